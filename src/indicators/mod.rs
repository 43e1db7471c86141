//! What a loop's signals say of its health, one indicator a file. Pure: no clock, no files, no randomness.
//!
//! [`indicators`] takes them all from one window. What is not known is none: without a mode there is no service factor,
//! without limits nothing is at one. Without a dead time the Harris index is that of one sample, which a loop with a longer one
//! cannot reach: then it does not count in the score.

pub mod distribution;
pub mod error;
pub mod harris;
pub mod noise;
pub mod oscillation;
pub mod score;
pub mod series;
pub mod service;
pub mod settling;
pub mod travel;

use crate::signal::Window;
use crate::sysid::spectrum::Transforms;
use distribution::Distribution;
use error::LoopError;
use harris::Harris;
use noise::Kept;
use oscillation::Oscillation;
use series::Values;
use settling::Settling;
use travel::Travel;

/// What is known of a loop beside its window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Known<'a> {
    /// 1 in automatic, 0 otherwise, at every sample.
    pub mode: Option<&'a [f64]>,
    /// The controller's output limits (OP unit).
    pub op_limits: Option<(f64, f64)>,
    /// Dead time of the process (s).
    pub dead_time_s: Option<f64>,
    /// Step of PV as it was measured (PV unit; 0 for none), where the window does not have its samples.
    pub step: Option<f64>,
}

/// The indicators of one loop over one window.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Indicators {
    /// Share of the time in automatic (0..1).
    pub service_factor: Option<f64>,
    /// Share of the time with OP at a limit (0..1).
    pub at_limits: Option<f64>,
    /// The error.
    pub error: Option<LoopError>,
    /// The Harris index; that of one sample's dead time where none is known.
    pub harris: Option<Harris>,
    /// Oscillations of the error, the largest first.
    pub oscillations: Vec<Oscillation>,
    /// How steps of the set point are followed.
    pub settling: Option<Settling>,
    /// The valve's work.
    pub travel: Travel,
    /// Share of the time in which PV stands still while OP moves (0..1).
    pub stuck: f64,
    /// Where OP stays.
    pub distribution: Option<Distribution>,
    /// Noise, steps and compression of PV.
    pub kept: Kept,
    /// The score (0..100).
    pub score: Option<f64>,
}

impl Indicators {
    /// As numbers.
    pub fn values(&self) -> Values {
        let swing: f64 = self.oscillations.iter().map(|own| own.share).sum();
        [
            self.score,
            self.service_factor,
            self.at_limits,
            self.error.map(|error| error.sd),
            self.error.map(|error| error.mean_absolute),
            self.harris.map(|harris| harris.index),
            Some(swing.clamp(0.0, 1.0)),
            self.oscillations.first().map(|own| own.period_s),
            Some(self.travel.a_day),
            Some(self.travel.reversals_a_day),
            Some(self.stuck),
            Some(self.kept.noise_share),
            Some(self.kept.quantisation),
        ]
        .map(|value: Option<f64>| value.filter(|x| x.is_finite()))
    }
}

/// Takes all indicators; a window with values that are not finite gives those that need none.
pub fn indicators(window: &Window, known: &Known<'_>, transforms: &mut Transforms) -> Indicators {
    let finite = window.op.iter().chain(&window.pv).all(|x| x.is_finite());
    if !finite || window.op.len() != window.pv.len() || window.ts <= 0.0 || window.ts.is_nan() {
        return Indicators {
            service_factor: known.mode.and_then(service::service_factor),
            ..Indicators::default()
        };
    }
    let e = error::errors(&window.pv, window.sp.as_deref());
    let dead = known.dead_time_s.map_or(1, |dead| 1 + (dead / window.ts).round().clamp(0.0, 1e6) as usize);
    let mut found = Indicators {
        service_factor: known.mode.and_then(service::service_factor),
        at_limits: known.op_limits.and_then(|limits| service::at_limits(&window.op, limits)),
        error: error::measure(&e, window.ts),
        harris: harris::harris(&e, dead),
        oscillations: oscillation::oscillations(&e, window.ts, transforms),
        settling: window.sp.as_ref().and_then(|sp| settling::settling(&window.pv, sp, window.ts)),
        travel: travel::travel(window.mv.as_deref().unwrap_or(&window.op), window.ts),
        stuck: travel::stuck(&window.op, &window.pv),
        distribution: known.op_limits.and_then(|limits| distribution::distribution(&window.op, limits)),
        kept: noise::kept(&window.pv, known.step),
        score: None,
    };
    let swinging: f64 = found.oscillations.iter().map(|oscillation| oscillation.share).sum();
    found.score = score::score(&[
        found.service_factor.map(|share| 1.0 - share),
        found.at_limits,
        Some(swinging.min(1.0)),
        found.harris.filter(|_| known.dead_time_s.is_some()).map(|harris| 1.0 - harris.index),
        Some(found.stuck),
    ]);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swinging_loop_scores_worse_and_rubbish_is_no_panic() {
        let n = 1440;
        let quiet: Vec<f64> = (0..n).map(|k| ((k * k) as f64 * 0.7).sin()).collect();
        let swing: Vec<f64> = (0..n).map(|k| quiet[k] + 5.0 * (0.1 * k as f64).sin()).collect();
        let window = |pv: &[f64]| Window { ts: 60.0, op: pv.to_vec(), pv: pv.to_vec(), ..Window::default() };
        let mut transforms = Transforms::new();
        let mut of = |pv: &[f64]| indicators(&window(pv), &Known::default(), &mut transforms);
        let (good, bad) = (of(&quiet), of(&swing));
        assert!(good.score > bad.score, "{good:?} {bad:?}");
        assert_eq!(bad.oscillations.len(), 1);
        // 62.8 samples; a sine in little noise is measured to a per mille.
        assert!((bad.oscillations[0].period_s / 60.0 - 62.83).abs() < 0.1);
        for rubbish in [vec![], vec![f64::NAN; 100], vec![1e300; 100], vec![0.0; 3]] {
            let found = of(&rubbish);
            assert!(found.score.is_none_or(f64::is_finite));
        }
    }

    #[test]
    fn the_harris_index_counts_where_the_dead_time_is_known() {
        // A pseudorandom sum over twenty samples: minimum variance behind twenty samples of dead time.
        let noise = |k: usize| ((k * k) as f64 * 0.7).sin();
        let pv: Vec<f64> = (0..4000).map(|k| (k..k + 20).map(noise).sum()).collect();
        let window = Window { ts: 1.0, op: pv.clone(), pv, ..Window::default() };
        let mut transforms = Transforms::new();
        let mut score = |dead_time_s| {
            let found = indicators(&window, &Known { dead_time_s, ..Known::default() }, &mut transforms);
            assert!(found.harris.is_some());
            found.score.expect("it is known how much it swings")
        };
        // Of a sample's dead time nearly all of the variance could be gone.
        let (unknown, short) = (score(None), score(Some(0.0)));
        assert!(unknown > short, "{unknown} {short}");
    }
}
