//! Who may import whom. The sources are read as text, so that a rule broken behind a `use` group, a `super::super`
//! or a path in the middle of a line is found all the same; test code is free to import what it needs.
//!
//! Each rule is shown to fail on a small source that breaks it: a check that cannot fail checks nothing.

#[path = "architecture/allowed.rs"]
mod allowed;
#[path = "architecture/breaking.rs"]
mod breaking;
#[path = "architecture/circles.rs"]
mod circles;
#[path = "architecture/source.rs"]
mod source;

use allowed::*;
use circles::circles;
use source::Source;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Rule 1 to 4: which of our modules a file may import.
fn imports(source: &Source) -> Vec<String> {
    let top = source.top();
    let Some((_, allowed)) = MAY_IMPORT.iter().find(|(name, _)| *name == top) else {
        return vec![format!("{}: module {top} is not in MAY_IMPORT", source.path)];
    };
    let strangers = |path: &Vec<String>| {
        let other = path.get(1).filter(|_| path[0] == "crate")?;
        let known = MAY_IMPORT.iter().any(|(name, _)| name == other);
        (known && *other != top && !allowed.contains(&other.as_str())).then(|| other.clone())
    };
    let found: BTreeSet<String> = source.paths().iter().filter_map(strangers).collect();
    found.into_iter().map(|other| format!("{}: {top} must not import {other}", source.path)).collect()
}

/// Rule 1: what PURE modules and READERS may use from outside. `crates` are the names of all dependencies.
fn purity(source: &Source, crates: &[String]) -> Vec<String> {
    let reads = READERS.contains(&source.top().as_str());
    if !reads && !PURE.contains(&source.top().as_str()) {
        return Vec::new();
    }
    let outside = if reads { FORMATS } else { NUMERICS };
    let impure = |path: &Vec<String>| -> bool {
        let (first, second) = (path[0].as_str(), path.get(1).map(String::as_str));
        if reads && (asks_the_machine(path) || makes_a_file(path)) {
            return true;
        }
        match first {
            "std" | "core" | "alloc" => {
                second.is_some_and(|part| !PURE_STD.contains(&part)) && !(reads && is_of_reader(path))
            }
            "rand" if !reads => path[1..].iter().any(|part| UNSEEDED.contains(&part.as_str())),
            "serde" => false,
            _ if outside.contains(&first) => false,
            _ => crates.iter().any(|name| name == first) && path.len() > 1,
        }
    };
    let found: BTreeSet<String> =
        source.paths().iter().filter(|p| impure(p)).map(|path| path.join("::")).collect();
    found.into_iter().map(|path| format!("{}: a pure module uses {path}", source.path)).collect()
}

/// Whether a path leads into what READERS may use of std.
fn is_of_reader(path: &[String]) -> bool {
    let path = path.join("::");
    let leads =
        |own: &&str| path.strip_prefix(*own).is_some_and(|rest| rest.is_empty() || rest.starts_with("::"));
    READER_STD.iter().any(leads)
}

/// Whether a path is a function of a type that asks for the time or the zone of the machine: `Timestamp::now`.
fn asks_the_machine(path: &[String]) -> bool {
    path.len() > 1 && path.last().is_some_and(|last| OF_MACHINE.contains(&last.as_str()))
}

/// Whether a path is a function of `File` that does anything but open one to read it.
fn makes_a_file(path: &[String]) -> bool {
    path.windows(2).any(|pair| pair[0] == "File" && pair[1] != "open")
}

/// Rule 2: the daemon diagnoses by way of the scheduler only.
fn diagnosing(source: &Source) -> Vec<String> {
    let diagnoses = |name: &String| ["diagnose", "diagnose_gated", "*"].contains(&name.as_str());
    let calls = |path: &Vec<String>| {
        let ours = path[0] == "crate" && path.get(1).is_some_and(|top| top == "diagnosis");
        (ours || path[0] == "diagnosis") && path.last().is_some_and(diagnoses)
    };
    if MAY_DIAGNOSE.contains(&source.top().as_str()) || !source.paths().iter().any(calls) {
        return Vec::new();
    }
    vec![format!("{}: only the scheduler diagnoses, with the function that app gives it", source.path)]
}

/// Rule 3: serde in Config structs and DTOs.
fn serde(source: &Source) -> Vec<String> {
    let names_serde = |path: &Vec<String>| path[0] == "serde" || path[0] == "serde_json";
    let paths = source.paths();
    if !paths.iter().any(names_serde) || SERDE_PLACES.iter().any(|place| source.path.starts_with(place)) {
        return Vec::new();
    }
    if !CONFIG_FILES.contains(&source.path.as_str()) {
        return vec![format!("{}: serde belongs in Config structs and in serve::dto", source.path)];
    }
    let writes = paths.iter().any(|path| path[0] == "serde_json" || path.iter().any(|p| p == "Serialize"));
    if writes { vec![format!("{}: a Config is read, never written", source.path)] } else { Vec::new() }
}

