//! An edge: forwards what it measured and found, hears what the centre wants, and tells people by itself while it reaches no
//! centre.

use super::alone::Alone;
use super::announcing::Announcing;
use super::forward::Forward;
use super::order::Making;
use super::orders::read_action;
use super::teller::NEWS_S;
use super::{Fleet, PAUSE};
use crate::alarm::{AlarmId, Cause};
use crate::app::App;
use crate::fleet::lease::Seen;
use crate::fleet::link::{Link, LinkError};
use crate::fleet::message::Action;
use crate::fleet::streams::ACTIONS;
use crate::fleet::subject::{What, all, escaped};
use crate::fleet::weights;
use crate::notify::Telling;
use crate::results::AlarmChange;
use crate::signal::LoopId;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

/// Changes of alarms that are handed to receivers in one go.
const MOST: usize = 1000;
/// Longest wait in one round until receivers have on disk what people are to be told.
const KEPT: Duration = Duration::from_secs(3);
/// Orders that are taken at once.
const ORDERS: usize = 64;

/// Changes that receivers do not have on disk yet, oldest first.
type Handed = Vec<(Arc<AlarmChange>, Telling)>;

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
        let mut seen: Option<(Seen, Duration)> = None;
        // How far our announcement has come; since when nothing is forwarded, or the store cannot be read.
        let (mut announcing, mut unheard_since) = (Announcing::default(), None::<Duration>);
        let (mut known, mut handed) = (Alone::default(), Handed::new());
        // There was no lease at the last look.
        let mut gone = false;
        let mut done = self.clock.elapsed();
        loop {
            let scene = self.scene.borrow().clone();
            self.asking.keep(writing(&scene.config));
            let now = self.clock.elapsed();
            match link.lease().await {
                Ok(lease) => {
                    let before = seen.as_ref().map(|(before, _)| before);
                    let is_new = lease.is_some() && before != lease.as_ref();
                    let is_anew = before.is_some_and(|before| {
                        lease.as_ref().map_or(!gone, |lease| lease.is_of_another_stream(before))
                    });
                    gone = lease.is_none();
                    // The first that is seen may be from long ago.
                    known.looked(is_new && before.is_some() && !is_anew);
                    if is_anew {
                        // What the streams had is lost, and their numbers say nothing any more.
                        known.lost();
                        announcing.lost();
                        forward.forget();
                    }
                    if let Some(lease) = lease {
                        if is_anew {
                            self.epoch.store(lease.epoch(), Relaxed);
                        }
                        self.epoch.fetch_max(lease.epoch(), Relaxed);
                        if is_new {
                            seen = Some((lease, now));
                        }
                    }
                }
                Err(error) => {
                    announcing.doubt();
                    tracing::debug!(%error, "the lease cannot be looked at");
                }
            }
            let silent = now.saturating_sub(seen.as_ref().map_or(Duration::ZERO, |(_, since)| *since));
            // While nothing is forwarded no centre hears of an alarm either, whatever lease there is.
            let unheard = unheard_since.map_or(Duration::ZERO, |since| now.saturating_sub(since));
            let alone = self.is_alone(silent.max(unheard));
            if alone {
                // Before it is forwarded, so that what is told here is marked as told.
                self.tell(&mut known, &mut handed).await;
            } else if !handed.is_empty() {
                // Also what receivers have by now; of what they still have not the centre tells people.
                self.note_kept(&mut known, &mut handed).await;
                handed.clear();
            }
            let holds = alone && {
                // Receivers are not replaced meanwhile.
                let _receivers = self.receivers.read().await;
                self.outlet.is_heard()
            };
            let told = known.so_far(self.since.max(self.clock.now() - NEWS_S), holds);
            let round = async {
                self.announce(link, &scene, &mut announcing).await?;
                let more = forward.samples(link, &scene.history, &store).await?;
                Ok::<_, LinkError>(forward.events(link, &store, told).await? || more)
            };
            let round = round.await;
            let failed = round.is_err();
            let pause = match round {
                Ok(more) => {
                    done = if more { done } else { self.clock.elapsed() };
                    if more { Duration::ZERO } else { Duration::from_secs_f64(self.config.forward_s) }
                }
                Err(error) => {
                    tracing::warn!(%error, "nothing is forwarded: it waits in the store");
                    // The streams may be others when they are there again.
                    announcing.doubt();
                    forward.forget();
                    PAUSE
                }
            };
            known.forwarded(forward.forwarded());
            unheard_since = (failed || forward.is_unread()).then(|| unheard_since.unwrap_or(now));
            self.lag(self.clock.elapsed().saturating_sub(done).as_secs_f64());
            tokio::time::sleep(pause).await;
        }
    }

    /// Whether this edge tells people by itself, after no centre was seen for so long.
    fn is_alone(&self, silent: Duration) -> bool {
        let alone = silent.as_secs_f64() > self.config.cut_off_after_s;
        if self.outlet.speak(alone) {
            let who = match (alone, self.outlet.is_heard()) {
                (true, true) => "this edge tells people: no centre hears of its alarms",
                (true, false) => {
                    "nobody is told: no centre hears of this edge's alarms, and it has no receiver"
                }
                (false, _) => "the centre tells people",
            };
            tracing::warn!(silent_s = silent.as_secs_f64(), "{who}");
        }
        alone
    }

    /// Tells people of changes of which nobody has heard. Those that receivers do not have on disk yet stay in `handed`, and the
    /// next call looks at them again.
    async fn tell(&self, known: &mut Alone, handed: &mut Handed) {
        // One receiver that cannot keep a change does not keep the others from those that come after it.
        let new = self.hand(known, handed).await;
        handed.extend(new);
        self.note_kept(known, handed).await;
    }

    /// Waits for receivers, not for long, and takes note of what they have on disk.
    async fn note_kept(&self, known: &mut Alone, handed: &mut Handed) {
        let until = tokio::time::Instant::now() + KEPT;
        for (change, mut own) in std::mem::take(handed) {
            match tokio::time::timeout_at(until, own.kept()).await {
                Ok(true) => known.told(&change),
                Ok(false) => {
                    // A receiver ended without it. The others are not replaced meanwhile.
                    let _receivers = self.receivers.read().await;
                    let again = self.outlet.tell(AlarmChange::clone(&change));
                    if !again.nobody() {
                        handed.push((change, again));
                    }
                }
                Err(_) => handed.push((change, own)),
            }
        }
    }

    /// Has receivers tell of the changes of the last day of which nobody has heard and that are not `handed` yet, by memory: the
    /// store may be away. Nothing is handed where there is no receiver, so that it is still to be told.
    async fn hand(&self, known: &Alone, handed: &Handed) -> Handed {
        let since = self.clock.now() - NEWS_S;
        let is_handed = |change: &Arc<AlarmChange>| handed.iter().any(|(own, _)| Arc::ptr_eq(own, change));
        let mut untold = known.untold(&self.results.alarm_log());
        untold.retain(|change| change.transition.at >= since && !is_handed(change));
        // Receivers are not replaced meanwhile.
        let _receivers = self.receivers.read().await;
        let hand = |change: Arc<AlarmChange>| {
            let telling = self.outlet.tell(AlarmChange::clone(&change));
            (!telling.nobody()).then_some((change, telling))
        };
        untold.into_iter().take(MOST.saturating_sub(handed.len())).map_while(hand).collect()
    }

    /// Does what people at the centre want done about alarms. An order is done with once what came of it is in the store.
    async fn obeying(&self, link: &Link, app: &App) {
        let reader = format!("edge_{}_{}", self.site, escaped(&self.name));
        let filter = all(Some(&self.site), What::Action);
        // Of one that comes again although it was done nothing is done.
        let (mut last, mut making) = (0, Making::default());
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
            if making.is_another(reading.made()) {
                // The stream may be another, and count from 1 again.
                last = 0;
            }
            while let Ok(orders) = reading.next(ORDERS, Duration::from_secs(2)).await {
                let new: Vec<_> = orders.iter().filter(|order| order.sequence() > last).collect();
                for order in &new {
                    last = order.sequence().max(last);
                    match weights::read::<Action>(order.subject(), order.bytes()) {
                        Some(action) if action.epoch < self.epoch.fetch_max(action.epoch, Relaxed) => {
                            tracing::warn!(
                                by = action.by,
                                "an order of a centre that was replaced is refused"
                            );
                        }
                        Some(action) => self.obey(&action, &mut obeyed),
                        None => {}
                    }
                }
                // Also for those that were done before: they come again because that was not durable.
                if !orders.is_empty() && !self.is_durable(app).await {
                    tracing::warn!("the store fails: orders of the centre come again");
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::fleet::tests::edge;

    #[tokio::test]
    async fn what_nobody_has_heard_of_is_still_to_be_told() {
        let (fleet, results) = edge("FIC1");
        let (mut known, mut handed) = (Alone::default(), Handed::new());
        results.watch_trip(&LoopId::new("FIC1"), Some("a fault".into()), fleet.clock.now());
        fleet.tell(&mut known, &mut handed).await;
        assert!(handed.is_empty() && !fleet.outlet.is_heard());
        assert_eq!(known.untold(&results.alarm_log()).len(), 1, "there is no receiver");
        // The store of this edge is nowhere.
        let receiver = fleet.outlet.kept_by_a_task();
        fleet.tell(&mut known, &mut handed).await;
        assert!(handed.is_empty() && known.untold(&results.alarm_log()).is_empty());
        receiver.abort();
    }

    #[tokio::test]
    async fn what_receivers_have_when_a_centre_is_back_is_told() {
        let (fleet, results) = edge("FIC1");
        let mut known = Alone::default();
        results.watch_trip(&LoopId::new("FIC1"), Some("a fault".into()), fleet.clock.now());
        let receiver = fleet.outlet.kept_by_a_task();
        let mut handed = fleet.hand(&known, &Vec::new()).await;
        assert_eq!((handed.len(), known.untold(&results.alarm_log()).len()), (1, 1));
        fleet.note_kept(&mut known, &mut handed).await;
        assert!(handed.is_empty() && known.untold(&results.alarm_log()).is_empty());
        receiver.abort();
    }
}
