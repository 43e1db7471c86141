//! Looks at the records of an `.xls` before the library opens it. The library makes room for as many cells and for as long texts as
//! it is told of, a cell of every place between the first and the last row and column, a text anew for each cell that shares it,
//! and a text of every formula; and it reads the records of a sheet anew for each name of a sheet that leads to them.

use super::fields::{u16_at, u32_at};
use super::limits::{self, GROWING, TEXT, Weight, heap};
use super::shared_texts::texts;
use super::tokens::{Written, written};
use crate::table::error::TableError;
use calamine::{Cell, Data, Dimensions};
use encoding_rs::UTF_16LE;

/// Cells that a sheet may always claim to have, without their being counted: 65,536 rows of twelve columns. Some programs claim as
/// many rows whatever there is. The library reserves 32 MB for them, and writes only to the room of cells that exist.
const FEW_TOLD: u64 = 3 << 18;
/// How many times the bytes of all records the sheets may have together: each record should belong to one sheet.
const TIMES_WALKED: u64 = 8;
/// Most bytes that the library takes for a byte of a text, in any encoding: four of UTF-8, and as many while the text grows.
const OF_A_BYTE: u64 = 8;
/// Most bytes for a byte of UTF-8 of a shared text, which is longer in another encoding.
const OF_A_SHARED_BYTE: u64 = 2;
/// Most bytes for a byte of UTF-8 of a shared text in the library's list, where the text grows.
const OF_A_LISTED_BYTE: u64 = 4;
/// Most bytes for a character of a name.
const OF_A_CHARACTER: u64 = 6;
/// Bytes that the library takes for a cell in the list of a sheet's cells.
const CELL: u64 = size_of::<Cell<Data>>() as u64;
/// Bytes of the value of a cell.
const VALUE: u64 = size_of::<Data>() as u64;
/// Bytes of a formula in the list of a sheet's formulas, without its text.
const FORMULA_OF_CELL: u64 = size_of::<Cell<String>>() as u64;
/// Bytes of the text that stands for a formula that the library cannot write.
const NO_FORMULA: u64 = 128;
/// Bytes that the library takes for a range of merged cells.
const JOINED: u64 = size_of::<Dimensions>() as u64;
/// Bytes of a range of merged cells in its record.
const JOINED_LEN: usize = 8;
/// Bytes of one number in a record of many, and of the fields around the numbers: row, first and last column.
const NUMBER_LEN: usize = 6;
/// Bytes that the library takes for a sheet or a name of cells, in lists that grow.
const ENTRY: u64 = 1024;
/// Bytes that it takes for each byte of the record of one.
const OF_AN_ENTRY: u64 = 12;
/// Bytes of an entry in the library's list of records that continue another. It moves when the entry before it is removed.
const PLACE: u64 = 16;

/// Records: how what follows is encrypted, begin and end of a part, a sheet's place, names of cells, the texts that cells share and
/// what continues them.
const ENCRYPTED: u16 = 0x002f;
const BEGIN_OF_PART: u16 = 0x0809;
const END_OF_PART: u16 = 0x000a;
const SHEET: u16 = 0x0085;
const NAME: u16 = 0x0018;
const TEXTS: u16 = 0x00fc;
const CONTINUED: u16 = 0x003c;
/// Of a sheet: its size as it is told, and cells.
const DIMENSIONS: u16 = 0x0200;
const FORMULA: u16 = 0x0006;
const TEXT_OF_FORMULA: u16 = 0x0207;
const NUMBERS: u16 = 0x00bd;
const JOINED_CELLS: u16 = 0x00e5;
const SHARED_TEXT: u16 = 0x00fd;
const OWN_TEXTS: [u16; 2] = [0x0204, 0x00d6];
const OTHER_CELLS: [u16; 3] = [0x0203, 0x0205, 0x027e];

/// Adds the memory that a stream of records would take.
///
/// # Errors
/// A stream that would take too much memory or time, or is encrypted.
pub fn look(book: &[u8], weight: &mut Weight) -> Result<(), TableError> {
    let Some(wrong) = wrong(book, weight) else { return Ok(()) };
    Err(TableError::refused(format!(
        "a workbook {wrong}; save it again, or the columns that are needed as CSV"
    )))
}

