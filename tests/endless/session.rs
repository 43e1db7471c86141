//! OPC UA servers that open a session and then flood it: every request to publish is answered at once with as many values as a
//! message has room for, and says that there are more. Each answer is followed by a request of ours, so that no count of bytes
//! between two requests bounds it. A request for history, which is read first, is never answered.

use super::rig::{MOST, Peer, at_rest, measured};
use super::{ACK, opcua};
use ::opcua::core::comms::chunker::Chunker;
use ::opcua::core::comms::message_chunk::MessageChunk;
use ::opcua::core::comms::secure_channel::{Role, SecureChannel};
use ::opcua::core::comms::sequence_number::SequenceNumberHandle;
use ::opcua::core::{RequestMessage, ResponseMessage};
use ::opcua::crypto::{CertificateStore, SecurityPolicy};
use ::opcua::sync::RwLock;
use ::opcua::types::{
    ActivateSessionResponse, ChannelSecurityToken, ContextOwned, CreateMonitoredItemsResponse,
    CreateSessionResponse, CreateSubscriptionResponse, DataChangeNotification, DataValue, DateTime,
    DecodingOptions, EndpointDescription, ExtensionObject, GetEndpointsResponse, MessageSecurityMode,
    MonitoredItemCreateResult, MonitoredItemNotification, NamespaceMap, NodeId, NotificationMessage,
    OpenSecureChannelResponse, PublishResponse, ReadResponse, ReadValueId, UserTokenPolicy, VariableId,
    Variant, VariantScalarTypeId,
};
use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::thread;

/// Bytes of values after which it is seen what is held …
const ENOUGH: u64 = 16 << 20;
/// … and of values of nothing: by then 200 MB of them have been decoded, which are six times as much as may be held.
const ENOUGH_OF_NOTHING: u64 = 4 << 20;
/// Longest chunk (bytes).
const CHUNK: usize = 65_535;

/// What a server sends again and again.
#[derive(Clone)]
struct Values {
    name: &'static str,
    value: Variant,
    /// So many fit into one chunk.
    count: usize,
    /// Bytes after which it is seen what is held.
    enough: u64,
}

fn floods() -> [Values; 3] {
    // A value of nothing is a byte on the wire, and some fifty in memory.
    let nothing = vec![Variant::Variant(Box::new(Variant::Empty)); 20_000];
    let list = Variant::from((VariantScalarTypeId::Variant, nothing));
    let text = "\u{1f321}".repeat(40);
    [
        Values { name: "lists of nothing", value: list, count: 3, enough: ENOUGH_OF_NOTHING },
        Values { name: "numbers", value: Variant::from(1.0), count: 2800, enough: ENOUGH },
        Values { name: "texts", value: Variant::from(text.as_str()), count: 350, enough: ENOUGH },
    ]
}

/// A server that sends such values, and counts their bytes.
fn server(values: Values) -> Peer {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("bound").port();
    let sent = Arc::new(AtomicU64::new(0));
    let bytes = sent.clone();
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (values, bytes) = (values.clone(), bytes.clone());
            thread::spawn(move || {
                // It ends one way or another, and what was sent is counted.
                let _ = Connection::new().serve(stream, &values, &bytes);
            });
        }
    });
    Peer { port, ended: Arc::default(), sent }
}

/// One connection without security.
struct Connection {
    channel: SecureChannel,
    sequence: SequenceNumberHandle,
}

impl Connection {
    fn new() -> Self {
        let options = DecodingOptions { max_array_length: 20_000, ..DecodingOptions::default() };
        let context = ContextOwned::new_default(NamespaceMap::new(), options);
        // Nothing is read from it.
        let store = CertificateStore::new(Path::new("/dev/null/pki"));
        let (store, context) = (Arc::new(RwLock::new(store)), Arc::new(RwLock::new(context)));
        let mut channel = SecureChannel::new(store, Role::Server, context);
        channel.set_security_token(token());
        Self { channel, sequence: SequenceNumberHandle::new(true) }
    }

    fn serve(mut self, mut stream: TcpStream, values: &Values, sent: &AtomicU64) -> io::Result<()> {
        // The greeting.
        frame(&mut stream)?;
        stream.write_all(ACK)?;
        let mut published = self.chunk(0, &published(values))?;
        loop {
            let chunk = MessageChunk { data: frame(&mut stream)?.into() };
            let info = chunk.chunk_info(&self.channel).map_err(io::Error::other)?;
            let id = info.sequence_header.request_id;
            let request: RequestMessage =
                Chunker::decode(&[chunk], &self.channel, None).map_err(io::Error::other)?;
            match request {
                RequestMessage::CloseSecureChannel(_) => return Ok(()),
                RequestMessage::Publish(_) => {
                    // Behind the head of the chunk stand the numbers of the chunk and of the request.
                    published[16..20].copy_from_slice(&self.sequence.current().to_le_bytes());
                    published[20..24].copy_from_slice(&id.to_le_bytes());
                    self.sequence.increment(1);
                    stream.write_all(&published)?;
                    sent.fetch_add(published.len() as u64, SeqCst);
                }
                request => {
                    if let Some(response) = answer(&request) {
                        let chunk = self.chunk(id, &response)?;
                        self.sequence.increment(1);
                        stream.write_all(&chunk)?;
                    }
                }
            }
        }
    }

