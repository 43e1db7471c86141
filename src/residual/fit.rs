//! Prediction-error estimation of the linear part together with the smooth numbers of the terms.
//!
//! Levenberg–Marquardt on `V = sum w e² / sum w`.

use super::filters::recursion;
use super::model::{Data, Linear, Spec, Stage};
use super::slopes::{Slopes, Smooth, moves_stem, put, smooths};
use crate::diagnosis::armax::{Orders, RHO, draw_inside};
use crate::sysid::gram::add_two;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};

/// Smallest loss relative to var(PV): below it rounding decides.
pub const FLOOR: f64 = 1e-12;

/// How often what an iteration promises it and all after it may gain: 1 of 200 fits that come to anything gains more.
const REACH: f64 = 16.0;

/// Errors one step ahead, over all samples; 0 before the recursion starts and where a sample does not count.
pub fn errors(data: &Data, stage: &Stage, orders: Orders, l: &Linear, e: &mut Vec<f64>) {
    errors_until(data, stage, orders, l, data.len(), e);
}

/// The same up to sample `to`: a fit needs no more than the split.
fn errors_until(data: &Data, stage: &Stage, orders: Orders, l: &Linear, to: usize, e: &mut Vec<f64>) {
    let begin = data.start.index + 1 + orders.na.max(orders.nk + orders.nb - 1);
    e.clear();
    e.resize(to, 0.0);
    if begin >= to {
        return;
    }
    let rows = to - begin;
    for (e, y) in e[begin..].iter_mut().zip(&stage.y[begin..]) {
        *e = y - l.c0;
    }
    let from_y = l.a.iter().enumerate().map(|(i, a)| (*a, &stage.y[begin - 1 - i..][..rows]));
    let from_z = l.b.iter().enumerate().map(|(j, b)| (-b, &stage.z[begin - orders.nk - j..][..rows]));
    let shapes = l.gamma.iter().zip(&stage.columns).map(|(g, column)| (-g, &column[begin..to]));
    let mut parts = from_y.chain(from_z).chain(shapes);
    while let Some(one) = parts.next() {
        // Two at a time: what is bound by memory is passed over half as often.
        add_two(&mut e[begin..], one, parts.next().unwrap_or((0.0, one.1)));
    }
    recursion(&l.c, &stage.weight[begin..to], &mut e[begin..]);
}

/// Loss on the fitted samples.
pub fn loss_of(data: &Data, stage: &Stage, e: &[f64]) -> f64 {
    let counted = &e[data.first..data.split];
    let weight: f64 = stage.weight[data.first..data.split].iter().sum();
    let loss = dot(counted, counted) / weight.max(1.0);
    if loss.is_finite() { loss + FLOOR } else { f64::INFINITY }
}

/// Minimises the loss of `spec` from its present coefficients, at most `most` iterations.
pub fn minimise(data: &Data, spec: &mut Spec, free_lag: bool, most: usize) {
    minimise_towards(data, spec, free_lag, (0, most), f64::INFINITY);
}

/// The same with the numbers of the terms before `first` held, given up once a loss of `enough` is out of reach.
pub fn minimise_towards(
    data: &Data,
    spec: &mut Spec,
    free_lag: bool,
    (first, most): (usize, usize),
    enough: f64,
) {
    let (mut stage, counts) = spec.stage(data);
    spec.linear.gamma.resize(counts.iter().sum(), 0.0);
    draw_inside(&mut spec.linear.c, RHO);
    let mut e = Vec::new();
    errors_until(data, &stage, spec.orders, &spec.linear, data.split, &mut e);
    spec.loss = loss_of(data, &stage, &e);
    let mut damping = 1e-3;
    let rows = (data.split - data.first) as f64;
    let mut trial = Vec::new();
    let mut slopes = Slopes::default();
    for iteration in 0..most {
        let smooth = smooths(spec, free_lag, first);
        let (g, r) = slopes.normal_equations(data, spec, &stage, &counts, &e, &smooth);
        let size = r.len();
        let mut improved = false;
        for _ in 0..6 {
            let mut damped = g.clone();
            for i in 0..size {
                damped[i * size + i] *= 1.0 + damping;
            }
            let mut step = r.clone();
            let mut live = [true; MOST_COLUMNS];
            factor(&mut damped, size, size, &mut live);
            substitute(&damped, size, &live, &mut step);
            let promised = dot(&step, &r) / rows;
            if promised.is_nan() || promised <= 1e-5 * spec.loss {
                return;
            }
            if iteration > 0 && spec.loss - REACH * promised > enough {
                return;
            }
            let mut candidate = spec.clone();
            apply(&mut candidate, &step, &smooth);
            if smooth.iter().any(|(which, ..)| moves_stem(&candidate, &counts, *which)) {
                candidate.restem(data, &stage.u[..data.split], &mut stage.z, &mut stage.dir);
            }
            if smooth
                .iter()
                .any(|(which, ..)| matches!(which, Smooth::Knob { term, .. } if counts[*term] > 0))
            {
                candidate.reshape(data, &mut stage);
            }
            errors_until(data, &stage, candidate.orders, &candidate.linear, data.split, &mut trial);
            let loss = loss_of(data, &stage, &trial);
            if loss < spec.loss {
                improved = spec.loss - loss > 3e-5 * loss;
                candidate.loss = loss;
                *spec = candidate;
                std::mem::swap(&mut e, &mut trial);
                damping = (damping * 0.2).max(1e-7);
                break;
            }
            damping = (damping * 10.0).max(1e-4);
        }
        if !improved {
            return;
        }
    }
}

