//! What a run found and the next may take as given, as text.

use crate::residual::{self, Test};
use crate::sysid::valve::{StopRule, ValveModel};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a search found of a loop's model: a later run fits it anew, and searches only where it no longer holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Structure {
    /// The valve; null where the stem follows OP.
    pub valve: Option<StructureValve>,
    /// Whether OP acts beside a stem that sticks.
    pub direct: bool,
    /// Whether a search asked for friction; a record in which OP hardly reverses is not asked.
    #[serde(default)]
    pub asked: bool,
    /// The effects beside it, in the order they were added.
    pub effects: Vec<Lasting>,
    /// The tests that the residual failed when it was found.
    pub failed_tests: Vec<String>,
    /// Where the window ended in which it was searched for (s).
    pub searched: f64,
    /// Runs in a row that found it still holds, without a search; 0 where this run searched.
    pub confirmed: u32,
}

/// An effect that lasts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
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
        /// Whether it holds the stem itself.
        held: bool,
    },
    /// Friction that differs by direction.
    AsymmetricFriction {
        /// S is `S (1 + asymmetry)` where OP falls, `S (1 - asymmetry)` where it rises (-).
        asymmetry: f64,
    },
}

/// Both ways between two enums whose variants and fields have the same names.
macro_rules! same {
    ($($variant:ident { $($field:ident),+ })+) => {
        impl From<&residual::Lasting> for Lasting {
            fn from(own: &residual::Lasting) -> Self {
                match own.clone() {
                    $(residual::Lasting::$variant { $($field),+ } => Self::$variant { $($field),+ },)+
                }
            }
        }

        impl From<&Lasting> for residual::Lasting {
            fn from(own: &Lasting) -> Self {
                match own.clone() {
                    $(Lasting::$variant { $($field),+ } => Self::$variant { $($field),+ },)+
                }
            }
        }
    };
}

same! {
    OscillatingLoad { period_s, harmonics }
    MeasuredDisturbance { tag, delay_s }
    Characteristic { curvature_per_op }
    GainOfPv { gain_per_pv }
    ValveSaturation { level, above, held }
    AsymmetricFriction { asymmetry }
}

/// A valve that sticks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StructureValve {
    /// When the stem rests: `reversal`, `stop` or `slip`.
    pub rule: String,
    /// Deadband plus stickband S (OP unit).
    pub s: f64,
    /// Slip jump J (OP unit).
    pub j: f64,
    /// Step of OP up to which a stem that moves comes to rest (OP unit).
    pub resolution: f64,
}

fn rule(rule: StopRule) -> &'static str {
    match rule {
        StopRule::Reversal => "reversal",
        StopRule::Stop => "stop",
        StopRule::Slip => "slip",
    }
}

impl From<&residual::Structure> for Structure {
    fn from(own: &residual::Structure) -> Self {
        let valve = |valve: ValveModel| StructureValve {
            rule: rule(valve.rule).to_string(),
            s: valve.s,
            j: valve.j,
            resolution: valve.resolution,
        };
        Self {
            valve: own.valve.map(valve),
            direct: own.direct,
            asked: own.asked,
            effects: own.effects.iter().map(Lasting::from).collect(),
            failed_tests: own.failed.iter().map(|test| test.as_str().to_string()).collect(),
            searched: own.searched,
            confirmed: own.confirmed,
        }
    }
}

impl Structure {
    /// What it says; `None` for names that this version does not know, and for no valve's numbers.
    pub fn read(&self) -> Option<residual::Structure> {
        let valve = |own: &StructureValve| {
            let rule = StopRule::ALL.into_iter().find(|known| rule(*known) == own.rule)?;
            let StructureValve { s, j, resolution, .. } = *own;
            Some(ValveModel { s, j, rule, resolution, ..ValveModel::default() })
                .filter(|valve| valve.is_valid() && [s, j, resolution].iter().all(|band| band.is_finite()))
        };
        // As many as one model ever has.
        if self.effects.len() > residual::Settings::default().most_effects {
            return None;
        }
        let test = |name: &String| Test::ALL.into_iter().find(|test| test.as_str() == name);
        Some(residual::Structure {
            valve: match &self.valve {
                Some(own) => Some(valve(own)?),
                None => None,
            },
            direct: self.direct,
            asked: self.asked,
            effects: self.effects.iter().map(residual::Lasting::from).collect(),
            failed: self.failed_tests.iter().map(test).collect::<Option<_>>()?,
            searched: self.searched,
            confirmed: self.confirmed,
        })
    }
}
