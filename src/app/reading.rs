//! A binary that only reads: in the place of write-back there is nothing to start, to end or to show.

use super::{AppError, Device};
use crate::audit::Recorder;
use crate::compensation::gate::Status;
use crate::config::Config;
use crate::history::History;
use crate::results::Results;
use crate::schedule::Clock;
use crate::serve::Desk;
use crate::signal::{LoopId, Record};
use std::sync::Arc;

pub(super) struct Writing;

impl Writing {
    pub(super) fn new(_: &Config, _: Clock, _: &Arc<Results>) -> Result<Arc<Self>, AppError> {
        Ok(Arc::new(Self))
    }

    pub(super) fn recorder(&self) -> Option<Arc<Recorder>> {
        None
    }

    pub(super) fn begin(&self, _: &Config, _: &Arc<History>, _: &[Device]) {}

    pub(super) async fn end(&self) {}

    pub(super) fn add_terms(&self, _: &LoopId, _: &mut Record) {}
}

impl Desk for Writing {
    fn status(&self, _: &LoopId) -> Option<Status> {
        None
    }
}
