//! Clocks that differ, sessions that end, and what is missing after them, without a server and by a clock of our own.

use super::listen::Closer;
use super::*;
use crate::collect::opcua::value::date_time;
use crate::collect::opcua::{Config, TagSpec};
use opcua::types::{StatusCode, Variant};
use std::sync::Mutex;
use tokio::time::advance;

/// Our clock's time at the start of a test (s).
pub(super) const START: f64 = 1.0e9;
/// A time of another century (s).
const FAR: f64 = 4.07e9;

/// What was handed on, with its tag.
#[derive(Default)]
pub(super) struct Recorder(Mutex<Vec<(usize, Sample)>>);

impl Sink for Recorder {
    fn sample(&self, tag: usize, sample: Sample) {
        self.0.lock().unwrap().push((tag, sample));
    }
    fn poll(&self, _: usize, _: Poll) {}
}

impl Recorder {
    pub(super) fn of(&self, tag: usize) -> Vec<Sample> {
        self.0.lock().unwrap().iter().filter(|(at, _)| *at == tag).map(|(_, sample)| *sample).collect()
    }

    fn last(&self, tag: usize) -> Sample {
        *self.of(tag).last().expect("there is one")
    }
}

/// A collector of so many tags whose clock goes with the runtime's.
pub(super) fn collector(tags: usize, more: &str, frozen_after_s: Option<f64>) -> Collector {
    let text = format!("name = 'd'\nurl = 'opc.tcp://d:4840/'\nsecurity_policy = 'None'\n{more}");
    let config: Config = toml::from_str(&text).unwrap();
    let spec = |index: usize| TagSpec {
        index,
        name: format!("tag {index}"),
        role: None,
        config: toml::from_str(&format!("device = 'd'\nnode = 'ns=2;s=A{index}'")).unwrap(),
        frozen_after_s,
    };
    let plan = Plan::new(0, &config, (0..tags).map(spec).collect()).unwrap();
    let began = Instant::now();
    Collector::new(plan, Arc::new(move || START + began.elapsed().as_secs_f64()), 1)
}

pub(super) fn good(value: f64, source: f64) -> DataValue {
    DataValue {
        value: Some(Variant::Double(value)),
        source_timestamp: Some(date_time(source)),
        ..DataValue::null()
    }
}

/// Without a value and without a source stamp, as servers send it whose controller is gone.
fn bad(server: f64) -> DataValue {
    DataValue {
        status: Some(StatusCode::BadNoCommunication),
        server_timestamp: Some(date_time(server)),
        ..DataValue::null()
    }
}

/// A value of this tag comes.
fn live(collector: &mut Collector, at: usize, value: &DataValue, sink: &Recorder) {
    let received = Received::of(value, &collector.plan.tags[at].meaning);
    collector.live(at, &received, sink);
}

async fn pass(seconds: f64) {
    advance(Duration::from_secs_f64(seconds)).await;
}

/// A second of each of the tags, stamped with our time and so much more.
pub(super) async fn second(collector: &mut Collector, tags: &[usize], ahead: f64, sink: &Recorder) {
    pass(1.0).await;
    let now = collector.clock.now() + ahead;
    for at in tags {
        live(collector, *at, &good(now - START, now), sink);
    }
}

fn forward(samples: &[Sample]) -> bool {
    samples.windows(2).all(|pair| pair[1].t > pair[0].t)
}

#[tokio::test(start_paused = true)]
async fn a_value_that_does_not_change_is_a_sign_of_life() {
    let (sink, mut collector) = (Recorder::default(), collector(1, "", None));
    let health = collector.health();
    let last = || health.snapshot().last_good.expect("one came");
    live(&mut collector, 0, &good(5.0, START), &sink);
    assert_eq!(last(), START);
    pass(300.0).await;
    live(&mut collector, 0, &good(5.0, START), &sink);
    assert!(last() >= START + 300.0 && sink.of(0).len() == 1, "no sample, and alive");
    // It could not be had for a while, and is as it was: behind the mark, and then the same again.
    pass(300.0).await;
    live(&mut collector, 0, &bad(START + 600.0), &sink);
    assert!(last() < START + 600.0, "that is no good answer");
    live(&mut collector, 0, &good(5.0, START), &sink);
    pass(300.0).await;
    live(&mut collector, 0, &good(5.0, START), &sink);
    assert!(last() >= START + 900.0 && sink.of(0).len() == 3, "{:?}", sink.of(0));
}

