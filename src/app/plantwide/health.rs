//! The indicators of every loop over time: each look of the latest week, and the mean of each day before that.

use crate::indicators::series::{COUNT, Values, over};
use crate::serve::Health;
use crate::signal::LoopId;
use std::collections::{BTreeSet, HashMap, VecDeque};

/// Time over which every look is kept (s), and the most of them.
const WEEK_S: f64 = 604_800.0;
const LOOKS: usize = 400;
/// Days that are kept.
pub(super) const DAYS: usize = 180;
/// Length of a day (s).
const DAY_S: f64 = 86_400.0;

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
            of.looks.push_back((now, kept(own)));
            while of.looks.len() > LOOKS || of.looks.front().is_some_and(|(t, _)| now - t > WEEK_S) {
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

    pub(super) fn latest(&self, id: &LoopId) -> Option<Values> {
        self.loops.get(id)?.looks.back().map(|(_, own)| values(own))
    }

    pub(super) fn of(&self, id: &LoopId) -> Option<Health> {
        let of = self.loops.get(id)?;
        let looks = of.looks.iter().map(|(t, own)| (*t, values(own))).collect();
        Some(Health { looks, days: of.days() })
    }
}

impl OfLoop {
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
        let found = log.of(&id).expect("known");
        assert_eq!((ended, found.days.len(), found.looks.len()), (9, 9, 169));
        assert_eq!((found.days[0].0, found.days[0].1[0], found.days[0].1[1]), (DAY_S, Some(11.5), None));
        assert_eq!(log.latest(&id).and_then(|own| own[0]), Some(23.0));
        let mut again = HealthLog::default();
        assert_eq!(again.restore(&id, &found.days), None, "as it is kept");
        assert_eq!(again.of(&id).map(|own| own.days), Some(found.days.clone()));
        // A day that ended before the others were found again.
        let mut late = HealthLog::default();
        late.restore(&id, &found.days[7..]);
        assert_eq!(late.restore(&id, &found.days), Some(found.days.clone()), "to be kept");
        assert_eq!(late.restore(&id, &found.days), None);
        assert_eq!(late.of(&id).map(|own| own.days), Some(found.days));
        again.keep_only(&BTreeSet::new());
        assert_eq!(again.of(&id), None);
    }
}
