//! What else explains a record in which the declared model saw no friction and the one with the effects does.
//!
//! A load whose shape a few waves describe badly leaves corners, and a stem that rests fits corners. So a verdict that the
//! diagnosis did not give has to beat what a verdict of the diagnosis has to beat: a periodic load of any shape, a valve
//! that runs into a stop, and both.

use super::Kind;
use super::candidate::FRICTION_COST;
use super::effects::wave;
use super::model::{Data, Spec, Stage};
use super::regress::Quick;
use crate::diagnosis::rivals::combs;
use crate::sysid::least_squares::MOST_COLUMNS;
use std::f64::consts::TAU;

/// Lags of y in the long ARX, and of z beyond the longest delay.
const LAGS_Y: usize = 10;
const BEYOND: usize = 4;
/// Harmonics of the loads that are in the model already.
const HARMONICS: [usize; 4] = [5, 14, 24, 40];
/// Least periods in the fitted samples: harmonics of a longer one span every slow signal.
const LEAST_PERIODS: f64 = 4.0;
/// Angular frequency up to which a harmonic is taken (rad/sample).
const HIGHEST: f64 = 3.0;
/// Combs that are tuned, the first step (lines of the spectrum) and how often it is halved.
const TUNED: usize = 3;
const STEP: f64 = 0.15;
const HALVINGS: usize = 8;
/// Clip levels tried on each side, the range of the stem between two of them, and numbers a clip costs.
const LEVELS: usize = 8;
const APART: f64 = 0.06;
const OF_CLIP: usize = 2;

/// `AIC(best rival) - AIC(model)` in the long ARX of the fitted samples, or that of the first rival by which it is no more than
/// `enough`; `period`: of OP's oscillation (samples).
///
/// A rival is the model without its friction, with none or one of its loads left out for one of any shape, or all of them and the
/// stops there are for others.
pub fn ahead(data: &Data, spec: &Spec, period: Option<f64>, enough: f64) -> f64 {
    let mut sound = spec.clone();
    sound.element.f = 0.0;
    let is_of = |at: &usize, kinds: &[Kind]| kinds.contains(&spec.terms[*at].kind());
    let terms = 0..spec.terms.len();
    let loads = terms.clone().filter(|at| is_of(at, &[Kind::OscillatingLoad]));
    let mut left_out: Vec<Vec<usize>> = loads.map(|load| vec![load]).collect();
    left_out.push(terms.filter(|at| is_of(at, &[Kind::OscillatingLoad, Kind::ValveSaturation])).collect());
    left_out.push(Vec::new());
    left_out.sort();
    left_out.dedup();
    let (stage, _) = spec.stage(data);
    let model = Rated { loss: quick(data, &stage).loss, columns: stage.columns.len() };
    let enough = enough + 2.0 * FRICTION_COST;
    let gains = left_out.iter().map(|out| model.ahead_of(data, &sound, out, period, enough));
    least(gains, enough) - 2.0 * FRICTION_COST
}

/// The least of some gains, or the first that is no more than `enough`.
fn least(gains: impl Iterator<Item = f64>, enough: f64) -> f64 {
    let mut least = f64::INFINITY;
    for gain in gains {
        least = gain.min(least);
        if least <= enough {
            break;
        }
    }
    least
}

/// The model with its friction.
struct Rated {
    loss: f64,
    columns: usize,
}

impl Rated {
    /// Its lead, its friction not paid for, over the sound model with a load of any shape in place of those loads.
    fn ahead_of(
        &self,
        data: &Data,
        sound: &Spec,
        left_out: &[usize],
        of_op: Option<f64>,
        enough: f64,
    ) -> f64 {
        let mut rival = sound.clone();
        let kept = |at: &usize| !left_out.contains(at);
        rival.terms = (0..sound.terms.len()).filter(kept).map(|at| sound.terms[at].boxed()).collect();
        let numbers = |at: &usize| sound.terms[*at].knobs();
        let loads = left_out.iter().filter(|at| sound.terms[**at].kind() == Kind::OscillatingLoad);
        let periods: Vec<f64> = loads.flat_map(numbers).map(|w| TAU / w.value).collect();
        let (mut stage, _) = rival.stage(data);
        let rows = (data.split - data.first) as f64;
        let knobs = left_out.iter().flat_map(numbers).count();
        let more = stage.columns.len() as f64 - (self.columns + knobs) as f64;
        let gain =
            |loss: f64, parameters: usize| rows * (loss / self.loss).ln() + 2.0 * (more + parameters as f64);
        let stops = rival.terms.iter().any(|term| term.kind() == Kind::ValveSaturation);
        let (clipped, of_clip) =
            if stops { (gain(quick(data, &stage).loss, 0), 0) } else { clip(data, &mut stage, &gain) };
        if clipped <= enough {
            return clipped;
        }
        let beside = |loss, count| gain(loss, count + of_clip);
        clipped.min(periodic(data, &stage, (&periods, of_op), &beside, enough))
    }
}

