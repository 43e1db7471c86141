//! All valves at once: a search over the two thresholds of a stem that leaves no value out.
//!
//! ```text
//! S: |OP - stem| beyond which the stem turns       J: the same beyond which it goes on after a stop
//! z = x - (S - J)/2 dir,    L = sum of ln(1 + e^2 / (3 s^2))
//! ```
//!
//! Where OP is noisy, a stem with thresholds half a per cent off goes other ways than the true one, and no grid is fine
//! enough to meet it. But a path depends on S and J only through what they are compared with: all thresholds that decide
//! alike so far share one path, and are one cell. A comparison that falls inside a cell splits it in two. Cells whose
//! paths explain PV badly are left behind, the best go on.

use super::model::Element;
use super::search::{FACTORS, LAGS, MOST_FACTOR};
use crate::diagnosis::friction::Start;

/// So many of the best cells go on, and of each part of the thresholds' range so many that are not far behind, when more than so
/// many are alive, or a quarter more than went on the last time.
const BEST: f64 = 24.0;
const EACH: f64 = 1.0;
const MOST: usize = 48;
/// How many times more at the first samples, which tell good from bad by chance only, and after how many it is half of that.
const AT_FIRST: f64 = 16.0;
const HALVED: f64 = 40.0;
/// Loss behind the best at which a cell is given up.
const FAR_BEHIND: f64 = 60.0;
/// Those alive before the first sample that is rated.
const UNRATED: usize = 2048;
/// Cells at the start: values of S, each about so many times the last and at most so many, of J as a share of it, and places of
/// the stem.
const WIDTH: f64 = 1.28;
const OF_S: usize = 16;
const OF_J: usize = 5;
const PLACES: [(bool, f64); 5] = [(false, 0.0), (false, 0.5), (true, 0.0), (true, 0.5), (true, 1.0)];
/// Samples of a path that are kept: the longest delay and the lags behind it.
const KEPT: usize = 32;

/// How a stem that stopped goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Family {
    /// It follows OP until it turns; its kinetic lag is this share of S/2.
    Plain(f64),
    /// It sticks at every stop (Choudhury's and Kano's).
    Sticks,
    /// Every move is a slip of its own (He's, Stenman's).
    Slips,
}

/// What is left of PV for a stem to explain, with the dynamics held.
pub struct Task<'a> {
    /// OP.
    pub u: &'a [f64],
    /// Where the stem starts.
    pub start: Start,
    /// First sample that is rated.
    pub first: usize,
    /// PV less all that does not come from the stem, from `first` on.
    pub left: &'a [f64],
    /// Whether a sample counts.
    pub counted: &'a [f64],
    /// First lag of the stem.
    pub nearest: usize,
    /// The coefficients from it on.
    pub b: &'a [f64],
    /// `1 / (3 s^2)`.
    pub per: f64,
    /// Least and largest S.
    pub range: (f64, f64),
    /// What the terms delay the stem by: from which sample on, and by how many samples before and from there on.
    pub delays: Vec<(usize, [usize; 2])>,
}

#[derive(Clone)]
struct Cell {
    s: (f64, f64),
    j: (f64, f64),
    /// The part of the thresholds' range that it began in.
    part: usize,
    /// Whether it was chosen.
    goes_on: bool,
    turned: bool,
    /// The stem's place at the start.
    place: f64,
    stem: f64,
    direction: f64,
    moving: bool,
    loss: f64,
    /// Factors whose logarithm is not in the loss yet.
    product: f64,
    /// Stem and direction, twice over so that any stretch lies in one piece.
    stems: [f64; 2 * KEPT],
    directions: [f64; 2 * KEPT],
}

fn middle(range: (f64, f64)) -> f64 {
    0.5 * (range.0 + range.1)
}

impl Cell {
    fn lag(&self, family: Family) -> f64 {
        match family {
            Family::Plain(share) => 0.5 * share * middle(self.s),
            _ => 0.5 * (middle(self.s) - middle(self.j)).max(0.0),
        }
    }

    /// The stem goes to `op`, on or back.
    fn go(&mut self, op: f64, back: bool, family: Family) {
        self.stem = op;
        if back {
            self.direction = -self.direction;
        }
        self.moving = family != Family::Slips;
    }

    fn stay(&mut self, family: Family) {
        self.moving = matches!(family, Family::Plain(_));
    }

