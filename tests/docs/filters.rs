//! The tests that the documents name by a command are there: a test that is renamed would else be shown by nothing.

use super::{DOCUMENTS, read, root};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// The words behind each `cargo nextest run` of a document, up to the end of the command.
fn commands(text: &str) -> Vec<Vec<&str>> {
    let behind = text.split("`cargo nextest run ").skip(1).filter_map(|rest| rest.split('`').next());
    behind.map(|command| command.split_whitespace().collect()).collect()
}

/// The paths of all Rust files at or below a path, and the lines of them that name a function or a module.
fn names(path: &Path) -> String {
    let mut out = String::new();
    let below = fs::read_dir(path).into_iter().flatten().flatten();
    below.for_each(|entry| out += &names(&entry.path()));
    if path.extension().is_some_and(|end| end == "rs") {
        let own = path.strip_prefix(root()).unwrap_or(path).with_extension("");
        out += &format!("{}\n", own.display());
        let text = fs::read_to_string(path).unwrap_or_default();
        let is_name = |line: &&str| ["fn ", "mod "].iter().any(|word| line.contains(word));
        text.lines().filter(is_name).for_each(|line| out += &format!("{line}\n"));
    }
    out
}

/// The names at or below a path, which are read once.
type Known = BTreeMap<PathBuf, String>;

/// What a command runs, as far as it is named here; why that is not there.
fn missing(command: &[&str], known: &mut Known) -> Option<String> {
    let (mut sources, mut filters, mut words) = (None, Vec::new(), command.iter());
    while let Some(word) = words.next() {
        match *word {
            // Of a crate beside ours.
            "-p" => return None,
            "--lib" => sources = Some(vec![root().join("src")]),
            "--test" => {
                let place = root().join("tests").join(words.next()?);
                let file = place.with_extension("rs");
                if !file.exists() && !place.exists() {
                    return Some(format!("{}: no such test", place.display()));
                }
                sources = Some(vec![file, place]);
            }
            option if option.starts_with('-') => {}
            filter => filters.push(filter),
        }
    }
    let sources = sources?;
    for path in &sources {
        known.entry(path.clone()).or_insert_with(|| names(path));
    }
    let known = &*known;
    let is_named = |part: &str| sources.iter().any(|path| known[path].contains(part));
    let is_there = |filter: &&str| filter.split("::").all(is_named);
    filters.iter().find(|filter| !is_there(filter)).map(|filter| format!("no test is called {filter}"))
}

#[test]
fn every_test_that_a_document_names_is_there() {
    let (mut count, mut wrong, mut known) = (0, Vec::new(), Known::new());
    for name in DOCUMENTS {
        let text = read(name);
        for command in commands(&text) {
            count += 1;
            wrong.extend(
                missing(&command, &mut known).map(|why| format!("{name}: {}: {why}", command.join(" "))),
            );
        }
    }
    assert!(count > 50, "only {count} commands found");
    assert!(wrong.is_empty(), "\n{}\n", wrong.join("\n"));
}

#[test]
fn a_test_that_is_not_there_is_missed() {
    let mut known = Known::new();
    let mut of = |command: &str| missing(&command.split(' ').collect::<Vec<_>>(), &mut known);
    assert_eq!(of("--test docs filters::a_test_that_is_not_there"), None);
    assert_eq!(of("--lib ledger:: --no-capture"), None);
    // In two parts, or its name would stand here.
    let strange = ["nobody_has", "called_a_test_so"].join("_");
    assert!(of(&format!("--test docs {strange}")).is_some_and(|why| why.contains(&strange)));
    assert!(of("--test no_such_file").is_some_and(|why| why.contains("no such test")));
}
