//! The number of rows L by which PV is recorded later than the controller read it, and whether OP of a row was computed from PV
//! of that row.
//!
//! ```text
//! controller:  OP[k] - OP[k-1] = b0 PV[k+L] + b1 PV[k+L-1] + b2 PV[k+L-2] + c0 SP[k] + c1 SP[k-1] + d
//! process:     OP[k]           = b0 PV[k+L] + b1 PV[k+L-1] + b2 PV[k+L-2] + d
//! with a load: OP[k] - OP[k-1] = b0 dPV[k+L] + b1 dPV[k+L-1] + b2 dPV[k+L-2] + b3 dPV[k+L-3] + d
//! ```
//!
//! * A controller with an integrator computes the moves of OP from PV and set point of its own scans. Where the tags were read
//!   together, its equation holds with L = 0. Where PV is recorded late, it holds with that L alone.
//! * A late PV must be moved back. OP seems to cause it exactly: a model of the process would be the inverse of the controller,
//!   explain everything, and call any valve sound.
//! * A fast process really causes PV a row later. The equation of the process holds for it, by its steady gain, and not for a
//!   controller, whose OP is a sum over all of PV's past.
//! * Beside a slow load that equation leaves the load, which is large. Its differences hold then (`dPV[k] = PV[k] - PV[k-1]`): they
//!   leave only the moves of the load. A controller has an integrator, whose moves follow from the value of PV and not from its
//!   differences.
//! * Where the equation of the controller holds almost exactly, and not without the newest PV, both values of a row are of one
//!   scan.
//!   It does not matter when they were read, because registers are held.

use crate::sysid::controller::{
    EXACT, LAGS, LONGEST, MARGIN, in_differences, of_values, resolution, rounding,
};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use crate::sysid::stats::mean;

/// Fewest rows at which OP moves.
pub(super) const LEAST_ROWS: usize = 100;
/// Largest share that the controller with a late PV may leave of OP's moves, and of what L - 1 and the process leave; and the share
/// of OP's moves that PV of one row alone must explain, so that OP shows from which row it was computed.
pub(super) const QUARTER: f64 = 0.25;
/// Share of OP's moves below which an equation holds: where L - 1 or the process leaves no more, PV is not late; where the
/// controller leaves no more, nothing else moved OP.
pub(super) const EXPLAINED: f64 = 1e-3;
/// Differences of PV by which the process beside a load is told: those of a second order, and one more.
pub(super) const DIFFERENCES: usize = 4;

/// One tag on rows; `None` where it is missing.
pub(super) type Rows<'a> = &'a [Option<f64>];

/// From which PV the controller computed OP.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Answer {
    /// Number L of rows by which PV is recorded late; 0 where OP does not show it.
    pub pv_late: usize,
    /// Whether OP of each row was computed from PV of that row, after PV is moved back. Then the controller did not act between the
    /// two readings.
    pub of_one_scan: bool,
}

/// Finds from which PV the controller computed OP.
///
/// * `op`, `pv`, `sp`: one value for each row, in any units; `None` where a row has none. `op` is without the term of write-back.
pub fn answer(op: Rows, pv: Rows, sp: Option<Rows>) -> Answer {
    let all: Vec<Option<Unexplained>> =
        (0..LONGEST + 2).map(|newest| unexplained(op, pv, sp, newest)).collect();
    let section = Section::of(op, pv, sp).between(DIFFERENCES, op.len().saturating_sub(LONGEST));
    // What is left with PV so many rows late, and what is left with one row less.
    let at = |late: usize| Some((all[late + 1].as_ref()?, all[late].as_ref()?));
    let known = |late: usize| {
        let (own, before) = at(late)?;
        let others = before.by_controller.min(own.by_process).min(1.0);
        let is_told = others > EXPLAINED && own.by_controller < QUARTER * others;
        let is_controller = || own.by_controller < QUARTER * own.beside_load || section.is_exact(late);
        (is_told && is_controller()).then_some((late, own.by_controller))
    };
    let best = (1..=LONGEST).filter_map(known).min_by(|a, b| a.1.total_cmp(&b.1));
    let pv_late = best.map_or(0, |(late, _)| late);
    // A smooth PV follows from the rows before and after, whenever it was read. So PV of this row must add to what they explain.
    let matters = at(pv_late).is_some_and(|(_, before)| before.by_controller > QUARTER);
    let of_one_scan = matters && known(pv_late).is_some_and(|(_, own)| own < EXPLAINED);
    Answer { pv_late, of_one_scan }
}

/// The sum of squares that each equation leaves, as a share of that of OP's moves.
struct Unexplained {
    by_controller: f64,
    by_process: f64,
    /// By the process beside a slow load.
    beside_load: f64,
}

