//! Valves that stick, as functions of OP.
//!
//! ```text
//! x[k] = p[k] - dir[k] (S - J)/2
//! p[k] = u[k]      where the stem moves,   p[k-1] where it rests
//! dir  = direction of the last move, +1 or -1
//!
//! p is held within the stops.
//!
//! The stem turns     where  dir (p - u) > S
//! The stem goes on   where  dir (u - p) > J after a rest, > r otherwise
//! ```
//!
//! `S` is the deadband plus stickband, `J` the slip jump, both in OP units; the paper's parameter is `f = S/2` and its
//! element has `J = S` and rests at reversals only. What counts as a rest is the [`StopRule`]: it tells the models of the
//! literature apart. `r` is the resolution with which a stem follows OP: one that rests whenever OP stops has come to rest,
//! too, where OP goes on by less.
//!
//! Sources: Choudhury et al., Control Eng. Practice 2005, 13, 641; Kano et al., IFAC DYCOPS 2004; He et al., Ind. Eng.
//! Chem. Res. 2007, 46, 4549; Stenman et al., Int. J. Adapt. Control 2003, 17, 251; Ivan & Lakshminarayanan 2009.

pub mod batch;
pub mod model_error;

/// When a stem rests, so that OP has to be `J` ahead before it goes on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum StopRule {
    /// At reversals only: the paper's element for `J = S`, a dead band for `J = 0`.
    #[default]
    Reversal,
    /// Whenever OP stops or turns: the two-parameter valve of Choudhury and Kano.
    Stop,
    /// After every slip: He's valve, and a physical stem that reaches its equilibrium between two samples. Stenman's for
    /// `J = S`.
    Slip,
}

impl StopRule {
    /// All rules.
    pub const ALL: [StopRule; 3] = [StopRule::Reversal, StopRule::Stop, StopRule::Slip];
}

/// The large extremum of OP from which a stem is followed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Start {
    /// Sample of the extremum.
    pub index: usize,
    /// True for a maximum.
    pub is_max: bool,
}

/// Where the stem was at the start, which no signal says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rest {
    /// Whether its last move was the other way than the extremum of OP says.
    pub turned: bool,
    /// How far `p` lay beyond OP in the direction of that move, as a share of S (0..1).
    pub beyond: f64,
}

/// A valve that sticks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ValveModel {
    /// Deadband plus stickband S (OP unit).
    pub s: f64,
    /// Slip jump J (OP unit); beyond S where the stem overshoots OP.
    pub j: f64,
    /// When the stem rests.
    pub rule: StopRule,
    /// Step of OP up to which a stem that moves comes to rest, with [`StopRule::Stop`] (OP unit).
    pub resolution: f64,
    /// Where it was at the start.
    pub rest: Rest,
    /// Turning down takes `S (1 + asymmetry)`, turning up `S (1 - asymmetry)` (-).
    pub asymmetry: f64,
    /// S and J grow from `1 - drift` to `1 + drift` times themselves over the fitted samples (-).
    pub drift: f64,
    /// Mechanical stops of the stem, where there are some (OP unit): OP goes on beyond them, the stem does not.
    pub stops: Option<(f64, f64)>,
}

impl ValveModel {
    /// The paper's element.
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

    /// Whether its parameters are a valve's.
    pub fn is_valid(&self) -> bool {
        self.s > 0.0
            && (0.0..=2.0 * self.s).contains(&self.j)
            && (0.0..=1.0).contains(&self.rest.beyond)
            && self.resolution >= 0.0
            && self.asymmetry.abs() < 1.0
            && self.drift.abs() < 1.0
    }

    /// Where OP at most moves `p` to: the stem is at a stop there.
    pub fn limits(&self) -> (f64, f64) {
        let (low, high) = self.stops.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
        (low - self.lag().max(0.0), high + self.lag().max(0.0))
    }

    /// Factor on S and J at sample `k` of `span` fitted ones.
    pub fn growth(&self, k: usize, span: usize) -> f64 {
        growth(self.drift, k, span)
    }

