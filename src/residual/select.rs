//! Forward selection: one effect at a time, friction and dynamics estimated again with each.

use super::candidate::{Candidate, with_friction};
use super::direct::{add_direct, is_repaired, not_worse};
use super::findings::{Outcome, report};
use super::fit::{held_out, minimise};
use super::free::{longer_sighted, not_beyond};
use super::model::{Data, Element, Spec};
use super::needless::{Added, drop_needless};
use super::pose::{declared, pose};
use super::regress::restructure;
use super::step::step;
use super::{Findings, Kind, Settings, Stem};
use crate::diagnosis::{Diagnosis, Preparation, Verdict};
use crate::signal::Window;

/// Gain of likelihood for which the model without an effect has its friction sought once more (-).
const CHANGED: f64 = 1.0;
/// How often another valve may take the place of the one there is in a trace.
const LOOKS: usize = 1;
/// Steps for each effect that may be added: one that goes again must not come back without end.
const STEPS: usize = 3;
/// Least gain of a kinetic lag: every valve model but the paper's own has one.
const LEAST_SLIP: f64 = 7.0;
/// The same where the declared dynamics are kept for the free run.
const CERTAIN_SLIP: f64 = 30.0;
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
    let mut added = Vec::new();
    add_direct(&data, settings, &mut base, &mut added);
    base = with_friction(&data, base, false, &mut tried);
    let at_start = held_out(&data, &declared);
    let (mut looks, mut steps) = (LOOKS, STEPS * settings.most_effects);
    while added.len() < settings.most_effects && steps > 0 && tried < settings.most_fits {
        steps -= 1;
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
        let paid = next.candidate.paid - base.paid;
        added.push(Added { kind: next.kind, evidence: next.evidence, paid });
        base = next.candidate;
        drop_needless(&data, settings, at_start.1, &mut base, &mut added);
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

/// The model with another valve.
fn with_valve(data: &Data, base: &Candidate, element: Element) -> Candidate {
    let mut spec = Spec { element, loss: f64::INFINITY, ..base.spec.clone() };
    minimise(data, &mut spec, true, 12);
    restructure(data, &mut spec, true, 3);
    Candidate::new(data, spec, base.paid)
}

/// Names the kinetic lag, which every friction estimate has, where it earns its place.
fn slip_jump(
    data: &Data,
    base: &mut Candidate,
    (declared, at_start): (&Spec, (f64, f64)),
    added: &mut Vec<Added>,
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
        added.push(Added { kind: Kind::SlipJump, evidence: gain, paid: 0.0 });
    }
}
