//! How much memory the library takes for the tables of an OpenDocument spreadsheet. It makes a thousand cells of one that is said to
//! be repeated a thousand times.

use super::limits::{GROWTH_FACTOR, MemoryEstimate, STRING_SIZE, VALUE_SIZE, allocation_size};
use super::tags::{Tag, Tags, attributes, number};
use std::io::{self, BufRead};

/// Rows at which the library stops repeating: a sheet of Excel has no more.
const MAX_ROWS: u64 = 1 << 20;
/// Columns at which the library stops repeating: a sheet of Excel has no more.
const MAX_COLUMNS: u64 = 1 << 14;
/// Bytes that it takes for a cell while it reads the rows: it has a list of values and a list of formulas. Both may have twice the
/// room that they need, and one of them grows.
const WRITTEN_CELL_SIZE: u64 = 2 * VALUE_SIZE + GROWTH_FACTOR * STRING_SIZE;

/// Elements that are cells; one that is covered lies under a merged one.
const CELLS: [&[u8]; 2] = [b"table:table-cell", b"table:covered-table-cell"];

/// What is made of a table.
#[derive(Debug, Default, PartialEq, Eq)]
struct Table {
    /// Cells of its rows as they are written, with blank cells between others.
    written: u64,
    /// Cells of all rows as often as they are repeated, each as wide as the widest.
    cells: u64,
    /// Whether any of its rows is repeated.
    is_repeated: bool,
    /// Whether it has formulas.
    has_formulas: bool,
    /// Bytes of texts and formulas of its rows as they are written.
    text_written: u64,
    /// The same as often as they are repeated.
    text: u64,
}

impl Table {
    fn add_to(&self, memory: &mut MemoryEstimate) {
        let each = VALUE_SIZE + if self.has_formulas { STRING_SIZE } else { 0 };
        let all = self.cells.saturating_mul(each);
        // The library makes room for the rows as they are written. If rows are repeated, the list grows.
        let kept = if self.is_repeated { all.saturating_mul(2) } else { all };
        let growing = if self.is_repeated { all } else { 0 };
        memory.add_library_memory(kept.saturating_add(self.text));
        let written = self.written.saturating_mul(WRITTEN_CELL_SIZE).saturating_add(self.text_written);
        memory.raise_opening_peak(written.saturating_add(growing));
        memory.raise_largest_sheet_copy(self.cells.saturating_mul(VALUE_SIZE).saturating_add(self.text));
    }
}

/// Adds the memory that the library would take for a document, counted high where that is simpler. Returns whether the document ends
/// within a table: the library would then wait for the table's end forever.
///
/// # Errors
/// What the reader said.
pub fn check(tags: &mut Tags<impl BufRead>, memory: &mut MemoryEstimate) -> io::Result<bool> {
    while let Some(tag) = tags.tag()? {
        let Tag::Begin(b"table:table", written) = tag else { continue };
        if attributes(written).any(|(name, _)| name == b"table:name") {
            let Some(table) = table(tags)? else { return Ok(true) };
            table.add_to(memory);
        }
    }
    Ok(false)
}

/// Counts one table: the rows as they are written, and all rows as often as they are repeated, each as wide as the widest. `None` if
/// the document ends before the table does.
fn table(tags: &mut Tags<impl BufRead>) -> io::Result<Option<Table>> {
    let (mut table, mut left, mut rows, mut width) = (Table::default(), MAX_ROWS, 0u64, 0u64);
    let (mut blank, mut is_blank_repeated) = (0u64, false);
    loop {
        let Some(tag) = tags.tag()? else { return Ok(None) };
        let written = match tag {
            Tag::End(b"table:table") => break,
            Tag::Begin(b"table:table-row", written) => written,
            _ => continue,
        };
        let repeats = number(written, "table:number-rows-repeated").min(left);
        left -= repeats;
        let row = row(tags)?;
        table.written = table.written.saturating_add(row.cells);
        table.has_formulas |= row.has_formulas;
        table.text_written = table.text_written.saturating_add(row.text);
        table.text = table.text.saturating_add(row.text.saturating_mul(repeats));
        // Room is made for a row that is repeated no time, too. Blank rows count between others only.
        if row.width == 0 {
            blank += repeats.max(1);
            is_blank_repeated |= repeats > 1;
            continue;
        }
        table.is_repeated |= repeats > 1 || (rows > 0 && is_blank_repeated);
        rows += repeats.max(1) + if rows > 0 { blank } else { 0 };
        (blank, is_blank_repeated, width) = (0, false, width.max(row.width));
    }
    table.cells = rows.saturating_mul(width);
    Ok(Some(table))
}

