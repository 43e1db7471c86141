//! Looks at a workbook before the library opens it. The library believes what the file says of itself: how many texts it has, how
//! often a cell is repeated, how long a record is. A process that cannot allocate memory ends, and then no loop is watched.

use super::archive::{Archive, Kind, PART_OF_OPEN_DOCUMENT, normalized};
use super::limits::{GROWTH_FACTOR, MemoryEstimate, STRING_SIZE, allocation_size, memory_limit};
use super::relations::{self, RELATIONSHIP};
use super::tags::{Tag, Tags, local, number};
use super::{content, ole, opened, xlsb};
use crate::table::error::TableError;
use crate::table::kinds;
use calamine::Style;
use std::io::{self, BufRead, BufReader};

/// Smallest limit of the texts that a workbook says it has: some programs tell more than there are.
const MIN_TEXT_LIMIT: u64 = 1 << 18;
/// Bytes that the library takes for a format of cells, in a list that grows, beside two names.
const FORMAT_SIZE: u64 = GROWTH_FACTOR * size_of::<Style>() as u64;
/// Bytes that the libraries for ZIP and for workbooks take for a part of an archive. Both list all parts, so it is counted high.
const PART_SIZE: u64 = 2048;
/// Bytes that they take for each byte of its name: both keep it, as it is and normalized, in texts that grow.
const PART_NAME_FACTOR: u64 = 8;

/// The most memory that opening a workbook of this kind would take, without the sheets as we keep them. What cannot be opened as an
/// archive here, the library cannot open as one either.
///
/// # Errors
/// A workbook that would take more than is allowed for its size.
pub fn check(bytes: &[u8], archive: Option<&mut Archive>, kind: Kind) -> Result<MemoryEstimate, TableError> {
    let mut memory = MemoryEstimate::of_file(bytes.len() as u64);
    if bytes.starts_with(kinds::OLE) {
        // An archive may follow it. The library opens that if it finds no workbook in the compound file.
        ole::check(bytes, &mut memory)?;
    }
    if let Some(archive) = archive {
        check_archive(archive, kind, &mut memory)?;
    }
    Ok(memory)
}

/// Adds the memory that opening an archive as this kind of workbook would take.
fn check_archive(archive: &mut Archive, kind: Kind, memory: &mut MemoryEstimate) -> Result<(), TableError> {
    for name in archive.file_names_raw() {
        memory.add_library_memory(PART_SIZE + PART_NAME_FACTOR * name.len() as u64);
    }
    let (own, limit) = (memory.file_bytes(), memory_limit(memory.file_bytes()));
    // A part that unpacks to more than the size given here is not read on: the ZIP library returns an error.
    let sizes = (0..archive.len()).filter_map(|at| archive.by_index(at).ok().map(|part| part.size()));
    if sizes.fold(0, u64::saturating_add) > limit {
        return Err(TableError::refused(format!(
            "a workbook that unpacks to more than {limit} bytes, from {own}: save the columns that are needed as CSV"
        )));
    }
    let xml_parts = opened::xml_parts(archive, kind, limit);
    for at in 0..archive.len() {
        let Ok(part) = archive.by_index(at) else { continue };
        let Ok(name) = part.name().map(|name| name.into_owned()) else { continue };
        let normalized = normalized(&name);
        if normalized.ends_with(".bin") || xml_parts.contains(&normalized) {
            let wrong = check_part(&normalized, BufReader::new(part), kind, memory)
                .map_err(|error| refused(&format!("whose {name:?} cannot be read: {error}")))?;
            if let Some(wrong) = wrong {
                return Err(refused(&format!("whose {name:?} {wrong}")));
            }
        }
        if let Some(over) = memory.over_limit() {
            return Err(refused(&format!("that {over}, up to its {name:?}")));
        }
    }
    Ok(())
}

fn refused(wrong: &str) -> TableError {
    TableError::refused(format!("a workbook {wrong}; save it again, or the columns that are needed as CSV"))
}

