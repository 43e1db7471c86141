//! What waits to be told to one receiver, and when it may be: grouped, at a bounded rate, bounded in size. Pure.

use super::filter::What;
use super::notice::Notice;
use super::wrong::Wrong;
use crate::alarm::{Kind, Priority};
use serde::Deserialize;
use std::collections::{BTreeMap, VecDeque};

/// Time over which messages are counted (s).
const HOUR: f64 = 3600.0;

/// `pace`: how many messages a receiver gets.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pace {
    /// After the first alarm others are waited for, to go into the same message (s).
    pub wait_s: f64,
    /// Least time between two messages (s); an alarm of high priority does not wait for it.
    pub interval_s: f64,
    /// Most messages in an hour; what is over it is in the next one.
    pub most_per_hour: usize,
    /// Most alarms told one by one in a message; the rest is counted.
    pub listed: usize,
}

impl Default for Pace {
    fn default() -> Self {
        Self { wait_s: 15.0, interval_s: 300.0, most_per_hour: 20, listed: 100 }
    }
}

impl Pace {
    pub(super) fn validate(&self) -> Vec<Wrong> {
        let mut wrong = Vec::new();
        for (field, value) in [("wait_s", self.wait_s), ("interval_s", self.interval_s)] {
            if !(0.0..=86_400.0).contains(&value) {
                wrong.push(("pace", field, format!("{value} must be 0 to 86400")));
            }
        }
        for (field, value, most) in
            [("most_per_hour", self.most_per_hour, 3600), ("listed", self.listed, 1000)]
        {
            if !(1..=most).contains(&value) {
                wrong.push(("pace", field, format!("{value} must be 1 to {most}")));
            }
        }
        wrong
    }
}

/// Notices that wait.
#[derive(Debug)]
pub(super) struct Batch {
    pace: Pace,
    waiting: VecDeque<Notice>,
    /// What is counted only.
    folded: BTreeMap<(What, Kind), u64>,
    /// Changes that nobody knows any more.
    lost: u64,
    /// When the first of them came (s on a steady clock, as everywhere here).
    first: Option<f64>,
    /// Whether one of them is not to wait for the interval.
    urgent: bool,
    /// When the last messages were made.
    made: VecDeque<f64>,
    /// How often something came.
    came: u64,
}

/// What goes into one message.
#[derive(Clone, Debug, PartialEq)]
pub struct Digest {
    /// One by one, oldest first.
    pub notices: Vec<Notice>,
    /// What is over that, counted.
    pub more: Vec<(What, Kind, u64)>,
    /// Changes that were too many to follow.
    pub lost: u64,
}

impl Digest {
    /// Changes told, one by one or counted.
    pub fn changes(&self) -> u64 {
        self.notices.len() as u64 + self.lost + self.more.iter().map(|(.., count)| count).sum::<u64>()
    }

    /// The notices one by one, each with those of the loops that are expected to calm down with its loop. Such a notice stands below one
    /// that says that an alarm of its source was raised, that of stiction before others, and nowhere else; without one it stands by
    /// itself.
    pub fn grouped(&self) -> Vec<(&Notice, Vec<&Notice>)> {
        // A source that is itself expected to calm down with another has nothing below it: two might stand below each other.
        let above = |notice: &Notice| {
            let source = &notice.swings_with.as_ref()?.source;
            let is_above = |own: &Notice| {
                own.what == What::Raised && own.swings_with.is_none() && own.alarm.of_loop() == Some(source)
            };
            let own = self.notices.iter().enumerate().filter(|(_, own)| is_above(own));
            own.min_by_key(|(_, own)| own.alarm.kind != Kind::Stiction).map(|(at, _)| at)
        };
        let placed: Vec<(&Notice, Option<usize>)> =
            self.notices.iter().map(|own| (own, above(own))).collect();
        let below = |at: usize| -> Vec<&Notice> {
            let own = placed.iter().filter(|(_, above)| *above == Some(at));
            own.map(|(notice, _)| *notice).collect()
        };
        let alone = placed.iter().enumerate().filter(|(_, (_, above))| above.is_none());
        alone.map(|(at, (notice, _))| (*notice, below(at))).collect()
    }
}

impl Batch {
    pub(super) fn new(pace: Pace) -> Self {
        Self {
            pace,
            waiting: VecDeque::new(),
            folded: BTreeMap::new(),
            lost: 0,
            first: None,
            urgent: false,
            made: VecDeque::new(),
            came: 0,
        }
    }

