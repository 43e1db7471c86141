//! `stictiond diagnose` as a user meets it: exit codes, one line on stderr, JSON on stdout, on any input.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn stictiond(args: &[&str]) -> Output {
    let output =
        Command::new(env!("CARGO_BIN_EXE_stictiond")).args(args).output().expect("the binary starts");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
    output
}

/// A file of its own for each case, in the directory cargo keeps for this test binary.
fn file(name: &str, content: impl AsRef<[u8]>) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&path, content).expect("the test directory is writable");
    path
}

/// Exit 2, nothing on stdout, one line on stderr that names the file and says what is wrong.
fn refused(path: &Path, says: &str) {
    let path = path.to_str().expect("a text path");
    let output = stictiond(&["diagnose", path]);
    let stderr = String::from_utf8(output.stderr).expect("text");
    assert_eq!(output.status.code(), Some(2), "{path}: {stderr}");
    assert!(output.stdout.is_empty(), "{path}");
    assert_eq!(stderr.lines().count(), 1, "{path}: {stderr}");
    assert!(stderr.starts_with(&format!("stictiond: {path}: ")), "{stderr}");
    assert!(stderr.contains(says), "{path}: {stderr}");
}

/// Exit 0 and a report whose verdict is `not_identifiable`.
fn not_identifiable(path: &Path) {
    let report = report(path);
    assert_eq!(report["verdict"], "not_identifiable", "{}", path.display());
    assert!(report["f"].is_null() && report["reason_code"].is_string(), "{report}");
}

