use super::*;
use crate::plantwide::{Cause, Part};
use proptest::prelude::*;

const HOUR: f64 = 3600.0;

fn config() -> Config {
    Config { persist_s: 10.0 * HOUR, ..Config::default() }
}

fn seen() -> Seen {
    Seen {
        cause: Cause::Valve,
        probability: Some(0.9),
        worth: 1.8,
        why: "it sticks".into(),
        gains_nothing: false,
        victims: vec![LoopId::new("LIC1")],
    }
}

/// What a look of the last hour says.
fn said(now: f64, is_seen: bool, sd: f64) -> Vec<Said> {
    let measure = Measure { error_sd: Some(sd), swing: Some(0.5), f: Some(1.0) };
    vec![Said { id: LoopId::new("FIC1"), from: now - HOUR, measure, seen: is_seen.then(seen) }]
}

/// Looks once an hour and returns the moves.
fn look(list: &mut WorkList, hours: std::ops::Range<u32>, is_seen: bool, sd: f64) -> Vec<(State, State)> {
    let mut moves = Vec::new();
    for hour in hours {
        let now = f64::from(hour) * HOUR;
        let changed = list.take(&said(now, is_seen, sd), now, &config());
        moves.extend(changed.into_iter().filter_map(|(_, moved)| moved).map(|m| (m.from, m.to)));
    }
    moves
}

#[test]
fn a_suspicion_that_lasts_is_ordered_repaired_and_verified() {
    let (mut list, id) = (WorkList::default(), LoopId::new("FIC1"));
    assert_eq!(look(&mut list, 0..10, true, 2.0), []);
    assert_eq!(look(&mut list, 10..30, true, 2.0), [(State::Watched, State::Open)]);
    let mut act = |what, hour: f64| {
        list.act(&id, what, Some("Ann".into()), Some("packing".into()), hour * HOUR).expect("there is one")
    };
    assert_eq!(act(Act::Order, 30.0).expect("open").1.to, State::Ordered);
    assert_eq!(act(Act::Order, 31.0), Err(Refusal("ordered", "ordered")));
    assert_eq!(act(Act::Repaired, 32.0).expect("ordered").1.to, State::Repaired);
    assert_eq!(look(&mut list, 33..60, false, 0.5), [(State::Repaired, State::Verified)]);
    let order = list.get(&id).expect("kept");
    let (before, at) = order.before.expect("measured");
    assert_eq!((before.error_sd, at), (Some(2.0), 32.0 * HOUR));
    assert_eq!(order.after.and_then(|after| after.error_sd), Some(0.5));
    assert_eq!(order.note.as_deref(), Some("packing"));
    // It is forgotten after a quarter of a year.
    list.take(&said(2300.0 * HOUR, false, 0.5), 2300.0 * HOUR, &config());
    assert_eq!(list.orders().count(), 0);
}

/// Who is expected to calm down with whom.
fn sources(list: &WorkList) -> Vec<(String, String)> {
    let mut all: Vec<_> =
        list.sources().into_iter().map(|(victim, source)| (victim.to_string(), source.to_string())).collect();
    all.sort();
    all
}

#[test]
fn nothing_is_expected_to_calm_down_with_what_is_not_suspected_any_more() {
    let victim = vec![("LIC1".to_string(), "FIC1".to_string())];
    let (mut list, id) = (WorkList::default(), LoopId::new("FIC1"));
    look(&mut list, 0..20, true, 2.0);
    assert_eq!(sources(&list), victim);
    // The order stays open until hardly any look suspects it; that its victims calm down with it is over at once.
    look(&mut list, 20..21, false, 0.5);
    assert_eq!((list.get(&id).map(|order| order.state), sources(&list)), (Some(State::Open), vec![]));
    look(&mut list, 21..40, true, 2.0);
    list.act(&id, Act::Order, None, None, 40.0 * HOUR).expect("there is one").expect("open");
    assert_eq!(sources(&list), victim);
    // Nor what is not looked at, as a loop in manual: the order is to be kept without them, once.
    let changed = list.take(&[], 41.0 * HOUR, &config());
    let kept: Vec<_> = changed.iter().map(|(order, moved)| (order.victims.len(), moved.is_none())).collect();
    assert_eq!((kept, sources(&list)), (vec![(0, true)], vec![]));
    assert!(list.take(&[], 42.0 * HOUR, &config()).is_empty());
    assert_eq!(list.get(&id).map(|order| order.state), Some(State::Ordered));
    look(&mut list, 43..44, true, 2.0);
    assert_eq!(sources(&list), victim, "it is suspected again");
}

