//! What OP tells of PV between the samples.
//!
//! ```text
//! du[k] = c + sum_{i=0}^{2} g_i y[k-i] + sum_{i=1}^{2} h_i du[k-i] + sum_{i=0}^{2} r_i sp[k-i] + w[k],   du[k] = u[k] - u[k-1]
//! y[k]  = c + sum_{i=1}^{16} a_i y[k-i] + sum_{j=1}^{14} d_j w[k-j] + e[k]
//! ```
//!
//! `w` is the innovation of OP: what it does that the recorded PV does not explain. A controller that acts on the recorded samples
//! alone leaves rounding in `w`. One that acts more often leaves its reaction to PV between the samples, above all in its integral,
//! so that OP predicts PV without moving it. Such an OP predicts PV better than the stem of any valve does.
//!
//! Feedback is negative: PV moved by the valve has the sign opposite to that of the PV to which OP reacted. So where the `d_j` have
//! the sign of the reaction, OP tells of PV.

use super::arx::{LAGS_X, LAGS_Y};
use super::controller::LAGS as OF_CONTROLLER;
use super::gain_sign::SIGNIFICANT;
use super::ols::Ols;

/// Lags of the innovation that a model of PV has beside the stem: as many as it has of the stem, so that it knows of OP what a model
/// without friction knows.
pub const LAGS: usize = LAGS_X;
/// Lags of the innovation whose sum is tested beside the first: those of an integral, which remembers.
const REMEMBERED: usize = 4;

/// The innovation of OP, one value for each row, where it tells of PV between the samples; `None` where it does not. It is 0 where
/// a row that it needs does not count.
///
/// * `u`, `y`, `sp`: OP, PV and set point, one value for each row, in any units.
/// * `counts`: whether a row counts.
pub fn innovation(
    u: &[f64],
    y: &[f64],
    sp: Option<&[f64]>,
    counts: impl Fn(usize) -> bool,
) -> Option<Vec<f64>> {
    let counts: Vec<bool> = (0..u.len()).map(counts).collect();
    let whole = |k: &usize, lags: usize| counts[k - lags..=*k].iter().all(|own| *own);
    let at =
        |rows: &[usize], v: &[f64], lag: usize| -> Vec<f64> { rows.iter().map(|k| v[k - lag]).collect() };

    let change: Vec<f64> = (0..u.len()).map(|k| u[k] - u[k.saturating_sub(1)]).collect();
    let [of_pv, of_changes, of_sp] = OF_CONTROLLER;
    let rows: Vec<usize> = (of_changes + 1..u.len()).filter(|k| whole(k, of_changes + 1)).collect();
    let mut columns = vec![vec![1.0; rows.len()]];
    columns.extend((0..of_pv).map(|lag| at(&rows, y, lag)));
    columns.extend((1..=of_changes).map(|lag| at(&rows, &change, lag)));
    columns.extend(
        sp.into_iter()
            .flat_map(|sp| (0..of_sp).map(move |lag| (sp, lag)))
            .map(|(sp, lag)| at(&rows, sp, lag)),
    );
    let controller = Ols::new(&columns, &at(&rows, &change, 0))?;
    // OP of a row may have been written before PV of that row was read.
    let reactions = (1..=of_pv).map(|column| controller.t(columns.len(), column..column + 1));
    let reaction = reactions.into_iter().find(|t| t.abs() > SIGNIFICANT)?;
    let theta = controller.theta(columns.len());
    let mut w = vec![0.0; u.len()];
    for (i, k) in rows.iter().enumerate() {
        w[*k] = change[*k] - columns.iter().zip(&theta).map(|(column, theta)| column[i] * theta).sum::<f64>();
    }

    let longest = LAGS_Y.max(LAGS);
    let rows: Vec<usize> = (longest..u.len()).filter(|k| whole(k, longest)).collect();
    let mut columns = vec![vec![1.0; rows.len()]];
    columns.extend((1..=LAGS_Y).map(|lag| at(&rows, y, lag)));
    columns.extend((1..=REMEMBERED).map(|lag| at(&rows, &w, lag)));
    let process = Ols::new(&columns, &at(&rows, y, 0))?;
    let first = LAGS_Y + 1;
    let tells = |lags: usize| reaction.signum() * process.t(columns.len(), first..first + lags) > SIGNIFICANT;
    (tells(1) || tells(REMEMBERED)).then_some(w)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// OP, PV and set point of every n-th scan of a PI controller: a lag of some samples with this gain, a valve that sticks with this
    /// f, a load, noise on every scan of PV, and what else moves OP.
    fn record(gain: f64, f: f64, scans: usize, other: f64, seed: u64) -> [Vec<f64>; 3] {
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed));
        let mut draw = || -> f64 { noise.next().unwrap_or(0.0) };
        let per = 1.0 / scans as f64;
        let (mut y, mut stem, mut load, mut integral) = (0.0, 0.0f64, 0.0, 0.0);
        let mut out = [Vec::new(), Vec::new(), Vec::new()];
        for k in 0..2000 * scans {
            let sp = if k / scans % 600 < 300 { 0.0 } else { 1.0 };
            let pv: f64 = y + 0.1 * draw();
            let error = sp - pv;
            integral += 0.03 * per * error / gain;
            let op: f64 = integral + 0.8 * error / gain + other * draw();
            if k % scans == 0 {
                [op, pv, sp].into_iter().zip(&mut out).for_each(|(value, out)| out.push(value));
            }
            stem = if (op - stem).abs() > f { op - f * (op - stem).signum() } else { stem };
            load += -0.01 * per * load + 0.03 * per.sqrt() * draw();
            y += 0.05 * per * (gain * stem + load - y);
        }
        out
    }

    fn tells(gain: f64, f: f64, scans: usize, other: f64, seed: u64) -> bool {
        let [u, y, sp] = record(gain, f, scans, other, seed);
        innovation(&u, &y, Some(&sp), |_| true).is_some()
    }

    #[test]
    fn op_tells_of_pv_where_the_controller_acts_between_the_samples() {
        for seed in 1..6 {
            for (gain, f) in [(2.0, 0.0), (-0.5, 0.0), (2.0, 0.3), (-0.5, 1.2)] {
                assert!(tells(gain, f, 10, 0.0, seed), "{gain} {f} {seed}");
                assert!(!tells(gain, f, 1, 0.0, seed), "{gain} {f} {seed}");
            }
        }
    }

    #[test]
    fn op_that_something_else_moves_tells_nothing() {
        for seed in 1..6 {
            assert!(!tells(2.0, 0.0, 1, 0.5, seed), "{seed}: PV follows OP");
        }
    }

    #[test]
    fn rows_that_do_not_count_have_no_innovation() {
        let [u, mut y, sp] = record(2.0, 0.0, 10, 0.0, 1);
        y[700] = 1e6;
        let w = innovation(&u, &y, Some(&sp), |k| k != 700).expect("it tells");
        assert_eq!(&w[700..704], [0.0; 4]);
        assert!(w.iter().all(|w| w.abs() < 1.0));
        assert_eq!(innovation(&u[..20], &y[..20], None, |_| true), None, "too short");
        assert_eq!(innovation(&[], &[], None, |_| true), None);
    }
}
