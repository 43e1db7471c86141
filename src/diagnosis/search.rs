//! The search over f: the paper's grid of ARMAX fits, and the exact profile over every distinguishable f.
//!
//! Two passes read the same window. [`Searcher::grid`] is the paper's: at each of 101 values of f every split
//! and every delay is screened and the promising ones are fitted by prediction error. [`Searcher::profile`]
//! walks the [`Cell`]s of f, of which sampled data can tell no two points apart, with the long ARX; at low
//! noise the minimum is one cell wide and a grid steps over it. [`Searcher::refine`] fits the ARMAX model with
//! a kinetic lag in the best cells of both and keeps the f with the least `AIC(ARMAX) + AIC(long ARX)`: two
//! views of the noise err in different places.

use super::armax::{Fit, LOSS_FLOOR, Lag, Orders, Signals, Theta, Workspace, splits};
use super::friction::{Cell, Start, reversals, stick_slip};
use super::screen::{Candidate, Screen};

/// Values of f in the paper's grid.
pub const GRID: usize = 101;
/// Most cells of the paper's element that the profile visits; more are thinned evenly in f.
const MOST_CELLS: usize = 1000;
/// Resume thresholds J/S of the extended elements.
const RESUMES: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
/// Cells of an extended element on the first pass, and around its best.
const COARSE_CELLS: usize = 80;
const FINE_CELLS: usize = 60;
/// Coarse steps to each side of the best that the fine pass covers.
const FINE_REACH: f64 = 3.0;
/// Fewest stem reversals in a window that say anything about f.
pub const LEAST_REVERSALS: usize = 4;
/// Structures fitted by prediction error at one f.
const FITTED: usize = 3;
/// Structures remembered from one f to the next.
const WINNERS: usize = 4;
/// Relative decrease of the loss at which a minimisation ends: 0.1 and 0.001 in N ln V of 1,000 samples.
const ROUGH: f64 = 1e-4;
const PRECISE: f64 = 1e-6;
/// Most screenings with better and better errors.
const RESCREENS: usize = 4;
/// Grid steps to each side of the best point that get a second look too.
const NEIGHBOURS: usize = 6;
/// Most second looks at the best point of the grid.
const SETTLING: usize = 8;
/// Structures fitted where the result decides: at f = 0 and in the refinement.
const FITTED_WELL: usize = 12;
/// Iterations each start gets before the leaders are known, leaders that go on, and iterations they get.
const HEAT: usize = 2;
const FINALISTS: usize = 2;
const MANY_FINALISTS: usize = 4;
const FINAL: usize = 40;
/// Distance in N ln V above the best at which a value of f gets no prediction-error fit: the Hannan–Rissanen loss
/// seldom overstates the minimum by more, though up to 400 has been seen.
const HOPELESS: f64 = 150.0;
/// Cells of each pass that the refinement looks at.
const REFINED: usize = 10;

/// One window, normalised to zero mean and unit variance, ready for the search.
#[derive(Clone, Debug)]
pub struct Problem {
    /// OP.
    pub u: Vec<f64>,
    /// PV.
    pub y: Vec<f64>,
    /// Where the friction element starts.
    pub start: Start,
    /// First sample that counts in the loss.
    pub first: usize,
    /// Longest delay (samples).
    pub max_delay: usize,
    /// Largest f at which the stem still reverses.
    pub f_top: f64,
}

impl Problem {
    /// Samples that count in the loss.
    pub fn rows(&self) -> f64 {
        (self.y.len() - self.first) as f64
    }

    /// The signals of a fit with the given stem position.
    pub fn signals<'s>(&'s self, x: &'s [f64], dir: &'s [f64]) -> Signals<'s> {
        Signals { y: &self.y, x, dir, start: self.start.index, first: self.first }
    }
}

/// The ARMAX model at one f of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridPoint {
    /// Friction.
    pub f: f64,
    /// Least loss over splits and delays; the screening value where no better was worth computing.
    pub loss: f64,
}

/// The long ARX in one cell of f.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellPoint {
    /// The values of f it holds for.
    pub cell: Cell,
    /// Resume threshold J/S of the element.
    pub resume: f64,
    /// Least loss over the kinetic lag.
    pub loss: f64,
    /// The kinetic lag at the minimum.
    pub lag: f64,
}

impl CellPoint {
    /// The f that stands for the cell: its middle, or its lower end when it has no upper one.
    pub fn f(&self) -> f64 {
        if self.cell.hi.is_finite() { 0.5 * (self.cell.lo + self.cell.hi) } else { self.cell.lo }
    }
}

