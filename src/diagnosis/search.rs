//! The search over f: the paper's grid of ARMAX fits, the exact profile over f, and the refinement of the best of both.
//!
//! 1. [`Searcher::grid`]: the ARMAX loss at equally spaced values of f (`grid.rs`).
//! 2. [`Searcher::profile`]: the loss of a long ARX in every [`Cell`]. A cell is a range of f with one and the same stem, so
//!    sampled data cannot tell its values apart. At low noise the minimum is one cell wide, and a grid misses it.
//! 3. [`Searcher::refine`]: ARMAX fits with a kinetic lag in the best cells of both. The best of these are *settled*: fitted from
//!    all starts. The estimate has the least `AIC(ARMAX) + AIC(long ARX)`, because the two models err in different places.
//!
//! Many fits compete by successive halving: a few iterations for all of them, then the best go on.

use super::armax::{Fit, LOSS_FLOOR, Lag, Orders, Rows, Signals, Theta, Workspace};
use super::friction::{Cell, Start, reversals, stick_slip};
use super::lagged_products::Counted;
use super::noise_models::Library;
use super::screen::{Candidate, Screen};
use crate::signal::{Row, Window};

/// Most cells of the paper's element that the profile visits; more are thinned evenly in f.
const MOST_CELLS: usize = 1000;
/// Resume thresholds J/S of the extended elements; 0 is the paper's.
const RESUMES: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
/// Most cells of an extended element on the first, coarse pass.
const COARSE_CELLS: usize = 80;
/// Most cells around the best of it on the second, fine pass.
const FINE_CELLS: usize = 60;
/// Coarse steps to each side of the best that the second pass covers.
const FINE_REACH: f64 = 3.0;
/// Fewest reversals of the stem in a window from which f is estimated: those of two cycles.
pub const LEAST_REVERSALS: usize = 4;
/// Structures fitted at each cell of the refinement: the best by the screening.
const FITTED: usize = 12;
/// Relative decrease of the loss at which a rough minimisation ends: 0.1 in N ln V of 1,000 samples.
pub(super) const ROUGH: f64 = 1e-4;
/// Relative decrease of the loss at which a minimisation that decides ends: 0.001 in N ln V.
pub(super) const PRECISE: f64 = 1e-6;
/// Most iterations of a minimisation that is to converge.
pub(super) const FINAL: usize = 40;
/// Rounds of successive halving: iterations of each fit, and how many fits go on.
pub(super) type Rounds = [(usize, usize)];
/// Rounds where a cell is refined.
const SHORT_RACE: [(usize, usize); 1] = [(2, 4)];
/// Rounds where a cell is settled, with every start.
const LONG_RACE: [(usize, usize); 2] = [(2, 60), (3, 16)];
/// Rounds of the structures that start again with the errors of the best model.
const RESCREEN_RACE: [(usize, usize); 1] = [(2, 6)];
/// Structures that start again with the errors of the best model.
const RESCREENED: usize = 40;
/// Most repetitions of that.
const RESCREENS: usize = 3;
/// Cells of the exact profile that are refined; of the grid's values half as many.
const REFINED: usize = 10;
/// Best cells among them that are settled.
const SETTLED: usize = 2;

/// One window, normalised to zero mean and unit variance, ready for the search.
#[derive(Clone, Debug)]
pub struct Problem {
    /// OP (standard deviations of OP).
    pub u: Vec<f64>,
    /// PV (standard deviations of PV).
    pub y: Vec<f64>,
    /// The extremum of OP at which the friction element starts.
    pub start: Start,
    /// First sample that counts in the loss.
    pub first: usize,
    /// Longest delay that is searched (samples).
    pub max_delay: usize,
    /// Largest f at which the stem still reverses (standard deviations of OP).
    pub f_top: f64,
    /// The samples that do not count.
    pub holes: Holes,
}

/// The samples of a window that do not count, from which [`armax::Rows`](super::armax::Rows) are made.
#[derive(Clone, Debug, Default)]
pub struct Holes {
    /// Their indices from the first sample that counts on, in order.
    left_out: Vec<usize>,
    /// The kind of every sample; empty where all count.
    worth: Vec<Row>,
}

impl Holes {
    /// The samples of a window that do not count, where `first` is the first one that may.
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

    /// The same for a fit to the first `n` samples.
    pub fn within(&self, n: usize) -> Rows<'_> {
        let end = self.left_out.partition_point(|k| *k < n);
        Rows { left_out: &self.left_out[..end], worth: &self.worth }
    }
}

impl Problem {
    /// The number N of samples that count in the loss.
    pub fn rows(&self) -> f64 {
        self.counted().rows(self.y.len()) as f64
    }

