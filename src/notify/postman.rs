//! Carries what happened to one receiver: notices into a batch, a batch into a letter, a letter until it is taken or dead.
//!
//! ```text
//!           due                     taken
//! batch ----------> letter waits ----------> gone from disk
//!                     ^      |  ^ |
//!              replay |      |  +-+ not now: again after a pause, twice as long each time, or what the receiver asks for
//!                     |      v
//!                    dead letter: refused for good, not taken for `for_s`, or the receiver is gone (410)
//! ```
//! Letters go one at a time, oldest first; while one is tried everything new stays in the batch, which is bounded. Only one
//! that some of its readers have keeps nothing back. What waits in the batch is on disk as a draft of its letter: after a
//! power failure it is sent at the next start.

mod trials;

use super::batch::{Batch, Digest, Pace};
use super::filter::{self, Filter, What};
use super::letters::{Letter, Letters};
use super::notice::Source;
use super::outlet::{Heard, News, Untold};
use super::state::State;
use super::time;
use super::wrong::Wrong;
use crate::results::{AlarmChange, Event};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use serde::Deserialize;
use std::collections::HashMap;
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::{error, info, warn};
use trials::{Trial, Trials};

/// Least time between two drafts (s): what came within it before a power failure is not told.
const DRAFT_S: f64 = 1.0;
/// Time after which a letter is written again that could not be written (s): a full disk stays full for minutes.
const UNWRITTEN_S: f64 = 10.0;
/// Most letters that wait for some of their readers only.
const MOST_PARTLY: usize = 20;

/// `retry`: how long a message is tried that is not taken.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Retry {
    /// First pause (s); each is twice the one before, the half of it by chance.
    pub first_s: f64,
    /// Longest pause (s).
    pub longest_s: f64,
    /// A message that is not taken for so long is a dead letter (s).
    pub for_s: f64,
    /// Dead letters kept; what is oldest goes first.
    pub dead_letters: usize,
}

impl Default for Retry {
    fn default() -> Self {
        Self { first_s: 1.0, longest_s: 300.0, for_s: 14_400.0, dead_letters: 100 }
    }
}

impl Retry {
    pub(super) fn validate(&self) -> Vec<Wrong> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push(("retry", field, message));
            }
        };
        let (first, longest, whole) = (self.first_s, self.longest_s, self.for_s);
        unless((0.01..=3600.0).contains(&first), "first_s", format!("{first} must be 0.01 to 3600"));
        let ok = (first..=86_400.0).contains(&longest);
        unless(ok, "longest_s", format!("{longest} must be first_s to 86400"));
        unless((0.0..=604_800.0).contains(&whole), "for_s", format!("{whole} must be 0 to 604800"));
        let most = self.dead_letters;
        unless((1..=10_000).contains(&most), "dead_letters", format!("{most} must be 1 to 10000"));
        wrong
    }
}

/// Brings letters to a receiver.
pub trait Carrier: Send + Sync + 'static {
    /// What is sent of a digest, made at `now` (s).
    fn compose(&self, digest: &Digest, source: &Source, now: f64) -> String;

    /// Sends a letter once.
    fn carry(&self, letter: &Letter) -> impl Future<Output = Result<(), Fault>> + Send;
}

/// Why a letter was not taken.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// It may be another time, after a pause that the receiver may have asked for.
    Later(String, Option<Duration>),
    /// It never will.
    Never(String),
    /// Nor will any other: nothing is sent until somebody replays a letter or the configuration is read again.
    Gone(String),
}

/// One receiver's postman.
pub struct Postman<C> {
    name: String,
    carrier: Arc<C>,
    source: Source,
    events: Vec<What>,
    filter: Filter,
    pace: Pace,
    retry: Retry,
    letters: Arc<Letters>,
    state: Arc<State>,
    news: News,
    /// Number of the last change that was heard of.
    heard: u64,
    /// What was picked for it and is in no letter, or in a draft that could not be written.
    held: Vec<Arc<Untold>>,
    /// What was picked for it, by letter that could not be written: held until that is written or delivered.
    unwritten: HashMap<String, Vec<Arc<Untold>>>,
    /// When such letters are written again (s).
    again: f64,
}

