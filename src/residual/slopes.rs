//! The derivatives that a fit needs: of the errors one step ahead by every coefficient and by the smooth numbers of the terms.
//!
//! ```text
//! C(q) de/dtheta = -x,   x a lag of y, of z or of e, 1 or a shape;   for another number by what it does to z and to the shapes
//! ```

use super::filters::whiten;
use super::model::{Data, Element, Spec, Stage};
use crate::sysid::gram::{Column, add_two, gram, lower};
use crate::sysid::least_squares::MOST_COLUMNS;

/// One smooth number: the element's lag or a term's knob.
#[derive(Clone, Copy)]
pub enum Smooth {
    /// The lag of the element.
    Lag,
    /// A number of a term.
    Knob {
        /// Which term.
        term: usize,
        /// Which of its numbers.
        at: usize,
    },
}

pub fn smooths(spec: &Spec, free_lag: bool, first: usize) -> Vec<(Smooth, f64, f64, (f64, f64))> {
    let mut out = Vec::new();
    if free_lag && spec.element.f > 0.0 {
        // On its own side of 0: whether a stem slips beyond OP is the searches' to say.
        let (least, most) = Element::LAGS;
        let lag = spec.element.lag;
        out.push((Smooth::Lag, lag, 0.1, if lag < 0.0 { (least, 0.0) } else { (0.0, most) }));
    }
    for (term, t) in spec.terms.iter().enumerate().skip(first) {
        for (at, knob) in t.knobs().into_iter().enumerate().filter(|(_, k)| k.smooth) {
            out.push((Smooth::Knob { term, at }, knob.value, knob.step, knob.bounds));
        }
    }
    out
}

pub fn put(spec: &mut Spec, which: Smooth, value: f64) {
    match which {
        Smooth::Lag => spec.element.lag = value,
        Smooth::Knob { term, at } => spec.terms[term].set(at, value),
    }
}

/// Whether a number may change the stem: those of a term's shapes do not.
pub fn moves_stem(spec: &Spec, counts: &[usize], which: Smooth) -> bool {
    match which {
        Smooth::Lag => true,
        Smooth::Knob { term, .. } => counts[term] == 0 || spec.terms[term].changes_stem(),
    }
}

/// The derivatives of e on the fitted samples, kept from one iteration to the next for their storage.
#[derive(Default)]
pub struct Slopes {
    /// The signals behind them, filtered by 1/C: y, z, e, 1, the shapes, the smooth numbers'.
    filtered: Vec<Vec<f64>>,
    /// How each smooth number changes e before the filter.
    moved: Vec<Vec<f64>>,
    ones: Vec<f64>,
    z: Vec<f64>,
    dir: Vec<f64>,
    columns: Vec<Vec<f64>>,
}

impl Slopes {
    /// `J'J` and `-J'e`, the numbers in the order of [`apply`].
    pub fn normal_equations(
        &mut self,
        data: &Data,
        spec: &mut Spec,
        stage: &Stage,
        counts: &[usize],
        e: &[f64],
        smooth: &[(Smooth, f64, f64, (f64, f64))],
    ) -> (Vec<f64>, Vec<f64>) {
        let (from, to, o) = (data.first, data.split, spec.orders);
        let begin = data.start.index;
        self.moved.resize_with(smooth.len(), Vec::new);
        for (i, one) in smooth.iter().enumerate() {
            self.move_one(data, spec, stage, counts, *one, i);
        }
        self.ones.resize(to, 1.0);
        let inputs: Vec<&[f64]> = [&stage.y[..], &stage.z[..], e, &self.ones[..]]
            .into_iter()
            .chain(stage.columns.iter().map(Vec::as_slice))
            .chain(self.moved.iter().map(Vec::as_slice))
            .collect();
        whiten(&spec.linear.c, &inputs, begin, to, &mut self.filtered);
        let shapes = stage.columns.len();
        let of = |i: usize| &self.filtered[i][..];
        let mut columns: Vec<Column> = Column::lags(of(0), 1..=o.na).collect();
        columns.extend(Column::lags(of(1), o.nk..o.nk + o.nb));
        columns.extend(Column::lags(of(2), 1..=o.nc));
        columns.extend((3..self.filtered.len()).map(|i| Column::now(of(i))));
        columns.truncate(MOST_COLUMNS - 1);
        let size = columns.len();
        columns.push(Column::now(e));
        let signs: Vec<f64> = (0..size)
            .map(|i| if i < o.na || i >= o.na + o.nb + o.nc + 1 + shapes { 1.0 } else { -1.0 })
            .collect();
        let all = size + 1;
        let mut g = vec![0.0; all * all];
        let weight = &stage.weight[from..to];
        if weight.contains(&0.0) {
            let counted = |column: &Column| -> Vec<f64> {
                column.rows(&(from..to)).iter().zip(weight).map(|(c, w)| c * w).collect()
            };
            let counted: Vec<Vec<f64>> = columns.iter().map(counted).collect();
            let counted: Vec<&[f64]> = counted.iter().map(Vec::as_slice).collect();
            lower(&counted, &mut g, all);
        } else {
            gram(&columns, &(from..to), &mut g, all);
        }
        let r = (0..size).map(|i| -signs[i] * g[size * all + i]).collect();
        let rows = g.chunks(all).zip(&signs);
        let signed = rows.flat_map(|(row, sign)| row.iter().zip(&signs).map(move |(g, s)| g * s * sign));
        (signed.collect(), r)
    }

