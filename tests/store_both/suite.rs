//! What a store promises, wherever it is.

use crate::place::{Place, all, all_of, batch, good, tag, whole};
use stictiond::signal::{BadReason, Quality, Sample};
use stictiond::store::archive::{self, Choice, Format, Kind};
use stictiond::store::{
    AlarmRow, Batch, Config, DiagnosisRow, ModelRow, Point, Row, Series, Store, StoreError, TagName,
    TransitionRow, Upkeep, pack, unpack,
};
use stictiond::table::{Options, Source, TableError, stream};

const DAY_S: f64 = 86_400.0;

pub fn diagnosis(control_loop: &str, finished: f64, report: Option<&str>) -> Row {
    Row::Diagnosis(DiagnosisRow {
        control_loop: control_loop.into(),
        finished,
        took_s: f64::NAN,
        outcome: "stiction".into(),
        f: Some(0.5),
        f_ci95: Some([0.4, 0.6]),
        report: report.and_then(pack),
        ..DiagnosisRow::default()
    })
}

pub fn transition(at: f64, before: &str, after: &str) -> Row {
    Row::Transition(TransitionRow {
        control_loop: "A".into(),
        at,
        before: before.into(),
        after: after.into(),
        cause: "raised".into(),
        ..TransitionRow::default()
    })
}

pub fn what_was_written_is_there_after_reopening(place: &mut Place) {
    let op = tag("A", "op");
    let mut store = Store::open(&place.config()).expect("opens");
    for i in 0..200 {
        store.write(&batch(&op, good(i..i + 1))).expect("writes");
        store.tidy(1000.0 + f64::from(i)).expect("tidies");
    }
    assert_eq!(all(place, &op), good(0..200), "beside the writer");
    drop(store);
    let _store = Store::open(&place.config()).expect("opens again");
    assert_eq!(all(place, &op), good(0..200));
    let checked = whole(place);
    assert_eq!((checked.samples, checked.tags, checked.span), (200, 1, Some((960, 1140))));
}

pub fn every_number_and_quality_comes_back_to_the_last_bit(place: &mut Place) {
    let (op, mut store) = (tag("A", "op"), Store::open(&place.config()).expect("opens"));
    let bad = [
        BadReason::DeviceException,
        BadReason::Timeout,
        BadReason::LinkDown,
        BadReason::OutOfRange,
        BadReason::NotANumber,
    ];
    let qualities: Vec<Quality> =
        bad.into_iter().map(Quality::Bad).chain([Quality::Stale, Quality::Good]).collect();
    // Stamps finer than a microsecond, and values at the ends of what there is.
    let values = [0.1, -0.0, f64::MIN_POSITIVE, f64::MAX, -1.0 / 3.0, f64::INFINITY, 5e-324];
    let mut samples: Vec<Sample> = (0..70)
        .map(|i| Sample {
            t: 1_763_700_000.0 + f64::from(i) / 7.0,
            value: values[i as usize % 7] * f64::from(i + 1),
            quality: qualities[i as usize / 10],
        })
        .collect();
    samples[3].value = f64::NAN;
    store.write(&batch(&op, samples.clone())).expect("writes");
    let bits = |samples: &[Sample]| -> Vec<_> {
        samples.iter().map(|s| (s.t.to_bits(), s.value.to_bits(), s.quality)).collect()
    };
    assert_eq!(bits(&all(place, &op)), bits(&samples));
}

pub fn stamps_of_any_order_find_their_place(place: &mut Place) {
    let (op, mut store) = (tag("A", "op"), Store::open(&place.config()).expect("opens"));
    let times = [5000.0, 100.0, 5001.0, 90_000.0, 101.0, 5002.0, -1.0, f64::NAN, 1e30, f64::INFINITY];
    for (i, &t) in times.iter().enumerate() {
        store.write(&batch(&op, vec![Sample::good(t, i as f64)])).expect("writes");
        store.tidy(5000.0 + 61.0 * i as f64).expect("tidies");
    }
    let stamps: Vec<f64> = all(place, &op).iter().map(|s| s.t).collect();
    assert_eq!(stamps, [100.0, 101.0, 5000.0, 5001.0, 5002.0, 90_000.0]);
    assert_eq!(store.refused_and_damaged(), (4, 0));
    let between = place.reader().between("A", "op", 101.0, 5001.0).expect("reads");
    assert_eq!(between.iter().map(|s| s.t).collect::<Vec<_>>(), [101.0, 5000.0, 5001.0]);
    assert_eq!(place.reader().previous_start(4980).expect("reads"), Some(60));
    assert_eq!(place.reader().previous_start(4981).expect("reads"), Some(4980));
    assert_eq!(place.reader().next_start(61).expect("reads"), Some(4980));
}

