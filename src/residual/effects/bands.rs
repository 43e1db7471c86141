//! Bands that differ or grow, sought together with the valve they belong to.
//!
//! The f that suits one constant band may be anywhere between the bands there are, its lag makes up for what the model lacks,
//! its kind is that which looks most like bands that are not one, and the dynamics estimated with it are as wrong. So a few
//! f, lags and kinds are rated with each value of the band's number by the long ARX's loss; the best are sought closely, and
//! judged. Where they promise anything, valves of an f near theirs are sought among all paths with the dynamics of those, as long
//! as that gains.

use super::{Context, Proposal};
use crate::residual::Kind;
use crate::residual::climb::{CLIMBS, climb};
use crate::residual::model::{Element, Spec, Term};
use crate::residual::scan::Scan;
use crate::residual::search::{Reach, banded, settle};

/// Ways a stem may go with one band, of those that matter to its errors.
const PATHS: f64 = 300.0;
/// Values of f in a scan together with the band's number.
const SCAN: u32 = 7;
/// Kinds of valve in it beside the likely one: lag, resume threshold, slips.
const KINDS: [(f64, f64, bool); 4] =
    [(0.0, 0.0, false), (0.0, 1.0, false), (0.5, 0.5, false), (0.0, 0.5, true)];
/// Gain of the long ARX below which none of them is sought closely.
const FAR_BEHIND: f64 = -30.0;
/// Gain in the scan below which there are no such bands: beside friction, which a few values miss by far, and beside none.
const LEAST_STICKY: f64 = -150.0;
const LEAST_SOUND: f64 = 3.0;
/// How many of the likely kind, and of the others, are sought closely, each with another value.
const OF_KIND: usize = 2;
/// Gain, by the scan and by the long model, of which one is enough to seek them among all paths where there is no friction.
const MUCH: f64 = 25.0;
const SOME: f64 = 7.0;
/// Gain from which valves are sought again from what was found, from how many, the values about the one there is, and the
/// largest.
const HOPEFUL: f64 = 10.0;
const STARTS: usize = 2;
const NEAR: [f64; 5] = [-0.2, -0.1, 0.0, 0.1, 0.2];
const LARGEST: f64 = 0.9;
/// Value, and share of f, by which two valves differ that are one.
const ALIKE: (f64, f64) = (0.03, 0.01);
/// Most proposals.
const MOST: usize = 2;
/// Least value that is no other valve.
const LEAST: f64 = 0.1;

/// What is sought.
pub struct Bands<'a> {
    /// The term, its first knob the band's number.
    pub term: &'a dyn Term,
    /// Values of the number.
    pub values: &'a [f64],
    /// Whether the number is the growth of f; else it is its difference between directions.
    pub grow: bool,
}

/// Whether the bands of `term`, where they are of that kind, are not those of another valve.
pub fn plausible(term: &dyn Term, kind: Kind) -> bool {
    term.kind() != kind || term.knobs().first().is_none_or(|knob| knob.value.abs() >= LEAST)
}

/// A valve with its band's number.
#[derive(Clone, Copy)]
struct Valve {
    element: Element,
    value: f64,
    /// Gain of likelihood of the long model over all samples (-).
    gain: f64,
}

