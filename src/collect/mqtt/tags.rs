//! From what a message tells to samples in order. Pure: the times are arguments.

use super::config::TimeFallback;
use super::json::{Refused, Told};
use super::plan::Tag;
use crate::collect::Frozen;
use crate::collect::scaling::Reading;
use crate::collect::series::{Order, Series, SourceClock};
use crate::signal::{BadReason, Quality, Sample};

/// A mark stands so long (s) before now by the source's clock: a value that is told in whole milliseconds, or that came a
/// little faster than the others, is still newer.
const MARGIN_S: f64 = 0.05;

/// The time from a mark to the value behind it (s), where that has no later stamp of its own.
const STEP_S: f64 = 1e-3;

/// What is known of one tag.
#[derive(Debug)]
pub(super) struct State {
    series: Series,
    clock: SourceClock,
    frozen: Option<Frozen>,
    /// When its last value came, by the steady clock (s).
    heard: Option<f64>,
    /// Stamp of its last value, as its source told it (s).
    told: Option<f64>,
    /// Whether it has been declared bad since.
    lost: bool,
    /// Whether that was before the start, so that what its source told is not known.
    of_before: bool,
}

/// When a message came.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    /// By our clock (s).
    pub(super) t: f64,
    /// By a clock that nobody sets (s).
    pub(super) steady: f64,
    /// Whether the broker had kept it.
    pub(super) retained: bool,
}

/// What became of a value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Taken {
    /// A sample; `jumped` when the source's clock was set.
    Sample { sample: Sample, jumped: bool },
    /// The newest one again.
    Again,
    /// Older than the newest.
    Old,
}

impl State {
    pub(super) fn new(tag: &Tag) -> Self {
        Self {
            series: Series::default(),
            clock: SourceClock::default(),
            frozen: tag.frozen_after_s.map(Frozen::new),
            heard: None,
            told: None,
            lost: false,
            of_before: false,
        }
    }

    /// Its newest sample is a mark of before the start, of time `mark` (s).
    pub(super) fn resume(&mut self, mark: f64) {
        (self.series, self.lost, self.of_before) = (Series::after(mark), true, true);
    }

    /// Takes a value.
    ///
    /// # Errors
    /// [`Refused::Time`], when it has no time and none may stand in.
    pub(super) fn take(
        &mut self,
        tag: &Tag,
        told: Told,
        came: Arrival,
        fallback: TimeFallback,
    ) -> Result<Taken, Refused> {
        let t = match (told.t, fallback) {
            (Some(t), _) => t,
            (None, TimeFallback::Arrival) => came.t,
            (None, TimeFallback::None) => return Err(Refused::Time),
        };
        let usable = told.raw.is_some() && !matches!(told.quality, Quality::Bad(_));
        let is_live = usable && !told.buffered;
        let same = is_live && (self.of_before || self.told == Some(t));
        self.of_before &= !is_live;
        let unchanged = self.lost && same;
        self.told = Some(t);
        // A value that did not change while it could not be had keeps its old stamp, but comes after the mark; right after it,
        // for what changed since then may still be on its way.
        let t = match self.series.last() {
            Some(mark) if unchanged && t <= mark => mark + STEP_S,
            _ => t,
        };
        // What was buffered is late, and no sign of a clock that was set back.
        let order = if told.buffered { self.series.filled(t) } else { self.series.live(t) };
        match order {
            Order::New | Order::SetBack => {}
            Order::Old if !same => return Ok(Taken::Old),
            // What did not change over an outage stands behind the mark; with its old stamp it is no older for that.
            Order::Again | Order::Old => {
                self.heard = Some(came.steady);
                return Ok(Taken::Again);
            }
        }
        let set_back = order == Order::SetBack;
        let jumped = self.clock.heard(t, came.steady, came.t, set_back).is_some();
        (self.heard, self.lost) = (Some(came.steady), false);
        let Reading { value, mut quality } = match (told.raw, told.quality) {
            (_, Quality::Bad(reason)) => Reading::bad(reason),
            (None, _) => Reading::bad(BadReason::NotANumber),
            (Some(raw), doubt) => {
                let read = tag.scaling.read(raw);
                // Nobody knows how old a retained value is that carries no time.
                let doubt = if came.retained && told.t.is_none() { Quality::Stale } else { doubt };
                let quality = if read.quality.is_good() { doubt } else { read.quality };
                Reading { quality, ..read }
            }
        };
        if let (Quality::Good, Some(frozen)) = (quality, &mut self.frozen)
            && frozen.update(t, value)
        {
            quality = Quality::Stale;
        }
        Ok(Taken::Sample { sample: Sample { t, value, quality }, jumped })
    }