/// The letter that the batch will be, as it is on disk.
#[derive(Default)]
struct Draft {
    /// Its name, once it is there.
    id: Option<String>,
    /// What it has, by the batch's count.
    came: u64,
    /// When the next may be written (s).
    next: f64,
}

impl Draft {
    /// When it is to be written again; `None` while it has everything.
    fn due(&self, batch: &Batch) -> Option<f64> {
        batch.due().filter(|_| batch.came() != self.came).map(|_| self.next)
    }
}

impl<C: Carrier> Postman<C> {
    /// Hears of everything from now on.
    pub fn new(name: &str, carrier: C, source: Source, letters: Arc<Letters>, state: Arc<State>) -> Self {
        let news = source.news();
        // After a reload it goes on where the one before ended.
        let heard = letters.heard().unwrap_or_else(|| source.results.latest_change());
        Self {
            name: name.to_string(),
            carrier: Arc::new(carrier),
            source,
            events: filter::usual(),
            filter: Filter::default(),
            pace: Pace::default(),
            retry: Retry::default(),
            letters,
            state,
            news,
            heard,
            held: Vec::new(),
            unwritten: HashMap::new(),
            again: 0.0,
        }
    }

    /// Which alarms, how often, and for how long they are tried.
    pub fn with(self, events: &[What], filter: &Filter, pace: &Pace, retry: &Retry) -> Self {
        let (filter, pace, retry) = (filter.clone(), pace.clone(), retry.clone());
        Self { events: events.to_vec(), filter, pace, retry, ..self }
    }

    /// Carries letters until `stop` is cancelled; what is not delivered then waits for the next start.
    pub async fn run(mut self, stop: CancellationToken) {
        let began = Instant::now();
        let now = || began.elapsed().as_secs_f64();
        let (mut batch, mut draft) = (Batch::new(self.pace.clone()), Draft::default());
        let mut trials = Trials::default();
        let mut random = Pcg32::seed_from_u64(time::wall().to_bits());
        let (mut under_way, mut tried) = (JoinSet::new(), String::new());
        self.catch_up(&mut batch, now());
        loop {
            let idle = under_way.is_empty();
            let next = trials.next(&self.letters, batch.due(), now()).filter(|_| idle);
            let due = next.as_ref().map(|(due, _)| *due);
            let instant = |t: f64| began + Duration::try_from_secs_f64(t).unwrap_or_default();
            let at = instant(due.unwrap_or(0.0));
            // What becomes a letter now needs no draft.
            let drafted = draft.due(&batch).filter(|_| due.is_none_or(|due| due > now()));
            self.state.queue.store(batch.len() + self.letters.counts().0 as u64, Relaxed);
            tokio::select! {
                () = stop.cancelled() => break,
                heard = self.news.recv() => match heard {
                    Ok(Heard::Event(Event::Alarm(change))) => self.hear(&change, &mut batch, now()),
                    Ok(Heard::Event(_)) => {}
                    Ok(Heard::Untold(untold)) => self.hold(untold, &mut batch, now()),
                    Err(RecvError::Lagged(lost)) if self.source.is_fed() => batch.lose(lost, now()),
                    Err(RecvError::Lagged(_)) => self.catch_up(&mut batch, now()),
                    Err(RecvError::Closed) => break,
                },
                () = self.letters.changed() => {}
                Some(carried) = under_way.join_next(), if !idle => {
                    let carried = carried.unwrap_or_else(|error| Err(Fault::Later(error.to_string(), None)));
                    let by_chance = random.random_range(0.5..1.0);
                    self.settle(&tried, carried, &mut trials, by_chance, now()).await;
                }
                () = sleep_until(instant(drafted.unwrap_or(0.0))), if drafted.is_some() => {
                    let pause = if self.keep(&mut draft, &batch).await { DRAFT_S } else { UNWRITTEN_S };
                    draft.next = now() + pause;
                }
                () = sleep_until(instant(self.again)), if self.letters.any_unwritten() => {
                    self.write_again().await;
                    self.again = now() + UNWRITTEN_S;
                }
                () = sleep_until(at), if due.is_some() => match next.and_then(|(_, id)| id) {
                    Some(id) => if let Some(letter) = self.letters.waiting(&id) {
                        let carrier = self.carrier.clone();
                        under_way.spawn(async move { carrier.carry(&letter).await });
                        tried = id;
                    },
                    None => if let Some(digest) = batch.take(now()) {
                        let id = self.post(&digest, draft.id.take()).await;
                        if let Some(id) = id.filter(|_| self.state.is_gone()) {
                            self.bury(&id, "the receiver has said that it is gone").await;
                        }
                    },
                },
            }
        }
        // Changes that came with the order to stop may be unheard yet, and the next start would take them for old.
        self.catch_up(&mut batch, now());
        while let Ok(untold) = self.news.try_recv() {
            self.hold(untold, &mut batch, now());
        }
        if let Some(digest) = batch.take(now()) {
            self.post(&digest, draft.id.take()).await;
        }
        self.write_again().await;
    }

