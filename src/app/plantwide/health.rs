//! The indicators of every loop over time: the looks of the latest week, and the mean of each day before that.

use crate::indicators::series::{COUNT, Values, over};
use crate::serve::Health;
use crate::signal::LoopId;
use std::collections::{BTreeSet, HashMap, VecDeque};

/// Time over which looks are kept (s).
const WEEK_S: f64 = 604_800.0;
/// Looks in it at most, beside the latest: those of a shorter period are kept so far apart, else they were of fewer hours.
const LOOKS: usize = 400;
/// See [`LOOKS`] (s).
const APART_S: f64 = WEEK_S / LOOKS as f64;
/// Days that are kept.
pub(super) const DAYS: usize = 180;
/// Length of a day (s).
const DAY_S: f64 = 86_400.0;
/// Periods of the looks for which the latest one says how a loop is now.
const FRESH: f64 = 2.0;

/// In single precision: they are drawn and compared, not computed with. NaN where a value is not known.
type Kept = [f32; COUNT];

#[derive(Default)]
struct OfLoop {
    looks: VecDeque<(f64, Kept)>,
    days: VecDeque<(f64, Kept)>,
}

/// The indicators of all loops.
#[derive(Default)]
pub(super) struct HealthLog {
    loops: HashMap<LoopId, OfLoop>,
}

fn kept(values: &Values) -> Kept {
    values.map(|value| value.map_or(f32::NAN, |x| x as f32))
}

fn values(kept: &Kept) -> Values {
    kept.map(|x| Some(f64::from(x)).filter(|x| x.is_finite()))
}

impl HealthLog {
    /// Takes what a look found; returns all days of the loops for which one has ended with it.
    pub(super) fn take(&mut self, found: &[(LoopId, Values)], now: f64) -> Vec<(LoopId, Vec<(f64, Values)>)> {
        let mut ended = Vec::new();
        for (id, own) in found {
            let of = self.loops.entry(id.clone()).or_default();
            if of.looks.back().is_some_and(|(last, _)| *last >= now) {
                of.looks.clear();
            }
            let day = |t: f64| (t / DAY_S).floor();
            if let Some((last, _)) = of.looks.back().copied().filter(|(last, _)| day(*last) < day(now)) {
                let looks = of.looks.iter().filter(|(t, _)| day(*t) == day(last));
                let looks: Vec<Values> = looks.map(|(_, own)| values(own)).collect();
                of.days.push_back(((day(last) + 1.0) * DAY_S, kept(&over(looks.iter()))));
                if of.days.len() > DAYS {
                    of.days.pop_front();
                }
                ended.push((id.clone(), of.days()));
            }
            of.thin();
            of.looks.push_back((now, kept(own)));
            while of.looks.front().is_some_and(|(t, _)| now - t > WEEK_S) {
                of.looks.pop_front();
            }
        }
        ended
    }

    /// Takes back the days that were kept of a loop, before those that there are; all of them, where there were any.
    pub(super) fn restore(&mut self, id: &LoopId, days: &[(f64, Values)]) -> Option<Vec<(f64, Values)>> {
        let of = self.loops.entry(id.clone()).or_default();
        let begun = of.days.front().map_or(f64::INFINITY, |(t, _)| *t);
        let older = days.iter().filter(|(t, _)| *t < begun);
        let all: VecDeque<_> = older.map(|(t, own)| (*t, kept(own))).chain(of.days.iter().copied()).collect();
        let grown = all.len() > of.days.len();
        of.days = all;
        of.days.drain(..of.days.len().saturating_sub(DAYS));
        (grown && begun.is_finite()).then(|| of.days())
    }

    pub(super) fn keep_only(&mut self, ids: &BTreeSet<LoopId>) {
        self.loops.retain(|id, _| ids.contains(id));
    }

    /// What the latest look found of a loop at `now` (s); `None` where that is older than two periods of the looks.
    pub(super) fn latest(&self, id: &LoopId, now: f64, period_s: f64) -> Option<Values> {
        let of = self.loops.get(id)?;
        if of.missed(now, period_s).is_some() {
            return None;
        }
        of.looks.back().map(|(_, own)| values(own))
    }

    /// The looks of the week before `now` (s) and the days before. Where the latest look is older than two periods, the one that
    /// was due last stands behind it without values: all who read it see that nothing is known of now.
    pub(super) fn of(&self, id: &LoopId, now: f64, period_s: f64) -> Option<Health> {
        let of = self.loops.get(id)?;
        let week = of.looks.iter().filter(|(t, _)| now - t <= WEEK_S);
        let missed = of.missed(now, period_s).map(|due| (due, [None; COUNT]));
        let looks = week.map(|(t, own)| (*t, values(own))).chain(missed).collect();
        Some(Health { looks, days: of.days() })
    }
}

