//! Cells of thresholds that have decided alike so far, side by side: the state of the beam search.
//!
//! A stem depends on S and J only through what they are compared with. All thresholds between two comparisons share one
//! stem and are one cell; a comparison that falls inside a cell splits it in two.

use crate::sysid::arx::LAGS_X;
use crate::sysid::valve::{Rest, StopRule, ValveModel};
use std::array::from_fn;

/// Least and largest value of a threshold.
pub type Range = (f64, f64);

/// The middle of a range.
pub fn middle(range: Range) -> f64 {
    0.5 * (range.0 + range.1)
}

/// Samples whose factors of the likelihood share one logarithm, and the largest factor: their product stays finite.
pub const FACTORS: usize = 16;
const MOST_FACTOR: f64 = 1e18;

/// Valves that are searched together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Family {
    /// When the stem rests.
    pub rule: StopRule,
    /// J/S, where it is held; always where stems rest at reversals only, since no comparison tells J then.
    pub ratio: Option<f64>,
    /// See [`ValveModel::resolution`].
    pub resolution: f64,
}

/// Thresholds that have decided alike so far.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Of S and of J.
    pub s: Range,
    /// See `s`.
    pub j: Range,
    /// The part of the range that it began in.
    pub part: usize,
    /// Where the stem was at the start, and the direction it came from.
    pub place: f64,
    /// See `place`.
    pub direction: f64,
    /// Whether it had turned, and how far it was beyond OP where bands are as wide as S and J say.
    pub turned: bool,
    /// See `turned`.
    pub beyond: f64,
}

impl Cell {
    /// The valve in its middle.
    pub fn valve(&self, family: Family) -> ValveModel {
        let s = middle(self.s);
        let j = family.ratio.map_or_else(|| middle(self.j), |ratio| ratio * s);
        let rest = Rest { turned: self.turned, beyond: (self.beyond / s).min(1.0) };
        let Family { rule, resolution, .. } = family;
        ValveModel { s, j, rule, resolution, rest, ..ValveModel::default() }
    }
}

/// A sample of OP, with bands that are `grown` times wider and by `asymmetry` wider downwards.
#[derive(Clone, Copy)]
pub struct Sample {
    /// OP.
    pub u: f64,
    /// Factor on S and J.
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

#[derive(Default)]
struct State {
    position: Vec<f64>,
    direction: Vec<f64>,
    /// 1 where the stem rests, so that J counts.
    rests: Vec<f64>,
}

/// Cells on their way through OP.
pub struct Cells {
    family: Family,
    /// With their thresholds as they are now.
    pub cells: Vec<Cell>,
    /// Losses, but for the factors whose logarithm is not in them yet.
    pub loss: Vec<f64>,
    product: Vec<f64>,
    s: [Vec<f64>; 2],
    j: [Vec<f64>; 2],
    lag: Vec<f64>,
    now: State,
    last: State,
    doubt: Vec<f64>,
    /// Stems as the process sees them at the last samples, that of sample k in row k modulo their number.
    kept: Vec<Vec<f64>>,
}

impl Cells {
    /// At the start; so many `rows` of the past are kept.
    pub fn new(family: Family, cells: Vec<Cell>, rows: usize) -> Self {
        let of = |number: &dyn Fn(&Cell) -> f64| -> Vec<f64> { cells.iter().map(number).collect() };
        let rests = if family.rule == StopRule::Reversal { 0.0 } else { 1.0 };
        // Where stems rest at reversals only, J decides nothing.
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
            doubt: Vec::new(),
            kept: vec![of(&|_| 0.0); rows],
            cells,
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Sample `k`; a cell in which the thresholds decide differently becomes two. `bend`: what the stem meets on its way.
    pub fn step(&mut self, k: usize, sample: Sample, bend: &dyn Fn(usize, &mut [f64])) {
        std::mem::swap(&mut self.now, &mut self.last);
        let n = self.cells.len();
        let Self { family, s, j, lag, now, last, doubt, .. } = self;
        for numbers in [&mut now.position, &mut now.direction, &mut now.rests, &mut *doubt] {
            numbers.resize(n, 0.0);
        }
        let rests = Rests::after(*family);
        advance(sample, [s, j], last, &mut now.position, &mut now.direction, (&mut now.rests, rests), doubt);
        if sample.stops != NO_STOPS {
            for (position, lag) in now.position.iter_mut().zip(&*lag) {
                let beyond = lag.max(0.0);
                *position = position.max(sample.stops.0 - beyond).min(sample.stops.1 + beyond);
            }
        }
        for i in 0..n {
            if self.doubt[i] > 0.0 {
                self.split(i, sample);
            }
        }
        let at = k % self.kept.len();
        let State { position, direction, .. } = &self.now;
        for (((kept, position), lag), direction) in
            self.kept[at].iter_mut().zip(position).zip(&self.lag).zip(direction)
        {
            *kept = position - lag * sample.grown * direction;
        }
        bend(k, &mut self.kept[at]);
    }

    /// One that may go or stay: it goes, with the lower thresholds; another with the higher ones is appended.
    fn split(&mut self, i: usize, Sample { u, grown, asymmetry, .. }: Sample) {
        let (position, direction) = (self.last.position[i], self.last.direction[i]);
        let onward = direction * (u - position);
        let mut stays = self.cells[i];
        let goes = &mut self.cells[i];
        let by_s = if onward <= 0.0 {
            let at = -onward / (grown * (1.0 + asymmetry * direction));
            (goes.s.1, stays.s.0) = (at, at);
            Some(at)
        } else {
            let at = onward / grown;
            (goes.j.1, stays.j.0) = (at, at);
            None
        };
        if let Some(ratio) = self.family.ratio {
            // One threshold decides, whichever it is that was compared.
            let s = by_s.unwrap_or(goes.j.1 / ratio.max(1e-9));
            (goes.s.1, goes.j.1) = (s, ratio * s);
            (stays.s.0, stays.j.0) = (s, ratio * s);
        }
        let (s, j, lag) = (goes.s.1, goes.j.1, goes.valve(self.family).lag());
        self.s[1][i] = s;
        self.lag[i] = lag;
        if self.family.rule != StopRule::Reversal {
            self.j[1][i] = j;
        }
        self.push(i, stays);
        self.now.position.push(position);
        self.now.direction.push(direction);
        self.now.rests.push(Rests::after(self.family).stays);
    }

    /// A cell with the past of cell `i`.
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
        let past = self.kept.iter_mut().chain([&mut self.loss, &mut self.product]);
        past.for_each(|numbers| numbers.push(numbers[i]));
    }

