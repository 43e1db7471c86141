//! What a loop's signals say of its health, one indicator a file. Pure: no clock, no files, no randomness.
//!
//! [`indicators`] takes them all from one window. What is not known is none: without a mode there is no service factor,
//! without limits nothing is at one. Without a dead time the Harris index is that of one sample, which a loop with a longer one
//! cannot reach: then it does not count in the score. Where good samples cover less than half of a window it has no values: what
//! is drawn through the rest was not measured.

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

use crate::signal::{Row, Window};
use crate::sysid::spectrum::Transforms;
use distribution::Distribution;
use error::LoopError;
use harris::Harris;
use noise::Kept;
use oscillation::Oscillation;
use series::Values;
use settling::Settling;
use travel::Travel;

/// Dead time of the Harris index (samples): nobody tells that of the process, so a loop is compared with itself over time.
const DEAD: usize = 1;

/// What is known of a loop beside its window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Known<'a> {
    /// 1 in automatic, 0 otherwise, at every sample.
    pub mode: Option<&'a [f64]>,
    /// The controller's output limits (OP unit).
    pub op_limits: Option<(f64, f64)>,
    /// Step of PV as it was measured (PV unit; 0 for none), where the window does not have its samples.
    pub step: Option<f64>,
    /// At how many samples, from the first on, the set point is known; none where it is at all of them.
    pub sp_known: Option<usize>,
    /// For how long there has been nothing since the window's end (s): it is a part of the time that is asked of.
    pub silent_s: f64,
    /// The valve's work as it was measured, where the window does not have its samples.
    pub travel: Option<Travel>,
    /// Whether most of OP's movement is too fast for the window: what is left of it does not say whether PV answers.
    pub blurred: bool,
}

/// The indicators of one loop over one window.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Indicators {
    /// Whether there was enough to measure: finite, and good samples over half of the time.
    pub measured: bool,
    /// Share of the time in automatic (0..1).
    pub service_factor: Option<f64>,
    /// Share of the time with OP at a limit (0..1).
    pub at_limits: Option<f64>,
    /// The error.
    pub error: Option<LoopError>,
    /// The Harris index of one sample's dead time.
    pub harris: Option<Harris>,
    /// Oscillations of the error, the largest first.
    pub oscillations: Vec<Oscillation>,
    /// Share of the error's variance in them (0..1); none where the error is too short or does not move.
    pub swing: Option<f64>,
    /// How steps of the set point are followed.
    pub settling: Option<Settling>,
    /// The valve's work.
    pub travel: Travel,
    /// Share of the time in which PV stands still while OP moves (0..1); none where OP does not move, or too fast to be seen.
    pub stuck: Option<f64>,
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
        let measured = |value: f64| self.measured.then_some(value);
        [
            self.score,
            self.service_factor,
            self.at_limits,
            self.error.map(|error| error.sd),
            self.error.map(|error| error.mean_absolute),
            self.harris.map(|harris| harris.index),
            self.swing,
            self.oscillations.first().map(|own| own.period_s),
            measured(self.travel.a_day),
            measured(self.travel.reversals_a_day),
            self.stuck,
            measured(self.kept.noise_share),
            measured(self.kept.quantisation),
        ]
        .map(|value: Option<f64>| value.filter(|x| x.is_finite()))
    }
}

