//! A server's history of some tags, slice by slice: what one slice brought is kept before the next is asked for, so that
//! whoever keeps it can go on where it was left. A slice that brings too much, or takes too long, is read in parts.

use super::config::TimeFallback;
use super::link::{Historian, Link, Lost, Page, Progress};
use super::pins::{Pinned, ServerPins};
use super::plan::{Plan, Tag};
use super::value::Received;
use crate::collect::backoff::Backoff;
use crate::signal::Sample;
use opcua::types::{ByteString, NodeId};
use rand::SeedableRng;
use rand_pcg::Pcg32;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep};
use tracing::{info, warn};

/// First pause before a lost session is opened again.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// Attempts in a row that bring nothing, after which it is given up.
const ATTEMPTS: u32 = 20;
/// Samples of all tags that are held at once at most: 24 bytes each, and half as much again while a list of them grows.
const MOST_SAMPLES: usize = 500_000;
/// Longest that a server is waited for while it gives what one tag has of one part.
const MOST_WAIT: Duration = Duration::from_secs(600);
/// A part with this share of the samples and of the time that are too much is followed by one twice as long: that is well below, too.
const LIGHT: f64 = 0.125;
/// A slice is not divided any further (s).
const LEAST_S: f64 = 1.0;
/// A part longer by this (s) is as long: times of today have steps of 2.4e-7 s.
const ROUNDING_S: f64 = 1e-3;

/// What is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wish {
    /// From this time on (s).
    pub from: f64,
    /// Up to and without this time (s).
    pub to: f64,
    /// The latest slice first.
    pub newest_first: bool,
    /// Time that one slice spans (s).
    pub slice_s: f64,
    /// Rest between two requests, which the server has for others.
    pub pause: Duration,
    /// Means over so many seconds, made by the server, rather than what it stored.
    pub average_s: Option<f64>,
}

impl Wish {
    /// The slices, in the order they are read.
    pub fn slices(&self) -> impl Iterator<Item = (f64, f64)> + use<> {
        let Wish { from, to, slice_s, newest_first, .. } = *self;
        let count = ((to - from) / slice_s).ceil().clamp(0.0, 1e9) as u64;
        (0..count).map(move |at| {
            let k = at as f64;
            if newest_first {
                ((to - (k + 1.0) * slice_s).max(from), to - k * slice_s)
            } else {
                (from + k * slice_s, (from + (k + 1.0) * slice_s).min(to))
            }
        })
    }

    /// The same without what lies on the read side of `done` (s).
    pub fn after(self, done: f64) -> Self {
        if self.newest_first {
            Self { to: done.min(self.to), ..self }
        } else {
            Self { from: done.max(self.from), ..self }
        }
    }
}

/// What one slice brought, or a part of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Slice {
    /// Begin (s).
    pub from: f64,
    /// End (s).
    pub to: f64,
    /// Samples of each tag by its number, by time.
    pub series: Vec<(usize, Vec<Sample>)>,
    /// It is the whole slice, or the last part of it.
    pub is_last: bool,
}

/// Takes slices.
pub trait Keep: Send {
    /// Keeps a slice; the next is asked for when it is kept.
    fn keep(&mut self, slice: Slice) -> impl Future<Output = Result<(), String>> + Send;
}

/// Why there is no (more) history.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HistoryError {
    /// The server is there and has none.
    #[error("{0}: the server gives no {1}")]
    None(String, &'static str),
    /// A tag is not there.
    #[error("{0}: {1}")]
    Tag(String, String),
    /// No session.
    #[error("{0}: {1}")]
    Lost(String, String),
    /// What came could not be kept.
    #[error("what was read cannot be kept: {0}")]
    Kept(String),
}

/// Reads the history of the plan's tags and has it kept. A session that is lost is opened again and the slice, or the part
/// of it, begun anew. Plain numbers are the namespaces that all who share `pinned` take them for.
///
/// # Errors
/// [`HistoryError`]; what was kept stays.
pub async fn history(
    plan: &Plan,
    wish: &Wish,
    pinned: &Pinned,
    keep: &mut impl Keep,
) -> Result<(), HistoryError> {
    let mut rest = rest_of(wish);
    let longest = Duration::from_millis(plan.config.reconnect_max_ms);
    let mut backoff = Backoff::new(FIRST_PAUSE.min(longest), longest, Pcg32::seed_from_u64(1));
    let (mut failures, config) = (0, Arc::new(plan.config.clone()));
    let pins = pinned.of(&config.url);
    while rest.part().is_some() {
        let ended = match Link::open(config.clone()).await {
            Ok(link) => {
                let before = rest.next;
                let ended = session(link, plan, wish, &pins, &mut rest, keep).await;
                if before != rest.next {
                    backoff.reset();
                    failures = 0;
                }
                ended
            }
            Err(lost) => Err(Ended::Lost(lost)),
        };
        match ended {
            Ok(()) => {}
            Err(Ended::For(error)) => return Err(error),
            Err(Ended::Lost(lost)) => {
                failures += 1;
                if failures == ATTEMPTS || matches!(lost, Lost::Untrusted(_)) {
                    return Err(HistoryError::Lost(config.name.clone(), lost.to_string()));
                }
                warn!(device = %config.name, "history: {lost}");
                sleep(backoff.failed(Instant::now())).await;
            }
        }
    }
    Ok(())
}

