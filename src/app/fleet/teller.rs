//! Telling people what happened to alarms. All centres read under one name, and only the one that leads asks. A message is
//! acknowledged once its receivers have it on disk. What a killed centre had not told comes to the one that leads next. What
//! came while none led comes to it too.

use super::centre::begin;
use super::events::{Heard, alarm, is_forgotten};
use super::order::{Making, Order};
use super::{Fleet, lock};
use crate::alarm::{AlarmId, State, Transition};
use crate::fleet::link::{Incoming, Link, LinkError, Mark};
use crate::fleet::ops::LOG;
use crate::fleet::streams::ALARMS;
use crate::fleet::subject::{Subject, What, all, of_site};
use crate::notify::Telling;
pub(super) use crate::results::NEWS_S;
use crate::results::{AlarmChange, RestoredAlarm};
use crate::signal::LoopId;
use std::collections::{HashSet, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// The name under which all centres read; that of a centre's own begins otherwise.
pub(super) const TELLER: &str = "centres_tell";
/// Changes that are told in one go.
const MOST: usize = 256;
/// Longest wait for the first of them.
const WAIT: Duration = Duration::from_secs(1);
/// How often it is looked whether we lead: a lease runs out by time alone.
const LOOK: Duration = Duration::from_millis(20);
/// Longest wait until the page shows what people are told of.
const SHOWN: Duration = Duration::from_secs(5);
/// People are told of an alarm of a loop that is not known after this time: the list of its edge may be on its way.
const UNKNOWN: Duration = Duration::from_secs(60);
/// A change that a receiver lost is told again after this time.
const AGAIN: Duration = Duration::from_secs(2);
/// Messages are kept from being given to another centre so often while receivers work on them.
const UNDER_WAY: Duration = Duration::from_secs(3);
/// Messages that receivers hold at once; beyond it no more are read. A server gives 4,096 without an acknowledgement.
const MOST_HELD: usize = 500;
/// Longest wait for receivers by a centre that does not lead any more, or stops; then another tells of what they hold.
const LET_GO: Duration = Duration::from_secs(5);
/// Changes and messages that are remembered.
const REMEMBERED: usize = 4096;

/// What a change is known by: which alarm, when (as bits), and its state since.
pub(super) type Key = (AlarmId, u64, State);

pub(super) fn key(change: &AlarmChange) -> Key {
    (change.id.clone(), change.transition.at.to_bits(), change.transition.to)
}

/// In which message of the stream each of the last changes came first: an edge that does not know whether a message arrived
/// sends its change again. With it, when that stream was made: the numbers of another say nothing.
#[derive(Default)]
pub(super) struct Firsts(Mutex<(i128, Numbered)>);

/// Changes, and the number of a message.
type Numbered = VecDeque<(Key, u64)>;

impl Firsts {
    /// A change came in this message of the stream that was made then.
    pub(super) fn note(&self, change: &AlarmChange, (made, sequence): (i128, u64)) {
        let key = key(change);
        let mut own = lock(&self.0);
        if own.0 != made {
            *own = (made, VecDeque::new());
        }
        let all = &mut own.1;
        if let Some((_, first)) = all.iter_mut().find(|(own, _)| *own == key) {
            *first = sequence.min(*first);
            return;
        }
        if all.len() == REMEMBERED {
            all.pop_front();
        }
        all.push_back((key, sequence));
    }

    /// Whether a change came in an earlier message than this of the same stream.
    fn is_repeated(&self, change: &AlarmChange, (made, sequence): (i128, u64)) -> bool {
        let key = key(change);
        let own = lock(&self.0);
        own.0 == made && own.1.iter().any(|(own, first)| *own == key && *first < sequence)
    }
}

/// The last messages that were told: one whose acknowledgement was lost comes again.
#[derive(Default)]
struct Told {
    /// Of which making of the stream the numbers are.
    making: Making,
    last: VecDeque<Mark>,
    /// Those that are not acknowledged yet.
    held: HashSet<u64>,
    /// Those of them that every receiver has on disk.
    kept: Arc<Mutex<HashSet<u64>>>,
    /// Each ends with its number, and whether every receiver has it on disk.
    ending: JoinSet<(u64, bool)>,
}

impl Told {
    /// The messages are of the stream that was made then; the numbers of another say nothing of them.
    async fn are_of(&mut self, made: i128) {
        if self.making.is_another(made) {
            self.let_go().await;
            self.last.clear();
        }
    }

    /// Whether a message is told for the first time; from now on it was.
    fn is_new(&mut self, mark: Mark) -> bool {
        if self.last.contains(&mark) {
            return false;
        }
        if self.last.len() == REMEMBERED {
            self.last.pop_front();
        }
        self.last.push_back(mark);
        true
    }

    /// Acknowledges a message once its receivers have it on disk.
    fn hand(&mut self, message: Incoming, telling: Option<Telling>) {
        let sequence = message.sequence();
        self.held.insert(sequence);
        let kept = self.kept.clone();
        self.ending.spawn(async move { (sequence, end(message, telling, &kept).await) });
    }

    /// Receivers let go of a message. One that was lost is told again when it comes again.
    fn end(&mut self, sequence: u64, kept: bool) {
        self.held.remove(&sequence);
        lock(&self.kept).remove(&sequence);
        if !kept {
            self.last.retain(|(own, _)| *own != sequence);
        }
    }

    /// Takes note of the messages that ended.
    fn note(&mut self) {
        while let Some(ended) = self.ending.try_join_next() {
            ended.into_iter().for_each(|(sequence, kept)| self.end(sequence, kept));
        }
    }

    /// Waits until receivers hold no more than `most` messages.
    async fn at_most(&mut self, most: usize) {
        while self.ending.len() > most {
            let Some(ended) = self.ending.join_next().await else { break };
            ended.into_iter().for_each(|(sequence, kept)| self.end(sequence, kept));
        }
    }

    /// Waits for the receivers, not for ever, and leaves what they still hold to another centre.
    async fn let_go(&mut self) {
        let _ = tokio::time::timeout(LET_GO, self.at_most(0)).await;
        self.ending.abort_all();
        self.ending = JoinSet::new();
        let kept = std::mem::take(&mut *lock(&self.kept));
        for sequence in std::mem::take(&mut self.held) {
            self.end(sequence, kept.contains(&sequence));
        }
    }
}

impl Fleet {
    /// Tells people while we lead, until `stop` is cancelled; receivers end later.
    pub(super) async fn telling(&self, link: &Link, stop: &CancellationToken) {
        let mut told = Told::default();
        while !stop.is_cancelled() {
            if !self.leads() {
                told.let_go().await;
                stop.run_until_cancelled(tokio::time::sleep(LOOK)).await;
                continue;
            }
            if let Err(error) = self.tell_while_leading(link, stop, &mut told).await {
                stop.run_until_cancelled(self.rest(&error, "people are not told")).await;
            }
        }
        told.let_go().await;
    }

    /// Tells people until we do not lead any more.
    async fn tell_while_leading(
        &self,
        link: &Link,
        stop: &CancellationToken,
        told: &mut Told,
    ) -> Result<(), LinkError> {
        let filter = all(None, What::Alarm);
        // Who has stopped to lead takes nothing that another is to tell.
        let reading = tokio::select! {
            reading = begin(link, ALARMS, (TELLER, filter.as_str())) => reading,
            () = self.is_over(stop) => return Ok(()),
        };
        let ((mut reading, made), mut order) = (reading?, Order::default());
        told.are_of(made).await;
        while self.leads() {
            told.note();
            match stop.run_until_cancelled(tokio::time::timeout(WAIT, told.at_most(MOST_HELD))).await {
                None => break,
                Some(Err(_)) => continue,
                Some(Ok(())) => {}
            }
            let Some(messages) = stop.run_until_cancelled(reading.next(MOST, WAIT)).await else { break };
            self.tell_all(messages?, stop, &mut order, told).await;
        }
        Ok(())
    }

    /// Waits until we do not lead any more, or the daemon stops.
    async fn is_over(&self, stop: &CancellationToken) {
        while self.leads() && !stop.is_cancelled() {
            tokio::time::sleep(LOOK).await;
        }
    }

    async fn tell_all(
        &self,
        messages: Vec<Incoming>,
        stop: &CancellationToken,
        order: &mut Order,
        told: &mut Told,
    ) {
        let Some(last) = messages.last().map(Incoming::sequence) else { return };
        let mut looked_at = self.looked_at.subscribe();
        // People are told all the same where that takes longer.
        let _ = tokio::time::timeout(SHOWN, looked_at.wait_for(|known| *known >= last)).await;
        // Receivers are not replaced meanwhile.
        let _receivers = self.receivers.read().await;
        for message in messages.into_iter().take_while(|_| self.leads()) {
            if told.held.contains(&message.sequence()) {
                // It came again while receivers hold it.
                message.again(UNDER_WAY).await;
                continue;
            }
            if !self.is_next(&message, order) {
                self.put_off(&message, order).await;
                continue;
            }
            let (change, is_known) = self.news(&message, told.making.made());
            if is_known {
                order.taken(message.subject(), message.sequence());
            } else {
                if change.is_some() && self.may_be_known(&message, order, UNKNOWN) {
                    self.put_off(&message, order).await;
                    continue;
                }
                order.end(message.subject(), message.sequence());
                if change.is_some() {
                    tracing::warn!(
                        target: LOG,
                        subject = message.subject(),
                        "people are told of an alarm that this centre does not show: no edge has announced its loop, or the list cannot be taken"
                    );
                }
            }
            let change = change.filter(|_| told.is_new(message.mark()));
            let telling = change.map(|change| self.outlet.tell(change));
            if stop.is_cancelled() {
                // Receivers may have ended before they heard of it: it is told after the next start.
                break;
            }
            told.hand(message, telling);
        }
    }

    /// What a message of the stream that was made then has to tell, if anything, and whether its loop is known.
    fn news(&self, message: &Incoming, made: i128) -> (Option<AlarmChange>, bool) {
        let Some(own) = Subject::read(message.subject()) else { return (None, true) };
        let id = LoopId::new(of_site(&own.site, &own.name));
        let Some(heard) = alarm(&id, message) else { return (None, true) };
        self.to_tell(&own.site, heard, (made, message.sequence()))
    }

    /// What of a change of an alarm is to be told, as `news` says it.
    fn to_tell(&self, site: &str, heard: Heard, at: (i128, u64)) -> (Option<AlarmChange>, bool) {
        let (id, edge) = (heard.kept.id.clone(), heard.edge.as_str());
        // Of a loop that its edge has no more nothing is known any longer, and its alarm is over.
        let is_known = heard.change.as_ref().is_some_and(is_forgotten) || self.is_known(&id);
        // A kind that is switched off here is not shown, and nobody is told of it.
        let is_enabled = self.scene.borrow().config.alarm.is_enabled(id.kind);
        let is_told = |change: &AlarmChange| change.told || self.firsts.is_repeated(change, at);
        let is_past = |change: &AlarmChange| {
            let is_old = self.age_s((site, edge), change.transition.at) > NEWS_S;
            let is_past = is_old && !self.is_standing(&heard.kept, change);
            if is_past {
                tracing::info!(target: LOG, alarm = %id, at = change.transition.at, "people are not told: it is more than a day ago, and over");
            }
            is_past
        };
        let change = heard.change.as_ref();
        let change = change.filter(|change| is_enabled && !is_told(change) && !is_past(change)).cloned();
        // Its edge knows of no flood but its own.
        let change = change.map(|change| {
            let grouped = self.results.is_grouped(&id, &change.transition);
            AlarmChange { grouped, ..change }
        });
        (change, is_known)
    }

    /// How long ago something happened that an edge stamped with `at` (s): by the server's clock, and by how far the edge's is
    /// ahead of that.
    fn age_s(&self, (site, edge): (&str, &str), at: f64) -> f64 {
        let ahead_s = lock(&self.machines).ahead_s(site, edge);
        self.server_now() - (at - ahead_s)
    }

    /// Whether an alarm still waits for somebody since a change, as far as its edge and everything that we know say.
    fn is_standing(&self, kept: &RestoredAlarm, change: &AlarmChange) -> bool {
        let Transition { at, to, .. } = change.transition;
        let known = self.results.alarm(&kept.id, self.clock.now());
        let is_over = known.and_then(|own| own.since).is_some_and(|since| since > at);
        to.wants_acknowledgement() && kept.saved.flags.since == Some(at) && !is_over
    }
}

/// Acknowledges a message once its receivers have it on disk, and notes that before; whether they have.
async fn end(message: Incoming, telling: Option<Telling>, noted: &Mutex<HashSet<u64>>) -> bool {
    if let Some(mut telling) = telling {
        let kept = loop {
            tokio::select! {
                kept = telling.kept() => break kept,
                () = tokio::time::sleep(UNDER_WAY) => message.under_way().await,
            }
        };
        if !kept {
            message.again(AGAIN).await;
            return false;
        }
    }
    lock(noted).insert(message.sequence());
    if let Err(error) = message.done().await {
        tracing::debug!(%error, "what is told comes again");
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::{Flags, Saved};
    use crate::app::fleet::tests::centre;

    fn change(at: f64) -> AlarmChange {
        let change = crate::notify::change();
        AlarmChange { transition: Transition { at, ..change.transition }, ..change }
    }

    #[test]
    fn a_change_that_an_edge_sends_again_is_repeated_and_the_first_is_not() {
        let firsts = Firsts::default();
        (1..4u64).for_each(|at| firsts.note(&change(at as f64), (7, at)));
        // In whatever order they come.
        firsts.note(&change(1.0), (7, 8));
        firsts.note(&change(2.0), (7, 1));
        let repeated = |at: f64, sequence| firsts.is_repeated(&change(at), (7, sequence));
        assert!(repeated(1.0, 8) && !repeated(1.0, 1));
        assert!(repeated(2.0, 2) && !repeated(2.0, 1));
        assert!(!repeated(4.0, 9), "it was not heard of before");
        // A stream that is made anew numbers from 1 again.
        assert!(!firsts.is_repeated(&change(1.0), (9, 8)));
        firsts.note(&change(1.0), (9, 4));
        assert!(firsts.is_repeated(&change(1.0), (9, 5)) && !firsts.is_repeated(&change(1.0), (9, 4)));
        assert!(!firsts.is_repeated(&change(2.0), (9, 8)));
    }

    #[tokio::test]
    async fn a_message_of_a_stream_that_was_made_anew_is_told_though_its_number_was() {
        let mut told = Told::default();
        told.are_of(7).await;
        assert!(told.is_new((5, 1)));
        told.are_of(7).await;
        assert!(!told.is_new((5, 1)));
        told.are_of(8).await;
        assert!(told.is_new((5, 1)));
    }

    /// What an edge says of a change of an alarm, which stands as these flags say.
    fn heard(id: &str, change: &AlarmChange, flags: Flags) -> Heard {
        let (id, saved) = (AlarmId::named(id), Saved { flags, ..Saved::default() });
        let kept = RestoredAlarm { id: id.clone(), saved, by: None, comment: None, detail: String::new() };
        Heard { kept, change: Some(AlarmChange { id, ..change.clone() }), edge: "e1".to_string() }
    }

    #[test]
    fn a_kind_that_is_switched_off_is_passed_and_an_unknown_loop_waits() {
        let (fleet, results) = centre("north:L0");
        let told = |id: &str| {
            let heard = heard(id, &change(fleet.clock.now()), Flags::default());
            let (change, is_known) = fleet.to_tell("north", heard, (7, 1));
            (change.is_some(), is_known)
        };
        assert_eq!(told("north:L0/stiction"), (true, true));
        assert_eq!(told("north:L0/f_rising"), (false, true), "it is switched off");
        assert_eq!(
            told("north:L1/stiction"),
            (true, false),
            "its list may be on its way; people are told in the end"
        );
        assert_eq!(told("north:dcs/collector_down"), (false, true), "it is switched off");
        assert_eq!(told("north:other/collector_down"), (false, false));
        assert!(results.alarm(&AlarmId::named("north:L0/f_rising"), 0.0).is_none());
    }

    #[test]
    fn of_what_is_long_ago_people_are_told_if_it_still_waits_for_them() {
        let (fleet, results) = centre("north:L0");
        let then = fleet.clock.now() - 2.0 * NEWS_S;
        let raised = Flags { active: true, acknowledged: false, since: Some(then), ..Flags::default() };
        let is_told = |id: &str, flags: Flags| {
            fleet.to_tell("north", heard(id, &change(then), flags), (7, 1)).0.is_some()
        };
        let id = "north:L0/stiction";
        assert!(is_told(id, raised), "it has stood since then");
        assert!(is_told("north:L1/stiction", raised), "of a loop that is not known, too");
        let later = Some(then + 60.0);
        assert!(!is_told(id, Flags { since: later, ..raised }), "its edge has told more of it since");
        assert!(!is_told(id, Flags::default()));
        // What came after it may have been heard of already.
        let acknowledged = Flags { acknowledged: true, since: later, ..raised };
        let own = heard(id, &change(then + 60.0), acknowledged);
        results.follow_alarm(own.kept, None, fleet.clock.now());
        assert!(!is_told(id, raised), "somebody has seen it");
    }

    #[test]
    fn an_edge_whose_clock_is_behind_has_people_told_all_the_same() {
        let (fleet, _results) = centre("north:L0");
        // Its clock says 1970, or is ahead by days.
        for behind_s in [fleet.clock.now(), -2.0 * NEWS_S] {
            let now = fleet.clock.now();
            fleet.machine_is_ahead("north", "e1", -behind_s);
            let is_told = |ago_s: f64| {
                let change = change(now - behind_s - ago_s);
                fleet
                    .to_tell("north", heard("north:L0/stiction", &change, Flags::default()), (7, 1))
                    .0
                    .is_some()
            };
            assert!(is_told(60.0) && !is_told(NEWS_S + 60.0), "{behind_s}");
        }
    }

    #[test]
    fn what_belongs_to_a_flood_of_all_edges_is_told_as_such() {
        let (fleet, results) = centre("north:L0");
        let now = fleet.clock.now();
        let most = crate::alarm::Config::default().flood_raises;
        let is_grouped = |back: usize| {
            let own = || heard("north:L0/stiction", &change(now - back as f64), Flags::default());
            results.follow_alarm(own().kept, own().change, now);
            fleet.to_tell("north", own(), (7, 1)).0.expect("it is news").grouped
        };
        let grouped: Vec<bool> = (0..most + 2).map(is_grouped).collect();
        assert!(grouped[..most].iter().all(|own| !own) && grouped[most] && grouped[most + 1], "{grouped:?}");
    }

    #[test]
    fn a_message_that_comes_again_is_told_once_unless_a_receiver_lost_it() {
        let mut told = Told::default();
        assert!(told.is_new((1, 1)) && told.is_new((2, 2)) && !told.is_new((1, 1)) && !told.is_new((2, 2)));
        // A server that has lost the second uses its number again.
        assert!(told.is_new((2, 9)));
        told.end(1, false);
        assert!(told.is_new((1, 1)));
    }

    #[test]
    fn what_is_remembered_is_bounded() {
        let (mut told, firsts) = (Told::default(), Firsts::default());
        let most = 2 * REMEMBERED as u64;
        assert!((0..most).all(|at| told.is_new((at, 1))));
        (0..most).for_each(|at| firsts.note(&change(at as f64), (7, at)));
        assert_eq!((told.last.len(), firsts.0.lock().unwrap().1.len()), (REMEMBERED, REMEMBERED));
    }
}
