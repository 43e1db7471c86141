//! Looks at the parts of an `.xlsb` before the library opens it. The library makes room for a record as long as it says it is, and
//! keeps the bytes of the longest one before: what a shorter one lacks, it takes from there. It writes the names of cells as text,
//! with the names and sheets in them as often as they stand there. Kinds of records have their names in Microsoft's document MS-XLSB.

use super::fields::u32_at;
use super::limits::{ENTRY_SIZE, GROWTH_FACTOR, MemoryEstimate, STRING_SIZE, allocation_size, shift_limit};
use super::tokens::{Written, depth, written};
use std::io::{self, BufRead};

/// Where a workbook lies in its archive, normalized.
pub const WORKBOOK: &str = "xl/workbook.bin";
/// Where the relationship part of a workbook lies in its archive, normalized.
pub const RELATIONS: &str = "xl/_rels/workbook.bin.rels";
/// Folders in which the library takes a part for a sheet, from the folder of the workbook on.
const SHEET_FOLDERS: [&[u8]; 3] = [b"worksheets/", b"chartsheets/", b"dialogsheets/"];
/// How the name of a part with a sheet ends.
const SHEET_ENDING: &[u8] = b".bin";

/// BrtSSTItem: a text that cells share.
const SHARED_TEXT: u16 = 0x0013;
/// BrtCellSt: a cell with a text of its own.
const TEXT_OF_CELL: u16 = 0x0006;
/// BrtFmlaString: a cell with a formula whose value is a text.
const TEXT_OF_FORMULA: u16 = 0x0008;
/// BrtBundleSh: a sheet.
const SHEET: u16 = 0x009c;
/// BrtExternSheet: links to sheets.
const LINKS: u16 = 0x016a;
/// BrtName: a name of cells.
const NAME: u16 = 0x0027;
/// BrtBeginFmts: the list of formats of numbers begins.
const FORMATS: u16 = 0x0267;
/// BrtFmt: a format of numbers.
const FORMAT: u16 = 0x002c;
/// BrtBeginCellXFs: the list of formats of cells begins.
const CELL_FORMATS: u16 = 0x0269;
/// BrtXF: a format of cells.
const CELL_FORMAT: u16 = 0x002f;

/// Bytes before the text in the record of a shared text: its flags.
const SHARED_TEXT_AT: usize = 1;
/// Bytes before the text in the record of a cell: its column and its format.
const CELL_TEXT_AT: usize = 8;
/// Bytes before the text in the record of a format: its number.
const FORMAT_TEXT_AT: usize = 2;
/// Bytes before the key of its relationship in the record of a sheet: its state and its number.
const SHEET_RELATION_AT: usize = 8;
/// Bytes before the name in the record of a name of cells: flags, a key and the sheet that it is for.
const NAME_TEXT_AT: usize = 9;

/// Most bytes of a record that are looked at: a name of cells that Excel takes is shorter.
const MAX_HELD: usize = 1 << 16;
/// Most bytes of the record of a sheet: two numbers, and two names of 255 characters with their lengths.
const LONGEST_SHEET: usize = 1036;
/// Bytes of a link to a sheet.
const LINK_LEN: usize = 12;
/// Bytes before the first link: their count.
const LINKS_HEAD_LEN: usize = 4;
/// Bytes that the library takes for each byte of the record of a sheet or of a name of cells: up to 3/2 in UTF-8, in a text that
/// grows.
const ENTRY_BYTE_FACTOR: u64 = 4;
/// How deep a formula may be nested in formulas: each level takes some kilobytes of a stack of 2 MB.
const MAX_FORMULA_DEPTH: usize = 64;

/// Looks at a part, by its normalized name, and adds the memory that it takes. In an archive without `WORKBOOK`, the library reads
/// formats and texts only.
///
/// # Errors
/// What the reader said, and what is wrong with the part.
pub fn check(name: &str, part: impl BufRead, is_binary: bool, memory: &mut MemoryEstimate) -> io::Result<()> {
    let mut records = Records { from: part, at: 0, longest: 0, held: Vec::new() };
    match name.strip_prefix("xl/") {
        _ if name == WORKBOOK => check_workbook(&mut records, memory)?,
        Some("styles.bin") => check_formats(&mut records)?,
        Some("sharedstrings.bin") => {
            memory.add_library_memory(check_texts(&mut records, &[(SHARED_TEXT, SHARED_TEXT_AT)])?);
        }
        // The library drops the text of a cell as soon as it is read.
        Some(path) if is_binary && is_sheet(path.as_bytes()) => {
            check_texts(&mut records, &[(TEXT_OF_CELL, CELL_TEXT_AT), (TEXT_OF_FORMULA, CELL_TEXT_AT)])?;
        }
        _ => {}
    }
    memory.raise_largest_buffer(records.longest);
    Ok(())
}

