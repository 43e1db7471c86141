//! Takes a request apart; what cannot be understood becomes a problem that names the field.

use super::Context;
use super::problem::Problem;
use crate::alarm::AlarmId;
use crate::detectors::Method;
use crate::signal::LoopId;
use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::StatusCode;
use axum::http::request::Parts;
use serde::de::DeserializeOwned;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// The query string as `T`.
pub struct Params<T>(pub T);

impl<T: DeserializeOwned, S: Sync> FromRequestParts<S> for Params<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self, Problem> {
        Query::<T>::try_from_uri(&parts.uri).map(|Query(params)| Self(params)).map_err(|rejection| {
            let text = rejection.body_text();
            let text = text.strip_prefix("Failed to deserialize query string: ").unwrap_or(&text);
            refused(text)
        })
    }
}

/// The JSON body as `T`; an empty body, or null, as its default.
pub struct Body<T>(pub T);

impl<T: DeserializeOwned + Default, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let bytes = body(request, state).await?;
        if bytes.is_empty() {
            return Ok(Self(T::default()));
        }
        from_json::<Option<T>>(&bytes).map(|body| Self(body.unwrap_or_default()))
    }
}

/// The JSON body as `T`.
pub struct Required<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Required<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        from_json(&body(request, state).await?).map(Self)
    }
}

async fn body<S: Send + Sync>(request: Request, state: &S) -> Result<Bytes, Problem> {
    Bytes::from_request(request, state).await.map_err(|rejection| Problem::of_status(rejection.status()))
}

fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    serde_json::from_slice(bytes).map_err(|error| refused(&format!("body: {error}")))
}

/// A problem of serde's message, which is `field: what` or names the field between backticks.
fn refused(text: &str) -> Problem {
    let quoted = text.split('`').nth(1).filter(|_| text.contains("field `"));
    let field = quoted.or_else(|| text.split_once(": ").map(|(field, _)| field)).unwrap_or("query");
    Problem::field(field, text)
}

/// The loop in the path; a problem when it is not there.
pub struct OfLoop(pub LoopId);

impl FromRequestParts<Arc<Context>> for OfLoop {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<Context>) -> Result<Self, Problem> {
        let id = LoopId::new(Named::from_request_parts(parts, state).await?.0);
        let known = state.plant.borrow().info(&id).is_some();
        if known { Ok(Self(id)) } else { Err(Problem::unknown_loop(id.as_str())) }
    }
}

/// The loop and the published method in the path; a problem when either is not there.
pub struct OfMethod(pub LoopId, pub Method);

impl FromRequestParts<Arc<Context>> for OfMethod {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<Context>) -> Result<Self, Problem> {
        let bad =
            |_| Problem::new(StatusCode::BAD_REQUEST, "bad_path", "the path is not percent-encoded UTF-8");
        let Path((name, method)) =
            Path::<(String, String)>::from_request_parts(parts, state).await.map_err(bad)?;
        let id = LoopId::new(name);
        if state.plant.borrow().info(&id).is_none() {
            return Err(Problem::unknown_loop(id.as_str()));
        }
        let known = Method::named(&method).ok_or_else(|| Problem::unknown_method(&method))?;
        Ok(Self(id, known))
    }
}

/// The name in the path, whatever it names.
pub struct Named(pub String);

impl<S: Send + Sync> FromRequestParts<S> for Named {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let Path(name) = Path::<String>::from_request_parts(parts, state).await.map_err(|_| {
            Problem::new(StatusCode::BAD_REQUEST, "bad_path", "the path is not percent-encoded UTF-8")
        })?;
        Ok(Self(name))
    }
}

/// The alarm in the path, whole or in two halves; whether it is there is for the results to say.
pub struct OfAlarm(pub AlarmId);

impl FromRequestParts<Arc<Context>> for OfAlarm {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<Context>) -> Result<Self, Problem> {
        let bad =
            |_| Problem::new(StatusCode::BAD_REQUEST, "bad_path", "the path is not percent-encoded UTF-8");
        let halves = Path::<Vec<(String, String)>>::from_request_parts(parts, state).await.map_err(bad)?.0;
        let names: Vec<&str> = halves.iter().map(|(_, value)| value.as_str()).collect();
        Ok(Self(AlarmId::named(&names.join("/"))))
    }
}

/// A number that must lie in a range.
pub fn within<T: PartialOrd + std::fmt::Display>(
    field: &str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<T, Problem> {
    if range.contains(&value) {
        return Ok(value);
    }
    Err(Problem::field(field, format!("{field}: {value} must be {} to {}", range.start(), range.end())))
}

/// A text that must not be longer than `most` characters or carry control characters.
pub fn short(field: &str, text: Option<String>, most: usize) -> Result<Option<String>, Problem> {
    match &text {
        Some(t) if t.chars().count() > most => {
            Err(Problem::field(field, format!("{field}: at most {most} characters")))
        }
        Some(t) if t.chars().any(char::is_control) => {
            Err(Problem::field(field, format!("{field}: no control characters")))
        }
        _ => Ok(text),
    }
}
