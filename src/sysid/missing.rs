//! OP and PV where they were not measured: the likeliest values, given what was measured before and after.
//!
//! ```text
//! PV[k] = sum_i a_i PV[k-i] + sum_i b_i OP[k-i] + c + e_pv[k]                          i = 1 .. p          (process)
//! OP[k] = sum_i a_i OP[k-i] + sum_i b_i PV[k-i] + sum_i d_i SP[k-i] + c + e_op[k]      b, d: i = 0 .. p    (controller)
//! minimise  sum over k of e_pv[k]^2 / s_pv^2 + e_op[k]^2 / s_op^2   over the values that were not measured
//! ```
//!
//! 1. Each equation, called a *law* here, is a regression on the rows where all its values were measured, with Student-t errors.
//!    Schwarz's criterion chooses p.
//! 2. The sum of squares is quadratic in the missing values. Its minimum is the solution of one banded system.
//!
//! A controller computes OP exactly, so PV on both sides of a hole determines OP inside it, with its turns.
//! Later rows use these values as lags. The rows of the hole still do not count as evidence.
//!
//! Source: Janssen, Veldhuis & Vries, IEEE Trans. ASSP 1986, 34, 317, for one signal; here for two that drive each other.

use super::criterion::{REGULAR, penalty};
use super::least_squares::{MOST_COLUMNS, factor, substitute};
use super::stats::{mean, sd};
use super::student;

/// Numbers of lags p of a law that are tried.
const LAGS: [usize; 6] = [1, 2, 3, 4, 6, 8];
/// Fewest rows without missing values for each coefficient of a law.
const ROWS_EACH: usize = 10;
/// Relative increase of the diagonal of the Gram matrix: below this share of a signal's power its difference from a combination of
/// the others is rounding. What a controller computes exactly is such a combination, and OP is recorded to so many digits.
const ROUNDING: f64 = 1e-10;
/// Most rows that a law is estimated from.
const MOST_ROWS: usize = 4000;
/// Passes of reweighted least squares.
const PASSES: usize = 4;
/// Number of signals: OP, PV and SP.
const SIGNALS: usize = 3;

/// A signal, as an index among the three.
#[derive(Clone, Copy, PartialEq)]
enum Tag {
    Op = 0,
    Pv = 1,
    Sp = 2,
}

/// An estimated law: a linear equation that predicts one signal.
struct Law {
    /// The signal that it predicts.
    of: Tag,
    /// Signal, lag and coefficient of each term.
    terms: Vec<(Tag, usize, f64)>,
    constant: f64,
    /// Scale of its errors.
    scale: f64,
}

/// The three signals, normalised; SP is empty where it never moves.
struct Signals {
    values: [Vec<f64>; SIGNALS],
    /// Whether OP, and PV, were measured, for each row.
    is_measured: [Vec<bool>; 2],
    /// Mean and standard deviation of OP and of PV.
    scale: [(f64, f64); 2],
}

/// OP and PV, with the likeliest value wherever one is missing.
///
/// * `op`, `pv`: what was measured, one value for each row (OP unit, PV unit).
/// * `guess`: OP and PV with some value everywhere. It is returned where too few rows are complete to estimate a law.
/// * `sp`: the set point (PV unit), where there is one.
pub fn likeliest(
    op: &[Option<f64>],
    pv: &[Option<f64>],
    guess: [Vec<f64>; 2],
    sp: Option<&[f64]>,
) -> [Vec<f64>; 2] {
    let complete = |v: &[Option<f64>]| v.iter().all(Option::is_some);
    if complete(op) && complete(pv) {
        return guess;
    }
    let Some(mut signals) = Signals::new([op, pv], &guess, sp) else { return guess };
    let laws = [Tag::Op, Tag::Pv].map(|of| signals.law(of));
    let [Some(of_op), Some(of_pv)] = laws else { return guess };
    if !signals.solve(&[of_op, of_pv]) {
        return guess;
    }
    let mut out = guess;
    let rows: Vec<usize> = (0..op.len()).collect();
    let complete = |k: &usize| op[*k].is_some() && pv[*k].is_some();
    for hole in rows.chunk_by(|a, b| complete(a) == complete(b)).filter(|run| !complete(&run[0])) {
        signals.take(hole, &mut out);
    }
    out
}

