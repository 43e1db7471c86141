//! Forward selection: one effect at a time, friction and dynamics estimated again with each.

use super::candidate::{Candidate, Sought, with_friction};
use super::direct::{add_direct, is_direct, not_worse, restamped};
use super::evidence::Judge;
use super::findings::{Needed, Outcome, report};
use super::fit::minimise;
use super::free::longer_sighted;
use super::model::{Data, Spec};
use super::needless::{Added, drop_needless};
use super::pose::{declared, pose};
use super::regress::restructure;
use super::run::held_out;
use super::slip::slip_jump;
use super::staged::{jumps, reaches};
use super::step::{PAST_SAVING, step};
use super::{Findings, Kind, Settings, Stem};
use crate::diagnosis::{Diagnosis, Verdict};
use crate::signal::Window;

/// Gain of likelihood for which the model without an effect has its friction sought once more (-).
const CHANGED: f64 = 1.0;
/// How often another valve is tried in the place of the one there is in a trace.
const LOOKS: usize = 1;
/// Steps for each effect that may be added: one that goes again must not come back without end.
const STEPS: usize = 3;

/// See [`super::trace`].
pub fn trace(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    let mut findings = trace_one(window, diagnosis, settings)?;
    findings.stem = window.mv.as_ref().and_then(|mv| stem(window, mv, settings));
    Some(findings)
}

/// OP to the measured stem: no process hides the valve there.
fn stem(window: &Window, mv: &[f64], settings: &Settings) -> Option<Stem> {
    let window = Window { pv: mv.to_vec(), mv: None, sp: None, ..window.clone() };
    let unknown = Diagnosis::bare(Verdict::NoStiction, "the stem follows OP");
    let findings = trace_one(&window, &unknown, settings)?;
    Some(Stem { friction: findings.friction_after, findings: Some(Box::new(findings)) })
}

fn trace_one(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    let data = pose(window)?;
    let f = diagnosis.estimate.as_ref().map_or(0.0, |e| e.f) / data.scale.u;
    let declared = declared(&data, f);
    let mut tried = 1;
    let mut base = Candidate::new(&data, declared.clone(), 0.0);
    let mut added = Vec::new();
    add_direct(&data, settings, &mut base, &mut added);
    // What dynamics that are better estimated gain is not friction's.
    if base.spec.element.f == 0.0 {
        base = Candidate::new(&data, refitted(&data, &base.spec), base.paid);
    }
    let was = base.spec.element.f;
    base = with_friction(&data, base, Sought::Any { slips: true, paths: false }, &mut tried);
    if base.spec.element.f > 0.0 {
        // A valve found through dynamics without one is seldom the right one; stems of slips were sought about another f, if at all.
        let slips = !reaches(was, base.spec.element.f);
        base = with_friction(&data, base, Sought::Any { slips, paths: true }, &mut tried);
    }
    let compared = restamped(&declared, &base.spec);
    let mut declared = compared.clone();
    if !declared.terms.is_empty() {
        minimise(&data, &mut declared, false, 12);
        restructure(&data, &mut declared, false, 3);
    }
    let at_start = held_out(&data, &declared);
    let (mut looks, mut steps, mut quiet) = (LOOKS, STEPS * settings.most_effects, None);
    while added.len() < settings.most_effects && steps > 0 && tried < settings.most_fits {
        steps -= 1;
        // The model without has the same chances as those with an effect: what a second look finds is no effect's gain.
        if looks == LOOKS || !added.is_empty() {
            let next = again(&data, base.clone(), &mut tried);
            if added.is_empty() || held_out(&data, &next.spec).1 <= at_start.1 {
                base = next;
            }
        }
        let (found, valve) = step(&data, settings, &base, (&declared, at_start), (&mut quiet, &mut tried));
        if let Some(element) = valve
            && looks > 0
        {
            looks -= 1;
            let other = base.with_valve(&data, element, true);
            // Beside effects that were judged with another valve it may run free anywhere.
            let judged = added.iter().any(|effect| !is_direct(effect.kind));
            if !judged || held_out(&data, &other.spec).1 <= at_start.1 {
                (base, quiet) = (other, None);
                continue;
            }
        }
        let Some(next) = found else {
            let was = base.spec.element;
            base = slips_beside(&data, base, &added, at_start, &mut tried);
            if base.spec.element == was {
                break;
            }
            quiet = None;
            continue;
        };
        let paid = next.candidate.paid - base.paid;
        added.push(Added { kind: next.kind, evidence: next.evidence, paid });
        base = next.candidate;
        let more = steps > 0 && tried < settings.most_fits;
        drop_needless(&data, settings, (at_start.1, more), &mut base, &mut added);
    }
    if added.len() == settings.most_effects {
        base = slips_beside(&data, base, &added, at_start, &mut tried);
    }
    base = Candidate { likely: base.likely, ..Candidate::new(&data, base.spec, base.paid) };
    let needed = Needed::after(settings, diagnosis, data.scale.ts);
    slip_jump(&data, &mut base, (&declared, at_start), needed.as_ref(), &mut added);
    base = not_worse(&data, &declared, base, at_start);
    // What later effects made of the first must still predict better than nothing.
    let now = held_out(&data, &base.spec);
    let better = now.0 < at_start.0 || now.1 < at_start.1;
    if !(added.is_empty()
        || better
        || added.iter().any(|effect| is_direct(effect.kind) && effect.kind != Kind::Outliers))
    {
        (base, added) = (Candidate::new(&data, declared.clone(), 0.0), Vec::new());
    }
    let refit = if added.is_empty() { longer_sighted(&data, &declared) } else { declared.clone() };
    Some(report(
        &data,
        diagnosis,
        settings,
        Outcome { compared, declared, base, refit, added, needed, tried },
    ))
}

