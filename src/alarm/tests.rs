use super::*;
use Observation::{Absent, Between, Present, Unknown};
use proptest::prelude::*;

mod walk;

fn fed(observations: &[Observation]) -> Alarm {
    let mut alarm = Alarm::new(Kind::Stiction);
    for (at, &observation) in observations.iter().enumerate() {
        alarm.observe(observation, Priority::Low, at as f64, &Config::default());
    }
    alarm
}

fn act(alarm: &mut Alarm, action: Action, now: f64) -> Result<Vec<Transition>, Refusal> {
    let (taken, acted) = alarm.act(action, now, &Config::default());
    acted.map(|()| taken)
}

fn shelve_for(seconds: f64) -> Action {
    Action::Shelve(Shelving::For(seconds))
}

#[test]
fn two_of_three_raise_and_three_of_four_clear() {
    assert_eq!(fed(&[Present]).state(), State::Normal);
    assert_eq!(fed(&[Present, Absent, Present]).state(), State::Unacknowledged);
    assert_eq!(fed(&[Present, Absent, Absent, Present]).state(), State::Normal);
    let raised = [Present, Present];
    assert_eq!(fed(&[&raised[..], &[Absent, Absent]].concat()).state(), State::Unacknowledged);
    assert_eq!(
        fed(&[&raised[..], &[Absent, Present, Absent, Absent]].concat()).state(),
        State::ReturnedUnacknowledged
    );
}

#[test]
fn not_identifiable_neither_raises_nor_clears_nor_counts() {
    assert_eq!(fed(&[Unknown; 50]).state(), State::Normal);
    assert_eq!(fed(&[Present, Unknown, Unknown, Unknown, Present]).state(), State::Unacknowledged);
    let mut long = vec![Present, Present];
    long.extend([Unknown; 50]);
    assert_eq!(fed(&long).state(), State::Unacknowledged);
}

#[test]
fn inside_the_dead_band_an_alarm_stays_as_it_is() {
    let mut alarm = fed(&[Present, Present]);
    for at in 0..20 {
        alarm.observe(Between, Priority::Low, f64::from(at), &Config::default());
    }
    assert!(alarm.flags().active);
    assert!(!fed(&[Between; 20]).flags().active);
}

#[test]
fn a_diagnosis_is_judged_by_verdict_then_f_then_evidence() {
    let config = Config::default();
    assert_eq!(config.judge(true, 2.5, 446.0), Present);
    assert_eq!(config.judge(false, 0.04, 1e9), Absent);
    assert_eq!(config.judge(false, 1.0, 10.0), Absent);
    assert_eq!(config.judge(false, 1.0, 15.0), Between);
    assert_eq!(config.judge(false, f64::NAN, f64::NAN), Between);
}

#[test]
fn priority_follows_f_and_never_falls_while_the_condition_holds() {
    let config = Config::default();
    let of = |f| config.priority(Kind::Stiction, f);
    assert_eq!(
        [of(None), of(Some(0.49)), of(Some(0.5)), of(Some(2.0))],
        [Priority::Low, Priority::Low, Priority::Medium, Priority::High]
    );
    let mut alarm = Alarm::new(Kind::Stiction);
    let mut seen = |f: f64, at| {
        alarm.observe(Present, of(Some(f)), at, &config);
        alarm.priority()
    };
    // The first vote raises nothing, so it has no priority yet.
    assert_eq!(
        [seen(3.0, 0.0), seen(0.6, 1.0), seen(2.5, 2.0), seen(0.1, 3.0)],
        [None, Some(Priority::Medium), Some(Priority::High), Some(Priority::High)]
    );
}

