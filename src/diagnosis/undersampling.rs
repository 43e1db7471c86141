//! Whether an oscillation has too few samples in a period, so that it is seen as another, slower one (aliasing).
//!
//! A line in the spectrum of OP with fewer than four samples in a period may be the mirror image of a faster one about half the
//! sampling frequency (Shannon, Proc. IRE 1949, 37, 10).
//! The samples of a running mean count as one.
//!
//! The cycle of a valve that sticks varies from period to period, so that its line is wide. What an oscillation of the period P has
//! is that OP repeats itself after P, and is reversed half a period before and after that:
//!
//! ```text
//! share(P) = (r(P) - (r(P/2) + r(3P/2)) / 2) / 2 = sum over f of p(f) w(f P)      w(x) = cos(2 pi x) (1 - cos(pi x)) / 2
//! ```
//!
//! r is the autocorrelation of OP, and p(f) the share of its power at the frequency f, both without the mean. A steady oscillation
//! has the share of OP's power that it holds, one that varies has somewhat less. A drift has nearly none, because OP repeats itself
//! no better after P than after half of it. Noise from sample to sample has little.

use super::history_kind::HistoryKind;
use super::not_identifiable::NotIdentifiable;
use super::preparation::Preparation;
use crate::sysid::spectrum;
use crate::sysid::stats::mean;
use std::f64::consts::PI;

/// Samples in a period below which a record is refused: the line may be the mirror image of a faster one.
const LEAST: f64 = 4.0;
/// Samples in a period below which a record whose OP shows no reversals is refused as undersampled.
const FEW: f64 = 10.0;
/// Share of OP's power that the oscillation must hold: most of it.
const OF_POWER: f64 = 0.5;
/// The same, from [`LEAST`] samples in a period on, where OP shows no reversals: noise hardly has it there, and no verdict is lost.
const NOTICED: f64 = 0.18;
/// Step of the periods that are tried (share of the period).
const STEP: f64 = 0.02;

