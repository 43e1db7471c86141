//! The gradient of the prediction by every coefficient, and one step of Levenberg–Marquardt.
//!
//! ```text
//! -de/da_i     = -1/C y[k-i]              -de/dc0      = 1/C 1
//! -de/db_j     =  1/C x[k-nk-(j-1)]       -de/dgamma_m = 1/C phi_m[k]
//! -de/dc_i     =  1/C e[k-i]              -de/dtheta   = 1/C d(B x + sum gamma phi + A o)/dtheta
//!
//! (J' W J + damping diag(J' W J)) step = J' W e,    J = -de/d(coefficients),  W = omega of Student's t
//! ```
//!
//! The columns of a, b and c are three lags of one filtered signal each, so y, x, e and 1 are filtered once.
//! Where samples do not count, the filter varies in time, and every column is filtered by itself (`kalman`).
//!
//! Source: Ljung, System Identification, 1999, section 10.3.

use super::errors::Errors;
use super::model::{Armax, Input, ORDER, Signals, Smooth};
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::student;
use multiversion::multiversion;

/// The gradient at a fitted model, in the fitted rows.
#[derive(Clone, Debug, Default)]
pub struct Gradient {
    /// `-de/d(coefficient)`: one column each for a, b, c, c0, gamma and theta, in this order.
    pub columns: Vec<Vec<f64>>,
    /// Weights omega of the equivalent least squares (-).
    pub omega: Vec<f64>,
    /// The prediction errors e (standard deviations of PV).
    pub errors: Vec<f64>,
    /// The input signals at the model's theta.
    pub signals: Signals,
}

/// The weighted normal equations at one model.
pub struct NormalEquations {
    /// `J' W J`, lower triangle.
    gram: Vec<f64>,
    /// `J' W e`.
    right: Vec<f64>,
}

/// `v / C(q)` for samples `begin..to`, from rest; 0 before `begin`.
pub fn filtered(v: impl Fn(usize) -> f64, [c1, c2, c3]: [f64; ORDER], begin: usize, to: usize) -> Vec<f64> {
    let mut out = vec![0.0; to];
    let (mut p1, mut p2, mut p3) = (0.0, 0.0, 0.0);
    for (k, out) in out.iter_mut().enumerate().skip(begin) {
        // The newest value is subtracted last, because it is the last to be computed.
        let value = v(k) - c3 * p3 - c2 * p2 - c1 * p1;
        *out = value;
        (p1, p2, p3) = (value, p1, p2);
    }
    out
}

/// [`filtered`] for many signals, eight side by side: the recursion of one signal alone leaves the processor idle.
pub fn filtered_all(signals: &[&[f64]], c: [f64; ORDER], begin: usize, to: usize) -> Vec<Vec<f64>> {
    let zeros = vec![0.0; to];
    // The last eight are filled up with zeros: the recursion of eight takes about as long as that of one.
    let mut all = vec![vec![0.0; to]; signals.len().next_multiple_of(8)];
    for (few, out) in signals.chunks(8).zip(all.as_chunks_mut::<8>().0) {
        let eight = std::array::from_fn(|i| &few.get(i).copied().unwrap_or(&zeros)[begin..to]);
        filter_eight(eight, c, out.each_mut().map(|out| &mut out[begin..]));
    }
    all.truncate(signals.len());
    all
}

/// `v / C(q)` of eight signals, from rest.
///
/// * `out`: receives as many samples as each signal has.
#[multiversion(targets("x86_64+avx2"))]
fn filter_eight(v: [&[f64]; 8], [c1, c2, c3]: [f64; ORDER], out: [&mut [f64]; 8]) {
    let n = v[0].len();
    let [v0, v1, v2, v3, v4, v5, v6, v7] = v.map(|v| &v[..n]);
    let [o0, o1, o2, o3, o4, o5, o6, o7] = out.map(|out| &mut out[..n]);
    let (mut p1, mut p2, mut p3) = ([0.0; 8], [0.0; 8], [0.0; 8]);
    for k in 0..n {
        let now = [v0[k], v1[k], v2[k], v3[k], v4[k], v5[k], v6[k], v7[k]];
        let mut value = [0.0; 8];
        for i in 0..8 {
            value[i] = now[i] - c3 * p3[i] - c2 * p2[i] - c1 * p1[i];
        }
        [o0[k], o1[k], o2[k], o3[k], o4[k], o5[k], o6[k], o7[k]] = value;
        (p1, p2, p3) = (value, p1, p2);
    }
}

