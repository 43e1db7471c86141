//! Health as JSON.

use super::notifications::PostHealth;
use super::{finite, rfc3339};
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
    /// Those who are told of alarms; null where nobody is.
    pub notifications: Option<PostHealth>,
}

/// How the store is. A daemon whose store fails goes on: nothing it measures is kept meanwhile but in memory.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct StoreHealth {
    /// `working`, `spooling` while what is new waits on disk for a database that is away or takes what waited, or `failing`.
    pub state: &'static str,
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
        let state = match (&store.failing, &store.spooling) {
            (Some(_), _) => "failing",
            (None, Some(_)) => "spooling",
            (None, None) => "working",
        };
        let failing = store.failing.as_ref().or(store.spooling.as_ref());
        Self {
            state,
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