impl OfLoop {
    /// The latest look is the latest no more, and stays where it is far enough from the one before it.
    fn thin(&mut self) {
        let mut newest = self.looks.iter().rev().map(|(t, _)| *t);
        if let (Some(last), Some(before)) = (newest.next(), newest.next())
            && last - before < APART_S
        {
            self.looks.pop_back();
        }
    }

    /// When a look was due last (s), where the latest one is older than two periods at `now` (s). A time of the looks' own
    /// rhythm: it changes once a period, and not whenever somebody asks.
    fn missed(&self, now: f64, period_s: f64) -> Option<f64> {
        let (last, _) = *self.looks.back()?;
        let periods = (now - last) / period_s;
        (periods > FRESH).then(|| last + periods.floor() * period_s)
    }

    fn days(&self) -> Vec<(f64, Values)> {
        self.days.iter().map(|(t, own)| (*t, values(own))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_of_a_week_and_means_of_days() {
        let (mut log, id) = (HealthLog::default(), LoopId::new("FIC1"));
        let mut ended = 0;
        for hour in 0..24 * 10 {
            let mut own = [None; COUNT];
            own[0] = Some(f64::from(hour % 24));
            ended += log.take(&[(id.clone(), own)], f64::from(hour) * 3600.0).len();
        }
        let now = 239.0 * 3600.0;
        let found = log.of(&id, now, 3600.0).expect("known");
        assert_eq!((ended, found.days.len(), found.looks.len()), (9, 9, 169));
        assert_eq!((found.days[0].0, found.days[0].1[0], found.days[0].1[1]), (DAY_S, Some(11.5), None));
        assert_eq!(log.latest(&id, now, 3600.0).and_then(|own| own[0]), Some(23.0));
        let mut again = HealthLog::default();
        assert_eq!(again.restore(&id, &found.days), None, "as it is kept");
        let days = |log: &HealthLog| log.of(&id, now, 3600.0).map(|own| own.days);
        assert_eq!(days(&again), Some(found.days.clone()));
        // A day that ended before the others were found again.
        let mut late = HealthLog::default();
        late.restore(&id, &found.days[7..]);
        assert_eq!(late.restore(&id, &found.days), Some(found.days.clone()), "to be kept");
        assert_eq!(late.restore(&id, &found.days), None);
        assert_eq!(days(&late), Some(found.days));
        again.keep_only(&BTreeSet::new());
        assert_eq!(again.of(&id, now, 3600.0), None);
    }

    #[test]
    fn looks_of_a_short_period_are_of_a_whole_week_and_a_whole_day_too() {
        let (mut log, id, minute) = (HealthLog::default(), LoopId::new("FIC1"), 60.0);
        let mut days = Vec::new();
        for at in 0..=8 * 1440 {
            let hour = f64::from(at % 1440) / 60.0;
            let now = f64::from(at) * minute;
            days.extend(log.take(&[(id.clone(), [Some(hour); COUNT])], now));
            assert_eq!(log.latest(&id, now, minute).and_then(|own| own[0]), Some(f64::from(hour as f32)));
        }
        let now = f64::from(8 * 1440) * minute;
        let found = log.of(&id, now, minute).expect("known");
        let first = found.looks.first().map_or(f64::NAN, |(t, _)| *t);
        assert!(first - (now - WEEK_S) < 2.0 * APART_S, "from the beginning of the week on: {first}");
        assert!(found.looks.len() <= LOOKS + 2, "{}", found.looks.len());
        // Of the whole day: the mean of its hours.
        let means: Vec<f64> = found.days.iter().filter_map(|(_, own)| own[0]).collect();
        assert!(days.len() == 8 && means.iter().all(|mean| (mean - 12.0).abs() < 1.0), "{means:?}");
    }

    #[test]
    fn a_look_of_long_ago_does_not_say_how_a_loop_is_now() {
        let (mut log, id, hour) = (HealthLog::default(), LoopId::new("FIC1"), 3600.0);
        for at in 0..10 {
            log.take(&[(id.clone(), [Some(50.0); COUNT])], f64::from(at) * hour);
        }
        let latest = |now: f64| log.latest(&id, now, hour).and_then(|own| own[0]);
        assert_eq!((latest(9.0 * hour), latest(11.0 * hour)), (Some(50.0), Some(50.0)));
        assert_eq!((latest(11.1 * hour), latest(500.0 * hour)), (None, None));
        let looks = |now: f64| log.of(&id, now, hour).expect("known").looks;
        assert_eq!(looks(11.0 * hour).len(), 10);
        let late = looks(12.9 * hour);
        assert_eq!((late.len(), late[9].1[0], late[10]), (11, Some(50.0), (12.0 * hour, [None; COUNT])));
        // What is older than a week is no look of the latest week.
        assert_eq!(looks(500.0 * hour), [(500.0 * hour, [None; COUNT])]);
        // A clock that was set back makes nothing old.
        assert_eq!(latest(0.0), Some(50.0));
    }
}
