//! [`LANES`] valves side by side over one OP: the batch form of [`ValveModel::run`].

use super::{Start, StopRule, ValveModel, growth};
use multiversion::multiversion;

/// Valves that go side by side.
pub const LANES: usize = 8;
/// A number of each of them.
pub type Lane = [f64; LANES];

/// A number of each valve. It takes the place of `array::from_fn`, of which the compiler makes a call within the loop.
#[inline(always)]
fn each(mut number: impl FnMut(usize) -> f64) -> Lane {
    let mut all = [0.0; LANES];
    for (l, own) in all.iter_mut().enumerate() {
        *own = number(l);
    }
    all
}

/// Valves on their way through OP.
pub struct Batch {
    start: Start,
    span: usize,
    drift: Lane,
    lag: Lane,
    beyond: Lane,
    /// OP has to be so far ahead after a sample at which the stem moved, and rested.
    ahead_after: [Lane; 2],
    ahead: Lane,
    band: Lane,
    asymmetry: Lane,
    limits: [Lane; 2],
    direction: Lane,
    position: Lane,
    turns: Lane,
}

impl Batch {
    /// Before the first sample.
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

    /// Runs them over all of OP; `x` receives the stems, sample by sample.
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

    /// How often each stem turned.
    pub fn turns(&self) -> Lane {
        self.turns
    }

    /// The samples after the start; without branches, so that it becomes vectors.
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

#[multiversion(targets("x86_64+avx2"))]
fn constant(batch: &mut Batch, from: usize, u: &[f64], x: &mut [Lane]) {
    batch.steps::<true>(from, u, x);
}

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
