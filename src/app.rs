//! The table of contents: the only place that knows every part and wires them together.
//!
//! ```text
//! collectors --sample--> history --snapshot--> scheduler --run--> results (alarms) --event--> API, notify
//! ```
//!
//! With the cargo feature `writeback`, and only then, a loop that enables it has a gate between results and plant.

mod alarm_inputs;
mod backfill;
mod device;
mod error;
mod facts;
mod fleet;
mod namespaces;
mod notifications;
mod persistence;
mod plantwide;
mod process;
mod recall;
pub mod replay;
mod restart;
mod rings;
mod security;
mod silence;
mod span;
mod surroundings;
mod writeback;

use crate::collect::{DeviceHealth, modbus};
use crate::config::{self, Config, Neighbour};
use crate::detectors::integration::told_by_name;
use crate::diagnosis::{self, Settings};
use crate::history::History;
use crate::residual;
use crate::results::{Judged, Results};
use crate::schedule::{self, Clock, Diagnose, Job, Scheduler};
use crate::serve::{self, Context, LoopInfo};
use crate::signal::LoopId;
use crate::writeback::TERM_REPEAT_S;
use backfill::BackfillJobs;
use device::Device;
use fleet::Fleet;
use futures::future::{BoxFuture, OptionFuture};
use namespaces::Namespaces;
use notifications::Notifications;
use persistence::Persistence;
use plantwide::Plantwide;
pub use plantwide::{DeadTime, friction_of, margins_of, untold_of};
use security::Security;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{Mutex, watch};
use tokio_util::sync::CancellationToken;
use writeback::WritebackControl;

pub use error::AppError;
pub use fleet::Role;
pub use process::{daemon, listen};
pub use span::span_contradiction;
pub use surroundings::Surroundings;

/// How often a shelving is looked at that may have run out.
const ALARM_TICK: Duration = Duration::from_secs(1);

/// The daemon, built and not yet running.
pub struct App {
    clock: Clock,
    dial: modbus::Dial,
    namespaces: Namespaces,
    results: Arc<Results>,
    scheduler: Arc<Scheduler>,
    plant: watch::Sender<Arc<serve::Plant>>,
    context: Arc<Context>,
    writeback: Arc<WritebackControl>,
    persistence: Arc<Persistence>,
    notifications: Arc<Notifications>,
    backfill: Arc<BackfillJobs>,
    plantwide: Arc<Plantwide>,
    security: Arc<Security>,
    /// `None` where this machine is alone.
    fleet: Option<Arc<Fleet>>,
    diagnose: Diagnose,
    /// The configuration of the start: what a reload does not change is as it says.
    started: Arc<Config>,
    /// Cancelled when the daemon stops.
    stop: CancellationToken,
    /// Held by who takes another configuration. The state stays free while terms of write-back go to zero: alarms look at it.
    taking: Mutex<()>,
    state: Mutex<Running>,
}

/// What a reload replaces.
struct Running {
    config: Arc<Config>,
    history: Arc<History>,
    devices: Vec<Device>,
    collecting: bool,
    /// How long after the start this configuration came into force.
    since: Duration,
}

impl App {
    /// Builds every part; nothing runs, connects or listens yet. `diagnose` is [`diagnosis`]'s own outside of tests.
    ///
    /// The order matters. What can refuse the start comes first, so that a refused start has not touched the store.
    /// Write-back comes before security, which puts changes on write-back's audit log where there is no other.
    /// Loops and devices are known before persistence gives their alarms back, because alarms of unknown ones are dropped.
    /// Notifications follow, and so hear of nothing that is only remembered. The alarms' design of the configuration is
    /// applied after that, because it overrules what was kept, and people hear of what it changes. Backfill, scheduler and
    /// devices need no more than what is above them, and the API's context is last because it shows all of them.
    ///
    /// # Errors
    /// [`AppError::Plan`], [`AppError::Audit`], [`AppError::Access`], [`AppError::Tls`].
    pub fn build(config: Config, clock: Clock, diagnose: Diagnose) -> Result<Self, AppError> {
        Self::build_in(Surroundings::of_machine(clock), config, diagnose)
    }

