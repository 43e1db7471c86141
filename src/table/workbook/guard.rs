//! Looks at a workbook before the library opens it. The library believes what the file says of itself: how many texts it has, how
//! often a cell is repeated, how long a record is. A process that cannot allocate memory ends, and then no loop is watched.

use super::limits::{self, GROWING, TEXT, Weight};
use super::opened::{Archive, Kind, PART_OF_OPEN_DOCUMENT, relation, small};
use super::tags::{Tag, Tags, local, number};
use super::{content, ole, xlsb};
use crate::table::error::TableError;
use crate::table::kinds;
use calamine::Style;
use std::io::{self, BufRead, BufReader, Cursor};

/// Texts that any workbook may say it has: some programs tell more than there are.
const FEW_TEXTS: u64 = 1 << 18;
/// Bytes that the library takes for a format of cells, in a list that grows, beside two names.
const FORMAT: u64 = GROWING * size_of::<Style>() as u64;
/// Bytes that the libraries for ZIP and for workbooks take for a part of an archive.
const PART: u64 = 2048;
/// Bytes that they take for each byte of its name.
const OF_A_NAME: u64 = 8;
/// How many times the bytes of the longest element the library takes while it reads it. It has the bytes and their text, each in a
/// growing buffer.
const BUFFERS: u64 = 2 * GROWING;

/// The most memory that opening a workbook of this kind would take, without the sheets as we keep them.
///
/// # Errors
/// A workbook that would take more than is allowed for its size.
pub fn look(bytes: &[u8], kind: Kind) -> Result<Weight, TableError> {
    let mut weight = Weight::of(bytes.len() as u64);
    if bytes.starts_with(kinds::OLE) {
        // An archive may follow it. The library opens that if it finds no workbook in the compound file.
        ole::look(bytes, &mut weight)?;
    }
    // What cannot be opened as an archive here, the library cannot open either.
    let Ok(mut archive) = Archive::new(Cursor::new(bytes)) else { return Ok(weight) };
    for name in archive.file_names_raw() {
        weight.library(PART + OF_A_NAME * name.len() as u64);
    }
    let most = limits::bytes(weight.own());
    // A part that unpacks to more than the size given here is not read on: the ZIP library returns an error.
    let sizes = (0..archive.len()).filter_map(|at| archive.by_index(at).ok().map(|part| part.size()));
    if sizes.fold(0, u64::saturating_add) > most {
        return Err(TableError::refused(format!(
            "a workbook that unpacks to more than {most} bytes, from {}: save the columns that are needed as CSV",
            bytes.len()
        )));
    }
    let opened = kind.opened(&mut archive, most);
    for at in 0..archive.len() {
        let Ok(part) = archive.by_index(at) else { continue };
        let Ok(name) = part.name().map(|name| name.into_owned()) else { continue };
        let small = small(&name);
        if small.ends_with(".bin") || opened.contains(&small) {
            let wrong = wrong(&small, BufReader::new(part), kind, &mut weight)
                .map_err(|error| refused(&format!("whose {name:?} cannot be read: {error}")))?;
            if let Some(wrong) = wrong {
                return Err(refused(&format!("whose {name:?} {wrong}")));
            }
        }
        if let Some(over) = weight.over() {
            return Err(refused(&format!("that {over}, up to its {name:?}")));
        }
    }
    Ok(weight)
}

fn refused(wrong: &str) -> TableError {
    TableError::refused(format!("a workbook {wrong}; save it again, or the columns that are needed as CSV"))
}

/// What is wrong with a part, if anything, by its name in small letters and the kind of its workbook. Adds the memory that it takes
/// to the weight.
fn wrong(small: &str, part: impl BufRead, kind: Kind, weight: &mut Weight) -> io::Result<Option<String>> {
    if small.ends_with(".bin") {
        return xlsb::look(small, part, kind == Kind::Binary, weight).map(|()| None);
    }
    let mut tags = Tags::new(part);
    let wrong = if kind == Kind::OpenDocument && small == PART_OF_OPEN_DOCUMENT {
        let is_cut = content::look(&mut tags, weight)?;
        is_cut.then(|| "ends within a table: it is cut".to_string())
    } else {
        of_excel(&mut tags, kind, weight)?
    };
    // The library reads all of a manifest into one buffer.
    let longest = if small.ends_with("manifest.xml") { tags.at } else { tags.longest };
    weight.library(tags.listed);
    weight.buffer(BUFFERS.saturating_mul(longest));
    Ok(wrong)
}

