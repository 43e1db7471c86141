//! Looks at a workbook before the library opens it, which believes what the file says of itself: how many texts it has, how often
//! a cell is there, how long a record is. Where memory cannot be had the process ends, and every loop that it watches with it.

use super::tags::{Tag, Tags, local, number};
use super::{MAX_CELLS, content, limits, ole, xlsb};
use crate::collect::table::error::TableError;
use crate::collect::table::kinds;
use std::io::{self, BufRead, BufReader, Cursor};

/// Texts that any workbook may say it has: some programs tell more than there are.
const FEW_TEXTS: u64 = 1 << 18;
/// Bytes that the library takes for a format of cells, beside two names.
const FORMAT: u64 = 512;

/// Refuses a workbook that would take far more memory than it has bytes.
pub fn look(bytes: &[u8]) -> Result<(), TableError> {
    if bytes.starts_with(kinds::OLE) {
        // The library opens an archive behind it where it finds no workbook in it.
        ole::look(bytes)?;
    }
    // What cannot be opened here cannot be opened there.
    let Ok(mut archive) = zip::ZipArchive::new(Cursor::new(bytes)) else { return Ok(()) };
    let is_binary = archive.file_names().flatten().any(|name| small(&name) == xlsb::BOOK);
    let (most, mut unpacked) = (limits::bytes(bytes.len() as u64), 0u64);
    for at in 0..archive.len() {
        let Ok(part) = archive.by_index(at) else { continue };
        let Ok(name) = part.name().map(|name| name.into_owned()) else { continue };
        // No part gives more than it says here: reading it ends with an error.
        unpacked = unpacked.saturating_add(part.size());
        if unpacked > most {
            return Err(TableError::refused(format!(
                "a workbook that unpacks to more than {most} bytes, from {}: save the columns that are needed as CSV",
                bytes.len()
            )));
        }
        let wrong = wrong(&name, BufReader::new(part), is_binary).map_err(|error| {
            TableError::refused(format!(
                "a workbook whose {name:?} cannot be read: {error}; save it again, or the columns that are needed as CSV"
            ))
        })?;
        if let Some(wrong) = wrong {
            return Err(TableError::refused(format!(
                "a workbook whose {name:?} {wrong}; save it again, or the columns that are needed as CSV"
            )));
        }
    }
    Ok(())
}

/// The name of a part as the library looks for it: it takes capital letters for small ones, and either slash for the other.
fn small(name: &str) -> String {
    name.to_ascii_lowercase().replace('\\', "/")
}

/// What a part says of itself that cannot be, or takes too much; `is_binary` for those of an `.xlsb`.
fn wrong(name: &str, part: impl BufRead, is_binary: bool) -> io::Result<Option<String>> {
    let small = small(name);
    if small.ends_with(".bin") {
        return xlsb::look(&small, part, is_binary).map(|()| None);
    }
    let mut tags = Tags::new(part);
    if small == xlsb::RELATIONS {
        return xlsb::relations(&mut tags).map(|()| None);
    }
    // The library finds these in any folder.
    if small.ends_with("sharedstrings.xml") {
        let told = texts(&mut tags)?;
        let is_wrong = told > FEW_TEXTS.max(tags.at);
        return Ok(is_wrong.then(|| format!("says that it holds {told} texts, in {} bytes", tags.at)));
    }
    if small.ends_with("styles.xml") {
        let taken = formats(&mut tags)?;
        let is_wrong = taken > limits::bytes(tags.at);
        return Ok(is_wrong.then(|| format!("has formats that take {taken} bytes, from {}", tags.at)));
    }
    if name == "content.xml" {
        let made = content::made(&mut tags)?;
        return Ok(if made.is_cut {
            Some("ends within a table: it is cut".into())
        } else if made.cells > MAX_CELLS as u64 {
            Some(format!("repeats cells to {} of them: {MAX_CELLS} are taken", made.cells))
        } else if made.bytes() > limits::bytes(tags.at) {
            Some(format!("repeats cells to {} bytes, from {}", made.bytes(), tags.at))
        } else {
            None
        });
    }
    Ok(None)
}

/// How many texts a list of them says it has: the library makes room for so many at once.
fn texts(tags: &mut Tags<impl BufRead>) -> io::Result<u64> {
    let mut told = None;
    while let Some(tag) = tags.tag()? {
        if let Tag::Begin(name, written) = tag
            && local(name) == b"sst"
        {
            // The library looks at the first.
            told = told.or(Some(number(written, "uniqueCount")));
        }
    }
    Ok(told.unwrap_or(0))
}

/// Bytes that the formats of cells take, each with the name of its font and how it writes numbers.
fn formats(tags: &mut Tags<impl BufRead>) -> io::Result<u64> {
    let (mut count, mut longest) = (0u64, 0u64);
    while let Some(tag) = tags.tag()? {
        let Tag::Begin(name, written) = tag else { continue };
        match local(name) {
            b"xf" => count += 1,
            b"numFmt" | b"name" => longest = longest.max(written.len() as u64),
            _ => {}
        }
    }
    Ok(count.saturating_mul(FORMAT.saturating_add(longest.saturating_mul(2))))
}
