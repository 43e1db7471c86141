//! The order of one tag's samples: each time once, forward only, unless the source's clock was set back.

/// So many samples in a row, each later than the one before but earlier than the newest, mean a clock set back.
const SET_BACK: u32 = 5;
/// What the subscription saw while history was read has come by then (s of source time).
const LATE_S: f64 = 60.0;

/// What was handed on of one tag. Pure.
#[derive(Clone, Debug, Default)]
pub(super) struct Series {
    last: Option<f64>,
    older: Option<(f64, u32)>,
    /// After what, and up to what, samples last came from history (s).
    history: Option<(f64, f64)>,
    /// The newest sample was handed on once more, at this time (s).
    repeated: Option<f64>,
}

/// What a sample is to those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// Later than all: to be handed on.
    New,
    /// The first after the clock was set back: to be handed on.
    SetBack,
    /// The newest one again, or one that history has brought already.
    Again,
    /// Older than the newest one, or without a time.
    Old,
}

impl Order {
    /// Whether the sample is to be handed on.
    pub(super) fn is_news(self) -> bool {
        matches!(self, Order::New | Order::SetBack)
    }
}

impl Series {
    /// Time of the newest sample handed on (s).
    pub(super) fn last(&self) -> Option<f64> {
        self.last
    }

    /// Time of the newest that was handed on, a sample that was repeated too (s).
    pub(super) fn end(&self) -> Option<f64> {
        self.repeated.or(self.last)
    }

    /// Goes on after a sample of time `last` (s) that was handed on before the start.
    pub(super) fn after(last: f64) -> Self {
        Self { last: Some(last), ..Self::default() }
    }

    /// Whether a sample of time `t` (s) would be the newest.
    pub(super) fn is_newer(&self, t: f64) -> bool {
        t.is_finite() && self.end().is_none_or(|end| t > end)
    }

    /// Takes a mark of time `t` (s), which says that there is no value; true when it is the newest and to be handed on.
    /// It is no sample of the history: what comes behind it has not come already.
    pub(super) fn mark(&mut self, t: f64) -> bool {
        let newer = self.is_newer(t);
        if newer {
            (self.last, self.history, self.repeated) = (Some(t), None, None);
        }
        newer
    }

    /// The newest sample is handed on once more, at `t` (s): true when that is its turn, and for the first time.
    /// What comes next comes behind it, and the sample itself is no more news than it was.
    pub(super) fn repeat(&mut self, t: f64) -> bool {
        let first = self.last.is_some() && self.repeated.is_none() && self.is_newer(t);
        if first {
            self.repeated = Some(t);
        }
        first
    }

    /// Takes a sample just received.
    pub(super) fn live(&mut self, t: f64) -> Order {
        let Some(last) = self.last.filter(|_| t.is_finite()) else {
            return self.filled(t);
        };
        // What the subscription saw while history was read comes after it.
        if t == last || self.history.is_some_and(|(after, until)| t > after && t <= until) {
            return Order::Again;
        }
        if t > last {
            if !self.is_newer(t) {
                return Order::Old;
            }
            (self.last, self.older, self.repeated) = (Some(t), None, None);
            self.history = self.history.filter(|(_, until)| t <= until + LATE_S);
            return Order::New;
        }
        let run = match self.older {
            Some((older, run)) if t > older => run + 1,
            Some((older, run)) if t == older => run,
            _ => 1,
        };
        self.older = Some((t, run));
        if run < SET_BACK {
            return Order::Old;
        }
        (self.last, self.older, self.history, self.repeated) = (Some(t), None, None, None);
        Order::SetBack
    }

    /// Takes a sample of the server's history: it never sets the time back.
    pub(super) fn filled(&mut self, t: f64) -> Order {
        if !self.is_newer(t) {
            return Order::Old;
        }
        let after = match (self.history, self.last) {
            (Some((after, until)), Some(last)) if until == last => after,
            (_, last) => last.unwrap_or(t),
        };
        (self.last, self.older, self.history, self.repeated) = (Some(t), None, Some((after, t)), None);
        Order::New
    }
}

/// A time so far ahead of all that were expected (s) is a clock that was set.
const JUMP_S: f64 = 60.0;
/// An estimate older than this is taken anew (s), since two clocks never run alike.
const ANEW_S: f64 = 600.0;

/// What a source's clock shows, carried on by a steady clock that nobody sets. Pure.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SourceClock {
    /// A source time, and when it came by the steady clock (s).
    known: Option<(f64, f64)>,
    /// What is known is of now, and not only the stamp of a value that may not have changed for days.
    runs: bool,
    /// The newest stamp too far ahead to be believed, and how many have come in a row, each later than the one before.
    ahead: Option<(f64, u32)>,
}