impl Bands<'_> {
    /// The terms worth a full fit, each with its valve.
    pub fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let (most, scanned) = self.scanned(c);
        let (sound, told) = (c.spec.element.f == 0.0, c.settings.only.is_some());
        let least = if sound { LEAST_SOUND } else { LEAST_STICKY };
        if most < least && !told {
            return Vec::new();
        }
        let closely = |(element, value)| self.closely(c, element, value, Reach::Near);
        let mut found: Vec<Valve> = scanned.into_iter().map(closely).collect();
        if !sound || told || most > MUCH || found.iter().any(|valve| valve.gain > SOME) {
            let plain = Spec { element: c.likely, ..c.spec.clone() };
            found.extend(self.among_paths(c, &plain, self.values, false));
        }
        best_apart(&mut found);
        if found.first().is_some_and(|best| best.gain > HOPEFUL) {
            let starts = found.iter().take(STARTS);
            let higher: Vec<Valve> = starts.flat_map(|start| self.climbed(c, *start)).collect();
            found.extend(higher);
            best_apart(&mut found);
        }
        let tried = PATHS * self.values.len() as f64;
        let proposal = |Valve { element, value, gain }: Valve| {
            let loss = c.quick.loss * (-gain / c.rows()).exp();
            Proposal { term: self.term(value), loss, parameters: 1.0, tried, element: Some(element) }
        };
        found.into_iter().filter(|valve| valve.gain.is_finite()).take(MOST).map(proposal).collect()
    }

    fn term(&self, value: f64) -> Box<dyn Term> {
        let mut term = self.term.boxed();
        term.set(0, value);
        term
    }

    /// The model with that valve and such bands.
    fn with(&self, c: &Context<'_>, element: Element, value: f64) -> Spec {
        let mut spec = Spec { element, ..c.spec.clone() };
        spec.terms.push(self.term(value));
        spec
    }

    /// Sought closely, and judged.
    fn closely(&self, c: &Context<'_>, element: Element, value: f64, reach: Reach) -> Valve {
        let spec = self.with(c, element, value);
        let (element, settled) = settle(c.data, &spec, element, Some(value), reach);
        let value = settled.unwrap_or(value);
        let (stage, _) = self.with(c, element, value).stage(c.data);
        Valve { element, value, gain: c.judge().gain(c.data, &stage, c.spec.orders.nk) }
    }

    /// The best of the likely kind and of others: a turn missed by one costs more squares than a wrong value; with the most gained.
    fn scanned(&self, c: &Context<'_>) -> (f64, Vec<(Element, f64)>) {
        let own = (c.likely.resume, c.likely.slips);
        let kinds = [0.0, 0.5].into_iter().map(|lag| (lag, own.0, own.1)).chain(KINDS);
        let kinds: Vec<(f64, f64, bool)> = kinds.collect();
        let mut scan = Scan::new(c.data, &self.with(c, c.likely, 0.0));
        let mut rated: Vec<(f64, Element, f64)> = Vec::new();
        for &value in self.values {
            let about = [1.0, 1.0 / (1.0 + value.abs()), 1.0 / (1.0 - 0.5 * value.abs())];
            let about = about.into_iter().map(|share| share * c.likely.f);
            let grid = (1..=SCAN).map(|i| c.data.f_top * (f64::from(i) / f64::from(SCAN)).powf(1.5));
            let of = |f| {
                kinds.iter().map(move |&(lag, resume, slips)| Element { f, lag, resume, slips, ..c.likely })
            };
            let elements: Vec<Element> = about.chain(grid).flat_map(of).collect();
            scan.set_last(value);
            let losses = scan.rate(&elements).into_iter().zip(elements);
            rated.extend(losses.filter_map(|(loss, element)| Some((loss?, element, value))));
        }
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        let gain = |loss: f64| c.rows() * (c.quick.loss / loss).ln();
        let most = rated.first().map_or(f64::NEG_INFINITY, |(loss, ..)| gain(*loss));
        rated.retain(|(loss, ..)| gain(*loss) > FAR_BEHIND);
        let mut seen: Vec<(bool, f64)> = Vec::new();
        rated.retain(|(_, element, value)| {
            let likely = (element.resume, element.slips) == own;
            let new = !seen.contains(&(likely, *value))
                && seen.iter().filter(|other| other.0 == likely).count() < OF_KIND;
            if new {
                seen.push((likely, *value));
            }
            new
        });
        (most, rated.into_iter().map(|(_, element, value)| (element, value)).collect())
    }

    /// The best with such bands among all paths, with the dynamics of `spec`, nearly right, sought closely; `any`: of any kind
    /// and an f near that.
    fn among_paths(&self, c: &Context<'_>, spec: &Spec, values: &[f64], any: bool) -> Vec<Valve> {
        let own = spec.element;
        let of = |value: &f64| if self.grow { (*value, 0.0) } else { (0.0, *value) };
        let apart = |e: Element| {
            let value = if self.grow { e.growth - own.growth } else { e.skew - own.skew };
            let element = Element { growth: own.growth, skew: own.skew, ..e };
            self.closely(c, element, value, Reach::Close)
        };
        banded(c.data, spec, values.iter().map(of), any).into_iter().map(apart).collect()
    }

    /// Valves of any kind with bands near those found, as long as the dynamics that go with the last show a better one.
    fn climbed(&self, c: &Context<'_>, start: Valve) -> Vec<Valve> {
        let next = |best: Valve| {
            let near = NEAR.into_iter().map(|by| best.value + by).filter(|value| value.abs() <= LARGEST);
            let near: Vec<f64> = near.collect();
            let next = self.among_paths(c, &self.with(c, best.element, best.value), &near, true).into_iter();
            next.max_by(|a, b| a.gain.total_cmp(&b.gain)).map(|next| (next.gain, next))
        };
        climb((start.gain, start), CLIMBS, next).into_iter().map(|(_, valve)| valve).collect()
    }
}

/// The best first, and of those next to one another that are one valve the best.
fn best_apart(found: &mut Vec<Valve>) {
    found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    found.dedup_by(|b, a| {
        a.element.slips == b.element.slips
            && (a.value - b.value).abs() < ALIKE.0
            && (a.element.f / b.element.f - 1.0).abs() < ALIKE.1
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::Settings;
    use crate::residual::effects::Recognise;
    use crate::residual::effects::asymmetric_friction::AsymmetricFriction;
    use crate::residual::fit::minimise;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::{behind_valve, noise, waves};
    use crate::residual::regress::{Quick, all_errors};

    /// What is proposed of a process behind `valve`, by a model with friction `f` (OP) or, where that is none, one of 1 at hand.
    fn proposed(valve: Element, f: f64, only: Option<Kind>) -> Vec<Proposal> {
        let mut draw = noise(11);
        let data = behind_valve(&waves(1400), valve, 0.8, |_| 0.05 * draw());
        let mut spec = declared(&data, f / data.scale.u);
        minimise(&data, &mut spec, false, 12);
        let (stage, e) = all_errors(&data, &spec);
        let quick = Quick::long_arx(&data, &stage, spec.orders.nk);
        let settings = Settings { only, ..Settings::default() };
        let likely = Element { f: 1.0 / data.scale.u, ..spec.element };
        let context = Context::new(&data, (&spec, likely), (&stage, &e), &quick, &settings);
        AsymmetricFriction.propose(&context)
    }

    #[test]
    fn bands_are_sought_where_a_scan_does_not_rule_them_out_or_they_are_known() {
        let (skewed, none) = (Element { f: 1.0, skew: 0.4, ..Element::default() }, Element::default());
        let best = proposed(skewed, 1.0, None);
        let value = best.first().map(|p| p.term.knobs()[0].value);
        assert!(value.is_some_and(|value| (value - 0.4).abs() < 0.1), "{value:?}");
        assert!(proposed(none, 0.0, None).is_empty());
        assert!(!proposed(none, 0.0, Some(Kind::AsymmetricFriction)).is_empty());
    }
}
