//! What the declared model leaves unexplained, and why: the residual is traced to an effect that the model lacks, the
//! effect is added, friction and dynamics are estimated again with it, and the error is compared on held-out data.
//!
//! ```text
//! A(q) y = B(q) g(x - lag dir) + sum gamma_i phi_i + c0 + C(q) e
//! ```
//!
//! x is the stem of the friction element driven by OP, g what the valve or process does to it (clip, curvature, change of
//! gain or delay) and phi the shapes of loads and measured disturbances. Everything is fitted on the first 70 % of the
//! window; an effect stays only if the last 30 %, which no fit has seen, is predicted better with it.
//! Pure: the same window gives the same findings.

mod candidate;
mod cells;
mod checks;
mod climb;
mod direct;
mod effects;
mod evidence;
mod filters;
mod findings;
mod fit;
mod free;
mod growing;
mod lanes;
mod model;
mod needless;
mod paths;
mod pose;
mod proposals;
mod regress;
mod rival;
mod run;
mod scan;
mod search;
mod select;
mod slip;
mod slopes;
mod staged;
mod step;

use crate::diagnosis::{self, Diagnosis, Model, Residual, Verdict, gate, prepare};
use crate::signal::{Record, Window};
use std::fmt;

/// An effect beside friction and linear dynamics: the closed list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// A periodic load.
    OscillatingLoad,
    /// A recorded tag drives PV.
    MeasuredDisturbance,
    /// A load that changes once and stays.
    LoadStep,
    /// A load or sensor that runs away at a constant rate.
    Drift,
    /// The process gain changes at some time.
    GainChange,
    /// The dead time changes at some time.
    DeadTimeChange,
    /// The stem runs into a stop.
    ValveSaturation,
    /// A curved valve characteristic or process gain.
    StaticNonlinearity,
    /// Kinetic lag: S and J differ.
    SlipJump,
    /// Friction differs between opening and closing.
    AsymmetricFriction,
    /// Friction changes over the window.
    FrictionDrift,
    /// PV moves in steps larger than its noise.
    QuantisedPv,
    /// Single PV samples far off.
    Outliers,
    /// PV stands still while the process moves.
    FrozenPv,
    /// OP and PV are stamped by clocks that disagree.
    ClockSkew,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Kind; 15] = [
        Kind::OscillatingLoad,
        Kind::MeasuredDisturbance,
        Kind::LoadStep,
        Kind::Drift,
        Kind::GainChange,
        Kind::DeadTimeChange,
        Kind::ValveSaturation,
        Kind::StaticNonlinearity,
        Kind::SlipJump,
        Kind::AsymmetricFriction,
        Kind::FrictionDrift,
        Kind::QuantisedPv,
        Kind::Outliers,
        Kind::FrozenPv,
        Kind::ClockSkew,
    ];

    /// The kind as the report writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Kind::OscillatingLoad => "oscillating_load",
            Kind::MeasuredDisturbance => "measured_disturbance",
            Kind::LoadStep => "load_step",
            Kind::Drift => "drift",
            Kind::GainChange => "gain_change",
            Kind::DeadTimeChange => "dead_time_change",
            Kind::ValveSaturation => "valve_saturation",
            Kind::StaticNonlinearity => "static_nonlinearity",
            Kind::SlipJump => "slip_jump",
            Kind::AsymmetricFriction => "asymmetric_friction",
            Kind::FrictionDrift => "friction_drift",
            Kind::QuantisedPv => "quantised_pv",
            Kind::Outliers => "outliers",
            Kind::FrozenPv => "frozen_pv",
            Kind::ClockSkew => "clock_skew",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.as_str())
    }
}

/// One number of an effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name in the report; the unit is part of it where it is fixed (`period_s`).
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its unit: `s`, `OP`, `PV`, `OP/s`, `-`.
    pub unit: &'static str,
}

/// One effect that was added to the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Which.
    pub kind: Kind,
    /// Evidence when it was added: see [`Settings::least_gain`]; of a repair the decrease of AIC (-).
    pub delta_aic: f64,
    /// The tag it comes from, where it is measured.
    pub tag: Option<String>,
    /// Its numbers.
    pub parameters: Vec<Parameter>,
    /// In one sentence.
    pub explanation: String,
}

/// Friction as one of the models has it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Friction {
    /// Friction parameter, S/2 (OP unit).
    pub f: f64,
    /// 95 % interval of f (OP unit).
    pub f_ci95: [f64; 2],
    /// Kinetic lag (S - J)/2 (OP unit).
    pub lag: f64,
    /// Evidence against the same model without friction (-).
    pub delta_aic: f64,
}

/// A test of the residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Test {
    /// Ljung–Box: the residual is correlated with its past.
    Whiteness,
    /// It is correlated with past OP.
    Input,
    /// It is correlated with the past of a tag.
    Tags,
    /// Fisher's g: its spectrum has a line.
    Line,
    /// Its level changes.
    ChangePoint,
    /// Its level drifts.
    Drift,
    /// It depends on the stem's direction.
    Direction,
    /// It depends on the stem's position.
    Travel,
    /// Its variance changes.
    Variance,
    /// Its tails are heavier than a normal distribution's.
    Tails,
}