/// The one file that may name a function that writes, and only where the feature `writeback` compiles it. The demo's own
/// plant takes such requests.
const WRITER: &str = "src/writeback/link.rs";

/// No other code that writes to a plant exists.
fn writing(source: &Source) -> Vec<String> {
    let writes = |name: &String| {
        let plain = name.to_lowercase().replace('_', "");
        [
            "writesingle",
            "writemultiple",
            "maskedwrite",
            "maskwrite",
            "readwritemultiple",
            "writevalue",
            "historyupdate",
        ]
        .iter()
        .any(|function| plain.starts_with(function))
    };
    if source.top() == "demo" || source.path == WRITER || !source.paths().iter().flatten().any(writes) {
        return Vec::new();
    }
    vec![format!("{}: names a function that writes", source.path)]
}

/// The database is the store's own: no other module names it, and nothing but the store writes samples to disk.
fn storing(source: &Source) -> Vec<String> {
    let names = |path: &Vec<String>| ["rusqlite", "zstd"].contains(&path[0].as_str()) && path.len() > 1;
    if source.top() == "store" || !source.paths().iter().any(names) {
        return Vec::new();
    }
    vec![format!("{}: only the store names its database", source.path)]
}

/// Size, and a head that says what the module is for.
fn shape(source: &Source) -> Vec<String> {
    let mut wrong = Vec::new();
    let lines = source.text.lines().count();
    if lines > MOST_LINES {
        wrong.push(format!("{}: {lines} lines, more than {MOST_LINES}", source.path));
    }
    let first = source.text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    let says_something = first.strip_prefix("//!").is_some_and(|doc| doc.trim().len() > 10);
    if !source.is_test() && !says_something {
        wrong.push(format!("{}: begin with //! and what the module is for", source.path));
    }
    wrong
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn sources() -> Vec<Source> {
    fn walk(folder: &Path, out: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).expect("src can be read").flatten() {
            let path = entry.path();
            if path.is_dir() {
                walk(&path, out);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                out.push(path);
            }
        }
    }
    let mut files = Vec::new();
    walk(&root().join("src"), &mut files);
    files.sort();
    assert!(files.len() > 20, "only {} sources found", files.len());
    let read = |path: &PathBuf| {
        let name = path.strip_prefix(root()).expect("below the root").to_string_lossy().replace('\\', "/");
        Source { path: name, text: fs::read_to_string(path).expect("a source can be read") }
    };
    files.iter().map(read).collect()
}

/// The names of all dependencies, as code writes them.
fn crates() -> Vec<String> {
    let of = |manifest: &str| -> Vec<String> {
        let text = fs::read_to_string(root().join(manifest)).expect("the manifest can be read");
        let manifest: toml::Table = text.parse().expect("the manifest is TOML");
        manifest["dependencies"]
            .as_table()
            .expect("a table")
            .keys()
            .map(|name| name.replace('-', "_"))
            .collect()
    };
    [of("Cargo.toml"), of("numerics/Cargo.toml"), of("tables/Cargo.toml")].concat()
}

fn everywhere(rule: impl Fn(&Source) -> Vec<String>) {
    let broken: Vec<String> = sources().iter().flat_map(rule).collect();
    assert!(broken.is_empty(), "\n{}\n", broken.join("\n"));
}

#[test]
fn every_module_imports_only_what_it_may() {
    everywhere(imports);
}

#[test]
fn pure_modules_are_pure() {
    let crates = crates();
    everywhere(|source| purity(source, &crates));
}

#[test]
fn only_the_scheduler_diagnoses() {
    everywhere(diagnosing);
}

#[test]
fn serde_lives_in_configs_and_dtos() {
    everywhere(serde);
}

#[test]
fn nothing_writes_to_a_plant() {
    everywhere(writing);
    let module = fs::read_to_string(root().join("src/writeback/mod.rs")).expect("a source can be read");
    for part in ["mod link;", "mod run;", "pub use link::{Clocks, Writer};"] {
        assert!(
            module.contains(&format!("#[cfg(feature = \"writeback\")]\n{part}")),
            "{part} is always there"
        );
    }
}

#[test]
fn only_the_store_names_its_database() {
    everywhere(storing);
    let refused = |text: &str| storing(&Source::new("src/app/persistence.rs", text)).len();
    assert_eq!(refused("use rusqlite::Connection;"), 1);
    assert_eq!(refused("fn f() { zstd::bulk::compress(b, 3) }"), 1);
    assert_eq!(refused("use crate::store::pack;"), 0);
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let sources = sources();
    let found: Vec<String> = NO_CIRCLES.iter().flat_map(|folder| circles(folder, &sources)).collect();
    assert!(found.is_empty(), "\n{}\n", found.join("\n"));
}

#[test]
fn files_are_short_and_say_what_they_are_for() {
    everywhere(shape);
}
