//! The sources' clocks, and the marks that say by them why there is no value.

use super::{Collector, STEP_S, State};
use crate::collect::opcua::value::Received;
use crate::collect::{Reading, Sink};
use crate::signal::{BadReason, Quality};
use std::time::Duration;
use tracing::warn;

impl Collector {
    /// A time that nobody sets (s).
    pub(super) fn steady(&self) -> f64 {
        self.born.elapsed().as_secs_f64()
    }

    /// What the sources' clocks showed at `steady` (s): the middle one, since one wrong stamp is to move nothing; ours where
    /// none is known to run.
    pub(super) fn sources_at(&self, steady: f64) -> f64 {
        let mut shown: Vec<f64> = self.tags.iter().filter_map(|tag| tag.source.running(steady)).collect();
        shown.sort_by(f64::total_cmp);
        let middle = shown.get(shown.len().saturating_sub(1) / 2).copied();
        middle.unwrap_or_else(|| self.clock.now() - (self.steady() - steady))
    }

    /// The time that one tag's source shows now (s), whatever is done to our clock.
    pub(super) fn source_of(&self, at: usize) -> f64 {
        let steady = self.steady();
        self.tags[at].source.running(steady).unwrap_or_else(|| self.sources_at(steady))
    }

    /// When a value came that has no usable stamp of its own: by the clock of its source where that runs, since the server's
    /// may be ahead of it.
    pub(super) fn came(&self, at: usize, value: &Received) -> f64 {
        let steady = self.steady();
        let source = self.tags[at].source.running(steady);
        source.or(value.server).unwrap_or_else(|| self.sources_at(steady))
    }

    /// A session has ended: from now on something is missing of every tag, unless it was before.
    pub(super) fn left(&mut self) {
        let heard = self.heard_at;
        let shared = self.sources_at(heard);
        // Of before the start everything is missing since what there is.
        let starting = self.starting;
        for tag in &mut self.tags {
            tag.gap = true;
            if !starting && tag.gap_from.is_none() {
                tag.gap_from = Some(tag.source.running(heard).unwrap_or(shared));
            }
        }
    }

    /// Nobody is there. While the gap may still be filled nothing is handed on, since a ring only goes forward.
    pub(super) fn down_tick(&mut self, sink: &dyn Sink) {
        let steady = self.steady();
        let shared = self.sources_at(steady);
        // At the start the past is read whatever is done about gaps.
        let (fills, longest) = (self.plan.config.fill_gaps || self.starting, self.longest_gap());
        let begins = self.starting && steady <= longest;
        for at in 0..self.tags.len() {
            let tag = &mut self.tags[at];
            let now = tag.source.running(steady).unwrap_or(shared);
            // Before the first value there is no time line to mark.
            let waits = begins || tag.series.last().is_none_or(|last| fills && now - last <= longest);
            if !waits && tag.series.mark(now) {
                self.hand_over(at, now, Reading::bad(BadReason::LinkDown), sink);
            } else {
                self.round.bad += 1;
            }
        }
        self.end_round(sink, Duration::ZERO);
    }

    /// The server is alive and refuses this node.
    pub(super) fn refused(&mut self, at: usize, why: &str, sink: &dyn Sink) {
        self.health.refused();
        if !std::mem::replace(&mut self.tags[at].refused, true) {
            warn!(device = %self.name(), tag = %self.plan.tags[at].name, "{why}");
        }
        // A clock that is not believed yet may be behind the last sample: the first mark comes behind that.
        let end = self.tags[at].series.end().filter(|_| !self.tags[at].marked);
        let now = end.map_or(self.source_of(at), |end| self.source_of(at).max(end + STEP_S));
        if self.tags[at].series.mark(now) {
            self.hand_over(at, now, Reading::bad(BadReason::DeviceException), sink);
        }
    }

    /// Between the sample of time `before` and the one of time `t` something is missing, and since when may be known: say so,
    /// rather than have them joined by a straight line.
    pub(super) fn mark_gap(
        &mut self,
        at: usize,
        (before, since): (f64, Option<f64>),
        t: f64,
        sink: &dyn Sink,
    ) {
        let begin = since.filter(|since| *since > before && *since < t).unwrap_or(before);
        self.hand_over(at, begin + (t - begin) / 2.0, Reading::bad(BadReason::LinkDown), sink);
    }

    /// Values that have not changed for too long, though the session lives. A server that tells of changes alone says nothing
    /// of them, so each is handed on once more.
    pub(super) fn repeat_frozen(&mut self, sink: &dyn Sink) {
        if !self.tags.iter().any(State::may_be_frozen) {
            return;
        }
        let steady = self.steady();
        // What changed lately may still be on its way.
        let (shared, pace_s) = (self.sources_at(steady), self.plan.pace_s());
        for at in 0..self.tags.len() {
            let tag = &mut self.tags[at];
            if !tag.may_be_frozen() {
                continue;
            }
            let t = tag.source.running(steady).unwrap_or(shared) - pace_s - STEP_S;
            let Some(value) = tag.frozen.as_mut().and_then(|frozen| frozen.unchanged(t)) else { continue };
            if tag.series.repeat(t) {
                self.hand_over(at, t, Reading { value, quality: Quality::Stale }, sink);
            }
        }
    }

    /// Sets the clock of a tag's source by a sample that just came, and says so when it has jumped.
    pub(super) fn heard(&mut self, at: usize, t: f64, set_back: bool) {
        let (steady, ours) = (self.steady(), self.clock.now());
        if let Some(by_s) = self.tags[at].source.heard(t, steady, ours, set_back) {
            self.health.clock_jumped();
            let tag = &self.plan.tags[at].name;
            warn!(device = %self.name(), %tag, t, by_s, "the source's clock was set");
        }
    }
}

impl State {
    /// Whether it is watched for a value that stays the same, and has one.
    fn may_be_frozen(&self) -> bool {
        self.frozen.is_some() && self.good && !self.gap
    }
}
