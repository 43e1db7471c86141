//! The fleet that this machine is a part of.

use super::super::Context;
use super::super::dto::fleet::Fleet;
use super::super::dto::params::NoQuery;
use super::super::extract::Params;
use super::super::problem::Problem;
use axum::Json;
use axum::extract::State;
use std::sync::Arc;

/// The fleet as this machine sees it: who is there, how far behind, whose clock is off.
#[utoipa::path(get, path = "/fleet", tag = "system", responses((status = 200, body = Fleet)))]
pub async fn fleet(
    State(context): State<Arc<Context>>,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Json<Fleet>, Problem> {
    let now = context.clock.now();
    Ok(Json(match &context.fleet {
        Some(port) => Fleet::of(port.seen(), now),
        None => Fleet::alone(now),
    }))
}
