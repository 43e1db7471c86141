//! The overview page: three files in the binary, nothing from anywhere else.

use axum::Router;
use axum::http::header;
use axum::routing::get;

/// `/` and what it needs.
pub fn routes() -> Router {
    let file = |kind: &'static str, text: &'static str| {
        get(move || async move { ([(header::CONTENT_TYPE, kind)], text) })
    };
    Router::new()
        .route("/", file("text/html; charset=utf-8", include_str!("index.html")))
        .route("/page.css", file("text/css; charset=utf-8", include_str!("page.css")))
        .route("/page.js", file("text/javascript; charset=utf-8", include_str!("page.js")))
        .route("/plot.js", file("text/javascript; charset=utf-8", include_str!("plot.js")))
}
