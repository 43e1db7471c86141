//! Looks at the records of an `.xls` before the library opens it. The library makes room for as many cells and for as long texts as
//! it is told of, a cell of every place between the first and the last row and column, a text anew for each cell that shares it,
//! and a text of every formula; and it reads the records of a sheet anew for each name of a sheet that leads to them.

mod records;

use super::fields::{u16_at, u32_at};
use super::limits::{
    ENTRY_SIZE, GROWTH_FACTOR, MemoryEstimate, STRING_SIZE, VALUE_SIZE, allocation_size, shift_limit,
};
use super::shared_texts::texts;
use super::tokens::{Written, written};
use crate::table::error::TableError;
use calamine::{Cell, Data, Dimensions};
use records::{
    BEGIN_OF_PART, CELL_HEAD_LEN, CONTINUED, DIMENSIONS, END_OF_PART, FORMULA, HEAD_LEN, MERGED_CELLS, NAME,
    NAME_LEN_AT, NUMBERS, OTHER_CELLS, OWN_TEXTS, SHARED_TEXT, SHEET, SHEET_NAME_LEN_AT, TEXT_OF_FORMULA,
    TEXTS, TOKENS_LEN_AT, globals, is_encrypted, records, sheets,
};

/// Cells that a sheet may always claim to have, without their being counted: 65,536 rows of twelve columns. Some programs claim as
/// many rows whatever there is. The library reserves 32 MB for them, and writes only to the room of cells that exist.
const UNCOUNTED_CELLS: u64 = 3 << 18;
/// How many times the sheets may read all records together: each record should belong to one sheet.
const MAX_READS: u64 = 8;
/// Most bytes that the library takes for a byte of a text, in any encoding: four of UTF-8, and as many while the text grows.
const OWN_TEXT_FACTOR: u64 = 8;
/// Most bytes for a byte of UTF-8 of a shared text, which is longer in another encoding.
const SHARED_TEXT_FACTOR: u64 = 2;
/// Most bytes for a byte of UTF-8 of a shared text in the library's list, where the text grows.
const LISTED_TEXT_FACTOR: u64 = 4;
/// Most bytes for a character of a name: three of UTF-8, and as many while the name grows.
const NAME_CHARACTER_SIZE: u64 = 6;
/// Bytes that the library takes for a cell in the list of a sheet's cells.
const CELL_SIZE: u64 = size_of::<Cell<Data>>() as u64;
/// Bytes of a formula in the list of a sheet's formulas, without its text.
const FORMULA_SIZE: u64 = size_of::<Cell<String>>() as u64;
/// Bytes of the text that stands for a formula that the library cannot write.
const UNREADABLE_FORMULA_SIZE: u64 = 128;
/// Bytes that the library takes for a range of merged cells.
const MERGED_SIZE: u64 = size_of::<Dimensions>() as u64;
/// Bytes of a range of merged cells in its record.
const MERGED_LEN: usize = 8;
/// Bytes of one number in a record of many, and of the fields around the numbers: row, first and last column.
const NUMBER_LEN: usize = 6;
/// Bytes that the library takes for each byte of the record of a sheet or of a name of cells: three of UTF-8, kept twice, in texts
/// that grow.
const ENTRY_BYTE_FACTOR: u64 = 12;
/// Bytes of an entry in the library's list of records that continue another. It is shifted when the entry before it is removed.
const CONTINUATION_SIZE: u64 = size_of::<&[u8]>() as u64;

/// Adds the memory that a stream of records would take.
///
/// # Errors
/// A stream that would take too much memory or time, or is encrypted.
pub fn check(book: &[u8], memory: &mut MemoryEstimate) -> Result<(), TableError> {
    let Some(wrong) = wrong(book, memory) else { return Ok(()) };
    Err(TableError::refused(format!(
        "a workbook {wrong}; save it again, or the columns that are needed as CSV"
    )))
}

