//! Those who are told of alarms, and what never reached them.

use super::super::Context;
use super::super::dto::notifications::{DeadLetterList, ReceiverList, ReplayBody, Replayed};
use super::super::dto::params::NoQuery;
use super::super::dto::rfc3339;
use super::super::extract::{Body, Named, Params};
use super::super::problem::Problem;
use super::off_thread;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use std::sync::Arc;

type Shared = State<Arc<Context>>;

/// Those who are told of alarms, and whether they take what they are sent.
#[utoipa::path(get, path = "/notifications", tag = "notifications", responses((status = 200, body = ReceiverList)))]
pub async fn list(State(context): Shared, Params(NoQuery {}): Params<NoQuery>) -> Result<Response, Problem> {
    off_thread(move || {
        let receivers = context.notifications.as_ref().map(|port| port.receivers()).unwrap_or_default();
        let items = receivers.into_iter().map(Into::into).collect();
        Ok(ReceiverList { time: rfc3339(context.clock.now()), items })
    })
    .await
}

/// The messages that never reached a receiver.
#[utoipa::path(get, path = "/notifications/{receiver}/dead-letters", tag = "notifications",
    params(("receiver" = String, Path, description = "the receiver's name")),
    responses((status = 200, body = DeadLetterList), (status = 404, description = "problem: no such receiver")))]
pub async fn dead_letters(
    State(context): Shared,
    Named(receiver): Named,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    off_thread(move || {
        let letters = context.notifications.as_ref().and_then(|port| port.dead_letters(&receiver));
        let letters = letters.ok_or_else(|| unknown(&receiver))?;
        Ok(DeadLetterList { items: letters.into_iter().map(Into::into).collect() })
    })
    .await
}

/// Sends a dead letter, or all of a receiver, once more.
#[utoipa::path(post, path = "/notifications/{receiver}/replay", tag = "notifications", request_body = Option<ReplayBody>,
    params(("receiver" = String, Path, description = "the receiver's name")),
    responses((status = 200, body = Replayed), (status = 400, description = "problem: the field is named"),
        (status = 404, description = "problem: no such receiver, or no such dead letter")))]
pub async fn replay(
    State(context): Shared,
    Named(receiver): Named,
    Body(body): Body<ReplayBody>,
) -> Result<Response, Problem> {
    off_thread(move || {
        let replayed =
            context.notifications.as_ref().and_then(|port| port.replay(&receiver, body.id.as_deref()));
        let replayed = replayed.ok_or_else(|| unknown(&receiver))?;
        if replayed == 0 && body.id.is_some() {
            let detail = "there is no such dead letter";
            return Err(Problem::new(StatusCode::NOT_FOUND, "unknown_letter", detail));
        }
        Ok(Replayed { replayed })
    })
    .await
}

fn unknown(receiver: &str) -> Problem {
    let detail = format!("there is no receiver '{receiver}' that keeps dead letters");
    Problem::new(StatusCode::NOT_FOUND, "unknown_receiver", detail)
}
