//! Who may import whom. The sources are read as text, so that a rule broken behind a `use` group, a `super::super`
//! or a path in the middle of a line is found all the same; test code is free to import what it needs.
//!
//! Each rule is shown to fail on a small source that breaks it: a check that cannot fail checks nothing.

#[path = "architecture/circles.rs"]
mod circles;
#[path = "architecture/source.rs"]
mod source;

use circles::circles;
use source::Source;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Top modules and what each may import of the others. A module that is not listed is refused: say here who may see it.
const MAY_IMPORT: &[(&str, &[&str])] = &[
    ("signal", &[]),
    ("sysid", &["signal"]),
    ("diagnosis", &["signal", "sysid"]),
    ("sim", &["signal"]),
    ("detectors", &["signal", "sysid", "diagnosis"]),
    ("residual", &["signal", "sysid", "diagnosis"]),
    ("indicators", &["signal", "sysid", "diagnosis", "detectors", "residual"]),
    ("plantwide", &["signal", "sysid", "diagnosis", "detectors", "indicators"]),
    ("compensation", &["signal"]),
    ("plot", &[]),
    ("reproduce", &["signal", "diagnosis", "sim", "compensation", "plot"]),
    ("alarm", &["signal"]),
    ("access", &[]),
    ("audit", &[]),
    ("host", &[]),
    ("bounded", &[]),
    ("quiet", &[]),
    ("mqtt", &[]),
    ("collect", &["signal", "bounded", "host", "mqtt"]),
    ("notify", &["signal", "alarm", "bounded", "results", "host", "mqtt"]),
    ("history", &["signal"]),
    ("store", &["signal", "bounded"]),
    ("results", &["signal", "compensation", "alarm", "detectors", "diagnosis", "residual"]),
    ("backfill", &["signal", "alarm", "diagnosis", "results"]),
    ("schedule", &["signal", "diagnosis", "residual", "results"]),
    ("writeback", &["signal", "compensation", "audit"]),
    (
        "serve",
        &[
            "signal",
            "sysid",
            "access",
            "audit",
            "compensation",
            "alarm",
            "detectors",
            "diagnosis",
            "residual",
            "history",
            "results",
            "backfill",
            "schedule",
            "plot",
            "host",
            "quiet",
        ],
    ),
    (
        "config",
        &[
            "signal",
            "access",
            "audit",
            "alarm",
            "diagnosis",
            "collect",
            "history",
            "schedule",
            "serve",
            "store",
            "notify",
            "writeback",
        ],
    ),
    (
        "app",
        &[
            "signal",
            "compensation",
            "access",
            "alarm",
            "audit",
            "detectors",
            "diagnosis",
            "residual",
            "collect",
            "history",
            "results",
            "schedule",
            "backfill",
            "serve",
            "store",
            "notify",
            "writeback",
            "config",
        ],
    ),
    (
        "demo",
        &[
            "signal",
            "sim",
            "compensation",
            "collect",
            "results",
            "schedule",
            "serve",
            "writeback",
            "config",
            "app",
        ],
    ),
    (
        "cli",
        &[
            "signal",
            "quiet",
            "sysid",
            "access",
            "plot",
            "audit",
            "detectors",
            "diagnosis",
            "residual",
            "collect",
            "history",
            "serve",
            "schedule",
            "store",
            "config",
            "app",
            "demo",
            "reproduce",
            "backfill",
            "alarm",
            "results",
            "indicators",
            "plantwide",
        ],
    ),
    ("lib", &[]),
    ("numerics", &[]),
    ("main", &["cli"]),
];

/// No clock, file, socket, task, log or unseeded number: the same input gives the same answer.
const PURE: &[&str] = &[
    "signal",
    "sysid",
    "diagnosis",
    "detectors",
    "residual",
    "indicators",
    "plantwide",
    "sim",
    "compensation",
    "alarm",
];
/// What PURE modules may use from outside.
const NUMERICS: &[&str] =
    &["multiversion", "nalgebra", "realfft", "rand", "rand_distr", "rand_pcg", "thiserror"];
