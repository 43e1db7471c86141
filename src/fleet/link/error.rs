//! Why the link does not do what it was asked.

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
}

pub(super) fn away(error: impl std::fmt::Display) -> LinkError {
    LinkError::Away(error.to_string())
}
