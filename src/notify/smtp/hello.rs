//! Servers of before 1995, small relays among them: they know HELO and no EHLO.
//!
//! The client library says EHLO only. Its connection takes a stream of ours, and this one changes the word.

use lettre::Message;
use lettre::transport::smtp::Error;
use lettre::transport::smtp::client::{AsyncSmtpConnection, AsyncTokioStream};
use lettre::transport::smtp::extension::ClientId;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;

/// What the library writes first, and what is sent for it: of one length, so that no count has to be kept.
const EHLO: &[u8] = b"EHLO ";
const HELO: &[u8] = b"HELO ";

/// Why a mail was not sent.
#[derive(Debug)]
pub(super) enum HeloError {
    Connect(io::Error),
    Smtp(Error),
}

/// Whether a server may not know the word: 500 and 502 of RFC 5321.
pub(super) fn is_unknown(error: &Error) -> bool {
    error.status().is_some_and(|code| ["500", "502"].contains(&code.to_string().as_str()))
}

/// Sends a mail in the clear, greeted by HELO.
pub(super) async fn send_by_helo(
    server: (&str, u16),
    greeting: String,
    mail: &Message,
) -> Result<(), HeloError> {
    let stream = TcpStream::connect(server).await.map_err(HeloError::Connect)?;
    let stream = Box::new(Greeting { stream, greeted: false });
    let hello = ClientId::Domain(greeting);
    let mut server =
        AsyncSmtpConnection::connect_with_transport(stream, &hello).await.map_err(HeloError::Smtp)?;
    let sent = server.send(mail.envelope(), &mail.formatted()).await;
    server.abort().await;
    sent.map(drop).map_err(HeloError::Smtp)
}

/// A stream whose first EHLO leaves as HELO.
#[derive(Debug)]
struct Greeting {
    stream: TcpStream,
    greeted: bool,
}

impl AsyncTokioStream for Greeting {
    fn peer_addr(&self) -> io::Result<SocketAddr> {
        self.stream.peer_addr()
    }
}

impl AsyncRead for Greeting {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buf)
    }
}

impl AsyncWrite for Greeting {
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
