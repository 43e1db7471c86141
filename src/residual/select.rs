//! Forward selection: one effect at a time, friction and dynamics estimated again with each.

use super::candidate::{Candidate, tune, with_friction};
use super::effects::{ALL, Context, Proposal};
use super::findings::{Outcome, report};
use super::fit::{held_out, loss_of, minimise};
use super::model::{Data, Element, Spec};
use super::pose::{declared, pose};
use super::regress::{Quick, all_errors, restructure};
use super::{Findings, Kind, Settings, Stem};
use crate::diagnosis::{Diagnosis, Preparation, Verdict};
use crate::signal::Window;

/// Candidates fitted in full at each step, and fitted with friction scanned anew.
const FULL: usize = 7;
/// Share of the leader's gain below which a candidate is not pursued.
const FAR_BEHIND: f64 = 0.1;
const FINAL: usize = 3;
/// Effects that take samples out and leave the others as they are.
const REPAIRS: [Kind; 3] = [Kind::FrozenPv, Kind::Outliers, Kind::QuantisedPv];
/// Share of the free-run error that a drift must leave at most where the noise model hides it.
const SLOW: f64 = 0.9;
/// Least gain of likelihood on the held-out samples, and one that leaves no doubt (-).
const LEAST_HELD: f64 = 6.0;
const BEYOND_DOUBT: f64 = 15.0;
/// Share of the free-run error that may be left by what happened once, and by what shows in nothing else.
const ONCE: f64 = 0.83;
const FAR_BETTER: f64 = 0.65;
/// Gain that is enough where the free run is better by as much as [`STRIKING`] or the held-out samples say the rest.
const FAINT: f64 = 8.0;
const STRIKING: f64 = 0.75;
/// Gain of likelihood on the held-out samples that settles the matter (-).
const OVERWHELMING: f64 = 60.0;
/// Least gain of a kinetic lag: every valve model but the paper's own has one.
const LEAST_SLIP: f64 = 10.0;
/// Least gain of a step: one sample far off looks like a small one.
const LEAST_STEP: f64 = 60.0;

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
    base = with_friction(&data, base, &mut tried);
    let mut judged = held_out(&data, &base.spec);
    let at_start = held_out(&data, &declared);
    while added.len() < settings.most_effects && tried < settings.most_fits {
        let Some((next, gain, error)) = step(&data, settings, &base, judged, at_start, &mut tried) else {
            break;
        };
        let kind = next.spec.terms.last().map(|t| t.kind())?;
        added.push((kind, gain));
        base = next;
        judged = error;
    }
    slip_jump(&data, &base, at_start, &mut added);
    base = not_worse(&data, &declared, base, at_start);
    Some(report(&data, diagnosis, settings, Outcome { declared, base, added, tried }))
}

/// Adds what the signals alone show.
fn add_direct(data: &Data, settings: &Settings, base: &mut Candidate, added: &mut Vec<(Kind, f64)>) {
    for effect in ALL.iter().filter(|e| e.direct()) {
        let (stage, e) = all_errors(data, &base.spec);
        let quick = Quick::long_arx(data, &stage, base.spec.orders.nk);
        let context = Context {
            data,
            spec: &base.spec,
            stage: &stage,
            e: &e,
            quick: &quick,
            likely: base.likely,
            settings,
        };
        let Some(proposal) = effect.propose(&context).into_iter().next() else { continue };
        if settings.only.is_some_and(|only| only != proposal.term.kind()) {
            continue;
        }
        let before = held_out(data, &base.spec);
        let mut spec = base.spec.clone();
        let kind = proposal.term.kind();
        spec.terms.push(proposal.term);
        minimise(data, &mut spec, false, 12);
        restructure(data, &mut spec, false, 3);
        let after = held_out(data, &spec);
        // Where the repair does not help the fit, the samples it takes out still do not count.
        let mut masked = base.spec.clone();
        masked.terms.push(spec.terms[spec.terms.len() - 1].boxed());
        let masked_error = held_out(data, &masked);
        if kind != Kind::ClockSkew && masked_error.1 < after.1 {
            let (stage, e) = all_errors(data, &masked);
            masked.loss = loss_of(data, &stage, &e);
            spec = masked;
        }
        // Errors on a PV that was shifted are not those on the other: they may differ a little for the worse.
        let worst = if kind == Kind::ClockSkew { 1.3 } else { 1.0001 };
        if after.1.min(masked_error.1) <= before.1 * worst {
            let next = Candidate::new(data, spec, base.paid + 2.0 * proposal.parameters);
            added.push((kind, (base.aic - next.aic).max(0.0)));
            *base = next;
        }
    }
}

