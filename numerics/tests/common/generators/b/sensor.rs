//! What transmitter and historian make of PV.

use super::super::Size;
use super::draw::{Draw, Range, Sized3};
use super::plan::{Plan, WARM_UP};
use super::run::{Natural, Trace};

/// A faulty measurement; `seen` tells whether the controller works with it or the historian alone has it.
#[derive(Clone, Debug, PartialEq)]
pub enum Sensor {
    /// PV as it is.
    Honest,
    /// PV rounded to steps.
    Steps { width: f64, seen: bool },
    /// Wild values at single scans: the scan and what is added.
    Wild { at: Vec<(usize, f64)>, seen: bool },
    /// PV that repeats its last value over runs: first scan and first scan after it.
    Frozen { runs: Vec<(usize, usize)>, seen: bool },
}

impl Sensor {
    /// What the controller sees and what is recorded; `last` is the value recorded before.
    pub fn read(&self, scan: usize, pv: f64, last: f64) -> (f64, f64) {
        let (recorded, seen) = match self {
            Sensor::Honest => (pv, true),
            Sensor::Steps { width, seen } => ((pv / width).round() * width, *seen),
            Sensor::Wild { at, seen } => {
                let jump = at.iter().find(|(k, _)| *k == scan).map_or(0.0, |(_, jump)| *jump);
                (pv + jump, *seen)
            }
            Sensor::Frozen { runs, seen } => {
                let frozen = runs.iter().any(|&(from, to)| (from..to).contains(&scan));
                (if frozen { last } else { pv }, *seen)
            }
        };
        (if seen { recorded } else { pv }, recorded)
    }
}

/// Width of PV's steps in sd of its noise: small, medium, large.
const STEP_WIDTH: Sized3 = [(3.0, 4.0), (5.0, 7.0), (8.0, 10.0)];
/// Share of quantised PVs that the controller works with.
const QUANTISED_SEEN: f64 = 0.7;
/// Share of wild and frozen PVs that the controller works with.
const FAULT_SEEN: f64 = 0.5;

/// A PV in steps.
pub fn quantised(draw: &mut Draw, size: Size, plan: &Plan) -> Sensor {
    let width = plan.noise_sd * draw.sized(size, &STEP_WIDTH);
    Sensor::Steps { width, seen: draw.chance(QUANTISED_SEEN) }
}

/// Share of scans with a wild PV.
const WILD_SHARE: Range = (0.005, 0.02);
/// How far a wild PV is off, in PV's own sd: small, medium, large.
const WILD_JUMP: Sized3 = [(3.0, 4.5), (5.0, 9.0), (11.0, 25.0)];
/// PV's own sd is taken as at least this many sd of its noise.
const WILD_NOISE: f64 = 3.0;
/// Largest kick of OP by a wild PV that the controller works with (% of OP's span).
const WILD_KICK: f64 = 12.0;

/// Single wild PVs, to both sides or, in a part of the records, to one alone.
pub fn wild(draw: &mut Draw, size: Size, plan: &Plan, natural: &Natural) -> Sensor {
    let count = (draw.uniform(WILD_SHARE) * plan.n as f64).round() as usize;
    let unit = natural.pv.max(WILD_NOISE * plan.noise_sd);
    let side = if draw.chance(0.3) { Some(draw.sign()) } else { None };
    let mut at: Vec<(usize, f64)> = Vec::with_capacity(count);
    while at.len() < count {
        let scan = WARM_UP + draw.whole(2, plan.n - 3);
        let sign = side.unwrap_or_else(|| draw.sign());
        let jump = sign * unit * draw.sized(size, &WILD_JUMP);
        if at.iter().all(|(k, _)| k.abs_diff(scan) > 1) {
            at.push((scan, jump));
        }
    }
    let largest = at.iter().map(|(_, jump)| jump.abs()).fold(0.0, f64::max);
    let bearable = largest * plan.settings.noise_gain() < WILD_KICK;
    Sensor::Wild { at, seen: draw.chance(FAULT_SEEN) && bearable }
}

/// Length of one frozen run (scans): small, medium, large.
const LONG_RUN: Sized3 = [(18.0, 30.0), (40.0, 80.0), (100.0, 180.0)];
/// Length of each of several frozen runs (scans): small, medium, large.
const SHORT_RUN: Sized3 = [(6.0, 10.0), (12.0, 25.0), (20.0, 40.0)];
/// How many short runs there are: small, medium, large.
const SHORT_RUNS: [(usize, usize); 3] = [(3, 5), (4, 8), (7, 12)];
/// How far PV moves during a frozen run, at least, in sd of its noise.
const FROZEN_MOVE: f64 = 6.0;
/// Trials of a place for a frozen run.
const FROZEN_TRIALS: usize = 60;

/// A PV that stands still while the process moves; `None` where it moves too little.
pub fn frozen(draw: &mut Draw, size: Size, plan: &Plan, trace: &Trace) -> Option<Sensor> {
    let several = draw.chance(0.5);
    let (low, high) = SHORT_RUNS[size as usize];
    let count = if several { draw.whole(low, high) } else { 1 };
    let lengths = if several { &SHORT_RUN } else { &LONG_RUN };
    let mut runs: Vec<(usize, usize)> = Vec::with_capacity(count);
    for _ in 0..FROZEN_TRIALS {
        let length = draw.sized(size, lengths).round() as usize;
        let from = WARM_UP + draw.whole(10, plan.n - length - 10);
        let to = from + length;
        let apart = runs.iter().all(|&(a, b)| to + 10 < a || b + 10 < from);
        let inside = &trace.pv[from..to];
        let span =
            inside.iter().fold(f64::MIN, |a, &b| a.max(b)) - inside.iter().fold(f64::MAX, |a, &b| a.min(b));
        if apart && span > FROZEN_MOVE * plan.noise_sd {
            runs.push((from, to));
        }
        if runs.len() == count {
            return Some(Sensor::Frozen { runs, seen: draw.chance(FAULT_SEEN) });
        }
    }
    None
}

/// Offset of PV's clock (scans): small, medium, large.
const CLOCK_OFFSET: Sized3 = [(2.0, 3.0), (4.0, 7.0), (8.0, 14.0)];
/// How far PV's clock has parted at the end (scans): small, medium, large.
const CLOCK_PARTING: Sized3 = [(3.0, 4.5), (6.0, 10.0), (12.0, 20.0)];

/// PV's clock: offset in scans and gain per scan.
pub fn skew(draw: &mut Draw, size: Size, n: usize) -> (f64, f64) {
    let sign = draw.sign();
    if draw.chance(0.5) {
        let offset = draw.sized(size, &CLOCK_OFFSET);
        let offset = if draw.chance(0.5) { offset.round() } else { offset };
        return (sign * offset, 0.0);
    }
    (0.0, sign * draw.sized(size, &CLOCK_PARTING) / n as f64)
}
