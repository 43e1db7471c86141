//! The search over f: the paper's grid of ARMAX fits, and the exact profile over every distinguishable f.
//!
//! Two passes read the same window. [`Searcher::grid`] is the paper's, in a file of its own. [`Searcher::profile`]
//! walks the [`Cell`]s of f, of which sampled data can tell no two points apart, with the long ARX; at low
//! noise the minimum is one cell wide and a grid steps over it. [`Searcher::refine`] fits the ARMAX model with
//! a kinetic lag in the best cells of both, settles the best of these from every start there is, and keeps the f with the
//! least `AIC(ARMAX) + AIC(long ARX)`: two views of the noise err in different places.

use super::armax::{Fit, LOSS_FLOOR, Lag, Orders, Rows, Signals, Theta, Workspace};
use super::explore::Explorer;
use super::friction::{Cell, Start, reversals, stick_slip};
use super::screen::{Candidate, Counted, Screen};
use crate::signal::{Row, Window};

/// Most cells of the paper's element that the profile visits; more are thinned evenly in f.
const MOST_CELLS: usize = 1000;
/// Resume thresholds J/S of the extended elements; 0 is the paper's.
const RESUMES: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
/// Cells of an extended element on the first pass, at most.
const COARSE_CELLS: usize = 80;
/// Cells around its best on the second pass, at most.
const FINE_CELLS: usize = 60;
/// Coarse steps to each side of the best that the second pass covers.
const FINE_REACH: f64 = 3.0;
/// Fewest stem reversals in a window that say anything about f: those of two cycles.
pub const LEAST_REVERSALS: usize = 4;
/// Structures fitted at each cell of the refinement: the best by the screening.
const FITTED: usize = 12;
/// Relative decrease of the loss at which a rough minimisation ends: 0.1 in N ln V of 1,000 samples.
pub(super) const ROUGH: f64 = 1e-4;
/// The same of one that decides: 0.001 in N ln V.
pub(super) const PRECISE: f64 = 1e-6;
/// Most iterations of a minimisation that is to reach the end.
pub(super) const FINAL: usize = 40;
/// Rounds of a race: iterations in it, and how many go on.
pub(super) type Rounds = [(usize, usize)];
/// Rounds where a cell is refined.
const SHORT_RACE: [(usize, usize); 1] = [(2, 4)];
/// Rounds where one is settled, with every start.
const LONG_RACE: [(usize, usize); 2] = [(2, 60), (3, 16)];
/// Rounds of those that start from the best model's errors.
const RESCREEN_RACE: [(usize, usize); 1] = [(2, 6)];
/// Structures that start from the best model's errors.
const RESCREENED: usize = 40;
/// How often the best may change that way.
const RESCREENS: usize = 3;
/// Cells of the exact profile that the refinement looks at; of the grid's values half as many.
const REFINED: usize = 10;
/// Cells among them that are settled: the best.
const SETTLED: usize = 2;

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
    /// Which samples do not count.
    pub holes: Holes,
}

/// Samples that do not count in a window, as [`armax::Rows`](super::armax::Rows) wants them.
#[derive(Clone, Debug, Default)]
pub struct Holes {
    left_out: Vec<usize>,
    /// Empty where all count.
    worth: Vec<Row>,
}

impl Holes {
    /// Of a window whose first sample that counts is `first`.
    pub fn of(window: &Window, first: usize) -> Self {
        Self {
            left_out: (first..window.rows.len()).filter(|k| window.rows[*k] != Row::Counts).collect(),
            worth: if window.rows.iter().any(|row| *row != Row::Counts) {
                window.rows.clone()
            } else {
                Vec::new()
            },
        }
    }

    /// Those among the first `n` samples.
    pub fn within(&self, n: usize) -> Rows<'_> {
        let end = self.left_out.partition_point(|k| *k < n);
        Rows { left_out: &self.left_out[..end], worth: &self.worth }
    }
}

impl Problem {
    /// Samples that count in the loss.
    pub fn rows(&self) -> f64 {
        self.counted().rows(self.y.len()) as f64
    }

