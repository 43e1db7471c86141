//! What the declared model leaves unexplained, and why: the residual is traced to an effect that the model lacks, the effect
//! is added, friction and dynamics are estimated again with it, and the error is compared on samples that no fit has seen.
//!
//! ```text
//! A(q) y = B(q) K(y) g(x) + sum gamma_i phi_i + c0 + C(q) e
//! ```
//!
//! x is the stem of the valve driven by OP, g and K what valve and process do to it (a stop, a curve, a change of gain or
//! delay) and phi the shapes of loads. Friction and effects compete by one criterion ([`crate::sysid::criterion`]).
//! Everything is fitted on the first 80 % of the window; the last 20 % is read only once a selection has ended, to
//! reject effects and for the errors before and after.
//! Pure: the same window gives the same findings.

mod backward_elimination;
mod checks;
mod confirm;
pub mod data_quality;
mod detectable;
pub mod effect;
mod findings;
pub mod fit;
pub mod forward_selection;
mod held_out;
pub mod hypotheses;
pub mod hypothesis;
mod interval;
pub mod posterior;
pub mod report;
mod response;
pub mod screening;
mod trace;
pub mod valve_search;
mod verdict;

pub use confirm::{LASTS_S, confirm};
pub use findings::{
    Curves, Effect, Evidence, Findings, Friction, Kind, Lasting, Parameter, Stem, Structure, Test,
};

use crate::diagnosis::{self, Diagnosis, NotIdentifiable, Verdict, gate, prepare};
use crate::signal::{Record, Window, span_at_least};

/// How far to trace.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Most effects added.
    pub most_effects: usize,
    /// Least f that counts as stiction (OP unit).
    pub f_threshold: f64,
    /// Least evidence that counts as stiction (-).
    pub evidence_threshold: f64,
    /// The one effect that is known to be there: it is looked for more thoroughly than the others.
    pub only: Option<Kind>,
    /// The span of OP, where it is known: sentences are then in per cent of it (OP unit).
    pub op_span: Option<f64>,
    /// S/2 and J of the valve, where they are known (OP unit): the search begins there, too.
    pub friction: Option<(f64, Option<f64>)>,
    /// Share of the traced window at which a term of write-back was in force (0..1): it hides friction.
    pub compensated: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            most_effects: 3,
            f_threshold: 0.05,
            evidence_threshold: 20.0,
            only: None,
            op_span: None,
            friction: None,
            compensated: 0.0,
        }
    }
}

/// Most samples traced: longer records are cut to the stretch about the diagnosed window.
const MOST_SAMPLES: usize = 2000;

/// The window to trace: the whole gated record where the diagnosis looks at its most regular stretch only, since a change
/// outside that stretch is an effect too; at its sample period, and at most 2,000 samples about its window. `None` where the gate
/// lets none pass, or its rows are no samples of the loop as it moves.
pub fn window(record: &Record, diagnosis: &Diagnosis, settings: &diagnosis::Settings) -> Option<Window> {
    use NotIdentifiable::{TsTooShort, Undersampled};
    // A repeated reading would count as evidence, and of an oscillation that is too fast another one is seen: no model of such
    // rows says anything.
    if let Verdict::NotIdentifiable(TsTooShort { .. } | Undersampled { .. }) = &diagnosis.verdict {
        return None;
    }
    let (gated, _) = gate::gate(record, settings).ok()?;
    let factor = diagnosis.preparation.decimation.max(1);
    let whole = if factor > 1 { prepare::decimate(&gated, factor) } else { gated };
    let n = whole.len();
    if n <= MOST_SAMPLES {
        return Some(whole);
    }
    let p = &diagnosis.preparation;
    let middle = (0.5 * (p.start + p.end) - whole.t0) / whole.ts;
    let middle = if middle.is_finite() { middle.clamp(0.0, n as f64) as usize } else { n };
    let from = middle.saturating_sub(MOST_SAMPLES / 2).min(n - MOST_SAMPLES);
    Some(whole.slice(from, from + MOST_SAMPLES))
}

/// [`trace`] on the [`window`] of a record; `None` where there is nothing to trace.
pub fn trace_record(
    record: &Record,
    diagnosis: &Diagnosis,
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
) -> Option<Findings> {
    let window = window(record, diagnosis, diagnosed)?;
    let covered = diagnosis.window.as_ref().unwrap_or(&window);
    let settings = settings_of(record, [&window, covered], diagnosed, settings);
    trace(&window, diagnosis, &settings)
}

/// The settings for the window of a record that is traced, whose diagnosis looked at the window `covered`: thresholds are per cent
/// of OP's span there and OP units here; one record has one, whatever window is traced.
fn settings_of(
    record: &Record,
    [traced, covered]: [&Window; 2],
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
) -> Settings {
    let op_span = record.known_span();
    Settings {
        f_threshold: 0.01 * diagnosed.f_threshold * span_at_least(op_span, &covered.op),
        op_span,
        evidence_threshold: diagnosed.evidence_threshold,
        compensated: record.compensated(traced),
        ..settings.clone()
    }
}

/// A hypothesis of the first step: friction or none, with one effect or none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Its effect.
    pub kind: Option<Kind>,
    /// Friction: 0 for none, 1 for J = S, 2 for J free.
    pub friction: usize,
    /// Log-likelihood.
    pub log_likelihood: f64,
    /// What its parameters and alternatives cost.
    pub cost: f64,
}

/// The hypotheses of the first step, for calibration.
pub fn first_step(
    record: &Record,
    diagnosis: &Diagnosis,
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
) -> Vec<Row> {
    window(record, diagnosis, diagnosed).map_or_else(Vec::new, |window| trace::first_step(&window, settings))
}

/// Traces the residual of a diagnosed window; `None` where the window is too short or too still to fit anything.
///
/// * `window`: the gated window, with every tag that may explain PV.
/// * `diagnosis`: what was found on it: the start of friction, and the verdict that stands if no effect is found.
pub fn trace(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    trace::trace(window, diagnosis, settings)
}

#[cfg(test)]
mod tests;
