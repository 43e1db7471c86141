//! What tracing finds: the values that leave the module.

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

    /// Whether it says how friction differs, so that it means nothing without friction.
    pub fn is_of_friction(self) -> bool {
        matches!(self, Kind::AsymmetricFriction | Kind::FrictionDrift)
    }

    /// Whether it is of the valve, or of how the process answers to it.
    pub fn is_of_the_valve(self) -> bool {
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

    /// Whether it sets in at a time and stays.
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

/// What speaks for an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Logarithm of the odds for its kind, none and the other kinds together against it, on the samples that were fitted (-).
    pub log_odds: f64,
    /// Standard deviations by which the samples that nothing was fitted to speak for it (-).
    pub held_out: f64,
    /// Whether the valve sticks beside it.
    pub beside_friction: bool,
}

/// One effect that was added to the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Which.
    pub kind: Kind,
    /// Probability that it is there, given the record (0..1).
    pub posterior: f64,
    /// What that follows from; `None` where the signals alone show the effect.
    pub evidence: Option<Evidence>,
    /// Twice the logarithm of the odds for it against none (-).
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
    /// Probability of friction (0..1); NaN where the diagnosis stands, which has none.
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

/// What a search found, and the next fit may take as given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Structure {
    /// The valve, its place at the start left out (OP unit); `None` where the stem follows OP.
    pub valve: Option<ValveModel>,
    /// Whether OP acts beside a stem that sticks.
    pub direct: bool,
    /// Whether a search asked for friction; a record in which OP hardly reverses is not asked.
    pub asked: bool,
    /// The effects beside it, in the order they were added.
    pub effects: Vec<Lasting>,
    /// The tests that the residual failed when the structure was found.
    pub failed: Vec<Test>,
    /// Windows on which it was confirmed since.
    pub confirmed: u32,
    /// Where the window ended in which it was searched for (s).
    pub searched: f64,
}

/// Everything that tracing found.
#[derive(Clone, Debug, PartialEq)]
pub struct Findings {
    /// In the order they were added; empty when the declared model suffices.
    pub effects: Vec<Effect>,
    /// What was likeliest until samples spoke against it that nothing was fitted to, or until PV was seen to follow OP beyond a
    /// stop.
    pub rejected: Vec<(Kind, Evidence)>,
    /// The likeliest kinds at the last step, those rejected and none (`None`) among them, with their posteriors.
    pub candidates: Vec<(Option<Kind>, f64)>,
    /// The declared model on the held-out samples; its f is the diagnosis', of the whole window.
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
    /// The least f that this record would have shown (OP unit), where no stiction is told no less than what the likelihood
    /// leaves possible; `None` where it could have shown none.
    pub f_detectable: Option<f64>,
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
    /// What the next window's fit may take as given; `None` where it has to search.
    pub structure: Option<Structure>,
}

impl Findings {
    /// Drops what is only drawn, of the stem too.
    pub fn drop_curves(&mut self) {
        self.curves = Curves::default();
        let of_stem = self.stem.as_mut().and_then(|stem| stem.findings.as_mut());
        of_stem.into_iter().for_each(|own| own.curves = Curves::default());
    }

    /// Whether they replace what the diagnosis says of friction: they do wherever they can tell it, or know that the record
    /// cannot, so that verdict, f, its interval and evidence come from one table.
    pub fn replaces_diagnosis(&self) -> bool {
        match &self.verdict {
            Verdict::Stiction | Verdict::NoStiction => true,
            Verdict::NotIdentifiable(why) => {
                use NotIdentifiable::*;
                matches!(
                    why,
                    HiddenFriction { .. } | NoResponse | StemNotFollowed | ReadApart { .. } | Compensated
                )
            }
        }
    }
}
