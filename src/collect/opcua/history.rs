//! A server's history of some tags, slice by slice: what one slice brought is kept before the next is asked for, so that
//! whoever keeps it can go on where it was left.

use super::config::TimeFallback;
use super::link::{Link, Lost};
use super::pins::{Pinned, ServerPins};
use super::plan::{Plan, Tag};
use super::value;
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
/// Values of one tag in one slice at most.
const MAX_VALUES: usize = 10_000_000;

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

/// What one slice brought.
#[derive(Clone, Debug, PartialEq)]
pub struct Slice {
    /// Begin (s).
    pub from: f64,
    /// End (s).
    pub to: f64,
    /// Samples of each tag by its number, by time.
    pub series: Vec<(usize, Vec<Sample>)>,
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

/// Reads the history of the plan's tags and has it kept. A session that is lost is opened again and the slice begun anew. Plain
/// numbers are the namespaces that all who share `pinned` take them for.
///
/// # Errors
/// [`HistoryError`]; what was kept stays.
pub async fn history(
    plan: &Plan,
    wish: &Wish,
    pinned: &Pinned,
    keep: &mut impl Keep,
) -> Result<(), HistoryError> {
    let mut slices = wish.slices();
    let mut next = slices.next();
    let longest = Duration::from_millis(plan.config.reconnect_max_ms);
    let mut backoff = Backoff::new(FIRST_PAUSE.min(longest), longest, Pcg32::seed_from_u64(1));
    let (mut failures, config) = (0, Arc::new(plan.config.clone()));
    let pins = pinned.of(&config.url);
    while next.is_some() {
        let ended = match Link::open(config.clone()).await {
            Ok(link) => {
                let before = next;
                let session = Session { plan, wish, link, pins: &pins };
                let ended = session.read(&mut next, &mut slices, keep).await;
                if before != next {
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

/// Why a session brings no more.
enum Ended {
    Lost(Lost),
    For(HistoryError),
}

impl From<Lost> for Ended {
    fn from(lost: Lost) -> Self {
        Self::Lost(lost)
    }
}

struct Session<'p> {
    plan: &'p Plan,
    wish: &'p Wish,
    link: Link,
    pins: &'p ServerPins,
}

impl Session<'_> {
    async fn read(
        mut self,
        next: &mut Option<(f64, f64)>,
        slices: &mut impl Iterator<Item = (f64, f64)>,
        keep: &mut impl Keep,
    ) -> Result<(), Ended> {
        let places: Vec<_> = self.plan.tags.iter().map(|tag| tag.place.clone()).collect();
        let mut nodes = Vec::with_capacity(places.len());
        for (tag, found) in self.plan.tags.iter().zip(self.link.resolve(&places, self.pins).await?) {
            nodes.push(found.map_err(|why| Ended::For(HistoryError::Tag(tag.name.clone(), why)))?);
        }
        while let Some((from, to)) = *next {
            let mut series = Vec::with_capacity(nodes.len());
            for (tag, node) in self.plan.tags.iter().zip(&nodes) {
                series.push((tag.index, self.tag(tag, node, from, to).await?));
            }
            let samples: usize = series.iter().map(|(_, samples)| samples.len()).sum();
            info!(device = %self.plan.config.name, from, to, samples, "history read");
            keep.keep(Slice { from, to, series })
                .await
                .map_err(|error| Ended::For(HistoryError::Kept(error)))?;
            *next = slices.next();
        }
        Ok(())
    }

    /// One tag's samples of `from..to`, over continuation points, or page by page where a server caps its answers.
    async fn tag(&mut self, tag: &Tag, node: &NodeId, from: f64, to: f64) -> Result<Vec<Sample>, Ended> {
        let mut found: Vec<Sample> = Vec::new();
        let (mut start, mut next) = (from, ByteString::null());
        loop {
            let asked = [(node.clone(), next)];
            let (pages, what) = match self.wish.average_s {
                Some(every_s) => (self.link.means(&asked, start, to, every_s).await?, "means of this tag"),
                None => (self.link.history(&asked, start, to).await?, "history"),
            };
            let none = || Ended::For(HistoryError::None(tag.name.clone(), what));
            let page = pages.and_then(|mut pages| pages.pop()).ok_or_else(none)?;
            if page.status.is_bad() {
                let status = format!("history: {}", page.status);
                return Err(Ended::For(HistoryError::Tag(tag.name.clone(), status)));
            }
            let mut newest = start;
            for value in page.values {
                let Some(t) = value::time(&value, TimeFallback::Server, f64::NAN) else { continue };
                newest = newest.max(t);
                if t >= from && t < to {
                    let reading = value::reading(&value, &tag.meaning);
                    found.push(Sample { t, value: reading.value, quality: reading.quality });
                }
            }
            sleep(self.wish.pause).await;
            if found.len() > MAX_VALUES {
                let many = format!("more than {MAX_VALUES} values in {} s", to - from);
                return Err(Ended::For(HistoryError::Tag(tag.name.clone(), many)));
            }
            let more = !page.next.is_null_or_empty();
            if !more && (newest <= start || self.wish.average_s.is_some()) {
                break;
            }
            // A continuation point belongs to the time it was asked with.
            (start, next) = if more { (start, page.next) } else { (newest, ByteString::null()) };
        }
        found.sort_by(|a, b| a.t.total_cmp(&b.t));
        found.dedup_by(|later, earlier| later.t == earlier.t);
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_cover_the_wish_once_and_go_on_where_they_were_left() {
        let wish = Wish {
            from: 10.0,
            to: 35.0,
            newest_first: false,
            slice_s: 10.0,
            pause: Duration::ZERO,
            average_s: None,
        };
        let of = |wish: Wish| wish.slices().collect::<Vec<_>>();
        assert_eq!(of(wish), [(10.0, 20.0), (20.0, 30.0), (30.0, 35.0)]);
        let back = Wish { newest_first: true, ..wish };
        assert_eq!(of(back), [(25.0, 35.0), (15.0, 25.0), (10.0, 15.0)]);
        assert_eq!(of(wish.after(20.0)), [(20.0, 30.0), (30.0, 35.0)]);
        assert_eq!(of(back.after(25.0)), [(15.0, 25.0), (10.0, 15.0)]);
        assert_eq!((of(wish.after(35.0)), of(back.after(10.0))), (vec![], vec![]));
    }
}