#[test]
fn a_loop_is_expected_to_calm_down_with_one_source() {
    let mut list = WorkList::default();
    let look = |list: &mut WorkList, hours: std::ops::Range<u32>, victim_of: usize| {
        for now in hours.map(|hour| HOUR * f64::from(hour)) {
            let of = |(at, name): (usize, &str)| {
                let victims = if at == victim_of { vec![LoopId::new("LIC1")] } else { Vec::new() };
                let own = said(now, true, 2.0).remove(0);
                Said { id: LoopId::new(name), seen: Some(Seen { victims, ..seen() }), ..own }
            };
            let own: Vec<Said> = ["FIC1", "FIC2"].into_iter().enumerate().map(of).collect();
            list.take(&own, now, &config());
        }
    };
    look(&mut list, 0..20, 1);
    assert_eq!(sources(&list), [("LIC1".to_string(), "FIC2".to_string())]);
    // Another look finds another source: the first is not one beside it.
    look(&mut list, 20..21, 0);
    assert_eq!(sources(&list), [("LIC1".to_string(), "FIC1".to_string())]);
    assert_eq!(list.orders().map(|order| order.victims.len()).sum::<usize>(), 1);
}

#[test]
fn what_is_not_wanted_is_not_forgotten_while_it_is_suspected() {
    let (mut list, id, day) = (WorkList::default(), LoopId::new("FIC1"), 24);
    look(&mut list, 0..20, true, 2.0);
    list.act(&id, Act::Dismiss, Some("Ann".into()), None, 20.0 * HOUR).expect("there is one").expect("open");
    let state = |list: &WorkList| list.get(&id).map(|order| order.state);
    assert_eq!(look(&mut list, 21..120 * day, true, 2.0), []);
    assert_eq!(state(&list), Some(State::Dismissed));
    // A quarter of a year after it was suspected last, and not after somebody said so.
    assert_eq!(look(&mut list, 120 * day..210 * day - 1, false, 0.5), []);
    assert_eq!(state(&list), Some(State::Dismissed));
    look(&mut list, 210 * day - 1..210 * day + 1, false, 0.5);
    assert_eq!(state(&list), None);
}

#[test]
fn a_repair_that_does_not_help_opens_the_order_again() {
    let (mut list, id) = (WorkList::default(), LoopId::new("FIC1"));
    look(&mut list, 0..20, true, 2.0);
    list.act(&id, Act::Repaired, None, None, 20.0 * HOUR).expect("there is one").expect("open");
    assert_eq!(look(&mut list, 21..40, true, 2.0), [(State::Repaired, State::Open)]);
    assert_eq!(list.get(&id).map(|order| order.reopened), Some(1));
}

/// Rings that go back 5.7 days: the swing that the repair has ended fills most of them for 68 hours.
#[test]
fn a_repair_is_judged_by_nothing_that_was_before_it() {
    const LENGTH: f64 = 136.8 * HOUR;
    let (mut list, id, config) = (WorkList::default(), LoopId::new("FIC1"), Config::default());
    let repaired = 60.0 * HOUR;
    let mut moves = Vec::new();
    for hour in 0..400 {
        let now = f64::from(hour) * HOUR;
        let from = now - LENGTH;
        let (is_seen, sd) = if from + 0.5 * LENGTH < repaired { (true, 2.0) } else { (false, 0.5) };
        let own = Said { from, ..said(now, is_seen, sd).remove(0) };
        let changed = list.take(&[own], now, &config);
        moves.extend(changed.into_iter().filter_map(|(_, moved)| moved).map(|own| (own.to, own.at / HOUR)));
        if hour == 60 {
            list.act(&id, Act::Repaired, None, None, now).expect("there is one").expect("open");
        }
    }
    // From hour 197 on windows begin after it, and 24 of them are half of two days.
    assert_eq!(moves, [(State::Open, 48.0), (State::Verified, 220.0)]);
    let order = list.get(&id).expect("kept");
    assert_eq!((order.reopened, order.after.and_then(|after| after.error_sd)), (0, Some(0.5)));
}

