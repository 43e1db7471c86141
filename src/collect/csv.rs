//! One loop's record from a CSV file: the columns of a historian's export to a [`Record`].
//!
//! `read` is pure apart from the reader it is given. What a cell holds is judged here (a number, a time,
//! nothing, rubbish); what the samples mean (gaps, order, duplicates) is judged by the diagnosis' gate.
//!
//! | accepted | |
//! |---|---|
//! | delimiter | comma, semicolon or tab, found from the header; a decimal comma with the latter two |
//! | header | any order and case, a unit in brackets allowed: `OP [%]` |
//! | time | `t`, `time`, `timestamp`, `date`: seconds, RFC 3339, or `YYYY-MM-DD hh:mm:ss` read as UTC |
//! | roles | `op`/`co`/`out`, `pv`, `sp`, `mode`, `mv`/`mv_stem`/`stem`; every other column is a tag |
//! | blank cell | no sample; a column blank throughout was not recorded |
//! | no number in a value cell | a sample of quality `bad:not_a_number` |

mod cell;
mod header;

use crate::signal::{BadReason, Quality, Record, Role, Sample, Series};
pub(super) use cell::Cells;
use header::{Column, Header};
pub(super) use header::{Meaning, meaning};
use std::io::{self, Read};

/// Most values (rows times columns) taken from one file: 1.6 GB of samples.
pub const MAX_VALUES: usize = 1 << 26;
/// Longest line accepted (bytes); an unclosed quote must not swallow the file into memory.
const MAX_LINE: usize = 1 << 20;
/// Most columns accepted.
const MAX_COLUMNS: usize = 1 << 12;
/// Bytes read at a time.
const BUFFER: usize = 1 << 18;

/// Why a file is no record; each names the line and column where it can.
#[derive(Debug, thiserror::Error)]
pub enum CsvError {
    /// The file could not be read.
    #[error("cannot read: {0}")]
    Io(#[source] io::Error),
    /// No header line.
    #[error("line 1: empty file; a header such as t,op,pv and one line per sample are needed")]
    Empty,
    /// The first bytes are no UTF-8 text.
    #[error("line {line}: not text ({what}); save the record as CSV in UTF-8")]
    NotText {
        /// Line of the header.
        line: u64,
        /// What it looks like instead.
        what: &'static str,
    },
    /// The header has a single column under each delimiter.
    #[error(
        "line {line}: only one column, {text:?}; t, op and pv must be separated by comma, semicolon or tab"
    )]
    OneColumn {
        /// Line of the header.
        line: u64,
        /// The beginning of the line.
        text: String,
    },
    /// The first line holds numbers.
    #[error("line {line}: numbers where the header should be; put a line such as t,op,pv above them")]
    NoHeader {
        /// Line of the first numbers.
        line: u64,
    },
    /// A needed column is not in the header.
    #[error(
        "line {line}: no column {missing} (t the time, op the controller's output, pv the measured value); the header has {found}"
    )]
    MissingColumn {
        /// Line of the header.
        line: u64,
        /// The needed names.
        missing: String,
        /// The header's names.
        found: String,
    },
    /// Two columns mean the same.
    #[error("line {line}, column {column}: {name:?} is the second column for {role} (after column {first})")]
    RepeatedColumn {
        /// Line of the header.
        line: u64,
        /// The second column, from 1.
        column: usize,
        /// Its name.
        name: String,
        /// What both are.
        role: &'static str,
        /// The first column, from 1.
        first: usize,
    },
    /// More columns than any record has.
    #[error("line {line}: {columns} columns, at most {MAX_COLUMNS} are read")]
    TooManyColumns {
        /// Line of the header.
        line: u64,
        /// Columns found.
        columns: usize,
    },
    /// A line has more cells than the header.
    #[error(
        "line {line}: {got} cells where the header has {want}; decimal commas need semicolons between cells"
    )]
    TooManyCells {
        /// The line.
        line: u64,
        /// Its cells.
        got: usize,
        /// The header's cells.
        want: usize,
    },
    /// A time cell cannot be read.
    #[error(
        "line {line}, column {column} ({name}): {cell:?} is no time; \
         seconds, RFC 3339 or YYYY-MM-DD hh:mm:ss are read"
    )]
    BadTime {
        /// The line.
        line: u64,
        /// The column, from 1.
        column: usize,
        /// The column's name.
        name: String,
        /// The cell.
        cell: String,
    },
    /// A column of a role holds no number.
    #[error("line {line}, column {column} ({name}): no number in the whole column, it begins with {cell:?}")]
    NoNumber {
        /// The line of the first cell that is no number, or the header's.
        line: u64,
        /// The column, from 1.
        column: usize,
        /// The column's name.
        name: String,
        /// The first cell; blank when all are.
        cell: String,
    },
    /// A header and nothing below it.
    #[error("line {line}: no samples below the header")]
    NoRows {
        /// Line of the header.
        line: u64,
    },
    /// A line without end.
    #[error("line {line}: longer than {MAX_LINE} bytes; a quote left open, or no CSV")]
    LineTooLong {
        /// Where it begins.
        line: u64,
    },
    /// More values than fit the memory bound.
    #[error("line {line}: more than {MAX_VALUES} values; cut the record into shorter files")]
    TooManyValues {
        /// The line at which the bound was passed.
        line: u64,
    },
}