impl SourceClock {
    /// The source's time at `steady` (s); `None` before the first sample.
    pub(super) fn now(&self, steady: f64) -> Option<f64> {
        self.known.map(|(t, at)| t + (steady - at))
    }

    /// The same; `None` too while all that came is one value, stamped long before our own clock's time.
    pub(super) fn running(&self, steady: f64) -> Option<f64> {
        self.now(steady).filter(|_| self.runs)
    }

    /// Takes the time `t` of a sample that came at `steady`, when our own clock showed `ours` (s). Returns by how much
    /// the source's clock was set, if it was.
    pub(super) fn heard(&mut self, t: f64, steady: f64, ours: f64, set_back: bool) -> Option<f64> {
        let Some(expected) = self.now(steady) else {
            (self.known, self.runs) = (Some((t, steady)), t >= ours - JUMP_S);
            return None;
        };
        let ahead = !set_back && t > expected.max(ours) + JUMP_S;
        if ahead && !self.is_confirmed(t) {
            return None;
        }
        (self.runs, self.ahead) = (true, None);
        // The sample that came without delay tells the time; an old one tells nothing.
        let stale = self.known.is_some_and(|(_, at)| steady - at > ANEW_S);
        if t >= expected || set_back || (stale && t > expected - JUMP_S) {
            self.known = Some((t, steady));
        }
        let jumped = if set_back { t < expected - 1.0 } else { ahead };
        jumped.then_some(t - expected)
    }

