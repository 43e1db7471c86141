use super::*;
use crate::alarm::{Action, AlarmId, Kind, Priority, Shelving, State};
use crate::diagnosis::{Diagnosis, Estimate, Model, NotIdentifiable, Settings, with_model_error};
use crate::signal::Record;
use std::sync::Mutex;

mod away;
mod changes;
mod clock;
mod compensated;
mod source;
mod told;

pub(super) fn diagnosis(verdict: Verdict, f: f64, delta_aic: f64) -> Box<Judged> {
    let model = Model { na: 1, nb: 1, nc: 1, nk: 1, a: vec![0.0], b: vec![0.0], c: vec![0.0], rmse: 1.0 };
    let estimate = Estimate {
        f,
        f_ci95: with_model_error(f, [f - 0.1, f + 0.1]),
        f_of_op_range: 0.1,
        delta_aic,
        rival: crate::diagnosis::rivals::Rival::Linear,
        steadiness: 9.0,
        f_max: 10.0,
        d: f,
        curve: vec![],
        model,
        mv: vec![],
    };
    let identifiable = !matches!(verdict, Verdict::NotIdentifiable(_));
    let diagnosis = Diagnosis {
        estimate: identifiable.then_some(estimate),
        ..Diagnosis::bare(verdict, "made for a test")
    };
    Box::new(diagnosis.into())
}

pub(super) fn run(time: f64, outcome: Outcome) -> Run {
    Run {
        basis: None,
        id: LoopId::new("A"),
        started: time - 1.0,
        finished: time,
        took_s: 0.02,
        trigger: Trigger::Periodic,
        op_span: Some(50.0),
        outcome,
    }
}

fn sticky(time: f64) -> Run {
    run(time, Outcome::Diagnosed(diagnosis(Verdict::Stiction, 1.0, 400.0)))
}

fn results(keep: usize) -> Results {
    Results::new(&[LoopId::new("A"), LoopId::new("B")], keep, &alarm::Config::default())
}

fn id() -> LoopId {
    LoopId::new("A")
}

fn stiction() -> AlarmId {
    AlarmId::new(id(), Kind::Stiction)
}

#[test]
fn keeps_the_latest_in_full_and_a_bounded_number_of_summaries() {
    let results = results(3);
    assert_eq!(results.coverage(), (0, 2));
    (0..5).for_each(|time| drop(results.record(sticky(f64::from(time)))));
    let times: Vec<f64> = results.summaries(&id()).expect("A is there").iter().map(|s| s.time).collect();
    assert_eq!(times, vec![2.0, 3.0, 4.0]);
    let known = results.get(&id(), 5.0).expect("A is there");
    assert_eq!(known.diagnosed.expect("diagnosed").finished, 4.0);
    // 1.0 OP unit of a span of 50 is 2 %.
    assert_eq!(known.summary.expect("diagnosed").f, Some(2.0));
    assert_eq!(results.coverage(), (1, 2));
    assert!(results.get(&LoopId::new("C"), 5.0).is_none());
}

#[test]
fn a_failed_run_is_told_and_leaves_the_last_diagnosis_standing() {
    let results = results(3);
    results.record(sticky(1.0));
    results.record(run(2.0, Outcome::Panicked("secret of the inside".into())));
    let known = results.get(&id(), 3.0).expect("A is there");
    assert_eq!(known.diagnosed.expect("kept").finished, 1.0);
    let last = known.last.expect("there were runs");
    assert_eq!((last.outcome.as_ref(), last.f), ("panicked", None));
    assert!(!last.reason.contains("secret"));
}

#[test]
fn an_alarm_says_what_the_run_says_in_words() {
    let results = results(3);
    (1..3).for_each(|k| drop(results.record(sticky(f64::from(k)))));
    let said = "The valve sticks: it ignores the first 4 % OP of each reversal.";
    let known = results.get(&id(), 3.0).expect("A is there");
    assert_eq!(
        (known.alarm.detail.as_str(), known.summary.expect("diagnosed").words().as_str()),
        (said, said)
    );
    assert_eq!(results.alarm_log()[0].detail, said);
    // What was traced is said too, in numbers of OP's span, though no effect was found.
    let mut judged = diagnosis(Verdict::NoStiction, 0.0, -2.0);
    judged.findings = Some(made_findings(Verdict::Stiction, Vec::new()));
    let summary = results.record(run(3.0, Outcome::Diagnosed(judged))).summary();
    assert_eq!(summary.words(), "The valve sticks: it ignores the first 8.83 % OP of each reversal.");
    assert_eq!(results.alarm(&stiction(), 4.0).expect("A is there").detail, summary.words());
}