impl Signals {
    fn new(measured: [&[Option<f64>]; 2], guess: &[Vec<f64>; 2], sp: Option<&[f64]>) -> Option<Self> {
        let scale = measured.map(|v| {
            let known: Vec<f64> = v.iter().copied().flatten().collect();
            (mean(&known), sd(&known))
        });
        let usable =
            |(middle, spread): &(f64, f64)| middle.is_finite() && spread.is_finite() && *spread > 0.0;
        if !scale.iter().all(usable) {
            return None;
        }
        let scaled =
            |v: &[f64], (middle, spread): (f64, f64)| v.iter().map(|v| (v - middle) / spread).collect();
        let moves = |sp: &&[f64]| sp.len() == guess[0].len() && sp.iter().any(|v| *v != sp[0]);
        let sp = sp.filter(moves).map_or_else(Vec::new, |sp| scaled(sp, (mean(sp), sd(sp))));
        Some(Self {
            values: [scaled(&guess[0], scale[0]), scaled(&guess[1], scale[1]), sp],
            is_measured: measured.map(|v| v.iter().map(Option::is_some).collect()),
            scale,
        })
    }

    /// Whether a signal was measured at row `k`; the set point always is.
    fn is_measured(&self, tag: Tag, k: usize) -> bool {
        tag == Tag::Sp || self.is_measured[tag as usize][k]
    }

    /// Estimates the law of one signal, with the number of lags that Schwarz's criterion chooses.
    ///
    /// `None` where too few rows are complete, even for the fewest lags.
    fn law(&self, of: Tag) -> Option<Law> {
        let rows_of = |terms: &[(Tag, usize)]| -> Vec<usize> {
            let complete = |k: &usize| {
                self.is_measured(of, *k) && terms.iter().all(|(tag, lag)| self.is_measured(*tag, k - lag))
            };
            (self.longest(terms)..self.values[0].len()).filter(complete).collect()
        };
        let each = LAGS.map(|lags| self.terms(of, lags));
        let enough = |terms: &Vec<(Tag, usize)>| rows_of(terms).len() >= ROWS_EACH * (terms.len() + 1);
        let most = each.iter().rposition(enough)?;
        let rows = rows_of(&each[most]);
        let rows: Vec<usize> = rows.iter().copied().step_by(rows.len().div_ceil(MOST_ROWS)).collect();
        let fits = each[..=most].iter().map(|terms| {
            let row = |k: &usize| -> Vec<f64> {
                let terms = terms.iter().map(|(tag, lag)| self.values[*tag as usize][k - lag]);
                terms.chain([1.0, self.values[of as usize][*k]]).collect()
            };
            let size = terms.len() + 1;
            let (theta, scale, log_likelihood) = fitted(&rows.iter().map(row).collect::<Vec<_>>(), size);
            // Schwarz's criterion.
            let score = log_likelihood - penalty(REGULAR * size as f64, rows.len() as f64);
            let terms = terms.iter().zip(&theta).map(|((tag, lag), theta)| (*tag, *lag, *theta)).collect();
            (score, Law { of, terms, constant: theta[size - 1], scale })
        });
        fits.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, law)| law)
    }

    /// The terms, signal and lag, of a law with so many lags.
    fn terms(&self, of: Tag, lags: usize) -> Vec<(Tag, usize)> {
        let mut terms = Vec::new();
        for tag in [Tag::Op, Tag::Pv, Tag::Sp] {
            let used = !(self.values[tag as usize].is_empty() || of == Tag::Pv && tag == Tag::Sp);
            // The controller computes OP from PV of the same scan. PV follows an earlier OP.
            let from = usize::from(of == Tag::Pv || tag == Tag::Op);
            terms.extend((from..=lags).filter(|_| used).map(|lag| (tag, lag)));
        }
        terms
    }

    fn longest(&self, terms: &[(Tag, usize)]) -> usize {
        terms.iter().map(|(_, lag)| *lag).max().unwrap_or(0)
    }

    /// Replaces the missing values after the longest lag by those with the least sum of squares; false where the system is
    /// singular.
    fn solve(&mut self, laws: &[Law; 2]) -> bool {
        let n = self.values[0].len();
        let lags = laws.iter().flat_map(|law| &law.terms).map(|(_, lag, _)| *lag).max().unwrap_or(0);
        let mut places = [vec![None; n], vec![None; n]];
        let mut count = 0;
        for k in lags..n {
            for (tag, places) in places.iter_mut().enumerate() {
                if !self.is_measured[tag][k] {
                    places[k] = Some(count);
                    count += 1;
                }
            }
        }
        let mut system = Banded::new(count, 2 * (lags + 1));
        let mut unknown: Vec<(usize, f64)> = Vec::new();
        for k in lags..n {
            for law in laws {
                unknown.clear();
                let mut rest = law.constant;
                let own = [(law.of, 0, -1.0)];
                for (tag, lag, by) in own.iter().chain(&law.terms) {
                    match places.get(*tag as usize).and_then(|places| places[k - lag]) {
                        Some(at) => unknown.push((at, *by)),
                        None => rest += by * self.values[*tag as usize][k - lag],
                    }
                }
                system.add(&unknown, rest, 1.0 / (law.scale * law.scale));
            }
        }
        let Some(found) = system.solved() else { return false };
        for (places, values) in places.iter().zip(&mut self.values) {
            for (value, at) in values.iter_mut().zip(places) {
                *value = at.map_or(*value, |at| found[at]);
            }
        }
        true
    }
}