fn report(path: &Path) -> serde_json::Value {
    let output = stictiond(&["diagnose", path.to_str().expect("a text path")]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{}: {stderr}", path.display());
    assert!(stderr.is_empty(), "{stderr}");
    // serde_json refuses NaN and Infinity, so parsing shows that there is none.
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn rows(n: usize, mut row: impl FnMut(usize) -> String) -> String {
    let mut text = String::from("t,op,pv\n");
    for k in 0..n {
        let _ = writeln!(text, "{}", row(k));
    }
    text
}

#[test]
fn what_is_no_record_is_refused_in_one_line() {
    let one_time = rows(600, |k| format!("7,{},{}", k % 50, k % 40));
    refused(&file("same_time.csv", one_time), "the times were cut or rounded");
    refused(&file("empty.csv", ""), "empty file");
    refused(&file("one_column.csv", "pv\n1\n2\n"), "only one column");
    refused(&file("wrong_delimiter.csv", "t^op^pv\n0^1^2\n"), "only one column");
    refused(&file("no_header.csv", "0,1,2\n1,2,3\n"), "numbers where the header should be");
    refused(&file("no_op.csv", "t,pv\n0,1\n"), "no column op");
    refused(&file("header_only.csv", "t,op,pv\n"), "no samples");
    refused(&file("text_time.csv", "t,op,pv\n0,1,2\nnoon,1,2\n"), "line 3, column 1 (t): \"noon\"");
    refused(&file("text_column.csv", rows(300, |k| format!("{k},shut,{k}"))), "line 2, column 2 (op)");
    refused(
        &file("nan_column.csv", rows(300, |k| format!("{k},{k},NaN"))),
        "line 1, column 3 (pv): nothing in",
    );
    refused(&file("decimal_comma.csv", "t,op,pv\n0,1,5,2,5\n"), "5 cells where the header has 3");
    let garbage: Vec<u8> = (0..100_000u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    refused(&file("garbage.csv", garbage), "line 1");
    refused(&file("utf16.csv", [0xff, 0xfe, b't', 0, b',', 0, b'\n', 0]), "no column");
    refused(&file("huge_time.csv", rows(600, |k| format!("{k}e305,1,2"))), "say --time-unit");
    refused(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("missing.csv"), "No such file");
    refused(Path::new(env!("CARGO_TARGET_TMPDIR")), "directory");
}

/// As from `zcat week.csv.gz |`: a table is read twice, and of a named pipe the second reading would wait for ever.
#[test]
fn a_pipe_is_refused_with_what_to_do() {
    for command in ["diagnose", "backfill", "import-tags"] {
        let child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
            .args([command, "/dev/stdin"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary starts");
        let output = child.wait_with_output().expect("it ends");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "{command}: {stderr}");
        let says = "stictiond: /dev/stdin: is a pipe or a device, and a table is read twice: save it";
        assert!(stderr.starts_with(says), "{command}: {stderr}");
    }
}

#[test]
fn what_cannot_be_judged_is_a_verdict() {
    not_identifiable(&file("two_samples.csv", rows(2, |k| format!("{k},{k},{k}"))));
    not_identifiable(&file("constant.csv", rows(600, |k| format!("{k},50,20"))));
    not_identifiable(&file("flat_pv.csv", rows(600, |k| format!("{k},{},20", k % 50))));
    not_identifiable(&file("flat_op.csv", rows(600, |k| format!("{k},20,{}", k % 50))));
    not_identifiable(&file(
        "mostly_text.csv",
        rows(600, |k| if k % 2 == 0 { format!("{k},{},x", k % 50) } else { format!("{k},NaN,inf") })
            .replacen("0,0,x", "0,0,1", 1),
    ));
}

/// What is missing is counted by the samples, whatever the stretches between look like.
#[test]
fn missing_samples_are_told_as_they_are() {
    let reason = |name: &str, text: String| {
        let report = report(&file(name, text));
        let words = report["reason"].as_str().expect("text").to_string();
        (report["reason_code"].as_str().expect("a code").to_string(), words)
    };
    // Ten of every hundred are missing: the nine tenths that are there can be judged.
    let torn = |missing: usize| {
        let (op, pv) = (
            |k: f64| (0.2 * k).sin() + 0.1 * (1.7 * k).cos(),
            |k: f64| (0.2 * k - 0.9).sin() + 0.1 * (2.3 * k).sin(),
        );
        rows(1200, move |k| {
            let pv = if k % 100 < missing { String::new() } else { pv(k as f64).to_string() };
            format!("{k},{},{pv}", op(k as f64))
        })
    };
    let report = report(&file("torn.csv", torn(10)));
    assert_ne!(report["reason_code"], "gaps", "{report}");
    let (code, words) = reason("mostly_missing.csv", torn(70));
    assert_eq!(code, "gaps");
    // Of the 1,130 rows from the first PV on 770 are missing.
    assert!(words.starts_with("gaps: 68 % of the samples"), "{words}");
    // As a historian writes two tags that it reads by turns: no row has both.
    let wave = |k: usize, late: f64| (0.2 * k as f64 - late).sin() + 0.1 * (1.7 * k as f64).cos();
    let by_turns = rows(1200, |k| match (k / 7).is_multiple_of(2) {
        true => format!("{k},{},", wave(k, 0.0)),
        false => format!("{k},,{}", wave(k, 0.9)),
    });
    let (code, words) = reason("by_turns.csv", by_turns);
    assert_eq!(code, "read_apart");
    assert!(words.contains("read both in one request"), "{words}");
    // Values that are all bad have stamps all the same.
    let bad = rows(600, |k| format!("{k},{},{}", k % 50, if k == 300 { "1" } else { "Bad" }));
    let (code, words) = reason("all_bad.csv", bad);
    assert_eq!(code, "gaps");
    assert!(words.starts_with("gaps: 100 % of the samples are missing or bad"), "{words}");
}

#[test]
fn odd_numbers_never_reach_the_report() {
    let wave = |k: usize| ((k as f64) * 0.2).sin();
    for (name, text) in [
        ("huge.csv", rows(600, |k| format!("{k},{}e308,{}e308", wave(k), wave(k + 5)))),
        ("tiny.csv", rows(600, |k| format!("{k},{}e-308,{}e-308", wave(k), wave(k + 5)))),
        (
            "one_spike.csv",
            rows(600, |k| format!("{k},{},{}", if k == 300 { 1e308 } else { wave(k) }, wave(k + 5))),
        ),
        (
            "some_nan.csv",
            rows(600, |k| {
                if k % 97 == 3 { format!("{k},NaN,x") } else { format!("{k},{},{}", wave(k), wave(k + 5)) }
            }),
        ),
        ("backwards.csv", rows(600, |k| format!("{},{},{}", 600 - k, wave(k), wave(k + 5)))),
        (
            "shuffled.csv",
            rows(601, |k| format!("{},{},{}", k * 241 % 601, wave(k * 241 % 601), wave(k * 241 % 601 + 5))),
        ),
    ] {
        let report = report(&file(name, text));
        let known = ["stiction", "no_stiction", "not_identifiable"];
        assert!(known.iter().any(|verdict| report["verdict"] == **verdict), "{name}: {report}");
    }
}

#[test]
fn a_million_samples() {
    let text = rows(1_000_000, |k| {
        format!("{k},{:.4},{:.4}", 50.0 + (k % 100) as f64 / 10.0, (k % 90) as f64 / 9.0)
    });
    let report = report(&file("million.csv", text));
    assert_eq!(report["loop"], "million");
}

#[test]
fn formats_and_arguments() {
    let path = file("formats.csv", rows(600, |k| format!("{k},50,20")));
    let path = path.to_str().unwrap();
    let text = stictiond(&["diagnose", path, "--format", "text"]);
    assert_eq!(text.status.code(), Some(0));
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.starts_with("read as:    , separated, time in seconds, op from \"op\", pv from \"pv\"\nloop        formats\nverdict     cannot be told\n"), "{text}");
    assert_eq!(stictiond(&["diagnose", path, "--ts", "2.5"]).status.code(), Some(0));
    for args in [
        &["diagnose"][..],
        &[],
        &["diagnose", path, "--format", "xml"],
        &["diagnose", path, "--ts", "0"],
        &["diagnose", path, "--ts", "-1"],
        &["diagnose", path, "--ts", "nan"],
        &["diagnose", path, "--ts", "soon"],
        &["diagnose", path, "--op-span", "0"],
        &["diagnose", path, "--op-limits", "100,0"],
        &["diagnose", path, "--op-limits", "100"],
        &["diagnose", path, "--decimal", ";"],
        &["diagnose", path, "--tz", "Mars"],
        &["diagnose", path, "--op", "valve"],
        &["diagnos"],
    ] {
        let output = stictiond(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(output.stdout.is_empty() && !output.stderr.is_empty(), "{args:?}");
    }
    assert_eq!(stictiond(&["--help"]).status.code(), Some(0));
    let version = stictiond(&["--version"]);
    assert_eq!(version.status.code(), Some(0));
    let told = String::from_utf8(version.stdout).expect("text");
    assert_eq!(told.trim_end(), format!("stictiond {}", stictiond::version::BUILD));
}

#[test]
fn span_and_limits_of_op_can_be_told() {
    let report = |args: &[&str]| -> serde_json::Value {
        let example = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/example.csv");
        let output = stictiond(&[&["diagnose", example], args].concat());
        serde_json::from_slice(&output.stdout).expect("JSON")
    };
    let f = |report: &serde_json::Value| report["f"].as_f64().expect("a number");
    let (plain, spanned) = (report(&[]), report(&["--op-span", "50"]));
    assert_eq!((&plain["f_unit_assumed"], &spanned["f_unit_assumed"]), (&true.into(), &false.into()));
    // The same f, told in another unit: equal but for one rounding.
    assert!((f(&spanned) - 2.0 * f(&plain)).abs() < 1e-12, "{} {}", f(&spanned), f(&plain));
    let stopped = file("stopped.csv", rows(600, |k| format!("{k},-5,{}", k % 50)));
    let stopped = stopped.to_str().expect("a text path");
    let output = stictiond(&["diagnose", stopped, "--op-limits", "-5,100"]);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(report["reason_code"], "saturated", "{report}");
}

#[test]
fn a_reader_that_stops_early_is_no_failure() {
    let path = file("pipe.csv", rows(600, |k| format!("{k},50,20")));
    let mut child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["diagnose", path.to_str().unwrap()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    assert_eq!(output.status.code(), Some(0));
}

/// Neither the report nor a file that is something else.
#[test]
fn a_picture_that_cannot_be_made_costs_nothing() {
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/example.csv");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let other = file("other_record.csv", "t,op,pv\n0,1,2\n");
    for (to, says) in [
        (other.clone(), "is there already and is no .svg"),
        (folder.join("no_such_folder/picture.svg"), "lies in a folder that is not there"),
        (folder.to_path_buf(), "is a folder"),
    ] {
        let to = to.to_str().expect("a text path");
        let output = stictiond(&["diagnose", example, "--plot", to]);
        let stderr = String::from_utf8(output.stderr).expect("text");
        assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "{stderr}");
        assert!(stderr.starts_with(&format!("stictiond: {to}: ")) && stderr.contains(says), "{stderr}");
    }
    assert_eq!(fs::read_to_string(&other).expect("text"), "t,op,pv\n0,1,2\n");

    // As on a disk that is full after some kilobytes.
    let picture = folder.join("full.svg");
    let _ = fs::remove_file(&picture);
    let limited = "trap '' XFSZ; ulimit -f 4; exec \"$0\" \"$@\"";
    let args = ["-c", limited, env!("CARGO_BIN_EXE_stictiond"), "diagnose", example, "--plot"];
    let output = Command::new("sh").args(args).arg(&picture).output().expect("sh is there");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.starts_with(&format!("stictiond: {}: ", picture.display())), "{stderr}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("the report");
    assert_eq!(report["verdict"], "stiction");
    assert!(!picture.exists(), "half a picture");

    // Nor the picture of the run before, also behind a link.
    let link = folder.join("link_to_full.svg");
    let _ = fs::remove_file(&link);
    std::os::unix::fs::symlink(&picture, &link).expect("a link");
    let drawn = stictiond(&["diagnose", example, "--plot", link.to_str().expect("a text path")]);
    assert_eq!(drawn.status.code(), Some(0));
    let good = fs::read_to_string(&picture).expect("a picture");
    assert!(good.starts_with("<svg") && good.len() > 4096, "{}", good.len());
    let output = Command::new("sh").args(args).arg(&link).output().expect("sh is there");
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(fs::read_to_string(&picture).expect("still there"), good);
    assert!(link.is_symlink());
    let beside = fs::read_dir(folder).expect("readable").filter_map(Result::ok);
    let left: Vec<_> =
        beside.filter(|own| own.file_name().to_string_lossy().starts_with("full.svg.")).collect();
    assert!(left.is_empty(), "{left:?}");
}

/// Under any name a run that is repeated draws its picture anew.
#[test]
fn a_picture_replaces_an_empty_file_and_a_picture() {
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/example.csv");
    let named = file("picture.out", "");
    for begun in ["", "<SVG of another program>"] {
        fs::write(&named, begun).expect("writable");
        for _ in 0..2 {
            let output = stictiond(&["diagnose", example, "--plot", named.to_str().expect("a text path")]);
            assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
            assert!(fs::read_to_string(&named).expect("text").starts_with("<svg xmlns"));
        }
    }
    // Behind the report, into whatever stdout is.
    let all = file("report_and_picture.txt", "");
    let status = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["diagnose", example, "--format", "json", "--plot", "/dev/stdout"])
        .stdout(fs::File::create(&all).expect("writable"))
        .status()
        .expect("the binary starts");
    assert_eq!(status.code(), Some(0));
    let all = fs::read_to_string(&all).expect("text");
    assert!(
        all.starts_with('{') && all.contains("}\n<svg xmlns") && all.trim_end().ends_with("</svg>"),
        "{all}"
    );
}

#[test]
fn a_message_that_nobody_can_read_is_no_failure() {
    let path = file("two_for_a_picture.csv", rows(2, |k| format!("{k},{k},{k}")));
    let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("a device that takes nothing");
    let output = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["diagnose", path.to_str().expect("a text path"), "--plot"])
        .arg(path.with_extension("svg"))
        .stderr(full)
        .output()
        .expect("the binary starts");
    assert_eq!(output.status.code(), Some(0));
    assert!(!output.stdout.is_empty());
}

/// The example with OP in another unit: the same valve, in per cent of its span, and where that is known from.
#[test]
fn the_span_of_op_is_told_by_limits_unit_or_values() {
    let example = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/example.csv")).expect("text");
    let scaled = |name: &str, header: &str, scale: f64, offset: f64| {
        let mut text = format!("t,{header},pv\n");
        for line in example.lines().skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            let op: f64 = cells[1].parse().expect("a number");
            let _ = writeln!(text, "{},{:.9},{}", cells[0], offset + scale * op, cells[2]);
        }
        file(name, text)
    };
    let told = |path: &Path, more: &[&str]| -> serde_json::Value {
        let args = [&["diagnose", path.to_str().expect("a text path")], more].concat();
        let output = stictiond(&args);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).expect("JSON")
    };
    for (name, header, scale, offset, more, source, span) in [
        ("percent.csv", "op", 1.0, 0.0, &[][..], "values", Some(100.0)),
        ("share.csv", "op", 0.01, 0.0, &[], "values", Some(1.0)),
        ("ampere.csv", "op", 0.00016, 0.004, &[], "values", Some(0.016)),
        ("header.csv", "op [mA]", 0.16, 4.0, &[], "unit", Some(16.0)),
        ("limits.csv", "op", 276.48, 0.0, &["--op-limits", "0,27648"], "limits", Some(27648.0)),
        ("given.csv", "op", 0.16, 4.0, &["--op-span", "16"], "given", Some(16.0)),
    ] {
        let report = told(&scaled(name, header, scale, offset), more);
        assert_eq!(
            (report["op_span_source"].as_str(), report["op_span"].as_f64()),
            (Some(source), span),
            "{name}"
        );
        assert_eq!(
            (report["verdict"].as_str(), report["f_unit"].as_str()),
            (Some("stiction"), Some("% OP")),
            "{name}"
        );
        let f = report["f"].as_f64().expect("a number");
        assert!((f - 0.5).abs() < 0.02, "{name}: {f}");
        assert_eq!(report["f_unit_assumed"], source == "values", "{name}");
    }
    // Twelve may be milliamperes or per cent.
    let doubt = told(&scaled("milli.csv", "op", 0.16, 4.0), &[]);
    assert_eq!((doubt["op_span_source"].as_str(), doubt["op_span"].is_null()), (Some("unknown"), true));
    assert_eq!(doubt["f_unit"], "OP units");
    // 20 to 100 of another unit are no per cent.
    let pneumatic = told(&scaled("kilopascal.csv", "op [kPa]", 0.8, 20.0), &[]);
    assert_eq!(
        (pneumatic["op_span_source"].as_str(), pneumatic["op_span"].is_null()),
        (Some("unknown"), true)
    );
    assert_eq!(pneumatic["f_unit"], "OP units");
    let example = scaled("contradiction.csv", "op", 1.0, 0.0);
    for args in [&["--op-span", "1", "--op-limits", "0,100"][..], &["--op-span", "1"]] {
        let output = stictiond(&[&["diagnose", example.to_str().expect("text")], args].concat());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(stderr.contains("--op-span 1") && stderr.contains("contradict"), "{stderr}");
    }
}
