//! The stream under the connection: what the server sends is counted message by message, encrypted or not.
//!
//! The library opens its own socket, and asks a maker of encrypted streams for what it talks over. Ours wraps; where
//! nothing is encrypted it hands the socket on, by the library's direct negotiation, in which nothing is asked before.

use crate::bounded::{Bounded, POSTGRES};
use std::convert::Infallible;
use std::future::{Future, Ready, ready};
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_postgres::tls::{ChannelBinding, MakeTlsConnect, TlsConnect, TlsStream};

/// Counts in the clear.
#[derive(Clone, Copy)]
pub(super) struct Clear;

/// Counts inside of what another one encrypts.
#[derive(Clone)]
pub(super) struct Within<M>(pub M);

/// A stream that is counted.
pub(super) struct Wire<S>(Bounded<S>);

impl<S> MakeTlsConnect<S> for Clear
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    type Stream = Wire<Open<S>>;
    type TlsConnect = Clear;
    type Error = Infallible;

    fn make_tls_connect(&mut self, _domain: &str) -> Result<Clear, Infallible> {
        Ok(Clear)
    }
}

impl<S> TlsConnect<S> for Clear
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    type Stream = Wire<Open<S>>;
    type Error = Infallible;
    type Future = Ready<Result<Wire<Open<S>>, Infallible>>;

    fn connect(self, stream: S) -> Self::Future {
        ready(Ok(Wire(Bounded::new(Open(stream), POSTGRES))))
    }
}

impl<S, M: MakeTlsConnect<S>> MakeTlsConnect<S> for Within<M>
where
    <M::TlsConnect as TlsConnect<S>>::Future: Send + 'static,
{
    type Stream = Wire<M::Stream>;
    type TlsConnect = Within<M::TlsConnect>;
    type Error = M::Error;

    fn make_tls_connect(&mut self, domain: &str) -> Result<Self::TlsConnect, M::Error> {
        self.0.make_tls_connect(domain).map(Within)
    }
}

impl<S, C: TlsConnect<S>> TlsConnect<S> for Within<C>
where
    C::Future: Send + 'static,
{
    type Stream = Wire<C::Stream>;
    type Error = C::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Wire<C::Stream>, C::Error>> + Send>>;

    fn connect(self, stream: S) -> Self::Future {
        let connecting = self.0.connect(stream);
        Box::pin(async { Ok(Wire(Bounded::new(connecting.await?, POSTGRES))) })
    }
}

/// What is not encrypted, and so has nothing that a log-in could be bound to.
pub(super) struct Open<S>(S);

impl<S: AsyncRead + AsyncWrite + Unpin> TlsStream for Open<S> {
    fn channel_binding(&self) -> ChannelBinding {
        ChannelBinding::none()
    }
}

impl<S: TlsStream + Unpin> TlsStream for Wire<S> {
    fn channel_binding(&self) -> ChannelBinding {
        self.0.below().channel_binding()
    }
}

macro_rules! passes_on {
    ($of:ident) => {
        impl<S: AsyncRead + Unpin> AsyncRead for $of<S> {
            fn poll_read(
                mut self: Pin<&mut Self>,
                cx: &mut Context<'_>,
                buf: &mut ReadBuf<'_>,
            ) -> Poll<io::Result<()>> {
                Pin::new(&mut self.0).poll_read(cx, buf)
            }
        }

        impl<S: AsyncWrite + Unpin> AsyncWrite for $of<S> {
            fn poll_write(
                mut self: Pin<&mut Self>,
                cx: &mut Context<'_>,
                buf: &[u8],
            ) -> Poll<io::Result<usize>> {
                Pin::new(&mut self.0).poll_write(cx, buf)
            }

            fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
                Pin::new(&mut self.0).poll_flush(cx)
            }

            fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
                Pin::new(&mut self.0).poll_shutdown(cx)
            }
        }
    };
}

passes_on!(Open);
passes_on!(Wire);
