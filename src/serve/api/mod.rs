//! The routes, and their description made from them.

mod alarms;
mod audit;
mod backfill;
mod bundle;
mod description;
mod events;
mod evidence;
mod fleet;
mod health;
mod loops;
mod notifications;
mod opinions;
mod plantwide;
mod report;
mod session;
mod system;
mod writeback;

use super::Context;
use super::conditional::conditional;
use super::layers::blocking;
use super::problem::Problem;
use axum::Router;
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Response};
use axum::{Json, http::header};
use serde::Serialize;
use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

#[derive(OpenApi)]
#[openapi(info(
    title = "stictiond",
    description = "Which control valves stick, by how much, and how sure that is. Times are RFC 3339 in UTC; a number that \
                   does not exist is null; errors are RFC 9457 problem details."
))]
struct Description;

/// The API under `/api/v1`; health, metrics and the description at the root too, where their readers expect them.
pub fn routes(context: Arc<Context>) -> Router {
    let (router, description) = described().split_for_parts();
    let text = serde_json::to_string(&description::complete(description)).unwrap_or_default();
    let text: Arc<str> = text.into();
    let document = axum::routing::get(move || {
        let text = text.to_string();
        async move { ([(header::CONTENT_TYPE, "application/json")], text) }
    });
    let document = document.layer(from_fn(conditional));
    router
        .merge(alarms::halves())
        .route("/openapi.json", document.clone())
        .route("/api/v1/openapi.json", document)
        .with_state(context)
}

/// The description of the API, OpenAPI.
pub fn openapi() -> utoipa::openapi::OpenApi {
    description::complete(described().into_openapi())
}

fn described() -> OpenApiRouter<Arc<Context>> {
    let common = || {
        OpenApiRouter::new()
            .routes(routes!(health::healthz))
            .routes(routes!(health::readyz))
            .routes(routes!(health::metrics))
    };
    // Who holds an answer of these may ask whether it is still good.
    let mut kept = OpenApiRouter::new()
        .routes(routes!(loops::list))
        .routes(routes!(loops::map))
        .routes(routes!(loops::detail))
        .routes(routes!(loops::diagnosis, loops::diagnose_now))
        .routes(routes!(loops::diagnoses))
        .routes(routes!(loops::samples))
        .routes(routes!(loops::model))
        .routes(routes!(evidence::evidence))
        .routes(routes!(opinions::opinion))
        .routes(routes!(report::of_loop))
        .routes(routes!(report::of_plant))
        .routes(routes!(bundle::bundle))
        .routes(routes!(writeback::state))
        .routes(routes!(alarms::list))
        .routes(routes!(alarms::history))
        .routes(routes!(system::collectors))
        .routes(routes!(plantwide::work))
        .routes(routes!(plantwide::work_csv))
        .routes(routes!(plantwide::work_html))
        .routes(routes!(plantwide::group))
        .routes(routes!(plantwide::indicators))
        .routes(routes!(audit::list))
        .layer(from_fn(conditional));
    description::conditional(kept.get_openapi_mut());
    let api = kept
        .routes(routes!(evidence::live))
        .routes(routes!(alarms::acknowledge))
        .routes(routes!(alarms::shelve))
        .routes(routes!(alarms::unshelve))
        .routes(routes!(alarms::reset))
        .routes(routes!(alarms::take_out))
        .routes(routes!(alarms::give_back))
        .routes(routes!(notifications::list))
        .routes(routes!(notifications::dead_letters))
        .routes(routes!(notifications::replay))
        .routes(routes!(events::stream))
        .routes(routes!(plantwide::groups, plantwide::look))
        .routes(routes!(plantwide::order))
        .routes(routes!(plantwide::repaired))
        .routes(routes!(plantwide::dismiss))
        .routes(routes!(plantwide::reopen))
        .routes(routes!(system::system))
        .routes(routes!(fleet::fleet))
        .routes(routes!(session::state, session::begin, session::end))
        .routes(routes!(backfill::state, backfill::begin, backfill::cancel))
        .merge(common());
    #[cfg(feature = "writeback")]
    let api = api
        .routes(routes!(writeback::grant))
        .routes(routes!(writeback::approve))
        .routes(routes!(writeback::withdraw))
        .routes(routes!(writeback::reset));
    OpenApiRouter::with_openapi(Description::openapi()).merge(common()).nest("/api/v1", api)
}

/// A part of a list whose entries are sorted by a name of their own, which is the cursor: an entry that stays is neither
/// repeated nor lost, whatever comes or goes meanwhile.
struct Page<T> {
    total: usize,
    items: Vec<T>,
    next: Option<String>,
}

impl<T> Page<T> {
    fn of(mut items: Vec<T>, name: impl Fn(&T) -> &String, after: Option<&str>, limit: usize) -> Self {
        let total = items.len();
        items.sort_by(|a, b| name(a).cmp(name(b)));
        let passed = after.map_or(0, |after| items.partition_point(|item| name(item).as_str() <= after));
        items.drain(..passed);
        let more = items.len() > limit;
        items.truncate(limit);
        let next = items.last().filter(|_| more).map(|last| name(last).clone());
        Self { total, items, next }
    }
}

/// A place among those who listen to events.
fn event_place(context: &Context) -> Result<OwnedSemaphorePermit, Problem> {
    let full = |_| Problem::busy("too_many_event_clients", "too many clients listen to events already");
    context.event_clients.clone().try_acquire_owned().map_err(full)
}

/// Computes an answer off the async threads, its text included.
async fn off_thread<T: Serialize>(
    compute: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<Response, Problem> {
    let answer = blocking(move || compute().map(|value| Json(value).into_response()));
    answer.await.unwrap_or_else(|error| {
        tracing::error!(%error, "a request failed inside");
        Err(Problem::internal())
    })
}