    /// The samples that count.
    pub fn counted(&self) -> Counted<'_> {
        Counted { first: self.first, left_out: &self.holes.left_out }
    }

    /// Sets the values of samples that do not count to 0; `values` has one for each sample from [`Problem::first`] on.
    pub fn blank(&self, values: &mut [f64]) {
        self.holes.left_out.iter().for_each(|k| values[k - self.first] = 0.0);
    }

    /// The values of the samples that count; `values` has one for each sample from [`Problem::first`] on.
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

/// One value of f of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridPoint {
    /// Friction f (unit of the problem's OP).
    pub f: f64,
    /// Least ARMAX loss V over splits and delays; that of the screening where no fit was made.
    pub loss: f64,
}

/// The long ARX in one cell of f.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellPoint {
    /// The range of f with this stem.
    pub cell: Cell,
    /// Resume threshold J/S of the element (-).
    pub resume: f64,
    /// Least loss V over the kinetic lag.
    pub loss: f64,
    /// The kinetic lag at that minimum (unit of the problem's OP).
    pub lag: f64,
}

impl CellPoint {
    /// The f that stands for the cell: its middle, or its lower end when it has no upper one.
    pub fn f(&self) -> f64 {
        if self.cell.hi.is_finite() { 0.5 * (self.cell.lo + self.cell.hi) } else { self.cell.lo }
    }
}

/// The ARMAX model and the long ARX at one f.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refined {
    /// The range of f with this stem.
    pub cell: Cell,
    /// Resume threshold J/S of the element (-).
    pub resume: f64,
    /// Friction f (unit of the problem's OP).
    pub f: f64,
    /// The ARMAX fit, with its kinetic lag.
    pub fit: Fit,
    /// Loss V of the long ARX.
    pub long_loss: f64,
    /// Kinetic lag of the long ARX.
    pub long_lag: f64,
}

impl Refined {
    /// What the search minimises: `ln V(ARMAX) + ln V(long ARX)`.
    pub fn score(&self) -> f64 {
        (self.fit.loss + LOSS_FLOOR).ln() + (self.long_loss + LOSS_FLOOR).ln()
    }
}

/// The search of one problem, with its buffers.
#[derive(Clone, Debug)]
pub struct Searcher<'a> {
    pub(super) p: &'a Problem,
    pub(super) screen: Screen,
    pub(super) work: Workspace,
    library: Library,
    /// The present stem, before the kinetic lag.
    pub(super) x: Vec<f64>,
    /// Direction of its last move.
    pub(super) dir: Vec<f64>,
    pub(super) candidates: Vec<Candidate>,
    pub(super) ranked: Vec<(f64, Orders)>,
    /// The fits that compete.
    pub(super) running: Vec<Fit>,
    /// Prediction-error minimisations so far.
    pub fits: usize,
    /// Structures screened so far.
    pub screened: usize,
}

impl<'a> Searcher<'a> {
    /// A search of the problem; it allocates all buffers.
    pub fn new(p: &'a Problem) -> Self {
        let n = p.y.len();
        Self {
            p,
            screen: Screen::new(&p.y, p.counted(), p.max_delay),
            work: Workspace::new(n),
            library: Library::new(p.max_delay),
            x: vec![0.0; n],
            dir: vec![0.0; n],
            candidates: Vec::with_capacity(25 * p.max_delay),
            ranked: Vec::with_capacity(15 * p.max_delay),
            running: Vec::with_capacity(50 * p.max_delay),
            fits: 0,
            screened: 0,
        }
    }

