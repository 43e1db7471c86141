//! Screening: the log-likelihood that new regressors would gain, by a score test at a fitted model.
//!
//! ```text
//! gain  = -n/2 ln(1 - r' D^-1 r / (e' W e))
//! r     = Phi' W e,   D = Phi' W Phi - G' (X' W X)^-1 G,   G = X' W Phi
//! gamma = D^-1 r                                                     coefficients of the new regressors
//! ```
//!
//! | symbol | what it is | unit |
//! |---|---|---|
//! | `X` | gradient of the one-step prediction by the fitted parameters, a column each | - |
//! | `Phi` | gradient by the new parameters at 0: the new regressors | - |
//! | `W` | Student-t weights, a diagonal matrix | - |
//! | `e` | one-step errors, without what `X` still explains of them | standard deviations of PV |
//! | `n` | samples that count | - |
//!
//! A score test fits nothing: one factorisation of `X' W X` serves every candidate, so that hundreds of change times can be
//! rated. Loads are tested in the high-order ARX: they enter its equation as they are, and it has no local optimum. Changes of
//! the stem are tested in the ARMAX: the few coefficients of its B say how PV answers.
//!
//! Source: Rao's score test; Basseville & Nikiforov, Detection of Abrupt Changes, 1993, section 7.2.

use super::fit::Fitted;
use super::hypothesis::{Hypothesis, OnData};
use crate::sysid::armax::{Armax, Gradient, ORDER, Signals, filtered, filtered_all};
use crate::sysid::arx::{Arx, ArxFit};
use crate::sysid::gram::lower;
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, dot_long, factor};
use std::array::from_fn;
use std::ops::Range;

/// Least share of a column's power that the other columns leave: below it rounding decides, and the column is left out.
const INDEPENDENT: f64 = 1e-9;
/// Fewest samples on each side of a change: the lags of the high-order ARX must see both sides.
pub const MARGIN: usize = LONGEST_LAG;

/// A score test at one fitted model.
pub struct ScoreTest {
    /// Errors `e` of the fitted rows.
    pub errors: Vec<f64>,
    /// Diagonal of `W`.
    omega: Vec<f64>,
    /// `W X`, column by column, over the fitted rows.
    weighted_gradient: Vec<Vec<f64>>,
    /// Cholesky factor `L` of `X' W X`, row by row.
    factor: Vec<f64>,
    /// Which columns of `X` are linearly independent of those before them.
    independent: Vec<bool>,
    /// `W e`, without what `X` still explains of `e`.
    weighted_errors: Vec<f64>,
    /// `e' W e`.
    power: f64,
    /// Samples that count, `n`.
    count: f64,
}

/// One fitted hypothesis, and the score tests by which further effects are screened beside it.
pub struct Screen<'a> {
    /// The record.
    pub data: &'a IdData,
    /// The hypothesis, fitted.
    pub base: &'a Fitted,
    /// Its stem, shapes of loads and offset.
    pub signals: Signals,
    /// Score test in the high-order ARX.
    pub arx: ScoreTest,
    /// Score test in the ARMAX.
    pub armax: ScoreTest,
    /// The high-order ARX, fitted.
    pub arx_fit: ArxFit,
    /// Response of the ARMAX to a load that steps: the unit step through 1/C.
    load_response: Vec<f64>,
    /// Response of the ARMAX to a stem that steps: the unit step through B/C.
    stem_response: Vec<f64>,
    /// Whether many alternatives are wanted, as of a kind that is known to be there.
    pub thorough: bool,
}

/// The time of a change, with its gain.
#[derive(Clone, Copy, Debug)]
pub struct ChangeTime {
    /// The sample.
    pub at: usize,
    /// Log-likelihood gained (-).
    pub gain: f64,
}