/// The best model at one f by both views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refined {
    /// The cell.
    pub cell: Cell,
    /// Resume threshold J/S of the element.
    pub resume: f64,
    /// Friction.
    pub f: f64,
    /// The ARMAX fit, kinetic lag included.
    pub fit: Fit,
    /// Loss of the long ARX there.
    pub long_loss: f64,
    /// Kinetic lag of the long ARX.
    pub long_lag: f64,
}

/// Buffers of a search, planned once for a window.
#[derive(Clone, Debug)]
pub struct Searcher<'a> {
    p: &'a Problem,
    screen: Screen,
    work: Workspace,
    x: Vec<f64>,
    dir: Vec<f64>,
    candidates: Vec<Candidate>,
    starts: Vec<(Orders, Theta)>,
    running: Vec<Fit>,
    /// The structures that won last, with their coefficients, the latest last: warm starts.
    winners: Vec<(Orders, Theta)>,
    /// Prediction-error minimisations so far.
    pub fits: usize,
    /// Structures screened so far.
    pub screened: usize,
}

impl<'a> Searcher<'a> {
    /// Plans the buffers.
    pub fn new(p: &'a Problem) -> Self {
        let n = p.y.len();
        Self {
            p,
            screen: Screen::new(&p.y, p.first, p.max_delay),
            work: Workspace::new(n),
            x: vec![0.0; n],
            dir: vec![0.0; n],
            candidates: Vec::with_capacity(15 * p.max_delay),
            starts: Vec::new(),
            running: Vec::new(),
            winners: Vec::with_capacity(WINNERS),
            fits: 0,
            screened: 0,
        }
    }

    /// The paper's pass: the least ARMAX loss at `values` points of f from 0 to `f_top`.
    pub fn grid(&mut self, values: usize) -> Vec<GridPoint> {
        let step = self.p.f_top / (values.max(2) - 1) as f64;
        let mut points: Vec<GridPoint> =
            (0..values).map(|i| GridPoint { f: step * i as f64, loss: f64::INFINITY }).collect();
        // A coarse pass first, so that the fine one knows what is hopeless.
        let coarse = (0..values).step_by(10);
        let fine = (0..values).filter(|i| i % 10 != 0);
        let mut best = f64::INFINITY;
        let mut last: Option<(Cell, f64)> = None;
        for i in coarse.chain(fine) {
            let cell = self.run_element(points[i].f, 0.0);
            let loss = match last {
                Some((known, loss)) if known == cell => loss,
                _ => self.armax(best * (HOPELESS / self.p.rows()).exp(), false),
            };
            last = Some((cell, loss));
            best = best.min(loss);
            points[i].loss = loss;
        }
        self.settle(&mut points);
        points
    }

    /// Looks again, with every kind of structure, at the best point until it stays the best.
    fn settle(&mut self, points: &mut [GridPoint]) {
        let mut settled = vec![false; points.len()];
        for _ in 0..SETTLING {
            let Some(at) = (0..points.len()).min_by(|&a, &b| points[a].loss.total_cmp(&points[b].loss))
            else {
                return;
            };
            // The best itself first: what wins there is then tried on its neighbours.
            let neighbours = (at.saturating_sub(NEIGHBOURS)..=at + NEIGHBOURS).filter(|near| *near != at);
            for near in std::iter::once(at).chain(neighbours) {
                if near < points.len() && !settled[near] {
                    settled[near] = true;
                    self.run_element(points[near].f, 0.0);
                    points[near].loss = points[near].loss.min(self.armax(f64::INFINITY, near == at));
                }
            }
            if (0..points.len()).all(|i| points[i].loss >= points[at].loss) {
                return;
            }
        }
    }

    /// The exact pass: the long ARX with its best kinetic lag in the cells of f between `from` and `to`, at
    /// most `most` of them, thinned evenly in f.
    pub fn profile(&mut self, resume: f64, from: f64, to: f64, most: usize) -> Vec<CellPoint> {
        let mut points = Vec::new();
        let least_step = (to - from) / most.max(1) as f64;
        let mut f = from;
        let mut ratio = 0.5;
        while f <= to {
            let cell = self.run_element(f, resume);
            if reversals(&self.dir) < LEAST_REVERSALS && f > 0.0 {
                break;
            }
            self.screen.load(&self.p.signals(&self.x, &self.dir), f > 0.0);
            let middle = if cell.hi.is_finite() { 0.5 * (cell.lo + cell.hi) } else { cell.lo };
            let long = self.screen.fit_lag(ratio * middle, middle);
            if long.lag > 0.0 && middle > 0.0 {
                ratio = long.lag / middle;
            }
            points.push(CellPoint { cell, resume, loss: long.loss + LOSS_FLOOR, lag: long.lag });
            if !cell.hi.is_finite() {
                break;
            }
            f = cell.hi.max(f + least_step);
        }
        points
    }

