//! `ETag` and `If-None-Match`: who still holds an answer and asks whether it is good is told so in a few bytes.

use axum::body::{Body, HttpBody, to_bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;

/// What ages by itself, and is no news.
const AGE: &[u8] = b"\"age_s\":";
/// How an answer begins that says when it was made.
const TIME: &[u8] = b"{\"time\":";

/// Gives an answer to GET its validator, and answers 304 where the client has it. Streams pass.
pub async fn conditional(request: Request, next: Next) -> Response {
    if request.method() != Method::GET {
        return next.run(request).await;
    }
    let asked = request.headers().clone();
    let response = next.run(request).await;
    // A body of known size is in memory already; a stream's is not known.
    let Some(size) = response.body().size_hint().exact().filter(|_| response.status() == StatusCode::OK)
    else {
        return response;
    };
    let (mut parts, body) = response.into_parts();
    let Ok(bytes) = to_bytes(body, usize::try_from(size).unwrap_or(usize::MAX)).await else {
        return super::problem::Problem::internal().into_response();
    };
    let tag = tag(stable(&bytes));
    if holds(&asked, &tag) {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response();
    }
    parts.headers.insert(header::ETAG, tag);
    Response::from_parts(parts, Body::from(bytes))
}

/// A weak validator of a content in pieces: what is sent may be compressed, and clocks in it are left out.
pub fn tag<'a>(pieces: impl IntoIterator<Item = &'a [u8]>) -> HeaderValue {
    let mut digest = Sha256::new();
    pieces.into_iter().for_each(|piece| digest.update(piece));
    let mut text = String::from("W/\"");
    for byte in &digest.finalize()[..12] {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    text.push('"');
    HeaderValue::from_str(&text).unwrap_or(HeaderValue::from_static("W/\"0\""))
}

/// Whether the client says that it has this already.
pub fn holds(asked: &HeaderMap, tag: &HeaderValue) -> bool {
    let same = |value: &HeaderValue| {
        let listed = value.to_str().unwrap_or_default();
        listed.split(',').any(|one| one.trim() == tag || one.trim() == "*")
    };
    asked.get_all(header::IF_NONE_MATCH).iter().any(same)
}

/// The pieces of an answer between its clock readings: when it was made, if it begins with that, and every age. A quote
/// inside of a text is escaped, so that a key in quotes is never part of one.
fn stable(body: &[u8]) -> Vec<&[u8]> {
    let mut rest = body.strip_prefix(TIME).map_or(body, after_value);
    let mut pieces = Vec::new();
    while let Some(at) = rest.windows(AGE.len()).position(|window| window == AGE) {
        pieces.push(&rest[..at]);
        rest = after_value(&rest[at + AGE.len()..]);
    }
    pieces.push(rest);
    pieces
}

/// What follows a number, a time or null.
fn after_value(text: &[u8]) -> &[u8] {
    let end = text.iter().position(|byte| b",}".contains(byte)).unwrap_or(text.len());
    &text[end..]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> HeaderValue {
        tag(stable(text.as_bytes()))
    }

    #[test]
    fn clocks_are_no_news_and_everything_else_is() {
        let one = r#"{"time":"2026-01-01T00:00:00Z","items":[{"id":"A","age_s":1.5},{"id":"B","age_s":null}],"n":1}"#;
        let later = one.replace("00:00:00Z", "00:00:07Z").replace("1.5", "8.5e0").replace("null", "3");
        assert_eq!(of(one), of(&later));
        assert_ne!(of(one), of(&one.replace("\"B\"", "\"C\"")));
        assert_ne!(of(one), of(&one.replace("\"n\":1", "\"n\":2")));
        // Only the time at the very beginning is the answer's own.
        assert_ne!(of(r#"{"id":"A","time":"1"}"#), of(r#"{"id":"A","time":"2"}"#));
        // A text that looks like an age is a text.
        assert_ne!(of(r#"{"id":"\"age_s\":1"}"#), of(r#"{"id":"\"age_s\":2"}"#));
    }

    #[test]
    fn a_list_of_validators_is_understood() {
        let tag = of("{}");
        let asked = |text: &str| {
            HeaderMap::from_iter([(header::IF_NONE_MATCH, HeaderValue::from_str(text).expect("a value"))])
        };
        let own = tag.to_str().expect("text");
        for yes in [own.to_string(), format!("W/\"1\", {own}"), "*".to_string()] {
            assert!(holds(&asked(&yes), &tag), "{yes}");
        }
        assert!(!holds(&asked("W/\"1\""), &tag) && !holds(&HeaderMap::new(), &tag));
    }
}
