//! Wires write-back: what a loop's gate sees, where its term goes, and who hears of it.

mod rights;

use super::super::AppError;
use super::super::device::Device;
use super::end_terms;
use crate::audit::Recorder;
use crate::compensation::gate::{Action, Evidence, Inputs, Status, Time};
use crate::config::{self, Config};
use crate::diagnosis::{self, Verdict, without_model_error};
use crate::history::{History, LoopTags, TagKind};
use crate::results::Results;
use crate::schedule::Clock;
use crate::serve::{Acted, WritebackPort};
use crate::signal::{LoopId, Role};
use crate::writeback::{Clocks, Look, LoopSetup, Tell, Writeback};
use std::collections::{BTreeSet, HashMap};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;
use tokio::sync::watch;

/// Write-back of the daemon, across reloads.
pub(in crate::app) struct WritebackControl {
    clock: Clock,
    results: Arc<Results>,
    /// The book of users and tokens, where there is a log-in; as it was at the start, because `[access]` is not reloaded.
    book: Option<PathBuf>,
    recorder: RwLock<Option<Arc<Recorder>>>,
    /// Held while the audit log is opened: a log has one writer.
    opening: Mutex<()>,
    current: RwLock<Option<Arc<Writeback>>>,
    read: Mutex<HashMap<LoopId, Read>>,
}

/// How a loop is read and diagnosed, and since when (s).
struct Read {
    tags: LoopTags,
    settings: diagnosis::Config,
    since: f64,
}

impl WritebackControl {
    /// Opens the audit log where a loop enables write-back.
    pub(in crate::app) fn new(
        config: &Config,
        clock: Clock,
        results: &Arc<Results>,
    ) -> Result<Arc<Self>, AppError> {
        let writeback = Self {
            clock,
            results: results.clone(),
            book: config.access.as_ref().map(|own| own.file.clone()),
            recorder: RwLock::default(),
            opening: Mutex::default(),
            current: RwLock::default(),
            read: Mutex::default(),
        };
        writeback.open(config)?;
        Ok(Arc::new(writeback))
    }

    fn open(&self, config: &Config) -> Result<(), AppError> {
        let _opening = self.opening.lock().unwrap_or_else(PoisonError::into_inner);
        let enabled = config.loops.iter().any(|own| own.writeback.as_ref().is_some_and(|own| own.enabled));
        if let (true, None, Some(path)) = (enabled, self.recorder(), &config.writeback.audit_file) {
            let bounds = crate::audit::Bounds {
                max_bytes: config.writeback.audit_max_bytes,
                keep_files: config.writeback.audit_keep_files,
            };
            // All files of the log are verified: meanwhile whoever asks for it must not wait.
            let opened = Arc::new(Recorder::start(path, bounds, self.clock.now())?);
            *self.recorder.write().unwrap_or_else(PoisonError::into_inner) = Some(opened);
        }
        Ok(())
    }

