//! What the daemon reads of its own files: users and tokens, the audit log.

use super::scratch;
use sha2::{Digest, Sha256};
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::sync::OnceLock;
use stictiond::{access, audit};

/// Users and tokens.
pub fn access(bytes: &[u8]) {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    let path = PATH.get_or_init(|| scratch("access").join("users.json"));
    // Its owner's alone, or it is not read at all.
    let file = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(path);
    file.and_then(|mut file| file.write_all(bytes)).expect("written");
    let _ = access::file::load(path);
}

/// Lines without a hash get the right one.
fn chained(text: &[u8]) -> Vec<u8> {
    let (mut before, mut out) = ("0".repeat(64), Vec::new());
    for line in text.split_inclusive(|byte| *byte == b'\n') {
        let (Some(body), false) = (line.strip_suffix(b"\n"), line.windows(2).any(|two| two == b" #")) else {
            out.extend(line);
            continue;
        };
        let digest = Sha256::new().chain_update(&before).chain_update(body).finalize();
        before = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        out.extend([body, b" #", before.as_bytes(), b"\n"].concat());
    }
    out
}

/// A log: a file, and its head behind a zero byte.
pub fn audit(bytes: &[u8]) {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    let path = PATH.get_or_init(|| scratch("audit").join("audit.log"));
    let mut parts = bytes.splitn(2, |byte| *byte == 0);
    fs::write(path, chained(parts.next().unwrap_or_default())).expect("written");
    let head = path.with_file_name("audit.log.head");
    match parts.next() {
        Some(bytes) => fs::write(&head, bytes).expect("written"),
        None => drop(fs::remove_file(&head)),
    }
    let _ = audit::verify(path);
    let mut before = None;
    for _ in 0..4 {
        let Ok(page) = audit::page(path, before, 10) else { break };
        assert!(page.lines.len() <= 10);
        before = page.next;
        if before.is_none() {
            break;
        }
    }
}
