//! Daemons without devices: one with recorded loops of the demo's plant and real diagnoses, one with very many loops, and the centre
//! of a fleet.

use crate::many::{self, Own};
use crate::orders::Orders;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use stictiond::access::{self, Access, Book, Cost, PasswordHash, Roles};
use stictiond::alarm;
use stictiond::app::App;
use stictiond::audit::{Bounds, Recorder};
use stictiond::diagnosis::{
    CurvePoint, Diagnosis, Estimate, Model, NotIdentifiable, Preparation, Settings, Verdict, rivals,
};
use stictiond::history::{self, History, LoopTags, TagKind, TagSpec};
use stictiond::results::Results;
use stictiond::schedule::{self, Clock, Diagnose, Job, Plan, Scheduler};
use stictiond::serve::dto::Report;
use stictiond::serve::{self, AskStore, Context, DeviceState, Facts, LoopInfo, Plant, Setting, StoreState};
use stictiond::signal::{LoopId, Role, Sample};
use stictiond::sim::{Recording, demo_plant, plant::record};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// 2026-01-01T00:00:00Z.
const START: f64 = 1_767_225_600.0;
/// A name that would act if it ever became markup.
const NASTY: &str = "<img src=x onerror=alert(1)>";
/// Time between two samples (s), and samples that are there from the beginning.
const TS_S: f64 = 2.0;
const BEFORE: usize = 1200;
/// Plant time over wall time: a sample every 100 ms.
const SPEED: f64 = 20.0;

pub struct Rig {
    pub address: SocketAddr,
    pub stop: CancellationToken,
}

struct Parts {
    tags: Vec<LoopTags>,
    infos: Vec<LoopInfo>,
    now: f64,
    speed: f64,
    samples: usize,
    diagnose: Diagnose,
    door: Option<Arc<Access>>,
    store: Option<AskStore>,
}

/// Serves what the parts describe; hands back the history, for who fills it, and the scheduler.
async fn serve(parts: Parts) -> (Rig, Arc<History>, Arc<Scheduler>) {
    let ids: Vec<LoopId> = parts.tags.iter().map(|t| t.id.clone()).collect();
    let crowd = ids.len() > 100;
    let history = Arc::new(History::new(&parts.tags, &history::Config { samples_per_tag: parts.samples }));
    let alarms = alarm::Config { k: 1, n: 1, ..alarm::Config::default() };
    let results = Arc::new(Results::new(&ids, 20, &alarms));
    let clock = Clock::plant(parts.now, parts.speed);
    let records = history.clone();
    let plan = Plan {
        jobs: ids.iter().map(|id| Job { id: id.clone(), period_s: 1e7 }).collect(),
        snapshot: Arc::new(move |id| records.snapshot(id)),
        silence: Arc::new(|_, _, _| None),
        settings: Settings::default(),
        follows: false,
        searched: Default::default(),
    };
    // Everything asked for at once may wait.
    let config = schedule::Config { queue: 4000, parallelism: 2, ..schedule::Config::default() };
    let scheduler = Arc::new(Scheduler::new(config, clock, parts.diagnose, results.clone(), plan));
    let device = DeviceState {
        name: "dcs1".into(),
        connected: true,
        last_good: Some(parts.now),
        counters: vec![("polls", 7), ("timeouts", 0)],
    };
    let settings = vec![Setting { section: "diagnosis", key: "f_threshold_percent", value: "0.05".into() }];
    let facts = Facts { f_threshold_percent: Some(0.05), settings };
    let plant = Plant::new(parts.infos, history.clone(), Arc::new(move || vec![device.clone()]));
    let (keep, plant) = watch::channel(Arc::new(plant.with_facts(facts)));
    let stop = CancellationToken::new();
    let audit = parts.door.as_ref().map(|_| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("browser-audit");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        let bounds = Bounds { max_bytes: 1_000_000, keep_files: 1 };
        Arc::new(Recorder::start(&folder.join("audit.log"), bounds, START).expect("a log"))
    });
    let context =
        Context::new(serve::Config::default(), clock, results, scheduler.clone(), plant, stop.clone())
            .with_access(parts.door)
            .with_store(parts.store)
            .with_plantwide(Arc::new(Orders(if crowd { ids } else { Vec::new() })))
            .with_audit(audit);
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    let (runner, token) = (scheduler.clone(), stop.clone());
    tokio::spawn(async move {
        let _keep = keep;
        tokio::join!(serve::serve(listener, Arc::new(context)), runner.run(token)).0
    });
    (Rig { address, stop }, history, scheduler)
}

