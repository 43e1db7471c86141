//! By which names the daemon may be asked. A page of another site can have its own name resolve to this machine; then
//! browser and daemon agree that both are of one origin. What it cannot do is ask by a name that is not its own.

use super::Context;
use super::problem::Problem;
use crate::host;
use axum::extract::{Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;
use std::sync::Arc;

/// Longest name that is compared (bytes), as the domain name system has it.
const LONGEST: usize = 253;

/// Refuses what is asked by a name that is not ours, or by a page that is not ours.
pub async fn own_names(State(context): State<Arc<Context>>, request: Request, next: Next) -> Response {
    match judge(&context, &request) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    }
}

fn judge(context: &Context, request: &Request) -> Result<(), Problem> {
    let headers = request.headers();
    let host = only(headers, header::HOST)?;
    // No browser leaves the host out; a probe of HTTP/1.0 does.
    for asked in [host, request.uri().authority().map(Authority::as_str)].into_iter().flatten() {
        if !known(context, asked) {
            let detail =
                "the daemon is not known by the name it was asked for: add the name to hosts in [server]";
            return Err(Problem::new(StatusCode::MISDIRECTED_REQUEST, "unknown_host", detail));
        }
    }
    let Some(origin) = only(headers, header::ORIGIN)? else { return Ok(()) };
    let from = origin.split_once("://").map(|(_, authority)| authority);
    let listed = |from: &str| context.config.hosts.iter().any(|own| own.eq_ignore_ascii_case(from));
    if from.is_some_and(|from| host.is_some_and(|host| from.eq_ignore_ascii_case(host)) || listed(from)) {
        return Ok(());
    }
    let detail = "requests are taken from the daemon's own pages and from programs, not from other sites";
    Err(Problem::new(StatusCode::FORBIDDEN, "foreign_origin", detail))
}

/// The value of a header that may stand once; what is no text is no name.
fn only(headers: &HeaderMap, name: HeaderName) -> Result<Option<&str>, Problem> {
    let mut values = headers.get_all(&name).into_iter();
    let first = values.next();
    let text = first.map(|value| value.to_str()).transpose();
    match (text, values.next()) {
        (Ok(text), None) => Ok(text),
        _ => {
            let detail = format!("{name} may stand once, as text");
            Err(Problem::new(StatusCode::BAD_REQUEST, "bad_header", detail))
        }
    }
}

/// Whether a host is ours: an address, which no other site can have as its name; this machine's name; one that
/// `[server]` lists or the certificate in force carries.
fn known(context: &Context, asked: &str) -> bool {
    let Ok(authority) = asked.parse::<Authority>() else { return false };
    let name = authority.host().trim_end_matches('.');
    let bare = name.trim_start_matches('[').trim_end_matches(']');
    if bare.parse::<IpAddr>().is_ok() || is(name, "localhost") || is(name, &host::name()) {
        return true;
    }
    let listed = |own: &String| is(name, name_of(own)) || is(asked, own);
    name.len() <= LONGEST
        && (context.config.hosts.iter().any(listed)
            || context.tls.as_ref().is_some_and(|tls| tls.carries(name)))
}

fn is(name: &str, own: &str) -> bool {
    name.eq_ignore_ascii_case(own)
}

/// A listed host without its port.
fn name_of(listed: &str) -> &str {
    match listed.rsplit_once(':') {
        Some((name, port)) if port.parse::<u16>().is_ok() && !name.ends_with(':') => name,
        _ => listed,
    }
}

/// What is wrong with an entry of `hosts`; `None` when it can be used.
pub fn fault(listed: &str) -> Option<String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    let name = name_of(listed);
    let ok = !name.is_empty() && name.len() <= LONGEST && name.chars().all(plain);
    (!ok).then(|| {
        format!("{listed:?} is no host's name, such as stiction.plant.example or stiction.plant.example:8443")
    })
}