#[test]
fn diagnoses_raise_the_alarm_and_everybody_hears_it_in_order() {
    let results = results(3);
    let mut events = results.subscribe();
    results.record(sticky(1.0));
    let why = Verdict::NotIdentifiable(NotIdentifiable::FlatPv);
    results.record(run(2.0, Outcome::Diagnosed(diagnosis(why, 0.0, 0.0))));
    results.record(sticky(3.0));
    let mut heard = Vec::new();
    while let Ok(event) = events.try_recv() {
        heard.push(match event {
            Event::Run(_, summary) => summary.outcome.to_string(),
            Event::Alarm(change) => change.transition.to.as_str().to_string(),
            Event::Writeback(..) => "writeback".to_string(),
            Event::Backfill { .. } => "backfill".to_string(),
            Event::Reloaded { .. } => "reloaded".to_string(),
        });
    }
    assert_eq!(heard, vec!["stiction", "not_identifiable", "stiction", "unacknowledged"]);
}

#[test]
fn what_was_before_a_start_that_did_not_know_it_is_merged_into_what_is_there() {
    let (then, changes) = (results(9), Arc::<Mutex<Vec<Change>>>::default());
    let heard = changes.clone();
    then.keep_with(Arc::new(move |change| heard.lock().expect("no panic").push(change)));
    for t in 1..=2 {
        then.record(sticky(f64::from(t)));
    }
    let said = Said { by: Some("kim".into()), comment: Some("seen".into()) };
    then.act(&stiction(), Action::Acknowledge, said, 3.0).expect("A is there").expect("it waits for that");
    let mut said = std::mem::take(&mut *changes.lock().expect("no panic"));
    let KeptAlarm { id: of, saved, by, comment, detail, .. } =
        said.pop().and_then(|mut change| change.alarms.pop()).expect("the acknowledgement");
    let kept = RestoredAlarm { id: of, saved, by, comment, detail };
    let model = then.get(&id(), 3.0).expect("A is there").model;
    assert_eq!(model.version, 1);
    let model = ModelVersion { version: 4, ..model };
    let runs = Remembered { summaries: then.summaries(&id()).expect("A is there"), ..Remembered::default() };

    // Nothing has happened since: it is as it was, and nobody hears of it.
    let now = results(9);
    let heard = changes.clone();
    now.keep_with(Arc::new(move |change| heard.lock().expect("no panic").push(change)));
    now.merge_model(&id(), model.clone());
    now.merge_alarms(vec![kept.clone()], 10.0);
    let known = now.get(&id(), 10.0).expect("A is there");
    assert_eq!((known.model.version, known.alarm.state), (4, State::Acknowledged));
    // What may wait of it from when it was not known is replaced.
    let mut written = std::mem::take(&mut *changes.lock().expect("no panic"));
    let written = written.pop().filter(|_| written.is_empty()).expect("one change").alarms;
    assert_eq!((written.len(), &written[0].saved, written[0].acted), (1, &kept.saved, false));
    assert!(written[0].transitions.is_empty() && now.alarm_log().is_empty());

    // It was raised anew: that is one and the same, and somebody has seen it.
    let now = results(9);
    now.record(sticky(11.0));
    now.record(sticky(12.0));
    let heard = changes.clone();
    now.keep_with(Arc::new(move |change| heard.lock().expect("no panic").push(change)));
    let other = ModelVersion { effects: vec![(crate::residual::Kind::ALL[0], None)], ..model };
    now.merge_model(&id(), other.clone());
    // Found once more, it is older than what there is.
    now.merge_model(&id(), other);
    now.merge_alarms(vec![kept.clone()], 13.0);
    now.restore(&id(), runs.clone());
    let known = now.get(&id(), 14.0).expect("A is there");
    assert_eq!((known.model.version, known.alarm.state), (5, State::Acknowledged), "versions go on");
    assert_eq!((known.alarm.raised_at, known.alarm.by.as_deref()), (Some(2.0), Some("kim")));
    let times = |results: &Results| -> Vec<f64> {
        results.summaries(&id()).expect("A is there").iter().map(|summary| summary.time).collect()
    };
    assert_eq!(times(&now), [1.0, 2.0, 11.0, 12.0]);
    now.restore(&id(), runs);
    assert_eq!(times(&now), [1.0, 2.0, 11.0, 12.0], "once");
    let kept = std::mem::take(&mut *changes.lock().expect("no panic"));
    assert_eq!(kept[0].model.as_ref().map(|(own, model)| (own.clone(), model.version)), Some((id(), 5)));
    let told = &kept[1].alarms[0].transitions[0];
    assert_eq!((told.from, told.to), (State::Unacknowledged, State::Acknowledged));
    assert_eq!((told.cause, kept[1].alarms[0].by.as_deref()), (alarm::Cause::Restored, Some("kim")));
}