#[tokio::test(start_paused = true)]
async fn one_stamp_of_another_century_stops_no_tag_over_an_outage() {
    let (sink, mut collector) = (Recorder::default(), collector(3, "fill_gaps = false", None));
    for _ in 0..5 {
        second(&mut collector, &[0, 1, 2], 0.0, &sink).await;
    }
    live(&mut collector, 2, &good(1.0, FAR), &sink);
    collector.left();
    for _ in 0..10 {
        pass(1.0).await;
        collector.down_tick(&sink);
    }
    for _ in 0..20 {
        second(&mut collector, &[0, 1, 2], 0.0, &sink).await;
    }
    for tag in [0, 1] {
        let samples = sink.of(tag);
        assert!(forward(&samples) && samples.iter().all(|s| s.t < START + 60.0), "{samples:?}");
        assert_eq!(samples.iter().filter(|s| s.quality.is_good()).count(), 25, "{samples:?}");
        // The marks of the outage, and none for values that were there.
        assert!(samples.iter().filter(|s| !s.quality.is_good()).all(|s| s.t > START + 5.0), "{samples:?}");
    }
    // The tag itself is believed to have been set back at the fifth.
    assert!(sink.last(2).quality.is_good() && sink.last(2).t < START + 60.0, "{:?}", sink.of(2));
}

#[tokio::test(start_paused = true)]
async fn the_first_stamp_of_a_tag_may_be_far_ahead_and_moves_no_other() {
    let (sink, mut collector) = (Recorder::default(), collector(3, "fill_gaps = false", None));
    live(&mut collector, 0, &good(1.0, FAR), &sink);
    for _ in 0..3 {
        second(&mut collector, &[1, 2], 0.0, &sink).await;
    }
    pass(1.0).await;
    collector.refused(1, "not there any more", &sink);
    let mark = sink.last(1);
    assert!(mark.value.is_nan() && (mark.t - START - 4.0).abs() < 0.1, "{mark:?}");
    collector.left();
    assert!(collector.tags[2].gap_from.is_some_and(|from| (from - START - 3.0).abs() < 0.1));
    let (from, to) = collector.span(&[1, 2]);
    assert!(from > START - 60.0 && to < START + 120.0, "{from} {to}");
}

#[tokio::test(start_paused = true)]
async fn a_controller_whose_clock_is_late_loses_no_value_behind_a_bad_one() {
    let (sink, mut collector) = (Recorder::default(), collector(1, "", None));
    for _ in 0..5 {
        second(&mut collector, &[0], -40.0, &sink).await;
    }
    pass(1.0).await;
    let now = collector.clock.now();
    live(&mut collector, 0, &bad(now), &sink);
    let mark = sink.last(0);
    assert!(mark.value.is_nan() && (mark.t - START - 6.0 + 40.0).abs() < 0.1, "{mark:?}");
    for _ in 0..10 {
        second(&mut collector, &[0], -40.0, &sink).await;
    }
    let samples = sink.of(0);
    assert!(forward(&samples), "{samples:?}");
    // Each has its own stamp.
    let own = samples.iter().filter(|s| s.quality.is_good() && (s.t - START - s.value).abs() < 1e-6).count();
    assert_eq!((own, collector.health.snapshot().discarded_samples), (15, 0), "{samples:?}");
}

#[tokio::test(start_paused = true)]
async fn history_is_asked_from_the_end_of_the_session_however_often_the_next_ones_fail() {
    let (sink, mut collector) = (Recorder::default(), collector(2, "history_max_s = 3600.0", None));
    // A set point of yesterday, and a value that changes.
    live(&mut collector, 0, &good(50.0, START - 86_400.0), &sink);
    for _ in 0..10 {
        second(&mut collector, &[1], 0.0, &sink).await;
    }
    collector.left();
    // Ten minutes, in which the set point alone is marked, and a session that brings nothing.
    for _ in 0..10 {
        pass(60.0).await;
        collector.down_tick(&sink);
    }
    collector.left();
    assert!(sink.last(0).value.is_nan() && sink.last(0).t > START + 60.0, "{:?}", sink.last(0));
    let (from, to) = collector.span(&[0, 1]);
    assert!((from - START - 10.0 + 60.0).abs() < 1.0 && to > START + 610.0, "{from} {to}");
    // Live values end it, and the next outage begins there.
    for _ in 0..3 {
        second(&mut collector, &[0, 1], 0.0, &sink).await;
    }
    assert!(collector.tags.iter().all(|tag| tag.gap_from.is_none()));
    collector.left();
    let (from, _) = collector.span(&[0, 1]);
    assert!((from - START - 613.0 + 60.0).abs() < 1.0, "{from}");
}

