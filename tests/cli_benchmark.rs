//! `stictiond benchmark` on a folder of two records whose truth is known: the example of the documentation, whose valve
//! sticks, and a loop that a load swings.

use serde_json::Value;
use std::f64::consts::TAU;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn folder(name: &str) -> PathBuf {
    let folder =
        Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-benchmark-{name}-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("writable");
    folder
}

/// A folder with both records and an index.
fn drawn(name: &str, index: &str) -> PathBuf {
    let folder = folder(name);
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/example.csv");
    fs::copy(example, folder.join("sticky.csv")).expect("the example is there");
    let mut swung = "t,op,pv\n".to_string();
    for k in 0..1000 {
        let phase = TAU * f64::from(k) / 50.0;
        writeln!(swung, "{k},{},{}", 50.0 - phase.sin(), 20.0 + 0.5 * (phase + 0.2).sin()).expect("a String");
    }
    fs::write(folder.join("swung.csv"), swung).expect("writable");
    fs::write(folder.join("index.csv"), index).expect("writable");
    folder
}

fn benchmark(folder: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    command.arg("benchmark").arg(folder).args(more).output().expect("runs")
}

const INDEX: &str =
    "loop,file,type,label\nFIC103,sticky.csv,FC,stiction\n<b>2</b>,swung.csv,FC,no stiction\n";

#[test]
fn every_method_and_the_program_are_counted_and_the_page_stands_alone() {
    let folder = drawn("both", INDEX);
    let page = folder.join("page.html");
    let output = benchmark(&folder, &["--format", "json", "--html", page.to_str().expect("text")]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let judges = found["judges"].as_array().expect("judges");
    assert_eq!(judges.len(), 13);
    for judge in judges {
        let count = |name: &str| judge[name].as_u64().expect("a count");
        let sticky = judge["found"]["n"].as_u64().expect("n") + count("missed") + count("cannot_tell_sticky");
        let sound =
            judge["false_alarms"]["n"].as_u64().expect("n") + count("cleared") + count("cannot_tell_sound");
        assert_eq!((sticky, sound), (1, 1), "{judge}");
    }
    let of = |name: &str| judges.iter().find(|judge| judge["method"] == name).expect("counted");
    // The documentation shows what the program says of its example; a sine is what the curve fit clears.
    assert_eq!(of("program")["found"]["n"], 1);
    assert_eq!(of("he_2007")["cleared"], 1, "{}", of("he_2007"));
    let page = fs::read_to_string(page).expect("written");
    assert!(page.contains("He 2007, curve fit") && page.contains("&lt;b&gt;2&lt;/b&gt;"));
    assert!(!page.contains("<b>2") && !page.contains("http"), "nothing from elsewhere, no name as markup");
    let text = benchmark(&folder, &["--format", "text"]);
    let text = String::from_utf8(text.stdout).expect("text");
    assert!(text.lines().any(|line| line.starts_with("program") && line.contains("1 of 1")), "{text}");
}

#[test]
fn what_a_table_does_not_say_is_told_for_all_of_the_folder() {
    let folder = drawn("columns", "loop,file,label\nFIC103,sticky.csv,stiction\n");
    let sticky = folder.join("sticky.csv");
    let text = fs::read_to_string(&sticky).expect("the example is there");
    let renamed = text.replacen("t,op,pv,sp", "when,first,second,third", 1);
    assert_ne!(text, renamed);
    fs::write(&sticky, renamed).expect("writable");
    let output = benchmark(&folder, &["--format", "json"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && said.contains("sticky.csv: "), "{said}");
    let columns = ["--time", "when", "--op", "first", "--pv", "second", "--sp", "third", "--time-unit", "s"];
    let output = benchmark(&folder, &[&columns[..], &["--format", "json"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let judges = found["judges"].as_array().expect("judges");
    let program = judges.iter().find(|judge| judge["method"] == "program").expect("counted");
    assert_eq!(program["found"]["n"], 1, "{program}");
}

#[test]
fn a_folder_that_cannot_be_used_is_refused_in_one_line() {
    for (name, index, why) in [
        ("label", "loop,file,label\nA,sticky.csv,perhaps\n", "line 2: label 'perhaps'"),
        ("column", "loop,file\nA,sticky.csv\n", "it has no column label"),
        ("none", "loop,file,label\n", "it names no record"),
        ("file", "loop,file,label\nA,nowhere.csv,stiction\n", "nowhere.csv"),
        ("cells", "loop,file,label\nA\n", "line 2: it has 1 cells"),
    ] {
        let output = benchmark(&drawn(name, index), &[]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{name}: {said}");
        assert!(said.contains(why) && said.lines().count() == 1, "{name}: {said}");
    }
    let output = benchmark(Path::new("no/such/folder"), &[]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(said.contains("in the columns loop, file and label") && said.lines().count() == 1, "{said}");
    let folder = drawn("page", INDEX);
    let index = folder.join("index.csv");
    let output = benchmark(&folder, &["--html", index.to_str().expect("text")]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && said.contains("is no .html or .htm"), "{said}");
    assert_eq!(fs::read_to_string(index).expect("text"), INDEX);
}

#[test]
fn a_record_whose_op_contradicts_its_unit_is_refused() {
    let folder = drawn("unit", "loop,file,label\nA,share.csv,stiction\n");
    let row = |k: u32| format!("{k},{:.2},{}\n", 0.5 + 0.01 * f64::from(k % 7), 20 + k % 5);
    let rows: String = (0..300).map(row).collect();
    fs::write(folder.join("share.csv"), format!("t,op [%],pv\n{rows}")).expect("writable");
    let output = benchmark(&folder, &[]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("share.csv: OP's unit is \"%\"") && said.lines().count() == 1, "{said}");
    assert!(said.contains("put OP's unit in the file's header right") && !said.contains("op-span"), "{said}");
}
