//! `stictiond plant` as a user meets it: a folder, a store or a table of several loops in, text, JSON and a page out.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;
use stictiond::signal::Sample;
use stictiond::sim::units::{Source, plant};
use stictiond::store::{self, Batch, Series, Store, TagName};

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
    has_its_parts(&found["work"]);
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
    let from = one["harris_dead_time_from"].as_str();
    assert!(matches!(from, Some("model" | "one_sample")), "{one}");
    assert_eq!(from == Some("one_sample"), one["harris_dead_time_s"].is_null(), "{one}");
    causes_are_told(found["loops"].as_array().expect("a list"));
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
    // Groups and their sources are found without the valves, which take most of the time.
    let text = stictiond(&["plant", path, "--format", "text", "--diagnose", "0"]);
    let text = String::from_utf8(text.stdout).expect("text");
    assert!(
        (text.contains("suspected source: ") || text.contains("likeliest source: "))
            && text.contains("skipped broken: "),
        "{text}"
    );
}

/// Every cause of every loop that could be judged has a probability, the largest first, and the one that is named the same as there.
fn causes_are_told(loops: &[serde_json::Value]) {
    let mut named = 0;
    for own in loops {
        let causes = own["causes"].as_array().expect("a list");
        let p = |of: &serde_json::Value| of["probability"].as_f64().expect("a probability");
        assert_eq!(causes.len(), 7, "{own}");
        assert!((causes.iter().map(p).sum::<f64>() - 1.0).abs() < 1e-9, "{own}");
        assert!(causes.windows(2).all(|two| p(&two[0]) >= p(&two[1])), "{own}");
        if let Some(said) = own["cause_probability"].as_f64() {
            named += 1;
            let same = causes.iter().find(|of| of["name"] == own["cause"]).expect("it is among them");
            assert!((p(same) - said).abs() < 1e-9, "{own}");
        }
    }
    assert!(named > 0, "{loops:?}");
}