/// What is wrong with a part, if anything, by its normalized name and the kind of its workbook. Adds the memory that it takes.
fn check_part(
    name: &str,
    part: impl BufRead,
    kind: Kind,
    memory: &mut MemoryEstimate,
) -> io::Result<Option<String>> {
    if name.ends_with(".bin") {
        return xlsb::check(name, part, kind == Kind::Binary, memory).map(|()| None);
    }
    let mut tags = Tags::new(part);
    let wrong = if kind == Kind::OpenDocument && name == PART_OF_OPEN_DOCUMENT {
        let is_cut = content::check(&mut tags, memory)?;
        is_cut.then(|| "ends within a table: it is cut".to_string())
    } else {
        check_xml_of_excel(&mut tags, kind, memory)?
    };
    // The library reads all of a manifest into one buffer.
    let longest = if name.ends_with("manifest.xml") { tags.at } else { tags.longest };
    memory.add_library_memory(tags.listed);
    memory.raise_largest_buffer(longest);
    Ok(wrong)
}

/// Looks at an XML part of a workbook of Excel for texts, formats and relationships. They are found by their elements, whatever the
/// part is called.
fn check_xml_of_excel(
    tags: &mut Tags<impl BufRead>,
    kind: Kind,
    memory: &mut MemoryEstimate,
) -> io::Result<Option<String>> {
    let (mut told, mut texts) = (None, 0u64);
    let (mut formats, mut longest_name, mut is_of_cells) = (0u64, 0u64, false);
    let mut is_kept = false;
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
            b"numFmt" | b"name" => longest_name = longest_name.max(written.len() as u64),
            RELATIONSHIP => relations::check(written, kind)?,
            _ => {}
        }
        is_kept |= [&b"si"[..], b"font", b"numFmt", b"definedName"].contains(&name);
    }
    let told = told.unwrap_or(0);
    if told > MIN_TEXT_LIMIT.max(tags.at) {
        return Ok(Some(format!("says that it holds {told} texts, in {} bytes", tags.at)));
    }
    // The library makes room for as many texts as the file claims. If there are more, its list grows.
    let room = if texts <= told { told } else { texts.saturating_mul(GROWTH_FACTOR) };
    memory.add_library_memory(room.saturating_mul(STRING_SIZE));
    memory.add_library_memory(texts.saturating_mul(allocation_size(1)));
    if is_kept {
        // A text that is put together of several pieces grows to up to twice the room that it needs.
        memory.add_library_memory(tags.at.saturating_mul(2));
    }
    // Each format may have the longest name of a format of numbers and of a font.
    let format_size = longest_name.saturating_mul(2).saturating_add(FORMAT_SIZE);
    memory.add_library_memory(formats.saturating_mul(format_size));
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is wrong with a part of a workbook of Excel, and what the workbook would take.
    fn checked(text: &str) -> (Result<Option<String>, String>, MemoryEstimate) {
        let mut memory = MemoryEstimate::of_file(0);
        let wrong = check_part("xl/part.xml", text.as_bytes(), Kind::Excel, &mut memory);
        (wrong.map_err(|error| error.to_string()), memory)
    }

    #[test]
    fn shared_texts_are_counted_with_their_headers() {
        let over = |told: &str, texts: usize| {
            let list = format!("<sst{told}>{}</sst>", "<si><t>a</t></si>".repeat(texts));
            let (wrong, memory) = checked(&list);
            assert_eq!(wrong, Ok(None));
            memory.over_limit().is_some()
        };
        // A header, the least that an allocator takes and twice the bytes in the file: 24 + 16 + 34 for each that was told of.
        assert!(!over(" uniqueCount='210000'", 210_000));
        assert!(over(" uniqueCount='220000'", 220_000));
        // The list grows where nothing is told: 72 for each header.
        assert!(!over("", 125_000));
        assert!(over("", 135_000));
        let (wrong, _) = checked("<sst uniqueCount='300000'><si/></sst>");
        assert_eq!(wrong, Ok(Some("says that it holds 300000 texts, in 37 bytes".to_string())));
    }

    #[test]
    fn formats_and_lists_are_counted_for_each_entry() {
        let over = |text: &str| checked(text).1.over_limit().is_some();
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
    fn relationships_are_found_in_any_part() {
        let said = |path: &str| {
            let part = format!("<Relationship Type=\"http://a/worksheet\" Target=\"{path}\"/>");
            checked(&part).0.err().unwrap_or_default()
        };
        assert_eq!(said("worksheets/sheet1.xml"), "");
        assert!(said("media/image1.png").contains("it lists a part at \"media/image1.png\""));
    }
}
