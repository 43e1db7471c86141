//! What the published methods looked at.

use super::super::Context;
use super::super::dto::opinions::LoopOpinion;
use super::super::dto::params::NoQuery;
use super::super::extract::{OfMethod, Params};
use super::super::problem::Problem;
use super::off_thread;
use axum::extract::State;
use axum::response::Response;
use std::sync::Arc;

/// What one published method says of the loop, and what it looked at in the window of the latest diagnosis.
#[utoipa::path(get, path = "/loops/{id}/opinions/{method}", tag = "loops",
    params(("id" = String, Path, description = "the loop's name"),
        ("method" = String, Path, description = "the method, as `opinions` of the diagnosis names it")),
    responses((status = 200, body = LoopOpinion),
        (status = 404, description = "problem: no such loop, no such method, or no diagnosis yet")))]
pub async fn opinion(
    State(context): State<Arc<Context>>,
    OfMethod(id, method): OfMethod,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    off_thread(move || {
        let known = context.results.get(&id, context.clock.now());
        let known = known.ok_or_else(|| Problem::unknown_loop(id.as_str()))?;
        LoopOpinion::latest(&known, method).ok_or_else(|| {
            let last = known.last.as_ref().map(|last| last.outcome.as_ref());
            Problem::not_diagnosed_yet(id.as_str(), last)
        })
    })
    .await
}
