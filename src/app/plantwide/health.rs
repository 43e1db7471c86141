//! The indicators of every loop over time: the looks of the latest week, and the mean of each day before that. Days are those of
//! UTC, each known by its date.
//!
//! The day that has not ended is kept as the means of its looks so far and their counts, so that a start goes on with it.

use super::rows::{Days, Part};
use crate::indicators::series::{COUNT, DEAD, Values, keep_latest_index, over};
use crate::serve::Health;
use crate::signal::LoopId;
use std::array::from_fn;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

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
pub(super) const FRESH: f64 = 2.0;

/// In single precision: they are drawn and compared, not computed with. NaN where a value is not known.
type Kept = [f32; COUNT];

#[derive(Default)]
struct OfLoop {
    looks: VecDeque<(f64, Kept)>,
    /// By [`day`].
    days: BTreeMap<i64, Kept>,
    /// What looks before the start had found of their day.
    part: Option<Part>,
    /// When the day so far was kept last (s).
    kept_at: Option<f64>,
}

/// The indicators of all loops.
#[derive(Default)]
pub(super) struct HealthLog {
    loops: HashMap<LoopId, OfLoop>,
}

/// What is to be kept of a look.
#[derive(Default)]
pub(super) struct ToKeep {
    /// All days of the loops of which one has ended.
    pub days: Vec<Days>,
    /// The day so far.
    pub parts: Vec<(LoopId, Part)>,
}

/// For how long what was kept of the day so far says how a loop is (s), with so much between two looks: it is kept seldomer than
/// looks are made, where those are near each other.
pub(super) fn kept_fresh_s(period_s: f64) -> f64 {
    (FRESH * period_s).max(APART_S)
}

/// Number of the day of a time (s), from 1970 on.
fn day(t: f64) -> i64 {
    (t / DAY_S).floor() as i64
}

/// When a day ends (s).
fn end(day: i64) -> f64 {
    (day as f64 + 1.0) * DAY_S
}

fn kept(values: &Values) -> Kept {
    values.map(|value| value.map_or(f32::NAN, |x| x as f32))
}

fn values(kept: &Kept) -> Values {
    kept.map(|x| Some(f64::from(x)).filter(|x| x.is_finite()))
}

impl HealthLog {
    /// Takes what a look found; returns what is to be kept of it.
    pub(super) fn take(&mut self, found: &[(LoopId, Values)], now: f64) -> ToKeep {
        let mut keep = ToKeep::default();
        for (id, own) in found {
            let of = self.loops.entry(id.clone()).or_default();
            of.set_back(now);
            if of.end(day(now)) {
                keep.days.push((id.clone(), of.days(i64::MAX)));
            }
            of.thin();
            of.looks.push_back((now, kept(own)));
            while of.looks.front().is_some_and(|(t, _)| now - t > WEEK_S) {
                of.looks.pop_front();
            }
            // As far apart as looks are kept.
            if of.kept_at.is_none_or(|at| (now - at).abs() >= APART_S)
                && let Some(part) = of.of_day(day(now))
            {
                of.kept_at = Some(now);
                keep.parts.push((id.clone(), part));
            }
        }
        keep
    }

    /// Takes back the days that were kept of a loop, beside those that there are; all of them, where there were any.
    pub(super) fn restore(&mut self, id: &LoopId, days: &[(f64, Values)]) -> Option<Vec<(f64, Values)>> {
        let of = self.loops.entry(id.clone()).or_default();
        let before = of.days.len();
        for (t, own) in days {
            // Half a day before its end, so that no rounding counts.
            of.days.entry(day(t - 0.5 * DAY_S)).or_insert_with(|| kept(own));
        }
        let grown = of.days.len() > before;
        of.bound(i64::MAX);
        (grown && before > 0).then(|| of.days(i64::MAX))
    }

