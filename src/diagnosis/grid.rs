//! The paper's pass over f: at each of 101 values the least ARMAX loss over every split and delay.
//!
//! First every value is screened with every structure. A few spread over f are fitted by prediction error: how far
//! the screening overstates the loss differs from place to place. Then the others are, the most promising first,
//! from their own starts and from the models next to them, not at all what is hopeless.
//! Where the loss is least nearly every structure is fitted, and what wins there is carried along f, until the least
//! stays the least.

use super::armax::{Fit, LOSS_FLOOR, Lag};
use super::friction::Cell;
use super::search::{GridPoint, PRECISE, ROUGH, Searcher, race, rescreen};

/// Values of f in the paper's grid.
pub const GRID: usize = 101;
/// Every which value is fitted thoroughly whatever its screening says: how far that overstates the loss changes slowly with f.
const COARSE: usize = 10;
/// Values that are fitted thoroughly beside these, the least expected loss first.
const THOROUGH: usize = 8;
/// Values that are fitted at all beside these: the others quickly.
const QUICK: usize = 20;
/// Structures that start where a value is fitted thoroughly: the best by the screening.
const STARTS: usize = 8;
/// Structures that start at the values fitted whatever their screening says: these only tell how far it overstates.
const COARSE_STARTS: usize = 4;
/// Structures that start again from the errors of the best: the long ARX ranks some of them too low.
const AGAIN: usize = 5;
/// Values next to the least that are looked at a second time: thoroughly, because the least may lie beside it.
const SECOND_LOOKS: usize = 2;
/// How near to the least they are (values).
const REACH: usize = 3;
/// Distance in N ln V above the best at which a value is expected to be hopeless: no fit is expected to make up for it.
const HOPELESS: f64 = 100.0;
/// Rounds where a value is fitted thoroughly.
const THOROUGH_RACE: [(usize, usize); 1] = [(3, 2)];
/// Rounds where it is fitted quickly.
const QUICK_RACE: [(usize, usize); 1] = [(2, 1)];
/// Rounds where every structure is fitted.
const EVERY_RACE: [(usize, usize); 2] = [(2, 30), (3, 8)];
/// Rounds of those that start there from the errors of the best.
const RESCREEN_RACE: [(usize, usize); 1] = [(2, 3)];
/// Structures that start at the first such place, of 15 splits with up to 10 delays each, and at the others.
const EVERY: [usize; 2] = [100, 40];
/// Structures that start there from the errors of the best.
const RESCREENED: usize = 8;
/// Places where every structure is fitted, at most: it bounds the time where no f is much better than the next.
const PLACES: usize = 3;
/// Fits after which there is no other such place: it bounds the time, too.
const MOST_FITS: usize = 500;
/// Models of different structure that are carried along f from such a place.
const CARRIED: usize = 2;
/// Iterations of each at each value: it begins with the coefficients at the one before.
const CARRY: usize = 2;
/// Values in a row that a model is carried on while it is far from the best.
const PATIENCE: usize = 2;
/// Distance up to which it is near (N ln V).
const NEAR: f64 = 20.0;

/// What screening one value left.
#[derive(Clone, Copy)]
struct Screened {
    cell: Cell,
    start: Fit,
}

