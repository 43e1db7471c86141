//! The archive that every workbook but an `.xls` is: the names of its parts, and the kind of workbook that they make.

use super::xlsb;
use crate::table::error::{TableError, listed};
use std::io::Cursor;
use std::sync::Arc;

/// A part that every workbook of Excel has that is an archive.
const PART_OF_EXCEL: &str = "[Content_Types].xml";
/// The part of OpenDocument that has the sheets.
pub const PART_OF_OPEN_DOCUMENT: &str = "content.xml";

/// An archive in memory.
pub type Archive = zip::ZipArchive<Cursor<Arc<[u8]>>>;

/// The names of the parts of an archive.
pub fn part_names(archive: &Archive) -> Vec<String> {
    archive.file_names().flatten().map(|name| name.into_owned()).collect()
}

/// Refuses an archive of files that is no workbook, by what is in it.
///
/// # Errors
/// The names of its parts.
pub fn refuse_other_archive(parts: &[String]) -> Result<(), TableError> {
    let is_of_workbook = |name: &String| [PART_OF_EXCEL, PART_OF_OPEN_DOCUMENT].contains(&name.as_str());
    if parts.is_empty() || parts.iter().any(is_of_workbook) {
        return Ok(());
    }
    let names = listed(parts.iter().map(String::as_str));
    Err(TableError::refused(format!("a ZIP archive, no table: it holds {names}; unpack it first")))
}

/// The name of a part as the library compares it: it ignores case, and takes `\` for `/`.
pub fn normalized(name: &str) -> String {
    name.to_ascii_lowercase().replace('\\', "/")
}

/// The kind of workbook as which the library opens an archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// `.xlsx`
    Excel,
    /// `.xlsb`
    Binary,
    /// `.ods`
    OpenDocument,
}

impl Kind {
    /// The kind of an archive, by the names of its parts.
    pub fn of(parts: &[String]) -> Self {
        let has = |own: &str| parts.iter().any(|name| name == own);
        if parts.iter().any(|name| normalized(name) == xlsb::WORKBOOK) {
            Self::Binary
        } else if has(PART_OF_OPEN_DOCUMENT) && !has(PART_OF_EXCEL) {
            Self::OpenDocument
        } else {
            Self::Excel
        }
    }
}
