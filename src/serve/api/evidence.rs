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
use crate::history::Trend;
use crate::signal::LoopId;
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
/// How far behind the others a tag may be and still be heard (s).
const LOOK_BACK_S: f64 = 3600.0;

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
    let seen = Seen::of(&context, &id);
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
    fn of(context: &Context, id: &LoopId) -> Self {
        let plant = context.plant();
        let latest = plant.history.latest(id).into_iter();
        let stamped = latest.filter_map(|(tag, sample)| Some((tag.kind.name().to_string(), sample?.t)));
        Self(stamped.collect())
    }

    /// From when on to look: a tag that has long been silent does not make the others be read in full.
    fn from(&self) -> f64 {
        let (least, most) = self
            .0
            .values()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), t| (least.min(*t), most.max(*t)));
        if self.0.is_empty() { f64::NEG_INFINITY } else { least.max(most - LOOK_BACK_S) }
    }

    /// Takes out what was sent before, and remembers the rest; false when nothing is left.
    fn only_news(&mut self, trends: &mut [Trend]) -> bool {
        let mut news = false;
        for trend in trends {
            let seen = self.0.entry(trend.tag.kind.name().to_string()).or_insert(f64::NEG_INFINITY);
            trend.samples.retain(|sample| sample.t > *seen);
            if let Some(last) = trend.samples.last() {
                *seen = last.t;
                news = true;
            }
        }
        news
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
                let mut trends = context.plant().history.samples(&id, seen.from(), f64::INFINITY, MOST)?;
                let news = seen.only_news(&mut trends);
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