#[test]
fn an_alarm_that_the_configuration_suppressed_speaks_again_after_a_restart_without_that() {
    let bad = AlarmId::new(id(), Kind::TagBad);
    let design = alarm::Config {
        suppressed: vec!["A/stiction".into(), "A/tag_bad".into()],
        ..alarm::Config::default()
    };
    let (old, changes) = (Results::new(&[id()], 9, &design), Arc::<Mutex<Vec<Change>>>::default());
    let heard = changes.clone();
    old.keep_with(Arc::new(move |change| heard.lock().expect("no panic").push(change)));
    old.apply_design(0.0);
    for t in 1..=2 {
        old.record(sticky(f64::from(t)));
    }
    assert_eq!(old.alarm(&stiction(), 3.0).expect("A is there").state, State::SuppressedByDesign);
    let kept = std::mem::take(&mut *changes.lock().expect("no panic"));
    let kept = || {
        let all = kept.iter().flat_map(|change| &change.alarms).map(|own| (own.id.clone(), own.clone()));
        let last: std::collections::BTreeMap<AlarmId, KeptAlarm> = all.collect();
        let restored = |own: KeptAlarm| {
            let KeptAlarm { id, saved, by, comment, detail, .. } = own;
            RestoredAlarm { id, saved, by, comment, detail }
        };
        last.into_values().map(restored).collect::<Vec<_>>()
    };
    let of = |results: &Results, id: &AlarmId| results.alarm(id, 5.0).expect("A is there").state;
    let (restarted, without) = (results(9), results(9));
    restarted.restore_alarms(kept(), Vec::new());
    restarted.apply_design(4.0);
    without.merge_alarms(kept(), 4.0);
    for new in [&restarted, &without] {
        assert_eq!(of(new, &stiction()), State::Unacknowledged);
        // What follows from a collector that was down is for the next look at it to say.
        assert_eq!(of(new, &bad), State::SuppressedByDesign);
        let tags = TagsSeen { id: id(), bad: None, devices: Vec::new() };
        new.watch(Vec::new(), vec![tags], 5.0);
        assert_eq!(of(new, &bad), State::Normal);
    }
    let same = Results::new(&[id()], 9, &design);
    same.restore_alarms(kept(), Vec::new());
    same.apply_design(4.0);
    assert_eq!(of(&same, &stiction()), State::SuppressedByDesign);
}

#[test]
fn operators_act_and_a_shelving_that_runs_out_is_told() {
    let results = results(3);
    let said = || Said { by: Some("kim".into()), comment: None };
    let act = |action, now| results.act(&stiction(), action, said(), now).expect("A is there");
    assert!(act(Action::Acknowledge, 0.0).is_err());
    results.record(sticky(1.0));
    results.record(sticky(2.0));
    let seen = act(Action::Acknowledge, 3.0).expect("it waits for that");
    assert_eq!((seen.state, seen.by.as_deref()), (State::Acknowledged, Some("kim")));
    act(Action::Shelve(Shelving::For(10.0)), 4.0).expect("a sound duration");
    let mut events = results.subscribe();
    results.tick(13.9);
    assert!(events.try_recv().is_err());
    // A shelving that has run out needs no end by hand, and nobody is said to have ended it.
    assert_eq!(act(Action::Unshelve, 14.0).expect("ended").state, State::Unacknowledged);
    assert!(
        matches!(events.try_recv(), Ok(Event::Alarm(c)) if c.transition.cause == alarm::Cause::Expired && c.by.is_none())
    );
    assert_eq!(results.alarms(15.0)[0].state, State::Unacknowledged);
    assert!(results.act(&AlarmId::named("C"), Action::Unshelve, said(), 0.0).is_none());
}

