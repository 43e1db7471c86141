use super::*;
use crate::signal::{BadReason, Quality, Sample};
use crate::store::backend::Writes;
use crate::store::{
    AlarmRow, Batch, Checked, Config, DiagnosisRow, Reader, Row, Series, StoreError, TagName, Upkeep, check,
};
use rusqlite::Connection;
use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// A folder of its own, gone with the test.
pub(in crate::store) struct Folder(pub PathBuf);

impl Folder {
    pub(in crate::store) fn new() -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let name =
            format!("stictiond-store-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }

    pub(super) fn config(&self) -> Config {
        Config { chunk_s: 60, ..Config::new(&self.0) }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

pub(super) fn tag(control_loop: &str, tag: &str) -> Arc<TagName> {
    Arc::new(TagName {
        control_loop: control_loop.into(),
        tag: tag.into(),
        source: "register 7".into(),
        unit: "%".into(),
    })
}

pub(super) fn batch(tag: &Arc<TagName>, samples: Vec<Sample>) -> Batch {
    Batch { series: vec![Series { tag: tag.clone(), samples }], rows: Vec::new() }
}

pub(super) fn good(range: std::ops::Range<u32>) -> Vec<Sample> {
    range.map(|i| Sample::good(1000.0 + f64::from(i), f64::from(i) * 0.5)).collect()
}

/// Everything that is kept of a tag, chunk by chunk.
pub(super) fn all(folder: &Folder) -> BTreeMap<u32, Vec<Sample>> {
    let mut reader = Reader::open(&folder.0).expect("opens");
    let mut found: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
    let mut from = 0;
    while let Some(start) = reader.next_start(from).expect("reads") {
        for (tag, samples) in reader.chunk(start, None).expect("reads") {
            found.entry(tag).or_default().extend(samples);
        }
        from = start + 1;
    }
    assert_eq!(reader.damaged(), 0);
    found
}

pub(super) fn whole(folder: &Folder) -> Checked {
    let checked = check(&folder.0).expect("can be read");
    assert_eq!(checked.faults, [""; 0]);
    checked
}

#[test]
fn chunks_that_are_over_are_rolled_and_none_waits_for_a_stamp_from_the_future() {
    let (folder, op) = (Folder::new(), tag("A", "op"));
    let mut store = Store::open(&folder.config()).expect("opens");
    for i in 0..200 {
        store.write(&batch(&op, good(i..i + 1))).expect("writes");
        store.tidy(1000.0 + f64::from(i)).expect("tidies");
    }
    let count = |store: &Store, table: &str| -> i64 {
        store.db.query_row(&format!("SELECT count(*) FROM {table}"), [], |row| row.get(0)).expect("reads")
    };
    // 960 to 1020 .. 1140 are over, 1140 to 1200 is open.
    assert_eq!(count(&store, "chunks"), 3);
    store.write(&batch(&op, vec![Sample::good(90_000.0, 1.0)])).expect("writes");
    store.tidy(1300.0).expect("tidies");
    assert_eq!((count(&store, "chunks"), count(&store, "journal")), (5, 0));
    assert_eq!(all(&folder)[&1][..200], good(0..200));
}

#[test]
fn a_damaged_blob_is_found_and_left_out() {
    let (folder, op) = (Folder::new(), tag("A", "op"));
    let mut store = Store::open(&folder.config()).expect("opens");
    store.insert(&batch(&op, good(0..300))).expect("inserts");
    store
        .db
        .execute("UPDATE chunks SET samples = zeroblob(40) WHERE key IN (SELECT min(key) FROM chunks)", [])
        .unwrap();
    let faults = check(&folder.0).expect("can be read").faults;
    assert!(faults.len() == 1 && faults[0].contains("chunk 960 of tag 1"), "{faults:?}");
    let mut reader = Reader::open(&folder.0).expect("opens");
    // The first chunk, 960 to 1020, held 20 samples; the others are read all the same.
    assert_eq!(reader.last(&[(*op).clone()], 1000).expect("reads")[&*op], good(20..300));
    assert_eq!(reader.damaged(), 1);
}

#[test]
fn a_sample_that_takes_the_place_of_another_is_not_left_out() {
    let (folder, op) = (Folder::new(), tag("A", "op"));
    let mut store = Store::open(&folder.config()).expect("opens");
    let bad = Sample { quality: Quality::Bad(BadReason::Timeout), ..Sample::good(1005.0, 1.0) };
    let mut left_out = |samples: Vec<Sample>| {
        let before = store.twice();
        store.insert(&batch(&op, samples)).expect("inserts");
        store.twice().zip(before).map(|(after, before)| after - before)
    };
    assert_eq!(left_out(vec![bad]), Some(0));
    assert_eq!(left_out(vec![bad]), Some(1), "it is there");
    assert_eq!(left_out(good(0..10)), Some(0), "one is in the place of the bad one");
    assert_eq!(left_out(good(5..12)), Some(5));
    assert_eq!(left_out(vec![bad]), Some(1));
}

/// Neither by what comes late nor by what becomes a trend: nobody would ever know of it.
#[test]
fn a_damaged_chunk_is_not_written_over() {
    let (folder, op) = (Folder::new(), tag("A", "op"));
    let mut store = Store::open(&Config { samples_days: 0.01, ..folder.config() }).expect("opens");
    store.insert(&batch(&op, good(0..300))).expect("inserts");
    let damaging = "UPDATE chunks SET samples = zeroblob(40) WHERE key IN (SELECT min(key) FROM chunks)";
    store.db.execute(damaging, []).expect("writes");
    assert!(store.insert(&batch(&op, good(5..15))).is_err_and(|error| error.is_damage()));
    assert!(store.tidy(1e6).is_err_and(|error| error.is_damage()));
    assert_eq!(store.refused_and_damaged(), (0, 2));
    let sql = "SELECT count(*) FROM chunks WHERE length(samples) = 40";
    let there: i64 = store.db.query_row(sql, [], |row| row.get(0)).expect("reads");
    assert_eq!(there, 1);
}

/// It is what was open when the last writer ended: without it samples of the last minute would be missing.
#[test]
fn a_damaged_journal_is_not_opened_as_if_nothing_were_missing() {
    let folder = Folder::new();
    let mut store = Store::open(&folder.config()).expect("opens");
    store.write(&batch(&tag("A", "op"), good(0..5))).expect("writes");
    store.db.execute("UPDATE journal SET frame = zeroblob(40)", []).expect("writes");
    drop(store);
    for _ in 0..2 {
        assert!(Store::open(&folder.config()).is_err_and(|error| error.is_damage()));
        assert!(marked(&folder.0).is_some_and(|why| why.starts_with("the journal of chunk 960")));
    }
}

/// In the database it is damaged, in the log it is not: carried over it would be taken for what it always was.
#[test]
fn a_damaged_page_is_not_written_over() {
    let folder = Folder::new();
    let upkeep = Upkeep { each: 0, ..Upkeep::default() };
    let mut store = Store::open(&Config { upkeep, ..folder.config() }).expect("opens");
    let alarm = |acknowledged| AlarmRow {
        control_loop: "A".into(),
        kind: "stiction".into(),
        acknowledged,
        ..AlarmRow::default()
    };
    let rows = |row: AlarmRow| Batch { series: Vec::new(), rows: vec![Row::Alarm(row)] };
    store.write(&rows(alarm(false))).expect("writes");
    store.carry_over().expect("nothing is damaged");
    store.write(&rows(alarm(true))).expect("writes");
    let sql = "SELECT rootpage FROM sqlite_schema WHERE name = 'alarms'";
    let page: i64 = store.db.query_row(sql, [], |row| row.get(0)).expect("reads");
    let file = OpenOptions::new().write(true).open(folder.0.join(DATABASE)).expect("there");
    file.write_all_at(&[0x5a; 8192], (page as u64 - 1) * 8192).expect("writable");
    assert!(store.carry_over().is_err_and(|error| error.is_damage()));
    let why = format!("page {page} of ");
    assert!(marked(&folder.0).is_some_and(|told| told.starts_with(&why)));
    assert!(store.tidy(1.0).is_err_and(|error| error.is_damage()), "and it goes on failing");
    drop(store);
    assert!(Store::open(&folder.config()).is_err_and(|error| error.is_damage()));
    let left = Reader::open(&folder.0).expect("can be read");
    assert_eq!(left.alarms().expect("reads"), [alarm(true)], "the second copy has the last of them");
    assert_eq!(left.lost().map(|(_, states)| states), Some(0));
}

/// By size while much is written and somebody reads, by time while little is.
#[test]
fn the_log_stays_short() {
    const FRAME: u64 = 8192 + 24;
    let folder = Folder::new();
    let mut store = Store::open(&folder.config()).expect("opens");
    let reader = Reader::open(&folder.0).expect("opens");
    let run = |k: u32| {
        let row = DiagnosisRow {
            control_loop: "A".into(),
            finished: f64::from(k),
            report: Some(vec![7; 100_000]),
            ..DiagnosisRow::default()
        };
        Batch { series: Vec::new(), rows: vec![Row::Diagnosis(row)] }
    };
    let bound = 32 + u64::from(Upkeep::default().log) * FRAME;
    let (mut before, mut written) = (store.log_bytes(), 0);
    for k in 0..300 {
        store.write(&run(k)).expect("writes");
        // A run takes fewer than 30 pages.
        assert!(store.log_bytes() < bound + 30 * FRAME);
        written += store.log_bytes() - before;
        store.tidy(f64::from(k)).expect("tidies");
        before = store.log_bytes();
        assert!(before < bound);
        assert_eq!(reader.last_diagnoses("A", 1).expect("reads").len(), 1);
    }
    assert!(written > 3 * bound, "{written} bytes went through the log");
    store.carried = Instant::now();
    store.write(&run(300)).expect("writes");
    store.tidy(300.0).expect("tidies");
    assert!(store.log_bytes() > 0, "it is not time yet");
    store.carried = Instant::now().checked_sub(Duration::from_secs(61)).expect("a machine that has run");
    store.tidy(301.0).expect("tidies");
    assert_eq!(store.log_bytes(), 0);
    assert_eq!(reader.diagnoses(0, 1000).expect("reads").len(), 301);
}

#[test]
fn the_database_stays_within_its_room_and_what_is_oldest_goes() {
    let folder = Folder::new();
    let config = Config { max_mb: 16, ..folder.config() };
    let mut store = Store::open(&config).expect("opens");
    let tags: Vec<_> = (0..20).map(|i| tag(&i.to_string(), "op")).collect();
    // Random values cannot be packed: 9 bytes a sample, 24 MB in all.
    let mut state = 1u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 11) as f64 / 9.1
    };
    let mut made_room = 0;
    for hour in 0..37 {
        let series = tags.iter().map(|tag| {
            let at = |i: u32| f64::from(hour * 3600 + i);
            Series { tag: tag.clone(), samples: (0..3600).map(|i| Sample::good(at(i), random())).collect() }
        });
        let batch = Batch { series: series.collect(), rows: Vec::new() };
        let now = f64::from(hour * 3600 + 3600);
        match store.insert(&batch) {
            Err(error) if error.is_full() => {
                made_room += 1;
                assert!(store.make_room(now).expect("room can be made"));
                store.insert(&batch).expect("there is room again");
            }
            written => written.expect("writes"),
        }
        while store.tidy(now).expect("tidies") {}
    }
    let usage = store.usage().expect("can be told");
    assert!(usage.file_bytes <= 16_000_000 && usage.used_bytes > 12_000_000, "{usage:?}, {made_room}");
    let checked = whole(&folder);
    assert!(checked.span.expect("not empty").0 > 0 && checked.samples > 1_000_000, "{checked:?}");
    assert_eq!(checked.span.expect("not empty").1, 37 * 3600 - 60, "the newest is there");
}

#[test]
fn other_folders_are_refused_and_say_why() {
    let folder = Folder::new();
    assert!(matches!(Reader::open(&folder.0), Err(StoreError::Missing(_))));
    let store = Store::open(&folder.config()).expect("opens");
    assert!(matches!(Store::open(&folder.config()), Err(StoreError::InUse(_))), "one writer");
    store.db.pragma_update(None, "user_version", 1_000).unwrap();
    drop(store);
    assert!(matches!(Store::open(&folder.config()), Err(StoreError::TooNew(1000))));
    assert!(matches!(Reader::open(&folder.0), Err(StoreError::TooNew(1000))));

    let foreign = Folder::new();
    std::fs::create_dir_all(&foreign.0).unwrap();
    Connection::open(foreign.0.join(DATABASE)).unwrap().execute_batch("CREATE TABLE t (x)").unwrap();
    assert!(matches!(Store::open(&foreign.config()), Err(StoreError::Foreign(_))));
    assert!(matches!(Reader::open(&foreign.0), Err(StoreError::Foreign(_))));

    let rubbish = Folder::new();
    std::fs::create_dir_all(&rubbish.0).unwrap();
    std::fs::write(rubbish.0.join(DATABASE), vec![7; 100_000]).unwrap();
    let error = Store::open(&rubbish.config()).expect_err("no database").to_string();
    assert!(error.contains("store check"), "{error}");
    let file = Folder::new();
    std::fs::write(&file.0, "a file").unwrap();
    assert!(matches!(Store::open(&file.config()), Err(StoreError::Io { .. })));
    std::fs::remove_file(&file.0).unwrap();
}

/// A database of before alarms had kinds, made by the steps of then.
#[test]
fn alarms_of_an_older_version_are_about_stiction() {
    let folder = Folder::new();
    drop(Store::open(&folder.config()).expect("opens"));
    let db = rusqlite::Connection::open(folder.0.join(DATABASE)).expect("opens");
    db.execute_batch(
        "DROP TABLE alarms; DROP TABLE transitions; DROP TABLE spool;
         DROP TABLE known_alarms; DROP TABLE known_models;
         CREATE TABLE alarms (control_loop TEXT PRIMARY KEY, active INTEGER NOT NULL, acknowledged INTEGER NOT NULL,
            shelved_until REAL, votes TEXT NOT NULL, since REAL, raised_at REAL, by_whom TEXT, comment TEXT) WITHOUT ROWID;
         CREATE TABLE transitions (id INTEGER PRIMARY KEY, control_loop TEXT NOT NULL, at REAL NOT NULL, before TEXT NOT NULL,
            after TEXT NOT NULL, cause TEXT NOT NULL, by_whom TEXT, comment TEXT,
            UNIQUE (control_loop, at, before, after, cause));
         CREATE INDEX transitions_at ON transitions (at);
         INSERT INTO alarms VALUES ('A', 1, 1, 99.0, 'sb', 5.0, 4.0, 'eve', 'seen');
         INSERT INTO transitions VALUES (7, 'A', 4.0, 'normal', 'unacknowledged', 'raised', NULL, NULL);
         INSERT INTO transitions VALUES (8, 'A', 5.0, 'unacknowledged', 'acknowledged', 'acknowledged', 'eve', 'seen');
         PRAGMA user_version = 2;",
    )
    .expect("the tables of then");
    drop(db);
    // There was no ledger and no second copy then.
    for name in ["store.sum", "store.ack", "states.log"] {
        std::fs::remove_file(folder.0.join(name)).expect("there");
    }
    drop(Store::open(&folder.config()).expect("opens and brings it up to date"));
    let reader = Reader::open(&folder.0).expect("opens");
    let expected = AlarmRow {
        control_loop: "A".into(),
        kind: "stiction".into(),
        active: true,
        acknowledged: true,
        shelved_until: Some(99.0),
        votes: "sb".into(),
        since: Some(5.0),
        raised_at: Some(4.0),
        by: Some("eve".into()),
        comment: Some("seen".into()),
        ..AlarmRow::default()
    };
    assert_eq!(reader.alarms().expect("reads"), [expected]);
    let rows = reader.transitions(0, 9).expect("reads");
    assert_eq!(
        rows.iter().map(|(id, row)| (*id, row.kind.as_str())).collect::<Vec<_>>(),
        [(7, "stiction"), (8, "stiction")]
    );
    assert!(whole(&folder).faults.is_empty());
}

/// The process ends when the new copy has taken the place of the old one, which had more records, and before that is noted.
#[test]
fn a_crash_while_the_second_copy_is_written_anew_is_no_damage() {
    let folder = Folder::new();
    let copy = folder.0.join(second::STATES);
    let mut store = Store::open(&folder.config()).expect("opens");
    for since in 0..5 {
        let row = AlarmRow {
            control_loop: "A".into(),
            kind: "stiction".into(),
            since: Some(f64::from(since)),
            ..AlarmRow::default()
        };
        store.write(&Batch { series: Vec::new(), rows: vec![Row::Alarm(row)] }).expect("writes");
    }
    drop(store);
    let old = std::fs::read(&copy).expect("there");
    let shorter = &old[..old.len() / 5];
    std::fs::write(&copy, shorter).expect("writable");
    let faults = check(&folder.0).expect("can be read").faults;
    assert!(faults.len() == 1 && faults[0].contains("4 of 5 records"), "{faults:?}");
    // The new one cannot be made, so opening ends where the old one no longer counts.
    std::fs::write(&copy, &old).expect("writable");
    std::fs::create_dir(folder.0.join("states.new")).expect("writable");
    assert!(matches!(Store::open(&folder.config()), Err(StoreError::Io { .. })));
    std::fs::remove_dir(folder.0.join("states.new")).expect("there");
    std::fs::write(&copy, shorter).expect("writable");
    whole(&folder);
    drop(Store::open(&folder.config()).expect("opens"));
    whole(&folder);
    // It is as new after that: the database has one state of the alarm.
    assert_eq!(std::fs::read(&copy).expect("there").len(), shorter.len());
}

/// The process ends when the database is made and its second copy is not.
#[test]
fn a_first_start_without_a_second_copy_is_no_damage() {
    let folder = Folder::new();
    std::fs::create_dir_all(folder.0.join("states.new")).expect("writable");
    assert!(matches!(Store::open(&folder.config()), Err(StoreError::Io { .. })));
    assert!(folder.0.join(DATABASE).is_file() && !folder.0.join(second::STATES).exists());
    whole(&folder);
}

/// The second copy of yesterday beside the database of today, as somebody may have put it back.
#[test]
fn an_old_second_copy_takes_the_place_of_nothing_in_a_database_that_is_whole() {
    let alarm = |control_loop: &str, acknowledged| AlarmRow {
        control_loop: control_loop.into(),
        kind: "stiction".into(),
        acknowledged,
        ..AlarmRow::default()
    };
    let rows = |row: AlarmRow| Batch { series: Vec::new(), rows: vec![Row::Alarm(row)] };
    let folder = Folder::new();
    let copy = folder.0.join(second::STATES);
    let mut store = Store::open(&folder.config()).expect("opens");
    store.write(&rows(alarm("A", false))).expect("writes");
    store.know(&[], &[alarm("B", false)]).expect("writes");
    let old = std::fs::read(&copy).expect("there");
    store.write(&rows(alarm("A", true))).expect("writes");
    store.know(&[], &[alarm("B", true)]).expect("writes");
    drop(store);
    std::fs::write(&copy, old).expect("writable");
    mark(&folder.0, "somebody is to decide");
    let left = super::Reader::open(&folder.0).expect("can be read");
    assert_eq!(left.written().expect("reads").1, [alarm("A", true)]);
    assert_eq!(left.known().expect("reads").1, [alarm("B", true)]);
}

/// What is written to it goes into files that no start will ever find.
#[test]
fn a_folder_that_is_moved_away_is_noticed_and_another_in_its_place_left_alone() {
    let (folder, aside, op) = (Folder::new(), Folder::new(), tag("A", "op"));
    let mut store = Store::open(&folder.config()).expect("opens");
    store.write(&batch(&op, good(0..10))).expect("writes");
    store.tidy(1010.0).expect("it is there");
    std::fs::rename(&folder.0, &aside.0).expect("writable");
    let is_gone = |store: &mut Store| matches!(store.tidy(1020.0), Err(StoreError::Gone { .. }));
    assert!(is_gone(&mut store));
    let mut other = Store::open(&folder.config()).expect("begins anew");
    other.write(&batch(&op, good(20..30))).expect("writes");
    assert!(is_gone(&mut store));
    drop(store);
    other.tidy(1030.0).expect("this one is there");
    drop(other);
    assert_eq!((&all(&folder)[&1], &all(&aside)[&1]), (&good(20..30), &good(0..10)));
    assert_eq!((whole(&folder).samples, whole(&aside).samples), (10, 10));
}

/// The files that are open take all of it.
#[test]
fn what_goes_to_a_folder_that_is_gone_does_not_count_as_written() {
    let (folder, aside, op) = (Folder::new(), Folder::new(), tag("A", "op"));
    let mut store = Store::open(&folder.config()).expect("opens");
    store.write(&batch(&op, good(0..10))).expect("writes");
    std::fs::rename(&folder.0, &aside.0).expect("writable");
    assert!(matches!(store.write(&batch(&op, good(10..20))), Err(StoreError::Gone { .. })));
    assert!(matches!(store.insert(&batch(&op, good(20..30))), Err(StoreError::Gone { .. })));
    std::fs::rename(&aside.0, &folder.0).expect("writable");
    store.write(&batch(&op, good(10..20))).expect("it is back");
}

/// As a file system over a network does after its server was started anew: the same file has another number.
#[test]
fn a_database_that_only_has_another_number_is_there() {
    let (folder, op) = (Folder::new(), tag("A", "op"));
    let mut store = Store::open(&folder.config()).expect("opens");
    store.write(&batch(&op, good(0..10))).expect("writes");
    let (own, other) = (folder.0.join(DATABASE), folder.0.join("other"));
    std::fs::copy(&own, &other).expect("copied");
    std::fs::rename(&other, &own).expect("writable");
    store.tidy(1010.0).expect("it is there");
    // Not where the ledger is of another store, too.
    let ledger = folder.0.join("store.ack");
    std::fs::remove_file(&ledger).expect("there");
    assert!(matches!(store.tidy(1020.0), Err(StoreError::Gone { .. })));
}
