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
