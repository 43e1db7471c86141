//! Diagnoses and alarms that are other machines'.

use super::*;
use crate::results::{Said, Told, Wanted};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// What another machine says of the run that `of` is.
fn elsewhere(of: &Run) -> Run {
    let told = Told {
        summary: of.summary(),
        report: Some("{}".into()),
        quality: "good".into(),
        doubtful: false,
        fitted_until: None,
        effects: vec![(crate::residual::Kind::Drift, None)],
        structure: None,
        unexplained: None,
        version: "0.1.0".into(),
    };
    Run { outcome: Outcome::Elsewhere(Box::new(told)), ..of.clone() }
}

#[test]
fn a_diagnosis_of_another_machine_is_to_alarms_and_people_what_our_own_is() {
    let (own, other) = (results(9), results(9));
    for time in [1.0, 2.0, 3.0] {
        own.record(sticky(time));
        other.record(elsewhere(&sticky(time)));
    }
    let state = |results: &Results| results.alarm(&stiction(), 4.0).map(|alarm| (alarm.state, alarm.detail));
    assert_eq!(state(&other), state(&own));
    assert_eq!(state(&other).map(|(state, _)| state), Some(State::Unacknowledged));
    let known = other.get(&id(), 4.0).expect("A is there");
    assert!(known.diagnosed.is_none());
    assert_eq!(known.restored.map(|restored| restored.finished), Some(3.0));
    assert_eq!(known.summary, own.get(&id(), 4.0).expect("A is there").summary);
    assert_eq!(other.effects(&id()), [(crate::residual::Kind::Drift, None)]);
    assert_eq!(other.before(&id()).map(|before| before.f), Some(2.0));
}

#[test]
fn what_another_machine_has_recorded_is_taken_once_and_moves_no_alarm() {
    let results = results(9);
    for time in [1.0, 2.0, 3.0] {
        assert!(results.learn(elsewhere(&sticky(time)), None, 4.0));
    }
    assert!(!results.learn(elsewhere(&sticky(2.0)), None, 4.0), "it is known");
    assert_eq!(results.summaries(&id()).map(|all| all.len()), Some(3));
    assert_eq!(results.alarm(&stiction(), 4.0).map(|alarm| alarm.state), Some(State::Normal));
}

#[test]
fn a_glance_is_what_the_whole_says_of_a_loop_alarms_shelved_and_gone_and_loops_elsewhere_included() {
    let names = ["A", "B", "nowhere"].map(LoopId::new);
    let results = results(9);
    let check = |now: f64, verdict: Option<&str>, state: State| {
        let seen = results.glances(&names, now);
        for (id, seen) in names.iter().zip(&seen) {
            let known = results.get(id, now);
            assert_eq!(seen.as_ref().map(|seen| seen.alarm), known.as_ref().map(|known| known.alarm.state));
            let summary = known.and_then(|known| known.summary);
            let told = seen
                .as_ref()
                .and_then(|seen| Some((seen.verdict.clone()?, seen.f, seen.delta_aic, seen.time)));
            assert_eq!(told, summary.map(|own| (own.outcome, own.f, own.delta_aic, Some(own.time))));
        }
        let first = seen[0].as_ref().expect("A is there");
        assert_eq!((first.verdict.as_deref(), first.alarm), (verdict, state));
    };
    check(0.0, None, State::Normal);
    for time in [1.0, 2.0] {
        results.record(sticky(time));
    }
    check(3.0, Some("stiction"), State::Unacknowledged);
    let shelve = Action::Shelve(Shelving::For(10.0));
    results.act(&stiction(), shelve, Said::default(), 4.0).expect("A is there").expect("a sound duration");
    check(13.0, Some("stiction"), State::Shelved);
    check(14.0, Some("stiction"), State::Unacknowledged);
    results.record(run(15.0, Outcome::DeadlineExceeded));
    check(16.0, Some("stiction"), State::Unacknowledged);
    results.record(elsewhere(&run(17.0, Outcome::Diagnosed(diagnosis(Verdict::NoStiction, 0.0, 1.0)))));
    check(18.0, Some("no_stiction"), State::Unacknowledged);
}

/// The board of a machine that follows another, and what is wanted of it.
fn follower(passes_on: bool) -> (Results, Arc<Mutex<Vec<Wanted>>>, Arc<AtomicBool>) {
    let (results, wanted) = (results(9), Arc::new(Mutex::new(Vec::new())));
    let (told, may) = (wanted.clone(), Arc::new(AtomicBool::new(passes_on)));
    let passes = may.clone();
    results.follow_others(Arc::new(move |own| {
        let passes = passes.load(Relaxed);
        if passes {
            told.lock().expect("no panic").push(own);
        }
        passes
    }));
    (results, wanted, may)
}