fn wrong(book: &[u8], weight: &mut Weight) -> Option<String> {
    if is_encrypted(book) {
        return Some("that is encrypted with a password: take it off".to_string());
    }
    let (shared, own) = (Shared::of(book), weight.own());
    let mut moved = shared.moved;
    if moved > limits::moved(own) {
        return Some(format!(
            "whose shared texts are cut into {} parts, more than any program writes",
            shared.parts
        ));
    }
    weight.library(shared.listed());
    weight.opening(shared.taken);
    if let Some(over) = weight.over() {
        return Some(format!("that {over}, for its shared texts and names"));
    }
    let (most_told, mut walked) = (FEW_TOLD.max(own), 0u64);
    for (at, name) in sheets(book) {
        let reach = Reach::of(book.get(at..).unwrap_or_default(), &shared);
        moved = moved.saturating_add(reach.made.moved);
        walked += reach.walked;
        if reach.told > most_told {
            let told = reach.told;
            return Some(format!(
                "whose sheet {name:?} says it has {told} cells: {most_told} are taken of {own} bytes"
            ));
        }
        weight.library(reach.kept());
        weight.opening(shared.taken.saturating_add(reach.listed()));
        weight.handed(reach.handed());
        if let Some(over) = weight.over() {
            return Some(format!(
                "that {over}, up to its sheet {name:?}, which reaches over {} cells and has texts and formulas of {} bytes: delete \
                 cells far from the others",
                reach.cells(),
                reach.texts()
            ));
        }
        if moved > limits::moved(own) {
            return Some(format!("whose sheet {name:?} has formulas that would take minutes"));
        }
        if walked > TIMES_WALKED * book.len() as u64 {
            return Some(format!("whose sheet {name:?} shares its cells with others"));
        }
    }
    None
}

/// The records of a stream: kind and bytes.
fn records(stream: &[u8]) -> impl Iterator<Item = (u16, &[u8])> {
    let mut rest = stream;
    std::iter::from_fn(move || {
        let (kind, len) = (u16_at(rest, 0)?, u16_at(rest, 2)?);
        let (own, next) = rest.split_at_checked(4 + usize::from(len))?;
        rest = next;
        Some((kind, &own[4..]))
    })
}

/// The records before the sheets.
fn globals(book: &[u8]) -> impl Iterator<Item = (u16, &[u8])> {
    records(book).take_while(|(kind, _)| *kind != END_OF_PART)
}

/// Whether the records are encrypted: then the library refuses the workbook, and no size in them means anything.
fn is_encrypted(book: &[u8]) -> bool {
    globals(book).any(|(kind, data)| kind == ENCRYPTED && u16_at(data, 0).is_some_and(|how| how != 0))
}

/// Where each sheet begins, and its name.
fn sheets(book: &[u8]) -> impl Iterator<Item = (usize, String)> {
    let places = globals(book).filter(|(kind, _)| *kind == SHEET);
    places.filter_map(|(_, data)| Some((u32_at(data, 0)? as usize, name_of(data))))
}

/// The name of a sheet, for a message.
fn name_of(data: &[u8]) -> String {
    let len = data.get(6).map_or(0, |len| usize::from(*len));
    let narrow = |text: &[u8]| text.iter().take(len).map(|byte| char::from(*byte)).collect();
    match data.get(7..).unwrap_or_default() {
        [1, wide @ ..] => {
            UTF_16LE.decode_without_bom_handling(&wide[..wide.len().min(2 * len)]).0.into_owned()
        }
        [0, text @ ..] => narrow(text),
        // Excel 5 does not tell how wide it is.
        text => narrow(text),
    }
}

/// What all sheets share.
#[derive(Debug, Default)]
struct Shared {
    /// Bytes of each text that cells name by its number.
    texts: Vec<u32>,
    /// Bytes that the library takes while it opens the workbook, for its lists of these texts and of records that continue others.
    taken: u64,
    /// Bytes of the longest name of a sheet or of cells.
    longest: u64,
    /// How many sheets and names of cells there are, and the bytes of their records.
    entries: (u64, u64),
    /// Parts that the texts are cut into, and bytes that are moved to put them together.
    parts: usize,
    moved: u64,
}

