//! The findings of tracing: the types that other modules read.

use crate::diagnosis::{Model, NotIdentifiable, Residual, Verdict};
use crate::sysid::valve::ValveModel;
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
    /// Friction differs by direction.
    AsymmetricFriction,
    /// Friction changes over the window.
    FrictionDrift,
    /// PV moves in steps larger than its noise.
    QuantisedPv,
    /// Single PV samples far off.
    Outliers,
    /// PV stands still while the process moves.
    FrozenPv,
    /// PV's time stamps are early or late against those of OP.
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

    /// Whether it describes how friction varies, so that it means nothing without friction.
    pub fn is_of_friction(self) -> bool {
        matches!(self, Kind::AsymmetricFriction | Kind::FrictionDrift)
    }

    /// Whether it acts between OP and PV: on the valve, or on how the process answers the valve.
    pub fn is_between_op_and_pv(self) -> bool {
        use Kind::*;
        matches!(
            self,
            GainChange
                | DeadTimeChange
                | ValveSaturation
                | StaticNonlinearity
                | SlipJump
                | AsymmetricFriction
                | FrictionDrift
        )
    }

    /// Whether it is a change that sets in at a time and lasts.
    pub fn is_change(self) -> bool {
        matches!(self, Kind::LoadStep | Kind::GainChange | Kind::DeadTimeChange)
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

/// An effect in numbers and in one sentence.
#[derive(Clone, Debug, PartialEq)]
pub struct Described {
    /// Its numbers.
    pub parameters: Vec<Parameter>,
    /// Where it acts, for kinds that have more than one place.
    pub place: Option<&'static str>,
    /// One sentence.
    pub explanation: String,
}

impl Described {
    /// A description by this sentence, without numbers.
    pub fn new(explanation: String) -> Self {
        Self { parameters: Vec::new(), place: None, explanation }
    }

    /// The same with one number more.
    pub fn with(mut self, name: &'static str, value: f64, unit: &'static str) -> Self {
        self.parameters.push(Parameter { name, value, unit });
        self
    }

    /// The same with its place.
    pub fn at(mut self, place: &'static str) -> Self {
        self.place = Some(place);
        self
    }
}

/// The evidence for an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Logarithm of the odds for its kind against all other kinds and none, on the fitted samples (-).
    pub log_odds: f64,
    /// Logarithm of the odds for it against the model without it, on the fitted samples (-). Where another kind describes the
    /// record as well, `log_odds` is small, and these odds are not.
    pub over_none: f64,
    /// Standard deviations by which the held-out samples are likelier with it than without it (-).
    pub held_out: f64,
    /// Whether there is friction beside it.
    pub beside_friction: bool,
}

/// One effect that was added to the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Its kind.
    pub kind: Kind,
    /// Probability that it is there, given the record (0..1).
    pub posterior: f64,
    /// The evidence behind that probability; `None` where the signals alone show the effect.
    pub evidence: Option<Evidence>,
    /// Twice the logarithm of the odds for it against the model without it (-).
    pub delta_aic: f64,
    /// The tag it comes from, where it is measured.
    pub tag: Option<String>,
    /// Its numbers.
    pub parameters: Vec<Parameter>,
    /// Where it acts, for a kind that has more than one place: `valve` or `process`.
    pub place: Option<&'static str>,
    /// The sentence that operators read.
    pub explanation: String,
}

/// The friction of one model.
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
    /// Probability of friction (0..1); NaN where the verdict of the diagnosis stands, which has no such probability.
    pub posterior: f64,
}

/// A test of the residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Test {
    /// Ljung–Box: the residual is correlated with its past.
    Whiteness,
    /// It is correlated with the past of the stem (OP, where there is no friction).
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
    /// It depends on the square of the stem's position.
    Travel,
    /// Its variance changes.
    Variance,
    /// Its tails are heavier than a normal distribution's.
    Tails,
}

impl Test {
    /// All tests.
    pub const ALL: [Test; 10] = [
        Test::Whiteness,
        Test::Input,
        Test::Tags,
        Test::Line,
        Test::ChangePoint,
        Test::Drift,
        Test::Direction,
        Test::Travel,
        Test::Variance,
        Test::Tails,
    ];

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

/// The stretch of the record that was traced. It may be longer than the diagnosed window, or shorter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traced {
    /// Time of the first sample (s).
    pub start: f64,
    /// Time of the last sample (s).
    pub end: f64,
    /// Number of samples.
    pub n: usize,
}

/// Signals to draw, one value per sample of the traced window (PV unit).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// Time of the first sample (s).
    pub t0: f64,
    /// Sample period (s).
    pub ts: f64,
    /// First held-out sample.
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

/// Friction by OP and the measured stem, without the process.
#[derive(Clone, Debug, PartialEq)]
pub struct Stem {
    /// Friction fitted on OP -> MV.
    pub friction: Friction,
    /// The residual of that model, traced like PV's.
    pub findings: Option<Box<Findings>>,
}