/// The oscillation that holds most of OP's power: the number of samples in its period, and its share (up to 1); `None` where OP does
/// not move or is too short.
///
/// * `longest`: longest period that is tried (samples).
fn oscillation(op: &[f64], longest: f64) -> Option<(f64, f64)> {
    let middle = mean(op);
    let mut moved: Vec<f64> = op.iter().map(|u| u - middle).collect();
    let n = moved.len() as f64;
    // A drift makes two or three periods.
    let longest = longest.min(n / 4.0);
    if longest < 2.0 {
        return None;
    }
    let power = spectrum::power(&mut moved);
    let total: f64 = power.iter().skip(1).sum();
    if total <= 0.0 || !total.is_finite() {
        return None;
    }
    let share = |period: f64| {
        let weighed = power.iter().enumerate().skip(1).map(|(j, power)| {
            let half = (PI * j as f64 * period / n).cos();
            power * (2.0 * half * half - 1.0) * (1.0 - half)
        });
        0.5 * weighed.sum::<f64>() / total
    };
    let at = |i: f64| (2.0 * (STEP * i).exp()).max(2.0);
    let count = ((0.5 * longest).ln() / STEP).ceil() as usize;
    let shares: Vec<f64> = (0..=count).map(|i| share(at(i as f64))).collect();
    let most = shares.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // OP repeats itself after three periods as well: of peaks about as high the first one is the period.
    let is_peak = |i: usize| {
        let near = [i.saturating_sub(1), (i + 1).min(count)];
        shares[i] >= 0.9 * most && near.iter().all(|k| shares[i] >= shares[*k])
    };
    let peak = (0..=count).find(|i| is_peak(*i))? as f64;
    let fine = (-20..=20).map(|k| at(peak + 0.05 * f64::from(k)));
    fine.map(|period| (period, share(period))).max_by(|a, b| a.1.total_cmp(&b.1))
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
    let (ts, mean_s) = (preparation.ts, mean_s(preparation));
    let rows_of_sample = mean_s.map_or(1.0, |mean_s| mean_s / ts);
    // Of a slower oscillation no more needs to be known than that it is slower.
    let (rows, share) = oscillation(op, 2.0 * FEW * rows_of_sample)?;
    let samples = rows / rows_of_sample;
    let limit = if unexcited { FEW } else { LEAST };
    let least = if unexcited && samples >= LEAST { NOTICED } else { OF_POWER };
    // Where only the running mean makes the samples too few, a faster poll would not help.
    let poll_s = Some(rows * ts / FEW).filter(|_| mean_s.is_none() || rows < FEW);
    (samples < limit && share > least).then_some(NotIdentifiable::Undersampled { samples, poll_s, mean_s })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::{Acquisition, HistoryFound};
    use crate::signal::Role;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;
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

    /// Standard normal numbers without end.
    fn normal(seed: u64) -> impl Iterator<Item = f64> {
        Distribution::<f64>::sample_iter(StandardNormal, Pcg64Mcg::seed_from_u64(seed))
    }

    /// A sine of unit amplitude whose periods vary from one to the next.
    ///
    /// * `cv`: standard deviation of the periods (share of their mean).
    fn wandering(period: f64, cv: f64, n: usize, seed: u64) -> Vec<f64> {
        let mut draw = normal(seed);
        let mut own = || period * (1.0 + cv * draw.next().unwrap_or(0.0)).max(0.3);
        let (mut begins, mut length) = (0.0, own());
        (0..n)
            .map(|k| {
                while k as f64 - begins >= length {
                    begins += length;
                    length = own();
                }
                (TAU * (k as f64 - begins) / length).sin()
            })
            .collect()
    }

    /// A low pass of the first order, of unit variance, where `memory` is below 1.
    fn coloured(memory: f64, n: usize, seed: u64) -> Vec<f64> {
        let sd = (1.0 - memory * memory).sqrt();
        let next = |at: &mut f64, e: f64| {
            *at = memory * *at + sd * e;
            Some(*at)
        };
        normal(seed).scan(0.0, next).skip(200).take(n).collect()
    }

    #[test]
    fn a_cycle_whose_period_varies_is_recognised() {
        for period in [2.2, 3.1, 3.9, 6.0, 9.0] {
            for cv in [0.0, 0.05, 0.1, 0.15] {
                for seed in 0..5 {
                    let noise = normal(100 + seed).map(|e| 0.1 * e);
                    let op: Vec<f64> = wandering(period, cv, 600, seed)
                        .iter()
                        .zip(noise)
                        .map(|(u, e)| 50.0 + u + e)
                        .collect();
                    let what = format!("{period} {cv} {seed}");
                    let Some(NotIdentifiable::Undersampled { samples, .. }) =
                        too_few(&op, &rows(10.0, None), true)
                    else {
                        panic!("{what}")
                    };
                    assert!((samples / period - 1.0).abs() < 0.08, "{what}: {samples}");
                    // A cycle of 3.9 samples may be taken for one of four.
                    let refused = too_few(&op, &rows(10.0, None), false).is_some();
                    assert!(refused == (period < 4.0) || period == 3.9, "{what}");
                }
            }
        }
    }

    #[test]
    fn a_cycle_beside_a_drift_is_noticed_where_op_shows_no_reversals() {
        for seed in 0..10 {
            let cycle = wandering(4.6, 0.15, 600, seed);
            let drift = coloured(0.95, 600, 50 + seed);
            // The cycle has four tenths of the power.
            let op: Vec<f64> =
                cycle.iter().zip(&drift).map(|(u, d)| 0.8_f64.sqrt() * u + 0.6_f64.sqrt() * d).collect();
            let found = too_few(&op, &rows(10.0, None), true);
            let Some(NotIdentifiable::Undersampled { samples, .. }) = found else { panic!("{seed}") };
            assert!((4.2..5.0).contains(&samples), "{seed}: {samples}");
            // Where OP shows reversals, it is no reason to judge nothing.
            assert_eq!(too_few(&op, &rows(10.0, None), false), None);
        }
    }

    #[test]
    fn noise_drifts_and_steps_are_no_oscillation() {
        type Noise = fn(u64, usize) -> Vec<f64>;
        let kinds: [(&str, Noise); 5] = [
            ("white", |seed, n| normal(seed).take(n).collect()),
            ("random walk", |seed, n| {
                let summed = |sum: &mut f64, e: f64| {
                    *sum += e;
                    Some(*sum)
                };
                normal(seed).scan(0.0, summed).take(n).collect()
            }),
            ("first order", |seed, n| coloured([0.3, 0.6, 0.9, 0.97][(seed % 4) as usize], n, seed)),
            ("steps of the set point", |seed, n| {
                let mut draw = normal(seed);
                let mut e = || draw.next().unwrap_or(0.0);
                let (mut target, mut at) = (0.0, 0.0);
                (0..n)
                    .map(|_| {
                        if e() > 2.0 {
                            target += 3.0 * e();
                        }
                        at += 0.3 * (target - at);
                        at + 0.05 * e()
                    })
                    .collect()
            }),
            ("differences", |seed, n| {
                let noise: Vec<f64> = normal(seed).take(n + 1).collect();
                noise.windows(2).map(|w| w[1] - w[0]).collect()
            }),
        ];
        let mut told = Vec::new();
        for (name, noise) in kinds {
            for seed in 0..50 {
                let n = [400, 800][(seed % 2) as usize];
                let op = noise(seed, n);
                // Where OP shows reversals, a verdict would be lost.
                assert_eq!(too_few(&op, &rows(1.0, None), false), None, "{name} {seed}");
                if let Some(why) = too_few(&op, &rows(1.0, None), true) {
                    told.push(format!("{name} {seed}: {why}"));
                }
            }
        }
        assert!(told.len() <= 5, "more than 2 of 100: {told:#?}");
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
