//! What the latest look found of a loop beside its indicators, as the API writes it: what is no single number.

use super::{finite, rfc3339};
use crate::indicators::distribution::Distribution;
use crate::indicators::margins::Margins;
use crate::indicators::oscillation::Oscillation;
use crate::indicators::settling::Settling;
use crate::serve::ports::LoopLook;
use serde::Serialize;
use utoipa::ToSchema;

/// What the latest look found of a loop beside its indicators: of its whole record, a week at most.
#[derive(Debug, Serialize, ToSchema)]
pub struct LatestLook {
    /// When the loop was looked at.
    pub time: Option<String>,
    /// The Harris index; null where the error is too short or does not move.
    pub harris: Option<HarrisItem>,
    /// Gain and phase margin; null where they are not known.
    pub margins: Option<MarginsItem>,
    /// How steps of the set point were followed; null without one to look at.
    pub settling: Option<SettlingItem>,
    /// Oscillations of the error, the largest first, three at most.
    pub oscillations: Vec<SwingItem>,
    /// Where OP stayed between its limits; null where these are not known.
    pub op_distribution: Option<DistributionItem>,
}

/// The Harris index: of all samples of a record that is not thinned, else of its latest 3,600 samples or its latest hour.
#[derive(Debug, Serialize, ToSchema)]
pub struct HarrisItem {
    /// Least possible variance of the error over its variance (0..1).
    pub index: f64,
    /// Its 95 % interval; null where the record is too short for one.
    pub ci95: Option<[f64; 2]>,
    /// Dead time of the process that it is for, one sample more (s); null where it is for one sample.
    pub dead_time_s: Option<f64>,
    /// Where the dead time is from: `model`, or `one_sample` where no good model had one.
    #[schema(value_type = String, example = "model")]
    pub dead_time_from: &'static str,
}

/// The margins of the loop, by its controller and the linear model of its latest diagnosis.
#[derive(Debug, Serialize, ToSchema)]
pub struct MarginsItem {
    /// Gain margin (-): the factor by which the loop's gain may grow before it swings without end; null without a phase crossover.
    pub gain: Option<f64>,
    /// Phase margin (degrees); null without a gain crossover.
    pub phase_deg: Option<f64>,
    /// Period of the gain crossover (s), with about which a tight loop swings; null without one.
    pub period_s: Option<f64>,
    /// Both margins in words; empty where neither is known.
    pub words: String,
}

/// How steps of the set point were followed.
#[derive(Debug, Serialize, ToSchema)]
pub struct SettlingItem {
    /// Steps that were looked at.
    pub steps: usize,
    /// Those after which PV settled.
    pub settled: usize,
    /// Median settling time of these (s); null where no step settled.
    pub time_s: Option<f64>,
    /// Median overshoot as a share of the step (-).
    pub overshoot: Option<f64>,
}

/// One oscillation of the error.
#[derive(Debug, Serialize, ToSchema)]
pub struct SwingItem {
    /// Period (s).
    pub period_s: Option<f64>,
    /// `r = mean(T) / (3 sd(T))` (-); above 1 is regular.
    pub regularity_r: Option<f64>,
    /// R, how it lasts (-): 1 for a wave that does not die away.
    pub lasting: Option<f64>,
    /// Share of the error's variance (0..1).
    pub share: Option<f64>,
    /// Amplitude (PV unit).
    pub amplitude: Option<f64>,
    /// Probability that it is no chance (0..1).
    pub probability: Option<f64>,
}

/// Where OP stayed between its limits.
#[derive(Debug, Serialize, ToSchema)]
pub struct DistributionItem {
    /// 5 % quantile (OP unit).
    pub q05: Option<f64>,
    /// Median (OP unit).
    pub q50: Option<f64>,
    /// 95 % quantile (OP unit).
    pub q95: Option<f64>,
    /// Share of the samples in each twentieth between the limits.
    pub histogram: Vec<f64>,
}

impl From<&LoopLook> for LatestLook {
    fn from(own: &LoopLook) -> Self {
        let harris = own.harris.map(|harris| HarrisItem {
            index: harris.index,
            ci95: harris.interval.map(|(low, high)| [low, high]),
            dead_time_s: own.dead_time_s.and_then(finite),
            dead_time_from: if own.dead_time_s.is_some() { "model" } else { "one_sample" },
        });
        Self {
            time: rfc3339(own.at),
            harris,
            margins: own.margins.as_ref().map(MarginsItem::from),
            settling: own.settling.as_ref().map(SettlingItem::from),
            oscillations: own.oscillations.iter().map(SwingItem::from).collect(),
            op_distribution: own.distribution.as_ref().map(DistributionItem::from),
        }
    }
}

