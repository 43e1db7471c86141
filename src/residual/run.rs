//! PV run free, on the fitted samples and on those that no fit has seen, with the errors of the latter.

use super::fit::errors;
use super::model::{Data, Linear, Spec, Stage};
use crate::diagnosis::armax::draw_inside;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};

/// How far the calibration holds on to the one-step estimate: lags of a slow stem are nearly one column.
const RIDGE: f64 = 1e-3;

/// PV run free from sample `from` on: predicted from what was measured and how far off it was before, and from OP.
///
/// It starts again every `stretch` samples: an integrating process would otherwise be judged by its one slowest error.
fn simulate(data: &Data, spec: &Spec, stage: &Stage, e: &[f64], from: usize, stretch: usize) -> Vec<f64> {
    let mut a = spec.linear.a.clone();
    // A model for simulation must not explode: one-step errors hide an A just outside the unit circle.
    draw_inside(&mut a, 1.0);
    let o = spec.orders;
    let l = &spec.linear;
    let mut y = stage.y.clone();
    let mut origin = from;
    for k in from.max(o.na.max(o.nk + o.nb))..data.len() {
        if k >= origin + stretch {
            origin += stretch;
        }
        let mut value = l.c0;
        for (i, a) in a.iter().enumerate() {
            let at = k - 1 - i;
            value -= a * if at < origin { stage.y[at] } else { y[at] };
        }
        for (j, b) in l.b.iter().enumerate() {
            value += b * stage.z[k - o.nk - j];
        }
        for (g, column) in l.gamma.iter().zip(&stage.columns) {
            value += g * column[k];
        }
        for (i, c) in l.c.iter().enumerate().filter(|(i, _)| k - 1 - i < origin) {
            value += c * e[k - 1 - i];
        }
        y[k] = value.clamp(-1e6, 1e6);
    }
    y
}

/// The linear part as the free run needs it: B, the constant and the shapes estimated again on the free-run error of the
/// fitted samples, where one-step errors say little about what is slow. A and C stay.
pub fn calibrated(data: &Data, spec: &Spec, stage: &Stage, e: &[f64]) -> Linear {
    let (l, o) = (&spec.linear, spec.orders);
    let mut a = l.a.clone();
    draw_inside(&mut a, 1.0);
    let (from, to, stretch) = (data.first, data.split, data.stretch());
    let run = simulate(data, spec, stage, e, from, stretch);
    let ones = vec![1.0; to];
    let sources: Vec<(&[f64], usize)> = (0..o.nb)
        .map(|j| (&stage.z[..], o.nk + j))
        .chain([(&ones[..], 0)])
        .chain(stage.columns.iter().map(|c| (&c[..], 0)))
        .collect();
    let columns: Vec<Vec<f64>> = sources
        .iter()
        .map(|(v, lag)| {
            let mut out = vec![0.0; to - from];
            for k in from..to {
                // From rest at the start of every stretch.
                let origin = from + (k - from) / stretch * stretch;
                let past = a.iter().enumerate().take_while(|(i, _)| k > origin + i);
                let past: f64 = past.map(|(i, a)| a * out[k - 1 - i - from]).sum();
                out[k - from] = v[k - lag] - past;
            }
            out.iter_mut().zip(&stage.weight[from..to]).for_each(|(x, w)| *x *= w);
            out
        })
        .collect();
    let left: Vec<f64> = (from..to).map(|k| (stage.y[k] - run[k]) * stage.weight[k]).collect();
    let size = columns.len().min(MOST_COLUMNS);
    let mut g = vec![0.0; size * size];
    let mut step = vec![0.0; size];
    for i in 0..size {
        for j in 0..=i {
            g[i * size + j] = dot(&columns[i], &columns[j]);
        }
        g[i * size + i] *= 1.0 + RIDGE;
        step[i] = dot(&columns[i], &left);
    }
    let mut live = [true; MOST_COLUMNS];
    factor(&mut g, size, size, &mut live);
    substitute(&g, size, &live, &mut step);
    let mut linear = l.clone();
    let slots = linear.b.iter_mut().chain([&mut linear.c0]).chain(&mut linear.gamma);
    for (slot, step) in slots.zip(&step).filter(|(_, step)| step.is_finite()) {
        *slot += step;
    }
    linear
}

/// The free run with the linear part [`calibrated`] for it.
pub fn free_run(data: &Data, spec: &Spec, stage: &Stage, e: &[f64], from: usize) -> Vec<f64> {
    if let Some(other) = &spec.free {
        let (stage, _) = other.stage(data);
        let mut e = Vec::new();
        errors(data, &stage, other.orders, &other.linear, &mut e);
        return free_run(data, other, &stage, &e, from);
    }
    let mut run = spec.clone();
    run.linear = calibrated(data, spec, stage, e);
    simulate(data, &run, stage, e, from, data.stretch())
}

/// Mean square free-run error of the fitted samples that count (normalised PV²).
pub fn free_fitted(data: &Data, spec: &Spec) -> f64 {
    let (stage, _) = spec.stage(data);
    let mut e = Vec::new();
    errors(data, &stage, spec.orders, &spec.linear, &mut e);
    let free = free_run(data, spec, &stage, &e, data.first);
    let fitted = data.first..data.split;
    let weight: f64 = stage.weight[fitted.clone()].iter().sum();
    fitted.map(|k| stage.weight[k] * (free[k] - stage.y[k]).powi(2)).sum::<f64>() / weight.max(1.0)
}

/// Root mean square one-step and free-run errors of the held-out samples that count (normalised PV).
pub fn held_out(data: &Data, spec: &Spec) -> (f64, f64) {
    let (stage, _) = spec.stage(data);
    let mut e = Vec::new();
    errors(data, &stage, spec.orders, &spec.linear, &mut e);
    let free = free_run(data, spec, &stage, &e, data.split);
    let (mut one, mut run, mut count) = (0.0, 0.0, 0.0_f64);
    for k in data.split..data.len() {
        let w = stage.weight[k];
        one += w * e[k] * e[k];
        run += w * (free[k] - stage.y[k]).powi(2);
        count += w;
    }
    ((one / count.max(1.0)).sqrt(), (run / count.max(1.0)).sqrt())
}