pub fn nothing_is_there_twice_and_a_good_sample_replaces_a_bad_one(place: &mut Place) {
    let op = tag("A", "op");
    let mut store = Store::open(&place.config()).expect("opens");
    let bad = Sample { t: 1500.0, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) };
    for now in [1000.0, 5000.0, 9000.0] {
        store.write(&batch(&op, good(0..100))).expect("writes");
        store.write(&batch(&op, vec![bad])).expect("writes");
        store.tidy(now).expect("tidies");
        store.insert(&batch(&op, good(50..150))).expect("inserts");
    }
    let there = &all(place, &op);
    assert_eq!(there.len(), 151);
    assert_eq!(there[..150], good(0..150));
    assert_eq!(there[150].quality, bad.quality);
    store.insert(&batch(&op, vec![Sample::good(1500.0, 3.0)])).expect("inserts");
    store.insert(&batch(&op, vec![Sample::good(1500.0, 4.0), bad])).expect("inserts");
    assert_eq!(all(place, &op)[150], Sample::good(1500.0, 3.0), "the first good one stays");
    assert_eq!(whole(place).samples, 151);
}

pub fn the_last_samples_of_each_tag_come_back_as_a_ring_held_them(place: &mut Place) {
    let (op, pv, other) = (tag("A", "op"), tag("A", "pv"), tag("B", "op"));
    let mut store = Store::open(&place.config()).expect("opens");
    for i in 0..500u32 {
        let mut both = batch(&op, good(i..i + 1));
        if i % 10 == 0 {
            both.series.push(Series { tag: pv.clone(), samples: good(i..i + 1) });
        }
        store.write(&both).expect("writes");
        store.tidy(1000.0 + f64::from(i)).expect("tidies");
    }
    let mut reader = place.reader();
    let found = reader.last(&[(*op).clone(), (*pv).clone(), (*other).clone()], 130).expect("reads");
    assert_eq!(found.len(), 2, "of B nothing was ever there");
    assert_eq!(found[&*op], good(370..500));
    assert_eq!(found[&*pv].len(), 50, "all there is");
    let elsewhere = TagName { source: "register 8".into(), ..(*op).clone() };
    assert!(reader.last(&[elsewhere], 10).expect("reads").is_empty(), "another register, another signal");
}

pub fn a_clock_that_is_set_back_begins_another_era(place: &mut Place) {
    let op = tag("A", "op");
    let mut store = Store::open(&place.config()).expect("opens");
    store.write(&batch(&op, good(0..100))).expect("writes");
    store.begin_era();
    let again: Vec<Sample> = good(50..60).iter().map(|s| Sample { value: -1.0, ..*s }).collect();
    store.write(&batch(&op, again.clone())).expect("writes");
    store.tidy(1060.0).expect("tidies");
    drop(store);
    let mut store = Store::open(&place.config()).expect("opens");
    let more = vec![Sample::good(1060.5, -2.0)];
    store.write(&batch(&op, more.clone())).expect("writes");
    let found = place.reader().last(&[(*op).clone()], 1000).expect("reads");
    assert_eq!(found[&*op], [again, more].concat());
    let eras: Vec<Vec<Sample>> = all_of(&place.config()).into_values().collect();
    assert_eq!(eras[0], good(0..100), "what was there stays as it was");
    // A tag whose own stamps never fell back goes on from what it had.
    let (mut store, pv) = (store, tag("A", "pv"));
    store.write(&batch(&pv, good(0..50))).expect("writes");
    store.begin_era();
    store.write(&batch(&pv, good(50..60))).expect("writes");
    let last = |count| place.reader().last(&[(*pv).clone()], count).expect("reads");
    assert_eq!(last(1000)[&*pv], good(0..60));
    assert_eq!(last(15)[&*pv], good(45..60));
    assert_eq!(last(5)[&*pv], good(55..60));
}