#[test]
fn alarms_of_another_machine_change_by_what_it_says_and_by_nothing_else() {
    let (edge, (centre, wanted, may)) = (results(9), follower(true));
    let kept = Arc::new(Mutex::new(Vec::new()));
    let seen = kept.clone();
    edge.keep_with(Arc::new(move |change: Change| seen.lock().expect("no panic").extend(change.alarms)));
    (1..4).for_each(|time| drop(edge.record(sticky(f64::from(time)))));
    let log = edge.alarm_log();
    let raised = log.iter().find(|change| change.id == stiction()).expect("raised");
    let last =
        kept.lock().expect("no panic").iter().rev().find(|own: &&KeptAlarm| own.id == stiction()).cloned();
    let last = last.expect("kept");
    let standing =
        RestoredAlarm { id: last.id, saved: last.saved, by: None, comment: None, detail: last.detail };
    // Whatever comes of its own diagnoses, tags and time.
    centre.record(sticky(1.0));
    centre.record(sticky(2.0));
    centre.tick(9.0);
    assert_eq!(centre.alarm(&stiction(), 9.0).map(|alarm| alarm.state), Some(State::Normal));

    centre.follow_alarm(standing.clone(), Some((**raised).clone()), 9.0);
    assert_eq!(centre.alarm_log()[0].transition, raised.transition);
    centre.follow_alarm(standing, Some((**raised).clone()), 9.0);
    let state = || centre.alarm(&stiction(), 9.0).map(|alarm| alarm.state);
    assert_eq!(state(), Some(State::Unacknowledged));
    assert_eq!(centre.alarm_log().len(), 1, "it happened once");

    // What people want is passed on, and done by the other machine alone.
    let eve = Said { by: Some("eve".into()), comment: None };
    let done = centre.act(&stiction(), Action::Acknowledge, eve.clone(), 10.0);
    assert!(matches!(done, Some(Ok(_))));
    assert_eq!(state(), Some(State::Unacknowledged));
    let orders = wanted.lock().expect("no panic").clone();
    assert_eq!(orders.len(), 1);
    assert_eq!((orders[0].action, &orders[0].said, orders[0].at), (Action::Acknowledge, &eve, 10.0));
    assert_eq!(orders[0].raised_at, edge.alarm(&stiction(), 9.0).and_then(|alarm| alarm.raised_at));
    // What cannot be is refused, and so is what cannot be passed on.
    assert!(matches!(centre.act(&stiction(), Action::Unshelve, eve.clone(), 11.0), Some(Err(_))));
    may.store(false, Relaxed);
    let refused = centre.act(&stiction(), Action::Acknowledge, eve, 12.0);
    assert_eq!(refused, Some(Err(crate::alarm::Refusal::NotLeading)));
    assert_eq!(wanted.lock().expect("no panic").len(), 1);
}

#[test]
fn a_run_after_a_clock_was_set_back_is_the_latest_though_one_before_is_stamped_later() {
    let results = results(9);
    let shown = |now| results.get(&id(), now).and_then(|known| known.summary).map(|summary| summary.time);
    assert!(results.learn(elsewhere(&sticky(9000.0)), None, 9000.0));
    assert!(results.learn(elsewhere(&sticky(8000.0)), None, 9001.0));
    assert_eq!(shown(9001.0), Some(9000.0), "that one only came late");
    assert!(results.learn(elsewhere(&sticky(5000.0)), None, 5001.0));
    assert_eq!(shown(5001.0), Some(5000.0));
}

#[test]
fn runs_that_come_once_more_after_years_do_not_take_the_place_of_the_latest() {
    let results = results(3);
    let shown = || {
        let known = results.get(&id(), 9000.0).expect("A is there");
        (known.summary.map(|own| own.time), known.last.map(|own| own.time))
    };
    let times =
        || -> Vec<f64> { results.summaries(&id()).unwrap_or_default().iter().map(|own| own.time).collect() };
    let learn = |time: f64| results.learn(elsewhere(&sticky(time)), None, 9000.0);
    assert!([1001.0, 1003.0, 1004.0].into_iter().all(learn));
    // The stream was made anew, and its edge sends all that it ever found.
    assert!((1..=20).map(f64::from).all(learn), "they may not be in the store");
    assert_eq!((times(), shown()), (vec![1001.0, 1003.0, 1004.0], (Some(1004.0), Some(1004.0))));
    // One that was missing comes to its place, and a new one behind them.
    assert!(learn(1002.0));
    assert_eq!((times(), shown().0), (vec![1002.0, 1003.0, 1004.0], Some(1004.0)));
    assert!(!learn(1003.0) && learn(1005.0));
    assert_eq!((times(), shown().0), (vec![1003.0, 1004.0, 1005.0], Some(1005.0)));
}