/// What is wrong with the records, if anything. Adds the memory that they take.
fn wrong(book: &[u8], memory: &mut MemoryEstimate) -> Option<String> {
    if is_encrypted(book) {
        return Some("that is encrypted with a password: take it off".to_string());
    }
    let (shared, own) = (Shared::of(book), memory.file_bytes());
    if shared.shifted > shift_limit(own) {
        return Some(format!(
            "whose shared texts are cut into {} parts, more than any program writes",
            shared.parts
        ));
    }
    memory.add_library_memory(shared.listed());
    memory.raise_opening_peak(shared.taken);
    if let Some(over) = memory.over_limit() {
        return Some(format!("that {over}, for its shared texts and names"));
    }
    wrong_sheet(book, &shared, memory)
}

/// What is wrong with a sheet, if anything. Adds the memory that the sheets take.
fn wrong_sheet(book: &[u8], shared: &Shared, memory: &mut MemoryEstimate) -> Option<String> {
    let own = memory.file_bytes();
    let cell_limit = UNCOUNTED_CELLS.max(own);
    let (mut shifted, mut record_bytes) = (shared.shifted, 0u64);
    for (at, name) in sheets(book) {
        let reach = Reach::of(book.get(at..).unwrap_or_default(), shared);
        shifted = shifted.saturating_add(reach.made.shifted);
        record_bytes += reach.record_bytes;
        if reach.told > cell_limit {
            let told = reach.told;
            return Some(format!(
                "whose sheet {name:?} says it has {told} cells: {cell_limit} are taken of {own} bytes"
            ));
        }
        memory.add_library_memory(reach.kept());
        memory.raise_opening_peak(shared.taken.saturating_add(reach.listed()));
        memory.raise_largest_sheet_copy(reach.copied());
        if let Some(over) = memory.over_limit() {
            return Some(format!(
                "that {over}, up to its sheet {name:?}, which reaches over {} cells and has texts and formulas of {} bytes: delete \
                 cells far from the others",
                reach.cells(),
                reach.texts()
            ));
        }
        if shifted > shift_limit(own) {
            return Some(format!("whose sheet {name:?} has formulas that would take minutes"));
        }
        if record_bytes > MAX_READS * book.len() as u64 {
            return Some(format!("whose sheet {name:?} shares its cells with others"));
        }
    }
    None
}

/// What all sheets share.
#[derive(Debug, Default)]
struct Shared {
    /// Bytes of each text that cells name by its number.
    texts: Vec<u32>,
    /// Bytes that the library takes while it opens the workbook, for its lists of these texts and of records that continue others.
    taken: u64,
    /// Bytes of the longest name of a sheet or of cells.
    longest_name: u64,
    /// How many sheets and names of cells there are.
    entries: u64,
    /// Bytes of the records of these.
    entry_bytes: u64,
    /// Parts that the texts are cut into.
    parts: usize,
    /// Bytes that are shifted to put the texts together.
    shifted: u64,
}

impl Shared {
    fn of(book: &[u8]) -> Self {
        let mut shared = Self::default();
        let mut records = globals(book).peekable();
        while let Some((kind, data)) = records.next() {
            let len_at = match kind {
                SHEET => SHEET_NAME_LEN_AT,
                NAME => NAME_LEN_AT,
                TEXTS => {
                    let mut parts = vec![data];
                    while let Some((_, more)) = records.next_if(|(kind, _)| *kind == CONTINUED) {
                        parts.push(more);
                    }
                    shared.take(&parts);
                    continue;
                }
                CONTINUED => {
                    shared.taken += GROWTH_FACTOR * CONTINUATION_SIZE;
                    continue;
                }
                _ => continue,
            };
            let characters = data.get(len_at).map_or(0, |len| u64::from(*len));
            shared.longest_name = shared.longest_name.max(NAME_CHARACTER_SIZE * characters);
            shared.entries += 1;
            shared.entry_bytes += data.len() as u64;
        }
        shared
    }