/// Looks at an XML part of a workbook of Excel for texts, formats and lists of parts. They are found by their elements, whatever the
/// part is called.
fn of_excel(tags: &mut Tags<impl BufRead>, kind: Kind, weight: &mut Weight) -> io::Result<Option<String>> {
    let (mut told, mut texts, mut formats, mut longest, mut is_kept) = (None, 0u64, 0u64, 0u64, false);
    let mut is_of_cells = false;
    while let Some(tag) = tags.tag()? {
        let Tag::Begin(name, written) = tag else { continue };
        let name = local(name);
        // The library looks at the first count.
        match name {
            b"sst" => told = told.or(Some(number(written, "uniqueCount"))),
            b"si" => texts += 1,
            // The library keeps the formats of this list only. The end of the list is not looked for: an end tag within a format
            // does not count for the library, and no other list of formats follows.
            b"cellXfs" => is_of_cells = true,
            b"xf" => formats += u64::from(is_of_cells),
            b"numFmt" | b"name" => longest = longest.max(written.len() as u64),
            b"Relationship" if kind == Kind::Binary => xlsb::relation(written)?,
            b"Relationship" => relation(written)?,
            _ => {}
        }
        is_kept |= [&b"si"[..], b"font", b"numFmt", b"definedName"].contains(&name);
    }
    let told = told.unwrap_or(0);
    if told > FEW_TEXTS.max(tags.at) {
        return Ok(Some(format!("says that it holds {told} texts, in {} bytes", tags.at)));
    }
    // The library makes room for as many texts as the file claims. If there are more, its list grows.
    let room = if texts <= told { told } else { texts.saturating_mul(GROWING) };
    weight.library(room.saturating_mul(TEXT).saturating_add(texts.saturating_mul(limits::heap(1))));
    if is_kept {
        // A text that is put together of several pieces grows.
        weight.library(tags.at.saturating_mul(2));
    }
    weight.library(formats.saturating_mul(longest.saturating_mul(2).saturating_add(FORMAT)));
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is wrong with a part of a workbook of Excel, and what the workbook would take.
    fn looked(text: &str) -> (Result<Option<String>, String>, Weight) {
        let mut weight = Weight::of(0);
        let wrong = wrong("xl/part.xml", text.as_bytes(), Kind::Excel, &mut weight);
        (wrong.map_err(|error| error.to_string()), weight)
    }

    #[test]
    fn shared_texts_are_counted_with_their_headers() {
        let over = |told: &str, texts: usize| {
            let list = format!("<sst{told}>{}</sst>", "<si><t>a</t></si>".repeat(texts));
            let (wrong, weight) = looked(&list);
            assert_eq!(wrong, Ok(None));
            weight.over().is_some()
        };
        // A header, the least that an allocator takes and twice the bytes in the file: 24 + 16 + 34 for each that was told of.
        assert!(!over(" uniqueCount='210000'", 210_000));
        assert!(over(" uniqueCount='220000'", 220_000));
        // The list grows where nothing is told: 72 for each header.
        assert!(!over("", 125_000));
        assert!(over("", 135_000));
        let (wrong, _) = looked("<sst uniqueCount='300000'><si/></sst>");
        assert_eq!(wrong, Ok(Some("says that it holds 300000 texts, in 37 bytes".to_string())));
    }

    #[test]
    fn formats_and_lists_are_counted_for_each_entry() {
        let over = |text: &str| looked(text).1.over().is_some();
        let formats = |count: usize| format!("<cellXfs>{}</cellXfs>", "<xf/>".repeat(count));
        assert!(!over(&formats(1000)));
        assert!(over(&formats(100_000)));
        let long = format!("<numFmt formatCode=\"{}\"/>", "0".repeat(10_000));
        assert!(over(&(long + &formats(1000))));
        let of_styles = format!("<cellStyleXfs>{}</cellStyleXfs>", "<xf/>".repeat(100_000));
        assert!(!over(&(of_styles + &formats(1000))), "the library does not keep them");
        // It goes on behind an end that stands within a format.
        assert!(over(&format!("<cellXfs><xf></cellXfs></xf>{}", "<xf/>".repeat(100_000))));
        let names = |count: usize| "<definedName name=\"abc\">S!$A$1</definedName>".repeat(count);
        // 208 bytes each, and twice those in the file: 88.
        assert!(!over(&names(53_000)));
        assert!(over(&names(55_000)));
        assert!(!over(&"<sheet/>".repeat(1000)));
        assert!(over(&"<sheet/>".repeat(20_000)));
    }

    #[test]
    fn sheets_are_parts_that_are_looked_at() {
        let said = |kind: &str, place: &str| {
            let list = format!("<Relationship Type=\"http://a/relationships/{kind}\" Target=\"{place}\"/>");
            looked(&list).0.err().unwrap_or_default()
        };
        let long = format!("{}.xml", "x".repeat(300));
        for place in ["worksheets/sheet1.xml", "/xl/worksheets/Sheet1.XML"] {
            assert_eq!(said("worksheet", place), "");
        }
        for place in ["media/image1.png", "a&#46;xml", long.as_str()] {
            for kind in ["worksheet", "officeDocument"] {
                assert!(said(kind, place).contains("it lists a part at \""), "{kind} {place}");
            }
            assert_eq!(said("image", place), "", "it is not opened");
        }
    }
}
