//! Screening: what a column or two more would gain, by a score test at a fitted model.
//!
//! ```text
//! gain = -n/2 ln(1 - r' D^-1 r / (n s^2)),   r = Phi' W e,   D = Phi' W Phi - G' (X' W X)^-1 G,   G = X' W Phi
//! ```
//!
//! `X` is the gradient of the prediction, `Phi` the gradient by the new parameters at 0, `W` the Student-t weights, `e` the
//! errors and `s` their scale. Loads are tested in the high-order ARX, where they enter as they are and no local optimum
//! hides them; changes of the stem in the ARMAX, whose few coefficients of B say how PV answers.
//!
//! Source: Rao's score test; Basseville & Nikiforov, Detection of Abrupt Changes, 1993, section 7.2.

use super::fit::Fitted;
use super::hypothesis::{Hypothesis, OnData};
use crate::sysid::armax::{Gradient, ORDER, Signals, filtered};
use crate::sysid::arx::{Arx, LAGS_Y};
use crate::sysid::gram::lower;
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor};

/// Share of a column's power that has to be left beside the others: below it rounding decides.
const INDEPENDENT: f64 = 1e-9;
/// Samples to each side of a change.
pub const MARGIN: usize = LONGEST_LAG;

/// A score test at one fitted model.
pub struct ScoreTest {
    /// Errors of the fitted rows.
    pub errors: Vec<f64>,
    omega: Vec<f64>,
    /// Weighted gradient, column by column, over the fitted rows.
    weighted: Vec<Vec<f64>>,
    factor: Vec<f64>,
    live: Vec<bool>,
    we: Vec<f64>,
    power: f64,
    count: f64,
}

/// One fitted hypothesis, ready for more columns.
pub struct Screen<'a> {
    /// The data.
    pub data: &'a IdData,
    /// What is fitted.
    pub base: &'a Fitted,
    /// Its signals.
    pub signals: Signals,
    /// In the high-order ARX.
    pub long: ScoreTest,
    /// In the ARMAX.
    pub model: ScoreTest,
    /// Coefficients of the lags of y in the high-order ARX.
    pub of_y: Vec<f64>,
    /// Whether many alternatives are wanted: of a kind that is known to be there.
    pub thorough: bool,
}

/// A time of a change, and what it gains.
#[derive(Clone, Copy, Debug)]
pub struct Since {
    /// The sample.
    pub at: usize,
    /// Log-likelihood gained.
    pub gain: f64,
}

impl ScoreTest {
    fn new(columns: &[&[f64]], omega: Vec<f64>, errors: Vec<f64>, count: f64) -> Self {
        let order = columns.len();
        let root: Vec<f64> = omega.iter().map(|omega| omega.sqrt()).collect();
        let by = |column: &[f64], weight: &[f64]| -> Vec<f64> {
            column.iter().zip(weight).map(|(c, w)| c * w).collect()
        };
        let scaled: Vec<Vec<f64>> = columns.iter().map(|column| by(column, &root)).collect();
        let all: Vec<&[f64]> = scaled.iter().map(Vec::as_slice).collect();
        let mut gram = vec![0.0; order * order];
        lower(&all, &mut gram, order);
        let mut live = [true; MOST_COLUMNS];
        factor(&mut gram, order, order, &mut live);
        let weighted = columns.iter().map(|column| by(column, &omega)).collect();
        let we = by(&errors, &omega);
        let live = live[..order].to_vec();
        let mut test = Self { errors, omega, weighted, factor: gram, live, we, power: 0.0, count };
        test.project_out_gradient();
        test
    }

    /// Takes out of the errors what the gradient still explains: a fit that ends after some iterations leaves a little, and a
    /// column that nearly lies in the gradient would gain from it without end.
    fn project_out_gradient(&mut self) {
        let mut b: Vec<f64> = self.weighted.iter().map(|x| dot(x, &self.errors)).collect();
        self.forward(&mut b);
        let order = b.len();
        for i in (0..order).rev() {
            let below: f64 = (i + 1..order).map(|j| self.factor[j * order + i] * b[j]).sum();
            b[i] = if self.live[i] { (b[i] - below) / self.factor[i * order + i] } else { 0.0 };
        }
        for (x, b) in self.weighted.iter().zip(b) {
            self.we.iter_mut().zip(x).for_each(|(we, x)| *we -= b * x);
        }
        let each = self.we.iter().zip(&self.omega).filter(|(_, omega)| **omega > 0.0);
        self.power = each.map(|(we, omega)| we * we / omega).sum();
    }

