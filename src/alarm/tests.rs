use super::*;
use Observation::{Between, Clean, Sticky, Unknown};
use proptest::prelude::*;

fn fed(observations: &[Observation]) -> Alarm {
    let mut alarm = Alarm::new(Config::default());
    for (at, &observation) in observations.iter().enumerate() {
        alarm.observe(observation, at as f64);
    }
    alarm
}

#[test]
fn two_of_three_raise_and_three_of_four_clear() {
    assert_eq!(fed(&[Sticky]).state(), State::Normal);
    assert_eq!(fed(&[Sticky, Clean, Sticky]).state(), State::Unacknowledged);
    assert_eq!(fed(&[Sticky, Clean, Clean, Sticky]).state(), State::Normal);
    let raised = [Sticky, Sticky];
    assert_eq!(fed(&[&raised[..], &[Clean, Clean]].concat()).state(), State::Unacknowledged);
    assert_eq!(
        fed(&[&raised[..], &[Clean, Sticky, Clean, Clean]].concat()).state(),
        State::ReturnedUnacknowledged
    );
}

#[test]
fn not_identifiable_neither_raises_nor_clears_nor_counts() {
    assert_eq!(fed(&[Unknown; 50]).state(), State::Normal);
    assert_eq!(fed(&[Sticky, Unknown, Unknown, Unknown, Sticky]).state(), State::Unacknowledged);
    let mut long = vec![Sticky, Sticky];
    long.extend([Unknown; 50]);
    assert_eq!(fed(&long).state(), State::Unacknowledged);
}

#[test]
fn inside_the_hysteresis_band_an_alarm_stays_as_it_is() {
    let mut alarm = fed(&[Sticky, Sticky]);
    for at in 0..20 {
        alarm.observe(Between, f64::from(at));
    }
    assert!(alarm.is_active());
    assert!(!fed(&[Between; 20]).is_active());
}

#[test]
fn a_diagnosis_is_judged_by_verdict_then_f_then_evidence() {
    let config = Config::default();
    assert_eq!(config.judge(true, 2.5, 446.0), Sticky);
    assert_eq!(config.judge(false, 0.04, 1e9), Clean);
    assert_eq!(config.judge(false, 1.0, 10.0), Clean);
    assert_eq!(config.judge(false, 1.0, 15.0), Between);
    assert_eq!(config.judge(false, f64::NAN, f64::NAN), Between);
}

#[test]
fn shelving_ends_by_itself_and_tells_what_held_meanwhile() {
    let mut alarm = Alarm::new(Config::default());
    let shelved = alarm.shelve(100.0, 0.0).expect("a sound duration");
    assert_eq!((shelved[0].from, shelved[0].to), (State::Normal, State::Shelved));
    assert_eq!(alarm.observe(Sticky, 1.0), vec![]);
    assert_eq!(alarm.observe(Sticky, 2.0), vec![]);
    assert_eq!(alarm.tick(99.9), vec![]);
    let ended = alarm.tick(100.0);
    assert_eq!((ended[0].to, ended[0].cause), (State::Unacknowledged, Cause::Expired));
    assert_eq!(alarm.raised_at(), Some(2.0));
}

#[test]
fn impossible_actions_are_refused_with_the_reason() {
    let mut alarm = Alarm::new(Config::default());
    assert_eq!(alarm.acknowledge(0.0), Err(Refusal::NothingToAcknowledge(State::Normal)));
    assert_eq!(alarm.unshelve(0.0), Err(Refusal::NotShelved(State::Normal)));
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
        assert!(matches!(alarm.shelve(bad, 0.0), Err(Refusal::BadDuration { .. })), "{bad}");
    }
    assert_eq!(alarm.state(), State::Normal);
}

#[test]
fn impossible_settings_are_named() {
    assert_eq!(Config::default().validate(), vec![]);
    let bad = Config { k: 4, clear_n: 0, clear_f_percent: f64::NAN, ..Config::default() };
    let fields: Vec<&str> = bad.validate().iter().map(|(field, _)| *field).collect();
    assert_eq!(fields, vec!["k", "clear_n", "clear_k", "clear_f_percent"]);
}

#[derive(Clone, Copy, Debug)]
enum Action {
    Observe(Observation),
    Acknowledge,
    Shelve(f64),
    Unshelve,
    Wait(f64),
}

