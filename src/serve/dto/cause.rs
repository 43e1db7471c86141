//! Why a loop was not at rest, as the API writes it.

use super::rfc3339;
use crate::serve::ports::Overview;
use crate::signal::LoopId;
use serde::Serialize;
use utoipa::ToSchema;

/// Why a loop was not at rest by the latest look at the plant.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct LoopCause {
    /// When the plant was looked at.
    pub time: Option<String>,
    /// The cause that is named: `valve`, `tuning`, `load`, `sensor`, `neighbour`, `saturation` or `unknown`.
    #[schema(value_type = String, example = "neighbour")]
    pub name: &'static str,
    /// Its probability (0..1); null for `unknown`.
    pub probability: Option<f64>,
    /// In a sentence.
    pub why: String,
    /// The likeliest source of the loop's group, where the cause is `neighbour`; null otherwise.
    pub neighbour: Option<String>,
    /// The probability of every cause, and of `at_rest`, the largest first.
    pub causes: Vec<CauseProbability>,
}

/// A cause with its probability.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct CauseProbability {
    /// `valve`, `tuning`, `load`, `sensor`, `neighbour`, `saturation`, or `at_rest`.
    #[schema(value_type = String, example = "valve")]
    pub name: &'static str,
    /// Probability (0..1).
    pub probability: f64,
}

impl LoopCause {
    /// The cause of a loop; `None` where it was at rest, or could not be judged.
    pub fn of(found: &Overview, id: &LoopId) -> Option<Self> {
        let own = found.causes.get(id)?;
        let likely =
            |(name, probability): &(&'static str, f64)| CauseProbability { name, probability: *probability };
        Some(Self {
            time: rfc3339(found.at),
            name: own.name,
            probability: own.probability,
            why: own.why.clone(),
            neighbour: own.neighbour.as_ref().map(LoopId::to_string),
            causes: own.causes.iter().map(likely).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::serve::ports::CauseSeen;
    use serde_json::json;

    #[test]
    fn a_victim_has_its_source_and_every_cause_and_a_loop_at_rest_has_none() {
        let [victim, source] = ["LIC201", "FIC102"].map(LoopId::new);
        let seen = CauseSeen {
            name: "neighbour",
            probability: Some(0.75),
            why: "it swings with 1 other at a period of 60 s".into(),
            neighbour: Some(source.clone()),
            causes: vec![("neighbour", 0.75), ("valve", 0.25)],
        };
        let found = Overview { at: 0.0, causes: [(victim.clone(), seen)].into(), ..Overview::default() };
        assert_eq!(
            serde_json::to_value(LoopCause::of(&found, &victim)).expect("JSON"),
            json!({
                "time": "1970-01-01T00:00:00Z", "name": "neighbour", "probability": 0.75,
                "why": "it swings with 1 other at a period of 60 s", "neighbour": "FIC102",
                "causes": [{"name": "neighbour", "probability": 0.75}, {"name": "valve", "probability": 0.25}],
            })
        );
        assert_eq!(LoopCause::of(&found, &source), None);
    }
}
