//! [`LANES`] valves side by side over one OP: [`ValveModel::run`] in vector registers.
//!
//! It is the recursion of `valve/recursion.rs` without branches; a test compares the two.

use super::model::{Start, StopRule, ValveModel};
use super::recursion::growth;
use multiversion::multiversion;

/// Number of valves that are run side by side.
pub const LANES: usize = 8;
/// One number of each valve.
pub type Lane = [f64; LANES];

/// One number of each valve. It replaces `array::from_fn`, which the compiler does not inline in the loop.
#[inline(always)]
fn each(mut number: impl FnMut(usize) -> f64) -> Lane {
    let mut all = [0.0; LANES];
    for (l, own) in all.iter_mut().enumerate() {
        *own = number(l);
    }
    all
}

/// The parameters and the states of [`LANES`] valves.
pub struct Batch {
    start: Start,
    span: usize,
    drift: Lane,
    /// Kinetic lag `(S - J)/2` (OP unit).
    lag: Lane,
    /// Distance of p beyond OP at the start (OP unit).
    beyond: Lane,
    /// Lead of OP above which the stem goes on, after a sample at which it moved, and after one at which it rested (OP unit).
    ahead_after: [Lane; 2],
    /// That lead at the next sample.
    ahead: Lane,
    /// `S` (OP unit).
    band: Lane,
    asymmetry: Lane,
    /// Least and largest p.
    limits: [Lane; 2],
    /// Direction of the last move, +1 or -1.
    direction: Lane,
    /// `p`: OP at the last move.
    position: Lane,
    /// Number of turns so far.
    turns: Lane,
}

impl Batch {
    /// The valves before the first sample.
    ///
    /// * `span`: number of samples over which the drift is counted.
    pub fn new(valves: &[ValveModel; LANES], start: Start, span: usize) -> Self {
        let of = |number: fn(&ValveModel) -> f64| -> Lane { each(|l| number(&valves[l])) };
        let rested = of(|v| if v.rule == StopRule::Reversal { 0.0 } else { v.j });
        Self {
            start,
            span,
            drift: of(|v| v.drift),
            lag: of(ValveModel::lag),
            beyond: of(|v| v.s * v.rest.beyond),
            ahead_after: [of(|v| if v.rule == StopRule::Slip { v.j } else { v.resolution }), rested],
            ahead: rested,
            band: of(|v| v.s),
            asymmetry: of(|v| v.asymmetry),
            limits: [of(|v| v.limits().0), of(|v| v.limits().1)],
            direction: each(|l| if start.is_max != valves[l].rest.turned { 1.0 } else { -1.0 }),
            position: [0.0; LANES],
            turns: [0.0; LANES],
        }
    }

    /// Runs the valves over all of OP, `u`; `x` receives the positions of their stems at each sample (OP unit).
    pub fn run(&mut self, u: &[f64], x: &mut Vec<Lane>) {
        x.clear();
        x.resize(u.len(), [0.0; LANES]);
        for (k, (&u, x)) in u.iter().zip(x.iter_mut()).enumerate().take(self.start.index + 1) {
            let grown: Lane = each(|l| growth(self.drift[l], k, self.span));
            let there = if k == self.start.index { 1.0 } else { 0.0 };
            self.position = each(|l| u + self.direction[l] * self.beyond[l] * grown[l] * there);
            *x = each(|l| self.position[l] - self.lag[l] * grown[l] * self.direction[l]);
        }
        let from = (self.start.index + 1).min(u.len());
        if self.drift == [0.0; LANES] {
            constant(self, from, &u[from..], &mut x[from..]);
        } else {
            growing(self, from, &u[from..], &mut x[from..]);
        }
    }

    /// The number of turns of each stem in the last [`Batch::run`].
    pub fn turns(&self) -> Lane {
        self.turns
    }

