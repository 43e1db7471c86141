//! Traces the residual of the diagnosed model to effects that the model lacks. Effects are added, friction and dynamics are
//! estimated again with them, and the errors are compared on samples that nothing was fitted to.
//!
//! ```text
//! A(q) y = B(q) K(y) g(x) + sum gamma_i phi_i + c0 + C(q) e
//! ```
//!
//! | symbol | what it is | unit |
//! |---|---|---|
//! | `y`, `x` | PV; the stem of the valve driven by OP | PV, OP |
//! | `g`, `K` | what valve and process do to the stem: a stop, a curve, a change of gain or dead time | - |
//! | `phi`, `gamma` | shapes of loads, and their sizes | -, PV |
//! | `A`, `B`, `C`, `c0` | polynomials of the ARMAX, and its constant | - |
//! | `e` | errors, independent and of Student's t | PV |
//!
//! Friction and effects compete by one criterion. Everything is fitted on the first 80 % of the window. The last 20 % are held
//! out: no selection on the fitted samples sees them. Once one has ended they reject effects, and each time they do the selection
//! goes on and they are asked again. The errors before and after are taken on the same samples, which therefore helped to choose
//! the model that they judge (`continuation.rs` measures what that makes of the errors).
//!
//! Where to look:
//!
//! | question | file |
//! |---|---|
//! | the steps in their order | `trace.rs` |
//! | the window that is traced | `window.rs` |
//! | what an effect is, and its sentence | `effect.rs`, and its own file in `hypotheses/` |
//! | the penalty of a parameter, such as a change time | `sysid/criterion.rs`; its rate is in the effect's own file |
//! | the penalty of a valve | `valve_search/cost.rs` |
//! | the noise model: the distribution of e, and C | `sysid/student.rs`, `sysid/armax.rs` |
//! | how a hypothesis is fitted and scored | `fit.rs` |
//! | the rule that adds an effect | `selection.rs`, `forward_selection.rs` |
//! | the rules that drop an effect: by the fitted samples, by the held-out ones | `backward_elimination.rs`, `rejection.rs` |
//! | the posterior | `posterior.rs` |
//! | the verdict on friction, and its sentence | `verdict.rs` |
//! | bounds on f: its interval, friction that could be hidden, the least that would have shown | `interval.rs`, `valve_search/hidden_friction.rs`, `detectable.rs` |
//! | when the last model is kept | `confirm.rs` |
//! | the errors on samples that chose nothing | `continuation.rs` |
//!
//! Pure: the same window gives the same findings.

mod backward_elimination;
mod checks;
mod confirm;
mod continuation;
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
mod rejection;
pub mod report;
mod response;
pub mod screening;
mod selection;
mod settings;
mod trace;
pub mod valve_search;
mod verdict;
mod window;

pub use confirm::{LASTS_S, confirm, confirm_gated};
pub use continuation::{Continuation, trace_continued};
pub use findings::{
    Curves, Described, Effect, Evidence, Findings, Friction, Kind, Lasting, Parameter, Stem, Structure, Test,
    Traced,
};
pub use settings::Settings;
pub use trace::Row;
pub use verdict::overruled;
pub use window::window;

use crate::diagnosis::gate::{Gated, gate};
use crate::diagnosis::{self, Diagnosis};
use crate::signal::{Record, Window};
use window::{settings_of, window_of};

/// Traces the [`window()`] of a record; `None` where there is no such window, or where it is too short or too still to fit anything.
pub fn trace_record(
    record: &Record,
    diagnosis: &Diagnosis,
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
) -> Option<Findings> {
    trace_gated(record, &gate(record, diagnosed), diagnosis, diagnosed, settings)
}

/// [`trace_record`] for a record that is gated already.
///
/// * `gated`: what [`gate`] made of the record with the settings of the diagnosis.
pub fn trace_gated(
    record: &Record,
    gated: &Gated,
    diagnosis: &Diagnosis,
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
) -> Option<Findings> {
    let window = window_of(gated, diagnosis)?;
    let covered = diagnosis.window.as_ref().unwrap_or(&window);
    let settings = settings_of(record, [&window, covered], diagnosed, settings);
    trace(&window, diagnosis, &settings)
}

/// The hypotheses of the first step, for calibration; empty where there is no window to trace.
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
/// * `diagnosis`: the diagnosis of that window: the friction of the declared model, and the verdict that stands where tracing has
///   none.
pub fn trace(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    trace::trace(window, diagnosis, settings).map(|report| report.findings)
}

#[cfg(test)]
mod tests;
