//! After a reconnect: the gap is read from the server's history, page by page, for as long as live values can wait.

use super::{Collector, Lost};
use crate::collect::Sink;
use crate::collect::opcua::config::TimeFallback;
use crate::collect::opcua::link::{Historian, Progress};
use crate::collect::opcua::listener::Events;
use crate::collect::opcua::value::Received;
use opcua::types::{ByteString, DataValue, NodeId, StatusCode};
use std::time::Duration;
use tokio::time::{Instant, sleep_until};
use tracing::{debug, info, warn};

/// History is asked from this long before the gap (s): tags are not stamped all at once.
const MARGIN_S: f64 = 60.0;
/// And up to this long after now (s): clocks differ.
const AHEAD_S: f64 = 60.0;
/// A source's clock that is further ahead than this (s) is wrong: a day, since some show local time.
const WRONG_S: f64 = 86_400.0;
/// Rounds over the nodes of one batch at most: enough for 31 days of a value a second in pages of 1,000.
const MAX_ROUNDS: usize = 3000;
/// Live values wait no longer than this for history that comes too slowly to be worth it.
const MOST_WAIT: Duration = Duration::from_secs(600);
/// And so much longer for each new sample of it: a server that gives 500 a second is read to its end.
const SAMPLE_WAIT: Duration = Duration::from_millis(2);
/// With many live values waiting, a server that has not answered for so long is not waited for.
const STALLED: Duration = Duration::from_secs(10);
/// Tags that a line of the log names; more are counted.
const MOST_NAMED: usize = 10;
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
    /// Why live values could wait no longer for this batch, if they could not.
    over: Option<&'static str>,
}

/// How long live values can wait; without events, as long as the history needs.
struct Patience<'e> {
    events: Option<&'e Events>,
    /// For all that is read.
    until: Instant,
    /// For the batch that is being read.
    batch_until: Instant,
    /// When the server last answered.
    answered: Instant,
}

impl<'e> Patience<'e> {
    fn new(events: Option<&'e Events>) -> Self {
        let now = Instant::now();
        Self { events, until: now + MOST_WAIT, batch_until: now + MOST_WAIT, answered: now }
    }

    /// A batch begins, and so many are left with it: each has the same part of the time that is left.
    fn begin(&mut self, left: usize) {
        let now = Instant::now();
        let each = self.until.saturating_duration_since(now).div_f64(left.max(1) as f64);
        self.batch_until = now + each;
    }

    /// The server answered with so many new samples, which are worth waiting for.
    fn answered(&mut self, news: u64) {
        self.answered = Instant::now();
        let more = SAMPLE_WAIT.mul_f64(news as f64);
        (self.until, self.batch_until) = (self.until + more, self.batch_until + more);
    }

    /// Ends when they can wait no longer, and says why.
    async fn over(&self) -> &'static str {
        let Some(events) = self.events else { return std::future::pending().await };
        let stalled = async {
            events.crowded().await;
            sleep_until(self.answered + STALLED).await;
        };
        tokio::select! {
            () = stalled => "many live values wait, and the server does not answer",
            () = sleep_until(self.batch_until) => "live values have waited for too long",
        }
    }
}

/// A tag whose history is being read.
struct Open {
    at: usize,
    /// Where its next page begins; null for the time that is asked from.
    next: ByteString,
    progress: Progress,
}

impl Open {
    fn new(at: usize) -> Self {
        Self { at, next: ByteString::null(), progress: Progress::default() }
    }
}

/// What is still to be read of one batch. Nodes with a continuation go on; one that gave none is asked again from its newest value
/// on, since a server may cap an answer without a word.
struct Batch {
    /// Asked next, from `start` (s) or where each goes on.
    open: Vec<Open>,
    start: f64,
    /// Asked in the next round, from the same time.
    continued: Vec<Open>,
    /// Asked from their newest values, when no other is left.
    later: Vec<Open>,
    rounds: usize,
}

impl Batch {
    fn new(tags: &[usize], start: f64) -> Self {
        let open = tags.iter().map(|at| Open::new(*at)).collect();
        Self { open, start, continued: Vec::new(), later: Vec::new(), rounds: 0 }
    }

    /// Goes on to the next round when this one is over; whether there is anything to ask.
    fn goes_on(&mut self) -> bool {
        if !self.open.is_empty() {
            return true;
        }
        self.rounds += 1;
        if self.rounds == MAX_ROUNDS {
            return false;
        }
        // Continuation points belong to the time they were asked with: those first, the others start anew.
        self.open = std::mem::take(&mut self.continued);
        if self.open.is_empty() {
            self.start = self.later.iter().map(|tag| tag.progress.newest).fold(f64::INFINITY, f64::min);
            self.open = self.later.drain(..).map(|tag| Open::new(tag.at)).collect();
        }
        !self.open.is_empty()
    }

    /// Those that were not read to their end.
    fn rest(self) -> impl Iterator<Item = usize> {
        self.open.into_iter().chain(self.continued).chain(self.later).map(|tag| tag.at)
    }
}

