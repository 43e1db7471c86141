//! Connections: a bound on how many are open, on how long each step may take, and TLS where it is configured.

use super::tls::Tls;
use axum::Router;
use axum::body::Body;
use futures::future::BoxFuture;
use http_body_util::BodyExt;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::Service;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::io;
use std::net::SocketAddr;
use std::pin::{Pin, pin};
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, Waker};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::{Instant, Sleep, sleep, timeout};
use tokio_util::sync::CancellationToken;

/// Longest wait for a handshake.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// A connection on which nothing goes either way is closed after this.
const IDLE: Duration = Duration::from_secs(90);
/// Largest head of a request (bytes), and most lines in it.
const HEAD_BYTES: usize = 16 * 1024;
const HEAD_LINES: usize = 64;
/// Pause after the system had no room for a connection.
const NO_ROOM: Duration = Duration::from_millis(100);

/// Who is at the other end; a request carries it.
#[derive(Clone, Copy, Debug)]
pub struct Peer(pub SocketAddr);

/// How many, and how long.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Connections open at the same time.
    pub connections: usize,
    /// Longest wait for the head of a request, and so between two of them.
    pub head: Duration,
}

/// Serves until `stop` is cancelled, then lets open requests end.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    tls: Option<Arc<Tls>>,
    bounds: Bounds,
    stop: CancellationToken,
) {
    let room = Arc::new(Semaphore::new(bounds.connections.max(1)));
    let mut open = JoinSet::new();
    loop {
        // Further clients wait in the system's backlog. The semaphore is never closed.
        let permit = tokio::select! {
            permit = room.clone().acquire_owned() => permit.ok(),
            () = stop.cancelled() => break,
        };
        let (stream, address) = tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    // A client that went away at once, or no more file descriptors: the next may be better.
                    tracing::debug!(%error, "no connection");
                    sleep(NO_ROOM).await;
                    continue;
                }
            },
            () = stop.cancelled() => break,
        };
        // Without it small events wait for the client's acknowledgement; the connection works all the same.
        let _ = stream.set_nodelay(true);
        let half = Arc::new(Half::default());
        let service = Served::new(router.clone(), Peer(address), half.clone());
        let stream = Bounded::new(stream, half);
        let (tls, stop) = (tls.clone(), stop.clone());
        open.spawn(async move {
            let _permit = permit;
            match tls {
                None => connection(stream, service, bounds.head, stop).await,
                Some(tls) => match timeout(HANDSHAKE, tls.acceptor().accept(stream)).await {
                    Ok(Ok(stream)) => connection(stream, service, bounds.head, stop).await,
                    Ok(Err(error)) => tracing::debug!(%address, %error, "no TLS connection"),
                    Err(_) => tracing::debug!(%address, "no TLS connection in time"),
                },
            }
        });
        while open.try_join_next().is_some() {}
    }
    while open.join_next().await.is_some() {}
}

async fn connection(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send,
    service: Served,
    head: Duration,
    stop: CancellationToken,
) {
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new())
        .header_read_timeout(head)
        .max_headers(HEAD_LINES)
        .max_buf_size(HEAD_BYTES)
        .pipeline_flush(false);
    let mut serving = pin!(http.serve_connection(TokioIo::new(stream), service));
    let ended = tokio::select! {
        ended = serving.as_mut() => ended,
        () = stop.cancelled() => {
            serving.as_mut().graceful_shutdown();
            serving.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection broke");
    }
}

/// Nothing more comes from a client: streams to it end; who has asked something that ends is still answered.
#[derive(Clone, Debug)]
pub struct Gone(pub CancellationToken);

/// What a connection knows of a client that has closed its half. The server library takes that for a client that went
/// away, so it hears of it only when nothing is being answered any more.
#[derive(Default)]
struct Half {
    closed: CancellationToken,
    answering: AtomicUsize,
    waiting: Mutex<Option<Waker>>,
}

/// An answer that is being given; dropped with its last byte.
struct Answering(Arc<Half>);

impl Answering {
    fn new(half: &Arc<Half>) -> Self {
        half.answering.fetch_add(1, SeqCst);
        Self(half.clone())
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        self.0.answering.fetch_sub(1, SeqCst);
        if let Some(waker) = self.0.waiting.lock().unwrap_or_else(PoisonError::into_inner).take() {
            waker.wake();
        }
    }
}

/// The routes, as one client sees them.
struct Served {
    router: TowerToHyperService<Router>,
    peer: Peer,
    half: Arc<Half>,
}

impl Served {
    fn new(router: Router, peer: Peer, half: Arc<Half>) -> Self {
        Self { router: TowerToHyperService::new(router), peer, half }
    }
}

impl Service<Request<Incoming>> for Served {
    type Response = axum::response::Response;
    type Error = std::convert::Infallible;
    type Future = BoxFuture<'static, Result<Self::Response, Self::Error>>;

    fn call(&self, request: Request<Incoming>) -> Self::Future {
        let mut request = request.map(Body::new);
        request.extensions_mut().insert(self.peer);
        request.extensions_mut().insert(Gone(self.half.closed.clone()));
        let (answering, answer) = (Answering::new(&self.half), self.router.call(request));
        Box::pin(async move {
            let response = answer.await?;
            Ok(response.map(|body| {
                Body::new(body.map_frame(move |frame| {
                    let _until_the_end = &answering;
                    frame
                }))
            }))
        })
    }
}

/// A connection that ends when nothing went either way for long.
struct Bounded {
    stream: TcpStream,
    silence: Pin<Box<Sleep>>,
    half: Arc<Half>,
}

impl Bounded {
    fn new(stream: TcpStream, half: Arc<Half>) -> Self {
        Self { stream, silence: Box::pin(sleep(IDLE)), half }
    }

    /// The client's half is closed: that is told once nothing is being answered.
    fn closed(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.half.closed.cancel();
        let mut waiting = self.half.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        // Looked at while the place for the waker is held: an answer that ends now wakes us after that.
        if self.half.answering.load(SeqCst) == 0 {
            return Poll::Ready(Ok(()));
        }
        *waiting = Some(cx.waker().clone());
        Poll::Pending
    }

    /// Starts the silence anew when something went, else ends it when it was long enough.
    fn heard<T>(&mut self, went: Poll<io::Result<T>>, cx: &mut Context<'_>) -> Poll<io::Result<T>> {
        if went.is_ready() {
            self.silence.as_mut().reset(Instant::now() + IDLE);
            return went;
        }
        self.silence.as_mut().poll(cx).map(|()| Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for Bounded {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        let mut read = Pin::new(&mut self.stream).poll_read(cx, buf);
        if matches!(read, Poll::Ready(Ok(()))) && buf.filled().len() == before && buf.remaining() > 0 {
            read = self.closed(cx);
        }
        self.heard(read, cx)
    }
}

impl AsyncWrite for Bounded {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, buf);
        self.heard(written, cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, bufs);
        self.heard(written, cx)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
