//! `[plantwide]` and `[loop.cost]`: how often the plant is looked at as a whole, and what a loop's swing costs.

use serde::Deserialize;

/// `[plantwide]`: how often all loops are looked at together, and how long a suspicion has to last.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// False to look at every loop alone.
    pub enabled: bool,
    /// Time between two looks (s of plant time).
    pub period_s: f64,
    /// A suspicion has to last this long before it is an open order, and a repair has to hold as long (s of plant time).
    pub persist_s: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { enabled: true, period_s: 3600.0, persist_s: 172_800.0 }
    }
}

impl Config {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        if !(60.0..=604_800.0).contains(&self.period_s) {
            wrong.push(("period_s", format!("{} must be 60 to 604800", self.period_s)));
        }
        let most = 200.0 * self.period_s;
        if wrong.is_empty() && !(self.period_s..=most).contains(&self.persist_s) {
            let (own, least) = (self.persist_s, self.period_s);
            wrong.push(("persist_s", format!("{own} must be {least} (period_s) to {most}")));
        }
        wrong
    }
}

/// `[loop.cost]`: what a loop's swing costs.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CostConfig {
    /// Price of a standard deviation of one PV unit, for as long as `unit` says.
    pub per_sd: f64,
    /// Unit of the price, for people: `EUR/day`.
    #[serde(default)]
    pub unit: String,
}

impl CostConfig {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        if !(self.per_sd.is_finite() && self.per_sd >= 0.0) {
            wrong.push(("per_sd", format!("{} must be 0 or more", self.per_sd)));
        }
        if self.unit.chars().count() > 20 {
            wrong.push(("unit", "at most 20 characters".into()));
        }
        wrong
    }
}
