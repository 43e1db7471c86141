//! Webhooks, signed as Standard Webhooks says: `webhook-signature: v1,` and the base64 of HMAC-SHA256 over `id.timestamp.body`.

mod config;

pub use config::Config;

use super::batch::Digest;
use super::http::{Answer, Endpoint};
use super::letters::{Letter, Letters};
use super::notice::Source;
use super::postman::{Carrier, Fault, Postman};
use super::state::State;
use super::{payload, secret, time};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hyper::StatusCode;
use hyper::header::{HeaderName, HeaderValue};
use ring::hmac;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::spawn_blocking;

/// Shortest and longest secret (bytes), as Standard Webhooks has it.
const LENGTH: std::ops::RangeInclusive<usize> = 24..=64;

/// Brings letters to one webhook.
pub struct Webhook {
    config: Config,
    endpoint: Endpoint,
}

/// The postman of a webhook.
///
/// # Errors
/// Why its address cannot be used; `check` says so before.
pub fn postman(
    config: &Config,
    source: Source,
    letters: Arc<Letters>,
    state: Arc<State>,
) -> Result<Postman<Webhook>, String> {
    let endpoint = Endpoint::of(&config.url, config.allow_plain_http, config.ca_file.clone())?;
    let carrier = Webhook { config: config.clone(), endpoint };
    let postman = Postman::new(&config.name, carrier, source, letters, state);
    Ok(postman.with(&config.events, &config.filter, &config.pace, &config.retry))
}

impl Carrier for Webhook {
    fn compose(&self, digest: &Digest, source: &Source, now: f64) -> String {
        payload::webhook(digest, source, now)
    }

    async fn carry(&self, letter: &Letter) -> Result<(), Fault> {
        let later = |why: String| Fault::Later(why, None);
        let secret = self.config.secret().ok_or_else(|| later("there is no secret".into()))?;
        let keys = spawn_blocking(move || keys(&secret::lines(&secret)?)).await;
        let keys = keys.map_err(|error| later(error.to_string()))?.map_err(later)?;
        let stamp = (time::wall() as u64).to_string();
        let signatures = signatures(&keys, &letter.id, &stamp, &letter.body);
        let mut headers = Vec::new();
        for (name, text) in
            [("webhook-id", &letter.id), ("webhook-timestamp", &stamp), ("webhook-signature", &signatures)]
        {
            let value = HeaderValue::from_str(text).map_err(|error| Fault::Never(error.to_string()))?;
            headers.push((HeaderName::from_static(name), value));
        }
        let limit = Duration::try_from_secs_f64(self.config.timeout_s).unwrap_or_default();
        judge(self.endpoint.post(headers, letter.body.clone().into_bytes(), limit).await.map_err(later)?)
    }
}

/// What an answer means.
fn judge(answer: Answer) -> Result<(), Fault> {
    let Answer { status, retry_after, text } = answer;
    let why = if text.is_empty() { format!("{status}") } else { format!("{status}: {text}") };
    match status {
        _ if status.is_success() => Ok(()),
        StatusCode::GONE => Err(Fault::Gone(why)),
        StatusCode::REQUEST_TIMEOUT | StatusCode::TOO_MANY_REQUESTS => Err(Fault::Later(why, retry_after)),
        _ if status.is_server_error() => Err(Fault::Later(why, retry_after)),
        _ => Err(Fault::Never(why)),
    }
}

/// The keys of secrets, one a line.
fn keys(lines: &[String]) -> Result<Vec<hmac::Key>, String> {
    let key = |line: &String| {
        let text = line.strip_prefix(config::PREFIX)?;
        let bytes = STANDARD.decode(text).ok().filter(|bytes| LENGTH.contains(&bytes.len()))?;
        Some(hmac::Key::new(hmac::HMAC_SHA256, &bytes))
    };
    // What is wrong with a secret is not shown: it may be most of one.
    let wrong = || "a secret is not whsec_ and base64 of 24 to 64 bytes".to_string();
    lines.iter().map(|line| key(line).ok_or_else(wrong)).collect()
}

/// One signature by each key.
fn signatures(keys: &[hmac::Key], id: &str, stamp: &str, body: &str) -> String {
    let content = format!("{id}.{stamp}.{body}");
    let sign = |key| format!("v1,{}", STANDARD.encode(hmac::sign(key, content.as_bytes())));
    keys.iter().map(sign).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the specification, and of its libraries.
    #[test]
    fn the_signature_is_that_of_the_specification() {
        let keys = keys(&["whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".into()]).unwrap();
        let signed =
            signatures(&keys, "msg_p5jXN8AQM9LWM0D4loKWxJek", "1614265330", r#"{"test": 2432232314}"#);
        assert_eq!(signed, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }

    #[test]
    fn secrets_that_are_none_are_refused_and_not_shown() {
        for wrong in ["MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "whsec_MfKQ", "whsec_*", "whsec_"] {
            let error = keys(&[wrong.to_string()]).unwrap_err();
            assert!(!error.contains("MfKQ"), "{error}");
        }
    }

    #[test]
    fn what_answers_mean() {
        let after = Some(Duration::from_secs(7));
        let of = |status: u16| {
            let status = StatusCode::from_u16(status).unwrap();
            judge(Answer { status, retry_after: after, text: String::new() })
        };
        assert_eq!((of(200), of(204)), (Ok(()), Ok(())));
        for status in [408, 429, 500, 502, 503] {
            assert!(matches!(of(status), Err(Fault::Later(_, pause)) if pause == after), "{status}");
        }
        for status in [301, 400, 401, 404, 422] {
            assert!(matches!(of(status), Err(Fault::Never(_))), "{status}");
        }
        assert!(matches!(of(410), Err(Fault::Gone(_))));
    }
}
