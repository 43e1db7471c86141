//! Everything about a loop that does not change over the record: process, controller, valve, working point.

use super::control::Tuning;
use super::draw::Draw;
use super::process::{Characteristic, Process, Slope};
use super::valve::{Force, Model, Valve};

/// J by S of friction that is not unusual.
const ORDINARY_SLIP: f64 = 0.95;
/// Band S of a valve that no longer sticks (% of OP): in the middle of those of sound valves.
const SOUND_BAND: f64 = 0.016;
/// Largest process gain where the stem travels far (PV by % of OP).
const BEND_GAIN: f64 = 0.9;

/// Classes of loops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Flow: fast, short dead time.
    Flow,
    /// Level: integrating.
    Level,
    /// Pressure: one long lag.
    Pressure,
    /// Temperature: two lags, long dead time.
    Temperature,
    /// Two lags and dead time with an inverse answer or a lead.
    SecondOrder,
    /// The inner loop of a cascade: its set point moves.
    Inner,
    /// The outer loop of a cascade: its output is the set point of a flow loop or of a positioner.
    Outer,
}

impl Class {
    /// All classes.
    pub const ALL: [Class; 7] = [
        Class::Flow,
        Class::Level,
        Class::Pressure,
        Class::Temperature,
        Class::SecondOrder,
        Class::Inner,
        Class::Outer,
    ];

    fn period(self, draw: &mut Draw) -> f64 {
        let choices: &[f64] = match self {
            Class::Flow | Class::Inner => &[1.0, 1.0, 2.0, 3.0],
            Class::Pressure => &[1.0, 2.0, 4.0, 5.0],
            Class::Level => &[2.0, 5.0, 10.0, 15.0],
            Class::Temperature | Class::SecondOrder | Class::Outer => &[5.0, 10.0, 20.0, 30.0],
        };
        choices[draw.whole(0, choices.len() - 1)]
    }
}

/// How the valve sticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grip {
    /// Next to no friction.
    Sound,
    /// A band that an engineer may overlook.
    Weak,
    /// A band that makes most loops cycle.
    Strong,
    /// A band between the two, for a sound valve that must stick.
    Middling,
}

/// What an effect asks of the plan.
#[derive(Clone, Debug)]
pub struct Wish {
    /// Factor that the process gain takes at some time; 1 if it stays.
    pub gain: f64,
    /// Change of the dead time (samples).
    pub delay: f64,
    /// Whether loads and set point must move the loop plainly.
    pub lively: bool,
    /// Whether the controller is tuned tight, with part of the room for a longer dead time only.
    pub tight: bool,
    /// Range of a curved gain: largest by smallest.
    pub bend: Option<(Bend, f64)>,
    /// Share of J in S, where it is asked for.
    pub slip: Option<f64>,
    /// Friction's ratio of the directions, opening by closing.
    pub asymmetry: f64,
    /// Whether the stem must be moved by OP itself, without a flow loop between.
    pub direct: bool,
    /// Share by which the draws become calmer, after draws that left the range.
    pub calm: f64,
}

/// What is curved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bend {
    /// The valve's characteristic.
    Valve,
    /// The process gain over PV.
    Gain,
}

/// A flow loop inside the recorded outer loop; times in samples of the record.
#[derive(Clone, Debug)]
pub struct FlowLoop {
    /// Gain (% of OP by % of flow).
    pub gain: f64,
    /// Reset time and lag of the flow measurement.
    pub lag: f64,
}

/// The loop around a recorded inner loop; times in samples.
#[derive(Clone, Debug)]
pub struct Around {
    /// Lag of its process behind the inner PV.
    pub lag: f64,
    /// Its controller.
    pub tuning: Tuning,
    /// Scans of the inner controller by scan of the outer one.
    pub every: usize,
}