    /// As [`App::build`], on another network and disk than the machine's.
    ///
    /// # Errors
    /// As [`App::build`].
    pub fn build_in(around: Surroundings, config: Config, diagnose: Diagnose) -> Result<Self, AppError> {
        Self::build_as(Role::Alone, around, config, diagnose)
    }

    /// As [`App::build_in`], as a part of a fleet.
    ///
    /// # Errors
    /// As [`App::build`], and [`AppError::Fleet`].
    pub fn build_as(
        role: Role,
        around: Surroundings,
        config: Config,
        diagnose: Diagnose,
    ) -> Result<Self, AppError> {
        let Surroundings { clock, dial, store } = around;
        let config = Arc::new(config);
        let stop = CancellationToken::new();
        let wired = config.plant().map_err(AppError::Plan)?;
        let history = Arc::new(History::new(&wired.loops, &config.history));
        let results = Arc::new(Results::new(&ids(&config), config.schedule.keep_results, &config.alarm));
        let fleet = Fleet::new(role, &config, clock, &history, &results)?;
        let writeback = WritebackControl::new(&config, clock, &results)?;
        results.watch_devices(&devices_of(&config), clock.now());
        let security = Arc::new(Security::new(&config, clock, writeback.recorder())?);
        let persistence = Persistence::new(&config, clock, store, (&history, &results));
        let outlet = fleet.as_ref().map(|fleet| fleet.outlet());
        let notifications = Arc::new(Notifications::new(&config, clock, &results, outlet));
        results.read_from(sources(&history), clock.now());
        results.apply_design(clock.now());
        let plan = schedule_plan(&config, &history, clock);
        let namespaces = Namespaces::new(&config);
        let parts = (&persistence, &results, namespaces.pinned());
        let backfill = BackfillJobs::new(&config, clock, parts, diagnose.clone(), stop.clone());
        let plantwide = Plantwide::new(&config, clock, &history, &results, &persistence);
        let own = (config.schedule.clone(), diagnose.clone());
        let scheduler = Scheduler::new(own.0, clock, own.1, results.clone(), plan);
        let scheduler = Arc::new(match fleet.as_ref().and_then(Fleet::elsewhere) {
            Some(elsewhere) => scheduler.asking(elsewhere),
            None => scheduler,
        });
        let device = |plan| Device::new(plan, clock, (&dial, namespaces.pinned()), &history);
        let devices: Vec<Device> = wired.into_plans().map(device).collect();
        let (plant, watched) = watch::channel(Arc::new(shown(&config, &config, &history, &devices)));
        let (served, ended) = (config.server.clone(), stop.clone());
        let context = Context::new(served, clock, results.clone(), scheduler.clone(), watched, ended);
        let context = context.with_writeback(writeback.clone()).with_notifications(notifications.clone());
        let context = context.with_store(persistence.ask()).with_backfill(backfill.clone());
        let context = context.with_plantwide(plantwide.clone());
        let context = context.with_fleet(fleet.clone().map(|fleet| fleet as Arc<dyn serve::FleetPort>));
        let context = context.with_access(security.access.clone()).with_audit(security.audit.clone());
        let durable = persistence.ask_durable();
        let durable = match &fleet {
            Some(fleet) => durable.map(|durable| fleet.clone().with_orders(durable)),
            None => durable,
        };
        let context = Arc::new(context.with_tls(security.tls.clone()).with_durable(durable));
        tracing::info!(
            loops = history.loops().len(),
            tags = history.tag_count(),
            samples_per_tag = config.history.samples_per_tag,
            bytes_per_sample = history.bytes_per_sample(),
            total_bytes = history.memory_bytes(),
            "history: memory taken"
        );
        let (started, since) = (config.clone(), clock.elapsed());
        let state = Mutex::new(Running { config, history, devices, collecting: false, since });
        Ok(Self {
            clock,
            dial,
            namespaces,
            results,
            scheduler,
            plant,
            context,
            writeback,
            persistence,
            backfill,
            plantwide,
            notifications,
            security,
            fleet,
            diagnose,
            started,
            stop,
            taking: Mutex::default(),
            state,
        })
    }

