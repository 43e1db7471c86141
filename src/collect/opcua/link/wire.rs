//! The stream under a session: what the server sends is counted chunk by chunk. The library's own believes any length, and
//! keeps what comes until it is reached. It also decodes a message while others that it has decoded still wait; here each is used
//! before the next is read.

use crate::bounded::{Bounded, OPCUA};
use crate::dial;
use opcua::client::ConnectionSource;
use opcua::client::transport::{
    Connector, RequestRecv, SecureChannelState, StreamConnection, StreamConnector, StreamTransport,
    Transport, TransportConfiguration, TransportPollResult,
};
use opcua::core::comms::tcp_codec::TcpCodec;
use opcua::core::comms::url::{hostname_port_from_url, is_opc_ua_binary_url};
use opcua::core::constants::DEFAULT_OPC_UA_SERVER_PORT;
use opcua::types::{DecodingOptions, EndpointDescription, Error, StatusCode};
use std::io;
use std::sync::Arc;
use tokio::io::{ReadHalf, WriteHalf, split};
use tokio::net::TcpStream;
use tokio::task::yield_now;
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
    type Transport = InTurn<StreamTransport<ReadHalf<Stream>, WriteHalf<Stream>>>;

    async fn connect(
        &self,
        channel: Arc<SecureChannelState>,
        requests: RequestRecv,
        config: TransportConfiguration,
    ) -> Result<Self::Transport, Error> {
        let opened =
            StreamConnector::new(connect, self.url.clone()).connect(channel, requests, config).await?;
        Ok(InTurn { transport: opened, came: false })
    }

    fn default_endpoint(&self) -> EndpointDescription {
        EndpointDescription::from(self.url.as_str())
    }
}

/// A transport that lets whoever waits for a message use it before it reads the next. By itself the session takes turns at
/// random, and a decoded message may take far more memory than its bytes.
pub(super) struct InTurn<T> {
    transport: T,
    /// A message came, and nobody else has had a turn since.
    came: bool,
}

impl<T: Transport> Transport for InTurn<T> {
    async fn poll(&mut self) -> TransportPollResult {
        if std::mem::take(&mut self.came) {
            yield_now().await;
        }
        let done = self.transport.poll().await;
        self.came = matches!(done, TransportPollResult::IncomingMessage);
        done
    }

    fn connected_url(&self) -> &str {
        self.transport.connected_url()
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

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;

    /// A server that always has one more message.
    struct Endless;

    impl Transport for Endless {
        async fn poll(&mut self) -> TransportPollResult {
            TransportPollResult::IncomingMessage
        }

        fn connected_url(&self) -> &str {
            "opc.tcp://d:4840/"
        }
    }

    #[test]
    fn between_two_messages_others_have_a_turn() {
        let mut transport = InTurn { transport: Endless, came: false };
        let came: Vec<bool> = (0..6).map(|_| transport.poll().now_or_never().is_some()).collect();
        assert_eq!(came, [true, false, true, false, true, false]);
    }
}
