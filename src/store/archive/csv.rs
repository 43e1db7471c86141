//! Tables as CSV.

use super::{ArchiveError, Cell, Column, Read, Sink};
use std::borrow::Cow;
use std::io;

/// What a spreadsheet takes for the beginning of a formula.
const FORMULA: [char; 6] = ['=', '+', '-', '@', '\t', '\r'];

/// Whether a spreadsheet would compute this text, were it not for the quotes before it.
fn is_formula(text: &str) -> bool {
    text.trim_start_matches('\'').starts_with(FORMULA)
}

/// Text that a spreadsheet shows as it is: a name from the plant is no formula.
fn shown(text: &str) -> Cow<'_, str> {
    if is_formula(text) { format!("'{text}").into() } else { text.into() }
}

/// The text that was written by [`shown`].
fn meant(text: &str) -> &str {
    text.strip_prefix('\'').filter(|rest| is_formula(rest)).unwrap_or(text)
}

/// Longest row that is read (bytes).
const MAX_ROW: usize = 1 << 20;

pub struct Writer<W: io::Write> {
    out: csv::Writer<W>,
}

impl<W: io::Write> Writer<W> {
    pub fn new(out: W, columns: &[Column]) -> Result<Self, ArchiveError> {
        let mut out = csv::Writer::from_writer(out);
        out.write_record(columns.iter().map(|(name, _)| name)).map_err(failed)?;
        Ok(Self { out })
    }
}

impl<W: io::Write> Sink for Writer<W> {
    fn row(&mut self, cells: &[Cell]) -> Result<(), ArchiveError> {
        for cell in cells {
            match cell {
                Cell::Text(text) => self.out.write_field(shown(text).as_bytes()),
                // The shortest text that reads back as the same number.
                Cell::Number(value) => self.out.write_field(value.to_string()),
                Cell::Nothing => self.out.write_field(""),
            }
            .map_err(failed)?;
        }
        self.out.write_record(None::<&[u8]>).map_err(failed)
    }

    fn finish(mut self: Box<Self>) -> Result<(), ArchiveError> {
        Ok(self.out.flush()?)
    }
}

fn failed(error: csv::Error) -> ArchiveError {
    let text = error.to_string();
    match error.into_kind() {
        csv::ErrorKind::Io(error) => ArchiveError::Io(error),
        _ => ArchiveError::Format(text),
    }
}

/// Reads rows; the row's number counts from 1, the header not counted.
pub fn read(
    from: impl io::Read,
    take: &mut dyn FnMut(u64, &Read<'_>) -> Result<(), ArchiveError>,
) -> Result<(), ArchiveError> {
    let mut rows = csv::ReaderBuilder::new()
        .flexible(true)
        .has_headers(false)
        .from_reader(Bounded { inner: from, since_row: 0 });
    let mut row = csv::StringRecord::new();
    if !rows.read_record(&mut row).map_err(failed)? {
        return Err(ArchiveError::Format("the file is empty".into()));
    }
    let header: Vec<String> =
        row.iter().map(|name| name.trim_start_matches('\u{feff}').trim().to_lowercase()).collect();
    let place = |name: &str| header.iter().position(|own| own == name);
    let needed = |name: &str| {
        let missing =
            || ArchiveError::Format(format!("no column {name}; the header has {}", header.join(", ")));
        place(name).ok_or_else(missing)
    };
    let (own, tag, t, value) = (needed("loop")?, needed("tag")?, needed("t")?, needed("value")?);
    let (source, unit, quality) = (place("source"), place("unit"), place("quality"));
    let mut at = 0;
    loop {
        rows.get_mut().since_row = 0;
        if !rows.read_record(&mut row).map_err(failed)? {
            return Ok(());
        }
        at += 1;
        let number = |column: usize, name: &str| match row.get(column).map(str::trim).unwrap_or_default() {
            "" => Ok(None),
            text => match text.parse::<f64>() {
                Ok(value) => Ok(Some(value).filter(|value| !value.is_nan())),
                Err(_) => Err(ArchiveError::Format(format!("row {at}: {name} {text:?} is no number"))),
            },
        };
        let text = |column: Option<usize>| row.get(column?).map(meant).filter(|text| !text.is_empty());
        take(
            at,
            &Read {
                control_loop: meant(row.get(own).unwrap_or_default()),
                tag: meant(row.get(tag).unwrap_or_default()),
                source: text(source),
                unit: text(unit),
                t: number(t, "t")?,
                value: number(value, "value")?,
                quality: text(quality),
            },
        )?;
    }
}

/// Ends a row without end before it fills the memory.
struct Bounded<R> {
    inner: R,
    since_row: usize,
}

impl<R: io::Read> io::Read for Bounded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.since_row > MAX_ROW {
            return Err(io::Error::other(format!(
                "a row is longer than {MAX_ROW} bytes: a quote left open?"
            )));
        }
        let read = self.inner.read(buffer)?;
        self.since_row += read;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_cell_is_a_formula_and_every_name_comes_back() {
        for name in ["FIC101", "=1+2", "-x", "@SUM(A1)", "+1", "\t=1", "'=1", "''=1", "'quoted'", "", "'"] {
            let cell = shown(name);
            assert!(!cell.starts_with(FORMULA), "{name:?} is written as {cell:?}");
            assert_eq!(meant(&cell), name);
        }
        assert_eq!((shown("FIC101").as_ref(), shown("=1").as_ref()), ("FIC101", "'=1"));
    }
}