#[tokio::test(start_paused = true)]
async fn history_that_begins_late_leaves_a_marked_gap_and_one_that_is_complete_leaves_none() {
    for late in [false, true] {
        let (sink, mut collector) = (Recorder::default(), collector(1, "", None));
        for _ in 0..10 {
            second(&mut collector, &[0], 0.0, &sink).await;
        }
        collector.left();
        pass(600.0).await;
        let begin = if late { START + 400.0 } else { START + 10.5 };
        let kept: Vec<DataValue> = (0..5).map(|k| good(f64::from(k), begin + f64::from(k))).collect();
        assert_eq!(collector.take_page(0, kept, START + 700.0, &sink).0, 5);
        let marks: Vec<Sample> = sink.of(0).into_iter().filter(|s| s.value.is_nan()).collect();
        assert_eq!(marks.len(), usize::from(late), "{marks:?}");
        assert!(marks.iter().all(|mark| mark.t > START + 10.0 && mark.t < begin), "{marks:?}");
        assert!(forward(&sink.of(0)));
    }
}

#[tokio::test(start_paused = true)]
async fn a_wrong_stamp_in_the_history_is_left_out() {
    let (sink, mut collector) = (Recorder::default(), collector(1, "", None));
    for _ in 0..3 {
        second(&mut collector, &[0], 0.0, &sink).await;
    }
    collector.left();
    pass(10.0).await;
    let (_, to) = collector.span(&[0]);
    let kept = vec![good(1.0, START + 5.0), good(2.0, FAR)];
    assert_eq!(collector.take_page(0, kept, to, &sink), (1, START + 5.0));
    second(&mut collector, &[0], 0.0, &sink).await;
    assert!((sink.last(0).t - START - 14.0).abs() < 0.1, "{:?}", sink.last(0));
}

/// A value of the first tag was read.
fn look(collector: &mut Collector, value: &DataValue, closer: &mut Closer, sink: &Recorder) {
    let received = Received::of(value, &collector.plan.tags[0].meaning);
    collector.look(0, &received, closer, sink);
}

#[tokio::test(start_paused = true)]
async fn a_value_that_changed_lately_is_not_hidden_yet() {
    let (sink, mut collector) = (Recorder::default(), collector(1, "sampling_ms = 60000", None));
    second(&mut collector, &[0], 0.0, &sink).await;
    pass(200.0).await;
    let now = collector.clock.now();
    let mut closer = Closer::default();
    look(&mut collector, &good(7.0, now - 30.0), &mut closer, &sink);
    assert_eq!(closer, Closer { hidden: 0, lately: 1 });
    look(&mut collector, &good(7.0, now - 62.0), &mut closer, &sink);
    assert_eq!(closer, Closer { hidden: 1, lately: 1 });
    // Neither was handed on: what the subscription owes comes by it, or from history.
    assert_eq!(sink.of(0).len(), 1);
    // What has not changed is no reason for anything.
    look(&mut collector, &good(1.0, START + 1.0), &mut closer, &sink);
    assert_eq!((closer, sink.of(0).len()), (Closer { hidden: 1, lately: 1 }, 1));
}

#[tokio::test(start_paused = true)]
async fn a_value_that_is_told_once_is_stale_once_when_it_stays_for_too_long() {
    let (sink, mut collector) = (Recorder::default(), collector(1, "", Some(60.0)));
    second(&mut collector, &[0], 0.0, &sink).await;
    for _ in 0..100 {
        pass(1.0).await;
        collector.repeat_frozen(&sink);
    }
    let samples = sink.of(0);
    assert_eq!(samples.len(), 2, "{samples:?}");
    assert_eq!((samples[1].value, samples[1].quality), (samples[0].value, Quality::Stale));
    assert!(samples[1].t - samples[0].t > 60.0 && samples[1].t - samples[0].t < 64.0, "{samples:?}");
    // Read again with its own stamp it is nothing new, and a change is good.
    live(&mut collector, 0, &good(1.0, START + 1.0), &sink);
    assert_eq!((sink.of(0).len(), collector.health.snapshot().discarded_samples), (2, 0));
    second(&mut collector, &[0], 0.0, &sink).await;
    assert!(sink.last(0).quality.is_good() && forward(&sink.of(0)), "{:?}", sink.of(0));
    // A change that came late, of before a repetition, is put behind it.
    for _ in 0..100 {
        pass(1.0).await;
        collector.repeat_frozen(&sink);
    }
    let repeated = sink.last(0);
    assert_eq!(repeated.quality, Quality::Stale);
    live(&mut collector, 0, &good(77.0, repeated.t - 1.0), &sink);
    assert!(sink.last(0).value == 77.0 && sink.last(0).quality.is_good() && forward(&sink.of(0)));
    // While nobody is there, nobody knows.
    let before = sink.of(0).len();
    collector.left();
    for _ in 0..100 {
        pass(1.0).await;
        collector.repeat_frozen(&sink);
    }
    assert_eq!(sink.of(0).len(), before);
}

