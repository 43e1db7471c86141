//! What an MQTT broker sends, as the collector takes it.

use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;
use stictiond::collect::mqtt::{Collector, Config, Plan, TagSpec};
use stictiond::collect::{Clock, Poll, Sink};
use stictiond::signal::Sample;

/// 2026-01-01T00:00:00Z.
const NOW: f64 = 1_767_225_600.0;

/// Topics with every way in which a value, a time and a quality are told.
const JSON: [&str; 5] = [
    "topic = 'a'",
    "topic = 'a'\ndecimal = ','",
    "topic = 'a'\npath = 'v'\ntime_path = 't'\nquality_path = 'q'",
    "topic = 'a'\npath = 'items[0].v'\ntime_path = 'items[0].t'\nscale = 0.1\nrange = [0.0, 100.0]",
    "topic = 'a'\npath = \"$.['a.b'].v\"\ndecimal = '.'",
];
/// Metrics by name and by alias, of a node and of a device.
const METRICS: [&str; 4] = [
    "sparkplug = 'g/e'\nmetric = 'pv'",
    "sparkplug = 'g/e'\nalias = 2",
    "sparkplug = 'g/e/d'\nmetric = 'op'\nrange = [0.0, 100.0]",
    "sparkplug = 'g/e/d'\nalias = 1",
];
const TOPICS: [&str; 6] = [
    "spBv1.0/g/NBIRTH/e",
    "spBv1.0/g/NDEATH/e",
    "spBv1.0/g/NDATA/e",
    "spBv1.0/g/DBIRTH/e/d",
    "spBv1.0/g/DDEATH/e/d",
    "spBv1.0/g/DDATA/e/d",
];

struct Still;

impl Clock for Still {
    fn now(&self) -> f64 {
        NOW
    }
}

/// Believes only what may be believed.
#[derive(Default)]
struct Judge(Mutex<Vec<f64>>);

impl Sink for Judge {
    fn sample(&self, tag: usize, sample: Sample) {
        assert!(sample.t.is_finite(), "{tag}: {sample:?}");
        assert!(!sample.quality.is_good() || sample.value.is_finite(), "{tag}: {sample:?}");
        self.0.lock().expect("nobody panicked").push(sample.t);
    }

    fn poll(&self, _device: usize, poll: Poll) {
        assert!(poll.good + poll.bad > 0 && poll.took < Duration::from_secs(10));
    }
}

fn plan(tags: &[&str]) -> Plan {
    let config: Config = toml::from_str("name = 'b'\naddress = 'h:1883'").expect("a broker");
    let specs = tags.iter().enumerate().map(|(index, text)| {
        let config = toml::from_str(&format!("device = 'b'\n{text}")).expect("a tag");
        TagSpec { index, name: format!("A.{index}"), role: None, config, frozen_after_s: Some(60.0) }
    });
    Plan::new(0, &config, specs.collect()).expect("a plan")
}

/// Payloads of one topic, divided by a zero byte.
pub fn json(bytes: &[u8]) {
    static PLAN: OnceLock<Plan> = OnceLock::new();
    let plan = PLAN.get_or_init(|| plan(&JSON));
    let judge = Judge::default();
    let mut collector = Collector::new(plan.clone(), Arc::new(Still), 1);
    for payload in bytes.split(|byte| *byte == 0).take(16) {
        let _ = collector.message(b"a", payload, false, &judge);
    }
}

/// A length that stands for all bytes that are left: so a payload can be longer than a byte says.
pub const REST: u8 = 0xff;

/// Messages of one edge node: which, how long, and the payload.
pub fn sparkplug(bytes: &[u8]) {
    static PLAN: OnceLock<Plan> = OnceLock::new();
    let plan = PLAN.get_or_init(|| plan(&METRICS));
    let judge = Judge::default();
    let mut collector = Collector::new(plan.clone(), Arc::new(Still), 1);
    let mut rest = bytes;
    for _ in 0..16 {
        let Some(([which, length], after)) = rest.split_first_chunk::<2>() else { return };
        let length = if *length == REST { after.len() } else { usize::from(*length).min(after.len()) };
        let (payload, after) = after.split_at(length);
        let topic = TOPICS[usize::from(*which) % TOPICS.len()];
        let _ = collector.message(topic.as_bytes(), payload, which & 0x80 != 0, &judge);
        rest = after;
    }
}