#[test]
fn a_priority_that_rises_while_the_condition_holds_is_told_once_and_leaves_the_state() {
    let config = Config::default();
    let mut alarm = fed(&[Present, Present]);
    act(&mut alarm, Action::Acknowledge, 2.0).expect("it waits for that");
    let mut seen = |priority, at| alarm.observe(Present, priority, at, &config);
    let (state, cause) = (State::Acknowledged, Cause::MoreUrgent);
    assert_eq!(seen(Priority::High, 3.0), [Transition { from: state, to: state, at: 3.0, cause }]);
    assert_eq!(seen(Priority::High, 4.0), []);
    assert_eq!(seen(Priority::Low, 5.0), []);
    assert_eq!(alarm.flags().since, Some(2.0));
    // In silence nobody is told of it, and at its end of all at once.
    let mut other = fed(&[Present, Present]);
    act(&mut other, shelve_for(10.0), 2.0).expect("a sound duration");
    assert_eq!(other.observe(Present, Priority::Medium, 3.0, &config), []);
    let ended = other.observe(Present, Priority::High, 12.0, &config);
    assert_eq!(ended.iter().map(|own| own.cause).collect::<Vec<_>>(), [Cause::Expired]);
    assert_eq!(other.priority(), Some(Priority::High));
}

#[test]
fn what_is_there_no_more_stands_no_longer_and_what_is_silent_stays_so() {
    let mut alarm = fed(&[Present, Present]);
    let over = alarm.forget(3.0);
    assert_eq!((over[0].from, over[0].to), (State::Unacknowledged, State::Normal));
    assert_eq!((over.len(), over[0].cause), (1, Cause::Forgotten));
    assert_eq!(alarm.forget(4.0), []);
    // It begins anew: no vote is left.
    assert_eq!(alarm.observe(Present, Priority::Low, 5.0, &Config::default()), []);
    let mut shelved = fed(&[Present, Present]);
    act(&mut shelved, shelve_for(10.0), 2.0).expect("a sound duration");
    assert_eq!(shelved.forget(3.0), []);
    assert_eq!((shelved.state(), shelved.flags().active), (State::Shelved, true));
}

#[test]
fn shelving_ends_by_itself_and_tells_what_held_meanwhile() {
    let config = Config::default();
    let mut alarm = Alarm::new(Kind::Stiction);
    let shelved = act(&mut alarm, shelve_for(100.0), 0.0).expect("a sound duration");
    assert_eq!((shelved[0].from, shelved[0].to), (State::Normal, State::Shelved));
    assert_eq!(alarm.observe(Present, Priority::Low, 1.0, &config), vec![]);
    assert_eq!(alarm.observe(Present, Priority::Low, 2.0, &config), vec![]);
    assert_eq!(alarm.tick(99.9), vec![]);
    let ended = alarm.tick(100.0);
    assert_eq!((ended[0].to, ended[0].cause), (State::Unacknowledged, Cause::Expired));
    assert_eq!(alarm.flags().raised_at, Some(2.0));
}

/// What was left, what has become since a start that did not know it, and what comes of the two.
#[test]
fn how_it_was_left_goes_into_what_it_has_become() {
    let flags = |active, acknowledged| Flags { active, acknowledged, ..Flags::default() };
    let shelved = Flags { shelved_until: Some(50.0), ..flags(true, true) };
    let out = Flags { out_of_service: true, ..flags(true, false) };
    let latched = Flags { latched: true, ..flags(false, false) };
    use State::*;
    for (left, own, state) in [
        (flags(true, true), flags(true, false), Acknowledged),
        (flags(true, false), flags(true, true), Acknowledged),
        (flags(true, false), flags(true, false), Unacknowledged),
        (flags(true, true), flags(false, true), Acknowledged),
        (flags(true, true), flags(false, false), Acknowledged),
        (flags(false, true), flags(true, false), Unacknowledged),
        (flags(false, false), flags(false, true), ReturnedUnacknowledged),
        (flags(false, true), flags(false, true), Normal),
        (shelved, flags(true, false), Shelved),
        (flags(true, false), shelved, Shelved),
        (out, shelved, OutOfService),
        (latched, flags(false, true), LatchedUnacknowledged),
        (latched, flags(true, true), Acknowledged),
        // What the design suppressed then it may not suppress now.
        (Flags { suppressed: true, ..flags(true, true) }, flags(true, false), Acknowledged),
        (flags(true, true), Flags { suppressed: true, ..flags(true, false) }, SuppressedByDesign),
    ] {
        let saved = |flags, votes: &[Observation], at| Saved {
            flags,
            votes: votes.to_vec(),
            raises: vec![at],
            ..Saved::default()
        };
        let config = Config::default();
        let mut alarm = Alarm::restored(Kind::Stiction, &config, saved(own, &[Present], 7.0));
        let taken = alarm.merge(saved(left, &[Absent], 3.0), 10.0, &config);
        assert_eq!(alarm.state(), state, "{left:?} {own:?}");
        let told: Vec<_> = taken.iter().map(|t| (t.from, t.to, t.at, t.cause)).collect();
        let expected = (own.state() != state).then_some((own.state(), state, 10.0, Cause::Restored));
        assert_eq!(told, Vec::from_iter(expected), "{left:?} {own:?}");
        let merged = alarm.saved();
        assert_eq!(merged.raises, [3.0, 7.0]);
        // Votes belong to a side: those of the one that the condition came from.
        let votes = if own.active == merged.flags.active { Present } else { Absent };
        assert_eq!(merged.votes, [votes], "{left:?} {own:?}");
        assert_eq!(alarm.merge(saved(left, &[Absent], 3.0), 11.0, &config), [], "twice is once");
        assert_eq!(alarm.saved(), merged);
    }
    // A shelving that has run out meanwhile has.
    let mut alarm = Alarm::new(Kind::Stiction);
    alarm.merge(Saved { flags: shelved, ..Saved::default() }, 60.0, &Config::default());
    assert_eq!(alarm.state(), Unacknowledged);
}

