//! One line per error, `file:line:column: message`, in the order of the file.

use std::collections::{BTreeSet, HashSet};
use std::fmt;

/// Something wrong in the configuration file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// The file's name.
    pub file: String,
    /// Line, from 1; 0 when the file as a whole is meant.
    pub line: usize,
    /// Column in characters, from 1; 0 when the file as a whole is meant.
    pub column: usize,
    /// What is wrong and what would be right; one line.
    pub message: String,
}

impl Diagnostic {
    /// About the file as a whole.
    pub fn of_file(file: &str, message: String) -> Self {
        Self { file: file.into(), line: 0, column: 0, message }
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(out, "{}: {}", self.file, self.message),
            line => write!(out, "{}:{line}:{}: {}", self.file, self.column, self.message),
        }
    }
}

/// Collects what is wrong with one text.
pub struct Report<'a> {
    file: &'a str,
    text: &'a str,
    /// Byte at which each line begins.
    lines: Vec<usize>,
    /// By byte, so that they come out in the file's order, and none twice.
    found: BTreeSet<(usize, String)>,
    /// Lines that are no TOML: whatever else is said of them follows from that.
    broken: BTreeSet<usize>,
    /// A section is not understood as a whole.
    sections: bool,
}

impl<'a> Report<'a> {
    pub fn new(file: &'a str, text: &'a str) -> Self {
        let ends = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
        Self {
            file,
            text,
            lines: std::iter::once(0).chain(ends.map(|(at, _)| at + 1)).collect(),
            found: BTreeSet::new(),
            broken: BTreeSet::new(),
            sections: false,
        }
    }

    /// Something wrong at a byte of the text.
    pub fn at(&mut self, byte: usize, message: String) {
        if !self.broken.contains(&self.line(byte)) {
            self.found.insert((byte, message.replace(['\n', '\r'], " ")));
        }
    }

    /// A section that is not understood as a whole.
    pub fn section(&mut self, byte: usize, message: String) {
        self.at(byte, message);
        self.sections = true;
    }

    /// Whether a section is not understood as a whole.
    pub fn has_section_errors(&self) -> bool {
        self.sections
    }

    /// A line that cannot be read as TOML.
    pub fn broken(&mut self, byte: usize, message: String) {
        self.at(byte, message);
        self.broken.insert(self.line(byte));
    }

    /// Bytes at which something was found.
    pub fn places(&self) -> HashSet<usize> {
        self.found.iter().map(|(byte, _)| *byte).collect()
    }

    /// True while nothing was found.
    pub fn is_clean(&self) -> bool {
        self.found.is_empty()
    }

    /// True when a line could not be read.
    pub fn is_broken(&self) -> bool {
        !self.broken.is_empty()
    }

    /// The line of a byte, from 1.
    pub fn line(&self, byte: usize) -> usize {
        self.lines.partition_point(|begin| *begin <= byte)
    }

    /// Everything found.
    pub fn finish(self) -> Vec<Diagnostic> {
        let place = |byte: usize| {
            let line = self.line(byte);
            let begin = self.lines.get(line - 1).copied().unwrap_or(0);
            let before = self.text.get(begin..byte.min(self.text.len())).unwrap_or("");
            (line, before.chars().count() + 1)
        };
        let diagnostic = |(byte, message): &(usize, String)| {
            let (line, column) = place(*byte);
            Diagnostic { file: self.file.into(), line, column, message: message.clone() }
        };
        self.found.iter().map(diagnostic).collect()
    }
}
