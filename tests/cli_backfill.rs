//! `stictiond backfill` over seven days of a plant, with gaps and drop-outs; records whose clock was set for the summer; and
//! what a store has of tags that are told only when they change.

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use stictiond::diagnosis::{Settings, diagnose};
use stictiond::signal::{Record, Sample};
use stictiond::store::{self, Batch, Series, Store, TagName};
use stictiond::table::{self, Options, Source};

/// Four times PV is exactly zero, and for an hour and a half nothing was written.
const RECORD: &str = "FIC211";

fn shared(name: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let path = root
        .map(|up| up.join("shared/data/long").join(name).with_extension("csv"))
        .find(|path| path.exists());
    if path.is_none() {
        println!("skipped: there is no shared/data/long/{name}.csv");
    }
    path
}

fn backfill(record: &Path, more: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["backfill", "--window", "90000", "--step", "90000", "--format", "json"])
        .arg(record)
        .args(more)
        .output()
        .expect("runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// What was said of each window: its end, the verdict, f with its interval, the evidence.
fn said(timeline: &Value) -> Vec<Value> {
    let items = timeline["items"].as_array().expect("a list").iter();
    let of = |item: &Value| ["to", "verdict", "f", "f_ci95", "delta_aic"].map(|name| item[name].clone());
    items.map(|item| of(item).into_iter().collect()).collect()
}

#[test]
fn seven_days_become_a_timeline_with_drop_outs_marked_and_not_fitted() {
    let Some(record) = shared(RECORD) else { return };
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-backfill-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("writable");
    let plot = folder.join("week.svg");
    let timeline = backfill(&record, &["--plot", plot.to_str().expect("text")]);
    assert_eq!((&timeline["op_drop_outs"], &timeline["pv_drop_outs"]), (&0.into(), &4.into()));
    assert!(timeline["gaps_s"].as_f64() > Some(3600.0), "{}", timeline["gaps_s"]);
    let items = said(&timeline);
    assert!(items.len() >= 6, "{items:?}");
    let share = |item: &Value| item["good_share"].as_f64().expect("a share");
    let shares: Vec<f64> = timeline["items"].as_array().expect("a list").iter().map(share).collect();
    assert!(shares.iter().any(|share| *share < 1.0) && shares.contains(&1.0), "{shares:?}");

    // With the zeros taken out of the file the same is said, number for number: they were never fitted.
    let text = fs::read_to_string(&record).expect("text");
    let (mut taken, mut without) = (0, String::new());
    for line in text.lines() {
        let mut cells: Vec<&str> = line.split(',').collect();
        if cells[2].parse() == Ok(0.0) {
            (cells[2], taken) = ("", taken + 1);
        }
        without += &(cells.join(",") + "\n");
    }
    assert_eq!(taken, 4);
    let clean = folder.join(RECORD).with_extension("csv");
    fs::write(&clean, without).expect("writable");
    let other = backfill(&clean, &[]);
    assert_eq!(other["pv_drop_outs"], 0);
    assert_eq!(said(&other), items);

    // The picture shades them, and draws no line over the gap.
    let drawn = fs::read_to_string(&plot).expect("text");
    assert!(drawn.matches("<rect class=\"bad\"").count() >= 1 && drawn.contains("bad, not fitted"));
    assert!(
        drawn.matches("<polyline class=\"pv\"").count() >= 3,
        "PV is interrupted, and there is the evidence"
    );
    for axis in
        ["time since the record began (h)", "OP (unit of OP)", "PV (unit of PV)", "f (% OP)", "evidence (-)"]
    {
        assert!(drawn.contains(axis), "{axis}");
    }
    assert!(!drawn.contains("NaN") && !drawn.contains("inf"));
    fs::remove_dir_all(&folder).expect("writable");
}

/// The night of 2026-10-25 in Berlin, when the hour from two to three comes twice, and that of 2026-03-29, when there is none.
#[test]
fn the_hour_that_comes_twice_is_told_apart_by_its_offset_and_else_counted() {
    let rows = |stamps: &[&str]| {
        let line = |(k, stamp): (usize, &&str)| format!("{stamp},{k},{k}\n");
        format!("t,op,pv\n{}", stamps.iter().enumerate().map(line).collect::<String>())
    };
    let read = |text: &str| {
        table::read(Source::Bytes(text.as_bytes()), &Options::default()).expect("a record").record
    };
    let steps =
        |record: &Record| -> Vec<f64> { record.pv.windows(2).map(|two| two[1].t - two[0].t).collect() };
    let autumn = read(&rows(&[
        "2026-10-25T01:30:00+02:00",
        "2026-10-25T02:00:00+02:00",
        "2026-10-25T02:30:00+02:00",
        "2026-10-25T02:00:00+01:00",
        "2026-10-25T02:30:00+01:00",
        "2026-10-25T03:00:00+01:00",
    ]));
    assert_eq!(steps(&autumn), [1800.0; 5]);
    let spring =
        read(&rows(&["2026-03-29T01:30:00+01:00", "2026-03-29T03:00:00+02:00", "2026-03-29T03:30:00+02:00"]));
    assert_eq!(steps(&spring), [1800.0; 2]);

    // Local time without its offset: every sample is kept under the stamp that is written, none is moved or made, and the
    // diagnosis counts what goes back and what is there twice.
    let local = read(&rows(&[
        "2026-10-25 01:30:00",
        "2026-10-25 02:00:00",
        "2026-10-25 02:30:00",
        "2026-10-25 02:00:00",
        "2026-10-25 02:30:00",
        "2026-10-25 03:00:00",
    ]));
    assert_eq!(steps(&local), [1800.0, 1800.0, -1800.0, 1800.0, 1800.0]);
    let found = diagnose(&local, &Settings::default());
    // Of OP and of PV.
    assert_eq!((found.preparation.out_of_order, found.preparation.duplicates), (2, 4));
}

/// What is said of the one window of a loop that swings, whose mode was told days before and not since.
fn with_a_mode_of_before(mode: f64) -> Value {
    let name = format!("cli-backfill-mode-{mode}-{}", std::process::id());
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    let series = |tag: &str, samples: Vec<Sample>| {
        let (control_loop, tag, source) = ("A".into(), tag.into(), "a node".into());
        Series { tag: Arc::new(TagName { control_loop, tag, source, unit: String::new() }), samples }
    };
    let wave = |phase: f64| -> Vec<Sample> {
        let noise = |k: u32| 0.2 * (f64::from(k * k % 997) / 997.0 - 0.5);
        let value = |k: u32| 50.0 + (0.2 * f64::from(k) + phase).sin() + noise(k);
        (0..1200).map(|k| Sample::good(500_000.0 + f64::from(k), value(k))).collect()
    };
    let told = vec![Sample::good(1000.0, 1.0 - mode), Sample::good(2000.0, mode)];
    let series = vec![series("op", wave(0.0)), series("pv", wave(1.0)), series("mode", told)];
    let mut store = Store::open(&store::Config::new(&folder)).expect("opens");
    store.write(&Batch { series, rows: Vec::new() }).expect("writes");
    drop(store);
    let timeline = backfill(&folder, &["--loop", "A", "--from", "500000"]);
    fs::remove_dir_all(&folder).expect("it was made");
    let items = timeline["items"].as_array().expect("a list");
    assert_eq!(items.len(), 1, "{timeline}");
    items[0].clone()
}

#[test]
fn a_mode_that_was_told_before_the_first_window_is_in_force_in_it() {
    let manual = |item: &Value| item["reason"].as_str().expect("text").contains("manual");
    let item = with_a_mode_of_before(1.0);
    assert!(!manual(&item), "{item}");
    let item = with_a_mode_of_before(0.0);
    assert!(manual(&item) && item["verdict"] == "not_identifiable", "{item}");
}

/// As the daemon, which has OP's unit from the configuration: twelve alone may be milliamperes or per cent.
#[test]
fn the_unit_of_op_in_a_store_tells_its_span() {
    let name = format!("cli-backfill-unit-{}", std::process::id());
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/example.csv");
    let example = table::record(Path::new(example)).expect("the example is there");
    let tag = |tag: &str, unit: &str, scale: f64, offset: f64, samples: &[Sample]| {
        let (control_loop, tag, source) = ("A".into(), tag.into(), "a node".into());
        let tag = Arc::new(TagName { control_loop, tag, source, unit: unit.into() });
        let moved = |s: &Sample| Sample::good(500_000.0 + s.t, offset + scale * s.value);
        Series { tag, samples: samples.iter().map(moved).collect() }
    };
    let series = vec![tag("op", "mA", 0.16, 4.0, &example.op), tag("pv", "m3/h", 1.0, 0.0, &example.pv)];
    let mut store = Store::open(&store::Config::new(&folder)).expect("opens");
    store.write(&Batch { series, rows: Vec::new() }).expect("writes");
    drop(store);
    let timeline = backfill(&folder, &["--loop", "A"]);
    fs::remove_dir_all(&folder).expect("it was made");
    assert_eq!(timeline["items"][0]["f_unit"], "% OP", "{timeline}");
    let f = timeline["items"][0]["f"].as_f64().expect("it sticks");
    assert!((f - 0.5).abs() < 0.05, "{timeline}");
}

#[test]
fn numbers_that_count_from_1970_or_as_spreadsheets_do_are_diagnosed_at_their_time() {
    let folder =
        Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-backfill-epochs-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("writable");
    let begin = 1_763_700_000u64;
    let seconds = |k: u32| begin + u64::from(k);
    let times: [(&str, &dyn Fn(u32) -> String); 5] = [
        ("s", &|k| seconds(k).to_string()),
        ("ms", &|k| format!("{}000", seconds(k))),
        ("us", &|k| format!("{}000000", seconds(k))),
        ("ns", &|k| format!("{}000000000", seconds(k))),
        ("days", &|k| format!("{:.9}", seconds(k) as f64 / 86_400.0 + 25_569.0)),
    ];
    for (unit, time) in times {
        let row = |k: u32| {
            let phase = 0.2 * f64::from(k);
            format!("{},{:.4},{:.4}\n", time(k), 50.0 + phase.sin(), 20.0 + (phase + 1.0).sin())
        };
        let file = folder.join(unit).with_extension("csv");
        fs::write(&file, "time,op,pv\n".to_string() + &(0..600).map(row).collect::<String>())
            .expect("writable");
        // From its middle on.
        let timeline = backfill(&file, &["--from", "2025-11-21T04:45:00Z"]);
        let is = |found: &Value, k: u32| (found.as_f64().expect("a time") - seconds(k) as f64).abs() < 1e-3;
        assert!(is(&timeline["begin"], 300), "{unit}: {}", timeline["begin"]);
        assert!(is(&timeline["items"][0]["to"], 599), "{unit}: {}", timeline["items"]);
    }
    fs::remove_dir_all(&folder).expect("writable");
}

#[test]
fn what_cannot_be_done_is_told_and_costs_no_report() {
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/example.csv");
    let run = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
        let output = command.arg("backfill").args(args).output().expect("runs");
        let [out, err] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).expect("text"));
        (output.status.code(), out, err)
    };
    let (code, out, err) = run(&[example, "--format", "json", "--plot", "/dev/full"]);
    assert!(code == Some(1) && err.starts_with("stictiond: /dev/full: "), "{err}");
    let report: Value = serde_json::from_str(&out).expect("the report");
    assert!(report["items"].as_array().is_some_and(|items| !items.is_empty()), "{report}");

    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-future-{}", std::process::id()));
    let into = folder.to_str().expect("text");
    let server = ["plant.toml", "--loop", "A", "--from", "0", "--into", into];
    for (args, says) in [
        (&[example, "--plot", "no/such/folder/p.svg"][..], "lies in a folder that is not there"),
        (&[example, "--from", "5", "--to-time", "4"], "--from is later than --to-time"),
        (&[example, "--from", "1e9"], "no two samples of PV with different times in the time that --from"),
        (&[&server[..], &["--to-time", "2900-01-01T00:00:00Z"]].concat(), "--to-time is in the future"),
    ] {
        let (code, out, err) = run(args);
        assert_eq!((code, out.as_str(), err.lines().count()), (Some(2), "", 1), "{err}");
        assert!(err.contains(says), "{err}");
    }
    assert!(!folder.exists(), "nothing was begun");
}
