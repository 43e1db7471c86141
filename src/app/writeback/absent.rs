//! A binary that only reads: in the place of write-back there is nothing to start, to end or to show.

use super::super::AppError;
use super::super::device::Device;
use crate::audit::Recorder;
use crate::compensation::gate::Status;
use crate::config::Config;
use crate::history::History;
use crate::results::Results;
use crate::schedule::Clock;
use crate::serve::WritebackPort;
use crate::signal::LoopId;
use std::sync::Arc;

pub(in crate::app) struct WritebackControl;

impl WritebackControl {
    pub(in crate::app) fn new(_: &Config, _: Clock, _: &Arc<Results>) -> Result<Arc<Self>, AppError> {
        Ok(Arc::new(Self))
    }

    pub(in crate::app) fn recorder(&self) -> Option<Arc<Recorder>> {
        None
    }

    pub(in crate::app) fn begin(&self, _: &Config, _: &Arc<History>, _: &[Device]) {}

    pub(in crate::app) async fn end(&self) {}
}

impl WritebackPort for WritebackControl {
    fn status(&self, _: &LoopId) -> Option<Status> {
        None
    }
}