/// What both equations leave of OP; `None` where OP moves at fewer than [`LEAST_ROWS`] rows. Rows at which OP does not move are
/// left out, because it may be at a limit or in a dead band.
///
/// * `newest`: L + 1, so that 1 is PV of OP's own row, and 0 PV of the rows before it alone.
fn unexplained(op: Rows, pv: Rows, sp: Option<Rows>, newest: usize) -> Option<Unexplained> {
    // The same rows for every `newest`, so that the shares compare.
    let rows = DIFFERENCES + 1..op.len().checked_sub(LONGEST)?;
    let (mut columns, mut outputs, mut moves) = (vec![Vec::new(); 5], Vec::new(), Vec::new());
    let mut differences = vec![Vec::new(); DIFFERENCES];
    for k in rows {
        let all = || {
            let own = op[k]?;
            let before = pv.get(k + newest - 1 - DIFFERENCES..k + newest)?;
            let mut of_pv = [0.0; DIFFERENCES + 1];
            for (own, value) in of_pv.iter_mut().zip(before.iter().rev()) {
                *own = (*value)?;
            }
            let [value, slope, bend] = in_differences([of_pv[0], of_pv[1], of_pv[2]]);
            let sp = match sp {
                Some(sp) => [sp[k]?, sp[k - 1]?],
                None => [0.0; 2],
            };
            let row = [value, slope, bend, sp[0], sp[0] - sp[1]];
            Some((own, own - op[k - 1]?, row, of_pv))
        };
        let Some((own, moved, row, of_pv)) = all().filter(|own| own.1 != 0.0) else { continue };
        differences.iter_mut().zip(of_pv.windows(2)).for_each(|(column, two)| column.push(two[0] - two[1]));
        outputs.push(own);
        moves.push(moved);
        columns.iter_mut().zip(row).for_each(|(column, value)| column.push(value));
    }
    let power = dot(&moves, &moves);
    if moves.len() < LEAST_ROWS || power.is_nan() || power <= 0.0 {
        return None;
    }
    columns.iter_mut().chain(&mut differences).chain([&mut moves, &mut outputs]).for_each(|one| centred(one));
    let share = |columns: &[Vec<f64>], y: &[f64]| {
        let (rest, _) = regression(columns, y);
        dot(&rest, &rest) / power
    };
    Some(Unexplained {
        by_controller: share(&columns, &moves),
        by_process: share(&columns[..3], &outputs),
        beside_load: share(&differences, &moves),
    })
}

/// Some rows of a record, to which the equation of the controller is fitted with its filter.
#[derive(Clone, Copy)]
pub(super) struct Section<'a> {
    pub(super) op: Rows<'a>,
    pv: Rows<'a>,
    sp: Option<Rows<'a>>,
    /// The steps in which OP and PV are written.
    steps: [f64; 2],
    /// The first row, and the one behind the last.
    rows: [usize; 2],
}

impl<'a> Section<'a> {
    /// All rows of a record.
    pub(super) fn of(op: Rows<'a>, pv: Rows<'a>, sp: Option<Rows<'a>>) -> Self {
        let measured = |rows: Rows| rows.iter().copied().flatten().collect::<Vec<f64>>();
        let steps = [op, pv].map(|rows| resolution(&measured(rows)));
        Self { op, pv, sp, steps, rows: [0, op.len()] }
    }

    /// The rows from `from` on, before `to`. OP has all of them.
    pub(super) fn between(self, from: usize, to: usize) -> Self {
        Self { rows: [from, to], ..self }
    }

    /// The rows at which OP moves and all of these are there, as columns: the first is the target. `None` where they are fewer than
    /// [`LEAST_ROWS`].
    pub(super) fn columns(&self, of: impl Fn(usize) -> Option<Vec<f64>>) -> Option<Vec<Vec<f64>>> {
        let [from, to] = self.rows;
        let mut columns: Vec<Vec<f64>> = Vec::new();
        for k in from.max(LAGS[1] + 1)..to {
            let Some(row) = self.change(k).filter(|change| *change != 0.0).and_then(|_| of(k)) else {
                continue;
            };
            columns.resize(row.len(), Vec::new());
            columns.iter_mut().zip(row).for_each(|(column, value)| column.push(value));
        }
        (columns.first()?.len() >= LEAST_ROWS).then_some(columns)
    }

    /// The change of OP to row `k`.
    pub(super) fn change(&self, k: usize) -> Option<f64> {
        Some(self.op[k]? - self.op[k.checked_sub(1)?]?)
    }

    /// PV `late` rows after row `k`.
    pub(super) fn pv(&self, k: usize, late: i64) -> Option<f64> {
        *self.pv.get(usize::try_from(k as i64 + late).ok()?)?
    }

