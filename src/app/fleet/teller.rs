//! Telling people what happened to alarms. All centres read under one name, and only the one that leads asks. A message is
//! acknowledged once its receivers have it on disk. What a killed centre had not told comes to the one that leads next. What
//! came while none led comes to it too.

use super::centre::{alarm, begin, is_forgotten};
use super::order::{Making, Order};
use super::{Fleet, lock};
use crate::alarm::{AlarmId, State};
use crate::fleet::link::{Incoming, Link, LinkError};
use crate::fleet::streams::EVENTS;
use crate::fleet::subject::{Subject, What, all, of_site};
use crate::notify::Telling;
use crate::results::AlarmChange;
pub(super) use crate::results::NEWS_S;
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

/// The last messages that were told, by number: one whose acknowledgement was lost comes again.
#[derive(Default)]
struct Told {
    /// Of which making of the stream the numbers are.
    making: Making,
    last: VecDeque<u64>,
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
    fn is_new(&mut self, sequence: u64) -> bool {
        if self.last.contains(&sequence) {
            return false;
        }
        if self.last.len() == REMEMBERED {
            self.last.pop_front();
        }
        self.last.push_back(sequence);
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
            self.last.retain(|own| *own != sequence);
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
            reading = begin(link, EVENTS, (TELLER, filter.as_str())) => reading,
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
            let Some(change) = self.news(&message, told.making.made()) else {
                self.later(&message, order).await;
                continue;
            };
            order.taken(message.subject(), message.sequence());
            let change = change.filter(|_| told.is_new(message.sequence()));
            let telling = change.map(|change| self.outlet.tell(change));
            if stop.is_cancelled() {
                // Receivers may have ended before they heard of it: it is told after the next start.
                break;
            }
            told.hand(message, telling);
        }
    }

    /// What a message of the stream that was made then has to tell, if anything; `None` where its loop is not known.
    fn news(&self, message: &Incoming, made: i128) -> Option<Option<AlarmChange>> {
        let own = Subject::read(message.subject())?;
        let id = LoopId::new(of_site(&own.site, &own.name));
        let Some((kept, change)) = alarm(&id, message) else { return Some(None) };
        self.to_tell(&kept.id, change, (made, message.sequence()))
    }

    /// What of a change of an alarm is to be told, as `news` says it.
    fn to_tell(
        &self,
        id: &AlarmId,
        change: Option<AlarmChange>,
        at: (i128, u64),
    ) -> Option<Option<AlarmChange>> {
        // Of a loop that its edge has no more nothing is known any longer, and its alarm is over.
        let is_known = change.as_ref().is_some_and(is_forgotten) || self.is_known(id);
        is_known.then_some(())?;
        // A kind that is switched off here is not shown, and nobody is told of it.
        let is_enabled = self.scene.borrow().config.alarm.is_enabled(id.kind);
        let is_told = |change: &AlarmChange| change.told || self.firsts.is_repeated(change, at);
        let is_past = |change: &AlarmChange| change.transition.at < self.clock.now() - NEWS_S;
        let change = change.filter(|change| is_enabled && !is_told(change) && !is_past(change));
        // Its edge knows of no flood but its own.
        Some(change.map(|change| {
            let grouped = self.results.is_grouped(id, &change.transition);
            AlarmChange { grouped, ..change }
        }))
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
    use crate::alarm::Transition;
    use crate::results::RestoredAlarm;

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
        assert!(told.is_new(5));
        told.are_of(7).await;
        assert!(!told.is_new(5));
        told.are_of(8).await;
        assert!(told.is_new(5));
    }

    #[test]
    fn a_kind_that_is_switched_off_is_passed_and_an_unknown_loop_waits() {
        let (fleet, results) = crate::app::fleet::tests::centre("north:L0");
        let at = |id: &str| {
            let own = change(fleet.clock.now());
            let id = AlarmId::named(id);
            fleet.to_tell(&id, Some(AlarmChange { id: id.clone(), ..own }), (7, 1))
        };
        let told = |id: &str| at(id).map(|change| change.is_some());
        assert_eq!(told("north:L0/stiction"), Some(true));
        assert_eq!(told("north:L0/f_rising"), Some(false), "it is switched off");
        assert_eq!(told("north:L1/stiction"), None, "it may be on its way");
        assert_eq!(told("north:dcs/collector_down"), Some(false), "it is switched off");
        assert_eq!(told("north:other/collector_down"), None);
        assert!(results.alarm(&AlarmId::named("north:L0/f_rising"), 0.0).is_none());
    }

    #[test]
    fn what_belongs_to_a_flood_of_all_edges_is_told_as_such() {
        let (fleet, results) = crate::app::fleet::tests::centre("north:L0");
        let (own, now) = (AlarmId::named("north:L0/stiction"), fleet.clock.now());
        let most = crate::alarm::Config::default().flood_raises;
        let is_grouped = |back: usize| {
            let change = AlarmChange { id: own.clone(), ..change(now - back as f64) };
            let (id, saved) = (own.clone(), crate::alarm::Saved::default());
            let kept = RestoredAlarm { id, saved, by: None, comment: None, detail: String::new() };
            results.follow_alarm(kept, Some(change.clone()), now);
            fleet.to_tell(&own, Some(change), (7, 1)).flatten().expect("it is news").grouped
        };
        let grouped: Vec<bool> = (0..most + 2).map(is_grouped).collect();
        assert!(grouped[..most].iter().all(|own| !own) && grouped[most] && grouped[most + 1], "{grouped:?}");
    }

    #[test]
    fn a_message_that_comes_again_is_told_once_unless_a_receiver_lost_it() {
        let mut told = Told::default();
        assert!(told.is_new(1) && told.is_new(2) && !told.is_new(1) && !told.is_new(2));
        told.end(1, false);
        assert!(told.is_new(1));
    }

    #[test]
    fn what_is_remembered_is_bounded() {
        let (mut told, firsts) = (Told::default(), Firsts::default());
        let most = 2 * REMEMBERED as u64;
        assert!((0..most).all(|at| told.is_new(at)));
        (0..most).for_each(|at| firsts.note(&change(at as f64), (7, at)));
        assert_eq!((told.last.len(), firsts.0.lock().unwrap().1.len()), (REMEMBERED, REMEMBERED));
    }
}
