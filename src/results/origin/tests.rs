use super::*;
use crate::alarm;
use crate::diagnosis::Verdict;
use crate::results::tests::{diagnosis, run};
use crate::results::{Outcome, Run};

/// Loops, each with the tag that drives it (or none) and whether its valve sticks.
fn plant(loops: &[(&str, Option<&str>, bool)]) -> Results {
    let ids: Vec<LoopId> = loops.iter().map(|(id, ..)| LoopId::new(*id)).collect();
    let results = Results::new(&ids, 3, &alarm::Config::default());
    for (id, driver, sticks) in loops {
        let verdict = if *sticks { Verdict::Stiction } else { Verdict::NoStiction };
        let outcome = Outcome::Diagnosed(diagnosis(verdict, 1.0, 400.0));
        results.record(Run { id: LoopId::new(*id), ..run(1.0, outcome) });
        let entry = results.entry(&LoopId::new(*id)).expect("it was placed");
        let effect = |tag: &str| (Kind::MeasuredDisturbance, Some(tag.to_string()));
        lock(&entry).model.effects = driver.iter().map(|tag| effect(tag)).collect();
    }
    results
}

fn path(origin: &Origin) -> Vec<&str> {
    origin.path.iter().map(LoopId::as_str).collect()
}

#[test]
fn follows_the_disturbance_to_the_loop_that_nothing_drives() {
    let results = plant(&[
        ("A", Some("B.pv"), false),
        ("B", Some("C.1.op"), false),
        ("C.1", None, true),
        ("D", None, true),
    ]);
    let origin = results.origin(&LoopId::new("A")).expect("B drives A");
    assert_eq!(path(&origin), ["A", "B", "C.1"]);
    assert_eq!((origin.starts_in, origin.sticky), (Some(LoopId::new("C.1")), true));
    assert_eq!(results.origin(&LoopId::new("D")), None);
    assert_eq!(results.origin(&LoopId::new("E")), None);
}

#[test]
fn a_circle_starts_where_the_valve_sticks_and_nowhere_if_none_or_two_do() {
    for (sticks, expected) in [([false, true], Some("B")), ([false, false], None), ([true, true], None)] {
        let results = plant(&[("A", Some("B.pv"), sticks[0]), ("B", Some("A.pv"), sticks[1])]);
        let origin = results.origin(&LoopId::new("A")).expect("B drives A");
        assert_eq!(path(&origin), ["A", "B"]);
        assert_eq!(origin.starts_in.as_ref().map(LoopId::as_str), expected);
    }
}

#[test]
fn a_tag_of_no_loop_and_the_own_tag_lead_nowhere() {
    let results = plant(&[("A", Some("ambient.temperature"), false), ("B", Some("B.op"), true)]);
    assert_eq!(results.origin(&LoopId::new("A")), None);
    assert_eq!(results.origin(&LoopId::new("B")), None);
}
