//! An oscillation that the samples are too few for: what is seen of it is another one.
//!
//! A line in OP's spectrum that holds most of its power and has fewer than four samples a period cannot be told from its
//! mirror image about half the sampling frequency (Shannon, Proc. IRE 1949, 37, 10). A running mean over several samples is
//! worth one of them.

use super::{HistoryFound, HistoryKind, NotIdentifiable};
use crate::sysid::spectrum;
use crate::sysid::stats::mean;

/// Samples a period below which nothing is said of a valve: the line may be the mirror image of a faster one.
const LEAST: f64 = 4.0;
/// Samples a period below which an oscillation that shows no reversals is called too fast for the samples.
const FEW: f64 = 10.0;
/// Share of OP's power that the line has to hold: most of it.
const OF_POWER: f64 = 0.5;
/// Half the width of a line, as a part of its frequency: a period that wanders makes it wide.
const WIDTH: f64 = 0.03;

/// Samples in one period of the line that holds most of OP's power, where there is one.
fn samples_a_period(op: &[f64]) -> Option<f64> {
    let middle = mean(op);
    let mut moved: Vec<f64> = op.iter().map(|u| u - middle).collect();
    let n = moved.len() as f64;
    if moved.is_empty() {
        return None;
    }
    let power = spectrum::power(&mut moved);
    let total: f64 = power.iter().skip(1).sum();
    let (at, _) = power.iter().enumerate().skip(1).max_by(|a, b| a.1.total_cmp(b.1))?;
    let reach = ((WIDTH * at as f64).ceil() as usize).max(1);
    let line: f64 = power[at.saturating_sub(reach).max(1)..(at + reach + 1).min(power.len())].iter().sum();
    (total > 0.0 && line > OF_POWER * total).then(|| n / at as f64)
}

/// Whether the samples are too few for the oscillation of OP: `unexcited`, where OP shows no reversals.
pub fn too_few(
    op: &[f64],
    ts: f64,
    history: Option<&HistoryFound>,
    unexcited: bool,
) -> Option<NotIdentifiable> {
    // What enters a running mean leaves it so many samples later.
    let averaged = history.filter(|found| found.kind == HistoryKind::Averaged);
    let one = averaged.map_or(1.0, |found| found.evidence[1].max(1.0));
    let samples = samples_a_period(op)?;
    let limit = if unexcited { FEW } else { LEAST };
    (samples / one < limit)
        .then(|| NotIdentifiable::Undersampled { samples: samples / one, poll_s: samples * ts / FEW })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Role;
    use std::f64::consts::TAU;

    fn sine(period: f64) -> Vec<f64> {
        (0..800)
            .map(|k| 40.0 + (TAU * k as f64 / period).sin() + 0.1 * (1.3 * (k * k) as f64).sin())
            .collect()
    }

    #[test]
    fn a_line_of_two_samples_a_period_is_named_with_the_poll_it_needs() {
        let found = too_few(&sine(2.2), 180.0, None, false);
        let Some(NotIdentifiable::Undersampled { samples, poll_s }) = found else { panic!("{found:?}") };
        assert!((samples - 2.2).abs() < 0.01 && (poll_s - 39.6).abs() < 0.2, "{samples} {poll_s}");
        assert_eq!(too_few(&sine(7.0), 1.0, None, false), None);
        assert!(too_few(&sine(7.0), 1.0, None, true).is_some());
        assert_eq!(too_few(&sine(12.0), 1.0, None, true), None);
    }

    #[test]
    fn a_running_mean_is_worth_one_sample() {
        let averaged = HistoryFound { kind: HistoryKind::Averaged, role: Role::Pv, evidence: [-0.5, 12.0] };
        assert!(too_few(&sine(30.0), 1.0, Some(&averaged), false).is_some());
        assert_eq!(too_few(&sine(60.0), 1.0, Some(&averaged), false), None);
    }

    #[test]
    fn noise_and_nothing_are_no_line() {
        let noise: Vec<f64> = (0..500).map(|k| (0.7 * (k * k) as f64).sin()).collect();
        assert_eq!(too_few(&noise, 1.0, None, true), None);
        assert_eq!(too_few(&[], 1.0, None, true), None);
        assert_eq!(too_few(&[1.0; 300], 1.0, None, true), None);
    }
}