    /// The columns of the controller's equation, with PV from `late` rows later on, and with so many earlier changes of OP.
    pub(super) fn of_controller(&self, late: i64, moves: usize) -> Option<Vec<Vec<f64>>> {
        self.columns(|k| {
            let mut row = vec![self.change(k)?];
            row.extend(in_differences([self.pv(k, late)?, self.pv(k, late - 1)?, self.pv(k, late - 2)?]));
            for lag in 1..=moves {
                row.push(self.change(k - lag)?);
            }
            if let Some(sp) = self.sp {
                let sp = [sp[k]?, sp[k - 1]?, sp[k - 2]?];
                row.extend([sp[0], sp[0] - sp[1], sp[1] - sp[2]]);
            }
            Some(row)
        })
    }

    /// The standard deviation of the controller's errors that rounding explains, by the coefficients of these columns.
    pub(super) fn rounding(&self, theta: &[f64], moves: usize) -> f64 {
        let g = of_values([theta[0], theta[1], theta[2]]);
        rounding(self.steps, &g, &theta[LAGS[0]..LAGS[0] + moves])
    }

    /// Whether the controller with PV so many rows late leaves no more than rounding. Such an equation is no process, also where its
    /// integrator does not show beside noise.
    fn is_exact(&self, late: usize) -> bool {
        let Some(mut columns) = self.of_controller(late as i64, LAGS[1]) else { return false };
        columns.iter_mut().for_each(|column| centred(column));
        let (target, others) = columns.split_at(1);
        let (rest, theta) = regression(others, &target[0]);
        let scale = |v: &[f64]| (dot(v, v) / v.len() as f64).sqrt();
        let of_rounding = MARGIN * self.rounding(&theta, LAGS[1]);
        scale(&rest) <= of_rounding.max(EXACT * scale(&target[0]))
    }
}

/// Subtracts the mean.
pub(super) fn centred(column: &mut [f64]) {
    let middle = mean(column);
    column.iter_mut().for_each(|value| *value -= middle);
}