/// Reads one loop's record.
///
/// Time and memory are linear in the number of values, which [`MAX_VALUES`] bounds; nothing is allocated per row.
///
/// # Errors
/// [`CsvError`] for what is no record of `t`, `op` and `pv`. Unordered or repeated times and bad value cells are none.
pub fn read(reader: impl Read) -> Result<Record, CsvError> {
    let (head, reader) = header::sniff(reader)?;
    let cells = Cells { decimal_comma: head.delimiter != b',' };
    let mut rows = csv::ReaderBuilder::new()
        .delimiter(head.delimiter)
        .has_headers(false)
        .flexible(true)
        .buffer_capacity(BUFFER)
        .from_reader(Guard::new(reader));
    let mut row = csv::ByteRecord::new();
    while next(&mut rows, &mut row)? && row.iter().all(cell::is_blank) {}
    let header = Header::new(&row, head.line, &cells)?;
    let mut columns: Vec<Taken> = header.columns.iter().map(|_| Taken::default()).collect();
    let mut values = 0;
    let mut any_row = false;
    while next(&mut rows, &mut row)? {
        // The guard ends every line with a newline, so the reader now stands on the line after this one.
        let line = || rows.position().line().saturating_sub(1);
        if row.len() > columns.len() && row.iter().skip(columns.len()).any(|cell| !cell::is_blank(cell)) {
            let (got, want) = (row.len(), columns.len());
            return Err(CsvError::TooManyCells { line: line(), got, want });
        }
        if row.iter().all(cell::is_blank) {
            continue;
        }
        any_row = true;
        let time_cell = row.get(header.time).unwrap_or_default();
        let t = cells.time(time_cell).ok_or_else(|| CsvError::BadTime {
            line: line(),
            column: header.time + 1,
            name: header.columns[header.time].name.clone(),
            cell: cell::shown(time_cell),
        })?;
        for ((cell, column), taken) in row.iter().zip(&header.columns).zip(&mut columns) {
            let Some(role) = column.role else { continue };
            if cell::is_blank(cell) {
                continue;
            }
            values += 1;
            taken.push(t, cells.value(cell, role), cell, line);
        }
        if values > MAX_VALUES {
            return Err(CsvError::TooManyValues { line: line() });
        }
    }
    if !any_row {
        return Err(CsvError::NoRows { line: head.line });
    }
    assemble(&header, head.line, columns)
}

