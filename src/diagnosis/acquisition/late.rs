//! The number of rows L by which PV is recorded later than the controller read it, and whether OP of a row was computed from PV
//! of that row.
//!
//! ```text
//! controller:  OP[k] - OP[k-1] = b0 PV[k+L] + b1 PV[k+L-1] + b2 PV[k+L-2] + c0 SP[k] + c1 SP[k-1] + d
//! process:     OP[k]           = b0 PV[k+L] + b1 PV[k+L-1] + b2 PV[k+L-2] + d
//! ```
//!
//! * A controller with an integrator computes the moves of OP from PV and set point of its own scans. Where the tags were read
//!   together, its equation holds with L = 0. Where PV is recorded late, it holds with that L alone.
//! * A late PV must be moved back. OP seems to cause it exactly: a model of the process would be the inverse of the controller,
//!   explain everything, and call any valve sound.
//! * A fast process really causes PV a row later. The equation of the process holds for it, by its steady gain, and not for a
//!   controller, whose OP is a sum over all of PV's past.
//! * Where the equation of the controller holds almost exactly, and not without the newest PV, both values of a row are of one
//!   scan.
//!   It does not matter when they were read, because registers are held.

use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use crate::sysid::stats::{mean, quantile};

/// Largest L that is tried (rows).
const LATEST: usize = 3;
/// Fewest rows at which OP moves.
const LEAST_ROWS: usize = 100;
/// Largest share that the controller with a late PV may leave of OP's moves, and of what L - 1 and the process leave; and the share
/// of OP's moves that PV of one row alone must explain, so that OP shows from which row it was computed.
const QUARTER: f64 = 0.25;
/// Share of OP's moves below which an equation holds: where L - 1 or the process leaves no more, PV is not late; where the
/// controller leaves no more, nothing else moved OP.
const EXPLAINED: f64 = 1e-3;

/// Largest share of OP's moves that the controller leaves where it computed OP from PV: the rounding of OP leaves a hundredth where
/// a usual move is four of its last digits, 1/6 of a squared digit of 16.
const COMPUTED: f64 = 0.01;
/// Share of the rows at which the controller's equation has to hold to the last digit: a limit of OP, or a set point that was
/// changed between two scans, may break it at the others.
const USUAL: f64 = 0.9;

/// One tag on rows; `None` where it is missing.
type Rows<'a> = &'a [Option<f64>];

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
        (0..LATEST + 2).map(|newest| unexplained(op, pv, sp, newest)).collect();
    // What is left with PV so many rows late, and what is left with one row less.
    let at = |late: usize| Some((all[late + 1].as_ref()?, all[late].as_ref()?));
    let known = |late: usize| {
        let (own, before) = at(late)?;
        let others = before.by_controller.min(own.by_process).min(1.0);
        (others > EXPLAINED && own.by_controller < QUARTER * others).then_some((late, own.by_controller))
    };
    let best = (1..=LATEST).filter_map(known).min_by(|a, b| a.1.total_cmp(&b.1));
    let pv_late = best.map_or(0, |(late, _)| late);
    // A smooth PV follows from the rows before and after, whenever it was read. So PV of this row must add to what they explain.
    let matters = at(pv_late).is_some_and(|(_, before)| before.by_controller > QUARTER);
    let of_one_scan = matters && known(pv_late).is_some_and(|(_, own)| own < EXPLAINED);
    Answer { pv_late, of_one_scan }
}

/// Whether the controller computed OP from these values of PV: for some L its equation holds to the rounding of the values. `None`
/// where OP does not tell, because it moves at too few rows or has too few digits.
///
/// PV that an archive drew is not what the controller read, so that its equation leaves more than rounding.
///
/// * `span`: number of rows over which the equation is summed: over more of them OP moves further, and is rounded as ever.
/// * `rounding`: the last digit of OP, and of PV.
pub fn is_computed(
    op: Rows,
    pv: Rows,
    sp: Option<Rows>,
    span: usize,
    [op_unit, pv_unit]: [f64; 2],
) -> Option<bool> {
    let mut told = None;
    for newest in 0..LATEST + 2 {
        let (mut columns, mut moves) = (vec![Vec::new(); COLUMNS], Vec::new());
        let rows: Vec<Option<Equation>> = all_rows(op).map(|k| equation(op, pv, sp, newest, k)).collect();
        for rows in rows.windows(span.max(1)) {
            let Some(summed) = rows.iter().copied().sum::<Option<Equation>>().filter(|own| own.travel > 0.0)
            else {
                continue;
            };
            moves.push(summed.moved);
            columns.iter_mut().zip(summed.columns).for_each(|(column, value)| column.push(value));
        }
        if moves.len() < LEAST_ROWS {
            continue;
        }
        columns.iter_mut().chain([&mut moves]).for_each(|column| centred(column));
        let most = COMPUTED * dot(&moves, &moves);
        let (theta, rest) = fitted(&columns, &moves);
        // Two values of OP are rounded, of PV two in its move, and all in its sum.
        let of_pv = theta[1].abs() + theta[0].abs() * (span as f64).sqrt();
        let rounding = op_unit + of_pv * pv_unit;
        // By half a digit each, so that a square is 1/12.
        if moves.len() as f64 * rounding * rounding / 6.0 > most {
            continue;
        }
        // One change of set point has more power than all the rows at which PV was drawn, so that the usual row has to hold as well.
        let sizes: Vec<f64> = rest.iter().map(|rest| rest.abs()).collect();
        if dot(&rest, &rest) <= most && quantile(&sizes, USUAL) <= rounding {
            return Some(true);
        }
        told = Some(false);
    }
    told
}

