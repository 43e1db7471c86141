//! Forward selection: one effect at a time, friction and dynamics estimated again with each.

use super::candidate::{Candidate, tune, with_friction};
use super::direct::{add_direct, is_repaired, not_worse};
use super::effects::{ALL, Context, Proposal};
use super::findings::{Outcome, report};
use super::fit::{free_fitted, held_out, minimise};
use super::model::{Data, Element, Spec};
use super::pose::{declared, pose};
use super::regress::{Quick, all_errors, restructure, structures};
use super::search::growing;
use super::{Findings, Kind, Settings, Stem};
use crate::diagnosis::{Diagnosis, Preparation, Verdict};
use crate::signal::Window;
use std::cell::OnceCell;

/// Candidates fitted in full at each step, those of them that may be of one kind, and fitted with friction scanned anew.
const FULL: usize = 18;
const FEW: usize = 3;
const FINAL: usize = 5;
/// Gain of the long ARX below which a proposal is not pursued (-).
const HOPELESS: f64 = -30.0;
/// The same of those whose gain is already known, and which they are.
const LITTLE: f64 = -4.0;
const EXACT: [Kind; 4] =
    [Kind::OscillatingLoad, Kind::MeasuredDisturbance, Kind::Drift, Kind::StaticNonlinearity];
/// Evidence below which another friction does not save an effect, and how far behind the best it is not worth it (-).
const LOST: f64 = 1.0;
const FAR_BEHIND: f64 = 20.0;
/// Gain of likelihood for which the model without an effect has its friction sought once more (-).
const CHANGED: f64 = 1.0;
/// Structures fitted when the dynamics are estimated once more.
const REFIT: usize = 16;
/// Loss, as a share of the declared model's, up to which a structure is as good.
const AS_GOOD: f64 = 1.005;
/// Effects that no valve that is off looks like; a clip is not among them.
const UNLIKE_A_VALVE: [Kind; 5] = [
    Kind::StaticNonlinearity,
    Kind::GainChange,
    Kind::DeadTimeChange,
    Kind::AsymmetricFriction,
    Kind::FrictionDrift,
];
/// Evidence that the others need more where there is friction (-).
const STICKY: f64 = 5.0;
/// Effects on the band to cross.
const BANDS: [Kind; 2] = [Kind::AsymmetricFriction, Kind::FrictionDrift];
/// Effects that the held-out samples see only as what was fitted goes on: its rate, level or time may be off a little.
const LATER: [Kind; 5] =
    [Kind::LoadStep, Kind::Drift, Kind::GainChange, Kind::DeadTimeChange, Kind::FrictionDrift];
/// Evidence more that others need where held-out samples are less likely with them, although they run free nearer (-).
const DISAGREES: f64 = 8.0;
/// Evidence less that is needed where the held-out samples leave no doubt and run free nearer than this share (-).
const CLEAR: (f64, f64) = (4.0, 0.75);
/// Evidence, in parts of what is needed, for which any gain of the free run is enough.
const OVERWHELMING: f64 = 3.0;
/// The same where they are hardly more likely (-).
const UNDECIDED: f64 = 3.0;
/// Evidence by which another valve takes the place of the one there is, and how often in a trace (-).
const OTHER_VALVE: f64 = 20.0;
const LOOKS: usize = 1;
/// Evidence that a free run nearer by a factor of e is worth: when effects are accepted, and when they are compared (-).
const NEARER: f64 = 3.0;
const AHEAD: f64 = 10.0;
/// Gain of likelihood on the held-out samples, or held-out free-run error as a share of that without, that is no chance (-).
const LEAST_HELD: f64 = 2.0;
const LEAST_NEARER: f64 = 0.98;
/// Evidence by which a change of gain, which comes with a step of its own, must be ahead, and as a share of a step's: a stem
/// that is off looks like a change of gain beside one.
const NESTED: f64 = 5.0;
const OF_STEP: f64 = 0.5;
/// Least gain of a kinetic lag: every valve model but the paper's own has one.
const LEAST_SLIP: f64 = 7.0;
/// The same where the declared dynamics are kept for the free run.
const CERTAIN_SLIP: f64 = 30.0;
/// Gain of likelihood on the held-out samples that leaves no doubt (-).
const DOUBTLESS: f64 = 15.0;