/// The model with a stem of slips where, beside the effects there are, that gains by AIC and the long model alike; its free run is not
/// beyond the declared model's.
fn slips_beside(
    data: &Data,
    base: Candidate,
    added: &[Added],
    at_start: (f64, f64),
    tried: &mut usize,
) -> Candidate {
    if added.is_empty() || base.spec.element.f <= 0.0 {
        return base;
    }
    let Some(element) = jumps(data, &base.spec) else { return base };
    let judge = Judge::new(data, &base.spec.stage(data).0, base.spec.orders.nk);
    let alone = Spec { element, ..base.spec.clone() };
    // Dynamics of its own do not save a stem that the signals speak against.
    if judge.gain(data, &alone.stage(data).0, alone.orders.nk) < PAST_SAVING {
        return base;
    }
    let other = base.with_valve(data, element, true);
    *tried += 1;
    let gain = judge.gain(data, &other.spec.stage(data).0, other.spec.orders.nk);
    let (held, was) = (held_out(data, &other.spec), held_out(data, &base.spec));
    let nearer = held.0 < was.0 && held.1 <= at_start.1.max(was.1);
    if nearer && other.aic < base.aic && gain > 0.0 { other } else { base }
}

/// The model estimated once more from where it is.
fn again(data: &Data, base: Candidate, tried: &mut usize) -> Candidate {
    let spec = refitted(data, &base.spec);
    let likely = base.likely;
    let rows = (data.split - data.first) as f64;
    if rows * (base.spec.loss / spec.loss).ln() < CHANGED {
        return base;
    }
    let next = with_friction(
        data,
        Candidate { likely, ..Candidate::new(data, spec, base.paid) },
        Sought::Kept,
        tried,
    );
    if next.aic < base.aic { next } else { base }
}

/// Dynamics estimated once more from where they are.
fn refitted(data: &Data, spec: &Spec) -> Spec {
    let mut spec = spec.clone();
    minimise(data, &mut spec, true, 8);
    restructure(data, &mut spec, true, 3);
    spec
}
