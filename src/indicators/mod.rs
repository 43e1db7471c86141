//! What a loop's signals say of its health, one indicator a file. Pure: no clock, no files, no randomness.
//!
//! [`indicators`] takes them all from one window. What is not known is none: without a mode there is no service factor,
//! without limits nothing is at one. Without a dead time the Harris index is that of one sample, which a loop with a longer one
//! cannot reach: it does not count in the score. Where good samples cover less than half of a window it has no values: what
//! is drawn through the rest was not measured.

pub mod distribution;
pub mod error;
pub mod harris;
pub mod margins;
pub mod noise;
pub mod oscillation;
pub mod score;
pub mod series;
pub mod service;
pub mod settling;
pub mod travel;

use crate::signal::{Row, Window};
use crate::sysid::spectrum::Transforms;
use crate::sysid::stats::mean;
use distribution::Distribution;
use error::LoopError;
use harris::Harris;
use noise::{Kept, Spread};
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
    /// Step of PV (PV unit; 0 for none) and its spread as it was measured, where the window does not have its samples.
    pub measured: Option<(f64, Spread)>,
    /// At which samples the set point is known; none where it is at all of them.
    pub sp_known: Option<&'a [bool]>,
    /// For how long there has been nothing since the window's end (s): it is a part of the time that is asked of.
    pub silent_s: f64,
    /// Share of the time in which the valve's work was measured (0..1); none where it is that of the window's rows.
    pub seen: Option<f64>,
    /// The valve's work as it was measured, where the window does not have its samples.
    pub travel: Option<Travel>,
    /// Whether most of the movement of PV is too fast for the window: what is left of it says neither how far PV is off and whether it
    /// swings, nor whether it answers.
    pub pv_blurred: bool,
    /// Whether most of the movement of OP is: then it is not known whether PV answers.
    pub op_blurred: bool,
    /// Dead time of the process by a model of the loop, without the sample that passes before OP acts (s).
    pub dead_time_s: Option<f64>,
}

/// The indicators of one loop over one window.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Indicators {
    /// Whether there was enough to measure: finite, and good samples over half of the time.
    pub measured: bool,
    /// Whether most of the movement of PV is too fast for the window: then error, swing and score are not known.
    pub blurred: bool,
    /// Share of the time in automatic (0..1).
    pub service_factor: Option<f64>,
    /// Share of the time with OP at a limit (0..1).
    pub at_limits: Option<f64>,
    /// The error.
    pub error: Option<LoopError>,
    /// Its mean (PV); none without a set point.
    pub error_mean: Option<f64>,
    /// Mean of PV (PV).
    pub pv_mean: Option<f64>,
    /// The Harris index for the dead time of the process and one sample; for one sample where that of the process is not known.
    pub harris: Option<Harris>,
    /// The Harris index for one sample, by which causes are told: their weights are fitted on it.
    pub harris_of_one: Option<Harris>,
    /// Dead time of the process that `harris` is for (s); none where that is for one sample.
    pub dead_time_s: Option<f64>,
    /// Oscillations of the error, the largest first.
    pub oscillations: Vec<Oscillation>,
    /// Share of the error's variance in them (0..1); none where the error is too short or does not move.
    pub swing: Option<f64>,
    /// How steps of the set point are followed.
    pub settling: Option<Settling>,
    /// The valve's work; none where it was measured over less than half of the time.
    pub travel: Option<Travel>,
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
    /// With what rows between the samples do not tell, taken from the latest part of the record, which has the samples: the Harris
    /// index and whether PV answers OP.
    #[must_use]
    pub fn with_recent(mut self, recent: &Self) -> Self {
        if self.measured {
            (self.harris, self.harris_of_one) = (recent.harris, recent.harris_of_one);
            (self.dead_time_s, self.stuck) = (recent.dead_time_s, recent.stuck);
            self.score = self.scored();
        }
        self
    }

    /// Whether tuning has nothing to gain: the error is as small as a controller can make it.
    pub fn is_at_minimum(&self) -> bool {
        self.harris.is_some_and(|harris| harris.is_at_minimum())
    }

    fn scored(&self) -> Option<f64> {
        // A cycle that does not show may be all that is wrong.
        (!self.blurred).then_some(())?;
        let in_manual = self.service_factor.map(|share| 1.0 - share);
        score::score(&[in_manual, self.at_limits, self.swing, self.stuck])
    }

    /// As numbers.
    pub fn values(&self) -> Values {
        let measured = |value: f64| self.measured.then_some(value);
        [
            self.score,
            self.service_factor,
            self.at_limits,
            self.error.map(|error| error.sd),
            // About a mean that every look has for itself it is no error over a day.
            self.error_mean.and(self.error).map(|error| error.mean_absolute),
            self.harris.map(|harris| harris.index),
            self.swing,
            self.oscillations.first().map(|own| own.period_s),
            self.travel.map(|travel| travel.a_day),
            self.travel.map(|travel| travel.reversals_a_day),
            self.stuck,
            measured(self.kept.noise_share),
            measured(self.kept.quantisation),
            self.error_mean,
            self.pv_mean,
            self.error_mean.and(self.error).map(|error| error.mean_square),
            self.settling.and_then(|settling| settling.time_s),
            self.oscillations.first().map(|own| own.regularity),
            measured(self.kept.compression),
            self.harris.and_then(|harris| harris.interval).map(|interval| interval.0),
            self.harris.and_then(|harris| harris.interval).map(|interval| interval.1),
            self.harris.and(self.dead_time_s),
        ]
        .map(|value: Option<f64>| value.filter(|x| x.is_finite()))
    }
}

