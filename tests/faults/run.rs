//! One run: several lives of the daemon under one clock, one network and one disk, all of it a function of a seed.

use crate::check;
use crate::disk::{Bug, Disk};
use crate::network::{Network, PAIRS};
use crate::plant;
use crate::time::TimeLine;
use crate::truth::{Content, Truth};
use crate::verdict;
use hyper_util::service::TowerToHyperService;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use stictiond::alarm::{Cause, Kind};
use stictiond::app::{App, Surroundings};
use stictiond::results::MOST_CHANGES;
use stictiond::schedule::Clock;
use stictiond::signal::LoopId;
use stictiond::store::Reader;
use tokio::net::TcpListener;

/// What happens within so long of each other happens at once (s).
const SAME_S: f64 = 0.1;

/// What a run came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// A number for all that was stored.
    pub print: u64,
    pub samples: usize,
    pub counts: BTreeMap<&'static str, u64>,
}

/// A folder of its own, gone with the run.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Runs a seed.
///
/// # Errors
/// What did not hold.
pub fn run(seed: u64, bug: Bug, told: bool) -> Result<Outcome, String> {
    // In memory, where the system has such a place: nobody waits for a disk that is simulated.
    let memory = Path::new("/dev/shm");
    let place = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
    let folder = Folder(place.join(format!("stictiond-faults-{}-{seed}-{bug:?}", std::process::id())));
    let _ = std::fs::remove_dir_all(&folder.0);
    let mut random = Pcg64::seed_from_u64(seed);
    let time = Arc::new(Mutex::new(TimeLine::new()));
    let world = World {
        network: Network::new(random.random(), time.clone(), bug == Bug::TakesAnswerForNext),
        disk: Disk::new(random.random(), &folder.0, bug),
        time,
        random,
        acts: 0,
        counts: BTreeMap::new(),
        variant: 0,
        jumped: false,
        steady: Vec::new(),
        told,
    };
    world.live()
}

struct World {
    network: Network,
    disk: Disk,
    time: Arc<Mutex<TimeLine>>,
    random: Pcg64,
    acts: u64,
    counts: BTreeMap<&'static str, u64>,
    /// Which configuration is in force.
    variant: usize,
    /// Clocks were set since the last round of the store.
    jumped: bool,
    /// When lives and configurations began (s).
    steady: Vec<f64>,
    /// Says what happens.
    told: bool,
}

/// One life, while it lasts.
struct Life {
    app: Arc<App>,
    clock: Clock,
    /// Changes of alarms that were looked at.
    seen: u64,
    /// When it began (s).
    began: f64,
    reloaded: bool,
    /// When it was last looked at (s).
    looked: f64,
    /// Samples that were in the store when it began.
    samples: usize,
}

impl World {
    fn time(&self) -> MutexGuard<'_, TimeLine> {
        self.time.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says what happens, to who runs one seed again.
    fn say(&self, what: &str) {
        if self.told {
            let time = self.time().clone();
            let (now, wall) = (time.now(), time.wall());
            println!("{now:10.3} s  clock {wall:.3}  {what}");
        }
    }

    fn count(&mut self, what: &'static str) {
        *self.counts.entry(what).or_default() += 1;
    }

    fn live(mut self) -> Result<Outcome, String> {
        for _ in 0..self.random.random_range(2..5) {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .start_paused(true)
                .build()
                .expect("a runtime");
            let lived = runtime.block_on(async {
                let lived = self.one_life().await;
                let rest = self.random.random_range(1..30_000);
                // Here, where its time is known.
                self.time().end(Duration::from_millis(rest));
                lived
            });
            // Whatever was under way is dropped where it waits.
            drop(runtime);
            lived?;
            if self.random.random_bool(0.2) {
                self.jump(None);
            }
        }
        self.disk.begin();
        let content = self.hold()?;
        let mut counts = self.counts.clone();
        counts.extend(self.network.counts());
        counts.extend(self.disk.counts());
        let print = self.disk.truth(|truth| truth.print());
        let samples = content.samples.iter().map(|(_, own)| own.len()).sum();
        Ok(Outcome { print, samples, counts })
    }