    /// The diagnosis that the daemon runs, its residual traced.
    pub fn diagnosis() -> Diagnose {
        Arc::new(|record, settings, structure| {
            let tracing = residual::Settings::default();
            let gated = diagnosis::gate::gate(record, settings);
            let confirmed =
                structure.and_then(|last| residual::confirm_gated(record, &gated, settings, &tracing, last));
            let (diagnosis, findings) = match confirmed {
                Some((diagnosis, findings)) => (diagnosis, Some(findings)),
                None => {
                    let diagnosis = diagnosis::diagnose_gated(record, &gated, settings);
                    let findings = residual::trace_gated(record, &gated, &diagnosis, settings, &tracing);
                    (diagnosis, findings)
                }
            };
            let judged = Judged { findings, ..diagnosis.into() }.with_opinions(record.integrates);
            // It is kept for every loop, and would be most of the memory.
            judged.packed()
        })
    }

    /// What the diagnoses said.
    pub fn results(&self) -> &Arc<Results> {
        &self.results
    }

    /// Write-back, as the API sees it.
    pub fn writeback(&self) -> Arc<dyn serve::WritebackPort> {
        self.writeback.clone()
    }

    /// Every route, for who asks without a socket.
    pub fn routes(&self) -> axum::Router {
        serve::router(self.context.clone())
    }

    /// Has everything made durable that there is; false where that failed, or there is no store.
    pub fn make_durable(&self) -> bool {
        self.persistence.make_durable()
    }

    /// Cancel it to stop the daemon.
    pub fn stop(&self) -> CancellationToken {
        self.stop.clone()
    }