    /// Runs OP through the valve.
    ///
    /// * `u`: OP, N values (OP unit); before `start` the stem follows it.
    /// * `span`: samples over which [`ValveModel::drift`] is counted.
    /// * `x`: receives the stem, N values (OP unit); `dir` the direction of its last move.
    pub fn run(&self, u: &[f64], start: Start, span: usize, x: &mut Vec<f64>, dir: &mut Vec<f64>) {
        x.clear();
        dir.clear();
        let mut stem = Stem::new(self, start);
        for (k, &u) in u.iter().enumerate() {
            let grown = self.growth(k, span);
            if k <= start.index {
                stem.place(self, u, grown, k == start.index);
            } else {
                stem.step(self, u, grown);
            }
            x.push(stem.position - self.lag() * grown * stem.direction);
            dir.push(stem.direction);
        }
    }
}

/// Factor on the bands of a valve with this drift at sample `k` of `span`; extrapolated to three times the middle.
pub fn growth(drift: f64, k: usize, span: usize) -> f64 {
    (1.0 + drift * ((2.0 * k as f64 / span as f64).min(3.0) - 1.0)).max(0.0)
}

/// The state of one stem.
#[derive(Clone, Copy, Debug)]
struct Stem {
    /// OP at which it last moved.
    position: f64,
    /// Direction of that move.
    direction: f64,
    /// Whether it rests.
    rests: bool,
}

impl Stem {
    fn new(valve: &ValveModel, start: Start) -> Self {
        let direction = if start.is_max != valve.rest.turned { 1.0 } else { -1.0 };
        Self { position: 0.0, direction, rests: true }
    }

    /// Puts the stem where it is taken to be before the start, and at it.
    fn place(&mut self, valve: &ValveModel, u: f64, grown: f64, at_start: bool) {
        let beyond = if at_start { valve.s * grown * valve.rest.beyond } else { 0.0 };
        self.position = u + self.direction * beyond;
        self.rests = valve.rule != StopRule::Reversal;
    }

    /// One sample: the one recursion behind every valve here.
    fn step(&mut self, valve: &ValveModel, u: f64, grown: f64) {
        let onward = self.direction * (u - self.position);
        let turns = -onward > valve.s * grown * (1.0 + valve.asymmetry * self.direction);
        let ahead = if self.rests { valve.j } else { valve.resolution };
        if turns || onward > ahead * grown {
            let (low, high) = valve.limits();
            self.position = u.max(low).min(high);
            self.direction = if turns { -self.direction } else { self.direction };
            self.rests = valve.rule == StopRule::Slip;
        } else {
            self.rests = valve.rule != StopRule::Reversal;
        }
    }
}

/// Half the largest fall of OP from a maximum, or rise from a minimum, after `start` (OP unit): with a larger f the stem
/// never turns.
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

