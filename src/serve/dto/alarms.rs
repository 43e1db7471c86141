//! Alarms as JSON.

use super::params::AlarmState;
use super::rfc3339;
use crate::alarm::State;
use crate::results::{AlarmChange, AlarmView};
use serde::Serialize;
use utoipa::ToSchema;

/// The alarm of one loop.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmItem {
    /// The loop, which names the alarm.
    pub id: String,
    /// What the operator sees.
    pub state: AlarmState,
    /// Whether the condition holds, shelved or not.
    pub active: bool,
    /// When the state last changed; null when it never did.
    pub since: Option<String>,
    /// When the condition was last raised.
    pub raised_at: Option<String>,
    /// Until when it is shelved.
    pub shelved_until: Option<String>,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

/// Alarms.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmList {
    /// When.
    pub time: Option<String>,
    /// The alarms, by loop.
    pub items: Vec<AlarmItem>,
}

/// The changes of alarms that are remembered.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmHistory {
    /// Newest first.
    pub items: Vec<AlarmChangeItem>,
}

/// A change of an alarm.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AlarmChangeItem {
    /// The loop, which names the alarm.
    pub id: String,
    /// When.
    pub time: Option<String>,
    /// State before.
    pub from: AlarmState,
    /// State after.
    pub to: AlarmState,
    /// Why: `raised`, `cleared`, `acknowledged`, ….
    pub cause: String,
    /// Who did it, where somebody did.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

impl From<&AlarmChange> for AlarmChangeItem {
    fn from(change: &AlarmChange) -> Self {
        Self {
            id: change.id.to_string(),
            time: rfc3339(change.transition.at),
            from: change.transition.from.into(),
            to: change.transition.to.into(),
            cause: change.transition.cause.as_str().to_string(),
            by: change.by.clone(),
            comment: change.comment.clone(),
        }
    }
}

impl From<&AlarmView> for AlarmItem {
    fn from(view: &AlarmView) -> Self {
        Self {
            id: view.id.to_string(),
            state: view.state.into(),
            active: view.active,
            since: view.since.and_then(rfc3339),
            raised_at: view.raised_at.and_then(rfc3339),
            shelved_until: view.shelved_until.and_then(rfc3339),
            by: view.by.clone(),
            comment: view.comment.clone(),
        }
    }
}

impl AlarmState {
    /// Its name, as the API writes it, in words.
    pub fn words(self) -> String {
        let name = serde_json::to_value(self).ok();
        name.as_ref().and_then(|name| name.as_str()).unwrap_or_default().replace('-', " ")
    }
}

impl From<State> for AlarmState {
    fn from(state: State) -> Self {
        match state {
            State::Normal => Self::Normal,
            State::Unacknowledged => Self::Unacknowledged,
            State::Acknowledged => Self::Acknowledged,
            State::ReturnedUnacknowledged => Self::ReturnedUnacknowledged,
            State::Shelved => Self::Shelved,
        }
    }
}
