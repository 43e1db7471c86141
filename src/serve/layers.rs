//! What every request passes: bounds on size, time and number, headers, and one shape of errors.

use super::Context;
use super::guard::guard;
use super::names::own_names;
use super::problem::{PROBLEM_JSON, Problem};
use axum::Router;
use axum::extract::{DefaultBodyLimit, MatchedPath, Request};
use axum::http::{HeaderName, HeaderValue, header};
use axum::middleware::{Next, from_fn, from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::{JoinHandle, spawn_blocking};
use tower_http::compression::CompressionLayer;
use tower_http::limit::RequestBodyLimitLayer;

/// Wraps the routes; the last layer is the outermost.
pub fn wrap(routes: Router, context: &Arc<Context>) -> Router {
    let config = &context.config;
    let secure = config.tls.is_some();
    let slots = Arc::new(Slots::new(config.max_requests));
    let timeout = Duration::try_from_secs_f64(config.request_timeout_s).unwrap_or(Duration::MAX);
    routes
        .layer(DefaultBodyLimit::max(config.max_body_bytes))
        .layer(from_fn(move |request, next| bounded(slots.clone(), timeout, request, next)))
        // Outside of the slots: who sends a body slowly takes none.
        .layer(from_fn_with_state(context.clone(), guard))
        .layer(RequestBodyLimitLayer::new(config.max_body_bytes))
        .layer(from_fn_with_state(context.clone(), own_names))
        .layer(map_response(as_problem))
        .layer(CompressionLayer::new())
        .layer(map_response(move |response| with_headers(secure, response)))
}

tokio::task_local! {
    /// The slot of the request that the task works on.
    static SLOT: Arc<OwnedSemaphorePermit>;
}

/// Whether the process lives: who asks that must not take a daemon that is busy for one that is dead.
const ALIVE: [&str; 2] = ["/healthz", "/api/v1/healthz"];

/// Requests of one kind that have slots of their own, at the same time: more than people and monitors ask at once, and little work.
const OWN_SLOTS: usize = 8;

/// Slots of requests. Work that hangs keeps its slot without end, so what must be answered all the same has slots of its own.
struct Slots {
    /// To take a term of write-back back: nothing else may keep it waiting, not even log-ins.
    withdrawals: Arc<Semaphore>,
    /// To log in, which whoever wants to do anything about it needs.
    sessions: Arc<Semaphore>,
    /// To see what is wrong.
    monitors: Arc<Semaphore>,
    /// For everything else.
    others: Arc<Semaphore>,
}

impl Slots {
    fn new(others: usize) -> Self {
        let [withdrawals, sessions, monitors, others] =
            [OWN_SLOTS, OWN_SLOTS, OWN_SLOTS, others].map(|count| Arc::new(Semaphore::new(count)));
        Self { withdrawals, sessions, monitors, others }
    }

    /// The slots for a path, of a route as the router knows it.
    fn of(&self, route: &str) -> Arc<Semaphore> {
        let path = route.strip_prefix("/api/v1").unwrap_or(route);
        let slots = match path {
            "/loops/{id}/writeback/withdraw" => &self.withdrawals,
            "/session" => &self.sessions,
            "/readyz" | "/metrics" => &self.monitors,
            _ => &self.others,
        };
        slots.clone()
    }
}

/// Refuses what is too much at once, and gives up on what takes too long. A stream counts until it begins.
async fn bounded(slots: Arc<Slots>, timeout: Duration, request: Request, next: Next) -> Response {
    if ALIVE.contains(&request.uri().path()) {
        return next.run(request).await;
    }
    let slots = slots.of(request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str));
    within(slots, timeout, next.run(request)).await
}

/// Answers in a slot, within a time.
async fn within(
    slots: Arc<Semaphore>,
    timeout: Duration,
    answer: impl Future<Output = Response>,
) -> Response {
    let Ok(slot) = slots.try_acquire_owned() else {
        return Problem::busy("too_many_requests", "too many requests at once").into_response();
    };
    match tokio::time::timeout(timeout, SLOT.scope(Arc::new(slot), answer)).await {
        Ok(response) => response,
        Err(_) => Problem::busy("timeout", "no answer in time").into_response(),
    }
}