    /// How e changes with one smooth number, before the filter by 1/C: where nothing says it, by a difference of the stem and of the
    /// shapes.
    fn move_one(
        &mut self,
        data: &Data,
        spec: &mut Spec,
        stage: &Stage,
        counts: &[usize],
        (which, value, width, bounds): (Smooth, f64, f64, (f64, f64)),
        slot: usize,
    ) {
        let (to, o) = (data.split, spec.orders);
        let begin = data.start.index + 1 + o.na.max(o.nk + o.nb - 1);
        let out = &mut self.moved[slot];
        out.clear();
        out.resize(to, 0.0);
        if known_slope(spec, stage, counts, which, begin, out) {
            return;
        }
        let mut h = 0.02 * width;
        if value + h > bounds.1 {
            h = -h;
        }
        put(spec, which, value + h);
        if moves_stem(spec, counts, which) {
            spec.restem(data, &stage.u[..to], &mut self.z, &mut self.dir);
            for (j, b) in spec.linear.b.iter().enumerate() {
                let lag = o.nk + j;
                let (now, was) = (&self.z[begin - lag..to - lag], &stage.z[begin - lag..to - lag]);
                add_two(&mut out[begin..], (-b / h, now), (b / h, was));
            }
        }
        if let Smooth::Knob { term, .. } = which
            && counts[term] > 0
        {
            let at: usize = counts[..term].iter().sum();
            self.columns.clear();
            spec.terms[term].columns(data, stage, &mut self.columns);
            let own = self.columns.iter().zip(&stage.columns[at..]).zip(&spec.linear.gamma[at..]);
            for ((now, was), gamma) in own {
                let by = gamma / h;
                add_two(&mut out[begin..], (-by, &now[begin..to]), (by, &was[begin..to]));
            }
        }
        put(spec, which, value);
    }
}

