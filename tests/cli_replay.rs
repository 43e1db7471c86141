//! `stictiond replay`: a recorded day comes out bit for bit, a bundle too, and what is none is refused.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use stictiond::app::App;
use stictiond::diagnosis::{Diagnosis, NotIdentifiable, Settings, Verdict};
use stictiond::residual::Structure;
use stictiond::results::{Basis, Judged, Outcome, Run, Silent, Trigger};
use stictiond::serve::LoopInfo;
use stictiond::serve::dto::bundle::Bundle;
use stictiond::serve::dto::{BasisText, Report};
use stictiond::signal::{BadReason, LoopId, Quality, Record, Role, Sample, Series};
use stictiond::sim::{demo_plant, simulate};
use stictiond::store::{self, Batch, DiagnosisRow, Row, Store, TagName, pack};
use stictiond::version::BUILD;

/// 2026-01-01T00:00:00Z.
const START: f64 = 1_767_225_600.0;
const DAY_S: usize = 86_400;
/// Samples that the rings of this plant hold.
const ROOM: usize = 1500;
/// Time between two diagnoses of a loop (s).
const PERIOD_S: f64 = 10_800.0;

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("writable");
    path
}

/// Exit code, stdout, stderr; stderr is at most one line.
fn replay(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_stictiond")).arg("replay").args(arguments).output().expect("runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    let (out, err) = (text(output.stdout), text(output.stderr));
    assert!(err.lines().count() <= 1, "{err}");
    (output.status.code(), out, err)
}

/// Two loops that look at each other's PV.
fn config(folder: &Path) -> PathBuf {
    let mut text = format!(
        "[history]\nsamples_per_tag = {ROOM}\n[schedule]\nperiod_s = {PERIOD_S}\n\
         [[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n"
    );
    for (id, other, at) in [("A", "B", 0), ("B", "A", 10)] {
        text += &format!("[[loop]]\nid = '{id}'\nop_span = 100.0\ncandidates = ['{other}.pv']\n");
        for (role, address) in [("op", at), ("pv", at + 2)] {
            text += &format!(
                "[loop.{role}]\ndevice = 'd'\nregister = 'holding'\naddress = {address}\ntype = 'f32'\n"
            );
        }
    }
    let path = folder.join("plant.toml");
    fs::write(&path, text).expect("writable");
    path
}

/// A day of a loop of the demo's plant, a sample every 2 s with stamps that jitter, and an hour in which nobody answered.
fn day(index: usize) -> [Series; 2] {
    let plant = demo_plant(1);
    let run = simulate(&plant[index].spec, 2 * DAY_S, plant[index].seed).expect("sound");
    let tag = |values: &[f64], off: f64| -> Series {
        let picked = run.t.iter().zip(values).step_by(4).enumerate();
        picked
            .map(|(i, (t, value))| {
                let t = START + t + off + 1e-3 * (i % 7) as f64;
                let silent = (36_000.0..37_000.0).contains(&(t - START));
                let bad = Sample { t, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) };
                if silent { bad } else { Sample::good(t, f64::from(*value as f32)) }
            })
            .collect()
    };
    [tag(&run.op, 0.0), tag(&run.pv, 0.01)]
}

fn held(samples: &Series, now: f64) -> Series {
    let until = samples.partition_point(|sample| sample.t <= now);
    samples[until.saturating_sub(ROOM)..until].to_vec()
}

/// What a daemon says at `now`, made without rings, scheduler and store.
fn said(
    id: &str,
    own: &[Series; 2],
    other: (&str, &Series),
    structure: Option<Structure>,
    now: f64,
) -> (Run, Record) {
    let record = Record {
        op: held(&own[0], now),
        pv: held(&own[1], now),
        tags: vec![(other.0.to_string(), held(other.1, now))],
        op_span: Some(100.0),
        op_span_source: stictiond::signal::SpanSource::Given,
        ..Record::default()
    };
    let settings = Settings::default();
    let judged: Judged = App::diagnosis()(&record, &settings, structure.as_ref());
    let run = Run {
        id: LoopId::new(id),
        started: now,
        finished: now + 0.25,
        took_s: 0.25,
        trigger: Trigger::Periodic,
        op_span: record.op_span,
        basis: Some(Arc::new(Basis::of(&record, &settings, structure))),
        outcome: Outcome::Diagnosed(Box::new(judged)),
    };
    (run, record)
}

