//! The door: who asks, whether they may, and that every change is put on record. Nothing gets past it unasked.

use super::Context;
use super::dto::compact;
use super::listen::{Gone, Peer};
use super::policy::{self, Need};
use super::problem::Problem;
use crate::access::{Identity, Lease, Proof, Refused, Role, same_word};
use crate::audit::ON_RECORD;
use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{FromRequestParts, MatchedPath, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::error::Error;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

/// The cookie of a session.
pub const COOKIE: &str = "stictiond_session";
/// The header that a change by cookie must carry.
pub const CSRF: &str = "x-csrf-token";
/// The header of what a page asks by itself, while nobody touches it: a session that only such requests and streams use is idle.
pub const BACKGROUND: &str = "x-stictiond-background";
/// Longest part of a path and its query that is put on record (characters).
const MOST_ASKED: usize = 300;
/// Longest part of a body that is put on record (characters).
const MOST_RECORDED: usize = 2000;

/// Who asks. Every request carries it.
#[derive(Clone, Debug)]
pub struct Actor {
    /// Who they are; `None` for whom nobody knows.
    pub identity: Option<Identity>,
    /// Where they are.
    pub from: IpAddr,
    /// What a change by this session must carry.
    pub csrf: Option<String>,
    /// Whether there is no log-in at all.
    pub unguarded: bool,
    /// Whether everybody may read.
    pub anyone_may_read: bool,
    /// What the identity rests on.
    pub lease: Option<Lease>,
    /// Cancelled when nothing more comes from them.
    pub gone: CancellationToken,
}

impl Actor {
    /// Whether they have a role that includes this one.
    pub fn may(&self, role: Role) -> bool {
        let known = self.identity.as_ref().is_some_and(|identity| identity.roles.may(role));
        known || self.unguarded || self.anyone_may_read && role == Role::Viewer
    }

    /// The name under which they act: their own; where there is no log-in, what they say.
    pub fn signed(&self, said: Option<String>) -> Option<String> {
        self.identity.as_ref().map(|identity| identity.name.clone()).or(said)
    }

    /// Whether they logged in by a password.
    pub fn is_person(&self) -> bool {
        self.identity.as_ref().is_some_and(|identity| identity.by == Proof::Session)
    }

    fn fields(&self) -> Vec<(&'static str, String)> {
        let (who, by) = match &self.identity {
            Some(identity) => (identity.name.clone(), identity.by.to_string()),
            None => (String::new(), "nobody".to_string()),
        };
        vec![("who", who), ("by", by), ("from", self.from.to_string())]
    }
}

impl<S: Sync> FromRequestParts<S> for Actor {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self, Problem> {
        parts.extensions.get::<Actor>().cloned().ok_or_else(Problem::internal)
    }
}

/// Lets a request in, or says why not.
pub async fn guard(State(context): State<Arc<Context>>, mut request: Request, next: Next) -> Response {
    let route = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let (rules, is_stream) =
        route.map(|route| (policy::of_path(route), policy::is_stream(route))).unwrap_or_default();
    if rules.is_empty() {
        return Problem::of_status(StatusCode::NOT_FOUND).into_response();
    }
    let Some(need) = policy::need(&rules, request.method()) else {
        return not_allowed(&rules);
    };
    let from = request.extensions().get::<Peer>().map_or(Ipv4Addr::UNSPECIFIED.into(), |peer| peer.0.ip());
    let gone = request.extensions().get::<Gone>().map(|gone| gone.0.clone()).unwrap_or_default();
    let is_change = !matches!(*request.method(), Method::GET | Method::HEAD);
    // A browser opens a stream again by itself, and can give it no header.
    let by_hand = is_change || !(is_stream || request.headers().contains_key(BACKGROUND));
    let actor = match identify(&context, request.headers(), from.to_canonical(), by_hand) {
        Ok(actor) => Actor { gone, ..actor },
        Err(problem) => return problem.into_response(),
    };
    if let Err(problem) = decide(need, &actor, is_change, request.headers()) {
        if let Some(identity) = actor.identity.as_ref().filter(|_| is_change)
            && let Some(left_out) =
                context.refusals.take(&identity.name, context.clock.elapsed().as_secs_f64())
        {
            let mut fields = asked(&actor, &request, problem.status());
            if left_out > 0 {
                fields.push(("refused_before", left_out.to_string()));
            }
            record(&context, "refused", fields).await;
        }
        return problem.into_response();
    }
    request.extensions_mut().insert(actor.clone());
    if is_change { change(context, actor, request, next).await } else { next.run(request).await }
}

fn not_allowed(rules: &[(&str, Need)]) -> Response {
    let mut allow: Vec<&str> = rules.iter().map(|(method, _)| *method).collect();
    if allow.contains(&"GET") {
        allow.push("HEAD");
    }
    let mut response = Problem::of_status(StatusCode::METHOD_NOT_ALLOWED).into_response();
    if let Ok(allow) = HeaderValue::from_str(&allow.join(",")) {
        response.headers_mut().insert(header::ALLOW, allow);
    }
    response
}

/// Who asks; a token that is no good is refused also where none is needed. A session counts as used where it is asked `by_hand`.
fn identify(context: &Context, headers: &HeaderMap, from: IpAddr, by_hand: bool) -> Result<Actor, Problem> {
    let nobody = Actor {
        identity: None,
        from,
        csrf: None,
        unguarded: false,
        anyone_may_read: false,
        lease: None,
        gone: CancellationToken::new(),
    };
    let Some(access) = &context.access else {
        return Ok(Actor { unguarded: true, ..nobody });
    };
    let nobody = Actor { anyone_may_read: access.anyone_may_read(), ..nobody };
    if let Some(shown) = headers.get(header::AUTHORIZATION) {
        let token = shown.to_str().ok().and_then(|text| text.split_once(' '));
        let token = token.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"));
        let token = token.ok_or_else(|| refused("bad_token", "write it as Authorization: Bearer TOKEN"))?;
        let found = access.of_token(token.1.trim(), context.clock.now());
        let (identity, lease) = found.map_err(|why| match why {
            Refused::Unknown => refused("bad_token", "this token was never made here, or was revoked"),
            Refused::Expired => refused("expired_token", "this token has run out: rotate it"),
        })?;
        return Ok(Actor { identity: Some(identity), lease: Some(lease), ..nobody });
    }
    let now = context.clock.elapsed().as_secs_f64();
    let session =
        cookies(headers).find_map(|id| Some((access.of_session(id, now, by_hand)?, Lease::of_session(id))));
    Ok(match session {
        Some(((identity, found), lease)) => {
            Actor { identity: Some(identity), csrf: Some(found.csrf), lease: Some(lease), ..nobody }
        }
        None => nobody,
    })
}

/// Every value of the session's cookie: which of several is ours shows.
pub fn cookies(headers: &HeaderMap) -> impl Iterator<Item = &str> {
    let lines = headers.get_all(header::COOKIE).into_iter().filter_map(|line| line.to_str().ok());
    let pairs = lines.flat_map(|line| line.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.filter(|(name, _)| *name == COOKIE).map(|(_, value)| value)
}

fn refused(kind: &'static str, detail: &str) -> Problem {
    Problem::new(StatusCode::UNAUTHORIZED, kind, detail)
}

fn decide(need: Need, actor: &Actor, is_change: bool, headers: &HeaderMap) -> Result<(), Problem> {
    let Need::Role(role) = need else { return Ok(()) };
    if !actor.may(role) {
        let Some(identity) = &actor.identity else {
            return Err(refused("log_in", "log in, or show a token"));
        };
        let detail = format!("this needs the role {role}; {} has: {}", identity.name, identity.roles);
        return Err(Problem::new(StatusCode::FORBIDDEN, "role", detail).with("needs", role.as_str()));
    }
    // A browser sends the cookie with whatever asks it to; the word it only has from our own page.
    let word = headers.get(CSRF).and_then(|word| word.to_str().ok());
    let by_cookie = is_change && actor.csrf.is_some();
    if by_cookie && !actor.csrf.as_deref().zip(word).is_some_and(|(own, word)| same_word(own, word)) {
        let detail =
            "a change by a browser's session carries the x-csrf-token that GET /api/v1/session gives";
        return Err(Problem::new(StatusCode::FORBIDDEN, "csrf", detail));
    }
    Ok(())
}

/// Runs a change and puts it on record with its result; without a record that works nothing is changed, but that people log in
/// and take a term of write-back back: on the way to zero the plant comes before the record, and write-back has a log of its
/// own.
async fn change(context: Arc<Context>, actor: Actor, request: Request, next: Next) -> Response {
    let fault = context.audit.as_ref().and_then(|audit| audit.fault());
    // A log-in puts itself on record, without the password.
    let is_session = request.uri().path().ends_with("/session");
    if let Some(fault) = fault.filter(|_| !is_session && !withdraws(&request)) {
        return Problem::unrecorded(&fault).into_response();
    }
    let mut fields = asked(&actor, &request, StatusCode::OK);
    let (parts, body) = request.into_parts();
    let bytes = match whole(body, &context).await {
        Ok(bytes) => bytes,
        Err(problem) => return problem.into_response(),
    };
    let said = said(&bytes);
    let request = Request::from_parts(parts, Body::from(bytes));
    let withdraws = withdraws(&request);
    to_its_end(async move {
        let response = next.run(request).await;
        if !is_session {
            if let Some(result) = fields.iter_mut().find(|(key, _)| *key == "result") {
                result.1 = response.status().as_u16().to_string();
            }
            fields.push(("said", said));
            let done = response.status().is_success();
            if !record(&context, "change", fields).await && done && !withdraws {
                let detail = "it was done, but is not on record: the audit log cannot be written; the daemon's log says why";
                return Problem::busy("audit_failed", detail).into_response();
            }
        }
        response
    })
    .await
}

/// Whether a request takes a term of write-back back.
fn withdraws(request: &Request) -> bool {
    let route = request.extensions().get::<MatchedPath>();
    route.is_some_and(|route| route.as_str().ends_with("/writeback/withdraw"))
}

/// Works to the end, whoever waits for it: a client that resets its connection leaves no change without its record.
async fn to_its_end(work: impl Future<Output = Response> + Send + 'static) -> Response {
    tokio::spawn(work).await.unwrap_or_else(|error| {
        tracing::error!(%error, "a change failed");
        Problem::internal().into_response()
    })
}

fn asked(actor: &Actor, request: &Request, status: StatusCode) -> Vec<(&'static str, String)> {
    let mut fields = actor.fields();
    let asked = request.uri().path_and_query().map_or("", |asked| asked.as_str());
    fields.push(("asked", format!("{} {}", request.method(), cut(asked, MOST_ASKED))));
    fields.push(("result", status.as_u16().to_string()));
    fields
}

/// The beginning of a text, and how long the whole is.
fn cut(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        Some((at, _)) => format!("{} ({} characters)", &text[..at], text.chars().count()),
        None => text.to_string(),
    }
}

/// What a body says, for the record: JSON without the blanks and escapes that would make it long.
fn said(bytes: &[u8]) -> String {
    let text = compact(bytes).unwrap_or_else(|| String::from_utf8_lossy(bytes).into_owned());
    cut(&text, MOST_RECORDED)
}

/// The body, within the time and size that the configuration allows.
async fn whole(body: Body, context: &Context) -> Result<Bytes, Problem> {
    let config = &context.config;
    match timeout(config.read_timeout(), to_bytes(body, config.max_body_bytes)).await {
        Ok(Ok(bytes)) => Ok(bytes),
        Ok(Err(error)) => {
            let mut cause: Option<&(dyn Error + 'static)> = Some(&error);
            while let Some(error) = cause {
                if error.is::<http_body_util::LengthLimitError>() {
                    return Err(Problem::of_status(StatusCode::PAYLOAD_TOO_LARGE));
                }
                cause = error.source();
            }
            Err(Problem::of_status(StatusCode::BAD_REQUEST))
        }
        Err(_) => {
            let detail = "the body did not arrive in time";
            Err(Problem::new(StatusCode::REQUEST_TIMEOUT, "slow_body", detail))
        }
    }
}

/// How often a lease is looked at that nobody has said to have ended: it may have run out.
const LOOK: Duration = Duration::from_millis(500);

/// Ends when an actor has gone, or what their rights rest on no longer gives them the role.
pub async fn lost(context: Arc<Context>, actor: Actor, role: Role) {
    let gone = actor.gone.clone();
    let _ = gone.run_until_cancelled(no_longer(&context, actor, role)).await;
}

async fn no_longer(context: &Context, actor: Actor, role: Role) {
    let (Some(access), Some(lease)) = (&context.access, &actor.lease) else {
        return std::future::pending().await;
    };
    let mut changes = access.changes();
    while access.holds(lease, role, context.clock.now(), context.clock.elapsed().as_secs_f64()) {
        // The access outlives who waits here: its changes never end.
        let _ = timeout(LOOK, changes.changed()).await;
    }
}

/// Puts something on record and waits until it is on disk; in the log where there is no record. Whether it is on record.
pub async fn record(context: &Context, event: &'static str, fields: Vec<(&'static str, String)>) -> bool {
    let Some(audit) = &context.audit else {
        tracing::info!(event, ?fields, "asked for");
        return true;
    };
    let mut done = audit.follow(context.clock.now(), event, fields);
    if matches!(timeout(ON_RECORD, &mut done).await, Ok(Ok(()))) {
        return true;
    }
    // It may have come just now.
    if done.try_recv().is_ok() {
        return true;
    }
    tracing::error!(event, "not on record in time");
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering::SeqCst};

    #[test]
    fn blanks_and_escapes_keep_nothing_off_the_record() {
        let padded = format!("{{{}\"comment\":\"\\u00fcber\"}}", " ".repeat(3000));
        assert_eq!(said(padded.as_bytes()), "{\"comment\":\"über\"}");
        assert_eq!(said(b"no json"), "no json");
        let long = said("ä".repeat(3000).as_bytes());
        assert!(long.starts_with("ää") && long.ends_with("ä (3000 characters)"), "{long}");
        assert_eq!(long.chars().filter(|c| *c == 'ä').count(), MOST_RECORDED);
    }

    #[tokio::test]
    async fn a_change_that_was_begun_is_put_on_record_though_nobody_waits_for_it() {
        let recorded = Arc::new(AtomicBool::new(false));
        let own = recorded.clone();
        let (go_on, told) = tokio::sync::oneshot::channel::<()>();
        let change = to_its_end(async move {
            told.await.expect("told to go on");
            own.store(true, SeqCst);
            Response::default()
        });
        // The connection is reset: whoever waited is gone.
        assert!(timeout(Duration::from_millis(20), change).await.is_err());
        go_on.send(()).expect("the change goes on");
        while !recorded.load(SeqCst) {
            tokio::task::yield_now().await;
        }
    }
}
