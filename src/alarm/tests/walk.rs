//! Random walks against an oracle that knows the diagram as a table of arrows, and nothing of how the alarm is built.

use super::*;

/// What happens to an alarm.
#[derive(Clone, Copy, Debug)]
enum Step {
    Observe(Observation),
    Acknowledge,
    Reset,
    Shelve(f64),
    Once(f64),
    Unshelve,
    Design(bool),
    TakeOut,
    GiveBack,
    Wait(f64),
}

/// Events of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Event {
    Raise,
    Clear,
    ClearLatching,
    Ack,
    Reset,
}

use Event::{Ack, Clear, ClearLatching, Raise};
use State::{
    Acknowledged as C, LatchedAcknowledged as F, LatchedUnacknowledged as E, Normal as A, OutOfService,
    ReturnedUnacknowledged as D, Shelved, SuppressedByDesign, Unacknowledged as B,
};

/// The letters are those of ISA-18.2's own diagram. What is not in the table is no arrow.
const ARROWS: &[(State, Event, State)] = &[
    (A, Raise, B),
    (B, Clear, D),
    (B, ClearLatching, E),
    (B, Ack, C),
    (C, Clear, A),
    (C, ClearLatching, F),
    (D, Raise, B),
    (D, Ack, A),
    (E, Raise, B),
    (E, Ack, F),
    (F, Raise, B),
    (F, Event::Reset, A),
];

/// Where an alarm that was silent comes back to: by condition, and by whether the condition went and stays latched.
const BACK: &[((bool, bool), State)] = &[((true, false), B), ((false, true), E), ((false, false), A)];

/// What is true of the plant and who has silenced the alarm, beside where the walk stands among the loud states.
struct Oracle {
    loud: State,
    condition: bool,
    latched: bool,
    shelved: Option<(f64, bool)>,
    design: bool,
    out: bool,
    /// Observations since the condition changed.
    seen: Vec<Observation>,
    latching: bool,
    config: Config,
}

impl Oracle {
    fn state(&self) -> State {
        match (self.out, self.shelved, self.design) {
            (true, ..) => OutOfService,
            (_, Some(_), _) => Shelved,
            (.., true) => SuppressedByDesign,
            _ => self.loud,
        }
    }

    fn silent(&self) -> bool {
        self.out || self.shelved.is_some() || self.design
    }

    fn arrow(&mut self, event: Event) {
        if let Some((.., to)) = ARROWS.iter().find(|(from, on, _)| *from == self.loud && *on == event) {
            self.loud = *to;
        }
    }

    /// Does something to who silences the alarm, and comes back when nobody does any more.
    fn silence(&mut self, act: impl FnOnce(&mut Self)) {
        let before = self.silent();
        act(self);
        if before && !self.silent() {
            let found = BACK.iter().find(|(when, _)| *when == (self.condition, self.latched));
            self.loud = found.expect("a condition that holds is not latched").1;
        }
    }

    fn turn(&mut self) {
        self.condition = !self.condition;
        self.latched = !self.condition && self.latching;
        self.seen.clear();
        if !self.silent() {
            self.arrow(match (self.condition, self.latching) {
                (true, _) => Raise,
                (false, false) => Clear,
                (false, true) => ClearLatching,
            });
        } else if !self.condition && matches!(self.shelved, Some((_, true))) {
            self.silence(|own| own.shelved = None);
        }
    }

    fn step(&mut self, step: Step, now: f64) {
        let ran_out = matches!(self.shelved, Some((until, _)) if now >= until);
        if ran_out {
            self.silence(|own| own.shelved = None);
        }
        match step {
            Step::Wait(_) | Step::Observe(Unknown) => {}
            Step::Observe(observation) => {
                self.seen.push(observation);
                let (wanted, enough, of) = match self.condition {
                    true => (Absent, self.config.clear_k, self.config.clear_n),
                    false => (Present, self.config.k, self.config.n),
                };
                let recent = &self.seen[self.seen.len().saturating_sub(of)..];
                if recent.iter().filter(|o| **o == wanted).count() >= enough {
                    self.turn();
                }
            }
            Step::Acknowledge if !self.silent() => self.arrow(Ack),
            Step::Reset if !self.silent() => {
                self.latched &= self.loud != F;
                self.arrow(Event::Reset);
            }
            Step::Shelve(duration) if !self.out => self.shelved = Some((now + duration, false)),
            Step::Once(duration) if !self.out && self.condition => {
                self.shelved = Some((now + duration, true))
            }
            Step::Unshelve if !self.out && self.shelved.is_some() => self.silence(|own| own.shelved = None),
            Step::Design(design) => self.silence(|own| own.design = design),
            Step::TakeOut if !self.out => (self.out, self.shelved) = (true, None),
            Step::GiveBack if self.out => self.silence(|own| own.out = false),
            _ => {}
        }
    }
}

