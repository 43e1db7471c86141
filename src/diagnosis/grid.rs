//! The paper's grid search: at each of 101 values of f the least ARMAX loss over all structures.
//!
//! A *structure* is a split of the orders and a delay. To *screen* is to compute the loss of a structure by Hannan–Rissanen least
//! squares ([`super::screen`]), which is cheap and above the loss of the prediction-error fit.
//!
//! 1. Every value of f is screened with every structure.
//! 2. Every tenth value is fitted by prediction error. There the ratio of the two losses is known. It changes slowly with f, so it
//!    predicts the loss at the values between.
//! 3. The values with the least predicted losses are fitted, from their own starts and from the models at neighbouring values.
//!    Values whose predicted loss is far from the least keep the loss of the screening.
//! 4. At the value with the least loss nearly every structure is fitted. The best models are then continued along f, each value
//!    from the coefficients at the one before. This is repeated until the least loss stays at its place.

use super::armax::{Fit, LOSS_FLOOR, Lag};
use super::friction::Cell;
use super::search::{GridPoint, PRECISE, ROUGH, Searcher, screen_with_errors_of, successive_halving};

/// Values of f in the paper's grid.
pub const GRID: usize = 101;
/// Every tenth value is fitted thoroughly, whatever its screening says: the ratio of the two losses changes slowly with f.
const COARSE: usize = 10;
/// Values that are fitted thoroughly beside these, the least predicted loss first.
const THOROUGH: usize = 8;
/// Values that are fitted at all beside these; those that are not fitted thoroughly are fitted quickly.
const QUICK: usize = 20;
/// Structures that start where a value is fitted thoroughly: the best by the screening.
const STARTS: usize = 8;
/// Structures that start at every tenth value: these fits only show the ratio of the two losses.
const COARSE_STARTS: usize = 4;
/// Structures that start again with the errors of the best fit: the long ARX ranks some of them too low.
const AGAIN: usize = 5;
/// Values near the least loss that are fitted thoroughly at the end, because the least may lie beside it.
const SECOND_LOOKS: usize = 2;
/// Largest distance of these from the least (values of the grid).
const REACH: usize = 3;
/// Distance of the predicted loss above the least, in N ln V, beyond which a value is not fitted: no fit gains as much.
const HOPELESS: f64 = 100.0;
/// Rounds of successive halving where a value is fitted thoroughly.
const THOROUGH_RACE: [(usize, usize); 1] = [(3, 2)];
/// Rounds where it is fitted quickly.
const QUICK_RACE: [(usize, usize); 1] = [(2, 1)];
/// Rounds where every structure is fitted.
const EVERY_RACE: [(usize, usize); 2] = [(2, 30), (3, 8)];
/// Rounds of those that start there with the errors of the best.
const RESCREEN_RACE: [(usize, usize); 1] = [(2, 3)];
/// Structures that start at the first such place, and at the others; there are 15 splits with up to 10 delays each.
const EVERY: [usize; 2] = [100, 40];
/// Structures that start there with the errors of the best.
const RESCREENED: usize = 8;
/// Places where every structure is fitted, at most: it bounds the time where no f is much better than the next.
const PLACES: usize = 3;
/// Number of fits after which no other such place is taken: it bounds the time, too.
const MOST_FITS: usize = 500;
/// Models of different structure that are continued along f from such a place.
const CARRIED: usize = 2;
/// Iterations of each model at each value: it begins with the coefficients at the value before.
const CARRY: usize = 2;
/// Values in a row after which a model that is far from the best is not continued.
const PATIENCE: usize = 2;
/// Distance up to which it is near the best (N ln V).
const NEAR: f64 = 20.0;

/// The result of screening one value.
#[derive(Clone, Copy)]
struct Screened {
    /// The range of f with the same stem.
    cell: Cell,
    /// The structure with the least loss, as a start.
    start: Fit,
}