    /// Polls, diagnoses and serves on `listener` until [`App::stop`] is cancelled.
    ///
    /// # Errors
    /// [`AppError::Serve`]; the rest is stopped first.
    pub fn run(&self, listener: TcpListener) -> BoxFuture<'_, Result<(), AppError>> {
        // Boxed here, so that a binary that calls it does not compile the daemon once more.
        Box::pin(self.work(listener))
    }

    async fn work(&self, listener: TcpListener) -> Result<(), AppError> {
        {
            let mut state = self.state.lock().await;
            (state.collecting, state.since) = (true, self.clock.elapsed());
            self.persistence.begin(self.results.clone());
            state.devices.iter_mut().for_each(|device| device.start(&self.stop));
            self.writeback.begin(&state.config, &state.history, &state.devices);
        }
        let serving = async {
            let served = serve::serve(listener, self.context.clone()).await;
            self.stop.cancel();
            served
        };
        // Terms go to zero as soon as the daemon is told to stop, whatever else takes its time.
        // What goes wrong on that way is told too, and would be told by no later start.
        let withdrawn = CancellationToken::new();
        let withdrawing = async {
            self.stop.cancelled().await;
            self.writeback.end().await;
            withdrawn.cancel();
        };
        let notifications = self.notifications.run(withdrawn.clone());
        let scheduling = self.scheduler.run(self.stop.clone());
        let security = self.security.clone().run(self.stop.clone());
        let looking = self.plantwide.clone().run(self.stop.clone());
        let joined = async {
            let part = match &self.fleet {
                Some(fleet) => fleet.clone().run(self).await,
                None => Ok(()),
            };
            if part.is_err() {
                self.stop.cancel();
            }
            part
        };
        let (joined, served, (), (), (), (), (), (), ()) = tokio::join!(
            joined,
            serving,
            scheduling,
            self.tick_alarms(),
            withdrawing,
            notifications,
            security,
            looking,
            self.namespaces.run(self.stop.clone())
        );
        let _taking = self.taking.lock().await;
        let mut state = self.state.lock().await;
        state.collecting = false;
        for device in &mut state.devices {
            device.end().await;
        }
        // Last, so that the last samples and results are kept too.
        self.persistence.end().await;
        joined?;
        Ok(served?)
    }

    async fn tick_alarms(&self) {
        let mut watch = alarm_inputs::Watch::new(self.clock);
        while self.stop.run_until_cancelled(tokio::time::sleep(ALARM_TICK)).await.is_some() {
            let (now, elapsed) = (self.clock.now(), self.clock.elapsed());
            if let Some(by) = watch.set(now, elapsed) {
                tracing::warn!(by_s = by, "the clock was set");
                self.results.clock_was_set(by);
                self.plantwide.clock_was_set(by, now, elapsed.as_secs_f64());
            }
            self.results.tick(now);
            if self.fleet.as_ref().is_some_and(|fleet| fleet.follows()) {
                // What tags and collectors are like, their edges say.
                continue;
            }
            let state = &mut *self.state.lock().await;
            alarm_inputs::observe(state, &self.results, &*self.writeback, (now, elapsed));
        }
    }

    /// Takes another configuration. Loops that are unchanged keep their data, results and alarms; a loop whose OP or PV is
    /// read elsewhere keeps nothing that speaks for another valve ([`Results::read_from`]). Devices whose tags are unchanged go on
    /// being polled. `[server]` and the sizes in `[schedule]` need a restart, and the log says so.
    ///
    /// # Errors
    /// [`AppError::Plan`], [`AppError::Access`], [`AppError::Tls`]; then everything stays as it was.
    pub fn reload(&self, config: Config) -> BoxFuture<'_, Result<(), AppError>> {
        Box::pin(self.take(Some(config)))
    }

    /// Takes another configuration, or the one in force anew where the fleet's loops have changed.
    async fn take(&self, config: Option<Config>) -> Result<(), AppError> {
        let _taking = self.taking.lock().await;
        let reloading = config.is_some();
        let in_force = self.state.lock().await.config.clone();
        let config = config.unwrap_or_else(|| Config::clone(&in_force));
        let config = Arc::new(match &self.fleet {
            Some(fleet) => fleet.composed(config)?,
            None => config,
        });
        let _paused = OptionFuture::from(self.fleet.as_ref().map(|fleet| fleet.pause())).await;
        let wired = config.plant().map_err(AppError::Plan)?;
        // A broken file of users keeps no loop of an edge out.
        if reloading {
            self.security.reload()?;
        }
        // Granted was what the old configuration says: every term goes to zero first.
        self.writeback.end().await;
        let mut state = self.state.lock().await;
        restart::warn_of_what_needs_one(&state.config, &config);
        let history = Arc::new(state.history.successor(&wired.loops, &config.history));
        history.keep_terms_of(&state.history, TERM_REPEAT_S);
        let (mut before, mut devices) = (std::mem::take(&mut state.devices), Vec::new());
        for plan in wired.into_plans() {
            let same = before.iter().position(|device| device.carries_on(&plan, &history));
            devices.push(match same {
                Some(at) => before.swap_remove(at),
                None => Device::new(plan, self.clock, (&self.dial, self.namespaces.pinned()), &history),
            });
        }
        // A ring has one writer: the old ones end before the new ones begin.
        for mut device in before {
            device.end().await;
        }
        self.notifications.reload(&config).await;
        self.backfill.reload(&config);
        self.plantwide.reload(&config, &history);
        self.results.reload(&ids(&config), &config.alarm, self.clock.now());
        self.results.watch_devices(&devices_of(&config), self.clock.now());
        self.persistence.clone().replace(history.clone(), self.results.clone()).await;
        // Of loops that were not watched it gives back how they were left: nobody said then that their alarms are over.
        let old = &state.config;
        self.results.begin_anew((&ids(old), &devices_of(old)), &old.alarm, self.clock.now());
        // What the store gave back may be of another valve, too.
        self.results.read_from(sources(&history), self.clock.now());
        // Only now: an edge would forward new rings before the store has filled them, and all they hold once more after that.
        if let Some(fleet) = &self.fleet {
            fleet.replace(&config, &history);
        }
        self.results.apply_design(self.clock.now());
        let mut plan = schedule_plan(&config, &history, self.clock);
        if self.fleet.as_ref().is_some_and(|fleet| fleet.follows()) {
            // Their edges diagnose them.
            plan.jobs.clear();
            plan.follows = true;
        }
        self.scheduler.replace(plan);
        self.plant.send_replace(Arc::new(shown(&self.started, &config, &history, &devices)));
        // Only now: who hears it asks for the loops at once.
        self.results.tell_reload();
        if state.collecting && !self.stop.is_cancelled() {
            devices.iter_mut().for_each(|device| device.start(&self.stop));
            self.writeback.begin(&config, &history, &devices);
            self.security.warn_of_log(self.writeback.recorder());
        }
        tracing::info!(
            loops = history.loops().len(),
            total_bytes = history.memory_bytes(),
            "another configuration is in force"
        );
        (state.config, state.history, state.devices) = (config, history, devices);
        state.since = self.clock.elapsed();
        Ok(())
    }
}

