//! What a connection is made of, and that nothing on it is older than its question.
//!
//! An answer that comes twice leaves its second copy in the socket. RTU frames have no number, and some gateways give none
//! back: there the copy would be taken for the answer to the next question, and that one's for the one after, for ever.
//! So a connection that has said something unasked is lost.

use crate::dial;
use futures::future::BoxFuture;
use std::fmt;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

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
        Box::pin(async move { Ok(Box::new(dial::to(&address).await?) as Box<dyn Wire>) })
    })
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
    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};

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
