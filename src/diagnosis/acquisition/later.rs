//! Whether OP answers a PV that is recorded later, at stamps that no move of PV by whole rows puts right: where the lateness drifts,
//! or PV is interpolated.
//!
//! OP that is computed from PV of its row and before tells nothing of a PV that is still to come. Where it answers a later PV, a
//! model of the process finds the controller's inverse: it explains PV by OP, and denies any friction. So such a record must not
//! say that a valve does not stick.
//!
//! In each section of the record the equation of the controller ([`crate::sysid::controller`]) is fitted with PV up to
//! [`LONGEST`] rows later. The regression is robust, because a lateness that drifts is the same in most rows of a section only. OP
//! answers a later PV where all of these are true:
//!
//! * at the stamps the equation leaves more than rounding, whether OP is computed from PV of its row or of the row before;
//! * with a later PV it leaves less than a quarter of that variance;
//! * it also leaves less than a quarter of what a process leaves, beside a steady load or a slow one (see `late.rs`). A process has
//!   lags of its own, so that beside a slow load it may have earlier changes of OP as the controller has. Where the controller
//!   leaves only rounding it has none, because no process is so exact.

use super::late::{DIFFERENCES, EXPLAINED, LEAST_ROWS, QUARTER, Rows, Section, centred, regression};
use crate::sysid::controller::{EXACT, LAGS, LONGEST, MARGIN, Robust, is_stable, robust};
use crate::sysid::least_squares::dot;
use crate::sysid::stats::{mean, sd};

/// Rows of a section: twice as many as the least at which OP moves.
pub(super) const SECTION: usize = 2 * LEAST_ROWS;
/// Sections at most, spread over the record.
const SECTIONS: usize = 8;
/// Latenesses whose equation is fitted robustly: those that leave the least by least squares. The right one is among them, also where
/// the next two fit alike.
const CANDIDATES: usize = 3;
/// Share of a signal's spread that ends the shrinking of a scale.
const LEAST: f64 = 1e-7;

/// How much later than OP the PV is recorded that OP answers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Later {
    /// Share of the sections in which it is later (0..1).
    pub share: f64,
    /// How much later it is in the middle one of these (rows).
    pub rows: f64,
}

impl Later {
    /// In how much of the rows OP answers a later PV; none where OP moves too seldom to tell.
    ///
    /// * `op`, `pv`, `sp`: one value for each row, in any units; `None` where a row has none.
    pub fn of(op: Rows, pv: Rows, sp: Option<Rows>) -> Self {
        let whole = Section::of(op, pv, sp);
        let n = op.len().min(pv.len());
        let every = (n / SECTIONS).max(SECTION);
        let starts = (0..n).step_by(every).filter(|start| start + SECTION <= n);
        let section = |start: usize| whole.between(start, start + SECTION).later();
        let told: Vec<Option<usize>> = starts.filter_map(section).collect();
        let mut late: Vec<usize> = told.iter().copied().flatten().collect();
        late.sort_unstable();
        Self {
            share: late.len() as f64 / told.len().max(1) as f64,
            rows: late.get(late.len() / 2).map_or(0.0, |rows| *rows as f64),
        }
    }
}

/// An equation, fitted.
struct Fit {
    /// Variance of its errors.
    variance: f64,
    /// Their scale, in that which rounding explains.
    of_rounding: f64,
    /// Whether it computes OP of PV alone.
    is_stable: bool,
}