/// Six recorded loops, diagnosed but for the last; one of them with a measured stem and a name that is no good. Their
/// samples go on arriving.
pub async fn plant() -> Rig {
    let wanted = ["FIC101", "FIC102", "FIC106", "PIC303", "LIC202", "FIC103"];
    let all = demo_plant(1);
    let chosen = wanted.map(|id| all.iter().find(|own| own.id == id).expect("in the plant"));
    let name = |id: &str| LoopId::new(if id == "PIC303" { NASTY } else { id });
    let tag = |role| TagSpec { kind: TagKind::Role(role), unit: "%".into(), source: String::new() };
    let roles = [Role::Op, Role::Pv, Role::Sp, Role::Mv];
    let tags = chosen.map(|own| LoopTags {
        id: name(&own.id),
        tags: roles[..if own.id == "PIC303" { 4 } else { 3 }].iter().map(|role| tag(*role)).collect(),
        op_limits: Some((0.0, 100.0)),
        op_span: Some(100.0),
        op_span_source: stictiond::signal::SpanSource::Given,
    });
    let infos = chosen.map(|own| LoopInfo {
        id: name(&own.id),
        description: format!("{}, {}", own.class.as_str(), own.truth.kind),
        group: format!("unit <b>{}</b>", own.class.as_str()),
        period_s: 3600.0,
    });
    let parts = Parts {
        tags: tags.to_vec(),
        infos: infos.to_vec(),
        now: START + TS_S * BEFORE as f64,
        speed: SPEED,
        samples: 4096,
        diagnose: App::diagnosis(),
        door: None,
        store: None,
    };
    let begun = Instant::now();
    let (rig, history, scheduler) = serve(parts).await;
    // The demo is polled at every fourth sample of its controllers; the first 2,000 s are its way into the swing.
    let recorded = chosen.map(|own| {
        let run = record(&own.spec, 5000, own.seed, Recording::Sample { every: 4 }).expect("a valid plant");
        run.after(1000)
    });
    let push = move |k: usize| {
        for (own, run) in tags.iter().zip(&recorded) {
            for (spec, column) in own.tags.iter().zip([&run.op, &run.pv, &run.sp, &run.mv]) {
                let tag = history.tag_index(&own.id, &spec.kind).expect("a tag of its own");
                // What was recorded comes again and again.
                history.push(tag, Sample::good(START + TS_S * k as f64, column[k % column.len()]));
            }
        }
    };
    (0..BEFORE).for_each(&push);
    for id in &wanted[..5] {
        scheduler.request(&name(id)).expect("idle").await.expect("done");
    }
    // What was sampled while the loops were diagnosed.
    let now = BEFORE + (begun.elapsed().as_secs_f64() * SPEED / TS_S) as usize;
    (BEFORE..now).for_each(&push);
    let stop = rig.stop.clone();
    tokio::spawn(async move {
        let mut ticks = tokio::time::interval(Duration::from_secs_f64(TS_S / SPEED));
        for k in now.. {
            if stop.run_until_cancelled(ticks.tick()).await.is_none() {
                return;
            }
            push(k);
        }
    });
    rig
}

/// Very many loops, one in twenty sticking, with made-up diagnoses.
pub async fn crowd(n: usize) -> Rig {
    crowd_behind(n, None, None).await
}

/// Some loops and a store that is damaged; what is lost of it has a name in it that would act if it ever became markup.
pub async fn damaged() -> Rig {
    let why = format!("the store is damaged: page 7 of {NASTY} is not what was written");
    let state =
        StoreState { failing: Some((why, START)), is_damaged: true, lost_states: 3, ..StoreState::default() };
    crowd_behind(4, None, Some(Arc::new(move || state.clone()))).await
}

/// The password of every user of `guarded`.
const PASSWORD: &str = "a password for tests";

/// Some loops, for who logs in: `vera` views, `otto` operates, `enya` is an engineer.
pub async fn guarded() -> Rig {
    let mut book = Book::default();
    for (name, role) in
        [("vera", access::Role::Viewer), ("otto", access::Role::Operator), ("enya", access::Role::Engineer)]
    {
        let cheap = Cost { memory_kib: 8, passes: 1 };
        let hash = PasswordHash::of(PASSWORD, [1; 16], cheap).expect("a cost");
        book.add_user(name, Roles::of(&[role]), hash).expect("added");
    }
    let access = Access::new(access::Config::new("unused".into()), book);
    crowd_behind(20, Some(Arc::new(access)), None).await
}