impl Collector {
    /// Reads what the server kept while nobody listened, oldest first, for as long as those who wait in `events` can; without them
    /// nobody waits.
    pub(super) async fn fill(
        &mut self,
        link: &mut impl Historian,
        events: Option<&Events>,
        sink: &dyn Sink,
    ) -> Result<(), Lost> {
        let config = &self.plan.config;
        let fills = config.fill_gaps || self.starting;
        let asked: Vec<usize> = (0..self.tags.len())
            .filter(|at| fills && self.tags[*at].gap && self.tags[*at].node.is_some())
            .filter(|at| self.starting || self.tags[*at].series.last().is_some())
            .collect();
        if !asked.is_empty() && self.dares() {
            self.fill_all(link, &asked, Patience::new(events), sink).await?;
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

    async fn fill_all(
        &mut self,
        link: &mut impl Historian,
        asked: &[usize],
        mut patience: Patience<'_>,
        sink: &dyn Sink,
    ) -> Result<(), Lost> {
        let (from, to) = self.span(asked);
        if self.starting {
            let seconds = to - AHEAD_S - from;
            info!(device = %self.name(), tags = asked.len(), seconds, "history of before the start is read");
        }
        let (mut samples, mut unfilled, mut refused, mut over) = (0, Vec::new(), false, None);
        let batches = asked.chunks(link.batch().max(1));
        let count = batches.len();
        for (done, batch) in batches.enumerate() {
            if refused {
                unfilled.extend_from_slice(batch);
                continue;
            }
            patience.begin(count - done);
            let mut filled = self.fill_some(link, batch, (from, to), &mut patience, sink).await?;
            // Where something came it is asked for once anew, from the newest on.
            let again: Vec<usize> = filled.failed.iter().copied().filter(|at| !self.tags[*at].gap).collect();
            if !again.is_empty() && filled.over.is_none() {
                let newest = again.iter().filter_map(|at| self.tags[*at].series.last()).fold(to, f64::min);
                let rest = self.fill_some(link, &again, (newest, to), &mut patience, sink).await?;
                filled.failed.retain(|at| !again.contains(at) || rest.failed.contains(at));
                filled.samples += rest.samples;
                (filled.refused, filled.over) = (rest.refused, rest.over);
            }
            for at in batch {
                let failed = filled.failed.contains(at);
                self.tags[*at].filled(failed);
            }
            samples += filled.samples;
            unfilled.append(&mut filled.failed);
            refused = filled.refused;
            over = over.or(filled.over);
        }
        let (missing, unfilled) = (self.names(&unfilled), unfilled.len());
        let missing = missing.as_deref();
        if let Some(why) = over {
            warn!(
                device = %self.name(), samples, unfilled, missing,
                "history is broken off, and the rest stays a gap: {why}"
            );
        } else if samples == 0 && unfilled > 0 {
            info!(device = %self.name(), missing, "the server gives no history: the gap stays");
        } else {
            info!(device = %self.name(), tags = asked.len(), samples, unfilled, missing, "gap filled from history");
        }
        Ok(())
    }

    /// The first of some tags by name, and how many more there are; `None` for none.
    fn names(&self, tags: &[usize]) -> Option<String> {
        let first = tags.iter().take(MOST_NAMED).map(|at| self.plan.tags[*at].name.as_str());
        let first: Vec<&str> = first.collect();
        let more = match tags.len().saturating_sub(MOST_NAMED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        (!first.is_empty()).then(|| first.join(", ") + &more)
    }

    async fn fill_some(
        &mut self,
        link: &mut impl Historian,
        tags: &[usize],
        (from, to): (f64, f64),
        patience: &mut Patience<'_>,
        sink: &dyn Sink,
    ) -> Result<Filled, Lost> {
        let (mut filled, mut batch) = (Filled::default(), Batch::new(tags, from));
        while batch.goes_on() {
            let node = |tag: &Open| Some((self.tags[tag.at].node.clone()?, tag.next.clone()));
            let Some(nodes) = batch.open.iter().map(node).collect::<Option<Vec<(NodeId, ByteString)>>>()
            else {
                break;
            };
            let answer = tokio::select! {
                biased;
                why = patience.over() => {
                    filled.over = Some(why);
                    break;
                }
                answer = link.ask(&nodes, batch.start, to) => answer?,
            };
            let Some(pages) = answer.filter(|pages| !pages.is_empty()) else {
                filled.refused = true;
                break;
            };
            // One answer is held at a time: what it brought is handed on before the next is asked for.
            let answered = pages.len().min(batch.open.len());
            let answered: Vec<Open> = batch.open.drain(..answered).collect();
            let before = filled.samples;
            for (mut tag, page) in answered.into_iter().zip(pages) {
                if is_empty(page.status) {
                    continue;
                }
                if page.status.is_bad() {
                    let name = &self.plan.tags[tag.at].name;
                    debug!(device = %self.name(), tag = %name, "history: {}", page.status);
                    filled.failed.push(tag.at);
                    continue;
                }
                tag.next = page.next;
                let (news, newest) = self.take_page(tag.at, page.values, to, sink);
                filled.samples += news;
                let leads_on = tag.progress.leads_on(newest);
                if tag.next.is_null_or_empty() {
                    if newest > batch.start {
                        batch.later.push(tag);
                    }
                } else if leads_on {
                    batch.continued.push(tag);
                } else {
                    let name = &self.plan.tags[tag.at].name;
                    debug!(device = %self.name(), tag = %name, "history: page after page brings nothing newer");
                    filled.failed.push(tag.at);
                }
            }
            patience.answered(filled.samples - before);
        }
        filled.failed.extend(batch.rest());
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
        let meaning = &self.plan.tags[at].meaning;
        let mut page: Vec<(f64, Received)> = values
            .into_iter()
            .map(|value| Received::of(&value, meaning))
            .filter_map(|value| Some((value.time(TimeFallback::Server, f64::NAN)?, value)))
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
            let reading = value.reading(&self.plan.tags[at].meaning);
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