/// Works on a thread that may wait. Nothing can break such work off: it keeps the slot of its request until it ends, also where the
/// client was told long before that there is no answer in time. So no more of it runs than there are slots.
pub fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> JoinHandle<T> {
    // A stream that has begun has none.
    let slot = SLOT.try_with(Arc::clone).ok();
    spawn_blocking(move || {
        let done = work();
        drop(slot);
        done
    })
}

/// Gives every error that is not a problem yet the shape of one; keeps its headers that matter (`Allow`).
async fn as_problem(response: Response) -> Response {
    let status = response.status();
    let shaped = response.headers().get(header::CONTENT_TYPE).is_some_and(|kind| kind == PROBLEM_JSON);
    if shaped || !(status.is_client_error() || status.is_server_error()) {
        return response;
    }
    let mut problem = Problem::of_status(status).into_response();
    if let Some(allow) = response.headers().get(header::ALLOW) {
        problem.headers_mut().insert(header::ALLOW, allow.clone());
    }
    problem
}

async fn with_headers(secure: bool, mut response: Response) -> Response {
    const HEADERS: [(HeaderName, &str); 7] = [
        (
            header::CONTENT_SECURITY_POLICY,
            "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; \
             base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        ),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (header::CACHE_CONTROL, "no-store"),
    ];
    for (name, value) in HEADERS {
        response.headers_mut().entry(name).or_insert(HeaderValue::from_static(value));
    }
    if secure {
        let year = HeaderValue::from_static("max-age=31536000");
        response.headers_mut().insert(header::STRICT_TRANSPORT_SECURITY, year);
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::StatusCode;

    #[test]
    fn a_term_is_taken_back_and_the_daemon_is_seen_while_everything_else_hangs() {
        let slots = Slots::new(1);
        let _hanging = slots.of("/api/v1/loops/{id}/samples").try_acquire_owned().expect("one slot");
        for other in ["/api/v1/loops", "/api/v1/loops/{id}/writeback/grant", "/index.html", ""] {
            assert_eq!(slots.of(other).available_permits(), 0, "{other}");
        }
        let withdraw = "/api/v1/loops/{id}/writeback/withdraw";
        let own = [withdraw, "/api/v1/session", "/readyz", "/api/v1/metrics"];
        assert!(own.iter().all(|path| slots.of(path).available_permits() == OWN_SLOTS));
        let sessions = slots.of("/api/v1/session");
        let _all = sessions.try_acquire_many_owned(OWN_SLOTS as u32).expect("all of them");
        assert_eq!(slots.of("/api/v1/session").available_permits(), 0);
        assert_eq!(slots.of(withdraw).available_permits(), OWN_SLOTS, "log-ins keep nobody from it");
        // The routes are those of the table.
        for path in ["/loops/{id}/writeback/withdraw", "/session", "/readyz", "/metrics"] {
            assert!(super::super::policy::RULES.iter().any(|(_, known, _)| *known == path), "{path}");
        }
    }

    #[tokio::test]
    async fn work_that_goes_on_after_its_time_keeps_its_slot() {
        let slots = Arc::new(Semaphore::new(1));
        let (end, ended) = std::sync::mpsc::channel::<()>();
        let slow = async move {
            // Until the other side is dropped.
            let _ = blocking(move || ended.recv()).await;
            Response::default()
        };
        let short = Duration::from_millis(10);
        let late = within(slots.clone(), short, slow).await;
        assert_eq!(late.status(), StatusCode::SERVICE_UNAVAILABLE, "no answer in time");
        assert_eq!(slots.available_permits(), 0, "the work goes on");
        let refused = within(slots.clone(), short, async { Response::default() }).await;
        assert_eq!(refused.status(), StatusCode::SERVICE_UNAVAILABLE);

        drop(end);
        let freed = tokio::time::timeout(Duration::from_secs(20), slots.acquire()).await;
        drop(freed.expect("the work has ended").expect("the slots are there"));
        let answered = within(slots, Duration::from_secs(20), async { Response::default() }).await;
        assert_eq!(answered.status(), StatusCode::OK);
    }
}
