//! What the API may ask of the past: one job at a time, which reads history and diagnoses it window by window.

use crate::backfill::Timeline;
use crate::signal::LoopId;
use std::sync::Arc;

/// What somebody wants to know of the past.
#[derive(Clone, Debug, PartialEq)]
pub struct BackfillRequest {
    /// Of which loop.
    pub id: LoopId,
    /// From this time on (s).
    pub from: f64,
    /// Up to this time (s).
    pub to: f64,
    /// Length of a window (s); 1,500 sample periods where it is not given.
    pub window_s: Option<f64>,
    /// From one diagnosis to the next (s); a quarter of a window where it is not given.
    pub step_s: Option<f64>,
    /// Whether devices that keep history are read into the store first.
    pub read_devices: bool,
    /// A table of samples in place of the store.
    pub file: Option<BackfillFile>,
}

/// A table of samples in the folder of `[tables]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BackfillFile {
    /// Its name there.
    pub name: String,
    /// What is told of it, by the names of the options.
    pub options: Vec<(String, String)>,
}

/// How far it has come.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BackfillPhase {
    /// History is read from devices, slice by slice.
    Reading,
    /// Windows are diagnosed.
    Diagnosing,
    /// All of them are.
    Done,
    /// Somebody ended it, or the daemon did.
    Cancelled,
    /// Why it ended.
    Failed(String),
}

impl BackfillPhase {
    /// As the API writes it.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Reading => "reading",
            Self::Diagnosing => "diagnosing",
            Self::Done => "done",
            Self::Cancelled => "cancelled",
            Self::Failed(_) => "failed",
        }
    }

    /// Whether it goes on.
    pub fn runs(&self) -> bool {
        matches!(self, Self::Reading | Self::Diagnosing)
    }
}

/// The job, running or ended.
#[derive(Clone, Debug, PartialEq)]
pub struct BackfillRun {
    /// What was wanted.
    pub request: BackfillRequest,
    /// How far it has come.
    pub phase: BackfillPhase,
    /// Slices read or windows diagnosed, of how many.
    pub done: usize,
    /// See `done`.
    pub of: usize,
    /// When it was begun (s).
    pub started: f64,
    /// When it ended (s).
    pub ended: Option<f64>,
    /// What it found.
    pub found: Option<Arc<Timeline>>,
    /// How a file was read.
    pub read_as: Option<String>,
}

/// Why no job is begun.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BackfillRefusal {
    /// One at a time.
    #[error("a backfill runs already; DELETE ends it")]
    Runs,
    /// There is no past without one.
    #[error("no [store] is configured, so there is no past to diagnose")]
    NoStore,
    /// What devices send of that time would not be there any more when it is diagnosed.
    #[error("{0}")]
    TooOld(String),
    /// The file, or what is told of it, cannot be meant.
    #[error("{0}")]
    File(String),
}

/// Where the past is asked for.
pub trait BackfillPort: Send + Sync {
    /// The last job, running or ended; `None` before the first since the start.
    fn job(&self) -> Option<BackfillRun>;

    /// Begins one; called on a thread of the runtime.
    ///
    /// # Errors
    /// [`BackfillRefusal`].
    fn begin(&self, request: BackfillRequest) -> Result<BackfillRun, BackfillRefusal>;

    /// Ends the one that runs; `None` where none does.
    fn cancel(&self) -> Option<BackfillRun>;
}