    /// How often something came: another number, other contents.
    pub(super) fn came(&self) -> u64 {
        self.came
    }

    /// Takes a notice; false when it will only be counted, for want of room or because it was raised in a flood.
    pub(super) fn put(&mut self, notice: Notice, now: f64) -> bool {
        self.first.get_or_insert(now);
        self.came += 1;
        self.urgent |= notice.priority == Priority::High && notice.what == What::Raised;
        if notice.grouped {
            self.fold(&notice);
            return false;
        }
        let full = self.waiting.len() >= self.pace.listed;
        // What is of least priority goes first, and of that the oldest.
        let priorities = || self.waiting.iter().enumerate().map(|(at, own)| (own.priority, at));
        let least = priorities().min().filter(|_| full);
        match least {
            Some((priority, _)) if priority > notice.priority => self.fold(&notice),
            Some((_, at)) => {
                if let Some(gone) = self.waiting.remove(at) {
                    self.fold(&gone);
                }
                self.waiting.push_back(notice);
            }
            None => self.waiting.push_back(notice),
        }
        !full
    }

    fn fold(&mut self, notice: &Notice) {
        *self.folded.entry((notice.what, notice.alarm.kind)).or_default() += 1;
    }

    /// Changes that came faster than they could be followed.
    pub(super) fn lose(&mut self, count: u64, now: f64) {
        self.first.get_or_insert(now);
        self.came += 1;
        self.lost += count;
    }

    /// Notices that wait, counted ones too.
    pub(super) fn len(&self) -> u64 {
        self.waiting.len() as u64 + self.folded.values().sum::<u64>()
    }

    /// When the next message may be made; `None` while there is nothing to tell.
    pub(super) fn due(&self) -> Option<f64> {
        let mut due = self.first? + self.pace.wait_s;
        if let Some(last) = self.made.back().filter(|_| !self.urgent) {
            due = due.max(last + self.pace.interval_s);
        }
        if self.made.len() >= self.pace.most_per_hour
            && let Some(oldest) = self.made.front()
        {
            due = due.max(oldest + HOUR);
        }
        Some(due)
    }

    /// All that waits, as it would be told now; `None` where nothing does.
    pub(super) fn digest(&self) -> Option<Digest> {
        self.first?;
        Some(Digest {
            notices: self.waiting.iter().cloned().collect(),
            more: self.folded.iter().map(|((what, kind), n)| (*what, *kind, *n)).collect(),
            lost: self.lost,
        })
    }

    /// All that waits, whether it is due or not; nothing does any more.
    pub(super) fn take(&mut self, now: f64) -> Option<Digest> {
        let digest = self.digest()?;
        (self.first, self.urgent, self.lost) = (None, false, 0);
        self.waiting.clear();
        self.folded.clear();
        while self.made.len() >= self.pace.most_per_hour {
            self.made.pop_front();
        }
        self.made.push_back(now);
        Some(digest)
    }
}

#[cfg(test)]
mod tests {
    use super::super::notice::tests::notice;
    use super::*;
    use crate::results::SourceOrder;
    use crate::signal::LoopId;
    use proptest::prelude::*;

    fn pace(wait_s: f64, interval_s: f64, most_per_hour: usize, listed: usize) -> Pace {
        Pace { wait_s, interval_s, most_per_hour, listed }
    }

    #[test]
    fn several_alarms_are_one_message_and_the_next_waits_its_time() {
        let mut batch = Batch::new(pace(10.0, 300.0, 20, 100));
        assert_eq!((batch.due(), batch.take(0.0)), (None, None));
        batch.put(notice("A", Priority::Low), 100.0);
        batch.put(notice("B", Priority::Low), 105.0);
        assert_eq!(batch.due(), Some(110.0));
        assert_eq!(batch.take(110.0).map(|digest| digest.notices.len()), Some(2));
        batch.put(notice("C", Priority::Medium), 120.0);
        assert_eq!(batch.due(), Some(410.0), "the interval");
        batch.put(notice("D", Priority::High), 130.0);
        assert_eq!(
            batch.due(),
            Some(130.0),
            "high priority waits for others only, of which the first came at 120"
        );
    }

