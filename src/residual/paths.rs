//! The stems of many cells of thresholds side by side, number by number: a sample is a few passes over vectors.

use super::cells::Family;
use super::search::{LAGS, MOST_FACTOR};
use std::array::from_fn;

/// Least and largest value of a threshold.
pub type Range = (f64, f64);

pub fn middle(range: Range) -> f64 {
    0.5 * (range.0 + range.1)
}

/// Thresholds that have decided alike so far, and where their stem was at the start.
#[derive(Clone, Copy)]
pub struct Cell {
    /// Those of a turn, and of going on after a stop.
    pub s: Range,
    pub j: Range,
    /// The part of the thresholds' range that it began in.
    pub part: usize,
    /// The stem's place at the start, the direction it came from, and whether that is not OP's.
    pub place: f64,
    pub direction: f64,
    pub turned: bool,
}

impl Cell {
    /// Kinetic lag of the valve in its middle.
    pub fn lag(&self, family: Family) -> f64 {
        match family {
            Family::Plain(share) => 0.5 * share * middle(self.s),
            _ => 0.5 * (middle(self.s) - middle(self.j)).max(0.0),
        }
    }
}

/// Numbers of each stem that change at every sample.
#[derive(Default)]
struct State {
    stem: Vec<f64>,
    direction: Vec<f64>,
    /// 0 where the last sample moved it so that it follows OP on, else 1.
    still: Vec<f64>,
}

/// A sample of OP, with the bands there are `grown` times wider and those to turn by `skew` wider downwards.
#[derive(Clone, Copy)]
pub struct Sample {
    pub op: f64,
    pub grown: f64,
    pub skew: f64,
}

/// Cells on their way through OP.
pub struct Paths {
    family: Family,
    /// With the thresholds as they are now.
    pub cells: Vec<Cell>,
    /// Losses, but for the factors whose logarithm is not in them yet.
    pub loss: Vec<f64>,
    product: Vec<f64>,
    /// The cells' thresholds, the least and the largest, and lags.
    s: [Vec<f64>; 2],
    j: [Vec<f64>; 2],
    lag: Vec<f64>,
    now: State,
    /// Before the sample there is.
    last: State,
    /// 1 where the thresholds decided differently.
    doubt: Vec<f64>,
    /// Stems with the kinetic lag they had then at the last samples, that of sample k in row k modulo their number.
    kept: Vec<Vec<f64>>,
}

