//! Processes: a delay, lags in series and one last stage; time in scans of the controller.

use std::collections::VecDeque;
use std::ops::{Add, Mul};

use super::draw::{Draw, Range};

/// Steps of the process within one scan.
pub const FINE: usize = 4;

/// What the loop controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Fast first order with a small delay.
    Flow,
    /// Integrating, with an outflow that depends on the level in some.
    Level,
    /// Two lags.
    Pressure,
    /// Two or three lags and a delay.
    Temperature,
    /// A fast and a slow path side by side, which make a slow zero.
    Reactor,
}

impl Class {
    /// All classes.
    pub const ALL: [Class; 5] =
        [Class::Flow, Class::Level, Class::Pressure, Class::Temperature, Class::Reactor];

    /// The class in a word.
    pub fn as_str(self) -> &'static str {
        match self {
            Class::Flow => "flow",
            Class::Level => "level",
            Class::Pressure => "pressure",
            Class::Temperature => "temperature",
            Class::Reactor => "reactor",
        }
    }

    /// Scan periods that such a loop has (s).
    pub fn periods(self) -> &'static [f64] {
        match self {
            Class::Flow => &[1.0, 2.0],
            Class::Level => &[2.0, 5.0, 10.0],
            Class::Pressure => &[1.0, 2.0, 5.0],
            Class::Temperature => &[5.0, 10.0, 20.0, 30.0],
            Class::Reactor => &[10.0, 20.0, 30.0],
        }
    }
}

/// The part behind delay and lags.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// Nothing.
    Plain,
    /// A tank: the time in which a unit of input adds a unit, and the time of the leak (infinite without one).
    Tank { time: f64, leak: f64 },
    /// Two lags side by side: the share of the slow one and both time constants.
    Paths { share: f64, fast: f64, slow: f64 },
}

/// A linear process.
#[derive(Clone, Debug, PartialEq)]
pub struct Process {
    /// Gain (PV per OP), of either sign.
    pub gain: f64,
    /// Dead time (scans).
    pub delay: f64,
    /// Lag of the stem behind the friction, 0 for none (scans).
    pub stem_lag: f64,
    /// Lags in series (scans).
    pub lags: Vec<f64>,
    /// The last stage.
    pub stage: Stage,
}

/// Size of the gain (PV per OP).
const GAIN: Range = (0.3, 3.0);
/// Share of valves with a lag behind the friction.
const LAGGING_STEMS: f64 = 0.35;
/// Lag of such a stem (scans).
const STEM_LAG: Range = (0.1, 0.7);
/// Dead time and lag of a flow (scans).
const FLOW: [Range; 2] = [(1.0, 3.0), (1.0, 4.0)];
/// Dead time, filling time and leak's time of a level (scans).
const LEVEL: [Range; 3] = [(1.0, 4.0), (15.0, 80.0), (150.0, 400.0)];
/// Share of levels whose outflow depends on the level.
const LEAKING: f64 = 0.4;
/// Dead time and lags of a pressure (scans).
const PRESSURE: [Range; 3] = [(1.0, 4.0), (5.0, 20.0), (1.0, 5.0)];
/// Dead time and lags of a temperature (scans); half of them have the third lag.
const TEMPERATURE: [Range; 4] = [(2.0, 8.0), (15.0, 50.0), (5.0, 15.0), (2.0, 6.0)];
/// Dead time, lag, fast path and slow path of a reactor (scans).
const REACTOR: [Range; 4] = [(1.0, 6.0), (1.0, 4.0), (4.0, 12.0), (40.0, 90.0)];
/// Share of the slow path in a reactor that creeps, and in one that overshoots.
const SLOW_SHARES: [Range; 2] = [(0.3, 0.7), (-0.5, -0.2)];

impl Process {
    /// A process of the class.
    pub fn draw(draw: &mut Draw, class: Class) -> Self {
        let gain = draw.log_uniform(GAIN) * draw.sign();
        let stem_lag = if draw.chance(LAGGING_STEMS) { draw.uniform(STEM_LAG) } else { 0.0 };
        let (delay, lags, stage) = match class {
            Class::Flow => (draw.uniform(FLOW[0]), vec![draw.uniform(FLOW[1])], Stage::Plain),
            Class::Level => {
                let leak = if draw.chance(LEAKING) { draw.uniform(LEVEL[2]) } else { f64::INFINITY };
                let time = draw.log_uniform(LEVEL[1]);
                (draw.uniform(LEVEL[0]), vec![], Stage::Tank { time, leak })
            }
            Class::Pressure => {
                let lags = PRESSURE[1..].iter().map(|&range| draw.uniform(range)).collect();
                (draw.uniform(PRESSURE[0]), lags, Stage::Plain)
            }
            Class::Temperature => {
                let count = draw.whole(3, 4);
                let lags = TEMPERATURE[1..count].iter().map(|&range| draw.uniform(range)).collect();
                (draw.uniform(TEMPERATURE[0]), lags, Stage::Plain)
            }
            Class::Reactor => {
                let share = draw.pick(&SLOW_SHARES);
                let share = draw.uniform(share);
                let stage =
                    Stage::Paths { share, fast: draw.uniform(REACTOR[2]), slow: draw.uniform(REACTOR[3]) };
                (draw.uniform(REACTOR[0]), vec![draw.uniform(REACTOR[1])], stage)
            }
        };
        Self { gain, delay, stem_lag, lags, stage }
    }