pub fn diagnoses_models_and_alarms_come_back(place: &mut Place) {
    let mut store = Store::open(&place.config()).expect("opens");
    let model = ModelRow { control_loop: "A".into(), version: 3, since: 5.0, effects: "drift\t\n".into() };
    let alarm = AlarmRow {
        control_loop: "A".into(),
        kind: "stiction".into(),
        active: true,
        one_shot: true,
        votes: "sc".into(),
        pending: Some(7.0),
        priority: Some("high".into()),
        by: Some("eve".into()),
        ..AlarmRow::default()
    };
    let other = AlarmRow { kind: "tag_bad".into(), suppressed: true, ..AlarmRow::default() };
    let mut rows = vec![
        diagnosis("A", 1.0, Some("{\"first\":1}")),
        diagnosis("A", 2.0, Some("{\"second\":2}")),
        diagnosis("A", 3.0, None),
        Row::Model(ModelRow { version: 2, ..model.clone() }),
        Row::Model(model.clone()),
        Row::Alarm(AlarmRow { active: false, ..alarm.clone() }),
        Row::Alarm(alarm.clone()),
        Row::Alarm(other.clone()),
        transition(2.0, "normal", "unacknowledged"),
    ];
    if let Row::Diagnosis(run) = &mut rows[0] {
        run.basis = pack("{\"worked on\":1}");
    }
    for _ in 0..2 {
        store.write(&Batch { series: Vec::new(), rows: rows.clone() }).expect("writes, and again");
    }
    let reader = place.reader();
    let last = reader.last_diagnoses("A", 2).expect("reads");
    let kept: Vec<(f64, bool)> = last.iter().map(|row| (row.finished, row.report.is_some())).collect();
    assert_eq!(kept, [(2.0, true), (3.0, false)]);
    assert_eq!(last[0].report.as_deref().and_then(unpack).as_deref(), Some("{\"second\":2}"));
    let basis = |finished| reader.basis("A", finished).expect("reads").as_deref().and_then(unpack);
    assert_eq!([1.0, 2.0, 7.0].map(basis), [Some("{\"worked on\":1}".to_string()), None, None]);
    assert_eq!(reader.model("A").expect("reads"), Some(model));
    assert_eq!(reader.alarm("A", "stiction").expect("reads"), Some(alarm.clone()));
    assert_eq!(reader.alarms().expect("reads"), [other, alarm]);
    assert_eq!(reader.alarm("A", "f_rising").expect("reads"), None);
    assert_eq!(reader.last_transitions(9).expect("reads").len(), 1);
    let checked = whole(place);
    assert_eq!((checked.diagnoses, checked.transitions), (3, 1));
}

/// A start takes both from the one answer, of thousands of loops.
pub fn the_last_run_and_the_last_that_said_something_come_whole(place: &mut Place) {
    let mut store = Store::open(&place.config()).expect("opens");
    let run = |at: f64, outcome: &str| match diagnosis("A", at, Some("{\"report\":1}")) {
        Row::Diagnosis(run) => {
            Row::Diagnosis(DiagnosisRow { outcome: outcome.into(), basis: pack("{\"basis\":1}"), ..run })
        }
        other => other,
    };
    let outcomes = ["stiction", "no_stiction", "not_identifiable", "not_identifiable"];
    let rows = outcomes.iter().zip([1.0, 2.0, 3.0, 4.0]).map(|(outcome, at)| run(at, outcome)).collect();
    store.write(&Batch { series: Vec::new(), rows }).expect("writes");
    let reader = place.reader();
    let whole = |count| -> Vec<(f64, bool)> {
        let last = reader.last_diagnoses("A", count).expect("reads");
        last.iter().map(|row| (row.finished, row.report.is_some() && row.basis.is_some())).collect()
    };
    assert_eq!(whole(9), [(1.0, false), (2.0, true), (3.0, false), (4.0, true)]);
    assert_eq!(whole(2), [(3.0, false), (4.0, true)]);
}

