//! One request by HTTP/1.1, by rustls where it is encrypted. Redirections are not followed; every answer is bounded.

use super::time;
use crate::bounded::{Bounded, HTTP};
use crate::dial;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1;
use hyper::header::{HOST, HeaderName, HeaderValue, RETRY_AFTER, USER_AGENT};
use hyper::{Request, Response, StatusCode, Uri};
use hyper_util::rt::TokioIo;
use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{Instant, timeout_at};
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// Largest answer read (bytes).
const MOST_ANSWER: usize = 1 << 16;
/// Longest part of an answer that is quoted (characters).
const MOST_QUOTED: usize = 200;

/// Where a request goes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Endpoint {
    uri: Uri,
    host: String,
    port: u16,
    tls: bool,
    ca_file: Option<PathBuf>,
}

/// Whether a host is this machine.
pub(super) fn is_loopback(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<std::net::IpAddr>();
    host == "localhost" || address.is_ok_and(|address| address.to_canonical().is_loopback())
}

/// What came back.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Answer {
    pub status: StatusCode,
    /// How long to wait before the next request.
    pub retry_after: Option<Duration>,
    /// How it begins, on one line.
    pub text: String,
}

impl Endpoint {
    /// The place that an address names.
    ///
    /// # Errors
    /// Why it cannot be used, for people.
    pub(super) fn of(url: &str, plain: bool, ca_file: Option<PathBuf>) -> Result<Self, String> {
        // An address may carry a secret: it is never quoted.
        let uri: Uri = url.parse().map_err(|_| "is not an address such as https://host/path".to_string())?;
        let tls = match uri.scheme_str() {
            Some("https") => true,
            Some("http") => false,
            _ => return Err("must begin with https:// or http://".into()),
        };
        let authority = uri.authority().ok_or("names no host")?;
        if authority.as_str().contains('@') {
            return Err("must not hold a password; there are keys for it".into());
        }
        let host = authority.host().trim_start_matches('[').trim_end_matches(']').to_string();
        let port = uri.port_u16().unwrap_or(if tls { 443 } else { 80 });
        if host.is_empty() || port == 0 {
            return Err("names no host".into());
        }
        if !tls && !plain && !is_loopback(&host) {
            let why = "is not encrypted: write https://, or set allow_plain_http = true";
            return Err(why.into());
        }
        Ok(Self { uri, host, port, tls, ca_file })
    }

    /// Sends JSON and waits for the answer, at most for `limit`.
    ///
    /// # Errors
    /// Why there is none.
    pub(super) async fn post(
        &self,
        headers: Vec<(HeaderName, HeaderValue)>,
        body: Vec<u8>,
        limit: Duration,
    ) -> Result<Answer, String> {
        let until = Instant::now() + limit;
        let answered = timeout_at(until, self.ask(headers, body)).await;
        let answered =
            answered.unwrap_or_else(|_| Err(format!("no answer within {} s", limit.as_secs_f64())));
        let (response, _connection) = answered?;
        Ok(read(response, until).await)
    }

    async fn ask(&self, headers: Vec<(HeaderName, HeaderValue)>, body: Vec<u8>) -> Result<Answered, String> {
        let path = self.uri.path_and_query().map_or("/", |path| path.as_str());
        let host = self.uri.authority().map_or("", |authority| authority.as_str());
        let mut request = Request::post(path)
            .header(HOST, host)
            .header(USER_AGENT, concat!("stictiond/", env!("CARGO_PKG_VERSION")))
            .header("content-type", "application/json");
        for (name, value) in headers {
            request = request.header(name, value);
        }
        let request = request.body(Full::new(Bytes::from(body))).map_err(|error| error.to_string())?;
        let connected = dial::to((self.host.as_str(), self.port)).await;
        let stream = connected.map_err(|error| format!("no connection: {error}"))?;
        let stream = Bounded::new(stream, HTTP);
        if !self.tls {
            return talk(stream, request).await;
        }
        let (ca_file, host) = (self.ca_file.clone(), self.host.clone());
        let made =
            spawn_blocking(move || encrypted(ca_file, &host)).await.map_err(|error| error.to_string())?;
        let (made, name) = made?;
        let stream = made.connect(name, stream).await.map_err(|error| format!("no TLS: {error}"))?;
        talk(stream, request).await
    }
}

/// An answer whose body is still to be read, and its connection, which ends with it.
type Answered = (Response<Incoming>, (http1::SendRequest<Full<Bytes>>, JoinSet<bool>));

async fn talk<S>(stream: S, request: Request<Full<Bytes>>) -> Result<Answered, String>
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let begun = http1::handshake(TokioIo::new(stream)).await;
    let (mut sender, connection) = begun.map_err(|error| whole(&error))?;
    let mut driver = JoinSet::new();
    driver.spawn(async move { connection.await.is_ok() });
    let response = sender.send_request(request).await.map_err(|error| whole(&error))?;
    Ok((response, (sender, driver)))
}

