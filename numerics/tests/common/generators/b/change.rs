//! Effects that change the process: gain, dead time, and a curved characteristic.

use stictiond_numerics::residual::Kind;

use super::super::Case;
use super::draw::{Draw, Range, Sized3};
use super::plan::WARM_UP;
use super::process::Process;

/// What changes about the process at one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// The scan.
    pub at: usize,
    /// What the gain is multiplied by from then on.
    pub gain: f64,
    /// What is added to the dead time from then on (scans).
    pub delay: f64,
}

/// When a process changes (share of the record).
const WHEN: Range = (0.25, 0.75);
/// Factor of a gain's change: small, medium, large.
const GAIN_FACTOR: Sized3 = [(1.4, 1.55), (1.75, 2.05), (2.2, 2.5)];
/// Change of a dead time (scans): small, medium, large.
const DELAY_STEP: Sized3 = [(2.0, 3.0), (4.0, 6.0), (7.0, 10.0)];
/// Shortest dead time that a change may leave (scans).
const SHORTEST_DELAY: f64 = 1.0;

impl Change {
    /// The change that a case asks for, of a record of `n` scans.
    pub fn draw(draw: &mut Draw, case: &Case, n: usize, process: &Process) -> Self {
        let at = WARM_UP + (draw.uniform(WHEN) * n as f64) as usize;
        let (mut gain, mut delay) = (1.0, 0.0);
        match case.effect {
            Some(Kind::GainChange) => gain = draw.sized(case.size, &GAIN_FACTOR).powf(draw.sign()),
            Some(Kind::DeadTimeChange) => {
                delay = draw.sized(case.size, &DELAY_STEP);
                if process.delay - delay >= SHORTEST_DELAY && draw.chance(0.6) {
                    delay = -delay;
                }
            }
            _ => {}
        }
        Self { at, gain, delay }
    }

    /// The forms that the process takes beside its first.
    pub fn forms(&self, process: &Process, curve: &Curve) -> Vec<Process> {
        let form = |gain: f64, delay: f64| {
            let (gain, delay) = (process.gain * gain, process.delay + delay);
            Process { gain, delay, ..process.clone() }
        };
        let steepest = curve.ratio.sqrt() * STEEPER;
        match curve.place {
            Place::Nowhere if self.gain == 1.0 && self.delay == 0.0 => vec![],
            Place::Nowhere => vec![form(self.gain, self.delay)],
            _ => vec![form(steepest, 0.0), form(1.0 / steepest, 0.0)],
        }
    }
}

/// Where a curve sits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// There is none.
    Nowhere,
    /// In the valve: equal percentage or quick opening.
    Valve,
    /// In the process: its gain depends on PV.
    Process,
}

/// A gain that changes by a constant ratio per unit of the stem or of PV.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    /// Where it sits.
    pub place: Place,
    /// Ratio of the gains at the ends of the range in which the loop moves.
    pub ratio: f64,
    /// Logarithm of the gain per % of stem or unit of PV; the sign tells which way it opens.
    pub rate: f64,
}

/// Ratio of the gains over the range that the loop moves in: small, medium, large.
const CURVE_RATIO: Sized3 = [(1.35, 1.55), (1.9, 2.4), (2.8, 3.5)];
/// Rangeability of a curved valve.
const RANGEABILITY: Range = (12.0, 60.0);
/// How much steeper than at the end of its range a curve may get before the loop loses its margins.
const STEEPER: f64 = 1.15;
/// Largest factor by which a gain that depends on PV leaves its middle.
const MOST: f64 = 4.0;

impl Curve {
    /// The curve that a case asks for; the rate of one in the process follows from its range later.
    pub fn draw(draw: &mut Draw, case: &Case) -> Self {
        if case.effect != Some(Kind::StaticNonlinearity) {
            return Self { place: Place::Nowhere, ratio: 1.0, rate: 0.0 };
        }
        let place = if case.variant.is_multiple_of(2) { Place::Valve } else { Place::Process };
        let rate = draw.sign() * draw.log_uniform(RANGEABILITY).ln() / 100.0;
        Self { place, ratio: draw.sized(case.size, &CURVE_RATIO), rate }
    }

    /// The stem's effect (OP units), of slope 1 at the working point: an exponential, falling for quick opening.
    pub fn flow(&self, stem: f64) -> f64 {
        match self.place {
            Place::Valve => ((self.rate * stem).exp() - 1.0) / self.rate,
            _ => stem,
        }
    }

    /// The factor of the process gain at PV's deviation.
    pub fn gain(&self, pv: f64) -> f64 {
        match self.place {
            Place::Process => (self.rate * pv).exp().clamp(1.0 / MOST, MOST),
            _ => 1.0,
        }
    }
}