impl Searcher<'_> {
    /// The least ARMAX loss at `values` points of f from 0 to `f_top`.
    pub fn grid(&mut self, values: usize) -> Vec<GridPoint> {
        let step = self.p.f_top / (values.max(2) - 1) as f64;
        let mut points: Vec<GridPoint> =
            (0..values).map(|i| GridPoint { f: step * i as f64, loss: f64::INFINITY }).collect();
        let screened = self.screen_all(&mut points);
        let mut fits: Vec<Option<Fit>> = vec![None; values];
        let mut looked: Vec<bool> = (0..values).map(|i| i % COARSE == 0).collect();
        for i in (0..values).step_by(COARSE) {
            self.at_value(&mut points, &mut fits, &screened, i, COARSE_STARTS);
        }
        let mut order: Vec<(f64, usize)> = (0..values)
            .filter(|&i| fits[i].is_none())
            .map(|i| (expected(&points, &fits, &screened, i), i))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Values of one cell are one model.
        order.retain(|&(_, i)| screened[i - 1].cell != screened[i].cell);
        for (rank, &(expected, i)) in order.iter().take(QUICK).enumerate() {
            if expected > least(&points).1 * (HOPELESS / self.p.rows()).exp() {
                break;
            }
            self.at_value(&mut points, &mut fits, &screened, i, if rank < THOROUGH { STARTS } else { 0 });
            looked[i] = rank < THOROUGH;
        }
        for _ in 0..SECOND_LOOKS {
            let (at, _) = least(&points);
            let near = at.saturating_sub(REACH)..(at + REACH + 1).min(values);
            let Some(i) = near.filter(|&i| !looked[i]).min_by_key(|i| i.abs_diff(at)) else { break };
            self.at_value(&mut points, &mut fits, &screened, i, STARTS);
            looked[i] = true;
        }
        self.settle(&mut points, &fits);
        for i in 1..values {
            if screened[i - 1].cell == screened[i].cell {
                points[i].loss = points[i - 1].loss;
            }
        }
        points
    }

    /// Screens every value; its loss becomes the value's until a better one is known.
    fn screen_all(&mut self, points: &mut [GridPoint]) -> Vec<Screened> {
        let mut screened: Vec<Screened> = Vec::with_capacity(points.len());
        for point in points {
            let cell = self.run_element(point.f, 0.0);
            match screened.last() {
                Some(known) if known.cell == cell => screened.push(*known),
                _ => {
                    let start = self.screen_present(1)[0];
                    screened.push(Screened { cell, start });
                }
            }
            point.loss = screened[screened.len() - 1].start.loss + LOSS_FLOOR;
        }
        screened
    }

    /// The best Hannan–Rissanen fits at the present stem position, in `running`.
    fn screen_present(&mut self, most: usize) -> &[Fit] {
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

    /// Fits one value from its own start and from the models at the nearest values that have one; where `starts` is
    /// not 0 as many of the screening's best structures start here, and again those by the errors of the best.
    fn at_value(
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
            self.screen_present(starts);
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
        let mut best = race(&mut self.work, &s, running, Lag::Fixed, rounds, ROUGH);
        if thorough {
            rescreen(&mut self.screen, &mut self.work, &s, &best, candidates);
            running.clear();
            running.push(best);
            running.extend(candidates.iter().take(AGAIN).map(|c| c.start(0.0)));
            self.fits += running.len();
            best = race(&mut self.work, &s, running, Lag::Fixed, &THOROUGH_RACE, ROUGH);
        }
        if fits[i].is_none_or(|known| best.loss < known.loss) {
            points[i].loss = best.loss + LOSS_FLOOR;
            fits[i] = Some(best);
        }
    }

    /// Fits every structure where the loss is least and carries what wins along f, until the least stays the least.
    fn settle(&mut self, points: &mut [GridPoint], fits: &[Option<Fit>]) {
        let mut places: Vec<usize> = Vec::with_capacity(PLACES);
        for _ in 0..PLACES {
            let (at, _) = least(points);
            if places.contains(&at) || self.fits > MOST_FITS {
                return;
            }
            places.push(at);
            let starts = EVERY[usize::from(places.len() > 1)];
            let leaders = self.every_structure(points[at].f, fits[at], starts);
            if let Some(best) = leaders.first() {
                points[at].loss = points[at].loss.min(best.loss + LOSS_FLOOR);
            }
            for leader in leaders {
                self.carry(points, (at + 1)..points.len(), leader);
                self.carry(points, (0..at).rev(), leader);
            }
        }
    }

    /// The best models of different structure at one f, `starts` of them tried.
    fn every_structure(&mut self, f: f64, known: Option<Fit>, starts: usize) -> Vec<Fit> {
        self.run_element(f, 0.0);
        self.screen_present(starts);
        let s = self.p.signals(&self.x, &self.dir);
        let running = &mut self.running;
        running.extend(known);
        self.fits += running.len();
        let best = race(&mut self.work, &s, running, Lag::Fixed, &EVERY_RACE, PRECISE);
        let mut leaders = running.clone();
        rescreen(&mut self.screen, &mut self.work, &s, &best, &mut self.candidates);
        running.clear();
        running.extend(self.candidates.iter().take(RESCREENED).map(|c| c.start(0.0)));
        self.fits += running.len();
        race(&mut self.work, &s, running, Lag::Fixed, &RESCREEN_RACE, PRECISE);
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

    /// Fits one structure at value after value, each from the coefficients at the one before.
    fn carry(&mut self, points: &mut [GridPoint], along: impl Iterator<Item = usize>, mut model: Fit) {
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

/// The value with the least loss.
fn least(points: &[GridPoint]) -> (usize, f64) {
    let losses = points.iter().map(|p| p.loss).enumerate();
    losses.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY))
}

/// The nearest values with a fit, below and above.
fn neighbours(fits: &[Option<Fit>], i: usize) -> (Option<usize>, Option<usize>) {
    let below = (0..i).rev().find(|&at| fits[at].is_some());
    (below, (i + 1..fits.len()).find(|&at| fits[at].is_some()))
}

/// The loss to expect of a value that is only screened: the screening overstates it as much as at its neighbours.
fn expected(points: &[GridPoint], fits: &[Option<Fit>], screened: &[Screened], i: usize) -> f64 {
    let overstated = |at: usize| (screened[at].start.loss + LOSS_FLOOR) / points[at].loss;
    let ratio = match neighbours(fits, i) {
        (Some(a), Some(b)) => {
            let share = (i - a) as f64 / (b - a) as f64;
            ((1.0 - share) * overstated(a).ln() + share * overstated(b).ln()).exp()
        }
        (Some(at), None) | (None, Some(at)) => overstated(at),
        (None, None) => 1.0,
    };
    (screened[i].start.loss + LOSS_FLOOR) / ratio
}
