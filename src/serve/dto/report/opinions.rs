//! What the published methods say, beside the verdict.

use super::super::finite;
use super::unit::OpUnit;
use super::{Report, ReportVerdict};
use crate::detectors::{Agreement, Opinion, Says};
use crate::results::words::{self, Doubt};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What one published method says of the valve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportOpinion {
    /// Whose: its author and year, as docs/benchmark.md names them.
    pub method: String,
    /// What people call it.
    #[serde(default)]
    pub title: String,
    /// What it says.
    pub says: ReportSays,
    /// Its index, larger the more the valve sticks (-); null where the method does not apply.
    pub index: Option<f64>,
    /// The thresholds of the index; null without one.
    pub threshold: Option<ReportThreshold>,
    /// What it measures beside its index; null for most.
    pub quantity: Option<ReportQuantity>,
    /// Unit of the quantity; null without one.
    pub unit: Option<String>,
    /// Why, in one line.
    pub why: String,
}

/// What a method says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReportSays {
    /// The valve sticks.
    Sticks,
    /// What oscillates is not the valve.
    Sound,
    /// The method does not apply, or its index lies between its thresholds.
    CannotTell,
}

impl From<Says> for ReportSays {
    fn from(says: Says) -> Self {
        match says {
            Says::Sticks => Self::Sticks,
            Says::Sound => Self::Sound,
            Says::CannotTell => Self::CannotTell,
        }
    }
}

/// The thresholds of an index.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportThreshold {
    /// Largest index of a sound valve; null where no index clears one.
    pub sound: Option<f64>,
    /// The index above which a valve sticks.
    pub sticks: Option<f64>,
}

/// What a method measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportQuantity {
    /// Its value.
    pub value: Option<f64>,
    /// Its unit: `f_unit`, since all that is measured is measured along OP.
    pub unit: String,
    /// What it is.
    pub measures: String,
}

impl ReportOpinion {
    pub(super) fn new(opinion: &Opinion, unit: &OpUnit) -> Self {
        let quantity = opinion.quantity.map(|quantity| ReportQuantity {
            value: unit.scale(quantity.value),
            unit: unit.name.to_string(),
            measures: quantity.measures.to_string(),
        });
        Self {
            method: opinion.method.as_str().to_string(),
            title: opinion.method.title().to_string(),
            says: opinion.says.into(),
            index: opinion.index.and_then(finite),
            threshold: opinion
                .threshold
                .map(|band| ReportThreshold { sound: finite(band.sound), sticks: finite(band.sticks) }),
            unit: quantity.as_ref().map(|quantity| quantity.unit.clone()),
            quantity,
            why: opinion.why.clone(),
        }
    }
}

/// How the methods agree, with one another and with the verdict. The measured stem is not counted among them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportAgreement {
    /// Methods that say that the valve sticks.
    pub sticks: usize,
    /// Methods that could tell.
    pub could_tell: usize,
    /// Methods that say what the verdict says.
    pub agree: usize,
    /// True where the measured stem is what contradicts the verdict.
    pub by_stem: bool,
    /// True where they contradict the verdict so that somebody should look at the loop.
    pub doubtful: bool,
    /// The same in one line.
    pub why: String,
}

impl From<&Agreement> for ReportAgreement {
    fn from(found: &Agreement) -> Self {
        Self {
            sticks: found.sticks,
            could_tell: found.could_tell,
            agree: found.agree,
            by_stem: found.by_stem,
            doubtful: found.doubtful,
            why: found.why.clone(),
        }
    }
}

impl Report {
    /// That other methods contradict the verdict, in a sentence or two; `None` where they do not.
    pub fn doubt(&self) -> Option<String> {
        let found = self.agreement.as_ref().filter(|found| found.doubtful)?;
        let by = match found.by_stem {
            true => Doubt::Stem,
            false => {
                Doubt::Methods { against: found.could_tell.saturating_sub(found.agree), of: found.could_tell }
            }
        };
        Some(words::doubtful(self.verdict == ReportVerdict::Stiction, by))
    }
}
