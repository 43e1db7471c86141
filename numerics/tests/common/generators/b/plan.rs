//! Everything that is fixed about a record before the loop runs.

use stictiond_numerics::residual::Kind;

use super::super::Case;
use super::change::{Change, Curve, Place};
use super::controller::Settings;
use super::draw::{Draw, Range};
use super::process::{Class, Process};
use super::sensor::Sensor;
use super::signals::{Colour, Habit, set_point};
use super::valve::{Friction, Model};

/// What the valve of a variant is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Health {
    /// Follows OP exactly.
    Sound,
    /// Sticks a little.
    Weak,
    /// Sticks much.
    Strong,
}

impl Health {
    /// All of them; friction effects leave out the first.
    pub const ALL: [Health; 3] = [Health::Sound, Health::Weak, Health::Strong];

    /// The valve in a word.
    pub fn as_str(self) -> &'static str {
        match self {
            Health::Sound => "sound valve",
            Health::Weak => "weak friction",
            Health::Strong => "strong friction",
        }
    }
}

/// A loop and all that acts on it; every signal has one value per scan.
#[derive(Clone, Debug)]
pub struct Plan {
    /// What the loop controls.
    pub class: Class,
    /// The valve in a word.
    pub health: Health,
    /// Recorded scans.
    pub n: usize,
    /// Scan period (s).
    pub period: f64,
    /// The process at the start.
    pub process: Process,
    /// The controller.
    pub settings: Settings,
    /// OP where the process is at its working point (%).
    pub op: f64,
    /// PV there.
    pub pv: f64,
    /// The valve's friction; `None` for a sound one.
    pub friction: Option<Friction>,
    /// What the friction is multiplied by; empty where it stays.
    pub worn: Vec<f64>,
    /// Stops of the stem (%).
    pub stops: (f64, f64),
    /// Set point.
    pub sp: Vec<f64>,
    /// Load at the process input (OP units).
    pub load_in: Vec<f64>,
    /// Load at the process output (PV units).
    pub load_out: Vec<f64>,
    /// Noise on PV.
    pub noise: Vec<f64>,
    /// Its sd.
    pub noise_sd: f64,
    /// What changes about the process.
    pub change: Change,
    /// Curved characteristic.
    pub curve: Curve,
    /// What the transmitter makes of PV.
    pub sensor: Sensor,
    /// PV's clock: its offset (scans), and how much it gains per scan.
    pub skew: (f64, f64),
    /// The recorded tag that drives PV.
    pub upstream: Option<Vec<f64>>,
}

/// Scans that run before the record, so that nothing is left of the start.
pub const WARM_UP: usize = 500;
/// Scans that run after the record, for a PV whose clock is late.
pub const TAIL: usize = 40;
/// Recorded scans.
const LENGTH: (usize, usize) = (1000, 1980);
/// OP and PV at the working point (% of span).
const MIDDLE: Range = (40.0, 60.0);
/// Band S of a weak valve (% of OP's span).
const WEAK_BAND: Range = (0.6, 1.6);
/// Band S of a strong valve (% of OP's span).
const STRONG_BAND: Range = (2.5, 8.0);
/// Band S of a valve with a slip jump in a variant whose valve is else sound (% of OP's span).
const SLIP_BAND: Range = (1.5, 4.0);
/// J/S of a slip jump: small, medium, large.
const SLIP_SHARE: [Range; 3] = [(0.48, 0.6), (0.22, 0.42), (0.0, 0.15)];
/// J/S of valves that jump over their whole band or nearly.
const FULL_SHARE: Range = (0.9, 1.0);
/// J/S of valves with a dead band and a jump.
const PART_SHARE: Range = (0.1, 0.7);
/// Ratio of the bands of opening and closing: small, medium, large.
const BAND_RATIO: [Range; 3] = [(1.5, 1.7), (1.9, 2.3), (2.5, 3.0)];
/// Factor between the friction of start and end: small, medium, large.
const WORN_FACTOR: [Range; 3] = [(1.7, 1.9), (2.1, 2.4), (2.6, 3.0)];
/// Sd of PV's noise (PV span 100).
const NOISE: Range = (0.01, 0.1);
/// Sd of PV's noise as it comes through to OP, at most (% of OP's span).
const NOISE_IN_OP: f64 = 0.6;
/// Memory of coloured noise (scans).
const NOISE_MEMORY: Range = (0.6, 2.5);
/// Sd of the load (OP units).
const LOAD: Range = (0.3, 1.2);
/// Factor for a white load, of which slow processes let little pass.
const WHITE_FACTOR: f64 = 1.6;
/// Sd of a load at the output, at most (PV units).
const LOAD_OUT: f64 = 1.5;
/// How far the set point is moved (OP units, times the gain).
const SET_POINT_UNIT: Range = (1.0, 3.5);
/// Largest step of OP that a step of the set point makes (% of OP's span).
const KICK: f64 = 6.0;