/// The work comes part by part; a cause that is not known is no work, and one that is not likely is none to do first.
fn has_its_parts(work: &serde_json::Value) {
    let place =
        |line: &serde_json::Value| ["first", "perhaps", "unknown"].iter().position(|p| line["part"] == *p);
    let work = work.as_array().expect("a list");
    assert!(work.iter().all(|line| place(line).is_some()) && work.is_sorted_by_key(place), "{work:?}");
    for line in work {
        assert_eq!(line["part"] == "unknown", line["cause"] == "unknown", "{line}");
        assert!(line["part"] != "first" || line["probability"].as_f64() >= Some(0.8), "{line}");
    }
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

/// As when an export is saved by a spreadsheet too: it would swing together with itself.
#[test]
fn a_record_that_is_there_in_two_formats_is_one_loop() {
    let path = folder("plant-twice");
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/example.csv");
    let example = fs::read_to_string(example).expect("the example is there");
    for name in ["FIC1.csv", "FIC1.txt"] {
        fs::write(path.join(name), &example).expect("writable");
    }
    let folder = path.to_str().expect("text");
    let output = stictiond(&["plant", folder, "--format", "json", "--diagnose", "0"]);
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(found["loops"].as_array().map(Vec::len), Some(1), "{found}");
    let skipped = found["skipped"][0].as_str().expect("one");
    assert!(skipped.starts_with("FIC1: FIC1.txt has the name of FIC1.csv, which is read"), "{skipped}");

    let record = path.join("FIC1.csv");
    let output = stictiond(&["plant", folder, "--html", record.to_str().expect("text")]);
    let stderr = String::from_utf8(output.stderr).expect("text");
    assert!(output.status.code() == Some(2) && stderr.contains("is no .html or .htm"), "{stderr}");
    assert_eq!(fs::read_to_string(record).expect("text"), example);
}

fn found(args: &[&str]) -> serde_json::Value {
    let output = stictiond(&[&["plant"], args, &["--format", "json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn names(found: &serde_json::Value) -> Vec<&str> {
    let loops = found["loops"].as_array().expect("a list").iter();
    loops.map(|own| own["loop"].as_str().expect("a name")).collect()
}

/// Two loops that swing together every 31 min, and one at rest: time (s) and OP and PV of each, a minute apart.
fn swinging(k: u32) -> [f64; 7] {
    let (t, swing) = (f64::from(k), 0.2 * f64::from(k));
    let noise = |rate: f64| (rate * t * t).sin();
    let one = |phase: f64, rate: f64| 5.0 * (swing + phase).sin() + noise(rate);
    [
        60.0 * t,
        50.0 + one(0.0, 0.7),
        one(-1.0, 0.9),
        40.0 + one(0.5, 1.1),
        one(-0.5, 1.3),
        30.0 + noise(1.7),
        noise(2.3),
    ]
}

fn wide(header: &str) -> String {
    let row = |k: u32| swinging(k).map(|value| format!("{value:.4}")).join(",") + "\n";
    format!("{header}\n{}", (0..1440).map(row).collect::<String>())
}

#[test]
fn a_table_of_several_loops_is_read_by_a_list_or_by_the_names_of_its_columns() {
    let path = folder("plant-wide");
    let (by_names, by_list, list) = (path.join("named.csv"), path.join("wide.csv"), path.join("loops.csv"));
    fs::write(&by_names, wide("t,FIC1.OP,FIC1.PV,LIC2.OP,LIC2.PV,TIC3.OP,TIC3.PV")).expect("writable");
    fs::write(&by_list, wide("t,XMV1,XMEAS1,XMV2,XMEAS2,XMV3,XMEAS3")).expect("writable");
    fs::write(
        &list,
        "loop,op,pv,sp\nFIC1,XMV1,XMEAS1,\nLIC2,XMV2,XMEAS2,\nTIC3,XMV3,XMEAS3,XMV1\nPIC4,XMV4,XMEAS4,\n",
    )
    .expect("writable");
    let text = |path: &Path| path.to_str().expect("text").to_string();
    let named = found(&[&text(&by_names), "--diagnose", "0"]);
    assert_eq!(names(&named), ["FIC1", "LIC2", "TIC3"]);
    assert!(named["skipped"].as_array().is_some_and(Vec::is_empty), "{}", named["skipped"]);
    let listed = found(&[&text(&by_list), "--loops", &text(&list), "--diagnose", "0"]);
    for found in [&named, &listed] {
        let mut members: Vec<&str> = Vec::new();
        for group in found["groups"].as_array().expect("a list") {
            members.extend(
                group["members"].as_array().expect("a list").iter().filter_map(serde_json::Value::as_str),
            );
        }
        members.sort_unstable();
        assert_eq!(members, ["FIC1", "LIC2"], "{}", found["groups"]);
    }
    assert_eq!(names(&listed), ["FIC1", "LIC2", "TIC3"]);
    // A column may be of two loops: the set point of one is the output of the other.
    assert_eq!(listed["loops"][2]["master"], "FIC1", "{}", listed["loops"][2]);
    assert!(named["loops"][2]["master"].is_null());
    let why = listed["skipped"][0].as_str().expect("one");
    assert!(why.starts_with("PIC4: op \"XMV4\": no column is called so"), "{why}");
    // Diagnosed too, out of the same table.
    let judged = found(&[&text(&by_list), "--loops", &text(&list)]);
    assert_eq!(names(&judged), ["FIC1", "LIC2", "TIC3"]);

    let refused = stictiond(&["plant", &text(&by_list)]);
    let stderr = String::from_utf8(refused.stderr).expect("text");
    assert!(
        refused.status.code() == Some(2) && stderr.contains("1 skipped: wide: line 1: no column"),
        "{stderr}"
    );
}

#[test]
fn why_nothing_could_be_used_is_said_in_one_line() {
    let path = folder("plant-refused");
    for k in 0..25 {
        fs::write(
            path.join(format!("unit{k:02}.csv")),
            wide(&format!("t,XMV1,XMEAS1,XMV2,XMEAS2,XMV3,XMEAS{}", k + 10)),
        )
        .expect("writable");
    }
    fs::write(path.join("short.csv"), "t,op,pv\n0,10,20\n1,11,21\n2,12,22\n3,13,23\n4,14,24\n")
        .expect("writable");
    let output = stictiond(&["plant", path.to_str().expect("text")]);
    let stderr = String::from_utf8(output.stderr).expect("text");
    assert_eq!((output.status.code(), stderr.lines().count()), (Some(2), 1), "{stderr}");
    assert!(stderr.contains("no record could be used, 26 skipped: short: 5 good samples of PV"), "{stderr}");
    assert!(
        stderr.contains("; unit00: line 1: no column op, pv ") && stderr.contains("; unit01: "),
        "{stderr}"
    );
    assert!(stderr.trim_end().ends_with("; 23 more, as unit00"), "{stderr}");

    fs::write(
        path.join("FIC1.csv"),
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/example.csv")).expect("there"),
    )
    .expect("writable");
    let output = stictiond(&["plant", path.to_str().expect("text"), "--format", "text", "--diagnose", "0"]);
    let text = String::from_utf8(output.stdout).expect("text");
    let said: Vec<&str> = text.lines().filter(|line| line.starts_with("skipped ")).collect();
    assert_eq!((said.len(), said.last()), (21, Some(&"skipped 6 more, as unit00")), "{text}");
}

#[test]
fn the_loops_of_a_store_are_those_of_the_records_that_were_taken_into_it() {
    /// 2026-11-21T04:40:00Z.
    const BEGIN: f64 = 1_795_236_000.0;
    let path = folder("plant-store");
    let (kept, records) = (path.join("store"), path.join("records"));
    fs::create_dir_all(&records).expect("writable");
    let mut all: Vec<Series> = Vec::new();
    for (own, columns) in [("FIC1", [1, 2]), ("LIC2", [3, 4]), ("TIC3", [5, 6])] {
        let samples = |column: usize| -> Vec<Sample> {
            (0..1440).map(swinging).map(|row| Sample::good(BEGIN + row[0], row[column])).collect()
        };
        let series = |(tag, column): (&str, usize)| {
            let (control_loop, source, unit) = (own.to_string(), String::new(), String::new());
            let tag = TagName { control_loop, tag: tag.to_string(), source, unit };
            Series { tag: Arc::new(tag), samples: samples(column) }
        };
        all.extend([("op", columns[0]), ("pv", columns[1])].map(series));
        // Told once, long before what is read.
        let mut mode = series(("mode", columns[0]));
        mode.samples = vec![Sample::good(BEGIN, 1.0)];
        all.push(mode);
        let row = |k: u32| {
            let row = swinging(k);
            format!("{},{},{}\n", BEGIN + row[0], row[columns[0]], row[columns[1]])
        };
        let text = "t,op,pv\n".to_string() + &(0..1440).map(row).collect::<String>();
        fs::write(records.join(own).with_extension("csv"), text).expect("writable");
    }
    let mut store = Store::open(&store::Config::new(&kept)).expect("opens");
    store.write(&Batch { series: all, rows: Vec::new() }).expect("writes");
    drop(store);
    let text = |path: &Path| path.to_str().expect("text").to_string();
    let of_store = found(&[&text(&kept), "--diagnose", "0"]);
    let of_records = found(&[&text(&records), "--diagnose", "0"]);
    assert_eq!(names(&of_store), ["FIC1", "LIC2", "TIC3"]);
    assert_eq!(of_store["groups"].as_array().map(Vec::len), Some(1));
    for name in ["period_s", "members"] {
        assert_eq!(of_store["groups"][0][name], of_records["groups"][0][name]);
    }
    for (own, other) in of_store["loops"]
        .as_array()
        .expect("a list")
        .iter()
        .zip(of_records["loops"].as_array().expect("a list"))
    {
        for name in ["pv_mean", "swing", "noise_share", "oscillations"] {
            assert_eq!(own[name], other[name], "{name} of {}", own["loop"]);
        }
    }
    // The latter half, in which the mode was not told again.
    let half = (BEGIN + 43_200.0).to_string();
    let later = found(&[&text(&kept), "--from", &half, "--diagnose", "1"]);
    assert_eq!(later["loops"][0]["service_factor"].as_f64(), Some(1.0), "{}", later["loops"][0]);
    assert_eq!(names(&later), ["FIC1", "LIC2", "TIC3"]);
    let (after, place) = ((BEGIN + 1e6).to_string(), text(&kept));
    for (args, says) in [
        (&["--from", after.as_str()][..], "no record could be used, 3 skipped: FIC1: 0 good samples of PV"),
        (&["--from", "5", "--to-time", "4"], "--from is later than --to-time"),
        (&["--loops", "x.csv"], "--loops: a store knows its loops"),
    ] {
        let output = stictiond(&[&["plant", place.as_str()], args].concat());
        let stderr = String::from_utf8(output.stderr).expect("text");
        assert!(output.status.code() == Some(2) && stderr.contains(says), "{stderr}");
    }

    // A configuration names the store, and which of its loops are the plant's.
    let config = configured(&path, &kept, &[("FIC1", 101), ("LIC2", 105)]);
    assert_eq!(names(&found(&[&text(&config), "--diagnose", "0"])), ["FIC1", "LIC2"]);
    let output = stictiond(&["plant", "postgres://user:secret@127.0.0.1/plant"]);
    let stderr = String::from_utf8(output.stderr).expect("text");
    assert!(
        output.status.code() == Some(2) && stderr.contains("a password is taken from PGPASSWORD"),
        "{stderr}"
    );
    assert!(!stderr.contains("secret"), "{stderr}");
}

/// A configuration with the store in `kept` and these loops, each with its first register.
fn configured(path: &Path, kept: &Path, loops: &[(&str, u32)]) -> PathBuf {
    let tag = |register: u32| {
        format!("{{ device = \"d\", register = \"holding\", address = {register}, type = \"f32\" }}")
    };
    let mut written = format!(
        "[store]\nfolder = {kept:?}\n[[modbus]]\nname = \"d\"\naddress = \"127.0.0.1:502\"\naddress_base = 1\npoll_ms = 1000\n"
    );
    for (id, register) in loops {
        let (op, pv) = (tag(*register), tag(register + 2));
        let _ = write!(written, "[[loop]]\nid = \"{id}\"\nop = {op}\npv = {pv}\n");
    }
    let config = path.join("plant.toml");
    fs::write(&config, written).expect("writable");
    config
}

/// A loop that is no longer configured ran on for a month, and a clock was ahead by decades.
#[test]
fn the_latest_week_of_a_store_is_that_of_the_loops_that_are_read() {
    /// 2023-11-14T22:13:20Z.
    const BEGIN: f64 = 1_700_000_000.0;
    let path = folder("plant-store-week");
    let kept = path.join("store");
    let config = configured(&path, &kept, &[("FIC1", 101)]);
    let text = |path: &Path| path.to_str().expect("text").to_string();
    let (config, place) = (text(&config), text(&kept));
    let refused = |args: &[&str]| {
        let output = stictiond(&[&["plant"], args].concat());
        let stderr = String::from_utf8(output.stderr).expect("text");
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        stderr.trim_end().to_string()
    };
    let write = |own: &str, begin: f64| {
        let of = |(tag, column): (&str, usize)| {
            let (control_loop, source, unit) = (own.to_string(), String::new(), String::new());
            let tag = TagName { control_loop, tag: tag.to_string(), source, unit };
            let sample = |row: [f64; 7]| Sample::good(begin + row[0], row[column]);
            Series { tag: Arc::new(tag), samples: (0..1440).map(swinging).map(sample).collect() }
        };
        let mut series = Vec::from([("op", 1), ("pv", 2), ("mode", 0)].map(of));
        series[2].samples = vec![Sample::good(4e9, 1.0)];
        let mut store = Store::open(&store::Config::new(&kept)).expect("opens");
        store.write(&Batch { series, rows: Vec::new() }).expect("writes");
    };
    drop(Store::open(&store::Config::new(&kept)).expect("opens"));
    let fresh = refused(&[&place]);
    assert!(fresh.ends_with(": the store has no samples of a loop"), "{fresh}");
    write("OLD", BEGIN + 30.0 * 86_400.0);
    let others = refused(&[&config]);
    assert!(others.ends_with(": the store has no samples of a loop of this configuration"), "{others}");
    write("FIC1", BEGIN);
    assert_eq!(names(&found(&[&config, "--diagnose", "0"])), ["FIC1"]);
    let span = ["2023-12-01T00:00:00Z", "2023-12-02T00:00:00Z"];
    let none = refused(&[&config, "--from", span[0], "--to-time", span[1]]);
    assert!(none.contains(": FIC1: 0 good samples of PV"), "{none}");
    assert!(none.ends_with(&format!("; read from {} to {}", span[0], span[1])), "{none}");
}

/// Tennessee Eastman with a sticking valve in the reactor's cooling water, whose swing has 2.2 samples a period.
#[test]
fn a_loop_that_is_sampled_too_slowly_says_so() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let Some(run) = root.map(|up| up.join("shared/data/tep/d14_te.csv")).find(|path| path.exists()) else {
        println!("skipped: there is no shared/data/tep/d14_te.csv");
        return;
    };
    let list = folder("plant-tep").join("loops.csv");
    let pairs = [
        ("FIC1", 3, 1),
        ("FIC2", 1, 2),
        ("FIC3", 2, 3),
        ("FIC4", 4, 4),
        ("FIC10", 6, 10),
        ("LIC12", 7, 12),
        ("LIC15", 8, 15),
        ("FIC19", 9, 19),
        ("TIC9", 10, 9),
        ("TIC21", 10, 21),
        ("TIC22", 11, 22),
    ];
    let row = |(name, op, pv): (&str, u32, u32)| format!("{name},XMV{op},XMEAS{pv}\n");
    fs::write(&list, "loop,op,pv\n".to_string() + &pairs.map(row).concat()).expect("writable");
    let found = found(&[run.to_str().expect("text"), "--loops", list.to_str().expect("text")]);
    assert_eq!(names(&found), pairs.map(|(name, ..)| name));
    let loops = found["loops"].as_array().expect("a list");
    has_its_parts(&found["work"]);
    let slow: Vec<_> = loops.iter().filter(|own| own["reason_code"] == "undersampled").collect();
    assert!(slow.iter().any(|own| own["loop"] == "TIC9" || own["loop"] == "TIC21"), "{loops:?}");
    for own in slow.iter().filter(|own| own["cause"] == "unknown") {
        let why = own["why"].as_str().expect("a sentence");
        assert!(
            why.contains("its valve could not be judged: sampled too slowly: ")
                && why.contains(" samples per period"),
            "{own}"
        );
    }
}