#[test]
fn how_it_was_before_is_how_it_was_when_it_was_suspected() {
    let (mut list, id) = (WorkList::default(), LoopId::new("FIC1"));
    look(&mut list, 0..20, true, 2.0);
    look(&mut list, 20..40, false, 0.5);
    look(&mut list, 40..60, true, 2.0);
    let acted = list.act(&id, Act::Repaired, None, None, 60.0 * HOUR).expect("there is one").expect("open");
    assert_eq!(acted.0.before.and_then(|(before, _)| before.error_sd), Some(2.0));
}

#[test]
fn what_comes_and_goes_is_no_order() {
    let mut list = WorkList::default();
    for hour in 0..100 {
        let moves = look(&mut list, hour..hour + 1, hour % 2 == 0, 1.0);
        assert_eq!(moves, [], "hour {hour}");
    }
    // Nothing is left of a suspicion that is not renewed.
    look(&mut list, 100..104, false, 1.0);
    assert_eq!(list.orders().count(), 0);
}

#[test]
fn an_open_order_whose_loop_calms_down_is_over_and_opens_again_with_it() {
    let mut list = WorkList::default();
    look(&mut list, 0..20, true, 2.0);
    assert_eq!(look(&mut list, 20..40, false, 0.5), [(State::Open, State::Calmed)]);
    assert_eq!(look(&mut list, 40..60, true, 2.0), [(State::Calmed, State::Open)]);
}

#[test]
fn looks_that_are_missing_decide_nothing() {
    let mut list = WorkList::default();
    list.take(&said(0.0, true, 1.0), 0.0, &config());
    // The daemon stood still for a day: one look is not ten hours of them.
    let day = 24.0 * HOUR;
    assert!(list.take(&said(day, true, 1.0), day, &config()).iter().all(|(_, moved)| moved.is_none()));
}

#[test]
fn the_cause_is_the_most_frequent_one() {
    let mut order = Order::new(LoopId::new("FIC1"), 0.0);
    for (at, cause, probability) in
        [(1.0, Cause::Valve, 0.8), (2.0, Cause::Load, 0.9), (3.0, Cause::Valve, 0.6)]
    {
        let seen = Seen { cause, probability: Some(probability), worth: at, ..seen() };
        order.take(Some(&seen), Measure::default(), 0.0, at * HOUR, &config());
    }
    let (cause, probability) = order.cause().expect("seen");
    assert!(cause == Cause::Valve && probability.is_some_and(|p| (p - 0.7).abs() < 1e-12));
    assert!((order.worth() - 2.0).abs() < 1e-12);
    let load = Seen { cause: Cause::Load, why: "a load".into(), ..seen() };
    order.take(Some(&load), Measure::default(), 0.0, 4.0 * HOUR, &config());
    assert_eq!(order.why, Some((Cause::Load, "a load".to_string())));
    assert_eq!(order.why.as_ref().map(|own| own.0), order.cause().map(|own| own.0));
}

#[test]
fn of_causes_that_are_as_frequent_a_known_one_is_shown_and_of_those_the_latest() {
    let after = |causes: &[Cause]| {
        let mut order = Order::new(LoopId::new("FIC1"), 0.0);
        for (at, cause) in (1..).zip(causes) {
            let probability = (*cause != Cause::Unknown).then_some(0.9);
            let seen = Seen { cause: *cause, probability, ..seen() };
            order.take(Some(&seen), Measure::default(), 0.0, f64::from(at) * HOUR, &config());
        }
        order.cause().expect("seen")
    };
    let (valve, tuning, unknown) = (Cause::Valve, Cause::Tuning, Cause::Unknown);
    assert_eq!(after(&[valve, unknown]), (valve, Some(0.9)));
    assert_eq!(after(&[unknown, valve]), (valve, Some(0.9)));
    assert_eq!((after(&[valve, tuning]).0, after(&[tuning, valve]).0), (tuning, valve));
    // Of a cause that is not known there is nothing to be sure of.
    assert_eq!(after(&[unknown, unknown, valve]), (unknown, None));
}