impl Plan {
    /// A loop for the case; `lively` multiplies its loads and moves.
    pub fn draw(draw: &mut Draw, case: &Case, lively: f64) -> Self {
        let (class, health) = variant(case);
        let n = draw.whole(LENGTH.0, LENGTH.1);
        let total = WARM_UP + n + TAIL;
        let process = Process::draw(draw, class);
        let change = Change::draw(draw, case, n, &process);
        let curve = Curve::draw(draw, case);
        let settings = Settings::draw(draw, class, &process, &change.forms(&process, &curve));
        let most = (NOISE_IN_OP / settings.noise_gain()).clamp(2.0 * NOISE.0, NOISE.1);
        let noise_sd = draw.log_uniform((NOISE.0, most));
        let friction = friction(draw, case, health);
        let mut plan = Self {
            class,
            health,
            n,
            period: draw.pick(class.periods()),
            process,
            settings,
            op: draw.uniform(MIDDLE),
            pv: draw.uniform(MIDDLE),
            friction,
            worn: worn(draw, case, n),
            stops: (0.0, 100.0),
            sp: vec![],
            load_in: vec![0.0; total],
            load_out: vec![0.0; total],
            noise: noise(draw, noise_sd, total),
            noise_sd,
            change,
            curve,
            sensor: Sensor::Honest,
            skew: (0.0, 0.0),
            upstream: None,
        };
        plan.draw_loads(draw, lively);
        plan.draw_set_point(draw, case, lively);
        plan
    }

    /// The same loop without the effect and with this share of its friction; `bare`: as it was drawn, before its effect was sized
    /// on it.
    pub fn before(self, effect: Option<Kind>, bare: Plan, share: f64) -> Plan {
        // Loads and moves that only show a curve stay.
        let (load_in, load_out) = match effect {
            Some(Kind::StaticNonlinearity) => (self.load_in, self.load_out),
            _ => (bare.load_in, bare.load_out),
        };
        let of_before = |own: Friction| {
            let j = if effect == Some(Kind::SlipJump) { own.s } else { own.j };
            Friction { s: share * own.s, j: share * j, ratio: 1.0, ..own }
        };
        Plan {
            friction: self.friction.filter(|_| share > 0.0).map(of_before),
            worn: vec![],
            stops: (0.0, 100.0),
            load_in,
            load_out,
            change: Change { gain: 1.0, delay: 0.0, ..self.change },
            curve: Curve { place: Place::Nowhere, ..self.curve },
            sensor: Sensor::Honest,
            skew: (0.0, 0.0),
            ..self
        }
    }

    /// Scans that are simulated.
    pub fn total(&self) -> usize {
        WARM_UP + self.n + TAIL
    }

    /// A load at the input or output, in a third of the loops two.
    fn draw_loads(&mut self, draw: &mut Draw, lively: f64) {
        let count = if draw.chance(0.33) { 2 } else { 1 };
        for _ in 0..count {
            let colour = Colour::draw(draw);
            let size = draw.log_uniform(LOAD) * lively / f64::from(count).sqrt();
            let signal = colour.signal(draw, self.total());
            let at_input = colour == Colour::White || draw.chance(0.65);
            let (load, size) = match (at_input, colour) {
                (true, Colour::White) => (&mut self.load_in, WHITE_FACTOR * size),
                (true, _) => (&mut self.load_in, size),
                (false, _) => {
                    (&mut self.load_out, (size * self.process.gain.abs()).min(LOAD_OUT * lively.max(1.0)))
                }
            };
            add(load, &signal, size);
        }
    }

    /// At rest in a third of the loops, else moved as operators do.
    fn draw_set_point(&mut self, draw: &mut Draw, case: &Case, lively: f64) {
        let moving = [Habit::Steps, Habit::Ramps, Habit::Moves];
        let habit = match case.effect {
            Some(Kind::StaticNonlinearity) => draw.pick(&moving[..2]),
            _ if draw.chance(1.0 / 3.0) => Habit::Rest,
            _ => draw.pick(&moving),
        };
        let unit = draw.uniform(SET_POINT_UNIT) * lively * self.process.gain.abs();
        let kick = KICK * lively.clamp(1.0, 2.0) / self.settings.noise_gain();
        let moves = set_point(draw, habit, self.total(), unit, kick);
        self.sp = moves.iter().map(|v| self.pv + v).collect();
    }
}

