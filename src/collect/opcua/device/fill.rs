//! After a reconnect: the gap is read from the server's history, page by page.

use super::{Collector, Link, Lost};
use crate::collect::Sink;
use crate::collect::opcua::config::TimeFallback;
use crate::collect::opcua::value;
use opcua::types::{ByteString, DataValue, NodeId, StatusCode};
use tracing::{debug, info, warn};

/// History is asked from this long before the gap (s): tags are not stamped all at once.
const MARGIN_S: f64 = 60.0;
/// And up to this long after now (s): clocks differ.
const AHEAD_S: f64 = 60.0;
/// A source's clock that is further ahead than this (s) is wrong: a day, since some show local time.
const WRONG_S: f64 = 86_400.0;
/// Pages read of one node in one gap at most.
const MAX_PAGES: usize = 3000;
/// After so many sessions in a row that were lost while history was read, one goes on without it.
const MOST_LOST: u32 = 2;

/// What reading the history of some tags brought.
#[derive(Default)]
struct Filled {
    samples: u64,
    /// The tags of which it could not be read to its end.
    failed: Vec<usize>,
    /// The server did not give the service at all.
    refused: bool,
}

impl Collector {
    /// Reads what the server kept while nobody listened, oldest first.
    pub(super) async fn fill(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<(), Lost> {
        let config = &self.plan.config;
        let fills = config.fill_gaps || self.starting;
        let asked: Vec<usize> = (0..self.tags.len())
            .filter(|at| fills && self.tags[*at].gap && self.tags[*at].node.is_some())
            .filter(|at| self.starting || self.tags[*at].series.last().is_some())
            .collect();
        if !asked.is_empty() && self.dares() {
            self.fill_all(link, &asked, sink).await?;
        }
        self.starting = false;
        Ok(())
    }

    /// Whether this session reads history, as far as those before it lived through that; counts it as lost until it has.
    pub(super) fn dares(&mut self) -> bool {
        let lost = self.lost_filling;
        if lost >= MOST_LOST {
            warn!(device = %self.name(), "{lost} sessions in a row were lost while history was read: the gap stays");
            return false;
        }
        self.lost_filling += 1;
        true
    }

    /// From when to when history of these tags is asked for (s).
    pub(super) fn span(&self, asked: &[usize]) -> (f64, f64) {
        let steady = self.steady();
        let now = self.sources_at(steady);
        let longest = now - self.longest_gap();
        // At the start a tag may have nothing yet, and another one what the store had of it.
        let from = asked.iter().map(|at| self.tags[*at].gap_from.unwrap_or(longest)).fold(now, f64::min);
        let shown = asked.iter().filter_map(|at| self.tags[*at].source.running(steady));
        let to = shown.filter(|t| *t < now + WRONG_S).fold(now, f64::max);
        ((from - MARGIN_S).max(longest), to + AHEAD_S)
    }

    async fn fill_all(&mut self, link: &mut Link, asked: &[usize], sink: &dyn Sink) -> Result<(), Lost> {
        let (from, to) = self.span(asked);
        if self.starting {
            let seconds = to - AHEAD_S - from;
            info!(device = %self.name(), tags = asked.len(), seconds, "history of before the start is read");
        }
        let (mut samples, mut unfilled, mut refused) = (0, 0, false);
        for batch in asked.chunks(link.history_batch().max(1)) {
            if refused {
                unfilled += batch.len();
                continue;
            }
            let mut filled = self.fill_some(link, batch, (from, to), sink).await?;
            // Where something came it is asked for once anew, from the newest on.
            let again: Vec<usize> = filled.failed.iter().copied().filter(|at| !self.tags[*at].gap).collect();
            if !again.is_empty() {
                let newest = again.iter().filter_map(|at| self.tags[*at].series.last()).fold(to, f64::min);
                let rest = self.fill_some(link, &again, (newest, to), sink).await?;
                filled.failed.retain(|at| !again.contains(at) || rest.failed.contains(at));
                (filled.samples, filled.refused) = (filled.samples + rest.samples, rest.refused);
            }
            for at in batch {
                let failed = filled.failed.contains(at);
                self.tags[*at].filled(failed);
            }
            samples += filled.samples;
            unfilled += filled.failed.len();
            refused = filled.refused;
        }
        if samples == 0 && unfilled > 0 {
            info!(device = %self.name(), "the server gives no history: the gap stays");
        } else {
            info!(device = %self.name(), tags = asked.len(), samples, unfilled, "gap filled from history");
        }
        Ok(())
    }

    async fn fill_some(
        &mut self,
        link: &mut Link,
        batch: &[usize],
        (from, to): (f64, f64),
        sink: &dyn Sink,
    ) -> Result<Filled, Lost> {
        let mut filled = Filled::default();
        let mut open: Vec<(usize, ByteString)> = batch.iter().map(|at| (*at, ByteString::null())).collect();
        // Nodes with a continuation go on; one that gave none is asked again from its newest value on, since a server
        // may cap an answer without a word.
        let (mut start, mut later) = (from, Vec::<(usize, f64)>::new());
        for _ in 0..MAX_PAGES {
            let nodes: Vec<(NodeId, ByteString)> = open
                .iter()
                .filter_map(|(at, next)| Some((self.tags[*at].node.clone()?, next.clone())))
                .collect();
            if nodes.is_empty() || nodes.len() != open.len() {
                break;
            }
            let Some(pages) = link.history_if_any(&nodes, start, to).await? else {
                filled.refused = true;
                break;
            };
            let mut continued = Vec::new();
            for ((at, _), page) in open.into_iter().zip(pages) {
                if is_empty(page.status) {
                    continue;
                }
                if page.status.is_bad() {
                    debug!(device = %self.name(), tag = %self.plan.tags[at].name, "history: {}", page.status);
                    filled.failed.push(at);
                    continue;
                }
                let (news, newest) = self.take_page(at, page.values, to, sink);
                filled.samples += news;
                if !page.next.is_null_or_empty() {
                    continued.push((at, page.next));
                } else if newest > start {
                    later.push((at, newest));
                }
            }
            // Continuation points belong to the time they were asked with: those first, the others start anew.
            if continued.is_empty() {
                start = later.iter().map(|(_, newest)| *newest).fold(f64::INFINITY, f64::min);
                open = later.drain(..).map(|(at, _)| (at, ByteString::null())).collect();
            } else {
                open = continued;
            }
        }
        // What is open still, or was to be asked again, was not read to its end.
        filled.failed.extend(open.into_iter().map(|(at, _)| at).chain(later.into_iter().map(|(at, _)| at)));
        Ok(filled)
    }

    /// One page of one tag up to the time `to`; returns how many samples were news, and the time of its newest.
    pub(super) fn take_page(
        &mut self,
        at: usize,
        values: Vec<DataValue>,
        to: f64,
        sink: &dyn Sink,
    ) -> (u64, f64) {
        let mut page: Vec<(f64, DataValue)> = values
            .into_iter()
            .filter_map(|value| Some((value::time(&value, TimeFallback::Server, f64::NAN)?, value)))
            // A wrong stamp far ahead would leave no room for all that comes after it.
            .filter(|(t, _)| *t <= to)
            .collect();
        page.sort_by(|a, b| a.0.total_cmp(&b.0));
        let newest = page.last().map_or(f64::NEG_INFINITY, |(t, _)| *t);
        let mut news = 0;
        for (t, value) in page {
            let before = self.tags[at].series.end();
            if !self.tags[at].series.filled(t).is_news() {
                continue;
            }
            let gap = std::mem::take(&mut self.tags[at].gap);
            let since = self.tags[at].gap_from.replace(t);
            // Where its history begins later than the gap, the rest of it is still one.
            if let Some(before) = before.filter(|before| gap && self.is_late(at, t, since, *before)) {
                self.mark_gap(at, (before, since), t, sink);
            }
            let reading = value::reading(&value, &self.plan.tags[at].meaning);
            self.hand_over(at, t, reading, sink);
            news += 1;
        }
        self.health.filled(news);
        (news, newest)
    }

    /// Whether the first sample of a tag's history, of time `t`, leaves out more than its sampling explains (s).
    fn is_late(&self, at: usize, t: f64, since: Option<f64>, before: f64) -> bool {
        let sampling_s = self.plan.tags[at].sampling.every_ms as f64 / 1e3;
        t > since.map_or(before, |since| since.max(before)) + MARGIN_S + sampling_s
    }
}

impl super::State {
    /// Its history was read to its end, or not: then what is missing is still a gap. Where it had nothing new, the gap goes on.
    pub(super) fn filled(&mut self, failed: bool) {
        if failed {
            self.gap = true;
        } else if !self.gap {
            self.gap_from = None;
        }
    }
}

/// Whether a page of this status says that nothing was kept of that time.
fn is_empty(status: StatusCode) -> bool {
    status == StatusCode::BadNoData || status == StatusCode::BadBoundNotFound
}
