//! An edge: forwards what it measured and found, hears what the centre wants, and tells people by itself while it reaches no
//! centre.

use super::forward::{Forward, Told};
use super::inventory::hello;
use super::orders::read_action;
use super::{Fleet, PAUSE};
use crate::app::App;
use crate::app::persistence::rows::remembered_change;
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::message::Action;
use crate::fleet::streams::ACTIONS;
use crate::fleet::subject::{Subject, What, all};
use crate::results::Event;
use crate::signal::LoopId;
use crate::store::{self, Reader};
use prost::Message;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

/// Changes of alarms that are read from the store in one go.
const ROWS: usize = 100;
/// An order that is not done within this time is given again.
const ORDER_WAITS: Duration = Duration::from_secs(30);
/// Orders that are taken at once.
const ORDERS: usize = 64;

/// Whether a centre is there, as this edge sees it.
struct Centre {
    /// The lease as it was seen last, and when that was new.
    seen: Option<(u64, Duration)>,
    /// The newest epoch that was seen.
    epoch: u64,
}

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
            stop.run_until_cancelled(self.obeying(link)),
        );
    }

    async fn forwarding(&self, link: &Link) {
        let scene = self.scene.borrow().clone();
        let Some(store) = scene.config.store.clone() else { return };
        let mut forward = Forward::new(&self.site, &self.name);
        let mut centre = Centre { seen: None, epoch: 0 };
        let (mut greeted, mut told, mut forwarded) = (None, 0, 0);
        let mut done = self.clock.elapsed();
        loop {
            let scene = self.scene.borrow().clone();
            self.asking.keep(writing(&scene.config));
            let was_greeted = greeted.as_ref().is_some_and(|greeted| Arc::ptr_eq(greeted, &scene));
            let round = async {
                if !was_greeted {
                    let names = crate::app::devices_of(&scene.config).iter().map(LoopId::to_string).collect();
                    let subject = Subject::new(&self.site, &self.name, What::Hello).to_string();
                    let body = hello(&scene, names).encode_to_vec();
                    link.send(&[Outgoing { subject, body }]).await.map_err(|(_, error)| error)?;
                }
                let lease = link.lease().await?;
                let more = forward.samples(link, &scene.history, &store).await?;
                Ok::<_, LinkError>((
                    lease,
                    forward.events(link, &store, Told { last: told, since: self.since }).await? || more,
                ))
            };
            let now = self.clock.elapsed();
            let round = round.await;
            forwarded = forward.forwarded().unwrap_or(forwarded);
            let pause = match round {
                Ok((lease, more)) => {
                    greeted = Some(scene);
                    done = if more { done } else { self.clock.elapsed() };
                    if let Some(lease) = lease
                        && centre.seen.is_none_or(|(sequence, _)| sequence != lease.sequence)
                    {
                        centre.seen = Some((lease.sequence, now));
                        centre.epoch = centre.epoch.max(lease.epoch());
                    }
                    if more { Duration::ZERO } else { Duration::from_secs_f64(self.config.forward_s) }
                }
                Err(error) => {
                    tracing::warn!(%error, "nothing is forwarded: it waits in the store");
                    forward.forget();
                    PAUSE
                }
            };
            self.lag(self.clock.elapsed().saturating_sub(done).as_secs_f64());
            let silent = now.saturating_sub(centre.seen.map_or(Duration::ZERO, |(_, since)| since));
            let alone = silent.as_secs_f64() > self.config.cut_off_after_s;
            if alone != self.speaks.swap(alone, Relaxed) {
                let who = if alone {
                    "this edge tells people: it reaches no centre"
                } else {
                    "the centre tells people"
                };
                tracing::warn!(silent_s = silent.as_secs_f64(), "{who}");
            }
            if alone {
                told = self.tell(&store, forwarded.max(told)).await;
            }
            tokio::time::sleep(pause).await;
        }
    }

    /// Tells people of changes behind the one with the number `told`, of which no centre has heard; the number of the last.
    async fn tell(&self, store: &store::Config, told: u64) -> u64 {
        let own = store.clone();
        let read = tokio::task::spawn_blocking(move || {
            Reader::of(&own)?.transitions(i64::try_from(told).unwrap_or(i64::MAX), ROWS)
        });
        let rows = match read.await {
            Ok(Ok(rows)) => rows,
            Ok(Err(error)) => {
                tracing::warn!(%error, "people are not told: the store cannot be read");
                return told;
            }
            Err(_) => return told,
        };
        let mut last = told;
        for (number, row) in rows {
            last = u64::try_from(number).unwrap_or(last);
            if row.at >= self.since
                && let Some(change) = remembered_change(row)
            {
                // An error here only means that nobody is to be told.
                let _ = self.outlet.send(Event::Alarm(Arc::new(change)));
            }
        }
        last
    }

    /// Does what people at the centre want done about alarms.
    async fn obeying(&self, link: &Link) {
        let reader =
            format!("edge-{}-{}", self.site, self.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-"));
        let mut newest = 0;
        loop {
            let filter = all(Some(&self.site), What::Action);
            let reading = match link.read(ACTIONS, &reader, &filter, (ORDER_WAITS, -1)).await {
                Ok(reading) => reading,
                Err(error) => {
                    tracing::debug!(%error, "orders of the centre are not heard");
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
            };
            while let Ok(orders) = reading.next(ORDERS, Duration::from_secs(2)).await {
                for order in orders {
                    match Action::decode(order.body()) {
                        Ok(action) if action.epoch < newest => {
                            tracing::warn!(
                                by = action.by,
                                "an order of a centre that was replaced is refused"
                            );
                        }
                        Ok(action) => {
                            newest = action.epoch;
                            self.obey(&action);
                        }
                        Err(error) => tracing::warn!(%error, "an order cannot be read"),
                    }
                    if let Err(error) = order.done().await {
                        tracing::debug!(%error, "an order comes again");
                    }
                }
            }
        }
    }

    fn obey(&self, order: &Action) {
        let Some((id, action, said)) = read_action(order) else {
            tracing::warn!(
                action = order.action,
                kind = order.kind,
                "an order is of a kind that this version does not know"
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
        match self.results.act(&id, action, said, now) {
            Some(Err(refusal)) => tracing::info!(alarm = %id, %refusal, "an order is not done"),
            _ => {
                tracing::info!(alarm = %id, action = order.action, by = order.by, "done as the centre wants")
            }
        }
    }
}

/// Loops that this machine may write to.
fn writing(config: &crate::config::Config) -> std::collections::HashSet<LoopId> {
    let loops = config.loops.iter().filter(|own| own.writeback.is_some());
    loops.map(|own| LoopId::new(own.id.as_str())).collect()
}