    /// The one chunk of an answer.
    fn chunk(&self, request: u32, response: &ResponseMessage) -> io::Result<Vec<u8>> {
        let chunks = Chunker::encode(self.sequence.clone(), request, 0, CHUNK, &self.channel, response);
        let chunks = chunks.map_err(io::Error::other)?;
        assert_eq!(chunks.len(), 1, "{}", response.type_name());
        Ok(chunks[0].data.to_vec())
    }
}

/// The next message, as its head says how long it is.
fn frame(stream: &mut TcpStream) -> io::Result<Vec<u8>> {
    let mut frame = vec![0; 8];
    stream.read_exact(&mut frame)?;
    let length = u32::from_le_bytes([frame[4], frame[5], frame[6], frame[7]]);
    frame.resize((length as usize).max(8), 0);
    stream.read_exact(&mut frame[8..])?;
    Ok(frame)
}

fn token() -> ChannelSecurityToken {
    ChannelSecurityToken {
        channel_id: 1,
        token_id: 1,
        created_at: DateTime::now(),
        revised_lifetime: 3_600_000,
    }
}

/// As many values of the first tag as a message has room for, and there are always more.
fn published(values: &Values) -> ResponseMessage {
    let value = DataValue {
        value: Some(values.value.clone()),
        source_timestamp: Some(DateTime::now()),
        ..DataValue::null()
    };
    let items = vec![MonitoredItemNotification { client_handle: 1, value }; values.count];
    let change = DataChangeNotification { monitored_items: Some(items), diagnostic_infos: None };
    let notification_message = NotificationMessage {
        sequence_number: 1,
        publish_time: DateTime::now(),
        notification_data: Some(vec![ExtensionObject::from_message(change)]),
    };
    let (subscription_id, more_notifications) = (1, true);
    PublishResponse { subscription_id, more_notifications, notification_message, ..Default::default() }.into()
}

/// What a server says to everything else; nothing to a request for history.
fn answer(request: &RequestMessage) -> Option<ResponseMessage> {
    Some(match request {
        RequestMessage::OpenSecureChannel(_) => {
            OpenSecureChannelResponse { security_token: token(), ..Default::default() }.into()
        }
        RequestMessage::GetEndpoints(asked) => {
            let endpoint = EndpointDescription {
                endpoint_url: asked.endpoint_url.clone(),
                security_mode: MessageSecurityMode::None,
                security_policy_uri: SecurityPolicy::None.to_uri().into(),
                user_identity_tokens: Some(vec![UserTokenPolicy::anonymous()]),
                ..Default::default()
            };
            GetEndpointsResponse { endpoints: Some(vec![endpoint]), ..Default::default() }.into()
        }
        RequestMessage::CreateSession(_) => CreateSessionResponse {
            session_id: NodeId::new(1, 1u32),
            authentication_token: NodeId::new(1, 2u32),
            revised_session_timeout: 60_000.0,
            ..Default::default()
        }
        .into(),
        RequestMessage::ActivateSession(_) => ActivateSessionResponse::default().into(),
        RequestMessage::Read(asked) => {
            let results = asked.nodes_to_read.iter().flatten().map(read).collect();
            ReadResponse { results: Some(results), ..Default::default() }.into()
        }
        RequestMessage::CreateSubscription(asked) => CreateSubscriptionResponse {
            subscription_id: 1,
            revised_publishing_interval: asked.requested_publishing_interval,
            revised_lifetime_count: asked.requested_lifetime_count,
            revised_max_keep_alive_count: asked.requested_max_keep_alive_count,
            ..Default::default()
        }
        .into(),
        RequestMessage::CreateMonitoredItems(asked) => {
            let items = asked.items_to_create.iter().flatten().zip(1..);
            let item = |id| MonitoredItemCreateResult { monitored_item_id: id, ..Default::default() };
            let results = Some(items.map(|(_, id)| item(id)).collect());
            CreateMonitoredItemsResponse { results, ..Default::default() }.into()
        }
        _ => return None,
    })
}

/// Its namespaces, and that it runs; nothing else.
fn read(asked: &ReadValueId) -> DataValue {
    let value = if asked.node_id == VariableId::Server_NamespaceArray {
        let uris = ["http://opcfoundation.org/UA/", "urn:server", "urn:plant"];
        Some(Variant::from(uris.map(String::from).to_vec()))
    } else if asked.node_id == VariableId::Server_ServerStatus_State {
        Some(Variant::from(0i32))
    } else {
        None
    };
    DataValue { value, ..DataValue::null() }
}

#[test]
fn sessions_that_are_flooded() {
    // Its own history is the first thing that a daemon wants.
    let config = opcua().replace("timeout_ms = 4000\n", "timeout_ms = 4000\nbackfill_s = 3600.0\n");
    let rest = at_rest("opc ua session", &config);
    for values in floods() {
        let (name, enough) = (values.name, values.enough);
        let most = measured(&server(values), &format!("opc ua session {name}"), &config, enough);
        let grown = most.saturating_sub(rest);
        println!(
            "{:20} {name:32} {:6.1} MiB beyond rest",
            "opc ua session",
            grown as f64 / f64::from(1 << 20)
        );
        assert!(grown < MOST, "{name}: {grown} bytes beyond rest");
    }
}
