//! What a run can be evidence of: nothing while its source is silent, and its samples once. A record that does not go on would
//! otherwise be diagnosed again and again, told as of now, and counted for and against the alarm each time.

use crate::diagnosis::{Diagnosis, NotIdentifiable, Verdict};
use crate::results::{Outcome, Silent, Summary};
use crate::signal::{LoopId, Record, Sample};
use std::sync::{Arc, Mutex, PoisonError};

/// Says which of OP and PV is silent now, of a loop with this record and this period (s).
pub type Silence = Arc<dyn Fn(&LoopId, &Record, f64) -> Option<Silent> + Send + Sync>;

/// Part of a period by which a record has to go on before another run on it counts. A run that is due may come late, and the one
/// after it in time; runs that are asked for in between say nothing new.
const ANEW: f64 = 0.5;

/// What comes of a run whose source is silent.
pub(super) fn of_silence(Silent { tag, since }: Silent) -> Outcome {
    let why = NotIdentifiable::Silent { tag, since };
    let said = why.to_string();
    Outcome::Diagnosed(Box::new(Diagnosis::bare(Verdict::NotIdentifiable(why), said).into()))
}

/// Stamp of the newest good sample of OP and PV (s).
pub(super) fn newest(record: &Record) -> Option<f64> {
    let good = |samples: &[Sample]| samples.iter().rev().find(|s| s.quality.is_good()).map(|s| s.t);
    [good(&record.op), good(&record.pv)].into_iter().flatten().reduce(f64::max)
}

/// How long ago a run last said whether the valve sticks, at `now` (s).
pub(super) fn last_said(summaries: &[Summary], now: f64) -> Option<f64> {
    summaries.iter().rev().find(|own| says(&own.outcome)).map(|own| (now - own.time).abs())
}

/// Whether this outcome says that the valve sticks, or does not.
pub(super) fn says(outcome: &str) -> bool {
    [Verdict::Stiction, Verdict::NoStiction].iter().any(|verdict| verdict.as_str() == outcome)
}

/// Which samples a run is on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reach {
    /// Stamp of the newest good one (s).
    pub(super) newest: f64,
    /// Time of the last that was fitted (s); `None` where that is not known. A long record may have its most regular stretch far
    /// behind its newest sample, and the same in each run.
    pub(super) fitted: Option<f64>,
}

impl Reach {
    /// Whether it says nothing new after that of the run that counted last, of a loop with this period (s).
    fn is_again(self, last: Self, period_s: f64) -> bool {
        let stands = self.fitted.zip(last.fitted).is_some_and(|(own, last)| own <= last);
        // A source's clock that was set back has brought something new, too.
        (self.newest - last.newest).abs() < ANEW * period_s || self.newest > last.newest && stands
    }
}

/// The last run of before the start that said whether the valve sticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Before {
    /// How long ago it ended (s), which stands for how much older its newest sample was.
    pub(super) ago_s: f64,
    /// Time of the last sample that it fitted (s); `None` where that is not known.
    pub(super) fitted: Option<f64>,
}

impl Before {
    /// On which samples it was, as one on these goes after it.
    fn reach(self, next: Reach) -> Reach {
        // What is of later than the newest sample was stamped by a clock that was set back since.
        let fitted = self.fitted.filter(|fitted| *fitted <= next.newest);
        Reach { newest: next.newest - self.ago_s, fitted }
    }
}

/// Up to where a loop's samples have been counted.
#[derive(Debug, Default)]
pub(super) struct Counted(Mutex<Option<Reach>>);

