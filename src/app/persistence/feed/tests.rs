use super::*;
use crate::alarm::{AlarmId, Kind, Saved};
use crate::history::Ring;
use crate::results::{Change, KeptAlarm, ModelVersion};
use crate::signal::LoopId;
use crate::store::{AlarmRow, DiagnosisRow, ModelRow, TagName, TransitionRow};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Rings of this size, followed with a clock that the test sets, and the queue that is bounded to some bytes.
struct World {
    rings: Vec<Arc<Ring>>,
    now: Arc<Mutex<f64>>,
    feed: StoreFeed,
    shared: Arc<Shared>,
}

fn world(sizes: &[usize], max_bytes: usize) -> World {
    let rings: Vec<Arc<Ring>> = sizes.iter().map(|size| Arc::new(Ring::new(*size))).collect();
    let tap = |(at, ring): (usize, &Arc<Ring>)| {
        let (source, unit) = (String::new(), String::new());
        let tag = TagName { control_loop: "A".into(), tag: at.to_string(), source, unit };
        let (next, retired) = (AtomicU64::new(0), AtomicBool::new(false));
        let last = AtomicU64::new(f64::NAN.to_bits());
        Arc::new(Tap { tag: Arc::new(tag), ring: ring.clone(), next, last, set_backs: 0, retired })
    };
    let shared = Arc::new(Shared::default());
    *lock(&shared.taps) = rings.iter().enumerate().map(tap).collect();
    let now = Arc::new(Mutex::new(0.0));
    let clock = now.clone();
    let (merge, again): (Merge, Again) = (Box::new(|_| {}), Box::new(super::super::again::Ends::default));
    let feed = StoreFeed::new(shared.clone(), Box::new(move || *lock(&clock)), (merge, again), max_bytes);
    World { rings, now, feed, shared }
}

impl World {
    fn push(&self, ring: usize, times: impl IntoIterator<Item = u32>) {
        times.into_iter().for_each(|t| self.rings[ring].push(Sample::good(f64::from(t), 0.0)));
    }

    /// Stamps of the next batch by tag.
    fn taken(&mut self) -> Vec<(String, Vec<u32>)> {
        self.feed.gather();
        let series = self.feed.take().series.iter();
        series.map(|own| (own.tag.tag.clone(), own.samples.iter().map(|s| s.t as u32).collect())).collect()
    }
}

fn one(times: impl IntoIterator<Item = u32>) -> Vec<(String, Vec<u32>)> {
    vec![("0".to_string(), times.into_iter().collect())]
}

#[test]
fn what_is_not_durable_is_taken_again_and_what_was_overwritten_is_counted() {
    let mut world = world(&[4], 1 << 20);
    world.push(0, 0..3);
    assert_eq!(world.taken(), one(0..3));
    world.push(0, 3..4);
    assert_eq!(world.taken(), one(0..4), "the write failed, and one came");
    assert!(!world.feed.settled());
    assert_eq!(world.taken(), []);
    world.push(0, 4..10);
    assert_eq!(world.taken(), one(6..10));
    assert_eq!(world.shared.lost_samples.load(Relaxed), 2);
    assert_eq!(world.taken(), one(6..10));
    assert_eq!(world.shared.lost_samples.load(Relaxed), 2, "counted once");
}

#[test]
fn a_ring_that_nobody_fills_any_more_is_followed_to_its_end() {
    let mut world = world(&[10, 10], 1 << 20);
    world.push(0, 0..3);
    lock(&world.shared.taps)[0].retired.store(true, Relaxed);
    assert_eq!(world.taken(), one(0..3));
    assert_eq!(lock(&world.shared.taps).len(), 2);
    world.feed.settled();
    assert_eq!(lock(&world.shared.taps).len(), 1);
}

#[test]
fn no_ring_waits_for_ever_behind_a_long_one() {
    let mut world = world(&[2 * MAX_SAMPLES, 10], 1 << 20);
    world.push(0, 0..(MAX_SAMPLES as u32 + 5));
    world.push(1, 0..3);
    assert_eq!(world.taken().iter().map(|(_, times)| times.len()).collect::<Vec<_>>(), [MAX_SAMPLES]);
    assert!(world.feed.settled(), "there is more");
    let second = world.taken();
    assert_eq!((second[0].0.as_str(), second[0].1.len(), second[1].1.len()), ("1", 3, 5));
    assert!(!world.feed.settled());
}

#[test]
fn samples_of_before_and_after_a_set_back_are_told_apart() {
    let mut world = world(&[100, 100, 100], 1 << 20);
    let at = |world: &World, t: f64| *lock(&world.now) = t;
    at(&world, 110.0);
    world.push(0, 100..110);
    world.push(2, 100..110);
    assert_eq!(world.taken().len(), 2);
    world.feed.settled();
    // Back to 50: one ring has samples of both, one only of before, one only of after.
    world.push(2, [50]);
    world.push(0, [110, 111, 50, 51]);
    world.push(1, [111]);
    at(&world, 51.0);
    assert_eq!(world.taken(), vec![("0".to_string(), vec![110, 111]), ("1".to_string(), vec![111])]);
    assert!(!world.feed.set_back(), "not before that is durable");
    assert!(world.feed.settled(), "there is more");
    assert!(world.feed.set_back());
    assert_eq!(world.taken(), vec![("0".to_string(), vec![50, 51]), ("2".to_string(), vec![50])]);
    assert!(!world.feed.settled() && !world.feed.set_back(), "told once");
}

