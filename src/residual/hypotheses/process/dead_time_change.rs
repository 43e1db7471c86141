//! A change of the dead time: from time t on, or until t, the process sees the stem `by` samples later.
//!
//! Parameters: time t (s), rate 1. Alternatives: longer or shorter, by 1 to 8 samples. It is proposed at the times at which the
//! response to the delayed stem gains most in place of the response to the stem.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind};
use crate::residual::hypotheses::change_time::neighbouring_times;
use crate::residual::hypotheses::proposal::{Proposal, Propose, best};
use crate::residual::screening::{Screen, best_times};
use crate::signal::{figures, moment};
use crate::sysid::armax::Armax;
use crate::sysid::criterion::THRESHOLD;
use crate::sysid::iddata::IdData;

/// Largest change (samples).
const LONGEST: usize = 8;
/// Changes that are screened (samples); the fits reach the others as their neighbours.
const CHANGES_TRIED: [usize; 6] = [1, 2, 3, 4, 6, 8];
/// Samples between the times that are screened: the fits move the best one to its exact sample.
const STRIDE: usize = 32;
/// Changes proposed.
const CHANGES: usize = 4;

/// The changes of dead time.
pub struct DeadTimeChanges;

#[derive(Clone, Debug)]
struct Change {
    /// Sample of the change.
    at: usize,
    /// Size of the change (samples).
    by: usize,
    /// Whether the dead time becomes shorter.
    shorter: bool,
}

impl EffectModel for Change {
    fn kind(&self) -> Kind {
        Kind::DeadTimeChange
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        THRESHOLD
    }
    fn alternatives(&self) -> f64 {
        2.0 * LONGEST as f64
    }
    fn delay(&self, k: usize) -> usize {
        if (k >= self.at) != self.shorter { self.by } else { 0 }
    }
    fn change_time(&self) -> Option<usize> {
        Some(self.at)
    }
    fn with_change_time(&self, at: usize) -> Box<dyn EffectModel> {
        Change { at, ..self.clone() }.boxed()
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        let mut out: Vec<Box<dyn EffectModel>> = neighbouring_times(self.at, data, 2.0 * step)
            .into_iter()
            .map(|at| Change { at, ..self.clone() }.boxed())
            .collect();
        let other = [self.by - 1, self.by + 1].into_iter().filter(|by| (1..=LONGEST).contains(by));
        out.extend(other.map(|by| Change { by, ..self.clone() }.boxed()));
        out
    }
    fn describe(&self, data: &IdData, _model: &Armax, _gamma: &[f64]) -> Described {
        let (time, by) = (data.time(self.at as f64), self.by as f64 * data.units.ts);
        let change = if self.shorter { -by } else { by };
        let than = if self.shorter { "sooner" } else { "later" };
        let (from, late) = (moment(time), figures(by));
        Described::new(format!("from {from} on PV answers {late} s {than} than before"))
            .with("time_s", time, "s")
            .with("change_s", change, "s")
    }
}

impl Propose for DeadTimeChanges {
    fn kind(&self) -> Kind {
        Kind::DeadTimeChange
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        // A PV that is later than any lateness that was tried is still late, and less so when its clock is right. That is no change
        // of the process.
        if screen.data.pv_moved.is_some_and(|moved| moved.perhaps_later) {
            return Vec::new();
        }
        let x = &screen.signals.x;
        let mut out = Vec::new();
        for by in CHANGES_TRIED {
            let less: Vec<f64> = (0..x.len()).map(|k| x[k.saturating_sub(by)] - x[k]).collect();
            for shorter in [false, true] {
                let cut = |at: usize| -> Vec<f64> {
                    less.iter().enumerate().map(|(k, s)| if (k < at) == shorter { *s } else { 0.0 }).collect()
                };
                let gain = |_: usize, v: Vec<f64>| screen.armax.single_gain(v).0;
                let rated = screen.rated_times(screen.change_times(STRIDE), cut, gain);
                let times = best_times(rated, screen.limit(1));
                out.extend(
                    times
                        .into_iter()
                        .map(|since| Proposal::new(Change { at: since.at, by, shorter }, since.gain)),
                );
            }
        }
        best(out, screen.limit(CHANGES))
    }
}
