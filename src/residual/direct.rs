//! What the signals alone show: it comes before all other effects and needs no gain in likelihood.

use super::candidate::Candidate;
use super::effects::{ALL, Context};
use super::fit::{loss_of, minimise};
use super::model::{Data, Spec};
use super::needless::Added;
use super::regress::{Quick, all_errors, restructure};
use super::run::held_out;
use super::{Kind, Settings};

/// Effects that take samples out and leave the others as they are.
const REPAIRS: [Kind; 3] = [Kind::FrozenPv, Kind::Outliers, Kind::QuantisedPv];
/// Share by which what the signals show may be doubted, up to which it is certain.
const CERTAIN: f64 = 0.02;
/// Decrease of AIC that each outlier among the fitted samples brings.
const EACH: f64 = 8.0;
/// Runs beyond which a PV stands still often, and one-step error as a share of that before beyond which those are then no samples
/// that are missing.
const OFTEN: f64 = 5.0;
const HARDER: f64 = 1.1;
/// One-step error as a share of that before which outliers that are none do not leave.
const MUCH_NEARER: f64 = 0.7;

/// Adds what the signals alone show.
pub fn add_direct(data: &Data, settings: &Settings, base: &mut Candidate, added: &mut Vec<Added>) {
    for effect in ALL.iter().filter(|e| e.direct()) {
        let (stage, e) = all_errors(data, &base.spec);
        let quick = Quick::long_arx(data, &stage, base.spec.orders.nk);
        let context = Context::new(data, (&base.spec, base.likely), (&stage, &e), &quick, settings);
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
        // A sensor that hangs stands still often, and what comes between is no more easily predicted.
        let often = kind == Kind::FrozenPv && proposal.parameters > OFTEN;
        if often && after.0.min(masked_error.0) > HARDER * before.0 {
            continue;
        }
        if kind != Kind::ClockSkew && masked_error.1 < after.1 {
            let (stage, e) = all_errors(data, &masked);
            masked.loss = loss_of(data, &stage, &e);
            spec = masked;
        }
        // Errors on a PV that was shifted are not those on the other: they may differ a little for the worse.
        // A PV that stands still does so whatever the fit makes of it.
        let worst = if matches!(kind, Kind::ClockSkew | Kind::FrozenPv) { 1.3 } else { 1.0001 };
        // PV follows from OP to rounding where OP's stamps are late: that is the controller's equation, not the process.
        let certain = matches!(kind, Kind::ClockSkew | Kind::FrozenPv) && proposal.loss < CERTAIN;
        let next = Candidate::new(data, spec, base.paid + 2.0 * proposal.parameters);
        let evidence = (base.aic - next.aic).max(0.0);
        // What outliers do to the next sample is gone in any case; they are none where they do not stand out of the errors.
        let outliers = kind == Kind::Outliers;
        let (left, there) = (next.spec.stage(data).0.weight, base.spec.stage(data).0.weight);
        let fitted = (data.first..data.split).filter(|&k| left[k] < there[k]).count();
        let gone = outliers && after.0.min(masked_error.0) < MUCH_NEARER * before.0;
        let stand_out = outliers && evidence > EACH * fitted as f64;
        let doubtless = certain || gone || stand_out;
        if doubtless || (!outliers && after.1.min(masked_error.1) <= before.1 * worst) {
            added.push(Added { kind, evidence, paid: next.paid - base.paid });
            *base = next;
        }
    }
}

/// The declared model, its coefficients as they are, on the samples that others are judged on: where clocks disagree, with the stamps
/// put right. On those there are it may be the controller's own equation, exact to rounding, and no model of the process is better.
pub fn restamped(declared: &Spec, base: &Spec) -> Spec {
    let mut spec = declared.clone();
    spec.terms.extend(base.terms.iter().filter(|t| t.kind() == Kind::ClockSkew).map(|t| t.boxed()));
    spec
}

/// The model, or the declared one with the same repairs where only repairs were added and the fit came out worse for it.
pub fn not_worse(data: &Data, declared: &Spec, base: Candidate, at_start: (f64, f64)) -> Candidate {
    let direct = base.spec.terms.iter().all(|term| REPAIRS.contains(&term.kind()));
    if base.spec.terms.is_empty() || !direct || held_out(data, &base.spec).1 <= at_start.1 {
        return base;
    }
    let mut repaired = declared.clone();
    repaired.terms = base.spec.terms.iter().map(|term| term.boxed()).collect();
    let (stage, e) = all_errors(data, &repaired);
    repaired.loss = loss_of(data, &stage, &e);
    if held_out(data, &repaired).1 > at_start.1 {
        repaired.free = Some(Box::new(declared.clone()));
    }
    Candidate::new(data, repaired, base.paid)
}

/// Whether the signals alone show such an effect.
pub fn is_direct(kind: Kind) -> bool {
    REPAIRS.contains(&kind) || kind == Kind::ClockSkew
}

/// Whether errors are counted over other samples than the declared model's.
pub fn is_repaired(spec: &Spec) -> bool {
    spec.terms.iter().any(|t| is_direct(t.kind()))
}
