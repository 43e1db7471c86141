//! What a connection is made of, and that nothing on it is older than its question.
//!
//! An answer that comes twice leaves its second copy in the socket. RTU frames have no number, and some gateways give none
//! back: there the copy would be taken for the answer to the next question, and that one's for the one after, for ever.
//! So a connection that has said something unasked is lost.

use futures::future::BoxFuture;
use futures::stream::{FuturesUnordered, StreamExt};
use std::collections::VecDeque;
use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpSocket, TcpStream, lookup_host};
use tokio::time::timeout;

/// A host's next address is tried too when the one before has not answered for so long: far longer than a plant's network
/// takes, and a small part of any time-out.
const APART: Duration = Duration::from_millis(100);

/// A stream to a device.
pub trait Wire: AsyncRead + AsyncWrite + Send + Unpin + fmt::Debug {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin + fmt::Debug> Wire for T {}

/// A connection under way.
pub type Dialled = BoxFuture<'static, io::Result<Box<dyn Wire>>>;

/// Makes a connection to `host:port`.
pub type Dial = Arc<dyn Fn(&str) -> Dialled + Send + Sync>;

/// Connections by TCP.
pub fn sockets() -> Dial {
    Arc::new(|address| {
        let address = address.to_string();
        Box::pin(async move { Ok(Box::new(connect(&address).await?) as Box<dyn Wire>) })
    })
}

async fn connect(address: &str) -> io::Result<TcpStream> {
    let addresses: VecDeque<SocketAddr> = lookup_host(address).await?.collect();
    first(addresses).await
}

/// Connects to the first of a host's addresses that answers. How long the caller waits is not known here, so one that never
/// answers is not waited for alone.
async fn first(mut addresses: VecDeque<SocketAddr>) -> io::Result<TcpStream> {
    let several = addresses.len() > 1;
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    let mut under_way = FuturesUnordered::new();
    loop {
        match addresses.pop_front() {
            Some(address) => under_way.push(one(address)),
            None if under_way.is_empty() => return Err(last),
            None => {}
        }
        let answered = if addresses.is_empty() {
            under_way.next().await
        } else {
            timeout(APART, under_way.next()).await.unwrap_or(None)
        };
        match answered {
            Some((_, Ok(stream))) => return Ok(stream),
            Some((address, Err(error))) if several => {
                last = io::Error::new(error.kind(), format!("{address}: {error}"));
            }
            Some((_, Err(error))) => last = error,
            None => {}
        }
    }
}

async fn one(address: SocketAddr) -> (SocketAddr, io::Result<TcpStream>) {
    (address, open(address).await)
}

async fn open(address: SocketAddr) -> io::Result<TcpStream> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    // A request is one small segment; waiting for more to send would only delay it.
    socket.set_nodelay(true)?;
    socket.set_keepalive(true)?;
    socket.connect(address).await
}

/// A stream on which a question may only be asked while nothing is there to be read.
#[derive(Debug)]
pub(super) struct Asked {
    stream: Box<dyn Wire>,
    /// A question is being sent, or its answer awaited.
    asking: bool,
}

impl Asked {
    pub(super) fn new(stream: Box<dyn Wire>) -> Self {
        Self { stream, asking: false }
    }

    /// Looks whether something is there that nobody asked for.
    fn quiet(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        let mut byte = [0];
        let mut byte = ReadBuf::new(&mut byte);
        match Pin::new(&mut self.stream).poll_read(cx, &mut byte) {
            Poll::Pending => Ok(()),
            Poll::Ready(Err(error)) => Err(error),
            Poll::Ready(Ok(())) if byte.filled().is_empty() => Err(io::ErrorKind::BrokenPipe.into()),
            Poll::Ready(Ok(())) => {
                let said = "the device said something that it was not asked: an answer that came twice?";
                Err(io::Error::new(io::ErrorKind::InvalidData, said))
            }
        }
    }
}

impl AsyncRead for Asked {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let read = ready!(Pin::new(&mut self.stream).poll_read(cx, into));
        self.asking = false;
        Poll::Ready(read)
    }
}

impl AsyncWrite for Asked {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if !self.asking {
            self.quiet(cx)?;
            self.asking = true;
        }
        Pin::new(&mut self.stream).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::black_hole::BlackHole;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};
    use tokio::net::TcpListener;

    #[tokio::test]
    async fn an_address_that_never_answers_leaves_time_for_the_next() {
        let black_hole = BlackHole::open().await;
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let alive = listener.local_addr().unwrap();
        let dialled =
            timeout(Duration::from_millis(900), first(VecDeque::from([black_hole.address, alive]))).await;
        assert_eq!(dialled.expect("in time").unwrap().peer_addr().unwrap(), alive);
        // One that refuses leaves it at once, and is named where there is no other.
        drop(listener);
        let error = first(VecDeque::from([alive, alive])).await.expect_err("nobody listens");
        assert!(error.to_string().starts_with(&format!("{alive}: ")), "{error}");
        let error = first(VecDeque::from([alive])).await.expect_err("nobody listens");
        assert!(!error.to_string().contains(&alive.to_string()), "the caller has named it: {error}");
    }

    #[tokio::test]
    async fn what_is_there_before_the_question_is_no_answer() {
        let (ours, mut device) = duplex(64);
        let mut stream = Asked::new(Box::new(ours));
        stream.write_all(b"one?").await.expect("nothing is there");
        device.write_all(b"one").await.expect("room");
        let mut answer = [0; 3];
        stream.read_exact(&mut answer).await.expect("answered");
        stream.write_all(b"two?").await.expect("nothing is there");
        device.write_all(b"two").await.expect("room");
        stream.read_exact(&mut answer).await.expect("answered");
        // The same once more.
        device.write_all(b"two").await.expect("room");
        let error = stream.write_all(b"three?").await.expect_err("it came before the question");
        assert!(error.to_string().contains("not asked"), "{error}");
    }

    #[tokio::test]
    async fn a_device_that_is_gone_is_noticed_before_the_question() {
        let (ours, device) = duplex(64);
        let mut stream = Asked::new(Box::new(ours));
        drop(device);
        let error = stream.write_all(b"one?").await.expect_err("nobody is there");
        assert_eq!(error.kind(), io::ErrorKind::BrokenPipe);
    }
}