/// See [`super::trace`].
pub fn trace(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    let mut findings = trace_one(window, diagnosis, settings)?;
    findings.stem = window.mv.as_ref().and_then(|mv| stem(window, mv, settings));
    Some(findings)
}

/// OP to the measured stem: no process hides the valve there.
fn stem(window: &Window, mv: &[f64], settings: &Settings) -> Option<Stem> {
    let window = Window { pv: mv.to_vec(), mv: None, sp: None, ..window.clone() };
    let unknown = Diagnosis {
        verdict: Verdict::NoStiction,
        reason: "the stem follows OP".into(),
        preparation: Preparation::default(),
        oscillation: None,
        estimate: None,
        residual: None,
        window: None,
    };
    let findings = trace_one(&window, &unknown, settings)?;
    Some(Stem { friction: findings.friction_after, findings: Some(Box::new(findings)) })
}

fn trace_one(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    let data = pose(window)?;
    let f = diagnosis.estimate.as_ref().map_or(0.0, |e| e.f) / data.scale.u;
    let declared = declared(&data, f);
    let mut tried = 1;
    let mut base = Candidate::new(&data, declared.clone(), 0.0);
    let mut added: Vec<(Kind, f64)> = Vec::new();
    add_direct(&data, settings, &mut base, &mut added);
    base = with_friction(&data, base, false, &mut tried);
    let at_start = held_out(&data, &declared);
    let mut looks = LOOKS;
    while added.len() < settings.most_effects && tried < settings.most_fits {
        // The model without has the same chances as those with an effect: what a second look finds is no effect's gain.
        if looks == LOOKS || !added.is_empty() {
            let next = again(&data, base.clone(), &mut tried);
            if added.is_empty() || held_out(&data, &next.spec).1 <= at_start.1 {
                base = next;
            }
        }
        let (found, valve) = step(&data, settings, &base, (&declared, at_start), &mut tried);
        if let Some(element) = valve
            && looks > 0
        {
            looks -= 1;
            base = with_valve(&data, &base, element);
            continue;
        }
        let Some(next) = found else { break };
        added.push((next.kind, next.evidence));
        base = next.candidate;
    }
    base = Candidate { likely: base.likely, ..Candidate::new(&data, base.spec, base.paid) };
    slip_jump(&data, &mut base, (&declared, at_start), &mut added);
    base = not_worse(&data, &declared, base, at_start);
    let refit = if added.is_empty() { longer_sighted(&data, &declared) } else { declared.clone() };
    Some(report(&data, diagnosis, settings, Outcome { declared, base, refit, added, tried }))
}

/// The model estimated once more from where it is.
fn again(data: &Data, base: Candidate, tried: &mut usize) -> Candidate {
    let mut spec = base.spec.clone();
    minimise(data, &mut spec, true, 8);
    restructure(data, &mut spec, true, 3);
    let likely = base.likely;
    let rows = (data.split - data.first) as f64;
    if rows * (base.spec.loss / spec.loss).ln() < CHANGED {
        return base;
    }
    let next =
        with_friction(data, Candidate { likely, ..Candidate::new(data, spec, base.paid) }, true, tried);
    if next.aic < base.aic { next } else { base }
}

/// The model with dynamics that run free better than the declared model where there are any, and its held-out errors.
fn not_beyond(
    data: &Data,
    spec: Spec,
    (declared, at_start): (&Spec, (f64, f64)),
    judged: (f64, f64),
) -> (Spec, (f64, f64)) {
    let error = held_out(data, &spec);
    if error.1 < at_start.1 {
        return (spec, error);
    }
    // One step ahead its dynamics may be as good as others that run free better.
    let mut spec = longer_sighted(data, &spec);
    let mut error = held_out(data, &spec);
    if error.1 >= at_start.1 {
        error = with_free(data, declared, at_start, judged, &mut spec).unwrap_or(error);
    }
    (spec, error)
}