    /// The recursion after the start. It has no branches, so that the compiler makes vector code of it.
    ///
    /// * `CONSTANT`: no valve has a drift.
    /// * `from`: index of the first sample of `u` and `x`.
    #[inline(always)]
    fn steps<const CONSTANT: bool>(&mut self, from: usize, u: &[f64], x: &mut [Lane]) {
        let Self { drift, lag, ahead_after: [moved, rested], band, asymmetry, span, limits, .. } = *self;
        let Self { mut ahead, mut direction, mut position, mut turns, .. } = *self;
        for (k, (&u, x)) in u.iter().zip(x).enumerate() {
            let grown: Lane =
                if CONSTANT { [1.0; LANES] } else { each(|l| growth(drift[l], from + k, span)) };
            let onward: Lane = each(|l| direction[l] * (u - position[l]));
            let turn = |l: usize| -onward[l] > band[l] * grown[l] * (1.0 + asymmetry[l] * direction[l]);
            let goes = |l: usize| turn(l) || onward[l] > ahead[l] * grown[l];
            let after: Lane = each(|l| if goes(l) { moved[l] } else { rested[l] });
            let held: Lane = each(|l| u.max(limits[0][l]).min(limits[1][l]));
            let place: Lane = each(|l| if goes(l) { held[l] } else { position[l] });
            let back: Lane = each(|l| if turn(l) { -direction[l] } else { direction[l] });
            turns = each(|l| turns[l] + if turn(l) { 1.0 } else { 0.0 });
            (ahead, position, direction) = (after, place, back);
            *x = each(|l| position[l] - lag[l] * grown[l] * direction[l]);
        }
        (self.ahead, self.direction, self.position, self.turns) = (ahead, direction, position, turns);
    }
}

/// [`Batch::steps`] for valves without drift.
#[multiversion(targets("x86_64+avx2"))]
fn constant(batch: &mut Batch, from: usize, u: &[f64], x: &mut [Lane]) {
    batch.steps::<true>(from, u, x);
}

/// [`Batch::steps`] for valves with drift.
#[multiversion(targets("x86_64+avx2"))]
fn growing(batch: &mut Batch, from: usize, u: &[f64], x: &mut [Lane]) {
    batch.steps::<false>(from, u, x);
}

#[cfg(test)]
mod tests {
    use super::super::{Rest, reversals};
    use super::*;
    use proptest::prelude::*;

    fn valve() -> impl Strategy<Value = ValveModel> {
        let shares = (0.0..2.0, 0.0..1.0, -0.9..0.9, -0.9..0.9);
        (0.05..3.0, shares, 0usize..3, any::<[bool; 3]>()).prop_map(|(s, (j, beyond, a, d), rule, has)| {
            let rule = StopRule::ALL[rule];
            let given = |has: bool, value: f64| if has { value } else { 0.0 };
            ValveModel {
                s,
                j: j * s,
                rule,
                resolution: if rule == StopRule::Stop { 0.1 * j } else { 0.0 },
                rest: Rest { turned: has[0], beyond },
                asymmetry: given(has[1], a),
                drift: given(has[2], d),
                stops: has[1].then_some((-0.5, 0.4)),
            }
        })
    }

    proptest! {
        #[test]
        fn each_lane_is_the_valve_alone(
            valves in prop::array::uniform8(valve()),
            index in 0usize..40,
            is_max in any::<bool>(),
            phase in 0.0..6.0,
        ) {
            let u: Vec<f64> = (0..200)
                .map(|k| f64::sin(0.21 * f64::from(k) + phase) + 0.5 * (1.3 * f64::from(k * k)).cos())
                .collect();
            let start = Start { index, is_max };
            let mut batch = Batch::new(&valves, start, 150);
            let (mut side_by_side, mut x, mut dir) = (Vec::new(), Vec::new(), Vec::new());
            batch.run(&u, &mut side_by_side);
            for (l, valve) in valves.iter().enumerate() {
                valve.run(&u, start, 150, &mut x, &mut dir);
                let lane: Vec<f64> = side_by_side.iter().map(|x| x[l]).collect();
                // Products in another order.
                prop_assert!(lane.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-12));
                prop_assert_eq!(batch.turns()[l] as usize, reversals(&dir[index..]));
            }
        }
    }
}
