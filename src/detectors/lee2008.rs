//! Lee, Ren & Huang 2008: S and J by a grid of low-order models.
//!
//! ```text
//! y[k] = -a1 y[k-1] - a2 y[k-2] + b1 x[k-n] + b2 x[k-n-1] + c + e[k]       x: OP through He's valve with fS, fD
//! (fS, fD, n) with the least sum of e², 0 <= fD <= fS, fS + fD <= range of OP
//! index = ln(V_0 / V)                                                      V_0: of a valve that follows OP
//! ```
//!
//! y: PV, x: stem (OP unit), n: delay (samples); fS, fD: static and kinetic friction, S = fS + fD and J = fS - fD (OP unit);
//! V: mean square of e (-). A primed fS', fD' is in % of OP's range. Ordinary least squares gives a, b and c.
//!
//! Source: Novel closed-loop stiction detection and quantification method via system identification, ADCONIP 2008, 283. The paper
//! says that a valve sticks where fS > 0; with that rule every record of noise would: the threshold of the index is calibrated
//! on simulated loops by `numerics/examples/opinions -- --calibrate`.
//! Limits: least squares is biased by noise on PV, and takes a load of a valve's shape for one. A delay beyond ten samples is
//! not found.

use super::{Band, Facts, Method, Opinion};
use crate::sysid::gram::{Column, gram};
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::valve::{Rest, StopRule, ValveModel};

const ME: Method = Method::Lee2008;
/// Thresholds of the index, calibrated (-).
pub const BAND: Band = Band { sound: 0.05, sticks: 0.3 };
/// Longest delay (samples).
const DELAYS: usize = 10;
/// Values of S up to OP's range, and of J up to S, of the first grid.
const COARSE: usize = 14;
const JUMPS: usize = 4;
/// Finer grids around the best, and values on either side.
const FINER: [f64; 3] = [0.33, 0.11, 0.037];
const BESIDE: i32 = 2;
/// Mean squared error that counts as none: what rounding leaves (of PV's variance).
const FLOOR: f64 = 1e-9;
/// Fewest reversals of OP.
const LEAST_REVERSALS: usize = 4;

/// The best valve and what it explains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Static friction fS (OP unit).
    pub fs: f64,
    /// Kinetic friction fD (OP unit).
    pub fd: f64,
    /// Delay (samples).
    pub delay: usize,
    /// `ln(V_0 / V)` (-).
    pub index: f64,
    /// Range of OP (OP unit): what fS' and fD' are per cent of.
    pub range: f64,
}

/// The best valve of the grid; none where OP reverses too little.
pub fn estimate(facts: &Facts<'_>) -> Option<Estimate> {
    if facts.region.reversals(0, facts.len()) < LEAST_REVERSALS {
        return None;
    }
    let mut models = Models::new(facts)?;
    let plain = models.loss(&facts.u.clone());
    let range = facts.op_range();
    let step = range / COARSE as f64;
    // (loss, S, J/S, delay)
    let mut best = (plain.0, 0.0, 1.0, plain.1);
    for i in 1..COARSE {
        for j in 0..=JUMPS {
            models.offer(facts, step * i as f64, j as f64 / JUMPS as f64, &mut best);
        }
    }
    if best.1 > 0.0 {
        for finer in FINER {
            let (_, s, j, _) = best;
            for a in -BESIDE..=BESIDE {
                for b in -BESIDE..=BESIDE {
                    let s = s + f64::from(a) * finer * step;
                    let j = j + f64::from(b) * finer / JUMPS as f64;
                    if s > 0.0 && s <= range && (0.0..=1.0).contains(&j) {
                        models.offer(facts, s, j, &mut best);
                    }
                }
            }
        }
    }
    let (loss, s, j, delay) = best;
    let (s, j) = (s * facts.unit, j * s * facts.unit);
    Some(Estimate {
        fs: 0.5 * (s + j),
        fd: 0.5 * (s - j),
        delay,
        index: ((plain.0 + FLOOR) / (loss + FLOOR)).ln(),
        range: range * facts.unit,
    })
}

/// The linear models of one PV.
struct Models {
    ones: Vec<f64>,
    y: Vec<f64>,
    rows: std::ops::Range<usize>,
    products: Vec<f64>,
    stem: Vec<f64>,
    dir: Vec<f64>,
}

/// Columns: y now and twice late, x from one sample late, a constant.
const COLUMNS: usize = 3 + DELAYS + 1 + 1;

impl Models {
    fn new(facts: &Facts<'_>) -> Option<Self> {
        let n = facts.len();
        let first = facts.start.index + DELAYS + 2;
        (n > first + 10 * COLUMNS / 2).then(|| Self {
            ones: vec![1.0; n],
            y: facts.y.clone(),
            rows: first..n,
            products: vec![0.0; COLUMNS * COLUMNS],
            stem: Vec::new(),
            dir: Vec::new(),
        })
    }

    /// Replaces `best` where this valve fits better.
    fn offer(&mut self, facts: &Facts<'_>, s: f64, j: f64, best: &mut (f64, f64, f64, usize)) {
        let rest = Rest::default();
        let valve = ValveModel { s, j: j * s, rule: StopRule::Slip, rest, ..ValveModel::default() };
        let (mut stem, mut dir) = (std::mem::take(&mut self.stem), std::mem::take(&mut self.dir));
        valve.run(&facts.u, facts.start, facts.len(), &mut stem, &mut dir);
        let (loss, delay) = self.loss(&stem);
        (self.stem, self.dir) = (stem, dir);
        if loss < best.0 {
            *best = (loss, s, j, delay);
        }
    }

    /// The least mean squared error over all delays, and the delay.
    fn loss(&mut self, x: &[f64]) -> (f64, usize) {
        let columns: Vec<Column<'_>> = Column::lags(&self.y, 0..=2)
            .chain(Column::lags(x, 1..=DELAYS + 1))
            .chain([Column::now(&self.ones)])
            .collect();
        gram(&columns, &self.rows, &mut self.products, COLUMNS);
        let product = |i: usize, j: usize| self.products[i.max(j) * COLUMNS + i.min(j)];
        let rows = self.rows.len() as f64;
        let of = |delay: usize| -> f64 {
            let used = [1, 2, 2 + delay, 3 + delay, COLUMNS - 1];
            let mut g = [0.0; 25];
            for (i, a) in used.iter().enumerate() {
                for (j, b) in used[..=i].iter().enumerate() {
                    g[i * 5 + j] = product(*a, *b);
                }
            }
            let right = used.map(|i| product(i, 0));
            let (mut theta, mut live) = (right, [true; MOST_COLUMNS]);
            factor(&mut g, 5, 5, &mut live);
            substitute(&g, 5, &live, &mut theta);
            let explained: f64 = theta.iter().zip(right).map(|(t, r)| t * r).sum();
            ((product(0, 0) - explained) / rows).max(0.0)
        };
        (1..=DELAYS)
            .map(|delay| (of(delay), delay))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, 1))
    }
}

/// What the method says.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let Some(found) = estimate(facts) else {
        return Opinion::cannot_tell(ME, "OP reverses too little");
    };
    let percent = 100.0 / found.range;
    let why = format!(
        "fS' {:.0} and fD' {:.0} % of OP's range, error {:.0} % of that without friction",
        found.fs * percent,
        found.fd * percent,
        100.0 * (-found.index).exp()
    );
    Opinion::of(ME, found.index, BAND, why).with(found.fs + found.fd, "dead band plus stick band S = fS + fD")
}
