//! Frozen PV: PV stands still while the process moves. The frozen samples do not count, and are interpolated.
//!
//! It is recognised by runs of one value that are much longer than all other runs. In a fine PV all other runs have a sample or two;
//! a quantised PV and a sensor with hysteresis have runs of all lengths, and are not frozen. Reported: the start of the first run
//! (s), and the number of frozen samples (-).

use super::fact::{Fact, bridge, is_measured};
use super::quantised::{OF_PV, quantum};
use crate::residual::findings::{Described, Kind};
use crate::signal::moment;
use crate::sysid::iddata::IdData;
use crate::sysid::stats::{median, range};

/// Factor by which a frozen run is longer than every other run: a factor of two happens among few runs.
const APART: usize = 3;
/// Shortest run that counts: a PV with two decimals repeats itself a few times by chance.
const SHORTEST: usize = 8;
/// Least step of a quantised PV at the end of a frozen run (quanta): after a normal rest it moves by one, or by two with noise.
const LEAP: f64 = 2.5;
/// Least move of OP during a run, as a share of its range: while OP is at rest or at its limit, PV may be at rest, too.
const MOVES: f64 = 0.002;
/// Share of the median increment of PV below which PV has come to rest by itself, as a process without noise does behind a valve that
/// sticks. A frozen sensor stops at full speed.
const SETTLED: f64 = 0.01;
/// Largest share of frozen samples: a PV that stands still most of the time is normal, as with a sensor with hysteresis.
const MOST: f64 = 0.5;
/// Samples after a run that do not count either: its values are still among their lags.
const ECHO: usize = 4;

/// Finds a frozen PV, interpolates it, and takes its samples out.
pub fn assess(data: &mut IdData) -> Option<Fact> {
    // A missing sample neither ends a run nor makes one.
    let at: Vec<usize> = (0..data.len()).filter(|k| is_measured(data, *k)).collect();
    let of = |signal: &[f64]| at.iter().map(|k| signal[*k]).collect::<Vec<f64>>();
    let runs = frozen(&of(&data.u), &of(&data.y))?;
    let runs: Vec<(usize, usize)> = runs.into_iter().map(|(from, to)| (at[from], at[to - 1] + 1)).collect();
    let fact = Fact { kind: Kind::FrozenPv, posterior: 1.0, described: describe(data, &runs) };
    for (from, to) in runs {
        bridge(&mut data.y, from, to);
        let end = (to + ECHO).min(data.len());
        data.weight[from..end].fill(0.0);
    }
    Some(fact)
}

fn describe(data: &IdData, runs: &[(usize, usize)]) -> Described {
    let samples = runs.iter().flat_map(|run| run.0..run.1).filter(|k| is_measured(data, *k)).count();
    let since = data.time(runs[0].0 as f64);
    Described::new(format!(
        "PV stands still for {samples} samples, first from {} on, while OP moves",
        moment(since)
    ))
    .with("from_s", since, "s")
    .with("duration_s", samples as f64 * data.units.ts, "s")
    .with("runs", runs.len() as f64, "-")
}

/// The frozen runs: the first sample of each, and the first sample after it. `u`, `y`: OP and PV.
fn frozen(u: &[f64], y: &[f64]) -> Option<Vec<(usize, usize)>> {
    let mut runs = Vec::new();
    let mut from = 0;
    for k in 1..=y.len() {
        if k == y.len() || y[k] != y[from] {
            runs.push((from, k));
            from = k;
        }
    }
    let mut lengths: Vec<usize> = runs.iter().map(|run| run.1 - run.0).collect();
    lengths.sort_unstable();
    let gap = lengths.windows(2).find(|two| two[1] >= SHORTEST && two[1] >= APART * two[0])?;
    let (low, high) = range(u);
    let step = quantum(y).map_or(0.0, |quantum| if quantum.size < OF_PV { 0.0 } else { quantum.size });
    let increments = y.windows(2).map(|two| (two[1] - two[0]).abs()).filter(|by| *by > 0.0);
    let settled = SETTLED * median(&increments.collect::<Vec<f64>>());
    let is_frozen = |&(from, to): &(usize, usize)| {
        let (least, most) = range(&u[from..to]);
        let leaps = y.get(to).map_or(step == 0.0, |after| (after - y[from]).abs() > LEAP * step);
        let halts = from > 0 && (y[from] - y[from - 1]).abs() > settled;
        to - from >= gap[1] && halts && leaps && most - least > MOVES * (high - low)
    };
    runs.retain(is_frozen);
    let samples: usize = runs.iter().map(|run| run.1 - run.0).sum();
    (samples > 0 && (samples as f64) < MOST * y.len() as f64).then_some(runs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// OP, and PV that follows it with noise, rounded to `quantum`.
    fn signals(quantum: f64) -> (Vec<f64>, Vec<f64>) {
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(4));
        let u: Vec<f64> = (0..900).map(|k| (0.05 * f64::from(k)).sin()).collect();
        let mut pv = || -> f64 { 0.05 * noise.next().unwrap_or(0.0) };
        let y = u.iter().map(|u| u + pv()).map(|y| (y / quantum).round() * quantum);
        (u.clone(), y.collect())
    }

    fn freeze(y: &mut [f64], from: usize, to: usize) {
        let held = y[from - 1];
        y[from..to].fill(held);
    }

    #[test]
    fn runs_are_found_in_a_fine_and_in_a_coarse_pv() {
        for quantum in [1e-9, 0.2] {
            let (u, mut y) = signals(quantum);
            assert_eq!(frozen(&u, &y), None, "{quantum}");
            freeze(&mut y, 200, 290);
            assert_eq!(frozen(&u, &y).map(|runs| runs.len()), Some(1), "{quantum}");
        }
        let (u, mut y) = signals(1e-9);
        freeze(&mut y, 200, 220);
        freeze(&mut y, 500, 512);
        // The sample before is of the same value.
        assert_eq!(frozen(&u, &y), Some(vec![(199, 220), (499, 512)]));
    }

    #[test]
    fn a_missing_sample_neither_ends_a_run_nor_makes_one() {
        let (u, mut y) = signals(1e-9);
        freeze(&mut y, 200, 290);
        let missing = |k: usize| k == 240 || (500..540).contains(&k);
        for k in (0..y.len()).filter(|k| missing(*k)) {
            y[k] = y[499] + if k == 240 { 0.5 } else { 0.0 };
        }
        let weight = (0..y.len()).map(|k| f64::from(u8::from(!missing(k)))).collect();
        let known = vec![false; y.len()];
        let mut data = IdData { u, y, weight, known, ..IdData::default() };
        let fact = assess(&mut data).expect("frozen");
        assert!(fact.described.explanation.contains("for 90 samples"), "{}", fact.described.explanation);
    }

    #[test]
    fn a_pv_that_settles_behind_a_valve_that_sticks_is_not_frozen() {
        let (u, _) = signals(1e-9);
        let mut pv = 0.0;
        // The stem goes on by one now and then, the process follows at its own pace.
        let y = (0..u.len()).map(|k| {
            pv += 0.3 * ((k / 150) as f64 - pv);
            pv
        });
        assert_eq!(frozen(&u, &y.collect::<Vec<_>>()), None);
    }

    #[test]
    fn a_pv_at_rest_is_not_frozen_while_op_rests_too() {
        let (mut u, mut y) = signals(1e-9);
        freeze(&mut y, 200, 240);
        freeze(&mut u, 190, 250);
        assert_eq!(frozen(&u, &y), None);
    }
}
