//! After a reconnect: the gap is read from the server's history, page by page.

use super::{Collector, Link, Lost};
use crate::collect::Sink;
use crate::collect::opcua::config::TimeFallback;
use crate::collect::opcua::value;
use opcua::types::{ByteString, DataValue, NodeId};
use tracing::{debug, info};

/// History is asked from this long before the newest sample of the server (s): tags are not stamped all at once.
const MARGIN_S: f64 = 60.0;
/// And up to this long after now (s): clocks differ.
const AHEAD_S: f64 = 60.0;
/// Pages read of one node in one gap at most.
const MAX_PAGES: usize = 3000;

impl Collector {
    /// Reads what the server kept while nobody listened, oldest first.
    pub(super) async fn fill(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<(), Lost> {
        let config = &self.plan.config;
        let now = self.source_now();
        let newest = self.tags.iter().filter_map(|tag| tag.series.last()).fold(f64::NEG_INFINITY, f64::max);
        let fills = config.fill_gaps || self.starting;
        let asked: Vec<usize> = (0..self.tags.len())
            .filter(|at| fills && self.tags[*at].gap && self.tags[*at].node.is_some())
            .filter(|at| self.starting || self.tags[*at].series.last().is_some())
            .collect();
        let longest = now - self.longest_gap();
        // At the start a tag may have nothing yet, and another one what the store had of it.
        let oldest =
            asked.iter().map(|at| self.tags[*at].series.last().unwrap_or(longest)).fold(newest, f64::min);
        let from = (if self.starting { oldest } else { newest } - MARGIN_S).max(longest);
        if self.starting && !asked.is_empty() {
            info!(device = %self.name(), tags = asked.len(), seconds = now - from, "history of before the start is read");
        }
        let mut filled = 0;
        for batch in asked.chunks(link.history_batch().max(1)) {
            match self.fill_some(link, batch, (from, now + AHEAD_S), sink).await? {
                Some(samples) => filled += samples,
                None => {
                    self.starting = false;
                    info!(device = %self.name(), "the server gives no history: the gap stays");
                    return Ok(());
                }
            }
        }
        self.starting = false;
        if !asked.is_empty() {
            info!(device = %self.name(), tags = asked.len(), samples = filled, "gap filled from history");
        }
        Ok(())
    }

    async fn fill_some(
        &mut self,
        link: &mut Link,
        batch: &[usize],
        (from, to): (f64, f64),
        sink: &dyn Sink,
    ) -> Result<Option<u64>, Lost> {
        let mut filled = 0;
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
            let Some(pages) = link.history(&nodes, start, to).await? else { return Ok(None) };
            let mut continued = Vec::new();
            for ((at, _), page) in open.into_iter().zip(pages) {
                if page.status.is_bad() {
                    debug!(device = %self.name(), tag = %self.plan.tags[at].name, "history: {}", page.status);
                    continue;
                }
                let (news, newest) = self.take_page(at, page.values, sink);
                filled += news;
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
        Ok(Some(filled))
    }

    /// One page of one tag; returns how many samples were news, and the time of its newest.
    fn take_page(&mut self, at: usize, values: Vec<DataValue>, sink: &dyn Sink) -> (u64, f64) {
        let mut page: Vec<(f64, DataValue)> = values
            .into_iter()
            .filter_map(|value| Some((value::time(&value, TimeFallback::Server, f64::NAN)?, value)))
            .collect();
        page.sort_by(|a, b| a.0.total_cmp(&b.0));
        let newest = page.last().map_or(f64::NEG_INFINITY, |(t, _)| *t);
        let mut news = 0;
        for (t, value) in page {
            if self.tags[at].series.filled(t).is_news() {
                let reading = value::reading(&value, &self.plan.tags[at].meaning);
                self.hand_over(at, t, reading, sink);
                self.tags[at].gap = false;
                news += 1;
            }
        }
        self.health.filled(news);
        (news, newest)
    }
}