    /// Takes what was picked, and holds it until it is on disk.
    fn hold(&mut self, untold: Arc<Untold>, batch: &mut Batch, now: f64) {
        let came = batch.came();
        self.tell(&untold.change, batch, now);
        match batch.came() == came {
            // It is not for this receiver.
            true => untold.keep(),
            false => self.held.push(untold),
        }
    }

    /// Everything that came is on disk, or counted as dropped.
    fn let_go(&mut self) {
        self.held.drain(..).for_each(|untold| untold.keep());
    }

    /// The channel may begin after the log: that has the one that is missing.
    fn hear(&mut self, change: &AlarmChange, batch: &mut Batch, now: f64) {
        if change.number > self.heard + 1 {
            self.catch_up(batch, now);
        }
        self.take(change, batch, now);
    }

    fn take(&mut self, change: &AlarmChange, batch: &mut Batch, now: f64) {
        if change.number <= self.heard {
            return;
        }
        self.heard = change.number;
        self.letters.hear(change.number);
        self.tell(change, batch, now);
    }

    fn tell(&mut self, change: &AlarmChange, batch: &mut Batch, now: f64) {
        let Some(notice) = self.source.notice(change).filter(|notice| self.events.contains(&notice.what))
        else {
            return;
        };
        if self.filter.takes(notice.alarm.kind, notice.priority, &notice.groups) && !batch.put(notice, now) {
            self.state.dropped.fetch_add(1, Relaxed);
        }
    }

    /// More happened than was taken from the channel: the log of changes has most of it.
    fn catch_up(&mut self, batch: &mut Batch, now: f64) {
        if self.source.is_fed() {
            return;
        }
        let log = self.source.results.alarm_log();
        let oldest = log.last().map_or(0, |change| change.number);
        let lost = oldest.saturating_sub(self.heard + 1);
        if lost > 0 {
            batch.lose(lost, now);
            self.state.dropped.fetch_add(lost, Relaxed);
        }
        log.iter().rev().for_each(|change| self.take(change, batch, now));
    }

    /// Has on disk what waits; whether that could be done.
    async fn keep(&mut self, draft: &mut Draft, batch: &Batch) -> bool {
        let Some(letter) = batch.digest().and_then(|digest| self.letter(&digest, draft.id.take())) else {
            draft.came = batch.came();
            return true;
        };
        draft.id = Some(letter.id.clone());
        let written = self.on_disk(move |letters| letters.draft(&letter)).await == Some(true);
        if written {
            draft.came = batch.came();
            self.let_go();
        }
        written
    }

    /// Makes a letter of a digest, in place of its draft; its name.
    async fn post(&mut self, digest: &Digest, draft: Option<String>) -> Option<String> {
        let Some(letter) = self.letter(digest, draft) else {
            error!(
                receiver = self.name,
                changes = digest.changes(),
                "not told: the machine has no randomness"
            );
            self.state.dropped.fetch_add(digest.changes(), Relaxed);
            self.let_go();
            return None;
        };
        let id = letter.id.clone();
        if self.on_disk(move |letters| letters.put(letter)).await == Some(true) {
            self.let_go();
        } else {
            self.unwritten.insert(id.clone(), std::mem::take(&mut self.held));
        }
        Some(id)
    }