/// The model, or the declared one with the same repairs where only repairs were added and the fit came out worse for it.
fn not_worse(data: &Data, declared: &Spec, base: Candidate, at_start: (f64, f64)) -> Candidate {
    let direct = base.spec.terms.iter().all(|term| REPAIRS.contains(&term.kind()));
    if base.spec.terms.is_empty() || !direct || held_out(data, &base.spec).1 <= at_start.1 {
        return base;
    }
    let mut repaired = declared.clone();
    repaired.terms = base.spec.terms.iter().map(|term| term.boxed()).collect();
    let (stage, e) = all_errors(data, &repaired);
    repaired.loss = loss_of(data, &stage, &e);
    Candidate::new(data, repaired, base.paid)
}

/// Names the kinetic lag, which every friction estimate has, where it earns its place.
fn slip_jump(data: &Data, base: &Candidate, at_start: (f64, f64), added: &mut Vec<(Kind, f64)>) {
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
    let now = held_out(data, &base.spec);
    if gain > LEAST_SLIP
        && now.1 <= at_start.1
        && now.0 < plain.0 * 1.01
        && (now.0 < plain.0 || now.1 < plain.1)
    {
        added.push((Kind::SlipJump, gain));
    }
}

type Step = (Candidate, f64, (f64, f64));

/// The best effect to add, if any earns its place.
fn step(
    data: &Data,
    settings: &Settings,
    base: &Candidate,
    judged: (f64, f64),
    at_start: (f64, f64),
    tried: &mut usize,
) -> Option<Step> {
    let (stage, e) = all_errors(data, &base.spec);
    let quick = Quick::long_arx(data, &stage, base.spec.orders.nk);
    let likely = base.likely;
    let context = Context { data, spec: &base.spec, stage: &stage, e: &e, quick: &quick, likely, settings };
    let n = context.rows();
    let mut proposals: Vec<(f64, Proposal)> = ALL
        .iter()
        .filter(|effect| !effect.direct())
        .flat_map(|effect| effect.propose(&context))
        .filter(|p| settings.only.is_none_or(|only| p.term.kind() == only))
        .map(|p| (n * (quick.loss / p.loss).ln() - cost(settings, &p), p))
        .collect();
    proposals.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut full: Vec<Candidate> = Vec::new();
    for (_, p) in proposals.into_iter().take(FULL) {
        let paid = base.paid + cost(settings, &p);
        let mut spec = base.spec.clone();
        spec.terms.push(p.term);
        spec.element = p.element.unwrap_or(spec.element);
        spec.loss = f64::INFINITY;
        minimise(data, &mut spec, true, 8);
        tune(data, &mut spec, tried);
        *tried += 1;
        full.push(Candidate::new(data, spec, paid));
    }
    full.sort_by(|a, b| a.aic.total_cmp(&b.aic));
    let mut finals: Vec<Candidate> = Vec::new();
    for candidate in full {
        // A ramp from the start and one from some time on are judged apart: they go on differently.
        let kind = |c: &Candidate| c.spec.terms.last().map(|t| (t.kind(), t.knobs().len()));
        let gain = base.aic - candidate.aic;
        if finals.len() == FINAL || gain < FAR_BEHIND * finals.first().map_or(0.0, |f| base.aic - f.aic) {
            break;
        }
        if finals.iter().any(|f| kind(f) == kind(&candidate)) {
            continue;
        }
        let mut candidate = candidate;
        restructure(data, &mut candidate.spec, true, 3);
        let mut candidate = with_friction(data, candidate, tried);
        tune(data, &mut candidate.spec, tried);
        let last = candidate.spec.terms.len() - 1;
        if !ALL.iter().all(|effect| effect.plausible(candidate.spec.terms[last].as_ref())) {
            continue;
        }
        let likely = candidate.likely;
        finals.push(Candidate { likely, ..Candidate::new(data, candidate.spec, candidate.paid) });
    }
    finals.sort_by(|a, b| a.aic.total_cmp(&b.aic));
    for candidate in finals {
        let mut gain = base.aic - candidate.aic;
        // A noise model with a pole at 1 swallows a ramp one step ahead; the free run shows what it was.
        let error = held_out(data, &candidate.spec);
        let Some(kind) = candidate.spec.terms.last().map(|t| t.kind()) else { continue };
        if kind == Kind::Drift && gain > 0.0 && error.1 < SLOW * judged.1 {
            let (stage, _) = candidate.spec.stage(data);
            let long = Quick::long_arx(data, &stage, candidate.spec.orders.nk);
            gain = gain.max(0.5 * (gain + n * (quick.loss / long.loss).ln()));
        }
        // What was held out is evidence too, and nothing was searched there.
        let held = 2.0 * (data.len() - data.split) as f64 * (judged.0 / error.0).ln();
        let striking = gain > FAINT && error.1 < STRIKING * judged.1 && held > -3.0;
        let nearer = error.1 / judged.1;
        let least = match kind {
            Kind::LoadStep => LEAST_STEP,
            Kind::Drift if held > 0.0 && nearer < 0.5 => 0.5 * FAINT,
            Kind::Drift => settings.least_gain,
            // So much likelihood where nothing was fitted needs little more.
            _ if held > OVERWHELMING => 0.0,
            Kind::MeasuredDisturbance => settings.least_gain,
            _ if striking => FAINT,
            _ => {
                let counts = if nearer < 0.85 && kind != Kind::OscillatingLoad { 1.0 } else { 0.5 };
                settings.least_gain - (counts * held).clamp(0.0, (settings.least_gain - FAINT).max(0.0))
            }
        };
        if gain < least && settings.only.is_none() {
            continue;
        }
        if settings.only.is_some() || better(data, kind, gain, judged, at_start, error) {
            return Some((candidate, gain, error));
        }
    }
    None
}

