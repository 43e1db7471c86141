//! A daemon without a plant: history, scheduler, results and API, its diagnoses made up by the test.

use super::http::{Answer, get};
use serde_json::Value;
use std::net::SocketAddr;
use std::sync::Arc;
use stictiond::alarm;
use stictiond::diagnosis::{
    CurvePoint, Diagnosis, Estimate, Model, NotIdentifiable, Preparation, Settings, Verdict,
};
use stictiond::history::{self, History, LoopTags, TagKind, TagSpec};
use stictiond::results::{Judged, Results};
use stictiond::schedule::{self, Clock, Diagnose, Job, Plan, Scheduler};
use stictiond::serve::{self, Context, DeviceState, LoopInfo, Plant};
use stictiond::signal::{LoopId, Record, Role};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// 2026-01-01T00:00:00Z.
pub const START: f64 = 1_767_225_600.0;
pub const NASTY: &str = "<b>a/b & \"c\" ü";

pub fn verdict_of(verdict: Verdict, f: f64, delta_aic: f64) -> Diagnosis {
    let model = Model {
        na: 2,
        nb: 2,
        nc: 2,
        nk: 1,
        a: vec![-1.2, 0.4],
        b: vec![0.1, f64::NAN],
        c: vec![0.0, 0.1],
        rmse: 0.01,
    };
    let estimate = Estimate {
        f,
        f_ci95: [f - 0.06, f + 0.05],
        f_of_op_range: 0.41,
        delta_aic,
        rival: stictiond::diagnosis::rivals::Rival::Linear,
        steadiness: 9.0,
        f_max: 5.0,
        d: 2.0 * f,
        curve: (0..10).map(|i| CurvePoint { f: f64::from(i), aic: f64::INFINITY }).collect(),
        model,
        mv: vec![],
    };
    let identifiable = !matches!(verdict, Verdict::NotIdentifiable(_));
    Diagnosis {
        reason: format!("made for a test: {}", verdict.as_str()),
        verdict,
        preparation: Preparation {
            start: START,
            end: START + 999.0,
            n: 1000,
            ts: 1.0,
            ..Preparation::default()
        },
        oscillation: None,
        estimate: identifiable.then_some(estimate),
        residual: None,
        packed: None,
        window: None,
    }
}

/// Judges by the loop's description in the record: the name of its only extra tag.
pub fn judge(record: &Record) -> Judged {
    let diagnosis = match record.tags[0].0.as_str() {
        "sticky" => verdict_of(Verdict::Stiction, 2.5, 446.0),
        "sound" => verdict_of(Verdict::NoStiction, 0.0, -2.0),
        "broken" => panic!("secret of the inside"),
        _ => verdict_of(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), 0.0, 0.0),
    };
    diagnosis.into()
}

/// Judges by the last OP: sticky at 10. It fits up to there, so what comes later is new.
pub fn sticky_at_ten(record: &Record) -> Judged {
    let last = record.op.last();
    let sticks = last.is_some_and(|sample| sample.value == 10.0);
    let (verdict, f, delta_aic) =
        if sticks { (Verdict::Stiction, 2.5, 446.0) } else { (Verdict::NoStiction, 0.0, -2.0) };
    let mut diagnosis = verdict_of(verdict, f, delta_aic);
    if let Some(last) = last {
        (diagnosis.preparation.start, diagnosis.preparation.end) = (last.t - 999.0, last.t);
    }
    diagnosis.into()
}

pub struct Rig {
    pub address: SocketAddr,
    pub history: Arc<History>,
    pub scheduler: Arc<Scheduler>,
    pub results: Arc<Results>,
    pub stop: CancellationToken,
    pub serving: tokio::task::JoinHandle<Result<(), serve::ServeError>>,
}

