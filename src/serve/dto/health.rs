//! Health as JSON.

use super::notifications::PostHealth;
use super::{finite, rfc3339};
use crate::audit::Fault;
use crate::serve::StoreState;
use serde::Serialize;
use utoipa::ToSchema;

/// The process answers.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Health {
    /// Always `ok`: a daemon that is not does not answer.
    pub status: &'static str,
    /// Version of the daemon.
    pub version: &'static str,
    /// Plant time.
    pub time: Option<String>,
    /// Plant time since the start (s).
    pub uptime_s: f64,
    /// The store; null where none is configured.
    pub store: Option<StoreHealth>,
    /// The audit logs; null where none is kept.
    pub audit: Option<AuditHealth>,
    /// Those who are told of alarms; null where nobody is.
    pub notifications: Option<PostHealth>,
}

/// How the audit logs are. While one takes no entries, what needs an entry in it is refused; all else goes on.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct AuditHealth {
    /// `working` or `failing`.
    pub state: &'static str,
    /// One of them was changed or cannot be read: it takes no entry until somebody decides by `stictiond audit renew`.
    pub damaged: bool,
    /// Why it fails, with the file and with what helps; null while it works.
    pub reason: Option<String>,
}

impl AuditHealth {
    /// Of the logs that take no entries, by why.
    pub fn of(faults: &[Fault]) -> Self {
        let reasons: Vec<&str> = faults.iter().map(|fault| fault.reason.as_str()).collect();
        Self {
            state: if faults.is_empty() { "working" } else { "failing" },
            damaged: faults.iter().any(|fault| fault.is_damaged),
            reason: (!faults.is_empty()).then(|| reasons.join("; ")),
        }
    }
}

/// How the store is. A daemon whose store fails goes on: nothing it measures is kept meanwhile but in memory.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct StoreHealth {
    /// `working`, `checking` while it works and not all of it was compared with its checksums since the start, `spooling` while
    /// what is new waits on disk for a database that is away or takes what waited, or `failing`.
    pub state: &'static str,
    /// It fails because it is damaged: nothing is written until somebody decides by `stictiond store check --repair`.
    pub damaged: bool,
    /// Records of states of alarms, their changes and models that were lost by that, as far as it is known.
    pub lost_states: u64,
    /// Share that was compared with its checksums since the start (0..1); null once all of it was, and while it fails.
    pub checked: Option<f64>,
    /// Why it fails or spools; null while it works.
    pub reason: Option<String>,
    /// Since when; null while it works.
    pub since: Option<String>,
    /// When something was last made durable.
    pub written: Option<String>,
    /// Share of the room it may take that is in use (0..1).
    pub used: Option<f64>,
}

impl From<&StoreState> for StoreHealth {
    fn from(store: &StoreState) -> Self {
        let state = match (&store.failing, &store.spooling, store.checked) {
            (Some(_), ..) => "failing",
            (None, Some(_), _) => "spooling",
            (None, None, Some(_)) => "checking",
            (None, None, None) => "working",
        };
        let failing = store.failing.as_ref().or(store.spooling.as_ref());
        Self {
            state,
            damaged: store.is_damaged,
            lost_states: store.lost_states,
            checked: store.checked.and_then(finite),
            reason: failing.map(|(reason, _)| reason.clone()),
            since: failing.and_then(|(_, since)| rfc3339(*since)),
            written: store.written_at.and_then(rfc3339),
            used: finite(store.used_bytes as f64 / store.max_bytes as f64),
        }
    }
}

/// Whether what the daemon shows can be used.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Readiness {
    /// Data arrives and diagnoses have run.
    pub ready: bool,
    /// What is missing; empty when ready.
    pub missing: Vec<String>,
    /// Loops watched.
    pub loops: usize,
    /// Loops of which a good sample of OP and of PV has arrived.
    pub loops_with_data: usize,
    /// Loops diagnosed at least once.
    pub loops_diagnosed: usize,
    /// The store, which does not decide whether it is ready; null where none is configured.
    pub store: Option<StoreHealth>,
}