/// What is still to be read, in the order it is read.
struct Rest<I> {
    slices: I,
    /// What is left of a slice that was begun, else the next one (s).
    next: Option<(f64, f64)>,
    newest_first: bool,
    /// Longest time that is asked for at once (s).
    part_s: f64,
    /// It is a whole number of these (s), so that every mean is over the same time as without parts.
    step_s: f64,
}

/// All of a wish.
fn rest_of(wish: &Wish) -> Rest<impl Iterator<Item = (f64, f64)> + use<>> {
    let mut slices = wish.slices();
    let next = slices.next();
    let step_s = wish.average_s.unwrap_or(LEAST_S);
    Rest { slices, next, newest_first: wish.newest_first, part_s: f64::INFINITY, step_s }
}

impl<I: Iterator<Item = (f64, f64)>> Rest<I> {
    /// The next part (s).
    fn part(&self) -> Option<(f64, f64)> {
        let (from, to) = self.next?;
        Some(match (to - from > self.part_s + ROUNDING_S, self.newest_first) {
            (false, _) => (from, to),
            (true, true) => (to - self.part_s, to),
            (true, false) => (from, from + self.part_s),
        })
    }

    /// What is left of the slice after this part of it, if anything is (s).
    fn left(&self, part: (f64, f64)) -> Option<(f64, f64)> {
        let (from, to) = self.next?;
        let left = if self.newest_first { (from, part.0) } else { (part.1, to) };
        (left.1 > left.0).then_some(left)
    }

    /// A part was kept. Where it was `light`, the next ones are longer: what was too much may have been an hour of many.
    fn kept(&mut self, part: (f64, f64), light: bool) {
        if light && part.1 - part.0 > self.part_s - ROUNDING_S {
            self.part_s *= 2.0;
        }
        self.next = self.left(part).or_else(|| self.slices.next());
    }

    /// A part was too long: the next ones are at most half as long. `false` where there is nothing shorter.
    fn divide(&mut self, part: (f64, f64)) -> bool {
        let span_s = part.1 - part.0;
        let half_s = (span_s / 2.0 / self.step_s).floor().max(1.0) * self.step_s;
        let is_shorter = span_s > half_s + ROUNDING_S;
        if is_shorter {
            self.part_s = half_s;
        }
        is_shorter
    }
}

/// Why a session brings no more.
#[derive(Debug)]
enum Ended {
    Lost(Lost),
    For(HistoryError),
}

impl From<Lost> for Ended {
    fn from(lost: Lost) -> Self {
        Self::Lost(lost)
    }
}

/// Asks a server as a wish says.
struct Asked<'l> {
    link: &'l mut Link,
    average_s: Option<f64>,
}

impl Historian for Asked<'_> {
    fn batch(&self) -> usize {
        1
    }

    async fn ask(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        from: f64,
        to: f64,
    ) -> Result<Option<Vec<Page>>, Lost> {
        match self.average_s {
            Some(every_s) => self.link.means(nodes, from, to, every_s).await,
            None => self.link.history(nodes, from, to).await,
        }
    }
}

