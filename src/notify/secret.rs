//! Secrets: read where they are used, anew each time, and never shown.

use std::fs::File;
use std::io::Read;
use std::path::PathBuf;

/// Longest file read (bytes).
const MOST: u64 = 1 << 16;

/// Where a secret is found; read anew whenever it is needed.
#[derive(Clone, Debug, PartialEq)]
pub enum Secret {
    /// In a file.
    File(PathBuf),
    /// In an environment variable.
    Env(String),
}

impl Secret {
    /// The one that a file names, if any.
    pub(super) fn of(file: &Option<PathBuf>, env: &Option<String>) -> Option<Self> {
        file.clone().map(Self::File).or_else(|| env.clone().map(Self::Env))
    }
}

/// The lines of a secret that are not empty. Files are read on the caller's thread: not on an async one.
///
/// # Errors
/// Why there is none; what is in it is never said.
pub(super) fn lines(secret: &Secret) -> Result<Vec<String>, String> {
    let text = match secret {
        Secret::Env(name) => {
            std::env::var(name).map_err(|_| format!("the environment variable {name} is not set"))?
        }
        Secret::File(path) => {
            let mut text = String::new();
            let read = File::open(path).and_then(|file| file.take(MOST).read_to_string(&mut text));
            read.map_err(|error| format!("{}: {error}", path.display()))?;
            text
        }
    };
    let lines: Vec<String> =
        text.lines().map(str::trim).filter(|line| !line.is_empty()).map(Into::into).collect();
    if lines.is_empty() {
        return Err(match secret {
            Secret::Env(name) => format!("the environment variable {name} is empty"),
            Secret::File(path) => format!("{} is empty", path.display()),
        });
    }
    Ok(lines)
}
