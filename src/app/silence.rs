//! Whether anything comes of a loop any more. Stamps say since when not; what they are compared with is the clock that makes them,
//! as the samples tell that have come: a source whose clock is hours behind is not silent. OP and PV may have two clocks.

use super::Clock;
use crate::history::{History, TagKind};
use crate::plantwide::window::{Source, silent_of, silent_since};
use crate::results::Silent;
use crate::schedule::Silence;
use crate::signal::{LoopId, Record, Role};
use std::sync::Arc;

/// Lead of a stamp over our clock (s) above which a sample from before the start is told in the log: sources may be some minutes off.
const AHEAD_S: f64 = 3600.0;

/// Asks the rings of `history`.
pub(super) fn of_rings(history: &Arc<History>, clock: Clock) -> Silence {
    let history = history.clone();
    Arc::new(move |id, record, period_s| of_loop(&history, clock, (id, record), period_s))
}

fn of_loop(history: &History, clock: Clock, of: (&LoopId, &Record), period_s: f64) -> Option<Silent> {
    let (id, record) = of;
    let since_start_s = clock.elapsed().as_secs_f64();
    named(silent_of(record, period_s, sources((history, id), (clock.now(), since_start_s), period_s)))
}

/// What is known of the sources of PV and OP of a loop, at a time by our clock and after the start (s), of which each was there
/// where it was so within a period (s).
pub(super) fn sources(of: (&History, &LoopId), now: (f64, f64), period_s: f64) -> [Source; 2] {
    let ((history, id), (now, since_start_s)) = (of, now);
    // Of a tag of which nothing has come since the start, our own clock is all there is. A stamp that is later than that was made by
    // a clock that was ahead, and is of before the start all the same.
    let ours = |kind: &TagKind| {
        let ring = history.tag_index(id, kind).and_then(|tag| history.ring(tag));
        ring.and_then(|ring| ring.latest()).map_or(now, |last| now.max(last.t + since_start_s))
    };
    [Role::Pv, Role::Op].map(TagKind::Role).map(|kind| Source {
        now: history.stamps_show(id, &kind, since_start_s).unwrap_or_else(|| ours(&kind)),
        is_there: history.was_there(id, &kind, since_start_s, period_s),
    })
}

/// Says in the log that samples of before the start are stamped later than our clock shows.
pub(super) fn tell_ahead(history: &History, now: f64) {
    if let Some((tags, by_s)) = ahead(history, now) {
        tracing::warn!(
            tags,
            by_s,
            "samples that the store gave back are stamped later than this machine's clock shows: this clock was ahead when they \
             came, or the clock of their source is; where no new ones come, the loop is silent once a period has passed"
        );
    }
}

/// The number of tags whose latest sample is stamped later than `now` (s) by more than [`AHEAD_S`], and the largest lead (s).
fn ahead(history: &History, now: f64) -> Option<(usize, f64)> {
    let latest = (0..history.tag_count()).filter_map(|tag| history.ring(tag)?.latest());
    let ahead: Vec<f64> = latest.map(|last| last.t - now).filter(|ahead| *ahead > AHEAD_S).collect();
    Some((ahead.len(), ahead.into_iter().reduce(f64::max)?))
}

/// Of a record alone, at a time by the clock that stamped it (s).
pub(super) fn of_record(record: &Record, now: f64, period_s: f64) -> Option<Silent> {
    named(silent_since(record, now, period_s))
}