fn apply(spec: &mut Spec, step: &[f64], smooth: &[(Smooth, f64, f64, (f64, f64))]) {
    let l = &mut spec.linear;
    let slots = l.a.iter_mut().chain(&mut l.b).chain(&mut l.c).chain([&mut l.c0]).chain(&mut l.gamma);
    let mut at = 0;
    for (slot, step) in slots.zip(step) {
        *slot += step;
        at += 1;
    }
    for ((which, value, width, bounds), step) in smooth.iter().zip(&step[at..]) {
        // A nonlinear number never goes further in one step than its difference quotient can vouch for.
        let moved = value + step.clamp(-2.0 * width, 2.0 * width);
        put(spec, *which, moved.clamp(bounds.0, bounds.1));
    }
    draw_inside(&mut spec.linear.c, RHO);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::friction::Start;
    use crate::residual::model::{Element, Knob, Scale, Term};
    use crate::residual::regress::{Quick, restructure, structures};
    use crate::residual::run::held_out;
    use crate::residual::{Kind, Parameter};

    /// `y[k] = 0.7 y[k-1] + 0.5 u[k-2] + 0.3`, exactly.
    fn exact() -> Data {
        let n = 600;
        let u: Vec<f64> = (0..n).map(|k| (0.3 * k as f64).sin() + (0.011 * (k * k) as f64).cos()).collect();
        let mut y = vec![0.0; n];
        for k in 2..n {
            y[k] = 0.7 * y[k - 1] + 0.5 * u[k - 2] + 0.3;
        }
        Data {
            f_top: 1.0,
            u,
            y,
            start: Start { index: 0, is_max: true },
            first: 40,
            split: 430,
            max_delay: 10,
            scale: Scale { t0: 0.0, ts: 1.0, u0: 0.0, u: 1.0, y0: 0.0, y: 1.0 },
            sp: None,
            tags: Vec::new(),
        }
    }

    fn blank(orders: Orders) -> Spec {
        let zeros = |n: usize| vec![0.0; n];
        let linear =
            Linear { a: zeros(orders.na), b: zeros(orders.nb), c: zeros(orders.nc), ..Linear::default() };
        Spec {
            element: Element::default(),
            terms: Vec::new(),
            orders,
            linear,
            free: None,
            loss: f64::INFINITY,
        }
    }

    #[test]
    fn an_exact_model_is_found_exactly_and_runs_free_without_error() {
        let data = exact();
        let mut spec = blank(Orders { na: 1, nb: 1, nc: 0, nk: 2 });
        minimise(&data, &mut spec, false, 30);
        // Solved to rounding: the loss is its floor.
        assert!((spec.linear.a[0] + 0.7).abs() < 1e-6 && (spec.linear.b[0] - 0.5).abs() < 1e-6);
        assert!((spec.linear.c0 - 0.3).abs() < 1e-6 && spec.loss < 1e-11);
        let (one, free) = held_out(&data, &spec);
        assert!(one < 1e-5 && free < 1e-4, "{one} {free}");
    }

    #[test]
    fn the_delay_is_found_by_the_choice_of_orders() {
        let data = exact();
        let mut spec = blank(Orders { na: 1, nb: 1, nc: 0, nk: 7 });
        restructure(&data, &mut spec, false, 4);
        // Every structure that holds the true one explains the record to rounding.
        assert!(spec.loss < 1e-9, "{:?} {}", spec.orders, spec.loss);
    }

    /// A fit that is given up is no better than what it was to reach, and one that reaches it is the whole fit.
    #[test]
    fn only_what_is_out_of_reach_is_given_up() {
        let data = exact();
        let spec = blank(Orders { na: 1, nb: 2, nc: 1, nk: 3 });
        let mut start = structures(&data, &spec, 1).remove(0);
        start.linear.a.iter_mut().for_each(|a| *a *= 0.8);
        let mut whole = start.clone();
        minimise(&data, &mut whole, false, 12);
        let mut given_up = 0;
        for share in [0.5, 0.9, 1.1, 2.0, 10.0] {
            let enough = share * whole.loss;
            let mut spec = start.clone();
            minimise_towards(&data, &mut spec, false, (0, 12), enough);
            if share > 1.0 {
                assert_eq!((spec.loss, &spec.linear), (whole.loss, &whole.linear));
            }
            assert_eq!(spec.loss < enough, whole.loss < enough);
            given_up += usize::from(spec.loss > whole.loss);
        }
        assert!(given_up > 0, "{given_up}");
    }

    #[test]
    fn shared_products_are_the_plain_ones() {
        let data = exact();
        let (stage, _) = blank(Orders { na: 1, nb: 1, nc: 0, nk: 2 }).stage(&data);
        let shared = Quick::new(&data, &stage, &[1, 2, 3, 4], &[3, 4, 5]);
        let apart = Quick::new(&data, &stage, &[1, 3, 2, 4], &[5, 3, 4]);
        // The same columns in another order, none of them the successor of its neighbour.
        assert!((shared.loss - apart.loss).abs() < 1e-9 * (1.0 + apart.loss));
        let column: Vec<f64> = (0..data.len()).map(|k| (0.7 * k as f64).cos()).collect();
        assert!((shared.with(&[&column]).0 - apart.with(&[&column]).0).abs() < 1e-9);
    }

    /// A wave of a frequency that is estimated.
    #[derive(Clone, Debug)]
    struct Tone(f64);

    impl Term for Tone {
        fn kind(&self) -> Kind {
            Kind::OscillatingLoad
        }
        fn boxed(&self) -> Box<dyn Term> {
            Box::new(self.clone())
        }
        fn knobs(&self) -> Vec<Knob> {
            vec![Knob { value: self.0, step: 1e-3, smooth: true, bounds: (0.0, 3.0) }]
        }
        fn set(&mut self, _at: usize, value: f64) {
            self.0 = value;
        }
        fn columns(&self, data: &Data, _stage: &Stage, out: &mut Vec<Vec<f64>>) {
            out.push((0..data.len()).map(|k| (self.0 * k as f64).sin()).collect());
        }
        fn describe(&self, _: &Data, _: &[f64], _: &Linear) -> (Vec<Parameter>, String) {
            Default::default()
        }
    }

    #[test]
    fn the_numbers_of_the_terms_before_the_first_are_held() {
        let mut data = exact();
        let tones = |k: usize| (0.3 * k as f64).sin() + (0.5 * k as f64).sin();
        for k in 2..data.len() {
            data.y[k] = 0.7 * data.y[k - 1] + 0.5 * data.u[k - 2] + tones(k);
        }
        let after = |first: usize| -> Vec<f64> {
            let mut spec = blank(Orders { na: 1, nb: 1, nc: 0, nk: 2 });
            spec.terms = vec![Box::new(Tone(0.3005)), Box::new(Tone(0.5005))];
            minimise_towards(&data, &mut spec, false, (first, 30), f64::INFINITY);
            spec.terms.iter().map(|term| term.knobs()[0].value).collect()
        };
        let (all, last, none) = (after(0), after(1), after(2));
        assert!((all[0] - 0.3).abs() < 1e-5 && (all[1] - 0.5).abs() < 1e-5, "{all:?}");
        assert!(last[0] == 0.3005 && (last[1] - 0.5).abs() < 3e-4, "{last:?}");
        assert_eq!(none, [0.3005, 0.5005]);
    }
}
