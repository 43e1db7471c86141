use super::super::plantwide::{Plantwide, rows as kept};
use super::*;
use crate::alarm::{self, Action, AlarmId};
use crate::config::parse;
use crate::diagnosis::{Diagnosis, Verdict};
use crate::indicators::series::COUNT;
use crate::results::Said;
use crate::serve::PlantwidePort;
use crate::serve::dto::Report;
use crate::signal::Sample;
use crate::store::{Batch, DiagnosisRow, pack};
use crate::work::{CostConfig, Measure, Order, State};
use std::path::PathBuf;
use std::sync::mpsc::channel;

const PLANT: &str = "[[modbus]]\nname = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0\n[[loop]]\nid = 'A'\n\
                     [loop.op]\ndevice = 'd'\nregister = 'input'\naddress = 0\ntype = 'f32'\n\
                     [loop.pv]\ndevice = 'd'\nregister = 'input'\naddress = 2\ntype = 'f32'\n";

/// Health and metrics are asked for on threads that poll: whoever waits for a disk must not make them wait.
#[test]
fn how_the_store_is_can_be_asked_while_somebody_waits_for_it() {
    let config = parse("plant.toml", &format!("{PLANT}[store]\nfolder = '/nowhere'\n")).expect("sound");
    let wired = config.plant().expect("sound");
    let (history, results) =
        (History::new(&wired.loops, &config.history), Arc::new(Results::new(&[], 1, &config.alarm)));
    let ((end, ended), (begin, begun)) = (channel::<()>(), channel());
    let (ended, begin) = (Mutex::new(ended), Mutex::new(begin));
    // The first opening fails, the next hangs until the test ends.
    let first = AtomicBool::new(true);
    let open: store::Opener = Arc::new(move |config, _| {
        if !first.swap(false, Relaxed) {
            let _ = lock(&begin).send(());
            let _ = lock(&ended).recv();
        }
        Err(StoreError::Io { path: config.folder.clone(), source: io::Error::other("a disk that hangs") })
    });
    let driven = store::Driven { open, by_hand: false };
    let persistence = Persistence::new(&config, Clock::by_hand(0.0), driven, (&history, &results));
    persistence.begin(results.clone());
    begun.recv().expect("it is opened again");
    let (durable, ask) = (persistence.ask_durable().expect("there"), persistence.ask().expect("there"));
    let (tell, told) = channel();
    let waiting = std::thread::spawn(move || {
        tell.send(()).expect("waited for");
        durable()
    });
    told.recv().expect("it begins");
    let began = Instant::now();
    while !waiting.is_finished() && began.elapsed() < PATIENCE / 20 {
        assert!(ask().failing.is_some());
        std::thread::yield_now();
    }
    let longest = began.elapsed();
    drop(end);
    assert!(!waiting.join().expect("no panic"));
    assert!(longest < PATIENCE / 2, "it was answered after {longest:?}");
}

/// What follows rings and keeps nothing, by a clock that shows `at` (s), and what makes a history of the plant.
fn without_store(at: f64) -> (Arc<Persistence>, impl Fn() -> History) {
    let config = parse("plant.toml", PLANT).expect("sound");
    let (wired, rings) = (config.plant().expect("sound"), config.history.clone());
    let history = move || History::new(&wired.loops, &rings);
    let results = Results::new(&[], 1, &config.alarm);
    let persistence =
        Persistence::new(&config, Clock::by_hand(at), store::Driven::default(), (&history(), &results));
    (persistence, history)
}

#[test]
fn a_new_ring_that_holds_what_is_of_before_a_set_back_measures_nothing() {
    let (persistence, history) = without_store(0.0);
    let last =
        || lock(&persistence.shared.taps).iter().map(|tap| f64::from_bits(tap.last.load(Relaxed))).next();
    for (now, measure) in [(f64::INFINITY, 9000.0), (9001.0, 9000.0), (8000.0, f64::NAN)] {
        let own = history();
        own.push(0, Sample::good(9000.0, 1.0));
        lock(&persistence.shared.taps).clear();
        persistence.follow(&own, now);
        assert_eq!(last().map(f64::to_bits), Some(f64::to_bits(measure)), "{now}");
    }
}