/// The long ARX of every delay.
fn quick(data: &Data, stage: &Stage) -> Quick {
    let (y_lags, z_lags): (Vec<usize>, Vec<usize>) =
        ((1..=LAGS_Y).collect(), (1..=data.max_delay + BEYOND).collect());
    Quick::new(data, stage, &y_lags, &z_lags)
}

/// Gain over the sound loop with a stop on each side, or none, where that is best, and what the stops cost; the stem of
/// `stage` is left behind them.
fn clip(data: &Data, stage: &mut Stage, gain: &dyn Fn(f64, usize) -> f64) -> (f64, usize) {
    let z = stage.z.clone();
    let fitted = &z[data.first..data.split];
    let (low, high) =
        fitted.iter().fold((fitted[0], fitted[0]), |(low, high), z| (low.min(*z), high.max(*z)));
    let step = APART * (high - low);
    let mut best = (gain(quick(data, stage).loss, 0), 0, (low, high));
    for (i, j) in (1..LEVELS * LEVELS).map(|at| (at / LEVELS, at % LEVELS)) {
        let ends = (low + step * i as f64, high - step * j as f64);
        stage.z.iter_mut().zip(&z).for_each(|(clipped, z)| *clipped = z.max(ends.0).min(ends.1));
        let clipped = gain(quick(data, stage).loss, OF_CLIP);
        if clipped < best.0 {
            best = (clipped, OF_CLIP, ends);
        }
    }
    let (gained, count, ends) = best;
    stage.z.iter_mut().zip(&z).for_each(|(clipped, z)| *clipped = z.max(ends.0).min(ends.1));
    (gained, count)
}

