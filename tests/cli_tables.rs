//! Every option that tells how a table is read, on the command line of every command that reads one, against the reader itself.

#[path = "exports/archive.rs"]
mod archive;

use archive::archive;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use stictiond::signal::Sample;
use stictiond::table::{self, Options, Source, TableError};

/// Rows of each table: enough for two windows of a minute.
const ROWS: u32 = 150;
/// 2025-11-21T04:40:00Z.
const START: u32 = 1_763_700_000;

fn op(k: u32) -> String {
    format!("{:.1}", 50.0 + f64::from(k % 7) / 10.0)
}

fn pv(k: u32) -> String {
    format!("{:.2}", 20.0 + f64::from(k % 9) / 10.0)
}

/// A table of these names and rows.
fn rows(header: &str, row: impl Fn(u32) -> String) -> Vec<u8> {
    (header.to_string() + "\n" + &(0..ROWS).map(|k| row(k) + "\n").collect::<String>()).into_bytes()
}

/// Time, OP and PV, their times written so.
fn timed(time: impl Fn(u32) -> String) -> Vec<u8> {
    rows("t;op;pv", |k| format!("{};{};{}", time(k), op(k), pv(k)))
}

/// A workbook of OpenDocument with two sheets of one table.
fn two_sheets() -> Vec<u8> {
    const OPEN: &str = "urn:oasis:names:tc:opendocument:xmlns";
    let text = |text: &str| {
        format!("<table:table-cell office:value-type=\"string\"><text:p>{text}</text:p></table:table-cell>")
    };
    let number =
        |value: String| format!("<table:table-cell office:value-type=\"float\" office:value=\"{value}\"/>");
    let row = |cells: [String; 3]| format!("<table:table-row>{}</table:table-row>", cells.concat());
    let table: String = (0..ROWS).map(|k| row([(START + k).to_string(), op(k), pv(k)].map(number))).collect();
    let table = row(["t", "op", "pv"].map(text)) + &table;
    let sheets = ["One", "Two"]
        .map(|name| format!("<table:table table:name=\"{name}\">{table}</table:table>"))
        .concat();
    let names =
        ["office", "table", "text"].map(|name| format!(" xmlns:{name}=\"{OPEN}:{name}:1.0\"")).concat();
    let content = format!(
        "<office:document-content{names}><office:body><office:spreadsheet>{sheets}</office:spreadsheet></office:body>\
         </office:document-content>"
    );
    let manifest = format!("<manifest:manifest xmlns:manifest=\"{OPEN}:manifest:1.0\"/>");
    archive(&[
        ("mimetype", "application/vnd.oasis.opendocument.spreadsheet"),
        ("META-INF/manifest.xml", &manifest),
        ("content.xml", &content),
    ])
}

/// A table, what is told of it beside the option, the option, and its value.
struct Case {
    table: Vec<u8>,
    beside: &'static [(&'static str, &'static str)],
    option: &'static str,
    value: &'static str,
}

/// One case for each option; without it, or with another one of the same value, the table is read otherwise or refused.
fn cases() -> Vec<Case> {
    let letters = || {
        rows("A;B;C;D;E", |k| {
            let mode = if k % 60 < 50 { "AUTO" } else { "MAN" };
            format!("{};{};{};{};{mode}", START + k, op(k), pv(k), pv(k + 1))
        })
    };
    let stamp = |k: u32| format!("2026-06-01 06:{:02}:{:02}", k / 60, k % 60);
    let tags = || rows("P;Q;R", |k| format!("{0}Z;X1;{1}\n{0}Z;X2;{2}", stamp(k), op(k), pv(k)));
    let with = |name: &str, cell: fn(u32) -> &'static str| {
        rows(&format!("t;op;pv;{name}"), |k| format!("{};{};{};{}", START + k, op(k), pv(k), cell(k)))
    };
    let plain = |sign: char| {
        rows(&format!("t{sign}op{sign}pv"), |k| format!("{}{sign}{}{sign}{}", START + k, op(k), pv(k)))
    };
    let in_doubt =
        rows("t;op;pv", |k| format!("{};{};{},{:03}", START + k, 50 + k % 7, 1 + k % 3, 100 + k % 9));
    let julian = |k: u32| format!("{:.7}", 61_000.25 + f64::from(k) / 43_200.0);
    let american = |k: u32| format!("06/01/2026 06:{:02}:{:02}", k / 60, k % 60);
    vec![
        Case::new(letters(), &[("op", "B"), ("pv", "C")], "time", "A"),
        Case::new(letters(), &[("time", "A"), ("pv", "C")], "op", "B"),
        Case::new(letters(), &[("time", "A"), ("op", "B")], "pv", "C"),
        Case::new(letters(), &[("time", "A"), ("op", "B"), ("pv", "C")], "sp", "D"),
        Case::new(letters(), &[("time", "A"), ("op", "B"), ("pv", "C")], "mv", "D"),
        Case::new(letters(), &[("time", "A"), ("op", "B"), ("pv", "C")], "mode", "none"),
        Case::new(tags(), &[("time", "P"), ("op", "X1"), ("pv", "X2"), ("value", "R")], "tag", "Q"),
        Case::new(tags(), &[("time", "P"), ("op", "X1"), ("pv", "X2"), ("tag", "Q")], "value", "R"),
        Case::new(timed(american), &[], "time_format", "mdy"),
        Case::new(timed(stamp), &[], "tz", "+02:00"),
        Case::new(timed(julian), &[], "time_unit", "mjd"),
        Case::new(plain(';'), &[], "encoding", "windows-1250"),
        Case::new(in_doubt, &[], "decimal", ","),
        Case::new(plain('^'), &[], "separator", "^"),
        Case::new(with("mode", |k| if k < 100 { "5" } else { "2" }), &[], "auto_values", "5"),
        Case::new(with("Quality", |k| if k % 50 > 0 { "500" } else { "7" }), &[], "good_values", "500"),
        Case::new(two_sheets(), &[], "sheet", "Two"),
    ]
}

