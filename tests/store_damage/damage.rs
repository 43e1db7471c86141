//! A store, damaged at random, and what is made of it.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stictiond::signal::{Quality, Sample};
use stictiond::store::{
    self, AlarmRow, Batch, Config, DiagnosisRow, ModelRow, Reader, Row, Series, Store, TagName, TransitionRow,
};

/// Seconds of samples, of so many tags.
const SECONDS: usize = 900;
const TAGS: usize = 12;
const ALARMS: usize = 30;
const CHANGES: usize = 370;
const STATES: [&str; 2] = ["normal", "active"];
/// When it begins (s).
pub const BEGIN: f64 = 1_790_000_000.0;
/// Bytes of a page of the database.
const PAGE: usize = 8192;

/// Files that are damaged at once: one, or two of which one would make up for the other.
pub const FILES: [&[&str]; 5] =
    [&["store.db"], &["store.db-wal"], &["states.log"], &["store.sum"], &["store.ack"]];
pub const PAIRS: [&[&str]; 6] = [
    &["store.db", "states.log"],
    &["store.db-wal", "states.log"],
    &["store.sum", "states.log"],
    &["store.ack", "states.log"],
    &["store.db", "store.db-wal"],
    &["store.db", "store.ack"],
];
/// How.
pub const KINDS: [&str; 4] = ["page", "bit", "cut", "zeroes"];

/// Everything that is in a store.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Content {
    pub samples: usize,
    pub alarms: Vec<AlarmRow>,
    pub changes: Vec<TransitionRow>,
    pub diagnoses: usize,
    pub models: usize,
}

fn alarm(n: usize, at: usize) -> AlarmRow {
    AlarmRow {
        control_loop: format!("FIC{n:03}"),
        kind: "stiction".into(),
        active: n.is_multiple_of(2),
        acknowledged: at.is_multiple_of(3),
        since: Some(BEGIN + at as f64),
        detail: "f = 2.5 % OP".into(),
        by: Some("jw".into()),
        ..AlarmRow::default()
    }
}

fn rows(at: usize) -> Vec<Row> {
    let mut rows = Vec::new();
    if at < CHANGES {
        let n = at % ALARMS;
        rows.push(Row::Alarm(alarm(n, at)));
        rows.push(Row::Transition(TransitionRow {
            control_loop: format!("FIC{n:03}"),
            kind: "stiction".into(),
            at: BEGIN + at as f64,
            before: STATES[at / ALARMS % 2].into(),
            after: STATES[(at / ALARMS + 1) % 2].into(),
            cause: "raised".into(),
            detail: format!("change {at}"),
            ..TransitionRow::default()
        }));
    }
    if at.is_multiple_of(60) {
        let control_loop = format!("FIC{:03}", at / 60);
        let (finished, report) = (BEGIN + at as f64, store::pack(&"a report ".repeat(2000)));
        rows.push(Row::Diagnosis(DiagnosisRow {
            control_loop: control_loop.clone(),
            finished,
            outcome: "stiction".into(),
            report,
            ..DiagnosisRow::default()
        }));
        rows.push(Row::Model(ModelRow {
            control_loop,
            version: 1,
            since: finished,
            effects: "drift\t\n".into(),
        }));
    }
    rows
}

/// Makes a store that was at work and was killed: part of it is in its log.
pub fn made(folder: &Path) -> Content {
    let (live, _) = (folder.join("live"), fs::create_dir_all(folder).expect("writable"));
    let mut rng = Pcg64::seed_from_u64(7);
    let mut store = Store::open(&Config::new(&live)).expect("a new store");
    let tags: Vec<Arc<TagName>> = (0..TAGS)
        .map(|n| TagName {
            control_loop: format!("FIC{n:03}"),
            tag: "pv".into(),
            source: format!("register {n}"),
            unit: "m3/h".into(),
        })
        .map(Arc::new)
        .collect();
    for at in 0..SECONDS {
        let t = BEGIN + at as f64;
        let sample = |value| Sample { t, value, quality: Quality::Good };
        let of = |tag: &Arc<TagName>| Series {
            tag: tag.clone(),
            samples: vec![sample(50.0 + rng.random::<f64>())],
        };
        let series = tags.iter().map(of).collect();
        store.write(&Batch { series, rows: rows(at) }).expect("written");
        store.tidy(t).expect("tidied");
    }
    let killed = folder.join("killed");
    copy(&live, &killed);
    drop(store);
    content(&Reader::open(&killed).expect("whole"))
}

