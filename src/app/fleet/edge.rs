//! An edge: forwards what it measured and found, hears what the centre wants, and tells people by itself while it reaches no
//! centre.

use super::forward::{Forward, Told};
use super::inventory::hello;
use super::orders::read_action;
use super::{Fleet, PAUSE, Scene};
use crate::alarm::{AlarmId, Cause};
use crate::app::App;
use crate::app::persistence::rows::remembered_change;
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::message::Action;
use crate::fleet::streams::ACTIONS;
use crate::fleet::subject::{Subject, What, all, escaped};
use crate::notify::Telling;
use crate::results::AlarmChange;
use crate::signal::LoopId;
use crate::store::{self, Reader, TransitionRow};
use prost::Message;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

/// Changes of alarms that are read from the store in one go.
const ROWS: usize = 1000;
/// Longest wait in one round until receivers have on disk what people are to be told.
const KEPT: Duration = Duration::from_secs(3);
/// Orders that are taken at once.
const ORDERS: usize = 64;

/// Changes that receivers do not have on disk yet, oldest first, by number; with nothing to tell there is no change.
type Handed = VecDeque<(u64, Option<(AlarmChange, Telling)>)>;

impl Fleet {
    pub(super) async fn edge(self: &Arc<Self>, link: &Link, app: &App) {
        let stop = app.stop.clone();
        let hearing = async {
            while !stop.is_cancelled() {
                if let Err(error) = self.asking.hear(link).await {
                    tracing::debug!(%error, "answers of workers are not heard");
                }
                stop.run_until_cancelled(tokio::time::sleep(PAUSE)).await;
            }
        };
        tokio::join!(
            stop.run_until_cancelled(hearing),
            stop.run_until_cancelled(self.forwarding(link)),
            stop.run_until_cancelled(self.obeying(link, app)),
        );
    }

    async fn forwarding(&self, link: &Link) {
        let Some(store) = self.scene.borrow().config.store.clone() else { return };
        let mut forward = Forward::new(&self.site, &self.name);
        // The lease as it was seen last, and when that was new.
        let mut seen: Option<(u64, Duration)> = None;
        // The scene that the centre knows; the last change that was told here; the last that a centre has heard of.
        let (mut greeted, mut told, mut heard) = (None, 0, 0);
        let mut handed = Handed::new();
        let mut done = self.clock.elapsed();
        loop {
            let scene = self.scene.borrow().clone();
            self.asking.keep(writing(&scene.config));
            let now = self.clock.elapsed();
            match link.lease().await {
                Ok(Some(lease)) => {
                    self.epoch.fetch_max(lease.epoch(), Relaxed);
                    if seen.is_none_or(|(sequence, _)| sequence != lease.sequence) {
                        seen = Some((lease.sequence, now));
                    }
                }
                Ok(None) => {}
                Err(error) => tracing::debug!(%error, "the lease cannot be looked at"),
            }
            let alone = self.is_alone(now.saturating_sub(seen.map_or(Duration::ZERO, |(_, since)| since)));
            if alone {
                // Before it is forwarded, so that what is told here is marked as told.
                told = self.tell(&store, heard.max(told), &mut handed).await;
            } else {
                // The centre tells people of what is not known to be told.
                handed.clear();
            }
            let round = async {
                if !greeted.as_ref().is_some_and(|greeted| Arc::ptr_eq(greeted, &scene)) {
                    self.greet(link, &scene).await?;
                }
                let more = forward.samples(link, &scene.history, &store).await?;
                let told = Told { after: heard, last: told, since: self.since, alone };
                Ok::<_, LinkError>(forward.events(link, &store, told).await? || more)
            };
            let pause = match round.await {
                Ok(more) => {
                    greeted = Some(scene);
                    done = if more { done } else { self.clock.elapsed() };
                    if more { Duration::ZERO } else { Duration::from_secs_f64(self.config.forward_s) }
                }
                Err(error) => {
                    tracing::warn!(%error, "nothing is forwarded: it waits in the store");
                    forward.forget();
                    PAUSE
                }
            };
            if !alone {
                heard = forward.forwarded().unwrap_or(heard);
            }
            self.lag(self.clock.elapsed().saturating_sub(done).as_secs_f64());
            tokio::time::sleep(pause).await;
        }
    }

