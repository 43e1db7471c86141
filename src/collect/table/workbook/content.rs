//! What the library that opens workbooks makes of the tables of an OpenDocument sheet: of a cell that is said to be there a
//! thousand times it makes a thousand.

use super::tags::{Tag, Tags, attributes, number};
use std::io::{self, BufRead};

/// Rows and columns at which the library stops repeating.
const MAX_ROWS: u64 = 1 << 20;
const MAX_COLUMNS: u64 = 1 << 14;
/// Bytes that it takes for a cell: a value, and a formula where there is one.
const CELL: u64 = 64;

const CELLS: [&[u8]; 2] = [b"table:table-cell", b"table:covered-table-cell"];

/// What is made of all tables.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Made {
    /// Cells, with the blank ones between others and those that fill the rows to the width of the table.
    pub cells: u64,
    /// Bytes of texts and formulas.
    pub text: u64,
    /// Whether the document ends within a table. The library would wait for its end without one.
    pub is_cut: bool,
}

impl Made {
    /// Bytes that are taken for it.
    pub fn bytes(&self) -> u64 {
        self.cells.saturating_mul(CELL).saturating_add(self.text)
    }
}

/// Counts what the library would make of a document. It is counted high rather than low where that is simpler.
pub fn made(tags: &mut Tags<impl BufRead>) -> io::Result<Made> {
    let mut made = Made::default();
    while let Some(tag) = tags.tag()? {
        let Tag::Begin(b"table:table", written) = tag else { continue };
        if attributes(written).any(|(name, _)| name == b"table:name") {
            table(tags, &mut made)?;
        }
    }
    Ok(made)
}

/// One table: each row as it is written, and then all of them as often as they are repeated and as wide as the widest.
fn table(tags: &mut Tags<impl BufRead>, made: &mut Made) -> io::Result<()> {
    let (mut left, mut rows, mut blank, mut width) = (MAX_ROWS, 0u64, 0u64, 0u64);
    loop {
        let Some(tag) = tags.tag()? else {
            made.is_cut = true;
            break;
        };
        let written = match tag {
            Tag::End(b"table:table") => break,
            Tag::Begin(b"table:table-row", written) => written,
            _ => continue,
        };
        let repeats = number(written, "table:number-rows-repeated").min(left);
        left -= repeats;
        let row = row(tags)?;
        made.cells = made.cells.saturating_add(row.cells);
        made.text = made.text.saturating_add(row.text.saturating_mul(repeats.saturating_add(1)));
        // Room is made for a row that is repeated no time, too. Blank rows count between others only.
        if row.width == 0 {
            blank += repeats.max(1);
        } else {
            rows += repeats.max(1) + if rows > 0 { blank } else { 0 };
            (blank, width) = (0, width.max(row.width));
        }
    }
    made.cells = made.cells.saturating_add(rows.saturating_mul(width));
    Ok(())
}

/// A row as it is written.
#[derive(Default)]
struct Row {
    /// Cells that are made.
    cells: u64,
    /// How far it reaches; 0 where all of it is blank.
    width: u64,
    text: u64,
}

fn row(tags: &mut Tags<impl BufRead>) -> io::Result<Row> {
    let (mut row, mut blank) = (Row::default(), 0);
    while let Some(tag) = tags.tag()? {
        let (name, written) = match tag {
            Tag::End(b"table:table-row") => break,
            Tag::Begin(name, written) => (name, written),
            Tag::End(_) => continue,
        };
        let Some(name) = CELLS.into_iter().find(|own| *own == name) else { continue };
        let repeats = number(written, "table:number-columns-repeated");
        let cell = Cell::new(written);
        let text = cell.text.saturating_add(content(tags, name, cell.is_in_content)?);
        // Blank cells are made as soon as another one follows, be it blank as well.
        row.cells += blank.min(MAX_COLUMNS - row.cells);
        let repeats = repeats.min(MAX_COLUMNS - row.cells);
        if cell.is_blank() {
            blank = repeats;
            continue;
        }
        (row.cells, blank) = (row.cells + repeats, 0);
        if repeats > 0 {
            row.width = row.cells;
        }
        row.text = row.text.saturating_add(text.saturating_mul(repeats));
    }
    Ok(row)
}

