//! Connections to other machines by TCP: to the first of a host's addresses that answers.

use futures::stream::{FuturesUnordered, StreamExt};
use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::{TcpSocket, TcpStream, ToSocketAddrs, lookup_host};
use tokio::time::timeout;

/// A host's next address is tried too when the one before has not answered for so long: far longer than a plant's network
/// takes, and a small part of any time-out.
const APART: Duration = Duration::from_millis(100);

/// Connects to a host's port. How long is waited is up to the caller.
///
/// # Errors
/// Why the last of its addresses does not answer; which one that is, where there are several.
pub async fn to(host: impl ToSocketAddrs) -> io::Result<TcpStream> {
    let addresses: VecDeque<SocketAddr> = lookup_host(host).await?.collect();
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
    // A request is small; waiting for more to send would only delay it.
    socket.set_nodelay(true)?;
    socket.set_keepalive(true)?;
    socket.connect(address).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::net::TcpListener;

    /// How long a connection on loopback may take; one that takes longer is not answered.
    const BRIEF: Duration = Duration::from_millis(200);

    /// A listener whose queue is full, as long as this lives: it takes no connection and refuses none.
    struct BlackHole {
        address: SocketAddr,
        _listener: TcpListener,
        _waiting: Vec<TcpStream>,
    }

    impl BlackHole {
        /// Nobody takes its connections, and no more than a few wait: the next one is not answered.
        async fn open() -> Self {
            let socket = TcpSocket::new_v4().unwrap();
            socket.bind("127.0.0.1:0".parse().unwrap()).unwrap();
            let listener = socket.listen(1).unwrap();
            let address = listener.local_addr().unwrap();
            let mut waiting = Vec::new();
            while let Ok(Ok(stream)) = timeout(BRIEF, TcpStream::connect(address)).await {
                waiting.push(stream);
                assert!(waiting.len() < 100, "it takes them all");
            }
            Self { address, _listener: listener, _waiting: waiting }
        }
    }

    #[tokio::test]
    async fn an_address_that_never_answers_leaves_time_for_the_next() {
        let black_hole = BlackHole::open().await;
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let alive = listener.local_addr().unwrap();
        let dialled =
            timeout(Duration::from_millis(900), first(VecDeque::from([black_hole.address, alive]))).await;
        assert_eq!(dialled.expect("in time").unwrap().peer_addr().unwrap(), alive);
        assert_eq!(to(alive).await.unwrap().peer_addr().unwrap(), alive);
        // One that refuses leaves it at once, and is named where there is no other.
        drop(listener);
        let error = first(VecDeque::from([alive, alive])).await.expect_err("nobody listens");
        assert!(error.to_string().starts_with(&format!("{alive}: ")), "{error}");
        let error = to(alive).await.expect_err("nobody listens");
        assert!(!error.to_string().contains(&alive.to_string()), "the caller has named it: {error}");
        let error = first(VecDeque::new()).await.expect_err("there is none");
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
    }
}