    /// The library takes the last list of texts, and looks at each.
    fn take(&mut self, parts: &[&[u8]]) {
        let count = parts.len() as u64;
        // Of `count` parts each but the first is shifted when one before it is removed: half the square of them in all.
        self.shifted = self.shifted.saturating_add(count.saturating_mul(count) / 2 * CONTINUATION_SIZE);
        self.parts = self.parts.max(parts.len());
        self.texts = texts(parts);
        let each = |bytes: &u32| {
            GROWTH_FACTOR * STRING_SIZE + allocation_size(LISTED_TEXT_FACTOR * u64::from(*bytes))
        };
        self.taken += self.texts.iter().map(each).sum::<u64>() + GROWTH_FACTOR * CONTINUATION_SIZE * count;
    }

    /// Bytes that the library takes for sheets and names of cells. A name may stand for cells of the sheet with the longest name.
    fn listed(&self) -> u64 {
        let each = ENTRY_SIZE + allocation_size(self.longest_name);
        self.entries.saturating_mul(each).saturating_add(ENTRY_BYTE_FACTOR * self.entry_bytes)
    }

    /// Bytes of the text with a number.
    fn bytes(&self, number: Option<u32>) -> u64 {
        number.and_then(|number| self.texts.get(number as usize)).map_or(0, |bytes| u64::from(*bytes))
    }
}

/// How far a sheet reaches: rows and columns, from the first to the last; and what it makes the library take.
#[derive(Debug, Default, PartialEq, Eq)]
struct Reach {
    rows: Option<(u16, u16)>,
    columns: Option<(u16, u16)>,
    /// How many cells it claims to have.
    told: u64,
    /// How many records of cells it has.
    count: u64,
    /// How many formulas of cells it has.
    formulas: u64,
    /// How many ranges of merged cells it has.
    merged: u64,
    /// How many records continue others.
    continued: u64,
    /// Bytes of the texts of its cells.
    text: u64,
    /// Texts of its formulas.
    made: Written,
    /// Bytes of its records.
    record_bytes: u64,
}

impl Reach {
    /// Of the sheet that begins with a stream.
    fn of(stream: &[u8], shared: &Shared) -> Self {
        let mut reach = Self::default();
        let (mut has_begun, mut within, mut formula) = (false, 0u64, Some((0, 0)));
        for (kind, data) in records(stream) {
            reach.record_bytes += (HEAD_LEN + data.len()) as u64;
            reach.continued += u64::from(kind == CONTINUED);
            let place = || u16_at(data, 0).zip(u16_at(data, 2));
            match kind {
                // A chart within a sheet has cells of its own.
                BEGIN_OF_PART if has_begun => within += 1,
                BEGIN_OF_PART => has_begun = true,
                END_OF_PART if within > 0 => within -= 1,
                END_OF_PART => break,
                _ if within > 0 => {}
                DIMENSIONS => reach.told = reach.told.saturating_add(told(data).unwrap_or(0)),
                MERGED_CELLS => reach.merged += (data.len() / MERGED_LEN) as u64,
                FORMULA => {
                    formula = place().or(formula);
                    reach.take(formula, 1);
                    reach.formulas += 1;
                    reach.made = reach.made.and(of_formula(data, shared.longest_name));
                }
                TEXT_OF_FORMULA => {
                    reach.take(formula, 1);
                    reach.text(room(data));
                }
                NUMBERS => {
                    let last = u16_at(data, data.len().saturating_sub(2));
                    reach.take(place(), (data.len().saturating_sub(NUMBER_LEN) / NUMBER_LEN) as u64);
                    reach.take(u16_at(data, 0).zip(last), 0);
                }
                SHARED_TEXT => {
                    reach.take(place(), 1);
                    reach.text(SHARED_TEXT_FACTOR * shared.bytes(u32_at(data, CELL_HEAD_LEN)));
                }
                _ if OWN_TEXTS.contains(&kind) => {
                    reach.take(place(), 1);
                    reach.text(room(data.get(CELL_HEAD_LEN..).unwrap_or_default()));
                }
                _ if OTHER_CELLS.contains(&kind) => reach.take(place(), 1),
                _ => {}
            }
        }
        reach
    }