/// Whether the library takes the part at a path for a sheet, and it is none that is looked at.
pub fn is_misplaced_sheet(path: &[u8]) -> bool {
    let path = path.to_ascii_lowercase();
    is_in_sheet_folder(&path) && !is_sheet(&path)
}

fn is_in_sheet_folder(path: &[u8]) -> bool {
    SHEET_FOLDERS.iter().any(|folder| path.starts_with(folder))
}

fn is_sheet(path: &[u8]) -> bool {
    is_in_sheet_folder(path) && path.ends_with(SHEET_ENDING)
}

fn wrong(says: String) -> io::Error {
    io::Error::other(says)
}

/// The records of a part one after the other.
struct Records<R> {
    from: R,
    /// Bytes that were read.
    at: u64,
    /// Bytes of the longest record.
    longest: u64,
    /// The first bytes of the record that was read last.
    held: Vec<u8>,
}

impl<R: BufRead> Records<R> {
    fn byte(&mut self) -> io::Result<Option<u8>> {
        let byte = self.from.fill_buf()?.first().copied();
        self.from.consume(usize::from(byte.is_some()));
        self.at += u64::from(byte.is_some());
        Ok(byte)
    }

    /// The kind of the next record; `None` at the end.
    fn kind(&mut self) -> io::Result<Option<u16>> {
        let Some(low) = self.byte()? else { return Ok(None) };
        if low & 0x80 == 0 {
            return Ok(Some(u16::from(low)));
        }
        let high = self.byte()?;
        Ok(high.map(|high| u16::from(low & 0x7f) | (u16::from(high & 0x7f) << 7)))
    }

    /// Goes on behind the record whose kind was read; the bytes that it has. `None` where the part ends before it says.
    fn body(&mut self) -> io::Result<Option<usize>> {
        let mut len = 0;
        for at in 0..4 {
            let Some(byte) = self.byte()? else { return Ok(None) };
            len |= usize::from(byte & 0x7f) << (7 * at);
            if byte & 0x80 == 0 {
                break;
            }
        }
        self.held.clear();
        let mut left = len;
        while left > 0 {
            let come = self.from.fill_buf()?;
            if come.is_empty() {
                let come = len - left;
                return Err(wrong(format!("a record says that it has {len} bytes, and {come} come")));
            }
            let (taken, room) = (left.min(come.len()), MAX_HELD - self.held.len());
            self.held.extend_from_slice(&come[..taken.min(room)]);
            self.from.consume(taken);
            left -= taken;
        }
        self.at += len as u64;
        self.longest = self.longest.max(len as u64);
        Ok(Some(len))
    }

    /// The next record: its kind, and the bytes that it has. `None` at the end.
    fn record(&mut self) -> io::Result<Option<(u16, usize)>> {
        let Some(kind) = self.kind()? else { return Ok(None) };
        Ok(self.body()?.map(|len| (kind, len)))
    }

    /// Refuses a record of so many bytes whose text goes on behind its end.
    fn has_text(&self, at: usize, len: usize) -> io::Result<()> {
        match u32_at(&self.held, at) {
            Some(characters) if (at + 4) as u64 + 2 * u64::from(characters) <= len as u64 => Ok(()),
            Some(characters) => Err(wrong(format!(
                "a text says that it has {characters} characters, in a record of {len} bytes"
            ))),
            None => Err(wrong(format!("a record of a text has {len} bytes, which hold none"))),
        }
    }
}

