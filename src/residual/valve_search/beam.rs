//! Beam search over all thresholds S and J at once, with fixed dynamics.
//!
//! ```text
//! loss = sum over k of ln(1 + e[k]^2 / (nu s^2)),   e[k] = r[k] - sum over j of b_j x[k-1-j]
//! ```
//!
//! `r` is PV less everything but the stem, `b` are the coefficients of the stem, and `s`, `nu` the scale and the degrees of
//! freedom of the errors; all of them are those of a fitted ARX. The plane of S and J is a set of cells (`cells.rs`), each
//! with one stem x. Where OP is noisy, thresholds half a per cent off make another stem, and no grid is fine enough to meet the
//! true one; a cell is split exactly where its thresholds would decide differently. Where there are too many cells, those
//! with the least losses survive, and the others are pruned.

use super::cells::{Cell, Cells, FACTORS, Family, Range, Sample, stops};
use crate::residual::hypothesis::Hypothesis;
use crate::sysid::arx::{ArxFit, LAGS_X};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{StopRule, ValveModel, growth};
use std::array::from_fn;

/// Cells that survive whatever part of the plane they began in, once many rows are rated.
const BEST: f64 = 24.0;
/// Cells of each part of the (S, J) plane that survive.
const EACH: f64 = 1.0;
/// Number of cells beyond which some are pruned.
const MOST: usize = 48;
/// Factor on the number of survivors at first: over few rows chance decides.
const AT_FIRST: f64 = 16.0;
/// Rows in which that factor halves.
const HALVED: f64 = 40.0;
/// Loss behind the best beyond which a cell is pruned (-).
const FAR_BEHIND: f64 = 60.0;
/// Cells kept before any row is rated.
const UNRATED: usize = 2048;
/// Parts into which S is divided at the start: their width as a factor, and most of them.
const PARTS_OF_S: (f64, usize) = (1.28, 16);
/// Parts into which J is divided at the start: their number, and the largest J/S.
const PARTS_OF_J: (usize, f64) = (6, 1.5);
/// Positions of the stem at the start: whether its last move was against the extremum of OP, and how far it was beyond OP (share
/// of S).
const PLACES: [(bool, f64); 5] = [(false, 0.0), (false, 0.5), (true, 0.0), (true, 0.5), (true, 1.0)];
/// Positions of the stem at the start, to each side, for J = S with the rule *slip*: every move is a slip of S, so that a stem never
/// forgets its start.
const CLOSE_PLACES: usize = 12;
/// The farthest of these positions (share of S): at 1 the stem slips at once.
const FARTHEST_PLACE: f64 = 0.98;

/// The dynamics that are fixed while thresholds are searched for.
pub struct FixedDynamics<'a> {
    data: &'a IdData,
    effects: &'a Hypothesis,
    /// PV less everything but the stem, on the fitted rows (standard deviations of PV).
    left: Vec<f64>,
    /// Coefficients of the stem.
    b: [f64; LAGS_X],
    /// `1/(nu s^2)`.
    per: f64,
}

impl<'a> FixedDynamics<'a> {
    /// The dynamics of a fit with the stem `x`. `effects`: the effects that the stem meets on its way to the process.
    pub fn new(data: &'a IdData, effects: &'a Hypothesis, fit: &ArxFit, x: &[f64]) -> Self {
        let b: [f64; LAGS_X] = from_fn(|j| fit.b()[j]);
        let from = data.first;
        let through = |k: usize| -> f64 { (0..LAGS_X).map(|j| b[j] * x[k - 1 - j]).sum() };
        let left = fit.e.iter().enumerate().map(|(row, e)| e + through(from + row)).collect();
        Self { data, effects, left, b, per: 1.0 / (fit.nu * fit.scale * fit.scale) }
    }

