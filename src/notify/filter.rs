//! Which alarms a receiver hears of, and what of them.

use crate::alarm::{Kind, Priority};
use serde::Deserialize;

/// What happened to an alarm, as a receiver chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// It stands now and did not before, or its priority rose.
    Raised,
    /// It stands no longer.
    Cleared,
    /// Somebody has seen it.
    Acknowledged,
    /// It was shelved, suppressed or taken out of service.
    Silenced,
    /// Its condition went and it stays until somebody resets it.
    Latched,
}

impl What {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            What::Raised => "raised",
            What::Cleared => "cleared",
            What::Acknowledged => "acknowledged",
            What::Silenced => "silenced",
            What::Latched => "latched",
        }
    }
}

/// What a receiver hears of when its file does not say.
pub(super) fn usual() -> Vec<What> {
    vec![What::Raised, What::Cleared]
}

/// `filter`: which alarms a receiver hears of; all where it is left out.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Filter {
    /// Of these kinds only; of every kind where it is empty.
    pub kinds: Vec<Kind>,
    /// Of this priority and above.
    pub min_priority: Priority,
    /// Of loops of these groups, and collectors that serve them; of every loop where it is empty.
    pub groups: Vec<String>,
}

impl Default for Filter {
    fn default() -> Self {
        Self { kinds: Vec::new(), min_priority: Priority::Low, groups: Vec::new() }
    }
}

impl Filter {
    /// Whether an alarm is one of them.
    pub fn takes(&self, kind: Kind, priority: Priority, groups: &[String]) -> bool {
        let own = |group: &String| groups.contains(group);
        (self.kinds.is_empty() || self.kinds.contains(&kind))
            && priority >= self.min_priority
            && (self.groups.is_empty() || self.groups.iter().any(own))
    }
}
