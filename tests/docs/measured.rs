//! No number in the documents is still to be measured.

use super::{DOCUMENTS, read, root};
use std::collections::BTreeSet;
use std::fs;

/// What stands where a number is still to be measured, in two parts, so that it does not stand here.
const MARK: [&str; 2] = ["MEASURE", "_ME"];

/// Every document below the root, `docs` and `deploy`, also one that nobody listed.
fn documents() -> BTreeSet<String> {
    let below = |folder: &str| {
        let entries = fs::read_dir(root().join(folder)).expect("it can be read").flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let names = names.filter(|name| name.ends_with(".md"));
        let named = |name: String| if folder.is_empty() { name } else { format!("{folder}/{name}") };
        names.map(named).collect::<Vec<_>>()
    };
    ["", "docs", "deploy"].into_iter().flat_map(below).collect()
}

#[test]
fn every_number_of_the_documents_is_measured() {
    let (mark, found) = (MARK.concat(), documents());
    for name in DOCUMENTS {
        assert!(found.contains(*name), "{name} was not looked through");
    }
    let open: Vec<String> = found
        .iter()
        .flat_map(|name| {
            let text = read(name);
            let lines = text.lines().enumerate().filter(|(_, line)| line.contains(&mark));
            lines.map(|(at, _)| format!("{name}:{}", at + 1)).collect::<Vec<_>>()
        })
        .collect();
    assert!(open.is_empty(), "still to be measured: {open:?}");
}