    /// The profile over all f: every cell of the paper's element, the extended elements where they may be
    /// better, and finely around the best of those. The first point is f = 0.
    pub fn full_profile(&mut self) -> Vec<CellPoint> {
        let top = self.p.f_top;
        let mut points = self.profile(0.0, 0.0, top, MOST_CELLS);
        let step = top / COARSE_CELLS as f64;
        for resume in RESUMES {
            let coarse = self.profile(resume, step, top, COARSE_CELLS);
            let least = coarse.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)).map(CellPoint::f);
            points.extend(coarse);
            if let Some(f) = least {
                let (from, to) = ((f - FINE_REACH * step).max(0.1 * step), (f + FINE_REACH * step).min(top));
                points.extend(self.profile(resume, from, to, FINE_CELLS));
            }
        }
        points
    }

    /// Fits the ARMAX model with a kinetic lag at f = 0 and in the best cells of both passes.
    ///
    /// Returns the frictionless model and the best sticky one, if there is any cell beyond 0.
    pub fn refine(&mut self, grid: &[GridPoint], cells: &[CellPoint]) -> (Refined, Option<Refined>) {
        let sound = self.refine_at(0.0, 0.0, 0.0);
        let mut chosen = best_cells(cells, REFINED);
        let mut by_grid: Vec<&GridPoint> = grid.iter().filter(|g| g.f > 0.0).collect();
        by_grid.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        for point in by_grid.iter().take(REFINED / 2) {
            let plain = cells.iter().take_while(|c| c.resume == 0.0);
            chosen.push(plain.take_while(|c| c.cell.lo <= point.f).count().saturating_sub(1));
        }
        chosen.sort_unstable();
        chosen.dedup();
        let score = |r: &Refined| (r.fit.loss + LOSS_FLOOR).ln() + (r.long_loss + LOSS_FLOOR).ln();
        let mut best: Option<Refined> = None;
        for at in chosen.into_iter().filter(|&at| at > 0) {
            let refined = self.refine_at(cells[at].f(), cells[at].resume, cells[at].lag);
            if best.as_ref().is_none_or(|b| score(&refined) < score(b)) {
                best = Some(refined);
            }
        }
        (sound, best)
    }

    /// Both fits at one f, the lag of the long ARX tried from `lag`.
    pub fn refine_at(&mut self, f: f64, resume: f64, lag: f64) -> Refined {
        let cell = self.run_element(f, resume);
        let s = self.p.signals(&self.x, &self.dir);
        self.screen.load(&s, f > 0.0);
        let long = self.screen.fit_lag(lag, f);
        let lag_mode = if f > 0.0 { Lag::Free { max: f } } else { Lag::Fixed };
        self.starts.clear();
        // Starts without and with the lag: the loss is not convex in it.
        for start in [0.0, long.lag] {
            if start == 0.0 && !self.starts.is_empty() {
                continue;
            }
            self.screen.load_errors(&s, start);
            self.candidates.clear();
            let candidates = &mut self.candidates;
            self.screen.fit_all(|c| candidates.push(c));
            self.screened += candidates.len();
            let most = FITTED_WELL.min(candidates.len());
            candidates.select_nth_unstable_by(most - 1, |a, b| a.loss.total_cmp(&b.loss));
            self.starts
                .extend(candidates[..most].iter().map(|c| (c.orders, Theta { lag: start, ..c.theta })));
        }
        self.fits += self.starts.len();
        let fit = race(&mut self.work, &s, &self.starts, lag_mode, PRECISE, &mut self.running);
        Refined { cell, resume, f, fit, long_loss: long.loss, long_lag: long.lag }
    }

    /// The prediction errors of a refined model, from its first counted sample on, and its stem position.
    pub fn errors(&mut self, refined: &Refined) -> (Vec<f64>, Vec<f64>) {
        self.run_element(refined.f, refined.resume);
        let s = self.p.signals(&self.x, &self.dir);
        self.work.evaluate(&s, refined.fit.orders, &refined.fit.theta);
        let stem = self.x.iter().zip(&self.dir).map(|(x, d)| x - refined.fit.theta.lag * d).collect();
        (self.work.errors()[self.p.first..].to_vec(), stem)
    }

    /// The least ARMAX loss at the present stem position; the screening value when that exceeds `hopeless`.
    ///
    /// `wide` races the best delay of every split beside the best of all: where the screening ranks the true
    /// winner low, its split still starts.
    fn armax(&mut self, hopeless: f64, wide: bool) -> f64 {
        let s = self.p.signals(&self.x, &self.dir);
        self.screen.load(&s, false);
        self.screen.load_errors(&s, 0.0);
        self.candidates.clear();
        let candidates = &mut self.candidates;
        self.screen.fit_all(|c| candidates.push(c));
        self.screened += candidates.len();
        let most = FITTED.min(candidates.len());
        candidates.select_nth_unstable_by(most - 1, |a, b| a.loss.total_cmp(&b.loss));
        let screened = candidates[..most].iter().map(|c| c.loss).fold(f64::INFINITY, f64::min);
        if screened > hopeless && !wide {
            return screened + LOSS_FLOOR;
        }
        self.starts.clear();
        self.starts.extend(candidates[..most].iter().map(|c| (c.orders, c.theta)));
        if wide {
            for split in splits(1) {
                let of_split = candidates.iter().filter(|c| Orders { nk: 1, ..c.orders } == split);
                let best = of_split.min_by(|a, b| a.loss.total_cmp(&b.loss));
                self.starts.extend(best.map(|c| (c.orders, c.theta)));
            }
        }
        self.starts.extend(self.winners.iter().copied());
        self.fits += self.starts.len();
        let (tolerance, rescreens) = if wide { (PRECISE, RESCREENS) } else { (ROUGH, 1) };
        let mut best = race(&mut self.work, &s, &self.starts, Lag::Fixed, tolerance, &mut self.running);
        for _ in 0..rescreens {
            let before = best.loss;
            best = rescreen(&mut self.screen, &mut self.work, &s, best, tolerance, &mut self.candidates);
            self.fits += FITTED;
            if best.loss > before * (1.0 - 1e-4) {
                break;
            }
        }
        self.winners.retain(|(orders, _)| *orders != best.orders);
        if self.winners.len() == WINNERS {
            self.winners.remove(0);
        }
        self.winners.push((best.orders, best.theta));
        best.loss + LOSS_FLOOR
    }

    fn run_element(&mut self, f: f64, resume: f64) -> Cell {
        stick_slip(&self.p.u, f, resume, self.p.start, &mut self.x, &mut self.dir)
    }
}

