//! A loop whose OP or PV is read elsewhere: another valve by the same name.

use super::*;
use crate::signal::Role;

const DAY: f64 = 86_400.0;

/// The run as one on samples that were read there.
fn read_at(source: u64, of: Run) -> Run {
    let record = Record { source: Some(source), ..Record::default() };
    let basis = Basis::of(&record, &Settings::default(), None);
    Run { basis: Some(Arc::new(basis)), ..of }
}

/// A run by which the valve there sticks with this f (OP units of a span of 50), and what it finds may be taken as given.
fn stuck(source: u64, time: f64, f: f64) -> Run {
    let mut found = made_findings(Verdict::Stiction, Vec::new());
    found.structure = Some(Structure::default());
    (found.friction_after.f, found.friction_after.f_ci95) = (f, with_model_error(f, [f - 0.1, f + 0.1]));
    let mut judged = diagnosis(Verdict::Stiction, f, 400.0);
    judged.findings = Some(found);
    read_at(source, run(time, Outcome::Diagnosed(judged)))
}

fn clean(source: u64, time: f64) -> Run {
    read_at(source, run(time, Outcome::Diagnosed(diagnosis(Verdict::NoStiction, 0.0, -2.0))))
}

fn read_from(results: &Results, source: u64, now: f64) {
    results.read_from([(id(), source)], now);
}

/// Whether the next run is given a structure, and whether friction of before a term is known.
fn is_given(results: &Results) -> (bool, bool) {
    (results.structure(&id()).is_some(), results.before(&id()).is_some())
}

fn is_raised(results: &Results) -> bool {
    results.get(&id(), 0.0).expect("A is there").alarm.active
}

#[test]
fn what_speaks_for_the_valve_of_before_is_forgotten() {
    let results = results(20);
    read_from(&results, 1, 0.0);
    results.record(stuck(1, 1.0, 1.0));
    assert_eq!(is_given(&results), (true, true));
    // As after any other reload.
    read_from(&results, 1, 2.0);
    assert_eq!(is_given(&results), (true, true));
    read_from(&results, 2, 3.0);
    assert_eq!(is_given(&results), (false, false));
    // Two of three raise. One was of the valve of before, and so is a run that began before the reload.
    results.record(stuck(1, 4.0, 1.0));
    assert_eq!(is_given(&results), (false, false));
    results.record(stuck(2, 5.0, 1.0));
    assert_eq!((is_given(&results), is_raised(&results)), ((true, true), false));
    results.record(stuck(2, 6.0, 1.0));
    assert!(is_raised(&results));
    // Three of four clear, all of one valve.
    [7.0, 8.0].into_iter().for_each(|time| drop(results.record(clean(2, time))));
    read_from(&results, 3, 9.0);
    [10.0, 11.0].into_iter().for_each(|time| drop(results.record(clean(3, time))));
    assert!(is_raised(&results));
    results.record(clean(3, 12.0));
    assert!(!is_raised(&results));
}

#[test]
fn two_valves_are_no_friction_that_rises() {
    let results = results(3);
    read_from(&results, 1, 0.0);
    let days = |days: std::ops::Range<u32>, source: u64, f: &dyn Fn(f64) -> f64| {
        for day in days.map(f64::from) {
            results.record(stuck(source, DAY * day, f(day)));
        }
        state(&results, "A/f_rising", 0.0)
    };
    assert_eq!(days(0..15, 1, &|day| 1.0 + 0.3 * day), State::Unacknowledged);
    read_from(&results, 2, 14.5 * DAY);
    assert_eq!(state(&results, "A/f_rising", 0.0), State::ReturnedUnacknowledged);
    assert_eq!(results.alarm_log()[0].transition.cause, alarm::Cause::Cleared);
    // More than the valve of before ever had, and always the same.
    assert_eq!(days(15..30, 2, &|_| 9.0), State::ReturnedUnacknowledged);
}

/// A run while PV at that source is silent.
fn silent(source: u64, time: f64) -> Run {
    let why = NotIdentifiable::Silent { tag: Role::Pv, since: 0.0 };
    read_at(source, run(time, Outcome::Diagnosed(diagnosis(Verdict::NotIdentifiable(why), 0.0, 0.0))))
}