impl ScoreTest {
    /// The test at a model with this gradient `X` (`columns`), weights, errors and number of samples that count.
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
        let mut test = Self {
            weighted_gradient: columns.iter().map(|column| by(column, &omega)).collect(),
            weighted_errors: by(&errors, &omega),
            errors,
            omega,
            factor: gram,
            independent: live[..order].to_vec(),
            power: 0.0,
            count,
        };
        test.project_out_gradient();
        test
    }

    /// Subtracts from the errors what the gradient still explains. A fit that ends after some iterations leaves a little, and a
    /// regressor that nearly lies in the span of the gradient would gain from it without end.
    fn project_out_gradient(&mut self) {
        let mut b: Vec<f64> = self.weighted_gradient.iter().map(|x| dot_long(x, &self.errors)).collect();
        self.forward_substitute(&mut b);
        let order = b.len();
        for i in (0..order).rev() {
            let below: f64 = (i + 1..order).map(|j| self.factor[j * order + i] * b[j]).sum();
            b[i] = if self.independent[i] { (b[i] - below) / self.factor[i * order + i] } else { 0.0 };
        }
        for (x, b) in self.weighted_gradient.iter().zip(b) {
            self.weighted_errors.iter_mut().zip(x).for_each(|(we, x)| *we -= b * x);
        }
        let each = self.weighted_errors.iter().zip(&self.omega).filter(|(_, omega)| **omega > 0.0);
        self.power = each.map(|(we, omega)| we * we / omega).sum();
    }

    /// Solves `L z = g` in place.
    fn forward_substitute(&self, g: &mut [f64]) {
        let order = self.weighted_gradient.len();
        for i in 0..order {
            let row = &self.factor[i * order..=i * order + i];
            g[i] = if self.independent[i] { (g[i] - dot(&row[..i], &g[..i])) / row[i] } else { 0.0 };
        }
    }

    /// Log-likelihood gained where `explained = r' D^-1 r` of `e' W e` is explained.
    fn gain(&self, explained: f64) -> f64 {
        let share = (explained / self.power.max(1e-300)).clamp(0.0, 1.0 - 1e-12);
        -0.5 * self.count * (1.0 - share).ln()
    }

    /// The gain of several regressors together, and their coefficients `gamma`.
    ///
    /// * `columns`: the regressors over the fitted rows.
    pub fn joint_gain(&self, columns: &[Vec<f64>]) -> (f64, Vec<f64>) {
        let m = columns.len();
        // A column that begins late is 0 before.
        let begins: Vec<usize> = columns.iter().map(|column| begin_of(column)).collect();
        let (mut d, mut r) = (weighted_products(columns, &begins, &self.omega), vec![0.0; m]);
        let mut solved: Vec<Vec<f64>> = Vec::with_capacity(m);
        for (i, (column, from)) in columns.iter().zip(begins).enumerate() {
            let mut g: Vec<f64> =
                self.weighted_gradient.iter().map(|x| dot_long(&x[from..], &column[from..])).collect();
            self.forward_substitute(&mut g);
            solved.push(g);
            r[i] = dot_long(column, &self.weighted_errors);
            for j in 0..=i {
                d[i * m + j] -= dot(&solved[i], &solved[j]);
            }
            let own = d[i * m + i] + dot(&solved[i], &solved[i]);
            if d[i * m + i] < INDEPENDENT * own {
                d[i * m + i] = f64::INFINITY;
            }
        }
        let coefficients = solve(&mut d, m, &r);
        (self.gain(dot(&coefficients, &r)), coefficients)
    }

    /// The gain of one regressor (over the fitted rows), and its coefficient.
    pub fn single_gain(&self, column: Vec<f64>) -> (f64, f64) {
        let (gain, coefficients) = self.joint_gain(&[column]);
        (gain, coefficients[0])
    }

    /// The gain of a step at each second row: `(row, gain, size)`. All times share their running sums.
    ///
    /// * `onset`: the step's first values; it keeps the last of them.
    pub fn step_gains(&self, onset: &[f64]) -> Vec<(usize, f64, f64)> {
        let (order, n) = (self.weighted_gradient.len(), self.errors.len());
        let mut g = vec![0.0; order];
        let mut solved = g.clone();
        let (mut own, mut r) = (0.0, 0.0);
        let mut out = Vec::with_capacity(n);
        let last = onset[onset.len() - 1];
        let first: Vec<f64> = onset[..onset.len() - 1].iter().map(|value| value - last).collect();
        for row in (MARGIN..n).rev() {
            g.iter_mut().zip(&self.weighted_gradient).for_each(|(g, x)| *g += last * x[row]);
            own += last * last * self.omega[row];
            r += last * self.weighted_errors[row];
            if row + MARGIN <= n && row.is_multiple_of(2) {
                let rows = row..row + first.len();
                for (solved, (g, x)) in solved.iter_mut().zip(g.iter().zip(&self.weighted_gradient)) {
                    *solved = g + dot(&first, &x[rows.clone()]);
                }
                self.forward_substitute(&mut solved);
                let powers = onset.iter().zip(&self.omega[rows.clone()]);
                let own =
                    own + powers.map(|(value, omega)| (value * value - last * last) * omega).sum::<f64>();
                let r = r + dot(&first, &self.weighted_errors[rows]);
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
    /// The tests at a fitted hypothesis.
    pub fn new(data: &'a IdData, base: &'a Fitted) -> Self {
        let input = OnData::new(&base.hypothesis, data);
        let Gradient { columns, omega, errors, signals } = Gradient::new(data, &data.y, &base.model, &input);
        let of: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let armax = ScoreTest::new(&of, omega, errors, data.counted());
        let y = base.hypothesis.pv(data);
        let regression = Arx::new(data, &y, &signals.shapes);
        let arx_fit = regression.fit(&signals.x, None);
        let (omega, errors) = (arx_fit.omega.clone(), arx_fit.e.clone());
        let arx = ScoreTest::new(&regression.columns(&signals.x), omega, errors, data.counted());
        drop(regression);
        let Armax { nk, b, c, .. } = base.model;
        let load_response = filtered(|_| 1.0, c, 0, data.split);
        let through_b =
            |k: usize| -> f64 { (0..ORDER).map(|j| b[j] * if k >= nk + j { 1.0 } else { 0.0 }).sum() };
        let stem_response = filtered(through_b, c, 0, data.split);
        Self { data, base, signals, arx, armax, arx_fit, load_response, stem_response, thorough: false }
    }

    /// The hypothesis that is screened.
    pub fn hypothesis(&self) -> &Hypothesis {
        &self.base.hypothesis
    }

    /// The regressor of a load in the high-order ARX: the signal (over all samples) at the fitted rows.
    pub fn arx_regressor(&self, signal: &[f64]) -> Vec<f64> {
        signal[self.data.rows()].to_vec()
    }

    /// The regressor in the ARMAX of a load that steps at the fitted row `at`.
    pub fn load_step_regressor(&self, at: usize) -> Vec<f64> {
        self.response_from(&self.load_response, at)
    }

    /// The regressor in the ARMAX of a stem that steps at the fitted row `at`.
    pub fn stem_step_regressor(&self, at: usize) -> Vec<f64> {
        self.response_from(&self.stem_response, at)
    }

    /// A response that begins at sample `at`, at the fitted rows.
    fn response_from(&self, response: &[f64], at: usize) -> Vec<f64> {
        let Range { start, end } = self.data.rows();
        let mut column = vec![0.0; at.clamp(start, end) - start];
        column.extend(&response[start.saturating_sub(at)..end.saturating_sub(at)]);
        column
    }

    /// The regressor of a part of the stem in the ARMAX: the signal through B/C.
    pub fn stem_regressor(&self, signal: &[f64]) -> Vec<f64> {
        let rows = self.data.rows();
        let v = self.through_b(signal);
        filtered(|k| v[k], self.base.model.c, self.data.start.index, rows.end)[rows].to_vec()
    }

    /// A part of the stem through B, up to the last fitted row.
    fn through_b(&self, signal: &[f64]) -> Vec<f64> {
        let (model, end) = (&self.base.model, self.data.split);
        let mut out = vec![0.0; end];
        let begin = begin_of(signal).max(self.data.start.index + model.nk + ORDER);
        for (k, out) in out.iter_mut().enumerate().skip(begin) {
            *out = (0..ORDER).map(|j| model.b[j] * signal[k - model.nk - j]).sum();
        }
        out
    }

    /// The gain of a change at each of these times. Eight regressors are filtered side by side.
    ///
    /// * `part`: what a change at a time adds to the stem.
    /// * `gain`: the gain of a change at a time whose part of the stem has this regressor in the ARMAX.
    pub fn rated_times(
        &self,
        times: impl Iterator<Item = usize>,
        part: impl Fn(usize) -> Vec<f64>,
        gain: impl Fn(usize, Vec<f64>) -> f64,
    ) -> Vec<ChangeTime> {
        let (rows, times) = (self.data.rows(), times.collect::<Vec<usize>>());
        let mut out = Vec::with_capacity(times.len());
        for few in times.chunks(8) {
            let parts: Vec<Vec<f64>> = few.iter().map(|at| self.through_b(&part(*at))).collect();
            let parts: Vec<&[f64]> = parts.iter().map(Vec::as_slice).collect();
            let all = filtered_all(&parts, self.base.model.c, self.data.start.index, rows.end);
            let regressors = all.iter().map(|v| v[rows.clone()].to_vec());
            out.extend(few.iter().zip(regressors).map(|(&at, v)| ChangeTime { at, gain: gain(at, v) }));
        }
        out
    }

    /// How many alternatives are proposed: `few`, or twenty times as many where the kind is known to be there.
    pub fn limit(&self, few: usize) -> usize {
        if self.thorough { 20 * few } else { few }
    }

    /// The times at which a change is screened, one in `stride` samples.
    pub fn change_times(&self, stride: usize) -> impl Iterator<Item = usize> + use<> {
        let rows = self.data.rows();
        (rows.start + MARGIN..rows.end - MARGIN).step_by(stride)
    }
}

/// The times with the largest gains, at most `most` of them. Of times close to each other only the best is kept.
pub fn best_times(mut times: Vec<ChangeTime>, most: usize) -> Vec<ChangeTime> {
    times.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let mut out: Vec<ChangeTime> = Vec::new();
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

/// The first sample of a signal that is not 0.
fn begin_of(signal: &[f64]) -> usize {
    signal.iter().position(|v| *v != 0.0).unwrap_or(signal.len())
}

/// `a' W b` of each two columns, as the lower triangle of a matrix. Each is summed sample by sample, and four of them side by side:
/// one sum alone waits for each of its terms.
///
/// * `begins`: the first sample of each column that is not 0.
fn weighted_products(columns: &[Vec<f64>], begins: &[usize], omega: &[f64]) -> Vec<f64> {
    let m = columns.len();
    let pairs: Vec<(usize, usize)> = (0..m).flat_map(|i| (0..=i).map(move |j| (i, j))).collect();
    let mut products = vec![0.0; m * m];
    for few in pairs.chunks(4) {
        let from = few.iter().map(|&(i, j)| begins[i].max(begins[j])).min().unwrap_or(0);
        let cut = |i: usize| &columns[i][from..];
        let omega = &omega[from..];
        if let &[(i, j)] = few {
            [products[i * m + j]] = weighted_sums([[cut(i), cut(j)]], omega);
            continue;
        }
        // The last pair fills up the four.
        let four = from_fn(|l| few[l.min(few.len() - 1)]);
        let sums: [f64; 4] = weighted_sums(four.map(|(i, j)| [cut(i), cut(j)]), omega);
        few.iter().zip(sums).for_each(|(&(i, j), sum)| products[i * m + j] = sum);
    }
    products
}

/// `sum over k of a[k] b[k] omega[k]` of each pair `[a, b]`.
fn weighted_sums<const L: usize>(pairs: [[&[f64]; 2]; L], omega: &[f64]) -> [f64; L] {
    let n = omega.len();
    let pairs = pairs.map(|pair| pair.map(|v| &v[..n]));
    let mut sums = [0.0; L];
    for (k, omega) in omega.iter().enumerate() {
        for (sum, [a, b]) in sums.iter_mut().zip(&pairs) {
            *sum += a[k] * b[k] * omega;
        }
    }
    sums
}

/// Solves `D x = r`, D symmetric of order `m` with its lower triangle given, by Cholesky's factorisation in place. An unknown
/// whose pivot is infinite or not positive is 0.
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
    use crate::residual::fit::fit_base;
    use crate::residual::hypotheses::change_time::heaviside;
    use crate::residual::tests::behind_dead_band;
    use crate::sysid::valve::ValveModel;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn regressors_that_share_their_work_are_those_one_by_one_to_the_last_bit() {
        let data = behind_dead_band(700, |_| 0.0);
        let s = 2.0 / data.units.u;
        let valve = ValveModel { s, j: s, ..ValveModel::default() };
        let base = fit_base(&data, Hypothesis { valve: Some(valve), effects: Vec::new() });
        let screen = Screen::new(&data, &base);
        let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
        let rows = data.rows();
        for at in [data.first, data.first + 4, data.first + 17, 300, data.split - 1] {
            let step = heaviside(data.len(), at);
            let plain = &filtered(|k| step[k], base.model.c, data.start.index, rows.end)[rows.clone()];
            assert_eq!(bits(&screen.load_step_regressor(at)), bits(plain), "{at}");
            assert_eq!(bits(&screen.stem_step_regressor(at)), bits(&screen.stem_regressor(&step)), "{at}");
        }
        for before in [false, true] {
            let part = |at: usize| -> Vec<f64> {
                let cut = |(k, x): (usize, &f64)| if (k < at) == before { *x } else { 0.0 };
                screen.signals.x.iter().enumerate().map(cut).collect()
            };
            let gain = |v: Vec<f64>| screen.armax.single_gain(v).0;
            let found = screen.rated_times(screen.change_times(61), part, |_, v| gain(v));
            assert!(found.len() > 8);
            for ChangeTime { at, gain: own } in found {
                assert_eq!(own.to_bits(), gain(screen.stem_regressor(&part(at))).to_bits(), "{at}");
            }
        }
    }

    #[test]
    fn products_side_by_side_are_those_one_by_one_to_the_last_bit() {
        let n = 205;
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(7));
        let mut noise = || -> Vec<f64> { draw.by_ref().take(n).collect() };
        let omega: Vec<f64> = noise().iter().map(|v| if *v > 1.0 { 0.0 } else { v.abs() }).collect();
        for m in 0..=6 {
            let mut columns: Vec<Vec<f64>> = (0..m).map(|_| noise()).collect();
            for (i, column) in columns.iter_mut().enumerate() {
                column[..41 * i].fill(0.0);
            }
            let begins: Vec<usize> = columns.iter().map(|column| begin_of(column)).collect();
            let found = weighted_products(&columns, &begins, &omega);
            for (i, j) in (0..m).flat_map(|i| (0..=i).map(move |j| (i, j))) {
                let terms = columns[i].iter().zip(&columns[j]).zip(&omega);
                let plain: f64 = terms.map(|((a, b), omega)| a * b * omega).sum();
                assert_eq!(found[i * m + j].to_bits(), (plain + 0.0).to_bits(), "{m} {i} {j}");
            }
        }
    }

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
        let gains: Vec<f64> = [1.0, 1e-2, 1e-4].map(|by| test(&unsettled).single_gain(nearly(by)).0).to_vec();
        let own = test(&errors).single_gain(other.clone()).0;
        assert!(gains.iter().all(|gain| (gain - own).abs() < 1e-3 * (1.0 + own)), "{gains:?} for {own}");
    }
}