/// Takes all indicators; a window with values that are not finite, or with good samples over less than half of its time, gives
/// those that need none.
pub fn indicators(window: &Window, known: &Known<'_>, transforms: &mut Transforms) -> Indicators {
    let finite = window.op.iter().chain(&window.pv).all(|x| x.is_finite());
    let length = window.pv.len() as f64 * window.ts;
    let is_sparse = |seen: f64| 2.0 * length * seen < length + known.silent_s;
    let covered = 1.0 - window.missing();
    // The mode is known no further than the window goes.
    let service_factor = known.mode.filter(|_| length >= known.silent_s).and_then(service::service_factor);
    let usable = window.op.len() == window.pv.len() && window.ts > 0.0;
    if !finite || is_sparse(covered) || !usable {
        return Indicators { service_factor, ..Indicators::default() };
    }
    let sp = window.sp.as_deref().filter(|sp| sp.len() == window.pv.len());
    let e = if known.pv_blurred { Vec::new() } else { error::known_errors(&window.pv, sp, known.sp_known) };
    let has_error = !e.is_empty();
    let oscillations = oscillation::oscillations(&e, window.ts, transforms);
    let (moved, seen) = (window.mv.as_deref().unwrap_or(&window.op), known.seen.unwrap_or(covered));
    let is_missing = |k: usize| window.row(k) == Row::Missing;
    // Nor is it known how PV followed a step where it is drawn through a gap.
    let is_known =
        |k: usize| known.sp_known.is_none_or(|known| known.get(k) == Some(&true)) && !is_missing(k);
    let harris_of_one = harris::harris(&e, 1);
    let harris = match harris::samples(known.dead_time_s, window.ts) {
        1 => harris_of_one,
        dead => harris::harris(&e, dead),
    };
    let swinging: f64 = oscillations.iter().map(|oscillation| oscillation.share).sum();
    let mut found = Indicators {
        measured: true,
        blurred: known.pv_blurred,
        service_factor,
        at_limits: known.op_limits.and_then(|limits| service::at_limits(&window.op, limits)),
        error: error::measure(&e, window.ts),
        error_mean: sp.filter(|_| has_error).map(|_| mean(&e)),
        pv_mean: (!window.pv.is_empty()).then(|| mean(&window.pv)),
        harris,
        harris_of_one,
        dead_time_s: known.dead_time_s.filter(|_| harris.is_some()),
        oscillations,
        swing: oscillation::can_tell(&e).then_some(swinging.clamp(0.0, 1.0)),
        settling: sp
            .filter(|_| has_error)
            .and_then(|sp| settling::settling(&window.pv, sp, window.ts, is_known)),
        travel: (!is_sparse(seen))
            .then(|| known.travel.unwrap_or_else(|| travel::travel(moved, window.ts, seen))),
        stuck: if known.pv_blurred || known.op_blurred {
            None
        } else {
            travel::stuck(&window.op, &window.pv, is_missing)
        },
        distribution: known.op_limits.and_then(|limits| distribution::distribution(&window.op, limits)),
        kept: noise::kept(&window.pv, known.measured),
        score: None,
    };
    found.score = found.scored();
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution as _, StandardNormal};

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
    fn the_harris_index_is_for_the_dead_time_that_is_known() {
        // Minimum variance for three samples: of the error nothing is known so long before, and two thirds one sample before.
        let noise: Vec<f64> =
            StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(6)).take(8002).collect();
        let pv: Vec<f64> = noise.windows(3).map(|w| w[2] + w[1] + w[0]).collect();
        let window = Window { ts: 10.0, op: pv.clone(), pv, ..Window::default() };
        let mut transforms = Transforms::new();
        let mut of = |dead_time_s| {
            let found = indicators(&window, &Known { dead_time_s, ..Known::default() }, &mut transforms);
            let values = found.values();
            let names = ["harris", "harris_low", "harris_high", "harris_dead_time_s"];
            let told = names
                .map(|name| series::NAMED.iter().position(|own| own.0 == name).and_then(|at| values[at]));
            (found.harris, found.harris_of_one, told)
        };
        let (harris, of_one, [index, low, high, dead_time_s]) = of(Some(20.0));
        assert!(index.is_some_and(|index| index > 0.97) && index == harris.map(|own| own.index), "{index:?}");
        assert!(low < index && index <= high && dead_time_s == Some(20.0), "{low:?} {high:?}");
        let (harris, same, [index, _, _, dead_time_s]) = of(None);
        // A third, and with no more than 15 lags three eighths.
        assert!(index.is_some_and(|index| (index - 0.375).abs() < 0.04), "{index:?}");
        assert_eq!((harris, same, dead_time_s), (of_one, of_one, None));
        // A process without a dead time of its own is one of one sample.
        assert_eq!((of(Some(0.0)).0, of(Some(0.0)).2[3]), (of_one, Some(0.0)));
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
        for (count, is_told) in [(1440, true), (1000, true), (700, false)] {
            let sp_known: Vec<bool> = (0..1440).map(|k| k < count).collect();
            let known = Known { sp_known: Some(&sp_known), ..Known::default() };
            let found = indicators(&window, &known, &mut transforms);
            assert_eq!((found.error.is_some(), found.swing.is_some()), (is_told, is_told), "{count}");
            assert_eq!((found.error_mean.is_some(), found.pv_mean.is_some()), (is_told, true));
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
    fn a_step_that_pv_was_not_seen_to_follow_is_not_timed() {
        // PV is lost before the step and found at the new level: nobody saw the line between.
        let sp: Vec<f64> = (0..400).map(|k| if k < 100 { 0.0 } else { 10.0 }).collect();
        let pv: Vec<f64> = (0..400).map(|k| (0.1 * (f64::from(k) - 90.0)).clamp(0.0, 10.0)).collect();
        let mut transforms = Transforms::new();
        let mut of = |lost: std::ops::Range<i32>| {
            let rows = (0..400).map(|k| if lost.contains(&k) { Row::Missing } else { Row::Counts });
            let (op, rows) = (pv.clone(), rows.collect());
            let window =
                Window { ts: 1.0, op, sp: Some(sp.clone()), pv: pv.clone(), rows, ..Window::default() };
            let found = indicators(&window, &Known::default(), &mut transforms);
            assert!(found.measured && found.error.is_some());
            found.settling.map(|own| (own.steps, own.settled))
        };
        assert_eq!((of(0..0), of(90..190)), (Some((1, 1)), None));
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
        let own = found.travel.expect("seen for most of the time");
        assert!((own.reversals_a_day - 8251.0).abs() < 150.0, "{own:?}");
        // What was measured before the window was thinned counts, and of a swing that is no more in it nothing is said.
        let travel = Travel { a_day: 7.0, reversals_a_day: 3.0 };
        let thinned = of(&Known { travel: Some(travel), ..Known::default() });
        assert_eq!((thinned.travel, thinned.stuck), (Some(travel), found.stuck));
        // Of a valve that was seen for less than half of the time nothing is known.
        for (seen, is_told) in [(0.5, true), (0.49, false)] {
            let valve = of(&Known { travel: Some(travel), seen: Some(seen), ..Known::default() });
            assert_eq!((valve.travel.is_some(), valve.measured), (is_told, true));
        }
    }

    #[test]
    fn what_is_too_fast_for_the_window_is_not_judged_by_the_rest() {
        let op: Vec<f64> = (0..1000).map(|k| (0.3 * f64::from(k)).sin()).collect();
        let limits = Some((-10.0, 10.0));
        let window = Window { ts: 1.0, sp: Some(vec![0.0; 1000]), pv: op.clone(), op, ..Window::default() };
        let mut transforms = Transforms::new();
        let mut of = |pv_blurred, op_blurred| {
            let known = Known { op_limits: limits, mode: Some(&[1.0; 1000]), ..Known::default() };
            indicators(&window, &Known { pv_blurred, op_blurred, ..known }, &mut transforms)
        };
        let unknown = |of: &Indicators| {
            let values = of.values();
            (0..series::COUNT).filter(|at| values[*at].is_none()).collect::<Vec<_>>()
        };
        let (sharp, pv, op) = (of(false, false), of(true, false), of(false, true));
        // The set point makes no step, and there is no model.
        assert_eq!(unknown(&sharp), [16, 21]);
        // Score, error, Harris index and its interval, swing, its period and regularity, whether PV stands still.
        let blurred = vec![0, 3, 4, 5, 6, 7, 10, 13, 15, 16, 17, 19, 20, 21];
        assert_eq!((unknown(&pv), pv.score), (blurred, None));
        // What OP does is asked for nothing but whether PV answers it.
        assert_eq!((unknown(&op), op.error, op.swing), (vec![10, 16, 21], sharp.error, sharp.swing));
        assert!(op.score.is_some_and(|score| score < sharp.score.expect("known")), "{:?}", op.score);
        // The latest part has both, and the score what it says of the valve.
        let sure = Indicators { stuck: Some(1.0), harris: None, ..sharp.clone() };
        let told = op.with_recent(&sure);
        assert_eq!((told.stuck, told.harris), (Some(1.0), None));
        assert!(told.score.is_some_and(|score| sharp.score.expect("known") - score > 10.0), "{told:?}");
        assert_eq!(pv.with_recent(&sharp).score, None);
        assert_eq!(Indicators::default().with_recent(&sharp), Indicators::default());
    }
}