#[test]
fn a_source_that_is_silent_for_a_while_changes_nothing_of_what_was_found() {
    let results = results(3);
    let known = || results.get(&id(), 0.0).expect("A is there");
    let looked = |time: f64| {
        let mut of = stuck(1, time, 1.0);
        if let Outcome::Diagnosed(judged) = &mut of.outcome
            && let Some(found) = &mut judged.findings
        {
            found.effects = vec![made_effect(crate::residual::Kind::Drift, 0.9)];
        }
        results.record(of);
    };
    looked(1.0);
    let found = known();
    assert_eq!((found.model.version, found.model.effects.len(), found.looked_at), (1, 1, Some(1.0)));
    // More of them than are remembered.
    for time in 2..9 {
        results.record(silent(1, f64::from(time)));
        assert_eq!((known().model, known().looked_at), (found.model.clone(), Some(1.0)));
        assert_eq!(is_given(&results), (true, true), "{time}");
        assert_eq!(known().summary.map(|own| own.time), Some(f64::from(time)), "it is told all the same");
    }
    looked(9.0);
    assert_eq!((known().model.version, known().looked_at), (1, Some(9.0)));
    // After one that failed everything is searched for.
    results.record(run(10.0, Outcome::DeadlineExceeded));
    results.record(silent(1, 11.0));
    assert_eq!((is_given(&results).0, known().looked_at), (false, Some(9.0)));
}

#[test]
fn of_a_loop_that_was_silent_from_the_first_that_is_how_old_it_is() {
    let (results, other) = (results(3), results(3));
    (1..9).for_each(|time| drop(results.record(silent(1, f64::from(time)))));
    let of = |results: &Results| results.get(&id(), 0.0).expect("A is there").looked_at;
    assert_eq!(of(&results), Some(1.0));
    // What is left of them after a restart.
    let summaries = results.summaries(&id()).expect("A is there");
    other.restore(&id(), Remembered { summaries, ..Remembered::default() });
    other.record(silent(1, 9.0));
    assert_eq!(of(&other), Some(6.0));
}

/// What a store has of one diagnosis on samples that were read at 1: it stuck, which is one vote.
fn kept() -> (Remembered, RestoredAlarm) {
    let summary = stuck(1, 1.0, 1.0).summary();
    let restored = Restored {
        finished: 1.0,
        took_s: 0.02,
        quality: "good".into(),
        doubtful: false,
        structure: Some(Structure::default()),
        source: Some(1),
        report: "{}".into(),
    };
    let remembered = Remembered {
        summaries: vec![summary.clone()],
        before: summary.before(),
        diagnosed: Some((restored, summary)),
        ..Remembered::default()
    };
    let saved = alarm::Saved { votes: vec![alarm::Observation::Present], ..alarm::Saved::default() };
    (remembered, RestoredAlarm { id: stiction(), saved, by: None, comment: None, detail: String::new() })
}

#[test]
fn what_a_store_gives_back_of_another_valve_is_shown_and_no_more() {
    for (source, is_own) in [(1, true), (2, false)] {
        let (remembered, alarm) = kept();
        let results = results(9);
        results.restore_alarms(vec![alarm], Vec::new());
        assert!(results.restore(&id(), remembered));
        read_from(&results, source, 2.0);
        assert_eq!(is_given(&results), (is_own, is_own));
        assert_eq!(results.summaries(&id()).map(|all| all.len()), Some(1));
        results.record(stuck(source, 3.0, 1.0));
        assert_eq!(is_raised(&results), is_own, "two of three raise");
    }
    // A store that can be read only later.
    let late = results(9);
    read_from(&late, 2, 0.0);
    assert!(!late.restore(&id(), kept().0));
    assert_eq!(is_given(&late), (false, false));
    // What an older version kept says nothing of where it was read.
    let (mut old, _) = kept();
    old.diagnosed.iter_mut().for_each(|(restored, _)| restored.source = None);
    let results = results(9);
    results.restore(&id(), old);
    read_from(&results, 2, 2.0);
    assert_eq!(is_given(&results), (true, true));
}
