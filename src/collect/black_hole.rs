//! For tests: an address on loopback that takes no connection and refuses none.

use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::time::timeout;

/// How long a connection on loopback may take; one that takes longer is not answered.
const BRIEF: Duration = Duration::from_millis(200);

/// A listener whose queue is full, as long as this lives.
pub(super) struct BlackHole {
    /// Its address.
    pub(super) address: SocketAddr,
    _listener: TcpListener,
    _waiting: Vec<TcpStream>,
}

impl BlackHole {
    /// Nobody takes its connections, and no more than a few wait: the next one is not answered.
    pub(super) async fn open() -> Self {
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