    /// Counts cells, one of which is at `place`.
    fn take(&mut self, place: Option<(u16, u16)>, count: u64) {
        let Some((row, column)) = place else { return };
        let wider = |from_to: Option<(u16, u16)>, at: u16| {
            let (from, to) = from_to.unwrap_or((at, at));
            Some((from.min(at), to.max(at)))
        };
        (self.rows, self.columns) = (wider(self.rows, row), wider(self.columns, column));
        self.count += count;
    }

    fn text(&mut self, bytes: u64) {
        self.text = self.text.saturating_add(allocation_size(bytes));
    }

    /// Cells from the first to the last row and column.
    fn cells(&self) -> u64 {
        let count = |from_to: Option<(u16, u16)>| from_to.map_or(0, |(from, to)| u64::from(to - from) + 1);
        count(self.rows) * count(self.columns)
    }

    /// Bytes of its texts and formulas. The text of a formula grows while the library writes it.
    fn texts(&self) -> u64 {
        let unreadable = self.formulas * UNREADABLE_FORMULA_SIZE;
        let formulas = self.made.text.saturating_mul(2).saturating_add(unreadable);
        self.text.saturating_add(formulas)
    }

    /// Bytes that the library keeps of it.
    fn kept(&self) -> u64 {
        let each = VALUE_SIZE + if self.formulas > 0 { STRING_SIZE } else { 0 };
        let merged = GROWTH_FACTOR * MERGED_SIZE * self.merged;
        self.cells().saturating_mul(each).saturating_add(self.texts()).saturating_add(merged)
    }

    /// Bytes that the library takes for the lists of its cells and formulas while it opens the workbook: room for the cells that the
    /// sheet claims to have, and lists that grow.
    fn listed(&self) -> u64 {
        let lists =
            CELL_SIZE * self.count + FORMULA_SIZE * self.formulas + CONTINUATION_SIZE * self.continued;
        let told = self.told.saturating_sub(UNCOUNTED_CELLS).saturating_mul(CELL_SIZE);
        told.saturating_add(GROWTH_FACTOR * lists)
    }

    /// Bytes of the copy of its cells that the library hands to us.
    fn copied(&self) -> u64 {
        self.cells().saturating_mul(VALUE_SIZE).saturating_add(self.text)
    }
}

/// The bytes that the library makes room for, for the text of a cell: as many as it says it is long, be it shorter or not.
fn room(text: &[u8]) -> u64 {
    u16_at(text, 0).map_or(0, u64::from).max(OWN_TEXT_FACTOR * text.len() as u64)
}

/// What is made of the tokens of a formula.
fn of_formula(data: &[u8], longest_name: u64) -> Written {
    let len = u16_at(data, TOKENS_LEN_AT).map_or(0, usize::from);
    let tokens = data.get(TOKENS_LEN_AT + 2..).unwrap_or_default();
    written(&tokens[..tokens.len().min(len)], longest_name)
}