/// A cell by its attributes.
struct Cell {
    has_value: bool,
    /// Whether its value stands in its content, as a text does.
    is_in_content: bool,
    /// Bytes of text and formula among the attributes.
    text: u64,
    has_formula: bool,
}

impl Cell {
    fn new(written: &[u8]) -> Self {
        let (mut has_value, mut is_string, mut is_error, mut is_hollow) = (false, false, false, false);
        let (mut text, mut formula) = (0, 0);
        for (name, value) in attributes(written) {
            match name {
                b"office:value" | b"office:boolean-value" if !has_value => has_value = true,
                b"office:string-value" | b"office:date-value" | b"office:time-value" if !has_value => {
                    has_value = true;
                    is_hollow = name == b"office:string-value" && value.is_empty();
                    text = value.len() as u64;
                }
                b"office:value-type" if !has_value => is_string = value == b"string",
                b"calcext:value-type" => is_error = value == b"error",
                b"table:formula" => formula = value.len() as u64,
                _ => {}
            }
        }
        let is_in_content = !has_value && is_string || is_error && is_hollow;
        Self { has_value, is_in_content, text: text + formula, has_formula: formula > 0 }
    }

    fn is_blank(&self) -> bool {
        !self.has_value && !self.is_in_content && !self.has_formula
    }
}

