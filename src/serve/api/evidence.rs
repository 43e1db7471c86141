//! The picture behind a verdict, and samples as they arrive.

use super::super::Context;
use super::super::dto::events::EventData;
use super::super::dto::evidence::LoopEvidence;
use super::super::dto::params::NoQuery;
use super::super::dto::rfc3339;
use super::super::dto::samples::TagSamples;
use super::super::extract::{OfLoop, Params};
use super::super::guard::{Actor, lost};
use super::super::problem::Problem;
use super::{event_place, off_thread};
use crate::access::Role;
use crate::history::{History, TagSpec, Trend};
use crate::signal::{LoopId, Sample};
use axum::extract::State;
use axum::response::Response;
use axum::response::sse::{Event as Frame, KeepAlive, Sse};
use futures::stream::{self, Stream, StreamExt};
use std::collections::HashMap;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::{Interval, MissedTickBehavior};

type Shared = State<Arc<Context>>;

/// How often new samples are sent: people see no more.
const EVERY: Duration = Duration::from_secs(1);
/// Most samples of a tag in one event; more are thinned.
const MOST: usize = 5000;
/// A newest sample that lies further behind what was sent (s) was stamped by a clock that was set back.
const SET_BACK_S: f64 = 1.0;

/// What the latest diagnosis saw: the window, the stem that the friction implies, and what the models leave over.
#[utoipa::path(get, path = "/loops/{id}/evidence", tag = "loops",
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = LoopEvidence), (status = 404, description = "problem: no such loop, or no diagnosis yet")))]
pub async fn evidence(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    off_thread(move || {
        let known = context.results.get(&id, context.clock.now());
        let known = known.ok_or_else(|| Problem::unknown_loop(id.as_str()))?;
        LoopEvidence::latest(&known).ok_or_else(|| {
            let last = known.last.as_ref().map(|last| last.outcome.as_ref());
            Problem::not_diagnosed_yet(id.as_str(), last)
        })
    })
    .await
}

/// The loop's samples as they arrive, once a second: `hello`, then events `samples`, each an array of tags as
/// `/samples` has them.
#[utoipa::path(get, path = "/loops/{id}/live", tag = "events",
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, content_type = "text/event-stream", body = Vec<TagSamples>),
        (status = 404, description = "problem: no such loop"),
        (status = 503, description = "problem: too many clients listen already")))]