    /// Declares the tag bad from `steady` on, when our clock showed `now` (s), once until its next value; the time is the
    /// source's, as far as it is known.
    pub(super) fn lose(&mut self, reason: BadReason, now: f64, steady: f64) -> Option<Sample> {
        if std::mem::replace(&mut self.lost, true) {
            return None;
        }
        let t = self.clock.now(steady).unwrap_or(now) - MARGIN_S;
        let t = match self.series.last() {
            Some(last) if t <= last => last + STEP_S,
            _ => t,
        };
        self.series.live(t).is_news().then_some(Sample { t, value: f64::NAN, quality: Quality::Bad(reason) })
    }

    /// Whether no value came for longer than `limit` (s) although there was one.
    pub(super) fn is_overdue(&self, steady: f64, limit: f64) -> bool {
        !self.lost && self.heard.is_some_and(|heard| steady - heard > limit)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Config, Plan, TagSpec};
    use super::*;
    use proptest::prelude::*;

    fn tag(more: &str) -> Tag {
        let config: Config = toml::from_str("name = 'b'\naddress = 'h:1883'").unwrap();
        let spec = TagSpec {
            index: 0,
            name: "A.pv".into(),
            role: None,
            config: toml::from_str(&format!("device = 'b'\ntopic = 'a'\n{more}")).unwrap(),
            frozen_after_s: None,
        };
        Plan::new(0, &config, vec![spec]).unwrap().tags.remove(0)
    }

    fn told(raw: f64, t: Option<f64>) -> Told {
        Told { raw: Some(raw), t, quality: Quality::Good, buffered: false }
    }

    fn came(t: f64, retained: bool) -> Arrival {
        Arrival { t, steady: t, retained }
    }

