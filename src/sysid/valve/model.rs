//! The parameters of a valve that sticks, and the rule by which its stem comes to rest.
//!
//! `valve/mod.rs` lists the symbols and the sources.

/// When a stem comes to rest. After a rest OP has to be more than `J` ahead before the stem goes on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum StopRule {
    /// At reversals only: the paper's element for `J = S`, a dead band for `J = 0`.
    #[default]
    Reversal,
    /// Also where OP stops or turns: the two-parameter valve of Choudhury and Kano.
    Stop,
    /// After every slip: He's valve, and a physical stem that reaches its equilibrium between two samples. Stenman's for
    /// `J = S`.
    Slip,
}

impl StopRule {
    /// All rules.
    pub const ALL: [StopRule; 3] = [StopRule::Reversal, StopRule::Stop, StopRule::Slip];
}

/// The large extremum of OP at which the recursion of the stem starts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Start {
    /// Sample of the extremum.
    pub index: usize,
    /// True for a maximum.
    pub is_max: bool,
}

/// Where the stem was at the start. No signal shows it, so it is searched.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rest {
    /// Whether its last move was down at a maximum of OP, or up at a minimum.
    pub turned: bool,
    /// Distance of `p` beyond OP in the direction of the last move, as a share of S (0..1).
    pub beyond: f64,
}

/// The parameters of a valve that sticks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ValveModel {
    /// Deadband plus stickband S (OP unit).
    pub s: f64,
    /// Slip jump J (OP unit); above S the stem overshoots OP.
    pub j: f64,
    /// When the stem rests.
    pub rule: StopRule,
    /// Resolution r (OP unit): with [`StopRule::Stop`] a moving stem comes to rest where OP goes on by no more.
    pub resolution: f64,
    /// Where it was at the start.
    pub rest: Rest,
    /// Turning down takes `S (1 + asymmetry)`, turning up `S (1 - asymmetry)` (-).
    pub asymmetry: f64,
    /// S and J grow from `1 - drift` to `1 + drift` times their values over the fitted samples (-).
    pub drift: f64,
    /// Positions of the lower and the upper mechanical stop (OP unit); `None` without stops.
    pub stops: Option<(f64, f64)>,
}

impl ValveModel {
    /// The paper's element: `S = J = 2 f`, rests at reversals only; `f` in OP units.
    pub fn one_parameter(f: f64) -> Self {
        Self { s: 2.0 * f, j: 2.0 * f, ..Self::default() }
    }

    /// `f = S/2` (OP unit).
    pub fn f(&self) -> f64 {
        0.5 * self.s
    }

    /// Kinetic lag `(S - J)/2` (OP unit).
    pub fn lag(&self) -> f64 {
        0.5 * (self.s - self.j)
    }

    /// Whether all parameters are in the range of a valve's.
    pub fn is_valid(&self) -> bool {
        self.s > 0.0
            && (0.0..=2.0 * self.s).contains(&self.j)
            && (0.0..=1.0).contains(&self.rest.beyond)
            && self.resolution >= 0.0
            && self.asymmetry.abs() < 1.0
            && self.drift.abs() < 1.0
    }

    /// The least and the largest `p` (OP unit): there the stem is at a stop. Infinite without stops.
    pub fn limits(&self) -> (f64, f64) {
        let (low, high) = self.stops.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
        (low - self.lag().max(0.0), high + self.lag().max(0.0))
    }
}

/// The largest f at which the stem still turns (OP unit): half the largest fall of OP after a maximum at `start`, or the
/// largest rise after a minimum.
pub fn largest_reversal(u: &[f64], start: Start) -> f64 {
    let sign = if start.is_max { 1.0 } else { -1.0 };
    let (mut top, mut fall) = (f64::NEG_INFINITY, 0.0_f64);
    for u in u.get(start.index..).unwrap_or_default() {
        top = top.max(sign * u);
        fall = fall.max(top - sign * u);
    }
    0.5 * fall
}

/// Half the largest move of OP in one direction after sample `from`, up or down (OP unit).
pub fn largest_move(u: &[f64], from: usize) -> f64 {
    let [fall, rise] = [true, false].map(|is_max| largest_reversal(u, Start { index: from, is_max }));
    fall.max(rise)
}

/// How often the direction of the stem changes.
pub fn reversals(dir: &[f64]) -> usize {
    dir.windows(2).filter(|w| w[0] != w[1]).count()
}
