//! The daemon itself: where its data comes from, and its settings, read-only.

use super::super::dto::params::{CollectorsQuery, NoQuery};
use super::super::dto::rfc3339;
use super::super::dto::system::{CollectorItem, CollectorList, SettingItem, System};
use super::super::extract::{Params, within};
use super::super::metrics;
use super::super::problem::Problem;
use super::super::{Context, DeviceState};
use super::{Page, off_thread};
use crate::alarm::Kind;
use crate::version::BUILD;
use axum::Json;
use axum::extract::State;
use axum::response::Response;
use std::sync::Arc;

type Shared = State<Arc<Context>>;

/// The devices that data comes from, by name.
#[utoipa::path(get, path = "/collectors", tag = "system", params(CollectorsQuery),
    responses((status = 200, body = CollectorList), (status = 400, description = "problem: the field is named")))]
pub async fn collectors(
    State(context): Shared,
    Params(query): Params<CollectorsQuery>,
) -> Result<Json<CollectorList>, Problem> {
    let limit = within("limit", query.limit.unwrap_or(1000), 1..=10_000)?;
    let now = context.clock.now();
    let devices = (context.plant().devices)();
    let down = context.results.active(Kind::CollectorDown);
    let is_down = |device: &DeviceState| down.iter().any(|name| name.as_str() == device.name);
    let items = devices.iter().map(|device| CollectorItem::new(device, is_down(device), now)).collect();
    let Page { total, items, next } = Page::of(items, |item| &item.name, query.after.as_deref(), limit);
    Ok(Json(CollectorList { time: rfc3339(now), total, items, next }))
}

/// What the daemon is, how it is and what it was told. Secrets are never among it.
#[utoipa::path(get, path = "/system", tag = "system", responses((status = 200, body = System)))]
pub async fn system(
    State(context): Shared,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    off_thread(move || {
        let plant = context.plant();
        Ok(System {
            version: env!("CARGO_PKG_VERSION"),
            build: BUILD,
            writeback_built_in: cfg!(feature = "writeback"),
            time: rfc3339(context.clock.now()),
            started: rfc3339(context.started),
            memory_bytes: metrics::resident_bytes(),
            history_bytes: plant.history.memory_bytes(),
            loops: plant.loops().len(),
            tags: plant.history.tag_count(),
            event_places_left: context.event_clients.available_permits(),
            max_shelve_s: context.results.max_shelve_s(),
            scheduler: context.scheduler.counters().into(),
            settings: plant.facts.settings.iter().map(SettingItem::from).collect(),
        })
    })
    .await
}