impl Gradient {
    /// The gradient of a fitted model.
    ///
    /// * `y`: PV (normalised).
    /// * `input`: the hypothesis that was fitted.
    pub fn new(data: &IdData, y: &[f64], model: &Armax, input: &dyn Input) -> Self {
        let signals = input.signals(&model.theta);
        let errors = model.errors(data, y, &signals, data.split);
        let rows = data.rows();
        let mut omega = vec![0.0; rows.len()];
        student::reweigh(
            &errors.e[rows.clone()],
            &data.weight[rows.clone()],
            (model.scale, model.nu),
            &mut omega,
        );
        let columns = columns(data, model, &input.smooth(), &signals, input, &errors);
        Self { columns, omega, errors: errors.e[rows].to_vec(), signals }
    }
}

/// The columns `-de/d(coefficient)` in the fitted rows, in the order of [`Gradient::columns`].
fn columns(
    data: &IdData,
    model: &Armax,
    smooth: &[Smooth],
    signals: &Signals,
    input: &dyn Input,
    errors: &Errors,
) -> Vec<Vec<f64>> {
    let rows = data.rows();
    let (begin, to) = (data.start.index, data.split);
    if !errors.gains.is_empty() {
        return columns_with_missing(data, model, smooth, signals, input, errors);
    }
    let ones = vec![1.0; to];
    let by_theta: Vec<Vec<f64>> =
        (0..smooth.len()).map(|i| by_theta(model, smooth, signals, input, (begin, to), i)).collect();
    let mut all: Vec<&[f64]> = vec![&errors.y, &signals.x, &errors.e, &ones];
    all.extend(signals.shapes.iter().chain(&by_theta).map(Vec::as_slice));
    let all = filtered_all(&all, model.c, begin, to);
    let lagged = |v: usize, lag: usize| all[v][rows.start - lag..rows.end - lag].to_vec();
    let mut columns: Vec<Vec<f64>> = (1..=ORDER).map(|lag| lagged(0, lag)).collect();
    columns.iter_mut().flatten().for_each(|y| *y = -*y);
    columns.extend((0..ORDER).map(|j| lagged(1, model.nk + j)));
    columns.extend((1..=ORDER).map(|lag| lagged(2, lag)));
    columns.extend((3..all.len()).map(|v| lagged(v, 0)));
    columns
}

/// [`columns`] where some samples do not count: the filter varies in time, so no column is another one shifted.
fn columns_with_missing(
    data: &IdData,
    model: &Armax,
    smooth: &[Smooth],
    signals: &Signals,
    input: &dyn Input,
    errors: &Errors,
) -> Vec<Vec<f64>> {
    let (rows, begin, gains) = (data.rows(), data.start.index, &errors.gains);
    let cut = |v: Vec<f64>| v[rows.clone()].to_vec();
    let by_state =
        |i: usize, sign: f64, v: &[f64]| cut(gains.sensitivity(begin, |_| 0.0, Some((i, sign, v))));
    let mut columns: Vec<Vec<f64>> = (0..ORDER).map(|i| by_state(i, -1.0, &errors.y)).collect();
    let x = |j: usize| move |k: usize| signals.x[k.saturating_sub(model.nk + j)];
    columns.extend((0..ORDER).map(|j| cut(gains.sensitivity(begin, x(j), None))));
    columns.extend((0..ORDER).map(|i| by_state(i, 1.0, &gains.likeliest)));
    columns.push(cut(gains.sensitivity(begin, |_| 1.0, None)));
    let by_gamma = |shape: &Vec<f64>| cut(gains.sensitivity(begin, |k| shape[k], None));
    columns.extend(signals.shapes.iter().map(by_gamma));
    columns.extend((0..smooth.len()).map(|i| {
        let by_theta = by_theta(model, smooth, signals, input, (begin, data.split), i);
        cut(gains.sensitivity(begin, |k| by_theta[k], None))
    }));
    columns
}