fn row(run: &Run) -> Row {
    let report = Report::text(run).expect("it did not fail");
    let basis = run.basis.as_deref().and_then(BasisText::text).expect("text");
    Row::Diagnosis(DiagnosisRow {
        control_loop: run.id.to_string(),
        finished: run.finished,
        took_s: run.took_s,
        outcome: run.outcome.as_str().into(),
        report: pack(&report),
        basis: pack(&basis),
        version: BUILD.into(),
        ..DiagnosisRow::default()
    })
}

#[test]
fn a_recorded_day_gives_identical_diagnoses() {
    let folder = folder("replay-day");
    let path = |name: &str| folder.join(name).display().to_string();
    let plant = config(&folder).display().to_string();
    let days = [("A", day(1)), ("B", day(0))];
    let (mut series, mut rows, mut stuck, mut confirmed) = (Vec::new(), Vec::new(), 0, 0);
    for (id, tags) in &days {
        for (tag, samples) in ["op", "pv"].into_iter().zip(tags) {
            let name = TagName {
                control_loop: (*id).into(),
                tag: tag.into(),
                source: "as recorded".into(),
                unit: String::new(),
            };
            series.push(store::Series { tag: Arc::new(name), samples: samples.clone() });
        }
    }
    let mut known = [None, None];
    for k in 0..8 {
        for at in 0..2 {
            let now = START + PERIOD_S * (f64::from(k) + 0.25 + 0.5 * at as f64);
            let (id, own) = &days[at];
            let (other, neighbour) = &days[1 - at];
            let name = format!("{other}.pv");
            let (run, _) = said(id, own, (&name, &neighbour[1]), known[at].clone(), now);
            known[at] = run.judged().expect("diagnosed").structure().cloned();
            confirmed += usize::from(known[at].as_ref().is_some_and(|structure| structure.confirmed > 0));
            stuck += usize::from(run.sticks());
            rows.push(row(&run));
        }
    }
    assert!(stuck >= 4, "{stuck} of 16 say that the valve sticks: the day says too little");
    assert!(confirmed >= 1, "no run found that the last model still fits: the day says nothing of those");
    let kept = store::Config { max_mb: 1000, ..store::Config::new(folder.join("store")) };
    let mut store = Store::open(&kept).expect("opens");
    store.insert(&Batch { series, rows: rows.clone() }).expect("writes");
    drop(store);
    let (code, out, err) = replay(&[&path("store"), "--config", &plant]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    assert!(out.ends_with("16 of 16 diagnoses identical to the recorded, bit for bit\n"), "{out}");

    // An export of the same samples is diagnosed when the schedule says, which is when it was recorded.
    let export = path("day.parquet");
    let made = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    let made = { made }.args(["store", "export", &path("store"), &export]).output().expect("runs");
    assert!(made.status.success());
    let (code, again, err) = replay(&[&export, "--config", &plant, "--to-time", "2026-01-01T03:00:00Z"]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{again}");
    assert!(again.ends_with("2 diagnoses; an export has none to compare them with\n"), "{again}");
    let friction = |line: &str| line.split_once("f ").map(|(_, rest)| rest.replace("  identical", ""));
    assert_eq!(
        again.lines().take(2).map(friction).collect::<Vec<_>>(),
        out.lines().take(2).map(friction).collect::<Vec<_>>()
    );

    // A record that says something else is found out, and one without its samples is no proof.
    let mut lie = Store::open(&store::Config::new(folder.join("lie"))).expect("opens");
    let mut other = rows[15].clone();
    let Row::Diagnosis(row) = &mut other else { panic!("a diagnosis") };
    let text = store::unpack(row.report.as_ref().expect("there")).expect("text");
    let (before, after) = text.split_once("\"delta_aic\":").expect("there");
    row.report = pack(&format!("{before}\"delta_aic\":1{after}"));
    lie.insert(&Batch { series: Vec::new(), rows: vec![other.clone()] }).expect("writes");
    drop(lie);
    let (code, _, err) = replay(&[&path("lie"), "--config", &plant]);
    assert!(code == Some(1) && err.contains("nothing could be compared"), "{err}");
    let mut store = Store::open(&kept).expect("opens");
    let Row::Diagnosis(row) = &mut other else { panic!("a diagnosis") };
    row.finished += 1.0;
    store.insert(&Batch { series: Vec::new(), rows: vec![other] }).expect("writes");
    drop(store);
    let (code, out, err) = replay(&[&path("store"), "--config", &plant, "--from", "2026-01-01T21:00:00Z"]);
    assert!(code == Some(1) && err.contains("1 differs: 2 of 3"), "{err}");
    assert!(out.contains("DIFFERENT: delta_aic: "), "{out}");

    // A time in which no run ended is another reason than a store that does not say what its runs worked on.
    let (code, _, err) = replay(&[&path("store"), "--config", &plant, "--from", "2026-02-01T00:00:00Z"]);
    let why = "no run in it ended in the time that --from and --to-time name";
    assert!(code == Some(2) && err.contains(why), "{err}");
    fs::remove_dir_all(&folder).expect("writable");
}

#[test]
fn what_a_table_does_not_say_is_told_by_the_options_of_tables() {
    let folder = folder("replay-table");
    let plant = config(&folder).display().to_string();
    let [op, pv] = day(1);
    // Until the first run of A, and a little longer; both values of a row have one stamp.
    let rows = op.iter().zip(&pv).take_while(|(op, _)| op.t < START + 0.27 * PERIOD_S);
    let (mut long, mut wide) = ("loop,tag,t,value\n".to_string(), "when;first;second\n".to_string());
    for (op, pv) in rows {
        long += &format!("A,op,{:.3},{}\nA,pv,{:.3},{}\n", op.t, op.value, op.t, pv.value);
        wide += &format!("{:.3};{};{}\n", op.t, op.value, pv.value);
    }
    let file = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::write(&path, text).expect("writable");
        path.display().to_string()
    };
    let (long, wide) = (file("long.csv", &long), file("wide.csv", &wide));
    let (code, named, err) = replay(&[&long, "--config", &plant]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{named}");
    let [run, count] = &named.lines().collect::<Vec<_>>()[..] else { panic!("one run: {named}") };
    assert!(
        run.contains("  A  stiction  f ") && run.contains(" % OP  ΔAIC "),
        "the run says too little: {run}"
    );
    assert_eq!(*count, "1 diagnosis; an export has none to compare it with");
    // Columns that nobody knows, of a loop that is named nowhere.
    let (code, _, err) = replay(&[&wide, "--config", &plant]);
    assert_eq!(code, Some(2), "{err}");
    let told = ["--loop", "A", "--time", "when", "--op", "first", "--pv", "second", "--time-unit", "s"];
    let (code, told, err) = replay(&[&[wide.as_str(), "--config", plant.as_str()][..], &told[..]].concat());
    assert_eq!((code, err.as_str()), (Some(0), ""), "{told}");
    assert_eq!(told, named);
    fs::remove_dir_all(&folder).expect("writable");
}

#[test]
fn a_bundle_gives_the_same_report_and_what_is_none_is_refused() {
    let folder = folder("replay-bundle");
    let (own, other) = (day(1), day(0));
    let (run, record) = said("A", &own, ("B.pv", &other[1]), None, START + 40_000.0);
    let info = LoopInfo {
        id: LoopId::new("A"),
        description: "feed".into(),
        group: "unit 10".into(),
        period_s: PERIOD_S,
    };
    let basis = run.basis.clone().expect("there");
    let bundle = Bundle::of(&info, &run, &basis, &record).expect("diagnosed");
    let good = serde_json::to_string(&bundle).expect("text");
    let file = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::write(&path, text).expect("writable");
        path.display().to_string()
    };
    let (code, out, err) = replay(&[&file("good.json", &good)]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    assert!(out.ends_with("1 of 1 diagnoses identical to the recorded, bit for bit\n"), "{out}");
    // What is told of a table would be left out in silence.
    for (record, what) in [(folder.join("good.json"), "a bundle"), (folder.clone(), "a store")] {
        for told in [["--loop", "A"], ["--op", "OUT"], ["--tz", "UTC"]] {
            let (code, _, err) = replay(&[&[record.to_str().expect("text")][..], &told[..]].concat());
            assert_eq!(code, Some(2), "{err}");
            assert!(err.contains(&format!("{what} says itself which loops and tags it has")), "{err}");
        }
    }

    // Of a run whose source was silent that is told again, whatever its samples say.
    let silent = Silent { tag: Role::Pv, since: START + 39_998.0 };
    let why = NotIdentifiable::Silent { tag: silent.tag, since: silent.since };
    let said = why.to_string();
    let outcome = Outcome::Diagnosed(Box::new(Diagnosis::bare(Verdict::NotIdentifiable(why), said).into()));
    let asked = Basis::clone(&basis).silent(Some(silent));
    let untold = Run { basis: Some(Arc::new(asked.clone())), outcome, ..run.clone() };
    let untold = Bundle::of(&info, &untold, &asked, &record).expect("told");
    let path = file("silent.json", &serde_json::to_string(&untold).expect("text"));
    let (code, out, err) = replay(&[&path]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    let why = "A  not_identifiable  silent: no good sample of PV since ";
    assert!(out.contains(why) && out.contains("1 of 1 diagnoses identical"), "{out}");

    let mut moved = bundle.clone();
    moved.samples[1].value[700] = moved.samples[1].value[700].map(|value| value + 1e-9);
    let mut short = bundle.clone();
    short.samples[0].t.pop();
    let mut strange = bundle.clone();
    strange.samples[0].quality[3] = "fine".into();
    let with = |change: &dyn Fn(&mut Bundle)| {
        let mut changed = bundle.clone();
        change(&mut changed);
        changed
    };
    let long = with(&|own| own.basis.settings.window_samples = i64::MAX as usize);
    let never = with(&|own| own.basis.settings.ts_s = Some(0.0));
    let all = with(&|own| own.basis.settings.max_gap_share = 1.5);
    let slow = with(&|own| own.basis.settings.max_delay_samples = usize::MAX);
    let often = with(&|own| own.r#loop.period_s = -1.0);
    let span = with(&|own| own.basis.op_span = Some(-100.0));
    let late = with(&|own| own.finished = 1e300);
    let text = |bundle: &Bundle| serde_json::to_string(bundle).expect("text");
    let format = good.replacen("stictiond bundle 1", "stictiond bundle 9", 1);
    for (name, text, why) in [
        ("moved.json", text(&moved), "the samples of pv are not those that were diagnosed"),
        ("short.json", text(&short), "columns of unequal length"),
        ("strange.json", text(&strange), "a quality that there is not"),
        ("long.json", text(&long), "window_samples: 9223372036854775807 must be 50 to 20000"),
        ("never.json", text(&never), "ts_s: 0 must be a number of seconds above 0"),
        ("all.json", text(&all), "max_gap_share: 1.5 must be 0 to 0.9"),
        ("slow.json", text(&slow), "max_delay_samples: "),
        ("often.json", text(&often), "period_s: "),
        ("span.json", text(&span), "span or limits of OP"),
        ("late.json", text(&late), "at no time that there is"),
        ("format.json", format, "\"stictiond bundle 9\""),
        ("half.json", good[..good.len() / 2].to_string(), "not a diagnosis bundle: EOF"),
        ("other.json", "{\"loop\": 1}".to_string(), "not a diagnosis bundle"),
        ("empty.json", String::new(), "not a diagnosis bundle"),
    ] {
        let path = file(name, &text);
        let (code, _, err) = replay(&[&path]);
        assert_eq!(code, Some(2), "{name}: {err}");
        assert!(err.starts_with(&format!("stictiond: {path}: ")) && err.contains(why), "{name}: {err}");
    }
    // A report that says something else was not made of these samples by this program.
    let mut lie = bundle.clone();
    lie.report.delta_aic = Some(1.0);
    let (code, out, err) = replay(&[&file("lie.json", &text(&lie))]);
    assert!(code == Some(1) && out.contains("DIFFERENT: delta_aic: ") && err.contains("1 differ"), "{err}");
    let (code, _, err) = replay(&[folder.to_str().expect("text")]);
    assert!(code == Some(2) && err.contains("--config FILE is needed"), "{err}");
    // Whatever is no bundle by its name is a table.
    for name in ["day.tsv", "day.xlsx", "day"] {
        let (code, _, err) = replay(&[&file(name, "t\tA.op\tA.pv\n")]);
        assert!(code == Some(2) && err.contains("--config FILE is needed"), "{name}: {err}");
    }
    fs::remove_dir_all(&folder).expect("writable");
}
