//! `[audit]`: where the changes that people and programs ask for are put on record.

use super::Bounds;
use serde::Deserialize;
use std::path::PathBuf;

/// `[audit]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The log; its own, not that of `[writeback]`.
    pub file: PathBuf,
    /// It is rotated once it is larger (bytes).
    #[serde(default = "bytes")]
    pub max_bytes: u64,
    /// Rotated files that are kept.
    #[serde(default = "files")]
    pub keep_files: usize,
}

fn bytes() -> u64 {
    16_000_000
}

fn files() -> usize {
    20
}

impl Config {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        if self.file.as_os_str().is_empty() {
            wrong.push(("file", "must name a file".to_string()));
        }
        let (bytes, files) = (self.max_bytes, self.keep_files);
        if !(10_000..=1_000_000_000).contains(&bytes) {
            wrong.push(("max_bytes", format!("{bytes} must be 10000 to 1000000000")));
        }
        if !(1..=10_000).contains(&files) {
            wrong.push(("keep_files", format!("{files} must be 1 to 10000")));
        }
        wrong
    }

    /// How large it may grow.
    pub fn bounds(&self) -> Bounds {
        Bounds { max_bytes: self.max_bytes, keep_files: self.keep_files }
    }
}
