//! Runs a loop: the controller at every scan, process and stem in substeps between.

use super::control::Controller;
use super::draw::Draw;
use super::plan::Plan;
use super::process::{Flow, SUBSTEPS};
use super::sensor::Fault;
use super::valve::Stem;

/// Samples that run before the record begins.
pub const WARM_UP: usize = 300;
/// Samples that run on after the record's end, for a PV that is stamped early.
pub const RUN_OUT: usize = 20;

/// What acts on a loop from outside, one value per scan.
#[derive(Clone, Debug)]
pub struct Signals {
    /// Set point as deviation from the working point (PV).
    pub sp: Vec<f64>,
    /// Noise of PV's measurement (PV).
    pub noise: Vec<f64>,
    /// Load at the process' input (% of OP).
    pub load_in: Vec<f64>,
    /// Load at its output (PV).
    pub load_out: Vec<f64>,
    /// Feed-forward, added to OP (%).
    pub forward: Vec<f64>,
    /// Load of the loop around (PV).
    pub around: Vec<f64>,
    /// Factor on the process gain.
    pub gain: Vec<f64>,
    /// Dead time (samples).
    pub dead: Vec<f64>,
    /// Factor on friction.
    pub friction: Vec<f64>,
    /// What is wrong with PV's measurement.
    pub fault: Fault,
    /// Whether the controller sees what is wrong, or the record alone.
    pub seen: bool,
}

impl Signals {
    /// Nothing acts.
    pub fn still(plan: &Plan) -> Self {
        let n = WARM_UP + plan.samples + RUN_OUT + 1;
        let zero = vec![0.0; n];
        Self {
            sp: zero.clone(),
            noise: zero.clone(),
            load_in: zero.clone(),
            load_out: zero.clone(),
            forward: zero.clone(),
            around: zero,
            gain: vec![1.0; n],
            dead: vec![plan.process.dead; n],
            friction: vec![1.0; n],
            fault: Fault::None,
            seen: false,
        }
    }

    /// Number of scans that are run.
    pub fn scans(&self) -> usize {
        self.sp.len() - 1
    }

    /// Adds the loads of `other`, multiplied.
    pub fn add_loads(&mut self, other: &Signals, factor: f64) {
        add(&mut self.load_in, &other.load_in, factor);
        add(&mut self.load_out, &other.load_out, factor);
        add(&mut self.forward, &other.forward, factor);
        add(&mut self.around, &other.around, factor);
    }

    /// Puts measurement noise.
    pub fn add_noise(&mut self, sd: f64, draw: &mut Draw) {
        self.noise.iter_mut().for_each(|v| *v += sd * draw.normal());
    }
}

/// Adds `factor` times `from` to `to`.
pub fn add(to: &mut [f64], from: &[f64], factor: f64) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
}

/// What a run leaves, one value per scan.
#[derive(Clone, Debug)]
pub struct Trace {
    /// Controller output (%).
    pub op: Vec<f64>,
    /// PV as measured, with the faults that the controller sees.
    pub pv: Vec<f64>,
    /// Set point (PV).
    pub sp: Vec<f64>,
    /// Stem (%).
    pub stem: Vec<f64>,
}

impl Trace {
    /// The part of a signal that is recorded.
    pub fn recorded(signal: &[f64]) -> &[f64] {
        &signal[WARM_UP..signal.len() - RUN_OUT]
    }

    /// PV less set point over the record.
    pub fn error(&self) -> Vec<f64> {
        let pairs = Self::recorded(&self.pv).iter().zip(Self::recorded(&self.sp));
        pairs.map(|(pv, sp)| pv - sp).collect()
    }

    /// OP less `at` over the record.
    pub fn swing(&self, at: f64) -> Vec<f64> {
        Self::recorded(&self.op).iter().map(|op| op - at).collect()
    }
}

/// The loop around an inner loop, at work.
struct Around<'a> {
    plan: &'a super::plan::Around,
    controller: Controller<'a>,
    pv: f64,
    sp: f64,
    base: f64,
}

impl<'a> Around<'a> {
    fn new(plan: &'a super::plan::Around, base: f64) -> Self {
        Self { plan, controller: Controller::new(&plan.tuning, base, base), pv: base, sp: base, base }
    }

    /// One scan of the inner loop: its set point.
    fn scan(&mut self, k: usize, inner: f64, load: f64) -> f64 {
        self.pv += (inner + load - self.pv) / self.plan.lag;
        if k.is_multiple_of(self.plan.every) {
            self.sp = self.controller.scan(self.base, self.pv);
        }
        self.sp
    }
}

/// The flow loop inside an outer loop, at work; all values in %.
struct Inside {
    gain: f64,
    lag: f64,
    flow: f64,
    sum: f64,
}

impl Inside {
    /// One substep: the signal to the valve for the set point `sp` and the stem's position.
    fn step(&mut self, sp: f64, stem: f64) -> f64 {
        let h = 1.0 / SUBSTEPS as f64;
        self.flow += h / self.lag * (stem - self.flow);
        let error = sp - self.flow;
        self.sum += h / self.lag * self.gain * error;
        self.sum + self.gain * error
    }
}

/// Runs a loop; `free` takes friction and the stem's mass away.
pub fn run(plan: &Plan, signals: &Signals, free: bool) -> Trace {
    let n = signals.scans();
    let h = plan.period / SUBSTEPS as f64;
    let mut stem = Stem::new(&plan.valve, plan.at);
    let mut flow = Flow::new(&plan.process, plan.base);
    let mut controller = Controller::new(&plan.tuning, plan.at, plan.base);
    let mut around = plan.around.as_ref().map(|around| Around::new(around, plan.base));
    let mut inside = plan.flow_loop.as_ref().map(|inner| Inside {
        gain: inner.gain,
        lag: inner.lag,
        flow: plan.at,
        sum: plan.at,
    });
    let mut trace = Trace { op: Vec::new(), pv: Vec::new(), sp: Vec::new(), stem: Vec::new() };
    let mut last = plan.base;
    for k in 0..n {
        let mut pv = plan.base + flow.output() + signals.load_out[k] + signals.noise[k];
        if signals.seen {
            pv = signals.fault.apply(k, pv, last);
        }
        last = pv;
        let outer = around.as_mut().map_or(plan.base, |around| around.scan(k, pv, signals.around[k]));
        let sp = outer + signals.sp[k];
        let op = (controller.scan(sp, pv) + signals.forward[k]).clamp(0.0, 100.0);
        stem.set_friction(signals.friction[k]);
        let slope = (signals.load_in[k + 1] - signals.load_in[k]) / SUBSTEPS as f64;
        for step in 0..SUBSTEPS {
            let u = inside.as_mut().map_or(op, |inside| inside.step(op, stem.x));
            if free {
                stem.step_free(u, h)
            } else {
                stem.step(u, h)
            }
            let load = signals.load_in[k] + slope * step as f64;
            let through = plan.process.characteristic.flow(stem.x, plan.at);
            flow.step(through, load, signals.dead[k], signals.gain[k]);
        }
        trace.op.push(op);
        trace.pv.push(pv);
        trace.sp.push(sp);
        trace.stem.push(stem.x);
    }
    trace
}
