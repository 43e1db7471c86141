//! The daemon's parts without collectors and without a store: rings, scheduler, results, alarms, API.

use super::feed::Feed;
use super::{Options, ReplayError, Say};
use crate::app::{App, ids, jobs, neighbours, silence};
use crate::collect::Issue;
use crate::config::{self, Config, Neighbour};
use crate::diagnosis::Settings;
use crate::history::{self, History, LoopTags, TagKind, TagSpec};
use crate::results::{Basis, Results, Run, Trigger, basis};
use crate::schedule::{self, Clock, Job, Scheduler, Snapshot};
use crate::serve::dto::bundle::Bundle;
use crate::serve::{self, Context, LoopInfo};
use crate::signal::{LoopId, Record};
use crate::{alarm, serve::dto::rfc3339};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// Samples that rings hold beyond what a run needs, because runs that overlapped are replayed one after the other.
const SLACK: usize = 512;
/// Steps of a paced replay (s on the wall clock).
const STEP_S: f64 = 0.1;

/// What a recorded run worked on, and when it ended.
type Due = Arc<Mutex<Option<(Basis, f64)>>>;

pub(super) struct Machine {
    clock: Clock,
    history: Arc<History>,
    results: Arc<Results>,
    scheduler: Arc<Scheduler>,
    snapshot: Snapshot,
    due: Due,
    speed: Option<f64>,
    server: serve::Config,
    plant: watch::Sender<Arc<serve::Plant>>,
    stop: CancellationToken,
    tasks: JoinSet<()>,
    now: f64,
}

/// What the parts are made from.
struct Parts {
    loops: Vec<LoopTags>,
    infos: Vec<LoopInfo>,
    jobs: Vec<Job>,
    neighbours: HashMap<LoopId, Vec<Neighbour>>,
    settings: Settings,
    schedule: schedule::Config,
    alarm: alarm::Config,
    server: serve::Config,
}

pub(super) fn issues(issues: Vec<Issue>) -> ReplayError {
    let lines = issues.iter().map(|issue| format!("{}: {}", issue.field, issue.message));
    ReplayError::Input(lines.collect::<Vec<_>>().join("; "))
}

impl Machine {
    /// The parts for the plant of a configuration, with rings for `room` samples.
    pub(super) fn of(
        config: &Config,
        room: usize,
        clock: Clock,
        options: &Options,
    ) -> Result<Self, ReplayError> {
        let info = |own: &config::LoopConfig| LoopInfo {
            id: LoopId::new(own.id.as_str()),
            description: own.description.clone(),
            group: own.group.clone(),
            period_s: config.period_s(own),
        };
        let parts = Parts {
            loops: config.plant().map_err(issues)?.loops,
            infos: config.loops.iter().map(info).collect(),
            jobs: jobs(config),
            neighbours: neighbours(config),
            settings: Settings::from(&config.diagnosis),
            schedule: config.schedule.clone(),
            alarm: config.alarm.clone(),
            server: config.server.clone(),
        };
        debug_assert_eq!(parts.loops.len(), ids(config).len());
        // A run that is not compared sees what the daemon's rings would have held, no more.
        Ok(Self::new(parts, room, clock, options))
    }

