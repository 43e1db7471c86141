//! Diagnoses over the past, as a job.

use super::super::Context;
use super::super::dto::backfill::{BackfillBody, BackfillJob};
use super::super::dto::params::NoQuery;
use super::super::dto::parse_time;
use super::super::extract::{Params, Required, within};
use super::super::ports::{BackfillFile, BackfillPort, BackfillRefusal, BackfillRequest};
use super::super::problem::Problem;
use crate::signal::LoopId;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use std::sync::Arc;

/// Longest past of one job (s): ten years.
const LONGEST_S: f64 = 3.2e8;
/// Later than any time (s since 1970): the record of a file ends by itself.
const LATEST_S: f64 = 1e11;
/// Shortest and longest window, and step (s).
const WINDOW_S: std::ops::RangeInclusive<f64> = 10.0..=3.2e7;

type Shared = State<Arc<Context>>;

fn port(context: &Context) -> Result<&Arc<dyn BackfillPort>, Problem> {
    let none = || Problem::new(StatusCode::NOT_FOUND, "no_backfill", "this daemon has no past to ask for");
    context.backfill.as_ref().ok_or_else(none)
}

fn none_yet() -> Problem {
    Problem::new(StatusCode::NOT_FOUND, "no_backfill", "there is none; POST begins one")
}

/// Diagnoses a loop's past, window by window, as the daemon would have: one job at a time, told by `backfill` events.
#[utoipa::path(post, path = "/backfill", tag = "backfill", request_body = BackfillBody,
    responses((status = 202, body = BackfillJob), (status = 400, description = "problem: the field is named"),
        (status = 404, description = "problem: no such loop"),
        (status = 409, description = "problem: one runs already, nothing is stored, or devices are asked for more than the store keeps")))]
pub async fn begin(
    State(context): Shared,
    Required(body): Required<BackfillBody>,
) -> Result<(StatusCode, Json<BackfillJob>), Problem> {
    let id = LoopId::new(body.r#loop.as_str());
    if context.plant().info(&id).is_none() {
        return Err(Problem::unknown_loop(id.as_str()));
    }
    let time = |field: &str, text: &str| {
        let fault = || Problem::field(field, format!("{field}: RFC 3339, or seconds since the Unix epoch"));
        parse_time(text).filter(|t| (0.0..1e11).contains(t)).ok_or_else(fault)
    };
    let from = match (&body.from, &body.file) {
        (Some(from), _) => time("from", from)?,
        // A file has a begin of its own.
        (None, Some(_)) => 0.0,
        (None, None) => return Err(Problem::field("from", "from: say from which time on")),
    };
    let latest = if body.file.is_some() { LATEST_S } else { context.clock.now() };
    let to = body.to.as_deref().map_or(Ok(latest), |text| time("to", text))?;
    let longest = if body.file.is_some() { f64::MAX } else { LONGEST_S };
    within("to", to - from, 1.0..=longest)
        .map_err(|_| Problem::field("to", format!("to: must be after from, by at most {LONGEST_S} s")))?;
    let (window_s, step_s) = (body.window_s, body.step_s);
    for (field, given) in [("window_s", window_s), ("step_s", step_s)] {
        given.map_or(Ok(0.0), |value| within(field, value, WINDOW_S))?;
    }
    if body.file.is_none() && !body.table.is_empty() {
        return Err(Problem::field("table", "table: it tells of a file; name it with file"));
    }
    let options = body.table.into_iter().collect();
    let file = body.file.map(|name| BackfillFile { name, options });
    let request = BackfillRequest { id, from, to, window_s, step_s, read_devices: body.read_devices, file };
    let begun = port(&context)?.begin(request);
    let refused = |why: BackfillRefusal| match why {
        BackfillRefusal::File(why) => Problem::field("file", format!("file: {why}")),
        why => Problem::new(StatusCode::CONFLICT, "backfill_state", why.to_string()),
    };
    begun.map(|job| (StatusCode::ACCEPTED, Json(BackfillJob::from(&job)))).map_err(refused)
}

/// The last job since the start: how far it has come, and when it is done what it found.
#[utoipa::path(get, path = "/backfill", tag = "backfill",
    responses((status = 200, body = BackfillJob), (status = 404, description = "problem: there was none")))]
pub async fn state(
    State(context): Shared,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Json<BackfillJob>, Problem> {
    port(&context)?.job().map(|job| Json(BackfillJob::from(&job))).ok_or_else(none_yet)
}

/// Ends the job that runs; what it read from devices stays in the store.
#[utoipa::path(delete, path = "/backfill", tag = "backfill",
    responses((status = 200, body = BackfillJob), (status = 404, description = "problem: none runs")))]
pub async fn cancel(
    State(context): Shared,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Json<BackfillJob>, Problem> {
    port(&context)?.cancel().map(|job| Json(BackfillJob::from(&job))).ok_or_else(none_yet)
}
