//! What is said of sticking loops while terms of write-back act on their valves.

use std::collections::{BTreeMap, BTreeSet};
use stictiond::alarm::{Kind, State, Transition};
use stictiond::compensation::gate;
use stictiond::results::{Event, Summary};
use stictiond::signal::LoopId;
use tokio::sync::broadcast::{Receiver, error::TryRecvError};

/// A diagnosis that ends so much later than a term began (s of plant time) was begun under the term: the demo diagnoses a loop
/// every 10 s on the wall, in which 200 s of plant time pass.
const BEGUN_UNDER_S: f64 = 200.0;

/// What the events of the daemon say of loops under terms.
#[derive(Default)]
pub struct Terms {
    /// Since when a term acts (s).
    since: BTreeMap<LoopId, f64>,
    /// Diagnoses under a term.
    diagnosed: BTreeMap<LoopId, usize>,
    /// Loops whose alarm on stiction stands.
    standing: BTreeSet<LoopId>,
    /// What must not be said.
    wrong: Vec<String>,
}

impl Terms {
    /// Takes every event that has come.
    pub fn drain(&mut self, events: &mut Receiver<Event>) {
        loop {
            match events.try_recv() {
                Ok(event) => self.take(&event),
                Err(TryRecvError::Empty) => return,
                Err(error) => panic!("events are missing: {error}"),
            }
        }
    }

    fn take(&mut self, event: &Event) {
        match event {
            Event::Writeback(id, gate::News { at, event: gate::Event::Moved { to, .. }, .. }) => {
                if to.writes() {
                    self.since.entry(id.clone()).or_insert(*at);
                } else {
                    self.since.remove(id);
                }
            }
            Event::Run(id, run) if self.is_under_term(id, run) => {
                *self.diagnosed.entry(id.clone()).or_default() += 1;
                if run.outcome == "no_stiction" {
                    self.wrong.push(format!("{id} under a term: no_stiction, {}", run.reason));
                }
            }
            Event::Alarm(change) if change.id.kind == Kind::Stiction => {
                self.alarm(&change.id.subject, change.transition);
            }
            _ => {}
        }
    }

    /// Whether it says itself that a term acted, or must have been made of samples under one.
    fn is_under_term(&self, id: &LoopId, run: &Summary) -> bool {
        let since = self.since.get(id);
        run.compensated.is_some() || since.is_some_and(|since| run.time > since + BEGUN_UNDER_S)
    }

    fn alarm(&mut self, id: &LoopId, Transition { from, to, .. }: Transition) {
        if [State::Unacknowledged, State::Acknowledged].contains(&to) {
            self.standing.insert(id.clone());
            return;
        }
        // Silence says nothing of the condition.
        if to.is_silent() {
            return;
        }
        self.standing.remove(id);
        if self.since.contains_key(id) {
            self.wrong.push(format!(
                "{id} under a term: its alarm goes from {} to {}",
                from.as_str(),
                to.as_str()
            ));
        }
    }

    /// Diagnoses of a loop under a term.
    pub fn diagnosed(&self, id: &LoopId) -> usize {
        self.diagnosed.get(id).copied().unwrap_or(0)
    }

    /// Loops under a term whose alarm stands.
    pub fn alarms(&self) -> usize {
        self.standing.iter().filter(|id| self.since.contains_key(*id)).count()
    }

    /// What was said and must not be; empty where nothing was.
    pub fn wrong(&self) -> &[String] {
        &self.wrong
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use stictiond::alarm::{AlarmId, Cause, Priority};
    use stictiond::results::{AlarmChange, Compensated, Seen, Trigger};

    fn id() -> LoopId {
        LoopId::new("FIC102")
    }

    fn moved(from: gate::State, to: gate::State) -> Event {
        let event = gate::Event::Moved { from, to, cause: gate::Cause::Opened, by: None };
        Event::Writeback(id(), gate::News { at: 1000.0, event, tripped_by: None })
    }

    fn run(time: f64, outcome: &'static str, compensated: bool) -> Event {
        let summary = Summary {
            time,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            outcome: outcome.into(),
            reason_code: None,
            reason: "made for a test".into(),
            f: None,
            f_ci95: None,
            f_in_percent: true,
            delta_aic: None,
            compensated: compensated.then_some(Compensated { f_before: Some(2.5), seen: Seen::Hidden }),
        };
        Event::Run(id(), summary)
    }

    fn alarm(from: State, to: State, cause: Cause) -> Event {
        Event::Alarm(Arc::new(AlarmChange {
            number: 1,
            id: AlarmId::new(id(), Kind::Stiction),
            transition: Transition { from, to, at: 1500.0, cause },
            priority: Priority::High,
            grouped: false,
            detail: String::new(),
            by: None,
            comment: None,
            told: false,
        }))
    }

    /// Under a term that began at 1000 s, with an alarm that stood before.
    fn under_term() -> Terms {
        let mut terms = Terms::default();
        terms.take(&alarm(State::Normal, State::Unacknowledged, Cause::Raised));
        terms.take(&moved(gate::State::Armed, gate::State::Active));
        terms
    }

    #[test]
    fn a_diagnosis_under_a_term_must_not_say_that_the_valve_is_sound() {
        let mut terms = under_term();
        terms.take(&run(1100.0, "no_stiction", false));
        terms.take(&run(1150.0, "not_identifiable", true));
        terms.take(&run(1350.0, "stiction", true));
        assert_eq!((terms.diagnosed(&id()), terms.alarms(), terms.wrong().len()), (2, 1, 0));
        // Whether or not it knows of the term.
        terms.take(&run(1550.0, "no_stiction", true));
        terms.take(&run(1750.0, "no_stiction", false));
        assert_eq!((terms.diagnosed(&id()), terms.wrong().len()), (4, 2), "{:?}", terms.wrong());
        terms.take(&moved(gate::State::Withdrawing, gate::State::Shadow));
        terms.take(&run(2550.0, "no_stiction", false));
        assert_eq!((terms.diagnosed(&id()), terms.wrong().len()), (4, 2));
    }

    #[test]
    fn an_alarm_must_not_return_under_a_term() {
        let gone = alarm(State::Unacknowledged, State::ReturnedUnacknowledged, Cause::Cleared);
        let mut terms = under_term();
        terms.take(&moved(gate::State::Active, gate::State::Withdrawing));
        terms.take(&alarm(State::Unacknowledged, State::Acknowledged, Cause::Acknowledged));
        assert_eq!((terms.alarms(), terms.wrong().len()), (1, 0));
        terms.take(&gone);
        assert_eq!((terms.alarms(), terms.wrong().len()), (0, 1), "{:?}", terms.wrong());
        let mut before = Terms::default();
        before.take(&gone);
        assert_eq!(before.wrong().len(), 0);
    }
}