/// How often the stem turns.
pub fn reversals(dir: &[f64]) -> usize {
    dir.windows(2).filter(|w| w[0] != w[1]).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn run(valve: ValveModel, u: &[f64], start: Start) -> (Vec<f64>, Vec<f64>) {
        let (mut x, mut dir) = (Vec::new(), Vec::new());
        valve.run(u, start, u.len(), &mut x, &mut dir);
        (x, dir)
    }

    const MAX_AT_1: Start = Start { index: 1, is_max: true };

    #[test]
    fn the_papers_element_sticks_for_2f_on_a_reversal_and_then_follows() {
        let u = [0.0, 3.0, 2.0, 1.0, 0.5, 0.0, -1.0, -0.5, 0.0, 1.0, 1.5, 2.0];
        let (x, dir) = run(ValveModel::one_parameter(1.0), &u, MAX_AT_1);
        assert_eq!(x, [0.0, 3.0, 3.0, 3.0, 0.5, 0.0, -1.0, -1.0, -1.0, -1.0, 1.5, 2.0]);
        assert_eq!(reversals(&dir), 2);
    }

    #[test]
    fn a_stem_at_rest_goes_on_beyond_its_slip_jump() {
        // S = 2, J = 1: the stem trails by 0.5; it rests at 3, OP is 0.5 ahead at 3.5, it goes on at 4.5.
        let valve = ValveModel { s: 2.0, j: 1.0, rule: StopRule::Stop, ..ValveModel::default() };
        let u = [0.0, 3.0, 2.5, 3.5, 4.5, 5.0, 2.5];
        assert_eq!(run(valve, &u, MAX_AT_1).0, [-0.5, 2.5, 2.5, 2.5, 4.0, 4.5, 3.0]);
        // He's rests after each slip: 5.0 is 0.5 ahead only.
        let he = ValveModel { rule: StopRule::Slip, ..valve };
        assert_eq!(run(he, &u, MAX_AT_1).0, [-0.5, 2.5, 2.5, 2.5, 4.0, 4.0, 4.0]);
    }

    #[test]
    fn a_band_that_differs_is_wider_on_one_side() {
        let u = [0.0, 4.0, 1.5, 0.5, 2.0, 3.6];
        let valve = ValveModel { asymmetry: 0.5, ..ValveModel::one_parameter(1.0) };
        // Down takes more than 3, up more than 1.
        assert_eq!(run(valve, &u, MAX_AT_1).0, [0.0, 4.0, 4.0, 0.5, 2.0, 3.6]);
    }

    #[test]
    fn a_stem_at_its_stop_leaves_it_when_the_force_has_turned() {
        // S = 2, J = 1, a stop at 3: the stem is there from OP 3.5 on, and leaves it where OP is below 3.5 - S.
        let valve =
            ValveModel { s: 2.0, j: 1.0, stops: Some((f64::NEG_INFINITY, 3.0)), ..ValveModel::default() };
        let u = [0.0, 1.0, 3.0, 5.0, 4.0, 2.0, 1.6, 1.4, 1.0];
        assert_eq!(
            run(valve, &u, Start { index: 0, is_max: true }).0,
            [-0.5, 0.5, 2.5, 3.0, 3.0, 3.0, 3.0, 1.9, 1.5]
        );
    }

    #[test]
    fn the_largest_reversal_ends_the_search() {
        let u = [0.0, 3.0, 1.0, 4.0, 1.5, 2.0];
        assert_eq!(largest_reversal(&u, MAX_AT_1), 1.25);
        assert_eq!(largest_reversal(&u, Start { index: 2, is_max: false }), 1.5);
        assert_eq!(largest_reversal(&u, Start { index: 9, is_max: true }), 0.0);
    }

    #[test]
    fn the_largest_move_is_that_of_either_direction() {
        // From a maximum OP falls by 3, then rises by 10.
        let u = [0.0, 5.0, 2.0, 12.0, 11.0];
        assert_eq!((largest_reversal(&u, MAX_AT_1), largest_move(&u, 1)), (1.5, 5.0));
        assert_eq!(largest_move(&u.map(|u| -u), 1), 5.0);
        assert_eq!(largest_move(&u, 9), 0.0);
    }

    /// The element as the paper's figure 3 states it.
    fn paper(u: &[f64], f: f64, start: Start) -> Vec<f64> {
        let mut x = u.to_vec();
        let mut residual = if start.is_max { f } else { -f };
        for k in start.index + 1..u.len() {
            let cum = residual + (u[k] - u[k - 1]);
            if cum.abs() > f {
                x[k] = u[k];
                residual = cum.signum() * f;
            } else {
                x[k] = x[k - 1];
                residual = cum;
            }
        }
        x
    }

    proptest! {
        // Steps of 1/8 keep both statements exact in floating point, so they must agree to the bit.
        #[test]
        fn agrees_with_the_paper(steps in prop::collection::vec(-16i32..=16, 2..200), f in 1i32..40, max: bool) {
            let u: Vec<f64> = steps.iter().scan(0, |s, d| { *s += d; Some(f64::from(*s) / 8.0) }).collect();
            let (start, f) = (Start { index: 0, is_max: max }, f64::from(f) / 8.0);
            prop_assert_eq!(run(ValveModel::one_parameter(f), &u, start).0, paper(&u, f, start));
        }
    }
}
