//! Friction elements run side by side: one alone waits for its own last position at every sample.

use super::model::Element;
use crate::diagnosis::friction::Start;
use multiversion::multiversion;
use std::array::from_fn;

/// Elements side by side. An element without friction must not be among them.
pub const LANES: usize = 8;
/// A number of each.
pub type Lane = [f64; LANES];

/// Elements on their way through OP; what [`Element::run`] computes, lane by lane.
pub struct Run {
    start: Start,
    from: usize,
    rate: f64,
    at: usize,
    growth: Lane,
    lag: Lane,
    rest: Lane,
    /// Distance to OP beyond which the stem goes on: after a move, after none, and now.
    moving: Lane,
    resting: Lane,
    ahead: Lane,
    /// Distance beyond which it turns: now, and after the next turn.
    behind: Lane,
    other: Lane,
    direction: Lane,
    stem: Lane,
    turns: Lane,
}

impl Run {
    /// From the first sample on; turns are counted within the samples after `from`, friction grows over `span` samples.
    pub fn new(elements: &[Element; LANES], start: Start, from: usize, span: usize) -> Self {
        let of = |number: fn(&Element) -> f64| -> Lane { from_fn(|l| number(&elements[l])) };
        let direction = from_fn(|l| if start.is_max != elements[l].turned { 1.0 } else { -1.0 });
        let resting = of(|e| 2.0 * e.f * e.resume);
        Self {
            start,
            from,
            rate: 2.0 / span as f64,
            at: 0,
            growth: of(|e| e.growth),
            lag: of(|e| e.lag * e.f),
            rest: of(|e| 2.0 * e.f * e.rest),
            moving: of(|e| if e.slips { 2.0 * e.f * e.resume } else { 0.0 }),
            resting,
            ahead: resting,
            behind: from_fn(|l| 2.0 * elements[l].f * (1.0 + elements[l].skew * direction[l])),
            other: from_fn(|l| 2.0 * elements[l].f * (1.0 - elements[l].skew * direction[l])),
            direction,
            stem: [0.0; LANES],
            turns: [0.0; LANES],
        }
    }

    /// Writes the stems, kinetic lag included, up to sample `to`.
    pub fn go_on(&mut self, u: &[f64], to: usize, z: &mut [Lane]) {
        while self.at < to && self.at <= self.start.index {
            z[self.at] = self.lie(u[self.at]);
            self.at += 1;
        }
        for end in [to.min(self.from + 1), to] {
            if self.at < end {
                let constant = self.growth == [0.0; LANES] && self.behind == self.other;
                let (u, z) = (&u[self.at..end], &mut z[self.at..end]);
                if constant { slide_constant(self, u, z) } else { slide_any(self, u, z) }
            }
            if self.at <= self.from + 1 {
                self.turns = [0.0; LANES];
            }
        }
    }

    /// How often each stem has turned.
    pub fn turns(&self) -> Lane {
        self.turns
    }

    /// Up to the start the stem follows OP; there it lies beyond it.
    fn lie(&mut self, op: f64) -> Lane {
        let grown = self.grown(self.at);
        let there = if self.at == self.start.index { 1.0 } else { 0.0 };
        self.stem = from_fn(|l| op + self.direction[l] * self.rest[l] * grown[l] * there);
        from_fn(|l| self.stem[l] - self.lag[l] * grown[l] * self.direction[l])
    }

    /// f at a sample, as a share.
    fn grown(&self, at: usize) -> Lane {
        let progress = (at as f64 * self.rate).min(3.0) - 1.0;
        self.growth.map(|growth| (1.0 + growth * progress).max(0.0))
    }

