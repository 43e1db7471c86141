//! What is told of one change of an alarm, and where it is looked up.

use super::filter::What;
use super::outlet::{News, Outlet};
use crate::alarm::{AlarmId, Cause, Kind, Priority, State, Transition};
use crate::results::{AlarmChange, AlarmView, Results, SourceOrder, f_unit};
use crate::signal::LoopId;
use std::collections::HashMap;
use std::sync::{Arc, PoisonError, RwLock};

/// The groups that alarms belong to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Places {
    /// Of each loop.
    pub loops: HashMap<LoopId, String>,
    /// Of the loops that each collector serves.
    pub devices: HashMap<LoopId, Vec<String>>,
    /// Those of before the configuration in force: that an alarm of what is gone is over is told where the alarm was.
    pub before: Option<Arc<Places>>,
}

impl Places {
    /// These from now on, after those that were in force.
    pub fn after(self, before: &Places) -> Self {
        Self { before: Some(Arc::new(Places { before: None, ..before.clone() })), ..self }
    }

    /// The groups that an alarm belongs to; `None` where it is not known here.
    fn of(&self, alarm: &AlarmId) -> Option<Vec<String>> {
        match alarm.of_loop() {
            Some(id) => {
                self.loops.get(id).map(|own| if own.is_empty() { Vec::new() } else { vec![own.clone()] })
            }
            None => self.devices.get(&alarm.subject).cloned(),
        }
    }
}

/// What receivers look things up in.
#[derive(Clone)]
pub struct Source {
    /// Alarms and diagnoses.
    pub results: Arc<Results>,
    /// Groups, as of the configuration in force.
    pub places: Arc<RwLock<Arc<Places>>>,
    /// The daemon's clock (s).
    pub now: Arc<dyn Fn() -> f64 + Send + Sync>,
    /// Name of the plant.
    pub site: Option<String>,
    /// Where people reach the dashboard.
    pub public_url: Option<String>,
    /// Where what is to be told comes from; `None` where this machine is alone: then it tells everything that happens.
    pub outlet: Option<Outlet>,
}

/// How much friction, by the latest diagnosis.
#[derive(Clone, Debug, PartialEq)]
pub struct Friction {
    /// f, in `unit`.
    pub f: f64,
    /// Its 95 % interval, in `unit`.
    pub interval: Option<[f64; 2]>,
    /// `% OP` or `OP units`.
    pub unit: &'static str,
    /// Difference of AIC to the best explanation without friction (-).
    pub evidence: Option<f64>,
}

/// One change of one alarm.
#[derive(Clone, Debug, PartialEq)]
pub struct Notice {
    /// Which.
    pub alarm: AlarmId,
    /// What happened.
    pub what: What,
    /// When (s).
    pub at: f64,
    /// The state since then.
    pub state: State,
    /// How soon somebody has to act.
    pub priority: Priority,
    /// The groups of its loops.
    pub groups: Vec<String>,
    /// When its condition was last raised (s).
    pub raised_at: Option<f64>,
    /// What the condition is, or was when it was last there, in one line.
    pub detail: String,
    /// Friction of its loop, by the latest diagnosis.
    pub friction: Option<Friction>,
    /// Who did it, where somebody did.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
    /// Raised in a flood.
    pub grouped: bool,
    /// The order on the loop that its own may calm down with.
    pub swings_with: Option<SourceOrder>,
    /// Where people see it.
    pub link: Option<String>,
}

/// Whether an alarm wants somebody to do something.
pub(super) fn stands(state: State) -> bool {
    use State::{Acknowledged, LatchedAcknowledged, LatchedUnacknowledged, Unacknowledged};
    matches!(state, Unacknowledged | Acknowledged | LatchedUnacknowledged | LatchedAcknowledged)
}

/// What a transition is to somebody outside; `None` where it says nothing new.
pub(super) fn what(transition: &Transition) -> Option<What> {
    match (stands(transition.from), stands(transition.to)) {
        (false, true) => Some(What::Raised),
        (true, false) if transition.to.is_silent() => Some(What::Silenced),
        (true, false) => Some(What::Cleared),
        (true, true) => match transition.cause {
            Cause::Raised | Cause::MoreUrgent => Some(What::Raised),
            Cause::Cleared => Some(What::Latched),
            Cause::Acknowledged => Some(What::Acknowledged),
            _ => None,
        },
        (false, false) => match transition.cause {
            Cause::Acknowledged => Some(What::Acknowledged),
            // What the configuration suppresses while nothing stands is no event: it says so at every start.
            Cause::Shelved | Cause::TakenOut => Some(What::Silenced),
            _ => None,
        },
    }
}