/// Another model for the free run: the declared model's A and C under this one's stem and shapes, with the shorter of both
/// delays, where that is not worse than the declared model; else, where the held-out samples leave no doubt one step ahead,
/// the declared model itself. Returns the held-out errors, if either will do.
///
/// In closed loop PV may stay nearer to where it was than an open loop under the same load would: the dynamics that are right
/// one step ahead then run free worse than ones that hardly answer to OP.
fn with_free(
    data: &Data,
    declared: &Spec,
    at_start: (f64, f64),
    judged: (f64, f64),
    spec: &mut Spec,
) -> Option<(f64, f64)> {
    let mut slow = Spec { orders: declared.orders, linear: declared.linear.clone(), ..spec.clone() };
    let earlier = slow.orders.nk.saturating_sub(spec.orders.nk);
    slow.linear.b.splice(0..0, vec![0.0; earlier]);
    (slow.orders.nk, slow.orders.nb) = (slow.orders.nk - earlier, slow.orders.nb + earlier);
    slow.linear.gamma = vec![0.0; spec.linear.gamma.len()];
    spec.free = Some(Box::new(slow));
    let error = held_out(data, spec);
    if error.1 < at_start.1 {
        return Some(error);
    }
    let held = likelier(data, judged.0, error.0);
    spec.free = (held > DOUBTLESS && !is_repaired(spec)).then(|| Box::new(declared.clone()));
    spec.free.is_some().then_some((error.0, at_start.1))
}

/// Twice the log-likelihood that held-out errors gain.
fn likelier(data: &Data, before: f64, after: f64) -> f64 {
    2.0 * (data.len() - data.split) as f64 * (before / after).ln()
}

/// The model with another valve.
fn with_valve(data: &Data, base: &Candidate, element: Element) -> Candidate {
    let mut spec = Spec { element, loss: f64::INFINITY, ..base.spec.clone() };
    minimise(data, &mut spec, true, 12);
    restructure(data, &mut spec, true, 3);
    Candidate::new(data, spec, base.paid)
}

/// The model with the structure that runs free best on the fitted samples, of those that are as good one step ahead.
fn longer_sighted(data: &Data, declared: &Spec) -> Spec {
    structures(data, declared, false, REFIT)
        .into_iter()
        .filter(|spec| spec.loss < AS_GOOD * declared.loss)
        .map(|spec| (free_fitted(data, &spec), spec))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(|| declared.clone(), |(_, spec)| spec)
}

/// Names the kinetic lag, which every friction estimate has, where it earns its place.
fn slip_jump(
    data: &Data,
    base: &mut Candidate,
    (declared, at_start): (&Spec, (f64, f64)),
    added: &mut Vec<(Kind, f64)>,
) {
    if base.spec.element.f <= 0.0 || base.spec.element.lag <= 0.0 {
        return;
    }
    let mut without = base.spec.clone();
    without.element.lag = 0.0;
    minimise(data, &mut without, false, 12);
    restructure(data, &mut without, false, 3);
    let plain = held_out(data, &without);
    let without = Candidate::new(data, without, base.paid);
    let mut sound = base.spec.clone();
    sound.element = Element { f: 0.0, lag: 0.0, ..base.spec.element };
    minimise(data, &mut sound, false, 12);
    restructure(data, &mut sound, false, 3);
    let sound = Candidate::new(data, sound, base.paid);
    let gain = without.aic.min(sound.aic) - base.aic;
    if gain <= LEAST_SLIP {
        return;
    }
    let (mut spec, mut now) = not_beyond(data, base.spec.clone(), (declared, at_start), at_start);
    if now.1 > at_start.1 && now.0 < at_start.0 && gain > CERTAIN_SLIP && !is_repaired(&spec) {
        spec.free = Some(Box::new(declared.clone()));
        now.1 = at_start.1;
    }
    if now.1 <= at_start.1 && now.0 < plain.0 * 1.01 && (now.0 < plain.0 || now.1 < plain.1) {
        base.spec = spec;
        added.push((Kind::SlipJump, gain));
    }
}