    /// The parts for the one loop of a bundle; tags of other loops are its own here.
    pub(super) fn of_one(
        bundle: &Bundle,
        record: &Record,
        clock: Clock,
        options: &Options,
    ) -> Result<Self, ReplayError> {
        let id = LoopId::new(bundle.r#loop.id.as_str());
        let spec = |name: &str| TagSpec {
            kind: TagKind::named(name),
            unit: String::new(),
            source: name.to_string(),
        };
        let tags = LoopTags {
            id: id.clone(),
            tags: basis::series(record).map(|(name, _)| spec(name)).collect(),
            op_limits: record.op_limits,
            op_span: record.op_span,
            op_span_source: record.op_span_source,
        };
        let room = basis::series(record).map(|(_, samples)| samples.len()).max().unwrap_or(0);
        let info = LoopInfo {
            id: id.clone(),
            description: bundle.r#loop.description.clone(),
            group: bundle.r#loop.group.clone(),
            period_s: bundle.r#loop.period_s,
        };
        let parts = Parts {
            loops: vec![tags],
            infos: vec![info],
            jobs: vec![Job { id, period_s: bundle.r#loop.period_s }],
            neighbours: HashMap::new(),
            settings: Settings::default(),
            schedule: schedule::Config::default(),
            alarm: alarm::Config::default(),
            server: serve::Config::default(),
        };
        Ok(Self::new(parts, room, clock, options))
    }

    fn new(parts: Parts, room: usize, clock: Clock, options: &Options) -> Self {
        let Parts { loops, infos, jobs, neighbours, settings, schedule, alarm, mut server } = parts;
        let history = Arc::new(History::new(&loops, &history::Config { samples_per_tag: room + SLACK }));
        let ids: Vec<LoopId> = loops.iter().map(|own| own.id.clone()).collect();
        let results = Arc::new(Results::new(&ids, schedule.keep_results, &alarm));
        let due = Due::default();
        let (rings, waits) = (history.clone(), due.clone());
        let whole: Snapshot = Arc::new(move |id| {
            let mut record = rings.snapshot(id)?;
            for tag in neighbours.get(id).into_iter().flatten() {
                let series = rings.series(&tag.id, &tag.kind).map(|series| (tag.name.clone(), series));
                record.tags.extend(series);
            }
            Some(record)
        });
        let all = whole.clone();
        let part: Snapshot = Arc::new(move |id| {
            let record = all(id)?;
            Some(match waits.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
                Some((basis, _)) => basis.cut(record).0,
                None => last(record, room),
            })
        });
        let (inner, waits) = (App::diagnosis(), due.clone());
        let diagnose: schedule::Diagnose = Arc::new(move |record, settings, structure| {
            let recorded = waits.lock().unwrap_or_else(PoisonError::into_inner).clone();
            match recorded {
                Some((basis, finished)) => {
                    let judged = inner(record, &basis.settings, basis.structure.as_ref());
                    clock.set(finished);
                    judged
                }
                None => inner(record, settings, structure),
            }
        });
        // However slow this machine is, what was done in time once is done.
        let own = schedule::Config { parallelism: 1, deadline_s: 3600.0, ..schedule };
        let waits = due.clone();
        // Of a recorded run it is known who was silent, and nothing is diagnosed that would set the clock.
        let silence: schedule::Silence = Arc::new(move |_, record, period_s| {
            match waits.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
                Some((basis, finished)) => basis.silent.inspect(|_| clock.set(*finished)),
                None => silence::of_record(record, clock.now(), period_s),
            }
        });
        let plan = schedule::Plan {
            jobs,
            snapshot: part,
            silence,
            settings,
            follows: false,
            searched: std::collections::HashSet::new(),
        };
        let scheduler = Arc::new(Scheduler::new(own, clock, diagnose, results.clone(), plan));
        if let Some(address) = options.listen {
            server.listen = address;
        }
        let plant = serve::Plant::new(infos, history.clone(), Arc::new(Vec::new));
        let plant = watch::Sender::new(Arc::new(plant));
        Self {
            now: clock.now(),
            clock,
            history,
            results,
            scheduler,
            snapshot: whole,
            due,
            speed: options.speed,
            server,
            plant,
            stop: CancellationToken::new(),
            tasks: JoinSet::new(),
        }
    }

    pub(super) fn history(&self) -> &History {
        &self.history
    }

    /// Starts the scheduler, and the API where it is asked for.
    pub(super) async fn begin(&mut self, options: &Options, say: Say<'_>) -> Result<(), ReplayError> {
        let (scheduler, stop) = (self.scheduler.clone(), self.stop.clone());
        self.tasks.spawn(async move { scheduler.run(stop).await });
        let Some(address) = options.listen else { return Ok(()) };
        let failed = |error: &dyn std::fmt::Display| {
            ReplayError::Failed(format!("cannot serve on {address}: {error}"))
        };
        let listener = TcpListener::bind(address).await.map_err(|error| failed(&error))?;
        let bound = listener.local_addr().map_err(|error| failed(&error))?;
        let (results, scheduler) = (self.results.clone(), self.scheduler.clone());
        let (plant, stop) = (self.plant.subscribe(), self.stop.clone());
        let context =
            Arc::new(Context::new(self.server.clone(), self.clock, results, scheduler, plant, stop));
        self.tasks.spawn(async move {
            if let Err(error) = serve::serve(listener, context).await {
                tracing::error!(%error, "the API failed");
            }
        });
        say(&format!("serving on http://{bound}"));
        Ok(())
    }

    /// Ends; an API goes on until it is interrupted.
    pub(super) async fn end(&mut self, options: &Options, say: Say<'_>) -> Result<(), ReplayError> {
        if options.listen.is_some() {
            let at = rfc3339(self.now).unwrap_or_default();
            say(&format!("the record is over at {at}; the API stays until it is interrupted"));
            tokio::signal::ctrl_c().await.map_err(|error| ReplayError::Failed(error.to_string()))?;
        }
        self.stop.cancel();
        while self.tasks.join_next().await.is_some() {}
        Ok(())
    }

    /// Lets plant time pass up to `t` (s), at the speed asked for.
    pub(super) async fn advance(&mut self, t: f64, feed: &mut dyn Feed) -> Result<(), ReplayError> {
        while let Some(speed) = self.speed
            && self.now < t
        {
            let step = (t - self.now).min(speed * STEP_S);
            tokio::time::sleep(Duration::try_from_secs_f64(step / speed).unwrap_or_default()).await;
            self.pass(self.now + step, feed)?;
        }
        if self.now < t { self.pass(t, feed) } else { Ok(()) }
    }

    fn pass(&mut self, t: f64, feed: &mut dyn Feed) -> Result<(), ReplayError> {
        self.feed(t, feed)?;
        self.now = t;
        self.clock.set(t);
        self.results.tick(t);
        Ok(())
    }

    /// Gives the rings their samples up to `t` (s).
    pub(super) fn feed(&self, t: f64, feed: &mut dyn Feed) -> Result<(), ReplayError> {
        feed.until(t, &mut |tag, sample| {
            self.history.push(tag, sample);
        })
    }

    /// Tags whose samples are not those that a recorded run worked on.
    pub(super) fn lost(&self, id: &LoopId, basis: &Basis) -> Vec<String> {
        match (self.snapshot)(id) {
            Some(record) => basis.cut(record).1,
            None => vec![format!("loop '{id}', which the configuration does not have")],
        }
    }

    /// One run; with what a recorded one worked on, when it began and when it ended, that one again.
    pub(super) async fn run(
        &mut self,
        id: &LoopId,
        trigger: Trigger,
        recorded: Option<(Basis, f64, f64)>,
    ) -> Result<Arc<Run>, ReplayError> {
        let ended = recorded.as_ref().map(|(.., finished)| *finished);
        if let Some((_, began, _)) = &recorded {
            self.clock.set(*began);
        }
        let recorded = recorded.map(|(basis, _, finished)| (basis, finished));
        if let Some((basis, _)) = &recorded {
            self.results.set_before(id, basis.before);
        }
        *self.due.lock().unwrap_or_else(PoisonError::into_inner) = recorded;
        let asked = self.scheduler.ask(id, trigger);
        let run = asked.map_err(|refused| ReplayError::Failed(format!("loop '{id}': {refused}")))?.await;
        *self.due.lock().unwrap_or_else(PoisonError::into_inner) = None;
        self.now = self.now.max(ended.unwrap_or(self.now));
        self.clock.set(self.now);
        run.map_err(|_| ReplayError::Failed(format!("loop '{id}': the run was given up")))
    }
}

/// The last `room` samples of each tag, and all terms: what acted on an OP must not be lost.
fn last(mut record: Record, room: usize) -> Record {
    let cut = |samples: &mut crate::signal::Series| {
        samples.drain(..samples.len().saturating_sub(room));
    };
    [&mut record.op, &mut record.pv].into_iter().for_each(cut);
    [&mut record.sp, &mut record.mode, &mut record.mv].into_iter().flatten().for_each(cut);
    record.tags.iter_mut().for_each(|(_, samples)| cut(samples));
    record
}