/// The loop that an import is told.
const LOOP: &str = "FIC101";

impl Case {
    fn new(
        table: Vec<u8>,
        beside: &'static [(&'static str, &'static str)],
        option: &'static str,
        value: &'static str,
    ) -> Self {
        Self { table, beside, option, value }
    }

    fn told(&self, option: Option<&str>, of_loop: Option<&str>) -> Options {
        let mut options = Options { of_loop: of_loop.map(str::to_string), ..Options::default() };
        let mut set = |name: &str, value: &str| assert!(options.set(name, value.to_string()), "{name}");
        self.beside.iter().for_each(|(name, value)| set(name, value));
        option.into_iter().for_each(|option| set(option, self.value));
        options
    }

    /// How the reader reads the table with an option of this name and the value, or without any.
    fn read(&self, option: Option<&str>) -> Result<String, String> {
        let read = table::read(Source::Bytes(&self.table), &self.told(option, None));
        read.map(|table| table.found.read_as).map_err(|error| error.to_string())
    }

    /// How many samples there are, and how they are read, as `store import` says it.
    fn imported(&self) -> String {
        let mut samples = 0u64;
        let mut take = |_: &table::Tag, _: Sample| {
            samples += 1;
            Ok::<(), TableError>(())
        };
        let options = self.told(Some(self.option), Some(LOOP));
        let found = table::stream(Source::Bytes(&self.table), &options, &mut take).expect("it is read");
        format!("{samples} samples, read as: {}", found.read_as)
    }

    /// A command on the table, with all that is told of it.
    fn run(&self, command: &[&str], file: &Path, more: &[&str]) -> Output {
        let mut own = Command::new(env!("CARGO_BIN_EXE_stictiond"));
        own.args(command).arg(file).args(more);
        for (name, value) in self.beside.iter().copied().chain([(self.option, self.value)]) {
            own.arg(format!("--{}", name.replace('_', "-"))).arg(value);
        }
        let output = own.output().expect("runs");
        assert!(
            output.status.success(),
            "{command:?} --{}: {}",
            self.option,
            String::from_utf8_lossy(&output.stderr)
        );
        output
    }
}

fn folder(name: &str) -> PathBuf {
    let path =
        Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-tables-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("writable");
    path
}

#[test]
fn every_option_decides_something_that_no_other_decides() {
    let error = toml::from_str::<Options>("no_such_key = 0").expect_err("no such option").to_string();
    let known: BTreeSet<&str> = error.split('`').skip(3).step_by(2).collect();
    let cases = cases();
    let tried: BTreeSet<&str> = cases.iter().map(|case| case.option).collect();
    assert_eq!(tried, known, "{error}");
    for case in &cases {
        let read = case.read(Some(case.option)).unwrap_or_else(|error| panic!("--{}: {error}", case.option));
        let beside = |name: &&str| case.beside.iter().any(|(own, _)| own == name);
        for other in known.iter().copied().filter(|name| *name != case.option && !beside(name)) {
            assert_ne!(case.read(Some(other)), Ok(read.clone()), "--{other} for --{}", case.option);
        }
        assert_ne!(case.read(None), Ok(read), "--{} decides nothing", case.option);
    }
}

#[test]
fn each_option_reaches_the_reader_from_each_command() {
    let folder = folder("options");
    for case in cases() {
        let file = folder.join(case.option).with_extension("table");
        fs::write(&file, &case.table).expect("writable");
        let read = case.read(Some(case.option)).unwrap_or_else(|error| panic!("--{}: {error}", case.option));
        let said = |output: Output| -> Value {
            let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
            report["read_as"].clone()
        };
        let diagnosed = case.run(&["diagnose"], &file, &["--format", "json"]);
        assert_eq!(said(diagnosed), read.as_str(), "diagnose --{}", case.option);
        let windows = ["--window", "60", "--step", "60", "--format", "json"];
        let filled = case.run(&["backfill"], &file, &windows);
        assert_eq!(said(filled), read.as_str(), "backfill --{}", case.option);
        let store = folder.join(case.option).with_extension("store");
        let store = store.to_str().expect("text");
        let imported = case.run(&["store", "import", store], &file, &["--loop", LOOP]);
        let line = format!("{}: {}\n", file.display(), case.imported());
        assert_eq!(String::from_utf8_lossy(&imported.stdout), line, "store import --{}", case.option);
    }
    fs::remove_dir_all(&folder).expect("writable");
}