#[test]
fn shelved_once_it_comes_back_with_the_next_occurrence() {
    let config = Config { k: 1, n: 1, clear_k: 1, clear_n: 1, ..Config::default() };
    let mut alarm = Alarm::new(Kind::Stiction);
    let once = Action::Shelve(Shelving::Once(1000.0));
    assert_eq!(alarm.act(once, 0.0, &config).1, Err(Refusal::NothingToShelve));
    alarm.observe(Present, Priority::Low, 1.0, &config);
    alarm.act(once, 2.0, &config).1.expect("the condition holds");
    let gone = alarm.observe(Absent, Priority::Low, 3.0, &config);
    assert_eq!((gone[0].to, gone[0].cause), (State::Normal, Cause::OneShotOver));
    alarm.observe(Present, Priority::Low, 4.0, &config);
    assert_eq!(alarm.state(), State::Unacknowledged);
}

#[test]
fn a_trip_stays_until_it_is_acknowledged_and_reset() {
    let config = Config::default();
    let mut alarm = Alarm::new(Kind::CompensationTripped);
    alarm.level(true, 1.0, &config);
    alarm.level(false, 2.0, &config);
    assert_eq!(alarm.state(), State::LatchedUnacknowledged);
    assert!(matches!(act(&mut alarm, Action::Reset, 3.0), Err(Refusal::NothingToReset(_))));
    act(&mut alarm, Action::Acknowledge, 4.0).expect("it waits for that");
    // Shelved, it comes back latched: a trip is not forgotten.
    act(&mut alarm, shelve_for(10.0), 5.0).expect("a sound duration");
    assert_eq!(alarm.tick(15.0)[0].to, State::LatchedUnacknowledged);
    act(&mut alarm, Action::Acknowledge, 16.0).expect("again");
    act(&mut alarm, Action::Reset, 17.0).expect("seen and gone");
    assert_eq!(alarm.state(), State::Normal);
}

#[test]
fn impossible_actions_are_refused_with_the_reason() {
    let mut alarm = Alarm::new(Kind::Stiction);
    let normal = State::Normal;
    assert_eq!(act(&mut alarm, Action::Acknowledge, 0.0), Err(Refusal::NothingToAcknowledge(normal)));
    assert_eq!(act(&mut alarm, Action::Unshelve, 0.0), Err(Refusal::NotShelved(normal)));
    assert_eq!(act(&mut alarm, Action::GiveBack, 0.0), Err(Refusal::InService(normal)));
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
        assert!(matches!(act(&mut alarm, shelve_for(bad), 0.0), Err(Refusal::BadDuration { .. })), "{bad}");
    }
    assert_eq!(alarm.state(), normal);
    act(&mut alarm, Action::TakeOut, 1.0).expect("it is in service");
    assert_eq!(act(&mut alarm, Action::TakeOut, 2.0), Err(Refusal::OutOfService));
    assert_eq!(act(&mut alarm, shelve_for(1.0), 2.0), Err(Refusal::OutOfService));
}

