//! Sources that break the rules, each of which has to be found: a check that cannot fail checks nothing.

use super::*;

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
fn a_reader_of_files_that_does_more_than_read_is_found() {
    let crates = ["tokio", "tracing", "rand", "nalgebra", "jiff"].map(String::from);
    let refused = |path: &str, text: &str| purity(&Source::new(path, text), &crates);
    for text in [
        "use std::time::SystemTime;",
        "use std::net::TcpStream;",
        "use std::{fs, io};",
        "use std::fs::OpenOptions;",
        "fn f() { std::fs::write(p, b) }",
        "fn f() { File::create(p) }",
        "fn f() { jiff::Timestamp::now() }",
        "fn f() { TimeZone::system() }",
        "fn f() { tracing::info!(n) }",
        "use tokio::fs::File;",
        "use rand::RngExt;",
        "use nalgebra::DMatrix;",
    ] {
        assert_eq!(refused("src/table/source.rs", text).len(), 1, "{text}");
    }
    let reads =
        "use std::fs::File; use std::io::{self, Read}; use jiff::tz::TimeZone; fn f() { File::open(p) }";
    assert_eq!(refused("src/table/source.rs", reads), [""; 0]);
    assert_eq!(refused("src/diagnosis/armax.rs", reads).len(), 4, "a pure module reads no file");
}

#[test]
fn a_call_around_the_scheduler_is_found() {
    let refused = |text: &str| diagnosing(&Source::new("src/serve/api/loops.rs", text)).len();
    assert_eq!(refused("use crate::diagnosis::{Settings, diagnose};"), 1);
    assert_eq!(refused("fn f() { crate::diagnosis::verdict::diagnose(r, s); }"), 1);
    assert_eq!(refused("fn f() { crate::diagnosis::diagnose_gated(r, g, s); }"), 1);
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