/// Takes all indicators; a window with values that are not finite, or with good samples over less than half of its time, gives
/// those that need none.
pub fn indicators(window: &Window, known: &Known<'_>, transforms: &mut Transforms) -> Indicators {
    let finite = window.op.iter().chain(&window.pv).all(|x| x.is_finite());
    let length = window.pv.len() as f64 * window.ts;
    let sparse = 2.0 * length * (1.0 - window.missing()) < length + known.silent_s;
    // The mode is known no further than the window goes.
    let service_factor = known.mode.filter(|_| length >= known.silent_s).and_then(service::service_factor);
    if !finite || sparse || window.op.len() != window.pv.len() || window.ts <= 0.0 || window.ts.is_nan() {
        return Indicators { service_factor, ..Indicators::default() };
    }
    let sp = window.sp.as_deref().filter(|sp| sp.len() == window.pv.len());
    let there = error::known_samples(&window.pv, sp, known.sp_known);
    let e = error::known_errors(&window.pv, sp, known.sp_known);
    let oscillations = oscillation::oscillations(&e, window.ts, transforms);
    let moved = window.mv.as_deref().unwrap_or(&window.op);
    let is_missing = |k: usize| window.row(k) == Row::Missing;
    let swinging: f64 = oscillations.iter().map(|oscillation| oscillation.share).sum();
    let mut found = Indicators {
        measured: true,
        service_factor,
        at_limits: known.op_limits.and_then(|limits| service::at_limits(&window.op, limits)),
        error: error::measure(&e, window.ts),
        harris: harris::harris(&e, DEAD),
        oscillations,
        swing: oscillation::can_tell(&e).then_some(swinging.clamp(0.0, 1.0)),
        settling: sp.and_then(|sp| settling::settling(&window.pv[..there], &sp[..there], window.ts)),
        travel: known.travel.unwrap_or_else(|| travel::travel(moved, window.ts, 1.0 - window.missing())),
        stuck: if known.blurred { None } else { travel::stuck(&window.op, &window.pv, is_missing) },
        distribution: known.op_limits.and_then(|limits| distribution::distribution(&window.op, limits)),
        kept: noise::kept(&window.pv, known.step),
        score: None,
    };
    found.score = score::score(&[
        found.service_factor.map(|share| 1.0 - share),
        found.at_limits,
        found.swing,
        found.stuck,
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
    fn a_loop_of_which_nothing_is_known_has_no_score() {
        let level = |n| Window { ts: 60.0, op: vec![40.0; n], pv: vec![5.0; n], ..Window::default() };
        let mut transforms = Transforms::new();
        let mut of = |window: &Window| indicators(window, &Known::default(), &mut transforms);
        for n in [3, 1440] {
            let found = of(&level(n));
            assert_eq!((found.score, found.swing, found.stuck), (None, None, None), "{n}");
            let values = found.values();
            assert_eq!((values[0], values[6], values[10]), (None, None, None), "{n}");
        }
        // The mean of many samples of 40.1 is another number.
        let at_rest = Window { op: vec![40.1; 1440], ..level(1440) };
        assert_eq!((of(&at_rest).stuck, of(&at_rest).score), (None, None));
        // Without the set point of less than half of the time it is not known how it swings.
        let pv: Vec<f64> = (0..1440).map(|k| ((k * k) as f64 * 0.7).sin()).collect();
        let window = Window { ts: 60.0, op: pv.clone(), sp: Some(vec![0.0; 1440]), pv, ..Window::default() };
        for (sp_known, is_told) in [(None, true), (Some(1000), true), (Some(700), false)] {
            let known = Known { sp_known, ..Known::default() };
            let found = indicators(&window, &known, &mut transforms);
            assert_eq!((found.error.is_some(), found.swing.is_some()), (is_told, is_told), "{sp_known:?}");
            assert!(found.stuck.is_some());
        }
    }

    #[test]
    fn what_good_samples_hardly_cover_has_no_values() {
        let pv: Vec<f64> = (0..100).map(|k| ((k * k) as f64 * 0.7).sin()).collect();
        let rows = |missing| (0..100).map(move |k| if k < missing { Row::Missing } else { Row::Counts });
        let window = |missing| Window {
            ts: 60.0,
            op: pv.clone(),
            pv: pv.clone(),
            rows: rows(missing).collect(),
            ..Window::default()
        };
        let mode = [1.0; 100];
        let mut transforms = Transforms::new();
        let mut of = |missing, silent_s| {
            let known = Known { mode: Some(&mode), silent_s, ..Known::default() };
            indicators(&window(missing), &known, &mut transforms)
        };
        assert!([of(0, 0.0), of(50, 0.0), of(0, 6000.0)].iter().all(|found| found.measured));
        for found in [of(51, 0.0), of(0, 6060.0), of(25, 3060.0)] {
            let values = found.values();
            assert!(!found.measured && values[0].is_none() && values[2..].iter().all(Option::is_none));
        }
        assert_eq!((of(51, 0.0).service_factor, of(0, 6060.0).service_factor), (Some(1.0), None));
    }

    #[test]
    fn the_work_of_a_valve_is_of_the_time_in_which_it_was_seen() {
        // Drawn through for 40 % of the time, in which nothing is seen of a swing.
        let wave = |k: usize| if k < 600 { (0.3 * k as f64).sin() } else { (0.3 * 600.0_f64).sin() };
        let op: Vec<f64> = (0..1000).map(wave).collect();
        let rows = (0..1000).map(|k| if k < 600 { Row::Counts } else { Row::Missing }).collect();
        let window = Window { ts: 1.0, pv: op.clone(), op, rows, ..Window::default() };
        let mut transforms = Transforms::new();
        let mut of = |known: &Known<'_>| indicators(&window, known, &mut transforms);
        let found = of(&Known::default());
        // Two turns in 20.94 s.
        assert!((found.travel.reversals_a_day - 8251.0).abs() < 150.0, "{:?}", found.travel);
        // What was measured before the window was thinned counts, and of a swing that is no more in it nothing is said.
        let travel = Travel { a_day: 7.0, reversals_a_day: 3.0 };
        let known = Known { travel: Some(travel), blurred: true, ..Known::default() };
        let thinned = of(&known);
        assert!(found.stuck.is_some());
        assert_eq!((thinned.travel, thinned.stuck), (travel, None));
    }
}
