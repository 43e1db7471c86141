//! What a run worked on, as text that is kept beside its report.

use super::Structure;
use crate::diagnosis::{self, Settings};
use crate::results::{Basis, Before, Extent, Silent};
use crate::signal::{Role, SpanSource};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a run worked on, beside the samples themselves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BasisText {
    /// Settings of the diagnosis.
    pub settings: SettingsText,
    /// What the last run found and this one may take as given; null where everything is searched for.
    pub structure: Option<Structure>,
    /// Friction as it was found last while no term of write-back acted, and its 95 % interval (% of OP span); null where
    /// none is known.
    #[serde(default)]
    pub f_before: Option<[f64; 3]>,
    /// The span of OP (OP unit).
    pub op_span: Option<f64>,
    /// Where that is known from.
    pub op_span_source: String,
    /// The controller's output limits (OP unit).
    pub op_limits: Option<[f64; 2]>,
    /// Whether the process integrates; null where that is not known.
    pub integrates: Option<bool>,
    /// Which of OP and PV was silent, so that nothing was diagnosed; left out where neither was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub silent: Option<SilentText>,
    /// What stands for where OP and PV were read: an FNV-1a of that, 16 hexadecimal digits; left out where nobody said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Which samples of each tag.
    pub tags: Vec<ExtentText>,
}

/// A tag that was silent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SilentText {
    /// `op` or `pv`.
    pub tag: String,
    /// Stamp of its last good sample (s).
    pub since: f64,
}

/// Settings of a diagnosis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SettingsText {
    /// Least f that counts as stiction (% of OP span).
    pub f_threshold_percent: f64,
    /// Least evidence that counts as stiction (-).
    pub evidence_threshold: f64,
    /// Samples taken from the most regular stretch.
    pub window_samples: usize,
    /// Fewest samples a diagnosis is tried on.
    pub min_samples: usize,
    /// Largest share of samples that may be missing or bad (0..1).
    pub max_gap_share: f64,
    /// Sample period to resample to (s); null takes the controller's scan where the record shows it, else the period of the stamps.
    pub ts_s: Option<f64>,
    /// Longest process delay searched (samples).
    pub max_delay_samples: usize,
}

/// Which samples of a tag: all between two stamps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ExtentText {
    /// `op`, `pv`, `sp`, `mode`, `mv` or another tag's name.
    pub tag: String,
    /// Samples.
    pub n: usize,
    /// Stamps of the first and the last (s); null when there is none.
    pub span: Option<[f64; 2]>,
    /// FNV-1a over stamps, values and qualities, 16 hexadecimal digits.
    pub digest: String,
}

impl From<&Basis> for BasisText {
    fn from(basis: &Basis) -> Self {
        let extent = |own: &Extent| ExtentText {
            tag: own.tag.clone(),
            n: own.n,
            span: own.span.map(<[f64; 2]>::from),
            digest: format!("{:016x}", own.digest),
        };
        let Settings {
            f_threshold,
            evidence_threshold,
            window_samples,
            min_samples,
            max_gap_share,
            ts,
            max_delay,
            // No configuration has other limits.
            reading: _,
        } = basis.settings;
        Self {
            settings: SettingsText {
                f_threshold_percent: f_threshold,
                evidence_threshold,
                window_samples,
                min_samples,
                max_gap_share,
                ts_s: ts,
                max_delay_samples: max_delay,
            },
            structure: basis.structure.as_ref().map(Structure::from),
            f_before: basis.before.map(|own| [own.f, own.f_ci95[0], own.f_ci95[1]]),
            op_span: basis.op_span,
            op_span_source: basis.op_span_source.as_str().to_string(),
            op_limits: basis.op_limits.map(<[f64; 2]>::from),
            integrates: basis.integrates,
            silent: basis
                .silent
                .map(|own| SilentText { tag: own.tag.as_str().to_string(), since: own.since }),
            source: basis.source.map(|own| format!("{own:016x}")),
            tags: basis.extents.iter().map(extent).collect(),
        }
    }
}

impl BasisText {
    /// What a run worked on as text.
    pub fn text(basis: &Basis) -> Option<String> {
        serde_json::to_string(&Self::from(basis)).ok()
    }

    /// What such a text says; `None` for what this version cannot read.
    pub fn read(text: &str) -> Option<Basis> {
        serde_json::from_str::<Self>(text).ok()?.basis().ok()
    }

