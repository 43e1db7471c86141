//! Health as JSON.

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
}
