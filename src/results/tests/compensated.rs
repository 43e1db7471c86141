//! Loops whose valve a term of write-back moves.

use super::*;
use gate::{Cause, Denial};

#[test]
fn a_fault_that_closes_the_gate_is_told_though_a_reload_comes_before_it_has_tripped() {
    let results = results(3);
    let moved = |from, to, cause, at| {
        let event = gate::Event::Moved { from, to, cause, by: None };
        results.tell_writeback(&id(), &gate::News { at, event, tripped_by: None });
    };
    let trip = || results.alarm(&AlarmId::named("A/compensation_tripped"), 9.0).expect("A");
    let (shadow, active, withdrawing) = (gate::State::Shadow, gate::State::Active, gate::State::Withdrawing);
    for (cause, at) in [(Cause::Operator, 1.0), (Cause::Denied(Denial::GrantExpired), 2.0)] {
        moved(active, withdrawing, cause, at);
        moved(withdrawing, shadow, Cause::AtZero, at + 0.5);
        assert_eq!(trip().state, State::Normal, "{cause:?} is no fault");
    }
    moved(active, withdrawing, Cause::Denied(Denial::NotAutomatic), 3.0);
    assert_eq!(trip().state, State::Unacknowledged);
    // The reload that came meanwhile ends it, and begins anew.
    moved(withdrawing, gate::State::Disabled, Cause::AtZero, 4.0);
    moved(gate::State::Disabled, shadow, Cause::Enabled, 5.0);
    assert_eq!(trip().state, State::LatchedUnacknowledged);
    assert_eq!(trip().detail, "write-back was closed by a fault: the loop is not in automatic");
    let raised = |change: &&Arc<AlarmChange>| change.transition.cause == alarm::Cause::Raised;
    assert_eq!(results.alarm_log().iter().filter(raised).count(), 1);
}

#[test]
fn a_loop_whose_write_back_is_gone_is_judged_again() {
    let results = results(9);
    let (from, to) = (gate::State::Armed, gate::State::Active);
    let event = gate::Event::Moved { from, to, cause: Cause::Opened, by: None };
    results.tell_writeback(&id(), &gate::News { at: 0.0, event, tripped_by: None });
    (1..3).for_each(|k| drop(results.record(sticky(f64::from(k)))));
    let alarm = |now| results.get(&id(), now).expect("A is there").alarm.active;
    let clean = |k: u32| run(f64::from(k), Outcome::Diagnosed(diagnosis(Verdict::NoStiction, 0.0, -2.0)));
    (3..9).for_each(|k| drop(results.record(clean(k))));
    assert!(alarm(9.0), "a term hides the friction");
    // Its task was ended before it could say so, and the next configuration has no write-back.
    results.keep_reinforced(|_| false);
    (9..15).for_each(|k| drop(results.record(clean(k))));
    assert!(!alarm(15.0));
}

#[test]
fn a_compensated_loop_says_whether_it_sticks_as_before() {
    let results = results(20);
    let told = |time: f64, verdict: Verdict, f: f64| {
        let mut judged = diagnosis(verdict, f, 400.0);
        judged.diagnosis.preparation.compensated = 1.0;
        let basis = Basis::of(&Record::default(), &Settings::default(), None).after(results.before(&id()));
        let own = Run { basis: Some(Arc::new(basis)), ..run(time, Outcome::Diagnosed(judged)) };
        results.record(own);
        results.get(&id(), time).and_then(|known| known.summary).expect("diagnosed")
    };
    let hidden = || Verdict::NotIdentifiable(NotIdentifiable::Compensated);
    assert_eq!(
        told(0.5, hidden(), 0.0).words(),
        "Write-back moved the valve in this record. Whether the valve sticks is not visible."
    );
    (1..3).for_each(|k| drop(results.record(sticky(f64::from(k)))));
    let alarm = |now| results.get(&id(), now).expect("A is there").alarm.active;
    let cases = [
        (hidden(), 0.0, "no_longer_visible", "f 2.000 % OP as of before, no longer visible"),
        (Verdict::Stiction, 1.01, "consistent", "f 2.000 % OP as of before, still consistent"),
        (Verdict::Stiction, 1.9, "changed", "f 2.000 % OP as of before, no longer consistent"),
    ];
    for (at, (verdict, f, seen, reason)) in cases.into_iter().enumerate() {
        let said = told(3.0 + at as f64, verdict, f);
        let own = said.compensated.expect("a term acted");
        assert_eq!((own.f_before, own.seen.as_str()), (Some(2.0), seen));
        assert!(said.reason.starts_with(&format!("compensated; {reason}; ")), "{}", said.reason);
    }
    // Nothing was told of write-back: that the window was acted on is enough.
    (10..20).for_each(|k| drop(told(f64::from(k), hidden(), 0.0)));
    assert!(alarm(20.0), "an alarm that a term hides returned to normal");
    // What was seen beside a term is no friction of before.
    assert_eq!(results.before(&id()).map(|own| own.f), Some(2.0));
}