    /// Whether PV runs away from a constant OP.
    pub fn integrates(&self) -> bool {
        matches!(self.stage, Stage::Tank { .. })
    }

    /// Frequency response with the hold of the scan (`omega` in rad per scan).
    pub fn response(&self, omega: f64) -> Complex {
        let held = Complex::polar(self.gain.abs(), -omega * (self.delay + 0.5));
        let lagged = self
            .lags
            .iter()
            .fold(held * Complex::lag(omega, self.stem_lag), |g, &lag| g * Complex::lag(omega, lag));
        lagged
            * match self.stage {
                Stage::Plain => Complex::new(1.0, 0.0),
                Stage::Tank { time, leak } => Complex::new(time / leak, omega * time).inverse(),
                Stage::Paths { share, fast, slow } => {
                    Complex::lag(omega, slow) * Complex::new(share, 0.0)
                        + Complex::lag(omega, fast) * Complex::new(1.0 - share, 0.0)
                }
            }
    }

    /// Time constant and dead time of a first-order model (half rule), in scans.
    pub fn first_order(&self) -> (f64, f64) {
        let mut lags = self.lags.clone();
        match self.stage {
            Stage::Plain => {}
            Stage::Tank { time, .. } => lags.push(time),
            Stage::Paths { share, fast, slow } => lags.push(fast.max(fast + share * (slow - fast))),
        }
        lags.push(self.stem_lag);
        lags.sort_by(|a, b| b.total_cmp(a));
        let rest: f64 = lags.iter().skip(2).sum();
        (lags[0] + lags[1] / 2.0, self.delay + 0.5 + lags[1] / 2.0 + rest)
    }
}

/// State of a process (deviations from its working point).
pub struct Running {
    line: VecDeque<f64>,
    stem_lag: Lag,
    lags: Vec<Lag>,
    stage: [Lag; 2],
    level: f64,
}

/// Longest dead time that a process may have (scans).
pub const LONGEST_DELAY: usize = 30;

impl Running {
    /// A process at rest.
    pub fn new(process: &Process) -> Self {
        let (fast, slow) = match process.stage {
            Stage::Paths { fast, slow, .. } => (fast, slow),
            _ => (0.0, 0.0),
        };
        Self {
            line: VecDeque::from(vec![0.0; LONGEST_DELAY * FINE + 1]),
            stem_lag: Lag::new(process.stem_lag),
            lags: process.lags.iter().map(|&lag| Lag::new(lag)).collect(),
            stage: [Lag::new(fast), Lag::new(slow)],
            level: 0.0,
        }
    }

    /// The stem behind its lag, after one fine step.
    pub fn stem(&mut self, stem: f64) -> f64 {
        self.stem_lag.step(stem)
    }

    /// PV's deviation after one fine step of the input (OP units); `gain` is the present gain.
    pub fn step(&mut self, process: &Process, input: f64, gain: f64, delay: f64) -> f64 {
        self.line.pop_back();
        self.line.push_front(input);
        let back = (delay * FINE as f64).round() as usize;
        let mut value = gain * self.line[back.min(LONGEST_DELAY * FINE)];
        for lag in &mut self.lags {
            value = lag.step(value);
        }
        match process.stage {
            Stage::Plain => value,
            Stage::Tank { time, leak } => {
                self.level += (value / time - self.level / leak) / FINE as f64;
                self.level
            }
            Stage::Paths { share, .. } => {
                (1.0 - share) * self.stage[0].step(value) + share * self.stage[1].step(value)
            }
        }
    }
}

/// A first-order lag, exact for an input held over the fine step.
struct Lag {
    pull: f64,
    state: f64,
}

impl Lag {
    /// A lag of the time constant (scans) at rest; 0 lets everything pass.
    fn new(time: f64) -> Self {
        let pull = if time > 0.0 { 1.0 - (-1.0 / (FINE as f64 * time)).exp() } else { 1.0 };
        Self { pull, state: 0.0 }
    }

    fn step(&mut self, input: f64) -> f64 {
        self.state += self.pull * (input - self.state);
        self.state
    }
}

/// A complex number.
#[derive(Clone, Copy, Debug)]
pub struct Complex {
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
}

impl Complex {
    /// From real and imaginary part.
    pub fn new(re: f64, im: f64) -> Self {
        Self { re, im }
    }

    /// From size and angle (rad).
    fn polar(size: f64, angle: f64) -> Self {
        Self::new(size * angle.cos(), size * angle.sin())
    }

    /// A first-order lag at a frequency.
    fn lag(omega: f64, time: f64) -> Self {
        Self::new(1.0, omega * time).inverse()
    }

    /// One over it.
    pub fn inverse(self) -> Self {
        let square = self.re * self.re + self.im * self.im;
        Self::new(self.re / square, -self.im / square)
    }

    /// Its size.
    pub fn size(self) -> f64 {
        self.re.hypot(self.im)
    }
}

impl Add for Complex {
    type Output = Complex;
    fn add(self, other: Complex) -> Complex {
        Complex::new(self.re + other.re, self.im + other.im)
    }
}

impl Mul for Complex {
    type Output = Complex;
    fn mul(self, other: Complex) -> Complex {
        Complex::new(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)
    }
}