fn tags(id: &str, kind: &str) -> LoopTags {
    let tag = |kind: TagKind, unit: &str| TagSpec { kind, unit: unit.into(), source: String::new() };
    let extra = TagKind::Extra(kind.to_string());
    LoopTags {
        id: LoopId::new(id),
        tags: vec![
            tag(TagKind::Role(Role::Op), "%"),
            tag(TagKind::Role(Role::Pv), "m3/h"),
            tag(extra, "bar"),
        ],
        op_limits: None,
        op_span: Some(100.0),
        op_span_source: stictiond::signal::SpanSource::Given,
    }
}

pub async fn start(loops: &[(&str, &str)], config: serve::Config, diagnose: Diagnose) -> Rig {
    let tags: Vec<LoopTags> = loops.iter().map(|(id, kind)| tags(id, kind)).collect();
    let ids: Vec<LoopId> = tags.iter().map(|t| t.id.clone()).collect();
    let history = Arc::new(History::new(&tags, &history::Config { samples_per_tag: 5000 }));
    let results = Arc::new(Results::new(&ids, 5, &alarm::Config::default()));
    let clock = Clock::plant(START, 1.0);
    let records = history.clone();
    let plan = Plan {
        jobs: ids.iter().map(|id| Job { id: id.clone(), period_s: 1e6 }).collect(),
        snapshot: Arc::new(move |id| records.snapshot(id)),
        silence: Arc::new(|_, _, _| None),
        settings: Settings::default(),
        follows: false,
        searched: Default::default(),
    };
    let scheduler =
        Arc::new(Scheduler::new(schedule::Config::default(), clock, diagnose, results.clone(), plan));
    let infos = loops.iter().enumerate().map(|(at, (id, kind))| LoopInfo {
        id: LoopId::new(*id),
        description: format!("a {kind} one"),
        group: format!("unit {}", at % 2),
        period_s: 1e6,
    });
    let device = DeviceState {
        name: "dcs1".into(),
        connected: true,
        last_good: Some(START),
        counters: vec![("polls", 7)],
    };
    let plant = Plant::new(infos.collect(), history.clone(), Arc::new(move || vec![device.clone()]));
    let (_keep, plant) = watch::channel(Arc::new(plant));
    let stop = CancellationToken::new();
    let context =
        Arc::new(Context::new(config, clock, results.clone(), scheduler.clone(), plant, stop.clone()));
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    let serving = tokio::spawn(serve::serve(listener, context));
    let (runner, token) = (scheduler.clone(), stop.clone());
    tokio::spawn(async move { runner.run(token).await });
    Rig { address, history, scheduler, results, stop, serving }
}

pub async fn rig(loops: &[(&str, &str)]) -> Rig {
    start(loops, serve::Config::default(), Arc::new(|record, _, _| judge(record))).await
}

impl Rig {
    pub async fn diagnose(&self, id: &str) {
        let run = self.scheduler.request(&LoopId::new(id)).expect("idle");
        run.await.expect("done");
    }

    pub async fn json(&self, path: &str) -> Value {
        let answer = get(self.address, path).await;
        assert_eq!(answer.status, 200, "{path}: {}", answer.text());
        answer.json()
    }

    pub fn ids(list: &Value) -> Vec<String> {
        let items = list["items"].as_array().expect("a list");
        items.iter().map(|item| item["id"].as_str().expect("an id").to_string()).collect()
    }
}

pub fn assert_problem(answer: &Answer, status: u16) -> Value {
    assert_eq!(answer.status, status, "{}", answer.text());
    assert_eq!(answer.header("content-type"), Some("application/problem+json"));
    let problem = answer.json();
    assert_eq!(problem["status"], status);
    for member in ["type", "title", "detail"] {
        assert!(problem[member].as_str().is_some_and(|text| !text.is_empty()), "{problem}");
    }
    problem
}

pub const FOUR: [(&str, &str); 4] =
    [("FIC1", "sticky"), ("LIC2", "sound"), ("PIC3", "flat"), ("TIC4", "broken")];
