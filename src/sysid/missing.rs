//! The values of OP and PV that were not measured: those that a loop makes likeliest, given what was measured before and after.
//!
//! ```text
//! PV[k] = sum_i a_i PV[k-i] + sum_i b_i OP[k-i] + c + e[k]                             i = 1 .. p
//! OP[k] = sum_i a_i OP[k-i] + sum_i b_i PV[k-i] + sum_i d_i SP[k-i] + c + e[k]         b and d from i = 0 on
//! minimise  sum over k of e_pv[k]^2 / s_pv^2 + e_op[k]^2 / s_op^2   over what was not measured
//! ```
//!
//! A controller computes OP exactly, so that its law and PV on both sides say what OP was in a hole, turn and all. That OP
//! stands for a measured one in the lags of later rows; a row without a sample says nothing all the same.
//! Both laws are regressions on the rows without holes, with Student-t errors. The least sum is one banded system of equations.
//!
//! Source: Janssen, Veldhuis & Vries, IEEE Trans. ASSP 1986, 34, 317, for one signal; here for two that drive each other.

use super::least_squares::{MOST_COLUMNS, factor, substitute};
use super::stats::{mean, sd};
use super::student;

/// Lags p of both laws, the longest that the rows without holes allow.
const LAGS: [usize; 4] = [6, 4, 3, 2];
/// Rows without holes for each coefficient that allow it.
const ROWS_EACH: usize = 10;
/// Rows that a law is estimated from, at most.
const MOST_ROWS: usize = 4000;
/// Passes of reweighted least squares.
const PASSES: usize = 4;
/// Least error of a law as a share of its signal's spread: weights of a law that is exact stay numbers.
const EXACT: f64 = 1e-5;
/// Rows of a set point that never moves say nothing of it.
const SIGNALS: usize = 3;

/// A signal's place among the three.
#[derive(Clone, Copy, PartialEq)]
enum Tag {
    Op = 0,
    Pv = 1,
    Sp = 2,
}

/// One law: what it predicts, from what, and how exactly.
struct Law {
    of: Tag,
    /// Signal, lag and coefficient of each term.
    terms: Vec<(Tag, usize, f64)>,
    constant: f64,
    scale: f64,
}

/// The three signals in their own spreads; SP is none where it never moves.
struct Signals {
    values: [Vec<f64>; SIGNALS],
    there: [Vec<bool>; 2],
    scale: [(f64, f64); 2],
}

/// OP and PV with the likeliest values where they are missing.
///
/// * `op`, `pv`: what was measured.
/// * `guess`: both with some value everywhere; it stays where the rows without holes are too few for any law.
/// * `sp`: the set point, where there is one.
pub fn likeliest(
    op: &[Option<f64>],
    pv: &[Option<f64>],
    guess: [Vec<f64>; 2],
    sp: Option<&[f64]>,
) -> [Vec<f64>; 2] {
    let whole = |v: &[Option<f64>]| v.iter().all(Option::is_some);
    if whole(op) && whole(pv) {
        return guess;
    }
    let Some(mut signals) = Signals::new([op, pv], &guess, sp) else { return guess };
    let Some((lags, laws)) = LAGS.iter().find_map(|lags| Some((*lags, signals.laws(*lags)?))) else {
        return guess;
    };
    if !signals.solve(lags, &laws) {
        return guess;
    }
    let mut out = guess;
    for (tag, out) in out.iter_mut().enumerate() {
        let (middle, spread) = signals.scale[tag];
        for k in (0..out.len()).filter(|k| !signals.there[tag][*k]) {
            out[k] = middle + spread * signals.values[tag][k];
        }
    }
    out
}

impl Signals {
    fn new(measured: [&[Option<f64>]; 2], guess: &[Vec<f64>; 2], sp: Option<&[f64]>) -> Option<Self> {
        let scale = measured.map(|v| {
            let there: Vec<f64> = v.iter().copied().flatten().collect();
            (mean(&there), sd(&there))
        });
        let usable = |(middle, spread): &(f64, f64)| middle.is_finite() && spread.is_finite() && *spread > 0.0;
        if !scale.iter().all(usable) {
            return None;
        }
        let scaled = |v: &[f64], (middle, spread): (f64, f64)| v.iter().map(|v| (v - middle) / spread).collect();
        let moves = |sp: &&[f64]| sp.len() == guess[0].len() && sp.iter().any(|v| *v != sp[0]);
        let sp = sp.filter(moves).map_or_else(Vec::new, |sp| scaled(sp, (mean(sp), sd(sp))));
        Some(Self {
            values: [scaled(&guess[0], scale[0]), scaled(&guess[1], scale[1]), sp],
            there: measured.map(|v| v.iter().map(Option::is_some).collect()),
            scale,
        })
    }