    /// `CONSTANT`: one band for all time and both directions. One choice at a time, so that each becomes a blend of vectors: a
    /// sample waits for the stem's last place, and every step on the way from there counts.
    #[inline(always)]
    fn slide<const CONSTANT: bool>(&mut self, u: &[f64], z: &mut [Lane]) {
        let Self { lag, moving, resting, at, .. } = *self;
        let Self { mut ahead, mut behind, mut other, mut direction, mut stem, mut turns, .. } = *self;
        for (k, (&op, position)) in u.iter().zip(z).enumerate() {
            let grown = if CONSTANT { [1.0; LANES] } else { self.grown(at + k) };
            let onward: Lane = from_fn(|l| direction[l] * (op - stem[l]));
            let turn = |l: usize| -onward[l] > behind[l] * grown[l];
            let go = |l: usize| onward[l] > ahead[l] * grown[l];
            let turned: Lane = from_fn(|l| if turn(l) { op } else { stem[l] });
            let next: Lane = from_fn(|l| if turn(l) { moving[l] } else { resting[l] });
            let back: Lane = from_fn(|l| if turn(l) { -direction[l] } else { direction[l] });
            turns = from_fn(|l| turns[l] + if turn(l) { 1.0 } else { 0.0 });
            stem = from_fn(|l| if go(l) { op } else { turned[l] });
            let then: Lane = from_fn(|l| if go(l) { moving[l] } else { next[l] });
            if !CONSTANT {
                let swapped: [Lane; 2] = [
                    from_fn(|l| if turn(l) { other[l] } else { behind[l] }),
                    from_fn(|l| if turn(l) { behind[l] } else { other[l] }),
                ];
                [behind, other] = swapped;
            }
            (ahead, direction) = (then, back);
            *position = from_fn(|l| stem[l] - lag[l] * grown[l] * direction[l]);
        }
        (self.ahead, self.behind, self.other) = (ahead, behind, other);
        (self.direction, self.stem, self.turns) = (direction, stem, turns);
        self.at += u.len();
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn slide_constant(run: &mut Run, u: &[f64], z: &mut [Lane]) {
    run.slide::<true>(u, z);
}

#[multiversion(targets("x86_64+avx2"))]
fn slide_any(run: &mut Run, u: &[f64], z: &mut [Lane]) {
    run.slide::<false>(u, z);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::friction::reversals;
    use proptest::prelude::*;

    fn element() -> impl Strategy<Value = Element> {
        let shares = (-1.0..1.0, 0.0..2.0, 0.0..1.0, -0.9..0.9, -0.9..0.9);
        (0.05..1.5, shares, any::<[bool; 5]>()).prop_map(|(f, (lag, resume, rest, skew, growth), has)| {
            let given = |has: bool, value: f64| if has { value } else { 0.0 };
            Element {
                f,
                lag,
                resume: given(has[0], resume),
                slips: has[1],
                turned: has[2],
                rest,
                skew: given(has[3], skew),
                growth: given(has[4], growth),
            }
        })
    }

    proptest! {
        #[test]
        fn each_lane_is_the_element_alone(
            elements in prop::array::uniform8(element()),
            index in 0usize..40,
            is_max in any::<bool>(),
            phase in 0.0..6.0,
        ) {
            let u: Vec<f64> = (0..200)
                .map(|k| f64::sin(0.21 * f64::from(k) + phase) + 0.5 * (1.3 * f64::from(k * k)).cos())
                .collect();
            let start = Start { index, is_max };
            let mut run = Run::new(&elements, start, 20, 150);
            let mut side_by_side = vec![[0.0; LANES]; u.len()];
            for to in [1, 30, 31, 170, 200] {
                run.go_on(&u, to, &mut side_by_side);
            }
            let (mut z, mut dir) = (Vec::new(), Vec::new());
            for (l, element) in elements.iter().enumerate() {
                element.run(&u, start, 150, &mut z, &mut dir);
                let lane: Vec<f64> = side_by_side.iter().map(|z| z[l]).collect();
                // Products in another order.
                prop_assert!(lane.iter().zip(&z).all(|(a, b)| (a - b).abs() < 1e-12));
                prop_assert_eq!(run.turns()[l] as usize, reversals(&dir[20..]));
            }
        }
    }
}