pub fn copy(from: &Path, to: &Path) {
    let _ = fs::remove_dir_all(to);
    fs::create_dir_all(to).expect("writable");
    for file in fs::read_dir(from).expect("there").map(|file| file.expect("read")) {
        // What SQLite keeps in memory between processes is made anew.
        let is_file = file.file_type().expect("a type").is_file();
        if is_file && !file.file_name().to_string_lossy().ends_with("-shm") {
            fs::copy(file.path(), to.join(file.file_name())).expect("copied");
        }
    }
}

/// Everything that a reader finds.
pub fn content(reader: &Reader) -> Content {
    let mut found = Content { alarms: reader.alarms().expect("alarms"), ..Content::default() };
    found.changes = reader.transitions(0, 10_000).expect("changes").into_iter().map(|(_, row)| row).collect();
    found.changes.sort_by(|a, b| a.at.total_cmp(&b.at));
    found.diagnoses = reader.diagnoses(0, 10_000).expect("runs").len();
    found.models =
        (0..TAGS + 3).filter(|n| reader.model(&format!("FIC{n:03}")).is_ok_and(|m| m.is_some())).count();
    found
}

/// Samples in it.
pub fn samples(reader: &mut Reader) -> usize {
    let (mut from, mut count) = (0, 0);
    while let Some(start) = reader.next_start(from).expect("a start") {
        count += reader.chunk(start, None).expect("a chunk").values().map(Vec::len).sum::<usize>();
        from = start + 1;
    }
    count
}

/// Damages a file in one way; false where there is nothing to damage.
pub fn damage(folder: &Path, file: &str, kind: &str, rng: &mut Pcg64) -> bool {
    let path = folder.join(file);
    let mut bytes = fs::read(&path).unwrap_or_default();
    if bytes.is_empty() {
        return false;
    }
    let before = bytes.clone();
    let at = rng.random_range(0..bytes.len());
    match kind {
        "bit" => bytes[at] ^= 1 << rng.random_range(0..8),
        "cut" => bytes.truncate(at),
        "zeroes" => {
            let end = (at + rng.random_range(1..60_000)).min(bytes.len());
            bytes[at..end].fill(0);
        }
        _ => {
            let from = at / PAGE * PAGE;
            let end = (from + PAGE).min(bytes.len());
            bytes[from..end].iter_mut().for_each(|byte| *byte = rng.random());
        }
    }
    fs::write(&path, &bytes).expect("written");
    bytes != before
}

/// What came of one damaged store.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// The store opened and goes on being written.
    pub working: bool,
    /// States of alarms that are back, of all.
    pub states: (usize, usize),
    /// States, changes and models that are not back, and records that are told to be lost.
    pub missing: usize,
    pub told: u64,
    /// Records of the second copy that can no longer be read.
    pub unreadable: u64,
    /// Samples that are back, of all.
    pub samples: (usize, usize),
    /// Runs that are back, of all.
    pub runs: (usize, usize),
    /// What is told of what is left; empty where nothing is lost.
    pub left: String,
    /// `store check` says that it is good.
    pub checked_good: bool,
}

impl Outcome {
    /// Whether it is told that some of these may be lost.
    pub fn lacks(&self, what: &str) -> bool {
        let told = self.left.split("; ").filter_map(|part| part.strip_suffix(": some may be lost"));
        told.flat_map(|words| words.split(", ")).any(|word| word == what)
    }

    /// Something is gone that nobody says is, or more records are told to be lost than cannot be read.
    pub fn mistold(&self) -> bool {
        let gone = |(back, all): (usize, usize)| back < all;
        self.missing as u64 > self.told
            || self.told > self.unreadable
            || gone(self.samples) && !self.lacks("samples")
            || gone(self.runs) && !self.lacks("runs")
    }
}

