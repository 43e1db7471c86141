//! The stream under a session: what the server sends is counted chunk by chunk. The library's own believes any length, and
//! keeps what comes until it is reached.

use crate::bounded::{Bounded, OPCUA};
use crate::dial;
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
use std::sync::Arc;
use tokio::io::{ReadHalf, WriteHalf, split};
use tokio::net::TcpStream;
use tokio_util::codec::FramedRead;

type Stream = Bounded<TcpStream>;
type Connection = StreamConnection<ReadHalf<Stream>, WriteHalf<Stream>>;

/// Opens connections to one endpoint.
pub(super) struct Counted {
    url: String,
}

/// To an endpoint by its address.
pub(super) fn to(url: &str) -> Result<Counted, Error> {
    if is_opc_ua_binary_url(url) {
        return Ok(Counted { url: url.to_string() });
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
        StreamConnector::new(connect, self.url.clone()).connect(channel, requests, config).await
    }

    fn default_endpoint(&self) -> EndpointDescription {
        EndpointDescription::from(self.url.as_str())
    }
}

/// Opens the connection of a session.
pub(super) struct Wire;

impl ConnectionSource for Wire {
    type Builder = Counted;

    fn get_connector(&self, endpoint: &EndpointDescription) -> Result<Counted, Error> {
        to(endpoint.endpoint_url.as_ref())
    }
}

async fn connect(url: String, options: DecodingOptions) -> Result<Connection, Error> {
    let (host, port) = hostname_port_from_url(&url, DEFAULT_OPC_UA_SERVER_PORT)
        .map_err(|status| Error::new(status, "the address names no host"))?;
    let unconnected = |error: io::Error| {
        Error::new(StatusCode::BadCommunicationError, format!("no connection to {host}:{port}: {error}"))
    };
    let stream = dial::to((host.trim_matches(['[', ']']), port)).await.map_err(unconnected)?;
    let (read, write) = split(Bounded::new(stream, OPCUA));
    Ok(StreamConnection::new(FramedRead::new(read, TcpCodec::new(options)), write, url))
}
