//! Whether it lives, whether it is ready, and how it is.

use super::super::dto::health::{AuditHealth, Health, Readiness, StoreHealth};
use super::super::dto::notifications::PostHealth;
use super::super::dto::params::NoQuery;
use super::super::dto::rfc3339;
use super::super::extract::Params;
use super::super::layers::blocking;
use super::super::problem::Problem;
use super::super::{Context, metrics as exposition};
use super::off_thread;
use crate::audit::Fault;
use crate::history::TagKind;
use crate::signal::Role;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;

type Shared = State<Arc<Context>>;

/// The process answers.
#[utoipa::path(get, path = "/healthz", tag = "health", responses((status = 200, body = Health)))]
pub async fn healthz(State(context): Shared, Params(NoQuery {}): Params<NoQuery>) -> Json<Health> {
    let now = context.clock.now();
    Json(Health {
        status: "ok",
        version: env!("CARGO_PKG_VERSION"),
        time: rfc3339(now),
        uptime_s: (now - context.started).max(0.0),
        store: store(&context),
        audit: audit(&context),
        notifications: notifications(&context),
    })
}

/// Data arrives and diagnoses have run; otherwise a problem whose `missing` says what is not there yet.
#[utoipa::path(get, path = "/readyz", tag = "health",
    responses((status = 200, body = Readiness), (status = 503, description = "problem: `missing` says what")))]
pub async fn readyz(
    State(context): Shared,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    off_thread(move || {
        let readiness = readiness(&context);
        if readiness.ready {
            return Ok(readiness);
        }
        Err(Problem::busy("not_ready", readiness.missing.join("; "))
            .with("ready", false)
            .with("missing", readiness.missing)
            .with("loops", readiness.loops)
            .with("loops_with_data", readiness.loops_with_data)
            .with("loops_diagnosed", readiness.loops_diagnosed)
            .with("store", serde_json::to_value(readiness.store).unwrap_or_default()))
    })
    .await
}

fn notifications(context: &Context) -> Option<PostHealth> {
    let receivers = context.notifications.as_ref()?.receivers();
    (!receivers.is_empty()).then(|| receivers.into())
}

fn audit(context: &Context) -> Option<AuditHealth> {
    let records = context.records();
    let faults: Vec<Fault> = records.iter().filter_map(|record| record.fault()).collect();
    (!records.is_empty()).then(|| AuditHealth::of(&faults))
}

fn store(context: &Context) -> Option<StoreHealth> {
    context.store.as_ref().map(|ask| StoreHealth::from(&ask()))
}

fn readiness(context: &Context) -> Readiness {
    let plant = context.plant();
    let has_data = |role| {
        let kind = TagKind::Role(role);
        move |values: &[(&crate::history::TagSpec, Option<crate::signal::Sample>)]| {
            values.iter().any(|(tag, s)| tag.kind == kind && s.is_some_and(|s| s.quality.is_good()))
        }
    };
    let (op, pv) = (has_data(Role::Op), has_data(Role::Pv));
    let fed = |info: &&super::super::LoopInfo| {
        let values = plant.history.latest(&info.id);
        op(&values) && pv(&values)
    };
    let loops = plant.loops().len();
    let loops_with_data = plant.loops().iter().filter(fed).count();
    let (loops_diagnosed, _) = context.results.coverage();
    let mut missing = Vec::new();
    if loops == 0 {
        missing.push("no loops are configured".to_string());
    }
    if loops > 0 && loops_with_data == 0 {
        missing.push("no loop has good OP and PV data yet".to_string());
    }
    if loops > 0 && loops_diagnosed == 0 {
        missing.push("no loop has been diagnosed yet".to_string());
    }
    Readiness {
        ready: missing.is_empty(),
        missing,
        loops,
        loops_with_data,
        loops_diagnosed,
        store: store(context),
    }
}

/// What a reader that knows OpenMetrics says it takes.
const OPEN_METRICS: &str = "application/openmetrics-text";

/// Metrics for Prometheus, in the format that it asks for.
#[utoipa::path(get, path = "/metrics", tag = "health",
    responses((status = 200, content((String = "text/plain"), (String = "application/openmetrics-text")))))]
pub async fn metrics(
    State(context): Shared,
    headers: HeaderMap,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    let mut accepted = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let open = accepted.any(|value| value.contains(OPEN_METRICS));
    let text = blocking(move || {
        let text = exposition::text(&context);
        if open { text } else { exposition::plain(&text) }
    });
    let text = text.await.map_err(|error| {
        tracing::error!(%error, "the metrics failed inside");
        Problem::internal()
    })?;
    let kind = match open {
        true => "application/openmetrics-text; version=1.0.0; charset=utf-8",
        false => "text/plain; version=0.0.4; charset=utf-8",
    };
    Ok(([(header::CONTENT_TYPE, kind), (header::VARY, "accept")], text).into_response())
}
