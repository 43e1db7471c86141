//! Cells of thresholds (S, J) with the same stem so far, side by side: the state of the beam search.
//!
//! A stem depends on S and J only through comparisons: it reverses where OP has come back by more than S, and goes on where OP is
//! ahead by more than J. All thresholds for which every comparison so far had the same result share one stem, and are one cell.
//! Where a comparison falls inside the range of a cell, the cell is split in two: below, the stem moves; above, it stays.

use crate::sysid::arx::LAGS_X;
use crate::sysid::valve::{Rest, StopRule, ValveModel};
use std::array::from_fn;

/// Least and largest value of a threshold.
pub type Range = (f64, f64);

/// The middle of a range.
pub fn middle(range: Range) -> f64 {
    0.5 * (range.0 + range.1)
}

/// Factors of the likelihood that are multiplied before one logarithm is taken, for speed.
pub const FACTORS: usize = 16;
/// Largest factor: the product of sixteen stays finite.
const MOST_FACTOR: f64 = 1e18;

/// The valves of one stop rule, with J/S fixed or free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Family {
    /// When the stem rests.
    pub rule: StopRule,
    /// J/S where it is fixed (-). It is always fixed where stems rest at reversals only: no comparison has J in it then.
    pub ratio: Option<f64>,
    /// See [`ValveModel::resolution`].
    pub resolution: f64,
}

/// A rectangle of thresholds with one stem so far.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Range of S (standard deviations of OP).
    pub s: Range,
    /// Range of J (standard deviations of OP).
    pub j: Range,
    /// Number of the part of the (S, J) plane that it began in.
    pub part: usize,
    /// Position of the stem at the start (standard deviations of OP).
    pub place: f64,
    /// Direction of its last move then, +1 or -1.
    pub direction: f64,
    /// See [`Rest::turned`].
    pub turned: bool,
    /// How far the stem was beyond OP at the start, for bands S and J without drift (standard deviations of OP).
    pub beyond: f64,
}

impl Cell {
    /// The valve in the middle of the cell.
    pub fn valve(&self, family: Family) -> ValveModel {
        let s = middle(self.s);
        let j = family.ratio.map_or_else(|| middle(self.j), |ratio| ratio * s);
        let rest = Rest { turned: self.turned, beyond: (self.beyond / s).min(1.0) };
        let Family { rule, resolution, .. } = family;
        ValveModel { s, j, rule, resolution, rest, ..ValveModel::default() }
    }
}

/// A sample of OP, with the bands of all valves at that sample.
#[derive(Clone, Copy)]
pub struct Sample {
    /// OP (standard deviations).
    pub u: f64,
    /// Factor on S and J by the drift of friction (-).
    pub grown: f64,
    /// See [`ValveModel::asymmetry`].
    pub asymmetry: f64,
    /// Mechanical stops of the stem; infinite where there are none.
    pub stops: (f64, f64),
}

/// A stem without stops.
const NO_STOPS: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

/// The stops of a valve.
pub fn stops(valve: &ValveModel) -> (f64, f64) {
    valve.stops.unwrap_or(NO_STOPS)
}

/// The stems of all cells at one sample.
#[derive(Default)]
struct State {
    /// OP at the last move.
    position: Vec<f64>,
    /// Direction of the last move, +1 or -1.
    direction: Vec<f64>,
    /// 1 where the stem rests, so that it goes on only beyond J; else 0.
    rests: Vec<f64>,
}

/// The cells of a family, with their stems and losses.
pub struct Cells {
    family: Family,
    /// The cells.
    pub cells: Vec<Cell>,
    /// Losses, without the factors in `product`.
    pub loss: Vec<f64>,
    /// Product of the factors whose logarithm is not in `loss` yet.
    product: Vec<f64>,
    /// Least and largest S of each cell, as its comparisons use it.
    s: [Vec<f64>; 2],
    /// Least and largest J likewise.
    j: [Vec<f64>; 2],
    /// Kinetic lag `(S - J)/2` of each cell's middle.
    lag: Vec<f64>,
    /// The stems at the present sample.
    now: State,
    /// The stems at the sample before.
    last: State,
    /// 1 where the thresholds of a cell decide differently, so that it is split; else 0.
    splits: Vec<f64>,
    /// The stems at the last samples as the process sees them: sample k is in row k modulo their number.
    past: Vec<Vec<f64>>,
}