    /// Takes back what looks before the start had found of their day; what is known of it now, where looks were made meanwhile.
    pub(super) fn restore_part(&mut self, id: &LoopId, part: Part) -> Option<Part> {
        let of = self.loops.entry(id.clone()).or_default();
        // What was kept since these looks has them.
        let is_new = of.part.is_none() && of.looks.front().is_none_or(|(first, _)| *first > part.until);
        if !is_new {
            return None;
        }
        let own = day(part.until);
        of.part = Some(part);
        of.looks.back().filter(|(t, _)| day(*t) == own)?;
        of.of_day(own)
    }

    /// The clock was set by so much (s): looks that it stamped between two times (s) are as long ago as before, and of no other day.
    pub(super) fn clock_was_set(&mut self, [from, until]: [f64; 2], by: f64) {
        for of in self.loops.values_mut() {
            let looks = of.looks.iter_mut().map(|(t, _)| t);
            let part = of.part.iter_mut().map(|part| &mut part.until);
            let stamps = looks.chain(part).chain(&mut of.kept_at);
            stamps.filter(|t| (from..=until).contains(&**t)).for_each(|t| *t += by);
        }
    }

    /// The loops of which anything is known.
    pub(super) fn ids(&self) -> Vec<LoopId> {
        self.loops.keys().cloned().collect()
    }

    /// All that is to be kept of all looks at some loops.
    pub(super) fn all(&self, ids: &[LoopId]) -> ToKeep {
        let mut keep = ToKeep::default();
        for (id, of) in ids.iter().filter_map(|id| self.loops.get_key_value(id)) {
            if !of.days.is_empty() {
                keep.days.push((id.clone(), of.days(i64::MAX)));
            }
            let latest = of.looks.back().map(|(t, _)| *t).or(of.part.as_ref().map(|part| part.until));
            keep.parts.extend(latest.and_then(|t| of.of_day(day(t))).map(|part| (id.clone(), part)));
        }
        keep
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
        Some(Health { looks, days: of.days(day(now)), last: None })
    }

