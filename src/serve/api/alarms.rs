//! Alarms, and what an operator may do to them.

use super::super::Context;
use super::super::dto::alarms::{AlarmChangeItem, AlarmHistory, AlarmItem, AlarmList};
use super::super::dto::params::{ActBody, AlarmHistoryQuery, AlarmState, AlarmsQuery, ShelveBody};
use super::super::dto::rfc3339;
use super::super::extract::{Body, OfLoop, Params, Required, short, within};
use super::super::guard::Actor;
use super::super::problem::Problem;
use super::off_thread;
use crate::alarm::Refusal;
use crate::results::{Action, AlarmChange};
use crate::signal::LoopId;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use std::sync::Arc;

type Shared = State<Arc<Context>>;

/// The alarms that are not normal, or those of one state.
#[utoipa::path(get, path = "/alarms", tag = "alarms", params(AlarmsQuery), responses((status = 200, body = AlarmList)))]
pub async fn list(State(context): Shared, Params(query): Params<AlarmsQuery>) -> Result<Response, Problem> {
    off_thread(move || {
        let now = context.clock.now();
        let items = context.results.alarms(now).iter().map(AlarmItem::from).collect::<Vec<_>>();
        let wanted = |item: &AlarmItem| match query.state {
            Some(state) => item.state == state,
            None => item.state != AlarmState::Normal,
        };
        Ok(AlarmList { time: rfc3339(now), items: items.into_iter().filter(wanted).collect() })
    })
    .await
}

/// The changes of alarms that are remembered, newest first.
#[utoipa::path(get, path = "/alarms/history", tag = "alarms", params(AlarmHistoryQuery),
    responses((status = 200, body = AlarmHistory), (status = 400, description = "problem: the field is named")))]
pub async fn history(
    State(context): Shared,
    Params(query): Params<AlarmHistoryQuery>,
) -> Result<Response, Problem> {
    let limit = within("limit", query.limit.unwrap_or(100), 1..=2000)?;
    off_thread(move || {
        let log = context.results.alarm_log();
        let wanted =
            |change: &&AlarmChange| query.r#loop.as_deref().is_none_or(|id| change.id.as_str() == id);
        Ok(AlarmHistory { items: log.iter().filter(wanted).take(limit).map(AlarmChangeItem::from).collect() })
    })
    .await
}

/// An operator has seen the alarm.
#[utoipa::path(post, path = "/alarms/{id}/ack", tag = "alarms", request_body = Option<ActBody>,
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = AlarmItem), (status = 404, description = "problem: no such loop"),
        (status = 409, description = "problem: there is nothing to acknowledge")))]
pub async fn acknowledge(
    State(context): Shared,
    OfLoop(id): OfLoop,
    actor: Actor,
    Body(body): Body<ActBody>,
) -> Result<Json<AlarmItem>, Problem> {
    act(&context, &id, Action::Acknowledge, actor.signed(body.by), body.comment)
}

/// An operator silences the alarm for a time; on a shelved alarm, sets a new end.
#[utoipa::path(post, path = "/alarms/{id}/shelve", tag = "alarms", request_body = ShelveBody,
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = AlarmItem), (status = 400, description = "problem: the field is named"),
        (status = 404, description = "problem: no such loop")))]
pub async fn shelve(
    State(context): Shared,
    OfLoop(id): OfLoop,
    actor: Actor,
    Required(body): Required<ShelveBody>,
) -> Result<Json<AlarmItem>, Problem> {
    act(&context, &id, Action::Shelve(body.duration_s), actor.signed(body.by), body.comment)
}

/// An operator ends the silence.
#[utoipa::path(post, path = "/alarms/{id}/unshelve", tag = "alarms", request_body = Option<ActBody>,
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = AlarmItem), (status = 404, description = "problem: no such loop"),
        (status = 409, description = "problem: it is not shelved")))]
pub async fn unshelve(
    State(context): Shared,
    OfLoop(id): OfLoop,
    actor: Actor,
    Body(body): Body<ActBody>,
) -> Result<Json<AlarmItem>, Problem> {
    act(&context, &id, Action::Unshelve, actor.signed(body.by), body.comment)
}

fn act(
    context: &Context,
    id: &LoopId,
    action: Action,
    by: Option<String>,
    comment: Option<String>,
) -> Result<Json<AlarmItem>, Problem> {
    let (by, comment) = (short("by", by, 100)?, short("comment", comment, 1000)?);
    let acted = context.results.act(id, action, by, comment, context.clock.now());
    match acted.ok_or_else(|| Problem::unknown_loop(id.as_str()))? {
        Ok(view) => Ok(Json(AlarmItem::from(&view))),
        Err(refusal @ Refusal::BadDuration { .. }) => {
            Err(Problem::field("duration_s", format!("duration_s: {refusal}")))
        }
        Err(refusal) => Err(Problem::new(StatusCode::CONFLICT, "alarm_state", refusal.to_string())),
    }
}
