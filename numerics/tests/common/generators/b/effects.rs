//! Effects that are sized on the loop they act on: loads, stops and curves.

use std::f64::consts::{SQRT_2, TAU};

use stictiond_numerics::residual::Kind;

use super::super::{Case, Size};
use super::change::{Curve, Place};
use super::draw::{Draw, Range, Sized3};
use super::plan::{Plan, WARM_UP, add};
use super::run::{Natural, linear, natural, recorded, run};
use super::sensor;
use super::signals::{Colour, mean, quantile, sd, steps};
use super::valve::{Friction, Valve};

/// Why a loop does not serve its case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The loop moves too little to show the effect.
    Faint,
    /// OP or PV comes near its limits.
    Wide,
    /// The effect drowns in what the loop does by itself.
    Hidden,
}

/// Rms of what an effect does to PV, at least, in sd of its noise: small, medium, large.
const VISIBLE: [f64; 3] = [1.5, 3.5, 6.0];
/// The same for friction, whose trace comes back at every turn of OP: small, medium, large.
const FELT: [f64; 3] = [1.2, 3.0, 4.5];
/// Rms of what an effect does to PV, at least, in natural sd of PV, for a change of the process or a stop: small, medium, large.
const CHANGE_SHARE: [f64; 3] = [0.1, 0.25, 0.4];
/// The same for a curve, which is seen over the moves of the set point too: small, medium, large.
const CURVE_SHARE: [f64; 3] = [0.05, 0.12, 0.2];
/// The same for friction, which is seen at every turn of OP: small, medium, large.
const FRICTION_SHARE: [f64; 3] = [0.04, 0.08, 0.12];

/// Puts the effect of the case into the plan.
pub fn apply(draw: &mut Draw, case: &Case, plan: &mut Plan) -> Result<(), Fault> {
    let Some(kind) = case.effect else { return Ok(()) };
    let natural = natural(plan);
    match kind {
        Kind::OscillatingLoad => oscillating(draw, case.size, plan, &natural),
        Kind::MeasuredDisturbance => measured(draw, case.size, plan, &natural),
        Kind::LoadStep => load_step(draw, case.size, plan, &natural),
        Kind::Drift => drift(draw, case.size, plan, &natural),
        Kind::GainChange | Kind::DeadTimeChange => changed(case.size, plan),
        Kind::ValveSaturation => saturated(draw, case.size, plan),
        Kind::StaticNonlinearity => curved(draw, case.size, plan),
        Kind::SlipJump | Kind::AsymmetricFriction | Kind::FrictionDrift => rubbed(case.size, plan, &natural),
        Kind::QuantisedPv => {
            plan.sensor = sensor::quantised(draw, case.size, plan);
            Ok(())
        }
        Kind::Outliers => {
            plan.sensor = sensor::wild(draw, case.size, plan, &natural);
            Ok(())
        }
        Kind::FrozenPv => {
            plan.sensor = sensor::frozen(draw, case.size, plan, &run(plan)).ok_or(Fault::Faint)?;
            Ok(())
        }
        Kind::ClockSkew => skewed(draw, case.size, plan),
    }
}

/// What a load of size 1 does to a loop with a sound valve.
struct Answer {
    pv: Vec<f64>,
    op: Vec<f64>,
}

/// The answer of PV and OP to a load at the input (OP units) or output (PV units).
fn answer(plan: &Plan, load: &[f64], at_input: bool) -> Answer {
    let mut loaded = plan.clone();
    add(if at_input { &mut loaded.load_in } else { &mut loaded.load_out }, load, 1.0);
    let (with, without) = (linear(&loaded), linear(plan));
    let difference = |a: &[f64], b: &[f64]| {
        recorded(plan, a).iter().zip(recorded(plan, b)).map(|(a, b)| a - b).collect::<Vec<f64>>()
    };
    Answer { pv: difference(&with.pv, &without.pv), op: difference(&with.op, &without.op) }
}

/// A load's size: `share` of the natural sd in PV or OP, whichever shows first, and `floor` times the noise at least.
struct Sizing {
    share: f64,
    floor: f64,
    /// Largest movement of OP (% of OP's span).
    most: f64,
}