/// Reads over one session until it is lost, or all is read.
async fn session(
    mut link: Link,
    plan: &Plan,
    wish: &Wish,
    pins: &ServerPins,
    rest: &mut Rest<impl Iterator<Item = (f64, f64)>>,
    keep: &mut impl Keep,
) -> Result<(), Ended> {
    let places: Vec<_> = plan.tags.iter().map(|tag| tag.place.clone()).collect();
    let mut tags = Vec::with_capacity(places.len());
    for (tag, found) in plan.tags.iter().zip(link.resolve(&places, pins).await?) {
        let node = found.map_err(|why| Ended::For(HistoryError::Tag(tag.name.clone(), why)))?;
        tags.push((tag, node));
    }
    let mut asked = Asked { link: &mut link, average_s: wish.average_s };
    while let Some((from, to)) = rest.part() {
        let began = Instant::now();
        let series = match part(&mut asked, &tags, wish, (from, to)).await? {
            Read::Whole(series) => series,
            Read::TooMuch(..) if rest.divide((from, to)) => continue,
            Read::TooMuch(tag, why) => {
                let why = format!(
                    "history: {why} for {} s of it, and it cannot be asked for in shorter parts",
                    to - from
                );
                return Err(Ended::For(HistoryError::Tag(tag, why)));
            }
        };
        let samples: usize = series.iter().map(|(_, samples)| samples.len()).sum();
        info!(device = %plan.config.name, from, to, samples, "history read");
        let light =
            samples as f64 <= LIGHT * MOST_SAMPLES as f64 && began.elapsed() <= MOST_WAIT.mul_f64(LIGHT);
        let is_last = rest.left((from, to)).is_none();
        let slice = Slice { from, to, series, is_last };
        keep.keep(slice).await.map_err(|error| Ended::For(HistoryError::Kept(error)))?;
        rest.kept((from, to), light);
    }
    Ok(())
}

/// What was read of some time.
#[derive(Debug, PartialEq)]
enum Read<T> {
    Whole(T),
    /// It is to be read in shorter parts: of which tag there was too much, and of what.
    TooMuch(String, String),
}

/// The samples of all tags of `from..to`.
async fn part(
    asked: &mut impl Historian,
    tags: &[(&Tag, NodeId)],
    wish: &Wish,
    span: (f64, f64),
) -> Result<Read<Vec<(usize, Vec<Sample>)>>, Ended> {
    let (mut series, mut room) = (Vec::with_capacity(tags.len()), MOST_SAMPLES);
    for (tag, node) in tags {
        match one(asked, tag, node, wish, span, room).await? {
            Read::Whole(samples) => {
                room -= samples.len().min(room);
                series.push((tag.index, samples));
            }
            Read::TooMuch(tag, why) => return Ok(Read::TooMuch(tag, why)),
        }
    }
    Ok(Read::Whole(series))
}

/// One tag's samples of `from..to`, over continuation points, or page by page where a server caps its answers; at most so many as
/// there is `room` for.
async fn one(
    asked: &mut impl Historian,
    tag: &Tag,
    node: &NodeId,
    wish: &Wish,
    (from, to): (f64, f64),
    room: usize,
) -> Result<Read<Vec<Sample>>, Ended> {
    let what = if wish.average_s.is_some() { "means of this tag" } else { "history" };
    let wrong = |why: String| Ended::For(HistoryError::Tag(tag.name.clone(), why));
    let (mut found, mut waited) = (Vec::<Sample>::new(), Duration::ZERO);
    let (mut start, mut next, mut progress) = (from, ByteString::null(), Progress::default());
    loop {
        let began = Instant::now();
        let pages = asked.ask(&[(node.clone(), next)], start, to).await?;
        waited += began.elapsed();
        let none = || Ended::For(HistoryError::None(tag.name.clone(), what));
        let page = pages.and_then(|mut pages| pages.pop()).ok_or_else(none)?;
        if page.status.is_bad() {
            return Err(wrong(format!("history: {}", page.status)));
        }
        let mut newest = f64::NEG_INFINITY;
        for value in page.values {
            let value = Received::of(&value, &tag.meaning);
            let Some(t) = value.time(TimeFallback::Server, f64::NAN).filter(|t| *t < to) else { continue };
            newest = newest.max(t);
            if t >= from {
                let reading = value.reading(&tag.meaning);
                found.push(Sample { t, value: reading.value, quality: reading.quality });
            }
        }
        if found.len() > room {
            let many = format!("the tags have more than {MOST_SAMPLES} values");
            return Ok(Read::TooMuch(tag.name.clone(), many));
        }
        if waited > MOST_WAIT {
            let long = format!("the server needs more than {} s", MOST_WAIT.as_secs());
            return Ok(Read::TooMuch(tag.name.clone(), long));
        }
        sleep(wish.pause).await;
        let leads_on = progress.leads_on(newest);
        let more = !page.next.is_null_or_empty();
        if more && !leads_on {
            return Err(wrong("history: page after page brings nothing newer".to_string()));
        }
        if !more && (newest <= start || wish.average_s.is_some()) {
            break;
        }
        // A continuation point belongs to the time it was asked with.
        (start, next) = if more { (start, page.next) } else { (newest, ByteString::null()) };
    }
    found.sort_by(|a, b| a.t.total_cmp(&b.t));
    found.dedup_by(|later, earlier| later.t == earlier.t);
    Ok(Read::Whole(found))
}

#[cfg(test)]
#[path = "history_tests.rs"]
mod tests;