/// Records of the second copy that are behind the first byte which is not what it was, each as long as its head and its text.
fn unreadable(before: &[u8], after: &[u8]) -> u64 {
    let same = before.iter().zip(after).take_while(|(a, b)| a == b).count();
    let (mut at, mut count) = (0, 0);
    while let Some(length) = before.get(at..at + 4) {
        at += 16 + u32::from_le_bytes(length.try_into().expect("four")) as usize;
        count += u64::from(at > same);
    }
    count
}

/// What is told of rows that are back is what is there.
fn counted(left: &str, found: &Content) {
    let counts = [
        ("diagnoses", found.diagnoses),
        ("transitions", found.changes.len()),
        ("alarms", found.alarms.len()),
        ("models", found.models),
    ];
    for (table, count) in counts {
        assert!(left.contains(&format!(" {table} {count},")), "{count} {table} are back: {left}");
    }
}

/// Opens a damaged copy as the daemon would, looks at what is there, then has it repaired.
pub fn opened(folder: &Path, truth: &Content, whole: usize) -> Outcome {
    let config = Config::new(folder);
    let checked = store::check(folder).is_ok_and(|found| found.faults.is_empty());
    let opening = Store::open(&config);
    let mut outcome = Outcome { working: opening.is_ok(), checked_good: checked, ..Outcome::default() };
    let mut reader = Reader::open(folder).expect("what is left can be read");
    let found = content(&reader);
    let back = truth.alarms.iter().filter(|row| found.alarms.contains(row)).count();
    outcome.states = (back, truth.alarms.len());
    let changes = truth.changes.iter().filter(|row| !found.changes.contains(row)).count();
    outcome.missing = changes + truth.models - found.models.min(truth.models) + truth.alarms.len() - back;
    outcome.samples = (samples(&mut reader), whole);
    outcome.runs = (found.diagnoses, truth.diagnoses);
    if let Some((left, states)) = reader.lost() {
        counted(&left, &found);
        (outcome.left, outcome.told) = (left, states);
    }
    drop(reader);
    match opening {
        Ok(store) => drop(store),
        Err(error) => {
            assert!(error.is_damage(), "{error}");
            assert!(store::check(folder).is_ok_and(|found| !found.faults.is_empty()), "it is told");
            let left = store::repair(&config).expect("repaired").left;
            let again = Store::open(&config).unwrap_or_else(|error| panic!("{error}, after {left}"));
            drop(again);
            let mut reader = Reader::open(folder).expect("a new store");
            assert_eq!((content(&reader), samples(&mut reader)), (found, outcome.samples.0), "{left}");
            // Where a change is lost the history of its alarm has a gap, and nothing else is wrong.
            let mut faults = store::check(folder).expect("read").faults;
            faults.retain(|fault| outcome.missing == 0 || !fault.starts_with("alarm of "));
            assert_eq!(faults, [] as [String; 0]);
        }
    }
    outcome
}

/// One after the other: files, kind and what came of it.
pub fn sweep(
    place: &Path,
    sets: &[&[&str]],
    cases: usize,
    seed: u64,
    mut each: impl FnMut(&str, &str, &Outcome),
) {
    let truth = made(place);
    let (killed, own): (PathBuf, PathBuf) = (place.join("killed"), place.join("case"));
    copy(&killed, &own);
    let whole = samples(&mut Reader::open(&own).expect("whole"));
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut case = 0;
    while case < cases {
        let (files, kind) = (sets[case % sets.len()], KINDS[case / sets.len() % KINDS.len()]);
        copy(&killed, &own);
        if files.iter().all(|file| damage(&own, file, kind, &mut rng)) {
            let [before, after] =
                [&killed, &own].map(|place| fs::read(place.join("states.log")).expect("there"));
            let mut outcome = opened(&own, &truth, whole);
            outcome.unreadable = unreadable(&before, &after);
            each(&files.join(" + "), kind, &outcome);
            case += 1;
        }
    }
}
