//! The header line: which delimiter, which column is what.

use super::cell::{Cells, is_blank, shown};
use super::{CsvError, MAX_COLUMNS, MAX_LINE};
use crate::signal::Role;
use std::io::{Cursor, ErrorKind, Read};

/// Bytes looked at to find the header line.
const SNIFFED: usize = 1 << 16;
const DELIMITERS: [u8; 3] = [b',', b';', b'\t'];

/// What a column's samples are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    Role(Role),
    Tag,
}

/// One column of the header.
pub struct Named {
    /// The name as written, without blanks around it.
    pub name: String,
    /// `None` for the time and for nameless columns.
    pub role: Option<Column>,
    /// The header gives the unit `%`.
    pub per_cent: bool,
}

/// The columns, in the file's order.
pub struct Header {
    pub columns: Vec<Named>,
    /// Index of the time column.
    pub time: usize,
}

/// Where the header is and how it is written.
pub struct Head {
    /// Line of the header, from 1.
    pub line: u64,
    pub delimiter: u8,
}

/// Finds the header line and the delimiter; the reader handed back still begins at the beginning.
pub fn sniff<R: Read>(mut reader: R) -> Result<(Head, impl Read), CsvError> {
    let mut start = vec![0; SNIFFED];
    let mut filled = 0;
    while filled < SNIFFED {
        match reader.read(&mut start[filled..]) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(CsvError::Io(error)),
        }
    }
    start.truncate(filled);
    if start.starts_with(&[0xff, 0xfe]) || start.starts_with(&[0xfe, 0xff]) {
        return Err(CsvError::NotText { line: 1, what: "it looks like UTF-16" });
    }
    let text = start.strip_prefix(&[0xef, 0xbb, 0xbf]).unwrap_or(&start);
    let (at, line) = text
        .split(|&byte| byte == b'\n')
        .enumerate()
        .find(|(_, line)| !is_blank(line))
        .ok_or(CsvError::Empty)?;
    let number = at as u64 + 1;
    if line.contains(&0) {
        return Err(CsvError::NotText { line: number, what: "it holds zero bytes" });
    }
    let Some(delimiter) = delimiter_of(line) else {
        let cells = Cells { decimal_comma: true };
        return Err(if cells.number(line).is_some() {
            CsvError::NoHeader { line: number }
        } else {
            CsvError::OneColumn { line: number, text: shown(line) }
        });
    };
    let head = Head { line: number, delimiter };
    Ok((head, Cursor::new(start).chain(reader)))
}

/// The delimiter under which most cells are known names, then the one with most cells; `None` when none divides.
fn delimiter_of(line: &[u8]) -> Option<u8> {
    let score = |delimiter: u8| {
        let mut quoted = false;
        let mut cells = 1;
        let mut known = 0;
        let mut begin = 0;
        for (at, &byte) in line.iter().chain(&[delimiter]).enumerate() {
            if byte == b'"' {
                quoted = !quoted;
            }
            if byte == delimiter && (!quoted || at == line.len()) {
                let cell = String::from_utf8_lossy(&line[begin..at]);
                known += usize::from(meaning(cell.trim().trim_matches('"')).is_some());
                cells += usize::from(at < line.len());
                begin = at + 1;
            }
        }
        (known, cells)
    };
    DELIMITERS
        .into_iter()
        .map(|delimiter| (score(delimiter), delimiter))
        .filter(|((_, cells), _)| *cells > 1)
        .rev()
        .max_by_key(|(score, _)| *score)
        .map(|(_, delimiter)| delimiter)
}

/// What a known name means.
#[derive(Clone, Copy, PartialEq)]
pub enum Meaning {
    Time,
    Role(Role),
}

impl Meaning {
    fn as_str(self) -> &'static str {
        match self {
            Meaning::Time => "t",
            Meaning::Role(Role::Op) => "op",
            Meaning::Role(Role::Pv) => "pv",
            Meaning::Role(Role::Sp) => "sp",
            Meaning::Role(Role::Mode) => "mode",
            Meaning::Role(Role::Mv) => "mv",
        }
    }
}

/// What a column of this name means; `None` for a tag.
pub fn meaning(name: &str) -> Option<Meaning> {
    Some(match split_unit(name).0.to_ascii_lowercase().as_str() {
        "t" | "time" | "timestamp" | "date" => Meaning::Time,
        "op" | "co" | "out" => Meaning::Role(Role::Op),
        "pv" => Meaning::Role(Role::Pv),
        "sp" => Meaning::Role(Role::Sp),
        "mode" => Meaning::Role(Role::Mode),
        "mv" | "mv_stem" | "stem" => Meaning::Role(Role::Mv),
        _ => return None,
    })
}

/// `OP [%]` as `OP` and `%`.
fn split_unit(name: &str) -> (&str, Option<&str>) {
    let name = name.trim();
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((before, unit)) = name.strip_suffix(close).and_then(|n| n.rsplit_once(open)) {
            return (before.trim(), Some(unit.trim()));
        }
    }
    (name, None)
}

impl Header {
    /// Reads the header row.
    pub fn new(row: &csv::ByteRecord, line: u64, cells: &Cells) -> Result<Self, CsvError> {
        if row.len() > MAX_COLUMNS {
            return Err(CsvError::TooManyColumns { line, columns: row.len() });
        }
        let mut columns: Vec<Named> = Vec::with_capacity(row.len());
        let mut found: Vec<(Meaning, usize)> = Vec::new();
        for (at, cell) in row.iter().enumerate() {
            let name = String::from_utf8_lossy(cell).trim().to_string();
            let meaning = meaning(&name);
            if let Some(meaning) = meaning {
                if let Some(&(_, first)) = found.iter().find(|(other, _)| *other == meaning) {
                    return Err(CsvError::RepeatedColumn {
                        line,
                        column: at + 1,
                        name: shown(cell),
                        role: meaning.as_str(),
                        first: first + 1,
                    });
                }
                found.push((meaning, at));
            }
            let role = match meaning {
                Some(Meaning::Time) => None,
                Some(Meaning::Role(role)) => Some(Column::Role(role)),
                None if name.is_empty() => None,
                None => Some(Column::Tag),
            };
            let per_cent = split_unit(&name).1 == Some("%");
            columns.push(Named { name, role, per_cent });
        }
        let needed = [Meaning::Time, Meaning::Role(Role::Op), Meaning::Role(Role::Pv)];
        let missing: Vec<&str> = needed
            .iter()
            .filter(|needed| !found.iter().any(|(meaning, _)| meaning == *needed))
            .map(|needed| needed.as_str())
            .collect();
        if missing.is_empty() {
            let time = found.iter().find(|(meaning, _)| *meaning == Meaning::Time);
            return Ok(Self { columns, time: time.map_or(0, |(_, at)| *at) });
        }
        if found.is_empty() && row.iter().any(|cell| cells.number(cell).is_some()) {
            return Err(CsvError::NoHeader { line });
        }
        const NAMED: usize = 8;
        let mut names: Vec<String> =
            row.iter().take(NAMED).map(|cell| format!("{:?}", shown(cell))).collect();
        if row.len() > NAMED {
            names.push("…".into());
        }
        Err(CsvError::MissingColumn { line, missing: missing.join(", "), found: names.join(", ") })
    }
}

const _: () = assert!(SNIFFED <= MAX_LINE);