/// A row as it is written.
#[derive(Default)]
struct Row {
    /// Cells that are made.
    cells: u64,
    /// How far it reaches; 0 where all of it is blank.
    width: u64,
    text: u64,
    has_formulas: bool,
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
        let content = content(tags, name, cell.is_in_content)?;
        let text = cell.text.saturating_add(allocation_size(content));
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
            row.has_formulas |= cell.has_formula;
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
        let text = allocation_size(text) + allocation_size(formula);
        Self { has_value, is_in_content, text, has_formula: formula > 0 }
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

    /// The table of these rows.
    fn table_of(rows: &str) -> Table {
        let text = format!("{rows}</table:table>");
        table(&mut Tags::new(text.as_bytes())).expect("text").expect("it ends")
    }

    /// Its cells as they are written and as they are repeated, and the bytes of its texts.
    fn of(rows: &str) -> (u64, u64, u64) {
        let table = table_of(rows);
        (table.written, table.cells, table.text)
    }

    /// Whether a document is cut, and what the workbook would take.
    fn checked(text: &str) -> (bool, MemoryEstimate) {
        let mut memory = MemoryEstimate::of_file(0);
        (check(&mut Tags::new(text.as_bytes()), &mut memory).expect("text"), memory)
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
        let whole = table_of(&(two.repeat(2) + &rest));
        assert_eq!(whole, Table { written: 4, cells: 4, ..Table::default() });
        assert_eq!(of(&(rest.clone() + &two)), (2, 2, 0), "nor are those above the table");
        assert_eq!(of(""), (0, 0, 0));
    }

    #[test]
    fn what_stands_between_cells_or_is_repeated_is_counted() {
        assert_eq!(of(&row("", &[FLOAT, &blank(8), FLOAT])), (10, 10, 0));
        let wide = FLOAT.replace("table-cell ", "table-cell table:number-columns-repeated=\"99999\" ");
        assert_eq!(of(&row("", &[&wide])), (1 << 14, 1 << 14, 0));
        let far = row("", &[FLOAT])
            + &row(" table:number-rows-repeated=\"1000\"", &[&blank(5)])
            + &row("", &[FLOAT]);
        assert_eq!(table_of(&far), Table { written: 2, cells: 1002, is_repeated: true, ..Table::default() });
        let ragged = row("", &[FLOAT]).repeat(100) + &row("", &[&blank(999), FLOAT]);
        let made = Table { written: 100 + 1000, cells: 101 * 1000, ..Table::default() };
        assert_eq!(table_of(&ragged), made);
        let high = table_of(&row(" table:number-rows-repeated=\"2000000\"", &[FLOAT]));
        assert_eq!(high, Table { written: 1, cells: 1 << 20, is_repeated: true, ..Table::default() });
    }

