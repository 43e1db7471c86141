//! The high-order ARX. It ranks hypotheses in every search, before an ARMAX is fitted to the best of them.
//!
//! ```text
//! y[k] = sum_{i=1}^{16} a_i y[k-i] + sum_{j=1}^{14} b_j x[k-j] + c + sum_m gamma_m phi_m[k] + e[k]
//! ```
//!
//! `y` is PV, `x` the stem, `phi` the shapes of effects; all are normalised.
//! Its orders are high enough for the dynamics of any loop, so that two hypotheses differ by their stems and shapes alone.
//! It is linear in its coefficients, so that least squares gives them at once.
//!
//! Source: Ljung, System Identification, 1999, sections 4.2 and 7.6 (Student-t weights).

use super::gram::{add_two, lower, products};
use super::iddata::IdData;
use super::least_squares::{MOST_COLUMNS, dot, factor, factor_rows, substitute};
use super::student;
use std::cell::OnceCell;
use std::ops::Range;

/// Number of lags of y, from 1 on.
pub const LAGS_Y: usize = 16;
/// Number of lags of x, from 1 on.
pub const LAGS_X: usize = 14;
/// Passes of reweighted least squares.
const PASSES: usize = 3;
/// Smallest mean square relative to PV's: below it rounding decides.
const LOSS_FLOOR: f64 = 1e-13;

/// The regression of one PV with given shapes, to which any stem can be added.
pub struct Arx<'a> {
    /// Rows that are fitted.
    rows: Range<usize>,
    y: &'a [f64],
    weight: &'a [f64],
    shapes: &'a [Vec<f64>],
    ones: Vec<f64>,
    /// Whether every weight is 0 or 1.
    is_unweighted: bool,
    /// Rows that do not count.
    left_out: Vec<usize>,
    /// Least scale of the errors.
    least: f64,
    /// The normal equations without x, once they are needed.
    without_stem: OnceCell<WithoutStem>,
}

/// The normal equations of the columns without x, of the rows that count.
struct WithoutStem {
    /// Cholesky factor of the Gram matrix.
    gram: Vec<f64>,
    /// Which columns do not depend on those before them.
    live: [bool; MOST_COLUMNS],
    /// Products of the columns with y.
    right: Vec<f64>,
    /// Sum of squares of y.
    power: f64,
}

/// A fit with Student-t errors.
#[derive(Clone, Debug, Default)]
pub struct ArxFit {
    /// Coefficients, in this order: of the lags of y, of 1, of the shapes, of the lags of x.
    pub theta: Vec<f64>,
    /// Prediction errors of the fitted rows (standard deviations of PV).
    pub e: Vec<f64>,
    /// Weights omega of the equivalent least squares (-).
    pub omega: Vec<f64>,
    /// Scale s of the errors (standard deviations of PV).
    pub scale: f64,
    /// Degrees of freedom nu of the errors (-).
    pub nu: f64,
    /// Log-likelihood of the fitted rows.
    pub log_likelihood: f64,
}

impl ArxFit {
    /// Coefficients of the lags of x, from lag 1 on.
    pub fn b(&self) -> &[f64] {
        &self.theta[self.theta.len() - LAGS_X..]
    }
}

impl<'a> Arx<'a> {
    /// The regression of PV `y` (normalised) with these shapes of effects; those beyond [`MOST_COLUMNS`] columns are left out.
    pub fn new(data: &'a IdData, y: &'a [f64], shapes: &'a [Vec<f64>]) -> Self {
        let rows = data.rows();
        let weight = &data.weight[rows.clone()];
        let ones = vec![1.0; rows.len()];
        let shapes = &shapes[..shapes.len().min(MOST_COLUMNS - LAGS_Y - LAGS_X - 1)];
        let is_unweighted = weight.iter().all(|w| *w == 1.0 || *w == 0.0);
        let left_out = (rows.clone()).filter(|k| data.weight[*k] == 0.0).collect();
        let (least, without_stem) = (data.least_scale, OnceCell::new());
        Self { y, weight, shapes, ones, is_unweighted, left_out, least, rows, without_stem }
    }

