//! Write-back: its state, and in a binary that can write what a person may do. Where there is no log-in names are believed,
//! so what acts is served on loopback only; where there is one, it takes a person who logged in, and no program's token.

use super::super::Context;
use super::super::dto::params::NoQuery;
use super::super::dto::writeback::WritebackView;
use super::super::extract::{OfLoop, Params};
use super::super::problem::Problem;
use crate::signal::LoopId;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use std::sync::Arc;

type Shared = State<Arc<Context>>;

/// A loop's write-back: its state, what speaks against it, and what it did to ISE and travel.
#[utoipa::path(get, path = "/loops/{id}/writeback", tag = "writeback",
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = WritebackView),
        (status = 404, description = "problem: no such loop, or write-back is not enabled for it")))]
pub async fn state(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Json<WritebackView>, Problem> {
    let status = context.writeback.as_ref().and_then(|writeback| writeback.status(&id));
    status.map(|status| Json(WritebackView::from(&status))).ok_or_else(|| not_enabled(&id))
}

fn not_enabled(id: &LoopId) -> Problem {
    let detail = format!("write-back is not enabled for loop '{id}', or not built into this daemon");
    Problem::new(StatusCode::NOT_FOUND, "writeback_not_enabled", detail).with("loop", id.as_str())
}

#[cfg(feature = "writeback")]
pub use acting::*;

#[cfg(feature = "writeback")]
mod acting {
    use super::super::super::dto::params::{GrantBody, NameBody};
    use super::super::super::extract::{Required, short};
    use super::super::super::guard::Actor;
    use super::*;
    use crate::compensation::gate::{Action, Refusal};
    use axum::extract::FromRequestParts;
    use axum::http::header;
    use axum::http::request::Parts;
    use axum::http::uri::Authority;
    use std::net::IpAddr;

    /// An operator allows write-back for a time; a second person has to approve. By a person who logged in; without a log-in on loopback only, and names are believed.
    #[utoipa::path(post, path = "/loops/{id}/writeback/grant", tag = "writeback", request_body = GrantBody,
        params(("id" = String, Path, description = "the loop's name")),
        responses((status = 200, body = WritebackView), (status = 400, description = "problem: the field is named"),
            (status = 403, description = "problem: not by a person who may"),
            (status = 404, description = "problem: no such loop, or not enabled"),
            (status = 409, description = "problem: the state does not allow it"),
            (status = 503, description = "problem: the audit log takes no entry")))]
    pub async fn grant(
        State(context): Shared,
        OfLoop(id): OfLoop,
        acting: Acting,
        Required(body): Required<GrantBody>,
    ) -> Result<Json<WritebackView>, Problem> {
        act(&context, &id, Action::Grant(body.duration_s), acting.signed(body.by)).await
    }

    /// A second person agrees to the grant.
    #[utoipa::path(post, path = "/loops/{id}/writeback/approve", tag = "writeback", request_body = NameBody,
        params(("id" = String, Path, description = "the loop's name")),
        responses((status = 200, body = WritebackView), (status = 403, description = "problem: not by a person who may"),
            (status = 404, description = "problem: no such loop, or not enabled"),
            (status = 409, description = "problem: nothing to approve, or the same person"),
            (status = 503, description = "problem: the audit log takes no entry")))]
    pub async fn approve(
        State(context): Shared,
        OfLoop(id): OfLoop,
        acting: Acting,
        Required(body): Required<NameBody>,
    ) -> Result<Json<WritebackView>, Problem> {
        act(&context, &id, Action::Approve, acting.signed(body.by)).await
    }

    /// Takes the term back by a ramp to zero, or the grant before it was used.
    #[utoipa::path(post, path = "/loops/{id}/writeback/withdraw", tag = "writeback", request_body = NameBody,
        params(("id" = String, Path, description = "the loop's name")),
        responses((status = 200, body = WritebackView), (status = 403, description = "problem: not by a person who may"),
            (status = 404, description = "problem: no such loop, or not enabled"),
            (status = 409, description = "problem: nothing to withdraw")))]
    pub async fn withdraw(
        State(context): Shared,
        OfLoop(id): OfLoop,
        acting: Acting,
        Required(body): Required<NameBody>,
    ) -> Result<Json<WritebackView>, Problem> {
        act(&context, &id, Action::Withdraw, acting.signed(body.by)).await
    }

    /// An operator resets a trip; a new grant is needed afterwards.
    #[utoipa::path(post, path = "/loops/{id}/writeback/reset", tag = "writeback", request_body = NameBody,
        params(("id" = String, Path, description = "the loop's name")),
        responses((status = 200, body = WritebackView), (status = 403, description = "problem: not by a person who may"),
            (status = 404, description = "problem: no such loop, or not enabled"),
            (status = 409, description = "problem: it is not tripped"),
            (status = 503, description = "problem: the audit log takes no entry")))]
    pub async fn reset(
        State(context): Shared,
        OfLoop(id): OfLoop,
        acting: Acting,
        Required(body): Required<NameBody>,
    ) -> Result<Json<WritebackView>, Problem> {
        act(&context, &id, Action::Reset, acting.signed(body.by)).await
    }

    /// Asked by a person who logged in. Where there is no log-in, asked on this machine, under a name of this machine: a page
    /// whose name was made to point here is of one origin with the daemon, as a browser sees it.
    pub struct Acting(Actor);

    impl Acting {
        fn signed(&self, said: Option<String>) -> String {
            self.0.signed(said).unwrap_or_default()
        }
    }

    impl FromRequestParts<Arc<Context>> for Acting {
        type Rejection = Problem;

        async fn from_request_parts(parts: &mut Parts, context: &Arc<Context>) -> Result<Self, Problem> {
            let actor = Actor::from_request_parts(parts, context).await?;
            if !actor.unguarded {
                let detail = "two people answer for write-back: a person logs in for it, a program's token is not enough";
                let person = actor.is_person().then_some(Self(actor));
                return person.ok_or_else(|| Problem::new(StatusCode::FORBIDDEN, "person_only", detail));
            }
            let host = parts.headers.get(header::HOST).and_then(|host| host.to_str().ok());
            let detail = match (context.on_loopback(), host.is_some_and(is_loopback)) {
                (true, true) => return Ok(Self(actor)),
                (true, false) => {
                    "without a log-in write-back can be acted on from this machine only: open it as 127.0.0.1 or as \
                     localhost"
                }
                (false, _) => {
                    "without a log-in write-back can be acted on from this machine only, and this daemon listens on the \
                     network: add [access], or listen on 127.0.0.1"
                }
            };
            Err(Problem::new(StatusCode::FORBIDDEN, "loopback_only", detail))
        }
    }

    /// Whether a `Host` is localhost or a loopback address.
    fn is_loopback(host: &str) -> bool {
        let Ok(authority) = host.parse::<Authority>() else { return false };
        let name = authority.host().trim_start_matches('[').trim_end_matches(']');
        name.eq_ignore_ascii_case("localhost") || name.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
    }

    async fn act(
        context: &Context,
        id: &LoopId,
        action: Action,
        by: String,
    ) -> Result<Json<WritebackView>, Problem> {
        let by = short("by", Some(by), 100)?.unwrap_or_default();
        let writeback = context.writeback.as_ref().ok_or_else(|| not_enabled(id))?;
        // Taking a term back is the safe direction, and waits for no record.
        let is_safe = matches!(action, Action::Withdraw);
        if let Some(fault) = writeback.record().and_then(|record| record.fault()).filter(|_| !is_safe) {
            return Err(Problem::unrecorded(&fault));
        }
        match writeback.act(id, action, &by).await.ok_or_else(|| not_enabled(id))? {
            Ok(status) => Ok(Json(WritebackView::from(&status))),
            Err(refusal @ Refusal::BadDuration { .. }) => {
                Err(Problem::field("duration_s", format!("duration_s: {refusal}")))
            }
            Err(Refusal::Nameless) => Err(Problem::field("by", format!("by: {}", Refusal::Nameless))),
            Err(Refusal::Unrecorded) => Err(Problem::busy("audit_failed", Refusal::Unrecorded.to_string())),
            Err(refusal) => Err(Problem::new(StatusCode::CONFLICT, "writeback_state", refusal.to_string())),
        }
    }
}