/// Looks at a part with records of texts, by their kinds and where in them a text begins. Returns the bytes that a list of the texts
/// takes.
fn check_texts(records: &mut Records<impl BufRead>, kinds: &[(u16, usize)]) -> io::Result<u64> {
    let mut taken = 0u64;
    while let Some((kind, len)) = records.record()? {
        if let Some((_, at)) = kinds.iter().find(|(own, _)| *own == kind) {
            records.has_text(*at, len)?;
            // The library makes room for one byte more than the text needs.
            let characters = allocation_size(utf_8_len(len) + 1);
            taken = taken.saturating_add(GROWTH_FACTOR * STRING_SIZE + characters);
        }
    }
    Ok(taken)
}

/// The part of formats. The library looks for its two lists byte by byte, as it takes no more than the kind of any other record; so
/// does this, to see the same lists.
fn check_formats(records: &mut Records<impl BufRead>) -> io::Result<()> {
    while let Some(kind) = records.kind()? {
        let one = match kind {
            FORMATS => FORMAT,
            CELL_FORMATS => CELL_FORMAT,
            _ => continue,
        };
        if records.body()?.is_none() {
            break;
        }
        for _ in 0..u32_at(&records.held, 0).unwrap_or(0) {
            if !goes_on_to(records, one)? {
                return Ok(());
            }
        }
        if kind == CELL_FORMATS {
            break;
        }
    }
    Ok(())
}

