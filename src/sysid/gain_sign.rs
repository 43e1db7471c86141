//! The sign of the process gain, from the way the controller acts: feedback is negative, or the loop would run away.
//!
//! ```text
//! u[k] - u[k-1] = c + sum_{i=0}^{2} g_i y[k-i] + sum_{i=0}^{2} r_i sp[k-i] + e[k]
//! ```
//!
//! This is a PI or PID controller in velocity form, fitted to the rows at which OP moves.
//! `g_0` is its proportional action (with the derivative), `sum g_i` its integral action.
//! The sign of the process gain is the opposite of theirs.
//! It is known only where both are significant and of one sign, and the equation explains the changes of OP.

use super::ols::Ols;

/// Lags of PV and of the set point: those of a PID.
const LAGS: usize = 3;
/// Two-sided 0.2 % point of the normal distribution, one-sided 0.1 %: a smaller |t| may be chance.
pub(super) const SIGNIFICANT: f64 = 3.09;
/// Largest share of the variance of OP's changes that the equation may leave: a feed-forward, another loop or a wrong clock leaves
/// more.
const LEAVES: f64 = 0.1;
/// Fewest rows at which OP moves.
const LEAST_ROWS: usize = 50;

/// The sign of the process gain (+1 or -1) with which the controller's feedback is negative; `None` where it is not known.
///
/// * `u`, `y`, `sp`: OP, PV and set point, one value for each row, in any units.
/// * `counts`: whether a row counts; the equation uses a row where it and the two before it count.
pub fn gain_sign(u: &[f64], y: &[f64], sp: Option<&[f64]>, counts: impl Fn(usize) -> bool) -> Option<f64> {
    let moves = |k: &usize| u[*k] != u[k - 1];
    let whole = |k: &usize| (k + 1 - LAGS..=*k).all(&counts);
    let rows: Vec<usize> = (LAGS - 1..u.len()).filter(|k| moves(k) && whole(k)).collect();
    if rows.len() < LEAST_ROWS {
        return None;
    }
    let column = |v: &[f64], lag: usize| -> Vec<f64> { rows.iter().map(|k| v[k - lag]).collect() };
    let mut columns = vec![vec![1.0; rows.len()]];
    columns.extend((0..LAGS).map(|lag| column(y, lag)));
    columns.extend(
        sp.into_iter().flat_map(|sp| (0..LAGS).map(move |lag| (sp, lag))).map(|(sp, lag)| column(sp, lag)),
    );
    let changes: Vec<f64> = rows.iter().map(|k| u[*k] - u[k - 1]).collect();
    let ols = Ols::new(&columns, &changes)?;
    let all = columns.len();
    let [proportional, integral] = [1..2, 1..1 + LAGS].map(|of| ols.t(all, of));
    let plain =
        proportional.abs().min(integral.abs()) > SIGNIFICANT && proportional.signum() == integral.signum();
    (plain && ols.rest(all) <= LEAVES * ols.rest(1)).then(|| -proportional.signum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// OP, PV and set point of a lag under a PI controller, whose valve sticks with `f`; `other`: what else moves OP.
    fn record(gain: f64, f: f64, other: f64, seed: u64) -> [Vec<f64>; 3] {
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed));
        let mut draw = || -> f64 { noise.next().unwrap_or(0.0) };
        let (mut x, mut stem, mut load, mut integral) = (0.0, 0.0f64, 0.0, 0.0);
        let mut out = [Vec::new(), Vec::new(), Vec::new()];
        for k in 0..1000 {
            let sp = [0.0, 1.0][k / 250 % 2];
            let pv: f64 = x + 0.05 * draw();
            let error = sp - pv;
            integral += 0.1 * error / gain;
            let op: f64 = integral + 0.8 * error / gain + other * draw();
            stem = if (op - stem).abs() > f { op - f * (op - stem).signum() } else { stem };
            load = 0.98 * load + 0.05 * draw();
            x += 0.1 * (gain * (stem + load) - x);
            out[0].push(op);
            out[1].push(pv);
            out[2].push(sp);
        }
        out
    }

    #[test]
    fn the_sign_is_that_of_the_process_whether_the_valve_sticks_or_not() {
        for seed in 1..6 {
            for (gain, f) in [(2.0, 0.0), (-0.5, 0.0), (2.0, 0.6), (-0.5, 0.6)] {
                let [u, y, sp] = record(gain, f, 0.0, seed);
                assert_eq!(gain_sign(&u, &y, Some(&sp), |_| true), Some(gain.signum()), "{gain} {f} {seed}");
            }
        }
    }

    #[test]
    fn what_does_not_show_is_not_told() {
        let [u, y, sp] = record(2.0, 0.6, 1.0, 1);
        assert_eq!(gain_sign(&u, &y, Some(&sp), |_| true), None, "something else moves OP");
        let [u, y, sp] = record(2.0, 0.6, 0.0, 1);
        assert_eq!(gain_sign(&u, &y, Some(&sp), |k| k % 4 == 0), None, "too few samples together");
        assert_eq!(gain_sign(&u[..40], &y[..40], None, |_| true), None, "too short");
    }
}
