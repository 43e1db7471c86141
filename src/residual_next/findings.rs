//! What tracing finds: the values that leave the module.

use crate::diagnosis::{Model, Residual, Verdict};
pub use crate::residual::{Kind, Parameter, Test};

/// One effect that was added to the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Which.
    pub kind: Kind,
    /// Probability that it is there, given the record (0..1).
    pub posterior: f64,
    /// Evidence: twice the logarithm of the odds for it against none (-).
    pub delta_aic: f64,
    /// The tag it comes from, where it is measured.
    pub tag: Option<String>,
    /// Its numbers.
    pub parameters: Vec<Parameter>,
    /// Where it acts, for a kind that has more than one place: `valve` or `process`.
    pub place: Option<&'static str>,
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
    /// Evidence: twice the logarithm of the odds for friction against the best model without (-).
    pub delta_aic: f64,
    /// Probability of friction (0..1).
    pub posterior: f64,
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
    /// The likeliest kinds at the last step, none (`None`) among them, with their posteriors.
    pub candidates: Vec<(Option<Kind>, f64)>,
    /// The declared model on the held-out samples, which are read once.
    pub before: Residual,
    /// The model with the effects on the same samples.
    pub after: Residual,
    /// Its own free run is worse than the declared model's.
    pub simulates_worse: bool,
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
}
