//! A subscription: what it brings, and whether it still brings anything.

use super::{Collector, Link, Lost, Never, RETRY};
use crate::collect::Sink;
use crate::collect::opcua::listener::{Event, Events};
use crate::collect::opcua::plan::Sampling;
use crate::collect::opcua::value::Received;
use opcua::types::NodeId;
use std::time::Duration;
use tokio::time::{Instant, Interval};

/// What reading tells of a subscription that brings nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Closer {
    /// Values that changed, and that it had to bring.
    pub(super) hidden: usize,
    /// Values that changed so lately that they may still be on their way.
    pub(super) lately: usize,
}

/// What happened to a subscription.
#[derive(Debug)]
pub(super) enum Next {
    /// Something came; `None` when nothing can come any more.
    Event(Option<Event>),
    /// A period is over.
    Tick,
}

/// An event or a tick, at random where there is both: neither a flood of values nor ticks that take long keep the other waiting.
pub(super) async fn next(events: &mut Events, ticks: &mut Interval) -> Next {
    tokio::select! {
        event = events.recv() => Next::Event(event),
        _ = ticks.tick() => Next::Tick,
    }
}

/// A subscription, and what it still owes.
struct Subscription {
    id: u32,
    events: Events,
    /// When it last brought something, or reading showed that there was nothing to bring.
    heard: Instant,
    /// Since when something has changed that it has not brought, and how many values.
    due: Option<(Instant, usize)>,
    /// When nodes that were refused were last tried again.
    retried: Instant,
}

impl Collector {
    pub(super) async fn listen(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<Never, Lost> {
        let meanings = self.plan.tags.iter().map(|tag| tag.meaning.clone()).collect();
        let (id, events) = link.subscribe(meanings).await?;
        self.monitor(link, id, sink).await?;
        // What the subscription brings meanwhile waits in its queue: history comes first, as long as there is room.
        self.fill(link, Some(&events), sink).await?;
        let now = Instant::now();
        let mut own = Subscription { id, events, heard: now, due: None, retried: now };
        let mut ticks = self.ticks();
        loop {
            tokio::select! {
                biased;
                next = next(&mut own.events, &mut ticks) => match next {
                    Next::Event(Some(Event::Value(at, value))) => {
                        (own.heard, own.due) = (Instant::now(), None);
                        self.live(at, &value, sink);
                    }
                    Next::Event(Some(Event::Ended(status))) => {
                        return Err(Lost::Broken(format!("the server ended the subscription: {status}")));
                    }
                    Next::Event(None) => return Err(Lost::Broken("the subscription is gone".into())),
                    Next::Tick => self.tick(link, &mut own, sink).await?,
                },
                // What came before the end is taken first.
                () = link.ended() => return Err(Lost::Broken("the server ended the session".into())),
            }
        }
    }

    /// A period is over: looks whether the subscription still brings what it has to.
    async fn tick(&mut self, link: &mut Link, own: &mut Subscription, sink: &dyn Sink) -> Result<(), Lost> {
        if let Some(lost) = self.overflowed(&mut own.events, sink) {
            return Err(lost);
        }
        let silence = Duration::from_secs_f64(self.plan.silence_s());
        let pace = Duration::from_secs_f64(self.plan.pace_s());
        match own.due {
            // What waits here was brought.
            _ if !own.events.is_empty() => {}
            Some((since, changed)) if since.elapsed() > pace => return Err(self.silent(changed)),
            Some(_) => {}
            None if own.heard.elapsed() > silence => match self.listen_closer(link, sink).await? {
                Closer { hidden, .. } if hidden > 0 => return Err(self.silent(hidden)),
                Closer { lately, .. } if lately > 0 => own.due = Some((Instant::now(), lately)),
                _ => own.heard = Instant::now(),
            },
            None => {}
        }
        if own.retried.elapsed() > RETRY {
            self.monitor(link, own.id, sink).await?;
            own.retried = Instant::now();
        }
        // Live values go on: this session has lived through its history.
        self.lost_filling = 0;
        self.repeat_frozen(sink);
        self.end_round(sink, Duration::ZERO);
        Ok(())
    }

    /// Where values found no room: takes those that came before, and says why the session is lost. The next one reads from history
    /// what has come since the first that was dropped.
    pub(super) fn overflowed(&mut self, events: &mut Events, sink: &dyn Sink) -> Option<Lost> {
        let (since, _) = events.dropped()?;
        while let Some(event) = events.take() {
            if let Event::Value(at, value) = event {
                self.live(at, &value, sink);
            }
        }
        let (_, dropped) = events.dropped()?;
        // They were taken late: what is missing begins where the first was dropped.
        self.heard_at = since.saturating_duration_since(self.born).as_secs_f64();
        // This session has lived through its history.
        self.lost_filling = 0;
        Some(Lost::Broken(format!("{dropped} values came faster than they could be taken")))
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
        let values = self.read(link).await?;
        // What has not changed does not tell when the subscription died.
        let (heard_at, mut closer) = (self.heard_at, Closer::default());
        for (at, value) in values {
            self.look(at, &value, &mut closer, sink);
        }
        if closer != Closer::default() {
            self.heard_at = heard_at;
        }
        Ok(closer)
    }

    /// One value that was read because nothing came. What the subscription has to bring is left to it: when it is dead, the
    /// next session reads from history what was before that value too.
    pub(super) fn look(&mut self, at: usize, value: &Received, closer: &mut Closer, sink: &dyn Sink) {
        let (state, tag) = (&self.tags[at], &self.plan.tags[at]);
        let t = value.time(self.plan.config.source_time_fallback, self.clock.now());
        let raw = value.number.as_ref().ok().copied();
        let newer = value.source.is_some() && t.is_some_and(|t| state.series.is_newer(t));
        let sent = tag.sampling.deadband.lets_through(state.raw, raw);
        match t.filter(|_| newer && sent) {
            Some(t) if self.source_of(at) - t > self.plan.pace_s() => closer.hidden += 1,
            Some(_) => closer.lately += 1,
            None => self.live(at, value, sink),
        }
    }
}
