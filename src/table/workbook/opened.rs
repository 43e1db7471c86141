//! Which parts of an archive the library opens as XML. The others are not looked at: macros, forms and models of data may have any
//! form.

use super::tags::{Tag, Tags, attributes, local};
use super::xlsb;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, BufReader, Cursor};

/// What is in every workbook of Excel that is an archive, and in every one of OpenDocument.
pub const PART_OF_EXCEL: &str = "[Content_Types].xml";
pub const PART_OF_OPEN_DOCUMENT: &str = "content.xml";
/// The part of OpenDocument that tells whether the others are encrypted, and the list of an `.xlsx` that leads to its workbook, in
/// small letters.
const MANIFEST: &str = "meta-inf/manifest.xml";
const PACKAGE: &str = "_rels/.rels";
/// Parts of an `.xlsx` that lie in the folder of its workbook, in small letters.
const BESIDE: [&str; 3] = ["sharedstrings.xml", "styles.xml", "theme/theme1.xml"];

/// An archive in memory.
pub type Archive<'b> = zip::ZipArchive<Cursor<&'b [u8]>>;

/// As what the library opens an archive.
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
    /// The kind that the names of its parts make it.
    pub fn of(parts: &[String]) -> Self {
        let has = |own: &str| parts.iter().any(|name| name == own);
        if parts.iter().any(|name| small(name) == xlsb::BOOK) {
            Self::Binary
        } else if has(PART_OF_OPEN_DOCUMENT) && !has(PART_OF_EXCEL) {
            Self::OpenDocument
        } else {
            Self::Excel
        }
    }

    /// The names, in small letters, of all parts that the library opens as XML, and of few others. A list of parts is read until its
    /// entries take more than `most` bytes in the library: such a workbook is refused for that.
    pub fn opened(self, archive: &mut Archive<'_>, most: u64) -> BTreeSet<String> {
        match self {
            Self::Excel => of_excel(archive, most),
            Self::Binary => BTreeSet::from([xlsb::RELATIONS.to_string()]),
            Self::OpenDocument => BTreeSet::from([PART_OF_OPEN_DOCUMENT, MANIFEST].map(str::to_string)),
        }
    }
}

/// The name of a part as the library looks for it: it takes capital letters for small ones, and either slash for the other.
pub fn small(name: &str) -> String {
    name.to_ascii_lowercase().replace('\\', "/")
}

/// The parts of an `.xlsx`: the list of the package leads to the workbook, and a list beside that to the sheets.
fn of_excel(archive: &mut Archive<'_>, most: u64) -> BTreeSet<String> {
    let package = BTreeMap::from([(PACKAGE.to_string(), String::new())]);
    let books = listed(archive, &package, most);
    let (mut opened, mut lists) = (BTreeSet::from([PACKAGE.to_string()]), BTreeMap::new());
    for book in &books {
        let (folder, name) = book.split_at(book.rfind('/').map_or(0, |slash| slash + 1));
        opened.extend(BESIDE.map(|part| format!("{folder}{part}")));
        lists.insert(format!("{folder}_rels/{name}.rels"), folder.to_string());
    }
    opened.extend(listed(archive, &lists, most));
    opened.extend(books);
    opened.extend(lists.into_keys());
    opened
}

/// The names, in small letters, of the workbooks and sheets in lists of parts; `lists` has the names of these, and the folder that
/// the places in each begin in.
fn listed(archive: &mut Archive<'_>, lists: &BTreeMap<String, String>, most: u64) -> BTreeSet<String> {
    let folder_of = |name: &str| lists.get(&small(name)).cloned();
    let found: Vec<Option<String>> =
        archive.file_names().map(|name| name.ok().and_then(|name| folder_of(&name))).collect();
    let mut names = BTreeSet::new();
    for (at, folder) in found.into_iter().enumerate() {
        let Some(folder) = folder else { continue };
        let Ok(part) = archive.by_index(at) else { continue };
        let mut tags = Tags::new(BufReader::new(part));
        // What is wrong with a list is told when it is looked at as a part.
        while let Ok(Some(tag)) = tags.tag() {
            if let Tag::Begin(name, written) = tag
                && local(name) == b"Relationship"
            {
                let places = places(written).filter(|place| is_looked_at(place));
                let places = places.filter_map(|place| str::from_utf8(place).ok());
                names.extend(places.map(|place| match place.strip_prefix('/') {
                    Some(whole) => small(whole),
                    None => small(&format!("{folder}{place}")),
                }));
            }
            if tags.listed > most {
                break;
            }
        }
    }
    names
}

/// The places of a workbook or a sheet among the attributes of a part in a list.
fn places(written: &[u8]) -> impl Iterator<Item = &[u8]> {
    const KINDS: [&[u8]; 4] = [b"officeDocument", b"worksheet", b"chartsheet", b"dialogsheet"];
    let is_looked_for = attributes(written)
        .filter(|(name, _)| *name == b"Type")
        .filter_map(|(_, kind)| kind.rsplit(|byte| *byte == b'/').next())
        .any(|kind| KINDS.contains(&kind));
    let targets = attributes(written).filter(|(name, _)| *name == b"Target").map(|(_, place)| place);
    targets.filter(move |_| is_looked_for)
}

/// Whether a place is one that is looked at as XML, in whatever folder.
fn is_looked_at(place: &[u8]) -> bool {
    xlsb::is_plain(place) && !place.contains(&b'\\') && place.to_ascii_lowercase().ends_with(b".xml")
}

/// Refuses a list of parts that has a sheet, or the list of sheets, in a part that is not looked at, or under a long name.
///
/// # Errors
/// A place where Excel puts neither.
pub fn relation(written: &[u8]) -> io::Result<()> {
    match places(written).find(|place| !is_looked_at(place)) {
        Some(place) => Err(xlsb::misplaced(place)),
        None => Ok(()),
    }
}