impl Searcher<'_> {
    /// The least ARMAX loss at `values` equally spaced values of f from 0 to `f_top` (unit of the problem's OP).
    pub fn grid(&mut self, values: usize) -> Vec<GridPoint> {
        let step = self.p.f_top / (values.max(2) - 1) as f64;
        let mut points: Vec<GridPoint> =
            (0..values).map(|i| GridPoint { f: step * i as f64, loss: f64::INFINITY }).collect();
        let screened = self.screen_all(&mut points);
        let mut fits: Vec<Option<Fit>> = vec![None; values];
        let mut is_thorough: Vec<bool> = (0..values).map(|i| i % COARSE == 0).collect();
        for i in (0..values).step_by(COARSE) {
            self.fit_value(&mut points, &mut fits, &screened, i, COARSE_STARTS);
        }
        let mut order: Vec<(f64, usize)> = (0..values)
            .filter(|&i| fits[i].is_none())
            .map(|i| (predicted(&points, &fits, &screened, i), i))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        // All values of one cell have the same stem, so the same model.
        order.retain(|&(_, i)| screened[i - 1].cell != screened[i].cell);
        for (rank, &(predicted, i)) in order.iter().take(QUICK).enumerate() {
            if predicted > least(&points).1 * (HOPELESS / self.p.rows()).exp() {
                break;
            }
            self.fit_value(&mut points, &mut fits, &screened, i, if rank < THOROUGH { STARTS } else { 0 });
            is_thorough[i] = rank < THOROUGH;
        }
        for _ in 0..SECOND_LOOKS {
            let (at, _) = least(&points);
            let near = at.saturating_sub(REACH)..(at + REACH + 1).min(values);
            let Some(i) = near.filter(|&i| !is_thorough[i]).min_by_key(|i| i.abs_diff(at)) else { break };
            self.fit_value(&mut points, &mut fits, &screened, i, STARTS);
            is_thorough[i] = true;
        }
        self.fit_around_least(&mut points, &fits);
        for i in 1..values {
            if screened[i - 1].cell == screened[i].cell {
                points[i].loss = points[i - 1].loss;
            }
        }
        points
    }

    /// Screens every value and takes its least loss for that value, until a fit has a lesser one.
    fn screen_all(&mut self, points: &mut [GridPoint]) -> Vec<Screened> {
        let mut screened: Vec<Screened> = Vec::with_capacity(points.len());
        for point in points {
            let cell = self.run_element(point.f, 0.0);
            match screened.last() {
                Some(known) if known.cell == cell => screened.push(*known),
                _ => {
                    let start = self.screen_stem(1)[0];
                    screened.push(Screened { cell, start });
                }
            }
            point.loss = screened[screened.len() - 1].start.loss + LOSS_FLOOR;
        }
        screened
    }

    /// The `most` best structures by Hannan–Rissanen at the present stem, as starts; they are left in `running`.
    fn screen_stem(&mut self, most: usize) -> &[Fit] {
        let s = self.p.signals(&self.x, &self.dir);
        self.screen.load(&s, false);
        self.screen.load_errors(&s, 0.0);
        self.ranked.clear();
        let ranked = &mut self.ranked;
        self.screen.rank_all(|orders, loss| ranked.push((loss, orders)));
        self.screened += ranked.len();
        let most = most.min(ranked.len());
        ranked.select_nth_unstable_by(most - 1, |a, b| a.0.total_cmp(&b.0));
        self.running.clear();
        self.running.extend(ranked[..most].iter().map(|(_, orders)| self.screen.fit(*orders).start(0.0)));
        &self.running
    }

    /// Fits value `i` from its own starts and from the models at the nearest values that have one.
    ///
    /// * `starts`: number of structures that start by the screening; 0 fits the value quickly, from the best of the screening
    ///   alone.
    ///   Else some structures start again with the errors of the best fit.
    fn fit_value(
        &mut self,
        points: &mut [GridPoint],
        fits: &mut [Option<Fit>],
        screened: &[Screened],
        i: usize,
        starts: usize,
    ) {
        self.run_element(points[i].f, 0.0);
        let thorough = starts > 0;
        if thorough {
            self.screen_stem(starts);
        } else {
            self.running.clear();
            self.running.push(screened[i].start);
        }
        let s = self.p.signals(&self.x, &self.dir);
        let (running, candidates) = (&mut self.running, &mut self.candidates);
        let (below, above) = neighbours(fits, i);
        running.extend(below.and_then(|at| fits[at]));
        running.extend(above.and_then(|at| fits[at]));
        self.fits += running.len();
        let rounds = if thorough { &THOROUGH_RACE } else { &QUICK_RACE };
        let mut best = successive_halving(&mut self.work, &s, running, Lag::Fixed, rounds, ROUGH);
        if thorough {
            screen_with_errors_of(&mut self.screen, &mut self.work, &s, &best, candidates);
            running.clear();
            running.push(best);
            running.extend(candidates.iter().take(AGAIN).map(|c| c.start(0.0)));
            self.fits += running.len();
            best = successive_halving(&mut self.work, &s, running, Lag::Fixed, &THOROUGH_RACE, ROUGH);
        }
        if fits[i].is_none_or(|known| best.loss < known.loss) {
            points[i].loss = best.loss + LOSS_FLOOR;
            fits[i] = Some(best);
        }
    }

    /// Fits nearly every structure at the value with the least loss, and continues the best models along f, until the least loss
    /// stays at its place.
    fn fit_around_least(&mut self, points: &mut [GridPoint], fits: &[Option<Fit>]) {
        let mut places: Vec<usize> = Vec::with_capacity(PLACES);
        for _ in 0..PLACES {
            let (at, _) = least(points);
            if places.contains(&at) || self.fits > MOST_FITS {
                return;
            }
            places.push(at);
            let starts = EVERY[usize::from(places.len() > 1)];
            let leaders = self.fit_structures(points[at].f, fits[at], starts);
            if let Some(best) = leaders.first() {
                points[at].loss = points[at].loss.min(best.loss + LOSS_FLOOR);
            }
            for leader in leaders {
                self.continue_along(points, (at + 1)..points.len(), leader);
                self.continue_along(points, (0..at).rev(), leader);
            }
        }
    }

    /// The best models of different structure at one f.
    ///
    /// * `known`: a model that is fitted there already.
    /// * `starts`: number of structures that start.
    fn fit_structures(&mut self, f: f64, known: Option<Fit>, starts: usize) -> Vec<Fit> {
        self.run_element(f, 0.0);
        self.screen_stem(starts);
        let s = self.p.signals(&self.x, &self.dir);
        let running = &mut self.running;
        running.extend(known);
        self.fits += running.len();
        let best = successive_halving(&mut self.work, &s, running, Lag::Fixed, &EVERY_RACE, PRECISE);
        let mut leaders = running.clone();
        screen_with_errors_of(&mut self.screen, &mut self.work, &s, &best, &mut self.candidates);
        running.clear();
        running.extend(self.candidates.iter().take(RESCREENED).map(|c| c.start(0.0)));
        self.fits += running.len();
        successive_halving(&mut self.work, &s, running, Lag::Fixed, &RESCREEN_RACE, PRECISE);
        leaders.extend_from_slice(running);
        leaders.sort_by(|a, b| a.loss.total_cmp(&b.loss));
        let mut different: Vec<Fit> = Vec::with_capacity(CARRIED);
        for leader in leaders {
            if different.len() < CARRIED && different.iter().all(|d| d.orders != leader.orders) {
                different.push(leader);
            }
        }
        different
    }

    /// Fits one structure at value after value, each from the coefficients at the value before (continuation).
    ///
    /// It ends where the model is far from the best at several values in a row.
    fn continue_along(
        &mut self,
        points: &mut [GridPoint],
        along: impl Iterator<Item = usize>,
        mut model: Fit,
    ) {
        let mut far = 0;
        for i in along {
            self.run_element(points[i].f, 0.0);
            let s = self.p.signals(&self.x, &self.dir);
            model = self.work.minimise(&s, model.orders, model.theta, Lag::Fixed, ROUGH, CARRY);
            self.fits += 1;
            let loss = model.loss + LOSS_FLOOR;
            points[i].loss = points[i].loss.min(loss);
            far = if loss > least(points).1 * (NEAR / self.p.rows()).exp() { far + 1 } else { 0 };
            if far > PATIENCE {
                return;
            }
        }
    }
}

