//! Those who are told of alarms, and what never reached them, as JSON.

use super::rfc3339;
use crate::serve::{DeadLetter, ReceiverState};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Those who are told.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ReceiverList {
    /// When.
    pub time: Option<String>,
    /// By name.
    pub items: Vec<ReceiverItem>,
}

/// One of them.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ReceiverItem {
    /// Its name.
    pub name: String,
    /// `webhook`, `alertmanager`, `smtp` or `mqtt`.
    pub kind: &'static str,
    /// `working` or `failing`: whether the last attempt was taken.
    pub state: &'static str,
    /// Why it was not; null while it works.
    pub reason: Option<String>,
    /// Since when; null while it works.
    pub since: Option<String>,
    /// When it last took something.
    pub last_sent: Option<String>,
    /// Messages that it took, since the start.
    pub sent: u64,
    /// Attempts that failed, since the start.
    pub failed: u64,
    /// Changes that were counted in a message instead of told one by one, or not told, since the start.
    pub dropped: u64,
    /// What waits now.
    pub queue: u64,
    /// Messages that never arrived.
    pub dead_letters: u64,
}

impl From<ReceiverState> for ReceiverItem {
    fn from(own: ReceiverState) -> Self {
        let (reason, since) = own.failing.unzip();
        Self {
            name: own.name,
            kind: own.kind,
            state: if reason.is_some() { "failing" } else { "working" },
            reason,
            since: since.and_then(rfc3339),
            last_sent: own.sent_at.and_then(rfc3339),
            sent: own.sent,
            failed: own.failed,
            dropped: own.dropped,
            queue: own.queue,
            dead_letters: own.dead_letters,
        }
    }
}

/// Messages that never arrived.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct DeadLetterList {
    /// Oldest first.
    pub items: Vec<DeadLetterItem>,
}

/// One of them.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct DeadLetterItem {
    /// Its name, which the receiver hears too.
    pub id: String,
    /// When it was made.
    pub made: Option<String>,
    /// Since when it is dead.
    pub dead_since: Option<String>,
    /// Attempts that failed.
    pub attempts: u32,
    /// Why the last one did.
    pub reason: String,
    /// What it says, as it was to be sent.
    pub body: String,
}

impl From<DeadLetter> for DeadLetterItem {
    fn from(letter: DeadLetter) -> Self {
        Self {
            id: letter.id,
            made: rfc3339(letter.made),
            dead_since: letter.dead_since.and_then(rfc3339),
            attempts: letter.attempts,
            reason: letter.why,
            body: letter.body,
        }
    }
}

/// What is sent once more.
#[derive(Clone, Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ReplayBody {
    /// The name of one dead letter; all of them where it is left out.
    pub id: Option<String>,
}

/// What was asked for.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Replayed {
    /// Messages that wait to be sent once more.
    pub replayed: usize,
}

/// How many are told, and how many of them fail.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PostHealth {
    /// Those who are told.
    pub receivers: usize,
    /// Those whose last attempt was not taken.
    pub failing: usize,
    /// Messages that never arrived.
    pub dead_letters: u64,
}

impl From<Vec<ReceiverState>> for PostHealth {
    fn from(all: Vec<ReceiverState>) -> Self {
        Self {
            receivers: all.len(),
            failing: all.iter().filter(|own| own.failing.is_some()).count(),
            dead_letters: all.iter().map(|own| own.dead_letters).sum(),
        }
    }
}
