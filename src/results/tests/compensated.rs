//! Loops whose valve a term of write-back moves.

use super::*;

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
        "The valve is compensated. Whether it sticks is not visible."
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
