//! Thresholds and sizes of a diagnosis.

use super::acquisition::ReadingLimits;

/// Thresholds and sizes of a diagnosis. Every published result uses the defaults.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Least f that counts as stiction (% of OP span).
    pub f_threshold: f64,
    /// Least evidence `delta_aic` that counts as stiction (-).
    pub evidence_threshold: f64,
    /// Number of samples that are fitted, from the most regular stretch.
    pub window_samples: usize,
    /// Fewest samples that are diagnosed.
    pub min_samples: usize,
    /// Largest share of samples that may be missing or bad (0..1).
    pub max_gap_share: f64,
    /// Period of the rows (s); `None` takes the controller's scan where the record shows it, else the period of the stamps.
    pub ts: Option<f64>,
    /// Longest delay of the process that is searched (samples).
    pub max_delay: usize,
    /// The limits by which OP and PV count as read together.
    pub reading: ReadingLimits,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            f_threshold: 0.05,
            evidence_threshold: 20.0,
            window_samples: 1000,
            min_samples: 200,
            max_gap_share: 0.5,
            ts: None,
            max_delay: 10,
            reading: ReadingLimits::default(),
        }
    }
}
