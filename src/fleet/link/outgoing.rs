//! What is sent to a stream.

/// A message to be kept by a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Outgoing {
    /// Where to.
    pub subject: String,
    /// What.
    pub body: Vec<u8>,
    /// The same bytes are the same message; else they are news each time.
    pub once: bool,
}

impl Outgoing {
    /// A message that is kept once however often it is sent.
    pub fn once(subject: String, body: Vec<u8>) -> Self {
        Self { subject, body, once: true }
    }

    /// How something is now, in place of what was said before.
    pub fn latest(subject: String, body: Vec<u8>) -> Self {
        Self { subject, body, once: false }
    }
}