/// An effect that is expected in the next window, too.
#[derive(Clone, Debug, PartialEq)]
pub enum Lasting {
    /// A periodic load.
    OscillatingLoad {
        /// Its period (s).
        period_s: f64,
        /// How many harmonics it has (-).
        harmonics: usize,
    },
    /// A recorded tag drives PV.
    MeasuredDisturbance {
        /// The tag.
        tag: String,
        /// How much later PV follows (s).
        delay_s: f64,
    },
    /// A curved valve characteristic.
    Characteristic {
        /// Its curvature (1/OP).
        curvature_per_op: f64,
    },
    /// A process gain that depends on PV.
    GainOfPv {
        /// Its relative slope (1/PV).
        gain_per_pv: f64,
    },
    /// The valve runs into a stop.
    ValveSaturation {
        /// Where the stop is (OP unit).
        level: f64,
        /// Whether it is the upper one.
        above: bool,
        /// Whether it holds the stem itself, which then leaves it only when the force has turned.
        held: bool,
    },
    /// Friction that differs by direction.
    AsymmetricFriction {
        /// S is `S (1 + asymmetry)` where OP falls, `S (1 - asymmetry)` where it rises (-).
        asymmetry: f64,
    },
}

/// The structure of a model: what a search found, and the fit of the next window may take as given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Structure {
    /// The valve, without its position at the start (OP unit); `None` where the stem follows OP.
    pub valve: Option<ValveModel>,
    /// Whether OP acts beside a stem that sticks.
    pub direct: bool,
    /// Whether a search tested friction: it cannot where OP hardly reverses.
    pub asked: bool,
    /// The effects beside it, in the order they were added.
    pub effects: Vec<Lasting>,
    /// The tests that the residual failed when the structure was found.
    pub failed: Vec<Test>,
    /// Windows on which it was confirmed since.
    pub confirmed: u32,
    /// End of the window in which it was searched for (s).
    pub searched: f64,
}

/// All findings of tracing.
#[derive(Clone, Debug, PartialEq)]
pub struct Findings {
    /// The stretch of the record in which effects were looked for: the time of an effect may lie outside of the diagnosed window.
    pub traced: Traced,
    /// The effects: first the faults of the data, then the others in the order they were added.
    pub effects: Vec<Effect>,
    /// The kinds that were selected and then rejected: by the held-out samples, or because PV follows OP beyond a stop.
    pub rejected: Vec<(Kind, Evidence)>,
    /// The likeliest kinds at the last step with their posteriors, also the rejected ones; `None` for no further effect.
    pub candidates: Vec<(Option<Kind>, f64)>,
    /// The declared model on the held-out samples; its f is that of the diagnosis, which has seen the whole window.
    pub before: Residual,
    /// The model with the effects on the same samples. They also rejected effects, so that its errors may be too small
    /// ([`super::trace_continued`] measures them on samples that chose nothing).
    pub after: Residual,
    /// Whether the free run of the model with the effects is worse than that of the declared model.
    pub simulates_worse: bool,
    /// Whether the residual is still not white, so that no effect explains it.
    pub unexplained: bool,
    /// The tests that the final residual fails.
    pub failed: Vec<Test>,
    /// Friction without the effects.
    pub friction_before: Friction,
    /// Friction estimated jointly with the effects; it takes the place of `friction_before`.
    pub friction_after: Friction,
    /// The least f that would have shown in this record (OP unit); where the verdict is no stiction, no less than the end of the
    /// interval of f. `None` where no f would have shown, or none is excluded.
    pub f_detectable: Option<f64>,
    /// The largest f that was tried (OP unit): half the largest reversal of OP at which the stem turns.
    pub f_max: f64,
    /// The verdict with the effects.
    pub verdict: Verdict,
    /// The sentence of the verdict, which operators read.
    pub reason: String,
    /// The linear part with the effects.
    pub model: Model,
    /// Signals to draw.
    pub curves: Curves,
    /// Friction from OP to the measured stem, where the stem is measured.
    pub stem: Option<Stem>,
    /// What the fit of the next window may take as given; `None` where the next window has to be searched.
    pub structure: Option<Structure>,
}

impl Findings {
    /// Drops the curves, which are only drawn, also those of the measured stem.
    pub fn drop_curves(&mut self) {
        self.curves = Curves::default();
        let of_stem = self.stem.as_mut().and_then(|stem| stem.findings.as_mut());
        of_stem.into_iter().for_each(|own| own.curves = Curves::default());
    }

    /// Whether they replace the diagnosis' verdict on friction. They do where they have a verdict of their own, or a reason why the
    /// record cannot tell. Verdict, f, its interval and evidence then come from the same hypotheses.
    pub fn replaces_diagnosis(&self) -> bool {
        match &self.verdict {
            Verdict::Stiction | Verdict::NoStiction => true,
            Verdict::NotIdentifiable(why) => {
                use NotIdentifiable::*;
                matches!(
                    why,
                    HiddenFriction { .. }
                        | Undecided { .. }
                        | NoResponse
                        | StemNotFollowed
                        | ReadApart { .. }
                        | Compressed { .. }
                        | PvLate { .. }
                        | Compensated
                )
            }
        }
    }
}
