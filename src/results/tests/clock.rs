//! Clocks that are set.

use super::*;

/// A restart takes what was kept: it has to be of the clock that is then.
#[test]
fn since_when_a_loop_cannot_be_judged_is_kept_by_the_clock_that_was_set() {
    let (results, kept) = (results(3), Arc::new(Mutex::new(Vec::new())));
    let keeper = kept.clone();
    results.keep_with(Arc::new(move |change| keeper.lock().expect("no panic").extend(change.alarms)));
    let why = NotIdentifiable::Gaps { share: 0.5 };
    results.record(run(1000.0, Outcome::Diagnosed(diagnosis(Verdict::NotIdentifiable(why), 0.0, 0.0))));
    let pending = || {
        let kept = kept.lock().expect("no panic");
        kept.last().map(|own: &KeptAlarm| (own.id.to_string(), own.saved.pending))
    };
    assert_eq!(pending(), Some(("A/not_identifiable".to_string(), Some(1000.0))));
    results.clock_was_set(-400.0);
    assert_eq!(pending(), Some(("A/not_identifiable".to_string(), Some(600.0))));
}

#[test]
fn a_clock_that_is_set_back_shelves_nothing_for_longer_than_anybody_may() {
    let (results, kept) = (results(3), Arc::new(Mutex::new(Vec::new())));
    let keeper = kept.clone();
    results.keep_with(Arc::new(move |change| keeper.lock().expect("no panic").extend(change.alarms)));
    let week = alarm::Config::default().max_shelve_s;
    let shelve = Action::Shelve(Shelving::For(week));
    results.act(&stiction(), shelve, Said::default(), 1e9).expect("A").expect("a sound duration");
    let until = || results.alarm(&stiction(), 0.0).expect("A").shelved_until;
    results.tick(1e9);
    assert_eq!(until(), Some(1e9 + week));
    // Ten years back; what time passes from then on counts.
    let now = 1e9 - 3e8;
    for passed in [0.0, 1.0, 1000.0] {
        results.tick(now + passed);
        assert_eq!(until(), Some(now + week));
    }
    let last = kept.lock().expect("no panic").last().map(|own: &KeptAlarm| own.saved.flags.shelved_until);
    assert_eq!(last, Some(Some(now + week)), "also after a restart");
    results.tick(now + week);
    assert_eq!(until(), None);
}

/// A reload gives back what the store has; without a clock of its own a machine begins in 1970.
#[test]
fn a_run_of_a_clock_that_was_behind_is_not_given_back_beside_itself() {
    let results = results(9);
    let run = |time| sticky(time).summary();
    let kept = |times: &[f64]| Remembered {
        summaries: times.iter().copied().map(run).collect(),
        ..Remembered::default()
    };
    results.restore(&id(), kept(&[900.0]));
    [100.0, 1000.0].into_iter().for_each(|time| drop(results.record(sticky(time))));
    let times =
        || -> Vec<f64> { results.summaries(&id()).expect("A is there").iter().map(|own| own.time).collect() };
    assert_eq!(times(), [900.0, 100.0, 1000.0]);
    results.restore(&id(), kept(&[100.0, 900.0, 1000.0]));
    assert_eq!(times(), [900.0, 100.0, 1000.0]);
}

#[test]
fn a_shelving_that_is_prolonged_is_told_as_such() {
    let results = results(3);
    let shelve = |duration_s, now| {
        let how = Action::Shelve(Shelving::For(duration_s));
        results.act(&stiction(), how, Said::default(), now).expect("A").expect("a sound duration")
    };
    shelve(100.0, 1.0);
    let view = shelve(200.0, 50.0);
    assert_eq!((view.shelved_until, view.since), (Some(250.0), Some(50.0)));
    let log = results.alarm_log();
    let told: Vec<_> = log.iter().map(|own| own.transition).collect();
    let (shelved, cause) = (State::Shelved, alarm::Cause::Shelved);
    let again = alarm::Transition { from: shelved, to: shelved, at: 50.0, cause };
    assert_eq!(told, [again, alarm::Transition { from: State::Normal, to: shelved, at: 1.0, cause }]);
}
