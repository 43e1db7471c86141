use super::super::plantwide::{Plantwide, rows as kept};
use super::*;
use crate::alarm::{self, Action, AlarmId};
use crate::config::parse;
use crate::indicators::series::COUNT;
use crate::results::Said;
use crate::serve::PlantwidePort;
use crate::signal::Sample;
use crate::store::Batch;
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

#[test]
fn a_new_ring_that_holds_what_is_of_before_a_set_back_measures_nothing() {
    let config = parse("plant.toml", PLANT).expect("sound");
    let wired = config.plant().expect("sound");
    let history = || History::new(&wired.loops, &config.history);
    let results = Results::new(&[], 1, &config.alarm);
    let none = history();
    let persistence =
        Persistence::new(&config, Clock::by_hand(0.0), store::Driven::default(), (&none, &results));
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
    let order = |control_loop: &str| Order {
        id: LoopId::new(control_loop),
        state: State::Ordered,
        since: 2000.0,
        first: 1000.0,
        suspected: 2000.0,
        why: None,
        victims: Vec::new(),
        looks: VecDeque::new(),
        before: None,
        after: None,
        by: Some("ann".into()),
        note: Some("fitter called".into()),
        reopened: 0,
    };
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