    #[test]
    fn texts_are_counted_as_often_as_they_are_made() {
        let cell = |attributes: &str, inside: &str| {
            row("", &[&format!("<table:table-cell{attributes}>{inside}</table:table-cell>")])
        };
        assert_eq!(of(&cell("", "<text:p>no value</text:p>")), (0, 0, 0));
        let one = of(&cell(" office:value-type=\"string\"", "<text:p>1234</text:p>"));
        assert!((one.0, one.1) == (1, 1) && (8..100).contains(&one.2), "{one:?}");
        let many = of(&cell(
            " table:number-columns-repeated=\"50\" office:value-type=\"string\"",
            "<text:p>1234</text:p>",
        ));
        assert_eq!(many, (50, 50, 50 * one.2));
        let blanks =
            of(&cell(" office:value-type=\"string\"", "<text:p><text:s text:c=\"2000000000\"/></text:p>"));
        assert!(blanks.2 > 2_000_000_000, "{blanks:?}");
        let told = table_of(&cell(" office:string-value=\"12345\" table:formula=\"of:=1\"", ""));
        let made = Table { written: 1, cells: 1, has_formulas: true, text_written: 32, ..Table::default() };
        assert_eq!(told, Table { text: 32, ..made });
        let formula = "<table:table-cell table:formula=\"of:=1\"/>";
        let thrice = row(" table:number-rows-repeated=\"3\"", &[formula]);
        let made = Table { written: 1, cells: 3, is_repeated: true, has_formulas: true, ..Table::default() };
        assert_eq!(table_of(&thrice), Table { text_written: 16, text: 48, ..made });
    }

    #[test]
    fn a_table_is_counted_while_it_is_read_and_as_it_is_kept() {
        let over = |table: Table| {
            let mut memory = MemoryEstimate::of_file(0);
            table.add_to(&mut memory);
            memory.over_limit().is_some()
        };
        // 168 bytes for a cell of a plain table: 136 in its rows, and 32 as it is kept.
        let plain = |cells: u64| Table { written: cells, cells, ..Table::default() };
        assert!(!over(plain(94_000)) && over(plain(96_000)));
        // 96 for one that is repeated: it is kept with twice the room, and grows or is handed over.
        let repeated = |cells: u64| Table { cells, is_repeated: true, ..Table::default() };
        assert!(!over(repeated(160_000)) && over(repeated(170_000)));
        // 168 where there are formulas.
        let formulas = |cells: u64| Table { has_formulas: true, ..repeated(cells) };
        assert!(!over(formulas(94_000)) && over(formulas(96_000)));
        let text = |text: u64| Table { text, ..Table::default() };
        assert!(!over(text(7_900_000)) && over(text(8_100_000)), "as it is kept, and handed over");
    }

    #[test]
    fn a_note_or_a_table_within_a_cell_does_not_end_it() {
        let note = "<office:annotation></table:table-cell></office:annotation>";
        let text = format!(
            "<table:table-cell office:value-type=\"string\">{note}<text:p>a</text:p></table:table-cell>"
        );
        assert_eq!(of(&row("", &[&text, FLOAT])).1, 2);
        let inner = format!("<table:table-cell office:value=\"1\">{FLOAT}{FLOAT}</table:table-cell>");
        assert_eq!(of(&row("", &[&inner, FLOAT])).1, 2);
    }

    #[test]
    fn a_document_that_ends_within_a_table_is_known() {
        let whole = format!("<table:table table:name=\"S\">{}</table:table>", row("", &[FLOAT]));
        for (cut, is_cut) in [(0, false), (1, true), (20, true), (60, true), (whole.len() - 10, false)] {
            let text = &whole[..whole.len() - cut];
            assert_eq!(checked(text).0, is_cut, "{text}");
        }
    }

    #[test]
    fn tables_with_a_name_count_together() {
        let rows = row(" table:number-rows-repeated=\"90000\"", &[FLOAT]);
        let document = |table: &str| format!("<office:spreadsheet>{}</office:spreadsheet>", table.repeat(3));
        let over = |table: &str| checked(&document(table)).1.over_limit().is_some();
        // One would take 96 bytes for each cell, and three 64 for each and 32 for those of one.
        assert!(over(&format!("<table:table table:name=\"S\">{rows}</table:table>")));
        assert!(!over(&format!("<table:table>{rows}</table:table>")), "the library leaves them out");
    }
}
