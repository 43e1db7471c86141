//! Generator B: loops stepped within the scan, valves from four models of the literature, PI and PID controllers.
//!
//! OP and PV have spans of 100.
//! A loop is drawn from its case, its effect is sized on the loop, and the loop is run.
//! Where the effect would not show or OP would come near its limits, another loop is drawn.

mod change;
mod controller;
mod draw;
mod effects;
mod plan;
mod process;
mod run;
mod sensor;
mod signals;
pub mod valve;

use stictiond_numerics::residual::Kind;
use stictiond_numerics::signal::{Record, Sample, Series};

use super::{Case, Generator, Truth};
use draw::{Draw, Range};
use effects::Fault;
use plan::{Health, Plan, TAIL, WARM_UP};
use run::{Trace, recorded, run};
use signals::{foreign, sd};

/// The generator.
pub const B: Generator = Generator { name: "B", variants: plan::variants, record, before };

/// Loops drawn for a case before it is given up.
const TRIALS: u64 = 2000;
/// How much livelier the loops of effects are that show in motion alone.
const LIVELY: f64 = 1.5;
/// Factors of liveliness after a loop that moved too little or too far.
const LIVELIER: (f64, f64) = (1.2, 0.85);
/// Largest liveliness.
const LIVELIEST: f64 = 3.0;

/// Draws a case.
fn record(case: &Case) -> (Record, Truth) {
    let Drawn { mut draw, plan, trace, .. } = drawn(case);
    (written(&mut draw, case, &plan, &trace), truth(case, &plan))
}

/// The loop of a case without its effect and with this share of its friction.
fn before(case: &Case, friction: f64) -> Record {
    let Drawn { mut draw, bare, plan, .. } = drawn(case);
    let plan = plan.before(case.effect, bare, friction);
    written(&mut draw, case, &plan, &run(&plan))
}

/// The loop of a case.
struct Drawn {
    /// What goes on from here.
    draw: Draw,
    /// The loop before its effect was sized on it.
    bare: Plan,
    plan: Plan,
    trace: Trace,
}

fn drawn(case: &Case) -> Drawn {
    let mut lively = match case.effect {
        Some(Kind::GainChange | Kind::DeadTimeChange | Kind::ValveSaturation | Kind::ClockSkew) => LIVELY,
        _ => 1.0,
    };
    for attempt in 0..TRIALS {
        let mut draw = Draw::of(case, attempt);
        let mut plan = Plan::draw(&mut draw, case, lively);
        let bare = plan.clone();
        let tried = effects::apply(&mut draw, case, &mut plan).and_then(|()| {
            let trace = run(&plan);
            checked(&plan, &trace).map(|()| trace)
        });
        match tried {
            Ok(trace) => return Drawn { draw, bare, plan, trace },
            Err(Fault::Faint) => lively = (lively * LIVELIER.0).min(LIVELIEST),
            Err(Fault::Wide) => lively *= LIVELIER.1,
            Err(Fault::Hidden) => {}
        }
    }
    panic!("no loop found for {case:?}");
}

/// Range in which OP stays (% of span).
const OP_RANGE: Range = (3.0, 97.0);
/// Range in which PV stays (% of span).
const PV_RANGE: Range = (0.0, 100.0);
/// Sd of OP at least (% of span).
const OP_MOVES: f64 = 0.1;
/// Motions of the stem at least.
const STEM_MOVES: usize = 10;

/// Whether the loop stays within its limits and moves.
fn checked(plan: &Plan, trace: &Trace) -> Result<(), Fault> {
    let (op, pv, stem) = (&trace.op, &trace.pv, recorded(plan, &trace.stem));
    let within = |signal: &[f64], range: Range| signal.iter().all(|v| (range.0..=range.1).contains(v));
    if !within(op, OP_RANGE) || !within(pv, PV_RANGE) {
        return Err(Fault::Wide);
    }
    let moves = stem.windows(2).filter(|pair| pair[0] != pair[1]).count();
    if moves < STEM_MOVES || sd(recorded(plan, op)) < OP_MOVES { Err(Fault::Faint) } else { Ok(()) }
}

/// What is true of the loop.
fn truth(case: &Case, plan: &Plan) -> Truth {
    let (class, asked) = (plan.class.as_str(), case.effect == Some(Kind::SlipJump));
    let Some(friction) = plan.friction else {
        let name = format!("{class}, {}", plan.health.as_str());
        return Truth { name, f: 0.0, j: 0.0, also: vec![], load: None };
    };
    let health = if plan.health == Health::Sound { "middling friction" } else { plan.health.as_str() };
    let (model, s, j) = (friction.model, friction.s, friction.j);
    let also = if j < 0.9 * s && !asked { vec![Kind::SlipJump] } else { vec![] };
    Truth { name: format!("{class}, {health}, {model:?} S {s:.2} J {j:.2}"), f: s / 2.0, j, also, load: None }
}

/// The record of a run.
fn written(draw: &mut Draw, case: &Case, plan: &Plan, trace: &Trace) -> Record {
    let on_scan = |signal: &[f64]| -> Series {
        let samples = recorded(plan, signal).iter().enumerate();
        samples.map(|(k, &value)| Sample::good(k as f64 * plan.period, value)).collect()
    };
    let mut tags: Vec<(String, Series)> = (0..case.tags)
        .map(|i| {
            let (letters, signal) = foreign(draw, &trace.pv);
            (format!("{letters}-{}", 101 + i), on_scan(&signal))
        })
        .collect();
    if let Some(signal) = &plan.upstream {
        tags.insert(draw.whole(0, tags.len()), ("upstream".to_string(), on_scan(signal)));
    }
    Record {
        op: on_scan(&trace.op),
        pv: stamped(plan, &trace.recorded),
        sp: Some(on_scan(&plan.sp)),
        tags,
        op_span: Some(100.0),
        ..Record::default()
    }
}

/// PV under its own clock's stamps, as far as they fall into the record.
fn stamped(plan: &Plan, pv: &[f64]) -> Series {
    let last = (plan.n - 1) as f64;
    (WARM_UP - TAIL..plan.total())
        .filter_map(|k| {
            let scan = k as f64 - WARM_UP as f64;
            let stamp = scan + plan.skew.0 + plan.skew.1 * scan;
            (-0.5..=last + 0.5).contains(&stamp).then(|| Sample::good(stamp * plan.period, pv[k]))
        })
        .collect()
}