fn actions() -> impl Strategy<Value = Vec<Action>> {
    let observation = prop_oneof![Just(Sticky), Just(Clean), Just(Between), Just(Unknown)];
    let action = prop_oneof![
        6 => observation.prop_map(Action::Observe),
        2 => Just(Action::Acknowledge),
        1 => (1.0f64..20.0).prop_map(Action::Shelve),
        1 => Just(Action::Unshelve),
        1 => (0.0f64..20.0).prop_map(Action::Wait),
    ];
    proptest::collection::vec(action, 0..120)
}

/// The oracle: the diagram as a table, and a condition recounted from every observation ever made.
struct Oracle {
    state: State,
    until: f64,
    seen: Vec<Observation>,
}

impl Oracle {
    /// Replays all observations from the first, changing the condition where the counts say so.
    fn condition(&self, config: &Config) -> bool {
        let (mut active, mut from) = (false, 0);
        for to in 1..=self.seen.len() {
            let (of, wanted, enough) = match active {
                true => (config.clear_n, Clean, config.clear_k),
                false => (config.n, Sticky, config.k),
            };
            let recent = &self.seen[from.max(to.saturating_sub(of))..to];
            if recent.iter().filter(|&&o| o == wanted).count() >= enough {
                (active, from) = (!active, to);
            }
        }
        active
    }

    fn step(&mut self, action: Action, now: f64, config: &Config) {
        if self.state == State::Shelved && now >= self.until {
            self.unshelve(config);
            if matches!(action, Action::Unshelve) {
                return;
            }
        }
        match action {
            Action::Observe(Unknown) | Action::Wait(_) => {}
            Action::Observe(observation) => {
                let before = self.condition(config);
                self.seen.push(observation);
                self.state = match (self.state, before, self.condition(config)) {
                    (State::Normal | State::ReturnedUnacknowledged, false, true) => State::Unacknowledged,
                    (State::Unacknowledged, true, false) => State::ReturnedUnacknowledged,
                    (State::Acknowledged, true, false) => State::Normal,
                    (state, _, _) => state,
                };
            }
            Action::Acknowledge => {
                self.state = match self.state {
                    State::Unacknowledged => State::Acknowledged,
                    State::ReturnedUnacknowledged => State::Normal,
                    state => state,
                };
            }
            Action::Shelve(duration) => (self.state, self.until) = (State::Shelved, now + duration),
            Action::Unshelve if self.state == State::Shelved => self.unshelve(config),
            Action::Unshelve => {}
        }
    }

    fn unshelve(&mut self, config: &Config) {
        self.state = if self.condition(config) { State::Unacknowledged } else { State::Normal };
    }
}

proptest! {
    #[test]
    fn follows_the_diagram(
        actions in actions(),
        (n, k) in (1usize..5).prop_flat_map(|n| (Just(n), 1..=n)),
        (clear_n, clear_k) in (1usize..5).prop_flat_map(|n| (Just(n), 1..=n)),
        restart_every in 1usize..6,
    ) {
        let config = Config { k, n, clear_k, clear_n, ..Config::default() };
        let mut alarm = Alarm::new(config.clone());
        let mut oracle = Oracle { state: State::Normal, until: 0.0, seen: Vec::new() };
        let mut now = 0.0;
        for (count, action) in actions.into_iter().enumerate() {
            // A restart in between changes nothing.
            if count % restart_every == 0 {
                alarm = Alarm::restored(config.clone(), alarm.saved());
            }
            now += if let Action::Wait(duration) = action { duration } else { 1.0 };
            let before = alarm.state();
            let taken = match action {
                Action::Observe(observation) => alarm.observe(observation, now),
                Action::Acknowledge => alarm.acknowledge(now).unwrap_or_default(),
                Action::Shelve(duration) => alarm.shelve(duration, now).unwrap_or_default(),
                Action::Unshelve => alarm.unshelve(now).unwrap_or_default(),
                Action::Wait(_) => alarm.tick(now),
            };
            oracle.step(action, now, &config);
            prop_assert_eq!(alarm.state(), oracle.state, "after {:?}", action);
            prop_assert_eq!(alarm.is_active(), oracle.condition(&config));
            // The transitions told to the outside are a chain from the old state to the new one.
            let end = taken.iter().try_fold(before, |at, t| (t.from == at && t.at == now).then_some(t.to));
            if matches!(action, Action::Acknowledge) && taken.is_empty() {
                continue; // a refused acknowledgement may still have let a shelving run out
            }
            prop_assert_eq!(end, Some(alarm.state()));
        }
    }
}
