//! Faults, made on a plant behind real Modbus connections, against the daemon as a process: the term reaches zero, by the
//! daemon or by the DCS's heartbeat time-out, within the time that the configuration says. The table in
//! docs/writeback.md is what this prints.

use super::daemon::{Daemon, FROZEN_S, RAMP_S, STEP_S};
use super::plant::{HEARTBEAT_S, Link, Plant, until};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::time::{Duration, Instant};
use stictiond::audit::Recorder;
use stictiond::compensation::gate::{Action, Evidence, Inputs, State, Time};
use stictiond::signal::LoopId;
use stictiond::writeback::{LoopSetup, Writeback};
use tokio::process::Command;
use tokio::sync::watch;

const PATIENCE: Duration = Duration::from_secs(60);
/// What a busy machine may add to any time here (s): it holds tests of a whole suite.
const SLACK_S: f64 = 1.0;

async fn verified(daemon: &Daemon) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    let output = command.args(["audit", "verify"]).arg(&daemon.audit).output().await;
    let output = output.expect("the binary starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    std::fs::read_to_string(&daemon.audit).expect("text")
}

/// Waits until a term is in force.
async fn in_force(plant: &Plant) {
    until("in force", PATIENCE, || plant.term().0.abs() > 0.5).await;
}

/// From now until no term is in force and none comes back; how long that took (s), and whether zero stands in the register.
async fn to_zero(plant: &Plant, what: &str, bound_s: f64) -> (f64, bool) {
    let began = Instant::now();
    // A reinforcement passes through zero by itself: it has stayed there when it has for five of the plant's samples.
    let mut since: Option<Instant> = None;
    until(what, PATIENCE, || {
        since = if plant.term().0 == 0.0 { since.or(Some(Instant::now())) } else { None };
        since.is_some_and(|since| since.elapsed() > Duration::from_millis(500))
    })
    .await;
    let took = since.expect("held").duration_since(began).as_secs_f64();
    assert!(took <= bound_s + SLACK_S, "{what}: {took:.2} s, at most {bound_s} s");
    (took, plant.term().1 == 0.0)
}

fn row(what: &str, cause: &str, (took, zero): (f64, bool), bound_s: f64) {
    let by = if zero { "the daemon" } else { "the DCS's time-out" };
    println!("| {what} | {cause} | {by} | {took:.2} s | {bound_s:.2} s |");
}

/// A plant, the link to it, and a daemon that writes over the link.
struct Site {
    plant: Arc<Plant>,
    link: Link,
    daemon: Daemon,
}

impl Site {
    async fn start(name: &str) -> Self {
        let plant = Plant::start();
        let address = plant.listen().await;
        let link = Link::start(address).await;
        let daemon = Daemon::start(address, link.address, name).await;
        Self { plant, link, daemon }
    }

    async fn open(&self) {
        self.daemon.open().await;
        in_force(&self.plant).await;
    }