impl Source {
    /// Hears what is to be told.
    pub(super) fn news(&self) -> News {
        match &self.outlet {
            Some(outlet) => News::Picked(outlet.hear()),
            None => News::All(self.results.subscribe()),
        }
    }

    /// Whether what is to be told is picked by somebody else.
    pub(super) fn is_fed(&self) -> bool {
        self.outlet.is_some()
    }

    /// Whether this machine tells people now.
    pub(super) fn speaks(&self) -> bool {
        self.outlet.as_ref().is_none_or(Outlet::speaks)
    }

    /// The groups that an alarm belongs to.
    pub(super) fn groups(&self, alarm: &AlarmId) -> Vec<String> {
        let places = self.places.read().unwrap_or_else(PoisonError::into_inner).clone();
        places.of(alarm).or_else(|| places.before.as_ref()?.of(alarm)).unwrap_or_default()
    }

    /// Friction of the loop that an alarm is about.
    pub(super) fn friction(&self, alarm: &AlarmId) -> Option<Friction> {
        let summary = self.results.get(alarm.of_loop()?, (self.now)())?.summary?;
        let f = summary.f.filter(|f| f.is_finite())?;
        let finite = |interval: &[f64; 2]| interval.iter().all(|limit| limit.is_finite());
        Some(Friction {
            f,
            interval: summary.f_ci95.filter(finite),
            unit: f_unit(summary.f_in_percent),
            evidence: summary.delta_aic.filter(|evidence| evidence.is_finite()),
        })
    }

    /// The order on the loop with which that of an alarm may calm down. What its own valve or signal says is its own.
    pub(super) fn swings_with(&self, alarm: &AlarmId) -> Option<SourceOrder> {
        let follows = matches!(alarm.kind, Kind::UnexplainedResidual | Kind::NotIdentifiable);
        alarm.of_loop().filter(|_| follows).and_then(|id| self.results.source_order(id))
    }

    /// Where people see an alarm.
    pub(super) fn link(&self, alarm: &AlarmId) -> Option<String> {
        let base = self.public_url.as_ref()?.trim_end_matches('/');
        Some(match alarm.of_loop() {
            Some(id) => format!("{base}/#/loop/{}", escaped(id.as_str())),
            None => format!("{base}/#/alarms"),
        })
    }

    /// What is told of a change; `None` where it says nothing new.
    pub(super) fn notice(&self, change: &AlarmChange) -> Option<Notice> {
        let what = what(&change.transition)?;
        let view = self.results.alarm(&change.id, (self.now)());
        Some(Notice {
            alarm: change.id.clone(),
            what,
            at: change.transition.at,
            state: change.transition.to,
            priority: change.priority,
            groups: self.groups(&change.id),
            raised_at: view.and_then(|view| view.raised_at),
            detail: change.detail.clone(),
            friction: self.friction(&change.id),
            by: change.by.clone(),
            comment: change.comment.clone(),
            grouped: change.grouped && what == What::Raised,
            swings_with: self.swings_with(&change.id),
            link: self.link(&change.id),
        })
    }

    /// All alarms as they are.
    pub(super) fn alarms(&self) -> Vec<AlarmView> {
        self.results.alarms((self.now)())
    }
}