impl Paths {
    /// At the start; so many `rows` of the past are kept, and none is rated before they are full.
    pub fn new(family: Family, cells: Vec<Cell>, rows: usize) -> Self {
        let of = |number: &dyn Fn(&Cell) -> f64| -> Vec<f64> { cells.iter().map(number).collect() };
        let still = Still::after(family).stays;
        Self {
            family,
            loss: of(&|_| 0.0),
            product: of(&|_| 1.0),
            s: [of(&|cell| cell.s.0), of(&|cell| cell.s.1)],
            j: [of(&|cell| cell.j.0), of(&|cell| cell.j.1)],
            lag: of(&|cell| cell.lag(family)),
            now: State {
                stem: of(&|cell| cell.place),
                direction: of(&|cell| cell.direction),
                still: of(&|_| still),
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

    /// Sample `k`; a cell in which the thresholds decide differently becomes two.
    pub fn step(&mut self, k: usize, sample: Sample) {
        std::mem::swap(&mut self.now, &mut self.last);
        let n = self.cells.len();
        let Self { family, s, j, now, last, doubt, .. } = self;
        for numbers in [&mut now.stem, &mut now.direction, &mut now.still, &mut *doubt] {
            numbers.resize(n, 0.0);
        }
        let still = Still::after(*family);
        go(sample, [s, j], last, &mut now.stem, &mut now.direction, (&mut now.still, still), doubt);
        for i in 0..n {
            if self.doubt[i] > 0.0 {
                self.split(i, sample);
            }
        }
        let at = k % self.kept.len();
        let State { stem, direction, .. } = &self.now;
        for (((kept, stem), lag), direction) in
            self.kept[at].iter_mut().zip(stem).zip(&self.lag).zip(direction)
        {
            *kept = stem - lag * sample.grown * direction;
        }
    }

    /// One that may go or stay: it goes, with the lower thresholds, another with the higher ones is appended.
    fn split(&mut self, i: usize, Sample { op, grown, skew }: Sample) {
        let (stem, direction) = (self.last.stem[i], self.last.direction[i]);
        let onward = direction * (op - stem);
        let mut stays = self.cells[i];
        let goes = &mut self.cells[i];
        if onward <= 0.0 {
            let at = -onward / (grown * (1.0 + skew * direction));
            (goes.s.1, stays.s.0) = (at, at);
        } else {
            let at = onward / grown;
            (goes.j.1, stays.j.0) = (at, at);
        }
        if self.family == Family::Jumps {
            // Whichever way: the threshold is one.
            let at = if onward <= 0.0 { goes.s.1 } else { goes.j.1 };
            (goes.s.1, goes.j.1, stays.s.0, stays.j.0) = (at, at, at, at);
        }
        (self.s[1][i], self.j[1][i], self.lag[i]) = (goes.s.1, goes.j.1, goes.lag(self.family));
        // A stop is not left with more force than a turn takes.
        if stays.j.0 < stays.s.1 {
            self.push(i, stays);
            self.now.stem.push(stem);
            self.now.direction.push(direction);
            self.now.still.push(Still::after(self.family).stays);
        }
    }

    /// A cell with the past of cell `i`.
    fn push(&mut self, i: usize, cell: Cell) {
        self.cells.push(cell);
        for (bounds, range) in [(&mut self.s, cell.s), (&mut self.j, cell.j)] {
            bounds[0].push(range.0);
            bounds[1].push(range.1);
        }
        self.lag.push(cell.lag(self.family));
        let past = self.kept.iter_mut().chain([&mut self.loss, &mut self.product]);
        past.for_each(|numbers| numbers.push(numbers[i]));
    }

    /// Takes into account that of what is `left` of PV for the stem to explain `b[j]` comes from its place at sample `newest - j`;
    /// the loss is `ln(1 + per e^2)`.
    pub fn rate(&mut self, newest: usize, b: &[f64; LAGS.1], left: f64, per: f64) {
        let (n, rows) = (self.cells.len(), self.kept.len());
        let past: [&[f64]; LAGS.1] = from_fn(|j| &self.kept[(newest - j) % rows][..n]);
        let product = &mut self.product[..n];
        for i in 0..n {
            let mut e = left;
            for j in 0..LAGS.1 {
                e -= b[j] * past[j][i];
            }
            let factor = per * e * e;
            product[i] *= 1.0 + if factor < MOST_FACTOR { factor } else { MOST_FACTOR };
        }
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
        let State { stem, direction, still } = &mut self.now;
        let thresholds = self.s.iter_mut().chain(&mut self.j).chain([&mut self.lag]);
        let numbers = thresholds.chain([stem, direction, still, &mut self.loss, &mut self.product]);
        numbers.chain(&mut self.kept).for_each(of);
    }
}

/// [`State::still`] after a sample at which the stem went, and stayed.
#[derive(Clone, Copy)]
struct Still {
    goes: f64,
    stays: f64,
}

impl Still {
    fn after(family: Family) -> Self {
        match family {
            Family::Plain(_) => Self { goes: 0.0, stays: 0.0 },
            Family::Sticks => Self { goes: 0.0, stays: 1.0 },
            Family::Slips | Family::Jumps => Self { goes: 1.0, stays: 1.0 },
        }
    }
}

/// Where each stem goes, one that may go or stay on; `doubt` is 1 for those. Not inlined and without branches: it becomes vectors.
#[inline(never)]
fn go(
    Sample { op, grown, skew }: Sample,
    [s, j]: [&[Vec<f64>; 2]; 2],
    last: &State,
    stem: &mut [f64],
    direction: &mut [f64],
    (still, after): (&mut [f64], Still),
    doubt: &mut [f64],
) {
    let n = stem.len();
    let [[s0, s1], [j0, j1]] = [s, j].map(|range| [&range[0][..n], &range[1][..n]]);
    let (was, came, rested) = (&last.stem[..n], &last.direction[..n], &last.still[..n]);
    let (direction, still, doubt) = (&mut direction[..n], &mut still[..n], &mut doubt[..n]);
    let one = |is: bool| if is { 1.0 } else { 0.0 };
    for i in 0..n {
        let onward = came[i] * (op - was[i]);
        let (back, ahead) = (grown * (1.0 + skew * came[i]), grown * rested[i]);
        let turns = one(-onward > s0[i] * back);
        let goes = turns + one(onward > j0[i] * ahead);
        doubt[i] = goes - one(-onward > s1[i] * back) - one(onward > j1[i] * ahead);
        stem[i] = if goes > 0.0 { op } else { was[i] };
        direction[i] = came[i] - 2.0 * turns * came[i];
        still[i] = after.stays + goes * (after.goes - after.stays);
    }
}