/// Writes how e changes with a number into `out`, which is 0, from `begin` on; false where that is not known without a difference.
fn known_slope(
    spec: &Spec,
    stage: &Stage,
    counts: &[usize],
    which: Smooth,
    begin: usize,
    out: &mut [f64],
) -> bool {
    let to = out.len();
    match which {
        Smooth::Lag => {
            let element = spec.full_element();
            if element.growth != 0.0 || spec.terms.iter().any(|term| term.changes_stem()) {
                return false;
            }
            // z = x - lag f dir, whatever the lag.
            for (j, b) in spec.linear.b.iter().enumerate() {
                let dir = &stage.dir[begin - spec.orders.nk - j..][..to - begin];
                out[begin..].iter_mut().zip(dir).for_each(|(out, dir)| *out += b * element.f * dir);
            }
        }
        Smooth::Knob { term, at } => {
            if moves_stem(spec, counts, which) {
                return false;
            }
            let first: usize = counts[..term].iter().sum();
            let own = first..first + counts[term];
            let slope = spec.terms[term].slope(at, &spec.linear.gamma[own.clone()], &stage.columns[own]);
            let Some(slope) = slope else { return false };
            out[begin..].iter_mut().zip(&slope[begin..]).for_each(|(out, slope)| *out = -slope);
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::armax::Orders;
    use crate::residual::Settings;
    use crate::residual::effects::{Context, OscillatingLoad, Recognise};
    use crate::residual::fit::minimise;
    use crate::residual::model::Linear;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::{behind_valve, first_order, noise, waves};
    use crate::residual::regress::{Quick, all_errors};

    #[test]
    fn samples_that_do_not_count_are_in_no_product() {
        let data = first_order(600);
        let mut spec = declared(&data, 0.0);
        spec.orders = Orders { na: 1, nb: 1, nc: 0, nk: 1 };
        spec.linear = Linear { a: vec![0.0], b: vec![0.0], ..Linear::default() };
        let (mut stage, counts) = spec.stage(&data);
        let e = data.y.clone();
        let rows = (data.split - data.first) as f64;
        let mut products = |stage: &Stage| {
            Slopes::default().normal_equations(&data, &mut spec, stage, &counts, &e[..data.split], &[])
        };
        let all = products(&stage);
        stage.weight[200..230].fill(0.0);
        let (g, r) = products(&stage);
        assert_eq!((all.0[8], g[8]), (rows, rows - 30.0));
        let plain = |lag: usize| -> f64 {
            (data.first..data.split).map(|k| stage.weight[k] * data.y[k - lag] * data.y[k - 1]).sum()
        };
        // The derivative by a1 is PV a sample before.
        assert!((g[0] - plain(1)).abs() < 1e-9 && (r[0] + plain(0)).abs() < 1e-9, "{g:?} {r:?}");
    }

    /// What is known of a slope is what a difference says: of the lag, and of a load with harmonics.
    #[test]
    fn a_known_slope_is_the_difference() {
        let mut draw = noise(4);
        let load = |k: usize| {
            (0.41 * k as f64).sin() + 0.5 * (0.82 * k as f64).cos() + 0.3 * (1.23 * k as f64).sin()
        };
        let valve = Element { f: 1.0, lag: 0.3, ..Element::default() };
        let data = behind_valve(&waves(1400), valve, 0.8, |k| load(k) + 0.05 * draw());
        let mut spec = declared(&data, 1.0 / data.scale.u);
        minimise(&data, &mut spec, true, 12);
        let (stage, e) = all_errors(&data, &spec);
        let quick = Quick::long_arx(&data, &stage, spec.orders.nk);
        let settings = Settings::default();
        let context = Context::new(&data, (&spec, spec.element), (&stage, &e), &quick, &settings);
        let mut proposed = OscillatingLoad.propose(&context);
        proposed.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        spec.terms.push(proposed.swap_remove(0).term);
        minimise(&data, &mut spec, true, 12);
        spec.element.lag = 0.3;
        let (stage, counts) = spec.stage(&data);
        assert!(counts[0] > 2, "a load with harmonics");
        for (which, value, width, _) in smooths(&spec, true, 0) {
            let begin = data.start.index + 10;
            let mut known = vec![0.0; data.split];
            assert!(known_slope(&spec, &stage, &counts, which, begin, &mut known));
            let h = 1e-4 * width;
            let mut other = spec.clone();
            put(&mut other, which, value + h);
            let errors_of = |spec: &Spec| {
                let plain = Spec {
                    linear: Linear { c: vec![], ..spec.linear.clone() },
                    orders: Orders { nc: 0, ..spec.orders },
                    ..spec.clone()
                };
                all_errors(&data, &plain).1
            };
            let (was, now) = (errors_of(&spec), errors_of(&other));
            let size = known.iter().fold(0.0_f64, |size, known| size.max(known.abs()));
            for k in begin..data.split {
                let difference = (now[k] - was[k]) / h;
                // The second derivative is left.
                assert!((known[k] - difference).abs() < 1e-3 * size, "{k}: {} {difference}", known[k]);
            }
        }
    }
}