/// What looks say of a loop that is not at rest for a cause that they know, or do not.
fn told(hours: std::ops::Range<u32>, cause: Cause, list: &mut WorkList) -> Vec<(State, State)> {
    let mut moves = Vec::new();
    for now in hours.map(|hour| HOUR * f64::from(hour)) {
        let probability = (cause != Cause::Unknown).then_some(0.9);
        let own = said(now, true, 2.0).remove(0);
        let own = Said { seen: Some(Seen { cause, probability, ..seen() }), ..own };
        let changed = list.take(&[own], now, &config());
        moves.extend(changed.into_iter().filter_map(|(_, moved)| moved).map(|m| (m.from, m.to)));
    }
    moves
}

#[test]
fn no_order_is_opened_for_a_cause_that_is_not_known() {
    let (mut list, id) = (WorkList::default(), LoopId::new("FIC1"));
    assert_eq!(told(0..40, Cause::Unknown, &mut list), [(State::Watched, State::Unexplained)]);
    let order = list.get(&id).expect("there");
    assert!(!order.state.is_standing() && order.part() == Some(Part::Unknown), "{order:?}");
    assert_eq!(list.sources().len(), 1, "its victims are told all the same");
    // Once most of the looks know a cause there is something to order.
    assert_eq!(told(40..81, Cause::Valve, &mut list), [(State::Unexplained, State::Open)]);
    assert_eq!(list.get(&id).and_then(Order::part), Some(Part::First));

    // Without that it calms down, and what has calmed down begins anew as it did at first.
    let mut list = WorkList::default();
    told(0..20, Cause::Unknown, &mut list);
    assert_eq!(look(&mut list, 20..40, false, 0.5), [(State::Unexplained, State::Calmed)]);
    assert_eq!(told(40..60, Cause::Unknown, &mut list), [(State::Calmed, State::Unexplained)]);
    // People may order what the looks do not explain.
    assert_eq!(
        list.act(&id, Act::Reopen, None, None, 60.0 * HOUR),
        Some(Err(Refusal("unexplained", "reopened")))
    );
    list.act(&id, Act::Order, None, None, 60.0 * HOUR).expect("there is one").expect("unexplained");
    assert_eq!(list.get(&id).and_then(Order::part), Some(Part::First));
}

#[test]
fn a_repair_that_leaves_the_loop_unexplained_did_not_help() {
    let (mut list, id) = (WorkList::default(), LoopId::new("FIC1"));
    told(0..20, Cause::Valve, &mut list);
    list.act(&id, Act::Repaired, None, None, 20.0 * HOUR).expect("there is one").expect("open");
    assert_eq!(told(21..50, Cause::Unknown, &mut list), [(State::Repaired, State::Open)]);
    assert_eq!(list.get(&id).map(|order| order.reopened), Some(1));
}

#[test]
fn the_part_of_an_order_follows_its_cause_and_what_is_gained() {
    let part = |probability: f64, gains_nothing: bool| {
        let mut list = WorkList::default();
        for now in (0..20).map(|hour| HOUR * f64::from(hour)) {
            let seen = Seen { probability: Some(probability), gains_nothing, ..seen() };
            let own = Said { seen: Some(seen), ..said(now, true, 2.0).remove(0) };
            list.take(&[own], now, &config());
        }
        let order = list.get(&LoopId::new("FIC1")).expect("there");
        assert_eq!(order.state, State::Open);
        order.part()
    };
    assert_eq!(part(0.9, false), Some(Part::First));
    assert_eq!(part(0.9, true), Some(Part::Perhaps));
    assert_eq!(part(0.7, false), Some(Part::Perhaps));
}