#[test]
fn a_reload_keeps_known_loops_and_forgets_the_others() {
    let results = results(3);
    results.record(sticky(1.0));
    results.record(sticky(2.0));
    results.reload(&[id(), LoopId::new("C")], &alarm::Config::default(), 3.0);
    let names: Vec<String> = results.alarms(3.0).iter().map(|view| view.id.to_string()).collect();
    assert_eq!(names, ["A/stiction", "A/f_rising", "C/stiction"]);
    assert_eq!(results.get(&id(), 3.0).expect("kept").alarm.state, State::Unacknowledged);
    assert!(results.get(&LoopId::new("B"), 3.0).is_none());
    let late = Run { id: LoopId::new("B"), ..sticky(4.0) };
    results.record(late);
    assert_eq!(results.coverage(), (1, 2));
}

#[test]
fn a_term_in_force_hides_the_friction_and_clears_no_alarm() {
    let results = results(3);
    let moved = |to| gate::News {
        at: 0.0,
        event: gate::Event::Moved { from: gate::State::Armed, to, cause: gate::Cause::Opened, by: None },
        tripped_by: None,
    };
    let clean = |time| run(time, Outcome::Diagnosed(diagnosis(Verdict::NoStiction, 0.0, -2.0)));
    let alarm = |now| results.get(&id(), now).expect("A is there").alarm.active;
    (1..3).for_each(|k| drop(results.record(sticky(f64::from(k)))));
    results.tell_writeback(&id(), &moved(gate::State::Active));
    (3..13).for_each(|k| drop(results.record(clean(f64::from(k)))));
    assert!(alarm(13.0));
    results.tell_writeback(&id(), &moved(gate::State::Shadow));
    (13..16).for_each(|k| drop(results.record(clean(f64::from(k)))));
    assert!(!alarm(16.0), "the alarm never clears");
}

/// What is kept of one, given to another, makes the same of everything that comes.
#[test]
fn what_is_kept_and_given_back_goes_on_as_if_nothing_had_been() {
    let (old, new) = (results(3), results(3));
    let kept: Arc<Mutex<Vec<Change>>> = Arc::default();
    let heard = kept.clone();
    old.keep_with(Arc::new(move |change| heard.lock().expect("whole").push(change)));
    old.record(sticky(1.0));
    old.record(sticky(2.0));
    old.record(run(3.0, Outcome::DeadlineExceeded));
    let seen = Said { by: Some("kim".into()), comment: Some("seen".into()) };
    let eve = || Said { by: Some("eve".into()), comment: None };
    old.act(&stiction(), Action::Acknowledge, seen, 4.0);
    old.act(&stiction(), Action::Shelve(Shelving::For(10.0)), eve(), 5.0);
    old.act(&stiction(), Action::Shelve(Shelving::For(20.0)), eve(), 6.0);
    let kept = std::mem::take(&mut *kept.lock().expect("whole"));
    let of = |c: &Change| c.alarms.iter().find(|own| own.id == stiction()).cloned();
    let said: Vec<_> = kept
        .iter()
        .map(|c| (c.run.is_some(), of(c).map_or(0, |a| a.transitions.len()), of(c).is_some_and(|a| a.acted)))
        .collect();
    let expected = [
        (true, 0, false),
        (true, 1, false),
        (true, 0, false),
        (false, 1, true),
        (false, 1, true),
        (false, 1, true),
    ];
    assert_eq!(said, expected, "a shelving that was only prolonged is kept and told too");
    assert_eq!(kept[0].model.as_ref().map(|(_, model)| model.version), Some(1));
    let summary = kept[1].run.as_ref().expect("a run").1.clone();
    let (quality, report) = ("good".into(), "{}".into());
    let restored = Restored {
        finished: 2.0,
        took_s: 0.02,
        quality,
        doubtful: false,
        structure: None,
        source: None,
        report,
    };
    let remembered = Remembered {
        summaries: kept.iter().filter_map(|c| Some(c.run.as_ref()?.1.clone())).collect(),
        diagnosed: Some((restored, summary.clone())),
        before: summary.before(),
        fitted_until: None,
        model: kept[0].model.clone().expect("new").1,
    };
    new.restore(&id(), remembered.clone());
    // Of each alarm what was kept last.
    let latest: std::collections::BTreeMap<AlarmId, KeptAlarm> =
        kept.iter().flat_map(|c| &c.alarms).map(|own| (own.id.clone(), own.clone())).collect();
    let restored = |own: KeptAlarm| {
        let KeptAlarm { id, saved, by, comment, detail, .. } = own;
        RestoredAlarm { id, saved, by, comment, detail }
    };
    assert_eq!(latest.len(), 3, "stiction, f rising, not identifiable");
    new.restore_alarms(
        latest.into_values().map(restored).collect(),
        old.alarm_log().iter().rev().map(|change| (**change).clone()).collect(),
    );
    let unnumbered = |results: &Results| -> Vec<AlarmChange> {
        results.alarm_log().iter().map(|change| AlarmChange { number: 0, ..(**change).clone() }).collect()
    };
    assert_eq!(unnumbered(&old), unnumbered(&new));
    let (a, b) = (old.get(&id(), 7.0).expect("A"), new.get(&id(), 7.0).expect("A"));
    assert_eq!((a.alarm, a.last, a.summary, a.model), (b.alarm, b.last, b.summary, b.model));
    assert_eq!(old.summaries(&id()), new.summaries(&id()));
    assert!(b.diagnosed.is_none() && b.restored.is_some(), "a diagnosis of before is marked as such");
    // The shelving runs out, the condition still holds, and the next run takes the place of what was restored.
    for results in [&old, &new] {
        assert_eq!(results.get(&id(), 30.0).expect("A").alarm.state, State::Unacknowledged);
        results.record(sticky(31.0));
        let known = results.get(&id(), 32.0).expect("A");
        assert!(known.diagnosed.is_some() && known.restored.is_none());
    }
    new.restore(&id(), remembered);
    assert_eq!(
        new.get(&id(), 33.0).expect("A").last.map(|last| last.time),
        Some(31.0),
        "never over what is newer"
    );
}

