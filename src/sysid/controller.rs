//! The equation of the controller, and what decides whether it holds: a robust regression, and the error that rounding explains.
//!
//! ```text
//! u[k] - u[k-1] = c + sum_{i=0}^{2} g_i y[k-i] + sum_{i=1}^{2} h_i (u[k-i] - u[k-i-1]) + sum_{i=0}^{2} r_i sp[k-i] + e
//! ```
//!
//! This is a PI or PID controller in velocity form. `h` is the filter of its derivative or of PV, or a PV that is interpolated
//! between two of its scans.
//!
//! A controller computes OP without noise, so that e is rounding alone. With steps `q_u` of OP and `q_y` of PV its variance is
//!
//! ```text
//! (q_u^2 (1 + (1 + h_1)^2 + (h_1 - h_2)^2 + h_2^2) + q_y^2 sum g_i^2) / 12
//! ```
//!
//! because OP of one row is in two changes. Load and noise keep the equation of a process from being so exact.

use super::gram::{lower, products};
use super::least_squares::{MOST_COLUMNS, factor, substitute};
use super::stats::sd;
use super::student::{self, FREEDOM};

/// Longest lateness and longest skew of PV that are tried (samples): within the lags of the high-order ARX, and less than the lead
/// of the fitted rows and the rows behind them.
pub const LONGEST: usize = 15;
/// Lags of PV, of OP's changes and of the set point: those of a PID with a filtered derivative.
pub const LAGS: [usize; 3] = [3, 2, 3];
/// Scale of the errors of OP's changes, as a share of their spread, up to which the equation is exact whatever the rounding: the
/// noise of PV keeps the equation of a process from being so exact.
pub const EXACT: f64 = 1e-3;
/// Scale of the errors, in that of rounding, up to which they may be those of rounding: it becomes so large where one row in seven is
/// wrong (`s^2` grows by `(1 - c) / (1 - 6 c)` with their share c), and rounding itself makes the coefficients too small.
pub const MARGIN: f64 = 2.0;
/// Most passes of reweighted least squares: the scale of an exact controller shrinks from pass to pass.
const PASSES: usize = 30;
/// Relative change of the scale at which the passes end: the log-likelihood of a row changes by no more.
const SETTLED: f64 = 1e-3;
/// Finest step that is looked for, in standard deviations of the signal: finer ones explain less than [`EXACT`] by far. An error of
/// the equation that is smaller yet is one of arithmetic.
pub const FINEST: f64 = 1e-6;
/// Distance of a value from a whole number of steps that arithmetic explains (steps).
const OFF: f64 = 0.05;
/// Least share of the values that are a whole number of steps: the others may stand in for missing samples. One value in ten is by
/// chance.
const WHOLE: f64 = 0.97;

/// A regression with errors of Student's t.
#[derive(Clone, Debug)]
pub struct Robust {
    /// Errors of the target.
    pub errors: Vec<f64>,
    /// Their scale.
    pub scale: f64,
    /// One coefficient for each column.
    pub theta: Vec<f64>,
    /// The weights of the equivalent least squares.
    pub omega: Vec<f64>,
}

/// The regression of `target` on `columns` by reweighted least squares.
///
/// * `omega`: weights to start from.
/// * `least`: lower bound of the scale.
pub fn robust(columns: &[&[f64]], target: &[f64], mut omega: Vec<f64>, least: f64) -> Robust {
    let ones = vec![1.0; target.len()];
    let (mut errors, mut theta) = (target.to_vec(), Vec::new());
    let mut scale = student::first_scale(target, &ones);
    for _ in 0..PASSES {
        (errors, theta) = regression(columns, target, &omega);
        let before = scale;
        scale = student::scale(&errors, &ones, scale, FREEDOM, least);
        student::reweigh(&errors, &ones, (scale, FREEDOM), &mut omega);
        if (scale / before - 1.0).abs() < SETTLED {
            break;
        }
    }
    Robust { errors, scale, theta, omega }
}

