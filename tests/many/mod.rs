//! A centre with very many loops of several sites, as edges would have told it of them: without devices, NATS and diagnoses.
//! Tests and a benchmark share it.

use std::net::SocketAddr;
use std::sync::Arc;
use stictiond::alarm::{self, AlarmId, Flags, Kind, Saved};
use stictiond::app::App;
use stictiond::diagnosis::Settings;
use stictiond::history::{self, History, LoopTags, TagKind, TagSpec};
use stictiond::results::{Outcome, RestoredAlarm, Results, Run, Summary, Told, Trigger};
use stictiond::schedule::{self, Clock, Plan, Scheduler};
use stictiond::serve::{
    self, Context, DeviceState, FleetLoad, FleetPort, FleetSeen, LoopInfo, Machine, Plant,
};
use stictiond::signal::{LoopId, Role, Sample, SpanSource};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// Sites of a fleet.
const SITES: usize = 20;
/// Units of a site.
const UNITS: usize = 50;
/// 2026-01-01T00:00:00Z.
const START: f64 = 1_767_225_600.0;
/// A day (s).
const DAY_S: f64 = 86_400.0;
/// Samples of each tag, a second apart: enough to be drawn.
const SAMPLES: usize = 16;

/// A loop as its edge tells of it.
#[derive(Clone, Debug)]
pub struct Own {
    pub id: String,
    pub description: String,
    /// `site / unit`, or the site alone.
    pub group: String,
    /// How it stands, as the letters of the map say.
    pub letter: char,
}

/// So many loops of 20 sites in 1,000 units, which stand as the letters say, one after the other.
pub fn loops(count: usize, letters: &str) -> Vec<Own> {
    let letters: Vec<char> = letters.chars().collect();
    let own = |at: usize| {
        let (site, unit) = (at % SITES, at / SITES % UNITS);
        Own {
            id: format!("s{site:02}:FIC-{at:05}"),
            description: format!("Feed {at} to column {unit}"),
            group: format!("s{site:02} / U{unit:02}"),
            letter: letters[at % letters.len()],
        }
    };
    (0..count).map(own).collect()
}

/// The machines of such a fleet in the order of a centre, each with how long ago it was heard of (s). The edge of s00 is far
/// behind, the clock of s01 is off, s02 is silent, a certificate of s03 ends soon, s04 has another version, s05 no certificate.
pub fn machines() -> Vec<(Machine, f64)> {
    let machine = |role: &str, site: String, name: String| Machine {
        role: role.into(),
        site,
        name,
        version: "0.1.0".into(),
        heard_at: 0.0,
        clock_offset_s: 0.004,
        since: START - DAY_S,
        lag_s: 0.8,
        diagnosed: 4711,
        loops: 500,
        certificate: Some(("[fleet] certificate_file".into(), START + 365.0 * DAY_S)),
    };
    let edge = |at: usize| {
        let (site, heard_s) = (format!("s{at:02}"), if at == 2 { 60.0 } else { 2.0 });
        let mut own = machine("edge", site.clone(), format!("edge-{site}"));
        match at {
            0 => own.lag_s = 600.0,
            1 => own.clock_offset_s = 2.5,
            3 => own.certificate = Some(("dcs user_certificate".into(), START + 10.0 * DAY_S)),
            4 => own.version = "0.0.9".into(),
            5 => own.certificate = None,
            _ => {}
        }
        (own, heard_s)
    };
    let other = |role: &str, name: &str| (machine(role, String::new(), name.into()), 2.0);
    let mut all = vec![other("centre", "c1"), other("centre", "c2")];
    all.extend((0..SITES).map(edge));
    all.extend([other("worker", "w1"), other("worker", "w2")]);
    all
}

/// Serves a centre that has these loops, each with its last `report`, and has heard of these machines.
pub async fn served(
    loops: &[Own],
    machines: Vec<(Machine, f64)>,
    report: impl Fn(&Own) -> Arc<str>,
) -> (SocketAddr, CancellationToken) {
    let (clock, stop) = (Clock::plant(START, 1.0), CancellationToken::new());
    let results = told(loops, report);
    let plan = Plan {
        jobs: Vec::new(),
        snapshot: Arc::new(|_| None),
        silence: Arc::new(|_, _, _| None),
        settings: Settings::default(),
        follows: true,
        searched: Default::default(),
    };
    let config = schedule::Config::default();
    let scheduler = Arc::new(Scheduler::new(config, clock, App::diagnosis(), results.clone(), plan));
    let (_keep, plant) = watch::channel(Arc::new(plant(loops)));
    let fleet = Fleet { clock, machines };
    let context = Context::new(serve::Config::default(), clock, results, scheduler, plant, stop.clone())
        .with_fleet(Some(Arc::new(fleet)));
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    tokio::spawn(serve::serve(listener, Arc::new(context)));
    (address, stop)
}

