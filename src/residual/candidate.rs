//! A model on trial, its friction scanned anew and its rough numbers tuned.

use super::Kind;
use super::climb::{CLIMBS, climb};
use super::evidence::Judge;
use super::fit::{minimise, minimise_towards};
use super::model::{Data, Element, Spec};
use super::regress::restructure;
use super::run::held_out;
use super::scan::scan_friction;
use super::search::{banded, even};
use super::staged::jumps;

/// Numbers that friction costs: f, its lag, the choice of the element.
pub const FRICTION_COST: f64 = 4.0;
/// Values of f in a scan.
const SCAN: usize = 24;
/// AIC behind the best up to which a structure of its own is sought for an element.
const WITHIN: f64 = 60.0;
/// Least decrease of AIC that brings friction into a model without.
const WORTH: f64 = 15.0;

/// Gain of the long ARX from which a model without friction is not tried in the place of one with (-).
const BEYOND_DOUBT: f64 = 200.0;

/// A model with what the selection knows of it.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The model.
    pub spec: Spec,
    /// Penalised AIC.
    pub aic: f64,
    /// Penalty of its terms, searches included.
    pub paid: f64,
    /// The best element of the last scan over f, whether adopted or not.
    pub likely: Element,
}

impl Candidate {
    /// Its AIC, `paid` for the terms included.
    pub fn new(data: &Data, spec: Spec, paid: f64) -> Self {
        let n = (data.split - data.first) as f64;
        let linear = (spec.orders.na + spec.orders.nb + spec.orders.nc + spec.linear.gamma.len()) as f64;
        let friction = if spec.element.f > 0.0 { FRICTION_COST } else { 0.0 };
        let aic = n * spec.loss.ln() + 2.0 * (linear + friction) + paid;
        let likely = spec.element;
        Self { spec, aic, paid, likely }
    }

    /// The model estimated with another valve; `lag_too`: its lag, too.
    pub fn with_valve(&self, data: &Data, element: Element, lag_too: bool) -> Self {
        let mut spec = Spec { element, ..self.spec.clone() };
        minimise(data, &mut spec, lag_too, 12);
        restructure(data, &mut spec, lag_too, 3);
        Self::new(data, spec, self.paid)
    }
}

/// Which valves are sought where there is friction.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Sought {
    /// Of the kind there is; where there is none, any that a scan promises.
    Kept,
    /// Of any kind, by AIC and the long model alike.
    Any {
        /// Stems of slips with dynamics of their own, too.
        slips: bool,
        /// All paths with dynamics of their own, too.
        paths: bool,
    },
}

/// The model with friction scanned anew: the better of what it has, another f, and none.
pub fn with_friction(data: &Data, base: Candidate, sought: Sought, tried: &mut usize) -> Candidate {
    let mut best = base.clone();
    let known = held_out(data, &base.spec);
    let (sticky, kept) = (base.spec.element.f > 0.0, sought == Sought::Kept);
    let scanned = scan_friction(data, &base.spec, SCAN, kept && sticky);
    let mut elements = scanned.best;
    let likely = elements.first().copied().unwrap_or(base.spec.element);
    if kept && !scanned.promising {
        elements.clear();
    }
    let judge = (sticky && !kept).then(|| Judge::new(data, &base.spec.stage(data).0, base.spec.orders.nk));
    if let (Some(judge), Sought::Any { slips, paths }) = (&judge, sought) {
        elements.extend(even(data, &base.spec));
        elements.extend(slips.then(|| jumps(data, &base.spec)).flatten());
        let like = scanned.of_family.into_iter().filter(|_| paths);
        elements.extend(like.filter_map(|like| among_paths(data, &base.spec, judge, like)));
    }
    if !(sticky && scanned.gain > BEYOND_DOUBT) {
        elements.push(Element { f: 0.0, ..base.spec.element });
    }
    if sticky {
        elements.push(Element { lag: 0.4, ..base.spec.element });
    }
    let mut most = 0.0;
    for element in elements {
        let mut spec = Spec { element, ..base.spec.clone() };
        minimise(data, &mut spec, true, 8);
        *tried += 1;
        // Another structure gains a few units, not what a wrong element costs.
        if Candidate::new(data, spec.clone(), base.paid).aic < best.aic + WITHIN {
            restructure(data, &mut spec, true, 2);
            *tried += 2;
        }
        let other = Candidate::new(data, spec, base.paid);
        if let Some(judge) = &judge {
            let gain = judge.gain(data, &other.spec.stage(data).0, other.spec.orders.nk);
            let both = 0.5 * (base.aic - other.aic + gain);
            if both > most && held_out(data, &other.spec).0 < 1.05 * known.0 {
                best = other;
                most = both;
            }
            continue;
        }
        // Friction where there was none has to be worth it, and none may cost what was held out.
        let worth = if best.spec.element.f == 0.0 && other.spec.element.f > 0.0 { WORTH } else { 0.0 };
        if other.aic + worth < best.aic && held_out(data, &other.spec).0 < 1.05 * known.0 {
            best = other;
        }
    }
    best.likely = if best.spec.element.f > 0.0 { best.spec.element } else { likely };
    best
}

/// The best valve of the family of `like` among all paths, with dynamics of its own: those of another would hide it.
fn among_paths(data: &Data, spec: &Spec, judge: &Judge, like: Element) -> Option<Element> {
    let with = |element| Spec { element, ..spec.clone() };
    let next = |element| {
        let element = *banded(data, &with(element), [(0.0, 0.0)].into_iter(), false).first()?;
        Some((judge.gain(data, &with(element).stage(data).0, spec.orders.nk), element))
    };
    climb((f64::NEG_INFINITY, like), 1 + CLIMBS, next).last().map(|found| found.1)
}

/// Tries the numbers of the last term in which the error is not smooth, on finer and finer steps.
pub fn tune(data: &Data, spec: &mut Spec, tried: &mut usize) {
    let Some(last) = spec.terms.len().checked_sub(1) else { return };
    let knobs = spec.terms[last].knobs();
    let spec_kind = spec.terms[last].kind();
    for (at, knob) in
        knobs.iter().enumerate().filter(|(_, k)| !k.smooth || spec_kind == Kind::ValveSaturation)
    {
        let mut step = knob.step;
        for _ in 0..3 {
            for sign in [-1.0, 1.0] {
                for _ in 0..3 {
                    let value = spec.terms[last].knobs()[at].value + sign * step;
                    if !(knob.bounds.0..=knob.bounds.1).contains(&value) {
                        break;
                    }
                    let mut other = spec.clone();
                    other.terms[last].set(at, value);
                    minimise_towards(data, &mut other, true, (last, 2), spec.loss);
                    *tried += 1;
                    if other.loss >= spec.loss {
                        break;
                    }
                    *spec = other;
                }
            }
            step *= 0.5;
        }
    }
}
