//! The plant as a whole: groups of loops that swing together, the work list, indicators.

use super::super::dto::params::NoQuery;
use super::super::dto::plantwide::{
    GroupDetail, GroupList, LoopHealth, WorkActed, WorkBody, WorkItem, WorkListing, WorkQuery,
};
use super::super::extract::{Body, Named, OfLoop, Params, short};
use super::super::guard::Actor;
use super::super::ports::{FleetPort, PlantwidePort, WorkLine};
use super::super::problem::Problem;
use super::super::report;
use super::super::{AskDurable, Context};
use super::off_thread;
use super::report::page;
use crate::signal::LoopId;
use crate::work::Act;
use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;

type Shared = State<Arc<Context>>;

fn port(context: &Context) -> Result<Arc<dyn PlantwidePort>, Problem> {
    let none = || {
        Problem::new(
            StatusCode::NOT_FOUND,
            "no_plantwide",
            "this daemon does not look at the plant as a whole",
        )
    };
    context.plantwide.clone().ok_or_else(none)
}

/// Groups of loops that swing together, by the latest look at the plant; without a time before the first.
#[utoipa::path(get, path = "/groups", tag = "plant", responses((status = 200, body = GroupList)))]
pub async fn groups(
    State(context): Shared,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Json<GroupList>, Problem> {
    Ok(Json(port(&context)?.overview().map(|found| GroupList::of(&found)).unwrap_or_default()))
}

/// Looks at the plant now.
#[utoipa::path(post, path = "/groups", tag = "plant",
    responses((status = 202, description = "it is looked at"),
        (status = 409, description = "problem: it is looked at already, or [plantwide] is switched off")))]
pub async fn look(State(context): Shared, Body(()): Body<()>) -> Result<StatusCode, Problem> {
    let refused = || {
        let detail = "the plant is looked at already, or [plantwide] enabled is false";
        Problem::new(StatusCode::CONFLICT, "looking", detail)
    };
    port(&context)?.look().then_some(StatusCode::ACCEPTED).ok_or_else(refused)
}

/// One group with its pictures.
#[utoipa::path(get, path = "/groups/{number}", tag = "plant",
    params(("number" = usize, Path, description = "the group's number")),
    responses((status = 200, body = GroupDetail), (status = 404, description = "problem: no such group")))]
pub async fn group(
    State(context): Shared,
    Named(number): Named,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    let found = port(&context)?.overview().unwrap_or_default();
    off_thread(move || {
        let none =
            || Problem::new(StatusCode::NOT_FOUND, "unknown_group", format!("there is no group {number}"));
        number.parse().ok().and_then(|number| GroupDetail::of(&found, number)).ok_or_else(none)
    })
    .await
}

/// What to do, first things first.
#[utoipa::path(get, path = "/work", tag = "plant", params(WorkQuery), responses((status = 200, body = WorkListing)))]
pub async fn work(State(context): Shared, Params(query): Params<WorkQuery>) -> Result<Response, Problem> {
    let port = port(&context)?;
    off_thread(move || Ok(WorkListing::of(port.work(), query.all, context.clock.now()))).await
}

/// The work list as CSV: one line each, those that are over too.
#[utoipa::path(get, path = "/work.csv", tag = "plant",
    responses((status = 200, content_type = "text/csv", body = String)))]
pub async fn work_csv(
    State(context): Shared,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    let port = port(&context)?;
    let listing = WorkListing::of(port.work(), true, context.clock.now());
    let head = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8"),
        (header::CONTENT_DISPOSITION, "attachment; filename=\"work.csv\""),
    ];
    Ok((head, report::work_csv(&listing)).into_response())
}

/// The work list as a page for printing.
#[utoipa::path(get, path = "/work.html", tag = "reports",
    responses((status = 200, content_type = "text/html", body = String)))]
pub async fn work_html(
    State(context): Shared,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    let port = port(&context)?;
    page(move || Ok(report::of_work(&WorkListing::of(port.work(), false, context.clock.now())))).await
}

/// A route by which somebody acts on an order.
macro_rules! act {
    ($(#[$doc:meta])* $name:ident, $path:literal, $act:expr, $refused:literal) => {
        $(#[$doc])*
        #[utoipa::path(post, path = $path, tag = "plant", request_body = Option<WorkBody>,
            params(("id" = String, Path, description = "the loop's name")),
            responses((status = 200, body = WorkActed), (status = 404, description = "problem: no such order"),
                (status = 409, description = $refused)))]
        pub async fn $name(
            State(context): Shared,
            OfLoop(id): OfLoop,
            actor: Actor,
            Body(body): Body<WorkBody>,
        ) -> Result<Response, Problem> {
            act(context, id, $act, &actor, body).await
        }
    };
}