    fn without_stem(&self) -> &WithoutStem {
        self.without_stem.get_or_init(|| {
            let columns = self.columns_without_stem();
            let (target, size) = (&self.y[self.rows.clone()], columns.len());
            let (mut gram, mut right) = (vec![0.0; size * size], vec![0.0; size]);
            lower(&columns, &mut gram, size);
            products(&[target], &columns, |_, i, sum| right[i] = sum);
            let mut power = dot(target, target);
            for row in self.left_out.iter().map(|k| k - self.rows.start) {
                for (i, a) in columns.iter().enumerate() {
                    right[i] -= a[row] * target[row];
                    for (j, b) in columns[..=i].iter().enumerate() {
                        gram[i * size + j] -= a[row] * b[row];
                    }
                }
                power -= target[row] * target[row];
            }
            let mut live = [true; MOST_COLUMNS];
            factor(&mut gram, size, size, &mut live);
            WithoutStem { gram, live, right, power }
        })
    }

    /// The columns without x: lags of y, 1, shapes.
    fn columns_without_stem(&self) -> Vec<&[f64]> {
        let Range { start, end } = self.rows;
        let mut columns: Vec<&[f64]> = (1..=LAGS_Y).map(|lag| &self.y[start - lag..end - lag]).collect();
        columns.push(&self.ones);
        columns.extend(self.shapes.iter().map(|shape| &shape[start..end]));
        columns
    }

    /// All columns with the stem `x`, one value for each fitted row, in the order of [`ArxFit::theta`].
    pub fn columns<'b>(&'b self, x: &'b [f64]) -> Vec<&'b [f64]> {
        let Range { start, end } = self.rows;
        let mut columns = self.columns_without_stem();
        columns.extend((1..=LAGS_X).map(|lag| &x[start - lag..end - lag]));
        columns
    }

    /// The Gaussian deviance with the stem `x`, `N ln V`: -2 ln L but for a constant. V is the mean square of the residual, with
    /// all rows that count of one weight. Where weights differ it is -2 ln L of Student's t ([`Arx::fit`]).
    pub fn deviance(&self, x: &[f64]) -> f64 {
        let n = (self.rows.len() - self.left_out.len()) as f64;
        if !self.is_unweighted {
            return -2.0 * self.fit(x, None).log_likelihood;
        }
        n * ((self.without_stem().power - self.explained(x)).max(0.0) / n + LOSS_FLOOR).ln()
    }

    /// The part of the sum of squares of y that the regression with the stem `x` explains: `right' theta`.
    fn explained(&self, x: &[f64]) -> f64 {
        let without = self.without_stem();
        let fixed = without.right.len();
        let size = fixed + LAGS_X;
        let mut g = vec![0.0; size * size];
        for i in 0..fixed {
            g[i * size..i * size + i + 1].copy_from_slice(&without.gram[i * fixed..][..i + 1]);
        }
        let mut right = without.right.clone();
        right.resize(size, 0.0);
        self.multiply_stem(x, &mut g, &mut right);
        self.subtract_left_out(x, &mut g, &mut right);
        let mut live = without.live;
        factor_rows(&mut g, size, fixed..size, &mut live);
        let mut theta = right.clone();
        substitute(&g, size, &live, &mut theta);
        dot(&right, &theta)
    }