/// The residual of `y` by least squares on the columns, and their coefficients.
pub(super) fn regression(columns: &[Vec<f64>], y: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = columns.len();
    let mut g: Vec<f64> = (0..n * n).map(|at| dot(&columns[at / n], &columns[at % n])).collect();
    let mut theta: Vec<f64> = columns.iter().map(|column| dot(column, y)).collect();
    let mut live = [true; MOST_COLUMNS];
    factor(&mut g, n, n, &mut live);
    substitute(&g, n, &live, &mut theta);
    let explained =
        |k: usize| columns.iter().zip(&theta).map(|(column, theta)| theta * column[k]).sum::<f64>();
    let rest = (0..y.len()).map(|k| y[k] - explained(k)).collect();
    (rest, theta)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;
    use std::f64::consts::TAU;

    /// PV that swings and rambles, and OP that a PI controller computes of it.
    fn pi(n: usize, seed: u64) -> (Vec<Option<f64>>, Vec<Option<f64>>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let (mut ramble, mut integral) = (0.0, 0.0);
        let mut row = |k: usize| {
            ramble = 0.9 * ramble + rng.random_range(-0.3..0.3);
            let pv = 50.0 + 2.0 * (TAU * k as f64 / 40.0).sin() + ramble;
            integral += 0.1 * (50.0 - pv);
            (Some(40.0 + 0.8 * (50.0 - pv) + integral), Some(pv))
        };
        (0..n).map(&mut row).unzip()
    }

    fn later(pv: &[Option<f64>], rows: usize) -> Vec<Option<f64>> {
        (0..pv.len()).map(|k| pv[k.saturating_sub(rows)]).collect()
    }

    fn rows_late(op: Rows, pv: Rows, sp: Option<Rows>) -> usize {
        answer(op, pv, sp).pv_late
    }

    /// Every `pace`-th row from row `from` on.
    fn every(rows: Rows, pace: usize, from: usize) -> Vec<Option<f64>> {
        rows.iter().skip(from).step_by(pace).copied().collect()
    }

    #[test]
    fn op_of_a_row_tells_whether_it_was_computed_from_its_pv() {
        for seed in 0..20 {
            let (op, pv) = pi(3000, seed);
            let of_one_scan = |op: Rows, pv: Rows| answer(op, pv, None).of_one_scan;
            assert!(of_one_scan(&op, &pv), "seed {seed}");
            // Read beyond the next scan, OP answers the PV of the next row, and PV is moved back.
            let moved = Answer { pv_late: 1, of_one_scan: true };
            assert_eq!(answer(&op, &later(&pv, 1), None), moved, "seed {seed}");
            // Of the scan before it answers PV of earlier rows alone.
            assert!(!of_one_scan(&later(&op, 1), &pv), "seed {seed}");
            // With scans between the rows, OP answers PVs that are in none of them.
            for (pace, after) in [(2, 1), (5, 2), (5, 4)] {
                assert!(
                    !of_one_scan(&every(&op, pace, after), &every(&pv, pace, 0)),
                    "{pace} {after} {seed}"
                );
            }
        }
    }

    #[test]
    fn the_controller_tells_how_late_pv_is() {
        for seed in 0..20 {
            let (op, mut pv) = pi(600, seed);
            for k in (5..600).step_by(17) {
                pv[k] = None;
            }
            for rows in (0..=4).chain([8, LONGEST]) {
                assert_eq!(rows_late(&op, &later(&pv, rows), None), rows, "seed {seed}");
            }
            // OP that is late makes the dead time longer, and nothing else.
            assert_eq!(rows_late(&later(&op, 1), &pv, None), 0);
        }
    }

    #[test]
    fn a_fast_process_is_not_the_controller() {
        // PV follows OP at once and exactly, or with noise; OP is moved by something else.
        let (_, u) = pi(600, 1);
        for (pole, zero, noise) in
            [(0.3, 0.0, 0.0), (0.0, 0.0, 0.0), (0.6, 0.5, 0.0), (0.3, 0.0, 0.05), (0.0, 0.0, 0.3)]
        {
            let mut rng = Pcg64Mcg::seed_from_u64(7);
            let (mut y, mut last) = (0.0, 0.0);
            let mut follows = |u: &Option<f64>| {
                let u = u.unwrap_or_default();
                y = pole * y + u + zero * last;
                last = u;
                Some(y + noise * rng.random_range(-1.0..1.0))
            };
            let pv: Vec<Option<f64>> = u.iter().map(&mut follows).collect();
            for delay in 1..=LONGEST {
                assert_eq!(rows_late(&u, &later(&pv, delay), None), 0, "{pole} {zero} {noise} {delay}");
            }
            assert!(!answer(&u, &pv, None).of_one_scan, "{pole} {zero} {noise}");
        }
    }

    #[test]
    fn a_fast_process_beside_a_slow_load_is_not_the_controller() {
        // The set point moves OP and is not recorded, so that the equation of the controller does not hold.
        for (seed, pole, delay) in [(1, 0.3, 0), (2, 0.8, 2), (3, 0.5, 6)] {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let mut draw = || rng.random_range(-1.0..1.0);
            let (mut x, mut load, mut target, mut integral) = (0.0, 0.0, 0.0, 0.0);
            let (mut op, mut pv) = (Vec::new(), Vec::new());
            for k in 0..2000 {
                let seen: f64 = x + 0.005 * draw();
                target = 0.9 * target + 0.5 * draw();
                load = 0.995 * load + 0.1 * draw();
                integral += 0.1 * (target - seen);
                op.push(Some(0.5 * (target - seen) + integral));
                pv.push(Some(seen));
                let acts: Option<f64> = if k >= delay { op[k - delay] } else { None };
                x = pole * x + (1.0 - pole) * (acts.unwrap_or(0.0) + load);
            }
            assert_eq!(rows_late(&op, &pv, None), 0, "{seed}");
        }
    }

    #[test]
    fn a_late_pv_of_a_controller_whose_integrator_hardly_shows_is_known() {
        // The derivative of a noisy PV moves OP far more than the integrator, and both tags are rounded.
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let (mut slow, mut integral, mut x, mut load) = (0.0, 0.0, 0.0, 0.0);
        let (mut op, mut pv) = (Vec::new(), Vec::new());
        let rounded = |value: f64| Some((value * 100.0).round() / 100.0);
        for _ in 0..2000 {
            let seen = x + rng.random_range(-0.2..0.2);
            slow += (seen - slow) / 1.8;
            integral -= 0.05 * seen;
            let own = -0.8 * seen + integral - 2.5 * (seen - slow);
            op.push(rounded(40.0 + own));
            pv.push(rounded(50.0 + seen));
            load = 0.995 * load + rng.random_range(-0.2..0.2);
            x = 0.9 * x + 0.1 * (own + load);
        }
        for rows in [0, 1, 3, 6] {
            assert_eq!(rows_late(&op, &later(&pv, rows), None), rows);
        }
    }

    #[test]
    fn short_and_still_records_say_nothing() {
        let (op, pv) = pi(90, 1);
        assert_eq!(rows_late(&op, &later(&pv, 1), None), 0);
        assert_eq!(rows_late(&[], &[], None), 0);
        assert_eq!(rows_late(&[Some(1.0); 300], &[Some(2.0); 300], Some(&[Some(2.0); 300])), 0);
        assert_eq!(answer(&[None; 300], &[None; 300], None), Answer::default());
    }
}
