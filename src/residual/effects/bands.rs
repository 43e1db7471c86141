//! Bands that differ or grow, sought together with the valve they belong to.
//!
//! The f that suits one constant band may be anywhere between the bands there are, its lag makes up for what the model lacks,
//! and its kind is that which looks most like bands that are not one. So a few f, lags and kinds are rated with each value
//! of the band's number by the long ARX's loss; the best are sought closely, and judged.

use super::{Context, Proposal};
use crate::residual::Kind;
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
/// Most proposals.
const MOST: usize = 2;
/// Least value that is no other valve.
const LEAST: f64 = 0.1;

/// A valve with its band's number: the long ARX's loss, the element, the number.
type Rated = (f64, Element, f64);

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

impl Bands<'_> {
    /// The terms worth a full fit, each with its valve.
    pub fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let mut trial = c.spec.clone();
        trial.terms.push(self.term.boxed());
        let last = trial.terms.len() - 1;
        let sought =
            self.scanned(c, &trial).into_iter().map(|(_, element, value)| (element, value, Reach::Near));
        let sought: Vec<_> = sought.chain(self.among_paths(c)).collect();
        let mut rated: Vec<Rated> = Vec::new();
        for (element, value, reach) in sought {
            let (element, settled) = settle(c.data, &trial, element, Some(value), reach);
            let value = settled.unwrap_or(value);
            trial.element = element;
            trial.terms[last].set(0, value);
            let gain = c.judge().gain(c.data, &trial.stage(c.data).0, c.spec.orders.nk);
            rated.push((c.quick.loss * (-gain / c.rows()).exp(), element, value));
        }
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        let ways = if self.grow { PATHS } else { (KINDS.len() + 2) as f64 * f64::from(SCAN) };
        let tried = ways * self.values.len() as f64;
        let proposal = |(loss, element, value): Rated| {
            let mut term = self.term.boxed();
            term.set(0, value);
            Proposal { term, loss, parameters: 1.0, tried, element: Some(element) }
        };
        rated.into_iter().filter(|r| r.0.is_finite()).take(MOST).map(proposal).collect()
    }

    /// The best of the likely kind and the best of another: a turn missed by one costs more squares than a wrong value.
    fn scanned(&self, c: &Context<'_>, trial: &Spec) -> Vec<Rated> {
        let own = (c.likely.resume, c.likely.slips);
        let kinds = [0.0, 0.5].into_iter().map(|lag| (lag, own.0, own.1)).chain(KINDS);
        let kinds: Vec<(f64, f64, bool)> = kinds.collect();
        let mut scan = Scan::new(c.data, trial);
        let mut rated: Vec<Rated> = Vec::new();
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
        let best =
            |likely: bool| rated.iter().find(|(_, e, _)| ((e.resume, e.slips) == own) == likely).copied();
        [best(true), best(false)].into_iter().flatten().collect()
    }

    /// Elements like the likely one but with such bands, nearly right.
    fn among_paths(&self, c: &Context<'_>) -> Vec<(Element, f64, Reach)> {
        let likely = Spec { element: c.likely, ..c.spec.clone() };
        let own = c.likely;
        let of = |value: &f64| if self.grow { (*value, 0.0) } else { (0.0, *value) };
        let apart = |e: Element| {
            let value = if self.grow { e.growth - own.growth } else { e.skew - own.skew };
            (Element { growth: own.growth, skew: own.skew, ..e }, value, Reach::Close)
        };
        banded(c.data, &likely, self.values.iter().map(of)).into_iter().map(apart).collect()
    }
}