impl Shared {
    fn of(book: &[u8]) -> Self {
        let mut shared = Self::default();
        let mut records = globals(book).peekable();
        while let Some((kind, data)) = records.next() {
            let len_at = match kind {
                SHEET => 6,
                NAME => 3,
                TEXTS => {
                    let mut parts = vec![data];
                    while let Some((_, more)) = records.next_if(|(kind, _)| *kind == CONTINUED) {
                        parts.push(more);
                    }
                    shared.take(&parts);
                    continue;
                }
                CONTINUED => {
                    shared.taken += GROWING * PLACE;
                    continue;
                }
                _ => continue,
            };
            let characters = data.get(len_at).map_or(0, |len| u64::from(*len));
            shared.longest = shared.longest.max(OF_A_CHARACTER * characters);
            shared.entries = (shared.entries.0 + 1, shared.entries.1 + data.len() as u64);
        }
        shared
    }

    /// The library takes the last list of texts, and looks at each.
    fn take(&mut self, parts: &[&[u8]]) {
        let count = parts.len() as u64;
        self.moved = self.moved.saturating_add(count.saturating_mul(count) / 2 * PLACE);
        self.parts = self.parts.max(parts.len());
        self.texts = texts(parts);
        let each = |bytes: &u32| GROWING * TEXT + heap(OF_A_LISTED_BYTE * u64::from(*bytes));
        self.taken += self.texts.iter().map(each).sum::<u64>() + GROWING * PLACE * count;
    }