#[test]
fn a_condition_counts_once_it_has_held_for_the_delay() {
    let config = Config::default();
    let mut alarm = Alarm::new(Kind::TagBad);
    alarm.level(true, 0.0, &config);
    alarm.level(true, 299.0, &config);
    alarm.level(false, 299.5, &config);
    alarm.level(true, 300.0, &config);
    alarm.level(true, 599.0, &config);
    assert_eq!(alarm.state(), State::Normal);
    // A restart in between does not begin it anew.
    alarm = Alarm::restored(Kind::TagBad, &config, alarm.saved());
    alarm.level(true, 600.0, &config);
    assert_eq!(alarm.state(), State::Unacknowledged);
    // A clock that was set back does.
    let mut other = Alarm::new(Kind::TagBad);
    other.level(true, 1000.0, &config);
    other.level(true, 10.0, &config);
    other.level(true, 309.0, &config);
    assert_eq!(other.state(), State::Normal);
    other.level(true, 310.0, &config);
    assert_eq!(other.state(), State::Unacknowledged);
    // Of one that is set, and told of it, nothing but the time that passes counts.
    let mut third = Alarm::new(Kind::TagBad);
    third.level(true, 0.0, &config);
    third.clock_was_set(4000.0);
    third.level(true, 4299.0, &config);
    assert_eq!(third.state(), State::Normal);
    third.clock_was_set(-4200.0);
    third.level(true, 100.0, &config);
    assert_eq!(third.state(), State::Unacknowledged);
}

#[test]
fn chattering_and_stale_alarms_are_told() {
    let config = Config::default();
    let mut alarm = Alarm::new(Kind::CollectorDown);
    for at in [0.0, 100.0, 200.0] {
        assert!(!alarm.chatters(at, &config), "{at}");
        alarm.level(true, at, &config);
        alarm.level(false, at + 50.0, &config);
    }
    assert!(alarm.chatters(250.0, &config));
    assert!(alarm.chatters(86_400.0, &config) && !alarm.chatters(86_401.0, &config));
    alarm.level(true, 1000.0, &config);
    let month = 30.0 * 86_400.0;
    assert!(!alarm.is_stale(1000.0 + month, &config) && alarm.is_stale(1001.0 + month, &config));
    alarm.level(false, 1002.0 + month, &config);
    assert!(!alarm.is_stale(2000.0 + month, &config));
}

#[test]
fn a_flood_is_grouped_counted_and_over_at_half_its_rate() {
    let config = Config { flood_raises: 10, flood_s: 600.0, ..Config::default() };
    let mut flood = Flood::default();
    let mut raised = |priority, at| flood.raised(priority, at, &config);
    assert!((0..10).all(|k| !raised(Priority::Low, f64::from(k))), "ten in ten minutes can be handled");
    assert!((10..40).all(|k| raised(Priority::Medium, f64::from(k))), "what is over it is grouped");
    assert!(!raised(Priority::High, 40.0), "what is urgent never is");
    assert_eq!(flood.view(), FloodView { since: Some(10.0), grouped: 30, recent: 41 });
    assert!(!flood.tick(600.0, &config));
    // Parts of ten seconds: what was raised up to 40 s has left the ten minutes by 650 s.
    assert!(flood.tick(650.0, &config));
    assert_eq!(flood.view(), FloodView { since: None, grouped: 30, recent: 0 });
    assert!(!flood.raised(Priority::Low, 700.0, &config));
}