    /// The dead time that the latest Harris index of a loop which is for one was for (s): that outlives a start.
    pub(super) fn dead_time(&self, id: &LoopId) -> Option<f64> {
        let of = self.loops.get(id)?;
        let known = |own: &Kept| Some(f64::from(own[DEAD])).filter(|x| x.is_finite());
        let by_looks = of.looks.iter().rev().find_map(|(_, own)| known(own));
        let by_part = || of.part.as_ref().and_then(|part| part.values[DEAD]);
        let by_days = || of.days.values().rev().find_map(known);
        by_looks.or_else(by_part).or_else(by_days)
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

    /// A clock that was set back: what was seen "later" says nothing of now.
    fn set_back(&mut self, now: f64) {
        while self.looks.back().is_some_and(|(t, _)| *t >= now) {
            self.looks.pop_back();
        }
        if self.part.as_ref().is_some_and(|part| part.until >= now) {
            self.part = None;
        }
    }

    /// Ends the days of its looks before `today`; whether there was one.
    fn end(&mut self, today: i64) -> bool {
        let of_looks = self.looks.back().map(|(t, _)| day(*t));
        let of_part = self.part.as_ref().map(|part| day(part.until));
        let of_part = of_part.filter(|own| !self.days.contains_key(own));
        let over: Vec<i64> = of_looks.into_iter().chain(of_part).filter(|own| *own < today).collect();
        for own in &over {
            if let Some(part) = self.of_day(*own) {
                self.days.insert(*own, kept(&part.values));
            }
        }
        self.bound(today);
        !over.is_empty()
    }

    /// Drops what is more than [`DAYS`]: days of a clock that was ahead of `today` first, then the oldest.
    fn bound(&mut self, today: i64) {
        while self.days.len() > DAYS {
            let last = self.days.last_key_value().map(|(day, _)| *day).filter(|day| *day >= today);
            let first = self.days.first_key_value().map(|(day, _)| *day);
            let Some(gone) = last.or(first) else { return };
            self.days.remove(&gone);
        }
    }

    /// What all looks of a day have found of it; none without any.
    fn of_day(&self, own: i64) -> Option<Part> {
        let before = self.part.as_ref().filter(|part| day(part.until) == own);
        let looks: Vec<&(f64, Kept)> = self.looks.iter().filter(|(t, _)| day(*t) == own).collect();
        let until = looks.last().map(|(t, _)| *t).or(before.map(|part| part.until))?;
        let mut all: Vec<Values> = before.map(looks_of).unwrap_or_default();
        all.extend(looks.iter().map(|(_, own)| values(own)));
        // Each mean counts the looks that it is of.
        keep_latest_index(&mut all);
        let count = |k: usize| all.iter().filter(|own| own[k].is_some()).count();
        let counts = from_fn(|k| u32::try_from(count(k)).unwrap_or(u32::MAX));
        Some(Part { until, values: over(all.iter()), counts })
    }

    /// Those that ended before `today`: a clock that was ahead may have left others.
    fn days(&self, today: i64) -> Vec<(f64, Values)> {
        self.days.range(..today).map(|(day, own)| (end(*day), values(own))).collect()
    }
}

/// As many looks as a part of a day is of, which have the same means.
fn looks_of(part: &Part) -> Vec<Values> {
    let most = part.counts.iter().max().map_or(0, |most| (*most).min(LOOKS as u32));
    (0..most).map(|at| from_fn(|k| part.values[k].filter(|_| at < part.counts[k]))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the Harris index stands.
    const HARRIS: usize = 5;

    #[test]
    fn looks_of_a_week_and_means_of_days() {
        let (mut log, id) = (HealthLog::default(), LoopId::new("FIC1"));
        let mut ended = 0;
        for hour in 0..24 * 10 {
            let mut own = [None; COUNT];
            own[0] = Some(f64::from(hour % 24));
            ended += log.take(&[(id.clone(), own)], f64::from(hour) * 3600.0).days.len();
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
        let (mut days, mut kept_at) = (Vec::new(), 0.0);
        for at in 0..=8 * 1440 {
            let hour = f64::from(at % 1440) / 60.0;
            let now = f64::from(at) * minute;
            let keep = log.take(&[(id.clone(), [Some(hour); COUNT])], now);
            days.extend(keep.days);
            kept_at = keep.parts.last().map_or(kept_at, |(_, part)| part.until);
            assert!(now - kept_at <= kept_fresh_s(minute), "a start now has no measure of {kept_at} s");
            assert_eq!(log.latest(&id, now, minute).and_then(|own| own[0]), Some(f64::from(hour as f32)));
        }
        let now = f64::from(8 * 1440) * minute;
        let found = log.of(&id, now, minute).expect("known");
        let first = found.looks.first().map_or(f64::NAN, |(t, _)| *t);
        assert!(first - (now - WEEK_S) < 2.0 * APART_S, "from the beginning of the week on: {first}");
        assert!(found.looks.len() <= LOOKS + 2, "{}", found.looks.len());
        assert_eq!((kept_fresh_s(minute), kept_fresh_s(3600.0)), (APART_S, 7200.0));
        // Of the whole day: the mean of its hours.
        let means: Vec<f64> = found.days.iter().filter_map(|(_, own)| own[0]).collect();
        assert!(days.len() == 8 && means.iter().all(|mean| (mean - 12.0).abs() < 1.0), "{means:?}");
    }

    #[test]
    fn a_day_has_the_index_of_its_latest_dead_time_and_a_start_goes_on_with_it() {
        let (mut log, id) = (HealthLog::default(), LoopId::new("FIC1"));
        assert_eq!(log.dead_time(&id), None);
        // For one sample in six looks, then for a dead time that no binary number is.
        let look = |hour: u32| {
            let mut own = [None; COUNT];
            own[HARRIS] = Some(if hour < 6 { 0.25 } else { 0.75 });
            own[DEAD] = (hour >= 6).then_some(20.1);
            own
        };
        let take = |log: &mut HealthLog, hours: std::ops::Range<u32>| {
            let each = hours.map(|hour| log.take(&[(id.clone(), look(hour))], f64::from(hour) * 3600.0));
            each.flat_map(|keep| keep.parts).last().expect("a day so far").1
        };
        let part = take(&mut log, 0..18);
        let dead = Some(f64::from(20.1_f32));
        assert_eq!((part.values[HARRIS], part.counts[HARRIS], part.values[DEAD]), (Some(0.75), 12, dead));
        let mut after = HealthLog::default();
        after.restore_part(&id, part);
        assert_eq!(after.dead_time(&id), dead);
        let part = take(&mut after, 18..24);
        assert_eq!((part.values[HARRIS], part.counts[HARRIS]), (Some(0.75), 18));
        take(&mut after, 24..25);
        let days = after.of(&id, 90_000.0, 3600.0).expect("known").days;
        assert_eq!((days.len(), days[0].1[HARRIS], days[0].1[DEAD]), (1, Some(0.75), dead));
        let mut later = HealthLog::default();
        later.restore(&id, &days);
        assert_eq!(later.dead_time(&id), dead);
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
    const HOUR: f64 = 3600.0;

    /// A log of one loop, whose first indicator is the hour.
    struct Hours(HealthLog);

    impl Hours {
        fn look(&mut self, hours: std::ops::Range<u32>, what: impl Fn(f64) -> f64) -> ToKeep {
            let mut keep = ToKeep::default();
            for hour in hours.map(f64::from) {
                let mut own = [None; COUNT];
                own[0] = Some(what(hour));
                let found = self.0.take(&[(LoopId::new("FIC1"), own)], hour * HOUR);
                keep.days.extend(found.days);
                keep.parts.extend(found.parts);
            }
            keep
        }

        /// Days and their means, as they are shown at an hour.
        fn days(&self, hour: f64) -> Vec<(f64, Option<f64>)> {
            let own = self.0.of(&LoopId::new("FIC1"), hour * HOUR, HOUR).map(|own| own.days);
            own.unwrap_or_default().into_iter().map(|(t, own)| (t / DAY_S, own[0])).collect()
        }
    }

    #[test]
    fn a_day_goes_on_after_a_restart() {
        let id = LoopId::new("FIC1");
        let mut before = Hours(HealthLog::default());
        let (_, part) = before.look(0..18, |hour| hour).parts.pop().expect("a day so far");
        assert_eq!((part.until, part.values[0], part.counts[0]), (17.0 * HOUR, Some(8.5), 18));
        assert_eq!((part.values[1], part.counts[1]), (None, 0));
        // As it is without the restart: the mean of 24 hours, not of six.
        let mut after = Hours(HealthLog::default());
        assert_eq!(after.0.restore_part(&id, part.clone()), None, "nothing was made meanwhile");
        let keep = after.look(18..25, |hour| hour);
        assert_eq!(after.days(25.0), [(1.0, Some(11.5))]);
        let counts: Vec<u32> = keep.parts.iter().map(|(_, part)| part.counts[0]).collect();
        assert_eq!(counts, [19, 20, 21, 22, 23, 24, 1], "each look is kept with those before the restart");
        // A restart before the first look of the next day: the day is not lost.
        let (_, whole) = before.look(18..24, |hour| hour).parts.pop().expect("a day so far");
        let mut nightly = Hours(HealthLog::default());
        nightly.0.restore_part(&id, whole.clone());
        assert_eq!(nightly.look(25..26, |hour| hour).days.len(), 1, "it is to be kept");
        assert_eq!(nightly.days(26.0), [(1.0, Some(11.5))]);
        // What the log has itself is not counted twice, whatever is found again.
        assert_eq!(before.0.restore_part(&id, whole), None);
        before.look(24..25, |hour| hour);
        assert_eq!(before.days(25.0), [(1.0, Some(11.5))]);
        // A store that works again after three looks: what is known is to be kept anew.
        let mut late = Hours(HealthLog::default());
        late.look(18..21, |hour| hour);
        let joined = late.0.restore_part(&id, part.clone()).expect("to be kept");
        assert_eq!((joined.until, joined.values[0], joined.counts[0]), (20.0 * HOUR, Some(10.0), 21));
        assert_eq!(late.0.restore_part(&id, part), None);
    }

    #[test]
    fn a_clock_that_is_set_back_costs_no_more_than_what_it_takes_back() {
        let mut log = Hours(HealthLog::default());
        log.look(0..60, |hour| hour);
        assert_eq!(log.days(60.0), [(1.0, Some(11.5)), (2.0, Some(35.5))]);
        // From hour 60 back to 40 of the second day: the looks of before stay, and the day is one.
        log.look(40..41, |_| 0.0);
        let looks = log.0.of(&LoopId::new("FIC1"), 40.0 * HOUR, HOUR).expect("known").looks;
        assert_eq!((looks.len(), looks[39].1[0], looks[40].1[0]), (41, Some(39.0), Some(0.0)));
        assert_eq!(log.days(40.0), [(1.0, Some(11.5))], "the second has not ended");
        let keep = log.look(41..80, |_| 0.0);
        // 24 to 39, and eight times 0.
        assert_eq!(log.days(80.0), [(1.0, Some(11.5)), (2.0, Some(21.0)), (3.0, Some(0.0))]);
        let (_, days) = keep.days.last().expect("two days have ended");
        let ends: Vec<f64> = days.iter().map(|own| own.0 / DAY_S).collect();
        assert_eq!(ends, [1.0, 2.0, 3.0], "each day once");
    }

    #[test]
    fn days_of_a_clock_that_was_ahead_are_not_shown_and_go_first() {
        let mut log = Hours(HealthLog::default());
        log.look(10_000..10_100, |hour| hour);
        log.look(0..30, |hour| hour);
        assert_eq!(log.days(30.0), [(1.0, Some(11.5))]);
        log.look(30..24 * 181, |hour| hour);
        let days = log.days(24.0 * 181.0);
        assert_eq!((days.len(), days[0].0, days[179].0), (DAYS, 1.0, 180.0));
    }

    #[test]
    fn what_is_kept_again_is_of_the_loops_that_are_named() {
        let (mut log, ids) = (HealthLog::default(), ["A", "B"].map(LoopId::new));
        let found = ids.clone().map(|id| (id, [Some(1.0); COUNT]));
        for day in [0.0, 1.0] {
            log.take(&found, day * DAY_S);
        }
        assert_eq!(log.ids().into_iter().collect::<BTreeSet<LoopId>>(), BTreeSet::from(ids.clone()));
        let keep = log.all(&ids[1..]);
        let days: Vec<&LoopId> = keep.days.iter().map(|own| &own.0).collect();
        let parts: Vec<&LoopId> = keep.parts.iter().map(|own| &own.0).collect();
        assert_eq!((days, parts), (vec![&ids[1]], vec![&ids[1]]));
    }

    #[test]
    fn looks_of_a_clock_that_was_behind_are_of_the_day_on_which_they_were_made() {
        let (mut log, id) = (HealthLog::default(), LoopId::new("FIC1"));
        let look = |log: &mut HealthLog, t: f64| log.take(&[(id.clone(), [Some(1.0); COUNT])], t).days;
        let (today, by) = (1000.0 * DAY_S, 1000.0 * DAY_S);
        log.restore(&id, &[(today, [Some(2.0); COUNT])]);
        // It began in 1970, and was set right after two hours.
        assert!((0..3).all(|hour| look(&mut log, f64::from(hour) * 3600.0).is_empty()));
        log.clock_was_set([0.0, 7200.0], by);
        assert!(look(&mut log, today + 10_800.0).is_empty(), "it is the same day");
        let ended: Vec<f64> = look(&mut log, today + DAY_S).remove(0).1.iter().map(|own| own.0).collect();
        assert_eq!(ended, [today, today + DAY_S]);
    }
}
