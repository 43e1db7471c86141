//! What is a change to those who are told.

use super::*;

/// Diagnosed as sticking by f (OP units of a span of 50).
fn stuck(results: &Results, loop_id: &LoopId, f: f64, time: f64) {
    let outcome = Outcome::Diagnosed(diagnosis(Verdict::Stiction, f, 400.0));
    results.record(Run { id: loop_id.clone(), ..run(time, outcome) });
}

/// Alarms that changed, oldest first: which, from, to, why and how urgent.
fn changes(results: &Results, kind: Kind) -> Vec<(State, State, alarm::Cause, Priority)> {
    let log = results.alarm_log().into_iter().rev().filter(|change| change.id.kind == kind);
    log.map(|own| (own.transition.from, own.transition.to, own.transition.cause, own.priority)).collect()
}

#[test]
fn an_alarm_that_becomes_more_urgent_while_it_stands_is_told_once() {
    use State::{Acknowledged, Normal, Unacknowledged};
    use alarm::Cause::{MoreUrgent, Raised};
    let (results, kept) = (results(9), Arc::new(Mutex::new(Vec::new())));
    let keeper = kept.clone();
    results.keep_with(Arc::new(move |change| keeper.lock().expect("no panic").extend(change.alarms)));
    for (time, f) in [(1.0, 0.1), (2.0, 0.1)] {
        stuck(&results, &id(), f, time);
    }
    results
        .act(&stiction(), Action::Acknowledge, Said::default(), 3.0)
        .expect("A")
        .expect("it waits for that");
    for (time, f) in [(4.0, 1.5), (5.0, 1.5), (6.0, 0.1)] {
        stuck(&results, &id(), f, time);
    }
    assert_eq!(
        changes(&results, Kind::Stiction),
        [
            (Normal, Unacknowledged, Raised, Priority::Low),
            (Unacknowledged, Acknowledged, alarm::Cause::Acknowledged, Priority::Low),
            (Acknowledged, Acknowledged, MoreUrgent, Priority::High),
        ]
    );
    let view = results.alarm(&stiction(), 7.0).expect("A is there");
    assert_eq!((view.state, view.priority, view.since), (Acknowledged, Priority::High, Some(3.0)));
    let kept = kept.lock().expect("no panic");
    let risen =
        kept.iter().find(|own: &&KeptAlarm| own.transitions.iter().any(|own| own.cause == MoreUrgent));
    assert_eq!(risen.and_then(|own| own.saved.priority), Some(Priority::High));
}

#[test]
fn what_was_grouped_and_becomes_urgent_is_grouped_no_more() {
    let config = alarm::Config { flood_raises: 1, ..alarm::Config::default() };
    let results = Results::new(&[LoopId::new("A"), LoopId::new("B")], 9, &config);
    for name in ["B", "A"] {
        stuck(&results, &LoopId::new(name), 0.1, 1.0);
        stuck(&results, &LoopId::new(name), 0.1, 2.0);
    }
    assert!(results.alarm(&stiction(), 3.0).expect("A is there").grouped);
    stuck(&results, &id(), 1.5, 3.0);
    assert!(!results.alarm(&stiction(), 4.0).expect("A is there").grouped);
    assert!(!results.alarm_log()[0].grouped);
    assert_eq!(results.flood(4.0).recent, 2, "it was raised once");
}

#[test]
fn what_a_reload_takes_out_stands_no_longer_and_everybody_hears_it() {
    let (results, kept) = (results(9), Arc::new(Mutex::new(Vec::new())));
    let keeper = kept.clone();
    results.keep_with(Arc::new(move |change| keeper.lock().expect("no panic").extend(change.alarms)));
    let (a, b, device) = (id(), LoopId::new("B"), LoopId::new("dcs"));
    results.watch_devices(std::slice::from_ref(&device), 0.0);
    for time in [1.0, 2.0] {
        stuck(&results, &a, 1.5, time);
        stuck(&results, &b, 1.5, time);
    }
    for now in [3.0, 603.0] {
        let down = DeviceSeen { name: device.clone(), down: Some(Some("silent".into())) };
        let bad = TagsSeen { id: id(), bad: Some("PV: no number".into()), devices: Vec::new() };
        results.watch(vec![down], vec![bad], now);
    }
    let mut events = results.subscribe();
    // A loop, a kind and a collector are taken out.
    let config = alarm::Config::default();
    results.reload(std::slice::from_ref(&a), &config, 700.0);
    let tag_bad = alarm::TagBadConfig { enabled: false, ..config.tag_bad.clone() };
    results.reload(std::slice::from_ref(&a), &alarm::Config { tag_bad, ..config }, 701.0);
    results.watch_devices(&[], 702.0);
    let mut over = Vec::new();
    while let Ok(event) = events.try_recv() {
        if let Event::Alarm(change) = event {
            let alarm::Transition { from, to, at, cause } = change.transition;
            over.push((change.id.to_string(), from, to, at, cause));
        }
    }
    let (from, to, cause) = (State::Unacknowledged, State::Normal, alarm::Cause::Forgotten);
    assert_eq!(
        over,
        [
            ("B/stiction".to_string(), from, to, 700.0, cause),
            ("A/tag_bad".to_string(), from, to, 701.0, cause),
            ("dcs/collector_down".to_string(), from, to, 702.0, cause),
        ]
    );
    // It is kept as over, so that it is raised anew when it is there again.
    let kept = kept.lock().expect("no panic");
    let last = kept.iter().rev().find(|own: &&KeptAlarm| own.id.subject == b).expect("kept");
    assert!(!last.saved.flags.active && last.saved.votes.is_empty());
    assert_eq!(state(&results, "A/stiction", 703.0), State::Unacknowledged);
}

