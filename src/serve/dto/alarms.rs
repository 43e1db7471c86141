//! Alarms as JSON.

use super::params::{AlarmKind, AlarmPriority, AlarmState};
use super::rfc3339;
use crate::alarm::{AlarmId, FloodView, Kind, Priority, State};
use crate::results::{AlarmChange, AlarmView};
use serde::Serialize;
use utoipa::ToSchema;

/// An alarm.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmItem {
    /// Its name, for good: the loop or collector, and the kind, with a slash between.
    pub id: String,
    /// The loop it is about; null for a collector's.
    pub r#loop: Option<String>,
    /// The collector it is about; null for a loop's.
    pub device: Option<String>,
    /// What it is about.
    pub kind: AlarmKind,
    /// How soon somebody has to act.
    pub priority: AlarmPriority,
    /// What the operator sees.
    pub state: AlarmState,
    /// Whether the condition holds, silent or not.
    pub active: bool,
    /// What the condition is, in one line; empty before it ever held.
    pub detail: String,
    /// When the state last changed; null when it never did.
    pub since: Option<String>,
    /// When the condition was last raised.
    pub raised_at: Option<String>,
    /// Until when it is shelved.
    pub shelved_until: Option<String>,
    /// Shelved until its condition goes.
    pub one_shot: bool,
    /// Raised so often lately that it says nothing any more.
    pub chattering: bool,
    /// Its condition has held for very long.
    pub stale: bool,
    /// Raised in a flood: nobody was called for it alone.
    pub grouped: bool,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

/// An alarm after somebody has acted.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmActed {
    /// The alarm.
    #[serde(flatten)]
    pub alarm: AlarmItem,
    /// Whether that is durable: false without a store, or while it fails.
    pub survives_restart: bool,
}

/// Alarms.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmList {
    /// When.
    pub time: Option<String>,
    /// Alarms that pass the filters, on all pages.
    pub total: usize,
    /// Alarms that wait for somebody to acknowledge them, in whatever state they are, and whatever the filters.
    pub to_acknowledge: usize,
    /// The alarms of this page, by name.
    pub items: Vec<AlarmItem>,
    /// `after` of the next page; null on the last.
    pub next: Option<String>,
    /// Whether more are raised than anybody can look at.
    pub flood: FloodItem,
}

/// More alarms than anybody can look at.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct FloodItem {
    /// Since when; null while there is none.
    pub since: Option<String>,
    /// Alarms grouped in it, or in the last one.
    pub grouped: usize,
    /// Alarms raised within `flood_s`.
    pub recent: usize,
}

/// The changes of alarms that are remembered.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmHistory {
    /// Newest first.
    pub items: Vec<AlarmChangeItem>,
    /// `after` for the next page; null on the last.
    pub next: Option<u64>,
}

/// A change of an alarm.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmChangeItem {
    /// The alarm.
    pub id: String,
    /// The loop it is about; null for a collector's.
    pub r#loop: Option<String>,
    /// What it is about.
    pub kind: AlarmKind,
    /// How soon somebody has to act.
    pub priority: AlarmPriority,
    /// When.
    pub time: Option<String>,
    /// State before.
    pub from: AlarmState,
    /// State after.
    pub to: AlarmState,
    /// Why: `raised`, `cleared`, `acknowledged`, ….
    pub cause: String,
    /// What the condition is, in one line.
    pub detail: String,
    /// Raised in a flood.
    pub grouped: bool,
    /// Who did it, where somebody did.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

fn of_loop(id: &AlarmId) -> Option<String> {
    id.of_loop().map(ToString::to_string)
}

impl From<&AlarmChange> for AlarmChangeItem {
    fn from(change: &AlarmChange) -> Self {
        Self {
            id: change.id.to_string(),
            r#loop: of_loop(&change.id),
            kind: change.id.kind.into(),
            priority: change.priority.into(),
            time: rfc3339(change.transition.at),
            from: change.transition.from.into(),
            to: change.transition.to.into(),
            cause: change.transition.cause.as_str().to_string(),
            detail: change.detail.clone(),
            grouped: change.grouped,
            by: change.by.clone(),
            comment: change.comment.clone(),
        }
    }
}

impl From<&AlarmView> for AlarmItem {
    fn from(view: &AlarmView) -> Self {
        Self {
            id: view.id.to_string(),
            r#loop: of_loop(&view.id),
            device: view.id.kind.of_device().then(|| view.id.subject.to_string()),
            kind: view.id.kind.into(),
            priority: view.priority.into(),
            state: view.state.into(),
            active: view.active,
            detail: view.detail.clone(),
            since: view.since.and_then(rfc3339),
            raised_at: view.raised_at.and_then(rfc3339),
            shelved_until: view.shelved_until.and_then(rfc3339),
            one_shot: view.one_shot,
            chattering: view.chattering,
            stale: view.stale,
            grouped: view.grouped,
            by: view.by.clone(),
            comment: view.comment.clone(),
        }
    }
}

impl From<FloodView> for FloodItem {
    fn from(view: FloodView) -> Self {
        Self { since: view.since.and_then(rfc3339), grouped: view.grouped, recent: view.recent }
    }
}

/// A name, as the API writes it, in words.
fn words(name: impl Serialize) -> String {
    let name = serde_json::to_value(name).ok();
    name.as_ref().and_then(|name| name.as_str()).unwrap_or_default().replace(['-', '_'], " ")
}

impl AlarmState {
    /// Its name in words.
    pub fn words(self) -> String {
        words(self)
    }
}

impl AlarmKind {
    /// What an alarm of this kind is about.
    pub fn words(self) -> &'static str {
        Kind::ALL.into_iter().find(|kind| Self::from(*kind) == self).map_or("", Kind::words)
    }
}

impl From<State> for AlarmState {
    fn from(state: State) -> Self {
        match state {
            State::Normal => Self::Normal,
            State::Unacknowledged => Self::Unacknowledged,
            State::Acknowledged => Self::Acknowledged,
            State::ReturnedUnacknowledged => Self::ReturnedUnacknowledged,
            State::LatchedUnacknowledged => Self::LatchedUnacknowledged,
            State::LatchedAcknowledged => Self::LatchedAcknowledged,
            State::Shelved => Self::Shelved,
            State::SuppressedByDesign => Self::SuppressedByDesign,
            State::OutOfService => Self::OutOfService,
        }
    }
}

impl From<Kind> for AlarmKind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Stiction => Self::Stiction,
            Kind::FRising => Self::FRising,
            Kind::NotIdentifiable => Self::NotIdentifiable,
            Kind::TagBad => Self::TagBad,
            Kind::CollectorDown => Self::CollectorDown,
            Kind::CompensationTripped => Self::CompensationTripped,
            Kind::UnexplainedResidual => Self::UnexplainedResidual,
        }
    }
}

impl From<Priority> for AlarmPriority {
    fn from(priority: Priority) -> Self {
        match priority {
            Priority::Low => Self::Low,
            Priority::Medium => Self::Medium,
            Priority::High => Self::High,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_calls_each_kind_as_reports_do() {
        let page = include_str!("../page/assets/js/states.js");
        let (_, list) = page.split_once("const ALARMS = {").expect("the page's list");
        for kind in Kind::ALL {
            let line = format!("{}: \"{}\"", kind.as_str(), AlarmKind::from(kind).words());
            assert!(list.contains(&line), "{line}");
        }
    }
}
