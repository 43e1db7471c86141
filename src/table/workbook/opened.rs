//! Which parts of an archive the library opens as XML. The others are not looked at: macros, forms and data models may hold
//! anything.

use super::tags::{Tag, Tags, attributes, local};
use super::xlsb;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, BufReader, Cursor};

/// A part that every workbook of Excel has that is an archive.
pub const PART_OF_EXCEL: &str = "[Content_Types].xml";
/// The part of OpenDocument that has the sheets.
pub const PART_OF_OPEN_DOCUMENT: &str = "content.xml";
/// The part of OpenDocument that tells whether the others are encrypted, in small letters.
const MANIFEST: &str = "meta-inf/manifest.xml";
/// The list of parts of an `.xlsx` that leads to its workbook, in small letters.
const PACKAGE: &str = "_rels/.rels";
/// Parts of an `.xlsx` that lie in the folder of its workbook, in small letters.
const BESIDE: [&str; 3] = ["sharedstrings.xml", "styles.xml", "theme/theme1.xml"];

/// An archive in memory.
pub type Archive<'b> = zip::ZipArchive<Cursor<&'b [u8]>>;

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
        if parts.iter().any(|name| small(name) == xlsb::BOOK) {
            Self::Binary
        } else if has(PART_OF_OPEN_DOCUMENT) && !has(PART_OF_EXCEL) {
            Self::OpenDocument
        } else {
            Self::Excel
        }
    }

    /// The names, in small letters, of all parts that the library opens as XML, and of a few others. A list of parts is not read
    /// beyond the entries that take `most` bytes in the library: such a workbook is refused later.
    pub fn opened(self, archive: &mut Archive<'_>, most: u64) -> BTreeSet<String> {
        match self {
            Self::Excel => of_excel(archive, most),
            Self::Binary => BTreeSet::from([xlsb::RELATIONS.to_string()]),
            Self::OpenDocument => BTreeSet::from([PART_OF_OPEN_DOCUMENT, MANIFEST].map(str::to_string)),
        }
    }
}

/// The name of a part as the library compares it: it ignores case, and takes `\` for `/`.
pub fn small(name: &str) -> String {
    name.to_ascii_lowercase().replace('\\', "/")
}

/// The parts of an `.xlsx`: the list of the package names the workbook, and a list beside the workbook names the sheets.
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

/// The names, in small letters, of the workbooks and sheets that lists of parts name; `lists` has the name of each list, and the
/// folder that its paths are relative to.
fn listed(archive: &mut Archive<'_>, lists: &BTreeMap<String, String>, most: u64) -> BTreeSet<String> {
    let folder_of = |name: &str| lists.get(&small(name)).cloned();
    let found: Vec<Option<String>> =
        archive.file_names().map(|name| name.ok().and_then(|name| folder_of(&name))).collect();
    let mut names = BTreeSet::new();
    for (at, folder) in found.into_iter().enumerate() {
        let Some(folder) = folder else { continue };
        let Ok(part) = archive.by_index(at) else { continue };
        let mut tags = Tags::new(BufReader::new(part));
        // An error in a list is reported when the list itself is looked at as a part.
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

/// The paths in an entry of a list of parts, if the entry is a workbook or a sheet.
fn places(written: &[u8]) -> impl Iterator<Item = &[u8]> {
    const KINDS: [&[u8]; 4] = [b"officeDocument", b"worksheet", b"chartsheet", b"dialogsheet"];
    let is_looked_for = attributes(written)
        .filter(|(name, _)| *name == b"Type")
        .filter_map(|(_, kind)| kind.rsplit(|byte| *byte == b'/').next())
        .any(|kind| KINDS.contains(&kind));
    let targets = attributes(written).filter(|(name, _)| *name == b"Target").map(|(_, place)| place);
    targets.filter(move |_| is_looked_for)
}

/// Whether the part at a path is looked at as XML, in any folder.
fn is_looked_at(place: &[u8]) -> bool {
    xlsb::is_plain(place) && !place.contains(&b'\\') && place.to_ascii_lowercase().ends_with(b".xml")
}

/// Looks at an entry of a list of parts: a workbook or a sheet has to be in a part that is looked at.
///
/// # Errors
/// A path where Excel puts neither.
pub fn relation(written: &[u8]) -> io::Result<()> {
    match places(written).find(|place| !is_looked_at(place)) {
        Some(place) => Err(xlsb::misplaced(place)),
        None => Ok(()),
    }
}
