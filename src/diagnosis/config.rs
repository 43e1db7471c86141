//! The section `[diagnosis]` of the configuration file.

use super::acquisition::ReadingLimits;
use super::screen::LONGEST_DELAY;
use super::settings::Settings;
use super::verdict::least_samples;
use serde::Deserialize;

/// `[diagnosis]`: thresholds and sizes of a diagnosis. Every published result uses the defaults.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Least f that counts as stiction (% of OP span).
    pub f_threshold_percent: f64,
    /// Least evidence `delta_aic` that counts as stiction (-).
    pub evidence_threshold: f64,
    /// Number of samples that are fitted, from the most regular stretch.
    pub window_samples: usize,
    /// Fewest samples that are diagnosed.
    pub min_samples: usize,
    /// Largest share of samples that may be missing or bad (0..1).
    pub max_gap_share: f64,
    /// Period of the rows (s); without it the controller's scan where the record shows it, else the period of the stamps.
    pub ts_s: Option<f64>,
    /// Longest delay of the process that is searched (samples).
    pub max_delay_samples: usize,
}

impl Default for Config {
    fn default() -> Self {
        let settings = Settings::default();
        Self {
            f_threshold_percent: settings.f_threshold,
            evidence_threshold: settings.evidence_threshold,
            window_samples: settings.window_samples,
            min_samples: settings.min_samples,
            max_gap_share: settings.max_gap_share,
            ts_s: settings.ts,
            max_delay_samples: settings.max_delay,
        }
    }
}

impl Config {
    /// All errors, as pairs of field and message; empty where there is none.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut issues = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                issues.push((field, message));
            }
        };
        let f = self.f_threshold_percent;
        unless((0.0..=100.0).contains(&f), "f_threshold_percent", format!("{f} must be 0 to 100"));
        let evidence = self.evidence_threshold;
        let ok = evidence.is_finite() && evidence >= 0.0;
        unless(ok, "evidence_threshold", format!("{evidence} must be a number from 0"));
        let (least, most) = (self.min_samples, self.window_samples);
        unless((50..=20_000).contains(&most), "window_samples", format!("{most} must be 50 to 20000"));
        let delay = self.max_delay_samples;
        let needed = least_samples(delay.clamp(1, LONGEST_DELAY));
        unless(
            least >= needed,
            "min_samples",
            format!(
                "{least} must be at least {needed}: a fit with max_delay_samples = {delay} needs so many"
            ),
        );
        unless(
            least <= most,
            "min_samples",
            format!("{least} is more than window_samples = {most}: no window could be long enough"),
        );
        let share = self.max_gap_share;
        unless((0.0..=0.9).contains(&share), "max_gap_share", format!("{share} must be 0 to 0.9"));
        if let Some(ts) = self.ts_s {
            let ok = ts.is_finite() && ts > 0.0;
            unless(ok, "ts_s", format!("{ts} must be a number of seconds above 0"));
        }
        unless(
            (1..=LONGEST_DELAY).contains(&delay),
            "max_delay_samples",
            format!("{delay} must be 1 to {LONGEST_DELAY}: sample more slowly (ts_s) for more dead time"),
        );
        issues
    }
}

impl From<&Config> for Settings {
    fn from(config: &Config) -> Self {
        Self {
            f_threshold: config.f_threshold_percent,
            evidence_threshold: config.evidence_threshold,
            window_samples: config.window_samples,
            min_samples: config.min_samples,
            max_gap_share: config.max_gap_share,
            ts: config.ts_s,
            max_delay: config.max_delay_samples,
            reading: ReadingLimits::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_the_published_settings() {
        assert_eq!(Settings::from(&Config::default()), Settings::default());
        assert_eq!(Config::default().validate(), []);
    }

    #[test]
    fn no_fewer_samples_are_asked_for_than_a_fit_needs() {
        let with = |min_samples, max_delay_samples| {
            let config = Config { min_samples, max_delay_samples, ..Config::default() };
            config.validate().into_iter().map(|(_, message)| message).collect::<Vec<_>>()
        };
        assert_eq!(
            with(100, 10),
            ["100 must be at least 139: a fit with max_delay_samples = 10 needs so many".to_string()]
        );
        assert!(with(139, 10).is_empty() && with(159, 30).is_empty());
        assert_eq!((with(138, 10).len(), with(158, 30).len()), (1, 1));
    }

    #[test]
    fn every_bad_field_is_named_at_once() {
        let bad = Config {
            f_threshold_percent: f64::NAN,
            evidence_threshold: -1.0,
            window_samples: 49,
            min_samples: 200,
            max_gap_share: 1.0,
            ts_s: Some(0.0),
            max_delay_samples: LONGEST_DELAY + 1,
        };
        let fields: Vec<_> = bad.validate().into_iter().map(|(field, _)| field).collect();
        let expected = [
            "f_threshold_percent",
            "evidence_threshold",
            "window_samples",
            "min_samples",
            "max_gap_share",
            "ts_s",
            "max_delay_samples",
        ];
        assert_eq!(fields, expected);
    }
}
