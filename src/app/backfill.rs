//! The past of a loop as a job beside the daemon: devices that keep history are read into the store, and what the store then
//! has is diagnosed window by window, on one thread, with nothing said to operators.

mod file;

use super::persistence::Persistence;
use crate::backfill::{BackfillError, Marked, Timeline, timeline, usual_cut};
use crate::collect::opcua::{self, Keep, Slice, Wish};
use crate::config::Config;
use crate::diagnosis::Settings;
use crate::results::{Event, Results};
use crate::schedule::{Clock, Diagnose};
use crate::serve::{BackfillPhase, BackfillPort, BackfillRefusal, BackfillRequest, BackfillRun};
use crate::signal::{Record, Sample, SpanSource};
use crate::store::{self, Batch, Reader, Series, StoreError, TagName};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Time asked of a device, and kept, at once (s).
const SLICE_S: f64 = 3600.0;
/// Rest between two requests to a device, which has others to answer.
const PAUSE: Duration = Duration::from_millis(100);
/// Time read from the store at once (s).
const DAY_S: f64 = 86_400.0;
/// Samples of a loop's tags together that are diagnosed at most: 24 bytes each in memory.
const MOST_SAMPLES: usize = 10_000_000;
/// Windows of one job.
const MOST_WINDOWS: f64 = 10_000.0;

/// Diagnoses the past of loops for the API.
pub(super) struct BackfillJobs {
    shared: Arc<Shared>,
    stop: CancellationToken,
}

struct Shared {
    persistence: Arc<Persistence>,
    results: Arc<Results>,
    clock: Clock,
    diagnose: Diagnose,
    config: Mutex<Arc<Config>>,
    job: Mutex<Option<(BackfillRun, CancellationToken)>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl BackfillJobs {
    pub(super) fn new(
        config: &Arc<Config>,
        clock: Clock,
        (persistence, results): (&Arc<Persistence>, &Arc<Results>),
        diagnose: Diagnose,
        stop: CancellationToken,
    ) -> Arc<Self> {
        let (persistence, results) = (persistence.clone(), results.clone());
        let (config, job) = (Mutex::new(config.clone()), Mutex::default());
        Arc::new(Self {
            shared: Arc::new(Shared { persistence, results, clock, diagnose, config, job }),
            stop,
        })
    }

    /// Another configuration; a job that runs goes on with its own.
    pub(super) fn reload(&self, config: &Arc<Config>) {
        *lock(&self.shared.config) = config.clone();
    }
}

impl BackfillPort for BackfillJobs {
    fn job(&self) -> Option<BackfillRun> {
        lock(&self.shared.job).as_ref().map(|(job, _)| job.clone())
    }

    fn begin(&self, request: BackfillRequest) -> Result<BackfillRun, BackfillRefusal> {
        let config = lock(&self.shared.config).clone();
        // Where it is kept does not change by a reload.
        let store = self.shared.persistence.configured();
        if let Some(why) = store.as_ref().and_then(|own| too_old(&request, own, self.shared.clock.now())) {
            return Err(BackfillRefusal::TooOld(why));
        }
        let past = match &request.file {
            Some(file) => Past::File(Box::new(file::named(file, &request.id, &config.tables)?)),
            None => Past::Store(Box::new(store.ok_or(BackfillRefusal::NoStore)?)),
        };
        let mut job = lock(&self.shared.job);
        if job.as_ref().is_some_and(|(job, _)| job.phase.runs()) {
            return Err(BackfillRefusal::Runs);
        }
        let phase = if request.read_devices { BackfillPhase::Reading } else { BackfillPhase::Diagnosing };
        let begun = BackfillRun {
            request: request.clone(),
            phase,
            done: 0,
            of: 0,
            started: self.shared.clock.now(),
            ended: None,
            found: None,
            read_as: None,
        };
        let cancel = self.stop.child_token();
        *job = Some((begun.clone(), cancel.clone()));
        drop(job);
        tracing::info!(control_loop = %request.id, from = request.from, to = request.to, "backfill: begun");
        tokio::spawn(self.shared.clone().work(request, config, past, cancel));
        Ok(begun)
    }

