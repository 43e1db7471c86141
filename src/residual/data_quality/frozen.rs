//! PV stands still while the process moves: those samples do not count, and are bridged by a straight line.
//!
//! Recognised by runs of one value, far longer than this PV's runs usually are; since [s], samples (-).

use super::quantised::quantum;
use super::{Fact, bridge};
use crate::residual::Kind;
use crate::residual::report::Described;
use crate::sysid::iddata::IdData;
use crate::sysid::stats::{quantile, range};

/// Shortest run that counts, and how many times longer than the usual it must be.
const SHORTEST: usize = 8;
const LONGER: f64 = 6.0;
/// Usual length beyond which PV is coarse: then its runs are of all lengths, as those of a sensor with hysteresis are.
const COARSE: f64 = 2.0;
/// How many times longer than any other run one of a coarse PV must be.
const ALONE: usize = 3;
/// Most runs: more are a sensor's habit.
const MOST: usize = 20;
/// Samples after a run in which its value is still among the lags.
const ECHO: usize = 4;

/// Tells a PV that stands still, bridges it and takes its samples out.
pub fn assess(data: &mut IdData) -> Option<Fact> {
    let runs = frozen(&data.u, &data.y)?;
    let fact = Fact { kind: Kind::FrozenPv, posterior: 1.0, described: describe(data, &runs) };
    for (from, to) in runs {
        bridge(&mut data.y, from, to);
        let end = (to + ECHO).min(data.len());
        data.weight[from..end].fill(0.0);
    }
    Some(fact)
}

fn describe(data: &IdData, runs: &[(usize, usize)]) -> Described {
    let samples: usize = runs.iter().map(|run| run.1 - run.0).sum();
    let since = data.time(runs[0].0 as f64);
    Described::new(format!(
        "PV stands still for {samples} samples, first from {since:.1} s on, while OP moves"
    ))
    .with("from_s", since, "s")
    .with("duration_s", samples as f64 * data.units.ts, "s")
    .with("runs", runs.len() as f64, "-")
}

/// First sample of each run in which PV is frozen and the first after it.
fn frozen(u: &[f64], y: &[f64]) -> Option<Vec<(usize, usize)>> {
    let mut runs = Vec::new();
    let mut from = 0;
    for k in 1..=y.len() {
        if k == y.len() || y[k] != y[from] {
            runs.push((from, k));
            from = k;
        }
    }
    let lengths: Vec<f64> = runs.iter().map(|r| (r.1 - r.0) as f64).collect();
    let usual = quantile(&lengths, 0.9);
    let least = (LONGER * usual).max(SHORTEST as f64);
    let (low, high) = range(u);
    let moves = |&(from, to): &(usize, usize)| {
        let (a, b) = range(&u[from..to]);
        b - a > 0.002 * (high - low)
    };
    // A coarse PV stands still by itself; frozen, it has something to make up for in the end.
    let step = quantum(y).map_or(0.0, |quantum| quantum.size);
    let leaps = |&(_, to): &(usize, usize)| {
        (step < 0.02 && usual <= COARSE)
            || y.get(to).is_some_and(|after| (after - y[to - 1]).abs() > 2.5 * step)
    };
    let (frozen, others): (Vec<_>, Vec<_>) =
        runs.into_iter().partition(|r| (r.1 - r.0) as f64 >= least && r.0 > 0 && moves(r) && leaps(r));
    let others = others.iter().map(|r| r.1 - r.0).max().unwrap_or(0);
    let alone = frozen.iter().all(|r| r.1 - r.0 >= ALONE * others);
    let habit = frozen.len() > MOST || (usual > COARSE && !alone);
    (!frozen.is_empty() && !habit).then_some(frozen)
}