    /// Holds the store against the truth.
    fn hold(&self) -> Result<Content, String> {
        let mut reader = Reader::open(&self.disk.folder()).map_err(|error| error.to_string())?;
        if let Some((lost, _)) = reader.lost() {
            return Err(format!("the store is damaged after an honest crash: {lost}"));
        }
        let content = Content::of(&mut reader)?;
        self.disk.truth(|truth: &mut Truth| truth.hold_against(&content))?;
        check::samples(&content, &self.network, &self.time())?;
        check::causes(&content, &self.network, &self.time(), &self.steady)?;
        Ok(content)
    }

    async fn one_life(&mut self) -> Result<(), String> {
        self.disk.begin();
        self.time().begin();
        let clock = Clock::adjusted(self.time().wall());
        let around = Surroundings { clock, dial: self.network.dial(), store: self.disk.driven() };
        let config = plant::config(self.variant, &self.disk.folder());
        let app =
            App::build_in(around, config, verdict::made_up(clock)).map_err(|error| error.to_string())?;
        let app = Arc::new(app);
        if self.disk.folder().join("store.db").exists() {
            self.hold()?;
        }
        let listener = TcpListener::bind("127.0.0.1:0").await.map_err(|error| error.to_string())?;
        let running = app.clone();
        let task = tokio::spawn(async move { running.run(listener).await });
        let began = self.time().now();
        self.steady.push(began);
        self.say("begins");
        // It is the first round that looks how late it is.
        self.jumped = true;
        let samples = self.disk.truth(|truth| truth.samples());
        let seen = app.results().latest_change();
        let mut life = Life { seen, app, clock, began, reloaded: false, looked: began, samples };
        let ends = began + f64::from(self.random.random_range(20..150));
        while self.time().now() < ends && !self.disk.is_dead() {
            tokio::time::sleep(Duration::from_millis(self.random.random_range(100..2500))).await;
            self.step(&mut life).await?;
            self.look(&mut life)?;
        }
        if self.disk.is_dead() || self.random.random_bool(0.6) {
            self.disk.kill();
            self.say("killed");
            return Ok(());
        }
        self.count("stops");
        self.say("stopped");
        self.stop(life, task).await
    }

    async fn step(&mut self, life: &mut Life) -> Result<(), String> {
        let device = self.random.random_range(0..2);
        match self.random.random_range(0..100) {
            0..50 => {
                self.round(life);
            }
            50..58 => {
                let likely =
                    if self.random.random_bool(0.5) { self.random.random_range(0.0..0.6) } else { 0.0 };
                self.say(&format!("device {device} fails {likely:.2} of the time"));
                self.network.set_faults(device, likely);
            }
            58..63 => {
                self.count("links cut");
                self.network.set_cut(device, true);
            }
            63..72 => self.network.set_cut(device, false),
            72..77 => {
                let fails = self.random.random_range(0.0..0.5);
                let full = self.random.random_bool(0.3);
                self.say(&format!("the disk fails {fails:.2} of the time, full: {full}"));
                self.disk.set_faults(fails, full);
            }
            77..84 => {
                self.say("the disk works");
                self.disk.set_faults(0.0, false);
            }
            84..88 => {
                let pair = self.random.random_range(0..2 * PAIRS);
                let sticks = self.random.random_bool(0.6);
                self.network.set_sticks(pair, sticks);
            }
            88..91 => self.jump(Some(life.clock)),
            91..93 => self.reload(life).await?,
            93..98 => self.act(life).await?,
            _ => {
                self.say("it is to die in the next write");
                self.disk.die();
            }
        }
        Ok(())
    }

    fn round(&mut self, life: &Life) {
        self.count("rounds of the store");
        let durable = life.app.make_durable();
        self.say(if durable { "the store has all" } else { "the store fails" });
        self.jumped = false;
    }

    /// Sets the clocks: forward, or back by so much that it is no correction.
    fn jump(&mut self, clock: Option<Clock>) {
        // Two between two looks would be one.
        if std::mem::replace(&mut self.jumped, true) {
            return;
        }
        let forward = self.random.random_bool(0.5);
        let by: f64 = if forward {
            self.random.random_range(5.0..4000.0)
        } else {
            -self.random.random_range(90.0..3000.0)
        };
        self.count(if forward { "clocks set forward" } else { "clocks set back" });
        self.time().jump(by);
        self.say(&format!("clocks are set by {by:.1} s"));
        if let Some(clock) = clock {
            clock.set(clock.now() + by);
        }
    }