    /// Solves `L z = g` in place.
    fn forward(&self, g: &mut [f64]) {
        let order = self.weighted.len();
        for i in 0..order {
            let row = &self.factor[i * order..=i * order + i];
            g[i] = if self.live[i] { (g[i] - dot(&row[..i], &g[..i])) / row[i] } else { 0.0 };
        }
    }

    fn gain(&self, explained: f64) -> f64 {
        let share = (explained / self.power.max(1e-300)).clamp(0.0, 1.0 - 1e-12);
        -0.5 * self.count * (1.0 - share).ln()
    }

    fn product(&self, a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).zip(&self.omega).map(|((a, b), omega)| a * b * omega).sum()
    }

    /// What columns (over the fitted rows) gain together, and their coefficients.
    pub fn several(&self, columns: &[Vec<f64>]) -> (f64, Vec<f64>) {
        let m = columns.len();
        let (mut d, mut r) = (vec![0.0; m * m], vec![0.0; m]);
        let mut solved: Vec<Vec<f64>> = Vec::with_capacity(m);
        for (i, column) in columns.iter().enumerate() {
            // A column that begins late is 0 before.
            let from = column.iter().position(|c| *c != 0.0).unwrap_or(column.len());
            let mut g: Vec<f64> = self.weighted.iter().map(|x| dot(&x[from..], &column[from..])).collect();
            self.forward(&mut g);
            solved.push(g);
            r[i] = dot(column, &self.we);
            for (j, other) in columns[..=i].iter().enumerate() {
                d[i * m + j] = self.product(column, other) - dot(&solved[i], &solved[j]);
            }
            let own = d[i * m + i] + dot(&solved[i], &solved[i]);
            if d[i * m + i] < INDEPENDENT * own {
                d[i * m + i] = f64::INFINITY;
            }
        }
        let coefficients = solve(&mut d, m, &r);
        (self.gain(dot(&coefficients, &r)), coefficients)
    }

    /// What one column gains, and its coefficient.
    pub fn alone(&self, column: Vec<f64>) -> (f64, f64) {
        let (gain, coefficients) = self.several(&[column]);
        (gain, coefficients[0])
    }

    /// What a step gains that begins at each row, all times sharing their sums: `(row, gain, size)`. `onset`: its first values;
    /// the last stays.
    pub fn steps(&self, onset: &[f64]) -> Vec<(usize, f64, f64)> {
        let (order, n) = (self.weighted.len(), self.errors.len());
        let mut g = vec![0.0; order];
        let mut solved = g.clone();
        let (mut own, mut r) = (0.0, 0.0);
        let mut out = Vec::with_capacity(n);
        let last = onset[onset.len() - 1];
        let first: Vec<f64> = onset[..onset.len() - 1].iter().map(|value| value - last).collect();
        for row in (MARGIN..n).rev() {
            g.iter_mut().zip(&self.weighted).for_each(|(g, x)| *g += last * x[row]);
            own += last * last * self.omega[row];
            r += last * self.we[row];
            if row + MARGIN <= n && row.is_multiple_of(2) {
                let rows = row..row + first.len();
                for (solved, (g, x)) in solved.iter_mut().zip(g.iter().zip(&self.weighted)) {
                    *solved = g + dot(&first, &x[rows.clone()]);
                }
                self.forward(&mut solved);
                let powers = onset.iter().zip(&self.omega[rows.clone()]);
                let own =
                    own + powers.map(|(value, omega)| (value * value - last * last) * omega).sum::<f64>();
                let r = r + dot(&first, &self.we[rows]);
                let left = own - dot(&solved, &solved);
                if left > INDEPENDENT * own {
                    out.push((row, self.gain(r * r / left), r / left));
                }
            }
        }
        out
    }
}

impl<'a> Screen<'a> {
    /// Of a fitted hypothesis.
    pub fn new(data: &'a IdData, base: &'a Fitted) -> Self {
        let input = OnData { hypothesis: &base.hypothesis, data };
        let Gradient { columns, omega, errors, signals } = Gradient::new(data, &data.y, &base.model, &input);
        let of: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let model = ScoreTest::new(&of, omega, errors, data.counted());
        let y = base.hypothesis.pv(data);
        let arx = Arx::new(data, &y, &signals.shapes);
        let fit = arx.fit(&signals.x, None);
        let long = ScoreTest::new(&arx.columns(&signals.x), fit.omega, fit.e, data.counted());
        let of_y = fit.theta[..LAGS_Y].to_vec();
        drop(arx);
        Self { data, base, signals, long, model, of_y, thorough: false }
    }

    /// The hypothesis that is screened.
    pub fn hypothesis(&self) -> &Hypothesis {
        &self.base.hypothesis
    }