    /// Whether this edge tells people by itself, after no centre was seen for so long.
    fn is_alone(&self, silent: Duration) -> bool {
        let alone = silent.as_secs_f64() > self.config.cut_off_after_s;
        if self.outlet.speak(alone) {
            let who = if alone {
                "this edge tells people: it reaches no centre"
            } else {
                "the centre tells people"
            };
            tracing::warn!(silent_s = silent.as_secs_f64(), "{who}");
        }
        alone
    }

    /// Says what this edge is.
    async fn greet(&self, link: &Link, scene: &Scene) -> Result<(), LinkError> {
        let names = crate::app::devices_of(&scene.config).iter().map(LoopId::to_string).collect();
        let subject = Subject::new(&self.site, &self.name, What::Hello).to_string();
        let message = Outgoing::latest(subject, hello(scene, names).encode_to_vec());
        match link.send(&[message]).await {
            Err((_, LinkError::TooLarge(bytes))) => {
                tracing::error!(
                    bytes,
                    "the centre does not know this edge's loops: max_payload of the NATS servers is too small"
                );
                Ok(())
            }
            sent => sent.map_err(|(_, error)| error),
        }
    }

    /// Tells people of changes behind the one with the number `told`, of which no centre has heard; the number up to which all
    /// receivers have them on disk. Those behind it stay in `handed`, and the next call looks at them again.
    async fn tell(&self, store: &store::Config, mut told: u64, handed: &mut Handed) -> u64 {
        if handed.is_empty() {
            *handed = self.hand(store, told).await;
        }
        let until = tokio::time::Instant::now() + KEPT;
        for (_, telling) in handed.iter_mut() {
            let Some((change, own)) = telling else { continue };
            match tokio::time::timeout_at(until, own.kept()).await {
                Ok(true) => *telling = None,
                Ok(false) => {
                    // A receiver ended without it. The others are not replaced meanwhile.
                    let _receivers = self.receivers.read().await;
                    *own = self.outlet.tell(change.clone());
                }
                Err(_) => {}
            }
        }
        while let Some((number, None)) = handed.front() {
            told = *number;
            handed.pop_front();
        }
        told
    }

    /// Has receivers tell of the changes behind the one with the number `told`.
    async fn hand(&self, store: &store::Config, told: u64) -> Handed {
        let own = store.clone();
        let read = tokio::task::spawn_blocking(move || {
            Reader::of(&own)?.transitions(i64::try_from(told).unwrap_or(i64::MAX), ROWS)
        });
        let rows = match read.await {
            Ok(Ok(rows)) => rows,
            Ok(Err(error)) => {
                tracing::warn!(%error, "people are not told: the store cannot be read");
                return Handed::new();
            }
            Err(_) => return Handed::new(),
        };
        // Receivers are not replaced meanwhile.
        let _receivers = self.receivers.read().await;
        let hand = |(number, row): (i64, _)| {
            let news = Some(row).filter(|row: &TransitionRow| row.at >= self.since);
            let change = news.and_then(remembered_change);
            let telling = change.map(|change| (change.clone(), self.outlet.tell(change)));
            (u64::try_from(number).unwrap_or(told), telling)
        };
        rows.into_iter().map(hand).collect()
    }

