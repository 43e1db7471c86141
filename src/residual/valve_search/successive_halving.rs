//! Successive halving: S and J are searched for on growing stretches of the record, with dynamics of their own at every stage.
//!
//! The likelihood of a valve that slips has a needle at the true thresholds: one per cent off, every slip comes at another sample.
//! Dynamics that were fitted to a wrong stem hide the needle, so that alternating maximisation does not find it. So each cell of
//! thresholds is rated by an ARX of its own on the first rows, the best half of the cells goes on over half as many rows more,
//! and so on to the end of the record. No dynamics are carried from one stage to the next.
//!
//! Source: Jamieson & Talwalkar, AISTATS 2016 (successive halving).

use super::beam::{cells_at_start, mark_widest};
use super::cells::{Cells, Family, Range, Sample, stops};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{ValveModel, growth};

/// Rows of the first stage: on many fewer an ARX explains anything.
const FIRST: usize = 192;
/// Factor from the rows of one stage to those of the next.
const GROWS: f64 = 1.5;
/// Most cells rated at the first stage, and at the last; the number halves from stage to stage in between.
const MOST: (usize, usize) = (1024, 96);
/// One in so many cells of a stage survives, and the fewest survivors.
const GO_ON: (usize, usize) = (2, 24);
/// Weight of the deviance at the last stage against the logarithm of a cell's area, where there are too many cells (-).
const TEMPERED: f64 = 0.25;
/// Largest J/S: the beam searches that follow look beyond it.
const MOST_J: f64 = 1.0;
/// Positions of the stem at the start, as in a beam search but fewer: beam searches refine them later.
const PLACES: [(bool, f64); 3] = [(false, 0.0), (true, 0.0), (true, 0.7)];
/// Positions for J = S with the rule *slip*, where the stem never forgets its start.
const CLOSE_PLACES: usize = 6;

/// The valves of a family with the least deviances, the best first.
///
/// * `full`: asymmetry, drift and stops that effects give every valve.
/// * `range`: least and largest S (standard deviations of OP).
/// * `deviances`: the deviances of valves on a record, of which only the first rows are fitted.
pub fn successive_halving(
    data: &IdData,
    full: &ValveModel,
    family: Family,
    range: Range,
    deviances: impl Fn(&IdData, &[ValveModel]) -> Vec<f64>,
) -> Vec<ValveModel> {
    let mut cells = cells_at_start(data, family, range, full.drift, &PLACES, CLOSE_PLACES);
    cells.retain(|cell| cell.j.0 < MOST_J * cell.s.1 || family.ratio.is_some());
    let mut cells = Cells::new(family, cells, 1);
    let (mut order, mut survives): (Vec<(f64, usize)>, Vec<bool>) = Default::default();
    let mut short = data.clone();
    let (mut rows, mut most, mut k) = (FIRST, MOST.0, data.start.index + 1);
    loop {
        let mut end = (data.first + rows).min(data.split);
        // A last stage that would be hardly longer than this one is joined to it.
        if data.split < end + rows / 2 {
            end = data.split;
        }
        while k < end {
            let grown = growth(full.drift, k, data.split).max(1e-3);
            cells.step(
                k,
                Sample { u: data.u[k], grown, asymmetry: full.asymmetry, stops: stops(full) },
                &|_, _| (),
            );
            if cells.len() > most {
                mark_widest(&cells, most * 3 / 4, TEMPERED, &mut order, &mut survives);
                cells.retain(&survives);
            }
            k += 1;
        }
        short.split = k;
        let valves: Vec<ValveModel> = cells.cells.iter().map(|cell| cell.valve(family)).collect();
        order.clear();
        order.extend(deviances(&short, &valves).into_iter().zip(0..));
        cells.loss.iter_mut().zip(&order).for_each(|(loss, rated)| *loss = rated.0);
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        if k >= data.split {
            return order.iter().filter(|o| o.0.is_finite()).map(|&(_, at)| valves[at]).collect();
        }
        survives.clear();
        survives.resize(cells.len(), false);
        let few = (cells.len() / GO_ON.0).max(GO_ON.1);
        order.iter().take(few).for_each(|&(_, at)| survives[at] = true);
        cells.retain(&survives);
        (rows, most) = ((GROWS * rows as f64) as usize, MOST.1.max(most / 2));
    }
}
