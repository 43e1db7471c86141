//! The loop in operation.

use super::controller::Controller;
use super::plan::{Plan, WARM_UP};
use super::process::{FINE, Running};
use super::signals::sd;
use super::valve::Valve;

/// What happened, one value per scan from the first of the warm-up on.
pub struct Trace {
    /// Controller output.
    pub op: Vec<f64>,
    /// Stem.
    pub stem: Vec<f64>,
    /// PV with its noise.
    pub pv: Vec<f64>,
    /// PV as recorded.
    pub recorded: Vec<f64>,
}

/// Runs a plan.
pub fn run(plan: &Plan) -> Trace {
    let total = plan.total();
    let series = || Vec::with_capacity(total);
    let mut trace = Trace { op: series(), stem: series(), pv: series(), recorded: series() };
    let mut controller = Controller::new(plan.settings, plan.op, plan.pv);
    let mut valve = Valve::new(plan.friction, plan.stops, plan.op);
    let mut running = Running::new(&plan.process);
    let (mut output, mut last) = (0.0, plan.pv);
    for k in 0..total {
        let pv = plan.pv + output + plan.load_out[k] + plan.noise[k];
        let (seen, recorded) = plan.sensor.read(k, pv, last);
        last = recorded;
        let op = controller.step(plan.sp[k], seen);
        let stem = valve.step(op, plan.worn.get(k).copied().unwrap_or(1.0));
        output = scan(plan, &mut running, k, stem, output);
        trace.op.push(op);
        trace.stem.push(stem);
        trace.pv.push(pv);
        trace.recorded.push(recorded);
    }
    trace
}

/// The process over one scan; returns its output's deviation.
fn scan(plan: &Plan, running: &mut Running, k: usize, stem: f64, mut output: f64) -> f64 {
    let (factor, later) =
        if k >= plan.change.at { (plan.change.gain, plan.change.delay) } else { (1.0, 0.0) };
    for _ in 0..FINE {
        let flow = plan.curve.flow(running.stem(stem - plan.op));
        let gain = plan.process.gain * factor * plan.curve.gain(output);
        output = running.step(&plan.process, flow + plan.load_in[k], gain, plan.process.delay + later);
    }
    output
}

/// How much a loop moves by itself.
pub struct Natural {
    /// Sd of PV about a resting set point.
    pub pv: f64,
    /// Sd of OP.
    pub op: f64,
}

/// How much the loop of a plan moves with its set point at rest.
pub fn natural(plan: &Plan) -> Natural {
    let trace = run(&Plan { sp: vec![plan.pv; plan.total()], ..plan.clone() });
    Natural { pv: sd(recorded(plan, &trace.pv)), op: sd(recorded(plan, &trace.op)) }
}

/// The loop of a plan with a sound valve.
pub fn linear(plan: &Plan) -> Trace {
    run(&Plan { friction: None, ..plan.clone() })
}

/// The recorded part of a signal.
pub fn recorded<'a>(plan: &Plan, signal: &'a [f64]) -> &'a [f64] {
    &signal[WARM_UP..WARM_UP + plan.n]
}
