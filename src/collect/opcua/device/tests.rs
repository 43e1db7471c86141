//! What a hostile or broken server may send, to the collector and without a server.

use super::*;
use crate::collect::HealthSnapshot;
use crate::collect::opcua::value::date_time;
use crate::collect::opcua::{Config, TagSpec};
use opcua::types::{DateTime, StatusCode, Variant};
use proptest::prelude::*;
use std::sync::Mutex;

#[derive(Default)]
struct Recorder(Mutex<Vec<Sample>>);

impl Sink for Recorder {
    fn sample(&self, _: usize, sample: Sample) {
        self.0.lock().unwrap().push(sample);
    }
    fn poll(&self, _: usize, _: Poll) {}
}

/// A collector of one tag without scaling; a value without a source time has none.
fn collector() -> Collector {
    let config: Config = toml::from_str(
        "name = 'd'\nurl = 'opc.tcp://d:4840/'\nsecurity_policy = 'None'\nsource_time_fallback = 'none'",
    )
    .unwrap();
    let spec = TagSpec {
        index: 0,
        name: "a".into(),
        role: None,
        config: toml::from_str("device = 'd'\nnode = 'ns=2;s=A'").unwrap(),
        frozen_after_s: None,
    };
    let plan = Plan::new(0, &config, vec![spec]).unwrap();
    Collector::new(plan, Arc::new(|| 1.0e9), 1)
}

#[test]
fn a_collector_that_takes_the_place_of_another_goes_on_with_its_namespaces() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    let _guard = runtime.enter();
    let pinned = Pinned::default();
    let first = collector().pinning(&pinned);
    first.pins.with(|pins| pins.pin(2, "urn:a".into()));
    drop(first);
    assert_eq!(collector().pinning(&pinned).pins.known(), [(2, "urn:a".to_string())]);
    assert!(collector().pins.known().is_empty(), "it shares them with nobody");
}

fn variant() -> impl Strategy<Value = Option<Variant>> {
    prop_oneof![
        6 => any::<f64>().prop_map(|v| Some(Variant::Double(v))),
        2 => any::<f32>().prop_map(|v| Some(Variant::Float(v))),
        2 => any::<i64>().prop_map(|v| Some(Variant::Int64(v))),
        1 => any::<u64>().prop_map(|v| Some(Variant::UInt64(v))),
        1 => any::<i16>().prop_map(|v| Some(Variant::Int16(v))),
        1 => any::<u8>().prop_map(|v| Some(Variant::Byte(v))),
        1 => any::<bool>().prop_map(|v| Some(Variant::Boolean(v))),
        1 => ".{0,8}".prop_map(|v| Some(Variant::from(v.as_str()))),
        1 => prop::collection::vec(any::<f64>(), 0..4).prop_map(|v| Some(Variant::from(v))),
        1 => Just(Some(Variant::Empty)),
        1 => Just(None),
    ]
}

/// Around now, an hour off, and anything that 64 bits can say.
fn time() -> impl Strategy<Value = Option<DateTime>> {
    let near = (0..200u32).prop_map(|step| 1.0e9 + f64::from(step));
    let jumped = (near.clone(), prop::sample::select(vec![-3600.0, 3600.0])).prop_map(|(t, by)| t + by);
    prop_oneof![
        8 => near.prop_map(|t| Some(date_time(t))),
        3 => jumped.prop_map(|t| Some(date_time(t))),
        1 => any::<i64>().prop_map(|ticks| Some(DateTime::from(ticks))),
        1 => Just(Some(DateTime::null())),
        1 => Just(None),
    ]
}

fn status() -> impl Strategy<Value = Option<StatusCode>> {
    prop_oneof![
        6 => Just(None),
        2 => Just(Some(StatusCode::Good)),
        1 => Just(Some(StatusCode::UncertainLastUsableValue)),
        1 => Just(Some(StatusCode::BadSensorFailure)),
        1 => any::<u32>().prop_map(|bits| Some(StatusCode::from(bits))),
    ]
}

fn sent() -> impl Strategy<Value = DataValue> {
    (variant(), status(), time(), time()).prop_map(|(value, status, source_timestamp, server_timestamp)| {
        DataValue { value, status, source_timestamp, server_timestamp, ..DataValue::null() }
    })
}

fn counted(health: &HealthSnapshot) -> u64 {
    health.good_samples + health.bad_samples + health.discarded_samples + health.exceptions
}

proptest! {
    // Long sequences find more here than many short ones.
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn no_value_is_invented_and_each_that_is_not_handed_on_is_counted(
        values in prop::collection::vec(sent(), 1..120),
    ) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let _guard = runtime.enter();
        let (sink, mut collector) = (Recorder::default(), collector());
        let health = collector.health();
        for value in &values {
            let (before, at) = (health.snapshot(), sink.0.lock().unwrap().len());
            let newest = collector.tags[0].series.last();
            let meaning = collector.plan.tags[0].meaning.clone();
            let received = Received::of(value, &meaning);
            collector.live(0, &received, &sink);
            let after = health.snapshot();
            let samples = sink.0.lock().unwrap();
            let (source, raw) = (received.source, received.reading(&meaning));
            prop_assert!(samples.len() <= at + 1);
            if let Some(sample) = samples.get(at) {
                prop_assert!(sample.t.is_finite());
                prop_assert_eq!(sample.value.to_bits(), if source.is_none() { f64::NAN } else { raw.value }.to_bits());
                prop_assert!(!sample.quality.is_good() || sample.value.is_finite());
                let after_a_mark = at > 0 && samples[at - 1].value.is_nan() && sample.t > samples[at - 1].t;
                prop_assert!(sample.value.is_nan() || Some(sample.t) == source || after_a_mark, "{:?}", sample);
            }
            // Only what was handed on before, with the time it has, needs no counting.
            let again = source.is_some() && source <= newest && !raw.value.is_nan();
            prop_assert!(counted(&after) > counted(&before) || again, "{:?}", value);
        }
    }

    #[test]
    fn a_clock_set_by_an_hour_and_back_costs_four_samples_and_is_counted(
        runs in (6usize..18, 6usize..18, 6usize..18),
        forward in any::<bool>(),
    ) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let _guard = runtime.enter();
        let (sink, mut collector) = (Recorder::default(), collector());
        let by = if forward { 3600.0 } else { -3600.0 };
        let shifts = [(runs.0, 0.0), (runs.1, by), (runs.2, 0.0)];
        let shifted = shifts.into_iter().flat_map(|(n, by)| std::iter::repeat_n(by, n));
        let times: Vec<f64> = shifted.enumerate().map(|(k, by)| 1.0e9 + k as f64 + by).collect();
        for t in &times {
            let value = DataValue {
                value: Some(Variant::Double(*t)),
                source_timestamp: Some(date_time(*t)),
                ..DataValue::null()
            };
            let received = Received::of(&value, &collector.plan.tags[0].meaning);
            collector.live(0, &received, &sink);
        }
        let samples = sink.0.lock().unwrap();
        prop_assert!(samples.iter().all(|s| s.t == s.value && s.quality.is_good()));
        let health = collector.health().snapshot();
        prop_assert_eq!((samples.len(), health.discarded_samples), (times.len() - 4, 4));
        // Forward to where our own clock is comes a source that was late, and that is none.
        prop_assert_eq!(health.clock_jumps, if forward { 2 } else { 1 });
    }
}