impl Sizing {
    /// The factor of a load that moves PV and OP by `pv` and `op`.
    fn factor(&self, plan: &Plan, natural: &Natural, (pv, op): (f64, f64)) -> Result<f64, Fault> {
        let shown = (natural.pv / pv).min(natural.op / op) * self.share;
        let factor = shown.max(self.floor * plan.noise_sd / pv);
        if factor * op > self.most { Err(Fault::Wide) } else { Ok(factor) }
    }
}

/// Adds a load of the factor.
fn load(plan: &mut Plan, signal: &[f64], at_input: bool, factor: f64) {
    add(if at_input { &mut plan.load_in } else { &mut plan.load_out }, signal, factor);
}

/// Share of loads that act at the process input.
const AT_INPUT: f64 = 0.6;
/// Noise multiples that a periodic or measured load makes in PV (amplitude or sd): small, medium, large.
const LOAD_FLOOR: [f64; 3] = [2.0, 5.0, 9.0];

/// Period of an oscillating load (scans).
const WAVE_PERIOD: Range = (10.0, 160.0);
/// Amplitude of an oscillating load's trace in PV or OP, in their natural sd: small, medium, large.
const WAVE: Sized3 = [(0.6, 0.9), (1.4, 2.2), (2.8, 4.2)];
/// Largest amplitude of OP under an oscillating load (% of OP's span).
const WAVE_IN_OP: f64 = 13.0;
/// How much the amplitude wanders, and the memory of that (scans).
const WAVE_WANDER: (Range, Range) = ((0.1, 0.3), (100.0, 300.0));
/// Second harmonic of a wave that is no pure sine.
const HARMONIC: Range = (0.05, 0.15);

/// A sine or nearly one.
fn oscillating(draw: &mut Draw, size: Size, plan: &mut Plan, natural: &Natural) -> Result<(), Fault> {
    let n = plan.total();
    let at_input = draw.chance(AT_INPUT);
    let (period, phase) = (draw.log_uniform(WAVE_PERIOD), draw.uniform((0.0, TAU)));
    let depth = if draw.chance(0.4) { draw.uniform(WAVE_WANDER.0) } else { 0.0 };
    let memory = draw.uniform(WAVE_WANDER.1);
    let swell = Colour::First(memory).signal(draw, n);
    let harmonic = if draw.chance(0.3) { draw.uniform(HARMONIC) } else { 0.0 };
    let wave: Vec<f64> = (0..n)
        .map(|k| {
            let angle = phase + TAU * k as f64 / period;
            (1.0 + depth * swell[k].clamp(-2.5, 2.5)) * (angle.sin() + harmonic * (2.0 * angle).sin())
        })
        .collect();
    let answer = answer(plan, &wave, at_input);
    let made = (SQRT_2 * sd(&answer.pv), SQRT_2 * sd(&answer.op));
    let sizing =
        Sizing { share: draw.sized(size, &WAVE), floor: LOAD_FLOOR[size as usize], most: WAVE_IN_OP };
    let factor = sizing.factor(plan, natural, made)?;
    load(plan, &wave, at_input, factor);
    Ok(())
}

/// Sd of a measured disturbance's trace in PV or OP, in their natural sd: small, medium, large.
const MEASURED: Sized3 = [(0.5, 0.75), (1.0, 1.8), (2.2, 3.2)];
/// Largest sd of OP under a measured disturbance (% of OP's span).
const MEASURED_IN_OP: f64 = 9.0;
/// Memory of a measured disturbance (scans).
const UPSTREAM_MEMORY: Range = (4.0, 150.0);
/// Time from the tag to the process (scans).
const UPSTREAM_DELAY: (usize, usize) = (0, 12);
/// Lag from the tag to the process (scans).
const UPSTREAM_LAG: Range = (0.5, 8.0);
/// Noise of the tag as a share of its sd.
const UPSTREAM_NOISE: Range = (0.005, 0.05);