    /// The samples that count.
    pub fn counted(&self) -> Counted<'_> {
        Counted { first: self.first, left_out: &self.holes.left_out }
    }

    /// Takes what does not count out of one value for each sample from the first on.
    pub fn blank(&self, values: &mut [f64]) {
        self.holes.left_out.iter().for_each(|k| values[k - self.first] = 0.0);
    }

    /// The values of the samples that count, out of one value for each sample from the first on.
    pub fn counting(&self, values: &[f64]) -> Vec<f64> {
        let counts = |k: usize| self.holes.left_out.binary_search(&(self.first + k)).is_err();
        values.iter().enumerate().filter(|(k, _)| counts(*k)).map(|(_, value)| *value).collect()
    }

    /// The signals of a fit with the given stem position.
    pub fn signals<'s>(&'s self, x: &'s [f64], dir: &'s [f64]) -> Signals<'s> {
        let rows = self.holes.within(self.y.len());
        Signals { y: &self.y, x, dir, start: self.start.index, first: self.first, rows }
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

impl Refined {
    /// What the search minimises: both views of the noise together (ln V).
    pub fn score(&self) -> f64 {
        (self.fit.loss + LOSS_FLOOR).ln() + (self.long_loss + LOSS_FLOOR).ln()
    }
}

/// Buffers of a search, planned once for a window.
#[derive(Clone, Debug)]
pub struct Searcher<'a> {
    pub(super) p: &'a Problem,
    pub(super) screen: Screen,
    pub(super) work: Workspace,
    explorer: Explorer,
    pub(super) x: Vec<f64>,
    pub(super) dir: Vec<f64>,
    pub(super) candidates: Vec<Candidate>,
    pub(super) ranked: Vec<(f64, Orders)>,
    pub(super) running: Vec<Fit>,
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
            screen: Screen::new(&p.y, p.counted(), p.max_delay),
            work: Workspace::new(n),
            explorer: Explorer::new(p.max_delay),
            x: vec![0.0; n],
            dir: vec![0.0; n],
            candidates: Vec::with_capacity(25 * p.max_delay),
            ranked: Vec::with_capacity(15 * p.max_delay),
            running: Vec::with_capacity(50 * p.max_delay),
            fits: 0,
            screened: 0,
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
            // Always further, also where rounding leaves a cell without width.
            f = cell.hi.max(f + least_step).max(f.next_up());
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
        let sound = self.settle_at(0.0, 0.0, 0.0);
        let mut chosen = best_cells(cells, REFINED);
        let mut by_grid: Vec<&GridPoint> = grid.iter().filter(|g| g.f > 0.0).collect();
        by_grid.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        for point in by_grid.iter().take(REFINED / 2) {
            let plain = cells.iter().take_while(|c| c.resume == 0.0);
            chosen.push(plain.take_while(|c| c.cell.lo <= point.f).count().saturating_sub(1));
        }
        chosen.sort_unstable();
        chosen.dedup();
        let mut refined: Vec<Refined> = chosen
            .into_iter()
            .filter(|&at| at > 0)
            .map(|at| self.refine_at(cells[at].f(), cells[at].resume, cells[at].lag))
            .collect();
        refined.sort_by(|a, b| a.score().total_cmp(&b.score()));
        refined.truncate(SETTLED);
        let settled = refined.into_iter().map(|r| self.settle_at(r.f, r.resume, r.long_lag));
        (sound, settled.min_by(|a, b| a.score().total_cmp(&b.score())))
    }

    /// Both fits at one f, the lag of the long ARX tried from `lag`; the structures that the screening ranks first.
    pub fn refine_at(&mut self, f: f64, resume: f64, lag: f64) -> Refined {
        self.fit_at(f, resume, lag, false)
    }

    /// Both fits at one f with every structure started from every view of the noise.
    pub fn settle_at(&mut self, f: f64, resume: f64, lag: f64) -> Refined {
        self.fit_at(f, resume, lag, true)
    }

    fn fit_at(&mut self, f: f64, resume: f64, lag: f64, thorough: bool) -> Refined {
        let cell = self.run_element(f, resume);
        let s = self.p.signals(&self.x, &self.dir);
        self.screen.load(&s, f > 0.0);
        let long = self.screen.fit_lag(lag, f);
        let mode = if f > 0.0 { Lag::Free { max: f } } else { Lag::Fixed };
        self.running.clear();
        // Starts without and with the lag: the loss is not convex in it.
        for start in [0.0, long.lag] {
            if start == 0.0 && !self.running.is_empty() {
                continue;
            }
            self.screen.load_errors(&s, start);
            self.candidates.clear();
            let candidates = &mut self.candidates;
            self.screen.fit_all(|c| candidates.push(c));
            self.screened += candidates.len();
            if thorough {
                candidates.extend(self.explorer.explore(&mut self.work, &s, start));
            } else {
                candidates.select_nth_unstable_by(FITTED - 1, |a, b| a.loss.total_cmp(&b.loss));
                candidates.truncate(FITTED);
            }
            self.running.extend(candidates.iter().map(|c| c.start(start)));
        }
        self.fits += self.running.len();
        let rounds: &Rounds = if thorough { &LONG_RACE } else { &SHORT_RACE };
        let mut fit = race(&mut self.work, &s, &mut self.running, mode, rounds, PRECISE);
        for _ in 0..if thorough { RESCREENS } else { 0 } {
            let before = fit.loss;
            self.running.clear();
            rescreen(&mut self.screen, &mut self.work, &s, &fit, &mut self.candidates);
            self.running.extend(self.candidates.iter().map(|c| c.start(fit.theta.lag)));
            self.running.push(fit);
            self.fits += self.running.len();
            fit = race(&mut self.work, &s, &mut self.running, mode, &RESCREEN_RACE, PRECISE);
            if fit.loss > before * (1.0 - 10.0 * PRECISE) {
                break;
            }
        }
        Refined { cell, resume, f, fit, long_loss: long.loss, long_lag: long.lag }
    }

    /// The prediction errors of a refined model, from its first counted sample on, and its stem position.
    pub fn errors(&mut self, refined: &Refined) -> (Vec<f64>, Vec<f64>) {
        self.run_element(refined.f, refined.resume);
        let s = self.p.signals(&self.x, &self.dir);
        self.work.evaluate(&s, refined.fit.orders, &refined.fit.theta);
        let stem = self.x.iter().zip(&self.dir).map(|(x, d)| x - refined.fit.theta.lag * d).collect();
        let mut errors = self.work.errors()[self.p.first..].to_vec();
        self.p.blank(&mut errors);
        (errors, stem)
    }

    /// Runs the friction element over OP.
    pub(super) fn run_element(&mut self, f: f64, resume: f64) -> Cell {
        stick_slip(&self.p.u, f, resume, self.p.start, &mut self.x, &mut self.dir)
    }
}

