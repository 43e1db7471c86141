//! The process: valve characteristic, dead time, two lags, a zero, perhaps an integrator, a gain that may depend on PV.
//!
//! Times are in samples of the record; flows are deviations in % of OP, PV is in % of its span.

/// Substeps of the process per scan.
pub const SUBSTEPS: usize = 20;
/// Longest dead time that the buffer holds (samples).
const LONGEST: usize = 24;

/// Inherent characteristic of the valve, scaled to slope 1 at the working point.
#[derive(Clone, Copy, Debug)]
pub enum Characteristic {
    /// Flow goes with travel.
    Linear,
    /// Equal percentage, R^(x − 1), with its rangeability.
    EqualPercentage(f64),
    /// Quick opening, √x.
    QuickOpening,
}

impl Characteristic {
    /// Flow as a deviation from that at `at`, both positions in %.
    pub fn flow(self, x: f64, at: f64) -> f64 {
        match self {
            Self::Linear => x - at,
            Self::EqualPercentage(r) => {
                let rate = r.ln() / 100.0;
                ((rate * (x - at)).exp() - 1.0) / rate
            }
            Self::QuickOpening => 2.0 * ((at * x.max(0.0)).sqrt() - at),
        }
    }
}

/// How the gain depends on PV.
#[derive(Clone, Copy, Debug)]
pub enum Slope {
    /// Not at all.
    Even,
    /// Steepest at `centre` and flatter away from it, as a titration curve (both in PV as deviation).
    Titration {
        /// Where it is steepest.
        centre: f64,
        /// How wide the steep part is.
        width: f64,
    },
    /// Falls with the root, as a head against flow; `reach` is the deviation at which the root ends.
    Root {
        /// Distance from the working point to the root's end.
        reach: f64,
    },
    /// A conical tank: the area grows with the square of the level.
    Cone,
}

impl Slope {
    /// PV's deviation for the deviation `w` that an even process would have.
    pub fn output(self, w: f64) -> f64 {
        match self {
            Self::Even | Self::Cone => w,
            Self::Titration { centre, width } => {
                width * (((w - centre) / width).tanh() + (centre / width).tanh())
            }
            Self::Root { reach } => 2.0 * reach * ((1.0 + w / reach).max(0.02).sqrt() - 1.0),
        }
    }
}

/// A process.
#[derive(Clone, Debug)]
pub struct Process {
    /// Gain: PV by % of OP, or PV by % of OP and sample behind an integrator.
    pub gain: f64,
    /// Dead time (samples).
    pub dead: f64,
    /// Lags (samples); 0 for none.
    pub lags: [f64; 2],
    /// Time of the zero (samples): positive leads, negative answers inversely.
    pub zero: f64,
    /// Whether it integrates.
    pub integrating: bool,
    /// Valve characteristic.
    pub characteristic: Characteristic,
    /// Dependence of the gain on PV.
    pub slope: Slope,
}

/// A process in motion.
pub struct Flow<'a> {
    process: &'a Process,
    ring: Vec<f64>,
    head: usize,
    approach: [f64; 2],
    states: [f64; 2],
    level: f64,
    base: f64,
}

impl<'a> Flow<'a> {
    /// A process at rest; `base` is PV at the working point.
    pub fn new(process: &'a Process, base: f64) -> Self {
        let h = 1.0 / SUBSTEPS as f64;
        let approach = process.lags.map(|lag| if lag > 0.0 { 1.0 - (-h / lag).exp() } else { 1.0 });
        let ring = vec![0.0; LONGEST * SUBSTEPS];
        Self { process, ring, head: 0, approach, states: [0.0; 2], level: 0.0, base }
    }

    /// Moves for one substep: `flow` through the valve, `load` behind the dead time, `dead` and `gain` as they are.
    pub fn step(&mut self, flow: f64, load: f64, dead: f64, gain: f64) {
        self.head = (self.head + 1) % self.ring.len();
        self.ring[self.head] = flow;
        let back = ((dead * SUBSTEPS as f64).round() as usize).min(self.ring.len() - 1);
        let late = self.ring[(self.head + self.ring.len() - back) % self.ring.len()];
        self.states[0] += self.approach[0] * (gain * self.process.gain * (late + load) - self.states[0]);
        self.states[1] += self.approach[1] * (self.states[0] - self.states[1]);
        if self.process.integrating {
            let area = match self.process.slope {
                Slope::Cone => ((self.base + self.level) / self.base).max(0.1).powi(2),
                _ => 1.0,
            };
            self.level += self.through() / area / SUBSTEPS as f64;
        }
    }

    /// PV as a deviation from the working point.
    pub fn output(&self) -> f64 {
        if self.process.integrating { self.level } else { self.process.slope.output(self.through()) }
    }

    fn through(&self) -> f64 {
        let [first, second] = self.states;
        let lag = self.process.lags[1];
        if lag > 0.0 { second + self.process.zero * (first - second) / lag } else { second }
    }
}
