//! Events as they happen: server-sent events, numbered. A client that comes back with the number it heard last hears what
//! it missed.

use super::super::Context;
use super::super::dto::events::EventData;
use super::super::dto::params::NoQuery;
use super::super::dto::rfc3339;
use super::super::extract::Params;
use super::super::guard::{Actor, lost};
use super::super::problem::Problem;
use super::event_place;
use crate::access::Role;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::sse::{Event as Frame, KeepAlive, Sse};
use futures::stream::{self, Stream, StreamExt};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, watch};

/// Events taken out of the log at once.
const AT_ONCE: usize = 64;

/// Diagnoses, alarms and reloads as they happen, each with an id. A client that comes back with `Last-Event-ID` first hears
/// what it missed; where that is forgotten, or of another run of the daemon, an event `reset`. A client that lags is told
/// how many events it lost. The stream ends with the right to it: a second after a token was revoked, a session ended.
#[utoipa::path(get, path = "/events", tag = "events",
    params(("Last-Event-ID" = Option<String>, Header, description = "the id of the last event that was heard")),
    responses((status = 200, content_type = "text/event-stream", body = EventData,
        description = "events hello, reset, diagnosis, alarm, writeback, backfill, reloaded, lagged, bye"),
        (status = 503, description = "problem: too many clients listen already")))]
pub async fn stream(
    State(context): State<Arc<Context>>,
    actor: Actor,
    Params(NoQuery {}): Params<NoQuery>,
    asked: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Frame, Infallible>>>, Problem> {
    let permit = event_place(&context)?;
    let ended = Box::pin(lost(context.clone(), actor, Role::Viewer));
    let client = Client::new(context, asked.get("last-event-id").and_then(|id| id.to_str().ok()), permit);
    let frames = stream::unfold(client, |mut client| async {
        let frame = client.next().await?;
        Some((Ok(frame), client))
    });
    let frames = frames.take_until(ended);
    Ok(Sse::new(frames).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}

struct Client {
    context: Arc<Context>,
    latest: watch::Receiver<u64>,
    /// The number of the last event that was sent, or that came before it all.
    after: u64,
    ready: VecDeque<(u64, EventData)>,
    done: bool,
    _permit: OwnedSemaphorePermit,
}

impl Client {
    fn new(context: Arc<Context>, last: Option<&str>, permit: OwnedSemaphorePermit) -> Self {
        let latest = context.results.latest_event();
        let now = *latest.borrow();
        let heard = last.and_then(|id| id.strip_prefix(&*context.event_run)?.strip_prefix('-')?.parse().ok());
        let past = heard.and_then(|heard| context.results.events_after(heard, 0));
        let known = heard.filter(|_| past.as_ref().is_some_and(|past| past.lost == 0));
        let after = known.unwrap_or(now);
        let hello = EventData::Hello { time: rfc3339(context.clock.now()), resumed: known.is_some() };
        let mut ready = VecDeque::from([(after, hello)]);
        if last.is_some() && known.is_none() {
            let lost = past.map(|_| now - heard.unwrap_or(now));
            ready.push_back((after, EventData::Reset { lost }));
        }
        Self { context, latest, after, ready, done: false, _permit: permit }
    }

    async fn next(&mut self) -> Option<Frame> {
        loop {
            if let Some((number, data)) = self.ready.pop_front() {
                return Some(self.frame(number, &data));
            }
            if self.done {
                return None;
            }
            self.take();
            if self.ready.is_empty() {
                // The results outlive this client: they never hang up.
                let waited = self.context.stop.run_until_cancelled(self.latest.changed()).await;
                self.done = !matches!(waited, Some(Ok(())));
                if self.done {
                    self.ready.push_back((self.after, EventData::Bye {}));
                }
            }
        }
    }

    /// Takes what there is out of the log.
    fn take(&mut self) {
        self.latest.mark_unchanged();
        let Some(past) = self.context.results.events_after(self.after, AT_ONCE) else { return };
        if past.lost > 0 {
            self.after += past.lost;
            self.ready.push_back((self.after, EventData::Lagged { lost: past.lost }));
        }
        self.after = past.events.last().map_or(self.after, |(number, _)| *number);
        self.ready.extend(past.events.into_iter().map(|(number, event)| (number, event.into())));
    }

    /// JSON has no line breaks, so one `data:` line holds it; text that could not be made is left empty.
    fn frame(&self, number: u64, data: &EventData) -> Frame {
        let frame = Frame::default().event(data.name()).id(format!("{}-{number}", self.context.event_run));
        frame.data(serde_json::to_string(data).unwrap_or_default())
    }
}
