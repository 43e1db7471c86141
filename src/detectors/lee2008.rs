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
//! Source: Novel closed-loop stiction detection and quantification method via system identification, ADCONIP 2008, 283. With
//! fS = 0 the valve is sound. The paper takes any other for stiction, and so nearly every record of noise: the threshold above
//! which it counts is calibrated on simulated loops by `numerics/examples/opinions -- --calibrate`.
//! Limits: least squares is biased by noise on PV, and takes a load of a valve's shape for one. A delay beyond ten samples is
//! not found.

use super::facts::Facts;
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone};
use crate::sysid::gram::{Column, gram};
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::valve::batch::{Batch, LANES, Lane};
use crate::sysid::valve::{Start, StopRule, ValveModel};
use std::array::from_fn;

const METHOD: Method = Method::Lee2008;
/// Thresholds of the index (-): 0 is the authors' sound valve, fS = 0; the other is calibrated.
pub const BAND: Band = Band { sound: 0.0, sticks: 0.23 };
/// Longest delay (samples).
const DELAYS: usize = 10;
/// Values of S, up to the range of OP. A slip that is one sample early in every cycle fits as badly as no friction, so that the steps
/// of S are smaller than the move of OP in one sample.
const COARSE: usize = 200;
/// Values of J for each S, up to S.
const JUMPS: usize = 5;
/// Samples before the first extremum of OP at which the stem may have slipped for the last time; the coarse grid uses the first.
const BEFORE: [usize; 4] = [2, 0, 1, 4];
/// Valves of the coarse grid around which finer grids are laid.
const LEADERS: usize = 3;
/// Steps of the finer grids, as shares of those of the coarse grid.
const FINER: [f64; 3] = [0.5, 0.25, 0.12];
/// Values on each side in a finer grid.
const BESIDE: i32 = 1;
/// Mean squared error that is added to both losses, as a share of PV's variance (-): rounding leaves as much.
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

/// The best valve, with the coarse grid that it was found in.
struct Searched {
    estimate: Estimate,
    /// Loss without friction.
    plain: f64,
    /// The valves of the coarse grid, by J, then by ascending S (standard deviations of OP).
    grid: Vec<Fitted>,
}

/// Searches for the best valve; none where OP reverses too seldom.
fn search(facts: &Facts<'_>) -> Option<Searched> {
    if facts.region.reversals(0, facts.len()) < LEAST_REVERSALS {
        return None;
    }
    let mut models = Models::new(facts)?;
    let (plain, delay) = models.loss(&facts.u);
    let range = facts.op_range();
    let step = range / COARSE as f64;
    let mut best = Fitted { loss: plain, s: 0.0, j: 1.0, delay };
    let of = |jump: usize| (1..COARSE).map(move |i| (step * i as f64, jump as f64 / JUMPS as f64));
    let valves: Vec<(f64, f64)> = (0..=JUMPS).flat_map(of).collect();
    let grid = models.fitted(facts, &valves, &BEFORE[..1]);
    let mut leaders = grid.clone();
    leaders.sort_by(|a, b| a.loss.total_cmp(&b.loss));
    for leader in leaders.into_iter().take(LEADERS) {
        best = best.or(models.near(facts, leader, step, range));
    }
    let Fitted { loss, delay, .. } = best;
    let (s, j) = (best.s * facts.unit, best.j * best.s * facts.unit);
    let estimate = Estimate {
        fs: 0.5 * (s + j),
        fd: 0.5 * (s - j),
        delay,
        index: ((plain + FLOOR) / (loss + FLOOR)).ln(),
        range: range * facts.unit,
    };
    Some(Searched { estimate, plain, grid })
}

/// The best valve; none where OP reverses too seldom.
pub fn estimate(facts: &Facts<'_>) -> Option<Estimate> {
    Some(search(facts)?.estimate)
}

/// The error of the grid's valves over S, for the least, a middle and the largest J.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Some(found) = search(facts) else { return Vec::new() };
    let mut layers = vec![Layer::level("without friction", Tone::Sound, 100.0)];
    let of = |jump: usize| -> Vec<(f64, f64)> {
        let valves = found.grid.chunks(COARSE - 1).nth(jump).into_iter().flatten();
        valves.map(|v| (v.s * facts.unit, 100.0 * (v.loss + FLOOR) / (found.plain + FLOOR))).collect()
    };
    layers.push(Layer::line("J = 0", Tone::Data, of(0)));
    layers.push(Layer::line("J = 0.4 S", Tone::Beside, of(2)));
    layers.push(Layer::line("J = S", Tone::Sticks, of(JUMPS)));
    let Estimate { fs, fd, .. } = found.estimate;
    if fs + fd > 0.0 {
        layers.push(Layer::upright("the best S", Tone::Mark, fs + fd));
    }
    let title =
        "Error of a linear model behind a valve, by its dead band plus stick band S and its slip jump J";
    vec![Picture::new(title, "S (OP unit)", "error (% of that without friction)", layers)]
}

