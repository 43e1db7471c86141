use super::*;
use crate::audit::Bounds;
use crate::compensation::gate::{Denial, Time};
use crate::writeback::link::tests::{Device, LIMITS, order, seen, target};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use tokio::time::{Instant, timeout};

const PATIENCE: Duration = Duration::from_secs(60);
/// The wall clock when a test begins (s).
const BEGIN: f64 = 1_000_000.0;

fn id() -> LoopId {
    LoopId::new("FIC101")
}

/// One loop in shadow, with its log in a folder.
fn started(folder: &Path, polled: watch::Receiver<u64>) -> Writeback {
    std::fs::create_dir_all(folder).expect("the temporary folder is writable");
    let bounds = Bounds { max_bytes: 1 << 20, keep_files: 1 };
    let recorder = Arc::new(Recorder::start(&folder.join("audit.log"), bounds, 0.0).expect("opens"));
    let setup = LoopSetup {
        id: id(),
        limits: LIMITS,
        target: target(),
        pause: Duration::from_millis(10),
        polled,
        heard: Arc::new(|| 0),
        look: Arc::new(Inputs::default),
        keep: Arc::new(|_| {}),
        lasts_s: 63.0,
    };
    let clocks: Clocks = Arc::new(|| Time { mono: 0.0, wall: 0.0 });
    Writeback::start(vec![setup], clocks, recorder, Arc::new(|_, _| {}))
}

/// A stop that comes before the tasks had their first turn must not leave them running until the withdrawal's limit.
#[tokio::test]
async fn what_is_stopped_as_soon_as_it_starts_ends_at_once() {
    let folder = std::env::temp_dir().join(format!("stictiond-run-{}", std::process::id()));
    let (_polls, polled) = watch::channel(0);
    let running = started(&folder, polled);
    let ended = timeout(Duration::from_secs(10), running.end()).await;
    let state = running.status(&id()).map(|status| status.state);
    std::fs::remove_dir_all(&folder).expect("the folder is there");
    assert_eq!((ended.is_ok(), state), (true, Some(State::Disabled)));
}

/// A loop that is stepped by hand, on a clock of the test's. OP rises, so that its valve moves.
struct Bench {
    task: Task,
    slot: Arc<Slot>,
    time: Arc<Mutex<Time>>,
    kept: Arc<Mutex<Vec<Sample>>>,
    polls: watch::Sender<u64>,
    ops: Arc<AtomicU64>,
}

impl Bench {
    fn new(recorder: Recorder, address: String) -> Self {
        let time = Arc::new(Mutex::new(Time { mono: 0.0, wall: BEGIN }));
        let kept = Arc::new(Mutex::new(Vec::new()));
        let (shown, keeps) = (time.clone(), kept.clone());
        let clocks: Clocks = Arc::new(move || *shown.lock().expect("whole"));
        let mut gate = Gate::new(LIMITS);
        gate.enable(clocks());
        let slot = Arc::new(Slot {
            id: id(),
            gate: Mutex::new(gate),
            wake: Notify::new(),
            said: Mutex::default(),
            keep: Arc::new(move |sample| keeps.lock().expect("whole").push(sample)),
            lasts_s: 70.0,
            percent: 1.0,
            clocks: clocks.clone(),
            recorder: Arc::new(recorder),
            tell: Arc::new(|_, _| ()),
        });
        let now = clocks.clone();
        let look: Look = Arc::new(move || seen(now(), 2.0));
        let target = Target { address, timeout: Duration::from_secs(10), ..target() };
        let ((polls, polled), ops) = (watch::channel(0), Arc::new(AtomicU64::new(0)));
        let (counted, pause) = (ops.clone(), Duration::from_secs(1));
        let heard: Heard = Arc::new(move || counted.load(Relaxed));
        let writer = Writer::new(target, clocks);
        let task = Task { slot: slot.clone(), writer, look, polled, heard, seen: 0, pause };
        Self { task, slot, time, kept, polls, ops }
    }

    /// One that cannot be put on record.
    fn hung() -> (Self, crate::audit::Hung) {
        let (recorder, disk) = Recorder::hung(Path::new("audit.log"));
        (Self::new(recorder, "127.0.0.1:9".into()), disk)
    }

    fn now(&self) -> Time {
        *self.time.lock().expect("whole")
    }

    fn pass(&self, s: f64) {
        let mut time = self.time.lock().expect("whole");
        *time = Time { mono: time.mono + s, wall: time.wall + s };
    }

    /// Until the next step opens the gate.
    async fn arm(&mut self) {
        for _ in 0..8 {
            self.pass(1.0);
            self.task.step().await;
        }
        let now = self.now();
        let mut gate = self.slot.gate();
        assert_eq!(gate.status().denials, [Denial::NotGranted]);
        gate.grant("Ann", 60.0, now).and_then(|()| gate.approve("Bob", now)).expect("in shadow");
        drop(gate);
        self.pass(1.0);
    }

    fn state(&self) -> State {
        self.slot.gate().state()
    }
}