impl Signals {
    /// Least and largest measured value of a signal.
    fn range(&self, tag: usize) -> (f64, f64) {
        let known = self.values[tag].iter().zip(&self.is_measured[tag]).filter(|(_, measured)| **measured);
        known.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (v, _)| (low.min(*v), high.max(*v)))
    }

    /// Puts the values of one hole into `out`, in the plant's units and limited to the measured range.
    ///
    /// The hole keeps its guess where a value lies beyond the measured range by more than the width of that range: the laws do not
    /// hold there.
    fn take(&self, hole: &[usize], out: &mut [Vec<f64>; 2]) {
        let ranges = [0, 1].map(|tag| self.range(tag));
        let plausible = ranges.iter().enumerate().all(|(tag, (low, high))| {
            let reach = high - low;
            hole.iter().all(|k| (low - reach..=high + reach).contains(&self.values[tag][*k]))
        });
        for (tag, (low, high)) in ranges.into_iter().enumerate().filter(|_| plausible) {
            let (middle, spread) = self.scale[tag];
            for &k in hole.iter().filter(|k| !self.is_measured[tag][**k]) {
                // A value beyond all measured ones is an artefact of the laws.
                out[tag][k] = middle + spread * self.values[tag][k].clamp(low, high);
            }
        }
    }
}

/// Regresses the last column of a table on the `size` columns before it, with Student-t errors: theta, scale, log-likelihood.
fn fitted(table: &[Vec<f64>], size: usize) -> (Vec<f64>, f64, f64) {
    let ones = vec![1.0; table.len()];
    let (mut omega, mut theta, mut scale, mut log_likelihood) = (ones.clone(), Vec::new(), 0.0, 0.0);
    for _ in 0..PASSES {
        let (mut g, mut right) = (vec![0.0; size * size], vec![0.0; size]);
        for (row, omega) in table.iter().zip(&omega) {
            for i in 0..size {
                let by = omega * row[i];
                right[i] += by * row[size];
                (0..=i).for_each(|j| g[i * size + j] += by * row[j]);
            }
        }
        (0..size).for_each(|i| g[i * size + i] *= 1.0 + ROUNDING);
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, size, size, &mut live);
        substitute(&g, size, &live, &mut right);
        theta = right;
        let error = |row: &Vec<f64>| row[size] - theta.iter().zip(row).map(|(t, v)| t * v).sum::<f64>();
        let e: Vec<f64> = table.iter().map(error).collect();
        let (s, nu, log) = student::tails(&e, &ones, (student::first_scale(&e, &ones), 0.0), 0.0);
        student::reweigh(&e, &ones, (s, nu), &mut omega);
        (scale, log_likelihood) = (s, log);
    }
    (theta, scale, log_likelihood)
}

/// A symmetric positive definite system with a band matrix.
struct Banded {
    /// Width of the band, with the diagonal, to one side.
    width: usize,
    /// The lower triangle: row i holds columns `i + 1 - width ..= i`.
    rows: Vec<f64>,
    right: Vec<f64>,
}

impl Banded {
    fn new(count: usize, width: usize) -> Self {
        Self { width, rows: vec![0.0; count * width], right: vec![0.0; count] }
    }

    fn at(&mut self, i: usize, j: usize) -> &mut f64 {
        &mut self.rows[i * self.width + j + self.width - 1 - i]
    }

    /// Adds one square, `weight (rest + sum of a_i x_i)^2`, of the unknowns `(i, a_i)`.
    fn add(&mut self, unknown: &[(usize, f64)], rest: f64, weight: f64) {
        for &(i, a) in unknown {
            self.right[i] -= weight * a * rest;
            for &(j, b) in unknown.iter().filter(|(j, _)| *j <= i) {
                *self.at(i, j) += weight * a * b;
            }
        }
    }

