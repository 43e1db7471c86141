//! Events as they happen: server-sent events.

use super::super::Context;
use super::super::dto::events::EventData;
use super::super::dto::params::NoQuery;
use super::super::dto::rfc3339;
use super::super::extract::Params;
use super::super::problem::Problem;
use super::event_place;
use crate::results::Event;
use axum::extract::State;
use axum::response::sse::{Event as Frame, KeepAlive, Sse};
use futures::stream::{self, Stream};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use tokio_util::sync::CancellationToken;

/// Diagnoses, alarms and reloads as they happen. A client that lags is told how many events it lost.
#[utoipa::path(get, path = "/events", tag = "events",
    responses((status = 200, content_type = "text/event-stream", body = EventData,
        description = "events hello, diagnosis, alarm, writeback, backfill, reloaded, lagged, bye"),
        (status = 503, description = "problem: too many clients listen already")))]
pub async fn stream(
    State(context): State<Arc<Context>>,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Sse<impl Stream<Item = Result<Frame, Infallible>>>, Problem> {
    let permit = event_place(&context)?;
    let client = Client {
        events: context.results.subscribe(),
        stop: context.stop.clone(),
        next: Some(EventData::Hello { time: rfc3339(context.clock.now()) }),
        done: false,
        _permit: permit,
    };
    let frames = stream::unfold(client, |mut client| async {
        let data = client.next().await?;
        Some((Ok(frame(&data)), client))
    });
    Ok(Sse::new(frames).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))))
}

struct Client {
    events: Receiver<Event>,
    stop: CancellationToken,
    next: Option<EventData>,
    done: bool,
    _permit: OwnedSemaphorePermit,
}

impl Client {
    async fn next(&mut self) -> Option<EventData> {
        if let Some(data) = self.next.take() {
            return Some(data);
        }
        if self.done {
            return None;
        }
        tokio::select! {
            event = self.events.recv() => match event {
                Ok(event) => return Some(event.into()),
                Err(RecvError::Lagged(lost)) => return Some(EventData::Lagged { lost }),
                Err(RecvError::Closed) => {}
            },
            () = self.stop.cancelled() => {}
        }
        self.done = true;
        Some(EventData::Bye {})
    }
}

/// JSON has no line breaks, so one `data:` line holds it; text that could not be made is left empty.
fn frame(data: &EventData) -> Frame {
    let frame = Frame::default().event(data.name());
    frame.data(serde_json::to_string(data).unwrap_or_default())
}
