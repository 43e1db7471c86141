//! Why a file is no record.

use std::io;

/// Why a table is refused; it names the line and column where it can, and the option that decides a doubt.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file could not be read.
    #[error("cannot read: {0}")]
    Io(#[from] io::Error),
    /// What it holds is no record, or leaves a doubt.
    #[error("{0}")]
    Refused(String),
}

impl TableError {
    /// A refusal in words.
    pub(super) fn refused(what: impl Into<String>) -> Self {
        Self::Refused(what.into())
    }
}

/// Longest text that a message shows of a cell (characters).
const SHOWN: usize = 40;

/// A cell in a message: short, whatever it holds.
pub fn shown(cell: &str) -> String {
    let cell = super::number::bare(cell);
    let mut out: String = cell.chars().take(SHOWN).collect();
    if out.len() < cell.len() {
        out.push('…');
    }
    out
}

/// Most names that a message lists.
const NAMED: usize = 8;

/// Names in a message, quoted, the first of many.
pub fn listed<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let mut names = names.into_iter();
    let mut out: Vec<String> = names.by_ref().take(NAMED).map(|name| format!("{:?}", shown(name))).collect();
    if names.next().is_some() {
        out.push("…".into());
    }
    out.join(", ")
}
