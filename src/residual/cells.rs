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
use super::paths::{Cell, Paths, Range, Sample, middle};
use super::search::{FACTORS, LAGS};
use crate::diagnosis::friction::Start;
use std::array::from_fn;

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
/// Places to each side of OP where they count for the whole record.
const CLOSE: usize = 12;
/// The farthest of them as a share of S: with the least S of a cell it is still no turn.
const MOST_REST: f64 = 0.86;
/// Samples of a path that are kept: the longest delay and the lags behind it.
const KEPT: usize = 32;

/// How a stem that stopped goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Family {
    /// It follows OP until it turns; its kinetic lag is this share of S/2.
    Plain(f64),
    /// It sticks at every stop (Choudhury's and Kano's).
    Sticks,
    /// Every move is a slip of its own (He's).
    Slips,
    /// The same where J is S (Stenman's): one number.
    Jumps,
}

/// The stems among which is sought.
pub struct Stems<'a> {
    /// OP.
    pub u: &'a [f64],
    /// Where the stem starts.
    pub start: Start,
    /// Least and largest S.
    pub range: (f64, f64),
}

/// What is left of PV for a stem to explain, with the dynamics held.
pub struct Task<'a> {
    /// The stems that may be behind it.
    pub stems: Stems<'a>,
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
    /// What the terms delay the stem by: from which sample on, and by how many samples before and from there on.
    pub delays: Vec<(usize, [usize; 2])>,
}

/// Which of the losses are the best, or the best of their part, when `rows` samples were rated before this one; `order` is scratch.
fn choose(paths: &Paths, order: &mut Vec<(f64, usize)>, goes_on: &mut Vec<bool>, rows: usize) {
    let more = (AT_FIRST * 0.5_f64.powf(rows as f64 / HALVED)).max(1.0);
    let (best, each) = ((BEST * more) as usize, (EACH * more.sqrt()) as usize);
    order.clear();
    order.extend(paths.loss.iter().enumerate().map(|(at, loss)| (*loss, at)));
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let enough = order[0].0 + FAR_BEHIND;
    let mut of_part = [0; OF_S * OF_J];
    goes_on.clear();
    goes_on.resize(order.len(), false);
    for (rank, &(loss, at)) in order.iter().enumerate() {
        let of_part = &mut of_part[paths.cells[at].part];
        *of_part += 1;
        goes_on[at] = loss < enough && (rank < best || *of_part <= each);
    }
}

/// The half of the cells with the widest thresholds.
fn widest(paths: &Paths, order: &mut Vec<(f64, usize)>, goes_on: &mut Vec<bool>) {
    let size = |c: &Cell| (c.s.1 - c.s.0) * (c.j.1 - c.j.0 + 1e-12);
    order.clear();
    order.extend(paths.cells.iter().enumerate().map(|(at, cell)| (size(cell), at)));
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    goes_on.clear();
    goes_on.resize(order.len(), false);
    order.iter().take(UNRATED / 2).for_each(|&(_, at)| goes_on[at] = true);
}

impl Task<'_> {
    /// How many samples of the stem its longest delay and the lags behind it reach back to.
    fn reach(&self) -> usize {
        let longest: usize = self.delays.iter().map(|(_, by)| by[0].max(by[1])).sum();
        self.nearest + longest + LAGS.1
    }

    /// Whether the stem's past is known for as long as that takes.
    pub fn is_kept(&self) -> bool {
        self.reach() <= KEPT
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
        let mut paths = Paths::new(family, self.stems.start_cells(family), self.reach());
        let rate = 2.0 / (self.first + self.left.len()) as f64;
        let grown = |k: usize| (1.0 + growth * ((k as f64 * rate).min(3.0) - 1.0)).max(1e-3);
        let (mut order, mut goes_on, mut most) = (Vec::new(), Vec::new(), MOST);
        let b = from_fn(|j| self.b.get(j).copied().unwrap_or(0.0));
        for k in self.stems.start.index + 1..self.first + self.left.len() {
            paths.step(k, Sample { op: self.stems.u[k], grown: grown(k), skew });
            let Some(row) = k.checked_sub(self.first) else {
                if paths.len() > UNRATED {
                    widest(&paths, &mut order, &mut goes_on);
                    paths.retain(&goes_on);
                }
                continue;
            };
            // All lags by the delay of this sample: those that reach back over a change are a few rows of all.
            let later: usize = self.delays.iter().map(|(at, by)| by[usize::from(k >= *at)]).sum();
            paths.rate(k - self.nearest - later, &b, self.left[row], self.counted[row] * self.per);
            if row % FACTORS == FACTORS - 1 || paths.len() > most {
                paths.count();
            }
            if paths.len() > most {
                choose(&paths, &mut order, &mut goes_on, row);
                paths.retain(&goes_on);
                // Parts of which none is far behind keep more than there should be: not to be sorted at every sample.
                most = MOST.max(paths.len() + paths.len() / 4);
            }
        }
        paths.count();
        let mut found: Vec<(f64, Cell)> = paths.loss.into_iter().zip(paths.cells).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let element = |cell: &Cell| Element {
            growth: like.growth + growth,
            skew: like.skew + skew,
            ..self.stems.element(cell, family, like)
        };
        found.iter().take(count).map(|(loss, cell)| (*loss, element(cell))).collect()
    }
}

