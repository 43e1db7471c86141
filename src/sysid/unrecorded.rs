//! What OP tells of PV beyond its samples.
//!
//! ```text
//! du[k] = c + sum_{i=0}^{2} g_i y[k-i] + sum_{i=1}^{2} h_i du[k-i] + sum_{i=0}^{2} r_i sp[k-i] + w[k],   du[k] = u[k] - u[k-1]
//! y[k]  = c + sum_{i=1}^{16} a_i y[k-i] + sum_{j=1}^{14} d_j w[k-j] + e[k]
//! ```
//!
//! `w` is the innovation of OP: what OP does that the recorded PV does not explain. A controller that acts on the recorded samples
//! alone leaves little in it. One that acts more often leaves its reaction to PV between the samples, above all in its integral. So
//! does one that sees PV finer than it is recorded. Such an OP predicts PV without moving it, and better than the stem of any valve.
//!
//! The sign tells the two apart where PV is noisy, because feedback is negative. Say the gain is positive, and OP rises because PV
//! has fallen between two samples. The next PV is low then: `d_j` has the sign of `g_0`. Where the valve moves PV, it rises: `d_j`
//! has the other sign. A process answers late. So the first lags tell of PV, up to the one at which the sum of the `d_j` is
//! farthest in the direction of `g_0`. Whether they tell at all is tested with one lag of `w`, and with four.
//!
//! Where PV is smooth, the sign does not tell. PV was low between two samples and is known at the second: it rises, and goes on
//! rising. There the size tells. Say `g` is the first `g_i` that is significant. If the valve moved PV by `d_1` within one sample, the
//! loop would correct `-d_1 g` of an error within one sample. Beyond 1, it would correct more than the whole error, and PV would turn
//! at every sample. So the first lag of `w` is the input there.

use super::arx::{LAGS_X, LAGS_Y};
use super::controller::{FINEST, LAGS as OF_CONTROLLER};
use super::gain_sign::SIGNIFICANT;
use super::ols::Ols;

/// Most lags of the innovation that are inputs beside the stem: as many as of the stem.
const LAGS: usize = LAGS_X;
/// So many first lags are tested by their sum, too: an integral remembers.
const REMEMBERED: usize = 4;
/// Share of an error of PV that a dead-beat loop corrects within one sample (-). A process `y[k+1] = a y[k] + d_1 u[k]`, a <= 1,
/// with a controller `u = g y` has the pole `a + d_1 g`. Beyond 1, `-d_1 g > 1 >= a`: the pole is negative, and PV would turn at
/// every sample instead of being smooth.
const DEAD_BEAT: f64 = 1.0;

/// The lags of OP's innovation that tell of PV, each with one value a row: inputs of PV beside the stem. `None` where none does. An
/// innovation is 0 where a row that it needs does not count.
///
/// * `u`, `y`, `sp`: OP, PV and set point, one value for each row, in any units.
/// * `gain_sign`: the sign of the process gain (+1 or -1), where it is known.
/// * `counts`: whether a row counts.
pub fn told_by_op(
    u: &[f64],
    y: &[f64],
    sp: Option<&[f64]>,
    gain_sign: Option<f64>,
    counts: impl Fn(usize) -> bool,
) -> Option<Vec<Vec<f64>>> {
    let counts: Vec<bool> = (0..u.len()).map(counts).collect();
    let Controller { w, reaction, gain } = controller(u, y, sp, &counts)?;
    // Where the sign of the gain is known it is taken, because it was tested more strictly; else the sign of this equation.
    let reaction = gain_sign.map(|sign| -sign).or(reaction)?;
    let known = |k: usize| w[k].is_some();
    let rows: Vec<usize> = (LAGS_Y.max(LAGS)..u.len())
        .filter(|k| counts[*k] && (1..=REMEMBERED).all(|lag| known(k - lag)))
        .collect();
    let w: Vec<f64> = w.into_iter().map(Option::unwrap_or_default).collect();
    let mut columns = vec![vec![1.0; rows.len()]];
    columns.extend((1..=LAGS_Y).map(|lag| lagged(&rows, y, lag)));
    let first = columns.len();
    columns.extend((1..=LAGS).map(|lag| lagged(&rows, &w, lag)));
    let next = lagged(&rows, y, 0);
    let process = Ols::new(&columns, &next)?;
    let input = |lag: usize| (0..w.len()).map(|k| w[k.saturating_sub(lag)]).collect();
    let tells = |lags: usize| reaction * process.t(first + lags, first..first + lags) > SIGNIFICANT;
    if !(tells(1) || tells(REMEMBERED)) {
        // Of a smooth PV.
        let corrects = -gain * process.theta(first + 1)[first];
        let shows = process.t(first + 1, first..first + 1).abs() > SIGNIFICANT;
        return (shows && corrects > DEAD_BEAT).then(|| vec![input(1)]);
    }
    let mut sums = vec![0.0];
    for d in &process.theta(columns.len())[first..] {
        sums.push(sums[sums.len() - 1] + reaction * d);
    }
    let lags = (0..sums.len()).max_by(|a, b| sums[*a].total_cmp(&sums[*b]))?;
    (lags > 0).then(|| (1..=lags).map(input).collect())
}

/// The equation of OP.
struct Controller {
    /// Innovation of OP, one value a row, where the rows that it needs count.
    w: Vec<Option<f64>>,
    /// The sign of the reaction to PV (+1 or -1), where it shows.
    reaction: Option<f64>,
    /// The first reaction to PV that is significant, as a gain; 0 where none is.
    gain: f64,
}

