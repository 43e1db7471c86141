//! What an OPC UA server sends: frames under our bound, and the messages in their chunks.

use super::{scratch, wait};
use futures::StreamExt;
use opcua::core::ResponseMessage;
use opcua::core::comms::chunker::Chunker;
use opcua::core::comms::message_chunk::{MessageChunk, MessageIsFinalType};
use opcua::core::comms::secure_channel::{Role, SecureChannel};
use opcua::core::comms::tcp_codec::{Message, TcpCodec};
use opcua::crypto::CertificateStore;
use opcua::sync::RwLock;
use opcua::types::{ContextOwned, DecodingOptions, NamespaceMap, TypeLoaderCollection};
use std::io::Cursor;
use std::sync::Arc;
use stictiond::bounded::{Bounded, OPCUA};
use tokio::io::{join, sink};
use tokio_util::codec::FramedRead;

/// As the collector sets them.
fn options() -> DecodingOptions {
    DecodingOptions { max_array_length: 20_000, ..DecodingOptions::default() }
}

thread_local! {
    /// A channel without encryption, which a server has before it is trusted.
    static CHANNEL: SecureChannel = {
        let context = ContextOwned::new(NamespaceMap::new(), TypeLoaderCollection::new(), options());
        let store = CertificateStore::new(&scratch("opcua"));
        SecureChannel::new(Arc::new(RwLock::new(store)), Role::Client, Arc::new(RwLock::new(context)))
    };
}

/// Takes what a server sends on one connection.
pub fn run(bytes: &[u8]) {
    CHANNEL.with(|channel| connection(bytes, channel));
}

fn connection(bytes: &[u8], channel: &SecureChannel) {
    let stream = Bounded::new(join(Cursor::new(bytes.to_vec()), sink()), OPCUA);
    let mut frames = FramedRead::new(stream, TcpCodec::new(options()));
    let mut chunks: Vec<MessageChunk> = Vec::new();
    wait(async {
        while let Some(Ok(message)) = frames.next().await {
            let Message::Chunk(chunk) = message else { continue };
            let Ok(info) = chunk.chunk_info(channel) else { break };
            chunks.push(chunk);
            if info.message_header.is_final == MessageIsFinalType::Intermediate {
                continue;
            }
            if Chunker::validate_chunks(channel, &chunks).is_ok() {
                let _ = Chunker::decode::<ResponseMessage>(&chunks, channel, None);
            }
            chunks.clear();
        }
    });
}