#[test]
fn a_flood_that_has_ended_when_one_more_is_raised_is_said_to_be_over() {
    let config = Config { flood_raises: 10, flood_s: 600.0, ..Config::default() };
    let mut flood = Flood::default();
    for k in 0..11 {
        flood.raised(Priority::Low, f64::from(k), &config);
    }
    assert!(flood.view().since.is_some());
    flood.raised(Priority::Low, 5000.0, &config);
    assert!(flood.tick(5000.0, &config), "else nobody lets go of what it grouped");
    assert_eq!((flood.view().since, flood.view().recent), (None, 1));
}

#[test]
fn a_clock_that_is_set_back_makes_no_flood_longer_and_no_alarm_chatter() {
    let config = Config { flood_raises: 10, flood_s: 600.0, ..Config::default() };
    let mut flood = Flood::default();
    for _ in 0..11 {
        flood.raised(Priority::Low, 90_000.0, &config);
    }
    assert_eq!(flood.view(), FloodView { since: Some(90_000.0), grouped: 1, recent: 11 });
    // An hour back: what was raised a moment ago still counts, for ten minutes.
    assert!(!flood.tick(86_400.0, &config));
    assert_eq!(flood.view(), FloodView { since: Some(86_400.0), grouped: 1, recent: 11 });
    assert!(!flood.tick(86_990.0, &config));
    assert!(flood.raised(Priority::Low, 86_990.0, &config));
    assert!(flood.tick(87_010.0, &config));
    assert_eq!(flood.view(), FloodView { since: None, grouped: 2, recent: 1 });

    let raises = vec![90_000.0; config.chatter_raises];
    let alarm = Alarm::restored(Kind::TagBad, &config, Saved { raises, ..Saved::default() });
    assert!(alarm.chatters(90_001.0, &config));
    assert!(!alarm.chatters(1000.0, &config), "that was not within the last day, whatever it was");
}

#[test]
fn what_the_configuration_suppresses_is_suppressed_by_design() {
    let config = Config { suppressed: vec!["A/tag_bad".into(), "*/f_rising".into()], ..Config::default() };
    for (kind, subject, expected) in [
        (Kind::TagBad, "A", State::SuppressedByDesign),
        (Kind::TagBad, "B", State::Normal),
        (Kind::FRising, "B", State::SuppressedByDesign),
    ] {
        let mut alarm = Alarm::new(kind);
        alarm.suppress(false, subject, 0.0, &config);
        assert_eq!(alarm.state(), expected, "{subject} {kind:?}");
    }
}

#[test]
fn names_of_alarms_states_causes_and_kinds_are_read_back() {
    let id = AlarmId::new(LoopId::new("FIC101"), Kind::FRising);
    assert_eq!(id.to_string(), "FIC101/f_rising");
    assert_eq!(AlarmId::named("FIC101/f_rising"), id);
    assert_eq!(AlarmId::named("FIC101"), AlarmId::new(LoopId::new("FIC101"), Kind::Stiction));
    assert_eq!(AlarmId::named("a/b").to_string(), "a/b/stiction");
    assert!(Kind::ALL.into_iter().all(|kind| Kind::named(kind.as_str()) == Some(kind)));
    assert!(State::ALL.into_iter().all(|state| State::named(state.as_str()) == Some(state)));
    assert!(Cause::ALL.into_iter().all(|cause| Cause::named(cause.as_str()) == Some(cause)));
    assert!(Priority::ALL.into_iter().all(|one| Priority::named(one.as_str()) == Some(one)));
}

#[test]
fn impossible_settings_are_named() {
    assert_eq!(Config::default().validate(), vec![]);
    let bad = Config {
        k: 4,
        clear_n: 0,
        clear_f_percent: f64::NAN,
        suppressed: vec!["FIC1".into()],
        tag_bad: TagBadConfig { after_s: 0.0, ..TagBadConfig::default() },
        f_rising: RisingConfig { min_points: 40, ..RisingConfig::default() },
        ..Config::default()
    };
    let fields: Vec<String> =
        bad.validate().iter().map(|(table, field, _)| format!("{table}.{field}")).collect();
    let expected = [
        ".k",
        ".clear_n",
        ".clear_k",
        ".clear_f_percent",
        "tag_bad.after_s",
        ".suppressed",
        "f_rising.min_points",
    ];
    assert_eq!(fields, expected);
}

use crate::signal::LoopId;