    async fn reload(&mut self, life: &mut Life) -> Result<(), String> {
        self.count("reloads");
        self.variant = self.random.random_range(0..plant::VARIANTS);
        self.say(&format!("reloaded, configuration {}", self.variant));
        life.reloaded = true;
        let config = plant::config(self.variant, &self.disk.folder());
        life.app.reload(config).await.map_err(|error| format!("a reload is refused: {error}"))?;
        self.jumped = false;
        let now = self.time().now();
        self.steady.push(now);
        Ok(())
    }

    /// Somebody acknowledges an alarm; what is answered to survive a restart is durable.
    async fn act(&mut self, life: &Life) -> Result<(), String> {
        use hyper::service::Service;
        self.acts += 1;
        let by = format!("operator {}", self.acts);
        let id = plant::LOOPS[self.random.random_range(0..plant::LOOPS.len())];
        let request = axum::http::Request::post(format!("/api/v1/alarms/{id}/ack"))
            .header("host", "localhost")
            .header("content-type", "application/json")
            .body(axum::body::Body::from(format!("{{\"by\":\"{by}\"}}")))
            .expect("a request");
        let answer = TowerToHyperService::new(life.app.routes()).call(request).await.expect("it answers");
        let status = answer.status().as_u16();
        if ![200, 404, 409].contains(&status) {
            return Err(format!("an acknowledgement is answered with {status}"));
        }
        let body =
            axum::body::to_bytes(answer.into_body(), 1 << 20).await.map_err(|error| error.to_string())?;
        if status != 200 || self.disk.is_dead() {
            return Ok(());
        }
        let answer: serde_json::Value = serde_json::from_slice(&body).map_err(|error| error.to_string())?;
        if answer["survives_restart"] == true {
            self.count("acknowledgements that survive");
            if !self.disk.truth(|truth| truth.has_act(&by)) {
                return Err(format!("{by} was told that it survives, and it is not on disk"));
            }
        }
        Ok(())
    }

    /// What has to hold at every moment.
    fn look(&mut self, life: &mut Life) -> Result<(), String> {
        let results = life.app.results();
        for id in plant::LOOPS {
            let kept = results.summaries(&LoopId::new(id)).map_or(0, |kept| kept.len());
            if kept > plant::KEEP {
                return Err(format!("{kept} runs of {id} are remembered, more than {}", plant::KEEP));
            }
        }
        let now = self.time().now();
        let changes = results.alarm_log();
        if changes.len() > MOST_CHANGES {
            return Err(format!("{} changes are remembered, more than {MOST_CHANGES}", changes.len()));
        }
        for change in changes {
            if change.number <= life.seen || change.transition.cause != Cause::Raised {
                continue;
            }
            self.count("alarms");
            // The moment of it; where clocks were set, the earliest that it can be.
            let raised = self.time().when(change.transition.at, life.looked, now).unwrap_or(life.looked);
            if change.id.kind == Kind::CollectorDown {
                let device = usize::from(change.id.subject.as_str() == "d1");
                let silent = raised - self.network.answered(device, raised - SAME_S).max(life.began);
                if silent < plant::DOWN_AFTER_S - SAME_S {
                    return Err(format!("{:?} was raised after {silent:.1} s: {}", change.id, change.detail));
                }
            }
        }
        life.looked = now;
        life.seen = results.latest_change();
        Ok(())
    }

    /// Stops the daemon as a person does, on a disk that works; then nothing at all is lost.
    async fn stop(
        &mut self,
        life: Life,
        task: tokio::task::JoinHandle<Result<(), stictiond::app::AppError>>,
    ) -> Result<(), String> {
        self.disk.set_faults(0.0, false);
        life.app.stop().cancel();
        let ended = tokio::time::timeout(Duration::from_secs(60), task).await;
        ended.map_err(|_| "it does not stop")?.map_err(|e| e.to_string())?.map_err(|e| e.to_string())?;
        if life.reloaded || self.disk.is_dead() {
            return Ok(());
        }
        let told = plant::told(&life.app).await?;
        let measured = told("device", "good_samples") + told("device", "bad_samples");
        let lost = told("store", "lost_samples") + told("store", "refused_samples");
        let stored = self.disk.truth(|truth| truth.samples()) - life.samples;
        if lost > 0.0 || stored as f64 != measured {
            return Err(format!("{measured} samples were measured, {stored} stored, {lost} lost"));
        }
        Ok(())
    }
}