/// A valve of the grid, with its loss.
#[derive(Clone, Copy)]
struct Fitted {
    loss: f64,
    s: f64,
    /// J as a share of S.
    j: f64,
    delay: usize,
}

impl Fitted {
    /// The one with the smaller loss.
    fn or(self, other: Self) -> Self {
        if other.loss < self.loss { other } else { self }
    }
}

/// The linear models of one PV.
struct Models {
    ones: Vec<f64>,
    y: Vec<f64>,
    rows: std::ops::Range<usize>,
    products: Vec<f64>,
    stems: Vec<Lane>,
    stem: Vec<f64>,
}

/// Columns: y now and twice late, x from one sample late, a constant.
const COLUMNS: usize = 3 + DELAYS + 1 + 1;

impl Models {
    fn new(facts: &Facts<'_>) -> Option<Self> {
        let n = facts.len();
        // The position of the stem at the start is not known: the fit begins after one cycle, where the record is long enough.
        let after =
            facts.region.extrema.iter().map(|e| e.index).find(|at| *at > facts.start.index).unwrap_or(0);
        let again = facts.region.extrema.iter().map(|e| e.index).find(|at| *at > after).unwrap_or(0);
        let begin = if again < n / 3 { again.max(facts.start.index) } else { facts.start.index };
        let first = begin + DELAYS + 2;
        (n > first + 10 * COLUMNS / 2).then(|| Self {
            ones: vec![1.0; n],
            y: facts.y.clone(),
            rows: first..n,
            products: vec![0.0; COLUMNS * COLUMNS],
            stems: Vec::new(),
            stem: Vec::new(),
        })
    }

    /// Fits valves, given by S and by J as a share of S. Each is simulated from a few samples of the last slip before the extremum, and
    /// the best one is kept: no signal tells that sample, and a valve that slips in steps of J never forgets it.
    fn fitted(&mut self, facts: &Facts<'_>, valves: &[(f64, f64)], before: &[usize]) -> Vec<Fitted> {
        let none = |&(s, j): &(f64, f64)| Fitted { loss: f64::INFINITY, s, j, delay: 1 };
        let mut all: Vec<Fitted> = valves.iter().map(none).collect();
        let (mut stems, mut stem) = (std::mem::take(&mut self.stems), std::mem::take(&mut self.stem));
        for before in before {
            let Some(index) = facts.start.index.checked_sub(*before) else { continue };
            let start = Start { index, ..facts.start };
            for few in all.chunks_mut(LANES) {
                let valve = |Fitted { s, j, .. }: Fitted| ValveModel {
                    s,
                    j: j * s,
                    rule: StopRule::Slip,
                    ..ValveModel::default()
                };
                let lanes = from_fn(|l| valve(few[l.min(few.len() - 1)]));
                Batch::new(&lanes, start, facts.len()).run(&facts.u, &mut stems);
                for (l, own) in few.iter_mut().enumerate() {
                    stem.clear();
                    stem.extend(stems.iter().map(|stems| stems[l]));
                    let (loss, delay) = self.loss(&stem);
                    *own = own.or(Fitted { loss, delay, ..*own });
                }
            }
        }
        (self.stems, self.stem) = (stems, stem);
        all
    }

    /// The best of ever finer grids around a valve.
    fn near(&mut self, facts: &Facts<'_>, leader: Fitted, step: f64, range: f64) -> Fitted {
        let centre = [(leader.s, leader.j)];
        let mut leader = self.fitted(facts, &centre, &BEFORE).into_iter().fold(leader, Fitted::or);
        for finer in FINER {
            let mut around = Vec::new();
            for a in -BESIDE..=BESIDE {
                for b in -BESIDE..=BESIDE {
                    let s = leader.s + f64::from(a) * finer * step;
                    let j = leader.j + f64::from(b) * finer / JUMPS as f64;
                    if s > 0.0 && s <= range && (0.0..=1.0).contains(&j) && (a, b) != (0, 0) {
                        around.push((s, j));
                    }
                }
            }
            leader = self.fitted(facts, &around, &BEFORE).into_iter().fold(leader, Fitted::or);
        }
        leader
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

/// The opinion of the method.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let Some(found) = estimate(facts) else {
        return Opinion::cannot_tell(METHOD, "OP reverses too little");
    };
    let percent = 100.0 / found.range;
    let why = format!(
        "fS' {:.0} and fD' {:.0} % of OP's range, error {:.0} % of that without friction",
        found.fs * percent,
        found.fd * percent,
        100.0 * (-found.index).exp()
    );
    Opinion::of(METHOD, found.index, BAND, why)
        .with(found.fs + found.fd, "dead band plus stick band S = fS + fD")
}