/// Goes on behind the next record of a kind; `false` where there is none.
fn goes_on_to(records: &mut Records<impl BufRead>, wanted: u16) -> io::Result<bool> {
    while let Some((kind, len)) = records.record()? {
        if kind == FORMAT && wanted == FORMAT {
            records.has_text(FORMAT_TEXT_AT, len)?;
        }
        if kind == wanted {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The part that lists sheets and names of cells.
fn check_workbook(records: &mut Records<impl BufRead>, memory: &mut MemoryEstimate) -> io::Result<()> {
    let (mut longest_name, mut made) = (0u64, Written::default());
    while let Some((kind, len)) = records.record()? {
        match kind {
            SHEET => {
                // All ones stand for no key: a sheet without a part.
                let characters = u32_at(&records.held, SHEET_RELATION_AT).filter(|key| *key != u32::MAX);
                let key_end = (SHEET_RELATION_AT + 4) as u64 + 2 * characters.map_or(0, u64::from);
                if len > LONGEST_SHEET || key_end > len as u64 {
                    return Err(wrong(format!(
                        "a sheet is listed in {len} bytes, too many or too few for its name"
                    )));
                }
                longest_name = longest_name.max(utf_8_len(len));
                memory.add_library_memory(ENTRY_SIZE + ENTRY_BYTE_FACTOR * len as u64);
            }
            LINKS => {
                let count = u32_at(&records.held, 0).map_or(0, u64::from);
                if LINKS_HEAD_LEN as u64 + count * LINK_LEN as u64 > len as u64 {
                    return Err(wrong(format!("a record says that it has {count} links, in {len} bytes")));
                }
                memory.add_library_memory(count.saturating_mul(allocation_size(longest_name) + STRING_SIZE));
            }
            NAME if len > MAX_HELD => {
                return Err(wrong(format!("a name of cells takes {len} bytes")));
            }
            NAME => {
                memory.add_library_memory(ENTRY_SIZE + ENTRY_BYTE_FACTOR * len as u64);
                // What is cut is refused by the library.
                let Some((name, tokens)) = name(&records.held) else { continue };
                if depth(tokens) > MAX_FORMULA_DEPTH {
                    return Err(wrong("a name of cells has formulas nested too deep".to_string()));
                }
                longest_name = longest_name.max(utf_8_len(name));
                made = made.and(written(tokens, longest_name));
            }
            _ => {}
        }
    }
    if made.shifted > shift_limit(records.at) {
        return Err(wrong("its names of cells would take minutes to be written as text".to_string()));
    }
    // Each grows while it is written.
    memory.add_library_memory(made.text.saturating_mul(GROWTH_FACTOR));
    Ok(())
}

/// Most bytes that so many bytes of UTF-16 take in UTF-8.
fn utf_8_len(bytes: usize) -> u64 {
    bytes as u64 * 3 / 2
}

/// A name of cells: the bytes of its characters, and the tokens of its formula.
fn name(held: &[u8]) -> Option<(usize, &[u8])> {
    let len = (u32_at(held, NAME_TEXT_AT)? as usize).checked_mul(2)?;
    let behind = held.get(NAME_TEXT_AT + 4..)?.get(len..)?;
    let tokens = behind.get(4..)?.get(..u32_at(behind, 0)? as usize)?;
    Some((len, tokens))
}

#[cfg(test)]
#[path = "../../../tests/exports/xlsb_records.rs"]
mod records;

#[cfg(test)]
mod tests {
    use super::records::{record, told, wide};
    use super::*;

    /// What is wrong with a part; nothing where it is sound.
    fn said(name: &str, part: &[Vec<u8>]) -> String {
        estimated(name, part).0
    }

    /// The same, and what the workbook would take.
    fn estimated(name: &str, part: &[Vec<u8>]) -> (String, MemoryEstimate) {
        let mut memory = MemoryEstimate::of_file(0);
        let checked = check(name, part.concat().as_slice(), true, &mut memory);
        (checked.err().map(|error| error.to_string()).unwrap_or_default(), memory)
    }

    const PARTS: [&str; 3] = ["xl/worksheets/sheet1.bin", "xl/workbook.bin", "xl/sharedstrings.bin"];

    #[test]
    fn a_record_that_is_longer_than_its_part_is_refused() {
        for part in PARTS {
            assert_eq!(said(part, &[record(0x94, &[0; 16]), record(0x1ff, &[0; 300]), record(0, &[])]), "");
            let lies = [record(0x94, &[0; 16]), told(0x94, (1 << 28) - 1, &[0; 16])];
            assert_eq!(said(part, &lies), "a record says that it has 268435455 bytes, and 16 come");
            assert_eq!(said(part, &[vec![0x94]]), "", "a kind that is cut");
            assert_eq!(said(part, &[vec![0x94, 1, 0xff]]), "", "a length that is cut");
        }
        let lies = told(1, 1 << 20, &[]);
        assert_eq!(said("xl/printersettings/settings1.bin", std::slice::from_ref(&lies)), "", "no records");
        let check = |part: &str| check(part, lies.as_slice(), false, &mut MemoryEstimate::of_file(0));
        assert!(check(PARTS[0]).is_ok(), "no sheet of an .xlsb");
        assert!(check(PARTS[2]).is_err(), "texts are read all the same");
    }

    #[test]
    fn a_text_that_goes_on_behind_its_record_is_refused() {
        let of = |at: usize, text: &[u8]| [&vec![0; at][..], text].concat();
        for (part, kind, at) in [
            ("xl/worksheets/sheet1.bin", TEXT_OF_CELL, 8),
            ("xl/worksheets/sheet1.bin", TEXT_OF_FORMULA, 8),
            ("xl/sharedstrings.bin", SHARED_TEXT, 1),
        ] {
            let sound = record(kind, &of(at, &wide("OP")));
            assert_eq!(said(part, &[sound.clone(), record(kind, &of(at, &[0; 9])), record(1, &[])]), "");
            let long = record(kind, &of(at, &wide("OP")[..7]));
            assert!(said(part, &[sound.clone(), long]).contains("2 characters, in a record of "));
            let blank = record(kind, &[0]);
            assert!(said(part, &[sound, blank]).contains("has 1 bytes, which hold none"));
        }
    }

    #[test]
    fn shared_texts_are_counted_with_their_headers() {
        // For each a header in a list that grows, and the least that an allocator takes: 72 and 16 bytes.
        let over = |texts: usize| {
            let text = record(SHARED_TEXT, &[&[0][..], &wide("a")[..]].concat());
            let (said, memory) = estimated(PARTS[2], &vec![text; texts]);
            assert_eq!(said, "");
            memory.over_limit().is_some()
        };
        assert!(!over(170_000));
        assert!(over(190_000));
        let text = record(TEXT_OF_CELL, &[&[0; 8][..], &wide("a")[..]].concat());
        let (_, memory) = estimated(PARTS[0], &vec![text; 190_000]);
        assert_eq!(memory.over_limit(), None, "they are read one by one");
    }

    #[test]
    fn formats_are_looked_for_as_the_library_does() {
        let format = |text: &[u8]| record(FORMAT, &[&[164, 0][..], text].concat());
        let list = |kind: u16, count: u32| record(kind, &count.to_le_bytes());
        let part = |formats: &[Vec<u8>]| {
            let begin = [record(0x116, &[]), list(FORMATS, formats.len() as u32)];
            let end = [record(0x268, &[]), list(CELL_FORMATS, 1), record(CELL_FORMAT, &[0; 16])];
            [&begin[..], formats, &end[..]].concat()
        };
        let name = "xl/styles.bin";
        assert_eq!(said(name, &part(&[format(&wide("0.00")), format(&wide("hh:mm"))])), "");
        let said_of_long = said(name, &part(&[format(&wide("0.00")), format(&[9, 0, 0, 0])]));
        assert!(said_of_long.contains("9 characters"), "{said_of_long}");
        let lies = [part(&[]), vec![told(CELL_FORMAT, 1 << 27, &[])]].concat();
        assert_eq!(said(name, &lies), "", "behind the lists nothing is read");
        let within = [list(FORMATS, 1), told(0x10, 1 << 27, &[])];
        assert!(said(name, &within).contains("134217728 bytes, and 0 come"));
        // The bytes of a list's kind within a record.
        let hidden = [record(0x10, &told(FORMATS, 1 << 27, &[0; 4]))];
        assert!(said(name, &hidden).contains("134217728 bytes, and 4 come"));
    }

    fn sheet(relation: &str, name: &str) -> Vec<u8> {
        record(SHEET, &[&[0; 8][..], &wide(relation)[..], &wide(name)[..]].concat())
    }

    fn name_of(tokens: &[u8]) -> Vec<u8> {
        let len = (tokens.len() as u32).to_le_bytes();
        record(NAME, &[&[0; 9][..], &wide("limits")[..], &len[..], tokens].concat())
    }

    #[test]
    fn sheets_links_and_names_take_no_more_than_they_have() {
        let said = |records: &[Vec<u8>]| said("xl/workbook.bin", records);
        let links = |count: u32| record(LINKS, &[&count.to_le_bytes()[..], &[0; 36][..]].concat());
        let area = [0x3b, 0, 0, 41, 0, 0, 0, 99, 0, 0, 0, 1, 0xc0, 2, 0xc0];
        let sound = [sheet("rId1", "Trend"), links(3), name_of(&area), name_of(&[]), record(NAME, &[0; 12])];
        assert_eq!(said(&sound), "");
        let unlisted = record(SHEET, &[&[0; 8][..], &[0xff; 4][..], &wide("Macro")[..]].concat());
        assert_eq!(said(&[unlisted]), "", "a sheet without a part");
        assert!(said(&[sheet("rId1", &"x".repeat(600))]).contains("a sheet is listed in 1224 bytes"));
        let short = record(SHEET, &[&[0; 8][..], &[9, 0, 0, 0][..], &[0; 8][..]].concat());
        assert!(said(&[short]).contains("a sheet is listed in 20 bytes"));
        assert!(said(&[links(4)]).contains("4 links, in 40 bytes"));
        let long = record(NAME, &vec![0; MAX_HELD + 1]);
        assert!(said(&[long]).contains("a name of cells takes 65537 bytes"));
    }

    #[test]
    fn formulas_that_are_deep_or_long_to_write_are_refused() {
        let of = |records: &[Vec<u8>]| estimated(PARTS[1], records);
        let said = |records: &[Vec<u8>]| of(records).0;
        let deep = |levels: usize| {
            let nest = |inside: Vec<u8>| {
                [&[0x29][..], &(inside.len() as u16).to_le_bytes()[..], &inside[..]].concat()
            };
            (0..levels).fold(vec![0x44, 0, 0, 0, 0, 0, 0], |inside, _| nest(inside))
        };
        assert_eq!(said(&[name_of(&deep(MAX_FORMULA_DEPTH))]), "");
        assert!(said(&[name_of(&deep(MAX_FORMULA_DEPTH + 1))]).contains("nested too deep"));
        let long = sheet("rId1", &"x".repeat(500));
        let links = record(LINKS, &[1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        let areas = [0x3b; 60_000];
        assert_eq!(of(&[long.clone(), links.clone(), name_of(&areas[..1000])]).1.over_limit(), None);
        let (said_of_long, memory) = of(&[long, links, name_of(&areas)]);
        assert_eq!(said_of_long, "");
        assert!(memory.over_limit().is_some());
        let signs = [0x12; 60_000];
        assert!(said(&[name_of(&signs)]).contains("its names of cells would take minutes"));
    }
}
