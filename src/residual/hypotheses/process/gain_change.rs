//! The gain changes at a time: the stem counts `ratio` times from t on, about a working point of its own.
//!
//! ```text
//! x -> ratio x + level   from t on
//! ```
//!
//! Parameters: time t (s), rate 1; ratio (-), rate 1/2; level, which the working point decides (OP unit), rate 1/2. Proposed
//! at the times where the predicted answer to the stem and a level gain most in the ARMAX.

use crate::residual::Kind;
use crate::residual::effect::EffectModel;
use crate::residual::hypotheses::load::load_step::{at_input, near};
use crate::residual::hypotheses::{Proposal, Propose};
use crate::residual::report::Described;
use crate::residual::screening::{Screen, Since, best_times};
use crate::signal::moment;
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::iddata::IdData;
use crate::sysid::stats::mean;

/// Times proposed.
const TIMES: usize = 2;
/// Samples between times that are tried.
const STRIDE: usize = 8;
/// Largest change of a gain that is believed (-).
const MOST: f64 = 8.0;
/// Largest shift of the level (standard deviations of OP).
const MOST_LEVEL: f64 = 50.0;

/// The changes of gain.
pub struct GainChanges;

#[derive(Clone, Debug)]
struct Change {
    at: usize,
    /// Logarithm of the ratio: a change and its inverse are alike.
    log_ratio: f64,
    /// Shift of the level that goes with it.
    level: f64,
}

impl EffectModel for Change {
    fn kind(&self) -> Kind {
        Kind::GainChange
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        THRESHOLD + 2.0 * REGULAR
    }
    fn smooth(&self) -> Vec<Smooth> {
        let ratio = Smooth { value: self.log_ratio, step: 1e-4, bounds: (-MOST.ln(), MOST.ln()) };
        vec![ratio, Smooth { value: self.level, step: 1e-4, bounds: (-MOST_LEVEL, MOST_LEVEL) }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        if let [log_ratio, level] = theta {
            (self.log_ratio, self.level) = (*log_ratio, *level);
        }
    }
    fn bends(&self) -> bool {
        true
    }
    fn bend(&self, _data: &IdData, k: usize, x: &mut [f64]) {
        if k >= self.at {
            let ratio = self.log_ratio.exp();
            x.iter_mut().for_each(|x| *x = ratio * *x + self.level);
        }
    }
    fn at(&self) -> Option<usize> {
        Some(self.at)
    }
    fn moved(&self, at: usize) -> Box<dyn EffectModel> {
        Change { at, ..self.clone() }.boxed()
    }
    /// With a ratio of 1 the level is all that changes.
    fn special_case(&self) -> Option<Box<dyn EffectModel>> {
        Some(at_input(self.at, self.level))
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        near(self.at, data, step).into_iter().map(|at| Change { at, ..self.clone() }.boxed()).collect()
    }
    fn describe(&self, data: &IdData, _model: &Armax, _gamma: &[f64]) -> Described {
        let (time, ratio) = (data.time(self.at as f64), self.log_ratio.exp());
        Described::new(format!(
            "from {} on the process answers {ratio:.2} times as much to the valve",
            moment(time)
        ))
        .with("time_s", time, "s")
        .with("ratio", ratio, "-")
    }
}

impl Propose for GainChanges {
    fn kind(&self) -> Kind {
        Kind::GainChange
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        let x = &screen.signals.x;
        let ones = vec![1.0; x.len()];
        let rate = |at: usize| {
            let from = |v: &[f64]| -> Vec<f64> {
                v.iter().enumerate().map(|(k, v)| if k >= at { *v } else { 0.0 }).collect()
            };
            screen.model.several(&[screen.stem(&from(x)), screen.stem(&from(&ones))])
        };
        let rated = screen.times(STRIDE).map(|at| Since { at, gain: rate(at).0 });
        let times = best_times(rated.collect(), screen.most(TIMES));
        let proposal = |at: usize, gain: f64| {
            let more = rate(at).1;
            // What B makes of the whole record lies between both gains.
            let ratio = (1.0 + more[0]).clamp(1.0 / MOST, MOST);
            let after = &x[at.min(x.len() - 1)..];
            // Where the ratio is out of bounds, the level makes up for it.
            let level = more[1] + (1.0 + more[0] - ratio) * mean(after);
            let (log_ratio, level) = (ratio.ln(), level.clamp(-MOST_LEVEL, MOST_LEVEL));
            Proposal::new(Change { at, log_ratio, level }, gain)
        };
        times.into_iter().map(|since| proposal(since.at, since.gain)).collect()
    }
}
