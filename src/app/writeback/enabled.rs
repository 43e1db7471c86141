//! Wires write-back: what a loop's gate sees, where its term goes, and who hears of it.

use super::super::AppError;
use super::super::device::Device;
use crate::audit::Recorder;
use crate::compensation::gate::{Action, Evidence, Inputs, Status, Time};
use crate::config::{self, Config};
use crate::diagnosis::Verdict;
use crate::history::{History, TagKind};
use crate::results::Results;
use crate::schedule::Clock;
use crate::serve::{Acted, WritebackPort};
use crate::signal::{LoopId, Role};
use crate::writeback::{Clocks, Look, LoopSetup, Tell, Writeback};
use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;
use tokio::sync::watch;

/// Write-back of the daemon, across reloads.
pub(in crate::app) struct WritebackControl {
    clock: Clock,
    results: Arc<Results>,
    recorder: RwLock<Option<Arc<Recorder>>>,
    current: RwLock<Option<Arc<Writeback>>>,
}

impl WritebackControl {
    /// Opens the audit log where a loop enables write-back.
    pub(in crate::app) fn new(
        config: &Config,
        clock: Clock,
        results: &Arc<Results>,
    ) -> Result<Arc<Self>, AppError> {
        let writeback =
            Self { clock, results: results.clone(), recorder: RwLock::default(), current: RwLock::default() };
        writeback.open(config)?;
        Ok(Arc::new(writeback))
    }

    fn open(&self, config: &Config) -> Result<(), AppError> {
        let mut recorder = self.recorder.write().unwrap_or_else(PoisonError::into_inner);
        let enabled = config.loops.iter().any(|own| own.writeback.as_ref().is_some_and(|own| own.enabled));
        if let (true, None, Some(path)) = (enabled, recorder.as_ref(), &config.writeback.audit_file) {
            let bounds = crate::audit::Bounds {
                max_bytes: config.writeback.audit_max_bytes,
                keep_files: config.writeback.audit_keep_files,
            };
            *recorder = Some(Arc::new(Recorder::start(path, bounds, self.clock.now())?));
        }
        Ok(())
    }

    /// The audit log, where a loop enables write-back.
    pub(in crate::app) fn recorder(&self) -> Option<Arc<Recorder>> {
        self.recorder.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Starts every loop that enables it, in shadow.
    pub(in crate::app) fn begin(&self, config: &Config, history: &Arc<History>, devices: &[Device]) {
        if let Err(error) = self.open(config) {
            tracing::error!(%error, "write-back stays off");
        }
        let Some(recorder) = self.recorder() else { return };
        let setups: Vec<LoopSetup> =
            config.loops.iter().filter_map(|own| self.setup(config, own, history, devices)).collect();
        let clock = self.clock;
        let clocks: Clocks =
            Arc::new(move || Time { mono: clock.elapsed().as_secs_f64(), wall: clock.now() });
        let results = self.results.clone();
        let tell: Tell = Arc::new(move |id, news| {
            tracing::info!(%id, ?news, "write-back");
            results.tell_writeback(id, news);
        });
        let started = Writeback::start(setups, clocks, recorder, tell);
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(started));
    }

    /// Ramps every term to zero and ends.
    pub(in crate::app) async fn end(&self) {
        let current = self.current.write().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(current) = current {
            current.end().await;
        }
    }

    fn current(&self) -> Option<Arc<Writeback>> {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn setup(
        &self,
        config: &Config,
        control_loop: &config::LoopConfig,
        history: &Arc<History>,
        devices: &[Device],
    ) -> Option<LoopSetup> {
        let own = control_loop.writeback.as_ref().filter(|own| own.enabled)?;
        let device = config.modbus.iter().find(|device| device.name == own.device)?;
        let (low_high, span) = (control_loop.op_limits?, control_loop.op_span?);
        let read = [Some(&control_loop.op), Some(&control_loop.pv), control_loop.sp.as_ref()];
        let names: BTreeSet<&str> =
            read.into_iter().chain([control_loop.mode.as_ref()]).flatten().map(|tag| tag.device()).collect();
        let named = |name: &str| devices.iter().find(|device| device.plan.name() == name);
        let healths: Vec<_> = names.iter().filter_map(|name| Some(named(name)?.health.clone())).collect();
        let missed = move || {
            let missed = healths.iter().map(|health| health.snapshot()).map(|h| h.overruns + h.missed_polls);
            missed.sum()
        };
        let polled: watch::Receiver<u64> = named(control_loop.op.device())?.rings.polled.subscribe();
        let id = LoopId::new(control_loop.id.as_str());
        let term =
            history.tag_index(&id, &TagKind::Role(Role::Term)).and_then(|tag| history.ring(tag)).cloned()?;
        Some(LoopSetup {
            limits: own.limits(span, low_high),
            target: own.target(&device.address, device.unit_id, device.address_base)?,
            pause: Duration::from_millis(own.write_ms),
            polled,
            look: look(id.clone(), history.clone(), self.results.clone(), self.clock, missed),
            keep: Arc::new(move |sample| term.push(sample)),
            id,
        })
    }
}

/// A loop as its gate sees it.
fn look(
    id: LoopId,
    history: Arc<History>,
    results: Arc<Results>,
    clock: Clock,
    missed: impl Fn() -> u64 + Send + Sync + 'static,
) -> Look {
    Arc::new(move || {
        let mut inputs = Inputs { missed_polls: missed(), ..Inputs::default() };
        for (tag, sample) in history.latest(&id) {
            match tag.kind {
                TagKind::Role(Role::Op) => inputs.op = sample,
                TagKind::Role(Role::Pv) => inputs.pv = sample,
                TagKind::Role(Role::Sp) => inputs.sp = sample,
                TagKind::Role(Role::Mode) => inputs.mode = sample,
                TagKind::Role(Role::Mv) => inputs.mv = sample,
                TagKind::Role(Role::Term) | TagKind::Extra(_) => {}
            }
        }
        let run = results.get(&id, clock.now()).and_then(|known| known.diagnosed);
        inputs.evidence = run.and_then(|run| {
            // By the declared model and with the effects alike: what opens a gate must not hang on an effect.
            let sticky = [&run.judged()?.diagnosis.verdict, run.judged()?.verdict()];
            let (f, f_ci95) = run.declared_friction().unwrap_or((f64::NAN, [f64::NAN; 2]));
            Some(Evidence {
                sticky: sticky.iter().all(|verdict| **verdict == Verdict::Stiction),
                f,
                f_ci95,
                at: run.finished,
            })
        });
        inputs
    })
}

impl WritebackPort for WritebackControl {
    fn status(&self, id: &LoopId) -> Option<Status> {
        self.current()?.status(id)
    }

    fn act<'a>(&'a self, id: &'a LoopId, action: Action, by: &'a str) -> Acted<'a> {
        Box::pin(async move { self.current()?.act(id, action, by).await })
    }
}