/// The best minimum from several starts, in `running`: a few iterations for each in every round, then only the
/// leaders to the end; these are left in `running`, the best first.
pub(super) fn race(
    work: &mut Workspace,
    s: &Signals<'_>,
    running: &mut Vec<Fit>,
    lag: Lag,
    rounds: &Rounds,
    tolerance: f64,
) -> Fit {
    for &(iterations, leaders) in rounds {
        advance(work, s, running, lag, ROUGH, iterations);
        running.truncate(leaders);
    }
    advance(work, s, running, lag, tolerance, FINAL);
    running.first().copied().unwrap_or(Fit {
        orders: Orders { na: 1, nb: 1, nc: 0, nk: 1 },
        theta: Theta::default(),
        loss: f64::INFINITY,
        iterations: 0,
    })
}

/// The structures that fit best with the errors of `best`, in `candidates`: a long ARX cannot follow a zero of C near
/// the unit circle, and ranks the structures that have one too low.
pub(super) fn rescreen(
    screen: &mut Screen,
    work: &mut Workspace,
    s: &Signals<'_>,
    best: &Fit,
    candidates: &mut Vec<Candidate>,
) {
    work.evaluate(s, best.orders, &best.theta);
    screen.reload_errors(s, best.theta.lag, work.errors());
    candidates.clear();
    screen.fit_all(|c| candidates.push(c));
    let most = RESCREENED.min(candidates.len());
    candidates.select_nth_unstable_by(most - 1, |a, b| a.loss.total_cmp(&b.loss));
    candidates.truncate(most);
    candidates.sort_unstable_by(|a, b| a.loss.total_cmp(&b.loss));
}

/// Iterates every fit and sorts them by loss.
fn advance(work: &mut Workspace, s: &Signals<'_>, fits: &mut [Fit], lag: Lag, tolerance: f64, most: usize) {
    for fit in fits.iter_mut() {
        *fit = work.minimise(s, fit.orders, fit.theta, lag, tolerance, most);
    }
    fits.sort_by(|a, b| a.loss.total_cmp(&b.loss));
}

/// The `most` best cells that are local minima of the profile.
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
