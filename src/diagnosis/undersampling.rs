//! Whether an oscillation has too few samples in a period, so that it is seen as another, slower one (aliasing).
//!
//! A line in the spectrum of OP with most of its power and fewer than four samples in a period may be the mirror image of a faster
//! one about half the sampling frequency (Shannon, Proc. IRE 1949, 37, 10).
//! The samples of a running mean count as one.

use super::history_kind::HistoryKind;
use super::not_identifiable::NotIdentifiable;
use super::preparation::Preparation;
use crate::sysid::spectrum;
use crate::sysid::stats::mean;

/// Samples in a period below which a record is refused: the line may be the mirror image of a faster one.
const LEAST: f64 = 4.0;
/// Samples in a period below which a record whose OP shows no reversals is refused as undersampled.
const FEW: f64 = 10.0;
/// Share of OP's power that the line must have: most of it.
const OF_POWER: f64 = 0.5;
/// Half the width of a line, as a share of its frequency: a period that varies makes a line wide.
const WIDTH: f64 = 0.03;

/// The number of samples in one period of the line with most of OP's power; `None` where there is no such line.
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

/// The length of the running mean (s), where PV is one over more than a row.
fn mean_s(preparation: &Preparation) -> Option<f64> {
    let averaged = preparation.history.as_ref().filter(|found| found.kind == HistoryKind::Averaged)?;
    let polls = preparation.acquisition.as_ref().and_then(|found| found.poll_s)?;
    Some(averaged.evidence[1] * polls).filter(|mean_s| *mean_s > preparation.ts)
}

/// The reason [`NotIdentifiable::Undersampled`] where a prepared window has too few rows for the oscillation of its OP.
///
/// * `unexcited`: whether OP shows no reversals; then more samples in a period are needed.
pub fn too_few(op: &[f64], preparation: &Preparation, unexcited: bool) -> Option<NotIdentifiable> {
    let (rows, ts, mean_s) = (samples_a_period(op)?, preparation.ts, mean_s(preparation));
    let samples = mean_s.map_or(rows, |mean_s| rows * ts / mean_s);
    let limit = if unexcited { FEW } else { LEAST };
    // Where only the running mean makes the samples too few, a faster poll would not help.
    let poll_s = Some(rows * ts / FEW).filter(|_| mean_s.is_none() || rows < FEW);
    (samples < limit).then_some(NotIdentifiable::Undersampled { samples, poll_s, mean_s })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::{Acquisition, HistoryFound};
    use crate::signal::Role;
    use std::f64::consts::TAU;

    fn sine(period: f64) -> Vec<f64> {
        (0..800)
            .map(|k| 40.0 + (TAU * k as f64 / period).sin() + 0.1 * (1.3 * (k * k) as f64).sin())
            .collect()
    }

    /// Rows of a period `ts`, of polls a second apart whose PV is a running mean over so many of them, if it is one.
    fn rows(ts: f64, averaged: Option<f64>) -> Preparation {
        let mean =
            |polls| HistoryFound { kind: HistoryKind::Averaged, role: Role::Pv, evidence: [-0.5, polls] };
        let acquisition = Acquisition { poll_s: Some(1.0), ..Acquisition::default() };
        Preparation {
            ts,
            history: averaged.map(|polls| Box::new(mean(polls))),
            acquisition: Some(Box::new(acquisition)),
            ..Preparation::default()
        }
    }

    #[test]
    fn a_line_of_two_samples_a_period_is_named_with_the_poll_it_needs() {
        let found = too_few(&sine(2.2), &rows(180.0, None), false);
        let Some(NotIdentifiable::Undersampled { samples, poll_s: Some(poll_s), mean_s: None }) = found
        else {
            panic!("{found:?}")
        };
        assert!((samples - 2.2).abs() < 0.01 && (poll_s - 39.6).abs() < 0.2, "{samples} {poll_s}");
        assert_eq!(
            NotIdentifiable::Undersampled { samples, poll_s: Some(poll_s), mean_s: None }.to_string(),
            "undersampled: 2.2 samples per period, ten are needed: poll at least every 39 s"
        );
        assert_eq!(too_few(&sine(7.0), &rows(1.0, None), false), None);
        assert!(too_few(&sine(7.0), &rows(1.0, None), true).is_some());
        assert_eq!(too_few(&sine(12.0), &rows(1.0, None), true), None);
    }

    #[test]
    fn a_running_mean_is_worth_one_sample() {
        assert!(too_few(&sine(30.0), &rows(1.0, Some(12.0)), false).is_some());
        assert_eq!(too_few(&sine(60.0), &rows(1.0, Some(12.0)), false), None);
    }

    #[test]
    fn a_running_mean_is_counted_in_rows() {
        // A mean over 20 polls is over four rows of 5 s: of 30 rows a period 7.5 are left.
        assert_eq!(too_few(&sine(30.0), &rows(5.0, Some(20.0)), false), None);
        // Within a row it takes nothing.
        assert_eq!(too_few(&sine(4.5), &rows(30.0, Some(20.0)), false), None);
    }

    #[test]
    fn where_a_mean_alone_leaves_too_few_no_faster_poll_is_asked_for() {
        let found = too_few(&sine(200.0), &rows(1.0, Some(60.0)), false).expect("too few");
        assert_eq!(
            found.to_string(),
            "undersampled: 3.3 samples per period, ten are needed: PV is a running mean over 60 s, which counts as one sample: \
             keep no means"
        );
        // Rows that would be too few without it need both.
        let found = too_few(&sine(6.0), &rows(5.0, Some(20.0)), false).expect("too few");
        let said = found.to_string();
        assert!(
            said.contains("ten are needed: poll at least every ") && said.ends_with("keep no means"),
            "{said}"
        );
    }

    #[test]
    fn noise_and_nothing_are_no_line() {
        let noise: Vec<f64> = (0..500).map(|k| (0.7 * (k * k) as f64).sin()).collect();
        let all: [&[f64]; 3] = [&noise, &[], &[1.0; 300]];
        for values in all {
            assert_eq!(too_few(values, &rows(1.0, None), true), None);
        }
    }
}
