//! What the API may know of write-back, and, in a binary that can write, what an operator may ask of it.

use crate::audit::Recorder;
use crate::compensation::gate::Status;
use crate::signal::LoopId;
use std::sync::Arc;

#[cfg(feature = "writeback")]
use crate::compensation::gate::{Action, Refusal};
#[cfg(feature = "writeback")]
use std::{future::Future, pin::Pin};

/// What became of an operator's action; `None` where the loop has no write-back.
#[cfg(feature = "writeback")]
pub type Acted<'a> = Pin<Box<dyn Future<Output = Option<Result<Status, Refusal>>> + Send + 'a>>;

/// Where write-back is asked.
pub trait WritebackPort: Send + Sync {
    /// A loop's write-back; `None` where it is not enabled.
    fn status(&self, id: &LoopId) -> Option<Status>;

    /// Where write-back is put on record; `None` where nothing is written to the plant.
    fn record(&self) -> Option<Arc<Recorder>>;

    /// An operator acts.
    #[cfg(feature = "writeback")]
    fn act<'a>(&'a self, id: &'a LoopId, action: Action, by: &'a str) -> Acted<'a>;
}
