//! What every request passes: bounds on size, time and number, headers, and one shape of errors.

use super::Context;
use super::guard::guard;
use super::names::own_names;
use super::problem::{PROBLEM_JSON, Problem};
use axum::Router;
use axum::extract::{DefaultBodyLimit, Request};
use axum::http::{HeaderName, HeaderValue, header};
use axum::middleware::{Next, from_fn, from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;
use tower_http::compression::CompressionLayer;
use tower_http::limit::RequestBodyLimitLayer;

/// Wraps the routes; the last layer is the outermost.
pub fn wrap(routes: Router, context: &Arc<Context>) -> Router {
    let config = &context.config;
    let secure = config.tls.is_some();
    let slots = Arc::new(Semaphore::new(config.max_requests));
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

/// Refuses what is too much at once, and gives up on what takes too long. A stream counts until it begins.
async fn bounded(slots: Arc<Semaphore>, timeout: Duration, request: Request, next: Next) -> Response {
    let Ok(_slot) = slots.try_acquire() else {
        return Problem::busy("too_many_requests", "too many requests at once").into_response();
    };
    match tokio::time::timeout(timeout, next.run(request)).await {
        Ok(response) => response,
        Err(_) => Problem::busy("timeout", "no answer in time").into_response(),
    }
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
