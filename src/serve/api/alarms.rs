//! Alarms, and what people may do to them.

use super::super::Context;
use super::super::dto::alarms::{AlarmActed, AlarmChangeItem, AlarmHistory, AlarmItem, AlarmList, FloodItem};
use super::super::dto::params::{ActBody, AlarmHistoryQuery, AlarmState, AlarmsQuery, ShelveBody};
use super::super::dto::rfc3339;
use super::super::extract::{Body, OfAlarm, Params, Required, short, within};
use super::super::guard::Actor;
use super::super::problem::Problem;
use super::{Page, off_thread};
use crate::alarm::{Action, AlarmId, Refusal, Shelving};
use crate::results::{AlarmChange, Said};
use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use axum::routing::post;
use std::sync::Arc;

type Shared = State<Arc<Context>>;

/// An alarm's name has a slash in it. Where a client does not write it as `%2F` its two halves come as two.
pub fn halves() -> Router<Arc<Context>> {
    Router::new()
        .route("/api/v1/alarms/{id}/{kind}/ack", post(acknowledge))
        .route("/api/v1/alarms/{id}/{kind}/reset", post(reset))
        .route("/api/v1/alarms/{id}/{kind}/shelve", post(shelve))
        .route("/api/v1/alarms/{id}/{kind}/unshelve", post(unshelve))
        .route("/api/v1/alarms/{id}/{kind}/out-of-service", post(take_out))
        .route("/api/v1/alarms/{id}/{kind}/in-service", post(give_back))
}

/// The alarms that are not normal, or those of one state, by name.
#[utoipa::path(get, path = "/alarms", tag = "alarms", params(AlarmsQuery), 
    responses((status = 200, body = AlarmList), (status = 400, description = "problem: the field is named")))]
pub async fn list(State(context): Shared, Params(query): Params<AlarmsQuery>) -> Result<Response, Problem> {
    let limit = within("limit", query.limit.unwrap_or(1000), 1..=10_000)?;
    off_thread(move || {
        let now = context.clock.now();
        let alarms = context.results.alarms(now);
        let to_acknowledge = alarms.iter().filter(|view| view.state.wants_acknowledgement()).count();
        let items = alarms.iter().map(AlarmItem::from).filter(|item| {
            query.state.map_or(item.state != AlarmState::Normal, |state| item.state == state)
                && query.kind.is_none_or(|kind| item.kind == kind)
                && query.priority.is_none_or(|priority| item.priority == priority)
                && query.r#loop.as_ref().is_none_or(|id| item.r#loop.as_ref() == Some(id))
        });
        let Page { total, items, next } =
            Page::of(items.collect(), |item| &item.id, query.after.as_deref(), limit);
        let flood = FloodItem::from(context.results.flood(now));
        Ok(AlarmList { time: rfc3339(now), total, to_acknowledge, items, next, flood })
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
        let wanted = |change: &&AlarmChange| {
            query.r#loop.as_deref().is_none_or(|id| change.id.of_loop().is_some_and(|own| own.as_str() == id))
                && query.kind.is_none_or(|kind| kind == change.id.kind.into())
                && query.after.is_none_or(|after| change.number < after)
        };
        let mut rest = log.iter().map(AsRef::as_ref).filter(wanted);
        let items: Vec<&AlarmChange> = rest.by_ref().take(limit).collect();
        let next = items.last().filter(|_| rest.next().is_some()).map(|last| last.number);
        Ok(AlarmHistory { items: items.into_iter().map(AlarmChangeItem::from).collect(), next })
    })
    .await
}

/// A route by which somebody acts on an alarm and says no more than a remark: its name, path, action, and what is in the way.
macro_rules! act {
    ($(#[$doc:meta])* $name:ident, $path:literal, $action:expr, $refused:literal) => {
        $(#[$doc])*
        #[utoipa::path(post, path = $path, tag = "alarms", request_body = Option<ActBody>,
            params(("id" = String, Path, description = "the alarm's name; a loop's name means its stiction")),
            responses((status = 200, body = AlarmActed), (status = 404, description = "problem: no such alarm"),
                (status = 409, description = $refused)))]
        pub async fn $name(
            context: Shared,
            OfAlarm(id): OfAlarm,
            actor: Actor,
            Body(body): Body<ActBody>,
        ) -> Result<Response, Problem> {
            act(context, id, $action, said(&actor, body.by, body.comment)?).await
        }
    };
}

act!(
    /// Somebody has seen the alarm.
    acknowledge, "/alarms/{id}/ack", Action::Acknowledge, "problem: there is nothing to acknowledge"
);
act!(
    /// Somebody lets a latched alarm go, which has been acknowledged and whose condition is gone.
    reset, "/alarms/{id}/reset", Action::Reset, "problem: there is nothing to reset"
);
act!(
    /// Somebody ends the silence.
    unshelve, "/alarms/{id}/unshelve", Action::Unshelve, "problem: it is not shelved"
);
act!(
    /// Somebody takes the alarm out of service, until it is given back.
    take_out, "/alarms/{id}/out-of-service", Action::TakeOut, "problem: it is out of service already"
);
act!(
    /// Somebody gives the alarm back to service.
    give_back, "/alarms/{id}/in-service", Action::GiveBack, "problem: it is in service"
);

/// Somebody silences the alarm for a time, or until its condition goes; on a shelved alarm, sets a new end.
#[utoipa::path(post, path = "/alarms/{id}/shelve", tag = "alarms", request_body = ShelveBody,
    params(("id" = String, Path, description = "the alarm's name; a loop's name means its stiction")),
    responses((status = 200, body = AlarmActed), (status = 400, description = "problem: the field is named"),
        (status = 404, description = "problem: no such alarm"),
        (status = 409, description = "problem: it is out of service, or there is nothing to shelve once")))]
pub async fn shelve(
    context: Shared,
    OfAlarm(id): OfAlarm,
    actor: Actor,
    Required(body): Required<ShelveBody>,
) -> Result<Response, Problem> {
    let how = if body.one_shot { Shelving::Once(body.duration_s) } else { Shelving::For(body.duration_s) };
    act(context, id, Action::Shelve(how), said(&actor, body.by, body.comment)?).await
}

/// Who acts on an alarm, and what they say: the one place where the name comes from.
fn said(actor: &Actor, by: Option<String>, comment: Option<String>) -> Result<Said, Problem> {
    Ok(Said { by: actor.signed(short("by", by, 100)?), comment: short("comment", comment, 1000)? })
}

/// Acts; what was done is durable before it is answered, where there is a store that works.
async fn act(State(context): Shared, id: AlarmId, action: Action, said: Said) -> Result<Response, Problem> {
    off_thread(move || {
        let acted = context.results.act(&id, action, said, context.clock.now());
        match acted.ok_or_else(|| Problem::unknown_alarm(&id.to_string()))? {
            Ok(view) => {
                let survives_restart = context.durable.as_ref().is_some_and(|durable| durable());
                Ok(AlarmActed { alarm: AlarmItem::from(&view), survives_restart })
            }
            Err(refusal @ Refusal::BadDuration { .. }) => {
                Err(Problem::field("duration_s", format!("duration_s: {refusal}")))
            }
            Err(Refusal::NotLeading) => {
                let standby = context.fleet.as_ref().and_then(|port| port.standby());
                let leader = standby.and_then(|own| own.leader);
                Err(Problem::not_leading("alarm_state", leader.as_deref()))
            }
            Err(refusal) => Err(Problem::new(StatusCode::CONFLICT, "alarm_state", refusal.to_string())),
        }
    })
    .await
}
