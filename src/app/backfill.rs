//! The past of a loop as a job beside the daemon: devices that keep history are read into the store, and what the store then
//! has is diagnosed window by window, on one thread, with nothing said to operators.

mod file;

use super::persistence::Persistence;
use super::span::{self, Origin};
use crate::backfill::{BackfillError, Marked, Part, Past, Timeline, timeline, usual_cut};
use crate::collect::opcua::{self, Keep, Pinned, Slice, Wish};
use crate::config::Config;
use crate::diagnosis::Settings;
use crate::results::{Event, Results};
use crate::schedule::{Clock, Diagnose};
use crate::serve::{BackfillPhase, BackfillPort, BackfillRefusal, BackfillRequest, BackfillRun};
use crate::signal::{Record, Sample};
use crate::store::{self, Batch, Reader, Series, StoreError, StoredTag, TagName};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Time asked of a device, and kept, at once (s).
const SLICE_S: f64 = 3600.0;
/// Rest between two requests to a device, which has others to answer.
const PAUSE: Duration = Duration::from_millis(100);
/// A day (s).
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
    pinned: Pinned,
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
        (persistence, results, pinned): (&Arc<Persistence>, &Arc<Results>, &Pinned),
        diagnose: Diagnose,
        stop: CancellationToken,
    ) -> Arc<Self> {
        let (persistence, results, pinned) = (persistence.clone(), results.clone(), pinned.clone());
        let (config, job) = (Mutex::new(config.clone()), Mutex::default());
        let shared = Shared { persistence, results, pinned, clock, diagnose, config, job };
        Arc::new(Self { shared: Arc::new(shared), stop })
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
        let source = match &request.file {
            Some(file) => Source::File(Box::new(file::named(file, &request.id, &config.tables)?)),
            None => Source::Store(Box::new(store.ok_or(BackfillRefusal::NoStore)?)),
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
        tokio::spawn(self.shared.clone().work(request, config, source, cancel));
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
        source: Source,
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
                let judging = move || own.judge(&request, &config, &source, &cancel);
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
            let read = opcua::history(plan, &history, &self.pinned, &mut kept).await;
            read.map_err(|error| error.to_string())?;
        }
        Ok(())
    }

    fn judge(
        &self,
        request: &BackfillRequest,
        config: &Config,
        source: &Source,
        cancel: &CancellationToken,
    ) -> BackfillPhase {
        let mut op_unit = None;
        let past = match source {
            Source::Store(store) => stored(request, store, config, cancel),
            Source::File(file) => file.read(request).map(|read| {
                op_unit = read.found.op_unit;
                self.change(|job| job.read_as = Some(read.found.read_as));
                Some(Past::from(read.record))
            }),
        };
        let origin = match source {
            Source::Store(_) => Origin::Tag,
            Source::File(_) => Origin::File(op_unit.as_deref()),
        };
        let judged = past.and_then(|found| match found {
            Some(past) => self.timeline(request, config, (past, origin), cancel),
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
        (mut past, origin): (Past, Origin<'_>),
        cancel: &CancellationToken,
    ) -> Result<Option<Timeline>, String> {
        // The span may have to be found from all values of OP, whatever window they are of.
        let mut record = Record { op: past.all("op").into_owned(), ..std::mem::take(&mut past.known) };
        let own = config.loops.iter().find(|l| l.id == request.id.as_str());
        span::find_span(&mut record, own, origin)?;
        past.known = Record { op: Vec::new(), ..record };
        let marked = Marked::from(past);
        let empty = || BackfillError::Empty.to_string();
        let cut = usual_cut(&marked.past, request.window_s, request.step_s).ok_or_else(empty)?;
        // The record of a file may be far shorter than the time that is asked for.
        let asked = if request.file.is_some() {
            let pv = marked.past.all("pv");
            pv.first().zip(pv.last()).map_or(0.0, |(first, last)| last.t - first.t)
        } else {
            request.to - request.from
        };
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
enum Source {
    Store(Box<store::Config>),
    File(Box<file::Table>),
}

/// A loop's own tags as the store has them; `None` where nobody wants them any more.
fn stored(
    request: &BackfillRequest,
    store: &store::Config,
    config: &Config,
    cancel: &CancellationToken,
) -> Result<Option<Past>, String> {
    let said = |error: StoreError| {
        store::heed(store, &error);
        error.to_string()
    };
    let mut reader = Reader::at_hand(store).map_err(said)?;
    let names = ["op", "pv", "sp", "mode", "mv", "term"];
    let id = request.id.as_str();
    let mut tags = reader.tags().map_err(said)?;
    tags.retain(|tag| tag.name.control_loop == id && names.contains(&tag.name.tag.as_str()));
    let mut count = 0;
    let mut go_on = |samples: usize| {
        count = samples;
        samples <= MOST_SAMPLES && !cancel.is_cancelled()
    };
    let found =
        reader.in_force(&tags, &["op", "pv"], [request.from, request.to], &mut go_on).map_err(said)?;
    store::heed_blobs(store, reader.damaged());
    if cancel.is_cancelled() {
        return Ok(None);
    }
    if count > MOST_SAMPLES {
        return Err(format!("more than {MOST_SAMPLES} samples; ask for less time"));
    }
    let plant = config.plant().ok();
    let own = plant.iter().flat_map(|plant| &plant.loops).find(|l| l.id == request.id);
    let is_configured = |stored: &StoredTag| {
        let tags = own.map_or(&[][..], |l| &l.tags[..]);
        tags.iter().any(|tag| tag.kind.name() == stored.name.tag && tag.source == stored.name.source)
    };
    let found = found.unwrap_or_default().into_iter();
    // A mode of which nothing is known is not to be taken for automatic.
    let is_told = |(tag, samples): &(StoredTag, Vec<Sample>)| tag.name.tag == "mode" || !samples.is_empty();
    let part = |(tag, samples): (StoredTag, Vec<Sample>)| Part {
        configured: is_configured(&tag),
        era: tag.era,
        tag: tag.name.tag,
        samples,
    };
    let parts = found.filter(is_told).map(part).collect();
    Ok(Some(Past { known: Record::default(), parts }))
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
        self.shared.change(|job| job.done += usize::from(slice.is_last));
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

    const PLANT: &str = r#"
        [[modbus]]
        name = "dcs1"
        address = "10.0.0.5:502"
        address_base = 0
        [[loop]]
        id = "A"
        [loop.op]
        device = "dcs1"
        register = "holding"
        address = 100
        type = "f32"
        [loop.pv]
        device = "dcs1"
        register = "holding"
        address = 102
        type = "f32"
    "#;

    #[test]
    fn the_past_has_what_was_in_force_when_it_begins_and_knows_where_its_tags_are_read() {
        let folder = std::env::temp_dir().join(format!("stictiond-past-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let config = crate::config::parse("plant.toml", PLANT).expect("sound");
        let plant = config.plant().expect("sound");
        let read_at = plant.loops[0].tags[0].source.as_str();
        let series = |tag: &str, source: &str, samples: Vec<Sample>| {
            let (control_loop, tag, source) = ("A".into(), tag.into(), source.into());
            Series { tag: Arc::new(TagName { control_loop, tag, source, unit: String::new() }), samples }
        };
        let polled = || (5000..6000u32).map(|t| Sample::good(f64::from(t), 1.0)).collect::<Vec<Sample>>();
        let series = vec![
            series("op", read_at, polled()),
            series("op", "another register", polled()),
            series("pv", "another register", polled()),
            series("mode", "a node", vec![Sample::good(1000.0, 0.0), Sample::good(2000.0, 1.0)]),
            series("sp", "a node", vec![Sample::good(7000.0, 50.0)]),
        ];
        let own = store::Config::new(&folder);
        let mut kept = store::Store::open(&own).expect("opens");
        kept.write(&Batch { series, rows: Vec::new() }).expect("writes");
        drop(kept);
        let (id, window_s, step_s) = (LoopId::new("A"), None, None);
        let (from, to, read_devices, file) = (5500.0, 6000.0, false, None);
        let request = BackfillRequest { id, from, to, window_s, step_s, read_devices, file };
        let cancel = CancellationToken::new();
        let past = stored(&request, &own, &config, &cancel).expect("read").expect("wanted");
        let read: Vec<bool> = past.of("op").map(|part| part.configured).collect();
        assert_eq!(read, [true, false]);
        assert_eq!(past.all("pv").len(), 500);
        let window = past.window(5500.0, 5999.0);
        assert_eq!(window.mode, Some(vec![Sample::good(2000.0, 1.0)]));
        assert_eq!(window.sp, None, "nothing is known of it yet");
        let earlier = BackfillRequest { from: 500.0, to: 900.0, ..request.clone() };
        let before = stored(&earlier, &own, &config, &cancel);
        let before = before.expect("read").expect("wanted");
        assert_eq!(before.window(500.0, 900.0).mode, Some(vec![]), "the loop has one, and it is not known");
        cancel.cancel();
        assert_eq!(stored(&request, &own, &config, &cancel), Ok(None));
        std::fs::remove_dir_all(&folder).expect("it was made");
    }
}