pub async fn live(
    State(context): Shared,
    actor: Actor,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Sse<impl Stream<Item = Result<Frame, Infallible>>>, Problem> {
    let permit = event_place(&context)?;
    let ended = Box::pin(lost(context.clone(), actor, Role::Viewer));
    let mut ticks = tokio::time::interval(EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let seen = Seen::of(&context.plant().history.latest(&id));
    let hello =
        serde_json::to_string(&EventData::Hello { time: rfc3339(context.clock.now()), resumed: false }).ok();
    let client = Client { hello, seen, context, id, ticks, _permit: permit };
    let frames = stream::unfold(client, |mut client| async {
        let frame = match client.hello.take() {
            Some(text) => Frame::default().event("hello").data(text),
            None => Frame::default().event("samples").data(client.next().await?),
        };
        Some((Ok(frame), client))
    });
    let frames = frames.take_until(ended);
    Ok(Sse::new(frames).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}

/// Time of the newest sample that was sent (s), by tag: tags may be stamped by clocks of their own.
#[derive(Clone)]
struct Seen(HashMap<String, f64>);

impl Seen {
    /// What is there already, which `/samples` gives.
    fn of(latest: &[(&TagSpec, Option<Sample>)]) -> Self {
        let stamped =
            latest.iter().filter_map(|(tag, sample)| Some((tag.kind.name().to_string(), sample.as_ref()?.t)));
        Self(stamped.collect())
    }

    fn at(&mut self, tag: &TagSpec) -> &mut f64 {
        self.0.entry(tag.kind.name().to_string()).or_insert(f64::NEG_INFINITY)
    }

    /// From when on to look, by the newest samples; infinity where none is new. A tag that is silent does not make the
    /// others be read in full.
    fn from(&mut self, latest: &[(&TagSpec, Option<Sample>)]) -> f64 {
        let mut from = f64::INFINITY;
        for (tag, sample) in latest {
            let Some(sample) = sample else { continue };
            let seen = self.at(tag);
            if sample.t < *seen - SET_BACK_S {
                // All that the history then gives is of after that.
                *seen = f64::NEG_INFINITY;
            }
            if sample.t > *seen {
                from = from.min(*seen);
            }
        }
        from
    }

    /// What came since, tag by tag; `None` when the loop is gone.
    fn news(&mut self, history: &History, id: &LoopId) -> Option<Vec<Trend>> {
        let from = self.from(&history.latest(id));
        let mut trends = history.samples(id, from, f64::INFINITY, MOST)?;
        for trend in &mut trends {
            let seen = self.at(&trend.tag);
            // Who listens has it already.
            trend.before = None;
            trend.samples.retain(|sample| sample.t > *seen);
            if let Some(last) = trend.samples.last() {
                *seen = last.t;
            }
        }
        Some(trends)
    }
}

struct Client {
    context: Arc<Context>,
    id: LoopId,
    /// What is said first: everything that arrives after it is heard.
    hello: Option<String>,
    seen: Seen,
    ticks: Interval,
    _permit: OwnedSemaphorePermit,
}

impl Client {
    /// The next samples as JSON; `None` when the daemon stops or the loop is gone.
    async fn next(&mut self) -> Option<String> {
        loop {
            let stop = self.context.stop.clone();
            stop.run_until_cancelled(self.ticks.tick()).await?;
            let (context, id, mut seen) = (self.context.clone(), self.id.clone(), self.seen.clone());
            let read = move || {
                let trends = seen.news(&context.plant().history, &id)?;
                let news = trends.iter().any(|trend| !trend.samples.is_empty());
                let tags: Vec<TagSamples> = trends.iter().map(TagSamples::from).collect();
                Some((seen, news.then(|| serde_json::to_string(&tags).ok()).flatten()))
            };
            let (seen, text) = tokio::task::spawn_blocking(read).await.ok()??;
            self.seen = seen;
            if text.is_some() {
                return text;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::{self, LoopTags, TagKind};
    use crate::signal::{Role, SpanSource};

    const NONE: Vec<f64> = Vec::new();

    #[test]
    fn a_tag_whose_clock_was_set_back_goes_on_at_once_and_from_there_only() {
        let id = LoopId::new("FIC101");
        let tag = |role| TagSpec { kind: TagKind::Role(role), unit: String::new(), source: String::new() };
        let tags = LoopTags {
            id: id.clone(),
            tags: vec![tag(Role::Op), tag(Role::Pv)],
            op_limits: None,
            op_span: None,
            op_span_source: SpanSource::default(),
        };
        let history = History::new(&[tags], &history::Config { samples_per_tag: 200 });
        let push =
            |tag, times: &[f64]| times.iter().for_each(|t| assert!(history.push(tag, Sample::good(*t, 1.0))));
        push(0, &[9_998.0, 9_999.0]);
        push(1, &[9_998.0, 9_999.0]);
        let mut seen = Seen::of(&history.latest(&id));
        let mut news = || {
            let trends = seen.news(&history, &id).expect("the loop is there");
            trends.iter().map(|own| own.samples.iter().map(|s| s.t).collect()).collect::<Vec<Vec<f64>>>()
        };
        assert_eq!(news(), [NONE, NONE], "what is there already is not news");
        push(0, &[10_000.0]);
        push(1, &[10_000.0]);
        assert_eq!(news(), [vec![10_000.0], vec![10_000.0]]);
        // Two hours back; PV comes later, and OP is heard beside a PV that lies in the future.
        push(0, &[2800.0, 2801.0]);
        assert_eq!(news(), [vec![2800.0, 2801.0], NONE]);
        push(0, &[2802.0]);
        assert_eq!(news(), [vec![2802.0], NONE]);
        push(0, &[2803.0]);
        push(1, &[2803.0]);
        assert_eq!(news(), [vec![2803.0], vec![2803.0]]);
        // A stamp that falls back by less is late, and nothing to begin anew for.
        push(1, &[2802.5]);
        assert_eq!(news(), [NONE, NONE]);
    }
}