    /// Takes into account that of what is `left` of PV for the stem, `b[j]` times its place at sample `newest - j` is
    /// explained; the loss is `ln(1 + per e^2)`.
    pub fn rate(&mut self, newest: usize, b: &[f64; LAGS_X], left: f64, per: f64) {
        let (n, rows) = (self.cells.len(), self.kept.len());
        let past: [&[f64]; LAGS_X] = from_fn(|j| &self.kept[(newest - j) % rows][..n]);
        rate(&mut self.product[..n], past, b, left, per);
    }

    /// Puts the factors into the losses.
    pub fn count(&mut self) {
        self.loss.iter_mut().zip(&self.product).for_each(|(loss, product)| *loss += product.ln());
        self.product.fill(1.0);
    }

    /// Leaves those that `goes_on` says.
    pub fn retain(&mut self, goes_on: &[bool]) {
        let of = |numbers: &mut Vec<f64>| {
            let mut all = goes_on.iter();
            numbers.retain(|_| all.next().is_none_or(|goes_on| *goes_on));
        };
        let mut all = goes_on.iter();
        self.cells.retain(|_| all.next().is_none_or(|goes_on| *goes_on));
        let State { position, direction, rests } = &mut self.now;
        let thresholds = self.s.iter_mut().chain(&mut self.j).chain([&mut self.lag]);
        let numbers = thresholds.chain([position, direction, rests, &mut self.loss, &mut self.product]);
        numbers.chain(&mut self.kept).for_each(of);
    }
}

/// One factor more for each cell.
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

/// Whether a stem rests after a sample at which it went, and stayed.
#[derive(Clone, Copy)]
struct Rests {
    goes: f64,
    stays: f64,
    /// How far OP goes on at least where the stem does not rest.
    resolution: f64,
}

impl Rests {
    fn after(Family { rule, resolution, .. }: Family) -> Self {
        let is = |rests: bool| if rests { 1.0 } else { 0.0 };
        Self { goes: is(rule == StopRule::Slip), stays: is(rule != StopRule::Reversal), resolution }
    }
}

/// Where each stem goes, one that may go or stay on; `doubt` is 1 for those. Without branches: it becomes vectors.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn advance(
    Sample { u, grown, asymmetry, .. }: Sample,
    [s, j]: [&[Vec<f64>; 2]; 2],
    last: &State,
    position: &mut [f64],
    direction: &mut [f64],
    (rests, after): (&mut [f64], Rests),
    doubt: &mut [f64],
) {
    let n = position.len();
    let [[s0, s1], [j0, j1]] = [s, j].map(|range| [&range[0][..n], &range[1][..n]]);
    let (was, came, rested) = (&last.position[..n], &last.direction[..n], &last.rests[..n]);
    let (direction, rests, doubt) = (&mut direction[..n], &mut rests[..n], &mut doubt[..n]);
    let one = |is: bool| if is { 1.0 } else { 0.0 };
    for i in 0..n {
        let onward = came[i] * (u - was[i]);
        let (back, ahead) = (grown * (1.0 + asymmetry * came[i]), grown * rested[i]);
        let least = grown * (1.0 - rested[i]) * after.resolution;
        let turns = one(-onward > s0[i] * back);
        let goes = turns + one(onward > j0[i] * ahead + least);
        doubt[i] = goes - one(-onward > s1[i] * back) - one(onward > j1[i] * ahead + least);
        position[i] = if goes > 0.0 { u } else { was[i] };
        direction[i] = came[i] - 2.0 * turns * came[i];
        rests[i] = after.stays + goes * (after.goes - after.stays);
    }
}