    /// Puts the products of the lags of x into the last rows of the Gram matrix `g` and of `right`.
    ///
    /// The products of one lag differ from those of the lag before by two terms: a sample enters at the start and one leaves at
    /// the end.
    fn multiply_stem(&self, x: &[f64], g: &mut [f64], right: &mut [f64]) {
        let Range { start: from, end: to } = self.rows;
        let (size, fixed) = (right.len(), right.len() - LAGS_X);
        let (y, shapes_at) = (self.y, LAGS_Y + 1);
        let lagged: Vec<&[f64]> = (1..=LAGS_X).map(|lag| &x[from - lag..to - lag]).collect();
        let mut others: Vec<&[f64]> = vec![&y[from..to], lagged[0]];
        others.extend(self.shapes.iter().map(|shape| &shape[from..to]));
        products(&lagged, &others, |i, j, sum| match j {
            0 => right[fixed + i] = sum,
            1 => g[(fixed + i) * size + fixed] = sum,
            _ => g[(fixed + i) * size + shapes_at + j - 2] = sum,
        });
        let without = self.columns_without_stem();
        products(&lagged[..1], &without[..shapes_at], |_, j, sum| g[fixed * size + j] = sum);
        for i in 1..LAGS_X {
            let (row, lag) = ((fixed + i) * size, i + 1);
            let [enters, leaves] = [from, to].map(|k| x[k - lag]);
            for l in 1..=LAGS_Y {
                let previous = if l == 1 { right[fixed + i - 1] } else { g[row - size + l - 2] };
                g[row + l - 1] = previous + enters * y[from - l] - leaves * y[to - l];
            }
            g[row + LAGS_Y] = g[row - size + LAGS_Y] + enters - leaves;
            for j in 1..=i {
                g[row + fixed + j] =
                    g[row - size + fixed + j - 1] + enters * x[from - j - 1] - leaves * x[to - j - 1];
            }
        }
    }

    /// Takes the rows that do not count out of what [`Arx::multiply_stem`] computed.
    fn subtract_left_out(&self, x: &[f64], g: &mut [f64], right: &mut [f64]) {
        let (size, fixed) = (right.len(), right.len() - LAGS_X);
        let (y, shapes_at) = (self.y, LAGS_Y + 1);
        for &k in &self.left_out {
            for i in 0..LAGS_X {
                let (row, value) = ((fixed + i) * size, x[k - i - 1]);
                right[fixed + i] -= value * y[k];
                for l in 1..=LAGS_Y {
                    g[row + l - 1] -= value * y[k - l];
                }
                g[row + LAGS_Y] -= value;
                for (j, shape) in self.shapes.iter().enumerate() {
                    g[row + shapes_at + j] -= value * shape[k];
                }
                for j in 0..=i {
                    g[row + fixed + j] -= value * x[k - j - 1];
                }
            }
        }
    }

    /// The fit with the stem `x` and Student-t errors, by iteratively reweighted least squares.
    ///
    /// * `near`: a fit of a similar model; its weights save a pass.
    pub fn fit(&self, x: &[f64], near: Option<&ArxFit>) -> ArxFit {
        let columns = self.columns(x);
        let target = &self.y[self.rows.clone()];
        let n = target.len();
        let mut omega = near.map_or_else(|| self.weight.to_vec(), |near| near.omega.clone());
        let (scale, nu) = near.map_or((0.0, 0.0), |near| (near.scale, near.nu));
        let mut found = ArxFit { scale, nu, ..ArxFit::default() };
        let mut scratch = vec![0.0; (columns.len() + 1) * n];
        for _ in 0..if near.is_some() { PASSES - 1 } else { PASSES } {
            self.weighted(&columns, target, &omega, &mut scratch, &mut found);
            let guess =
                if found.scale > 0.0 { found.scale } else { student::first_scale(&found.e, self.weight) };
            (found.scale, found.nu, found.log_likelihood) =
                student::tails(&found.e, self.weight, (guess, found.nu), self.least);
            student::reweigh(&found.e, self.weight, (found.scale, found.nu), &mut omega);
        }
        found.omega = omega;
        found
    }

    /// One weighted least squares: minimises `sum omega e^2`, and puts theta and e into `found`.
    ///
    /// * `scratch`: room for all columns and y.
    fn weighted(
        &self,
        columns: &[&[f64]],
        target: &[f64],
        omega: &[f64],
        scratch: &mut [f64],
        found: &mut ArxFit,
    ) {
        let (n, size) = (target.len(), columns.len());
        let root: Vec<f64> = omega.iter().map(|omega| omega.sqrt()).collect();
        for (to, from) in scratch.chunks_exact_mut(n).zip(columns.iter().chain([&target])) {
            multiply(to, from, &root);
        }
        let all: Vec<&[f64]> = scratch.chunks_exact(n).collect();
        let mut g = vec![0.0; size * size];
        lower(&all[..size], &mut g, size);
        let mut theta = vec![0.0; size];
        products(&[all[size]], &all[..size], |_, i, sum| theta[i] = sum);
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, size, size, &mut live);
        substitute(&g, size, &live, &mut theta);
        found.e.clear();
        found.e.extend_from_slice(target);
        for (theta, column) in theta.chunks(2).zip(columns.chunks(2)) {
            match (theta, column) {
                ([a, b], [v, w]) => add_two(&mut found.e, (-a, v), (-b, w)),
                _ => found.e.iter_mut().zip(column[0]).for_each(|(e, c)| *e -= theta[0] * c),
            }
        }
        found.theta = theta;
    }
}

