//! The gradient of the prediction, and one step of Levenberg–Marquardt on it.

use super::{Armax, Errors, Input, ORDER, Signals, Smooth};
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::student;

/// What the prediction gains by each coefficient, `- de/dtheta`, in the fitted rows.
#[derive(Clone, Debug, Default)]
pub struct Gradient {
    /// Columns: of a, b, c, c0, the shapes' coefficients and the smooth parameters.
    pub columns: Vec<Vec<f64>>,
    /// Weights of the equivalent least squares.
    pub omega: Vec<f64>,
    /// The errors.
    pub errors: Vec<f64>,
    /// The signals.
    pub signals: Signals,
}

/// The normal equations at one model.
pub struct Normal {
    gram: Vec<f64>,
    right: Vec<f64>,
}

/// `v / C(q)` from sample `begin` on, 0 before.
pub fn filtered(v: impl Fn(usize) -> f64, [c1, c2, c3]: [f64; ORDER], begin: usize, to: usize) -> Vec<f64> {
    let mut out = vec![0.0; to];
    let (mut p1, mut p2, mut p3) = (0.0, 0.0, 0.0);
    for (k, out) in out.iter_mut().enumerate().skip(begin) {
        // The newest value comes last: the processor has the other terms by then.
        let value = v(k) - c3 * p3 - c2 * p2 - c1 * p1;
        *out = value;
        (p1, p2, p3) = (value, p1, p2);
    }
    out
}

/// The same of many signals, four at once: each value waits for the one before, and the processor is idle meanwhile.
fn filtered_all(signals: &[&[f64]], c: [f64; ORDER], begin: usize, to: usize) -> Vec<Vec<f64>> {
    let (fours, rest) = signals.as_chunks::<4>();
    let mut all: Vec<Vec<f64>> = fours.iter().flat_map(|four| by_four(*four, c, begin, to)).collect();
    all.extend(rest.iter().map(|v| filtered(|k| v[k], c, begin, to)));
    all
}

fn by_four(v: [&[f64]; 4], [c1, c2, c3]: [f64; ORDER], begin: usize, to: usize) -> [Vec<f64>; 4] {
    let v = v.map(|v| &v[begin..to]);
    let mut out: [Vec<f64>; 4] = std::array::from_fn(|_| vec![0.0; to]);
    let of = out.each_mut().map(|out| &mut out[begin..]);
    let (mut p1, mut p2, mut p3) = ([0.0; 4], [0.0; 4], [0.0; 4]);
    for k in 0..to - begin {
        let mut value = [0.0; 4];
        for i in 0..4 {
            value[i] = v[i][k] - c3 * p3[i] - c2 * p2[i] - c1 * p1[i];
            of[i][k] = value[i];
        }
        (p1, p2, p3) = (value, p1, p2);
    }
    out
}

impl Gradient {
    /// Of a fitted model.
    pub fn new(data: &IdData, y: &[f64], model: &Armax, input: &dyn Input) -> Self {
        let signals = input.signals(&model.theta);
        let at = model.errors(data, y, &signals, data.split);
        let rows = data.rows();
        let mut omega = vec![0.0; rows.len()];
        student::reweigh(
            &at.e[rows.clone()],
            &data.weight[rows.clone()],
            (model.scale, model.nu),
            &mut omega,
        );
        let columns = columns(data, model, &input.smooth(), &signals, input, &at);
        Self { columns, omega, errors: at.e[rows].to_vec(), signals }
    }
}

/// The columns of the gradient.
fn columns(
    data: &IdData,
    model: &Armax,
    smooth: &[Smooth],
    signals: &Signals,
    input: &dyn Input,
    at: &Errors,
) -> Vec<Vec<f64>> {
    let rows = data.rows();
    let (begin, to) = (data.start.index, data.split);
    if !at.gains.is_empty() {
        return with_holes(data, model, smooth, signals, input, at);
    }
    let ones = vec![1.0; to];
    let slopes: Vec<Vec<f64>> =
        (0..smooth.len()).map(|i| slope(model, smooth, signals, input, (begin, to), i)).collect();
    let mut all: Vec<&[f64]> = vec![&at.y, &signals.x, &at.e, &ones];
    all.extend(signals.shapes.iter().chain(&slopes).map(Vec::as_slice));
    let all = filtered_all(&all, model.c, begin, to);
    let late = |v: usize, lag: usize| all[v][rows.start - lag..rows.end - lag].to_vec();
    let mut columns: Vec<Vec<f64>> = (1..=ORDER).map(|lag| late(0, lag)).collect();
    columns.iter_mut().flatten().for_each(|y| *y = -*y);
    columns.extend((0..ORDER).map(|j| late(1, model.nk + j)));
    columns.extend((1..=ORDER).map(|lag| late(2, lag)));
    columns.extend((3..all.len()).map(|v| late(v, 0)));
    columns
}

/// The same where some samples do not count: no two columns are one signal sooner or later then.
fn with_holes(
    data: &IdData,
    model: &Armax,
    smooth: &[Smooth],
    signals: &Signals,
    input: &dyn Input,
    at: &Errors,
) -> Vec<Vec<f64>> {
    let (rows, begin) = (data.rows(), data.start.index);
    let cut = |v: Vec<f64>| v[rows.clone()].to_vec();
    let of_state = |i: usize, sign: f64, v: &[f64]| cut(at.gains.through(begin, |_| 0.0, Some((i, sign, v))));
    let mut columns: Vec<Vec<f64>> = (0..ORDER).map(|i| of_state(i, -1.0, &at.y)).collect();
    let x = |j: usize| move |k: usize| signals.x[k.saturating_sub(model.nk + j)];
    columns.extend((0..ORDER).map(|j| cut(at.gains.through(begin, x(j), None))));
    columns.extend((0..ORDER).map(|i| of_state(i, 1.0, &at.gains.likeliest)));
    columns.push(cut(at.gains.through(begin, |_| 1.0, None)));
    let of_shape = |shape: &Vec<f64>| cut(at.gains.through(begin, |k| shape[k], None));
    columns.extend(signals.shapes.iter().map(of_shape));
    columns.extend((0..smooth.len()).map(|i| {
        let slope = slope(model, smooth, signals, input, (begin, data.split), i);
        cut(at.gains.through(begin, |k| slope[k], None))
    }));
    columns
}

impl Normal {
    /// At `model`, its signals and errors.
    pub fn new(
        data: &IdData,
        model: &Armax,
        smooth: &[Smooth],
        signals: &Signals,
        input: &dyn Input,
        at: &Errors,
    ) -> Self {
        let rows = data.rows();
        let mut columns = columns(data, model, smooth, signals, input, at);
        columns.push(at.e[rows.clone()].to_vec());
        let mut omega = vec![0.0; rows.len()];
        student::reweigh(&at.e[rows.clone()], &data.weight[rows], (model.scale, model.nu), &mut omega);
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

    /// The model one damped step on.
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

/// What smooth parameter `i` adds to each sample of a stretch before the filter, by a difference of the signals; 0 before it.
fn slope(
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
    // What differs, so many samples late, times a coefficient.
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
    // What PV shows beside the output comes through A.
    if !signals.offset.is_empty() {
        for (lag, a) in std::iter::once(&1.0).chain(&model.a).enumerate() {
            add(*a, (&other.offset, &signals.offset), lag);
        }
    }
    sum.iter_mut().for_each(|sum| *sum /= step);
    sum
}