pub fn a_gap_in_an_alarms_history_is_found(place: &mut Place) {
    let mut store = Store::open(&place.config()).expect("opens");
    let rows = vec![transition(1.0, "normal", "unacknowledged"), transition(2.0, "acknowledged", "normal")];
    store.write(&Batch { series: Vec::new(), rows }).expect("writes");
    let faults = stictiond::store::check_of(&place.config()).expect("can be read").faults;
    assert!(faults.len() == 1 && faults[0].contains("alarm of A"), "{faults:?}");
}

pub fn what_is_old_is_thinned_to_trends_and_then_goes(place: &mut Place) {
    let (op, begin) = (tag("A", "op"), 30.0 * DAY_S);
    // Days pass in no time here.
    let upkeep = Upkeep { pace: None, ..Upkeep::default() };
    let config =
        Config { samples_days: 1.0, trend_days: 40.0, diagnoses_days: 1.0, upkeep, ..place.config() };
    let mut store = Store::open(&config).expect("opens");
    // Two days, a sample each 10 s, the value the number of its sample; the second minute is bad.
    let mut samples: Vec<Sample> =
        (0..17_280).map(|i| Sample::good(begin + 10.0 * f64::from(i), f64::from(i))).collect();
    samples[6..12].iter_mut().for_each(|s| s.quality = Quality::Bad(BadReason::Timeout));
    store.insert(&batch(&op, samples)).expect("inserts");
    let rows = (0..5).map(|i| diagnosis("A", f64::from(i), Some("{}"))).collect();
    store.write(&Batch { series: Vec::new(), rows }).expect("writes");
    while store.tidy(begin + 2.0 * DAY_S).expect("tidies") {}
    let kept = all(place, &op);
    let first = kept[0].t - begin;
    // In pieces of 10 minutes here and of 6 hours there, never a sample that is younger than a day.
    assert!((0.7 * DAY_S..=DAY_S).contains(&first), "from {first} s on");
    let tag = place.reader().tags().expect("reads")[0].id;
    let points = place.reader().trends(tag, begin as i64, (begin + 2.0 * DAY_S) as i64).expect("reads");
    assert_eq!(points.len() as f64, first / 60.0, "a point for each minute that was thinned");
    assert_eq!(points[0], Point { t: begin, least: 0.0, mean: 2.5, most: 5.0 });
    assert!(points[1].mean.is_nan() && points[1].least.is_nan() && points[1].most.is_nan());
    assert_eq!(points[2].mean, 14.5);
    let checked = whole(place);
    assert_eq!((checked.samples, checked.points), (kept.len() as u64, points.len() as u64));
    assert_eq!(checked.diagnoses, 1, "the latest run stays");

    while store.tidy(begin + 80.0 * DAY_S).expect("tidies") {}
    let checked = whole(place);
    assert_eq!((checked.samples, checked.points, checked.diagnoses), (0, 0, 1));
}

/// An edge of a fleet goes on behind the number of the last that it forwarded.
pub fn the_last_that_was_said_keeps_its_number_however_old_its_stamp_is(place: &mut Place) {
    let now = 20_000.0 * DAY_S;
    let upkeep = Upkeep { pace: None, ..Upkeep::default() };
    let mut store = Store::open(&Config { upkeep, ..place.config() }).expect("opens");
    let say = |store: &mut Store, at: f64| {
        let rows = vec![diagnosis("A", at, None), transition(at, "normal", "unacknowledged")];
        store.write(&Batch { series: Vec::new(), rows }).expect("writes");
    };
    let numbers = || -> [Vec<i64>; 2] {
        let reader = place.reader();
        let runs = reader.diagnoses(0, 9).expect("reads").into_iter().map(|(number, _)| number);
        let changes = reader.transitions(0, 9).expect("reads").into_iter().map(|(number, _)| number);
        [runs.collect(), changes.collect()]
    };
    say(&mut store, now - 60.0);
    // The clock of the machine said 1970 after a start.
    say(&mut store, 100.0);
    let before = numbers();
    while store.tidy(now).expect("tidies") {}
    assert_eq!(numbers(), before);
    say(&mut store, now);
    while store.tidy(now + 120.0).expect("tidies") {}
    for (own, before) in numbers().into_iter().zip(before) {
        assert!(own.len() == 2 && own[0] == before[0] && own[1] > before[1], "{own:?} after {before:?}");
    }
}

