//! `stictiond plant` as a user meets it: a folder in, text, JSON and a page out.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use stictiond::sim::units::{Source, plant};

fn stictiond(args: &[&str]) -> Output {
    let output =
        Command::new(env!("CARGO_BIN_EXE_stictiond")).args(args).output().expect("the binary starts");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
    output
}

/// An empty folder of its own for each case.
fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("the test directory is writable");
    path
}

/// A plant with a load, one file a loop, beside an index and a file that is no record; the loop that the load enters.
fn with_a_load(name: &str) -> (PathBuf, String) {
    let path = folder(name);
    let of = plant(12, 2, &[(Source::Load, Some(3))]);
    for (of, run) in of.loops.iter().zip(of.run(12.0, &[true])) {
        let mut text = "t,op,pv,sp\n".to_string();
        for k in 0..run.t.len() {
            let _ = writeln!(text, "{},{:.4},{:.4},{:.4}", run.t[k], run.op[k], run.pv[k], run.sp[k]);
        }
        fs::write(path.join(&of.name).with_extension("csv"), text).expect("writable");
    }
    fs::write(path.join("index.csv"), "file,label\nFIC101.csv,1\n").expect("writable");
    fs::write(path.join("broken.csv"), "a,b\nx,y\n").expect("writable");
    (path, of.loops[3].name.clone())
}