/// A recorded tag that drives PV behind a delay and a lag.
fn measured(draw: &mut Draw, size: Size, plan: &mut Plan, natural: &Natural) -> Result<(), Fault> {
    let n = plan.total();
    let (delay, lag) = (draw.whole(UPSTREAM_DELAY.0, UPSTREAM_DELAY.1), draw.uniform(UPSTREAM_LAG));
    let pull = if draw.chance(0.5) { 1.0 - (-1.0 / lag).exp() } else { 1.0 };
    let cause = match draw.whole(0, 3) {
        0 => steps(draw, n),
        _ => Colour::First(draw.log_uniform(UPSTREAM_MEMORY)).signal(draw, n),
    };
    let mut state = cause[0];
    let driven: Vec<f64> = (0..n)
        .map(|k| {
            state += pull * (cause[k.saturating_sub(delay)] - state);
            state
        })
        .collect();
    let at_input = draw.chance(AT_INPUT);
    let answer = answer(plan, &driven, at_input);
    let sizing =
        Sizing { share: draw.sized(size, &MEASURED), floor: LOAD_FLOOR[size as usize], most: MEASURED_IN_OP };
    let factor = draw.sign() * sizing.factor(plan, natural, (sd(&answer.pv), sd(&answer.op)))?;
    load(plan, &driven, at_input, factor);
    let noise = draw.uniform(UPSTREAM_NOISE);
    let (unit, middle) = (draw.log_uniform((0.2, 20.0)), draw.uniform((20.0, 200.0)));
    plan.upstream = Some(cause.iter().map(|v| middle + unit * (v + noise * draw.normal())).collect());
    Ok(())
}

/// When a load steps (share of the record).
const STEP_AT: Range = (0.15, 0.85);
/// Peak of a load step's trace in PV or shift in OP, in their natural sd: small, medium, large.
const STEP: Sized3 = [(1.2, 1.8), (2.8, 4.2), (6.0, 9.0)];
/// Noise multiples that a load step makes in PV at its peak: small, medium, large.
const STEP_FLOOR: [f64; 3] = [3.0, 7.0, 14.0];
/// Largest shift of OP by a load step or drift (% of OP's span).
const SHIFT_IN_OP: f64 = 26.0;

/// A load that changes once; at the output of a process that runs away the level's sensor would jump alone.
fn load_step(draw: &mut Draw, size: Size, plan: &mut Plan, natural: &Natural) -> Result<(), Fault> {
    let at = WARM_UP + (draw.uniform(STEP_AT) * plan.n as f64) as usize;
    let step: Vec<f64> = (0..plan.total()).map(|k| f64::from(k >= at)).collect();
    let at_input = plan.process.integrates() || draw.chance(AT_INPUT);
    let answer = answer(plan, &step, at_input);
    let sizing =
        Sizing { share: draw.sized(size, &STEP), floor: STEP_FLOOR[size as usize], most: SHIFT_IN_OP };
    let made = (largest(&answer.pv), shift(&answer.op));
    let factor = draw.sign() * sizing.factor(plan, natural, made)?;
    load(plan, &step, at_input, factor);
    Ok(())
}

/// Where a drift begins that does not fill the record (share of the record).
const DRIFT_FROM: Range = (0.1, 0.6);
/// How far a drift takes OP, in OP's natural sd: small, medium, large.
const DRIFT: Sized3 = [(1.3, 2.0), (3.2, 4.8), (7.0, 10.0)];
/// How far a drift takes OP at least (% of OP's span): small, medium, large.
const DRIFT_FLOOR: [f64; 3] = [1.0, 3.0, 6.0];

/// A load or a sensor that ramps; behind an integrating process the load.
fn drift(draw: &mut Draw, size: Size, plan: &mut Plan, natural: &Natural) -> Result<(), Fault> {
    let n = plan.n as f64;
    let whole = draw.chance(0.5);
    let from = if whole { 0.0 } else { WARM_UP as f64 + draw.uniform(DRIFT_FROM) * n };
    let to = WARM_UP as f64 + n;
    let middle = if whole { WARM_UP as f64 + n / 2.0 } else { from };
    let ramp: Vec<f64> = (0..plan.total())
        .map(|k| ((k as f64).max(from) - middle) / (to - from.max(WARM_UP as f64)))
        .collect();
    let at_input = plan.process.integrates() || draw.chance(AT_INPUT);
    let answer = answer(plan, &ramp, at_input);
    let made = (answer.op[answer.op.len() - 1] - answer.op[0]).abs();
    let wanted = (draw.sized(size, &DRIFT) * natural.op).max(DRIFT_FLOOR[size as usize]);
    if wanted > SHIFT_IN_OP {
        return Err(Fault::Wide);
    }
    let factor = draw.sign() * wanted / made;
    load(plan, &ramp, at_input, factor);
    Ok(())
}