/// A loop.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Its class.
    pub class: Class,
    /// Scan and record period (s).
    pub period: f64,
    /// Samples of the record.
    pub samples: usize,
    /// Process.
    pub process: Process,
    /// Controller.
    pub tuning: Tuning,
    /// Valve.
    pub valve: Valve,
    /// Mean band S (% of OP); next to 0 for a sound valve.
    pub band: f64,
    /// Mean jump J (% of OP).
    pub jump: f64,
    /// Flow loop between OP and the valve.
    pub flow_loop: Option<FlowLoop>,
    /// Loop around, for an inner loop.
    pub around: Option<Around>,
    /// Standard deviation of PV's noise (PV).
    pub noise: f64,
    /// Working point of the stem (%).
    pub at: f64,
    /// Working point of PV.
    pub base: f64,
    /// Half of the stem's range that a curve needs (%); 0 without one.
    pub reach: f64,
}

impl Plan {
    /// Draws a loop.
    pub fn draw(class: Class, grip: Grip, wish: &Wish, draw: &mut Draw) -> Self {
        let period = class.period(draw);
        let samples = draw.whole(1000, 2000);
        let base = draw.even(40.0, 60.0);
        let mut process = draw_process(class, wish, draw);
        let (at, reach, most) = curve(&mut process, base, wish, draw);
        let (mut tuning, closed) = tune(&mut process, most * wish.gain.max(1.0), wish, draw);
        let noise = draw.log(0.01, 0.1).min(0.7 / tuning.gain.abs()).max(0.01);
        limit_rate(&mut tuning, noise);
        let (valve, band, jump) = draw_valve(grip, class, period, wish, draw);
        let sound = grip == Grip::Sound && class == Class::Outer && !wish.direct;
        let flow_loop = sound.then(|| FlowLoop { gain: draw.even(0.3, 0.6), lag: draw.even(0.15, 0.6) });
        let mut valve = valve;
        if flow_loop.is_some() {
            valve.positioner = 0.0;
        }
        let around = (class == Class::Inner).then(|| draw_around(closed, draw));
        Self {
            class,
            period,
            samples,
            process,
            tuning,
            valve,
            band,
            jump,
            flow_loop,
            around,
            noise,
            at,
            base,
            reach,
        }
    }

    /// The same loop without a curve, a stop, or friction of an unusual kind.
    pub fn ordinary(&self) -> Self {
        let mut plan = self.clone();
        let force = Force::from_band(self.band, ORDINARY_SLIP * self.band);
        (plan.valve.opening, plan.valve.closing) = (force, force);
        plan.valve.stops = (0.0, 100.0);
        (plan.process.characteristic, plan.process.slope) = (Characteristic::Linear, Slope::Even);
        plan
    }

    /// The same loop without the effect and with this share of its friction; `slips`: its jump is the effect.
    pub fn before(&self, slips: bool, share: f64) -> Self {
        let mut plan = self.ordinary();
        let jump = if slips { ORDINARY_SLIP * self.band } else { self.jump };
        // A sound valve has a little, too.
        let share = if self.sticks() { share.max(SOUND_BAND / self.band) } else { 1.0 };
        let force = Force::from_band(self.band, jump).times(share);
        (plan.valve.opening, plan.valve.closing) = (force, force);
        plan
    }

    /// Whether the valve sticks.
    pub fn sticks(&self) -> bool {
        self.band > 0.1
    }

    /// The loop in a few words.
    pub fn name(&self) -> String {
        let class = format!("{:?}", self.class).to_lowercase();
        let inner = match (&self.flow_loop, self.valve.positioner > 0.0) {
            (Some(_), _) => " over a flow loop",
            (None, true) => " over a positioner",
            (None, false) => "",
        };
        let model = if self.valve.model == Model::Karnopp { "Karnopp" } else { "LuGre" };
        format!("{class}{inner}, {}, {model} S {:.2} J {:.2}", self.tuning.name(), self.band, self.jump)
    }
}