impl Stems<'_> {
    /// The cells at the start.
    pub fn start_cells(&self, family: Family) -> Vec<Cell> {
        let wide = self.range.1 / self.range.0;
        let parts = ((wide.ln() / WIDTH.ln()).ceil() as usize).clamp(1, OF_S);
        let s = |i: usize| self.range.0 * wide.powf(i as f64 / parts as f64);
        let mut cells = Vec::new();
        for i in 0..parts {
            let s = (s(i), s(i + 1));
            let of_j = |share: usize| s.1 * share as f64 / OF_J as f64;
            let shares: Vec<Range> = match family {
                Family::Plain(_) => vec![(0.0, 0.0)],
                Family::Jumps => vec![s],
                Family::Sticks | Family::Slips => {
                    (0..OF_J).map(|share| (of_j(share), of_j(share + 1))).collect()
                }
            };
            for (share, j) in shares.into_iter().enumerate() {
                let start = |place| self.start_cell(s, j, i * OF_J + share, place);
                if family == Family::Jumps {
                    // Nothing but a slip at the same sample makes two of its paths one: the start is never forgotten.
                    let rest = |i: usize| MOST_REST * i as f64 / CLOSE as f64;
                    let places = (0..=CLOSE).map(|i| (true, rest(i)));
                    let others = (1..=CLOSE).map(|i| (false, rest(i)));
                    cells.extend(places.chain(others).map(start));
                } else {
                    cells.extend(PLACES.into_iter().map(start));
                }
            }
        }
        cells
    }

    fn start_cell(&self, s: Range, j: Range, part: usize, (turned, rest): (bool, f64)) -> Cell {
        let direction = if self.start.is_max != turned { 1.0 } else { -1.0 };
        let place = self.u[self.start.index] + direction * middle(s) * rest;
        Cell { s, j, part, place, direction, turned }
    }

    /// The valve in the middle of a cell.
    pub fn element(&self, cell: &Cell, family: Family, like: Element) -> Element {
        let s = middle(cell.s);
        let resume = (middle(cell.j) / s).min(1.0);
        let lag = (2.0 * cell.lag(family) / s).min(1.0);
        let rest = ((cell.place - self.u[self.start.index]).abs() / s).min(1.0);
        let slips = matches!(family, Family::Slips | Family::Jumps);
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
        let stems = Stems { u, start: START, range: (0.08, 4.0) };
        Task { stems, first: FIRST, left, counted, nearest: 1, b: &B, per, delays: Vec::new() }
    }

    fn noise(seed: u64) -> impl Iterator<Item = f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed))
    }

    #[test]
    fn the_loss_of_a_cell_is_that_of_its_valve() {
        let valve = Element { f: 0.6, ..Element::default() };
        let lags = Element { lag: 0.6, ..valve };
        // Sums in another order; the lag was another while the cell was wide.
        for (family, valve, least) in [
            (Family::Plain(0.0), valve, 1e-9),
            (Family::Plain(0.6), lags, 0.1),
            (Family::Sticks, Element { resume: 0.4, ..lags }, 0.1),
            (Family::Slips, Element { resume: 0.4, slips: true, ..lags }, 0.1),
        ] {
            let mut noise = noise(3);
            let u = op(&mut noise);
            let left = left(&u, valve, 0.02, &mut noise);
            let counted = vec![1.0; left.len()];
            let task = task(&u, &left, &counted, 0.02);
            for (loss, element) in task.best(family, (0.0, 0.0), Element::default(), 3) {
                let (mut z, mut dir) = (Vec::new(), Vec::new());
                element.run(&u, START, u.len(), &mut z, &mut dir);
                let e = |k: usize| left[k - FIRST] - (0..LAGS.1).map(|j| B[j] * z[k - 1 - j]).sum::<f64>();
                let plain: f64 = (FIRST..u.len()).map(|k| (1.0 + e(k) * e(k) * task.per).ln()).sum();
                assert!((loss / plain - 1.0).abs() < least, "{loss} {plain} {element:?}");
            }
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
            (3, slips, Family::Jumps),
            (4, growing, Family::Sticks),
            (5, skewed, Family::Sticks),
        ] {
            let mut noise = noise(seed);
            let u = op(&mut noise);
            let left = left(&u, valve, 0.02, &mut noise);
            let counted = vec![1.0; left.len()];
            let s = 2.0 * valve.f;
            for range in [(0.08, 4.0), (0.7 * s, 1.5 * s)] {
                let mut task = task(&u, &left, &counted, 0.02);
                task.stems.range = range;
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