impl NormalEquations {
    /// The normal equations at `model`, whose input signals and errors are given.
    pub fn new(
        data: &IdData,
        model: &Armax,
        smooth: &[Smooth],
        signals: &Signals,
        input: &dyn Input,
        errors: &Errors,
    ) -> Self {
        let rows = data.rows();
        let mut columns = columns(data, model, smooth, signals, input, errors);
        columns.push(errors.e[rows.clone()].to_vec());
        let mut omega = vec![0.0; rows.len()];
        student::reweigh(&errors.e[rows.clone()], &data.weight[rows], (model.scale, model.nu), &mut omega);
        omega.iter_mut().for_each(|omega| *omega = omega.sqrt());
        for column in &mut columns {
            column.iter_mut().zip(&omega).for_each(|(c, omega)| *c *= omega);
        }
        let all: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let size = all.len() - 1;
        let mut normal = Self { gram: vec![0.0; size * size], right: vec![0.0; size] };
        lower(&all[..size], &mut normal.gram, size);
        products(&all[size..], &all[..size], |_, i, sum| normal.right[i] = sum);
        normal
    }

    /// The model after one damped step from `model`; theta is held within its bounds.
    pub fn step(&self, model: &Armax, smooth: &[Smooth], damping: f64) -> Armax {
        let size = self.right.len();
        let (mut g, mut step) = (self.gram.clone(), self.right.clone());
        (0..size).for_each(|i| g[i * size + i] *= 1.0 + damping);
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, size, size, &mut live);
        substitute(&g, size, &live, &mut step);
        let mut next = model.clone();
        let slots = next.a.iter_mut().chain(&mut next.b).chain(&mut next.c).chain([&mut next.c0]);
        let slots = slots.chain(&mut next.gamma).chain(&mut next.theta);
        slots.zip(&step).filter(|(_, step)| step.is_finite()).for_each(|(slot, step)| *slot += step);
        for (theta, smooth) in next.theta.iter_mut().zip(smooth) {
            *theta = theta.clamp(smooth.bounds.0, smooth.bounds.1);
        }
        next
    }
}

/// `d(B x + sum gamma phi + A o)/dtheta_i` of samples `begin..to`, by a difference quotient of the signals; 0 before them.
fn by_theta(
    model: &Armax,
    smooth: &[Smooth],
    signals: &Signals,
    input: &dyn Input,
    (begin, to): (usize, usize),
    i: usize,
) -> Vec<f64> {
    let mut theta = model.theta.clone();
    let up = theta[i] + smooth[i].step <= smooth[i].bounds.1;
    let step = if up { smooth[i].step } else { -smooth[i].step };
    theta[i] += step;
    let other = input.signals(&theta);
    let first = begin + 1 + model.nk + ORDER;
    let mut sum = vec![0.0; to];
    // Adds a coefficient times the difference of a signal, `lag` samples later.
    let mut add = |by: f64, (new, old): (&[f64], &[f64]), lag: usize| {
        let pairs = new[first - lag..to - lag].iter().zip(&old[first - lag..to - lag]);
        sum[first..].iter_mut().zip(pairs).for_each(|(sum, (new, old))| *sum += by * (new - old));
    };
    if other.x != signals.x {
        for (j, b) in model.b.iter().enumerate() {
            add(*b, (&other.x, &signals.x), model.nk + j);
        }
    }
    for (gamma, (new, old)) in model.gamma.iter().zip(other.shapes.iter().zip(&signals.shapes)) {
        if new != old {
            add(*gamma, (new, old), 0);
        }
    }
    // The offset enters the error through A.
    if !signals.offset.is_empty() {
        for (lag, a) in std::iter::once(&1.0).chain(&model.a).enumerate() {
            add(*a, (&other.offset, &signals.offset), lag);
        }
    }
    sum.iter_mut().for_each(|sum| *sum /= step);
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn signals_side_by_side_are_those_alone_to_the_last_bit() {
        let c = [-0.7, 0.2, 0.05];
        let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
        for n in [0, 1, 7, 8, 9, 17, 513] {
            let signals: Vec<Vec<f64>> = (0..17)
                .map(|seed| {
                    StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed)).take(n).collect()
                })
                .collect();
            let signals: Vec<&[f64]> = signals.iter().map(Vec::as_slice).collect();
            for (many, begin) in (0..=17).flat_map(|many| [(many, 0), (many, n / 3), (many, n)]) {
                let all = filtered_all(&signals[..many], c, begin, n);
                assert_eq!(all.len(), many);
                for (signal, found) in signals.iter().zip(&all) {
                    let alone = filtered(|k| signal[k], c, begin, n);
                    assert_eq!(bits(found), bits(&alone), "{many} from {begin} to {n}");
                }
            }
        }
    }
}
