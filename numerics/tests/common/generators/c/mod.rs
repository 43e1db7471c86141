//! Generator C: loops whose valve has a stem with mass, moved by air against a spring and held by physical friction.

mod control;
mod draw;
mod effect;
mod loads;
mod plan;
mod process;
mod run;
mod sensor;
mod swings;
mod tags;
pub mod valve;

use stictiond_numerics::residual::Kind;
use stictiond_numerics::signal::Record;

use super::{Case, Generator, Truth};
use draw::Draw;
use plan::{Class, Grip, Plan};
use run::Trace;

/// The generator.
pub const C: Generator = Generator {
    name: "C",
    variants,
    record: |case| record(case, false, None),
    before: |case, friction| record(case, false, Some(friction)).0,
};
/// The same loops under loads that swing: what no hypothesis describes must not be taken for another effect.
pub const D: Generator = Generator {
    name: "D",
    variants,
    record: |case| record(case, true, None),
    before: |case, friction| record(case, true, Some(friction)).0,
};

/// Draws of a loop before the last one is taken as it is.
const ATTEMPTS: u64 = 60;
/// How much calmer each further draw is.
const CALMER: f64 = 0.96;
/// What OP must not leave (%).
const OP_RANGE: (f64, f64) = (3.0, 97.0);
/// What PV must not leave.
const PV_RANGE: (f64, f64) = (3.0, 97.0);
/// J by S below which the two differ.
const SLIP_DIFFERS: f64 = 0.9;
/// Least number of times that a sticking stem turns within the record.
const LEAST_TURNS: usize = 8;
/// Travel after which a turn counts, by the band S.
const LEAST_TURN: f64 = 0.05;
/// Stream of the random numbers of tags, apart from those of the draws.
const TAG_STREAM: u64 = 1000;

/// Whether an effect is there with friction only.
fn of_friction(effect: Option<Kind>) -> bool {
    matches!(effect, Some(Kind::AsymmetricFriction | Kind::FrictionDrift))
}

fn variants(effect: Option<Kind>) -> usize {
    Class::ALL.len()
        * match effect {
            // Each loop comes with a curved valve and with a curved process.
            Some(Kind::StaticNonlinearity) => 6,
            _ if of_friction(effect) => 2,
            _ => 3,
        }
}

/// Class and valve of a variant.
fn split(case: &Case) -> (Class, Grip) {
    let grips: &[Grip] = if of_friction(case.effect) {
        &[Grip::Weak, Grip::Strong]
    } else if case.effect == Some(Kind::SlipJump) {
        &[Grip::Middling, Grip::Weak, Grip::Strong]
    } else {
        &[Grip::Sound, Grip::Weak, Grip::Strong]
    };
    let class = case.variant / grips.len() % Class::ALL.len();
    (Class::ALL[class], grips[case.variant % grips.len()])
}

/// `before`: the share of friction where the loop is as it was, without its effect.
fn record(case: &Case, swings: bool, before: Option<f64>) -> (Record, Truth) {
    let mut last = None;
    for attempt in 0..ATTEMPTS {
        if let Some((inside, record, truth)) = draw_once(case, swings, before, attempt) {
            if inside {
                return (record, truth);
            }
            last = Some((record, truth));
        }
    }
    last.expect("one of the draws carries the effect")
}

/// One draw of the case, and whether it stays inside the range; `None` where the loop cannot carry the effect.
fn draw_once(case: &Case, swings: bool, before: Option<f64>, attempt: u64) -> Option<(bool, Record, Truth)> {
    let mut draw = Draw::new(case, attempt);
    let (class, grip) = split(case);
    let wish = effect::wish(case, CALMER.powi(attempt as i32), &mut draw);
    let mut plan = Plan::draw(class, grip, &wish, &mut draw);
    let mut signals = loads::normal(&plan, &wish, swings, &mut draw);
    let usual = signals.clone();
    let mut tags = effect::put(case, &wish, &mut plan, &mut signals, &mut draw)?;
    let trace = run::run(&plan, &signals, false);
    if plan.sticks() && turns(&trace, LEAST_TURN * plan.band) < LEAST_TURNS {
        return None;
    }
    let pv = sensor::recorded_pv(&signals, &trace);
    if !effect::shows(case, (&plan, &signals), (&plan.ordinary(), &usual), &pv) {
        return None;
    }
    let within = |values: &[f64], (low, high): (f64, f64)| values.iter().all(|v| (low..=high).contains(v));
    let inside = within(&trace.op, OP_RANGE) && within(&trace.pv, PV_RANGE) && within(&pv, PV_RANGE);
    let (plan, signals, trace) = match before {
        Some(friction) => {
            // The load that drives the stem to its stop is no part of the effect.
            let signals = if case.effect == Some(Kind::ValveSaturation) { signals } else { usual };
            let plan = plan.before(case.effect == Some(Kind::SlipJump), friction);
            let trace = run::run(&plan, &signals, false);
            (plan, signals, trace)
        }
        None => (plan, signals, trace),
    };
    let pv = sensor::recorded_pv(&signals, &trace);
    let mut other = Draw::new(case, TAG_STREAM);
    // A tag that drives the process may stand at any place.
    let mut all = tags::draw_tags(case.tags, &pv, &mut other);
    tags.drain(..).for_each(|tag| all.insert(other.whole(0, all.len()), tag));
    let record = sensor::record(&plan, &signals, &trace, all);
    Some((inside, record, truth(case, &plan, swings)))
}

/// Times that the stem turns and then travels by `least` (%) at the least.
fn turns(trace: &Trace, least: f64) -> usize {
    let stem = Trace::recorded(&trace.stem);
    let (mut way, mut mark, mut count) = (0.0, stem[0], 0);
    for &x in stem {
        if way * (x - mark) > 0.0 {
            mark = x;
        } else if (x - mark).abs() > least {
            count += usize::from(way != 0.0);
            (way, mark) = ((x - mark).signum(), x);
        }
    }
    count
}

fn truth(case: &Case, plan: &Plan, swings: bool) -> Truth {
    let sticks = plan.sticks();
    let (f, j) = if sticks { (0.5 * plan.band, plan.jump) } else { (0.0, 0.0) };
    let slips = sticks && plan.jump < SLIP_DIFFERS * plan.band && case.effect != Some(Kind::SlipJump);
    let mut also = if slips { vec![Kind::SlipJump] } else { Vec::new() };
    if swings {
        // As near as a name comes.
        also.extend([Kind::OscillatingLoad, Kind::LoadStep]);
    }
    Truth { name: plan.name(), f, j, also, load: None }
}