/// Reads the next line; `false` at the end.
fn next<R: Read>(rows: &mut csv::Reader<Guard<R>>, row: &mut csv::ByteRecord) -> Result<bool, CsvError> {
    rows.get_mut().since_line = 0;
    let line = rows.position().line();
    match rows.read_byte_record(row) {
        Ok(more) => Ok(more),
        Err(_) if rows.get_ref().tripped => Err(CsvError::LineTooLong { line }),
        Err(error) => Err(CsvError::Io(match error.into_kind() {
            csv::ErrorKind::Io(error) => error,
            other => io::Error::other(format!("{other:?}")),
        })),
    }
}

/// What one column gave so far.
#[derive(Default)]
struct Taken {
    series: Series,
    numbers: usize,
    /// Line and text of the first cell that was no number.
    first_bad: Option<(u64, String)>,
}

impl Taken {
    fn push(&mut self, t: f64, value: Option<f64>, cell: &[u8], line: impl Fn() -> u64) {
        let (value, quality) = match value {
            Some(value) => {
                self.numbers += 1;
                (value, Quality::Good)
            }
            None => {
                self.first_bad.get_or_insert_with(|| (line(), cell::shown(cell)));
                (f64::NAN, Quality::Bad(BadReason::NotANumber))
            }
        };
        self.series.push(Sample { t, value, quality });
    }
}

/// The columns as a record; a role without a single number is refused.
fn assemble(header: &Header, line: u64, taken: Vec<Taken>) -> Result<Record, CsvError> {
    let mut record = Record::default();
    for (at, (column, taken)) in header.columns.iter().zip(taken).enumerate() {
        let Some(role) = column.role else { continue };
        let needed = matches!(role, Column::Role(Role::Op | Role::Pv));
        let text_only = taken.numbers == 0 && !taken.series.is_empty();
        if matches!(role, Column::Role(_)) && (text_only || (needed && taken.series.is_empty())) {
            let (line, cell) = taken.first_bad.unwrap_or((line, String::new()));
            return Err(CsvError::NoNumber { line, column: at + 1, name: column.name.clone(), cell });
        }
        // A tag of text only (an operator's remark) or a column that is blank throughout was not recorded.
        if taken.numbers == 0 {
            continue;
        }
        match role {
            Column::Role(Role::Op) => {
                record.op = taken.series;
                record.op_span = column.per_cent.then_some(100.0);
            }
            Column::Role(Role::Pv) => record.pv = taken.series,
            Column::Role(Role::Sp) => record.sp = Some(taken.series),
            Column::Role(Role::Mode) => record.mode = Some(taken.series),
            Column::Role(Role::Mv) => record.mv = Some(taken.series),
            Column::Tag => record.tags.push((column.name.clone(), taken.series)),
        }
    }
    Ok(record)
}

/// Refuses to hand out more than [`MAX_LINE`] bytes (and one buffer) for a single line, and makes every line end
/// in one newline: `csv` counts lines right only then.
struct Guard<R> {
    inner: R,
    since_line: usize,
    tripped: bool,
    ended: bool,
}

impl<R> Guard<R> {
    fn new(inner: R) -> Self {
        Self { inner, since_line: 0, tripped: false, ended: true }
    }
}

impl<R: Read> Read for Guard<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.since_line > MAX_LINE {
            self.tripped = true;
            return Err(io::Error::other("line too long"));
        }
        let mut n = self.inner.read(buffer)?;
        if n == 0 && !self.ended && !buffer.is_empty() {
            buffer[0] = b'\n';
            n = 1;
        }
        let read = &mut buffer[..n];
        for byte in read.iter_mut() {
            if *byte == b'\r' {
                *byte = b' ';
            }
        }
        self.ended = read.last().is_none_or(|&byte| byte == b'\n');
        self.since_line += n;
        Ok(n)
    }
}

#[cfg(test)]
mod tests;