fn seen(down: Option<Option<&str>>, bad: Option<&str>) -> (Vec<DeviceSeen>, Vec<TagsSeen>) {
    let down = down.map(|why| why.map(str::to_string));
    let devices = vec![DeviceSeen { name: LoopId::new("dcs"), down }];
    let tags = TagsSeen { id: id(), bad: bad.map(str::to_string), devices: vec![LoopId::new("dcs")] };
    (devices, vec![tags])
}

fn state(results: &Results, name: &str, now: f64) -> State {
    results.alarm(&AlarmId::named(name), now).expect("there is such an alarm").state
}

#[test]
fn a_collector_that_is_down_is_one_alarm_and_its_tags_say_nothing() {
    let results = results(3);
    results.watch_devices(&[LoopId::new("dcs")], 0.0);
    let watch = |down, bad, now| {
        let (devices, loops) = seen(down, bad);
        results.watch(devices, loops, now);
    };
    // A tag alone is bad for five minutes.
    watch(Some(None), Some("PV: no number"), 0.0);
    watch(Some(None), Some("PV: no number"), 300.0);
    assert_eq!(state(&results, "A/tag_bad", 300.0), State::Unacknowledged);
    watch(Some(None), None, 301.0);
    assert_eq!(state(&results, "A/tag_bad", 301.0), State::ReturnedUnacknowledged);
    // Then the whole collector is gone, for long.
    for at in [1000.0, 1300.0, 2000.0] {
        watch(Some(Some("no good sample for 120 s")), Some("PV: no connection"), at);
    }
    assert_eq!(state(&results, "dcs/collector_down", 2000.0), State::Unacknowledged);
    assert_eq!(state(&results, "A/tag_bad", 2000.0), State::SuppressedByDesign);
    let known = results.get(&id(), 2000.0).expect("A");
    assert_eq!(known.others.len(), 2, "{:?}", known.others);
    // Nobody knows yet, as after a restart: nothing changes.
    watch(None, Some("PV: no connection"), 2100.0);
    assert_eq!(state(&results, "dcs/collector_down", 2100.0), State::Unacknowledged);
    // It is back. What its tags were like meanwhile raises nothing, what they are like from now on does.
    watch(Some(None), Some("PV: no connection"), 2200.0);
    assert_eq!(state(&results, "dcs/collector_down", 2200.0), State::ReturnedUnacknowledged);
    assert_eq!(state(&results, "A/tag_bad", 2200.0), State::Normal);
    watch(Some(None), Some("PV: no number"), 2500.0);
    assert_eq!(state(&results, "A/tag_bad", 2500.0), State::Unacknowledged);
    assert!(results.alarm(&AlarmId::named("A/collector_down"), 0.0).is_none());
    assert!(results.alarm(&AlarmId::named("dcs/tag_bad"), 0.0).is_none());
}

