//! Historians that do not end, and live values that wait for them, without a server.

use super::listen::{Next, next};
use super::outage_tests::{Recorder, START, collector, good, second};
use super::*;
use crate::collect::opcua::link::{Historian, Page};
use crate::collect::opcua::listener::{Event, Events, Listener, listener};
use futures::FutureExt;
use opcua::client::{MonitoredItem, OnSubscriptionNotification};
use opcua::types::{ByteString, StatusCode};
use std::io::Write;
use std::sync::Mutex;

/// Values that are more than wait for history, and fewer than wait at all.
const SENT: u32 = 60_000;

/// A historian that answers each node as it is told: by how often it was asked before, and from when.
struct Told<F> {
    asked: usize,
    takes: Duration,
    at_once: usize,
    answer: F,
}

impl<F: FnMut(usize, f64) -> Page + Send> Historian for Told<F> {
    fn batch(&self) -> usize {
        100
    }

    async fn ask(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        from: f64,
        _to: f64,
    ) -> Result<Option<Vec<Page>>, Lost> {
        self.asked += 1;
        tokio::time::sleep(self.takes).await;
        let asked = self.asked - 1;
        Ok(Some(nodes.iter().take(self.at_once).map(|_| (self.answer)(asked, from)).collect()))
    }
}

fn told<F: FnMut(usize, f64) -> Page + Send>(takes: Duration, at_once: usize, answer: F) -> Told<F> {
    Told { asked: 0, takes, at_once, answer }
}

fn page(values: Vec<DataValue>, more: bool) -> Page {
    let next = if more { ByteString::from(vec![1]) } else { ByteString::null() };
    Page { values, status: StatusCode::Good, next }
}

/// So many tags that had a value each second up to ten seconds from the start, and none for the ten minutes after that.
async fn after_an_outage(tags: usize, sink: &Recorder) -> Collector {
    let mut collector = collector(tags, "", None);
    let all: Vec<usize> = (0..tags).collect();
    for _ in 0..10 {
        second(&mut collector, &all, 0.0, sink).await;
    }
    collector.left();
    tokio::time::advance(Duration::from_secs(600)).await;
    collector.tags.iter_mut().for_each(|tag| tag.node = Some(NodeId::null()));
    collector
}

/// What of a tag came after the outage, by time since the start (s).
fn since(sink: &Recorder, tag: usize) -> Vec<f64> {
    sink.of(tag).iter().filter(|s| s.value.is_finite()).map(|s| s.t - START).filter(|t| *t > 10.5).collect()
}

/// A listener to the subscription of a collector, and what it hears.
fn listening(collector: &Collector) -> (Listener, Events) {
    listener(collector.plan.tags.iter().map(|tag| tag.meaning.clone()).collect())
}

#[tokio::test(start_paused = true)]
async fn a_historian_without_end_is_given_up_and_the_rest_is_a_gap() {
    let sink = Recorder::default();
    let mut collector = after_an_outage(1, &sink).await;
    // Three values, and then pages without any and with a continuation.
    let values = || (0..3).map(|k| good(1.0, START + 20.0 + f64::from(k))).collect::<Vec<_>>();
    let mut historian = told(Duration::ZERO, 1, |asked, _| match asked {
        0 => page(values(), true),
        _ => page(Vec::new(), true),
    });
    collector.fill(&mut historian, None, &sink).await.expect("the session lives");
    assert_eq!(since(&sink, 0), [20.0, 21.0, 22.0]);
    // Once to its end, and once anew from its newest value on.
    assert!((100..=202).contains(&historian.asked), "{}", historian.asked);
    second(&mut collector, &[0], 0.0, &sink).await;
    let samples = sink.of(0);
    let mark = samples[samples.len() - 2];
    assert!(mark.value.is_nan() && mark.t > START + 22.0 && mark.t < START + 611.0, "{mark:?}");
}