    /// A fault trips it for this cause; then all is well again, and it is reset. How many writes were still to be cut.
    async fn trips(&self, what: &str, code: &str, bound_s: f64, fault: impl FnOnce(&Self)) -> usize {
        self.open().await;
        fault(self);
        let taken = to_zero(&self.plant, what, bound_s).await;
        let status = self.daemon.state("tripped").await;
        assert_eq!(status["tripped_by"]["code"], code, "{what}: {status}");
        row(what, code, taken, bound_s);
        let left = self.link.cuts_left();
        let faults = &self.plant.faults;
        for own in [&faults.manual, &faults.pv_frozen, &faults.ignores_writes] {
            own.store(false, SeqCst);
        }
        self.link.cut_writes(0);
        self.daemon.act("reset", r#"{"by": "Ann"}"#).await;
        left
    }

    /// It ends well, and its record is whole.
    async fn ends(&mut self) -> String {
        let ended = tokio::time::timeout(PATIENCE, self.daemon.child.wait()).await.expect("it ends");
        assert_eq!(ended.expect("waited").code(), Some(0));
        verified(&self.daemon).await
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_fault_brings_the_term_to_zero_in_time() {
    // Most of the time the loop is measured until the term may come back: on two plants that takes half as long.
    tokio::join!(faults_of_the_plant_and_signals(), faults_of_the_link());
}

async fn faults_of_the_plant_and_signals() {
    let mut site = Site::start("faults").await;
    let bound_s = STEP_S + RAMP_S;
    let manual = |site: &Site| site.plant.faults.manual.store(true, SeqCst);
    site.trips("mode to manual", "not_automatic", bound_s, manual).await;
    let frozen = |site: &Site| site.plant.faults.pv_frozen.store(true, SeqCst);
    site.trips("a frozen PV", "pv_bad", FROZEN_S + bound_s, frozen).await;

    site.open().await;
    site.daemon.signal("-HUP");
    let taken = to_zero(&site.plant, "SIGHUP", bound_s).await;
    assert!(taken.1);
    let status = site.daemon.state("shadow").await;
    assert_eq!(status["grant"], serde_json::Value::Null, "granted was the old file");
    row("SIGHUP, the same file again", "stopped", taken, bound_s);

    site.open().await;
    site.daemon.signal("-TERM");
    let taken = to_zero(&site.plant, "SIGTERM", bound_s).await;
    assert!(taken.1, "SIGTERM ramps to zero itself");
    row("SIGTERM", "stopped", taken, bound_s);
    let record = site.ends().await;
    for what in
        ["grant", "approval", "cause=\"opened\"", "cause=\"not_automatic\"", "cause=\"reset\"", " write "]
    {
        assert!(record.contains(what), "{what} is not on record");
    }
    assert!(record.contains("cause=\"stopped\"") && record.contains("from=\"withdrawing\" to=\"disabled\""));
}

async fn faults_of_the_link() {
    let mut site = Site::start("faults-of-the-link").await;
    let what = "the link cut in the middle of a write, once";
    let left = site.trips(what, "write_failed", STEP_S + RAMP_S, |site| site.link.cut_writes(1)).await;
    assert_eq!(left, 0, "it was cut");
    let what = "every write cut in the middle";
    site.trips(what, "write_failed", HEARTBEAT_S, |site| site.link.cut_writes(usize::MAX)).await;
    let what = "a device that acknowledges and ignores writes";
    let ignored = |site: &Site| site.plant.faults.ignores_writes.store(true, SeqCst);
    site.trips(what, "read_back_mismatch", HEARTBEAT_S, ignored).await;
    site.daemon.signal("-TERM");
    let record = site.ends().await;
    for cause in ["write_failed", "read_back_mismatch", "reset"] {
        assert!(record.contains(&format!("cause=\"{cause}\"")), "{cause} is not on record");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn killed_it_leaves_a_heart_that_stands_still() {
    let plant = Plant::start();
    let address = plant.listen().await;
    let mut daemon = Daemon::start(address, address, "killed").await;
    daemon.open().await;
    in_force(&plant).await;
    daemon.signal("-KILL");
    let taken = to_zero(&plant, "kill -9", HEARTBEAT_S).await;
    assert!(!taken.1, "a term still stands in the register, and the DCS ignores it");
    row("kill -9 of the daemon", "-", taken, HEARTBEAT_S);
    daemon.child.wait().await.expect("waited");
    // Begun again it is in shadow, knows of no grant, writes nothing, and goes on with the record.
    let path = daemon.audit.with_extension("toml");
    let again = Daemon::again(address, address, &path, daemon.audit.clone()).await;
    assert_eq!(again.state("shadow").await["grant"], serde_json::Value::Null);
    assert_eq!(plant.term().0, 0.0);
    verified(&again).await;
}

/// Nobody can make the machine's clock jump in a test: here the parts of the daemon run with a wall clock of the test's.
#[tokio::test(flavor = "multi_thread")]
async fn a_jump_of_the_clock_brings_the_term_to_zero() {
    tokio::join!(
        jumps("the clock jumps ahead by an hour", 3600.0),
        jumps("the clock is set back by a minute", -60.0)
    );
}

async fn jumps(what: &str, jump: f64) {
    let plant = Plant::start();
    let address = plant.listen().await;
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"));
    let audit = folder.join(format!("jump{jump}.audit"));
    let _ = std::fs::remove_file(&audit);
    let _ = std::fs::remove_file(folder.join(format!("jump{jump}.audit.head")));
    let text = super::daemon::config(address, address, &audit);
    let config = stictiond::config::parse("jump", &text).expect("valid");
    let own = config.loops[0].writeback.as_ref().expect("configured");
    let bounds = stictiond::audit::Bounds { max_bytes: 1 << 20, keep_files: 1 };
    let recorder = Arc::new(Recorder::start(&audit, bounds, 0.0).expect("opens"));
    let jumped = Arc::new(AtomicU64::new(0f64.to_bits()));
    let (began, by) = (Instant::now(), Arc::clone(&jumped));
    let clocks = move || {
        let mono = began.elapsed().as_secs_f64();
        Time { mono, wall: 1.7e9 + mono + f64::from_bits(by.load(SeqCst)) }
    };
    let (wall, seen) = (clocks.clone(), Arc::clone(&plant));
    let look = move || {
        let evidence = Evidence { sticky: true, f: 2.5, f_ci95: [2.4, 2.6], at: 1.7e9, data_end: 1.7e9 };
        Inputs { evidence: Some(evidence), ..seen.inputs(wall().wall) }
    };
    let (polled, receiver) = watch::channel(0);
    let id = LoopId::new("LIC201");
    let setup = LoopSetup {
        id: id.clone(),
        limits: own.limits(100.0, [0.0, 100.0]),
        target: own.target(&address.to_string(), 1, 0).expect("registers"),
        pause: Duration::from_millis(25),
        polled: receiver,
        heard: Arc::new(|| 0),
        look: Arc::new(look),
        keep: Arc::new(|_| ()),
        lasts_s: own.term_lasts_s(),
    };
    let writing = Writeback::start(vec![setup], Arc::new(clocks), recorder, Arc::new(|_, _| ()));
    until("ready", PATIENCE, || writing.status(&id).is_some_and(|s| s.denials.len() == 1)).await;
    writing.act(&id, Action::Grant(300.0), "Ann").await.expect("enabled").expect("granted");
    writing.act(&id, Action::Approve, "Bob").await.expect("enabled").expect("approved");
    in_force(&plant).await;
    jumped.store(f64::to_bits(jump), SeqCst);
    let bound_s = STEP_S + RAMP_S;
    let taken = to_zero(&plant, what, bound_s).await;
    assert!(taken.1);
    until("out", PATIENCE, || writing.status(&id).is_some_and(|s| !s.state.writes())).await;
    let status = writing.status(&id).expect("enabled");
    // An hour ahead the grant has run out too, by the wall: whichever is found first, zero it is.
    let cause = status.tripped_by.map_or("grant_expired", |denial| denial.code());
    assert_eq!(cause, if jump > 0.0 { "grant_expired" } else { "clock_jump" });
    assert_eq!(status.state, if jump > 0.0 { State::Shadow } else { State::Tripped });
    row(what, cause, taken, bound_s);
    writing.end().await;
    drop(polled);
}