fn named(silent: Option<(&'static str, f64)>) -> Option<Silent> {
    let (name, since) = silent?;
    Some(Silent { tag: if name == "OP" { Role::Op } else { Role::Pv }, since })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::{Config, LoopTags, TagSpec};
    use crate::signal::{BadReason, Quality, Sample, SpanSource};

    /// 2026-01-01T00:00:00Z.
    const START: f64 = 1_767_225_600.0;
    const PERIOD_S: f64 = 600.0;
    /// Between two samples (s).
    const TS_S: f64 = 10.0;

    /// A loop of OP and PV, and the clock of its daemon.
    struct Rig {
        history: Arc<History>,
        clock: Clock,
        id: LoopId,
    }

    impl Rig {
        fn new() -> Self {
            let tag = |role: Role| TagSpec {
                kind: TagKind::Role(role),
                unit: String::new(),
                source: role.as_str().to_string(),
            };
            let id = LoopId::new("A");
            let tags = LoopTags {
                id: id.clone(),
                tags: vec![tag(Role::Op), tag(Role::Pv)],
                op_limits: None,
                op_span: None,
                op_span_source: SpanSource::Unknown,
            };
            let history = Arc::new(History::new(&[tags], &Config { samples_per_tag: 1000 }));
            Self { history, clock: Clock::by_hand(START), id }
        }

        /// A sample of a tag comes so long after the start (s), stamped by a clock that is `ahead` of ours (s).
        fn hear(&self, tag: usize, at: f64, ahead: f64, value: f64) {
            let t = START + at + ahead;
            self.history.push(tag, Sample::good(t, value));
            self.history.ring(tag).expect("a tag").heard().sample(t, at);
        }

        /// OP and PV come for so long (s), no value twice in a row.
        fn hear_both(&self, seconds: f64, ahead: f64) {
            for k in 0..(seconds / TS_S) as u32 {
                let at = TS_S * f64::from(k);
                self.hear(0, at, ahead, 50.0 + (0.1 * at).sin());
                self.hear(1, at, ahead, 20.0 + (0.1 * at).cos());
            }
        }

        /// Who is silent so long after the start (s).
        fn silent(&self, at: f64) -> Option<Silent> {
            self.clock.set(START + at);
            let record = self.history.snapshot(&self.id).expect("the loop is there");
            of_rings(&self.history, self.clock)(&self.id, &record, PERIOD_S)
        }
    }

    #[test]
    fn a_loop_is_silent_when_nothing_has_come_for_a_period() {
        let rig = Rig::new();
        rig.hear_both(2000.0, 0.0);
        assert_eq!((rig.silent(1990.0), rig.silent(2580.0)), (None, None));
        let silent = Silent { tag: Role::Pv, since: START + 1990.0 };
        assert_eq!((rig.silent(2600.0), rig.silent(400_000.0)), (Some(silent), Some(silent)));
        // What comes without a value is no life: a broker that is gone is marked once, a device at every poll.
        for at in [2000.0, 2010.0, 2590.0] {
            let bad = Sample { t: START + at, value: f64::NAN, quality: Quality::Bad(BadReason::LinkDown) };
            rig.history.push(1, bad);
        }
        assert_eq!(rig.silent(2600.0), Some(silent));
        // It is back.
        rig.hear(1, 2700.0, 0.0, 21.0);
        assert_eq!(rig.silent(2700.0), None);
    }

    #[test]
    fn a_source_whose_clock_is_off_is_silent_when_nothing_comes_and_not_before() {
        for ahead in [-18_000.0, 18_000.0] {
            let rig = Rig::new();
            rig.hear_both(2000.0, ahead);
            assert_eq!((rig.silent(1990.0), rig.silent(2580.0)), (None, None), "{ahead}");
            let silent = Silent { tag: Role::Pv, since: START + 1990.0 + ahead };
            assert_eq!(rig.silent(2600.0), Some(silent), "{ahead}");
        }
    }

    #[test]
    fn what_a_store_gave_back_is_as_old_as_our_clock_says() {
        let rig = Rig::new();
        for k in 0..200 {
            let t = START - 5000.0 + TS_S * f64::from(k);
            rig.history.push(0, Sample::good(t, f64::from(k)));
            rig.history.push(1, Sample::good(t, f64::from(k)));
        }
        // The last of them is 3,010 s older than the start.
        assert_eq!(rig.silent(1.0), Some(Silent { tag: Role::Pv, since: START - 3010.0 }));
        rig.hear(0, 10.0, 0.0, 50.0);
        rig.hear(1, 10.0, 0.0, 50.0);
        assert_eq!(rig.silent(20.0), None);
    }

    #[test]
    fn what_a_clock_stamped_that_was_ahead_is_as_old_as_the_start() {
        let rig = Rig::new();
        // Three days, and set right while nothing ran.
        let first = START + 3.0 * 86_400.0;
        for k in 0..200 {
            let t = first + TS_S * f64::from(k);
            rig.history.push(0, Sample::good(t, f64::from(k)));
            rig.history.push(1, Sample::good(t, f64::from(k)));
        }
        assert_eq!(ahead(&rig.history, START), Some((2, first + 1990.0 - START)));
        assert_eq!(ahead(&rig.history, first), None, "half an hour is no clock that was wrong");
        assert_eq!((rig.silent(1.0), rig.silent(590.0)), (None, None));
        let silent = Silent { tag: Role::Pv, since: first + 1990.0 };
        assert_eq!((rig.silent(610.0), rig.silent(86_400.0)), (Some(silent), Some(silent)));
        // What comes now is not behind the latest of the record, but the first of another one.
        rig.hear(0, 90_000.0, 0.0, 50.0);
        rig.hear(1, 90_000.0, 0.0, 20.0);
        assert_eq!(rig.silent(90_000.0), None);
        let record = rig.history.snapshot(&rig.id).expect("the loop is there");
        let times = [&record.op, &record.pv].map(|own| own.iter().map(|s| s.t).collect::<Vec<_>>());
        assert_eq!(times, [[START + 90_000.0], [START + 90_000.0]]);
    }

    #[test]
    fn a_source_of_changes_that_is_there_is_not_silent_while_nothing_changes() {
        let rig = Rig::new();
        rig.hear_both(2000.0, 0.0);
        let there = |at: f64| [0, 1].map(|tag| rig.history.ring(tag).expect("a tag").heard().seen(at));
        there(80_000.0);
        assert_eq!(rig.silent(80_001.0), None);
        // It has gone.
        assert_eq!(rig.silent(81_000.0).map(|own| own.tag), Some(Role::Pv));
        there(82_000.0);
        assert_eq!(rig.silent(82_001.0), None);
        // It says that PV is bad.
        let bad =
            Sample { t: START + 3000.0, value: f64::NAN, quality: Quality::Bad(BadReason::DeviceException) };
        rig.history.push(1, bad);
        assert_eq!(rig.silent(82_001.0).map(|own| own.tag), Some(Role::Pv));
        // That it once sent a value again, as after a reconnect, makes it no other source.
        let rig = Rig::new();
        rig.hear_both(2000.0, 0.0);
        rig.hear(1, 2000.0, 0.0, 21.0);
        rig.hear(1, 2010.0, 0.0, 21.0);
        rig.history.ring(1).expect("PV").heard().seen(80_000.0);
        assert_eq!(rig.silent(80_001.0), None);
        assert_eq!(rig.silent(81_000.0), Some(Silent { tag: Role::Pv, since: START + 2010.0 }));
    }

    #[test]
    fn each_tag_is_judged_by_the_clock_that_stamps_it() {
        for [op, pv] in [[-18_000.0, 0.0], [18_000.0, 0.0], [0.0, -18_000.0], [0.0, 18_000.0]] {
            let rig = Rig::new();
            for k in 0..200 {
                let at = TS_S * f64::from(k);
                rig.hear(0, at, op, 50.0 + (0.1 * at).sin());
                rig.hear(1, at, pv, 20.0 + (0.1 * at).cos());
            }
            assert_eq!((rig.silent(1990.0), rig.silent(2580.0)), (None, None), "{op} {pv}");
            let silent = Silent { tag: Role::Pv, since: START + 1990.0 + pv };
            assert_eq!(rig.silent(2600.0), Some(silent), "{op} {pv}");
            // PV comes again, and OP, which repeated a value before, does not.
            rig.hear(0, 2600.0, op, 50.0);
            rig.hear(0, 2610.0, op, 50.0);
            rig.hear(1, 3300.0, pv, 20.0);
            let silent = Silent { tag: Role::Op, since: START + 2610.0 + op };
            assert_eq!(rig.silent(3300.0), Some(silent), "{op} {pv}");
        }
    }

    #[test]
    fn a_pv_at_zero_while_the_unit_is_down_is_a_value() {
        // A subscription tells the change to zero once.
        let rig = Rig::new();
        rig.hear_both(2000.0, 0.0);
        rig.hear(1, 2000.0, 0.0, 0.0);
        let there = |at: f64| [0, 1].map(|tag| rig.history.ring(tag).expect("a tag").heard().seen(at));
        there(80_000.0);
        assert_eq!(rig.silent(80_001.0), None);
        assert_eq!(rig.silent(81_000.0), Some(Silent { tag: Role::Pv, since: START + 2000.0 }));
        // A poll reads it again and again; OP is sent by changes.
        let rig = Rig::new();
        rig.hear_both(2000.0, 0.0);
        (200..290).for_each(|k| rig.hear(1, TS_S * f64::from(k), 0.0, 0.0));
        assert_eq!(rig.silent(2900.0), None);
    }

    #[test]
    fn one_sample_is_no_silence() {
        let rig = Rig::new();
        [0, 1].into_iter().for_each(|tag| rig.hear(tag, 0.0, 0.0, 50.0));
        assert_eq!(rig.silent(2.0 * PERIOD_S), None);
        [0, 1].into_iter().for_each(|tag| rig.hear(tag, 900.0, 0.0, 51.0));
        assert_eq!((rig.silent(9900.0), rig.silent(9901.0).map(|own| own.tag)), (None, Some(Role::Pv)));
    }
}