/// `to[k] = a[k] b[k]`.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn multiply(to: &mut [f64], a: &[f64], b: &[f64]) {
    to.iter_mut().zip(a).zip(b).for_each(|((to, a), b)| *to = a * b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Window;
    use crate::sysid::valve::Start;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn data(noise: f64) -> IdData {
        let n = 900;
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(1));
        let op: Vec<f64> = (0..n)
            .map(|k| (0.21 * k as f64).sin() + (0.047 * k as f64).cos() + 0.1 * draw.next().unwrap_or(0.0))
            .collect();
        let mut pv = vec![0.0; n];
        for k in 2..n {
            pv[k] = 0.8 * pv[k - 1] + 0.3 * op[k - 2] + noise * draw.next().unwrap_or(0.0);
        }
        let window = Window { t0: 0.0, ts: 1.0, op, pv, ..Window::default() };
        IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough")
    }

    #[test]
    fn the_shared_gram_matrix_is_the_plain_one() {
        let data = data(0.05);
        let shape: Vec<f64> = (0..data.len()).map(|k| (0.013 * k as f64).sin()).collect();
        let shapes = [shape];
        let arx = Arx::new(&data, &data.y, &shapes);
        let columns = arx.columns(&data.u);
        let mut found = ArxFit::default();
        let mut scratch = vec![0.0; (columns.len() + 1) * arx.rows.len()];
        arx.weighted(&columns, &data.y[data.rows()], &vec![1.0; arx.rows.len()], &mut scratch, &mut found);
        let n = arx.rows.len() as f64;
        let plain = n * (dot(&found.e, &found.e) / n).ln();
        // Neighbouring lags are summed in another order.
        assert!((arx.deviance(&data.u) - plain).abs() < 1e-4, "{} {plain}", arx.deviance(&data.u));
    }

    #[test]
    fn rows_that_do_not_count_are_in_no_sum() {
        let mut data = data(0.1);
        let rows = data.rows();
        for k in rows.clone().filter(|k| k % 13 < 2) {
            (data.y[k], data.weight[k]) = (data.y[k - 1], 0.0);
        }
        let arx = Arx::new(&data, &data.y, &[]);
        let (mut scratch, mut found) = (vec![0.0; 2000 * MOST_COLUMNS], ArxFit::default());
        let columns = arx.columns(&data.u);
        scratch.truncate((columns.len() + 1) * rows.len());
        let weight = data.weight[rows.clone()].to_vec();
        arx.weighted(&columns, &data.y[rows.clone()], &weight, &mut scratch, &mut found);
        let n = weight.iter().sum::<f64>();
        let squares: f64 = found.e.iter().zip(&weight).map(|(e, w)| w * e * e).sum();
        let naive = n * (squares / n).ln();
        assert!((arx.deviance(&data.u) - naive).abs() < 1e-4, "{} {naive}", arx.deviance(&data.u));
    }

    #[test]
    fn dynamics_come_out_and_huge_errors_do_not_rule() {
        let mut data = data(0.01);
        let exact = Arx::new(&data, &data.y, &[]).fit(&data.u, None);
        // 0.8 q^-1: one lag of y; 0.3 q^-2 in units of OP and PV.
        let b = 0.3 * data.units.u / data.units.y;
        assert!((exact.b()[1] - b).abs() < 0.05 * b, "{:?}", exact.b());
        for k in (100..700).step_by(97) {
            data.y[k] += 3.0;
        }
        let spoiled = Arx::new(&data, &data.y, &[]).fit(&data.u, None);
        assert!((spoiled.b()[1] - b).abs() < 0.2 * b, "{:?}", spoiled.b());
    }
}