/// Goes on behind a cell; the bytes of its content where the library makes a text of it.
///
/// A text ends with the next end of any cell that is in no note, another one where as many cells of its name have ended as began.
fn content(tags: &mut Tags<impl BufRead>, name: &[u8], is_text: bool) -> io::Result<u64> {
    let (from, mut depth, mut is_note, mut blanks) = (tags.at, 0u64, false, 0u64);
    while let Some(tag) = tags.tag()? {
        match tag {
            Tag::Begin(own, _) if !is_text => depth += u64::from(own == name),
            Tag::End(own) if !is_text => match depth.checked_sub(u64::from(own == name)) {
                Some(left) => depth = left,
                None => return Ok(0),
            },
            Tag::End(b"office:annotation") => is_note = false,
            _ if is_note => {}
            Tag::Begin(b"office:annotation", _) => is_note = true,
            // So many blanks in a row.
            Tag::Begin(b"text:s", written) => blanks = blanks.saturating_add(number(written, "text:c")),
            Tag::End(own) if CELLS.contains(&own) => break,
            _ => {}
        }
    }
    Ok((tags.at - from).saturating_add(blanks))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLOAT: &str = "<table:table-cell office:value-type=\"float\" office:value=\"1\"><text:p>1</text:p></table:table-cell>";

    fn of(rows: &str) -> Made {
        let text = format!(
            "<office:spreadsheet><table:table table:name=\"S\">{rows}</table:table></office:spreadsheet>"
        );
        made(&mut Tags::new(text.as_bytes())).expect("text")
    }

    /// Rows of cells, each with its attributes.
    fn row(repeats: &str, cells: &[&str]) -> String {
        format!("<table:table-row{repeats}>{}</table:table-row>", cells.concat())
    }

    fn blank(columns: u64) -> String {
        format!("<table:table-cell table:number-columns-repeated=\"{columns}\"/>")
    }

    #[test]
    fn blanks_to_the_end_of_the_sheet_are_no_cells() {
        let two = row("", &[FLOAT, FLOAT, &blank(16_382)]);
        let rest = row(" table:number-rows-repeated=\"1048574\"", &[&blank(16_384)]);
        // Each cell once in its row, and once in the table.
        assert_eq!(of(&(two.repeat(2) + &rest)), Made { cells: 8, text: 0, is_cut: false });
        assert_eq!(of(&(rest.clone() + &two)).cells, 4, "nor are those above the table");
        assert_eq!(of(""), Made::default());
    }

    #[test]
    fn what_stands_between_cells_or_is_repeated_is_counted() {
        assert_eq!(of(&row("", &[FLOAT, &blank(8), FLOAT])).cells, 10 + 10);
        assert_eq!(
            of(&row(
                "",
                &[&FLOAT.replace("table-cell ", "table-cell table:number-columns-repeated=\"99999\" ")]
            ))
            .cells,
            2 << 14
        );
        let far = row("", &[FLOAT])
            + &row(" table:number-rows-repeated=\"1000\"", &[&blank(5)])
            + &row("", &[FLOAT]);
        assert_eq!(of(&far).cells, 2 + 1002);
        let wide = row("", &[FLOAT]).repeat(100) + &row("", &[&blank(999), FLOAT]);
        assert_eq!(of(&wide).cells, 100 + 1000 + 101 * 1000);
        assert_eq!(of(&row(" table:number-rows-repeated=\"2000000\"", &[FLOAT])).cells, 1 + (1 << 20));
        let unread = "<table:table><table:table-row table:number-rows-repeated=\"9\"/></table:table>";
        assert_eq!(made(&mut Tags::new(unread.as_bytes())).expect("text"), Made::default(), "it has no name");
    }

    #[test]
    fn texts_are_counted_as_often_as_they_are_made() {
        let cell = |attributes: &str, inside: &str| {
            row("", &[&format!("<table:table-cell{attributes}>{inside}</table:table-cell>")])
        };
        assert_eq!(of(&cell("", "<text:p>no value</text:p>")).bytes(), 0);
        let one = of(&cell(" office:value-type=\"string\"", "<text:p>1234</text:p>"));
        assert!(one.cells == 2 && (8..100).contains(&one.text), "{one:?}");
        let many = of(&cell(
            " table:number-columns-repeated=\"50\" office:value-type=\"string\"",
            "<text:p>1234</text:p>",
        ));
        assert_eq!((many.cells, many.text), (100, 50 * one.text));
        let blanks =
            of(&cell(" office:value-type=\"string\"", "<text:p><text:s text:c=\"2000000000\"/></text:p>"));
        assert!(blanks.bytes() > 2_000_000_000, "{blanks:?}");
        let told = of(&cell(" office:string-value=\"12345\" table:formula=\"of:=1\"", ""));
        assert_eq!((told.cells, told.text), (2, 2 * 10));
        let formula = of(&cell(" table:formula=\"of:=1\"", ""));
        assert_eq!((formula.cells, formula.text), (2, 2 * 5));
    }

    #[test]
    fn a_note_or_a_table_within_a_cell_does_not_end_it() {
        let note = "<office:annotation></table:table-cell></office:annotation>";
        let text = format!(
            "<table:table-cell office:value-type=\"string\">{note}<text:p>a</text:p></table:table-cell>"
        );
        assert_eq!(of(&row("", &[&text, FLOAT])).cells, 4);
        let inner = format!("<table:table-cell office:value=\"1\">{FLOAT}{FLOAT}</table:table-cell>");
        assert_eq!(of(&row("", &[&inner, FLOAT])).cells, 4);
    }

    #[test]
    fn a_document_that_ends_within_a_table_is_known() {
        let whole = format!("<table:table table:name=\"S\">{}</table:table>", row("", &[FLOAT]));
        for (cut, is_cut) in [(0, false), (1, true), (20, true), (60, true), (whole.len() - 10, false)] {
            let text = &whole[..whole.len() - cut];
            assert_eq!(made(&mut Tags::new(text.as_bytes())).expect("text").is_cut, is_cut, "{text}");
        }
    }
}