fn draw_process(class: Class, wish: &Wish, draw: &mut Draw) -> Process {
    let gain = draw.log(0.4, 1.5) * draw.sign();
    let mut integrating = class == Class::Level;
    let mut zero = 0.0;
    let (dead, lags) = match class {
        Class::Flow => (draw.even(1.0, 2.5), [draw.log(0.7, 5.0), 0.3]),
        Class::Level => (draw.even(1.0, 4.0), [draw.even(0.2, 2.0), 0.0]),
        Class::Pressure => {
            let long = draw.log(5.0, 25.0);
            (draw.even(1.0, 4.0), [long, draw.even(0.2, 1.5)])
        }
        Class::Temperature => {
            let long = draw.log(8.0, 40.0);
            (draw.even(2.0, 8.0), [long, long * draw.even(0.1, 0.5)])
        }
        Class::SecondOrder => {
            let long = draw.log(3.0, 15.0);
            let short = long * draw.even(0.4, 0.9);
            zero = if draw.chance(0.5) { -draw.even(0.3, 1.0) * short } else { draw.even(0.2, 0.6) * short };
            (draw.even(1.0, 7.0), [long, short])
        }
        Class::Inner => (draw.even(1.0, 3.0), [draw.log(0.7, 8.0), 0.3]),
        Class::Outer => {
            integrating = draw.chance(0.3);
            let long = if integrating { draw.even(0.5, 3.0) } else { draw.log(6.0, 30.0) };
            (draw.even(1.0, 6.0), [long, long * draw.even(0.1, 0.4)])
        }
    };
    // A dead time that becomes shorter must have been longer before.
    let dead = dead + (-wish.delay).max(0.0);
    let (characteristic, slope) = (Characteristic::Linear, Slope::Even);
    Process { gain, dead, lags, zero, integrating, characteristic, slope }
}

/// Bends the process: the stem's working point, half the stem's range, and the largest gain by that at the working
/// point.
fn curve(process: &mut Process, base: f64, wish: &Wish, draw: &mut Draw) -> (f64, f64, f64) {
    let Some((bend, ratio)) = wish.bend else {
        return (draw.even(38.0, 62.0), 0.0, 1.0);
    };
    // PV travels with the stem.
    process.gain = process.gain.clamp(-BEND_GAIN, BEND_GAIN);
    let at = draw.even(40.0, 58.0);
    if bend == Bend::Valve {
        if draw.chance(0.6) {
            let r: f64 = draw.even(30.0, 50.0);
            process.characteristic = Characteristic::EqualPercentage(r);
            return (at, 50.0 * ratio.ln() / r.ln(), ratio.sqrt());
        }
        process.characteristic = Characteristic::QuickOpening;
        let share = (ratio * ratio - 1.0) / (ratio * ratio + 1.0);
        let at = (30.0 / share).clamp(32.0, 45.0);
        return (at, (share * at).min(30.0), (1.0 - share).powf(-0.5));
    }
    if process.integrating {
        process.slope = Slope::Cone;
        // The level's range follows from the ratio; the least level has the largest gain.
        let low = cone_range(ratio, base);
        return (at, 0.0, (base / (base - low)).powi(2));
    }
    let reach = draw.even(8.0, 14.0);
    let most = reach * process.gain.abs();
    if draw.chance(0.5) {
        let share = (ratio * ratio - 1.0) / (ratio * ratio + 1.0);
        process.slope = Slope::Root { reach: most / share };
        return (at, reach, (1.0 - share).powf(-0.5));
    }
    let centre = draw.sign() * draw.even(0.3, 1.0) * most;
    let width = (most + centre.abs()) / ratio.sqrt().acosh();
    process.slope = Slope::Titration { centre, width };
    (at, reach, 1.0)
}

/// Half the range of a conical tank's level over which its gain changes by `ratio`.
pub fn cone_range(ratio: f64, base: f64) -> f64 {
    let root = ratio.sqrt();
    base * (root - 1.0) / (root + 1.0)
}