#[tokio::test(start_paused = true)]
async fn live_values_wait_for_a_slow_historian_no_longer_than_ten_minutes() {
    let sink = Recorder::default();
    let mut collector = after_an_outage(1, &sink).await;
    // A value every nine seconds, and always one more.
    let slow = |asked: usize, _: f64| page(vec![good(1.0, START + 20.0 + asked as f64)], true);
    let mut historian = told(Duration::from_secs(9), 1, slow);
    let ((_listener, events), began) = (listening(&collector), Instant::now());
    collector.fill(&mut historian, Some(&events), &sink).await.expect("the session lives");
    assert_eq!(began.elapsed().as_secs(), 600);
    assert_eq!((historian.asked, since(&sink, 0).len()), (67, 66), "the last answer was not waited for");
    assert!(collector.tags[0].gap, "the rest is missing");
}

/// Lines of the log.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[tokio::test(start_paused = true)]
async fn history_that_is_given_up_is_told_once_with_its_device_and_its_tags() {
    let (sink, log) = (Recorder::default(), Log::default());
    let writer = log.clone();
    let to_log = tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).finish();
    let _guard = tracing::subscriber::set_default(to_log);
    let mut collector = after_an_outage(12, &sink).await;
    let slow = |asked: usize, _: f64| page(vec![good(1.0, START + 20.0 + asked as f64)], true);
    let mut historian = told(Duration::from_secs(9), 100, slow);
    let (_listener, events) = listening(&collector);
    collector.fill(&mut historian, Some(&events), &sink).await.expect("the session lives");
    // Live values go on, and it is not told again.
    second(&mut collector, &[0], 0.0, &sink).await;
    let said = String::from_utf8_lossy(&log.0.lock().unwrap()).into_owned();
    let warnings: Vec<&str> = said.lines().filter(|line| line.contains(" WARN ")).collect();
    let [warning] = warnings[..] else { panic!("{said}") };
    for part in [
        "history is broken off, and the rest stays a gap",
        "device=d",
        "unfilled=12",
        "missing=\"tag 0, tag 1, tag 2, tag 3, tag 4, tag 5, tag 6, tag 7, tag 8, tag 9 and 2 more\"",
    ] {
        assert!(warning.contains(part), "{part}: {warning}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_historian_that_takes_few_nodes_at_once_is_asked_for_all() {
    let sink = Recorder::default();
    let mut collector = after_an_outage(5, &sink).await;
    // Two values of each, capped without a word after the first.
    let capped = |_: usize, from: f64| {
        let t = if from < START + 30.0 { START + 30.0 } else { START + 40.0 };
        page(vec![good(1.0, t)], false)
    };
    let mut historian = told(Duration::ZERO, 2, capped);
    collector.fill(&mut historian, None, &sink).await.expect("the session lives");
    for tag in 0..5 {
        assert_eq!(since(&sink, tag), [30.0, 40.0], "{tag}");
        assert!(!collector.tags[tag].gap && collector.tags[tag].gap_from.is_none(), "{tag}");
    }
    // Three rounds of three: the second value is the last, which the third shows.
    assert_eq!(historian.asked, 9);
}

#[tokio::test(start_paused = true)]
async fn a_flood_ends_the_wait_for_a_historian_that_says_nothing_and_none_of_it_is_lost() {
    let sink = Recorder::default();
    let mut collector = after_an_outage(1, &sink).await;
    let (mut listener, mut events) = listening(&collector);
    let (item, began) = (MonitoredItem::new(1), Instant::now());
    {
        let mut silent = told(Duration::from_secs(86_400), 1, |_, _| page(Vec::new(), false));
        let fill = collector.fill(&mut silent, Some(&events), &sink);
        tokio::pin!(fill);
        assert!(fill.as_mut().now_or_never().is_none(), "it waits for an answer");
        for k in 0..SENT {
            listener.on_data_value(good(f64::from(k), START + 610.0 + f64::from(k) / 1e3), &item);
        }
        fill.await.expect("the session lives");
    }
    assert_eq!(began.elapsed().as_secs(), 10, "as long as an answer may take");
    for _ in 0..SENT {
        match events.recv().await {
            Some(Event::Value(at, value)) => collector.live(at, &value, &sink),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((events.dropped(), since(&sink, 0).len()), (None, SENT as usize));
    let mark = sink.of(0).into_iter().find(|sample| sample.value.is_nan()).expect("the gap is marked");
    assert!(mark.t > START + 10.0 && mark.t < START + 610.0, "{mark:?}");
}

#[tokio::test(start_paused = true)]
async fn nobody_waits_for_history_where_tags_are_polled() {
    let sink = Recorder::default();
    let mut collector = after_an_outage(1, &sink).await;
    let slow = |asked: usize, _: f64| match asked {
        0..100 => page(vec![good(1.0, START + 20.0 + asked as f64)], true),
        _ => page(Vec::new(), false),
    };
    let mut historian = told(Duration::from_secs(9), 1, slow);
    collector.fill(&mut historian, None, &sink).await.expect("the session lives");
    assert_eq!(since(&sink, 0).len(), 100);
    assert!(!collector.tags[0].gap, "nothing is missing");
}

#[tokio::test(start_paused = true)]
async fn tags_that_are_asked_for_later_have_their_part_of_the_time() {
    let sink = Recorder::default();
    let mut collector = after_an_outage(250, &sink).await;
    // Of the first hundred there is always one more; of the others all at once.
    let slow = |asked: usize, _: f64| match asked {
        0..23 => page(vec![good(1.0, START + 20.0 + asked as f64)], true),
        _ => page(vec![good(1.0, START + 30.0)], false),
    };
    let mut historian = told(Duration::from_secs(9), 100, slow);
    let (_listener, events) = listening(&collector);
    collector.fill(&mut historian, Some(&events), &sink).await.expect("the session lives");
    assert!(collector.tags[0].gap && !since(&sink, 0).is_empty(), "broken off after a third of the time");
    for tag in [100, 199, 200, 249] {
        assert!(since(&sink, tag) == [30.0] && !collector.tags[tag].gap, "{tag}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_crowd_does_not_end_history_that_comes_and_what_found_no_room_is_read_by_the_next_session() {
    let sink = Recorder::default();
    let mut collector = after_an_outage(1, &sink).await;
    let (mut listener, mut events) = listening(&collector);
    let item = MonitoredItem::new(1);
    let mut sent = 0_u32;
    while events.dropped().is_none() {
        listener.on_data_value(good(f64::from(sent), START + 610.0 + f64::from(sent) / 1e3), &item);
        sent += 1;
        assert!(sent < 10_000_000, "there is always room");
    }
    let full = collector.steady();
    // Five minutes of pages, which come.
    let paged = |asked: usize, _: f64| match asked {
        0..60 => page(vec![good(1.0, START + 20.0 + asked as f64)], true),
        _ => page(Vec::new(), false),
    };
    let mut historian = told(Duration::from_secs(5), 1, paged);
    collector.fill(&mut historian, Some(&events), &sink).await.expect("the session lives");
    assert_eq!(since(&sink, 0).len(), 60);
    // Later ones would stand behind a hole.
    listener.on_data_value(good(1.0, START + 1000.0), &item);
    let lost = collector.overflowed(&mut events, &sink).expect("some found no room");
    assert!(lost.to_string().contains("2 values"), "{lost}");
    let came = since(&sink, 0);
    assert_eq!(came.len(), 60 + sent as usize - 1, "all before the first that was dropped");
    assert!(came[came.len() - 1] < 1000.0);
    assert!((collector.heard_at - full).abs() < 1e-6, "{} {full}", collector.heard_at);
    collector.left();
    let from = collector.tags[0].gap_from.expect("something is missing");
    assert!(collector.tags[0].gap && (from - START - full).abs() < 1.0, "{from} {full}");
}

#[tokio::test(start_paused = true)]
async fn a_flood_keeps_no_tick_waiting_and_a_tick_no_value() {
    let collector = collector(1, "publishing_ms = 10", None);
    let (mut listener, mut events) = listening(&collector);
    let item = MonitoredItem::new(1);
    let mut ticks = collector.ticks();
    let (mut values, mut ticked) = (0, 0);
    while ticked < 40 {
        // There is always a value, and it is always time for a tick.
        listener.on_data_value(good(1.0, START), &item);
        tokio::time::advance(Duration::from_millis(10)).await;
        match next(&mut events, &mut ticks).await {
            Next::Event(event) => {
                assert!(event.is_some());
                values += 1;
            }
            Next::Tick => ticked += 1,
        }
        assert!(values < 2000, "only {ticked} ticks");
    }
    assert!(values > 0, "only ticks");
}
