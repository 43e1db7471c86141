//! Tables that hold more than an answer of the database may have (20 MiB): they are read in pages.

use crate::place::{Place, batch, good, tag};
use std::collections::BTreeSet;
use stictiond::store::{Config, Store, pack};

/// A place whose tables are there and have these rows.
fn filled(statements: &str) -> Place {
    let mut place = Place::postgres();
    let mut store = Store::open(&place.config()).expect("opens");
    store.write(&batch(&tag("A", "op"), good(0..10))).expect("writes");
    drop(store);
    let mut client = place.cluster().client().expect("answers");
    client.batch_execute("SET search_path TO stictiond").expect("there");
    client.batch_execute(statements).expect("writes");
    place
}

/// 1,200 loops with 180 days of indicators, and 5,000 with two versions of a long model.
const STATES: &str = "INSERT INTO alarms (control_loop, kind, active, acknowledged, latched, one_shot, suppressed,
        out_of_service, votes, raises, trend, detail)
    SELECT 'L' || n, 'health', false, false, false, false, false, false, '', '', repeat('0.123456 ', 2900) || n, ''
        FROM generate_series(1, 1200) AS n;
    INSERT INTO models SELECT 'L' || n, version, version, repeat('drift', 1000) || n
        FROM generate_series(1, 5000) AS n, generate_series(1, 2) AS version;";

#[test]
fn states_of_more_than_an_answer_do_not_keep_the_database_away() {
    let place = filled(STATES);
    // On a new disk nothing of it is known.
    let fresh = Config { folder: place.folder.join("fresh"), ..place.config() };
    let mut store = Store::reopen(&fresh).expect("opens");
    assert_eq!(store.spool().expect("there is one").away, None);
    let found = store.found().expect("all of it is news");
    assert_eq!((found.alarms.len(), found.models.len()), (1200, 5000));
    let bytes: usize = found.alarms.iter().map(|row| row.trend.len()).sum();
    assert!(bytes > 30_000_000, "{bytes}");
    for row in &found.alarms {
        let n = row.control_loop.trim_start_matches('L');
        assert_eq!(row.trend.strip_prefix("0.123456 ".repeat(2900).as_str()), Some(n));
    }
    let loops: BTreeSet<&str> = found.models.iter().map(|row| row.control_loop.as_str()).collect();
    assert_eq!(loops.len(), 5000);
    assert!(found.models.iter().all(|row| row.version == 2 && row.effects.len() > 5000), "the latest");

    let alarms = place.reader().alarms().expect("reads");
    assert!(alarms.is_sorted_by_key(|row| row.control_loop.clone()));
    assert!(alarms.len() == 1200 && alarms.iter().all(|row| found.alarms.contains(row)));
}

/// A hundred tags more each time the clock is set back, a thousand times.
const TAGS: &str = "INSERT INTO tags (control_loop, tag, source, era, unit)
    SELECT 'L' || n % 100, 'op', 'register 7', n / 100, '%' FROM generate_series(0, 99999) AS n;";

#[test]
fn tags_of_more_than_an_answer_are_read_and_their_samples_too() {
    let place = filled(TAGS);
    let mut reader = place.reader();
    let tags = reader.tags().expect("reads");
    assert!(tags.is_sorted_by_key(|tag| tag.id));
    let names: BTreeSet<(&str, i64)> =
        tags.iter().map(|tag| (tag.name.control_loop.as_str(), tag.era)).collect();
    assert_eq!((tags.len(), names.len()), (100_001, 100_001), "each once, and the one that has samples");
    let chunk = reader.chunk(960, None).expect("reads");
    assert_eq!(chunk.into_values().collect::<Vec<_>>(), [good(0..10)]);
}

/// Runs with reports of half a megabyte, one of three, changes with long comments, and two months of a trend.
const RECORDS: &str =
    "INSERT INTO diagnoses (control_loop, finished, took_s, on_demand, outcome, reason, f_in_percent,
        version, report)
    SELECT 'A', n, 0, false, 'stiction', '', true, '', '\"' || repeat('report ', 70000) || n || '\"'
        FROM generate_series(1, 60) AS n;
    UPDATE diagnoses SET report = '\"' || repeat('report ', 430000) || '30\"' WHERE finished = 30;
    INSERT INTO transitions (control_loop, kind, at, before, after, cause, detail, comment)
    SELECT 'A', 'stiction', n, 'normal', 'normal', 'raised', '', repeat('note ', 2000) || n
        FROM generate_series(1, 3000) AS n;
    CREATE TABLE trends_0 PARTITION OF trends FOR VALUES FROM (to_timestamp(0)) TO (to_timestamp(6000000));
    INSERT INTO trends SELECT to_timestamp(60 * n), 1, n, n, n FROM generate_series(0, 89999) AS n;";

#[test]
fn records_of_more_than_an_answer_come_back_whole_and_in_order() {
    let place = filled(RECORDS);
    let mut reader = place.reader();
    let runs = reader.diagnoses(0, 1000).expect("reads");
    let finished: Vec<f64> = runs.iter().map(|(_, row)| row.finished).collect();
    assert_eq!(finished, (1..=60).map(f64::from).collect::<Vec<_>>());
    for (_, row) in &runs {
        let times = if row.finished == 30.0 { 430_000 } else { 70_000 };
        let report = format!("\"{}{}\"", "report ".repeat(times), row.finished);
        assert!(row.report == pack(&report), "{}", row.finished);
    }
    // As many as are asked for, though a page holds fewer.
    let some = reader.diagnoses(runs[4].0, 50).expect("reads");
    assert_eq!((some.len(), some[0].1.finished, some[49].1.finished), (50, 6.0, 55.0));
    let last = reader.last_diagnoses("A", 55).expect("reads");
    let with_report = last.iter().filter(|row| row.report.is_some()).map(|row| row.finished);
    assert_eq!(with_report.collect::<Vec<_>>(), [60.0], "the latest alone");
    assert_eq!((last.len(), last[0].finished), (55, 6.0));

    let at = |rows: &[stictiond::store::TransitionRow]| rows.iter().map(|row| row.at).collect::<Vec<_>>();
    let numbers = |range: std::ops::RangeInclusive<u32>| range.map(f64::from).collect::<Vec<_>>();
    let changes = reader.transitions(0, 5000).expect("reads").into_iter().map(|(_, row)| row);
    assert_eq!(at(&changes.collect::<Vec<_>>()), numbers(1..=3000));
    assert_eq!(at(&reader.last_transitions(2500).expect("reads")), numbers(501..=3000));

    let points = reader.trends(1, 60, 5_400_000).expect("reads");
    assert_eq!(points.iter().map(|point| point.mean).collect::<Vec<_>>(), numbers(1..=89_999));
    assert_eq!((points[0].t, points[0].least), (60.0, 1.0));
}
