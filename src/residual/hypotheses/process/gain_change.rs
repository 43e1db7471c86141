//! A change of the process gain at time t, about a working point of its own.
//!
//! ```text
//! x[k] -> ratio x[k] + level     for k >= t
//! ```
//!
//! Parameters: time t (s), rate 1; ratio of the gains (-), rate 1/2; level, which follows from the working point (OP unit), rate
//! 1/2. It is proposed at the times at which the response to the stem and a level gain most in the ARMAX.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind};
use crate::residual::hypotheses::change_time::neighbouring_times;
use crate::residual::hypotheses::load::load_step::at_input;
use crate::residual::hypotheses::proposal::{Proposal, Propose};
use crate::residual::screening::{Screen, best_times};
use crate::signal::moment;
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::iddata::IdData;
use crate::sysid::stats::mean;

/// Times proposed.
const TIMES: usize = 2;
/// Samples between the times that are screened.
const STRIDE: usize = 8;
/// Largest ratio of two gains that is believed (-).
const MOST: f64 = 8.0;
/// Largest shift of the level (standard deviations of OP).
const MOST_LEVEL: f64 = 50.0;

/// The changes of gain.
pub struct GainChanges;

#[derive(Clone, Debug)]
struct Change {
    /// Sample of the change.
    at: usize,
    /// Logarithm of the ratio (-): a change and its inverse have the same size.
    log_ratio: f64,
    /// Level (standard deviations of OP).
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
    fn maps_stem(&self) -> bool {
        true
    }
    fn map_stem(&self, _data: &IdData, k: usize, x: &mut [f64]) {
        if k >= self.at {
            let ratio = self.log_ratio.exp();
            x.iter_mut().for_each(|x| *x = ratio * *x + self.level);
        }
    }
    fn change_time(&self) -> Option<usize> {
        Some(self.at)
    }
    fn with_change_time(&self, at: usize) -> Box<dyn EffectModel> {
        Change { at, ..self.clone() }.boxed()
    }
    /// With a ratio of 1 only the level changes: that is a load step at the process input.
    fn special_case(&self) -> Option<Box<dyn EffectModel>> {
        Some(at_input(self.at, self.level))
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        neighbouring_times(self.at, data, step)
            .into_iter()
            .map(|at| Change { at, ..self.clone() }.boxed())
            .collect()
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
        let part = |at: usize| -> Vec<f64> {
            x.iter().enumerate().map(|(k, x)| if k >= at { *x } else { 0.0 }).collect()
        };
        let rate =
            |at: usize, of_x: Vec<f64>| screen.armax.joint_gain(&[of_x, screen.stem_step_regressor(at)]);
        let rated = screen.rated_times(screen.change_times(STRIDE), part, |at, of_x| rate(at, of_x).0);
        let times = best_times(rated, screen.limit(TIMES));
        let proposal = |at: usize, gain: f64| {
            let more = rate(at, screen.stem_regressor(&part(at))).1;
            // B, fitted to the whole record, has a gain between the two: the ratio is only a start.
            let ratio = (1.0 + more[0]).clamp(1.0 / MOST, MOST);
            let after = &x[at.min(x.len() - 1)..];
            // Where the ratio is clamped, the level takes the rest on the average.
            let level = more[1] + (1.0 + more[0] - ratio) * mean(after);
            let (log_ratio, level) = (ratio.ln(), level.clamp(-MOST_LEVEL, MOST_LEVEL));
            Proposal::new(Change { at, log_ratio, level }, gain)
        };
        times.into_iter().map(|since| proposal(since.at, since.gain)).collect()
    }
}
