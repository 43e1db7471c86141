//! Whether the controller computed OP from the recorded PV, or an archive drew that PV later.
//!
//! The equation of the controller (see `late.rs`) is summed over several rows: OP moves further then, and is rounded as ever.

use super::late::{LEAST_ROWS, Rows, centred, regression};
use super::later::SECTION;
use crate::sysid::controller::{LONGEST, in_differences};
use crate::sysid::least_squares::dot;
use crate::sysid::stats::quantile;

/// Largest share of OP's moves that the controller leaves where it computed OP from PV: the rounding of OP leaves a hundredth where
/// a usual move is four of its last digits, 1/6 of a squared digit of 16.
const COMPUTED: f64 = 0.01;
/// Share of the rows at which the controller's equation has to hold to the last digit: a limit of OP, or a set point that was
/// changed between two scans, may break it at the others.
const USUAL: f64 = 0.9;
/// Least share of the sections of a record in which the equation has to hold, where it does not hold over the whole: an archive draws
/// in all of them, and a set point that is not recorded breaks those in which it changes.
const SOME_SECTIONS: f64 = 0.25;

/// Whether the controller computed OP from these values of PV. `None` where OP does not tell, because it moves at too few rows or has
/// too few digits.
///
/// It did where for some L its equation holds to the rounding of the values, over the whole record or in some of its sections. A PV
/// that an archive drew is not what the controller read, so that the equation leaves more.
///
/// * `op`, `pv`, `sp`: one value for each row; `None` where a row has none.
/// * `span`: number of rows over which the equation is summed: over more of them OP moves further, and is rounded as ever.
/// * `rounding`: the last digit of OP, and of PV.
pub fn is_computed(
    op: Rows,
    pv: Rows,
    sp: Option<Rows>,
    span: usize,
    [op_unit, pv_unit]: [f64; 2],
) -> Option<bool> {
    let whole = holds(op, pv, sp, span, [op_unit, pv_unit])?;
    if whole {
        return Some(true);
    }
    // Each section has a constant of its own, and so a set point. Longer sums would leave it too few of them.
    let span = span.min(SECTION / 4);
    let starts = (0..op.len()).step_by(SECTION);
    let section = |start: usize| {
        let rows = start..start + SECTION;
        let sp = match sp {
            Some(sp) => Some(sp.get(rows.clone())?),
            None => None,
        };
        holds(op.get(rows.clone())?, pv.get(rows)?, sp, span, [op_unit, pv_unit])
    };
    let told: Vec<bool> = starts.filter_map(section).collect();
    let held = told.iter().filter(|holds| **holds).count();
    Some(held > 0 && held as f64 >= SOME_SECTIONS * told.len() as f64)
}

/// [`is_computed`] over all of these rows, with one set of coefficients.
fn holds(op: Rows, pv: Rows, sp: Option<Rows>, span: usize, [op_unit, pv_unit]: [f64; 2]) -> Option<bool> {
    let mut told = None;
    for newest in 0..LONGEST + 2 {
        let (mut columns, mut moves) = (vec![Vec::new(); COLUMNS], Vec::new());
        let rows: Vec<Option<Equation>> = all_rows(op).map(|k| equation(op, pv, sp, newest, k)).collect();
        for sum in sums(&rows, span) {
            moves.push(sum.moved);
            columns.iter_mut().zip(sum.columns).for_each(|(column, value)| column.push(value));
        }
        if moves.len() < LEAST_ROWS {
            continue;
        }
        columns.iter_mut().chain([&mut moves]).for_each(|column| centred(column));
        let most = COMPUTED * dot(&moves, &moves);
        let (rest, theta) = regression(&columns, &moves);
        // Two values of OP are rounded, of PV two in its move, four in the change of its move, and all in its sum.
        let of_pv = theta[1].abs() + 2.0 * theta[2].abs() + theta[0].abs() * (span as f64).sqrt();
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

/// Columns of an equation: PV, its first and second difference, set point, and its change.
const COLUMNS: usize = 5;

/// The equation of one row, or its sum over several.
#[derive(Clone, Copy, Default)]
struct Equation {
    /// See [`COLUMNS`].
    columns: [f64; COLUMNS],
    /// The move of OP.
    moved: f64,
    /// Number of rows at which OP moves.
    moves: f64,
}

impl Equation {
    /// Adds another one so many times.
    fn plus(self, other: Self, times: f64) -> Self {
        Self {
            columns: std::array::from_fn(|i| self.columns[i] + times * other.columns[i]),
            moved: self.moved + times * other.moved,
            moves: self.moves + times * other.moves,
        }
    }
}

/// The sums over every `span` neighbouring rows of which none is missing, where OP moves in them.
fn sums(rows: &[Option<Equation>], span: usize) -> Vec<Equation> {
    let span = span.max(1);
    let mut found = Vec::new();
    for run in rows.split(Option::is_none) {
        let run: Vec<Equation> = run.iter().flatten().copied().collect();
        let mut sum = Equation::default();
        for (first, own) in run.windows(span).enumerate() {
            // A long sum is that of the row before, moved on by a row. It is summed anew now and then, so that no rounding adds up.
            sum = if first.is_multiple_of(span) {
                own.iter().fold(Equation::default(), |sum, row| sum.plus(*row, 1.0))
            } else {
                sum.plus(run[first - 1], -1.0).plus(own[span - 1], 1.0)
            };
            if sum.moves > 0.0 {
                found.push(sum);
            }
        }
    }
    found
}

/// The rows for which an equation can be asked: the same for every `newest`, so that the shares compare.
fn all_rows(op: Rows) -> std::ops::Range<usize> {
    3..op.len().saturating_sub(LONGEST)
}

/// The equation of row `k`; `None` where a value is missing.
///
/// * `newest`: L + 1, so that 1 is PV of OP's own row, and 0 PV of the rows before it alone.
fn equation(op: Rows, pv: Rows, sp: Option<Rows>, newest: usize, k: usize) -> Option<Equation> {
    let own = op[k]?;
    let pv = [pv[k + newest - 1]?, pv[k + newest - 2]?, pv[k + newest - 3]?];
    let sp = match sp {
        Some(sp) => [sp[k]?, sp[k - 1]?],
        None => [0.0; 2],
    };
    let [value, slope, bend] = in_differences(pv);
    let columns = [value, slope, bend, sp[0], sp[0] - sp[1]];
    let moved = own - op[k - 1]?;
    Some(Equation { columns, moved, moves: if moved == 0.0 { 0.0 } else { 1.0 } })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equations_are_summed_over_neighbours_only() {
        // OP rests up to row 3, and row 6 is missing.
        let moves = |k: usize| if k > 3 { 1.0 } else { 0.0 };
        let row = |k: usize| Equation { columns: [k as f64; COLUMNS], moved: moves(k), moves: moves(k) };
        let rows: Vec<Option<Equation>> = (0..12).map(|k| (k != 6).then(|| row(k))).collect();
        let of = |span: usize| -> Vec<(f64, f64)> {
            sums(&rows, span).iter().map(|sum| (sum.columns[0], sum.moved)).collect()
        };
        assert_eq!(of(3), [(9.0, 1.0), (12.0, 2.0), (24.0, 3.0), (27.0, 3.0), (30.0, 3.0)]);
        assert_eq!(of(1), [4.0, 5.0, 7.0, 8.0, 9.0, 10.0, 11.0].map(|k| (k, 1.0)));
        assert_eq!((of(6), of(7)), (vec![(15.0, 2.0)], Vec::new()));
        assert!(sums(&[], 3).is_empty());
    }
}