    /// Bytes that the library takes for sheets and names of cells. A name may stand for cells of the sheet with the longest name.
    fn listed(&self) -> u64 {
        let (count, bytes) = self.entries;
        count.saturating_mul(ENTRY + heap(self.longest)).saturating_add(OF_AN_ENTRY * bytes)
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
    joined: u64,
    /// How many records continue others.
    continued: u64,
    /// Bytes of the texts of its cells.
    text: u64,
    /// Texts of its formulas.
    made: Written,
    /// Bytes of its records.
    walked: u64,
}

impl Reach {
    /// Of the sheet that begins with a stream.
    fn of(stream: &[u8], shared: &Shared) -> Self {
        let mut reach = Self::default();
        let (mut has_begun, mut within, mut formula) = (false, 0u64, Some((0, 0)));
        for (kind, data) in records(stream) {
            reach.walked += 4 + data.len() as u64;
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
                JOINED_CELLS => reach.joined += (data.len() / JOINED_LEN) as u64,
                FORMULA => {
                    formula = place().or(formula);
                    reach.take(formula, 1);
                    reach.formulas += 1;
                    reach.made = reach.made.and(of_formula(data, shared.longest));
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
                    reach.text(OF_A_SHARED_BYTE * shared.bytes(u32_at(data, 6)));
                }
                _ if OWN_TEXTS.contains(&kind) => {
                    reach.take(place(), 1);
                    reach.text(room(data.get(6..).unwrap_or_default()));
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
        self.text = self.text.saturating_add(heap(bytes));
    }

    /// Cells from the first to the last row and column.
    fn cells(&self) -> u64 {
        let count = |from_to: Option<(u16, u16)>| from_to.map_or(0, |(from, to)| u64::from(to - from) + 1);
        count(self.rows) * count(self.columns)
    }

    /// Bytes of its texts and formulas. The text of a formula grows while the library writes it.
    fn texts(&self) -> u64 {
        let formulas = self.made.text.saturating_mul(2).saturating_add(self.formulas * NO_FORMULA);
        self.text.saturating_add(formulas)
    }

    /// Bytes that the library keeps of it.
    fn kept(&self) -> u64 {
        let each = VALUE + if self.formulas > 0 { TEXT } else { 0 };
        let joined = GROWING * JOINED * self.joined;
        self.cells().saturating_mul(each).saturating_add(self.texts()).saturating_add(joined)
    }

    /// Bytes that the library takes for the lists of its cells and formulas while it opens the workbook: room for the cells that the
    /// sheet claims to have, and lists that grow.
    fn listed(&self) -> u64 {
        let lists = CELL * self.count + FORMULA_OF_CELL * self.formulas + PLACE * self.continued;
        self.told.saturating_sub(FEW_TOLD).saturating_mul(CELL).saturating_add(GROWING * lists)
    }

    /// Bytes of the copy of its cells that the library hands to us.
    fn handed(&self) -> u64 {
        self.cells().saturating_mul(VALUE).saturating_add(self.text)
    }
}

/// The bytes that the library makes room for, for the text of a cell: as many as it says it is long, be it shorter or not.
fn room(text: &[u8]) -> u64 {
    u16_at(text, 0).map_or(0, u64::from).max(OF_A_BYTE * text.len() as u64)
}

/// What is made of the tokens of a formula.
fn of_formula(data: &[u8], longest: u64) -> Written {
    let (len, tokens) = (u16_at(data, 20).map_or(0, usize::from), data.get(22..).unwrap_or_default());
    written(&tokens[..tokens.len().min(len)], longest)
}

/// The cells that a sheet says it has, as the library reads it.
fn told(data: &[u8]) -> Option<u64> {
    let short = |at: usize| u16_at(data, at).map(u32::from);
    let (from, to, left, right) = match data.len() {
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
        Reach::of(stream, &Shared { texts: vec![5, 70_000], longest: 60, ..Shared::default() })
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
        assert_eq!(whole.walked, (begin.len() + own.len() + 4) as u64, "no record behind its end");
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
        assert_eq!(text(&[record(0x00d6, &[0, 0, 0, 2, 0x6100, 0x62])]), OF_A_BYTE * 6);
    }

    #[test]
    fn what_a_sheet_takes_is_counted_by_the_lists_of_the_library() {
        let cells = [number(0, 0), number(1, 9)].concat();
        let plain = reach(&cells);
        assert_eq!(
            (plain.kept(), plain.listed(), plain.handed()),
            (20 * VALUE, GROWING * 2 * CELL, 20 * VALUE)
        );
        let with_text = reach(&[cells.clone(), record(SHARED_TEXT, &[0, 0, 0, 0, 0])].concat());
        assert_eq!((with_text.kept(), with_text.handed()), (20 * VALUE + 16, 20 * VALUE + 16));
        let with_formula = reach(&[cells.clone(), record(FORMULA, &[0; 10])].concat());
        assert_eq!(with_formula.kept(), 20 * (VALUE + TEXT) + NO_FORMULA);
        assert_eq!(with_formula.listed(), GROWING * (3 * CELL + FORMULA_OF_CELL));
        let joined = record(JOINED_CELLS, &[2, 0, 1, 0, 1, 5, 6, 0, 1]);
        assert_eq!(reach(&joined).kept(), GROWING * 2 * JOINED);
        let continued = reach(&[cells.clone(), record(CONTINUED, &[])].concat());
        assert_eq!(continued.listed() - plain.listed(), GROWING * PLACE);
        let told = reach(&[cells, record(DIMENSIONS, &[0, 0, 0, 16, 0, 1, 0])].concat());
        assert_eq!(told.listed() - plain.listed(), ((1 << 20) - FEW_TOLD) * CELL);
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
        assert_eq!((shared.texts.as_slice(), shared.longest, shared.parts), (&[1, 1][..], 6, 2));
        assert_eq!((shared.taken, shared.entries), (2 * (GROWING * (TEXT + PLACE) + 16), (2, 20)));
        assert_eq!((shared.bytes(Some(1)), shared.bytes(Some(2)), shared.bytes(None)), (1, 0, 0));
        assert_eq!(name_of(&[0, 0, 0, 0, 0, 0, 3, b'A', b'B', b'C', b'D']), "ABC", "as Excel 5 writes it");
        assert_eq!(name_of(&[0, 0, 0]), "");
    }
}
