//! Reports for printing: HTML, each in one file.

use super::super::dto::alarms::AlarmChangeItem;
use super::super::dto::evidence::LoopEvidence;
use super::super::dto::loops::{LoopDiagnosis, LoopItem, RunItem};
use super::super::dto::params::NoQuery;
use super::super::dto::plantwide::LoopHealth;
use super::super::dto::rfc3339;
use super::super::extract::{OfLoop, Params};
use super::super::layers::blocking;
use super::super::problem::Problem;
use super::super::report;
use super::super::{Context, LoopInfo};
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;

type Shared = State<Arc<Context>>;

/// One loop as a page for printing and for a work order.
#[utoipa::path(get, path = "/loops/{id}/report.html", tag = "reports",
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, content_type = "text/html", body = String), (status = 404, description = "problem: no such loop")))]
pub async fn of_loop(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    page(move || {
        let now = context.clock.now();
        let unknown = || Problem::unknown_loop(id.as_str());
        let known = context.results.get(&id, now).ok_or_else(unknown)?;
        let plant = context.plant();
        let info = plant.info(&id).ok_or_else(unknown)?;
        let item = LoopItem::new(info, &known, context.standing(&id), now);
        let runs: Vec<RunItem> =
            context.results.summaries(&id).unwrap_or_default().iter().map(RunItem::from).collect();
        let log = context.results.alarm_log();
        let own = log.iter().filter(|change| change.id.of_loop() == Some(&id));
        let alarms: Vec<AlarmChangeItem> = own.map(|change| AlarmChangeItem::from(&**change)).collect();
        let health = context.plantwide.as_ref().and_then(|port| port.health(&id)).unwrap_or_default();
        Ok(report::of_loop(&report::Subject {
            health: &LoopHealth::from(&health),
            item: &item,
            diagnosis: LoopDiagnosis::latest(&known, now).as_ref(),
            evidence: LoopEvidence::latest(&known).as_ref(),
            runs: &runs,
            alarms: &alarms,
            now: rfc3339(now).as_deref(),
        }))
    })
    .await
}

/// The plant as a page for printing.
#[utoipa::path(get, path = "/report.html", tag = "reports",
    responses((status = 200, content_type = "text/html", body = String)))]
pub async fn of_plant(
    State(context): Shared,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    page(move || {
        let now = context.clock.now();
        let plant = context.plant();
        let item = |info: &LoopInfo| {
            Some(LoopItem::new(info, &context.results.get(&info.id, now)?, context.standing(&info.id), now))
        };
        let mut items: Vec<LoopItem> = plant.loops().iter().filter_map(item).collect();
        items.sort_by(|a, b| {
            let f = |item: &LoopItem| item.f.unwrap_or(-1.0);
            b.severity.cmp(&a.severity).then(f(b).total_cmp(&f(a))).then_with(|| a.id.cmp(&b.id))
        });
        let alarms = context.results.alarms(now);
        let to_acknowledge = alarms.iter().filter(|view| view.state.wants_acknowledgement()).count();
        Ok(report::of_plant(&items, to_acknowledge, rfc3339(now).as_deref()))
    })
    .await
}

/// Writes a page off the async threads, and sends it under the reports' own policy.
pub async fn page(
    write: impl FnOnce() -> Result<String, Problem> + Send + 'static,
) -> Result<Response, Problem> {
    let written = blocking(write).await.unwrap_or_else(|error| {
        tracing::error!(%error, "a report failed inside");
        Err(Problem::internal())
    })?;
    let head = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8"),
        (header::CONTENT_SECURITY_POLICY, &report::POLICY),
    ];
    Ok((head, written).into_response())
}
