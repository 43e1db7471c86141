//! The audit log, read-only.

use super::super::Context;
use super::super::dto::audit::{AuditList, AuditQuery};
use super::super::extract::{Params, within};
use super::super::problem::Problem;
use super::off_thread;
use crate::audit;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use std::sync::Arc;

/// What was changed, by whom, from where, and with what result; newest first.
#[utoipa::path(get, path = "/audit", tag = "system", operation_id = "audit", params(AuditQuery),
    responses((status = 200, body = AuditList), (status = 400, description = "problem: the field is named"),
        (status = 404, description = "problem: there is no audit log")))]
pub async fn list(
    State(context): State<Arc<Context>>,
    Params(query): Params<AuditQuery>,
) -> Result<Response, Problem> {
    let limit = within("limit", query.limit.unwrap_or(100), 1..=1000)?;
    let none = || {
        let detail = "there is no audit log: the configuration has no [audit]";
        Problem::new(StatusCode::NOT_FOUND, "no_audit", detail)
    };
    let path = context.audit.as_ref().ok_or_else(none)?.path().to_path_buf();
    off_thread(move || {
        let page = audit::page(&path, query.before, limit).map_err(|error| {
            tracing::error!(%error, "the audit log cannot be read");
            Problem::internal()
        })?;
        Ok(AuditList::from(page))
    })
    .await
}