#[test]
fn a_folder_gives_groups_a_work_list_and_a_page_that_stands_alone() {
    let (path, at) = with_a_load("plant-load");
    let page = path.with_extension("html");
    let (path, to) = (path.to_str().expect("text"), page.to_str().expect("text"));
    let output = stictiond(&["plant", path, "--format", "json", "--op-limits", "0,100", "--html", to]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(found["loops"].as_array().map(Vec::len), Some(24));
    let skipped = found["skipped"].as_array().expect("a list");
    assert!(
        skipped.len() == 1 && skipped[0].as_str().is_some_and(|s| s.starts_with("broken: ")),
        "{skipped:?}"
    );
    let group = &found["groups"][0];
    assert!(group["members"].as_array().is_some_and(|m| m.iter().any(|m| *m == at.as_str())), "{group}");
    assert!(found["work"].as_array().is_some_and(|work| !work.is_empty()));
    let one =
        found["loops"].as_array().and_then(|l| l.iter().find(|l| l["loop"] == at.as_str())).expect("named");
    assert!(
        one["at_limits"] == 0.0 && one["service_factor"].is_null() && one["score"].as_f64().is_some(),
        "{one}"
    );
    // Of this record, which has a set point and limits, every one of these is known.
    for known in ["iae", "iae_per_s", "ise", "error_sd", "error_mean", "pv_mean", "harris", "swing", "stuck"]
    {
        assert!(one[known].as_f64().is_some_and(f64::is_finite), "{known} in {one}");
    }
    let op = &one["op_distribution"];
    let [low, middle, high] = ["q05", "q50", "q95"].map(|name| op[name].as_f64().expect("a quantile"));
    assert!((0.0..=middle).contains(&low) && (middle..=100.0).contains(&high), "{op}");
    let shares = op["histogram"].as_array().expect("a list").iter();
    assert!((shares.filter_map(serde_json::Value::as_f64).sum::<f64>() - 1.0).abs() < 1e-6, "{op}");

    let page = fs::read_to_string(page).expect("written");
    assert!(
        page.contains("What to do first")
            && page.contains(&at)
            && page.contains("prefers-color-scheme: dark")
    );
    // Nothing is loaded from anywhere, and nothing runs.
    for outside in ["<script", "src=", "http:", "https:", "@import"] {
        assert!(!page.contains(outside), "{outside}");
    }
    let text = stictiond(&["plant", path, "--format", "text"]);
    let text = String::from_utf8(text.stdout).expect("text");
    assert!(
        (text.contains("suspected source: ") || text.contains("likeliest source: "))
            && text.contains("skipped broken: "),
        "{text}"
    );
}

#[test]
fn how_steps_of_the_set_point_are_followed_is_told() {
    let path = folder("plant-steps");
    // Ten minutes after each step PV is there, and has gone a tenth beyond.
    let level = |k: u32| if (k / 200).is_multiple_of(2) { 40.0 } else { 60.0 };
    let mut text = "t,op,pv,sp\n".to_string();
    for k in 0..1000_u32 {
        let (since, sp) = (k % 200, level(k));
        let sign = if sp > 50.0 { 1.0 } else { -1.0 };
        let off = if k < 200 || since >= 10 {
            0.0
        } else if since < 5 {
            -20.0
        } else {
            2.0
        };
        let _ = writeln!(text, "{},{},{},{sp}", 60 * k, 30 + k % 7, sp + sign * off);
    }
    fs::write(path.join("FIC1.csv"), text).expect("writable");
    let output = stictiond(&["plant", path.to_str().expect("text"), "--format", "json", "--diagnose", "0"]);
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let own = &found["loops"][0]["settling"];
    assert_eq!((own["steps"].as_u64(), own["settled"].as_u64()), (Some(4), Some(4)), "{own}");
    assert_eq!((own["time_s"].as_f64(), own["overshoot"].as_f64()), (Some(600.0), Some(0.1)), "{own}");
}

#[test]
fn a_folder_without_records_is_bad_input() {
    let empty = folder("plant-empty");
    for path in [empty.to_str().expect("text"), "/nowhere/at/all"] {
        let output = stictiond(&["plant", path]);
        assert_eq!(output.status.code(), Some(2));
        let stderr = String::from_utf8(output.stderr).expect("text");
        assert!(
            stderr.lines().count() == 1 && stderr.starts_with(&format!("stictiond: {path}: ")),
            "{stderr}"
        );
    }
}

/// Of a record whose header and values contradict each other nothing is said in per cent, here as in `diagnose`.
#[test]
fn a_record_whose_op_contradicts_its_unit_is_skipped_with_what_contradicts() {
    let path = folder("plant-contradicted");
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/example.csv");
    let example = fs::read_to_string(example).expect("the example is there");
    let scaled = |name: &str, header: &str, scale: f64, offset: f64| {
        let mut text = format!("t,{header},pv\n");
        for line in example.lines().skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            let op: f64 = cells[1].parse().expect("a number");
            let _ = writeln!(text, "{},{:.9},{}", cells[0], offset + scale * op, cells[2]);
        }
        fs::write(path.join(name), text).expect("writable");
    };
    scaled("share.csv", "OP [%]", 0.01, 0.0);
    scaled("milli.csv", "OP [mA]", 0.16, 4.0);
    scaled("percent.csv", "OP [%]", 1.0, 0.0);
    let told = |more: &[&str]| -> Vec<String> {
        let args = [&["plant", path.to_str().expect("text"), "--format", "json", "--diagnose", "0"], more];
        let output = stictiond(&args.concat());
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let skipped = found["skipped"].as_array().expect("a list").iter();
        skipped.map(|why| why.as_str().expect("text").to_string()).collect()
    };
    let skipped = told(&[]);
    assert_eq!(skipped.len(), 1, "{skipped:?}");
    assert!(skipped[0].starts_with("share: ") && skipped[0].contains("OP's unit is \"%\""), "{skipped:?}");
    assert!(skipped[0].ends_with("put OP's unit in the file's header right"), "{skipped:?}");
    // Limits in per cent are not those of a record in milliamperes.
    let skipped = told(&["--op-limits", "0,100"]);
    assert_eq!(skipped.len(), 1, "{skipped:?}");
    assert!(
        skipped[0].starts_with("milli: ") && skipped[0].contains("the span of --op-limits, 100,"),
        "{skipped:?}"
    );
}
