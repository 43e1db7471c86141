use super::*;
use crate::config::parse;
use crate::signal::Sample;

#[test]
fn a_new_ring_that_holds_what_is_of_before_a_set_back_measures_nothing() {
    let text = "[[modbus]]\nname = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0\n[[loop]]\nid = 'A'\n\
                [loop.op]\ndevice = 'd'\nregister = 'input'\naddress = 0\ntype = 'f32'\n\
                [loop.pv]\ndevice = 'd'\nregister = 'input'\naddress = 2\ntype = 'f32'\n";
    let config = parse("plant.toml", text).expect("sound");
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