/// What of std PURE modules may use.
const PURE_STD: &[&str] = &[
    "array",
    "borrow",
    "cell",
    "cmp",
    "collections",
    "convert",
    "error",
    "f64",
    "fmt",
    "hash",
    "iter",
    "mem",
    "num",
    "ops",
    "rc",
    "result",
    "slice",
    "str",
    "string",
    "sync",
    "vec",
];
/// Names that draw random numbers from the machine.
const UNSEEDED: &[&str] = &["rng", "thread_rng", "random", "OsRng", "SysRng", "from_os_rng", "ThreadRng"];

/// Files that hold a `Config` of their component, or a part of one: they may read it, and write nothing.
const CONFIG_FILES: &[&str] = &[
    "src/access/config.rs",
    "src/alarm/config.rs",
    "src/audit/config.rs",
    "src/collect/modbus/config.rs",
    "src/collect/mqtt/config.rs",
    "src/collect/opcua/config.rs",
    "src/collect/table/options.rs",
    "src/collect/text_value.rs",
    "src/diagnosis/config.rs",
    "src/history/mod.rs",
    "src/notify/alertmanager/config.rs",
    "src/notify/batch.rs",
    "src/notify/config.rs",
    "src/notify/filter.rs",
    "src/notify/mqtt/config.rs",
    "src/notify/postman.rs",
    "src/notify/smtp/config.rs",
    "src/notify/webhook/config.rs",
    "src/schedule.rs",
    "src/serve/mod.rs",
    "src/serve/tls.rs",
    "src/store/config.rs",
    "src/writeback/config.rs",
];
/// Other places that may name serde: the file of users and tokens, a broker's messages, what receivers are sent, the loader of the file, the DTOs, and where those are turned from and into text.
const SERDE_PLACES: &[&str] = &[
    "src/access/file.rs",
    "src/collect/mqtt/json.rs",
    "src/collect/mqtt/probe.rs",
    "src/notify/letters.rs",
    "src/notify/mqtt/message.rs",
    "src/notify/payload.rs",
    "src/config/",
    "src/serve/dto/",
    "src/serve/api/",
    "src/serve/extract.rs",
    "src/serve/problem.rs",
    "src/cli/backfill.rs",
    "src/cli/benchmark.rs",
    "src/cli/diagnose.rs",
    "src/cli/plant/json.rs",
    "src/reproduce/json.rs",
    "src/cli/reproduce.rs",
];

/// Who may name the function that diagnoses: its own module, the wiring (which hands it to the scheduler), the command line,
/// and the report, which is no part of the daemon.
const MAY_DIAGNOSE: &[&str] = &["diagnosis", "app", "cli", "reproduce"];

/// Folders whose files import each other in no circle: each imports a thing from the file where it stands, and its folder's own
/// file only where that imports nothing of the folder.
const NO_CIRCLES: &[&str] = &[
    "src/alarm",
    "src/backfill",
    "src/demo",
    "src/history",
    "src/mqtt",
    "src/notify",
    "src/reproduce",
    "src/schedule",
    "src/writeback",
];

/// Longest file (lines).
const MOST_LINES: usize = 520;

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

/// Rule 1: what PURE modules may use from outside. `crates` are the names of all dependencies.
fn purity(source: &Source, crates: &[String]) -> Vec<String> {
    if !PURE.contains(&source.top().as_str()) {
        return Vec::new();
    }
    let impure = |path: &Vec<String>| -> bool {
        let (first, second) = (path[0].as_str(), path.get(1).map(String::as_str));
        match first {
            "std" | "core" | "alloc" => second.is_some_and(|part| !PURE_STD.contains(&part)),
            "rand" => path[1..].iter().any(|part| UNSEEDED.contains(&part.as_str())),
            "serde" => false,
            _ if NUMERICS.contains(&first) => false,
            _ => crates.iter().any(|name| name == first) && path.len() > 1,
        }
    };
    let found: BTreeSet<String> =
        source.paths().iter().filter(|p| impure(p)).map(|path| path.join("::")).collect();
    found.into_iter().map(|path| format!("{}: a pure module uses {path}", source.path)).collect()
}

