//! The stream under a session: what the server sends is counted chunk by chunk. The library's own believes any length, and
//! keeps what comes until it is reached.

use crate::bounded::{Bounded, OPCUA};
use opcua::client::ConnectionSource;
use opcua::client::transport::{
    Connector, RequestRecv, SecureChannelState, StreamConnection, StreamConnector, StreamTransport,
    TransportConfiguration,
};
use opcua::core::comms::tcp_codec::TcpCodec;
use opcua::core::comms::url::{hostname_port_from_url, is_opc_ua_binary_url};
use opcua::core::constants::DEFAULT_OPC_UA_SERVER_PORT;
use opcua::types::{DecodingOptions, EndpointDescription, Error, StatusCode};
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{ReadHalf, WriteHalf, split};
use tokio::net::{TcpStream, lookup_host};
use tokio::time::timeout;
use tokio_util::codec::FramedRead;

type Stream = Bounded<TcpStream>;
type Connection = StreamConnection<ReadHalf<Stream>, WriteHalf<Stream>>;

/// Opens connections to one endpoint.
pub(super) struct Counted {
    url: String,
    /// Longest wait for all addresses of its host.
    limit: Duration,
}

/// To an endpoint by its address.
pub(super) fn to(url: &str, limit: Duration) -> Result<Counted, Error> {
    if is_opc_ua_binary_url(url) {
        return Ok(Counted { url: url.to_string(), limit });
    }
    Err(Error::new(StatusCode::BadInvalidArgument, "the address does not begin with opc.tcp://"))
}

impl Connector for Counted {
    type Transport = StreamTransport<ReadHalf<Stream>, WriteHalf<Stream>>;

    async fn connect(
        &self,
        channel: Arc<SecureChannelState>,
        requests: RequestRecv,
        config: TransportConfiguration,
    ) -> Result<Self::Transport, Error> {
        let limit = self.limit;
        let open = move |url: String, options: DecodingOptions| connect(url, options, limit);
        StreamConnector::new(open, self.url.clone()).connect(channel, requests, config).await
    }

    fn default_endpoint(&self) -> EndpointDescription {
        EndpointDescription::from(self.url.as_str())
    }
}

/// Opens the connection of a session, within this time.
pub(super) struct Wire(pub(super) Duration);

impl ConnectionSource for Wire {
    type Builder = Counted;

    fn get_connector(&self, endpoint: &EndpointDescription) -> Result<Counted, Error> {
        to(endpoint.endpoint_url.as_ref(), self.0)
    }
}

async fn connect(url: String, options: DecodingOptions, limit: Duration) -> Result<Connection, Error> {
    let (host, port) = hostname_port_from_url(&url, DEFAULT_OPC_UA_SERVER_PORT)
        .map_err(|status| Error::new(status, "the address names no host"))?;
    let unconnected = |error: io::Error| {
        Error::new(StatusCode::BadCommunicationError, format!("no connection to {host}:{port}: {error}"))
    };
    let found = lookup_host((host.trim_matches(['[', ']']), port)).await.map_err(unconnected)?;
    let addresses: Vec<SocketAddr> = found.collect();
    let stream = first(&addresses, limit).await.map_err(unconnected)?;
    let (read, write) = split(Bounded::new(stream, OPCUA));
    Ok(StreamConnection::new(FramedRead::new(read, TcpCodec::new(options)), write, url))
}

/// Connects to the first of a host's addresses that answers. One that never does leaves the others their share of the time,
/// and one share is left for what is said over the connection.
async fn first(addresses: &[SocketAddr], limit: Duration) -> io::Result<TcpStream> {
    let shares = u32::try_from(addresses.len()).unwrap_or(u32::MAX).saturating_add(1);
    // A single address has all of the time: whoever waits for the session ends it.
    let share = if addresses.len() > 1 { limit / shares } else { limit };
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    for address in addresses {
        last = match timeout(share, TcpStream::connect(*address)).await {
            Ok(Ok(stream)) => return Ok(stream),
            Ok(Err(error)) => io::Error::new(error.kind(), format!("{address}: {error}")),
            Err(_) => {
                let waited = format!("{address}: no answer within {} ms", share.as_millis());
                io::Error::new(io::ErrorKind::TimedOut, waited)
            }
        };
    }
    Err(last)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::black_hole::BlackHole;
    use tokio::net::TcpListener;

    #[tokio::test]
    async fn an_address_that_never_answers_leaves_time_for_the_next() {
        let hole = BlackHole::open().await;
        let black_hole = hole.address;
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let alive = listener.local_addr().unwrap();
        let limit = Duration::from_millis(1500);
        let stream = timeout(limit, first(&[black_hole, alive], limit)).await.expect("in time").unwrap();
        assert_eq!(stream.peer_addr().unwrap(), alive);
        // Where none answers, the error names the last.
        let error =
            timeout(limit, first(&[black_hole, black_hole], limit)).await.expect("in time").unwrap_err();
        assert!(error.to_string().contains(&black_hole.to_string()), "{error}");
    }
}
