use super::*;
use crate::config::parse;
use crate::signal::Sample;
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
