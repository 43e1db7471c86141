//! What an edge tells people by itself: which changes of alarms it told, and of which a centre has heard. Pure. A change is known
//! by what it is and not by its number in the store: that may be away while people have to be told.

use super::teller::{Key, key};
use crate::alarm::{AlarmId, Kind, State};
use crate::results::AlarmChange;
use crate::signal::LoopId;
use crate::store::TransitionRow;
use std::collections::{HashSet, VecDeque};
use std::sync::Arc;

/// Changes that are remembered: more than the log of changes has.
const REMEMBERED: usize = 4096;

/// The last of some changes.
#[derive(Clone, Debug, Default)]
struct Keys {
    all: HashSet<Key>,
    order: VecDeque<Key>,
}

impl Keys {
    fn has(&self, key: &Key) -> bool {
        self.all.contains(key)
    }

    fn put(&mut self, key: Key) {
        if self.all.insert(key.clone()) {
            self.order.push_back(key);
        }
        if self.order.len() > REMEMBERED
            && let Some(oldest) = self.order.pop_front()
        {
            self.all.remove(&oldest);
        }
    }

    fn append(&mut self, others: Self) {
        others.order.into_iter().for_each(|key| self.put(key));
    }
}

/// What an edge knows of the changes since its start.
#[derive(Debug, Default)]
pub(super) struct Alone {
    /// A centre was there after they had been forwarded.
    heard: Arc<Keys>,
    /// People were told here.
    told: Arc<Keys>,
    /// Forwarded before the last look at the lease.
    before: Keys,
    /// Forwarded since.
    since: Keys,
}

impl Alone {
    /// The lease was looked at, and is another message than at the look before, or not. Its holder wrote it between the two, so
    /// what was forwarded before the first of them was there to be heard; what was forwarded between them may have come later.
    pub(super) fn looked(&mut self, is_new: bool) {
        if is_new {
            let before = std::mem::take(&mut self.before);
            Arc::make_mut(&mut self.heard).append(before);
        }
        let since = std::mem::take(&mut self.since);
        self.before.append(since);
    }

    /// What was forwarded is lost with its stream, and is forwarded anew.
    pub(super) fn lost(&mut self) {
        (self.before, self.since) = (Keys::default(), Keys::default());
    }

    /// These were forwarded.
    pub(super) fn forwarded(&mut self, changes: Vec<Key>) {
        changes.into_iter().for_each(|key| self.since.put(key));
    }

    /// People were told of it here.
    pub(super) fn told(&mut self, change: &AlarmChange) {
        Arc::make_mut(&mut self.told).put(key(change));
    }

    /// Of the changes in `log`, newest first, those that nobody has heard of, oldest first. What was given back by the store at
    /// the start is marked as told.
    pub(super) fn untold(&self, log: &[Arc<AlarmChange>]) -> Vec<Arc<AlarmChange>> {
        let is_untold = |change: &AlarmChange| {
            let key = key(change);
            !change.told && !self.heard.has(&key) && !self.told.has(&key)
        };
        log.iter().rev().filter(|change| is_untold(change)).cloned().collect()
    }

    /// What is to be known while changes are forwarded. What happened before `since` (s) is not told here any more. `holds`: this
    /// edge tells people.
    pub(super) fn so_far(&self, log: Log, since: f64, holds: bool) -> Told {
        Told { heard: self.heard.clone(), told: self.told.clone(), log, since, holds }
    }
}

/// What alarms did, the last of it, as [`Alone::untold`] takes it.
pub(super) type Log = Box<dyn Fn() -> Vec<Arc<AlarmChange>> + Send + Sync>;

/// What is known of changes while they are forwarded.
pub(super) struct Told {
    heard: Arc<Keys>,
    told: Arc<Keys>,
    log: Log,
    /// What happened before this is not told here (s).
    since: f64,
    /// This edge tells people: what it still has to tell is forwarded after that, so that it says whether people know.
    holds: bool,
}

impl Told {
    /// What the changes since the start are known by: they may be told here. Stamps do not tell which those are, since the clock may
    /// have been set. It is asked after rows were read, so that it has the changes of all of them.
    pub(super) fn own(&self) -> HashSet<Key> {
        (self.log)().iter().filter(|change| !change.told).map(|change| key(change)).collect()
    }

    /// Whether people were told of the change here.
    pub(super) fn is_told(&self, row: &TransitionRow) -> bool {
        known_by(row).is_some_and(|key| self.told.has(&key))
    }

    /// Whether a change is not to be forwarded yet; `own`: what those since the start are known by.
    pub(super) fn is_held(&self, row: &TransitionRow, own: &HashSet<Key>) -> bool {
        let is_new = |key: Key| own.contains(&key) && !self.told.has(&key) && !self.heard.has(&key);
        self.holds && row.at >= self.since && known_by(row).is_some_and(is_new)
    }
}

/// Of some rows, what the changes since the start are known by: others are not told here, and a store that is sent from the first on
/// would push out those that are.
pub(super) fn known_of(rows: &[(i64, TransitionRow)], own: &HashSet<Key>) -> Vec<Key> {
    rows.iter().filter_map(|(_, row)| known_by(row)).filter(|key| own.contains(key)).collect()
}

