//! What moves a loop in normal operation: noise, loads, set point, feed-forward.

use super::draw::{Draw, deviation, lagged};
use super::plan::{Bend, Class, Plan, Wish, cone_range};
use super::run::{Signals, Trace, add, run};
use super::swings::draw_swings;

/// Share of loops with a feed-forward from a measured load that is not recorded.
const FORWARD_SHARE: f64 = 0.12;
/// Largest standard deviation of OP that a load may ask for (%).
const LOAD_ROOM: f64 = 3.0;
/// Share of records whose set point rests.
const AT_REST: f64 = 0.36;

/// Draws the signals of normal operation; `swings`: the load comes from elsewhere in the plant and swings.
pub fn normal(plan: &Plan, wish: &Wish, swings: bool, draw: &mut Draw) -> Signals {
    let mut signals = Signals::still(plan);
    signals.add_noise(plan.noise, draw);
    let load = draw_load(plan, swings, draw);
    let ratio = if wish.lively { draw.log(4.0, 12.0) } else { draw.log(1.0, 6.0) };
    let room = wish.calm * LOAD_ROOM * if wish.lively { 1.5 } else { 1.0 };
    signals.add_loads(&load, scale(plan, &load, ratio * plan.noise, room));
    if draw.chance(FORWARD_SHARE) {
        put_forward(&mut signals, wish, draw);
    }
    if plan.around.is_some() {
        let n = signals.around.len();
        let tau = draw.log(10.0, 80.0);
        let sd = (plan.noise * draw.log(6.0, 30.0)).min(3.0 * plan.process.gain.abs()) * wish.calm;
        let load = draw.coloured(n, tau);
        add(&mut signals.around, &load, sd);
    }
    match wish.bend {
        Some(bend) => put_travel(plan, bend, &mut signals, draw),
        None => put_set_point(plan, wish, &mut signals, draw),
    }
    signals
}

/// A load of unit size, at the process' input or output.
fn draw_load(plan: &Plan, swings: bool, draw: &mut Draw) -> Signals {
    let mut load = Signals::still(plan);
    let n = load.sp.len();
    let colour = if swings { None } else { Some(draw.whole(0, 3)) };
    let values = match colour {
        None => draw_swings(n, draw),
        Some(0) => draw.white(n),
        Some(1) => {
            let tau = draw.log(3.0, 40.0);
            draw.coloured(n, tau)
        }
        Some(2) => {
            let (period, damping) = (draw.log(12.0, 80.0), draw.even(0.3, 0.7));
            draw.resonant(n, period, damping)
        }
        // A random walk that returns.
        _ => {
            let tau = draw.log(100.0, 400.0);
            draw.coloured(n, tau)
        }
    };
    if draw.chance(0.65) {
        load.load_in = values
    } else {
        load.load_out = values
    }
    load
}

/// The factor that makes a load of unit size move PV by the standard deviation `pv`, and OP by no more than `op`.
///
/// The loop without friction serves as the measure.
pub fn scale(plan: &Plan, load: &Signals, pv: f64, op: f64) -> f64 {
    let trace = run(plan, load, true);
    let moved = deviation(&trace.error()).max(1e-9);
    let swing = deviation(&trace.swing(plan.at)).max(1e-9);
    (pv / moved).min(op / swing)
}

/// A measured load and a feed-forward that takes most of it away.
fn put_forward(signals: &mut Signals, wish: &Wish, draw: &mut Draw) {
    let tau = draw.log(5.0, 60.0);
    let load = draw.coloured(signals.sp.len(), tau);
    let size = draw.log(0.3, 2.0) * wish.calm;
    add(&mut signals.load_in, &load, size);
    add(&mut signals.forward, &load, -size * draw.even(0.6, 0.95));
}

/// Set point at rest, with occasional steps or with slow moves.
fn put_set_point(plan: &Plan, wish: &Wish, signals: &mut Signals, draw: &mut Draw) {
    let rest = if wish.lively { 0.6 * AT_REST } else { AT_REST };
    if plan.class == Class::Inner || draw.chance(rest) {
        return;
    }
    let n = signals.sp.len();
    let hold = draw.log(n as f64 / 8.0, n as f64 / 3.0);
    let ramp = if draw.chance(0.5) { 1.0 } else { draw.log(20.0, 150.0) };
    let kick = plan.tuning.gain.abs() * plan.tuning.weight.max(0.1);
    let room = if plan.process.integrating { 6.0 } else { (7.0 * plan.process.gain.abs()).min(6.0) };
    let room = if ramp > 1.0 { room } else { room.min(6.0 / kick) };
    let size = room * draw.log(0.15, 1.0) * wish.calm;
    let moves = draw.moves(n, hold, ramp);
    add(&mut signals.sp, &moves, size);
}

/// Moves the stem, or a conical tank's level, over the range in which the curve shows.
fn put_travel(plan: &Plan, (bend, ratio): (Bend, f64), signals: &mut Signals, draw: &mut Draw) {
    let n = signals.sp.len();
    let slow = 4.0 * (plan.tuning.reset + plan.process.dead) + 20.0;
    let hold = (n as f64 / draw.even(5.0, 12.0)).max(slow);
    if plan.process.integrating && bend == Bend::Gain {
        let range = cone_range(ratio, plan.base);
        // The level cannot move quicker than some per cent of flow fill the vessel.
        let ramp = (2.0 * range / (plan.process.gain.abs() * 8.0)).max(10.0);
        let moves = draw.moves(n, hold, ramp);
        add(&mut signals.sp, &moves, range);
        return;
    }
    let by_load =
        plan.process.integrating || plan.class == Class::Inner || (bend == Bend::Valve && draw.chance(0.4));
    let ramp = if by_load { draw.log(10.0, 60.0) } else { draw.log(5.0, 60.0) }.max(0.6 * plan.tuning.reset);
    let moves = draw.moves(n, hold, ramp);
    let smooth = lagged(&moves, 2.0 + ramp / 8.0);
    for (k, target) in smooth.into_iter().enumerate() {
        let flow = plan.process.characteristic.flow(plan.at + plan.reach * target, plan.at);
        if by_load && bend == Bend::Valve {
            signals.load_in[k] -= flow;
        } else {
            signals.sp[k] += plan.process.slope.output(plan.process.gain * flow);
        }
    }
}

/// Share of a run's recorded scans in which `test` holds for the stem.
pub fn share(trace: &Trace, test: impl Fn(f64) -> bool) -> f64 {
    let stem = Trace::recorded(&trace.stem);
    stem.iter().filter(|x| test(**x)).count() as f64 / stem.len() as f64
}
