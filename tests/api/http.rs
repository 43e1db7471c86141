//! A client over a real socket, small enough to be read: one request a connection, HTTP/1.1.

use serde_json::Value;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;

/// Longest wait for anything; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(20);

/// An answer.
pub struct Answer {
    pub status: u16,
    pub headers: Vec<(String, String)>,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str())
    }

    pub fn text(&self) -> String {
        String::from_utf8(self.body.clone()).expect("the body is UTF-8")
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {}", self.text()))
    }
}

/// Sends a request with these header lines and body and reads the whole answer.
pub async fn send(to: SocketAddr, method: &str, path: &str, headers: &[&str], body: &str) -> Answer {
    let mut head = format!("{method} {path} HTTP/1.1\r\nhost: {to}\r\nconnection: close\r\n");
    headers.iter().for_each(|line| head += &format!("{line}\r\n"));
    raw(to, &head, body).await
}

/// Sends a head as it is, its length added, and a body.
pub async fn raw(to: SocketAddr, head: &str, body: &str) -> Answer {
    let mut stream = TcpStream::connect(to).await.expect("the server listens");
    let mut text = head.to_string();
    if !body.is_empty() {
        text += &format!("content-length: {}\r\n", body.len());
    }
    text += "\r\n";
    text += body;
    // A server may answer and close before it has read a body that is too large.
    let _ = stream.write_all(text.as_bytes()).await;
    let mut all = Vec::new();
    let read = tokio::time::timeout(PATIENCE, stream.read_to_end(&mut all)).await;
    let _ = read.unwrap_or_else(|_| panic!("no answer to {head}"));
    parse(&all)
}

pub async fn get(to: SocketAddr, path: &str) -> Answer {
    send(to, "GET", path, &[], "").await
}

pub async fn post(to: SocketAddr, path: &str, body: &str) -> Answer {
    send(to, "POST", path, &[], body).await
}

fn parse(all: &[u8]) -> Answer {
    let end = all.windows(4).position(|w| w == b"\r\n\r\n").expect("an answer has a head");
    let head = String::from_utf8_lossy(&all[..end]).to_string();
    let mut lines = head.lines();
    let status =
        lines.next().and_then(|l| l.split(' ').nth(1)).and_then(|s| s.parse().ok()).expect("a status");
    let headers: Vec<(String, String)> = lines
        .filter_map(|line| line.split_once(": "))
        .map(|(name, value)| (name.to_ascii_lowercase(), value.to_string()))
        .collect();
    let mut answer = Answer { status, headers, body: all[end + 4..].to_vec() };
    if answer.header("transfer-encoding") == Some("chunked") {
        answer.body = unchunked(&answer.body);
    }
    answer
}

fn unchunked(mut rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    while let Some(end) = rest.windows(2).position(|w| w == b"\r\n") {
        let length =
            usize::from_str_radix(&String::from_utf8_lossy(&rest[..end]), 16).expect("a chunk length");
        body.extend(&rest[end + 2..end + 2 + length]);
        rest = &rest[(end + 4 + length).min(rest.len())..];
    }
    body
}

/// An open stream of server-sent events.
pub struct Events {
    stream: BufReader<TcpStream>,
    id: String,
}

impl Events {
    pub async fn open(to: SocketAddr) -> Self {
        Self::open_at(to, "/api/v1/events").await
    }

    pub async fn open_at(to: SocketAddr, path: &str) -> Self {
        Self::ask(to, path, "").await
    }

    /// Opens the stream as one who has heard the events up to this.
    pub async fn resume(to: SocketAddr, id: &str) -> Self {
        Self::ask(to, "/api/v1/events", &format!("last-event-id: {id}\r\n")).await
    }

    async fn ask(to: SocketAddr, path: &str, more: &str) -> Self {
        let mut stream = TcpStream::connect(to).await.expect("the server listens");
        let request = format!("GET {path} HTTP/1.1\r\nhost: {to}\r\nconnection: close\r\n{more}\r\n");
        stream.write_all(request.as_bytes()).await.expect("sent");
        Self { stream: BufReader::new(stream), id: String::new() }
    }

    /// The id of the latest event.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The next event: its name and its data; `None` when the stream has ended.
    pub async fn next(&mut self) -> Option<(String, Value)> {
        let mut name = String::new();
        loop {
            let mut line = String::new();
            let read = tokio::time::timeout(PATIENCE, self.stream.read_line(&mut line))
                .await
                .expect("an event in time");
            if !matches!(read, Ok(n) if n > 0) {
                return None;
            }
            if let Some(event) = line.strip_prefix("event: ") {
                name = event.trim_end().to_string();
            } else if let Some(id) = line.strip_prefix("id: ") {
                self.id = id.trim_end().to_string();
            } else if let Some(data) = line.strip_prefix("data: ") {
                return Some((name, serde_json::from_str(data).expect("events carry JSON")));
            }
        }
    }
}