/// While an era is owed a reload measures by no time of now, but the clock may have been set back once more.
#[test]
fn a_new_ring_begins_behind_a_set_back_whatever_it_is_measured_by() {
    let (persistence, history) = without_store(8000.0);
    for (told, set_backs) in [(7999.0, 0), (9000.0, 1)] {
        lock(&persistence.shared.set_backs).begin(told);
        lock(&persistence.shared.taps).clear();
        persistence.follow(&history(), f64::INFINITY);
        let found: Vec<u32> = lock(&persistence.shared.taps).iter().map(|tap| tap.set_backs).collect();
        assert!(!found.is_empty() && found.iter().all(|own| *own == set_backs), "{told}: {found:?}");
    }
}

/// A folder of its own, gone with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("stictiond-persistence-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).expect("writable");
        Self(path)
    }

    fn config(&self) -> Config {
        let store = format!("[store]\nfolder = {:?}\n", self.0.join("store"));
        parse("plant.toml", &format!("{PLANT}{store}")).expect("sound")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_store_that_opens_and_cannot_be_read_fails_until_it_can() {
    let folder = Folder::new("unread");
    let config = folder.config();
    let wired = config.plant().expect("sound");
    let history = History::new(&wired.loops, &config.history);
    let results = Arc::new(Results::new(&[LoopId::new("A")], 1, &config.alarm));
    // It opens, elsewhere: where it is configured nothing can be read.
    let elsewhere = store::Config::new(folder.0.join("elsewhere"));
    let open: store::Opener = Arc::new(move |_, _| Store::open(&elsewhere));
    let driven = store::Driven { open, by_hand: true };
    let persistence = Persistence::new(&config, Clock::by_hand(0.0), driven, (&history, &results));
    persistence.begin(results.clone());
    let ask = persistence.ask().expect("there is one");
    assert!(ask().failing.is_some_and(|(why, _)| why.contains("there is no store")));
    assert!(!persistence.make_durable(), "nothing is written before what is there has been read");
}

/// As of a sector that has gone bad: a process has nothing at the begin of its memory, and reading there fails.
#[test]
fn a_store_that_opens_and_fails_to_be_read_is_damaged() {
    let folder = Folder::new("sector");
    let config = folder.config();
    let own = config.store.clone().expect("there");
    let wired = config.plant().expect("sound");
    let history = History::new(&wired.loops, &config.history);
    let results = Arc::new(Results::new(&[LoopId::new("A")], 1, &config.alarm));
    std::fs::create_dir_all(&own.folder).expect("writable");
    std::os::unix::fs::symlink("/proc/self/mem", own.folder.join("store.db")).expect("writable");
    let elsewhere = store::Config::new(folder.0.join("elsewhere"));
    let open: store::Opener = Arc::new(move |_, _| Store::open(&elsewhere));
    let driven = store::Driven { open, by_hand: true };
    let persistence = Persistence::new(&config, Clock::by_hand(0.0), driven, (&history, &results));
    assert!(store::is_damaged(&own), "after the next start too");
    persistence.begin(results.clone());
    let state = persistence.ask().expect("there is one")();
    assert!(state.is_damaged && state.failing.is_some_and(|(why, _)| why.contains("I/O")));
}

#[test]
fn what_was_thinned_while_the_clock_was_ahead_is_counted() {
    let status = store::Status { thinned_in_doubt_s: 600, ..store::Status::default() };
    let counters = state(status, &Shared::default()).counters;
    assert!(counters.contains(&("thinned_in_doubt_s", 600)), "{counters:?}");
}

/// Each reload with another size leaves the rings of before; a store that is damaged never drains them.
#[test]
fn few_rings_wait_for_a_store_that_fails_and_none_for_one_that_is_damaged() {
    for is_damaged in [false, true] {
        let folder = Folder::new("retired");
        let config = folder.config();
        let own = config.store.clone().expect("there");
        if is_damaged {
            std::fs::create_dir_all(&own.folder).expect("writable");
            assert!(store::mark_damaged(&own, "somebody is to decide").is_damage());
        }
        let wired = config.plant().expect("sound");
        let history = || History::new(&wired.loops, &config.history);
        let (first, results) = (history(), Results::new(&[], 1, &config.alarm));
        let driven = store::Driven { by_hand: true, ..store::Driven::default() };
        let persistence = Persistence::new(&config, Clock::by_hand(0.0), driven, (&first, &results));
        let reload = |_: usize| {
            let own = history();
            persistence.follow(&own, 0.0);
            for t in [1000.0, 1001.0] {
                assert!(own.push(0, Sample::good(t, 1.0)));
            }
            (lock(&persistence.shared.taps).len(), persistence.shared.lost_samples.load(Relaxed))
        };
        let found: Vec<(usize, u64)> = (0..4).map(reload).collect();
        // Two tags; the first rings held nothing.
        let expected =
            if is_damaged { [(2, 0), (2, 2), (2, 4), (2, 6)] } else { [(4, 0), (4, 0), (4, 2), (4, 4)] };
        assert_eq!(found, expected, "damaged: {is_damaged}");
    }
}

fn order(control_loop: &str) -> Order {
    Order {
        id: LoopId::new(control_loop),
        state: State::Ordered,
        since: 2000.0,
        first: 1000.0,
        suspected: 2000.0,
        why: None,
        gains_nothing: false,
        victims: Vec::new(),
        looks: VecDeque::new(),
        before: None,
        after: None,
        by: Some("ann".into()),
        note: Some("fitter called".into()),
        reopened: 0,
    }
}

/// The work list and the indicators: of a start that could not open the store, and of a loop that is taken out and put back.
#[test]
fn orders_and_indicators_are_back_as_soon_as_they_can_be_read() {
    let folder = Folder::new("orders");
    let mut config = folder.config();
    for own in &mut config.loops {
        own.cost = Some(CostConfig { per_sd: 2.0, unit: "EUR/day".into() });
    }
    // How a loop was is kept every 25 minutes.
    config.plantwide.period_s = 60.0;
    let own = config.store.clone().expect("there");
    let days = vec![(86_400.0, [Some(81.5); COUNT]), (172_800.0, [None; COUNT])];
    // A quarter of an hour ago; without the swing half of the error would be left.
    let part = kept::Part { until: 299_100.0, values: [Some(81.5); COUNT], counts: [11; COUNT] };
    let measure = Measure { error_sd: Some(3.0), swing: Some(0.75), f: None };
    let of = |id: &str| {
        let mut rows = kept::order_rows(&order(id), None);
        rows.push(kept::health_row(&LoopId::new(id), &days));
        rows.push(kept::today_row(&LoopId::new(id), &part, &measure));
        rows
    };
    // X was configured once.
    let rows = ["A", "X"].into_iter().flat_map(of).collect();
    let mut store = Store::open(&own).expect("opens");
    store.write(&Batch { series: Vec::new(), rows }).expect("writes");
    drop(store);

    let first = AtomicBool::new(true);
    let open: store::Opener = Arc::new(move |config, _| match first.swap(false, Relaxed) {
        true => Err(StoreError::InUse(config.folder.clone())),
        false => Store::open(config),
    });
    let driven = store::Driven { open, by_hand: true };
    let wired = config.plant().expect("sound");
    let history = Arc::new(History::new(&wired.loops, &config.history));
    let (results, clock) =
        (Arc::new(Results::new(&[LoopId::new("A")], 1, &config.alarm)), Clock::by_hand(3e5));
    let persistence = Persistence::new(&config, clock, driven, (&history, &results));
    let plantwide = Plantwide::new(&config, clock, &history, &results, &persistence);
    let there = || {
        let orders: Vec<Order> = plantwide.work().into_iter().map(|line| line.order).collect();
        (orders, plantwide.health(&LoopId::new("A")).map(|own| own.days))
    };
    assert_eq!(there(), (vec![], None), "the store failed");
    persistence.begin(results.clone());
    assert!(persistence.make_durable());
    let all = (vec![order("A")], Some(days.clone()));
    assert_eq!(there(), all, "now it works");
    let cost = || plantwide.work().into_iter().find_map(|line| line.cost);
    assert_eq!(cost(), Some((3.0, "EUR/day".to_string())), "before the first look");

    let without = parse("plant.toml", &PLANT.replace("id = 'A'", "id = 'B'")).expect("sound");
    plantwide.reload(&without, &history);
    assert_eq!(there(), (vec![], None));
    plantwide.reload(&config, &history);
    persistence.give_back(&history, &results).expect("can be read");
    assert_eq!(there(), all, "it is configured again");
    assert_eq!(cost(), Some((3.0, "EUR/day".to_string())));
}

/// As of a disk that is replaced while the daemon runs: all of it is in memory, and nobody says it again until it changes.
#[test]
fn a_store_that_is_gone_is_made_anew_with_all_that_is_a_state() {
    let folder = Folder::new("gone");
    let config = folder.config();
    let (own, id) = (config.store.clone().expect("there"), LoopId::new("A"));
    let mut rows = kept::order_rows(&order("A"), None);
    rows.push(kept::health_row(&id, &[(86_400.0, [Some(81.5); COUNT])]));
    let part = kept::Part { until: 299_100.0, values: [Some(81.5); COUNT], counts: [11; COUNT] };
    rows.push(kept::today_row(&id, &part, &Measure::default()));
    let (control_loop, kind) = ("A".to_string(), "stiction".to_string());
    let alarm = AlarmRow { control_loop, kind, active: true, out_of_service: true, ..AlarmRow::default() };
    let model = ModelRow { control_loop: "A".into(), version: 3, since: 1000.0, ..ModelRow::default() };
    rows.extend([store::Row::Alarm(alarm), store::Row::Model(model)]);
    let batch = Batch { series: Vec::new(), rows };
    Store::open(&own).and_then(|mut store| store.write(&batch)).expect("writes");
    let states = || Reader::open(&own.folder).and_then(|reader| reader.states()).expect("can be read");
    let before = states();
    assert_eq!((before.alarms.len(), before.models.len()), (4, 1));

    let driven = store::Driven { by_hand: true, ..store::Driven::default() };
    let wired = config.plant().expect("sound");
    let history = Arc::new(History::new(&wired.loops, &config.history));
    let (results, clock) = (Arc::new(Results::new(&[id], 1, &config.alarm)), Clock::by_hand(3e5));
    let persistence = Persistence::new(&config, clock, driven, (&history, &results));
    let _plantwide = Plantwide::new(&config, clock, &history, &results, &persistence);
    persistence.begin(results.clone());
    assert!(persistence.make_durable());
    std::fs::remove_dir_all(&own.folder).expect("there");
    assert!(!persistence.make_durable(), "it is noticed");
    assert!(persistence.make_durable(), "another is begun");
    assert_eq!(states(), before);
}

/// A disk that is full keeps nobody from reading it.
#[test]
fn a_store_that_cannot_be_opened_is_read_and_not_merged_into_itself() {
    let folder = Folder::new("full");
    let config = folder.config();
    let own = config.store.clone().expect("there");
    let alarm = AlarmRow {
        control_loop: "A".into(),
        kind: "stiction".into(),
        active: true,
        out_of_service: true,
        ..AlarmRow::default()
    };
    let mut store = Store::open(&own).expect("opens");
    store.write(&Batch { series: Vec::new(), rows: vec![store::Row::Alarm(alarm)] }).expect("writes");
    drop(store);

    let first = AtomicBool::new(true);
    let open: store::Opener = Arc::new(move |config, _| match first.swap(false, Relaxed) {
        true => Err(StoreError::Io { path: config.folder.clone(), source: io::Error::other("no room") }),
        false => Store::open(config),
    });
    let driven = store::Driven { open, by_hand: true };
    let wired = config.plant().expect("sound");
    let history = History::new(&wired.loops, &config.history);
    let results = Arc::new(Results::new(&[LoopId::new("A")], 1, &config.alarm));
    let persistence = Persistence::new(&config, Clock::by_hand(3e5), driven, (&history, &results));
    let id = AlarmId::named("A/stiction");
    let state = || results.alarm(&id, 3e5).expect("there").state;
    assert_eq!(state(), alarm::State::OutOfService, "it is back at once");
    persistence.begin(results.clone());
    assert!(persistence.ask().is_some_and(|ask| ask().failing.is_some()));
    let back = results.act(&id, Action::GiveBack, Said::default(), 3e5).expect("there");
    assert_eq!(back.expect("it may be").state, alarm::State::Unacknowledged);
    assert!(persistence.make_durable(), "there is room again");
    assert_eq!(state(), alarm::State::Unacknowledged, "what was done meanwhile stays");
    let kept =
        Reader::open(&own.folder).and_then(|reader| reader.alarm("A", "stiction")).expect("can be read");
    assert!(kept.is_some_and(|row| row.active && !row.out_of_service));
}

/// As where an older copy is put back while the daemon runs, or a disk comes back on which another was begun meanwhile.
#[test]
fn in_an_older_copy_of_the_store_histories_go_on_from_where_it_was_left() {
    let folder = Folder::new("copy");
    let mut config = folder.config();
    config.alarm.f_rising.enabled = true;
    let own = config.store.clone().expect("there");
    let step = |kind: &str, at: f64, [before, after]: [&str; 2], cause: &str| {
        let [control_loop, kind] = ["A", kind].map(String::from);
        let [before, after, cause] = [before, after, cause].map(String::from);
        let row = store::TransitionRow { control_loop, kind, at, before, after, cause, ..Default::default() };
        store::Row::Transition(row)
    };
    let alarm = |kind: &str, active: bool, out_of_service: bool| {
        let [control_loop, kind] = ["A", kind].map(String::from);
        let acknowledged = !active;
        let row =
            AlarmRow { control_loop, kind, active, acknowledged, out_of_service, ..AlarmRow::default() };
        store::Row::Alarm(row)
    };
    let raised = ["normal", "unacknowledged"];
    let mut store = Store::open(&own).expect("opens");
    let mut put = |rows| store.write(&Batch { series: Vec::new(), rows }).expect("writes");
    put(vec![step("stiction", 1.0, raised, "raised"), alarm("stiction", true, false)]);
    put(vec![step("f_rising", 1.0, raised, "raised"), alarm("f_rising", true, false)]);
    let aside = folder.0.join("copy");
    std::fs::create_dir(&aside).expect("writable");
    for file in std::fs::read_dir(&own.folder).expect("there").map(|file| file.expect("read")) {
        std::fs::copy(file.path(), aside.join(file.file_name())).expect("copied");
    }
    put(vec![
        step("stiction", 2.0, ["unacknowledged", "out-of-service"], "out_of_service"),
        alarm("stiction", true, true),
        step("f_rising", 2.0, ["unacknowledged", "normal"], "forgotten"),
        alarm("f_rising", false, false),
    ]);
    drop(store);

    let driven = store::Driven { by_hand: true, ..store::Driven::default() };
    let wired = config.plant().expect("sound");
    let history = History::new(&wired.loops, &config.history);
    let results = Arc::new(Results::new(&[LoopId::new("A")], 1, &config.alarm));
    let persistence = Persistence::new(&config, Clock::by_hand(3e5), driven, (&history, &results));
    persistence.begin(results.clone());
    assert!(persistence.make_durable());
    std::fs::rename(&own.folder, folder.0.join("gone")).expect("writable");
    std::fs::rename(&aside, &own.folder).expect("writable");
    assert!(!persistence.make_durable(), "it is noticed");
    let id = AlarmId::named("A/stiction");
    assert!(results.act(&id, Action::GiveBack, Said::default(), 3e5).expect("there").is_ok());
    assert!(persistence.make_durable(), "it goes on in the copy");
    assert_eq!(store::check(&own.folder).expect("can be read").faults, [""; 0]);
    let reader = Reader::open(&own.folder).expect("can be read");
    let told = |kind: &str| -> Vec<String> {
        let rows = reader.transitions(0, 99).expect("reads").into_iter().map(|(_, row)| row);
        rows.filter(|row| row.kind == kind).map(|row| format!("{} {}", row.cause, row.after)).collect()
    };
    let expected = ["raised unacknowledged", "forgotten out-of-service", "in_service unacknowledged"];
    assert_eq!(told("stiction"), expected);
    assert_eq!(told("f_rising"), ["raised unacknowledged", "forgotten normal"]);
    assert!(reader.alarm("A", "f_rising").expect("reads").is_some_and(|row| !row.active));
}

/// As where `url` was added beside a folder that is in use: nothing is written, and nobody is told that there are no alarms.
#[test]
fn of_a_folder_that_is_refused_as_a_spool_states_are_back_and_go_to_the_one_in_its_place() {
    let folder = Folder::new("refused");
    let mut config = folder.config();
    let upkeep = store::Upkeep { pace: None, ..store::Upkeep::default() };
    let own = store::Config { samples_days: 1.0, upkeep, ..config.store.clone().expect("there") };
    let [control_loop, kind] = ["A", "stiction"].map(String::from);
    let alarm = AlarmRow { control_loop, kind, active: true, out_of_service: true, ..AlarmRow::default() };
    let [control_loop, tag, source, unit] = ["A", "op", "", ""].map(String::from);
    let tag = Arc::new(TagName { control_loop, tag, source, unit });
    let series = vec![store::Series { tag, samples: vec![Sample::good(1000.0, 1.0)] }];
    let mut store = Store::open(&own).expect("opens");
    store.write(&Batch { series, rows: vec![store::Row::Alarm(alarm)] }).expect("writes");
    // To a trend.
    while store.tidy(3e5).expect("tidies") {}
    drop(store);

    let url = Some("postgres://nobody@127.0.0.1:1/none".to_string());
    config.store = Some(store::Config { url, ..own.clone() });
    let wired = config.plant().expect("sound");
    let history = History::new(&wired.loops, &config.history);
    let results = Arc::new(Results::new(&[LoopId::new("A")], 1, &config.alarm));
    let driven = store::Driven { by_hand: true, ..store::Driven::default() };
    let persistence = Persistence::new(&config, Clock::by_hand(3e5), driven, (&history, &results));
    let state = results.alarm(&AlarmId::named("A/stiction"), 3e5).expect("there").state;
    assert_eq!(state, alarm::State::OutOfService, "it is back");
    persistence.begin(results.clone());
    let why = persistence.ask().and_then(|ask| ask().failing).expect("nothing is written").0;
    assert!(why.contains("a store of its own"), "{why}");
    assert!(!persistence.make_durable());
    std::fs::rename(&own.folder, folder.0.join("aside")).expect("writable");
    assert!(persistence.make_durable(), "an empty folder is a spool");
    let kept = Reader::open(&own.folder).and_then(|reader| reader.alarm("A", "stiction"));
    assert!(kept.expect("can be read").is_some_and(|row| row.active && row.out_of_service));
}

#[test]
fn up_to_where_the_last_verdict_was_fitted_is_known_though_runs_that_say_nothing_came_since() {
    let folder = Folder::new("fitted");
    let own = folder.config().store.expect("there");
    let mut store = Store::open(&own).expect("opens");
    let mut ends = |finished: f64, outcome: &str, end: f64| {
        let mut report = Report::from(("A", &Diagnosis::bare(Verdict::NoStiction, "made for a test")));
        report.window.end = Some(end);
        let run = DiagnosisRow {
            control_loop: "A".into(),
            finished,
            outcome: outcome.into(),
            report: report.as_text().as_deref().and_then(pack),
            ..DiagnosisRow::default()
        };
        let rows = vec![store::Row::Diagnosis(run)];
        store.write(&Batch { series: Vec::new(), rows }).expect("writes");
        let reader = Reader::open(&own.folder).expect("can be read");
        remembered(&reader, &LoopId::new("A"), 9).expect("can be read").fitted_until
    };
    assert_eq!(ends(1.0, "not_identifiable", 0.5), None);
    assert_eq!(ends(2.0, "stiction", 1.5), Some(1.5));
    assert_eq!(ends(3.0, "not_identifiable", 2.5), Some(1.5));
    assert_eq!(ends(4.0, "no_stiction", 0.1), Some(0.1));
}