#[test]
fn a_clock_that_is_set_back_twice_while_the_store_fails_begins_two_eras() {
    let mut world = world(&[100], 1 << 20);
    let at = |world: &World, t: f64| *lock(&world.now) = t;
    at(&world, 1001.0);
    world.push(0, [1000, 1001]);
    assert_eq!(world.taken(), one([1000, 1001]));
    // That was not written, and neither is what follows.
    world.push(0, [500, 501]);
    at(&world, 501.0);
    assert_eq!(world.taken(), one([1000, 1001]));
    world.push(0, [200, 201]);
    at(&world, 201.0);
    assert_eq!(world.taken(), one([1000, 1001]));
    assert!(world.feed.settled() && world.feed.set_back());
    assert_eq!(world.taken(), one([500, 501]));
    assert!(world.shared.leaving.load(Relaxed), "there is another one");
    assert!(world.feed.settled() && world.feed.set_back());
    assert!(!world.shared.leaving.load(Relaxed));
    assert_eq!(world.taken(), one([200, 201]));
    assert!(!world.feed.settled() && !world.feed.set_back());
}

/// A reload replaces a ring while the era of a set-back has not begun, because the store fails: nothing in it falls back.
#[test]
fn a_ring_that_begins_behind_a_set_back_waits_for_its_era() {
    let mut world = world(&[10, 10], 1 << 20);
    *lock(&world.now) = 1001.0;
    world.push(0, [1000, 1001]);
    assert_eq!(world.taken(), one([1000, 1001]));
    // That was not written. The clock is set back, and no round has looked at it yet.
    *lock(&world.now) = 501.0;
    {
        let set_backs = lock(&world.shared.set_backs).look(501.0);
        let mut taps = lock(&world.shared.taps);
        let Tap { tag, ring, .. } = &*taps[1];
        taps[1] = Arc::new(Tap {
            tag: tag.clone(),
            ring: ring.clone(),
            next: AtomicU64::new(0),
            last: AtomicU64::new(f64::NAN.to_bits()),
            set_backs,
            retired: AtomicBool::new(false),
        });
    }
    world.push(1, [500, 501]);
    assert_eq!(world.taken(), one([1000, 1001]));
    assert!(world.feed.settled() && world.feed.set_back());
    assert_eq!(world.taken(), [("1".to_string(), vec![500, 501])]);
    assert!(!world.feed.settled() && !world.feed.set_back());
}

/// A device stamps its samples itself, and its clock is set back while ours is not.
#[test]
fn a_ring_that_falls_back_tells_of_a_clock_that_was_set_back() {
    let mut world = world(&[100], 1 << 20);
    world.push(0, [100, 101, 40, 41]);
    assert_eq!(world.taken(), one([100, 101]));
    assert!(world.feed.settled() && world.feed.set_back());
    assert_eq!(world.taken(), one([40, 41]));
    assert!(!world.feed.settled() && !world.feed.set_back());
    world.push(0, [42, 7]);
    assert_eq!(world.taken(), one([42, 7]), "again so soon: a source that is late");
    assert!(!world.feed.settled() && !world.feed.set_back());
}

#[test]
fn what_waits_is_bounded_and_the_oldest_reports_go_first() {
    let mut world = world(&[], 4000);
    let row = |i: u32| {
        let (report, basis) = (Some(vec![0; 600]), Some(vec![0; 400]));
        Row::Diagnosis(DiagnosisRow { finished: f64::from(i), report, basis, ..DiagnosisRow::default() })
    };
    let rows = (0..4).map(row);
    for row in rows.chain([Row::Transition(TransitionRow::default())]) {
        world.feed.queue(row);
    }
    world.feed.bound();
    let reports: Vec<bool> = world
        .feed
        .rows
        .iter()
        .filter_map(|own| match &own.row {
            Row::Diagnosis(row) => Some(row.report.is_some() && row.basis.is_some()),
            _ => None,
        })
        .collect();
    assert_eq!(world.feed.rows.len(), 5, "no row is gone");
    assert!(world.feed.bytes <= 4000 && !reports[0] && reports[3], "{reports:?}");
    let counted: usize = world.feed.rows.iter().map(|own| own.row.bytes()).sum();
    assert_eq!(counted, world.feed.bytes);
    world.feed.max_bytes = 500;
    world.feed.bound();
    let newest = world.feed.rows.back().map(|own| &own.row);
    assert!(world.feed.bytes <= 500 && matches!(newest, Some(Row::Transition(_))));
    world.feed.take();
    world.feed.settled();
    assert_eq!((world.feed.rows.len(), world.feed.bytes), (0, 0));
}