/// Settings by the process' lags and dead time, from tight to sluggish; the closed loop's time (samples).
fn tune(process: &mut Process, most: f64, wish: &Wish, draw: &mut Draw) -> (Tuning, f64) {
    let [long, short] = process.lags;
    let room = if wish.tight { 0.5 } else { 1.0 };
    let dead = process.dead + room * wish.delay.max(0.0) + 0.5 + short / 2.0 + (-process.zero).max(0.0);
    let time = long + short / 2.0;
    let closed = dead * draw.log(0.9, if wish.tight { 2.0 } else { 5.0 }) + dead;
    let (gain, reset) = if process.integrating {
        let closed = closed + time;
        // Here the gain of the controller is drawn, and the vessel's size follows from it.
        let gain = draw.log(0.6, 5.0);
        process.gain = process.gain.signum() / (gain * closed * most);
        (gain, 4.0 * closed)
    } else {
        (time / (process.gain.abs() * closed * most), time.min(4.0 * closed))
    };
    let gain = gain * draw.log(0.75, 1.25) * process.gain.signum();
    let reset = reset * draw.log(0.75, 1.5);
    let with_rate = short > 1.0 && draw.chance(0.6);
    let rate = if with_rate { (short * draw.even(0.4, 1.0)).min(reset / 4.0) } else { 0.0 };
    let filter = draw.even(4.0, 10.0);
    let weight = if draw.chance(0.5) { 1.0 } else { draw.even(0.0, 1.0) };
    let (velocity, series) = (draw.chance(0.5), draw.chance(0.5));
    (Tuning { gain, reset, rate, filter, weight, velocity, series }, closed)
}

/// Drops the derivative part where it would make OP too noisy.
fn limit_rate(tuning: &mut Tuning, noise: f64) {
    let share = 1.0 / (1.0 + tuning.rate / tuning.filter);
    if tuning.gain.abs() * noise * (1.0 + tuning.rate * share) > 0.8 {
        tuning.rate = 0.0;
    }
}

fn draw_valve(grip: Grip, class: Class, period: f64, wish: &Wish, draw: &mut Draw) -> (Valve, f64, f64) {
    let band = match grip {
        Grip::Sound => draw.even(0.004, 0.028),
        Grip::Weak => draw.even(0.6, 1.6),
        Grip::Middling => draw.even(1.5, 4.0),
        Grip::Strong => 2.5 + (draw.log(2.5, 8.0) - 2.5) * wish.calm,
    };
    let slip = wish.slip.unwrap_or_else(|| {
        let kind = draw.even(0.0, 1.0);
        if kind < 0.2 {
            0.0
        } else if kind < 0.6 {
            draw.even(0.1, 0.85)
        } else {
            draw.even(0.91, 0.98)
        }
    });
    let jump = slip * band;
    let mean = Force::from_band(band, jump);
    let ratio = wish.asymmetry;
    let model = if draw.chance(0.5) { Model::Karnopp } else { Model::Lugre };
    let positioner = if class == Class::Outer { draw.even(0.8, 2.0) } else { 0.0 };
    // A positioner must be quick against the stem, or the stem runs on after a slip.
    let (stem, damping, air) = if positioner > 0.0 {
        let stem = period * draw.even(0.025, 0.035);
        (stem, draw.even(2.2, 2.6), 0.05 * stem)
    } else {
        (period * draw.even(0.015, 0.03), draw.even(0.9, 1.6), draw.even(0.1, 0.8).max(0.02 * period))
    };
    let valve = Valve {
        model,
        opening: mean.times(2.0 * ratio / (1.0 + ratio)),
        closing: mean.times(2.0 / (1.0 + ratio)),
        stem,
        damping,
        air,
        positioner,
        stops: (0.0, 100.0),
    };
    (valve, band, jump)
}

fn draw_around(closed: f64, draw: &mut Draw) -> Around {
    let lag = draw.log(10.0, 50.0);
    let slow = 3.0 * closed + 5.0;
    let gain = (lag / slow).min(4.0) * draw.log(0.5, 1.0);
    let tuning = Tuning {
        gain,
        reset: lag * draw.even(0.8, 1.5),
        rate: 0.0,
        filter: 1.0,
        weight: 1.0,
        velocity: draw.chance(0.5),
        series: false,
    };
    Around { lag, tuning, every: draw.whole(1, 5) }
}
