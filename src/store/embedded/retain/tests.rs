use super::*;
use crate::store::embedded::tests::{Folder, batch, good, tag, whole};
use crate::store::{Batch, Config, DiagnosisRow, Row, Series};

fn number(store: &Store, sql: &str) -> i64 {
    store.db.query_row(sql, [], |row| row.get(0)).expect("reads")
}

/// Nor is it told as whole with the points that were left out.
#[test]
fn a_damaged_trend_is_not_written_over() {
    let folder = Folder::new();
    let mut store = Store::open(&Config { samples_days: 0.01, ..folder.config() }).expect("opens");
    store.insert(&batch(&tag("A", "op"), good(0..1000))).expect("inserts");
    assert!(store.tidy(1e6).expect("tidies"), "up to 1200 there are points now");
    store.db.execute("UPDATE trends SET points = zeroblob(40)", []).expect("writes");
    let error = store.tidy(1e6).expect_err("it is damaged");
    assert!(error.is_damage() && error.to_string().contains("trend 0 of tag 1"), "{error}");
    assert_eq!(store.refused_and_damaged(), (0, 1));
    assert_eq!(number(&store, "SELECT count(*) FROM trends WHERE length(points) = 40"), 1);
    assert_eq!(number(&store, "SELECT count(*) FROM chunks"), 14, "from 1200 to 2000");
}

/// Neither when what is oldest goes because there is no room.
#[test]
fn a_damaged_chunk_does_not_go_unseen() {
    let folder = Folder::new();
    let mut store = Store::open(&folder.config()).expect("opens");
    store.insert(&batch(&tag("A", "op"), good(0..100))).expect("inserts");
    store.db.execute("UPDATE chunks SET samples = zeroblob(40)", []).expect("writes");
    assert!(store.make_room(2000.0).is_err_and(|error| error.is_damage()));
    assert_eq!(store.refused_and_damaged(), (0, 1));
    assert_eq!(number(&store, "SELECT count(*) FROM chunks"), 3);
}

/// Samples of one hour that cannot be packed, of 60 tags each 8 s: 240 kB.
fn hour_of(hour: u32, random: &mut impl FnMut() -> f64) -> Batch {
    let mut series = Vec::new();
    for own in 0..60 {
        let samples = (0..450).map(|i| Sample::good(f64::from(hour * 3600 + 8 * i), random()));
        series.push(Series { tag: tag(&own.to_string(), "op"), samples: samples.collect() });
    }
    Batch { series, rows: Vec::new() }
}

#[test]
fn a_full_store_that_is_given_less_room_goes_on_and_what_is_oldest_goes() {
    let folder = Folder::new();
    let config = |max_mb| Config { max_mb, chunk_s: 600, ..folder.config() };
    let mut state = 1u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 11) as f64 / 9.1
    };
    let mut store = Store::open(&config(100)).expect("opens");
    for hour in 0..30 {
        store.insert(&hour_of(hour, &mut random)).expect("inserts");
    }
    drop(store);
    let mut store = Store::open(&config(4)).expect("opens");
    assert!(store.usage().expect("can be told").used_bytes > 5_000_000);
    assert_eq!(number(&store, "PRAGMA freelist_count"), 0, "there is no page left");
    for hour in 30..40 {
        let (batch, now) = (hour_of(hour, &mut random), f64::from(hour * 3600 + 3600));
        let mut made_room = 0;
        while let Err(error) = store.insert(&batch) {
            assert!(error.is_full() && made_room < 100, "{error}");
            assert!(store.make_room(now).expect("room can be made"));
            made_room += 1;
        }
        assert!(made_room > 0 || hour > 30, "the first had no room");
        while store.tidy(now).expect("tidies") {}
    }
    let usage = store.usage().expect("can be told");
    assert!(usage.used_bytes < 4_000_000, "{usage:?}");
    let (first, last) = whole(&folder).span.expect("not empty");
    assert!(first > 20 * 3600 && last == 40 * 3600 - 600, "from {first} to {last}");
}

/// The first note is of 1970, and so are a few samples: neither holds what comes later for years.
#[test]
fn a_first_note_that_is_years_behind_does_not_hold_everything_for_years() {
    const BEGIN: f64 = 1_767_225_600.0;
    let folder = Folder::new();
    let mut store = Store::open(&folder.config()).expect("opens");
    while store.tidy(5.0).expect("tidies") {}
    store.insert(&batch(&tag("A", "op"), vec![Sample::good(BEGIN, 1.0)])).expect("inserts");
    let latest = DiagnosisRow { control_loop: "A".into(), finished: 6.0, ..DiagnosisRow::default() };
    store.write(&Batch { series: Vec::new(), rows: vec![Row::Diagnosis(latest)] }).expect("writes");
    let clock = BEGIN + 1e9;
    while store.tidy(clock).expect("tidies") {}
    let (now, due) = (store.age.now(clock), BEGIN + (store.config.samples_days - 1.0) * DAY_S);
    assert!((due..due + DAY_S).contains(&now), "{now}: the latest run of a loop never goes");
    assert_eq!(number(&store, "SELECT count(*) FROM chunks"), 1, "nothing has gone");
}

#[test]
fn a_file_of_which_a_quarter_is_free_shrinks() {
    let folder = Folder::new();
    let mut store = Store::open(&folder.config()).expect("opens");
    let run = |k: u32| {
        Row::Diagnosis(DiagnosisRow {
            control_loop: "A".into(),
            finished: f64::from(k),
            report: Some(vec![7; 100_000]),
            ..DiagnosisRow::default()
        })
    };
    store.write(&Batch { series: Vec::new(), rows: (0..250).map(run).collect() }).expect("writes");
    store.db.execute("DELETE FROM diagnoses", []).expect("writes");
    let before = number(&store, "PRAGMA page_count");
    assert!(!store.tidy(300.0).expect("tidies"));
    let after = number(&store, "PRAGMA page_count");
    assert!(before > 3000 && after <= before - 1000, "from {before} to {after} pages");
}
