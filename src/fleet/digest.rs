//! What a message is known by.

use sha2::{Digest, Sha256};

/// The same bytes to the same subject have the same.
pub fn digest(subject: &str, body: &[u8]) -> [u8; 32] {
    let mut hash = Sha256::new();
    hash.update(subject.as_bytes());
    hash.update([0]);
    hash.update(body);
    hash.finalize().into()
}

/// As it is written.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
