use super::*;
use crate::collect::mqtt::{Config, Plan, TagSpec};
use crate::mqtt::sparkplug::{BDSEQ, PropertySet, PropertyValue, Value, datatype};
use proptest::prelude::*;

/// Tags: 0 the node's `load`, 1 the device's `op`, 2 the device's metric of alias 7.
fn edge() -> Edge {
    let config: Config = toml::from_str("name = 'b'\naddress = 'h:1883'").unwrap();
    let tags = [
        "sparkplug = 'g/e'\nmetric = 'load'",
        "sparkplug = 'g/e/d'\nmetric = 'op'",
        "sparkplug = 'g/e/d'\nalias = 7",
    ];
    let specs = tags.iter().enumerate().map(|(index, text)| TagSpec {
        index,
        name: format!("tag {index}"),
        role: None,
        config: toml::from_str(&format!("device = 'b'\n{text}")).unwrap(),
        frozen_after_s: None,
    });
    let plan = Plan::new(0, &config, specs.collect()).unwrap();
    assert_eq!(plan.filters().into_iter().collect::<Vec<_>>(), ["spBv1.0/g/+/e/#"]);
    Edge::all(&plan.tags).remove(0)
}

const T: u64 = 1_700_000_000_000;

fn metric(name: &str, alias: u64, value: f64) -> Metric {
    let named = Metric::named(name, datatype::DOUBLE, Some(Value::Double(value)));
    Metric { alias: Some(alias), timestamp: Some(T), ..named }
}

/// As data: by alias only, with no type.
fn bare(alias: u64, value: f64) -> Metric {
    Metric { name: None, datatype: None, ..metric("", alias, value) }
}

fn bdseq(number: u64) -> Metric {
    Metric::named(BDSEQ, datatype::INT64, Some(Value::Long(number)))
}

fn say(edge: &mut Edge, topic: &str, seq: Option<u64>, metrics: Vec<Metric>) -> News {
    let topic = Topic::parse(topic).unwrap();
    assert!(edge.is_of(&topic));
    edge.take(&topic, &Payload { timestamp: Some(T), metrics, seq })
}

fn values(news: &News) -> Vec<(usize, f64)> {
    news.values.iter().map(|(tag, told)| (*tag, told.raw.unwrap())).collect()
}

fn born(edge: &mut Edge, session: u64) {
    let news = say(edge, "spBv1.0/g/NBIRTH/e", Some(0), vec![bdseq(session), metric("load", 1, 0.5)]);
    assert_eq!(values(&news), [(0, 0.5)]);
    let news = say(edge, "spBv1.0/g/DBIRTH/e/d", Some(1), vec![metric("op", 3, 40.0), metric("pv", 7, 20.0)]);
    assert_eq!((values(&news), news.refused), (vec![(1, 40.0), (2, 20.0)], 0));
}

#[test]
fn births_data_and_deaths() {
    let mut edge = edge();
    let early = say(&mut edge, "spBv1.0/g/DDATA/e/d", Some(9), vec![bare(3, 1.0)]);
    assert_eq!((early.values.len(), early.wants_births, early.refused), (0, true, 1));
    born(&mut edge, 5);
    let news =
        say(&mut edge, "spBv1.0/g/DDATA/e/d", Some(2), vec![bare(3, 41.0), bare(7, 21.0), bare(9, 1.0)]);
    assert_eq!(values(&news), [(1, 41.0), (2, 21.0)]);
    assert_eq!(news.values[0].1.t, Some(1_700_000_000.0));
    let dead = say(&mut edge, "spBv1.0/g/DDEATH/e/d", Some(3), vec![]);
    assert_eq!(dead.lost, [(1, BadReason::LinkDown), (2, BadReason::LinkDown)]);
    let late = say(&mut edge, "spBv1.0/g/DDATA/e/d", Some(4), vec![metric("op", 3, 1.0)]);
    assert_eq!((late.values.len(), late.wants_births, late.refused), (0, true, 1));
    // The will of the session before the one that was born last says nothing.
    assert_eq!(say(&mut edge, "spBv1.0/g/NDEATH/e", None, vec![bdseq(4)]), News::default());
    let dead = say(&mut edge, "spBv1.0/g/NDEATH/e", None, vec![bdseq(5)]);
    assert_eq!(dead.lost.len(), 3);
}