/// The cells that a sheet says it has, as the library reads it.
fn told(data: &[u8]) -> Option<u64> {
    let short = |at: usize| u16_at(data, at).map(u32::from);
    let (from, to, left, right) = match data.len() {
        // Excel 5 has no more than 65,535 rows.
        10 => (short(0)?, short(2)?, short(4)?, short(6)?),
        14 | 16 => (u32_at(data, 0)?, u32_at(data, 4)?, short(8)?, short(10)?),
        _ => return None,
    };
    let left = if left > 0xff || right < left { 0 } else { left };
    let (rows, columns) = if to > 0 && right > 0 { (to.wrapping_sub(from), right - left) } else { (1, 1) };
    Some(u64::from(rows) * u64::from(columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(kind: u16, data: &[u16]) -> Vec<u8> {
        let data: Vec<u8> = data.iter().flat_map(|word| word.to_le_bytes()).collect();
        [&kind.to_le_bytes()[..], &(data.len() as u16).to_le_bytes()[..], &data[..]].concat()
    }

    fn number(row: u16, column: u16) -> Vec<u8> {
        record(0x0203, &[row, column, 0, 0, 0, 0, 0x4049])
    }

    fn reach(stream: &[u8]) -> Reach {
        Reach::of(stream, &Shared { texts: vec![5, 70_000], longest_name: 60, ..Shared::default() })
    }

    #[test]
    fn a_sheet_reaches_from_its_first_to_its_last_cell() {
        let begin = record(BEGIN_OF_PART, &[0x0600, 0x10]);
        let chart = [begin.clone(), number(9000, 200), record(END_OF_PART, &[])].concat();
        let own = [number(2, 1), number(4, 3), chart, record(NUMBERS, &[5, 2, 0, 0, 0, 0, 0, 0, 3])].concat();
        let after = [record(END_OF_PART, &[]), number(60_000, 255)].concat();
        let whole = reach(&[begin.clone(), own.clone(), after].concat());
        assert_eq!((whole.rows, whole.columns, whole.told), (Some((2, 5)), Some((1, 3)), 0));
        assert_eq!((whole.cells(), whole.count), (4 * 3, 2 + 2));
        assert_eq!(whole.record_bytes, (begin.len() + own.len() + 4) as u64, "no record behind its end");
        let text = [record(FORMULA, &[7, 8]), record(TEXT_OF_FORMULA, &[0])].concat();
        assert_eq!(reach(&text).cells(), 1);
        assert_eq!(reach(&begin).cells(), 0);
        assert_eq!(reach(&number(1, 1)[..9]), Reach::default(), "a record that is cut");
    }

    #[test]
    fn what_a_sheet_says_of_its_size_is_read_as_the_library_reads_it() {
        let cells = |data: &[u16]| reach(&record(DIMENSIONS, data)).told;
        assert_eq!(cells(&[0, 0, 1200, 0, 0, 4, 0]), 4800);
        assert_eq!(cells(&[3, 0, 1200, 0, 300, 4, 0]), 1197 * 4, "a first column that cannot be is 0");
        assert_eq!(cells(&[0, 1200, 0, 4, 0]), 4800, "as Excel 5 writes it");
        assert_eq!(cells(&[0, 0, 0, 0, 0, 0, 0]), 1);
        assert_eq!(cells(&[0, 0, 0, 0x8000, 0, 256, 0]), 0x8000_0000 * 256);
        assert_eq!(cells(&[9, 0, 1, 0, 0, 1, 0]), 0xffff_fff8, "from a row behind its last");
        assert_eq!(cells(&[1, 2]), 0);
        assert_eq!(
            reach(&record(DIMENSIONS, &[0, 1200, 0, 4, 0]).repeat(3)).told,
            3 * 4800,
            "each makes room"
        );
    }

    #[test]
    fn texts_are_counted_for_each_cell_and_as_long_as_they_are_told() {
        let text = |records: &[Vec<u8>]| reach(&records.concat()).text;
        let shared = |number: u16| record(SHARED_TEXT, &[0, 0, 0, number, 0]);
        assert_eq!(text(&[shared(0), shared(1), shared(1)]), 16 + 2 * 140_000);
        assert_eq!(text(&[shared(2), record(SHARED_TEXT, &[0, 0])]), 0, "there is no such text");
        assert_eq!(text(&[record(0x0204, &[0, 0, 0, 0xffff, 0])]), 0x1_0000);
        assert_eq!(text(&[record(TEXT_OF_FORMULA, &[0xffff])]), 0x1_0000);
        assert_eq!(text(&[record(0x00d6, &[0, 0, 0, 2, 0x6100, 0x62])]), OWN_TEXT_FACTOR * 6);
    }

    #[test]
    fn what_a_sheet_takes_is_counted_by_the_lists_of_the_library() {
        let cells = [number(0, 0), number(1, 9)].concat();
        let plain = reach(&cells);
        assert_eq!(
            (plain.kept(), plain.listed(), plain.copied()),
            (20 * VALUE_SIZE, GROWTH_FACTOR * 2 * CELL_SIZE, 20 * VALUE_SIZE)
        );
        let with_text = reach(&[cells.clone(), record(SHARED_TEXT, &[0, 0, 0, 0, 0])].concat());
        assert_eq!((with_text.kept(), with_text.copied()), (20 * VALUE_SIZE + 16, 20 * VALUE_SIZE + 16));
        let with_formula = reach(&[cells.clone(), record(FORMULA, &[0; 10])].concat());
        assert_eq!(with_formula.kept(), 20 * (VALUE_SIZE + STRING_SIZE) + UNREADABLE_FORMULA_SIZE);
        assert_eq!(with_formula.listed(), GROWTH_FACTOR * (3 * CELL_SIZE + FORMULA_SIZE));
        let merged = record(MERGED_CELLS, &[2, 0, 1, 0, 1, 5, 6, 0, 1]);
        assert_eq!(reach(&merged).kept(), GROWTH_FACTOR * 2 * MERGED_SIZE);
        let continued = reach(&[cells.clone(), record(CONTINUED, &[])].concat());
        assert_eq!(continued.listed() - plain.listed(), GROWTH_FACTOR * CONTINUATION_SIZE);
        let told = reach(&[cells, record(DIMENSIONS, &[0, 0, 0, 16, 0, 1, 0])].concat());
        assert_eq!(told.listed() - plain.listed(), ((1 << 20) - UNCOUNTED_CELLS) * CELL_SIZE);
    }

    #[test]
    fn formulas_are_counted_by_their_tokens() {
        // Twenty bytes, the length of the tokens, a name, and what is no token any more.
        let formula = [&[0; 10][..], &[5, 0x0123, 0, 0x2300, 0x2323][..]].concat();
        let made = reach(&record(FORMULA, &formula)).made;
        assert_eq!(made, written(&[0x23, 1, 0, 0, 0], 60));
        assert_eq!(reach(&record(FORMULA, &[0; 10])).made, Written::default());
    }

    #[test]
    fn what_sheets_share_stands_before_their_end() {
        let place = |name: &[u16]| record(SHEET, &[&[9, 0, 0][..], name].concat());
        let texts = [record(TEXTS, &[0, 0, 0, 0, 1, 0x6100]), record(CONTINUED, &[1, 0x6200])].concat();
        let book = [
            place(&[0x0001, u16::from(b'S')]),
            place(&[0x0101, u16::from(b'T')]),
            texts.clone(),
            record(END_OF_PART, &[]),
            place(&[0x0005, 0x4142]),
            texts,
        ]
        .concat();
        let sheets: Vec<(usize, String)> = sheets(&book).collect();
        assert_eq!(sheets, [(9, "S".to_string()), (9, "T".to_string())]);
        let shared = Shared::of(&book);
        assert_eq!((shared.texts.as_slice(), shared.longest_name, shared.parts), (&[1, 1][..], 6, 2));
        assert_eq!(shared.taken, 2 * (GROWTH_FACTOR * (STRING_SIZE + CONTINUATION_SIZE) + 16));
        assert_eq!((shared.entries, shared.entry_bytes), (2, 20));
        assert_eq!((shared.bytes(Some(1)), shared.bytes(Some(2)), shared.bytes(None)), (1, 0, 0));
    }
}
