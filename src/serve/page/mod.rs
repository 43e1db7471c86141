//! The dashboard: files in the binary, nothing from anywhere else. Each has an ETag; a browser asks again and hears 304.

use super::conditional::{holds, tag};
use axum::Router;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";
const TEXT: &str = "text/plain; charset=utf-8";

/// Path, type and content.
const FILES: &[(&str, &str, &str)] = &[
    ("/", HTML, include_str!("assets/index.html")),
    ("/app.css", CSS, include_str!("assets/app.css")),
    ("/icon.svg", SVG, include_str!("assets/icon.svg")),
    ("/js/actions.js", SCRIPT, include_str!("assets/js/actions.js")),
    ("/js/alarms.js", SCRIPT, include_str!("assets/js/alarms.js")),
    ("/js/api.js", SCRIPT, include_str!("assets/js/api.js")),
    ("/js/audit.js", SCRIPT, include_str!("assets/js/audit.js")),
    ("/js/board.js", SCRIPT, include_str!("assets/js/board.js")),
    ("/js/dom.js", SCRIPT, include_str!("assets/js/dom.js")),
    ("/js/evidence.js", SCRIPT, include_str!("assets/js/evidence.js")),
    ("/js/format.js", SCRIPT, include_str!("assets/js/format.js")),
    ("/js/fleet.js", SCRIPT, include_str!("assets/js/fleet.js")),
    ("/js/groups.js", SCRIPT, include_str!("assets/js/groups.js")),
    ("/js/health.js", SCRIPT, include_str!("assets/js/health.js")),
    ("/js/lines.js", SCRIPT, include_str!("assets/js/lines.js")),
    ("/js/live.js", SCRIPT, include_str!("assets/js/live.js")),
    ("/js/login.js", SCRIPT, include_str!("assets/js/login.js")),
    ("/js/loop.js", SCRIPT, include_str!("assets/js/loop.js")),
    ("/js/main.js", SCRIPT, include_str!("assets/js/main.js")),
    ("/js/map.js", SCRIPT, include_str!("assets/js/map.js")),
    ("/js/opinions.js", SCRIPT, include_str!("assets/js/opinions.js")),
    ("/js/plant.js", SCRIPT, include_str!("assets/js/plant.js")),
    ("/js/receivers.js", SCRIPT, include_str!("assets/js/receivers.js")),
    ("/js/session.js", SCRIPT, include_str!("assets/js/session.js")),
    ("/js/settings.js", SCRIPT, include_str!("assets/js/settings.js")),
    ("/js/states.js", SCRIPT, include_str!("assets/js/states.js")),
    ("/js/store.js", SCRIPT, include_str!("assets/js/store.js")),
    ("/js/svg.js", SCRIPT, include_str!("assets/js/svg.js")),
    ("/js/tiles.js", SCRIPT, include_str!("assets/js/tiles.js")),
    ("/js/trend.js", SCRIPT, include_str!("assets/js/trend.js")),
    ("/js/work.js", SCRIPT, include_str!("assets/js/work.js")),
    ("/vendor/uplot.min.js", SCRIPT, include_str!("assets/vendor/uplot.min.js")),
    ("/vendor/uplot.min.css", CSS, include_str!("assets/vendor/uplot.min.css")),
    ("/vendor/uplot.LICENSE", TEXT, include_str!("assets/vendor/uplot.LICENSE")),
];

/// Whether this is one of the dashboard's files.
pub fn has(route: &str) -> bool {
    FILES.iter().any(|(path, ..)| *path == route)
}

/// `/` and what it needs.
pub fn routes() -> Router {
    FILES.iter().fold(Router::new(), |router, &(path, kind, content)| {
        let tag = tag([content.as_bytes()]);
        router.route(path, get(move |asked: HeaderMap| async move { answer(&asked, kind, content, &tag) }))
    })
}

fn answer(asked: &HeaderMap, kind: &'static str, content: &'static str, tag: &HeaderValue) -> Response {
    // Asked for again every time, so that another version of the daemon shows its own page at once.
    let head = [(header::ETAG, tag.clone()), (header::CACHE_CONTROL, HeaderValue::from_static("no-cache"))];
    if holds(asked, tag) {
        return (StatusCode::NOT_MODIFIED, head).into_response();
    }
    (head, [(header::CONTENT_TYPE, kind)], content).into_response()
}