/// Rule 2: the daemon diagnoses by way of the scheduler only.
fn diagnosing(source: &Source) -> Vec<String> {
    let calls = |path: &Vec<String>| {
        let ours = path[0] == "crate" && path.get(1).is_some_and(|top| top == "diagnosis");
        (ours || path[0] == "diagnosis") && path.last().is_some_and(|name| name == "diagnose" || name == "*")
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
    [of("Cargo.toml"), of("numerics/Cargo.toml")].concat()
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
    for part in ["mod link;", "mod run;", "pub use link::Writer;"] {
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

#[test]
fn a_forbidden_import_is_found_however_it_is_written() {
    let refused = |path: &str, text: &str| imports(&Source::new(path, text));
    for text in [
        "use crate::serve::Config;",
        "use crate::{history, serve::{self, dto::Report}};",
        "use super::super::serve;",
        "fn f() -> crate::serve::Config { todo() }",
        "use stictiond::serve;",
        "pub use crate::serve::Config as Other;",
        "/* a \" quote */ const S: &str = r#\"\"#; use crate::serve;",
    ] {
        let found = refused("src/collect/csv.rs", text);
        assert!(
            found.contains(&"src/collect/csv.rs: collect must not import serve".into()),
            "{text}: {found:?}"
        );
    }
    assert_eq!(refused("src/schedule.rs", "use crate::app::App;").len(), 1);
    assert_eq!(refused("src/signal.rs", "use crate::sim;").len(), 1);
    assert_eq!(refused("src/news/mod.rs", "").len(), 1, "a module nobody has placed");
}

#[test]
fn what_only_looks_like_an_import_is_let_through() {
    for text in [
        "// use crate::serve;",
        "/// [`crate::serve`]",
        "const TEXT: &str = \"use crate::serve;\";",
        "const TEXT: &str = r#\"a \" crate::serve \"#;",
        "#[cfg(test)] mod tests { use crate::serve; fn f() { { } } }",
        "use crate::signal::Sample; const Q: char = '\"'; fn f<'a>(x: &'a str) {}",
        "use super::csv; use self::serve;",
    ] {
        assert_eq!(imports(&Source::new("src/collect/modbus.rs", text)), [""; 0], "{text}");
    }
}

#[test]
fn a_clock_a_file_a_task_or_chance_in_a_pure_module_is_found() {
    let crates = ["tokio", "tracing", "rand", "nalgebra"].map(String::from);
    let refused = |text: &str| purity(&Source::new("src/diagnosis/armax.rs", text), &crates);
    for text in [
        "use std::time::Instant;",
        "use std::{fmt, fs};",
        "fn f() { std::thread::yield_now() }",
        "use std::net::TcpStream;",
        "fn f() { tracing::info!(n) }",
        "use tokio::sync::watch;",
        "use rand::rng;",
        "fn f() -> f64 { rand::random() }",
    ] {
        assert_eq!(refused(text).len(), 1, "{text}");
    }
    assert_eq!(
        refused("use std::fmt; use nalgebra::DMatrix; use rand::RngExt; use std::f64::consts::PI;"),
        [""; 0]
    );
}

#[test]
fn a_call_around_the_scheduler_is_found() {
    let refused = |text: &str| diagnosing(&Source::new("src/serve/api/loops.rs", text)).len();
    assert_eq!(refused("use crate::diagnosis::{Settings, diagnose};"), 1);
    assert_eq!(refused("fn f() { crate::diagnosis::verdict::diagnose(r, s); }"), 1);
    assert_eq!(refused("use crate::diagnosis::*;"), 1);
    assert_eq!(refused("use crate::diagnosis::Settings; fn f() { scheduler.diagnose(id) }"), 0);
}

#[test]
fn serde_in_another_place_and_a_config_that_is_written_are_found() {
    assert_eq!(serde(&Source::new("src/results.rs", "use serde::Serialize;")).len(), 1);
    assert_eq!(serde(&Source::new("src/results.rs", "#[derive(serde::Serialize)] struct A;")).len(), 1);
    assert_eq!(serde(&Source::new("src/alarm/config.rs", "use serde::{Deserialize, Serialize};")).len(), 1);
    assert_eq!(serde(&Source::new("src/alarm/config.rs", "use serde::Deserialize;")).len(), 0);
}

#[test]
fn a_function_that_writes_to_a_plant_is_found() {
    let refused = |text: &str| writing(&Source::new("src/collect/modbus/link.rs", text)).len();
    assert_eq!(refused("fn f() { context.write_single_register(1, 2) }"), 1);
    assert_eq!(refused("fn f() { Request::WriteMultipleRegisters(a, b) }"), 1);
    assert_eq!(refused("use opcua::types::WriteValue;"), 1);
    assert_eq!(refused("fn f() { context.read_holding_registers(1, 2) }"), 0);
}

#[test]
fn a_long_file_and_one_without_a_head_are_found() {
    let head = "//! What this module is for.\n";
    assert_eq!(shape(&Source::new("src/a.rs", head)).len(), 0);
    assert_eq!(shape(&Source::new("src/a.rs", "use std::fmt;")).len(), 1);
    assert_eq!(shape(&Source::new("src/a.rs", "//! todo")).len(), 1);
    assert_eq!(shape(&Source::new("src/a.rs", &(head.to_string() + &"\n".repeat(MOST_LINES)))).len(), 1);
}

#[test]
fn a_circle_of_imports_is_found_whatever_its_length() {
    let among = |files: &[(&str, &str)]| {
        let source = |(path, text): &(&str, &str)| Source::new(path, text);
        circles("src/notify", &files.iter().map(source).collect::<Vec<_>>())
    };
    let two = [
        ("src/notify/a.rs", "use super::b::B; pub(super) struct A;"),
        ("src/notify/b.rs", "pub(super) fn f() { crate::notify::a::A }"),
    ];
    assert_eq!(
        among(&two),
        ["src/notify: a circle of imports: src/notify/a.rs -> src/notify/b.rs -> src/notify/a.rs"]
    );
    let three = [
        ("src/notify/a.rs", "use super::b;"),
        ("src/notify/b.rs", "use super::{inner::{c::C, other}, d};"),
        ("src/notify/inner/c.rs", "use crate::notify::a::*;"),
    ];
    assert_eq!(among(&three).len(), 1, "{:?}", among(&three));
    // By what the folder's own file shows of its parts, and by what it has itself.
    let root = ("src/notify/mod.rs", "mod a; mod b; pub use a::A; fn wall() {}");
    for text in ["use super::wall;", "use super::A;", "use crate::notify;", "fn f() { super::wall() }"] {
        assert_eq!(among(&[root, ("src/notify/a.rs", text)]).len(), 1, "{text}");
    }
    assert_eq!(among(&[("src/notify.rs", "pub use a::A;"), ("src/notify/a.rs", "use super::B;")]).len(), 1);
}

#[test]
fn imports_that_come_to_an_end_are_no_circle() {
    let files = [
        ("src/notify/mod.rs", "mod a; mod b; mod c; pub use a::A; fn wall() {}"),
        ("src/notify/a.rs", "use super::b::B; pub(super) struct A; pub(in crate::notify) struct D;"),
        (
            "src/notify/b.rs",
            "use super::c; use crate::alarm; #[cfg(test)] mod tests { use super::super::a::A; }",
        ),
        ("src/notify/c.rs", "// use super::a;"),
        ("src/notify/c/tests.rs", "use super::super::a::A;"),
        ("src/alarm/mod.rs", "use crate::notify::a::A;"),
    ];
    let sources = files.map(|(path, text)| Source::new(path, text));
    assert_eq!(circles("src/notify", &sources), [""; 0]);
}