/// What nobody says again: an alarm that was acknowledged stays as it was left.
#[test]
fn the_latest_states_stay_when_what_waits_is_too_much() {
    let mut world = world(&[], 4000);
    let alarm = |acknowledged| {
        let (control_loop, kind) = ("A".to_string(), "stiction".to_string());
        Row::Alarm(AlarmRow { control_loop, kind, acknowledged, ..AlarmRow::default() })
    };
    let model = Row::Model(ModelRow { control_loop: "A".into(), version: 3, ..ModelRow::default() });
    let later = (0..50).map(|_| Row::Transition(TransitionRow::default()));
    for row in [alarm(false), model.clone(), alarm(true)].into_iter().chain(later) {
        world.feed.queue(row);
    }
    world.feed.bound();
    let rows: Vec<&Row> = world.feed.rows.iter().map(|own| &own.row).collect();
    let dropped = world.shared.dropped_rows.load(Relaxed);
    assert_eq!((rows[0], rows[1]), (&model, &alarm(true)));
    assert!(rows.len() > 2 && rows.iter().filter(|row| row.is_state()).count() == 2, "{rows:?}");
    // The state that another took the place of is not missed.
    assert_eq!(dropped as usize, 52 - rows.len());
    assert_eq!(rows.iter().map(|row| row.bytes()).sum::<usize>(), world.feed.bytes);
    let states: usize = rows[..2].iter().map(|row| row.bytes()).sum();
    assert!(world.feed.bytes <= 4000 + states);
}

/// The days of one of 20 loops: together they are more than everything else may be.
fn days(own: u32) -> Row {
    let (control_loop, kind, trend) = (own.to_string(), "health".to_string(), "x".repeat(1000));
    Row::Alarm(AlarmRow { control_loop, kind, trend, ..AlarmRow::default() })
}

/// What happened: a run with its report, and an alarm that it raised.
fn happened() -> [Row; 2] {
    let report = Some(vec![0; 600]);
    let [control_loop, kind, before, after] = ["A", "stiction", "normal", "unacknowledged"].map(String::from);
    let raised = TransitionRow { control_loop, kind, before, after, ..TransitionRow::default() };
    [Row::Diagnosis(DiagnosisRow { report, ..DiagnosisRow::default() }), Row::Transition(raised)]
}

#[test]
fn states_that_are_larger_than_the_bound_drop_nothing_else() {
    let mut world = world(&[], 8000);
    happened().into_iter().for_each(|row| world.feed.queue(row));
    // Twice, as when the store fails for longer than a day.
    for _ in 0..2 {
        lock(&world.shared.rows).extend((0..20).map(days));
        world.feed.gather();
    }
    let rows: Vec<Row> = world.feed.rows.iter().map(|own| own.row.clone()).collect();
    assert_eq!(rows, happened().into_iter().chain((0..20).map(days)).collect::<Vec<Row>>());
    assert_eq!(world.shared.dropped_rows.load(Relaxed), 0);
    assert_eq!(rows.iter().map(Row::bytes).sum::<usize>(), world.feed.bytes);
}

/// A store that is begun anew is given all states at once: what waited before it is the step that its histories need.
#[test]
fn what_waited_is_not_dropped_for_what_is_said_again() {
    let mut world = world(&[], 8000);
    happened().into_iter().for_each(|row| world.feed.queue(row));
    let shared = world.shared.clone();
    world.feed.again = Box::new(move || {
        lock(&shared.rows).extend((0..20).map(days));
        super::super::again::Ends::default()
    });
    world.feed.say_again();
    let waits: Vec<Row> = world.feed.rows.iter().take(2).map(|own| own.row.clone()).collect();
    assert_eq!(waits, happened());
    assert_eq!((world.feed.rows.len(), world.shared.dropped_rows.load(Relaxed)), (22, 0));
}

#[test]
fn what_was_said_together_is_written_together() {
    let mut world = world(&[], 1 << 30);
    let kept = |subject: &str| KeptAlarm {
        id: AlarmId::new(LoopId::new(subject), Kind::Stiction),
        saved: Saved::default(),
        transitions: Vec::new(),
        acted: false,
        by: None,
        comment: None,
        detail: String::new(),
    };
    // Three rows each: a thousand of them end within one.
    for _ in 0..400 {
        let model = Some((LoopId::new("A"), ModelVersion::default()));
        let change = Change { run: None, model, alarms: vec![kept("A"), kept("B")] };
        assert_eq!(lock(&world.shared.changes).put(change), 0);
    }
    world.feed.gather();
    assert_eq!(world.feed.take().rows.len(), 1002);
    assert!(world.feed.settled());
    assert_eq!(world.feed.take().rows.len(), 198);
    assert!(!world.feed.settled());
}
