//! A client that sends exactly what it is told, over any stream.

use serde_json::Value;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

/// Longest wait for anything; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(30);

/// An answer.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub head: String,
    pub body: String,
}

impl Answer {
    pub fn header(&self, name: &str) -> Option<&str> {
        let named = |line: &&str| line.split_once(": ").is_some_and(|(n, _)| n.eq_ignore_ascii_case(name));
        self.head.lines().find(named).and_then(|line| line.split_once(": ")).map(|(_, value)| value)
    }

    pub fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.body))
    }

    /// The last part of the type of a problem.
    pub fn problem(&self) -> String {
        assert_eq!(self.header("content-type"), Some("application/problem+json"), "{self:?}");
        self.json()["type"].as_str().and_then(|kind| kind.rsplit(':').next()).unwrap_or_default().to_string()
    }
}

/// Sends bytes and reads all that comes until the server closes.
pub async fn exchange(mut stream: impl AsyncRead + AsyncWrite + Unpin, bytes: &[u8]) -> String {
    // A server may answer and close before it has read everything.
    let _ = stream.write_all(bytes).await;
    let mut all = Vec::new();
    let _ = timeout(PATIENCE, stream.read_to_end(&mut all)).await.expect("the server closes");
    String::from_utf8_lossy(&all).into_owned()
}

/// The same over a new connection.
pub async fn raw(to: SocketAddr, text: &str) -> String {
    exchange(TcpStream::connect(to).await.expect("the server listens"), text.as_bytes()).await
}

/// A request as text.
pub fn request(to: SocketAddr, what: &str, headers: &[&str], body: &str) -> String {
    let mut text = format!("{what} HTTP/1.1\r\nhost: {to}\r\nconnection: close\r\n");
    headers.iter().for_each(|line| text += &format!("{line}\r\n"));
    if !body.is_empty() {
        text += &format!("content-length: {}\r\n", body.len());
    }
    text + "\r\n" + body
}

/// Takes an answer apart.
pub fn parse(text: &str) -> Answer {
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("no answer: {text:?}"));
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status");
    let mut answer = Answer { status, head: head.to_string(), body: body.to_string() };
    if answer.header("transfer-encoding") == Some("chunked") {
        let mut rest = body;
        answer.body.clear();
        while let Some((length, after)) = rest.split_once("\r\n") {
            let length = usize::from_str_radix(length, 16).expect("a length");
            answer.body += &after[..length];
            rest = after.get(length + 2..).unwrap_or_default();
        }
    }
    answer
}

/// Asks `METHOD path`.
pub async fn ask(to: SocketAddr, what: &str, headers: &[&str], body: &str) -> Answer {
    parse(&raw(to, &request(to, what, headers, body)).await)
}
