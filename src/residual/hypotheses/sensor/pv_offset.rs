//! A shift of PV itself, behind the process or in the sensor: the offset that PV shows and the output of the process does not have.
//!
//! ```text
//! o[k] = size [k >= t]          A(q) (y - o) = B(q) x + c0 + C(q) e
//! ```
//!
//! Parameters: time t (s), rate 1; size (PV unit), rate 1/2. Alternatives: the three places of a step
//! ([`crate::residual::hypotheses::load::load_step`] has the other two). It is proposed at the times that gain most in the
//! high-order ARX, where the offset enters the equation through A.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind};
use crate::residual::hypotheses::change_time::{LARGEST_STEP, neighbouring_times};
use crate::residual::hypotheses::gains::{in_op, in_pv};
use crate::residual::hypotheses::proposal::Proposal;
use crate::residual::screening::{ChangeTime, Screen, best_times};
use crate::signal::{moment, told};
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::arx::LAGS_Y;
use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::iddata::IdData;

#[derive(Clone, Debug)]
struct Offset {
    /// Sample of the shift.
    at: usize,
    /// Size (standard deviations of PV).
    size: f64,
}

/// A shift of PV from sample `at` on. `size`: in standard deviations of PV.
pub fn at(at: usize, size: f64) -> Box<dyn EffectModel> {
    Offset { at, size: size.clamp(-LARGEST_STEP, LARGEST_STEP) }.boxed()
}

impl EffectModel for Offset {
    fn kind(&self) -> Kind {
        Kind::LoadStep
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        REGULAR + THRESHOLD
    }
    fn alternatives(&self) -> f64 {
        3.0
    }
    fn smooth(&self) -> Vec<Smooth> {
        vec![Smooth { value: self.size, step: 1e-4, bounds: (-LARGEST_STEP, LARGEST_STEP) }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        self.size = theta.first().copied().unwrap_or(self.size);
    }
    fn has_pv_offset(&self) -> bool {
        true
    }
    fn add_pv_offset(&self, _data: &IdData, offset: &mut [f64]) {
        offset.iter_mut().skip(self.at).for_each(|offset| *offset += self.size);
    }
    fn change_time(&self) -> Option<usize> {
        Some(self.at)
    }
    fn with_change_time(&self, at: usize) -> Box<dyn EffectModel> {
        Offset { at, ..self.clone() }.boxed()
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        neighbouring_times(self.at, data, step)
            .into_iter()
            .map(|at| Offset { at, ..self.clone() }.boxed())
            .collect()
    }
    fn describe(&self, data: &IdData, model: &Armax, _gamma: &[f64]) -> Described {
        let time = data.time(self.at as f64);
        let gain = in_pv(data, model) / in_op(data, model);
        let size = told(self.size * data.units.y);
        // A shift of PV is not a load: its place says so.
        Described::new(format!("PV's level shifts at {} by {size} and stays", moment(time)))
            .with("time_s", time, "s")
            .with("size_op", self.size * data.units.y / gain, "OP")
            .at("pv")
    }
}

/// The shifts of PV that gain most, `most` of them.
pub fn propose(screen: &Screen<'_>, most: usize) -> Vec<Proposal> {
    let first = screen.data.first;
    let mut onset = vec![1.0];
    screen.arx_fit.theta[..LAGS_Y].iter().for_each(|a| onset.push(onset[onset.len() - 1] - a));
    let shown: Vec<(usize, f64, f64)> = screen.arx.step_gains(&onset);
    let since = |(row, gain, _): &(usize, f64, f64)| ChangeTime { at: first + row, gain: *gain };
    let sized = |at: usize| shown.iter().find(|step| first + step.0 == at).map_or(0.0, |step| step.2);
    let proposal =
        |since: ChangeTime| Proposal { effect: at(since.at, sized(since.at)), valve: None, gain: since.gain };
    best_times(shown.iter().map(since).collect(), most).into_iter().map(proposal).collect()
}