/// What edges said of their loops and the alarms on their stiction.
fn told(loops: &[Own], report: impl Fn(&Own) -> Arc<str>) -> Arc<Results> {
    let ids: Vec<LoopId> = loops.iter().map(|own| LoopId::new(own.id.as_str())).collect();
    let results = Results::new(&ids, 5, &alarm::Config::default());
    for (at, (id, own)) in ids.into_iter().zip(loops).enumerate() {
        if let Some(outcome) = verdict(own.letter) {
            results.learn(diagnosed(at, id.clone(), outcome, report(own)), None, START);
        }
        if let Some(flags) = flags(own.letter) {
            let kept = RestoredAlarm {
                id: AlarmId::new(id, Kind::Stiction),
                saved: Saved { flags, ..Saved::default() },
                by: None,
                comment: None,
                detail: String::new(),
            };
            results.follow_alarm(kept, None, START);
        }
    }
    Arc::new(results)
}

/// What the latest diagnosis of a loop says; `None` where it was never diagnosed.
fn verdict(letter: char) -> Option<&'static str> {
    match letter {
        'U' | 'A' | 'S' | 'H' | 'X' => Some("stiction"),
        'R' | 'L' | 'O' => Some("no_stiction"),
        'N' => Some("not_identifiable"),
        _ => None,
    }
}

/// The alarm on a loop's stiction; `None` where nothing ever happened to it.
fn flags(letter: char) -> Option<Flags> {
    let raised = Flags {
        active: true,
        acknowledged: false,
        since: Some(START),
        raised_at: Some(START),
        ..Flags::default()
    };
    Some(match letter {
        'U' => raised,
        'A' => Flags { acknowledged: true, ..raised },
        'R' => Flags { active: false, ..raised },
        'L' => Flags { active: false, latched: true, acknowledged: true, ..raised },
        'H' => Flags { shelved_until: Some(START + DAY_S), ..raised },
        'X' => Flags { out_of_service: true, ..raised },
        _ => return None,
    })
}

/// A diagnosis of another machine.
fn diagnosed(at: usize, id: LoopId, outcome: &'static str, report: Arc<str>) -> Run {
    let sticks = outcome == "stiction";
    let summary = Summary {
        time: START - (at % 3600) as f64,
        took_s: 0.1,
        trigger: Trigger::Periodic,
        outcome: outcome.into(),
        reason_code: (outcome == "not_identifiable").then(|| "flat_pv".into()),
        reason: "f 0.52 % OP [0.47, 0.58], 431 better than the best explanation without friction".into(),
        f: sticks.then_some(0.1 + (at % 977) as f64 / 200.0),
        f_ci95: sticks.then_some([0.05, 6.0]),
        f_in_percent: true,
        delta_aic: Some((at % 1009) as f64),
        compensated: None,
    };
    Run {
        id,
        started: summary.time - 0.1,
        finished: summary.time,
        took_s: summary.took_s,
        trigger: summary.trigger,
        op_span: Some(100.0),
        basis: None,
        outcome: Outcome::Elsewhere(Box::new(Told {
            summary,
            report: Some(report),
            quality: "good".into(),
            doubtful: false,
            fitted_until: None,
            effects: Vec::new(),
            structure: None,
            unexplained: None,
            version: "0.1.0".into(),
        })),
    }
}

/// The loops with the last samples of their OP and PV.
fn plant(loops: &[Own]) -> Plant {
    let tag =
        |role, unit: &str| TagSpec { kind: TagKind::Role(role), unit: unit.into(), source: String::new() };
    let tags = |own: &Own| LoopTags {
        id: LoopId::new(own.id.as_str()),
        tags: vec![tag(Role::Op, "%"), tag(Role::Pv, "m3/h")],
        op_limits: Some((0.0, 100.0)),
        op_span: Some(100.0),
        op_span_source: SpanSource::Given,
    };
    let tags: Vec<LoopTags> = loops.iter().map(tags).collect();
    let history = History::new(&tags, &history::Config { samples_per_tag: SAMPLES });
    for tag in 0..history.tag_count() {
        for at in 0..SAMPLES {
            history.push(tag, Sample::good(START - (SAMPLES - at) as f64, 40.0 + at as f64));
        }
    }
    let infos = loops.iter().map(|own| LoopInfo {
        id: LoopId::new(own.id.as_str()),
        description: own.description.clone(),
        group: own.group.clone(),
        period_s: 3600.0,
    });
    let device =
        DeviceState { name: "s00:dcs".into(), connected: true, last_good: Some(START), counters: Vec::new() };
    Plant::new(infos.collect(), Arc::new(history), Arc::new(move || vec![device.clone()]))
}

/// Machines, of each of which was heard so long ago (s) whenever it is asked.
struct Fleet {
    clock: Clock,
    machines: Vec<(Machine, f64)>,
}

impl FleetPort for Fleet {
    fn seen(&self) -> FleetSeen {
        let now = self.clock.now();
        let heard = |(own, ago_s): &(Machine, f64)| Machine { heard_at: now - ago_s, ..own.clone() };
        FleetSeen {
            role: "centre",
            name: "c1".into(),
            connected: true,
            tells: true,
            machines: self.machines.iter().map(heard).collect(),
        }
    }

    fn load(&self) -> FleetLoad {
        let streams = vec![("stictiond_alarms", 0.85), ("stictiond_samples", 1.0)];
        FleetLoad { windows: Some(42), streams, ..FleetLoad::default() }
    }
}