    #[test]
    fn the_rate_is_bounded_even_for_high_priority_and_the_rest_is_in_one_message() {
        let mut batch = Batch::new(pace(0.0, 0.0, 2, 3));
        for t in [0.0, 10.0] {
            batch.put(notice("A", Priority::High), t);
            assert_eq!(batch.due(), Some(t));
            assert!(batch.take(t).is_some());
        }
        for k in 0..6 {
            batch.put(notice("B", if k == 0 { Priority::High } else { Priority::Low }), 20.0 + f64::from(k));
        }
        assert_eq!((batch.due(), batch.len()), (Some(3600.0), 6));
        let digest = batch.take(3600.0).expect("six");
        assert_eq!((digest.notices.len(), digest.changes()), (3, 6));
        assert_eq!(digest.notices[0].priority, Priority::High, "the urgent one is told by name");
        assert_eq!(digest.more, [(What::Raised, Kind::Stiction, 3)]);
    }

    #[test]
    fn who_calms_down_with_a_source_that_is_told_stands_below_it_once() {
        let of = |id: &str, source: Option<&str>| {
            let order = |source: &str| SourceOrder {
                source: LoopId::new(source),
                state: "open",
                since: 0.0,
                by: None,
                note: None,
            };
            Notice { swings_with: source.map(order), ..notice(id, Priority::Low) }
        };
        let grouped = |notices: &[Notice]| -> Vec<(String, Vec<String>)> {
            let digest = Digest { notices: notices.to_vec(), more: Vec::new(), lost: 0 };
            let name = |own: &Notice| own.alarm.to_string();
            let all = digest.grouped().into_iter();
            all.map(|(own, below)| (name(own), below.into_iter().map(name).collect())).collect()
        };
        let told = |own: &str, below: &[&str]| {
            (own.to_string(), below.iter().map(|own| (*own).to_string()).collect::<Vec<_>>())
        };
        let cleared = Notice { what: What::Cleared, ..of("A/f_rising", None) };
        let [first, second] = ["B/not_identifiable", "C/unexplained_residual"].map(|id| of(id, Some("A")));
        // Of the source's notices that of stiction, wherever it is; a loop whose source is not told is by itself.
        let absent = of("D/not_identifiable", Some("E"));
        let all =
            [first.clone(), cleared.clone(), of("A/tag_bad", None), absent, of("A/stiction", None), second];
        assert_eq!(
            grouped(&all),
            [
                told("A/f_rising", &[]),
                told("A/tag_bad", &[]),
                told("D/not_identifiable", &[]),
                told("A/stiction", &["B/not_identifiable", "C/unexplained_residual"]),
            ]
        );
        // Nothing calms down with a source of which only an end is told.
        assert_eq!(grouped(&[first, cleared]), [told("B/not_identifiable", &[]), told("A/f_rising", &[])]);
        // Two that are each other's source are both told.
        let round = [of("A/not_identifiable", Some("B")), of("B/not_identifiable", Some("A"))];
        assert_eq!(grouped(&round), [told("A/not_identifiable", &[]), told("B/not_identifiable", &[])]);
    }

    #[test]
    fn what_is_raised_in_a_flood_is_counted() {
        let mut batch = Batch::new(Pace::default());
        let own = Notice { grouped: true, ..notice("A", Priority::Low) };
        assert!(!batch.put(own, 0.0));
        batch.lose(7, 1.0);
        let digest = batch.take(20.0).expect("something");
        assert_eq!((digest.notices.len(), digest.lost, digest.changes()), (0, 7, 8));
    }

    proptest! {
        /// Every notice is told once, by name or in a count; there are never more messages in an hour than allowed.
        #[test]
        fn nothing_is_told_twice_or_forgotten(
            steps in prop::collection::vec((0.0f64..400.0, 0usize..3, any::<bool>()), 1..200),
        ) {
            let mut batch = Batch::new(pace(5.0, 60.0, 4, 5));
            let (mut now, mut told, mut put, mut made) = (0.0, 0, 0, Vec::<f64>::new());
            for (pause, priority, flood) in steps {
                now += pause;
                while let Some(due) = batch.due().filter(|due| *due <= now) {
                    told += batch.take(due).map_or(0, |digest| digest.changes());
                    made.push(due);
                }
                batch.put(Notice { grouped: flood, ..notice("A", Priority::ALL[priority]) }, now);
                put += 1;
                prop_assert!(batch.waiting.len() <= 5);
            }
            told += batch.take(now).map_or(0, |digest| digest.changes());
            prop_assert_eq!(told, put);
            for five in made.windows(5) {
                // Sums of times are exact to well below a microsecond.
                prop_assert!(five[4] - five[0] >= HOUR - 1e-6, "{:?}", five);
            }
        }
    }
}