/// Whether the effect shows in what was held out, as much as its kind must.
///
/// What goes on after the split (a periodic load, a curved valve, another gain) has to gain likelihood there too, some
/// tenth of what it gained per fitted sample, or make the free run far better. What happened once before it (a step, a
/// ramp) hardly changes errors one step ahead: there the free run decides. The free run is never beyond the declared
/// model's but for effects that leave no doubt one step ahead.
fn better(data: &Data, kind: Kind, gain: f64, was: (f64, f64), start: (f64, f64), now: (f64, f64)) -> bool {
    let n = (data.len() - data.split) as f64;
    let held = 2.0 * n * (was.0 / now.0).ln();
    let nearer = now.1 / was.1;
    let expected = gain * n / (data.split - data.first) as f64;
    let lasting = held > LEAST_HELD && held > 0.2 * expected;
    let doubtless = held > BEYOND_DOUBT && held > 0.35 * expected && gain > LEAST_STEP;
    if now.1 > start.1 {
        return doubtless
            && !matches!(kind, Kind::LoadStep | Kind::Drift)
            && now.1 < 1.2 * start.1
            && nearer < 1.2;
    }
    match kind {
        Kind::LoadStep => held > -0.02 * n && nearer < ONCE,
        Kind::Drift => (held > -0.02 * n && nearer < ONCE) || nearer < 0.4,
        _ => {
            (lasting && nearer < 1.1)
                || (held > -0.01 * n && nearer < FAR_BETTER)
                || (doubtless && nearer < 1.25 && now.1 < 0.95 * start.1)
        }
    }
}

/// What a proposal's numbers and the search for it cost in AIC.
fn cost(settings: &Settings, p: &Proposal) -> f64 {
    let known =
        settings.known.iter().any(|(kind, tag)| *kind == p.term.kind() && tag.as_deref() == p.term.tag());
    2.0 * p.parameters + if known { 0.0 } else { 2.0 * p.tried.max(1.0).ln() }
}
