//! Which parts of an archive the library opens as XML. The others are not looked at: macros, forms and data models may hold
//! anything.

use super::archive::{Archive, Kind, PART_OF_OPEN_DOCUMENT};
use super::{relations, xlsb};
use std::collections::{BTreeMap, BTreeSet};

/// The part of OpenDocument that tells whether the others are encrypted, normalized.
const MANIFEST: &str = "meta-inf/manifest.xml";
/// The relationship part of an `.xlsx` that leads to its workbook, normalized.
const PACKAGE: &str = "_rels/.rels";
/// Parts of an `.xlsx` that lie in the folder of its workbook, normalized: the library opens them without a relationship.
const BESIDE_WORKBOOK: [&str; 3] = ["sharedstrings.xml", "styles.xml", "theme/theme1.xml"];

/// The normalized names of all parts that the library opens as XML, and of a few others. A relationship part is not read beyond
/// the entries that take more than `memory_limit` bytes in the library: such a workbook is refused later.
pub fn xml_parts(archive: &mut Archive, kind: Kind, memory_limit: u64) -> BTreeSet<String> {
    match kind {
        Kind::Excel => of_excel(archive, memory_limit),
        Kind::Binary => BTreeSet::from([xlsb::RELATIONS.to_string()]),
        Kind::OpenDocument => BTreeSet::from([PART_OF_OPEN_DOCUMENT, MANIFEST].map(str::to_string)),
    }
}

/// The parts of an `.xlsx`: one relationship part leads from the package to the workbook, another from the workbook to the sheets.
fn of_excel(archive: &mut Archive, memory_limit: u64) -> BTreeSet<String> {
    let package = BTreeMap::from([(PACKAGE.to_string(), String::new())]);
    let workbooks = relations::xml_targets(archive, &package, memory_limit);
    let (mut opened, mut of_workbooks) = (BTreeSet::from([PACKAGE.to_string()]), BTreeMap::new());
    for workbook in &workbooks {
        let (folder, name) = workbook.split_at(workbook.rfind('/').map_or(0, |slash| slash + 1));
        opened.extend(BESIDE_WORKBOOK.map(|part| format!("{folder}{part}")));
        of_workbooks.insert(format!("{folder}_rels/{name}.rels"), folder.to_string());
    }
    opened.extend(relations::xml_targets(archive, &of_workbooks, memory_limit));
    opened.extend(workbooks);
    opened.extend(of_workbooks.into_keys());
    opened
}
