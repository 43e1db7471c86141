//! The name of an alarm: whose it is, and of which kind.

use super::config::Kind;
use crate::signal::LoopId;
use std::fmt;

/// Names one alarm, for good: `FIC101/stiction`, `dcs1/collector_down`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct AlarmId {
    /// The loop, or the collector.
    pub subject: LoopId,
    /// What it is about.
    pub kind: Kind,
}

impl AlarmId {
    /// The alarm of this kind of a loop or collector.
    pub fn new(subject: LoopId, kind: Kind) -> Self {
        Self { subject, kind }
    }

    /// The alarm of this name; a name without a kind is a loop's, and means its stiction.
    pub fn named(name: &str) -> Self {
        let with_kind = name.rsplit_once('/').and_then(|(subject, kind)| Some((subject, Kind::named(kind)?)));
        let (subject, kind) = with_kind.unwrap_or((name, Kind::Stiction));
        Self::new(LoopId::new(subject), kind)
    }

    /// The loop it is about; `None` for a collector's.
    pub fn of_loop(&self) -> Option<&LoopId> {
        (!self.kind.of_device()).then_some(&self.subject)
    }
}

impl fmt::Display for AlarmId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}/{}", self.subject, self.kind.as_str())
    }
}
