//! What the effects propose to a model, rated by the long ARX.

use super::effects::{ALL, Context, Proposal, Recognise};
use super::fit::minimise;
use super::model::{Element, Spec};
use super::regress::{Quick, all_errors};
use super::{Kind, Settings};

/// Evidence of the model without friction below which no effect takes friction's place and bands are sought beside a load, and above
/// which any effect may (-).
const CERTAIN_FRICTION: f64 = -100.0;
const DOUBTFUL_FRICTION: f64 = -40.0;
/// Gain of the long ARX below which bands are not sought again, until its likelihood has grown by so much (-).
const QUIET: f64 = 4.0;
const LOUDER: f64 = 1000.0;
/// Loads that are a wave or a tag.
pub const SHAPED: [Kind; 2] = [Kind::OscillatingLoad, Kind::MeasuredDisturbance];
/// Effects on the band to cross.
pub const BANDS: [Kind; 2] = [Kind::AsymmetricFriction, Kind::FrictionDrift];

/// A proposal with its gain in the long ARX, less what its numbers and the search for them cost.
pub type Rated = (f64, Proposal);

/// What the effects propose that act beside the valve.
pub fn loads(context: &Context<'_>) -> Vec<Rated> {
    of(context, is_load)
}

/// What the others propose with the model's valve; and those on the stem's way to the process also without it, or with the
/// likely one where it has none: where friction may be mistaken, all without it. `quiet`: loss of the long ARX at which bands
/// that differ or grow promised nothing.
pub fn others(context: &Context<'_>, quiet: &mut Option<f64>) -> Vec<Rated> {
    let Context { data, spec, likely, settings, .. } = *context;
    let none = Element { f: 0.0, ..spec.element };
    let element = if spec.element.f > 0.0 { none } else { likely };
    let other = (element != spec.element).then(|| {
        let mut other = Spec { element, ..spec.clone() };
        minimise(data, &mut other, true, 8);
        let (stage, e) = all_errors(data, &other);
        let without = (element.f == 0.0).then(|| context.judge().gain(data, &stage, other.orders.nk));
        (other, stage, e, without)
    });
    let without = other.as_ref().and_then(|other| other.3);
    let loaded = spec.terms.iter().any(|term| SHAPED.contains(&term.kind()));
    let known = settings.known.iter().any(|(kind, _)| BANDS.contains(kind));
    // Beside such a load a valve that hardly shows does not show how its bands differ.
    let blurred = loaded && !known && without.is_none_or(|gain| gain > CERTAIN_FRICTION);
    let still =
        blurred || quiet.is_some_and(|loss| context.rows() * (loss / context.quick.loss).ln() < LOUDER);
    let fitting =
        |effect: &dyn Recognise| !(is_load(effect) || effect.direct() || still && effect.on_the_band());
    let mut out = of(context, fitting);
    if !still {
        let bands = out.iter().filter(|(_, p)| BANDS.contains(&p.term.kind()));
        let most = bands.map(|(rated, _)| *rated).max_by(f64::total_cmp);
        // Without a valve nothing was sought that could promise anything.
        let promised = likely.f <= 0.0 || most.is_some_and(|most| most >= QUIET);
        *quiet = (!promised).then_some(context.quick.loss);
    }
    let Some((other, stage, e, _)) = other else { return out };
    if without.is_some_and(|gain| gain < CERTAIN_FRICTION) {
        return out;
    }
    let quick = Quick::long_arx(data, &stage, other.orders.nk);
    let its = Context::new(data, (&other, likely), (&stage, &e), &quick, settings);
    let any = without.is_some_and(|gain| gain > DOUBTFUL_FRICTION);
    let any_other = |effect: &dyn Recognise| any && !effect.direct() && !effect.on_the_band();
    let fitting = ALL.iter().filter(|effect| effect.on_the_stem() || any_other(**effect));
    let others = fitting.flat_map(|effect| effect.propose(&its)).filter(|p| asked(settings, p));
    out.extend(others.map(|p| rated(context, Proposal { element: Some(other.element), ..p })));
    out
}

/// Whether an effect acts beside the valve: nothing that friction could be mistaken for.
fn is_load(effect: &dyn Recognise) -> bool {
    !(effect.direct() || effect.on_the_stem() || effect.on_the_band())
}

/// What effects of a sort propose with the model's valve.
fn of(context: &Context<'_>, which: impl Fn(&dyn Recognise) -> bool) -> Vec<Rated> {
    let effects = ALL.iter().filter(|effect| which(**effect));
    let proposed = effects.flat_map(|effect| effect.propose(context));
    proposed.filter(|p| asked(context.settings, p)).map(|p| rated(context, p)).collect()
}

fn asked(settings: &Settings, p: &Proposal) -> bool {
    settings.only.is_none_or(|only| p.term.kind() == only)
}

fn rated(context: &Context<'_>, p: Proposal) -> Rated {
    (context.rows() * (context.quick.loss / p.loss).ln() - cost(context.settings, &p), p)
}

/// What a proposal's numbers and the search for it cost in AIC.
pub fn cost(settings: &Settings, p: &Proposal) -> f64 {
    let known =
        settings.known.iter().any(|(kind, tag)| *kind == p.term.kind() && tag.as_deref() == p.term.tag());
    2.0 * p.parameters + if known { 0.0 } else { 2.0 * p.tried.max(1.0).ln() }
}