    /// The valves of a family with the least losses, each with its loss (-), the best first.
    ///
    /// * `range`: least and largest S (standard deviations of OP).
    /// * `full`: asymmetry, drift and stops that effects give every valve.
    /// * `count`: number of valves.
    /// * `enough`: a loss only grows from row to row; once the least exceeds this one, the search ends with no valve.
    pub fn beam_search(
        &self,
        family: Family,
        range: Range,
        full: &ValveModel,
        count: usize,
        enough: f64,
    ) -> Vec<(f64, ValveModel)> {
        let data = self.data;
        let ValveModel { asymmetry, drift, .. } = *full;
        // The longest dead time that the effects add together: so many past stems are kept.
        let effects = self.effects.effects.iter();
        let latest: usize = effects.map(|effect| effect.delay(0).max(effect.delay(usize::MAX))).sum();
        let starts = cells_at_start(data, family, range, drift, &PLACES, CLOSE_PLACES);
        let mut cells = Cells::new(family, starts, LAGS_X + 1 + latest);
        let is_mapped = self.effects.effects.iter().any(|effect| effect.maps_stem());
        let map_stem = |k: usize, x: &mut [f64]| {
            if is_mapped {
                self.effects.effects.iter().for_each(|effect| effect.map_stem(data, k, x));
            }
        };
        let (mut order, mut survives, mut most) = (Vec::new(), Vec::new(), MOST);
        for k in data.start.index + 1..data.split {
            let grown = growth(drift, k, data.split).max(1e-3);
            cells.step(k, Sample { u: data.u[k], grown, asymmetry, stops: stops(full) }, &map_stem);
            let Some(row) = k.checked_sub(data.first) else {
                if cells.len() > UNRATED {
                    mark_widest(&cells, UNRATED / 2, 0.0, &mut order, &mut survives);
                    cells.retain(&survives);
                }
                continue;
            };
            let later: usize = self.effects.effects.iter().map(|effect| effect.delay(k)).sum();
            cells.rate(k - 1 - later, &self.b, self.left[row], data.weight[k] * self.per);
            if row % FACTORS == FACTORS - 1 || cells.len() > most {
                cells.take_logarithms();
                if cells.loss.iter().copied().min_by(f64::total_cmp).is_some_and(|least| least > enough) {
                    return Vec::new();
                }
            }
            if cells.len() > most {
                mark_best(&cells, &mut order, &mut survives, row);
                cells.retain(&survives);
                // Where no cell is far behind, more than `MOST` survive: the limit is raised, or they would be sorted at every sample.
                most = MOST.max(cells.len() + cells.len() / 4);
            }
        }
        cells.take_logarithms();
        let mut found: Vec<(f64, Cell)> = cells.loss.into_iter().zip(cells.cells).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let valve = |cell: &Cell| ValveModel { asymmetry, drift, stops: full.stops, ..cell.valve(family) };
        found.iter().take(count).map(|(loss, cell)| (*loss, valve(cell))).collect()
    }
}

/// Marks the cells that survive after so many rated `rows`: the best of all, and the best of each part.
fn mark_best(cells: &Cells, order: &mut Vec<(f64, usize)>, survives: &mut Vec<bool>, rows: usize) {
    let more = (AT_FIRST * 0.5_f64.powf(rows as f64 / HALVED)).max(1.0);
    let (best, each) = ((BEST * more) as usize, (EACH * more.sqrt()) as usize);
    order.clear();
    order.extend(cells.loss.iter().enumerate().map(|(at, loss)| (*loss, at)));
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let enough = order[0].0 + FAR_BEHIND;
    let mut of_part = [0; PARTS_OF_S.1 * PARTS_OF_J.0];
    survives.clear();
    survives.resize(order.len(), false);
    for (rank, &(loss, at)) in order.iter().enumerate() {
        let of_part = &mut of_part[cells.cells[at].part];
        *of_part += 1;
        survives[at] = loss < enough && (rank < best || *of_part <= each);
    }
}

/// Marks the cells with the largest `ln(area) - tempered * loss`, `count` of them. `tempered`: weight of the loss (-); 0 before any
/// row is rated.
pub fn mark_widest(
    cells: &Cells,
    count: usize,
    tempered: f64,
    order: &mut Vec<(f64, usize)>,
    survives: &mut Vec<bool>,
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
    survives.clear();
    survives.resize(order.len(), false);
    order.iter().take(count).for_each(|&(_, at)| survives[at] = true);
}

/// The cells of a family at the start.
///
/// * `range`: least and largest S (standard deviations of OP).
/// * `places`: positions of the stem at the start (see `PLACES`).
/// * `close`: number of positions to each side that take their place for J = S with the rule *slip*.
pub fn cells_at_start(
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