/// The index of the value with the least loss, and that loss.
fn least(points: &[GridPoint]) -> (usize, f64) {
    let losses = points.iter().map(|p| p.loss).enumerate();
    losses.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY))
}

/// The indices of the nearest values with a fit, below and above.
fn neighbours(fits: &[Option<Fit>], i: usize) -> (Option<usize>, Option<usize>) {
    let below = (0..i).rev().find(|&at| fits[at].is_some());
    (below, (i + 1..fits.len()).find(|&at| fits[at].is_some()))
}

/// The predicted loss of a value that is only screened: its screening loss over the ratio of the two losses at its neighbours.
///
/// The logarithm of the ratio is interpolated linearly.
fn predicted(points: &[GridPoint], fits: &[Option<Fit>], screened: &[Screened], i: usize) -> f64 {
    let ratio_at = |at: usize| (screened[at].start.loss + LOSS_FLOOR) / points[at].loss;
    let ratio = match neighbours(fits, i) {
        (Some(a), Some(b)) => {
            let share = (i - a) as f64 / (b - a) as f64;
            ((1.0 - share) * ratio_at(a).ln() + share * ratio_at(b).ln()).exp()
        }
        (Some(at), None) | (None, Some(at)) => ratio_at(at),
        (None, None) => 1.0,
    };
    (screened[i].start.loss + LOSS_FLOOR) / ratio
}
