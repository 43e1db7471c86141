//! All thresholds at once: a beam search over cells of S and J, the dynamics held.
//!
//! ```text
//! L = sum over k of ln(1 + e_k^2 / (nu s^2)),   e = y - everything but the stem - sum_j b_j x[k-j]
//! ```
//!
//! Where OP is noisy, a stem with thresholds half a per cent off goes other ways than the true one, and no grid is fine
//! enough to meet it. The cells whose stems explain PV badly are left behind, the best go on.

use super::cells::{Cell, Cells, FACTORS, Family, Range, Sample, stops};
use crate::residual::hypothesis::Hypothesis;
use crate::sysid::arx::{ArxFit, LAGS_X};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{StopRule, ValveModel, growth};
use std::array::from_fn;

/// Cells that go on whatever part they began in, once many samples are rated.
const BEST: f64 = 24.0;
/// Cells of each part that go on.
const EACH: f64 = 1.0;
/// Cells beyond which some are left behind.
const MOST: usize = 48;
/// How many times as many go on at first: chance decides there.
const AT_FIRST: f64 = 16.0;
/// Rows in which that halves.
const HALVED: f64 = 40.0;
/// Loss behind the best beyond which a cell is left behind (-).
const FAR_BEHIND: f64 = 60.0;
/// Cells kept before any row is rated.
const UNRATED: usize = 2048;
/// Parts of S, each at most this factor wide, and how many at most.
const PARTS_OF_S: (f64, usize) = (1.28, 16);
/// Parts of J, up to `J = 1.5 S`.
const PARTS_OF_J: (usize, f64) = (6, 1.5);
/// Places of the stem at the start: whether it had turned, and how far beyond OP it was (share of S).
const PLACES: [(bool, f64); 5] = [(false, 0.0), (false, 0.5), (true, 0.0), (true, 0.5), (true, 1.0)];
/// The same where nothing but a slip at the same sample makes two stems one: the start is never forgotten.
const CLOSE_PLACES: usize = 12;
const FARTHEST_PLACE: f64 = 0.98;

/// What is held while thresholds are searched.
pub struct Held<'a> {
    data: &'a IdData,
    effects: &'a Hypothesis,
    /// What is left of PV for the stem.
    left: Vec<f64>,
    b: [f64; LAGS_X],
    per: f64,
}

impl<'a> Held<'a> {
    /// The dynamics of a fit with the stem `x`; `effects`: what the stem meets on its way.
    pub fn new(data: &'a IdData, effects: &'a Hypothesis, fit: &ArxFit, x: &[f64]) -> Self {
        let b: [f64; LAGS_X] = from_fn(|j| fit.b()[j]);
        let from = data.first;
        let through = |k: usize| -> f64 { (0..LAGS_X).map(|j| b[j] * x[k - 1 - j]).sum() };
        let left = fit.e.iter().enumerate().map(|(row, e)| e + through(from + row)).collect();
        Self { data, effects, left, b, per: 1.0 / (fit.nu * fit.scale * fit.scale) }
    }

    /// The valves with the least losses of a family with S in `range`, `count` of them; `full`: what effects change about any.
    pub fn best(
        &self,
        family: Family,
        range: Range,
        full: &ValveModel,
        count: usize,
    ) -> Vec<(f64, ValveModel)> {
        let data = self.data;
        let ValveModel { asymmetry, drift, .. } = *full;
        // The process sees the stem as late as all changes of dead time together make it.
        let effects = self.effects.effects.iter();
        let latest: usize = effects.map(|effect| effect.delay(0).max(effect.delay(usize::MAX))).sum();
        let starts = at_start(data, family, range, drift, &PLACES, CLOSE_PLACES);
        let mut cells = Cells::new(family, starts, LAGS_X + 1 + latest);
        let bends = self.effects.effects.iter().any(|effect| effect.bends());
        let bend = |k: usize, x: &mut [f64]| {
            if bends {
                self.effects.effects.iter().for_each(|effect| effect.bend(data, k, x));
            }
        };
        let (mut order, mut goes_on, mut most) = (Vec::new(), Vec::new(), MOST);
        for k in data.start.index + 1..data.split {
            let grown = growth(drift, k, data.split).max(1e-3);
            cells.step(k, Sample { u: data.u[k], grown, asymmetry, stops: stops(full) }, &bend);
            let Some(row) = k.checked_sub(data.first) else {
                if cells.len() > UNRATED {
                    widest(&cells, UNRATED / 2, 0.0, &mut order, &mut goes_on);
                    cells.retain(&goes_on);
                }
                continue;
            };
            let later: usize = self.effects.effects.iter().map(|effect| effect.delay(k)).sum();
            cells.rate(k - 1 - later, &self.b, self.left[row], data.weight[k] * self.per);
            if row % FACTORS == FACTORS - 1 || cells.len() > most {
                cells.count();
            }
            if cells.len() > most {
                choose(&cells, &mut order, &mut goes_on, row);
                cells.retain(&goes_on);
                // Parts of which none is far behind keep more than there should be: not to be sorted at every sample.
                most = MOST.max(cells.len() + cells.len() / 4);
            }
        }
        cells.count();
        let mut found: Vec<(f64, Cell)> = cells.loss.into_iter().zip(cells.cells).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let valve = |cell: &Cell| ValveModel { asymmetry, drift, stops: full.stops, ..cell.valve(family) };
        found.iter().take(count).map(|(loss, cell)| (*loss, valve(cell))).collect()
    }
}