    /// The profile over f: the long ARX with its best kinetic lag in the cells between the f `from` and `to`.
    ///
    /// * `resume`: resume threshold J/S of the element (-).
    /// * `most`: largest number of cells; more are thinned evenly in f.
    ///
    /// It ends where the stem reverses too seldom.
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
            // f always increases, also where rounding leaves a cell without width.
            f = cell.hi.max(f + least_step).max(f.next_up());
        }
        points
    }

    /// The profile over all f: every cell of the paper's element, then the extended elements coarsely, and finely around the best
    /// of each. The first point is f = 0.
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
    /// Returns the model without friction, and the best model with friction; `None` where there is no cell beyond f = 0.
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

    /// The ARMAX model and the long ARX at one f, of the structures that the screening ranks first.
    ///
    /// * `lag`: where the kinetic lag of the long ARX starts.
    pub fn refine_at(&mut self, f: f64, resume: f64, lag: f64) -> Refined {
        self.fit_at(f, resume, lag, false)
    }

    /// The same with every structure, started from the screening and from the library of noise models.
    pub fn settle_at(&mut self, f: f64, resume: f64, lag: f64) -> Refined {
        self.fit_at(f, resume, lag, true)
    }

    /// [`Searcher::settle_at`] where `thorough`, else [`Searcher::refine_at`].
    fn fit_at(&mut self, f: f64, resume: f64, lag: f64, thorough: bool) -> Refined {
        let cell = self.run_element(f, resume);
        let s = self.p.signals(&self.x, &self.dir);
        self.screen.load(&s, f > 0.0);
        let long = self.screen.fit_lag(lag, f);
        let mode = if f > 0.0 { Lag::Free { max: f } } else { Lag::Fixed };
        self.running.clear();
        // Starts without the lag and with it, because the loss may have a minimum at each.
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
                candidates.extend(self.library.best_models(&mut self.work, &s, start));
            } else {
                candidates.select_nth_unstable_by(FITTED - 1, |a, b| a.loss.total_cmp(&b.loss));
                candidates.truncate(FITTED);
            }
            self.running.extend(candidates.iter().map(|c| c.start(start)));
        }
        self.fits += self.running.len();
        let rounds: &Rounds = if thorough { &LONG_RACE } else { &SHORT_RACE };
        let mut fit = successive_halving(&mut self.work, &s, &mut self.running, mode, rounds, PRECISE);
        for _ in 0..if thorough { RESCREENS } else { 0 } {
            let before = fit.loss;
            self.running.clear();
            screen_with_errors_of(&mut self.screen, &mut self.work, &s, &fit, &mut self.candidates);
            self.running.extend(self.candidates.iter().map(|c| c.start(fit.theta.lag)));
            self.running.push(fit);
            self.fits += self.running.len();
            fit = successive_halving(&mut self.work, &s, &mut self.running, mode, &RESCREEN_RACE, PRECISE);
            if fit.loss > before * (1.0 - 10.0 * PRECISE) {
                break;
            }
        }
        Refined { cell, resume, f, fit, long_loss: long.loss, long_lag: long.lag }
    }

    /// The prediction errors of a refined model, one for each sample from [`Problem::first`] on, and its stem for all samples.
    pub fn errors(&mut self, refined: &Refined) -> (Vec<f64>, Vec<f64>) {
        self.run_element(refined.f, refined.resume);
        let s = self.p.signals(&self.x, &self.dir);
        self.work.evaluate(&s, refined.fit.orders, &refined.fit.theta);
        let stem = self.x.iter().zip(&self.dir).map(|(x, d)| x - refined.fit.theta.lag * d).collect();
        let mut errors = self.work.errors()[self.p.first..].to_vec();
        self.p.blank(&mut errors);
        (errors, stem)
    }

    /// Runs the friction element over OP; the stem is left in `x` and `dir`.
    pub(super) fn run_element(&mut self, f: f64, resume: f64) -> Cell {
        stick_slip(&self.p.u, f, resume, self.p.start, &mut self.x, &mut self.dir)
    }
}

/// The best of several fits, by successive halving: in every round each fit gets a few iterations, and the best go on. The last
/// ones are fitted to the end and left in `running`, the best first.
pub(super) fn successive_halving(
    work: &mut Workspace,
    s: &Signals<'_>,
    running: &mut Vec<Fit>,
    lag: Lag,
    rounds: &Rounds,
    tolerance: f64,
) -> Fit {
    for &(iterations, leaders) in rounds {
        iterate(work, s, running, lag, ROUGH, iterations);
        running.truncate(leaders);
    }
    iterate(work, s, running, lag, tolerance, FINAL);
    running.first().copied().unwrap_or(Fit {
        orders: Orders { na: 1, nb: 1, nc: 0, nk: 1 },
        theta: Theta::default(),
        loss: f64::INFINITY,
        iterations: 0,
    })
}

/// Screens all structures with the prediction errors of `best`, and puts those with the least losses into `candidates`.
///
/// The errors of the long ARX rank structures with a zero of C near the unit circle too low, because it cannot follow such a zero.
pub(super) fn screen_with_errors_of(
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

/// Iterates every fit and sorts the fits by loss.
fn iterate(work: &mut Workspace, s: &Signals<'_>, fits: &mut [Fit], lag: Lag, tolerance: f64, most: usize) {
    for fit in fits.iter_mut() {
        *fit = work.minimise(s, fit.orders, fit.theta, lag, tolerance, most);
    }
    fits.sort_by(|a, b| a.loss.total_cmp(&b.loss));
}

/// The indices of the `most` best cells among the local minima of the profile.
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