/// An effect on trial, against the model without it.
struct Trial {
    candidate: Candidate,
    kind: Kind,
    /// Twice the log-likelihood gained over all samples, less what its numbers and the search for them cost.
    evidence: f64,
    /// Decrease of the penalised AIC on the fitted samples.
    gain: f64,
    /// Gain of likelihood on the held-out samples (-).
    held: f64,
    /// Held-out free-run error as a share of that without the effect, and of the declared model's.
    nearer: f64,
    of_start: f64,
}

/// The best effect to add, if any earns its place; and the valve of one on trial, if the model without that effect is far
/// better with it.
fn step(
    data: &Data,
    settings: &Settings,
    base: &Candidate,
    (declared, at_start): (&Spec, (f64, f64)),
    tried: &mut usize,
) -> (Option<Trial>, Option<Element>) {
    let (stage, e) = all_errors(data, &base.spec);
    let quick = Quick::long_arx(data, &stage, base.spec.orders.nk);
    let context = Context::new(data, (&base.spec, base.likely), (&stage, &e), &quick, settings);
    let judge = context.judge();
    let with_effect = |c: &Candidate| -> f64 {
        let (stage, counts) = c.spec.stage(data);
        // Of two delays the linear part has the shorter one.
        let twofold = c.spec.terms.last().is_some_and(|t| t.kind() == Kind::DeadTimeChange);
        let nk = if twofold { base.spec.orders.nk.min(c.spec.orders.nk) } else { base.spec.orders.nk };
        judge.gain(data, &stage, nk) - 2.0 * counts.last().map_or(0.0, |n| *n as f64) - (c.paid - base.paid)
    };
    let with_valve = |element: Element| -> f64 {
        let valve = Spec { element, ..base.spec.clone() };
        judge.gain(data, &valve.stage(data).0, base.spec.orders.nk)
    };
    let likely = Spec { element: context.likely, ..base.spec.clone() };
    let even = OnceCell::new();
    let even = || *even.get_or_init(|| best_even(data, &likely, &with_valve));
    let evidence = |c: &Candidate| -> f64 {
        let gain = with_effect(c);
        if gain < LOST || c.spec.element == base.spec.element {
            return gain;
        }
        // The valve that was found with the effect may be the whole gain, or one as closely sought without it.
        let bands = c.spec.terms.last().is_some_and(|t| BANDS.contains(&t.kind()));
        let without = with_valve(c.spec.element).max(if bands { even().0 } else { 0.0 });
        gain - without.max(0.0)
    };
    let mut proposals = proposals(&context);
    proposals.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut full: Vec<(f64, bool, Candidate)> = Vec::new();
    for (rated, p) in proposals {
        // A ramp from the start and one from some time on are judged apart: they go on differently.
        let own_valve = p.element.is_none();
        let alike = |c: &Candidate| {
            c.spec
                .terms
                .last()
                .is_some_and(|t| t.kind() == p.term.kind() && t.knobs().len() == p.term.knobs().len())
        };
        let twice = full.iter().filter(|(_, own, c)| *own == own_valve && alike(c)).count()
            >= if full.len() < FEW { 2 } else { 1 };
        let hopeless = if EXACT.contains(&p.term.kind()) { LITTLE } else { HOPELESS };
        if full.len() == FULL || twice || (rated < hopeless && !full.is_empty() && settings.only.is_none()) {
            continue;
        }
        let paid = base.paid + cost(settings, &p);
        let mut spec = base.spec.clone();
        spec.terms.push(p.term);
        spec.element = p.element.unwrap_or(spec.element);
        spec.loss = f64::INFINITY;
        minimise(data, &mut spec, true, 8);
        if spec.terms.last().is_some_and(|t| t.kind() == Kind::DeadTimeChange) {
            // Its delay is one of two now.
            restructure(data, &mut spec, true, 2);
        }
        tune(data, &mut spec, tried);
        *tried += 1;
        let candidate = Candidate::new(data, spec, paid);
        let promised = evidence(&candidate);
        // What another valve gains is no effect's.
        let promised = if own_valve { promised.max(base.aic - candidate.aic) } else { promised };
        full.push((promised, own_valve, candidate));
    }
    full.sort_by(|a, b| b.0.total_cmp(&a.0));
    let judged = held_out(data, &base.spec);
    let mut finals: Vec<Trial> = Vec::new();
    let mut done = Vec::new();
    for (promised, own_valve, mut candidate) in full {
        let key = |c: &Candidate| c.spec.terms.last().map(|t| (t.kind(), t.knobs().len()));
        // Another friction does not save what is lost, nor does it let what is far behind catch up.
        let ahead =
            finals.iter().filter(|t| t.worth(settings.least_gain)).map(Trial::rank).fold(0.0, f64::max);
        if (promised < LOST || promised + FAR_BEHIND < ahead) && settings.only.is_none() {
            break;
        }
        if finals.len() == FINAL || done.contains(&(own_valve, key(&candidate))) {
            continue;
        }
        done.push((own_valve, key(&candidate)));
        restructure(data, &mut candidate.spec, true, 3);
        let plain = candidate;
        let mut candidate = with_friction(data, plain.clone(), true, tried);
        // What friction wins on the fitted samples it must win on all.
        if candidate.spec.element != plain.spec.element && with_effect(&candidate) < with_effect(&plain) {
            candidate = Candidate { likely: candidate.likely, ..plain };
        }
        tune(data, &mut candidate.spec, tried);
        let last = candidate.spec.terms.len() - 1;
        if !ALL.iter().all(|effect| effect.plausible(candidate.spec.terms[last].as_ref())) {
            continue;
        }
        let kind = candidate.spec.terms[last].kind();
        candidate.spec.free = None;
        candidate =
            Candidate { likely: candidate.likely, ..Candidate::new(data, candidate.spec, candidate.paid) };
        let evidence = evidence(&candidate);
        let error = if evidence > settings.least_gain {
            let (spec, error) = not_beyond(data, candidate.spec, (declared, at_start), judged);
            candidate.spec = spec;
            error
        } else {
            held_out(data, &candidate.spec)
        };
        let of_start = error.1 / at_start.1;
        // Dynamics that ran free worse than the declared ones are no measure.
        let nearer = of_start.max(error.1 / judged.1);
        let gain = base.aic - candidate.aic;
        let held = likelier(data, judged.0, error.0);
        finals.push(Trial { candidate, kind, evidence, gain, held, nearer, of_start });
    }
    if settings.only.is_some() {
        return (finals.into_iter().max_by(|a, b| a.gain.total_cmp(&b.gain)), None);
    }
    let valves = finals.iter().map(|t| t.candidate.spec.element);
    let valves = valves.filter(|element| element.f > 0.0 && *element != base.spec.element);
    let valves = valves.map(|element| (with_valve(element), element));
    let even = finals.iter().any(|t| BANDS.contains(&t.kind)).then(even);
    let valves = valves.chain(even);
    let valve = valves.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|valve| valve.0 > OTHER_VALVE);
    finals.retain(|t| t.worth(settings.least_gain));
    let steps = finals.iter().filter(|t| t.kind == Kind::LoadStep).map(|t| t.evidence);
    let of_step = OF_STEP * steps.fold(0.0, f64::max);
    let rank = |t: &Trial| t.rank() - if t.kind == Kind::GainChange { of_step } else { 0.0 };
    let best = finals.into_iter().max_by(|a, b| rank(a).total_cmp(&rank(b)));
    let valve = valve.filter(|valve| best.as_ref().is_none_or(|best| valve.0 > best.evidence));
    (best, valve.map(|valve| valve.1))
}