/// A changed process: shown where the loop moves enough.
fn changed(size: Size, plan: &Plan) -> Result<(), Fault> {
    let mut plain = plan.clone();
    plain.change.gain = 1.0;
    plain.change.delay = 0.0;
    visible(plan, &plain, plan.change.at, size, CHANGE_SHARE[size as usize])
}

/// Whether two plans' PVs part enough from a scan on, with sound valves.
fn visible(plan: &Plan, plain: &Plan, from: usize, size: Size, share: f64) -> Result<(), Fault> {
    let (with, without) = (linear(plan), linear(plain));
    let end = WARM_UP + plan.n;
    shown(plan, &natural(plain), parted(&with.pv[from..end], &without.pv[from..end]), size, share)
}

/// Whether a change of PV of this rms shows beside noise and natural motion.
fn shown(plan: &Plan, natural: &Natural, rms: f64, size: Size, share: f64) -> Result<(), Fault> {
    if rms < VISIBLE[size as usize] * plan.noise_sd {
        Err(Fault::Faint)
    } else if rms < share * natural.pv {
        Err(Fault::Hidden)
    } else {
        Ok(())
    }
}

/// Friction that is not what it seems: shown where the stem's difference from a plain one is seen in PV.
fn rubbed(size: Size, plan: &Plan, natural: &Natural) -> Result<(), Fault> {
    let op = run(plan).op;
    let plain = plan.friction.map(|f| match f.ratio {
        _ if !plan.worn.is_empty() => f,
        1.0 => Friction { j: f.s, ..f },
        _ => Friction { ratio: 1.0, ..f },
    });
    let (mut real, mut other) =
        (Valve::new(plan.friction, plan.stops, plan.op), Valve::new(plain, plan.stops, plan.op));
    let parted: Vec<f64> = (0..op.len())
        .map(|k| real.step(op[k], plan.worn.get(k).copied().unwrap_or(1.0)) - other.step(op[k], 1.0))
        .collect();
    let centre = mean(&parted);
    let parted: Vec<f64> = parted.iter().map(|v| v - centre).collect();
    let rms = sd(&answer(plan, &parted, true).pv);
    let least = (FELT[size as usize] * plan.noise_sd).max(FRICTION_SHARE[size as usize] * natural.pv);
    // Livelier loads would hide it, so that another loop is drawn instead.
    if rms < least { Err(Fault::Hidden) } else { Ok(()) }
}