fn ids(config: &Config) -> Vec<LoopId> {
    config.loops.iter().map(|control_loop| LoopId::new(control_loop.id.as_str())).collect()
}

/// What stands for where each loop is read.
fn sources(history: &History) -> impl Iterator<Item = (LoopId, u64)> {
    history.loops().iter().filter_map(move |own| Some((own.id.clone(), history.source(&own.id)?)))
}

fn devices_of(config: &Config) -> Vec<LoopId> {
    let modbus = config.modbus.iter().map(|device| device.name.as_str());
    let opcua = config.opcua.iter().map(|device| device.name.as_str());
    let mqtt = config.mqtt.iter().map(|device| device.name.as_str());
    let forwarded = config.forwarded.iter().map(String::as_str);
    modbus.chain(opcua).chain(mqtt).chain(forwarded).map(LoopId::new).collect()
}

fn neighbours(config: &Config) -> HashMap<LoopId, Vec<Neighbour>> {
    config.loops.iter().map(|l| (LoopId::new(l.id.as_str()), config.neighbours(l))).collect()
}

fn schedule_plan(config: &Config, history: &Arc<History>, clock: Clock) -> schedule::Plan {
    schedule::Plan {
        jobs: jobs(config),
        snapshot: span::watched(config, snapshot(config, history)),
        silence: silence::of_rings(history, clock),
        settings: Settings::from(&config.diagnosis),
        follows: false,
        searched: may_be_written(config),
    }
}

/// Loops that write-back may act on: their evidence has to be as good as it can be.
fn may_be_written(config: &Config) -> HashSet<LoopId> {
    let loops = config.loops.iter().filter(|own| own.writeback.is_some());
    loops.map(|own| LoopId::new(own.id.as_str())).collect()
}

fn jobs(config: &Config) -> Vec<Job> {
    let job = |control_loop: &config::LoopConfig| {
        let period_s = config.period_s(control_loop);
        Job { id: LoopId::new(control_loop.id.as_str()), period_s }
    };
    config.loops.iter().map(job).collect()
}

/// Copies what is remembered of a loop and of the tags that may explain it.
fn snapshot(config: &Config, history: &Arc<History>) -> schedule::Snapshot {
    let (history, neighbours) = (history.clone(), neighbours(config));
    Arc::new(move |id| {
        let mut record = history.snapshot(id)?;
        record.integrates = told_by_name(id.as_str());
        for tag in neighbours.get(id).into_iter().flatten() {
            record.tags.extend(history.series(&tag.id, &tag.kind).map(|series| (tag.name.clone(), series)));
        }
        Some(record)
    })
}

/// What the API shows of the plant, and of what is in force: of some sections that is what the daemon was started with.
fn shown(started: &Config, config: &Config, history: &Arc<History>, devices: &[Device]) -> serve::Plant {
    let info = |control_loop: &config::LoopConfig| LoopInfo {
        id: LoopId::new(control_loop.id.as_str()),
        description: control_loop.description.clone(),
        group: control_loop.group.clone(),
        period_s: config.period_s(control_loop),
    };
    // Of a device that write-back alone has to do with nothing is collected: it would pass for one that never answered.
    let read = devices.iter().filter(|device| !device.rings.by_tag.is_empty());
    let healths: Vec<(String, Arc<DeviceHealth>)> =
        read.map(|device| (device.plan.name().to_string(), device.health.clone())).collect();
    let states = move || healths.iter().map(|(name, health)| Device::state(name, health)).collect();
    let snapshot = snapshot(config, history);
    let recall = recall::recall(snapshot, started.store.clone(), neighbours(config));
    serve::Plant::new(config.loops.iter().map(info).collect(), history.clone(), Arc::new(states))
        .with_facts(facts::of(started, config))
        .with_recall(recall)
}

#[cfg(test)]
mod tests;
