//! Log-in, log-out, and who one is.

use super::super::Context;
use super::super::dto::params::NoQuery;
use super::super::dto::session::{LogIn, SessionView};
use super::super::extract::{Params, Required};
use super::super::guard::{Actor, COOKIE, cookies, record};
use super::super::layers::blocking;
use super::super::problem::Problem;
use crate::access::{Access, Identity, Proof, is_name};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

type Shared = State<Arc<Context>>;

/// Longest wait for a turn: each trial takes some megabytes and tens of milliseconds on purpose.
const TURN: Duration = Duration::from_secs(5);

/// Who asks, and what they may do; what a page shows and leaves out.
#[utoipa::path(get, path = "/session", tag = "session", responses((status = 200, body = SessionView)))]
pub async fn state(
    State(context): Shared,
    actor: Actor,
    Params(NoQuery {}): Params<NoQuery>,
) -> Json<SessionView> {
    Json(SessionView::of(&actor, context.audit.is_some()))
}

/// Begins a session by name and password; the cookie is for the browser, `csrf` for what changes something.
#[utoipa::path(post, path = "/session", tag = "session", request_body = LogIn,
    responses((status = 200, body = SessionView), (status = 400, description = "problem: the field is named"),
        (status = 401, description = "problem: name or password is wrong"),
        (status = 404, description = "problem: there is no log-in here"),
        (status = 429, description = "problem: too many trials; Retry-After says when"),
        (status = 503, description = "problem: too many at once")))]
pub async fn begin(
    State(context): Shared,
    actor: Actor,
    headers: HeaderMap,
    Required(LogIn { user, password }): Required<LogIn>,
) -> Result<Response, Problem> {
    let access = context.access.clone().ok_or_else(no_log_in)?;
    let now = context.clock.elapsed().as_secs_f64();
    access.attempt(&user, actor.from, now).map_err(|wait| {
        // Of all together: a stranger who asks without end must not fill the disk by that.
        if let Some(left_out) = context.throttled.take("", now) {
            tracing::warn!(from = %actor.from, wait_s = wait, left_out, "log-in throttled");
        }
        let detail = format!("too many trials: wait {:.0} s", wait.ceil());
        Problem::new(StatusCode::TOO_MANY_REQUESTS, "throttled", detail).with("retry_after_s", wait.ceil())
    })?;
    let turn = timeout(TURN, context.hashing.clone().acquire_owned()).await;
    let Ok(Ok(turn)) = turn else {
        return Err(Problem::busy("too_many_log_ins", "too many log in at once"));
    };
    let (door, name) = (access.clone(), user.clone());
    let found = blocking(move || {
        let _turn = turn;
        door.recognise(&name, &password)
    });
    let found = found.await.map_err(|error| {
        tracing::error!(%error, "a log-in failed inside");
        Problem::internal()
    })?;
    // A name that cannot be one may be a password in the wrong field.
    let named = if is_name(&user) { user } else { String::new() };
    let put =
        |event, who: String| record(&context, event, vec![("who", who), ("from", actor.from.to_string())]);
    let Some(user) = found else {
        put("log_in_failed", named).await;
        return Err(Problem::new(StatusCode::UNAUTHORIZED, "log_in_failed", "name or password is wrong"));
    };
    for old in cookies(&headers) {
        access.end(old);
    }
    let now = context.clock.elapsed().as_secs_f64();
    let begun = access.begin(&user, actor.from, now).ok_or_else(Problem::internal)?;
    put("log_in", user.name.clone()).await;
    let identity = Identity { name: user.name, roles: user.roles, by: Proof::Session };
    let actor = Actor { identity: Some(identity), csrf: Some(begun.csrf), ..actor };
    let cookie = cookie(&context, &headers, &begun.id, None)?;
    let view = SessionView::of(&actor, context.audit.is_some());
    Ok(([(header::SET_COOKIE, cookie)], Json(view)).into_response())
}

/// Ends the session.
#[utoipa::path(delete, path = "/session", tag = "session",
    responses((status = 204, description = "nobody is logged in any more")))]
pub async fn end(State(context): Shared, actor: Actor, headers: HeaderMap) -> Result<Response, Problem> {
    let access = context.access.clone().ok_or_else(no_log_in)?;
    if log_out(&access, &headers) {
        let who = actor.signed(None).unwrap_or_default();
        record(&context, "log_out", vec![("who", who), ("from", from(&actor))]).await;
    }
    let cookie = cookie(&context, &headers, "", Some(0))?;
    Ok((StatusCode::NO_CONTENT, [(header::SET_COOKIE, cookie)]).into_response())
}

fn from(actor: &Actor) -> String {
    let address: IpAddr = actor.from;
    address.to_string()
}

fn log_out(access: &Access, headers: &HeaderMap) -> bool {
    // Every one of several: none is left behind.
    let ended: Vec<bool> = cookies(headers).map(|id| access.end(id)).collect();
    ended.contains(&true)
}

fn no_log_in() -> Problem {
    let detail = "there is no log-in here: the configuration has no [access]";
    Problem::new(StatusCode::NOT_FOUND, "no_log_in", detail)
}

/// For this host only, out of reach of scripts and of other sites, and never in the clear, unless the configuration
/// accepts that and the browser came so: it would drop the cookie, and nobody could log in.
fn cookie(
    context: &Context,
    headers: &HeaderMap,
    value: &str,
    age: Option<u32>,
) -> Result<HeaderValue, Problem> {
    let origin = headers.get(header::ORIGIN).and_then(|origin| origin.to_str().ok()).unwrap_or_default();
    let clear = context.config.allow_plain_http_on_network && origin.starts_with("http://");
    let secure = if clear { "" } else { "; Secure" };
    let age = age.map(|age| format!("; Max-Age={age}")).unwrap_or_default();
    let text = format!("{COOKIE}={value}; Path=/; HttpOnly; SameSite=Strict{secure}{age}");
    HeaderValue::from_str(&text).map_err(|_| Problem::internal())
}