impl Cells {
    /// The cells at the start. `rows`: number of past samples whose stems are kept.
    pub fn new(family: Family, cells: Vec<Cell>, rows: usize) -> Self {
        let of = |number: &dyn Fn(&Cell) -> f64| -> Vec<f64> { cells.iter().map(number).collect() };
        let rests = if family.rule == StopRule::Reversal { 0.0 } else { 1.0 };
        // Where stems rest at reversals only, no comparison has J in it.
        let j = |of_j: fn(&Cell) -> f64| if rests > 0.0 { of(&of_j) } else { of(&|_| 0.0) };
        Self {
            family,
            loss: of(&|_| 0.0),
            product: of(&|_| 1.0),
            s: [of(&|cell| cell.s.0), of(&|cell| cell.s.1)],
            j: [j(|cell| cell.j.0), j(|cell| cell.j.1)],
            lag: of(&|cell| cell.valve(family).lag()),
            now: State {
                position: of(&|cell| cell.place),
                direction: of(&|cell| cell.direction),
                rests: of(&|_| rests),
            },
            last: State::default(),
            splits: Vec::new(),
            past: vec![of(&|_| 0.0); rows],
            cells,
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Moves every stem by sample `k` of OP, and splits the cells whose thresholds decide differently. `map_stem`: what the effects
    /// make of stem positions on their way to the process.
    pub fn step(&mut self, k: usize, sample: Sample, map_stem: &dyn Fn(usize, &mut [f64])) {
        std::mem::swap(&mut self.now, &mut self.last);
        let n = self.cells.len();
        let Self { family, s, j, lag, now, last, splits, .. } = self;
        for numbers in [&mut now.position, &mut now.direction, &mut now.rests, &mut *splits] {
            numbers.resize(n, 0.0);
        }
        let rests = RestRule::of(*family);
        advance(sample, [s, j], last, &mut now.position, &mut now.direction, (&mut now.rests, rests), splits);
        if sample.stops != NO_STOPS {
            for (position, lag) in now.position.iter_mut().zip(&*lag) {
                let beyond = lag.max(0.0);
                *position = position.max(sample.stops.0 - beyond).min(sample.stops.1 + beyond);
            }
        }
        for i in 0..n {
            if self.splits[i] > 0.0 {
                self.split(i, sample);
            }
        }
        let at = k % self.past.len();
        let State { position, direction, .. } = &self.now;
        for (((past, position), lag), direction) in
            self.past[at].iter_mut().zip(position).zip(&self.lag).zip(direction)
        {
            *past = position - lag * sample.grown * direction;
        }
        map_stem(k, &mut self.past[at]);
    }

    /// Splits cell `i`, whose stem was moved: it keeps the lower thresholds. A cell with the higher thresholds, whose stem stays, is
    /// appended.
    fn split(&mut self, i: usize, Sample { u, grown, asymmetry, .. }: Sample) {
        let (position, direction) = (self.last.position[i], self.last.direction[i]);
        let onward = direction * (u - position);
        let mut stays = self.cells[i];
        let moves = &mut self.cells[i];
        let by_s = if onward <= 0.0 {
            let at = -onward / (grown * (1.0 + asymmetry * direction));
            (moves.s.1, stays.s.0) = (at, at);
            Some(at)
        } else {
            let at = onward / grown;
            (moves.j.1, stays.j.0) = (at, at);
            None
        };
        if let Some(ratio) = self.family.ratio {
            // J is a fixed share of S: a comparison with either splits both.
            let s = by_s.unwrap_or(moves.j.1 / ratio.max(1e-9));
            (moves.s.1, moves.j.1) = (s, ratio * s);
            (stays.s.0, stays.j.0) = (s, ratio * s);
        }
        let (s, j, lag) = (moves.s.1, moves.j.1, moves.valve(self.family).lag());
        self.s[1][i] = s;
        self.lag[i] = lag;
        if self.family.rule != StopRule::Reversal {
            self.j[1][i] = j;
        }
        self.push(i, stays);
        self.now.position.push(position);
        self.now.direction.push(direction);
        self.now.rests.push(RestRule::of(self.family).if_stays);
    }

    /// Appends a cell with the loss and the past stems of cell `i`.
    fn push(&mut self, i: usize, cell: Cell) {
        self.cells.push(cell);
        let resting = self.family.rule != StopRule::Reversal;
        for (bounds, range) in
            [(&mut self.s, cell.s), (&mut self.j, if resting { cell.j } else { (0.0, 0.0) })]
        {
            bounds[0].push(range.0);
            bounds[1].push(range.1);
        }
        self.lag.push(cell.valve(self.family).lag());
        let past = self.past.iter_mut().chain([&mut self.loss, &mut self.product]);
        past.for_each(|numbers| numbers.push(numbers[i]));
    }

    /// Adds the loss `ln(1 + per e^2)` of one row to every cell, with the error `e = left - sum over j of b[j] x[newest - j]`.
    ///
    /// * `newest`: the latest sample of the stem in the sum.
    /// * `left`: PV less everything but the stem.
    /// * `per`: `1/(nu s^2)`.
    pub fn rate(&mut self, newest: usize, b: &[f64; LAGS_X], left: f64, per: f64) {
        let (n, rows) = (self.cells.len(), self.past.len());
        let past: [&[f64]; LAGS_X] = from_fn(|j| &self.past[(newest - j) % rows][..n]);
        rate(&mut self.product[..n], past, b, left, per);
    }

    /// Adds the logarithms of the products to the losses.
    pub fn take_logarithms(&mut self) {
        self.loss.iter_mut().zip(&self.product).for_each(|(loss, product)| *loss += product.ln());
        self.product.fill(1.0);
    }

    /// Drops the cells that do not survive.
    pub fn retain(&mut self, survives: &[bool]) {
        let survivors: Vec<usize> = (0..survives.len()).filter(|at| survives[*at]).collect();
        keep(&mut self.cells, &survivors);
        let State { position, direction, rests } = &mut self.now;
        let thresholds = self.s.iter_mut().chain(&mut self.j).chain([&mut self.lag]);
        let numbers = thresholds.chain([position, direction, rests, &mut self.loss, &mut self.product]);
        numbers.chain(&mut self.past).for_each(|numbers| keep(numbers, &survivors));
    }
}

/// Keeps the values at `survivors`, which are in ascending order.
fn keep<T: Copy>(values: &mut Vec<T>, survivors: &[usize]) {
    for (to, from) in survivors.iter().enumerate() {
        values[to] = values[*from];
    }
    values.truncate(survivors.len());
}

/// Multiplies the product of each cell by one factor, `1 + per e^2`.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn rate(product: &mut [f64], past: [&[f64]; LAGS_X], b: &[f64; LAGS_X], left: f64, per: f64) {
    let n = product.len();
    let past = past.map(|past| &past[..n]);
    for i in 0..n {
        let mut e = left;
        for j in 0..LAGS_X {
            e -= b[j] * past[j][i];
        }
        let factor = per * e * e;
        product[i] *= 1.0 + if factor < MOST_FACTOR { factor } else { MOST_FACTOR };
    }
}

/// Whether a stem rests after a sample, by its stop rule: 1 where it rests, else 0.
#[derive(Clone, Copy)]
struct RestRule {
    /// Where it moved at that sample.
    if_moves: f64,
    /// Where it stayed.
    if_stays: f64,
    /// See [`ValveModel::resolution`].
    resolution: f64,
}

impl RestRule {
    fn of(Family { rule, resolution, .. }: Family) -> Self {
        let is = |rests: bool| if rests { 1.0 } else { 0.0 };
        Self { if_moves: is(rule == StopRule::Slip), if_stays: is(rule != StopRule::Reversal), resolution }
    }
}

/// The position, direction and rest of each stem after a sample of OP. A stem moves where the least thresholds of its cell let it
/// move; `splits` is 1 where the largest would not. It has no branches, so that it compiles to vector instructions.
///
/// * `s`, `j`: least and largest thresholds of each cell.
/// * `last`: the stems at the sample before.
/// * `after`: whether stems rest after this sample.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn advance(
    Sample { u, grown, asymmetry, .. }: Sample,
    [s, j]: [&[Vec<f64>; 2]; 2],
    last: &State,
    position: &mut [f64],
    direction: &mut [f64],
    (rests, after): (&mut [f64], RestRule),
    splits: &mut [f64],
) {
    let n = position.len();
    let [[s0, s1], [j0, j1]] = [s, j].map(|range| [&range[0][..n], &range[1][..n]]);
    let (was, came, rested) = (&last.position[..n], &last.direction[..n], &last.rests[..n]);
    let (direction, rests, splits) = (&mut direction[..n], &mut rests[..n], &mut splits[..n]);
    let one = |is: bool| if is { 1.0 } else { 0.0 };
    for i in 0..n {
        let onward = came[i] * (u - was[i]);
        let (back, ahead) = (grown * (1.0 + asymmetry * came[i]), grown * rested[i]);
        let least = grown * (1.0 - rested[i]) * after.resolution;
        let turns = one(-onward > s0[i] * back);
        let moves = turns + one(onward > j0[i] * ahead + least);
        splits[i] = moves - one(-onward > s1[i] * back) - one(onward > j1[i] * ahead + least);
        position[i] = if moves > 0.0 { u } else { was[i] };
        direction[i] = came[i] - 2.0 * turns * came[i];
        rests[i] = after.if_stays + moves * (after.if_moves - after.if_stays);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_values_that_survive_are_those_that_a_filter_keeps(survives in prop::collection::vec(any::<bool>(), 0..80)) {
            let survivors: Vec<usize> = (0..survives.len()).filter(|at| survives[*at]).collect();
            let mut values: Vec<f64> = (0..survives.len()).map(|at| 0.1 * at as f64).collect();
            let plain: Vec<f64> = values.iter().zip(&survives).filter(|own| *own.1).map(|own| *own.0).collect();
            keep(&mut values, &survivors);
            prop_assert_eq!(values, plain);
        }
    }

    #[test]
    fn every_number_of_a_cell_goes_with_it() {
        let family = Family { rule: StopRule::Stop, ratio: None, resolution: 0.0 };
        let cell = |i: usize| {
            let by = 0.1 * i as f64;
            let (s, j) = ((1.0 + by, 1.05 + by), (0.3 + by, 0.4 + by));
            let direction = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
            Cell { s, j, part: i, place: by, direction, turned: false, beyond: 0.0 }
        };
        let cells =
            |which: &[usize]| Cells::new(family, which.iter().map(|i| cell(*i)).collect(), LAGS_X + 1);
        let run = |cells: &mut Cells, from: usize, to: usize| {
            for k in from..to {
                let u = 2.0 * (0.3 * k as f64).sin();
                cells.step(k, Sample { u, grown: 1.0, asymmetry: 0.1, stops: NO_STOPS }, &|_, _| ());
                cells.rate(k.max(LAGS_X), &[0.05; LAGS_X], u, 0.7);
            }
        };
        let (mut all, mut few) = (cells(&[0, 1, 2, 3, 4, 5]), cells(&[1, 4]));
        run(&mut all, 0, 40);
        run(&mut few, 0, 40);
        let survives: Vec<bool> = all.cells.iter().map(|cell| [1, 4].contains(&cell.part)).collect();
        all.retain(&survives);
        run(&mut all, 40, 90);
        run(&mut few, 40, 90);
        let told = |cells: &mut Cells| {
            cells.take_logarithms();
            let own = cells.cells.iter().zip(&cells.loss).map(|(cell, loss)| format!("{cell:?} {loss:?}"));
            let mut own: Vec<String> = own.collect();
            own.sort();
            own
        };
        let (all, few) = (told(&mut all), told(&mut few));
        assert!(few.len() > 2, "some cells are split");
        assert_eq!(all, few);
    }
}
