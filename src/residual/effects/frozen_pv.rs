//! PV stands still while the process moves: those samples do not count, and are bridged by a straight line.
//!
//! Recognised by runs of one value, far longer than this PV's runs usually are; since [s], samples (-).

use super::quantised_pv::quantum;
use super::{Context, Proposal, Recognise};
use crate::residual::model::{Data, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};
use crate::sysid::stats::{quantile, range};

/// Shortest run that counts, and how many times longer than the usual it must be.
const SHORTEST: usize = 8;
const LONGER: f64 = 6.0;
/// Usual length beyond which PV is coarse: then its runs are of all lengths, as those of a sensor with hysteresis are.
const COARSE: f64 = 2.0;
/// How many times longer than any other run one of a coarse PV must be, and any where there is to be no doubt.
const ALONE: usize = 3;
/// How lively PV is just before, as a share of its mean move, where there is no doubt: a process without noise comes to rest
/// slowly.
const LIVELY: f64 = 0.3;
/// Most runs: more are a sensor's habit.
const MOST: usize = 20;
/// Samples after a run in which its value is still among the lags.
const ECHO: usize = 4;

pub struct FrozenPv;

#[derive(Clone, Debug)]
struct Frozen {
    /// First sample of each run and the first after it.
    runs: Vec<(usize, usize)>,
}

/// Puts a straight line between the neighbours of `from..to`.
pub fn bridge(y: &mut [f64], from: usize, to: usize) {
    let left = y[from.saturating_sub(1)];
    let right = y.get(to).copied().unwrap_or(left);
    let length = (to - from + 1) as f64;
    for k in from..to.min(y.len()) {
        y[k] = left + (right - left) * (k - from + 1) as f64 / length;
    }
}

impl Term for Frozen {
    fn kind(&self) -> Kind {
        Kind::FrozenPv
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn data(&self, stage: &mut Stage) {
        for &(from, to) in &self.runs {
            bridge(&mut stage.y, from, to);
            let end = (to + ECHO).min(stage.weight.len());
            stage.weight[from..end].fill(0.0);
        }
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let samples: usize = self.runs.iter().map(|r| r.1 - r.0).sum();
        let since = data.scale.t0 + self.runs[0].0 as f64 * data.scale.ts;
        let parameters = vec![
            Parameter { name: "from_s", value: since, unit: "s" },
            Parameter { name: "duration_s", value: samples as f64 * data.scale.ts, unit: "s" },
            Parameter { name: "runs", value: self.runs.len() as f64, unit: "-" },
        ];
        (
            parameters,
            format!("PV stands still for {samples} samples, first from {since:.1} s on, while OP moves"),
        )
    }
}

impl Recognise for FrozenPv {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let y = &c.data.y;
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
        let (low, high) = range(&c.data.u);
        let moves = |&(from, to): &(usize, usize)| {
            let (a, b) = range(&c.data.u[from..to]);
            b - a > 0.002 * (high - low)
        };
        // A coarse PV stands still by itself; frozen, it has something to make up for in the end.
        let step = quantum(y).map_or(0.0, |(size, _)| size);
        let leaps = |&(_, to): &(usize, usize)| {
            (step < 0.02 && usual <= COARSE)
                || y.get(to).is_some_and(|after| (after - y[to - 1]).abs() > 2.5 * step)
        };
        let (frozen, others): (Vec<_>, Vec<_>) =
            runs.into_iter().partition(|r| (r.1 - r.0) as f64 >= least && r.0 > 0 && moves(r) && leaps(r));
        let others = others.iter().map(|r| r.1 - r.0).max().unwrap_or(0);
        let alone = alone(&frozen, others);
        if frozen.is_empty() || frozen.len() > MOST || (usual > COARSE && !alone) {
            return Vec::new();
        }
        let parameters = frozen.len() as f64;
        let certain = alone && frozen.iter().all(|run| lively(y, run.0));
        let loss = if certain { 0.0 } else { 1.0 };
        vec![Proposal {
            term: Box::new(Frozen { runs: frozen }),
            loss,
            parameters,
            tried: 1.0,
            element: None,
        }]
    }
    fn direct(&self) -> bool {
        true
    }
}

/// Whether the frozen runs are far longer than the longest of the others.
fn alone(frozen: &[(usize, usize)], others: usize) -> bool {
    frozen.iter().all(|r| r.1 - r.0 >= ALONE * others)
}

/// Whether PV moves as usual just before `from`.
fn lively(y: &[f64], from: usize) -> bool {
    let moved = |y: &[f64]| y.windows(2).map(|w| (w[1] - w[0]).abs()).sum::<f64>() / y.len().max(2) as f64;
    moved(&y[from.saturating_sub(ECHO + 2)..=from]) > LIVELY * moved(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bridge_is_a_straight_line() {
        let mut y = [0.0, 9.0, 9.0, 9.0, 4.0];
        bridge(&mut y, 1, 4);
        assert_eq!(y, [0.0, 1.0, 2.0, 3.0, 4.0]);
        let mut end = [2.0, 9.0];
        bridge(&mut end, 1, 2);
        assert_eq!(end, [2.0, 2.0]);
    }
}