    /// One sample of OP, with the bands there are `grown` times wider and those to turn by `skew` wider downwards; what decides
    /// otherwise goes into `split`.
    fn step(&mut self, op: f64, (grown, skew): (f64, f64), family: Family, split: &mut Vec<Cell>) {
        let onward = self.direction * (op - self.stem);
        if onward > 0.0 && self.moving && family != Family::Slips {
            self.stem = op;
            return;
        }
        let back = onward <= 0.0;
        let wider = if back { 1.0 + skew * self.direction } else { 1.0 };
        let distance = onward.abs() / (grown * wider);
        let range = if back { &mut self.s } else { &mut self.j };
        if distance > range.1 {
            self.go(op, back, family);
        } else if distance <= range.0 {
            self.stay(family);
        } else {
            let high = range.1;
            range.1 = distance;
            let mut other = self.clone();
            *(if back { &mut other.s } else { &mut other.j }) = (distance, high);
            self.go(op, back, family);
            other.stay(family);
            // A stop is not left with more force than a turn takes.
            if other.j.0 < other.s.1 {
                split.push(other);
            }
        }
    }

    /// Puts the factors into the loss.
    fn count(&mut self) {
        self.loss += self.product.ln();
        self.product = 1.0;
    }

    /// Keeps the stem of sample `k`.
    fn keep(&mut self, k: usize) {
        let at = k % KEPT;
        (self.stems[at], self.stems[at + KEPT]) = (self.stem, self.stem);
        (self.directions[at], self.directions[at + KEPT]) = (self.direction, self.direction);
    }
}

/// Leaves the best, and the best of each part, when `rows` samples were rated before this one; `order` is scratch.
fn choose(cells: &mut Vec<Cell>, order: &mut Vec<(f64, usize)>, rows: usize) {
    let more = (AT_FIRST * 0.5_f64.powf(rows as f64 / HALVED)).max(1.0);
    let (best, each) = ((BEST * more) as usize, (EACH * more.sqrt()) as usize);
    order.clear();
    order.extend(cells.iter().enumerate().map(|(at, cell)| (cell.loss, at)));
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let enough = order[0].0 + FAR_BEHIND;
    let mut of_part = [0; OF_S * OF_J];
    for (rank, &(loss, at)) in order.iter().enumerate() {
        let cell = &mut cells[at];
        of_part[cell.part] += 1;
        cell.goes_on = loss < enough && (rank < best || of_part[cell.part] <= each);
    }
    cells.retain(|cell| cell.goes_on);
}

