//! An edge: forwards what it measured and found, hears what the centre wants, and tells people by itself while it reaches no
//! centre.

use super::alone::{Alone, Told};
use super::announcing::Announcing;
use super::centre::Taken;
use super::forward::{Came, Forward};
use super::found::Found;
use super::order::Making;
use super::orders::{late_s, read_action};
use super::teller::NEWS_S;
use super::{Fleet, PAUSE, Scene};
use crate::alarm::{AlarmId, Cause};
use crate::app::App;
use crate::fleet::lease::Seen;
use crate::fleet::link::{Incoming, Link, LinkError};
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
            stop.run_until_cancelled(self.forwarding(link, app)),
            stop.run_until_cancelled(self.obeying(link, app)),
        );
    }

    async fn forwarding(&self, link: &Link, app: &App) {
        let Some(store) = self.scene.borrow().config.store.clone() else { return };
        let mut own = Forwarding::new(&self.site, &self.name, self.clock.elapsed());
        loop {
            let scene = self.scene.borrow().clone();
            self.asking.keep(writing(&scene.config));
            own.watch(&scene);
            let now = self.clock.elapsed();
            own.watch_store(app.persistence.fails(), now);
            let lease = link.lease().await;
            let answers = lease.is_ok();
            match lease {
                Ok(lease) => self.look_at(lease, now, &mut own),
                Err(error) => {
                    // The streams may be others when the server is there again, or have lost their last messages.
                    own.forward.forget();
                    own.doubt();
                    tracing::debug!(%error, "the lease cannot be looked at");
                }
            }
            let alone = self.is_alone(own.unheard_for(now));
            if alone {
                // Before it is forwarded, so that what is told here is marked as told.
                self.tell(&mut own.known, &mut own.handed).await;
            } else if !own.handed.is_empty() {
                // Also what receivers have by now; of what they still have not the centre tells people.
                self.note_kept(&mut own.known, &mut own.handed).await;
                own.handed.clear();
            }
            let holds = alone && {
                // Receivers are not replaced meanwhile.
                let _receivers = self.receivers.read().await;
                self.outlet.is_heard()
            };
            let results = self.results.clone();
            let log = Box::new(move || results.alarm_log());
            let told = own.known.so_far(log, self.clock.now() - NEWS_S, holds);
            let pause = self.round(link, (&scene, &store), &mut own, (told, answers)).await;
            self.lag(self.clock.elapsed().saturating_sub(own.done).as_secs_f64());
            tokio::time::sleep(pause).await;
        }
    }

    /// Takes the lease as it was looked at.
    fn look_at(&self, lease: Option<Seen>, now: Duration, own: &mut Forwarding) {
        let before = own.seen.as_ref().map(|(before, _)| before);
        let is_new = lease.is_some() && before != lease.as_ref();
        let is_anew = before.is_some_and(|before| {
            lease.as_ref().map_or(!own.gone, |lease| lease.is_of_another_stream(before))
        });
        own.gone = lease.is_none();
        // The first that is seen may be from long ago.
        own.known.looked(is_new && before.is_some() && !is_anew);
        if is_anew {
            // What the streams had is lost, and their numbers say nothing any more.
            own.known.lost();
            own.announcing.lost();
            own.forward.forget();
            own.found.doubt();
        }
        if let Some(lease) = lease {
            if is_anew {
                self.epoch.store(lease.epoch(), Relaxed);
            }
            self.epoch.fetch_max(lease.epoch(), Relaxed);
            if is_new {
                own.seen = Some((lease, now));
            }
        }
    }

    /// Forwards what is new, alarms first: they never wait for anything else. `answers`: the server has just answered. How long to
    /// wait until the next round.
    async fn round(
        &self,
        link: &Link,
        (scene, store): (&Arc<Scene>, &crate::store::Config),
        own: &mut Forwarding,
        (told, answers): (Told, bool),
    ) -> Duration {
        let now = self.clock.elapsed();
        let alarms = async {
            let changes = own.found.alarms(link, store, told, now).await?;
            if changes == Came::Part {
                return Ok(None);
            }
            // A long list takes several rounds, and no alarm waits for it.
            let list = self.announce(link, scene, &mut own.announcing).await?;
            Ok::<_, LinkError>(Some([changes, list, own.found.states(link, store).await?]))
        };
        let alarms = alarms.await;
        own.known.forwarded(own.found.forwarded());
        // While alarms are not forwarded no centre hears of one, whatever lease there is. Nobody waits for the rest.
        let unheard = alarms.is_err() || own.found.is_unread();
        own.unheard_since = unheard.then(|| own.unheard_since.unwrap_or(now));
        let (mut came, mut failed) = (Vec::new(), None);
        match alarms {
            Ok(Some(some)) => came.extend(some),
            // Nothing else is forwarded before the other changes of alarms.
            Ok(None) => return Duration::ZERO,
            Err(error) => failed = Some(("alarms", error)),
        }
        // A line that is dead without a reset takes 5 s for each question, so a server that is silent is asked nothing more.
        if answers && (failed.is_none() || is_heard(link).await) {
            match own.found.diagnoses(link, store, now).await {
                Ok(some) => came.push(some),
                Err(error) => failed = failed.or(Some(("diagnoses", error))),
            }
            if failed.is_none() || is_heard(link).await {
                match own.forward.samples(link, &scene.history, store).await {
                    Ok(some) => came.push(some),
                    Err(error) => failed = failed.or(Some(("samples", error))),
                }
            }
        }
        if let Some((what, error)) = failed {
            tracing::warn!(%error, what, "this is not forwarded: it waits in the store");
            own.doubt();
            return PAUSE;
        }
        if !answers {
            return PAUSE;
        }
        if came.iter().all(|own| *own == Came::Whole) {
            own.done = self.clock.elapsed();
        }
        if came.contains(&Came::Part) {
            Duration::ZERO
        } else {
            Duration::from_secs_f64(self.config.forward_s)
        }
    }

    /// Whether this edge tells people by itself, after no centre heard of its alarms for so long.
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
        let (mut taken, mut making) = (Taken::default(), Making::default());
        let mut obeyed = Obeyed::default();
        let mut is_said = false;
        loop {
            let mut reading = match link.read(ACTIONS, &reader, &filter).await {
                Ok(reading) => reading,
                Err(error) => {
                    // A server that permits another reader does not answer, while all else works.
                    if !std::mem::replace(&mut is_said, true) {
                        tracing::warn!(%error, reader, "orders of the centre are not heard");
                    }
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
            };
            is_said = false;
            if making.is_another(reading.made()) {
                // The stream may be another, and count from 1 again.
                taken = Taken::default();
            }
            while let Ok(orders) = reading.next(ORDERS, Duration::from_secs(2)).await {
                // Orders are aged by the server's clock alone. After a long cut the stamps of the orders themselves are too old to
                // show it.
                if !orders.is_empty()
                    && let Err(error) = self.ask_server(link).await
                {
                    // All of them come again, in their order, to another reading.
                    self.rest(&error, "orders wait: the server does not say what time it is").await;
                    break;
                }
                let is_new = |order: &&Incoming| !taken.is_past(&filter, order.mark());
                let new: Vec<&Incoming> = orders.iter().filter(is_new).collect();
                new.iter().filter_map(|order| order.taken_at()).for_each(|at| self.hear_server(at));
                for order in &new {
                    match weights::read::<Action>(order.subject(), order.bytes()) {
                        Some(action) if action.epoch < self.epoch.fetch_max(action.epoch, Relaxed) => {
                            tracing::warn!(
                                by = action.by,
                                "an order of a centre that was replaced is refused"
                            );
                        }
                        Some(action) => {
                            self.obey(&action, late_s(self.server_now(), order.taken_at()), &mut obeyed);
                        }
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

    /// Carries out an order that comes so much later than it was given (s).
    fn obey(&self, order: &Action, late_s: f64, obeyed: &mut Obeyed) {
        if !order.edge.is_empty() && order.edge != self.name {
            // Another edge of the site has a loop of the same name, and the centre takes it from there.
            tracing::info!(subject = order.subject, edge = order.edge, "an order is for another edge");
            return;
        }
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

/// How far everything has come that an edge forwards, and what its people and a centre know of it.
struct Forwarding {
    forward: Forward,
    found: Found,
    announcing: Announcing,
    known: Alone,
    handed: Handed,
    /// The lease as it was seen last, and when that was new, on a steady clock.
    seen: Option<(Seen, Duration)>,
    /// There was no lease at the last look.
    gone: bool,
    /// Since when no alarm is forwarded, or the store cannot be read for them.
    unheard_since: Option<Duration>,
    /// Since when the store takes nothing.
    unwritten_since: Option<Duration>,
    /// When all that was new had been forwarded last.
    done: Duration,
    /// What is watched.
    scene: Option<Arc<Scene>>,
}

impl Forwarding {
    fn new(site: &str, name: &str, now: Duration) -> Self {
        Self {
            forward: Forward::new(site, name),
            found: Found::new(site, name),
            announcing: Announcing::default(),
            known: Alone::default(),
            handed: Handed::new(),
            seen: None,
            gone: false,
            unheard_since: None,
            unwritten_since: None,
            done: now,
            scene: None,
        }
    }

    /// What is watched now.
    fn watch(&mut self, scene: &Arc<Scene>) {
        if self.scene.as_ref().is_some_and(|own| Arc::ptr_eq(own, scene)) {
            return;
        }
        let loops = scene.config.loops.iter().map(|own| own.id.clone());
        let devices = crate::app::devices_of(&scene.config);
        self.found.watch(loops.chain(devices.iter().map(LoopId::to_string)).collect());
        self.scene = Some(scene.clone());
    }

    /// The streams may be others when they are there again, or have lost their last messages. What the streams said of samples
    /// stays until the lease or samples fail: of many loops that takes several rounds.
    fn doubt(&mut self) {
        self.announcing.doubt();
        self.found.doubt();
    }

    /// For how long no centre has heard of alarms at `now`.
    fn unheard_for(&self, now: Duration) -> Duration {
        let since = |then: Duration| now.saturating_sub(then);
        let silent = since(self.seen.as_ref().map_or(Duration::ZERO, |(_, since)| *since));
        let unheard = self.unheard_since.map_or(Duration::ZERO, since);
        silent.max(unheard).max(self.unwritten_since.map_or(Duration::ZERO, since))
    }

    /// Whether the store fails at `now`: an alarm that it does not take is in memory alone, and is forwarded to no centre, whatever
    /// lease there is.
    fn watch_store(&mut self, fails: bool, now: Duration) {
        self.unwritten_since = fails.then(|| self.unwritten_since.unwrap_or(now));
    }
}

/// Whether the server answers after something has failed: one stream may be full, and the others take what is new all the same.
async fn is_heard(link: &Link) -> bool {
    link.is_up() && link.lease().await.is_ok()
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
mod tests;