/// How the loops of a fleet stand, one after the other: no site and no unit has loops of one kind only.
const LETTERS: &str = "USOANORLHXWOO";
/// The unit whose loops have a report to be opened.
const OPENED: &str = "s03 / U17";

/// A centre of so many loops: of 20 sites with 50 units each, of one without units, and of one with a name that would act if it ever
/// became markup.
pub async fn fleet(n: usize) -> Rig {
    let own = |id: &str, group: &str, letter| Own {
        id: id.into(),
        description: String::new(),
        group: group.into(),
        letter,
    };
    let odd = [
        own(&format!("north:{NASTY}"), "north / <b>U & 1</b> / 2?x=1", 'W'),
        own("north:B", "north", 'U'),
        own("west:A", "west", 'O'),
    ];
    let mut loops = many::loops(n - odd.len(), LETTERS);
    loops.extend(odd);
    let bare: Arc<str> = "{}".into();
    let report = |own: &Own| if own.group == OPENED { reported(own) } else { bare.clone() };
    let (address, stop) = many::served(&loops, many::machines(), report).await;
    Rig { address, stop }
}

/// The report of a loop's made-up diagnosis.
fn reported(own: &Own) -> Arc<str> {
    let diagnosis = made_up(match own.letter {
        'N' => 1,
        'R' | 'L' | 'O' => 2,
        _ => 0,
    });
    serde_json::to_string(&Report::new(&own.id, Some(100.0), &diagnosis)).expect("JSON").into()
}

async fn crowd_behind(n: usize, door: Option<Arc<Access>>, store: Option<AskStore>) -> Rig {
    let id = |at: usize| LoopId::new(format!("FIC{at:05}"));
    let tags = (0..n).map(|at| LoopTags {
        id: id(at),
        tags: vec![TagSpec { kind: TagKind::Role(Role::Op), unit: "%".into(), source: String::new() }],
        op_limits: Some((at as f64, 1e6)),
        op_span: Some(100.0),
        op_span_source: stictiond::signal::SpanSource::Given,
    });
    let infos = (0..n).map(|at| LoopInfo {
        id: id(at),
        description: format!("feed to column {at}"),
        group: format!("unit {}", at % 40),
        period_s: 3600.0,
    });
    let parts = Parts {
        tags: tags.collect(),
        infos: infos.collect(),
        now: START,
        speed: 1.0,
        samples: 200,
        diagnose: Arc::new(|record, _, _| made_up(record.op_limits.map_or(0, |(at, _)| at as usize)).into()),
        door,
        store,
    };
    let (rig, _, scheduler) = serve(parts).await;
    for at in 0..n {
        // One loop in fifty waits for its first diagnosis for ever.
        if at % 50 != 49 {
            scheduler.request(&id(at)).expect("room to wait").await.expect("done");
        }
    }
    rig
}

fn made_up(at: usize) -> Diagnosis {
    let (verdict, f) = match at % 20 {
        0 => (Verdict::Stiction, 0.5 + (at % 70) as f64 / 20.0),
        1 => (Verdict::NotIdentifiable(NotIdentifiable::FlatPv), 0.0),
        _ => (Verdict::NoStiction, 0.0),
    };
    let model = Model { na: 1, nb: 1, nc: 1, nk: 1, a: vec![-0.9], b: vec![0.1], c: vec![0.0], rmse: 0.01 };
    let estimate = Estimate {
        f,
        f_ci95: [0.9 * f, 1.1 * f + 0.02],
        f_of_op_range: 0.4,
        delta_aic: 100.0 * f,
        rival: rivals::Rival::Linear,
        steadiness: 9.0,
        f_max: 5.0,
        d: f,
        curve: (0..10).map(|i| CurvePoint { f: f64::from(i), aic: f64::from(i) }).collect(),
        model,
        mv: vec![],
    };
    let known = !matches!(verdict, Verdict::NotIdentifiable(_));
    Diagnosis {
        reason: format!("made for a test: {}", verdict.as_str()),
        verdict,
        preparation: Preparation { start: START, end: START, n: 1000, ts: 1.0, ..Preparation::default() },
        oscillation: None,
        estimate: known.then_some(estimate),
        residual: None,
        packed: None,
        window: None,
    }
}