    fn cancel(&self) -> Option<BackfillRun> {
        let mut job = lock(&self.shared.job);
        let (job, cancel) = job.as_mut().filter(|(job, _)| job.phase.runs())?;
        cancel.cancel();
        Some(job.clone())
    }
}

impl Shared {
    async fn work(
        self: Arc<Self>,
        request: BackfillRequest,
        config: Arc<Config>,
        past: Past,
        cancel: CancellationToken,
    ) {
        let mut ended = Ok(());
        if request.read_devices {
            let reading = self.read_devices(&request, &config);
            ended = cancel.run_until_cancelled(reading).await.unwrap_or(Ok(()));
        }
        let phase = match ended {
            Err(why) => BackfillPhase::Failed(why),
            Ok(()) if cancel.is_cancelled() => BackfillPhase::Cancelled,
            Ok(()) => {
                let own = self.clone();
                let judging = move || own.judge(&request, &config, &past, &cancel);
                match tokio::task::spawn_blocking(judging).await {
                    Ok(phase) => phase,
                    Err(error) => BackfillPhase::Failed(format!("the diagnosis failed: {error}")),
                }
            }
        };
        match &phase {
            BackfillPhase::Failed(why) => tracing::warn!(why, "backfill: failed"),
            phase => tracing::info!(phase = phase.as_str(), "backfill: ended"),
        }
        let ended = self.clock.now();
        self.change(|job| (job.phase, job.ended) = (phase, Some(ended)));
    }

    /// Changes the job and tells it.
    fn change(&self, change: impl FnOnce(&mut BackfillRun)) {
        let mut held = lock(&self.job);
        let Some((job, _)) = held.as_mut() else { return };
        change(job);
        let (id, phase) = (job.request.id.clone(), job.phase.as_str());
        self.results.tell_backfill(Event::Backfill { id, phase, done: job.done, of: job.of });
    }

    /// Reads what the loop's OPC UA servers kept.
    async fn read_devices(
        self: &Arc<Self>,
        request: &BackfillRequest,
        config: &Config,
    ) -> Result<(), String> {
        let plant = config
            .plant()
            .map_err(|issues| issues.first().map_or_else(String::new, |issue| issue.message.clone()))?;
        let all = plant.loops.iter().flat_map(|l| l.tags.iter().map(move |tag| (l, tag))).enumerate();
        let own = all.filter(|(_, (l, _))| l.id == request.id);
        let names: HashMap<usize, Arc<TagName>> = own
            .map(|(at, (l, tag))| {
                let (source, unit) = (tag.source.clone(), tag.unit.clone());
                let (control_loop, tag) = (l.id.to_string(), tag.kind.name().to_string());
                (at, Arc::new(TagName { control_loop, tag, source, unit }))
            })
            .collect();
        let plans = plant.opcua.into_iter().filter_map(|mut plan| {
            plan.tags.retain(|tag| names.contains_key(&tag.index));
            (!plan.tags.is_empty()).then_some(plan)
        });
        let plans: Vec<opcua::Plan> = plans.collect();
        if plans.is_empty() {
            return Err("no tag of the loop is read from a server that could keep history".to_string());
        }
        let history = Wish {
            from: request.from,
            to: request.to,
            newest_first: false,
            slice_s: SLICE_S,
            pause: PAUSE,
            average_s: None,
        };
        let of = plans.len() * history.slices().count();
        self.change(|job| job.of = of);
        let mut kept = Kept { shared: self.clone(), names };
        for plan in &plans {
            opcua::history(plan, &history, &mut kept).await.map_err(|error| error.to_string())?;
        }
        Ok(())
    }

    fn judge(
        &self,
        request: &BackfillRequest,
        config: &Config,
        past: &Past,
        cancel: &CancellationToken,
    ) -> BackfillPhase {
        let record = match past {
            Past::Store(store) => stored(request, store, cancel),
            Past::File(file) => file.read(request).map(|(record, read_as)| {
                self.change(|job| job.read_as = Some(read_as));
                Some(record)
            }),
        };
        let judged = record.and_then(|found| match found {
            Some(record) => self.timeline(request, config, record, cancel),
            None => Ok(None),
        });
        match judged {
            Ok(Some(found)) => {
                self.change(|job| job.found = Some(Arc::new(found)));
                BackfillPhase::Done
            }
            Ok(None) => BackfillPhase::Cancelled,
            Err(why) => BackfillPhase::Failed(why),
        }
    }

