//! Relationship parts (`.rels`) of workbooks of Excel. They lead from the package to the workbook, and from the workbook to its
//! sheets; so they say which parts the library opens.

use super::archive::{Archive, Kind, normalized};
use super::tags::{Tag, Tags, attributes, local};
use super::xlsb;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, BufReader};

/// The element of one relationship, without its prefix.
pub const RELATIONSHIP: &[u8] = b"Relationship";
/// Last words of the types of relationships that lead to a workbook or to a sheet.
const TYPES: [&[u8]; 4] = [b"officeDocument", b"worksheet", b"chartsheet", b"dialogsheet"];
/// Most bytes of the path of a part: paths in Windows are no longer.
const LONGEST_PATH: usize = 260;

/// The normalized names of the workbooks and sheets in XML that relationship parts lead to. `folders` has the folder that the paths
/// of each part are relative to, by the part's normalized name. A part is not read beyond the entries that take more than
/// `memory_limit` bytes in the library.
pub fn xml_targets(
    archive: &mut Archive,
    folders: &BTreeMap<String, String>,
    memory_limit: u64,
) -> BTreeSet<String> {
    let folder_of = |name: &str| folders.get(&normalized(name)).cloned();
    let found: Vec<Option<String>> =
        archive.file_names().map(|name| name.ok().and_then(|name| folder_of(&name))).collect();
    let mut names = BTreeSet::new();
    for (at, folder) in found.into_iter().enumerate() {
        let Some(folder) = folder else { continue };
        let Ok(part) = archive.by_index(at) else { continue };
        let mut tags = Tags::new(BufReader::new(part));
        // An error in a relationship part is reported when it is itself looked at as a part.
        while let Ok(Some(tag)) = tags.tag() {
            if let Tag::Begin(name, written) = tag
                && local(name) == RELATIONSHIP
            {
                let paths = opened_targets(written).filter(|path| is_xml(path));
                let paths = paths.filter_map(|path| str::from_utf8(path).ok());
                names.extend(paths.map(|path| match path.strip_prefix('/') {
                    Some(whole) => normalized(whole),
                    None => normalized(&format!("{folder}{path}")),
                }));
            }
            if tags.listed > memory_limit {
                break;
            }
        }
    }
    names
}

/// Checks a relationship by its attributes: what the library opens as a workbook or as a sheet has to be a part that is looked at.
///
/// # Errors
/// A path where Excel puts neither.
pub fn check(written: &[u8], kind: Kind) -> io::Result<()> {
    let misplaced = match kind {
        Kind::Binary => targets(written).find(|path| !is_plain(path) || xlsb::is_misplaced_sheet(path)),
        Kind::Excel | Kind::OpenDocument => opened_targets(written).find(|path| !is_xml(path)),
    };
    let Some(path) = misplaced else { return Ok(()) };
    let path = String::from_utf8_lossy(&path[..path.len().min(LONGEST_PATH)]).into_owned();
    Err(io::Error::other(format!("it lists a part at {path:?}, where Excel puts none")))
}

/// The paths of a relationship.
fn targets(written: &[u8]) -> impl Iterator<Item = &[u8]> {
    attributes(written).filter(|(name, _)| *name == b"Target").map(|(_, path)| path)
}

/// The paths of a relationship that leads to a workbook or to a sheet; none of any other.
fn opened_targets(written: &[u8]) -> impl Iterator<Item = &[u8]> {
    let leads_to_one = attributes(written)
        .filter(|(name, _)| *name == b"Type")
        .filter_map(|(_, kind)| kind.rsplit(|byte| *byte == b'/').next())
        .any(|kind| TYPES.contains(&kind));
    targets(written).filter(move |_| leads_to_one)
}

/// Whether the part at a path is looked at as XML, in any folder.
fn is_xml(path: &[u8]) -> bool {
    is_plain(path) && !path.contains(&b'\\') && path.to_ascii_lowercase().ends_with(b".xml")
}

/// Whether a path is short, and has no entities that would change it.
fn is_plain(path: &[u8]) -> bool {
    path.len() <= LONGEST_PATH && !path.contains(&b'&')
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is wrong with a relationship; nothing where it is sound.
    fn said(written: &str, kind: Kind) -> String {
        check(written.as_bytes(), kind).err().map(|error| error.to_string()).unwrap_or_default()
    }

    #[test]
    fn sheets_of_an_xlsx_are_parts_that_are_looked_at() {
        let said = |kind: &str, path: &str| {
            said(&format!(" Type=\"http://a/relationships/{kind}\" Target=\"{path}\""), Kind::Excel)
        };
        let long = format!("{}.xml", "x".repeat(LONGEST_PATH));
        for path in ["worksheets/sheet1.xml", "/xl/worksheets/Sheet1.XML"] {
            assert_eq!(said("worksheet", path), "");
        }
        for path in ["media/image1.png", "a&#46;xml", long.as_str()] {
            for kind in ["worksheet", "officeDocument"] {
                assert!(said(kind, path).contains("it lists a part at \""), "{kind} {path}");
            }
            assert_eq!(said("image", path), "", "it is not opened");
        }
    }

    #[test]
    fn sheets_of_an_xlsb_lie_where_they_are_looked_at() {
        let said = |path: &str| said(&format!(" Id='r' Target=\"{path}\""), Kind::Binary);
        for sound in
            ["worksheets/sheet1.bin", "WorkSheets/Sheet1.BIN", "theme/theme1.xml", "sharedStrings.bin"]
        {
            assert_eq!(said(sound), "");
        }
        let long = format!("worksheets/{}.bin", "x".repeat(LONGEST_PATH));
        for path in ["worksheets/_rels/sheet1.bin.rels", "w&#111;rksheets/sheet1.xml", long.as_str()] {
            assert!(said(path).contains("it lists a part at \""), "{path}");
        }
    }
}
