//! A sheet that is filled cell by cell, while its memory is counted.

use super::limits::{GROWTH_FACTOR, MemoryEstimate, allocation_size};
use super::{Held, MAX_COLUMNS, Row, Sheet};
use crate::signal::Sample;
use crate::table::error::TableError;
use crate::table::layout::LOOKED_AT;

/// Bytes of a cell.
const CELL_SIZE: u64 = size_of::<Held>() as u64;
/// Bytes of a row, without its cells, in a list that grows.
const ROW_SIZE: u64 = GROWTH_FACTOR * size_of::<Row>() as u64;
/// Bytes that a cell takes later, when the record is made: a sample in a series that grows. A cell of the first rows, which are
/// looked at for the header, takes no more.
const SAMPLE_SIZE: u64 = GROWTH_FACTOR * size_of::<Sample>() as u64;
/// Bytes of the two reference counts of a text, which is an `Arc<str>`.
const REFERENCE_COUNTS_SIZE: u64 = 2 * size_of::<usize>() as u64;
/// Absolute values of numbers that take few digits as text; what is there for a cell has room for them.
const SHORT_NUMBERS: std::ops::Range<f64> = 1e-5..1e16;
/// Most bytes of any other number as text: the smallest has more than 300 zeros.
const LONG_NUMBER_LEN: u64 = 400;

/// A sheet that is being filled.
pub struct Filling<'f> {
    rows: Vec<Row>,
    name: &'f str,
    memory: &'f mut MemoryEstimate,
}

impl<'f> Filling<'f> {
    pub fn new(name: &'f str, memory: &'f mut MemoryEstimate) -> Self {
        Self { rows: Vec::new(), name, memory }
    }

    /// Adds a cell, by its row and column from 0. Blank cells before it in its row take memory as well.
    ///
    /// # Errors
    /// A workbook that would take too much memory.
    pub fn put(&mut self, (row, column): (u32, u32), held: Held) -> Result<(), TableError> {
        if matches!(held, Held::Blank) || column >= MAX_COLUMNS {
            return Ok(());
        }
        let (line, at) = (u64::from(row) + 1, column as usize);
        let is_new = self.rows.last().is_none_or(|(last, _)| *last != line);
        // In the first rows, which are looked at for the header, blank cells take memory later; below, they make no sample.
        let is_looked_at = self.rows.len() + usize::from(is_new) <= LOOKED_AT;
        let (made_of_room, made_of_cell) = if is_looked_at { (SAMPLE_SIZE, 0) } else { (0, SAMPLE_SIZE) };
        if is_new {
            // Most rows are as long as the one before.
            let len = self.rows.last().map_or(0, |(_, cells)| cells.len()).max(at + 1);
            let cells = Vec::with_capacity(len);
            let room = cells.capacity() as u64;
            self.memory.add_sheet_memory(ROW_SIZE + CELL_SIZE * room);
            self.memory.add_record_memory(made_of_room * room);
            self.rows.push((line, cells));
        }
        let Some((_, cells)) = self.rows.last_mut() else { return Ok(()) };
        let room = cells.capacity();
        cells.resize(cells.len().max(at + 1), Held::Blank);
        let more = (cells.capacity() - room) as u64;
        let (text, shown) = match &held {
            Held::Text(text) => {
                let len = text.len() as u64;
                (allocation_size(REFERENCE_COUNTS_SIZE + len), len)
            }
            Held::Number(value) if *value != 0.0 && !SHORT_NUMBERS.contains(&value.abs()) => {
                (0, LONG_NUMBER_LEN)
            }
            _ => (0, 0),
        };
        cells[at] = held;
        self.memory.add_sheet_memory(CELL_SIZE * more + text);
        self.memory.add_record_memory(made_of_room * more + made_of_cell + shown);
        let Some(over) = self.memory.over_limit() else { return Ok(()) };
        let name = self.name;
        Err(TableError::refused(format!(
            "sheet {name:?}: the workbook {over}, up to here; say which sheet with --sheet, or save the columns that are needed as CSV"
        )))
    }

    pub fn end(self, one_of_many: bool) -> Sheet {
        Sheet { name: self.name.to_string(), one_of_many, since_1904: false, rows: self.rows }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fills a sheet up to the first cell that is one too many, each in a row of its own; cells that there was room for.
    fn filled(memory: &mut MemoryEstimate, column: u32, held: &Held) -> (u32, String) {
        let mut sheet = Filling::new("S", memory);
        let put = (0..1_000_000).find_map(|row| Some((row, sheet.put((row, column), held.clone()).err()?)));
        let (count, error) = put.expect("there is an end");
        (count, error.to_string())
    }

    #[test]
    fn the_sheets_of_a_workbook_share_its_memory() {
        // Cells of a row before one in the last column are blank: each of the first rows takes 4096 cells of 24 + 72 bytes.
        let mut memory = MemoryEstimate::of_file(0);
        let mut first = Filling::new("first", &mut memory);
        (0..30).try_for_each(|row| first.put((row, MAX_COLUMNS - 1), Held::Number(1.0))).expect("12 MB");
        first.put((30, MAX_COLUMNS), Held::Number(3.0)).expect("no column that is read");
        first.put((30, 0), Held::Blank).expect("nothing");
        assert_eq!(first.end(true).rows.len(), 30);
        let mut second = Filling::new("second", &mut memory);
        let said = (0..30).find_map(|row| second.put((row, MAX_COLUMNS - 1), Held::Number(1.0)).err());
        let said = said.expect("there is no room").to_string();
        assert!(
            said.starts_with("sheet \"second\": the workbook would take ") && said.contains("--sheet"),
            "{said}"
        );
    }

    #[test]
    fn a_cell_takes_what_is_kept_of_it_and_what_is_made_of_it() {
        let count = |held: &Held| filled(&mut MemoryEstimate::of_file(0), 0, held).0;
        // 24 and 96 bytes for the cell and its row, and 72 for the sample: 192 in all.
        assert!((83_000..84_000).contains(&count(&Held::Number(50.5))));
        assert!(count(&Held::Number(0.0)) > 83_000);
        // Of the blank cells before it nothing is made but in the 400 first rows: 648 bytes, and 19 times 72 more in those.
        let (far, _) = filled(&mut MemoryEstimate::of_file(0), 19, &Held::Number(50.5));
        assert!((23_000..24_000).contains(&far));
        // A text is there once more when it is looked at, and a number may be written with hundreds of digits.
        let text = Held::Text("x".repeat(100_000).into());
        assert!((79..81).contains(&count(&text)));
        assert!((26_000..28_000).contains(&count(&Held::Number(1e-300))));
    }

    #[test]
    fn what_the_library_holds_counts_with_the_sheet() {
        let mut memory = MemoryEstimate::of_file(0);
        memory.add_library_memory(15_000_000);
        let (count, said) = filled(&mut memory, 0, &Held::Number(50.5));
        // 120 bytes are kept of each while the library is there.
        assert!((8_000..8_500).contains(&count), "{count}: {said}");
    }
}