    /// The timeline; `None` where nobody wants it any more.
    fn timeline(
        &self,
        request: &BackfillRequest,
        config: &Config,
        mut record: Record,
        cancel: &CancellationToken,
    ) -> Result<Option<Timeline>, String> {
        if let Some(own) = config.loops.iter().find(|l| l.id == request.id.as_str()) {
            record.op_limits = own.op_limits.map(|[low, high]| (low, high)).or(record.op_limits);
            // What the configuration says of OP goes before what its values look like, not before a file's own unit.
            if own.op_span.is_some() || record.op_span_source == SpanSource::Values {
                record.op_span = None;
            }
            record.find_span(own.op_span, own.op.unit());
        }
        record.find_span(None, None);
        let marked = Marked::from(record);
        let empty = || BackfillError::Empty.to_string();
        let cut = usual_cut(&marked.record, request.window_s, request.step_s).ok_or_else(empty)?;
        // The record of a file may be far shorter than the time that is asked for.
        let ends = [marked.record.pv.first(), marked.record.pv.last()].map(|s| s.map_or(0.0, |s| s.t));
        let asked = if request.file.is_some() { ends[1] - ends[0] } else { request.to - request.from };
        if asked / cut.step_s > MOST_WINDOWS {
            return Err(format!("more than {MOST_WINDOWS} windows; take a longer step"));
        }
        self.change(|job| (job.phase, job.done, job.of) = (BackfillPhase::Diagnosing, 0, 0));
        let progress = |done: usize, of: usize| {
            self.change(|job| (job.done, job.of) = (done, of));
            !cancel.is_cancelled()
        };
        let (settings, judge) = (Settings::from(&config.diagnosis), self.diagnose.as_ref());
        let judge = |record: &Record, settings: &Settings, last: Option<&_>| judge(record, settings, last);
        match timeline(&request.id, marked, cut, &settings, &config.alarm, &judge, progress) {
            Err(BackfillError::Cancelled) => Ok(None),
            found => found.map(Some).map_err(|error| error.to_string()),
        }
    }
}

/// Why nothing is read from devices: what is older than samples are kept in full is thinned as soon as it is stored, which is
/// before it is diagnosed.
fn too_old(request: &BackfillRequest, store: &store::Config, now: f64) -> Option<String> {
    let (days, kept) = ((now - request.from) / DAY_S, store.samples_days);
    (request.read_devices && days > kept).then(|| {
        format!(
            "from is {days:.1} days ago and [store] samples_days = {kept}: what devices send of before that would be thinned \
             before it is diagnosed; raise samples_days and start anew, or ask for less"
        )
    })
}

/// Where the past is read.
enum Past {
    Store(Box<store::Config>),
    File(Box<file::Table>),
}

/// A loop's own tags as the store has them, read a day at a time; `None` where nobody wants them any more.
fn stored(
    request: &BackfillRequest,
    config: &store::Config,
    cancel: &CancellationToken,
) -> Result<Option<Record>, String> {
    let said = |error: StoreError| error.to_string();
    let mut reader = Reader::at_hand(config).map_err(said)?;
    let names = ["op", "pv", "sp", "mode", "mv", "term"];
    let mut series: [Vec<Sample>; 6] = std::array::from_fn(|_| Vec::new());
    let mut from = request.from;
    while from < request.to {
        // The next slice begins behind the last sample that this one may hold.
        let to = (from + DAY_S).min(request.to);
        for (name, series) in names.iter().zip(&mut series) {
            let slice = reader.between(request.id.as_str(), name, from, to).map_err(said)?;
            let last = series.last().map_or(f64::NEG_INFINITY, |sample| sample.t);
            series.extend(slice.into_iter().filter(|sample| sample.t > last));
        }
        if cancel.is_cancelled() {
            return Ok(None);
        }
        if series.iter().map(Vec::len).sum::<usize>() > MOST_SAMPLES {
            return Err(format!("more than {MOST_SAMPLES} samples; ask for less time"));
        }
        from = to;
    }
    let [op, pv, sp, mode, mv, term] = series;
    let some = |series: Vec<Sample>| Some(series).filter(|series| !series.is_empty());
    let (sp, mode, mv, term) = (some(sp), some(mode), some(mv), some(term));
    Ok(Some(Record { op, pv, sp, mode, mv, term, ..Record::default() }))
}

/// Puts slices into the daemon's store.
struct Kept {
    shared: Arc<Shared>,
    names: HashMap<usize, Arc<TagName>>,
}

impl Keep for Kept {
    async fn keep(&mut self, slice: Slice) -> Result<(), String> {
        let named =
            |(at, samples): (usize, Vec<Sample>)| Some(Series { tag: self.names.get(&at)?.clone(), samples });
        let batch = Batch { series: slice.series.into_iter().filter_map(named).collect(), rows: Vec::new() };
        let persistence = self.shared.persistence.clone();
        let kept = tokio::task::spawn_blocking(move || persistence.insert(batch)).await;
        kept.unwrap_or_else(|error| Err(error.to_string()))?;
        self.shared.change(|job| job.done += 1);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::LoopId;

    #[test]
    fn devices_are_not_asked_for_what_the_store_would_thin_at_once() {
        let (store, now) = (store::Config { samples_days: 30.0, ..store::Config::new("s") }, 1e9);
        let told = |days: f64, read_devices| {
            let (id, from) = (LoopId::new("A"), now - days * DAY_S);
            let (window_s, step_s, file) = (None, None, None);
            too_old(&BackfillRequest { id, from, to: now, window_s, step_s, read_devices, file }, &store, now)
        };
        assert_eq!(told(29.9, true), None);
        assert_eq!(told(90.0, false), None, "what the store has of then is all there is");
        let why = told(90.0, true).expect("a reason");
        assert!(why.contains("90.0 days ago and [store] samples_days = 30:"), "{why}");
    }
}