    /// Whether so many stamps far ahead have come in a row that a clock was set, and not one of them wrong.
    fn is_confirmed(&mut self, t: f64) -> bool {
        let run = match self.ahead {
            Some((before, run)) if t > before => run + 1,
            _ => 1,
        };
        self.ahead = Some((t, run));
        run >= SET_BACK
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn each_time_once_and_forward() {
        let mut series = Series::default();
        let orders: Vec<Order> = [1.0, 1.0, 2.0, 1.5, 3.0].into_iter().map(|t| series.live(t)).collect();
        assert_eq!(orders, [Order::New, Order::Again, Order::New, Order::Old, Order::New]);
        assert_eq!(series.live(f64::NAN), Order::Old);
        assert_eq!(series.filled(2.9), Order::Old);
        assert_eq!(series.filled(3.5), Order::New);
        assert_eq!(series.last(), Some(3.5));
    }

    #[test]
    fn a_clock_set_back_is_believed_after_several_samples_and_one_stray_is_not() {
        let mut series = Series::default();
        series.live(3600.0);
        assert_eq!(series.live(0.0), Order::Old);
        assert_eq!(series.live(3601.0), Order::New);
        for t in 1..5 {
            assert_eq!(series.live(f64::from(t)), Order::Old);
        }
        // The same stamp again and again is a value that does not change, not a clock that runs.
        assert_eq!(series.live(4.0), Order::Old);
        assert_eq!(series.live(5.0), Order::SetBack);
        assert_eq!(series.live(6.0), Order::New);
    }

    #[test]
    fn what_history_has_brought_is_no_clock_set_back_when_it_comes_again() {
        let mut series = Series::default();
        series.live(10.0);
        for t in 11..=30 {
            assert_eq!(series.filled(f64::from(t)), Order::New);
        }
        for t in 15..=30 {
            assert_eq!(series.live(f64::from(t)), Order::Again, "{t}");
        }
        assert_eq!(series.live(31.0), Order::New);
        assert_eq!(series.live(30.0), Order::Again);
        // Before the gap nothing came from history.
        for t in 1..5 {
            assert_eq!(series.live(f64::from(t)), Order::Old);
        }
        assert_eq!(series.live(5.0), Order::SetBack);
    }

    #[test]
    fn the_sources_clock_goes_on_by_itself_and_its_jumps_are_seen_once() {
        let mut clock = SourceClock::default();
        assert_eq!(clock.now(5.0), None);
        // The first value may be a day old; the next is of now, and no jump.
        assert_eq!(clock.heard(1000.0, 0.0, 87_400.0, false), None);
        assert_eq!(clock.heard(87_400.0, 1.0, 87_401.0, false), None);
        assert_eq!(clock.now(11.0), Some(87_410.0));
        // A value that came late, and our own clock an hour off, change nothing.
        assert_eq!(clock.heard(87_000.0, 11.0, 91_000.0, false), None);
        assert_eq!(clock.now(11.0), Some(87_410.0));
        // An hour forward is believed at the fifth sample, and said once; so is the way back.
        for k in [0.0, 1.0, 2.0, 3.0] {
            assert_eq!(clock.heard(91_010.0 + k, 11.0 + k, 87_411.0 + k, false), None);
            assert_eq!(clock.now(11.0 + k), Some(87_410.0 + k));
        }
        assert_eq!(clock.heard(91_014.0, 15.0, 87_415.0, false), Some(3600.0));
        assert_eq!(clock.heard(91_015.0, 16.0, 87_416.0, false), None);
        assert_eq!(clock.heard(87_420.0, 21.0, 87_421.0, true), Some(-3600.0));
        assert_eq!(clock.heard(87_420.0, 21.0, 87_421.0, true), None);
        // A source that runs slow is followed, if not at once.
        assert_eq!(clock.heard(88_414.0, 1017.0, 88_417.0, false), None);
        assert_eq!(clock.now(1017.0), Some(88_414.0));
    }

    #[test]
    fn one_stamp_of_another_century_sets_no_clock() {
        let mut clock = SourceClock::default();
        clock.heard(1000.0, 0.0, 1000.0, false);
        assert_eq!(clock.heard(4e9, 1.0, 1001.0, false), None);
        assert_eq!(clock.now(2.0), Some(1002.0));
        // What comes in between begins the count anew.
        for k in 0..4 {
            assert_eq!(clock.heard(4e9 + f64::from(k), 2.0, 1002.0, false), None);
            assert_eq!(clock.heard(1002.0, 2.0, 1002.0, false), None);
        }
        assert_eq!(clock.heard(4e9 + 9.0, 2.0, 1002.0, false), None);
        assert_eq!(clock.now(2.0), Some(1002.0));
    }

    #[test]
    fn a_clock_runs_once_its_time_is_known_to_be_of_now() {
        let mut clock = SourceClock::default();
        // A set point of yesterday tells nothing of the time; its next change does.
        clock.heard(13_600.0, 0.0, 100_000.0, false);
        assert_eq!((clock.now(5.0), clock.running(5.0)), (Some(13_605.0), None));
        clock.heard(99_990.0, 20.0, 100_020.0, false);
        assert_eq!(clock.running(25.0), Some(99_995.0));
        // A controller's clock half a minute late is of now.
        let mut late = SourceClock::default();
        late.heard(99_970.0, 0.0, 100_000.0, false);
        assert_eq!(late.running(1.0), Some(99_971.0));
    }

    #[test]
    fn what_comes_behind_a_mark_has_not_come_already() {
        let mut series = Series::default();
        series.live(10.0);
        // A mark far ahead, and the first values after the connection is back.
        assert!(series.mark(500.0) && !series.mark(500.0) && !series.mark(20.0));
        assert_eq!(series.live(500.5), Order::New);
        for t in 501..520 {
            assert_eq!(series.live(f64::from(t)), Order::New, "{t}");
        }
        // Nor what came from history before the mark.
        let mut series = Series::default();
        series.live(10.0);
        assert_eq!(series.filled(30.0), Order::New);
        assert!(series.mark(40.0));
        assert_eq!(series.live(20.0), Order::Old);
    }

    #[test]
    fn a_sample_is_repeated_once_and_is_no_news_after_that() {
        let mut series = Series::default();
        assert!(!series.repeat(5.0), "there is none");
        series.live(10.0);
        assert!(!series.repeat(10.0) && series.repeat(70.0) && !series.repeat(80.0));
        assert_eq!((series.last(), series.end()), (Some(10.0), Some(70.0)));
        // The server shows it with its own stamp again and again.
        assert_eq!(series.live(10.0), Order::Again);
        // What is older than the repetition would set the time back.
        for t in 60..70 {
            assert_eq!(series.live(f64::from(t)), Order::Old);
        }
        assert_eq!(series.filled(65.0), Order::Old);
        assert_eq!(series.live(71.0), Order::New);
        assert!(series.repeat(200.0));
    }

    proptest! {
        #[test]
        fn what_is_handed_on_goes_forward_but_for_a_set_back(
            times in prop::collection::vec((0u8..40, any::<bool>()), 0..200),
        ) {
            let (mut series, mut newest) = (Series::default(), None::<f64>);
            for (t, live) in times {
                let t = f64::from(t);
                let order = if live { series.live(t) } else { series.filled(t) };
                if order == Order::New {
                    prop_assert!(newest.is_none_or(|last| t > last));
                }
                if order == Order::SetBack {
                    prop_assert!(live && newest.is_some_and(|last| t < last));
                }
                if order.is_news() {
                    newest = Some(t);
                }
                prop_assert_eq!(series.last(), newest);
            }
        }
    }
}