/// The step of a number below 46, and of a share of the longest time that it may take. A strategy for each kind of step would
/// take most of the time of the walks.
fn step((kind, share): (u8, f64)) -> Step {
    match kind {
        0..5 => Step::Observe(Present),
        5..10 => Step::Observe(Absent),
        10..15 => Step::Observe(Between),
        15..20 => Step::Observe(Unknown),
        20..26 => Step::Acknowledge,
        26..30 => Step::Reset,
        30..32 => Step::Shelve(1.0 + 19.0 * share),
        32..34 => Step::Once(1.0 + 19.0 * share),
        34..36 => Step::Unshelve,
        36 => Step::Design(true),
        37 => Step::Design(false),
        38..40 => Step::TakeOut,
        40..44 => Step::GiveBack,
        _ => Step::Wait(20.0 * share),
    }
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    proptest::collection::vec((0u8..46, 0.0f64..1.0).prop_map(step), 0..80)
}

fn take(alarm: &mut Alarm, step: Step, now: f64, config: &Config) -> Vec<Transition> {
    let act = match step {
        Step::Observe(observation) => return alarm.observe(observation, Priority::Low, now, config),
        Step::Design(design) => return alarm.suppress(design, "A", now, config),
        Step::Wait(_) => return alarm.tick(now),
        Step::Acknowledge => Action::Acknowledge,
        Step::Reset => Action::Reset,
        Step::Shelve(duration) => Action::Shelve(Shelving::For(duration)),
        Step::Once(duration) => Action::Shelve(Shelving::Once(duration)),
        Step::Unshelve => Action::Unshelve,
        Step::TakeOut => Action::TakeOut,
        Step::GiveBack => Action::GiveBack,
    };
    alarm.act(act, now, config).0
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn follows_the_diagram(
        steps in steps(),
        (n, k) in (1usize..4).prop_flat_map(|n| (Just(n), 1..=n)),
        (clear_n, clear_k) in (1usize..4).prop_flat_map(|n| (Just(n), 1..=n)),
        latching in any::<bool>(),
        restart_every in 1usize..6,
    ) {
        let latch = if latching { vec![Kind::Stiction] } else { vec![] };
        let config = Config { k, n, clear_k, clear_n, latch, ..Config::default() };
        let mut alarm = Alarm::new(Kind::Stiction);
        let mut oracle = Oracle {
            loud: A,
            condition: false,
            latched: false,
            shelved: None,
            design: false,
            out: false,
            seen: Vec::new(),
            latching,
            config: config.clone(),
        };
        let mut now = 0.0;
        for (count, step) in steps.into_iter().enumerate() {
            // A restart in between changes nothing.
            if count % restart_every == 0 {
                alarm = Alarm::restored(Kind::Stiction, &config, alarm.saved());
            }
            now += if let Step::Wait(duration) = step { duration } else { 1.0 };
            let before = alarm.state();
            let taken = take(&mut alarm, step, now, &config);
            oracle.step(step, now);
            prop_assert_eq!(alarm.state(), oracle.state(), "after {:?}", step);
            prop_assert_eq!(alarm.flags().active, oracle.condition);
            // The transitions told to the outside are a chain from the old state to the new one.
            let end = taken.iter().try_fold(before, |at, t| (t.from == at && t.at == now).then_some(t.to));
            prop_assert_eq!(end, Some(alarm.state()), "{:?}", taken);
        }
    }
}