/// What the change of a row is known by; `None` for one that this version does not know.
fn known_by(row: &TransitionRow) -> Option<Key> {
    let id = AlarmId::new(LoopId::new(row.control_loop.as_str()), Kind::named(&row.kind)?);
    Some((id, row.at.to_bits(), State::named(&row.after)?))
}

#[cfg(test)]
mod tests {
    use super::super::teller::NEWS_S;
    use super::*;
    use crate::alarm::Transition;

    fn change(at: f64) -> Arc<AlarmChange> {
        let change = crate::notify::change();
        Arc::new(AlarmChange { transition: Transition { at, ..change.transition }, ..change })
    }

    fn row(change: &AlarmChange) -> TransitionRow {
        TransitionRow {
            control_loop: change.id.subject.to_string(),
            kind: change.id.kind.as_str().to_string(),
            at: change.transition.at,
            before: change.transition.from.as_str().to_string(),
            after: change.transition.to.as_str().to_string(),
            cause: change.transition.cause.as_str().to_string(),
            priority: None,
            detail: String::new(),
            by: None,
            comment: None,
        }
    }

    fn log_of(changes: &[Arc<AlarmChange>]) -> Log {
        let changes = changes.to_vec();
        Box::new(move || changes.clone())
    }

    fn times(changes: &[Arc<AlarmChange>]) -> Vec<f64> {
        changes.iter().map(|change| change.transition.at).collect()
    }

    #[test]
    fn a_centre_has_heard_of_what_was_forwarded_before_it_wrote_the_lease_last() {
        let (one, two) = (change(1.0), change(2.0));
        let log = [two.clone(), one.clone()];
        let mut alone = Alone::default();
        alone.looked(false);
        alone.forwarded(vec![key(&one)]);
        // The lease may be from before that: its holder may be dead since.
        alone.looked(true);
        assert_eq!(times(&alone.untold(&log)), [1.0, 2.0]);
        alone.forwarded(vec![key(&two)]);
        alone.looked(true);
        assert_eq!(times(&alone.untold(&log)), [2.0], "it lived after the first");
        // It is silent from now on, however often that is looked at.
        (0..9).for_each(|_| alone.looked(false));
        assert_eq!(times(&alone.untold(&log)), [2.0]);
    }

    #[test]
    fn what_is_told_here_is_marked_and_what_is_still_to_be_told_waits_for_that() {
        let (one, two) = (change(11.0), change(12.0));
        let before = AlarmChange { told: true, ..AlarmChange::clone(&change(3.0)) };
        let log = [two.clone(), one.clone(), Arc::new(before.clone())];
        let mut alone = Alone::default();
        assert_eq!(times(&alone.untold(&log)), [11.0, 12.0], "what was before the start is known");
        alone.told(&one);
        assert_eq!(times(&alone.untold(&log)), [12.0]);
        let told = alone.so_far(log_of(&log), 0.0, true);
        let rows = [row(&before), row(&one), row(&two)];
        let own = told.own();
        assert_eq!(rows.each_ref().map(|row| told.is_held(row, &own)), [false, false, true]);
        assert_eq!(rows.each_ref().map(|row| told.is_told(row)), [false, true, false]);
        // Where nobody can be told, and of what is long ago, nothing waits for it.
        assert!(!alone.so_far(log_of(&log), 0.0, false).is_held(&row(&two), &own));
        assert!(!alone.so_far(log_of(&log), 13.0, true).is_held(&row(&two), &own));
    }

    #[test]
    fn a_clock_that_was_set_does_not_change_what_is_of_before_the_start() {
        // It was ahead before the start and after it, and was set back to 1,000 s then.
        let before = Arc::new(AlarmChange { told: true, ..AlarmChange::clone(&change(10_000.0)) });
        let log = [change(1_010.0), change(10_010.0), before];
        let told = Alone::default().so_far(log_of(&log), 1_030.0 - NEWS_S, true);
        let own = told.own();
        assert_eq!(log.each_ref().map(|change| told.is_held(&row(change), &own)), [true, true, false]);
    }

    #[test]
    fn what_was_forwarded_while_the_clock_was_ahead_is_not_told_again_when_that_is_set_back() {
        for ahead_s in [600.0, 2.0 * NEWS_S] {
            let (log, mut alone) = ([change(1_010.0)], Alone::default());
            let told = alone.so_far(log_of(&log), 1_020.0 + ahead_s - NEWS_S, false);
            let own = told.own();
            alone.forwarded(known_of(&log.each_ref().map(|change| (1, row(change))), &own));
            [false, true].into_iter().for_each(|is_new| alone.looked(is_new));
            assert!(alone.untold(&log).is_empty(), "a centre has heard of it: {ahead_s}");
        }
    }

    #[test]
    fn what_is_remembered_is_bounded_and_the_latest_stay() {
        let mut alone = Alone::default();
        (0..2 * REMEMBERED).for_each(|at| alone.told(&change(at as f64)));
        assert_eq!((alone.told.all.len(), alone.told.order.len()), (REMEMBERED, REMEMBERED));
        let last = change((2 * REMEMBERED - 1) as f64);
        assert!(alone.untold(&[last]).is_empty());
    }
}