    /// The audit log, where a loop enables write-back. While it is damaged no gate opens.
    pub(in crate::app) fn recorder(&self) -> Option<Arc<Recorder>> {
        self.recorder.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Starts every loop that enables it, in shadow.
    pub(in crate::app) fn begin(&self, config: &Config, history: &Arc<History>, devices: &[Device]) {
        if let Err(error) = self.open(config) {
            tracing::error!(%error, "write-back stays off");
        }
        self.note_how_read(config, history);
        let recorder = self.recorder();
        let enabled = config.loops.iter().filter(|_| recorder.is_some());
        let setups: Vec<LoopSetup> =
            enabled.filter_map(|own| self.setup(config, own, history, devices)).collect();
        let is_written = |id: &LoopId| setups.iter().any(|own| own.id == *id);
        end_terms(history, config, self.clock.now());
        self.results.keep_reinforced(is_written);
        if let Some(recorder) = recorder {
            self.start(setups, recorder);
        }
    }

    fn start(&self, setups: Vec<LoopSetup>, recorder: Arc<Recorder>) {
        let clock = self.clock;
        let clocks: Clocks =
            Arc::new(move || Time { mono: clock.elapsed().as_secs_f64(), wall: clock.now() });
        let results = self.results.clone();
        let tell: Tell = Arc::new(move |id, news| {
            tracing::info!(%id, ?news, "write-back");
            results.tell_writeback(id, news);
        });
        let started = Arc::new(Writeback::start(setups, clocks, recorder, tell));
        if let Some(book) = &self.book {
            tokio::spawn(rights::follow(Arc::downgrade(&started), book.clone()));
        }
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(started);
    }

    /// Ramps every term to zero and ends. Until then it is shown: a term that is still in force must not look like none.
    pub(in crate::app) async fn end(&self) {
        let Some(ending) = self.current() else { return };
        ending.end().await;
        let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
        // Meanwhile a reload may have begun another.
        current.take_if(|current| Arc::ptr_eq(current, &ending));
    }

    /// Remembers since when each loop is read and diagnosed as it is now. Results are kept by name, and what was said of it
    /// before was said of other registers, another span or by other rules.
    fn note_how_read(&self, config: &Config, history: &History) {
        let now = self.clock.now();
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        let before = std::mem::take(&mut *read);
        // At the start there are no results; whatever the clock is set to later, they are of this configuration.
        let anew = if before.is_empty() { f64::NEG_INFINITY } else { now };
        let settings = &config.diagnosis;
        for tags in history.loops() {
            let same = before.get(&tags.id).filter(|own| own.tags == *tags && own.settings == *settings);
            let since = same.map_or(anew, |own| own.since);
            let own = Read { tags: tags.clone(), settings: settings.clone(), since };
            read.insert(tags.id.clone(), own);
        }
    }

    /// Since when a loop is read as it is now (s); a loop that nobody knows has not been yet.
    fn read_since(&self, id: &LoopId) -> f64 {
        let read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        read.get(id).map_or(f64::INFINITY, |own| own.since)
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
        let ring =
            |role| history.tag_index(&id, &TagKind::Role(role)).and_then(|tag| history.ring(tag)).cloned();
        let (op, term) = (ring(Role::Op)?, ring(Role::Term)?);
        Some(LoopSetup {
            limits: own.limits(span, low_high),
            target: own.target(&device.address, device.unit_id, device.address_base)?,
            pause: Duration::from_millis(own.write_ms),
            polled,
            heard: Arc::new(move || op.pushed()),
            look: look(
                (id.clone(), self.read_since(&id)),
                history.clone(),
                self.results.clone(),
                self.clock,
                missed,
            ),
            keep: Arc::new(move |sample| term.push(sample)),
            lasts_s: own.term_lasts_s(),
            id,
        })
    }
}

/// A loop as its gate sees it. A diagnosis that began before `since` (s) is none: it may be of what the loop was then.
fn look(
    (id, since): (LoopId, f64),
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
        let run = run.filter(|run| run.started >= since);
        inputs.evidence = run.and_then(|run| {
            let judged = run.judged()?;
            // By the declared model and with the effects alike: what opens a gate must not hang on an effect.
            let sticky = [&judged.diagnosis.verdict, judged.verdict()];
            let (f, f_ci95) = run.declared_friction().unwrap_or((f64::NAN, [f64::NAN; 2]));
            Some(Evidence {
                sticky: sticky.iter().all(|verdict| **verdict == Verdict::Stiction),
                f,
                // Compared with the interval of the grant: both have the error of the models in common.
                f_ci95: without_model_error(f, f_ci95),
                at: run.finished,
                // All that is remembered is judged anew in each run, and what is found may be of days ago.
                data_end: judged.diagnosis.preparation.end,
            })
        });
        inputs
    })
}

impl WritebackPort for WritebackControl {
    fn status(&self, id: &LoopId) -> Option<Status> {
        self.current()?.status(id)
    }

    fn record(&self) -> Option<Arc<Recorder>> {
        self.recorder()
    }

    fn act<'a>(&'a self, id: &'a LoopId, action: Action, by: &'a str) -> Acted<'a> {
        Box::pin(async move { self.current()?.act(id, action, by).await })
    }
}

#[cfg(test)]
mod tests;