#[test]
fn after_a_missed_message_an_alias_means_nothing_until_the_next_birth() {
    let mut edge = edge();
    born(&mut edge, 1);
    let gap = say(&mut edge, "spBv1.0/g/DDATA/e/d", Some(3), vec![bare(3, 1.0), metric("op", 3, 42.0)]);
    assert!(gap.gap && gap.wants_births);
    assert_eq!(values(&gap), [(1, 42.0)], "a name is a name");
    let after = say(&mut edge, "spBv1.0/g/DDATA/e/d", Some(4), vec![bare(3, 1.0)]);
    assert!(!after.gap && after.values.is_empty());
    // Another birth gives the number another meaning.
    say(&mut edge, "spBv1.0/g/NBIRTH/e", Some(0), vec![metric("load", 3, 0.6)]);
    say(&mut edge, "spBv1.0/g/DBIRTH/e/d", Some(1), vec![metric("op", 8, 50.0)]);
    let news = say(&mut edge, "spBv1.0/g/DDATA/e/d", Some(2), vec![bare(3, 1.0), bare(8, 51.0)]);
    assert_eq!(values(&news), [(1, 51.0)]);
}

#[test]
fn numbers_run_from_255_to_0() {
    let mut edge = edge();
    say(&mut edge, "spBv1.0/g/NBIRTH/e", Some(255), vec![metric("load", 1, 1.0)]);
    assert!(!say(&mut edge, "spBv1.0/g/NDATA/e", Some(0), vec![bare(1, 2.0)]).gap);
    assert!(say(&mut edge, "spBv1.0/g/NDATA/e", Some(0), vec![bare(1, 2.0)]).gap);
    assert_eq!(say(&mut edge, "spBv1.0/g/NDATA/e", Some(256), vec![bare(1, 2.0)]).refused, 1);
    assert_eq!(say(&mut edge, "spBv1.0/g/NDATA/e", None, vec![bare(1, 2.0)]).refused, 1);
}

#[test]
fn nulls_qualities_texts_and_strange_times() {
    let mut edge = edge();
    born(&mut edge, 1);
    let quality = |code| Metric {
        properties: Some(PropertySet {
            keys: vec!["Quality".into()],
            values: vec![PropertyValue { datatype: Some(datatype::INT32), int: Some(code) }],
        }),
        ..metric("op", 3, 1.0)
    };
    let mut seq = 1;
    let mut one = |metric: Metric| {
        seq += 1;
        say(&mut edge, "spBv1.0/g/DDATA/e/d", Some(seq), vec![metric])
    };
    let of = |news: News| news.values.first().map(|(_, told)| told.quality);
    assert_eq!(of(one(quality(192))), Some(Quality::Good));
    assert_eq!(of(one(quality(500))), Some(Quality::Stale));
    assert_eq!(of(one(quality(0))), Some(Quality::Bad(BadReason::DeviceException)));
    let null = Metric { is_null: Some(true), value: None, ..metric("op", 3, 1.0) };
    assert_eq!(of(one(null)), Some(Quality::Bad(BadReason::NotANumber)));
    for strange in [
        Metric { value: Some(Value::Text("7".into())), ..metric("op", 3, 1.0) },
        Metric { value: None, ..metric("op", 3, 1.0) },
        Metric { timestamp: Some(5), ..metric("op", 3, 1.0) },
        Metric { timestamp: Some(u64::MAX), ..metric("op", 3, 1.0) },
    ] {
        let news = one(strange);
        assert_eq!((news.values.len(), news.refused), (0, 1));
    }
}

#[test]
fn a_metric_that_a_birth_does_not_have_is_bad() {
    let mut edge = edge();
    let news = say(&mut edge, "spBv1.0/g/NBIRTH/e", Some(0), vec![bdseq(1)]);
    assert_eq!(news.lost, [(0, BadReason::DeviceException)]);
}

proptest! {
    /// In any order of messages: no panic, and each value is one that this message carries.
    #[test]
    fn no_value_is_invented(
        messages in prop::collection::vec((0usize..6, 0u64..4, 0u64..9, any::<bool>()), 0..80),
    ) {
        let topics = ["NBIRTH/e", "NDEATH/e", "NDATA/e", "DBIRTH/e/d", "DDEATH/e/d", "DDATA/e/d"];
        let mut edge = edge();
        for (number, (kind, seq, alias, named)) in messages.into_iter().enumerate() {
            let told = number as f64;
            let metric = if named { metric("op", alias, told) } else { bare(alias, told) };
            let news = say(&mut edge, &format!("spBv1.0/g/{}", topics[kind]), Some(seq), vec![metric]);
            for (_, value) in &news.values {
                prop_assert_eq!(value.raw, Some(told));
            }
        }
    }
}