impl Test {
    /// The test as the report writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Test::Whiteness => "whiteness",
            Test::Input => "input",
            Test::Tags => "tags",
            Test::Line => "line_spectrum",
            Test::ChangePoint => "change_point",
            Test::Drift => "drift",
            Test::Direction => "direction",
            Test::Travel => "travel",
            Test::Variance => "variance",
            Test::Tails => "tails",
        }
    }
}

/// Signals to draw, one value per sample of the traced window (PV unit).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// Time of the first sample (s).
    pub t0: f64,
    /// Sample period (s).
    pub ts: f64,
    /// First sample that no fit has seen.
    pub split: usize,
    /// Measured PV.
    pub pv: Vec<f64>,
    /// Free run of the declared model.
    pub free_before: Vec<f64>,
    /// Free run with the effects.
    pub free_after: Vec<f64>,
    /// One-step residual of the declared model.
    pub residual_before: Vec<f64>,
    /// One-step residual with the effects.
    pub residual_after: Vec<f64>,
}

/// What OP and the measured stem say directly.
#[derive(Clone, Debug, PartialEq)]
pub struct Stem {
    /// Friction fitted on OP -> MV.
    pub friction: Friction,
    /// The residual of that model, traced like PV's.
    pub findings: Option<Box<Findings>>,
}

/// Everything that tracing found.
#[derive(Clone, Debug, PartialEq)]
pub struct Findings {
    /// In the order they were added; empty when the declared model suffices.
    pub effects: Vec<Effect>,
    /// The declared model on held-out data.
    pub before: Residual,
    /// The model with the effects on held-out data.
    pub after: Residual,
    /// The residual is still not white and no effect explains it.
    pub unexplained: bool,
    /// The tests that the final residual fails.
    pub failed: Vec<Test>,
    /// Friction without the effects.
    pub friction_before: Friction,
    /// Friction estimated jointly with the effects: it replaces the one before.
    pub friction_after: Friction,
    /// The verdict with the effects.
    pub verdict: Verdict,
    /// That verdict in one line.
    pub reason: String,
    /// The linear part with the effects.
    pub model: Model,
    /// Signals to draw.
    pub curves: Curves,
    /// OP -> measured stem, where there is one.
    pub stem: Option<Stem>,
    /// Candidates that were fitted.
    pub tried: usize,
}

/// How long and how boldly to trace.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Most effects added.
    pub most_effects: usize,
    /// Evidence that an effect must bring: twice the log-likelihood gained by a long model over all samples, less what its
    /// numbers and the search for them cost (-).
    pub least_gain: f64,
    /// Least f that counts as stiction (OP unit).
    pub f_threshold: f64,
    /// Least evidence that counts as stiction (-).
    pub evidence_threshold: f64,
    /// Longest delay of a tag (samples).
    pub most_lag: usize,
    /// Candidates fitted before the search ends with what it has: the budget, counted and not timed, so that the same
    /// window gives the same findings.
    pub most_fits: usize,
    /// The one effect that is known to be there: it alone is fitted, and it stays whatever it brings.
    pub only: Option<Kind>,
    /// Effects of the last diagnosis (with tag): tried first, without paying for the search that found them.
    pub known: Vec<(Kind, Option<String>)>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            most_effects: 3,
            least_gain: 8.0,
            f_threshold: 0.05,
            evidence_threshold: 20.0,
            most_lag: 30,
            most_fits: 4000,
            only: None,
            known: Vec::new(),
        }
    }
}

/// Most samples traced: longer records are cut to the stretch about the diagnosed window.
const MOST_SAMPLES: usize = 2000;

/// The window to trace: the whole gated record where the diagnosis looks at its most regular stretch only, since a change
/// outside that stretch is an effect too; at its sample period, and at most 2,000 samples about its window.
pub fn window(record: &Record, diagnosis: &Diagnosis, settings: &diagnosis::Settings) -> Option<Window> {
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
    let span = record.op_span.filter(|span| span.is_finite() && *span > 0.0).unwrap_or(100.0);
    // Thresholds are per cent of OP's span there and OP units here.
    let settings = Settings {
        f_threshold: diagnosed.f_threshold * span / 100.0,
        evidence_threshold: diagnosed.evidence_threshold,
        ..settings.clone()
    };
    trace(&window, diagnosis, &settings)
}

/// Traces the residual of a diagnosed window; `None` where the window is too short or too still to fit anything.
///
/// * `window`: the gated window, with every tag that may explain PV.
/// * `diagnosis`: what was found on it: the start of friction, and the verdict that stands if no effect is found.
pub fn trace(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    select::trace(window, diagnosis, settings)
}
