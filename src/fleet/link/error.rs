//! Why the link does not do what it was asked.

use async_nats::jetstream::ErrorCode;
use async_nats::jetstream::context::{CreateStreamError, CreateStreamErrorKind};
use async_nats::jetstream::stream::Config;

/// Why the link does not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// A file that it was told of cannot be used.
    #[error("[fleet] {0}")]
    Settings(String),
    /// Nobody answers.
    #[error("NATS: {0}")]
    Away(String),
    /// Somebody else wrote first.
    #[error("NATS: another message came first")]
    Overtaken,
    /// The message is larger than a server takes (bytes).
    #[error("NATS: a message of {0} bytes is larger than the server takes")]
    TooLarge(usize),
    /// The server reserves the room of a stream when the stream is made, and has not got it.
    #[error(
        "NATS: the server has no room for the {megabytes} MB of the stream {stream}: raise max_file_store in its \
         configuration or the account's limit there, free its disk (it takes three quarters of what is free unless told), or \
         lower samples_mb, diagnoses_mb or alarms_mb in [fleet]"
    )]
    NoRoom {
        /// Its name.
        stream: String,
        /// What it may take at most (MB).
        megabytes: i64,
    },
}

/// What a server answers that has no room for a stream: none on its disk, none left of what it may take, none left to the account.
const NO_ROOM: [ErrorCode; 3] = [
    ErrorCode::STORAGE_RESOURCES_EXCEEDED,
    ErrorCode::INSUFFICIENT_RESOURCES,
    ErrorCode::ACCOUNT_RESOURCES_EXCEEDED,
];

/// Why a stream is not made.
pub(super) fn unmade(error: &CreateStreamError, wanted: &Config) -> LinkError {
    match error.kind() {
        CreateStreamErrorKind::JetStream(own) if NO_ROOM.contains(&own.error_code()) => {
            LinkError::NoRoom { stream: wanted.name.clone(), megabytes: wanted.max_bytes / 1_000_000 }
        }
        _ => away(error),
    }
}

pub(super) fn away(error: impl std::fmt::Display) -> LinkError {
    LinkError::Away(error.to_string())
}
