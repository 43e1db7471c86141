//! A binary that only reads: in the place of write-back there is nothing to start or to show, and to end only what one that
//! writes left behind.

use super::super::AppError;
use super::super::device::Device;
use super::end_terms;
use crate::audit::Recorder;
use crate::compensation::gate::Status;
use crate::config::Config;
use crate::history::History;
use crate::results::Results;
use crate::schedule::Clock;
use crate::serve::WritebackPort;
use crate::signal::LoopId;
use std::sync::Arc;

pub(in crate::app) struct WritebackControl {
    clock: Clock,
}

impl WritebackControl {
    pub(in crate::app) fn new(_: &Config, clock: Clock, _: &Arc<Results>) -> Result<Arc<Self>, AppError> {
        Ok(Arc::new(Self { clock }))
    }

    pub(in crate::app) fn recorder(&self) -> Option<Arc<Recorder>> {
        None
    }

    pub(in crate::app) fn begin(&self, config: &Config, history: &Arc<History>, _: &[Device]) {
        end_terms(history, config, self.clock.now());
    }

    pub(in crate::app) async fn end(&self) {}
}

impl WritebackPort for WritebackControl {
    fn status(&self, _: &LoopId) -> Option<Status> {
        None
    }

    fn record(&self) -> Option<Arc<Recorder>> {
        self.recorder()
    }
}