#[test]
fn a_flood_of_all_machines_together_is_grouped() {
    let (results, ..) = follower(true);
    let most = alarm::Config::default().flood_raises;
    let raised = |at: f64| {
        let flags = alarm::Flags { active: true, acknowledged: false, ..alarm::Flags::default() };
        let saved = alarm::Saved { flags, ..alarm::Saved::default() };
        let kept = RestoredAlarm { id: stiction(), saved, by: None, comment: None, detail: String::new() };
        let (from, to) = (State::Normal, State::Unacknowledged);
        let change = AlarmChange {
            number: 0,
            id: stiction(),
            transition: alarm::Transition { from, to, at, cause: alarm::Cause::Raised },
            priority: Priority::Low,
            grouped: false,
            detail: String::new(),
            by: None,
            comment: None,
            told: false,
        };
        (kept, change)
    };
    let hear = |at: f64, now: f64| {
        let (kept, change) = raised(at);
        results.follow_alarm(kept, Some(change.clone()), now);
        results.is_grouped(&stiction(), &change.transition)
    };
    let now = 10.0 * NEWS_S;
    // What comes late, from however many machines whose clocks differ, is a flood now; what is history is none.
    assert!((0..2 * most).all(|k| !hear(k as f64, now)));
    assert!((0..most).all(|k| !hear(now - 3600.0 - k as f64, now)));
    assert!(hear(now - 7200.0, now) && hear(now + 5.0, now + 1.0));
    let seen = results.flood(now + 1.0);
    assert_eq!((seen.since, seen.grouped, seen.recent), (Some(now), 2, most + 2));
    assert!(results.alarm(&stiction(), now).expect("A").grouped);
    results.tick(now + 86_400.0);
    assert!(!results.alarm(&stiction(), now).expect("A").grouped, "it is over");
}

/// It may be known that a loop is gone before it is heard how its alarm ended.
#[test]
fn an_alarm_of_a_loop_that_another_machine_has_no_more_ends_in_the_history_once() {
    let (centre, ..) = follower(true);
    let heard = |id: AlarmId, flags: alarm::Flags, [from, to]: [State; 2], at: f64, cause: alarm::Cause| {
        let saved = alarm::Saved { flags, ..alarm::Saved::default() };
        let change = AlarmChange {
            number: 0,
            id: id.clone(),
            transition: alarm::Transition { from, to, at, cause },
            priority: Priority::Low,
            grouped: false,
            detail: String::new(),
            by: None,
            comment: None,
            told: false,
        };
        let kept = RestoredAlarm { id, saved, by: None, comment: None, detail: String::new() };
        centre.follow_alarm(kept, Some(change), at);
    };
    let (latched, over) = (
        alarm::Flags { latched: true, acknowledged: false, ..alarm::Flags::default() },
        alarm::Flags::default(),
    );
    let states = [State::Unacknowledged, State::LatchedUnacknowledged];
    heard(stiction(), latched, states, 9.0, alarm::Cause::Cleared);
    assert_eq!(centre.alarm(&stiction(), 9.0).map(|own| own.state), Some(State::LatchedUnacknowledged));
    let config = alarm::Config::default();
    let tag_bad = alarm::TagBadConfig { enabled: false, ..config.tag_bad.clone() };
    centre.reload(&[LoopId::new("B")], &alarm::Config { tag_bad, ..config }, 10.0);
    let states = [State::LatchedUnacknowledged, State::Normal];
    for id in [stiction(), stiction(), AlarmId::named("A/tag_bad")] {
        heard(id, over, states, 11.0, alarm::Cause::Forgotten);
    }
    let log: Vec<_> =
        centre.alarm_log().iter().map(|own| (own.id.to_string(), own.transition.cause)).collect();
    let expected =
        [alarm::Cause::Forgotten, alarm::Cause::Cleared].map(|cause| ("A/stiction".to_string(), cause));
    assert_eq!(log, expected);
}
