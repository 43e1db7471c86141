//! What went wrong, for the caller: RFC 9457 problem details. What went wrong inside is for the log.

use crate::audit::Fault;
use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value};

/// A refusal, with what to do about it.
#[derive(Clone, Debug)]
pub struct Problem {
    status: StatusCode,
    kind: &'static str,
    detail: String,
    more: Map<String, Value>,
}

impl Problem {
    /// A problem of a kind (the last part of its `type` URI).
    pub fn new(status: StatusCode, kind: &'static str, detail: impl Into<String>) -> Self {
        Self { status, kind, detail: detail.into(), more: Map::new() }
    }

    /// Its status.
    pub fn status(&self) -> StatusCode {
        self.status
    }

    /// 400: a field of the query or body is wrong.
    pub fn field(field: &str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "bad_field", detail).with("field", field)
    }

    /// 404: no such loop.
    pub fn unknown_loop(id: &str) -> Self {
        Self::new(StatusCode::NOT_FOUND, "unknown_loop", format!("there is no loop '{id}'")).with("loop", id)
    }

    /// 404: no such alarm.
    pub fn unknown_alarm(id: &str) -> Self {
        Self::new(StatusCode::NOT_FOUND, "unknown_alarm", format!("there is no alarm '{id}'"))
            .with("alarm", id)
    }

    /// 404: there is no such published method.
    pub fn unknown_method(name: &str) -> Self {
        let detail = format!("there is no method '{name}'");
        Self::new(StatusCode::NOT_FOUND, "unknown_method", detail).with("method", name)
    }

    /// 404: the loop is there, but has never been diagnosed.
    pub fn not_diagnosed_yet(id: &str, failure: Option<&str>) -> Self {
        let detail = match failure {
            Some(failure) => format!("loop '{id}' has no diagnosis: its latest run ended as {failure}"),
            None => format!("loop '{id}' has not been diagnosed yet"),
        };
        Self::new(StatusCode::NOT_FOUND, "not_diagnosed_yet", detail).with("loop", id)
    }

    /// 409: this centre does not act for the fleet, but the one called `leader`, where that is known.
    pub fn not_leading(kind: &'static str, leader: Option<&str>) -> Self {
        let detail = match leader {
            Some(name) => format!("another centre, {name}, acts for the fleet at present: do it there"),
            None => "this centre does not act for the fleet at present, and knows of no other".to_string(),
        };
        Self::new(StatusCode::CONFLICT, kind, detail).with("leader", leader)
    }

    /// 503: try again later.
    pub fn busy(kind: &'static str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, kind, detail)
    }

    /// 503: nothing can be put on record, so nothing is changed.
    pub fn unrecorded(fault: &Fault) -> Self {
        let detail = format!("nothing is changed, because it could not be put on record: {}", fault.reason);
        Self::busy("audit_failed", detail).with("damaged", fault.is_damaged)
    }

    /// 500: the log says more.
    pub fn internal() -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", "the daemon failed; its log says why")
    }

    /// Adds a member.
    pub fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.more.insert(name.to_string(), value.into());
        self
    }

    /// The problem that a bare status stands for.
    pub fn of_status(status: StatusCode) -> Self {
        let (kind, detail) = match status {
            StatusCode::NOT_FOUND => {
                ("not_found", "there is nothing here; /openapi.json lists what there is")
            }
            StatusCode::METHOD_NOT_ALLOWED => {
                ("method_not_allowed", "this resource does not take that method; see Allow")
            }
            StatusCode::PAYLOAD_TOO_LARGE => {
                ("too_large", "the request body is larger than the daemon takes")
            }
            StatusCode::REQUEST_TIMEOUT | StatusCode::SERVICE_UNAVAILABLE => ("timeout", "no answer in time"),
            StatusCode::URI_TOO_LONG | StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE => {
                ("too_large", "the head of the request is larger than the daemon takes")
            }
            _ if status.is_server_error() => {
                return Self { status, ..Self::internal() };
            }
            _ => ("bad_request", "the request cannot be understood"),
        };
        Self::new(status, kind, detail)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let wait = self.more.get("retry_after_s").and_then(Value::as_f64).map(|seconds| seconds as u64);
        let mut body = self.more;
        body.insert("type".into(), format!("urn:stictiond:problem:{}", self.kind).into());
        body.insert("title".into(), self.status.canonical_reason().unwrap_or("Error").into());
        body.insert("status".into(), self.status.as_u16().into());
        body.insert("detail".into(), self.detail.into());
        let mut response = (self.status, Json(Value::Object(body))).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        if self.status == StatusCode::SERVICE_UNAVAILABLE {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
        }
        if let Some(seconds) = wait {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"stictiond\""));
        }
        response
    }
}

/// The media type of a problem.
pub const PROBLEM_JSON: &str = "application/problem+json";