impl Section<'_> {
    /// The number of rows by which the PV that OP answers is later: `Some(None)` where it is not, `None` where OP moves too seldom.
    fn later(&self) -> Option<Option<usize>> {
        let mut honest: Option<f64> = None;
        // Without the lags that a controller does not need its equation is not unique: it may look unstable with them.
        for (moves, newest) in (0..=LAGS[1]).flat_map(|moves| [(moves, 0), (moves, -1)]) {
            let fit = self.controller(newest, moves)?;
            if fit.is_stable && fit.of_rounding <= 1.0 {
                return Some(None);
            }
            if fit.is_stable {
                honest = Some(honest.map_or(fit.variance, |least: f64| least.min(fit.variance)));
            }
        }
        let honest = honest?;
        let with = |rows: usize| Some((rows, self.controller(rows as i64, LAGS[1])?));
        let all: Vec<(usize, Fit)> = self.candidates().into_iter().filter_map(with).collect();
        // A controller that does not need the oldest of its PVs fits a row later as well: the least late one that fits is right.
        let least = all.iter().map(|(_, fit)| fit.variance).fold(f64::INFINITY, f64::min);
        let (rows, fit) = all.iter().find(|(_, fit)| fit.variance <= least / QUARTER)?;
        let [steady, beside_load] = self.process(*rows, fit.of_rounding <= MARGIN)?;
        let others = honest.min(steady);
        let is_late = others > EXPLAINED * self.moves()? && fit.variance < QUARTER * others.min(beside_load);
        Some(is_late.then_some((*rows).max(1)))
    }

    /// The latenesses (rows) that leave the least by least squares, the least late first.
    fn candidates(&self) -> Vec<usize> {
        let left = |rows: usize| {
            let mut columns = self.of_controller(rows as i64, LAGS[1])?;
            columns.iter_mut().for_each(|column| centred(column));
            let (rest, _) = regression(&columns[1..], &columns[0]);
            Some((dot(&rest, &rest) / rest.len() as f64, rows))
        };
        let mut all: Vec<(f64, usize)> = (0..=LONGEST).filter_map(left).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut rows: Vec<usize> = all.into_iter().take(CANDIDATES).map(|(_, rows)| rows).collect();
        rows.sort_unstable();
        rows
    }

    /// Variance of OP's changes.
    fn moves(&self) -> Option<f64> {
        let columns = self.columns(|k| Some(vec![self.change(k)?]))?;
        Some(sd(&columns[0]).powi(2))
    }

    /// The equation of the controller with PV from `newest` rows later on, and with so many earlier changes of OP.
    fn controller(&self, newest: i64, moves: usize) -> Option<Fit> {
        let columns = self.of_controller(newest, moves)?;
        let fit = fitted(&columns)?;
        let by_rounding = self.rounding(&fit.theta, moves).max(EXACT * sd(&columns[0]));
        Some(Fit {
            variance: fit.scale.powi(2),
            of_rounding: fit.scale / by_rounding,
            is_stable: is_stable(&fit.theta[LAGS[0]..LAGS[0] + moves]),
        })
    }

    /// The variances that the equations of the process leave beside a steady load and a slow one, with PV from `newest` rows later on.
    ///
    /// * `is_exact`: whether the controller leaves only rounding. Then the process has no earlier changes of OP.
    fn process(&self, newest: usize, is_exact: bool) -> Option<[f64; 2]> {
        let newest = newest as i64;
        let steady = self.columns(|k| {
            let mut row = vec![self.op[k]?];
            for lag in 0..LAGS[0] as i64 {
                row.push(self.pv(k, newest - lag)?);
            }
            Some(row)
        })?;
        let slow = |moves: usize| {
            self.columns(|k| {
                let mut row = vec![self.change(k)?];
                for lag in 0..DIFFERENCES as i64 {
                    row.push(self.pv(k, newest - lag)? - self.pv(k, newest - lag - 1)?);
                }
                for lag in 1..=moves {
                    row.push(self.change(k - lag)?);
                }
                Some(row)
            })
        };
        let slow = slow(if is_exact { 0 } else { LAGS[1] })?;
        Some([fitted(&steady)?, fitted(&slow)?].map(|fit| fit.scale.powi(2)))
    }
}