impl Counted {
    /// Whether a run on such samples counts, of a loop with this period (s). Then its samples have been counted. `before`: the last
    /// run of before the start, since a restart makes nothing new.
    pub(super) fn takes(
        &self,
        reach: Option<Reach>,
        period_s: f64,
        before: impl FnOnce() -> Option<Before>,
    ) -> bool {
        // What has no samples is not told apart by them.
        let Some(reach) = reach else { return true };
        let mut counted = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let last = counted.or_else(|| before().map(|before| before.reach(reach)));
        let is_again = last.is_some_and(|last| reach.is_again(last, period_s));
        *counted = if is_again { last } else { Some(reach) };
        !is_again
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{BadReason, Quality};

    /// Samples up to that one (s), of which nobody knows which were fitted.
    fn up_to(newest: f64) -> Option<Reach> {
        Some(Reach { newest, fitted: None })
    }

    #[test]
    fn samples_count_once_however_often_they_are_diagnosed() {
        let counted = Counted::default();
        let never = || None;
        assert!(counted.takes(up_to(1000.0), 600.0, never), "the first");
        for newest in [1000.0, 1000.0, 1020.0, 1299.0] {
            assert!(!counted.takes(up_to(newest), 600.0, never), "{newest}");
        }
        assert!(counted.takes(up_to(1300.0), 600.0, never) && !counted.takes(up_to(1310.0), 600.0, never));
        assert!(counted.takes(up_to(200.0), 600.0, never), "a clock was set back");
        // Without samples nothing is known of them.
        assert!(counted.takes(None, 600.0, never) && counted.takes(None, 600.0, never));
    }

    #[test]
    fn a_stretch_that_was_fitted_before_counts_once_whatever_came_since() {
        let counted = Counted::default();
        let takes = |newest: f64, fitted: f64| {
            counted.takes(Some(Reach { newest, fitted: Some(fitted) }), 600.0, || None)
        };
        assert!(takes(1000.0, 400.0) && !takes(1600.0, 400.0) && !takes(9000.0, 399.0));
        assert!(takes(9600.0, 401.0), "it has gone on");
        assert!(takes(200.0, 100.0), "a clock was set back");
    }

    #[test]
    fn a_restart_makes_no_new_evidence_of_old_samples() {
        let ago = |ago_s: f64| move || Some(Before { ago_s, fitted: None });
        let counted = Counted::default();
        assert!(!counted.takes(up_to(1000.0), 600.0, ago(60.0)));
        // What was counted before the start stays so, however often it is asked for since.
        assert!(!counted.takes(up_to(1100.0), 600.0, ago(1.0)));
        assert!(counted.takes(up_to(1240.0), 600.0, ago(1.0)), "300 s after the one of before the start");
        assert!(Counted::default().takes(up_to(1000.0), 600.0, ago(600.0)));
    }

    #[test]
    fn a_restart_makes_no_new_evidence_of_a_stretch_that_was_fitted_before_it() {
        let counted = Counted::default();
        let takes = |newest: f64, fitted: f64| {
            let before = || Some(Before { ago_s: 600.0, fitted: Some(400.0) });
            counted.takes(Some(Reach { newest, fitted: Some(fitted) }), 600.0, before)
        };
        assert!(!takes(1600.0, 400.0) && !takes(2200.0, 399.0));
        assert!(takes(2800.0, 401.0), "it has gone on");
        // A clock that was set back while nothing ran.
        let before = || Some(Before { ago_s: 600.0, fitted: Some(9000.0) });
        let reach = Reach { newest: 1600.0, fitted: Some(1600.0) };
        assert!(Counted::default().takes(Some(reach), 600.0, before));
    }

    #[test]
    fn the_newest_sample_is_a_good_one_of_op_or_pv() {
        let bad = Sample { t: 9.0, value: f64::NAN, quality: Quality::Bad(BadReason::LinkDown) };
        let good = |t: f64| Sample::good(t, 1.0);
        let record = Record {
            op: vec![good(1.0), good(4.0), bad],
            pv: vec![good(2.0), bad],
            sp: Some(vec![good(8.0)]),
            ..Record::default()
        };
        assert_eq!((newest(&record), newest(&Record::default())), (Some(4.0), None));
    }
}