    /// A part of a signal (over all samples) as a load in the high-order ARX.
    pub fn rows(&self, signal: &[f64]) -> Vec<f64> {
        signal[self.data.rows()].to_vec()
    }

    /// A load as the prediction of the ARMAX sees it, through 1/C.
    pub fn load(&self, signal: &[f64]) -> Vec<f64> {
        let rows = self.data.rows();
        filtered(|k| signal[k], self.base.model.c, self.data.start.index, rows.end)[rows].to_vec()
    }

    /// A part of the stem as the prediction of the ARMAX sees it, through B/C.
    pub fn stem(&self, signal: &[f64]) -> Vec<f64> {
        let (model, rows) = (&self.base.model, self.data.rows());
        let b = |k: usize| -> f64 { (0..ORDER).map(|j| model.b[j] * signal[k - model.nk - j]).sum() };
        // A part that begins late is 0 before.
        let from = signal.iter().position(|x| *x != 0.0).unwrap_or(signal.len());
        let begin = from.max(self.data.start.index + model.nk + ORDER);
        filtered(b, model.c, begin, rows.end)[rows].to_vec()
    }

    /// `few`, or many where the kind is known to be there.
    pub fn most(&self, few: usize) -> usize {
        if self.thorough { 20 * few } else { few }
    }

    /// Times of a change, one in `stride` samples.
    pub fn times(&self, stride: usize) -> impl Iterator<Item = usize> + use<> {
        let rows = self.data.rows();
        (rows.start + MARGIN..rows.end - MARGIN).step_by(stride)
    }
}

/// The best of several times, and its neighbours left out, `most` of them.
pub fn best_times(mut times: Vec<Since>, most: usize) -> Vec<Since> {
    times.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let mut out: Vec<Since> = Vec::new();
    let apart = if most > 8 { 5 } else { 2 * MARGIN };
    for time in times {
        if out.iter().all(|other| other.at.abs_diff(time.at) > apart) {
            out.push(time);
            if out.len() == most {
                break;
            }
        }
    }
    out
}

/// Solves a small symmetric system, lower triangle given; a pivot that is infinite or not positive drops its unknown.
fn solve(d: &mut [f64], m: usize, r: &[f64]) -> Vec<f64> {
    let mut out = r.to_vec();
    let mut live = vec![true; m];
    for i in 0..m {
        for j in 0..=i {
            let mut sum = d[i * m + j];
            (0..j).filter(|k| live[*k]).for_each(|k| sum -= d[i * m + k] * d[j * m + k]);
            if i == j {
                live[i] = sum > 1e-12 * d[i * m + i].abs() && sum.is_finite();
                d[i * m + i] = if live[i] { sum.sqrt() } else { 1.0 };
            } else {
                d[i * m + j] = if live[j] { sum / d[j * m + j] } else { 0.0 };
            }
        }
    }
    for i in 0..m {
        let sum: f64 = (0..i).filter(|k| live[*k]).map(|k| d[i * m + k] * out[k]).sum();
        out[i] = if live[i] { (out[i] - sum) / d[i * m + i] } else { 0.0 };
    }
    for i in (0..m).rev() {
        if !live[i] {
            continue;
        }
        let sum: f64 = (i + 1..m).filter(|k| live[*k]).map(|k| d[k * m + i] * out[k]).sum();
        out[i] = (out[i] - sum) / d[i * m + i];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn a_column_that_nearly_lies_in_the_others_gains_no_more_than_its_own_part_explains() {
        let n = 400;
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(5));
        let mut noise = || -> Vec<f64> { draw.by_ref().take(n).collect() };
        let wave = |phase: f64| -> Vec<f64> { (0..n).map(|k| (0.05 * k as f64 + phase).sin()).collect() };
        let (a, b) = (wave(0.0), wave(1.0));
        let (errors, other) = (noise(), noise());
        let nearly =
            |by: f64| -> Vec<f64> { a.iter().zip(&other).map(|(a, other)| a + by * other).collect() };
        // A fit that ended early: its errors still hold a tenth of a column.
        let unsettled: Vec<f64> = errors.iter().zip(&a).map(|(e, a)| e + 0.1 * a).collect();
        let test = |errors: &[f64]| ScoreTest::new(&[&a, &b], vec![1.0; n], errors.to_vec(), n as f64);
        let gains: Vec<f64> = [1.0, 1e-2, 1e-4].map(|by| test(&unsettled).alone(nearly(by)).0).to_vec();
        let own = test(&errors).alone(other.clone()).0;
        assert!(gains.iter().all(|gain| (gain - own).abs() < 1e-3 * (1.0 + own)), "{gains:?} for {own}");
    }
}