/// The robust regression of the first column on the others, each centred; coefficients are those of the others.
fn fitted(columns: &[Vec<f64>]) -> Option<Robust> {
    let centred = |column: &Vec<f64>| -> Vec<f64> {
        let middle = mean(column);
        column.iter().map(|value| value - middle).collect()
    };
    let spread = sd(columns.first()?);
    if spread.is_nan() || spread <= 0.0 {
        return None;
    }
    // Scales have a least value: they are compared where the target has the spread 1.
    let all: Vec<Vec<f64>> = columns.iter().map(centred).collect();
    let target: Vec<f64> = all[0].iter().map(|value| value / spread).collect();
    let ones = vec![1.0; target.len()];
    let others: Vec<&[f64]> = all[1..].iter().map(Vec::as_slice).chain([&*ones]).collect();
    let mut fit = robust(&others, &target, ones.clone(), LEAST);
    fit.scale *= spread;
    fit.theta.iter_mut().for_each(|theta| *theta *= spread);
    Some(fit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// What a loop is like.
    #[derive(Clone, Copy, Debug)]
    struct Loop {
        /// Noise of PV.
        noise: f64,
        /// Standard deviation of a slow load.
        load: f64,
        /// Pole of the process, and its dead time (rows).
        process: (f64, usize),
        /// Derivative time of the controller (rows), filtered over a fifth of it.
        derivative: f64,
        /// Standard deviation of what is added to OP and recorded nowhere.
        forward: f64,
    }

    const PLAIN: Loop = Loop { noise: 0.1, load: 1.0, process: (0.8, 2), derivative: 0.0, forward: 0.0 };

    /// OP and PV of a loop, as the controller has them.
    fn signals(own: Loop, seed: u64) -> [Vec<f64>; 2] {
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed));
        let mut draw = || -> f64 { noise.next().unwrap_or(0.0) };
        let (mut x, mut load, mut integral, mut slow, mut forward) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let (mut op, mut pv): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
        for k in 0..4000usize {
            let seen: f64 = x + own.noise * draw();
            slow += (seen - slow) / (1.0 + 0.2 * own.derivative);
            let rate = if own.derivative > 0.0 { 5.0 * (seen - slow) } else { 0.0 };
            integral -= 0.08 * seen;
            forward = 0.9 * forward + 0.44 * own.forward * draw();
            op.push(45.0 - 0.8 * seen + integral - 0.5 * rate + forward);
            pv.push(seen + 560.0);
            load = 0.995 * load + 0.1 * own.load * draw();
            let (pole, dead) = own.process;
            let acts = k.checked_sub(dead).map_or(0.0, |at| op[at] - 45.0);
            x = pole * x + (1.0 - pole) * (acts + load);
        }
        [op, pv]
    }

    /// PV that is recorded late by `first` rows at the start to `last` at the end: held from scan to scan, or interpolated.
    fn recorded(pv: &[f64], [first, last]: [f64; 2], held: bool) -> Vec<f64> {
        let n = pv.len();
        let of = |k: usize| {
            let at = (k as f64 - first - (last - first) * k as f64 / n as f64).clamp(0.0, n as f64 - 1.0);
            let (before, share) = (at as usize, if held { 0.0 } else { at.fract() });
            pv[before] + share * (pv[(before + 1).min(n - 1)] - pv[before])
        };
        (0..n).map(of).collect()
    }

    fn written(values: &[f64], step: f64) -> Vec<Option<f64>> {
        values.iter().map(|v| Some((v / step).round() * step)).collect()
    }

    fn found([op, pv]: &[Vec<f64>; 2], late: [f64; 2], held: bool, steps: [f64; 2]) -> Later {
        Later::of(&written(op, steps[0]), &written(&recorded(pv, late, held), steps[1]), None)
    }

    #[test]
    fn op_that_answers_a_later_pv_is_told_whatever_its_rounding() {
        for seed in 0..3 {
            let filtered = Loop { derivative: 4.0, ..PLAIN };
            for own in [PLAIN, filtered] {
                let signals = signals(own, seed);
                // The derivative of noise hides the integrator behind coarser steps.
                for steps in [[1e-3, 1e-3], [1e-4, 1e-3], [1e-5, 1e-5]] {
                    for rows in [1.0, 3.0, 6.0, 12.0] {
                        let late = found(&signals, [rows; 2], true, steps);
                        assert_eq!(late.share, 1.0, "{own:?} {steps:?} {rows} {late:?}");
                        assert!((late.rows - rows).abs() <= 1.0, "{own:?} {steps:?} {rows} {late:?}");
                    }
                    let drifts = found(&signals, [0.0, 8.0], true, steps);
                    assert!(
                        drifts.share > 0.7 && (2.0..=7.0).contains(&drifts.rows),
                        "{own:?} {steps:?} {drifts:?}"
                    );
                }
            }
            let between = found(&signals(PLAIN, seed), [2.7; 2], false, [1e-3; 2]);
            assert!(between.share > 0.9 && (2.0..=3.0).contains(&between.rows), "{between:?}");
        }
    }

    #[test]
    fn op_of_right_stamps_answers_no_later_pv() {
        let loops = [
            PLAIN,
            Loop { derivative: 4.0, ..PLAIN },
            Loop { forward: 0.5, ..PLAIN },
            Loop { forward: 2.0, derivative: 4.0, ..PLAIN },
            // A fast process moves PV a row later, with hardly any noise, beside a load and without one.
            Loop { noise: 0.0, forward: 2.0, process: (0.3, 0), ..PLAIN },
            Loop { noise: 0.005, load: 0.1, forward: 2.0, process: (0.3, 0), ..PLAIN },
            Loop { noise: 0.005, load: 0.0, forward: 2.0, process: (0.0, 1), ..PLAIN },
            Loop { noise: 0.0, load: 0.3, forward: 1.0, process: (0.8, 5), ..PLAIN },
            // A smooth PV follows from the rows before and after.
            Loop { noise: 0.0, process: (0.97, 4), ..PLAIN },
        ];
        for (own, seed) in loops.into_iter().flat_map(|own| [(own, 1), (own, 2)]) {
            for steps in [[1e-9, 1e-9], [1e-3, 1e-3], [0.1, 0.01]] {
                let signals = signals(own, seed);
                // The controller may read PV a row before OP is written, and the clock of PV may be ahead.
                for early in [0.0, -1.0, -3.0] {
                    let told = found(&signals, [early; 2], true, steps);
                    assert!(told.share < 0.1, "{own:?} {steps:?} {early} {told:?}");
                }
            }
        }
    }

    #[test]
    fn an_op_that_rests_tells_nothing() {
        let still = vec![Some(40.0); 1000];
        let [_, pv] = signals(PLAIN, 1);
        assert_eq!(Later::of(&still, &written(&pv, 1e-3), None), Later::default());
        assert_eq!(Later::of(&[], &[], None), Later::default());
        assert_eq!(Later::of(&[None; 500], &[None; 500], Some(&[None; 500])), Later::default());
    }
}