/// As where a loop gets another name.
#[test]
fn a_latched_alarm_that_nobody_acknowledged_does_not_go_without_a_word() {
    let config = alarm::Config { latch: vec![Kind::Stiction], ..alarm::Config::default() };
    let results = Results::new(&[id()], 9, &config);
    for time in [1.0, 2.0] {
        stuck(&results, &id(), 1.5, time);
    }
    for time in 3..13 {
        let clean = Outcome::Diagnosed(diagnosis(Verdict::NoStiction, 0.0, -2.0));
        results.record(run(f64::from(time), clean));
    }
    assert_eq!(state(&results, "A/stiction", 13.0), State::LatchedUnacknowledged);
    let mut events = results.subscribe();
    results.reload(&[LoopId::new("A2")], &config, 20.0);
    let (from, to, cause) = (State::LatchedUnacknowledged, State::Normal, alarm::Cause::Forgotten);
    let over = alarm::Transition { from, to, at: 20.0, cause };
    let last = results.alarm_log()[0].clone();
    assert_eq!((&last.id, last.transition), (&stiction(), over));
    let told = std::iter::from_fn(|| events.try_recv().ok());
    let told: Vec<_> =
        told.filter_map(|own| if let Event::Alarm(own) = own { Some(own) } else { None }).collect();
    assert_eq!(told, [last]);
    assert_eq!(state(&results, "A2/stiction", 21.0), State::Normal);
}

/// A daemon that was stopped, started without the loop, and given it back by a reload.
#[test]
fn an_alarm_that_was_kept_of_a_loop_that_nobody_watched_is_over_when_the_loop_is_back() {
    let (config, b) = (alarm::Config::default(), LoopId::new("B"));
    let results = Results::new(&[id()], 9, &config);
    results.reload(&[id(), b.clone()], &config, 10.0);
    let kept = |name: &str, flags, pending| {
        let saved = alarm::Saved { flags, pending, ..alarm::Saved::default() };
        RestoredAlarm { id: AlarmId::named(name), saved, by: None, comment: None, detail: String::new() }
    };
    let stands = alarm::Flags { active: true, ..alarm::Flags::default() };
    let shelved = alarm::Flags { shelved_until: Some(1e6), ..stands };
    let all = vec![
        kept("A/tag_bad", stands, None),
        kept("B/stiction", stands, None),
        kept("B/tag_bad", shelved, None),
        kept("B/not_identifiable", alarm::Flags::default(), Some(1.0)),
    ];
    results.restore_alarms(all, Vec::new());
    results.begin_anew((&[id()], &[]), &config, 11.0);
    let told: Vec<(String, State, alarm::Cause)> = results
        .alarm_log()
        .iter()
        .map(|own| (own.id.to_string(), own.transition.to, own.transition.cause))
        .collect();
    assert_eq!(told, [("B/stiction".to_string(), State::Normal, alarm::Cause::Forgotten)]);
    assert_eq!(state(&results, "A/tag_bad", 12.0), State::Acknowledged, "it was watched all the time");
    assert_eq!(state(&results, "B/tag_bad", 12.0), State::Shelved, "that stays, as with any restart");
    // What did not hold before the loop was there does not hold for a week at its first diagnosis.
    let why = Verdict::NotIdentifiable(NotIdentifiable::Gaps { share: 0.5 });
    let late = run(700_000.0, Outcome::Diagnosed(diagnosis(why, 0.0, 0.0)));
    results.record(Run { id: b, ..late });
    assert_eq!(state(&results, "B/not_identifiable", 700_000.0), State::Normal);
}