/// Loop class and valve of a variant.
fn variant(case: &Case) -> (Class, Health) {
    let classes = Class::ALL.len();
    let healths = match case.effect {
        Some(Kind::AsymmetricFriction | Kind::FrictionDrift) => &Health::ALL[1..],
        _ => &Health::ALL[..],
    };
    (Class::ALL[case.variant % classes], healths[case.variant / classes % healths.len()])
}

/// How many variants an effect has.
pub fn variants(effect: Option<Kind>) -> usize {
    let healths = match effect {
        Some(Kind::AsymmetricFriction | Kind::FrictionDrift) => 2,
        _ => 3,
    };
    Class::ALL.len() * healths
}

/// The friction of a case.
fn friction(draw: &mut Draw, case: &Case, health: Health) -> Option<Friction> {
    let slip_jump = case.effect == Some(Kind::SlipJump);
    let s = match health {
        Health::Sound if slip_jump => draw.uniform(SLIP_BAND),
        Health::Sound => return None,
        Health::Weak => draw.uniform(WEAK_BAND),
        Health::Strong => draw.uniform(STRONG_BAND),
    };
    let mut model = match draw.whole(0, 9) {
        0..5 => Model::Kano,
        5 => Model::Stenman,
        6 | 7 => Model::He,
        _ => Model::Karnopp,
    };
    if slip_jump && model == Model::Stenman {
        model = Model::Kano;
    }
    let ratio = match case.effect {
        Some(Kind::AsymmetricFriction) => draw.sized(case.size, &BAND_RATIO),
        _ => 1.0,
    };
    let mut share = match draw.whole(0, 9) {
        _ if slip_jump => draw.sized(case.size, &SLIP_SHARE),
        _ if model == Model::Stenman => 1.0,
        0..3 => 1.0,
        3..5 => draw.uniform(FULL_SHARE),
        9 => 0.0,
        _ => draw.uniform(PART_SHARE),
    };
    if ratio > 1.0 {
        // The dead band S - J is one for both ways, so that the smaller band must hold it.
        let least = (ratio - 1.0) / (ratio + 1.0);
        share = least + share * (1.0 - least);
    }
    let ratio = if draw.chance(0.5) { ratio } else { 1.0 / ratio };
    Some(Friction { model, s, j: share * s, ratio })
}

/// How the friction of a case grows or falls, of mean 1 over the record.
fn worn(draw: &mut Draw, case: &Case, n: usize) -> Vec<f64> {
    if case.effect != Some(Kind::FrictionDrift) {
        return vec![];
    }
    let factor = draw.sized(case.size, &WORN_FACTOR);
    let (from, to) = if draw.chance(0.6) { (1.0, factor) } else { (factor, 1.0) };
    let (at, time) = (draw.uniform((0.3, 0.7)), draw.uniform((0.15, 0.4)));
    let shape = draw.whole(0, 9);
    let course: Vec<f64> = (0..n)
        .map(|k| {
            let along = k as f64 / n as f64;
            let done = match shape {
                0 | 1 => f64::from(along >= at),
                2 | 3 => (1.0 - (-along / time).exp()) / (1.0 - (-1.0 / time).exp()),
                _ => along,
            };
            from + (to - from) * done
        })
        .collect();
    let level = course.iter().sum::<f64>() / n as f64;
    let before = std::iter::repeat_n(from / level, WARM_UP);
    let after = std::iter::repeat_n(to / level, TAIL);
    before.chain(course.iter().map(|v| v / level)).chain(after).collect()
}

/// White noise in six loops of ten, else noise of a short memory.
fn noise(draw: &mut Draw, sd: f64, n: usize) -> Vec<f64> {
    let colour = if draw.chance(0.6) { Colour::White } else { Colour::First(draw.uniform(NOISE_MEMORY)) };
    colour.signal(draw, n).iter().map(|v| sd * v).collect()
}

/// Adds a signal times a size.
pub fn add(to: &mut [f64], signal: &[f64], size: f64) {
    for (sum, value) in to.iter_mut().zip(signal) {
        *sum += size * value;
    }
}
