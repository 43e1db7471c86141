//! Validation of the declared model: its one-step and free-run errors on held-out samples, and the whiteness of its residual.
//!
//! The coefficients are fitted again to the first 70 % of the window; the errors are those of the last 30 %.
//! Whiteness ([`crate::sysid::whiteness`]) is tested with the model that was fitted to the whole window, on the whole window.

use super::armax::{Lag, Signals, Workspace, draw_inside};
use super::friction::stick_slip;
use super::result::Residual;
use super::search::{Problem, Refined};
use crate::sysid::least_squares::dot;
use crate::sysid::whiteness::is_white;

/// Share of the window to which the validated model is fitted; the rest is held out.
pub const FITTED_SHARE: f64 = 0.7;

/// Validates the chosen model.
///
/// * `unit`: standard deviation of PV (PV unit), which converts the errors of the normalised PV.
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
        rows: p.holes.within(split),
    };
    let mut work = Workspace::new(n);
    let orders = chosen.fit.orders;
    let fit = work.minimise(&fitted, orders, chosen.fit.theta, Lag::Fixed, 1e-6, 30);
    // One-step errors hide a zero of A just outside the unit circle, with which a free run would diverge.
    let mut simulated = fit.theta;
    draw_inside(&mut simulated.a[..orders.na], 1.0);
    let whole = p.signals(&x, &dir);
    work.evaluate(&whole, orders, &fit.theta);
    let left_out = whole.rows.left_out;
    let counts = |k: &usize| left_out.binary_search(k).is_err();
    let of = |v: &[f64], from: usize| -> Vec<f64> { (from..n).filter(counts).map(|k| v[k]).collect() };
    let rms = |v: &[f64]| (dot(v, v) / v.len().max(1) as f64).sqrt() * unit;
    let one_step_rmse = rms(&of(work.errors(), split));
    let mut y = p.y.clone();
    for k in split..n {
        let past: f64 = (0..orders.na).map(|i| simulated.a[i] * y[k - 1 - i]).sum();
        let stem = |at: usize| x[at] - fit.theta.lag * dir[at];
        let input: f64 = (0..orders.nb).map(|j| fit.theta.b[j] * stem(k - orders.nk - j)).sum();
        // An unstable A must not end in infinities.
        y[k] = (input + fit.theta.c0 - past).clamp(-1e6, 1e6);
    }
    let free: Vec<f64> = y.iter().zip(&p.y).map(|(a, b)| a - b).collect();
    work.evaluate(&whole, orders, &chosen.fit.theta);
    let white = is_white(&of(work.errors(), p.first), orders.na + orders.nc);
    Residual { white, one_step_rmse, free_run_rmse: rms(&of(&free, split)) }
}