    /// Does what people at the centre want done about alarms. An order is done with once what came of it is in the store.
    async fn obeying(&self, link: &Link, app: &App) {
        let reader = format!("edge_{}_{}", self.site, escaped(&self.name));
        let filter = all(Some(&self.site), What::Action);
        // Of one that comes again although it was done nothing is done.
        let mut last = 0;
        let mut obeyed = Obeyed::default();
        loop {
            let mut reading = match link.read(ACTIONS, &reader, &filter).await {
                Ok(reading) => reading,
                Err(error) => {
                    tracing::debug!(%error, "orders of the centre are not heard");
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
            };
            while let Ok(orders) = reading.next(ORDERS, Duration::from_secs(2)).await {
                let new: Vec<_> = orders.iter().filter(|order| order.sequence() > last).collect();
                for order in &new {
                    last = order.sequence().max(last);
                    match Action::decode(order.body()) {
                        Ok(action) if action.epoch < self.epoch.fetch_max(action.epoch, Relaxed) => {
                            tracing::warn!(
                                by = action.by,
                                "an order of a centre that was replaced is refused"
                            );
                        }
                        Ok(action) => self.obey(&action, &mut obeyed),
                        Err(error) => tracing::warn!(%error, "an order cannot be read"),
                    }
                }
                if !new.is_empty() && !self.is_durable(app).await {
                    tracing::warn!("the store fails: orders of the centre come again after a restart");
                    continue;
                }
                for order in orders {
                    if let Err(error) = order.done().await {
                        tracing::debug!(%error, "an order comes again");
                    }
                }
            }
        }
    }

    fn obey(&self, order: &Action, obeyed: &mut Obeyed) {
        let late_s = (self.clock.now() - order.at).max(0.0);
        let Some((id, action, said)) = read_action(order, late_s) else {
            tracing::warn!(
                action = order.action,
                kind = order.kind,
                "an order is over, or of a kind that this version does not know"
            );
            return;
        };
        let now = self.clock.now();
        let Some(own) = self.results.alarm(&id, now) else { return };
        // What was raised since has been seen by nobody.
        if order.action == "acknowledge" && own.raised_at != order.raised_at {
            tracing::info!(alarm = %id, "an acknowledgement is of an earlier alarm");
            return;
        }
        // The centre did not know what a person did here after the state that it saw. That person is nearer to the valve. A stamp
        // in the future was made before the clock was set back, and does not count.
        let log = self.results.alarm_log();
        let by_hand = log.iter().filter(|change| change.id == id && is_by_hand(change.transition.cause));
        let mut acted = by_hand.map(|change| change.transition.at).filter(|at| *at <= now);
        if let Some(since) = order.since
            && let Some(at) = acted.find(|at| *at > since && !obeyed.contains(&id, *at))
        {
            tracing::info!(alarm = %id, action = order.action, by = order.by, at, "an order is refused: somebody acted here since");
            return;
        }
        obeyed.push(id.clone(), now);
        match self.results.act(&id, action, said, now) {
            Some(Err(refusal)) => tracing::info!(alarm = %id, %refusal, "an order is not done"),
            _ => {
                tracing::info!(alarm = %id, action = order.action, by = order.by, "done as the centre wants")
            }
        }
    }
}

/// Whether a person makes an alarm change so.
fn is_by_hand(cause: Cause) -> bool {
    use Cause::{Acknowledged, Reset, Returned, Shelved, TakenOut, Unshelved};
    matches!(cause, Acknowledged | Reset | Shelved | Unshelved | TakenOut | Returned)
}

/// Orders of the centre that were done here lately: which alarm, and when (s).
#[derive(Default)]
struct Obeyed(VecDeque<(AlarmId, f64)>);

/// How many of them are remembered.
const MOST_OBEYED: usize = 1024;

impl Obeyed {
    fn push(&mut self, id: AlarmId, at: f64) {
        if self.0.len() >= MOST_OBEYED {
            self.0.pop_front();
        }
        self.0.push_back((id, at));
    }

    fn contains(&self, id: &AlarmId, at: f64) -> bool {
        self.0.iter().any(|(own, then)| own == id && *then == at)
    }
}

/// Loops that this machine may write to.
fn writing(config: &crate::config::Config) -> std::collections::HashSet<LoopId> {
    let loops = config.loops.iter().filter(|own| own.writeback.is_some());
    loops.map(|own| LoopId::new(own.id.as_str())).collect()
}