    fn sample(taken: Result<Taken, Refused>) -> Sample {
        match taken {
            Ok(Taken::Sample { sample, .. }) => sample,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_source_time_is_kept_and_a_retained_value_without_one_is_stale() {
        let (tag, arrival) = (tag("scale = 2.0"), TimeFallback::Arrival);
        let mut state = State::new(&tag);
        let first = sample(state.take(&tag, told(3.0, Some(500.0)), came(900.0, true), arrival));
        assert_eq!(first, Sample::good(500.0, 6.0));
        let next = sample(state.take(&tag, told(4.0, None), came(901.0, true), arrival));
        assert_eq!((next.t, next.quality), (901.0, Quality::Stale));
        assert!(sample(state.take(&tag, told(4.0, None), came(902.0, false), arrival)).quality.is_good());
        let none = state.take(&tag, told(4.0, None), came(903.0, false), TimeFallback::None);
        assert_eq!(none, Err(Refused::Time));
        let again = state.take(&tag, told(4.0, Some(902.0)), came(904.0, false), arrival);
        assert_eq!(again, Ok(Taken::Again));
        assert_eq!(state.take(&tag, told(4.0, Some(1.0)), came(905.0, false), arrival), Ok(Taken::Old));
    }

    #[test]
    fn a_lost_tag_is_bad_once_and_in_the_sources_own_time() {
        let tag = tag("");
        let mut state = State::new(&tag);
        let fallback = TimeFallback::Arrival;
        // The source's clock is an hour ahead.
        state.take(&tag, told(1.0, Some(4600.0)), came(1000.0, false), fallback).unwrap();
        assert!(!state.is_overdue(1010.0, 10.0) && state.is_overdue(1010.1, 10.0));
        let lost = state.lose(BadReason::Timeout, 1020.0, 1020.0).unwrap();
        assert_eq!((lost.t, lost.quality), (4620.0 - MARGIN_S, Quality::Bad(BadReason::Timeout)));
        assert_eq!(state.lose(BadReason::LinkDown, 1021.0, 1021.0), None);
        let back = sample(state.take(&tag, told(2.0, Some(4625.0)), came(1025.0, false), fallback));
        assert_eq!(back, Sample::good(4625.0, 2.0));
        assert!(state.lose(BadReason::LinkDown, 1025.0, 1025.0).is_some_and(|mark| mark.t > 4625.0));
    }

    #[test]
    fn a_value_that_did_not_change_meanwhile_is_good_again_behind_the_mark() {
        let (tag, fallback) = (tag(""), TimeFallback::Arrival);
        let mut state = State::new(&tag);
        // A set point of long ago, kept by the broker.
        state.take(&tag, told(50.0, Some(100.0)), came(9000.0, true), fallback).unwrap();
        let mark = state.lose(BadReason::LinkDown, 9100.0, 9100.0).unwrap();
        let bad = Told { quality: Quality::Bad(BadReason::DeviceException), ..told(50.0, Some(100.0)) };
        assert_eq!(state.take(&tag, bad, came(9104.0, true), fallback), Ok(Taken::Old), "no value");
        let back = sample(state.take(&tag, told(50.0, Some(100.0)), came(9105.0, true), fallback));
        assert!(back.quality.is_good() && back.value == 50.0 && back.t > mark.t, "{back:?}");
        let again = state.take(&tag, told(50.0, Some(100.0)), came(9106.0, true), fallback);
        assert_eq!(again, Ok(Taken::Again), "once");
        assert!(!state.is_overdue(9116.0, 10.0), "its source says it still");
        assert!(
            sample(state.take(&tag, told(51.0, Some(9110.0)), came(9110.0, false), fallback)).t == 9110.0
        );
    }

    #[test]
    fn a_value_at_rest_is_good_behind_the_mark_of_before_the_start() {
        let (tag, fallback) = (tag(""), TimeFallback::Arrival);
        let mut state = State::new(&tag);
        state.resume(9000.0);
        assert_eq!(state.lose(BadReason::LinkDown, 9100.0, 9100.0), None, "it is marked already");
        let bad = Told { quality: Quality::Bad(BadReason::DeviceException), ..told(50.0, Some(100.0)) };
        assert_eq!(state.take(&tag, bad, came(9104.0, true), fallback), Ok(Taken::Old), "no value");
        let back = sample(state.take(&tag, told(50.0, Some(100.0)), came(9105.0, true), fallback));
        assert_eq!(back, Sample::good(9000.0 + STEP_S, 50.0));
        let again = state.take(&tag, told(50.0, Some(100.0)), came(9106.0, true), fallback);
        assert_eq!(again, Ok(Taken::Again), "once");
        let next = sample(state.take(&tag, told(51.0, Some(9110.0)), came(9110.0, false), fallback));
        assert_eq!(next, Sample::good(9110.0, 51.0));
        // What changed since the mark has its own stamp.
        state = State::new(&tag);
        state.resume(9000.0);
        let changed = sample(state.take(&tag, told(52.0, Some(9050.0)), came(9105.0, true), fallback));
        assert_eq!(changed, Sample::good(9050.0, 52.0));
    }

    #[test]
    fn what_an_edge_node_had_buffered_sets_no_clock_back() {
        let (tag, fallback) = (tag(""), TimeFallback::Arrival);
        let mut state = State::new(&tag);
        state.take(&tag, told(1.0, Some(1000.0)), came(1000.0, false), fallback).unwrap();
        for t in 900..950 {
            let late = Told { buffered: true, ..told(2.0, Some(f64::from(t))) };
            assert_eq!(state.take(&tag, late, came(1001.0, false), fallback), Ok(Taken::Old));
        }
        assert_eq!(
            sample(state.take(&tag, told(3.0, Some(1002.0)), came(1002.0, false), fallback)).t,
            1002.0
        );
    }

    proptest! {
        /// Samples go forward unless the clock is set back, and none has a value that was not told.
        #[test]
        fn no_sample_is_invented(
            tells in prop::collection::vec((0u8..60, any::<bool>(), 0u8..4, any::<bool>()), 1..120),
        ) {
            let tag = tag("");
            let mut state = State::new(&tag);
            for (number, (t, timed, what, retained)) in tells.into_iter().enumerate() {
                let (now, t) = (number as f64, timed.then_some(f64::from(t)));
                let raw = number as f64;
                if what == 0 {
                    if let Some(mark) = state.lose(BadReason::LinkDown, now, now) {
                        prop_assert!(mark.value.is_nan());
                    }
                    continue;
                }
                let quality = if what == 1 { Quality::Bad(BadReason::DeviceException) } else { Quality::Good };
                let told = Told { raw: Some(raw), t, quality, buffered: false };
                let came = Arrival { t: now, steady: now, retained };
                let lost = state.lost;
                if let Ok(Taken::Sample { sample, .. }) = state.take(&tag, told, came, TimeFallback::Arrival) {
                    // Behind a mark an old stamp is replaced.
                    prop_assert!(sample.t == t.unwrap_or(now) || lost && sample.t >= t.unwrap_or(now));
                    let true_to_it = if what == 1 { sample.value.is_nan() } else { sample.value == raw };
                    prop_assert!(true_to_it, "{:?}", sample);
                }
            }
        }
    }
}