#[tokio::test]
async fn a_term_that_is_taken_back_while_the_disk_is_waited_for_is_not_written() {
    let (recorder, disk) = Recorder::hung(Path::new("audit.log"));
    let device = Arc::new(Device::new(usize::MAX));
    let mut bench = Bench::new(recorder, device.listen().await);
    bench.arm().await;
    let (slot, now) = (bench.slot.clone(), bench.now());
    let taken_back = async {
        while slot.gate().state() != State::Active {
            tokio::task::yield_now().await;
        }
        slot.gate().withdraw("Cid", now).expect("active");
        disk.go_on();
    };
    tokio::join!(bench.task.step(), taken_back);
    assert_eq!((bench.state(), device.heard()), (State::Withdrawing, (vec![], [0; 3])));
    bench.pass(0.5);
    bench.task.step().await;
    assert_eq!((bench.state(), device.heard()), (State::Shadow, (vec![0, 2], [0, 0, 2])));
}

#[tokio::test(start_paused = true)]
async fn a_disk_that_hangs_keeps_no_step_waiting_and_opens_nothing() {
    let (mut bench, _disk) = Bench::hung();
    bench.arm().await;
    timeout(PATIENCE, bench.task.step()).await.expect("it does not wait for ever");
    let status = bench.slot.gate().status();
    assert_eq!((status.state, status.tripped_by), (State::Withdrawing, Some(Denial::AuditFailed)));
}

#[tokio::test(start_paused = true)]
async fn taking_a_term_back_waits_for_no_record_and_a_grant_without_one_is_none() {
    let (bench, _disk) = Bench::hung();
    let slots = HashMap::from([(id(), bench.slot.clone())]);
    let running = Writeback { slots, tasks: Mutex::default(), longest: PATIENCE };
    let asked = timeout(PATIENCE, running.act(&id(), Action::Grant(60.0), "Ann")).await;
    assert_eq!(asked.expect("it does not wait for ever"), Some(Err(Refusal::Unrecorded)));
    let granted = || running.grants().len();
    assert_eq!(granted(), 0);
    bench.slot.gate().grant("Ann", 60.0, bench.now()).expect("in shadow");
    assert_eq!(granted(), 1);
    let began = Instant::now();
    let asked = timeout(PATIENCE, running.act(&id(), Action::Withdraw, "Cid")).await;
    assert!(asked.is_ok_and(|answer| answer.is_some_and(|answer| answer.is_ok())));
    assert_eq!((granted(), began.elapsed()), (0, Duration::ZERO));
}

#[tokio::test(start_paused = true)]
async fn only_another_op_is_a_reason_to_write_before_the_pause_is_over() {
    let (mut bench, _disk) = Bench::hung();
    for (new, least, most) in [(0, 1000, 1100), (1, 0, 100), (0, 1000, 1100)] {
        bench.ops.fetch_add(new, Relaxed);
        let polls = bench.polls.clone();
        // A broker with much to say.
        let chatter = async {
            for _ in 0..1000 {
                polls.send_modify(|polls| *polls += 1);
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        let began = Instant::now();
        tokio::select! {
            () = bench.task.wait() => {}
            () = chatter => panic!("it waits for ever"),
        }
        let took = began.elapsed().as_millis();
        assert!((least..most).contains(&took), "{new} samples of OP, {took} ms");
    }
}

#[test]
fn a_term_that_nobody_could_write_ends_as_the_dcs_dropped_it() {
    let (mut bench, _disk) = Bench::hung();
    let kept = |bench: &Bench| {
        let kept = std::mem::take(&mut *bench.kept.lock().expect("whole"));
        kept.iter().map(|own| (own.t - BEGIN, own.value)).collect::<Vec<_>>()
    };
    // The process stood still for half an hour.
    for (after, term) in [(0.0, 2.0), (30.0, 2.0), (60.0, 2.0), (1860.0, 0.0)] {
        bench.slot.remember(BEGIN + after, term);
    }
    // One of 0 is not told again, unless the clock was set back.
    assert_eq!(kept(&bench), [(0.0, 2.0), (60.0, 2.0), (130.0, 0.0)]);
    bench.slot.remember(BEGIN + 100.0, 0.0);
    assert_eq!(kept(&bench), [(100.0, 0.0)]);
    // The link is down.
    bench.pass(2000.0);
    bench.slot.remember(bench.now().wall, 2.0);
    for _ in 0..3 {
        bench.pass(30.0);
        bench.task.done(order(2.0).0, Err(WriteFault::Failed));
    }
    assert_eq!(kept(&bench), [(2000.0, 2.0), (2070.0, 0.0)]);
}

/// What the writer says was about another write.
#[test]
fn a_term_that_cannot_be_put_on_record_was_not_refused_by_the_device() {
    let (bench, _disk) = Bench::hung();
    assert_eq!(bench.task.why(WriteFault::Audit), "it cannot be put on record");
    assert_eq!(bench.task.why(WriteFault::Failed), bench.task.writer.why());
}
