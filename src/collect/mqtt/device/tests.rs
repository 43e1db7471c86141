//! What a collector makes of messages, without a broker and by a clock of our own.

use super::*;
use crate::collect::mqtt::{Config, TagSpec};
use std::sync::Mutex;

#[derive(Default)]
struct Recorder(Mutex<Vec<Sample>>, Mutex<usize>);

impl Sink for Recorder {
    fn sample(&self, _: usize, sample: Sample) {
        self.0.lock().unwrap().push(sample);
    }
    fn again(&self, _: usize) {
        *self.1.lock().unwrap() += 1;
    }
    fn poll(&self, _: usize, _: Poll) {}
}

/// A collector of one tag, `{"v": VALUE, "t": MILLISECONDS}`, and its clock (s).
fn collector() -> (Collector, Arc<Mutex<f64>>) {
    let config: Config = toml::from_str("name = 'b'\naddress = 'h:1883'").unwrap();
    let spec = TagSpec {
        index: 0,
        name: "A.pv".into(),
        role: None,
        config: toml::from_str("device = 'b'\ntopic = 'a'\npath = 'v'\ntime_path = 't'\nrange = [0.0, 10.0]")
            .unwrap(),
        frozen_after_s: None,
    };
    let plan = Plan::new(0, &config, vec![spec]).unwrap();
    let now = Arc::new(Mutex::new(1000.0));
    let clock = now.clone();
    (Collector::new(plan, Arc::new(move || *clock.lock().unwrap()), 1), now)
}

#[test]
fn a_source_that_says_the_same_again_lives_and_a_broker_that_kept_it_does_not_say_so() {
    let (sink, (mut collector, now)) = (Recorder::default(), collector());
    let health = collector.health();
    let mut say = |at: f64, payload: &str, retained| {
        *now.lock().unwrap() = at;
        assert_eq!(collector.message(b"a", payload.as_bytes(), retained, &sink), None);
        health.snapshot().last_good
    };
    let same = r#"{"v": 5, "t": 1700000000000}"#;
    assert_eq!(say(1000.0, same, false), Some(1000.0));
    assert_eq!(say(1300.0, same, false), Some(1300.0));
    assert_eq!(say(1400.0, same, true), Some(1300.0), "the broker had kept it");
    // What is not believed is no sign of life, and what is older is one.
    assert_eq!(say(1500.0, r#"{"v": 50, "t": 1700000000000}"#, false), Some(1300.0));
    assert_eq!(say(1600.0, r#"{"v": 5, "t": 1699999999000}"#, false), Some(1600.0));
    assert_eq!((sink.0.lock().unwrap().len(), health.snapshot().discarded_samples), (1, 1));
    assert_eq!(*sink.1.lock().unwrap(), 1, "once its source said a good value again");
}
