//! Rows of text whose cells a sign divides.

use super::blanks::Blanks;
use super::error::TableError;
use super::source::{Cell, Rows, is_nothing};
use super::text::{Encoding, MAX_LINE, Text};
use std::io::{self, Read};

/// Bytes read at a time.
const BUFFER: usize = 1 << 18;

/// The rows of a text.
pub struct Lines<R> {
    rows: csv::Reader<Text<R>>,
    row: csv::StringRecord,
    separator: char,
}

impl<R: Read> Lines<R> {
    pub fn new(inner: R, encoding: &Encoding, separator: u8) -> Self {
        let rows = csv::ReaderBuilder::new()
            .delimiter(separator)
            .has_headers(false)
            .flexible(true)
            .buffer_capacity(BUFFER)
            .from_reader(Text::new(inner, encoding, Blanks::of(separator)));
        Self { rows, row: csv::StringRecord::new(), separator: char::from(separator) }
    }
}

/// Refuses a cell that goes on over whole rows: its quote was never closed. A remark of several lines is none.
fn swallowed(row: &csv::StringRecord, separator: char, begins: u64, ends: u64) -> Result<(), TableError> {
    for cell in row {
        let (mut whole, mut half) = (0, 0);
        for line in cell.lines().skip(1) {
            let signs = line.matches(separator).count();
            whole += usize::from(signs >= 2 && signs + 1 >= row.len());
            half += usize::from(signs >= 2 && 2 * signs + 1 >= row.len());
        }
        if whole > 0 || half > 1 {
            return Err(TableError::refused(format!(
                "line {begins}: a quote opens a cell that goes on over whole rows up to line {ends}; close it, or take it off"
            )));
        }
    }
    Ok(())
}

impl<R: Read> Rows for Lines<R> {
    fn next(&mut self) -> Result<Option<u64>, TableError> {
        loop {
            self.rows.get_mut().line_begins();
            let begins = self.rows.position().line();
            match self.rows.read_record(&mut self.row) {
                Ok(false) => return Ok(None),
                Ok(true) if self.row.iter().all(is_nothing) => {}
                // The text ends every line in one newline, so the reader now stands on the line after this one.
                Ok(true) => {
                    let ends = self.rows.position().line().saturating_sub(1);
                    if ends > begins {
                        swallowed(&self.row, self.separator, begins, ends)?;
                    }
                    return Ok(Some(ends));
                }
                Err(_) if self.rows.get_ref().tripped => {
                    return Err(TableError::refused(format!(
                        "line {begins}: longer than {MAX_LINE} bytes; a quote left open, or no CSV"
                    )));
                }
                Err(error) => {
                    return Err(match error.into_kind() {
                        csv::ErrorKind::Io(error) => TableError::Io(error),
                        other => TableError::Io(io::Error::other(format!("{other:?}"))),
                    });
                }
            }
        }
    }

    fn len(&self) -> usize {
        self.row.len()
    }

    fn cell(&self, at: usize) -> Cell<'_> {
        self.row.get(at).map_or(Cell::Blank, Cell::of_text)
    }
}
