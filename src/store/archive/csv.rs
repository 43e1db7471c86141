//! Tables as CSV.

use super::{ArchiveError, Cell, Column, Sink};
use std::borrow::Cow;
use std::io;

/// What a spreadsheet takes for the beginning of a formula; full width and small forms of a sign count as the sign to some.
const FORMULA: [char; 16] =
    ['=', '+', '-', '@', '\t', '\r', '\n', '＝', '＋', '－', '＠', '﹦', '﹢', '﹣', '﹫', '−'];

/// What may stand before it and is not seen, or is taken away.
const HIDDEN: [char; 6] = ['\'', ' ', '\u{a0}', '\u{3000}', '\u{200b}', '\u{feff}'];

/// Whether a spreadsheet would compute this text, were it not for the quotes before it.
fn is_formula(text: &str) -> bool {
    text.trim_start_matches(HIDDEN).starts_with(FORMULA)
}

/// Text that a spreadsheet shows as it is: a name from the plant is no formula.
fn shown(text: &str) -> Cow<'_, str> {
    if is_formula(text) { format!("'{text}").into() } else { text.into() }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_cell_is_a_formula() {
        for name in [
            "FIC101",
            "=1+2",
            "-x",
            "@SUM(A1)",
            "+1",
            "\t=1",
            "'=1",
            "''=1",
            "'quoted'",
            "",
            "'",
            "＝1+2",
            "＋1",
            "－1",
            "＠x",
            "﹦1",
            "−1",
            " =1",
            "\u{feff}＝1",
            "\n=1",
        ] {
            let cell = shown(name);
            assert!(!is_formula(&cell) || cell.starts_with('\''), "{name:?} is written as {cell:?}");
            assert!(
                !cell.trim_start_matches([' ', '\u{feff}']).starts_with(FORMULA),
                "{name:?} is written as {cell:?}"
            );
        }
        assert_eq!((shown("FIC101").as_ref(), shown("=1").as_ref()), ("FIC101", "'=1"));
    }
}
