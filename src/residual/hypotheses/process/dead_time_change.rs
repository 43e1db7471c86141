//! The dead time changes at a time: the process sees the stem `by` samples later after t, or before it.
//!
//! Parameters: time t (s), rate 1; a level that shifts with it is none of it. Alternatives: 2 x 8 changes. Proposed at the
//! times where the predicted answer to the later stem gains most in place of that to the other.

use crate::residual::Kind;
use crate::residual::effect::EffectModel;
use crate::residual::hypotheses::load::load_step::near;
use crate::residual::hypotheses::{Proposal, Propose, best};
use crate::residual::report::Described;
use crate::residual::screening::{Screen, Since, best_times};
use crate::signal::{figures, moment};
use crate::sysid::armax::Armax;
use crate::sysid::criterion::THRESHOLD;
use crate::sysid::iddata::IdData;

/// Largest change (samples).
const LONGEST: usize = 8;
/// Changes tried (samples); the others are their neighbours.
const CHANGES_TRIED: [usize; 6] = [1, 2, 3, 4, 6, 8];
/// Samples between times that are tried: the best is moved to its sample later.
const STRIDE: usize = 32;
/// Changes proposed.
const CHANGES: usize = 4;

/// The changes of dead time.
pub struct DeadTimeChanges;

#[derive(Clone, Debug)]
struct Change {
    at: usize,
    by: usize,
    /// Whether the longer dead time is the one before.
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
    fn at(&self) -> Option<usize> {
        Some(self.at)
    }
    fn moved(&self, at: usize) -> Box<dyn EffectModel> {
        Change { at, ..self.clone() }.boxed()
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        let mut out: Vec<Box<dyn EffectModel>> = near(self.at, data, 2.0 * step)
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
        let x = &screen.signals.x;
        let mut out = Vec::new();
        for by in CHANGES_TRIED {
            let less: Vec<f64> = (0..x.len()).map(|k| x[k.saturating_sub(by)] - x[k]).collect();
            for shorter in [false, true] {
                let cut = |at: usize| -> Vec<f64> {
                    less.iter().enumerate().map(|(k, s)| if (k < at) == shorter { *s } else { 0.0 }).collect()
                };
                let rated = screen
                    .times(STRIDE)
                    .map(|at| Since { at, gain: screen.model.alone(screen.stem(&cut(at))).0 });
                let times = best_times(rated.collect(), screen.most(1));
                out.extend(
                    times
                        .into_iter()
                        .map(|since| Proposal::new(Change { at: since.at, by, shorter }, since.gain)),
                );
            }
        }
        best(out, screen.most(CHANGES))
    }
}