pub fn a_clock_that_is_set_forward_takes_no_history_with_it(place: &mut Place) {
    let (op, begin) = (tag("A", "op"), 30.0 * DAY_S);
    let config = Config { samples_days: 1.0, diagnoses_days: 1.0, alarms_days: 1.0, ..place.config() };
    let mut store = Store::open(&config).expect("opens");
    // A day, from an hour on.
    let at = |i: u32| begin + 3600.0 + 60.0 * f64::from(i);
    store.insert(&batch(&op, (0..1380).map(|i| Sample::good(at(i), 1.0)).collect())).expect("inserts");
    let mut rows: Vec<Row> = (0..5).map(|i| diagnosis("A", at(i), Some("{}"))).collect();
    rows.push(transition(at(0), "normal", "unacknowledged"));
    store.write(&Batch { series: Vec::new(), rows }).expect("writes");
    while store.tidy(begin + DAY_S).expect("tidies") {}
    for _ in 0..2 {
        while store.tidy(begin + 800.0 * DAY_S).expect("tidies") {}
        let checked = whole(place);
        assert_eq!((checked.samples, checked.points), (1380, 0));
        assert_eq!((checked.diagnoses, checked.transitions), (5, 1));
        assert_eq!(store.thinned_in_doubt_s(), 0);
        // Nor does it after a restart.
        drop(store);
        store = Store::open(&config).expect("opens");
    }
}

pub fn what_is_exported_and_imported_is_the_same(place: &mut Place) {
    let mut store = Store::open(&place.config()).expect("opens");
    let samples =
        |k: f64| (0..300).map(move |i| Sample::good(1_763_700_000.1 + f64::from(i), k * f64::from(i) / 3.0));
    let series = vec![
        Series { tag: tag("A", "op"), samples: samples(1.0).collect() },
        Series { tag: tag("B", "a, \"b\"\nü"), samples: samples(-1e9).collect() },
    ];
    let rows = vec![diagnosis("A", 5.0, Some("{\"f\":0.25}")), transition(6.0, "normal", "shelved")];
    store.write(&Batch { series, rows }).expect("writes");
    for (format, name) in [(Format::Csv, "out.csv"), (Format::Parquet, "out.parquet")] {
        let file = place.folder.join(name);
        let choice = Choice::default();
        let mut reader = place.reader();
        assert_eq!(
            archive::export(&mut reader, Kind::Samples, &choice, format, &file).expect("exports"),
            600
        );
        let mut other = Store::open(&place.beside()).expect("opens");
        for _ in 0..2 {
            let mut take = |batch: &Batch| other.insert(batch);
            let mut import = archive::Import::new(&|_, _| None, &mut take);
            stream(Source::File(&file), &Options::default(), &mut |tag, sample| {
                let (source, unit) = (tag.source.as_deref(), tag.unit.as_deref());
                let place = archive::Place { control_loop: &tag.owner, tag: &tag.name, source, unit };
                import.sample(&place, sample).expect("a sample");
                Ok::<_, TableError>(())
            })
            .expect("reads");
            assert_eq!(import.end().expect("writes").handed_on, 600);
        }
        assert_eq!(all_of(&place.beside()), all_of(&place.config()), "{format:?}");
    }
    let file = place.folder.join("said.csv");
    let rows = archive::export(&mut place.reader(), Kind::Diagnoses, &Choice::default(), Format::Csv, &file);
    assert_eq!(rows.expect("exports"), 1);
    assert!(std::fs::read_to_string(&file).expect("text").contains("{\"\"f\"\":0.25}"));
}

pub fn another_version_and_another_writer_are_refused(place: &mut Place) {
    assert!(matches!(stictiond::store::Reader::of(&place.config()), Err(StoreError::Missing(_))));
    let store = Store::open(&place.config()).expect("opens");
    assert!(matches!(Store::open(&place.config()), Err(StoreError::InUse(_))), "one writer");
    drop(store);
    assert_eq!(whole(place).samples, 0);
}
