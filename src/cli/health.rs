//! `stictiond health`: whether a running daemon answers, for containers and supervisors that have no HTTP client.

use super::{Failure, print};
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// More of an answer than is looked at.
const MOST_BYTES: u64 = 4096;

#[derive(clap::Args)]
pub struct Args {
    /// Where the daemon listens
    #[arg(value_name = "HOST:PORT", default_value = "127.0.0.1:8080", value_parser = host_and_port)]
    address: String,
    /// Longest wait for the connection and for the answer (ms)
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    timeout_ms: u64,
}

fn host_and_port(text: &str) -> Result<String, String> {
    let is =
        text.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    if is { Ok(text.into()) } else { Err("not host:port, such as 127.0.0.1:8080".into()) }
}

/// Asks once.
pub fn run(args: &Args) -> Result<(), Failure> {
    let status = ask(&args.address, Duration::from_millis(args.timeout_ms))
        .map_err(|error| Failure::Failed(format!("{}: {error}", args.address)))?;
    match status.split_whitespace().nth(1) {
        Some("200") => print("ok\n"),
        _ => Err(Failure::Failed(format!("{}: answers {status:?}", args.address))),
    }
}

/// The first line of the answer.
fn ask(address: &str, patience: Duration) -> io::Result<String> {
    // A name may have addresses on which nobody listens, such as ::1 of localhost.
    let mut stream = Err(io::Error::new(io::ErrorKind::NotFound, "the name has no address"));
    for address in address.to_socket_addrs()? {
        stream = TcpStream::connect_timeout(&address, patience);
        if stream.is_ok() {
            break;
        }
    }
    let mut stream = stream?;
    stream.set_read_timeout(Some(patience))?;
    stream.set_write_timeout(Some(patience))?;
    write!(stream, "GET /healthz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut answer = Vec::new();
    stream.take(MOST_BYTES).read_to_end(&mut answer)?;
    Ok(String::from_utf8_lossy(&answer).lines().next().unwrap_or_default().to_string())
}
