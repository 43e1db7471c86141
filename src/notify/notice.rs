//! What is told of one change of an alarm, and where it is looked up.

use super::filter::What;
use super::outlet::{News, Outlet};
use crate::alarm::{AlarmId, Cause, Kind, Priority, State, Transition};
use crate::results::{AlarmChange, AlarmView, Results, f_unit};
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
    /// What the condition is, in one line.
    pub detail: String,
    /// Friction of its loop, by the latest diagnosis.
    pub friction: Option<Friction>,
    /// Who did it, where somebody did.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
    /// Raised in a flood.
    pub grouped: bool,
    /// The loop that its own is expected to calm down with.
    pub swings_with: Option<LoopId>,
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
            Cause::Raised => Some(What::Raised),
            Cause::Cleared => Some(What::Latched),
            Cause::Acknowledged => Some(What::Acknowledged),
            _ => None,
        },
        (false, false) => match transition.cause {
            Cause::Acknowledged => Some(What::Acknowledged),
            Cause::Shelved | Cause::Suppressed | Cause::TakenOut => Some(What::Silenced),
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
        match alarm.of_loop() {
            Some(id) => places.loops.get(id).filter(|group| !group.is_empty()).cloned().into_iter().collect(),
            None => places.devices.get(&alarm.subject).cloned().unwrap_or_default(),
        }
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

    /// The loop with which that of an alarm is expected to calm down. What its own valve or signal says is its own.
    pub(super) fn swings_with(&self, alarm: &AlarmId) -> Option<LoopId> {
        let follows = matches!(alarm.kind, Kind::UnexplainedResidual | Kind::NotIdentifiable);
        alarm.of_loop().filter(|_| follows).and_then(|id| self.results.swings_with(id))
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

/// A kind as a person reads it.
pub(super) fn words(kind: Kind) -> &'static str {
    match kind {
        Kind::Stiction => "the valve sticks",
        Kind::FRising => "friction rises",
        Kind::NotIdentifiable => "cannot be judged",
        Kind::TagBad => "a tag is bad",
        Kind::CollectorDown => "the collector is down",
        Kind::CompensationTripped => "write-back was closed by a fault",
        Kind::UnexplainedResidual => "much is unexplained",
    }
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
    fn a_name_becomes_one_part_of_an_address() {
        assert_eq!(escaped("FIC 101/ä"), "FIC%20101%2F%C3%A4");
    }
}