/// Marks the cells that go on: the best of all, and of each part the best.
fn choose(cells: &Cells, order: &mut Vec<(f64, usize)>, goes_on: &mut Vec<bool>, rows: usize) {
    let more = (AT_FIRST * 0.5_f64.powf(rows as f64 / HALVED)).max(1.0);
    let (best, each) = ((BEST * more) as usize, (EACH * more.sqrt()) as usize);
    order.clear();
    order.extend(cells.loss.iter().enumerate().map(|(at, loss)| (*loss, at)));
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let enough = order[0].0 + FAR_BEHIND;
    let mut of_part = [0; PARTS_OF_S.1 * PARTS_OF_J.0];
    goes_on.clear();
    goes_on.resize(order.len(), false);
    for (rank, &(loss, at)) in order.iter().enumerate() {
        let of_part = &mut of_part[cells.cells[at].part];
        *of_part += 1;
        goes_on[at] = loss < enough && (rank < best || *of_part <= each);
    }
}

/// Marks the widest cells, `count` of them; by `tempered` times their loss, where rows were rated, less wide ones too.
pub fn widest(
    cells: &Cells,
    count: usize,
    tempered: f64,
    order: &mut Vec<(f64, usize)>,
    goes_on: &mut Vec<bool>,
) {
    let size = |c: &Cell| (c.s.1 - c.s.0) * (c.j.1 - c.j.0 + 1e-12);
    order.clear();
    order.extend(
        cells
            .cells
            .iter()
            .zip(&cells.loss)
            .enumerate()
            .map(|(at, (cell, loss))| (size(cell).max(1e-300).ln() - tempered * loss, at)),
    );
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    goes_on.clear();
    goes_on.resize(order.len(), false);
    order.iter().take(count).for_each(|&(_, at)| goes_on[at] = true);
}

/// The cells of a family at the start: the stem at `places`, or where the start is never forgotten at `close` and more.
pub fn at_start(
    data: &IdData,
    family: Family,
    range: Range,
    drift: f64,
    places: &[(bool, f64)],
    close: usize,
) -> Vec<Cell> {
    let wide = range.1 / range.0;
    let grown = growth(drift, data.start.index, data.split);
    let parts = ((wide.ln() / PARTS_OF_S.0.ln()).ceil() as usize).clamp(1, PARTS_OF_S.1);
    let s = |i: usize| range.0 * wide.powf(i as f64 / parts as f64);
    let mut cells = Vec::new();
    for i in 0..parts {
        let s = (s(i), s(i + 1));
        let (of_j, most) = PARTS_OF_J;
        let j = |share: usize| most * s.1 * share as f64 / of_j as f64;
        let shares: Vec<Range> = match family.ratio {
            Some(ratio) => vec![(ratio * s.0, ratio * s.1)],
            None => (0..of_j).map(|share| (j(share), j(share + 1))).collect(),
        };
        for (share, j) in shares.into_iter().enumerate() {
            let start = |(turned, beyond): (bool, f64)| {
                let direction = if data.start.is_max != turned { 1.0 } else { -1.0 };
                let beyond = beyond * s.0;
                let place = data.u[data.start.index] + direction * beyond * grown;
                Cell { s, j, part: i * of_j + share, place, direction, turned, beyond }
            };
            if family.rule == StopRule::Slip && family.ratio.is_some() {
                let rest = |i: usize| FARTHEST_PLACE * i as f64 / close as f64;
                let places = (0..=close).map(|i| (true, rest(i)));
                cells.extend(places.chain((1..=close).map(|i| (false, rest(i)))).map(start));
            } else {
                cells.extend(places.iter().copied().map(start));
            }
        }
    }
    cells
}