/// The equation of OP, fitted; `None` where it is exact.
fn controller(u: &[f64], y: &[f64], sp: Option<&[f64]>, counts: &[bool]) -> Option<Controller> {
    let change: Vec<f64> = (0..u.len()).map(|k| u[k] - u[k.saturating_sub(1)]).collect();
    let [of_pv, of_changes, of_sp] = OF_CONTROLLER;
    let rows: Vec<usize> = (of_changes + 1..u.len())
        .filter(|k| counts[k - of_changes - 1..=*k].iter().all(|own| *own))
        .collect();
    let mut columns = vec![vec![1.0; rows.len()]];
    columns.extend((0..of_pv).map(|lag| lagged(&rows, y, lag)));
    columns.extend((1..=of_changes).map(|lag| lagged(&rows, &change, lag)));
    if let Some(sp) = sp {
        columns.extend((0..of_sp).map(|lag| lagged(&rows, sp, lag)));
    }
    let of_op = Ols::new(&columns, &lagged(&rows, &change, 0))?;
    // What is left of an exact controller is the error of arithmetic.
    if of_op.rest(columns.len()) <= FINEST * FINEST * of_op.rest(1) {
        return None;
    }
    let t = |of: std::ops::Range<usize>| Some(of_op.t(columns.len(), of)).filter(|t| t.abs() > SIGNIFICANT);
    // OP of a row may have been written before PV of that row was read.
    let first = (1..=of_pv).find(|column| t(*column..column + 1).is_some());
    let theta = of_op.theta(columns.len());
    let gain = first.map_or(0.0, |column| theta[column]);
    let integral = t(1..1 + of_pv);
    let is_plain = integral.is_none_or(|integral| integral.signum() == gain.signum());
    let mut w = vec![None; u.len()];
    for (i, k) in rows.iter().enumerate() {
        let explained: f64 = columns.iter().zip(&theta).map(|(column, theta)| column[i] * theta).sum();
        w[*k] = Some(change[*k] - explained);
    }
    Some(Controller { w, reaction: first.filter(|_| is_plain).map(|_| gain.signum()), gain })
}

/// `v` of these rows, so many rows earlier.
fn lagged(rows: &[usize], v: &[f64], lag: usize) -> Vec<f64> {
    rows.iter().map(|k| v[k - lag]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// OP, PV and set point of every n-th scan of a PI controller: a lag of some samples with this gain, a valve that sticks with this
    /// f, a load, noise on every scan of PV, and what else moves OP.
    fn record(gain: f64, f: f64, scans: usize, other: f64, seed: u64) -> [Vec<f64>; 3] {
        noisy(gain, f, scans, other, 0.1, seed)
    }

    /// The same with noise of PV of this standard deviation.
    fn noisy(gain: f64, f: f64, scans: usize, other: f64, sd: f64, seed: u64) -> [Vec<f64>; 3] {
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed));
        let mut draw = || -> f64 { noise.next().unwrap_or(0.0) };
        let per = 1.0 / scans as f64;
        let (mut y, mut stem, mut load, mut integral) = (0.0, 0.0f64, 0.0, 0.0);
        let mut out = [Vec::new(), Vec::new(), Vec::new()];
        for k in 0..2000 * scans {
            let sp = if k / scans % 600 < 300 { 0.0 } else { 1.0 };
            let pv: f64 = y + sd * draw();
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
        told_by_op(&u, &y, Some(&sp), None, |_| true).is_some()
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
    fn only_lags_that_tell_of_pv_are_inputs() {
        // The valve follows OP: from some lag on, PV answers.
        let [u, y, sp] = record(2.0, 0.0, 4, 0.0, 1);
        let inputs = told_by_op(&u, &y, Some(&sp), Some(1.0), |_| true).expect("it tells");
        assert!((1..LAGS).contains(&inputs.len()), "{}", inputs.len());
        assert_eq!(told_by_op(&u, &y, Some(&sp), Some(-1.0), |_| true), None, "the other gain");
    }

    #[test]
    fn op_tells_of_a_smooth_pv_by_its_move_alone() {
        // Hardly noisy: PV between two samples tells where it goes next.
        for seed in 1..6 {
            for (gain, f) in [(2.0, 0.0), (-0.5, 1.2)] {
                let [u, y, sp] = noisy(gain, f, 4, 0.0, 1e-4, seed);
                let inputs = told_by_op(&u, &y, Some(&sp), Some(gain), |_| true).expect("it tells");
                assert_eq!(inputs.len(), 1, "{gain} {f} {seed}");
                let [u, y, sp] = noisy(gain, f, 1, 0.3, 1e-4, seed);
                assert_eq!(told_by_op(&u, &y, Some(&sp), Some(gain), |_| true), None, "{gain} {f} {seed}");
            }
        }
    }

    #[test]
    fn missing_rows_leave_the_others() {
        let [u, mut y, sp] = record(2.0, 0.0, 10, 0.0, 1);
        y[700] = 1e6;
        let inputs = told_by_op(&u, &y, Some(&sp), None, |k| k != 700).expect("it tells");
        assert_eq!(&inputs[0][701..705], [0.0; 4]);
        assert!(inputs.iter().flatten().all(|w| w.abs() < 1.0));
        // Every eleventh row is missing: the model fills its PV.
        let [u, y, sp] = record(2.0, 0.0, 10, 0.0, 1);
        assert!(told_by_op(&u, &y, Some(&sp), None, |k| k % 11 != 0).is_some());
    }

    #[test]
    fn a_short_record_tells_nothing() {
        let [u, y, _] = record(2.0, 0.0, 10, 0.0, 1);
        assert_eq!(told_by_op(&u[..20], &y[..20], None, None, |_| true), None);
        assert_eq!(told_by_op(&[], &[], None, None, |_| true), None);
        assert_eq!(told_by_op(&u, &vec![1.0; u.len()], None, None, |_| true), None, "PV stands still");
    }
}