#[test]
fn a_loop_that_nothing_can_be_said_of_for_a_week_is_told_and_one_in_manual_is_not() {
    let day = 86_400.0;
    let not = |why: NotIdentifiable, at| {
        run(at, Outcome::Diagnosed(diagnosis(Verdict::NotIdentifiable(why), 0.0, 0.0)))
    };
    for (why, expected) in [
        (NotIdentifiable::Gaps { share: 0.5 }, State::Unacknowledged),
        (NotIdentifiable::Manual { share_auto: 0.0 }, State::Normal),
        (NotIdentifiable::NotExcited { reversals: 1 }, State::Normal),
    ] {
        let results = results(3);
        (0..8).for_each(|at| drop(results.record(not(why.clone(), f64::from(at) * day))));
        assert_eq!(state(&results, "A/not_identifiable", 8.0 * day), expected, "{why}");
        results.record(sticky(9.0 * day));
        assert_ne!(state(&results, "A/not_identifiable", 9.0 * day), State::Unacknowledged);
    }
}

#[test]
fn a_trip_is_latched_and_a_flood_is_grouped() {
    let ids: Vec<LoopId> = (0..20).map(|at| LoopId::new(format!("L{at}"))).collect();
    let results = Results::new(&ids, 3, &alarm::Config::default());
    // What tripped it closed it; the move to tripped comes later, once the term is at zero.
    let moved = |from, to, cause, tripped_by, at| {
        let event = gate::Event::Moved { from, to, cause, by: None };
        results.tell_writeback(&ids[0], &gate::News { at, event, tripped_by });
    };
    let by = gate::Denial::NotAutomatic;
    moved(gate::State::Active, gate::State::Withdrawing, gate::Cause::Denied(by), None, 0.5);
    moved(gate::State::Withdrawing, gate::State::Tripped, gate::Cause::AtZero, Some(by), 1.0);
    moved(gate::State::Tripped, gate::State::Shadow, gate::Cause::Reset, None, 2.0);
    let trip = results.alarm(&AlarmId::named("L0/compensation_tripped"), 2.0).expect("L0");
    assert_eq!((trip.state, trip.priority), (State::LatchedUnacknowledged, Priority::High));
    assert_eq!(trip.detail, "write-back was closed by a fault: the loop is not in automatic");
    let mut events = results.subscribe();
    for id in &ids {
        let loops = |bad: &str| vec![TagsSeen { id: id.clone(), bad: Some(bad.into()), devices: vec![] }];
        results.watch(vec![], loops("PV: no number"), 10.0);
        results.watch(vec![], loops("PV: no number"), 310.0);
    }
    // One has been raised before; ten in ten minutes are no flood, the eleventh and what comes after it is.
    let grouped = results.alarms(310.0).iter().filter(|view| view.grouped).count();
    assert_eq!((grouped, results.flood(310.0).grouped), (11, 11));
    let mut told = 0;
    while let Ok(Event::Alarm(change)) = events.try_recv() {
        told += usize::from(change.grouped);
    }
    assert_eq!(told, 11, "all are told, and which are grouped");
    assert_eq!(results.flood(1000.0).since, None);
    assert!(results.alarms(1000.0).iter().all(|view| !view.grouped && view.state != State::Shelved));
}

/// Numbers follow what happened: of one alarm every change begins where the one before it ended, whoever made it.
#[test]
fn changes_made_by_two_at_once_are_numbered_and_told_in_the_order_they_happened() {
    for _ in 0..20 {
        let (results, begin) = (results(3), std::sync::Barrier::new(2));
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    begin.wait();
                    // What comes too late is refused. No more than are remembered, so that none is missed.
                    for _ in 0..events::MOST_EVENTS / 4 {
                        for action in [Action::TakeOut, Action::GiveBack] {
                            results.act(&stiction(), action, Said::default(), 1.0);
                        }
                    }
                });
            }
        });
        let mut log = results.alarm_log();
        log.reverse();
        let past = results.events_after(0, events::MOST_EVENTS).expect("they were told");
        let told = past.events.iter().filter_map(|(_, event)| match event {
            Event::Alarm(change) => Some(change.number),
            _ => None,
        });
        let first = log[0].number;
        assert!(
            log.len() > 1 && told.eq(first..first + log.len() as u64),
            "told in the order of their numbers"
        );
        for pair in log.windows(2) {
            assert_eq!(pair[0].transition.to, pair[1].transition.from, "{pair:?}");
        }
    }
}