/// The valve of one band that explains most, sought as closely as those of which it grows, and what it gains.
fn best_even(data: &Data, likely: &Spec, gain: &dyn Fn(Element) -> f64) -> (f64, Element) {
    let even = growing(data, likely, &[0.0]).into_iter().map(|element| (gain(element), element));
    even.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::NEG_INFINITY, likely.element))
}

impl Trial {
    /// Whether the effect earns its place: by the evidence of all samples, more of it where friction may be what is wrong, and
    /// less where the free run comes nearer; and by held-out errors that are smaller, one step ahead or run free.
    ///
    /// The free run is never beyond the declared model's.
    fn worth(&self, enough: f64) -> bool {
        let Self { kind, evidence, held, nearer, of_start, .. } = *self;
        let mut needed = enough + NEARER * nearer.clamp(0.2, 2.0).ln();
        if self.candidate.spec.element.f > 0.0 && !UNLIKE_A_VALVE.contains(&kind) {
            needed += STICKY;
        }
        if held < 0.0 && !LATER.contains(&kind) {
            needed = needed.max(enough) + DISAGREES;
        } else if (0.0..LEAST_HELD).contains(&held) {
            needed += UNDECIDED;
        } else if held > DOUBTLESS && nearer < CLEAR.1 {
            needed -= CLEAR.0;
        }
        let agrees = held > LEAST_HELD
            || nearer < LEAST_NEARER
            || (held > 0.0 && evidence > 1.5 * needed)
            || (nearer < 1.0 && evidence > OVERWHELMING * needed);
        evidence > needed && agrees && (of_start < 1.0 || (of_start <= 1.0 && held > DOUBTLESS))
    }

