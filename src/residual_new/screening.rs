//! Screening: what one or two columns more would gain in the high-order ARX, without fitting it anew.
//!
//! ```text
//! gain = -n/2 ln(1 - r' D^-1 r / (n s^2)),   r = Phi' W e,   D = Phi' W Phi - G' (X' W X)^-1 G,   G = X' W Phi
//! ```
//!
//! `X` are the columns of the fit, `W` its Student-t weights, `e` its errors and `s` their scale. Columns that begin at
//! some time share all their sums, so that every time of a change costs one triangular solve.

use super::hypothesis::Hypothesis;
use crate::sysid::arx::{Arx, ArxFit, LAGS_X};
use crate::sysid::armax::Signals;
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::least_squares::dot;

/// Share of a column's square that has to be left beside the others: below it rounding decides.
const INDEPENDENT: f64 = 1e-9;
/// Samples to each side of a change.
pub const MARGIN: usize = LONGEST_LAG;

/// The fit of one hypothesis, ready for more columns.
pub struct Screen<'a> {
    /// The data.
    pub data: &'a IdData,
    /// What is fitted.
    pub base: &'a Hypothesis,
    /// Its signals.
    pub signals: &'a Signals,
    /// Its fit.
    pub fit: &'a ArxFit,
    /// Weighted rows of its columns, row after row.
    weighted: Vec<f64>,
    order: usize,
    /// Weighted errors.
    we: Vec<f64>,
    power: f64,
    count: f64,
}

/// A column or two that begin at a sample, and what they gain.
#[derive(Clone, Copy, Debug)]
pub struct Since {
    /// The sample.
    pub at: usize,
    /// Log-likelihood gained.
    pub gain: f64,
}

impl<'a> Screen<'a> {
    /// Of a fitted hypothesis.
    pub fn new(data: &'a IdData, base: &'a Hypothesis, signals: &'a Signals, fit: &'a ArxFit) -> Self {
        let arx = Arx::new(data, &data.y, &signals.shapes);
        let columns = arx.columns(&signals.x);
        let (n, order) = (fit.e.len(), columns.len());
        let mut weighted = vec![0.0; n * order];
        for (i, column) in columns.iter().enumerate() {
            for (k, value) in column.iter().enumerate() {
                weighted[k * order + i] = value * fit.omega[k];
            }
        }
        let we: Vec<f64> = fit.e.iter().zip(&fit.omega).map(|(e, omega)| e * omega).collect();
        let power = dot(&we, &fit.e);
        let count = data.counted();
        Self { data, base, signals, fit, weighted, order, we, power, count }
    }

    fn rows(&self) -> usize {
        self.fit.e.len()
    }

    /// The errors of the fitted rows.
    pub fn errors(&self) -> &[f64] {
        &self.fit.e
    }

    /// Solves `L z = g` in place and returns z.z.
    fn forward(&self, g: &mut [f64]) -> f64 {
        let (l, order) = (&self.fit.factor, self.order);
        let mut sum = 0.0;
        for i in 0..order {
            let row = &l[i * order..=i * order + i];
            let value = if self.fit.live[i] { (g[i] - dot(&row[..i], &g[..i])) / row[i] } else { 0.0 };
            g[i] = value;
            sum += value * value;
        }
        sum
    }

    /// Log-likelihood gained where the share of power is explained.
    fn gain(&self, explained: f64) -> f64 {
        let share = (explained / self.power.max(1e-300)).clamp(0.0, 1.0 - 1e-12);
        -0.5 * self.count * (1.0 - share).ln()
    }

    /// What columns (over all samples) gain together, and their coefficients.
    pub fn several(&self, columns: &[&[f64]]) -> (f64, Vec<f64>) {
        let (n, first, m) = (self.rows(), self.data.first, columns.len());
        let mut solved = Vec::with_capacity(m);
        let (mut d, mut r) = (vec![0.0; m * m], vec![0.0; m]);
        for (i, column) in columns.iter().enumerate() {
            let column = &column[first..first + n];
            let mut g = vec![0.0; self.order];
            for (value, row) in column.iter().zip(self.weighted.chunks_exact(self.order)) {
                if *value != 0.0 {
                    g.iter_mut().zip(row).for_each(|(g, x)| *g += value * x);
                }
            }
            self.forward(&mut g);
            solved.push(g);
            r[i] = dot(column, &self.we);
            for (j, other) in columns[..=i].iter().enumerate() {
                let other = &other[first..first + n];
                let own: f64 =
                    column.iter().zip(other).zip(&self.fit.omega).map(|((a, b), omega)| a * b * omega).sum();
                d[i * m + j] = own - dot(&solved[i], &solved[j]);
                if i == j && d[i * m + i] < INDEPENDENT * own {
                    d[i * m + i] = f64::INFINITY;
                }
            }
        }
        let coefficients = solve(&mut d, m, &r);
        (self.gain(dot(&coefficients, &r)), coefficients)
    }

    /// What one column gains, and its coefficient.
    pub fn alone(&self, column: &[f64]) -> (f64, f64) {
        let (gain, coefficients) = self.several(&[column]);
        (gain, coefficients[0])
    }

    /// What columns gain that begin at a sample, for every `stride`-th sample; `before`: that end there instead.
    pub fn since(&self, columns: &[&[f64]], stride: usize, before: bool) -> Vec<Since> {
        let (n, first, m) = (self.rows(), self.data.first, columns.len());
        let mut g = vec![vec![0.0; self.order]; m];
        let (mut own, mut r) = (vec![0.0; m * m], vec![0.0; m]);
        let mut out = Vec::new();
        let mut solved = g.clone();
        for step in 0..n {
            let row = if before { step } else { n - 1 - step };
            let x = &self.weighted[row * self.order..(row + 1) * self.order];
            for i in 0..m {
                let value = columns[i][first + row];
                if value != 0.0 {
                    g[i].iter_mut().zip(x).for_each(|(g, x)| *g += value * x);
                }
                r[i] += value * self.we[row];
                for j in 0..=i {
                    own[i * m + j] += value * columns[j][first + row] * self.fit.omega[row];
                }
            }
            let at = if before { row + 1 } else { row };
            if !at.is_multiple_of(stride) || at < MARGIN || at + MARGIN > n {
                continue;
            }
            let mut d = own.clone();
            for i in 0..m {
                solved[i].copy_from_slice(&g[i]);
                self.forward(&mut solved[i]);
                for j in 0..=i {
                    d[i * m + j] -= dot(&solved[i], &solved[j]);
                }
                if d[i * m + i] < INDEPENDENT * own[i * m + i] {
                    d[i * m + i] = f64::INFINITY;
                }
            }
            let coefficients = solve(&mut d, m, &r);
            out.push(Since { at: first + at, gain: self.gain(dot(&coefficients, &r)) });
        }
        out
    }

    /// A signal of the stem as it comes out of B: what the prediction would gain if the stem were larger by it.
    pub fn through_b(&self, shape: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; shape.len()];
        for (lag, b) in (1..=LAGS_X).zip(self.fit.b()) {
            out[lag..].iter_mut().zip(shape).for_each(|(out, shape)| *out += b * shape);
        }
        out
    }
}

/// The best of several times, and its neighbours left out, `most` of them.
pub fn best_times(mut times: Vec<Since>, most: usize) -> Vec<Since> {
    times.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let mut out: Vec<Since> = Vec::new();
    for time in times {
        if out.iter().all(|other| other.at.abs_diff(time.at) > 2 * MARGIN) {
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