/// Rms of the difference of two signals.
fn parted(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

/// Where the stop lies between the stem's mean and its upper or lower end: small, medium, large.
const STOP: Sized3 = [(0.78, 0.92), (0.45, 0.7), (0.15, 0.35)];
/// Share of the record with the stem at the stop: small, medium, large.
const STOPPED: Sized3 = [(0.02, 0.2), (0.07, 0.45), (0.2, 0.75)];

/// A stop that the stem runs into on one side.
fn saturated(draw: &mut Draw, size: Size, plan: &mut Plan) -> Result<(), Fault> {
    let plain = plan.clone();
    let trace = run(plan);
    let stem = recorded(plan, &trace.stem);
    let (middle, part) = (mean(stem), draw.sized(size, &STOP));
    let stop = |end: f64| middle + part * (quantile(stem, end) - middle);
    plan.stops = if draw.chance(0.5) { (0.0, stop(0.95)) } else { (stop(0.05), 100.0) };
    visible(plan, &plain, WARM_UP, size, CHANGE_SHARE[size as usize])?;
    let share = stopped(plan, &run(plan).op);
    let (low, high) = STOPPED[size as usize];
    if share < low || share > high { Err(Fault::Faint) } else { Ok(()) }
}

/// Share of the record in which OP lies beyond the stops by more than friction explains.
fn stopped(plan: &Plan, op: &[f64]) -> f64 {
    let band = plan.friction.map_or(0.0, |f| f.s / 2.0);
    let beyond = |op: f64| op > plan.stops.1 + band || op < plan.stops.0 - band;
    recorded(plan, op).iter().filter(|&&op| beyond(op)).count() as f64 / plan.n as f64
}

/// Range of PV in which a gain that depends on PV is shown (OP units, times the gain).
const CURVE_RANGE: Range = (8.0, 18.0);
/// Memory of the load that moves the curved valve of an integrating process (scans).
const CURVE_LOAD: Range = (60.0, 150.0);
/// Largest step of OP that a scaled set point makes (% of OP's span).
const CURVE_KICK: f64 = 10.0;
/// Factors by which loads may be widened along with the moves of the set point.
const LOAD_WIDER: Range = (0.5, 1.5);
/// Shares between which a range is taken.
const ENDS: (f64, f64) = (0.05, 0.95);
/// Sd of a normal signal in its range between these shares.
const SD_OF_RANGE: f64 = 1.0 / 3.29;

/// A curve, and moves that are wide enough to show it.
fn curved(draw: &mut Draw, size: Size, plan: &mut Plan) -> Result<(), Fault> {
    let straight = Curve { place: Place::Nowhere, ..plan.curve };
    let in_valve = plan.curve.place == Place::Valve;
    let wanted = if in_valve {
        plan.curve.ratio.ln() / plan.curve.rate.abs()
    } else {
        draw.uniform(CURVE_RANGE) * plan.process.gain.abs()
    };
    if in_valve && plan.process.integrates() {
        let memory = draw.uniform(CURVE_LOAD);
        let signal = Colour::First(memory).signal(draw, plan.total());
        add(&mut plan.load_in, &signal, wanted * SD_OF_RANGE);
    } else {
        let trace = run(&Plan { curve: straight, ..plan.clone() });
        let signal = recorded(plan, if in_valve { &trace.stem } else { &trace.pv });
        widen(plan, wanted / (quantile(signal, ENDS.1) - quantile(signal, ENDS.0)));
    }
    if !in_valve {
        // A gain that grows with PV acts on its own result, so that half the rate makes the ratio.
        let own = if plan.process.integrates() { 1.0 } else { 0.5 };
        plan.curve.rate = plan.curve.rate.signum() * own * plan.curve.ratio.ln() / wanted;
    }
    let plain = Plan { curve: straight, ..plan.clone() };
    visible(plan, &plain, WARM_UP, size, CURVE_SHARE[size as usize])
}

/// Multiplies loads and moves of the set point.
fn widen(plan: &mut Plan, factor: f64) {
    for load in plan.load_in.iter_mut().chain(&mut plan.load_out) {
        *load *= factor.clamp(LOAD_WIDER.0, LOAD_WIDER.1);
    }
    let kick = CURVE_KICK / plan.settings.noise_gain();
    let mut value = plan.sp[0];
    for sp in &mut plan.sp {
        let wanted = plan.pv + factor * (*sp - plan.pv);
        value += (wanted - value).clamp(-kick, kick);
        *sp = value;
    }
}

/// A skewed clock: shown where PV moves enough over the time that it is off.
fn skewed(draw: &mut Draw, size: Size, plan: &mut Plan) -> Result<(), Fault> {
    plan.skew = sensor::skew(draw, size, plan.n);
    let (offset, rate) = plan.skew;
    let off = (offset + rate * plan.n as f64 / 2.0).abs().round() as usize;
    let quiet = Plan { noise: vec![0.0; plan.total()], ..plan.clone() };
    let pv = run(&quiet).pv;
    let rms = parted(&pv[WARM_UP..WARM_UP + plan.n], &pv[WARM_UP - off..WARM_UP + plan.n - off]);
    if rms < VISIBLE[size as usize] * plan.noise_sd { Err(Fault::Faint) } else { Ok(()) }
}

/// Largest size in a signal.
fn largest(signal: &[f64]) -> f64 {
    signal.iter().fold(0.0, |most: f64, v| most.max(v.abs()))
}

/// Size of a signal's mean over its last tenth.
fn shift(signal: &[f64]) -> f64 {
    mean(&signal[signal.len() * 9 / 10..]).abs()
}
