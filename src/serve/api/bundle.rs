//! A diagnosis with everything it rests on, to be replayed elsewhere.

use super::super::Context;
use super::super::dto::bundle::{Bundle, MOST_SAMPLES};
use super::super::dto::params::NoQuery;
use super::super::extract::{OfLoop, Params};
use super::super::problem::Problem;
use super::off_thread;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::Response;
use std::sync::Arc;

/// The latest diagnosis with its samples, settings and version: `stictiond replay` makes the same of it on any desk.
#[utoipa::path(get, path = "/loops/{id}/bundle", tag = "loops",
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = Bundle),
        (status = 404, description = "problem: no such loop, or no diagnosis since the start"),
        (status = 409, description = "problem: the samples are no longer there, or too many")))]
pub async fn bundle(
    State(context): State<Arc<Context>>,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    let known = context.results.get(&id, context.clock.now());
    let known = known.ok_or_else(|| Problem::unknown_loop(id.as_str()))?;
    let not_yet =
        || Problem::not_diagnosed_yet(id.as_str(), known.last.as_ref().map(|last| last.outcome.as_ref()));
    let run = known.diagnosed.clone().ok_or_else(not_yet)?;
    let basis = run.basis.clone().ok_or_else(not_yet)?;
    let conflict = |kind, detail: String| Problem::new(StatusCode::CONFLICT, kind, detail);
    if basis.samples() > MOST_SAMPLES {
        let detail = format!("{} samples, a bundle holds {MOST_SAMPLES}", basis.samples());
        return Err(conflict("bundle_too_large", detail));
    }
    let mut answer = off_thread(move || {
        let plant = context.plant();
        let info = plant.info(&run.id).ok_or_else(|| Problem::unknown_loop(run.id.as_str()))?;
        let record = plant.recall.as_ref().and_then(|recall| recall(&run.id, &basis)).ok_or_else(|| {
            let detail = "the history has moved on since the diagnosis, and no store has its samples: ask for a \
                          diagnosis and then again";
            conflict("samples_gone", detail.to_string())
        })?;
        Bundle::of(info, &run, &basis, &record).ok_or_else(Problem::internal)
    })
    .await?;
    let name = HeaderValue::from_static("attachment; filename=\"bundle.json\"");
    answer.headers_mut().insert(header::CONTENT_DISPOSITION, name);
    Ok(answer)
}