act!(
    /// Somebody orders the work.
    order, "/work/{id}/order", Act::Order, "problem: it is ordered already, or over"
);
act!(
    /// Somebody says that the work is done; what is measured from now on verifies it, or opens the order again.
    repaired, "/work/{id}/repaired", Act::Repaired, "problem: it is done already"
);
act!(
    /// Somebody does not want it.
    dismiss, "/work/{id}/dismiss", Act::Dismiss, "problem: it is done already, or over"
);
act!(
    /// Somebody opens it again.
    reopen, "/work/{id}/reopen", Act::Reopen, "problem: it is not ordered yet"
);

/// Acts; what was done is durable before it is answered, where there is a store that works.
async fn act(
    context: Arc<Context>,
    id: LoopId,
    act: Act,
    actor: &Actor,
    body: WorkBody,
) -> Result<Response, Problem> {
    may_act(context.fleet.as_deref())?;
    let (by, note) = (actor.signed(short("by", body.by, 100)?), short("note", body.note, 1000)?);
    let port = port(&context)?;
    off_thread(move || {
        let none =
            || Problem::new(StatusCode::NOT_FOUND, "unknown_order", format!("there is no order for {id}"));
        let refused =
            |why: crate::work::Refusal| Problem::new(StatusCode::CONFLICT, "work_state", why.to_string());
        let line = port.act(&id, act, by, note).ok_or_else(none)?.map_err(refused)?;
        Ok(acted(&line, context.durable.as_ref()))
    })
    .await
}

/// Nobody acts at a centre while another leads, as on alarms. Where no other is known, as while the server is away, the list is
/// worked on: it is in this centre's own store.
fn may_act(fleet: Option<&dyn FleetPort>) -> Result<(), Problem> {
    match fleet.and_then(|port| port.standby()).and_then(|own| own.leader) {
        Some(leader) => Err(Problem::not_leading("work_state", Some(&leader))),
        None => Ok(()),
    }
}

/// The order as it is now, once that is durable or cannot be.
fn acted(line: &WorkLine, durable: Option<&AskDurable>) -> WorkActed {
    let survives_restart = durable.is_some_and(|durable| durable());
    WorkActed { order: WorkItem::of(line), survives_restart }
}

/// The indicators of a loop: the latest hour, and its shift, day and week; every look of a week, and the days before. Without
/// any look before the first.
#[utoipa::path(get, path = "/loops/{id}/indicators", tag = "plant",
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = LoopHealth), (status = 404, description = "problem: no such loop")))]
pub async fn indicators(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Response, Problem> {
    off_thread(move || {
        let found = context.plantwide.as_ref().and_then(|port| port.health(&id)).unwrap_or_default();
        Ok(LoopHealth::from(&found))
    })
    .await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::serve::{FleetSeen, Standby};
    use crate::work::Order;

    /// A machine of a fleet, and which centre leads in its place.
    struct Fleet(Option<Standby>);

    impl FleetPort for Fleet {
        fn seen(&self) -> FleetSeen {
            FleetSeen::default()
        }

        fn standby(&self) -> Option<Standby> {
            self.0.clone()
        }
    }

    #[tokio::test]
    async fn nobody_acts_on_the_list_of_a_centre_while_another_leads_which_is_named() {
        assert!(may_act(None).is_ok() && may_act(Some(&Fleet(None))).is_ok());
        assert!(may_act(Some(&Fleet(Some(Standby { leader: None })))).is_ok(), "no other is known");
        let fleet = Fleet(Some(Standby { leader: Some("c1".to_string()) }));
        let refused = may_act(Some(&fleet)).expect_err("another leads");
        assert_eq!(refused.status(), StatusCode::CONFLICT);
        let body = refused.into_response().into_body();
        let body = axum::body::to_bytes(body, 10_000).await.expect("it is short");
        let body: serde_json::Value = serde_json::from_slice(&body).expect("JSON");
        assert!(
            body["detail"].as_str().is_some_and(|own| own.starts_with("another centre, c1, acts")),
            "{body}"
        );
        assert_eq!(body["leader"], "c1");
    }

    #[test]
    fn an_act_is_not_said_to_outlive_a_restart_that_it_would_not() {
        let line = WorkLine { order: Order::new(LoopId::new("FIC101"), 0.0), cost: None };
        let store = |works: bool| -> AskDurable { Arc::new(move || works) };
        assert!(acted(&line, Some(&store(true))).survives_restart);
        assert!(!acted(&line, Some(&store(false))).survives_restart);
        assert!(!acted(&line, None).survives_restart, "there is no store");
    }
}