/// A name as a part of an address.
fn escaped(name: &str) -> String {
    let mut out = String::new();
    for byte in name.bytes() {
        match byte {
            b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => out.push(char::from(byte)),
            _ => out += &format!("%{byte:02X}"),
        }
    }
    out
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn notice(id: &str, priority: Priority) -> Notice {
        Notice {
            alarm: AlarmId::named(id),
            what: What::Raised,
            at: 1_767_225_600.0,
            state: State::Unacknowledged,
            priority,
            groups: vec!["unit 10".into()],
            raised_at: Some(1_767_225_600.0),
            detail: "sticks by 2.5 %".into(),
            friction: Some(Friction {
                f: 2.5,
                interval: Some([2.4, 2.6]),
                unit: "% OP",
                evidence: Some(446.0),
            }),
            by: None,
            comment: None,
            grouped: false,
            swings_with: None,
            link: Some("https://plant/#/loop/A".into()),
        }
    }

    /// Of a plant without loops.
    pub fn source() -> Source {
        Source {
            results: Arc::new(Results::new(&[], 5, &crate::alarm::Config::default())),
            places: Arc::default(),
            now: Arc::new(|| 0.0),
            site: None,
            public_url: None,
            outlet: None,
        }
    }

    pub fn change() -> AlarmChange {
        AlarmChange {
            number: 1,
            id: AlarmId::named("L0/stiction"),
            transition: Transition {
                from: State::Normal,
                to: State::Unacknowledged,
                at: 0.0,
                cause: Cause::Raised,
            },
            priority: Priority::Medium,
            grouped: false,
            detail: String::new(),
            by: None,
            comment: None,
            told: false,
        }
    }

    #[test]
    fn what_transitions_are_to_somebody_outside() {
        use State::*;
        let told = |from, to, cause| what(&Transition { from, to, at: 0.0, cause });
        for (from, to, cause, expected) in [
            (Normal, Unacknowledged, Cause::Raised, Some(What::Raised)),
            (ReturnedUnacknowledged, Unacknowledged, Cause::Raised, Some(What::Raised)),
            (LatchedAcknowledged, Unacknowledged, Cause::Raised, Some(What::Raised)),
            (Shelved, Unacknowledged, Cause::Expired, Some(What::Raised)),
            (SuppressedByDesign, LatchedUnacknowledged, Cause::Unsuppressed, Some(What::Raised)),
            (Unacknowledged, Acknowledged, Cause::Acknowledged, Some(What::Acknowledged)),
            (ReturnedUnacknowledged, Normal, Cause::Acknowledged, Some(What::Acknowledged)),
            (Unacknowledged, ReturnedUnacknowledged, Cause::Cleared, Some(What::Cleared)),
            (Acknowledged, Normal, Cause::Cleared, Some(What::Cleared)),
            (Acknowledged, Acknowledged, Cause::MoreUrgent, Some(What::Raised)),
            (LatchedUnacknowledged, Normal, Cause::Forgotten, Some(What::Cleared)),
            (Normal, SuppressedByDesign, Cause::Suppressed, None),
            (Acknowledged, SuppressedByDesign, Cause::Suppressed, Some(What::Silenced)),
            (ReturnedUnacknowledged, Normal, Cause::Forgotten, None),
            (Acknowledged, LatchedAcknowledged, Cause::Cleared, Some(What::Latched)),
            (LatchedAcknowledged, Normal, Cause::Reset, Some(What::Cleared)),
            (Acknowledged, Shelved, Cause::Shelved, Some(What::Silenced)),
            (Normal, OutOfService, Cause::TakenOut, Some(What::Silenced)),
            (Shelved, Normal, Cause::Expired, None),
            (Shelved, OutOfService, Cause::TakenOut, Some(What::Silenced)),
        ] {
            assert_eq!(told(from, to, cause), expected, "{from:?} {to:?}");
        }
    }

    #[test]
    fn what_a_reload_has_taken_out_is_told_in_the_group_where_it_was() {
        let places = |loops: &[(&str, &str)], devices: &[&str]| Places {
            loops: loops.iter().map(|(id, group)| (LoopId::new(*id), group.to_string())).collect(),
            devices: devices.iter().map(|name| (LoopId::new(*name), vec!["unit 10".to_string()])).collect(),
            before: None,
        };
        let groups = |places: &Places, id| places.of(&AlarmId::named(id)).unwrap_or_default();
        let first = places(&[("A", "unit 10"), ("B", "unit 20")], &["dcs"]);
        let second = places(&[("B", ""), ("C", "unit 30")], &[]).after(&first);
        let source = Source { places: Arc::new(RwLock::new(Arc::new(second.clone()))), ..source() };
        for (id, expected) in [
            ("A/stiction", vec!["unit 10"]),
            ("dcs/collector_down", vec!["unit 10"]),
            ("B/stiction", vec![]),
            ("C/stiction", vec!["unit 30"]),
        ] {
            assert_eq!(source.groups(&AlarmId::named(id)), expected, "{id}");
        }
        let third = places(&[("B", "")], &[]).after(&second);
        let before = third.before.as_deref().expect("it is known");
        assert_eq!(groups(before, "A/stiction"), Vec::<String>::new(), "no more than one is remembered");
    }

    #[test]
    fn a_name_becomes_one_part_of_an_address() {
        assert_eq!(escaped("FIC 101/ä"), "FIC%20101%2F%C3%A4");
    }
}