/// The errors and the coefficients of a weighted least-squares regression of `target` on `columns`.
fn regression(columns: &[&[f64]], target: &[f64], weight: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let size = columns.len();
    let root: Vec<f64> = weight.iter().map(|weight| weight.sqrt()).collect();
    let by = |column: &[f64]| -> Vec<f64> { column.iter().zip(&root).map(|(c, w)| c * w).collect() };
    let scaled: Vec<Vec<f64>> = columns.iter().map(|column| by(column)).collect();
    let all: Vec<&[f64]> = scaled.iter().map(Vec::as_slice).collect();
    let (mut g, mut theta) = (vec![0.0; size * size], vec![0.0; size]);
    lower(&all, &mut g, size);
    products(&[&by(target)], &all, |_, i, sum| theta[i] = sum);
    let mut live = [true; MOST_COLUMNS];
    factor(&mut g, size, size, &mut live);
    substitute(&g, size, &live, &mut theta);
    let mut e = target.to_vec();
    for (theta, column) in theta.iter().zip(columns) {
        e.iter_mut().zip(*column).for_each(|(e, c)| *e -= theta * c);
    }
    (e, theta)
}

/// PV of three rows, the newest first, as its newest value, its first and its second difference: the values are nearly collinear.
pub fn in_differences([now, before, first]: [f64; 3]) -> [f64; 3] {
    [now, now - before, now - 2.0 * before + first]
}

/// The coefficients of the values of PV, by those of its [`in_differences`].
pub fn of_values([value, slope, bend]: [f64; 3]) -> [f64; 3] {
    [value + slope + bend, -slope - 2.0 * bend, bend]
}

/// The standard deviation of `e` that rounding explains.
///
/// * `steps`: the steps `q_u` of OP and `q_y` of PV.
/// * `g`, `h`: the coefficients of PV and of OP's earlier changes.
pub fn rounding(steps: [f64; 2], g: &[f64], h: &[f64]) -> f64 {
    let mut of_changes = vec![1.0];
    of_changes.extend(h.iter().map(|h| -h));
    // A change has OP of its row and, with the other sign, that of the row before.
    let at = |k: usize| of_changes.get(k).copied().unwrap_or(0.0);
    let of_op: f64 =
        (0..=of_changes.len()).map(|k| at(k) - k.checked_sub(1).map_or(0.0, at)).map(|c| c * c).sum();
    let of_pv: f64 = g.iter().map(|g| g * g).sum();
    ((steps[0].powi(2) * of_op + steps[1].powi(2) * of_pv) / 12.0).sqrt()
}

/// Whether the equation computes OP of PV alone: an error of OP's earlier changes dies out.
///
/// It does not where PV is interpolated and lies nearer to an earlier scan: OP then tells of a PV that the record does not show.
pub fn is_stable(h: &[f64]) -> bool {
    let [first, second] = [0, 1].map(|i| h.get(i).copied().unwrap_or(0.0));
    second.abs() < 1.0 && first.abs() < 1.0 - second
}

