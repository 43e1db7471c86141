//! One conversation with a server, over a stream of ours.
//!
//! The library's own stream believes that a line ends; ours counts what comes. It also changes a word: servers of before
//! 1995, small relays among them, know HELO and no EHLO, which is all that the library says.

use super::super::http;
use super::config::{Config, Security};
use crate::bounded::{Bounded, SMTP};
use crate::dial;
use lettre::transport::smtp::Error;
use lettre::transport::smtp::authentication::{Credentials, DEFAULT_MECHANISMS};
use lettre::transport::smtp::client::{AsyncSmtpConnection, AsyncTokioStream, TlsParameters};
use lettre::transport::smtp::extension::ClientId;
use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::task::spawn_blocking;

/// What the library writes first, and what is sent for it: of one length, so that no count has to be kept.
const EHLO: &[u8] = b"EHLO ";
const HELO: &[u8] = b"HELO ";

/// Why a mail was not sent.
#[derive(Debug, thiserror::Error)]
pub(super) enum Unsent {
    /// There is no server, or no encryption.
    #[error("{0}")]
    Connect(String),
    /// The conversation failed.
    #[error(transparent)]
    Smtp(#[from] Error),
}

/// Whether a server may not know the word: 500 and 502 of RFC 5321.
pub(super) fn is_unknown(error: &Unsent) -> bool {
    let code = |error: &Error| error.status().map(|code| code.to_string());
    matches!(error, Unsent::Smtp(error) if code(error).is_some_and(|code| ["500", "502"].contains(&code.as_str())))
}

/// What a conversation needs, the secrets read.
#[derive(Clone)]
pub(super) struct Server {
    pub config: Config,
    pub login: Option<Credentials>,
    /// For STARTTLS, which the library does itself.
    pub tls: Option<TlsParameters>,
}

impl Server {
    /// Connects, greets and logs in as the configuration says.
    pub(super) async fn connect(&self, knows_ehlo: bool) -> Result<AsyncSmtpConnection, Unsent> {
        let hello = ClientId::Domain(self.config.greeting());
        let stream = self.stream(!knows_ehlo).await?;
        let mut open = AsyncSmtpConnection::connect_with_transport(stream, &hello).await?;
        if let (Security::Starttls, Some(tls)) = (self.config.security, &self.tls) {
            open.starttls(tls.clone(), &hello).await?;
        }
        if let Some(login) = &self.login {
            open.auth(DEFAULT_MECHANISMS, login).await?;
        }
        Ok(open)
    }

    async fn stream(&self, helo: bool) -> Result<Box<dyn AsyncTokioStream>, Unsent> {
        let none = |why: &dyn fmt::Display| Unsent::Connect(why.to_string());
        let (host, port) = self.config.host_and_port().map_err(|why| none(&why))?;
        let connected = dial::to((host.as_str(), port)).await;
        let stream = connected.map_err(|error| none(&format!("no connection: {error}")))?;
        let peer = stream.peer_addr().map_err(|error| none(&error))?;
        let stream = Bounded::new(stream, SMTP);
        if self.config.security != Security::Tls {
            return Ok(Box::new(Wire { stream, peer, greeted: !helo }));
        }
        let (ca, name) = (self.config.ca_file.clone(), host);
        let made = spawn_blocking(move || http::encrypted(ca, &name)).await.map_err(|error| none(&error))?;
        let (connector, name) = made.map_err(|why| none(&why))?;
        let stream =
            connector.connect(name, stream).await.map_err(|error| none(&format!("no TLS: {error}")))?;
        Ok(Box::new(Wire { stream, peer, greeted: !helo }))
    }
}

/// A stream whose first EHLO leaves as HELO, where it is not `greeted` yet.
#[derive(Debug)]
struct Wire<S> {
    stream: S,
    peer: SocketAddr,
    greeted: bool,
}

impl<S: AsyncRead + AsyncWrite + Send + Sync + Unpin + fmt::Debug> AsyncTokioStream for Wire<S> {
    fn peer_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.peer)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Wire<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buf)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Wire<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        if self.greeted || !buf.starts_with(EHLO) {
            return Pin::new(&mut self.stream).poll_write(cx, buf);
        }
        let word = Pin::new(&mut self.stream).poll_write(cx, HELO);
        // What follows the word is written next; a word in pieces would be another word.
        match word {
            Poll::Ready(Ok(n)) if n < HELO.len() => Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
            Poll::Ready(Ok(n)) => {
                self.greeted = true;
                Poll::Ready(Ok(n))
            }
            other => other,
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