impl From<&Margins> for MarginsItem {
    fn from(own: &Margins) -> Self {
        Self {
            gain: own.gain.and_then(finite),
            phase_deg: own.phase_deg.and_then(finite),
            period_s: own.gain_crossover_s.and_then(finite),
            words: own.words(),
        }
    }
}

impl From<&Settling> for SettlingItem {
    fn from(own: &Settling) -> Self {
        let (steps, settled) = (own.steps, own.settled);
        Self { steps, settled, time_s: own.time_s.and_then(finite), overshoot: finite(own.overshoot) }
    }
}

impl From<&Oscillation> for SwingItem {
    fn from(own: &Oscillation) -> Self {
        Self {
            period_s: finite(own.period_s),
            regularity_r: finite(own.regularity),
            lasting: finite(own.lasting),
            share: finite(own.share),
            amplitude: finite(own.amplitude),
            probability: finite(own.probability()),
        }
    }
}

impl From<&Distribution> for DistributionItem {
    fn from(own: &Distribution) -> Self {
        let [q05, q50, q95] = own.quantiles.map(finite);
        Self { q05, q50, q95, histogram: own.histogram.to_vec() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::indicators::harris::Harris;
    use serde_json::json;

    #[test]
    fn what_is_no_single_number_is_told_with_the_dead_time_and_where_it_is_from() {
        let swing = |period_s| Oscillation {
            period_s,
            regularity: 2.5,
            lasting: 0.75,
            share: 0.5,
            share_of_fast: 0.5,
            steadiness: 1.0,
            periods: 20.0,
            amplitude: 1.5,
        };
        let mut histogram = [0.0; 20];
        (histogram[9], histogram[10]) = (0.25, 0.75);
        let own = LoopLook {
            at: 0.0,
            harris: Some(Harris { index: 0.75, interval: Some((0.5, 0.875)) }),
            dead_time_s: Some(20.0),
            settling: Some(Settling { steps: 4, settled: 3, time_s: Some(42.0), overshoot: 0.125 }),
            oscillations: vec![swing(60.0), swing(600.0)],
            distribution: Some(Distribution { quantiles: [40.0, 50.0, 60.0], histogram }),
            margins: Some(Margins {
                gain: None,
                phase_deg: Some(17.5),
                phase_crossover_s: None,
                gain_crossover_s: Some(120.0),
            }),
        };
        let told = |own: &LoopLook| serde_json::to_value(LatestLook::from(own)).expect("JSON");
        let found = told(&own);
        assert_eq!(found["time"], "1970-01-01T00:00:00Z");
        let harris =
            json!({"index": 0.75, "ci95": [0.5, 0.875], "dead_time_s": 20.0, "dead_time_from": "model"});
        assert_eq!(found["harris"], harris);
        let words = "phase margin 18°";
        assert_eq!(
            found["margins"],
            json!({"gain": null, "phase_deg": 17.5, "period_s": 120.0, "words": words})
        );
        assert_eq!(found["settling"], json!({"steps": 4, "settled": 3, "time_s": 42.0, "overshoot": 0.125}));
        let periods: Vec<f64> = own.oscillations.iter().map(|own| own.period_s).collect();
        let seen = found["oscillations"].as_array().expect("a list");
        assert_eq!(
            seen.iter().map(|own| own["period_s"].as_f64().expect("known")).collect::<Vec<_>>(),
            periods
        );
        assert_eq!((&seen[0]["regularity_r"], &seen[0]["share"]), (&json!(2.5), &json!(0.5)));
        let spread = &found["op_distribution"];
        assert_eq!(
            (&spread["q05"], &spread["q95"], &spread["histogram"][10]),
            (&json!(40.0), &json!(60.0), &json!(0.75))
        );
        let known = LoopLook { dead_time_s: None, settling: None, distribution: None, margins: None, ..own };
        let bare = told(&known);
        assert_eq!(
            (&bare["harris"]["dead_time_s"], &bare["harris"]["dead_time_from"]),
            (&json!(null), &json!("one_sample"))
        );
        let unknown = ["settling", "op_distribution", "margins"];
        assert!(unknown.iter().all(|name| bare[*name].is_null()), "{bare}");
    }
}