/// The resolution of a signal: the coarsest decimal step of which nearly all values are a whole number; 0 where there is none.
pub fn resolution(values: &[f64]) -> f64 {
    let spread = sd(values);
    if values.is_empty() || !(spread.is_finite() && spread > 0.0) {
        return 0.0;
    }
    let is_whole = |value: f64| (value - value.round()).abs() < OFF;
    let fits = |step: f64| {
        let whole = values.iter().filter(|value| is_whole(*value / step)).count();
        whole as f64 >= WHOLE * values.len() as f64
    };
    let (coarsest, finest) = (spread.log10().ceil() as i32, (FINEST * spread).log10().ceil() as i32);
    (finest..=coarsest).rev().map(|digit| 10f64.powi(digit)).find(|step| fits(*step)).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn noise(n: usize, seed: u64) -> Vec<f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed)).take(n).collect()
    }

    fn written(values: &[f64], step: f64) -> Vec<f64> {
        values.iter().map(|v| (v / step).round() * step).collect()
    }

    #[test]
    fn the_digits_of_values_tell_their_resolution() {
        let values: Vec<f64> = noise(2000, 1).iter().map(|e| 563.0 + 3.0 * e).collect();
        for step in [1.0, 0.1, 0.01, 1e-3, 1e-5] {
            let found = resolution(&written(&values, step));
            assert!((found / step - 1.0).abs() < 1e-12, "{found} for {step}");
        }
        assert_eq!(resolution(&values), 0.0, "as many digits as there are");
        assert_eq!((resolution(&[2.0; 50]), resolution(&[])), (0.0, 0.0));
        // What stands in for missing samples has other digits.
        let mut filled = written(&values, 0.01);
        filled.iter_mut().step_by(50).for_each(|v| *v += 0.004);
        assert!((resolution(&filled) - 0.01).abs() < 1e-12);
    }

    #[test]
    fn coefficients_of_differences_are_those_of_values() {
        let (pv, theta) = ([3.0, -1.0, 0.5], [0.25, -2.0, 4.0]);
        let sum = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert_eq!(in_differences(pv), [3.0, 4.0, 5.5]);
        assert_eq!(sum(theta, in_differences(pv)), sum(of_values(theta), pv));
    }

    #[test]
    fn rounding_explains_the_errors_of_a_controller() {
        let pv = noise(20_000, 2);
        let (g, h, steps) = ([-1.3, 0.9, 0.2], [0.4, -0.2], [0.02, 0.05]);
        let mut changes = vec![0.0; pv.len()];
        for k in 2..pv.len() {
            changes[k] =
                (0..3).map(|i| g[i] * pv[k - i]).sum::<f64>() + h[0] * changes[k - 1] + h[1] * changes[k - 2];
        }
        let op: Vec<f64> = changes
            .iter()
            .scan(40.0, |op, d| {
                *op += d;
                Some(*op)
            })
            .collect();
        let (op, pv) = (written(&op, steps[0]), written(&pv, steps[1]));
        let e: Vec<f64> = (4..pv.len())
            .map(|k| {
                let change = |k: usize| op[k] - op[k - 1];
                change(k)
                    - (0..3).map(|i| g[i] * pv[k - i]).sum::<f64>()
                    - h[0] * change(k - 1)
                    - h[1] * change(k - 2)
            })
            .collect();
        let expected = rounding(steps, &g, &h);
        assert!((sd(&e) / expected - 1.0).abs() < 0.03, "{} {expected}", sd(&e));
        assert!((rounding([0.12, 0.0], &[], &[]) - 0.12 * (2.0f64 / 12.0).sqrt()).abs() < 1e-15);
    }

    #[test]
    fn a_filter_is_stable_and_an_interpolated_pv_near_the_scan_before_is_not() {
        assert!(is_stable(&[]) && is_stable(&[0.9]) && is_stable(&[1.6, -0.64]) && is_stable(&[-0.4]));
        // PV is `(1 - d) PV[k] + d PV[k-1]`: the change of OP has the coefficient `-d / (1 - d)`.
        assert!(is_stable(&[-0.4 / 0.6, 0.0]) && !is_stable(&[-0.6 / 0.4, 0.0]) && !is_stable(&[0.5, 0.6]));
    }

    #[test]
    fn wrong_rows_do_not_move_a_robust_regression() {
        let x = noise(400, 3);
        let ones = vec![1.0; 400];
        let mut target: Vec<f64> = x.iter().map(|x| 2.0 - 3.0 * x).collect();
        target.iter_mut().step_by(20).for_each(|y| *y += 50.0);
        let found = robust(&[&ones, &x], &target, ones.clone(), 1e-6);
        assert!(
            (found.theta[0] - 2.0).abs() < 1e-4 && (found.theta[1] + 3.0).abs() < 1e-4,
            "{:?}",
            found.theta
        );
        assert!(found.scale < 1e-3 && found.omega[0] < 1e-3 * found.omega[1]);
    }
}