    /// What the run worked on.
    ///
    /// # Errors
    /// A structure that this version does not know, and settings that no configuration may have.
    pub fn basis(&self) -> Result<Basis, String> {
        let own = &self.settings;
        let config = diagnosis::Config {
            f_threshold_percent: own.f_threshold_percent,
            evidence_threshold: own.evidence_threshold,
            window_samples: own.window_samples,
            min_samples: own.min_samples,
            max_gap_share: own.max_gap_share,
            ts_s: own.ts_s,
            max_delay_samples: own.max_delay_samples,
        };
        if let Some((field, message)) = config.validate().into_iter().next() {
            return Err(format!("its settings cannot be used: {field}: {message}"));
        }
        let span = self.op_span.is_none_or(|span| span.is_finite() && span > 0.0);
        let limits =
            self.op_limits.is_none_or(|[low, high]| low.is_finite() && high.is_finite() && low < high);
        if !span || !limits {
            return Err("its span or limits of OP cannot be used: they must be numbers, and not empty".into());
        }
        let known = "it knows a structure or tags that this version does not";
        self.with(Settings::from(&config)).ok_or_else(|| known.to_string())
    }

    fn with(&self, settings: Settings) -> Option<Basis> {
        let extent = |own: &ExtentText| {
            let digest = u64::from_str_radix(&own.digest, 16).ok()?;
            Some(Extent { tag: own.tag.clone(), n: own.n, span: own.span.map(<(f64, f64)>::from), digest })
        };
        let silent = |own: &SilentText| {
            let tag = [Role::Op, Role::Pv].into_iter().find(|role| role.as_str() == own.tag)?;
            Some(Silent { tag, since: own.since })
        };
        Some(Basis {
            settings,
            structure: match &self.structure {
                Some(own) => Some(own.read()?),
                None => None,
            },
            before: self.f_before.map(|[f, low, high]| Before { f, f_ci95: [low, high] }),
            op_span: self.op_span,
            op_span_source: SpanSource::from_name(&self.op_span_source),
            op_limits: self.op_limits.map(<(f64, f64)>::from),
            integrates: self.integrates,
            silent: match &self.silent {
                Some(own) => Some(silent(own)?),
                None => None,
            },
            source: match &self.source {
                Some(own) => Some(u64::from_str_radix(own, 16).ok()?),
                None => None,
            },
            extents: self.tags.iter().map(extent).collect::<Option<_>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::{self, Test};
    use crate::signal::{Record, Sample};
    use crate::sysid::valve::{StopRule, ValveModel};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_comes_back_to_the_last_bit(times in proptest::collection::vec(0.0..2e9f64, 0..20), threshold in 1e-9..100f64) {
            let op: Vec<Sample> = times.iter().map(|t| Sample::good(*t, t.sin())).collect();
            let settings = Settings { f_threshold: threshold, ts: Some(threshold / 3.0), ..Settings::default() };
            let integrates = Some(threshold > 1.0);
            let source = (threshold > 30.0).then_some(threshold.to_bits());
            let record = Record { op, op_limits: Some((-0.1, threshold)), integrates, source, ..Record::default() };
            let valve = (threshold > 1.0).then(|| ValveModel {
                s: threshold,
                j: threshold / 3.0,
                rule: StopRule::ALL[(threshold * 10.0) as usize % 3],
                resolution: threshold / 700.0,
                ..ValveModel::default()
            });
            let effects = vec![
                residual::Lasting::OscillatingLoad { period_s: threshold / 7.0, harmonics: 3 },
                residual::Lasting::MeasuredDisturbance { tag: "a.pv".to_string(), delay_s: threshold / 9.0 },
                residual::Lasting::Characteristic { curvature_per_op: -threshold / 13.0 },
                residual::Lasting::GainOfPv { gain_per_pv: threshold / 17.0 },
                residual::Lasting::ValveSaturation { level: threshold / 19.0, above: threshold > 2.0, held: threshold > 4.0 },
                residual::Lasting::AsymmetricFriction { asymmetry: threshold / 101.0 },
            ];
            // As many as one model ever has.
            let effects = effects.into_iter().skip(threshold as usize % 5).take(3).collect();
            let failed = Test::ALL[..(threshold / 10.0) as usize].to_vec();
            let known = residual::Structure { valve, direct: threshold > 3.0, asked: threshold > 6.0, effects, failed, searched: threshold / 11.0, confirmed: threshold as u32 };
            let known = (threshold > 0.1).then_some(known);
            let before = (threshold > 50.0).then_some(Before { f: threshold, f_ci95: [0.1, 2.0 * threshold] });
            let tag = if threshold > 20.0 { Role::Op } else { Role::Pv };
            let silent = (threshold > 10.0).then_some(Silent { tag, since: 1e9 * threshold });
            let basis = Basis::of(&record, &settings, known).after(before).silent(silent);
            prop_assert_eq!(BasisText::read(&BasisText::text(&basis).expect("text")), Some(basis));
        }
    }
}