impl Task<'_> {
    /// Whether the stem is kept for as long as the longest delay takes.
    pub fn is_kept(&self) -> bool {
        let longest: usize = self.delays.iter().map(|(_, by)| by[0].max(by[1])).sum();
        self.nearest + longest + LAGS.1 <= KEPT
    }

    /// The `count` best elements of a family, each with its loss; their f grows from `1 - growth` to `1 + growth` times itself
    /// over the samples, and the band to turn is `1 + skew` times as wide downwards and `1 - skew` upwards.
    pub fn best(
        &self,
        family: Family,
        (growth, skew): (f64, f64),
        like: Element,
        count: usize,
    ) -> Vec<(f64, Element)> {
        let mut cells = self.start_cells(family);
        let rate = 2.0 / (self.first + self.left.len()) as f64;
        let grown = |k: usize| (1.0 + growth * ((k as f64 * rate).min(3.0) - 1.0)).max(1e-3);
        let (mut split, mut order, mut most) = (Vec::new(), Vec::new(), MOST);
        let mut back = [0.0; LAGS.1];
        back.iter_mut().zip(self.b.iter().rev()).for_each(|(own, b)| *own = *b);
        for k in self.start.index + 1..self.first + self.left.len() {
            for cell in &mut cells {
                cell.step(self.u[k], (grown(k), skew), family, &mut split);
            }
            cells.append(&mut split);
            cells.iter_mut().for_each(|cell| cell.keep(k));
            if k < self.first {
                if cells.len() > UNRATED {
                    let size = |c: &Cell| (c.s.1 - c.s.0) * (c.j.1 - c.j.0 + 1e-12);
                    cells.select_nth_unstable_by(UNRATED / 2, |a, b| size(b).total_cmp(&size(a)));
                    cells.truncate(UNRATED / 2);
                }
                continue;
            }
            self.rate(k, family, grown(k), &back, &mut cells);
            if (k - self.first) % FACTORS == FACTORS - 1 || cells.len() > most {
                cells.iter_mut().for_each(Cell::count);
            }
            if cells.len() > most {
                choose(&mut cells, &mut order, k - self.first);
                // Parts of which none is far behind keep more than there should be: not to be sorted at every sample.
                most = MOST.max(cells.len() + cells.len() / 4);
            }
        }
        cells.iter_mut().for_each(Cell::count);
        cells.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        let element = |cell: &Cell| Element {
            growth: like.growth + growth,
            skew: like.skew + skew,
            ..self.element(cell, family, like)
        };
        cells.iter().take(count).map(|cell| (cell.loss, element(cell))).collect()
    }

    fn start_cells(&self, family: Family) -> Vec<Cell> {
        let wide = self.range.1 / self.range.0;
        let parts = ((wide.ln() / WIDTH.ln()).ceil() as usize).clamp(1, OF_S);
        let s = |i: usize| self.range.0 * wide.powf(i as f64 / parts as f64);
        let plain = matches!(family, Family::Plain(_));
        let mut cells = Vec::with_capacity(UNRATED);
        for i in 0..parts {
            for share in 0..if plain { 1 } else { OF_J } {
                let of_j = |share: usize| s(i + 1) * share as f64 / OF_J as f64;
                let j = if plain { (0.0, 0.0) } else { (of_j(share), of_j(share + 1)) };
                let part = i * OF_J + share;
                let start = |place| self.start_cell((s(i), s(i + 1)), j, part, place);
                cells.extend(PLACES.into_iter().map(start).map(|cell| Cell { moving: plain, ..cell }));
            }
        }
        cells
    }

    fn start_cell(&self, s: (f64, f64), j: (f64, f64), part: usize, (turned, rest): (bool, f64)) -> Cell {
        let direction = if self.start.is_max != turned { 1.0 } else { -1.0 };
        let at = self.u[self.start.index];
        let place = at + direction * middle(s) * rest;
        let mut cell = Cell {
            s,
            j,
            part,
            goes_on: true,
            turned,
            place,
            stem: place,
            direction,
            moving: false,
            loss: 0.0,
            product: 1.0,
            stems: [at; 2 * KEPT],
            directions: [direction; 2 * KEPT],
        };
        cell.keep(self.start.index);
        cell
    }

    fn rate(&self, k: usize, family: Family, grown: f64, back: &[f64; LAGS.1], cells: &mut [Cell]) {
        let row = k - self.first;
        let later: usize = self.delays.iter().map(|(at, by)| by[usize::from(k >= *at)]).sum();
        // All lags by the delay of this sample: those that reach back over a change are a few rows of all.
        let from = (k - self.nearest - later - (LAGS.1 - 1)) % KEPT;
        for cell in cells {
            let (mut stem, mut turn) = (0.0, 0.0);
            let stems = &cell.stems[from..from + LAGS.1];
            let directions = &cell.directions[from..from + LAGS.1];
            for ((b, x), d) in back.iter().zip(stems).zip(directions) {
                stem += b * x;
                turn += b * d;
            }
            let e = self.left[row] - stem + cell.lag(family) * grown * turn;
            cell.product *= 1.0 + (self.counted[row] * e * e * self.per).min(MOST_FACTOR);
        }
    }

    fn element(&self, cell: &Cell, family: Family, like: Element) -> Element {
        let s = middle(cell.s);
        let resume = (middle(cell.j) / s).min(1.0);
        let lag = (2.0 * cell.lag(family) / s).min(1.0);
        let rest = ((cell.place - self.u[self.start.index]).abs() / s).min(1.0);
        let slips = family == Family::Slips;
        Element { f: 0.5 * s, lag, resume, slips, turned: cell.turned, rest, ..like }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const B: [f64; LAGS.1] = [0.2, 0.16, 0.13, 0.1, 0.08, 0.07, 0.05, 0.04];
    const FIRST: usize = 40;
    const START: Start = Start { index: 6, is_max: true };

    /// OP so noisy that no grid of thresholds meets a stem's way through it.
    fn op(noise: &mut impl Iterator<Item = f64>) -> Vec<f64> {
        let wave = |k: usize| 2.0 * (0.07 * k as f64).sin() + (0.023 * k as f64).cos();
        (0..1200).map(|k| wave(k) + 0.3 * noise.next().unwrap_or(0.0)).collect()
    }

    /// What `element` leaves of PV for the search to explain, with noise of `sd`.
    fn left(u: &[f64], element: Element, sd: f64, noise: &mut impl Iterator<Item = f64>) -> Vec<f64> {
        let (mut z, mut dir) = (Vec::new(), Vec::new());
        element.run(u, START, u.len(), &mut z, &mut dir);
        let through = |k: usize| -> f64 { B.iter().enumerate().map(|(j, b)| b * z[k - 1 - j]).sum() };
        (FIRST..u.len()).map(|k| through(k) + sd * noise.next().unwrap_or(0.0)).collect()
    }

    fn task<'a>(u: &'a [f64], left: &'a [f64], counted: &'a [f64], sd: f64) -> Task<'a> {
        let per = 1.0 / (3.0 * sd * sd);
        Task {
            u,
            start: START,
            first: FIRST,
            left,
            counted,
            nearest: 1,
            b: &B,
            per,
            range: (0.08, 4.0),
            delays: Vec::new(),
        }
    }

    fn noise(seed: u64) -> impl Iterator<Item = f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed))
    }

    #[test]
    fn the_loss_of_a_cell_is_that_of_its_valve() {
        let mut noise = noise(3);
        let u = op(&mut noise);
        let valve = Element { f: 0.6, ..Element::default() };
        let left = left(&u, valve, 0.02, &mut noise);
        let counted = vec![1.0; left.len()];
        let task = task(&u, &left, &counted, 0.02);
        for (loss, element) in task.best(Family::Plain(0.0), (0.0, 0.0), Element::default(), 5) {
            let (mut z, mut dir) = (Vec::new(), Vec::new());
            element.run(&u, START, u.len(), &mut z, &mut dir);
            let plain: f64 = (FIRST..u.len())
                .map(|k| {
                    let e =
                        left[k - FIRST] - B.iter().enumerate().map(|(j, b)| b * z[k - 1 - j]).sum::<f64>();
                    (1.0 + e * e * task.per).ln()
                })
                .sum();
            // Sums in another order.
            assert!((loss / plain - 1.0).abs() < 1e-9, "{loss} {plain} {element:?}");
        }
    }

    #[test]
    fn thresholds_that_no_grid_meets_are_found_to_the_cell() {
        let sticks = Element { f: 0.613, resume: 0.37, lag: 0.63, ..Element::default() };
        let slips = Element { f: 0.441, resume: 1.0, slips: true, ..Element::default() };
        let growing = Element { growth: 0.45, ..sticks };
        let skewed = Element { skew: -0.3, ..sticks };
        for (seed, valve, family) in [
            (1, sticks, Family::Sticks),
            (2, slips, Family::Slips),
            (4, growing, Family::Sticks),
            (5, skewed, Family::Sticks),
        ] {
            let mut noise = noise(seed);
            let u = op(&mut noise);
            let left = left(&u, valve, 0.02, &mut noise);
            let counted = vec![1.0; left.len()];
            let s = 2.0 * valve.f;
            for range in [(0.08, 4.0), (0.7 * s, 1.5 * s)] {
                let task = Task { range, ..task(&u, &left, &counted, 0.02) };
                let found = task.best(family, (valve.growth, valve.skew), Element::default(), 1)[0].1;
                let close = |a: f64, b: f64, by: f64| (a - b).abs() < by;
                let right = close(found.f, valve.f, 0.01 * valve.f)
                    && close(found.resume, valve.resume, 0.06)
                    && (found.growth, found.skew) == (valve.growth, valve.skew);
                assert!(right, "{found:?} for {valve:?} in {range:?}");
            }
        }
    }

    #[test]
    fn the_true_path_is_not_given_up_while_chance_decides() {
        let sticks = Element { f: 0.613, resume: 0.37, lag: 0.63, ..Element::default() };
        let valves = [
            (sticks, Family::Sticks),
            (Element { skew: -0.3, ..sticks }, Family::Sticks),
            (Element { f: 0.441, resume: 1.0, slips: true, ..Element::default() }, Family::Slips),
            (Element { f: 0.541, ..Element::default() }, Family::Plain(0.0)),
        ];
        let (mut found, mut all) = (0, 0);
        for (valve, family) in valves {
            for seed in 20..40 {
                let mut noise = noise(seed);
                let u = op(&mut noise);
                let left = left(&u, valve, 0.04, &mut noise);
                let counted = vec![1.0; left.len()];
                let task = task(&u, &left, &counted, 0.04);
                let best = task.best(family, (0.0, valve.skew), Element::default(), 1)[0].1;
                found += i32::from((best.f / valve.f - 1.0).abs() < 0.01);
                all += 1;
            }
        }
        // Half of them are lost where the first samples leave only a few.
        assert!(10 * found >= 9 * all, "{found} of {all}");
    }
}