proptest! {
    /// Whatever is seen and done: states change only as the diagram says, and what people did stays until they act.
    #[test]
    fn every_move_is_in_the_diagram(
        steps in proptest::collection::vec((0..8u8, any::<bool>(), 0.0..5.0f64), 1..200),
        is_known in any::<bool>(),
    ) {
        let (mut list, id, mut now) = (WorkList::default(), LoopId::new("FIC1"), 0.0);
        for (what, is_seen, hours) in steps {
            now += hours * HOUR;
            let before = list.get(&id).map(|order| order.state);
            let act = [Act::Order, Act::Repaired, Act::Dismiss, Act::Reopen].get(usize::from(what)).copied();
            let moved = match act {
                Some(act) => list.act(&id, act, None, None, now).and_then(Result::ok).map(|(_, moved)| moved),
                None => {
                    let mut own = said(now, is_seen, 1.0);
                    if let Some(seen) = own[0].seen.as_mut().filter(|_| !is_known) {
                        (seen.cause, seen.probability) = (Cause::Unknown, None);
                    }
                    list.take(&own, now, &config()).pop().and_then(|(_, moved)| moved)
                }
            };
            let after = list.get(&id).map(|order| order.state);
            if let (Some(before), Some(after)) = (before, after) && before != after {
                let moved = moved.expect("told");
                prop_assert_eq!((moved.from, moved.to), (before, after));
                use State::{Calmed, Dismissed, Open, Ordered, Repaired, Unexplained, Verified, Watched};
                let begun = if is_known { Open } else { Unexplained };
                let by_itself = [
                    (Watched, begun),
                    (begun, Calmed),
                    (Open, Calmed),
                    (Repaired, Verified),
                    (Repaired, Open),
                    (Calmed, begun),
                    (Verified, begun),
                ];
                prop_assert!(act.is_some() || by_itself.contains(&(before, after)), "{before:?} {after:?}");
                prop_assert!(after != Dismissed || act == Some(Act::Dismiss));
                prop_assert!(after != Ordered || act == Some(Act::Order));
            }
            prop_assert!(list.get(&id).is_none_or(|order| order.looks.len() <= 240));
        }
    }
}

#[test]
fn a_clock_that_was_ahead_holds_no_order_up() {
    let (mut list, id) = (WorkList::default(), LoopId::new("FIC1"));
    // An order of another century, and one that somebody ordered there.
    assert_eq!(look(&mut list, 900_000..900_020, true, 2.0), [(State::Watched, State::Open)]);
    assert_eq!(look(&mut list, 0..20, false, 0.5), [(State::Open, State::Calmed)]);
    look(&mut list, 20..40, true, 2.0);
    list.act(&id, Act::Repaired, None, None, 900_000.0 * HOUR).expect("there is one").expect("open");
    assert_eq!(look(&mut list, 40..60, false, 0.5), [(State::Repaired, State::Verified)]);
}

/// A machine without a clock of its own began in 1970, was set right after five hours, and then has too little to look at.
#[test]
fn a_clock_that_was_behind_makes_no_order_old() {
    let (mut list, id) = (WorkList::default(), LoopId::new("FIC1"));
    look(&mut list, 500_000..500_030, true, 2.0);
    list.act(&id, Act::Dismiss, None, None, 500_030.0 * HOUR).expect("there is one").expect("open");
    look(&mut list, 0..5, true, 2.0);
    let (by, now) = (500_035.0 * HOUR, 500_041.0 * HOUR);
    let mut without = list.clone();
    without.take(&[], now, &config());
    assert_eq!(without.orders().count(), 0, "it would be forgotten, and begin anew");
    let kept = list.clock_was_set([0.0, 5.0 * HOUR], by);
    list.take(&[], now, &config());
    let order = list.get(&id).expect("it is not old");
    let stamps = (order.first, order.since, order.suspected, order.looks.len());
    assert_eq!(stamps, (by, by, by + 4.0 * HOUR, 5));
    assert!(order.state == State::Dismissed && order.looks.iter().all(|look| look.at >= by));
    assert_eq!(kept.iter().map(|own| own.since).collect::<Vec<_>>(), [by]);
    // What was stamped before the start is not the clock's doing.
    assert_eq!(list.clock_was_set([0.0, 5.0 * HOUR], by), []);
}