/// The best minimum from several starts: a few iterations for each, then only the leaders to the end.
fn race(
    work: &mut Workspace,
    s: &Signals<'_>,
    starts: &[(Orders, Theta)],
    lag: Lag,
    tolerance: f64,
    running: &mut Vec<Fit>,
) -> Fit {
    running.clear();
    running.extend(starts.iter().map(|(orders, theta)| work.minimise(s, *orders, *theta, lag, ROUGH, HEAT)));
    running.sort_by(|a, b| a.loss.total_cmp(&b.loss));
    running.truncate(if tolerance < ROUGH { MANY_FINALISTS } else { FINALISTS });
    let finals = running.iter().map(|fit| work.minimise(s, fit.orders, fit.theta, lag, tolerance, FINAL));
    let nobody = Fit {
        orders: Orders { na: 1, nb: 1, nc: 0, nk: 1 },
        theta: Theta::default(),
        loss: f64::INFINITY,
        iterations: 0,
    };
    finals.min_by(|a, b| a.loss.total_cmp(&b.loss)).unwrap_or(nobody)
}

/// Screens every structure again with the errors of the best model so far, and fits the best of that screening.
fn rescreen(
    screen: &mut Screen,
    work: &mut Workspace,
    s: &Signals<'_>,
    best: Fit,
    tolerance: f64,
    candidates: &mut Vec<Candidate>,
) -> Fit {
    work.evaluate(s, best.orders, &best.theta);
    screen.reload_errors(s, work.errors());
    candidates.clear();
    screen.fit_all(|c| candidates.push(c));
    candidates.select_nth_unstable_by(FITTED - 1, |a, b| a.loss.total_cmp(&b.loss));
    let fits = candidates[..FITTED].iter().filter(|c| c.orders != best.orders).map(|c| {
        let theta = Theta { lag: best.theta.lag, ..c.theta };
        work.minimise(s, c.orders, theta, Lag::Fixed, tolerance, FINAL)
    });
    fits.chain([best]).min_by(|a, b| a.loss.total_cmp(&b.loss)).unwrap_or(best)
}

/// The `most` best cells that are local minima of the profile, and their neighbours.
fn best_cells(cells: &[CellPoint], most: usize) -> Vec<usize> {
    let beats = |i: usize, other: Option<usize>| {
        other
            .and_then(|o| cells.get(o))
            .is_none_or(|o| o.resume != cells[i].resume || o.loss >= cells[i].loss)
    };
    let mut minima: Vec<usize> =
        (1..cells.len()).filter(|&i| beats(i, i.checked_sub(1)) && beats(i, Some(i + 1))).collect();
    minima.sort_by(|&a, &b| cells[a].loss.total_cmp(&cells[b].loss));
    minima.truncate(most);
    minima
}

#[cfg(test)]
mod tests;
