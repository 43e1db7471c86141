//! A subscription: what it brings, and whether it still brings anything.

use super::{Collector, Link, Lost, Never, RETRY};
use crate::collect::Sink;
use crate::collect::opcua::listener::Event;
use crate::collect::opcua::plan::Sampling;
use crate::collect::opcua::value;
use opcua::types::{DataValue, NodeId};
use std::time::Duration;
use tokio::time::Instant;

/// What reading tells of a subscription that brings nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Closer {
    /// Values that changed, and that it had to bring.
    pub(super) hidden: usize,
    /// Values that changed so lately that they may still be on their way.
    pub(super) lately: usize,
}

impl Collector {
    pub(super) async fn listen(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<Never, Lost> {
        let (subscription, mut events) = link.subscribe().await?;
        self.monitor(link, subscription, sink).await?;
        // What the subscription brings meanwhile waits in its queue: history comes first.
        self.fill(link, sink).await?;
        let silence = Duration::from_secs_f64(self.plan.silence_s());
        let pace = Duration::from_secs_f64(self.plan.pace_s());
        let (mut heard, mut retried) = (Instant::now(), Instant::now());
        // Since when something has changed that the subscription has not brought, and how many values.
        let mut due: Option<(Instant, usize)> = None;
        let mut ticks = self.ticks();
        loop {
            tokio::select! {
                biased;
                event = events.recv() => match event {
                    Some(Event::Value(at, value)) => {
                        (heard, due) = (Instant::now(), None);
                        self.live(at, &value, sink);
                    }
                    Some(Event::Ended(status)) => {
                        return Err(Lost::Broken(format!("the server ended the subscription: {status}")));
                    }
                    None => return Err(Lost::Broken("the subscription is gone".into())),
                },
                () = link.ended() => return Err(Lost::Broken("the server ended the session".into())),
                _ = ticks.tick() => {
                    match due {
                        Some((since, changed)) if since.elapsed() > pace => return Err(self.silent(changed)),
                        Some(_) => {}
                        None if heard.elapsed() > silence => match self.listen_closer(link, sink).await? {
                            Closer { hidden, .. } if hidden > 0 => return Err(self.silent(hidden)),
                            Closer { lately, .. } if lately > 0 => due = Some((Instant::now(), lately)),
                            _ => heard = Instant::now(),
                        },
                        None => {}
                    }
                    if retried.elapsed() > RETRY {
                        self.monitor(link, subscription, sink).await?;
                        retried = Instant::now();
                    }
                    let dropped = link.take_dropped();
                    if dropped > 0 {
                        return Err(Lost::Broken(format!("{dropped} values came faster than they could be taken")));
                    }
                    // Live values go on: this session has lived through its history.
                    self.lost_filling = 0;
                    self.repeat_frozen(sink);
                    self.end_round(sink, Duration::ZERO);
                }
            }
        }
    }

    fn silent(&self, changed: usize) -> Lost {
        let silence_s = self.plan.silence_s();
        Lost::Broken(format!("the subscription was silent for {silence_s} s while {changed} values changed"))
    }

    /// Finds the nodes that have none yet and has them monitored. A refused one leaves the others alone.
    async fn monitor(&mut self, link: &mut Link, subscription: u32, sink: &dyn Sink) -> Result<(), Lost> {
        let fresh = self.resolve(link, sink).await?;
        let asked = |at: usize| Some((at, self.tags[at].node.clone()?, self.plan.tags[at].sampling));
        let nodes: Vec<(usize, NodeId, Sampling)> = fresh.into_iter().filter_map(asked).collect();
        let taken = link.monitor(subscription, &nodes).await?;
        for ((at, ..), status) in nodes.into_iter().zip(taken) {
            if status.is_bad() {
                self.tags[at].node = None;
                self.refused(at, &format!("not monitored: {status}"), sink);
            } else {
                self.tags[at].refused = false;
            }
        }
        Ok(())
    }

    /// Nothing came for long. Either nothing has changed, or the subscription is dead: reading tells.
    async fn listen_closer(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<Closer, Lost> {
        let (places, values) = self.read(link).await?;
        // What has not changed does not tell when the subscription died.
        let (heard_at, mut closer) = (self.heard_at, Closer::default());
        for (at, value) in places.into_iter().zip(values) {
            self.look(at, &value, &mut closer, sink);
        }
        if closer != Closer::default() {
            self.heard_at = heard_at;
        }
        Ok(closer)
    }

    /// One value that was read because nothing came. What the subscription has to bring is left to it: when it is dead, the
    /// next session reads from history what was before that value too.
    pub(super) fn look(&mut self, at: usize, value: &DataValue, closer: &mut Closer, sink: &dyn Sink) {
        let (state, tag) = (&self.tags[at], &self.plan.tags[at]);
        let t = value::time(value, self.plan.config.source_time_fallback, self.clock.now());
        let raw = value::number(value, &tag.meaning).ok();
        let newer = value.source_timestamp.is_some() && t.is_some_and(|t| state.series.is_newer(t));
        let sent = tag.sampling.deadband.lets_through(state.raw, raw);
        match t.filter(|_| newer && sent) {
            Some(t) if self.source_of(at) - t > self.plan.pace_s() => closer.hidden += 1,
            Some(_) => closer.lately += 1,
            None => self.live(at, value, sink),
        }
    }
}