/// What an answer says. One that is too long, breaks off or does not end in time has said what matters by its status.
async fn read(response: Response<Incoming>, until: Instant) -> Answer {
    let (parts, body) = response.into_parts();
    let after = parts.headers.get(RETRY_AFTER).and_then(|value| value.to_str().ok());
    let body = timeout_at(until, Limited::new(body, MOST_ANSWER).collect()).await;
    let bytes = body.ok().and_then(Result::ok).map(|body| body.to_bytes()).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let text =
        text.chars().take(MOST_QUOTED).map(|c| if c.is_control() { ' ' } else { c }).collect::<String>();
    let retry_after = after.and_then(|text| pause(text, time::wall()));
    Answer { status: parts.status, retry_after, text: text.trim().to_string() }
}

/// An error with what caused it.
fn whole(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text += &format!(": {error}");
        cause = error.source();
    }
    text
}

/// Retry-After, in seconds or as a date, seen at `now` (s).
fn pause(text: &str, now: f64) -> Option<Duration> {
    let seconds = match text.trim().parse::<u32>() {
        Ok(seconds) => f64::from(seconds),
        Err(_) => {
            let date = jiff::fmt::rfc2822::parse(text.trim()).ok()?;
            (date.timestamp().as_millisecond() as f64 * 1e-3 - now).max(0.0)
        }
    };
    Duration::try_from_secs_f64(seconds).ok()
}

/// TLS to a host, that trusts a file or what the system trusts.
pub(super) fn encrypted(
    ca_file: Option<PathBuf>,
    host: &str,
) -> Result<(TlsConnector, ServerName<'static>), String> {
    let name = ServerName::try_from(host.trim_matches(['[', ']']).to_string());
    Ok((connector(ca_file)?, name.map_err(|_| "the host's name is none".to_string())?))
}

/// TLS that trusts a file, or what the system trusts.
fn connector(ca_file: Option<PathBuf>) -> Result<TlsConnector, String> {
    let mut roots = RootCertStore::empty();
    for certificate in trusted(ca_file)? {
        // A system may have certificates that nobody can read; those that can be are enough.
        let _ = roots.add(certificate);
    }
    if roots.is_empty() {
        return Err("no certificate is trusted: set ca_file".into());
    }
    let provider = Arc::new(ring::default_provider());
    let begun = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
    let begun = begun.map_err(|error| error.to_string())?;
    Ok(Arc::new(begun.with_root_certificates(roots).with_no_client_auth()).into())
}

/// The certificates of a file, or the system's.
pub(super) fn trusted(ca_file: Option<PathBuf>) -> Result<Vec<CertificateDer<'static>>, String> {
    let Some(path) = ca_file else { return Ok(rustls_native_certs::load_native_certs().certs) };
    let read = CertificateDer::pem_file_iter(&path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    match read {
        Ok(found) if !found.is_empty() => Ok(found),
        _ => Err(format!("{}: no certificates (PEM) can be read from it", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    #[test]
    fn addresses_are_encrypted_or_on_this_machine_and_hold_no_password() {
        let of = |url: &str| Endpoint::of(url, false, None);
        for good in ["https://h/x?y=1", "http://127.0.0.1:9/", "http://localhost", "http://[::1]:8080/a"] {
            assert!(of(good).is_ok(), "{good}");
        }
        for (bad, why) in [
            ("http://plant/x", "is not encrypted"),
            ("ftp://h/", "must begin with"),
            ("h:80", "must begin with"),
            ("/x", "must begin with"),
            ("https://u:p@h/", "must not hold a password"),
            ("https://h:0/", "names no host"),
            ("", "is not an address"),
        ] {
            let found = of(bad).unwrap_err();
            assert!(found.contains(why), "{bad}: {found}");
        }
        assert!(Endpoint::of("http://plant/x", true, None).is_ok());
    }

    /// A message that was taken must not be sent again for want of the rest of a text that nobody needs.
    #[tokio::test]
    async fn an_answer_whose_body_does_not_end_has_its_status() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/", listener.local_addr().unwrap());
        let answering = tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let (mut request, mut chunk) = (Vec::new(), [0; 1024]);
            while !request.ends_with(b"\r\n\r\n{}") {
                let n = stream.read(&mut chunk).await.unwrap();
                assert!(n > 0, "{}", String::from_utf8_lossy(&request));
                request.extend(&chunk[..n]);
            }
            stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 9\r\n\r\nthanks").await.unwrap();
            // Until the other side has gone.
            assert_eq!(stream.read(&mut chunk).await.unwrap_or_default(), 0);
        });
        let endpoint = Endpoint::of(&url, false, None).unwrap();
        let answer = endpoint.post(Vec::new(), b"{}".to_vec(), Duration::from_secs(2)).await;
        assert_eq!(answer.map(|answer| answer.status), Ok(StatusCode::OK));
        answering.await.unwrap();
    }

    #[test]
    fn retry_after_is_seconds_or_a_date() {
        let now = 1_445_412_480.0 - 90.0;
        assert_eq!(pause("120", now), Some(Duration::from_secs(120)));
        assert_eq!(pause("Wed, 21 Oct 2015 07:28:00 GMT", now), Some(Duration::from_secs(90)));
        assert_eq!(pause("Wed, 21 Oct 2015 07:28:00 GMT", now + 1e6), Some(Duration::ZERO));
        assert_eq!((pause("soon", now), pause("-3", now)), (None, None));
    }
}