/// The sum of squares that each equation leaves, as a share of that of OP's moves.
struct Unexplained {
    by_controller: f64,
    by_process: f64,
}

/// Columns of an equation: PV, its first and second difference, set point, and its change.
const COLUMNS: usize = 5;

/// Both equations of one row, or their sums over several.
#[derive(Clone, Copy, Default)]
struct Equation {
    /// See [`COLUMNS`].
    columns: [f64; COLUMNS],
    /// OP.
    op: f64,
    /// The move of OP.
    moved: f64,
    /// The size of that move.
    travel: f64,
}

impl std::iter::Sum for Equation {
    fn sum<I: Iterator<Item = Self>>(rows: I) -> Self {
        rows.fold(Self::default(), |sum, row| Self {
            columns: std::array::from_fn(|i| sum.columns[i] + row.columns[i]),
            op: sum.op + row.op,
            moved: sum.moved + row.moved,
            travel: sum.travel + row.travel,
        })
    }
}

/// The rows for which an equation can be asked: the same for every `newest`, so that the shares compare.
fn all_rows(op: Rows) -> std::ops::Range<usize> {
    3..op.len().saturating_sub(LATEST)
}

/// The equations of row `k`; `None` where a value is missing.
///
/// * `newest`: L + 1, so that 1 is PV of OP's own row, and 0 PV of the rows before it alone.
fn equation(op: Rows, pv: Rows, sp: Option<Rows>, newest: usize, k: usize) -> Option<Equation> {
    let own = op[k]?;
    let pv = [pv[k + newest - 1]?, pv[k + newest - 2]?, pv[k + newest - 3]?];
    let sp = match sp {
        Some(sp) => [sp[k]?, sp[k - 1]?],
        None => [0.0; 2],
    };
    // Differences of neighbours, because the values themselves are nearly collinear.
    let columns = [pv[0], pv[0] - pv[1], pv[0] - 2.0 * pv[1] + pv[2], sp[0], sp[0] - sp[1]];
    let moved = own - op[k - 1]?;
    Some(Equation { columns, op: own, moved, travel: moved.abs() })
}

/// What both equations leave of OP; `None` where OP moves at fewer than [`LEAST_ROWS`] rows. Rows at which OP does not move are
/// left out, because it may be at a limit or in a dead band.
///
/// * `newest`: see [`equation`].
fn unexplained(op: Rows, pv: Rows, sp: Option<Rows>, newest: usize) -> Option<Unexplained> {
    let (mut columns, mut outputs, mut moves) = (vec![Vec::new(); COLUMNS], Vec::new(), Vec::new());
    for k in all_rows(op) {
        let Some(row) = equation(op, pv, sp, newest, k).filter(|row| row.moved != 0.0) else { continue };
        outputs.push(row.op);
        moves.push(row.moved);
        columns.iter_mut().zip(row.columns).for_each(|(column, value)| column.push(value));
    }
    let power = dot(&moves, &moves);
    if moves.len() < LEAST_ROWS || power.is_nan() || power <= 0.0 {
        return None;
    }
    columns.iter_mut().chain([&mut moves, &mut outputs]).for_each(|column| centred(column));
    let share = |columns: &[Vec<f64>], y: &[f64]| {
        let (_, rest) = fitted(columns, y);
        dot(&rest, &rest) / power
    };
    Some(Unexplained { by_controller: share(&columns, &moves), by_process: share(&columns[..3], &outputs) })
}

/// Subtracts the mean.
fn centred(column: &mut [f64]) {
    let middle = mean(column);
    column.iter_mut().for_each(|value| *value -= middle);
}

/// The coefficients of `y` by least squares on the columns, and its residual.
fn fitted(columns: &[Vec<f64>], y: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = columns.len();
    let mut g: Vec<f64> = (0..n * n).map(|at| dot(&columns[at / n], &columns[at % n])).collect();
    let mut theta: Vec<f64> = columns.iter().map(|column| dot(column, y)).collect();
    let mut live = [true; MOST_COLUMNS];
    factor(&mut g, n, n, &mut live);
    substitute(&g, n, &live, &mut theta);
    let explained =
        |k: usize| columns.iter().zip(&theta).map(|(column, theta)| theta * column[k]).sum::<f64>();
    let rest = (0..y.len()).map(|k| y[k] - explained(k)).collect();
    (theta, rest)
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
            for rows in 0..=LATEST {
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
            for delay in 1..=LATEST {
                assert_eq!(rows_late(&u, &later(&pv, delay), None), 0, "{pole} {zero} {noise} {delay}");
            }
            assert!(!answer(&u, &pv, None).of_one_scan, "{pole} {zero} {noise}");
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