#[tokio::test(start_paused = true)]
async fn a_value_at_rest_comes_behind_the_mark_of_before_the_start() {
    let bad = Quality::Bad(BadReason::LinkDown);
    let lost = Sample { t: START - 60.0, value: f64::NAN, quality: bad };
    let frozen = Sample { value: 5.0, quality: Quality::Stale, ..lost };
    for (more, mark, marks) in [("backfill_s = 3600.0", lost, 1), ("", lost, 0), ("", frozen, 0)] {
        let (sink, mut collector) = (Recorder::default(), collector(1, more, None));
        // It could not be had when the daemon ended, or was repeated, and has not changed for an hour.
        collector.resume(&|_| Some(mark));
        pass(1.0).await;
        live(&mut collector, 0, &good(5.0, START - 3600.0), &sink);
        let (samples, last) = (sink.of(0), sink.last(0));
        assert!(last.quality.is_good() && last.value == 5.0 && last.t > mark.t, "{more}: {samples:?}");
        assert!(forward(&samples) && samples[0].t > mark.t, "{more}: {samples:?}");
        // With history what is missing is said once more.
        assert_eq!(samples.iter().filter(|own| own.value.is_nan()).count(), marks, "{more}: {samples:?}");
        live(&mut collector, 0, &good(5.0, START - 3600.0), &sink);
        assert_eq!(sink.of(0).len(), samples.len(), "{more}: the same again");
    }
    // Behind a value it is that value again, and so it is where the source itself called it uncertain.
    let value = Sample::good(START - 3600.0, 5.0);
    let uncertain = Sample { quality: Quality::Stale, ..value };
    for (more, newest) in
        [("backfill_s = 3600.0", value), ("backfill_s = 3600.0", uncertain), ("", uncertain)]
    {
        let (sink, mut collector) = (Recorder::default(), collector(1, more, None));
        collector.resume(&|_| Some(newest));
        live(&mut collector, 0, &good(5.0, START - 3600.0), &sink);
        assert!(sink.of(0).is_empty(), "{more}: {:?}", sink.of(0));
    }
    // A clock that is behind what was stored hides no refusal.
    let (sink, mut collector) = (Recorder::default(), collector(1, "", None));
    let ahead = Sample { t: START + 100.0, ..frozen };
    collector.resume(&|_| Some(ahead));
    collector.refused(0, "no such node", &sink);
    assert!(sink.last(0).value.is_nan() && sink.last(0).t > ahead.t, "{:?}", sink.of(0));
}

#[tokio::test(start_paused = true)]
async fn history_that_breaks_off_leaves_the_rest_a_gap() {
    for failed in [false, true] {
        let (sink, mut collector) = (Recorder::default(), collector(1, "", None));
        second(&mut collector, &[0], 0.0, &sink).await;
        collector.left();
        pass(20.0).await;
        collector.take_page(0, vec![good(1.0, START + 2.0), good(2.0, START + 3.0)], START + 80.0, &sink);
        collector.tags[0].filled(failed);
        second(&mut collector, &[0], 0.0, &sink).await;
        let marks: Vec<Sample> = sink.of(0).into_iter().filter(|s| s.value.is_nan()).collect();
        assert_eq!(marks.len(), usize::from(failed), "{marks:?}");
        assert!(marks.iter().all(|mark| mark.t > START + 3.0 && mark.t < START + 22.0), "{marks:?}");
        assert!(forward(&sink.of(0)));
    }
}

#[tokio::test(start_paused = true)]
async fn history_is_left_out_when_two_sessions_in_a_row_were_lost_while_it_was_read() {
    let mut collector = collector(1, "", None);
    assert_eq!([collector.dares(), collector.dares(), collector.dares()], [true, true, false]);
}
