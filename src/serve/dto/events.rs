//! Events as JSON, one kind per SSE event name.

use super::loops::RunItem;
use super::params::{AlarmKind, AlarmPriority, AlarmState};
use super::rfc3339;
use super::writeback::WritebackNews;
use crate::results::Event;
use serde::Serialize;
use utoipa::ToSchema;

/// What an SSE event carries.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub enum EventData {
    /// `hello`: the stream is open.
    Hello {
        /// Plant time.
        time: Option<String>,
        /// Whether it goes on where the client was: what it missed follows. Otherwise fetch the loops.
        resumed: bool,
    },
    /// `reset`: what happened since the client was here is not known any more; fetch the loops again.
    Reset {
        /// How many events; null when the id is of another run of the daemon, or none at all.
        lost: Option<u64>,
    },
    /// `diagnosis`: a run has ended.
    Diagnosis(DiagnosisEvent),
    /// `alarm`: an alarm has changed its state.
    Alarm {
        /// The alarm.
        id: String,
        /// Which loop; null for a collector's.
        #[serde(rename = "loop")]
        control_loop: Option<String>,
        /// What it is about.
        kind: AlarmKind,
        /// How soon somebody has to act.
        priority: AlarmPriority,
        /// Raised in a flood.
        grouped: bool,
        /// What the condition is, in one line.
        detail: String,
        /// Before.
        from: AlarmState,
        /// After.
        to: AlarmState,
        /// When.
        time: Option<String>,
        /// Why.
        cause: String,
    },
    /// `writeback`: something happened to a loop's write-back.
    Writeback(WritebackEvent),
    /// `backfill`: the job over a loop's past has come further.
    Backfill {
        /// Which loop.
        #[serde(rename = "loop")]
        control_loop: String,
        /// `reading`, `diagnosing`, `done`, `cancelled` or `failed`.
        phase: String,
        /// Slices read or windows diagnosed.
        done: usize,
        /// Of how many.
        of: usize,
    },
    /// `reloaded`: another configuration is in force; fetch the loops again.
    Reloaded {
        /// Loops now watched.
        loops: usize,
    },
    /// `lagged`: this client was too slow and lost events; fetch the loops again.
    Lagged {
        /// How many.
        lost: u64,
    },
    /// `bye`: the daemon stops.
    Bye {},
}

/// A run of a loop that has ended.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct DiagnosisEvent {
    /// Which loop.
    pub r#loop: String,
    /// In a few numbers.
    #[serde(flatten)]
    pub run: RunItem,
}

/// What happened to a loop's write-back.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct WritebackEvent {
    /// Which loop.
    pub r#loop: String,
    /// What.
    #[serde(flatten)]
    pub news: WritebackNews,
}

impl EventData {
    /// The SSE event name.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Hello { .. } => "hello",
            Self::Reset { .. } => "reset",
            Self::Diagnosis(_) => "diagnosis",
            Self::Alarm { .. } => "alarm",
            Self::Writeback(_) => "writeback",
            Self::Backfill { .. } => "backfill",
            Self::Reloaded { .. } => "reloaded",
            Self::Lagged { .. } => "lagged",
            Self::Bye {} => "bye",
        }
    }
}

impl From<Event> for EventData {
    fn from(event: Event) -> Self {
        match event {
            Event::Run(id, summary) => {
                Self::Diagnosis(DiagnosisEvent { r#loop: id.to_string(), run: RunItem::from(&summary) })
            }
            Event::Alarm(change) => Self::Alarm {
                id: change.id.to_string(),
                control_loop: change.id.of_loop().map(ToString::to_string),
                kind: change.id.kind.into(),
                priority: change.priority.into(),
                grouped: change.grouped,
                detail: change.detail.clone(),
                from: change.transition.from.into(),
                to: change.transition.to.into(),
                time: rfc3339(change.transition.at),
                cause: change.transition.cause.as_str().to_string(),
            },
            Event::Writeback(id, news) => {
                Self::Writeback(WritebackEvent { r#loop: id.to_string(), news: WritebackNews::from(&news) })
            }
            Event::Backfill { id, phase, done, of } => {
                Self::Backfill { control_loop: id.to_string(), phase: phase.to_string(), done, of }
            }
            Event::Reloaded { loops } => Self::Reloaded { loops },
        }
    }
}
