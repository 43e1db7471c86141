//! The declared model judged on data it has not seen: fitted on the first 70 % of the window, its one-step and
//! free-run errors taken on the last 30 %, its residual tested for whiteness.
//!
//! ```text
//! Q = N (N + 2) sum over l = 1..h of r_l² / (N - l)  <  chi²_0.99(h - na - nc)      (Ljung–Box)
//! ```
//!
//! Source: Ljung & Box, Biometrika 1978, 65, 297.

use super::Residual;
use super::armax::{Lag, Signals, Workspace, draw_inside};
use super::friction::stick_slip;
use crate::sysid::least_squares::dot;
use super::search::{Problem, Refined};

/// Share of the window that the model is fitted on.
pub const FITTED_SHARE: f64 = 0.7;
/// Lags in the whiteness test.
const LAGS: usize = 20;

/// Judges the chosen model; `unit` is the PV unit of a normalised PV.
pub fn validate(p: &Problem, chosen: &Refined, unit: f64) -> Residual {
    let n = p.y.len();
    let split = p.first + ((n - p.first) as f64 * FITTED_SHARE) as usize;
    let (mut x, mut dir) = (vec![0.0; n], vec![0.0; n]);
    stick_slip(&p.u, chosen.f, chosen.resume, p.start, &mut x, &mut dir);
    let fitted = Signals {
        y: &p.y[..split],
        x: &x[..split],
        dir: &dir[..split],
        start: p.start.index,
        first: p.first,
    };
    let mut work = Workspace::new(n);
    let orders = chosen.fit.orders;
    let fit = work.minimise(&fitted, orders, chosen.fit.theta, Lag::Fixed, 1e-6, 30);
    // A model for simulation must not explode: one-step errors hide an A just outside the unit circle.
    let mut simulated = fit.theta;
    draw_inside(&mut simulated.a[..orders.na], 1.0);
    let whole = Signals { y: &p.y, x: &x, dir: &dir, start: p.start.index, first: p.first };
    work.evaluate(&whole, orders, &fit.theta);
    let held_out = &work.errors()[split..n];
    let rms = |v: &[f64]| (dot(v, v) / v.len().max(1) as f64).sqrt() * unit;
    let one_step_rmse = rms(held_out);
    let mut y = p.y.clone();
    for k in split..n {
        let past: f64 = (0..orders.na).map(|i| simulated.a[i] * y[k - 1 - i]).sum();
        let stem = |at: usize| x[at] - fit.theta.lag * dir[at];
        let input: f64 = (0..orders.nb).map(|j| fit.theta.b[j] * stem(k - orders.nk - j)).sum();
        // An unstable A must not end in infinities; far outside the record is wrong enough.
        y[k] = (input + fit.theta.c0 - past).clamp(-1e6, 1e6);
    }
    let free: Vec<f64> = y[split..].iter().zip(&p.y[split..]).map(|(a, b)| a - b).collect();
    work.evaluate(&whole, orders, &chosen.fit.theta);
    let white = is_white(&work.errors()[p.first..n], orders.na + orders.nc);
    Residual { white, one_step_rmse, free_run_rmse: rms(&free) }
}

/// Ljung–Box at 1 %, with `fitted` degrees of freedom used up.
pub fn is_white(e: &[f64], fitted: usize) -> bool {
    let n = e.len() as f64;
    let power = dot(e, e);
    if e.len() <= 2 * LAGS || power <= 0.0 {
        return true;
    }
    let q: f64 = (1..=LAGS)
        .map(|l| {
            let r = dot(&e[l..], &e[..e.len() - l]) / power;
            r * r / (n - l as f64)
        })
        .sum::<f64>()
        * n
        * (n + 2.0);
    q < chi_squared_99((LAGS - fitted) as f64)
}

/// 99 % point of chi-squared with `dof` degrees of freedom (Wilson–Hilferty, good to 0.5 % here).
fn chi_squared_99(dof: f64) -> f64 {
    let a = 2.0 / (9.0 * dof);
    dof * (1.0 - a + 2.326_347_9 * a.sqrt()).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn chi_squared_by_table() {
        // Tables: 99 % of chi-squared is 29.141 with 14 and 37.566 with 20 degrees of freedom.
        assert!((chi_squared_99(14.0) - 29.141).abs() < 0.1);
        assert!((chi_squared_99(20.0) - 37.566).abs() < 0.1);
    }

    #[test]
    fn white_passes_and_coloured_fails() {
        let (mut passed, mut caught) = (0, 0);
        for seed in 0..200 {
            let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
            let e: Vec<f64> = StandardNormal.sample_iter(&mut rng).take(500).collect();
            passed += usize::from(is_white(&e, 0));
            let coloured: Vec<f64> = e.windows(2).map(|w| w[1] + 0.4 * w[0]).collect();
            caught += usize::from(!is_white(&coloured, 0));
        }
        // 1 % of 200 is 2; six or more rejections would have a chance of 2 %.
        assert!(passed >= 195, "{passed}");
        // r1 = 0.345 gives Q = 59 on average against a limit of 38.
        assert!(caught >= 190, "{caught}");
    }
}