/// Gain over the loop of `stage` with a periodic load of any shape.
fn periodic(
    data: &Data,
    stage: &Stage,
    (loads, of_op): (&[f64], Option<f64>),
    gain: &dyn Fn(f64, usize) -> f64,
    enough: f64,
) -> f64 {
    let quick = quick(data, stage);
    let rows = (data.split - data.first) as f64;
    let most = (MOST_COLUMNS - quick.theta.len()) / 2;
    let at = |w: f64, harmonics: usize| {
        let below = (1..=harmonics.min(most)).map(|h| w * h as f64).take_while(|w| *w < HIGHEST);
        let shapes: Vec<Vec<f64>> = below.flat_map(|w| wave(w, data.len())).collect();
        let shapes: Vec<&[f64]> = shapes.iter().map(Vec::as_slice).collect();
        // The frequency is a number, too.
        gain(quick.with(&shapes).0, shapes.len() + 1)
    };
    let mut sought = combs(&quick.residual(), of_op);
    sought.extend(loads.iter().flat_map(|period| HARMONICS.map(|harmonics| (*period, harmonics))));
    let mut found: Vec<(f64, f64, usize)> = Vec::new();
    for (period, harmonics) in sought.into_iter().filter(|(period, _)| LEAST_PERIODS * period <= rows) {
        let gained = at(TAU / period, harmonics);
        if gained <= enough {
            return gained;
        }
        found.push((gained, TAU / period, harmonics));
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let tuned = found.into_iter().take(TUNED).map(|(mut least, mut w, harmonics)| {
        for halved in 0..HALVINGS {
            let step = STEP * TAU / rows * 0.5_f64.powi(halved as i32);
            for other in [w - step, w + step] {
                let gained = at(other, harmonics);
                if gained < least {
                    (least, w) = (gained, other);
                }
            }
        }
        least
    });
    least(tuned, enough)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::Settings;
    use crate::residual::effects::{Context, OscillatingLoad, Recognise};
    use crate::residual::fit::minimise;
    use crate::residual::model::Element;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::{behind_valve, noise, waves};
    use crate::residual::regress::all_errors;

    /// What a verdict needs.
    const NEEDED: f64 = 20.0;

    /// A process behind `valve` with `load` added to PV, and the model with friction `f` (OP) and dynamics estimated.
    fn fitted(valve: Element, f: f64, load: impl Fn(usize) -> f64) -> (Data, Spec) {
        let mut draw = noise(3);
        let data = behind_valve(&waves(1400), valve, 0.8, |k| load(k) + 0.02 * draw());
        let mut spec = declared(&data, f / data.scale.u);
        minimise(&data, &mut spec, false, 12);
        (data, spec)
    }

    /// `AIC(best rival) - AIC(model)` with the search ended at no rival; one that ends says the same of any bar.
    fn ahead_of_all(data: &Data, spec: &Spec, period: Option<f64>) -> f64 {
        let full = ahead(data, spec, period, f64::NEG_INFINITY);
        for enough in [full - 1.0, full + 1e-9, full + 1.0, full + 100.0, full.abs() + 1000.0, NEEDED] {
            let first = ahead(data, spec, period, enough);
            assert!(first >= full && (first <= enough) == (full <= enough), "{enough}: {first} {full}");
        }
        full
    }

    #[test]
    fn a_valve_that_sticks_is_ahead_of_every_rival() {
        let valve = Element { f: 1.0, ..Element::default() };
        let (data, spec) = fitted(valve, 1.0, |_| 0.0);
        let ahead = ahead_of_all(&data, &spec, Some(TAU / 0.11));
        assert!(ahead > 10.0 * NEEDED, "{ahead}");
    }

    /// What two loads or a slow one explain, their rival explains, too: a model without friction is ahead of none.
    #[test]
    fn a_model_without_friction_is_never_ahead() {
        for periods in [vec![37.0, 21.7], vec![300.0], vec![900.0]] {
            let load = |k: usize| periods.iter().map(|p| 0.4 * (k as f64 * TAU / p).sin()).sum::<f64>();
            let (data, mut spec) = fitted(Element::default(), 0.0, load);
            let context = |spec: &Spec| (spec.stage(&data).0, all_errors(&data, spec).1);
            for _ in &periods {
                let (stage, e) = context(&spec);
                let quick = Quick::long_arx(&data, &stage, spec.orders.nk);
                let settings = Settings::default();
                let context = Context::new(&data, (&spec, spec.element), (&stage, &e), &quick, &settings);
                let best = OscillatingLoad.propose(&context).into_iter().next().expect("a line is there");
                spec.terms.push(best.term);
                minimise(&data, &mut spec, false, 12);
            }
            let ahead = ahead_of_all(&data, &spec, None);
            assert!(ahead < 0.0, "{periods:?}: {ahead}");
        }
    }

    #[test]
    fn a_square_load_is_not_friction() {
        let square = |k: usize| if (k as f64 * TAU / 57.3).sin() > 0.0 { 0.6 } else { -0.6 };
        let (data, spec) = fitted(Element::default(), 1.0, square);
        let sound = declared(&data, 0.0);
        let linear = quick(&data, &sound.stage(&data).0).loss;
        let ahead = ahead_of_all(&data, &spec, None);
        let rows = (data.split - data.first) as f64;
        let of_linear = rows * (linear / quick(&data, &spec.stage(&data).0).loss).ln();
        // Edges that forty harmonics draw and no linear loop can.
        assert!(ahead < 0.0 && ahead < of_linear - 10.0 * NEEDED, "{ahead}, linear {of_linear}");
    }

    #[test]
    fn a_stop_is_not_friction() {
        let op: Vec<f64> = waves(1400);
        let stopped: Vec<f64> = op.iter().map(|u| u.min(52.0)).collect();
        let mut data = behind_valve(&op, Element::default(), 0.8, |_| 0.0);
        let truth = behind_valve(&stopped, Element::default(), 0.8, |_| 0.0);
        data.y = truth.y;
        let mut spec = declared(&data, 1.0 / data.scale.u);
        minimise(&data, &mut spec, false, 12);
        let ahead = ahead_of_all(&data, &spec, None);
        assert!(ahead < -10.0 * NEEDED, "{ahead}");
    }
}