    fn there(&self, tag: Tag, k: usize) -> bool {
        tag == Tag::Sp || self.there[tag as usize][k]
    }

    /// Both laws with so many lags; `None` where the rows without holes are too few.
    fn laws(&self, lags: usize) -> Option<[Law; 2]> {
        Some([self.law(Tag::Op, lags)?, self.law(Tag::Pv, lags)?])
    }

    /// One law, by reweighted least squares.
    fn law(&self, of: Tag, lags: usize) -> Option<Law> {
        let mut terms: Vec<(Tag, usize, f64)> = Vec::new();
        for tag in [Tag::Op, Tag::Pv, Tag::Sp] {
            let used = !self.values[tag as usize].is_empty() && !(of == Tag::Pv && tag == Tag::Sp);
            // OP follows from this scan's PV, PV from an earlier OP.
            let from = usize::from(!(of == Tag::Op && tag != Tag::Op));
            terms.extend((from..=lags).filter(|_| used).map(|lag| (tag, lag, 0.0)));
        }
        let n = self.values[0].len();
        let whole = |k: &usize| {
            self.there(of, *k) && terms.iter().all(|(tag, lag, _)| self.there(*tag, k - lag))
        };
        let rows: Vec<usize> = (lags..n).filter(whole).collect();
        let size = terms.len() + 1;
        if rows.len() < ROWS_EACH * size {
            return None;
        }
        let rows: Vec<usize> = rows.iter().copied().step_by(rows.len().div_ceil(MOST_ROWS)).collect();
        let row = |k: usize| -> Vec<f64> {
            let terms = terms.iter().map(|(tag, lag, _)| self.values[*tag as usize][k - lag]);
            terms.chain([1.0, self.values[of as usize][k]]).collect()
        };
        let table: Vec<Vec<f64>> = rows.iter().map(|k| row(*k)).collect();
        let (theta, scale) = fitted(&table, size);
        for (term, theta) in terms.iter_mut().zip(&theta) {
            term.2 = *theta;
        }
        Some(Law { of, terms, constant: theta[size - 1], scale: scale.max(EXACT) })
    }

    /// Puts the least sum of squares in place of what is missing, from row `lags` on; false where there is none.
    fn solve(&mut self, lags: usize, laws: &[Law; 2]) -> bool {
        let n = self.values[0].len();
        let mut places = [vec![None; n], vec![None; n]];
        let mut count = 0;
        for k in lags..n {
            for (tag, places) in places.iter_mut().enumerate() {
                if !self.there[tag][k] {
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

/// Coefficients of the last column of a table by those before it, and the scale of the errors.
fn fitted(table: &[Vec<f64>], size: usize) -> (Vec<f64>, f64) {
    let ones = vec![1.0; table.len()];
    let (mut omega, mut theta, mut scale) = (ones.clone(), Vec::new(), 0.0);
    for _ in 0..PASSES {
        let (mut g, mut right) = (vec![0.0; size * size], vec![0.0; size]);
        for (row, omega) in table.iter().zip(&omega) {
            for i in 0..size {
                let by = omega * row[i];
                right[i] += by * row[size];
                (0..=i).for_each(|j| g[i * size + j] += by * row[j]);
            }
        }
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, size, size, &mut live);
        substitute(&g, size, &live, &mut right);
        theta = right;
        let error = |row: &Vec<f64>| row[size] - theta.iter().zip(row).map(|(t, v)| t * v).sum::<f64>();
        let e: Vec<f64> = table.iter().map(error).collect();
        let (s, nu, _) = student::tails(&e, &ones, student::first_scale(&e, &ones), EXACT);
        student::reweigh(&e, &ones, (s, nu), &mut omega);
        scale = s;
    }
    (theta, scale)
}

/// A symmetric system whose unknowns meet only their neighbours.
struct Banded {
    width: usize,
    /// Row i holds columns `i + 1 - width ..= i`.
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

    /// One square: `weight (rest + sum by x)^2`.
    fn add(&mut self, unknown: &[(usize, f64)], rest: f64, weight: f64) {
        for &(i, a) in unknown {
            self.right[i] -= weight * a * rest;
            for &(j, b) in unknown.iter().filter(|(j, _)| *j <= i) {
                *self.at(i, j) += weight * a * b;
            }
        }
    }

    /// The unknowns, by Cholesky; `None` where a pivot is none.
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
            let value = x[i];
            for j in (i + 1).saturating_sub(self.width)..i {
                x[j] -= *self.at(i, j) * value;
            }
        }
        x.iter().all(|x| x.is_finite()).then_some(x)
    }
}