    /// The solution, by Cholesky; `None` where a pivot is not positive.
    fn solved(mut self) -> Option<Vec<f64>> {
        let n = self.right.len();
        let mut x = std::mem::take(&mut self.right);
        for i in 0..n {
            let first = (i + 1).saturating_sub(self.width);
            for j in first..=i {
                let from = first.max((j + 1).saturating_sub(self.width));
                let product: f64 = (from..j).map(|k| *self.at(i, k) * *self.at(j, k)).sum();
                let rest = *self.at(i, j) - product;
                *self.at(i, j) = if i == j { rest.sqrt() } else { rest / *self.at(j, j) };
            }
            let pivot = *self.at(i, i);
            if !(pivot.is_finite() && pivot > 0.0) {
                return None;
            }
            let known: f64 = (first..i).map(|j| *self.at(i, j) * x[j]).sum();
            x[i] = (x[i] - known) / pivot;
        }
        for i in (0..n).rev() {
            x[i] /= *self.at(i, i);
            let (value, first) = (x[i], (i + 1).saturating_sub(self.width));
            for (j, x) in x[first..i].iter_mut().enumerate() {
                *x -= *self.at(i, first + j) * value;
            }
        }
        x.iter().all(|x| x.is_finite()).then_some(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    /// A PI loop behind a valve that sticks, with noise on PV: OP, PV and SP.
    fn limit_cycle(n: usize) -> [Vec<f64>; 3] {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let (mut y, mut stem, mut op, mut last) = (0.0, 0.0, 0.0, 0.0);
        let mut out = [const { Vec::new() }; 3];
        for k in 0..n {
            let sp = if k % 406 < 203 { 0.0 } else { 0.5 };
            let noise: f64 = StandardNormal.sample(&mut rng);
            let error = sp - (y + 0.02 * noise);
            op += 0.8 * (error - last) + 0.08 * error;
            last = error;
            if f64::abs(op - stem) > 1.0 {
                stem = op;
            }
            [op, sp - error, sp].iter().zip(&mut out).for_each(|(v, out)| out.push(*v));
            y += 0.15 * (stem - y);
        }
        out
    }

    fn with_holes(v: &[f64], lost: impl Fn(usize) -> bool) -> Vec<Option<f64>> {
        v.iter().enumerate().map(|(k, v)| (!lost(k)).then_some(*v)).collect()
    }

    fn held(v: &[Option<f64>]) -> Vec<f64> {
        let mut last = 0.0;
        let next = |v: &Option<f64>| {
            last = v.unwrap_or(last);
            last
        };
        v.iter().map(next).collect()
    }

    #[test]
    fn a_turn_of_op_in_a_hole_is_found_again() {
        let [op, pv, sp] = limit_cycle(1500);
        let mut rng = Pcg64Mcg::seed_from_u64(6);
        let chance: Vec<bool> = (0..1500).map(|_| rng.random::<f64>() < 0.1).collect();
        let patterns: [&dyn Fn(usize) -> bool; 3] = [&|k| chance[k], &|k| k % 60 < 6, &|k| k % 10 < 3];
        for lost in patterns {
            let lost = |k: usize| lost(k) && k > 30;
            let (some_op, some_pv) = (with_holes(&op, lost), with_holes(&pv, lost));
            let guess = [held(&some_op), held(&some_pv)];
            let found = likeliest(&some_op, &some_pv, guess.clone(), Some(&sp));
            let off = |v: &[f64], of: &[f64]| -> f64 {
                v.iter().zip(of).map(|(v, of)| (v - of).powi(2)).sum::<f64>().sqrt()
            };
            // Held values are off by several steps; what is left is PV's noise, which nothing tells.
            for (tag, of) in [(0, &op), (1, &pv)] {
                let (before, after) = (off(&guess[tag], of), off(&found[tag], of));
                assert!(after < 0.4 * before, "{tag}: {after} {before}");
            }
            let measured = (0..1500).filter(|k| !lost(*k));
            measured.for_each(|k| assert_eq!((found[0][k], found[1][k]), (op[k], pv[k])));
        }
    }

    #[test]
    fn where_no_law_can_be_told_the_guess_stays() {
        let [op, pv, _] = limit_cycle(200);
        // Never two rows on end.
        let some = with_holes(&op, |k| k % 2 > 0);
        let guess = [held(&some), pv.clone()];
        let pv: Vec<Option<f64>> = pv.into_iter().map(Some).collect();
        assert_eq!(likeliest(&some, &pv, guess.clone(), None), guess);
        let still = vec![Some(1.0); 200];
        assert_eq!(likeliest(&some, &still, guess.clone(), None), guess);
        assert_eq!(likeliest(&[], &[], [vec![], vec![]], None), [vec![], vec![]] as [Vec<f64>; 2]);
    }

    #[test]
    fn a_banded_system_is_solved() {
        // (x0 - 1)^2 + (x1 - x0 - 2)^2 + 4 (x2 + x1 - 5)^2 is 0 at 1, 3, 2.
        let mut system = Banded::new(3, 2);
        system.add(&[(0, 1.0)], -1.0, 1.0);
        system.add(&[(1, 1.0), (0, -1.0)], -2.0, 1.0);
        system.add(&[(2, 1.0), (1, 1.0)], -5.0, 4.0);
        let x = system.solved().expect("three squares, three unknowns");
        assert!(x.iter().zip([1.0, 3.0, 2.0]).all(|(x, known)| (x - known).abs() < 1e-12), "{x:?}");
        assert!(Banded::new(1, 1).solved().is_none());
    }
}