    /// What it is compared by with others that are worth it.
    fn rank(&self) -> f64 {
        let nested = if self.kind == Kind::GainChange { NESTED } else { 0.0 };
        self.evidence - AHEAD * self.nearer.clamp(0.1, 2.0).ln() - nested
    }
}

/// What the effects propose with the model's valve; and those on the stem's way to the process also without it, or with the
/// likely one where it has none. Each with its gain in the long ARX.
fn proposals(context: &Context<'_>) -> Vec<(f64, Proposal)> {
    let Context { data, spec, likely, settings, .. } = *context;
    let rated = |p: Proposal| (context.rows() * (context.quick.loss / p.loss).ln() - cost(settings, &p), p);
    let asked = |p: &Proposal| settings.only.is_none_or(|only| p.term.kind() == only);
    let all = ALL.iter().filter(|effect| !effect.direct());
    let mut out: Vec<_> = all.flat_map(|effect| effect.propose(context)).filter(asked).map(rated).collect();
    let none = Element { f: 0.0, ..spec.element };
    let element = if spec.element.f > 0.0 { none } else { likely };
    if element != spec.element {
        let mut other = Spec { element, loss: f64::INFINITY, ..spec.clone() };
        minimise(data, &mut other, true, 8);
        let (stage, e) = all_errors(data, &other);
        let quick = Quick::long_arx(data, &stage, other.orders.nk);
        let context = Context::new(data, (&other, likely), (&stage, &e), &quick, settings);
        let on_the_stem = ALL.iter().filter(|effect| effect.on_the_stem());
        let others = on_the_stem.flat_map(|effect| effect.propose(&context)).filter(asked);
        out.extend(others.map(|p| rated(Proposal { element: Some(other.element), ..p })));
    }
    out
}

/// What a proposal's numbers and the search for it cost in AIC.
fn cost(settings: &Settings, p: &Proposal) -> f64 {
    let known =
        settings.known.iter().any(|(kind, tag)| *kind == p.term.kind() && tag.as_deref() == p.term.tag());
    2.0 * p.parameters + if known { 0.0 } else { 2.0 * p.tried.max(1.0).ln() }
}