    /// Writes what could not be written.
    async fn write_again(&mut self) {
        let written = self.on_disk(Letters::write_again).await.unwrap_or_default();
        written.iter().for_each(|id| self.is_safe(id));
    }

    /// A letter is on disk or delivered: what was picked for it is let go.
    fn is_safe(&mut self, id: &str) {
        self.unwritten.remove(id).into_iter().flatten().for_each(|untold| untold.keep());
    }

    fn letter(&self, digest: &Digest, draft: Option<String>) -> Option<Letter> {
        let now = (self.source.now)();
        let letter = Letter::new(self.carrier.compose(digest, &self.source, now), now)?;
        let id = draft.unwrap_or_else(|| letter.id.clone());
        Some(Letter { id, ..letter })
    }

    /// What came of an attempt; `by_chance` is the part of the usual pause that is waited.
    async fn settle(
        &mut self,
        id: &str,
        carried: Result<(), Fault>,
        trials: &mut Trials,
        by_chance: f64,
        now: f64,
    ) {
        let trial = trials.of(id, now);
        let (why, wait) = match carried {
            Ok(()) => {
                trials.forget(id);
                self.delivered(id.to_string()).await;
                return;
            }
            Err(Fault::Later(why, after)) => (why, self.wait(trial, after, by_chance, now)),
            Err(Fault::Never(why)) => (why, None),
            Err(Fault::Gone(why)) => {
                self.state.gone.store(true, Relaxed);
                (why, None)
            }
        };
        if self.state.refused(&why, (self.source.now)()) {
            warn!(receiver = self.name, "a message was not taken: {why}");
        }
        match wait {
            Some(wait) => {
                self.letters.failed(id, &why);
                (trial.next, trial.failures) = (now + wait, trial.failures.saturating_add(1));
            }
            None => {
                trials.forget(id);
                self.bury(id, &why).await;
            }
        }
        // Those that were replayed are tried first.
        let partly: Vec<String> =
            self.letters.partly().into_iter().filter(|id| trials.has_failed(id)).collect();
        for id in partly.iter().take(partly.len().saturating_sub(MOST_PARTLY)) {
            trials.forget(id);
            self.bury(
                id,
                "more mails than allowed wait for addresses that refused them, and this is the oldest",
            )
            .await;
        }
    }

    /// A letter was taken.
    async fn delivered(&mut self, id: String) {
        if self.state.took((self.source.now)()) {
            info!(receiver = self.name, "takes messages again");
        }
        self.is_safe(&id);
        self.on_disk(move |letters| letters.done(&id)).await;
    }

    /// How long until a letter is tried again (s); `None` where it was tried for long enough.
    fn wait(&self, trial: &Trial, asked: Option<Duration>, by_chance: f64, now: f64) -> Option<f64> {
        let pause = self.pause(trial.failures).mul_f64(by_chance).as_secs_f64();
        let left = self.retry.for_s - (now - trial.first);
        // Who asks for more than is left is asked once more at the end.
        let asked = asked.unwrap_or_default().as_secs_f64().min(left);
        (pause <= left).then_some(pause.max(asked))
    }

    async fn bury(&self, id: &str, why: &str) {
        error!(receiver = self.name, letter = id, "a message is a dead letter: {why}");
        self.letters.failed(id, why);
        let (id, now) = (id.to_string(), (self.source.now)());
        let lost = self.on_disk(move |letters| letters.bury(&id, now)).await;
        if lost.is_some_and(|lost| lost > 0) {
            warn!(receiver = self.name, lost, "older dead letters are gone for it");
        }
    }

    fn pause(&self, failures: u32) -> Duration {
        let factor = 2f64.powi(failures.min(60) as i32);
        Duration::try_from_secs_f64((self.retry.first_s * factor).min(self.retry.longest_s))
            .unwrap_or_default()
    }

    async fn on_disk<T: Send + 'static>(
        &self,
        act: impl FnOnce(&Letters) -> T + Send + 'static,
    ) -> Option<T> {
        let letters = self.letters.clone();
        let done = spawn_blocking(move || act(&letters)).await;
        done.inspect_err(|error| error!(receiver = self.name, %error, "a message could not be kept")).ok()
    }
}

#[cfg(test)]
mod tests;
