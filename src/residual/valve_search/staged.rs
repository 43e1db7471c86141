//! Thresholds sought with dynamics of their own at every stage: successive halving on growing stretches of the record.
//!
//! Behind a valve that slips the true thresholds are a needle: a per cent off, each slip comes at another sample, and dynamics
//! that go with a wrong stem blur the true one. So cells are rated by the ARX of their own on the first rows, the best go on
//! through half as many more, and so to the end. Nothing that was rated is held.

use super::beam::{at_start, widest};
use super::cells::{Cells, Family, Range, Sample, stops};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{ValveModel, growth};

/// Rows of the first stage: on many fewer an ARX explains anything.
const FIRST: usize = 192;
/// Factor to the next stage.
const GROWS: f64 = 1.5;
/// Cells rated at the first stage, at most, and at the later ones in the end; half as many at each.
const MOST: (usize, usize) = (1024, 96);
/// One in so many cells of a stage goes on, and the fewest.
const GO_ON: (usize, usize) = (2, 24);
/// Share of what was lost at the last stage by which cells are told apart from wider ones before the next (-).
const TEMPERED: f64 = 0.25;
/// Largest J/S: beams from what was found look beyond.
const MOST_J: f64 = 1.0;
/// Places of the stem at the start: fewer than a beam tries, which mends them later.
const PLACES: [(bool, f64); 3] = [(false, 0.0), (true, 0.0), (true, 0.7)];
/// The same where nothing but a slip at the same sample makes two stems one.
const CLOSE_PLACES: usize = 6;

/// The valves of a family with S in `range` that explain PV best, the best first.
///
/// * `full`: what effects change about a valve.
/// * `deviances`: what rates valves on the first rows.
pub fn staged(
    data: &IdData,
    full: &ValveModel,
    family: Family,
    range: Range,
    deviances: impl Fn(&IdData, &[ValveModel]) -> Vec<f64>,
) -> Vec<ValveModel> {
    let mut cells = at_start(data, family, range, full.drift, &PLACES, CLOSE_PLACES);
    cells.retain(|cell| cell.j.0 < MOST_J * cell.s.1 || family.ratio.is_some());
    let mut cells = Cells::new(family, cells, 1);
    let (mut order, mut goes_on): (Vec<(f64, usize)>, Vec<bool>) = Default::default();
    let mut short = data.clone();
    let (mut rows, mut most, mut k) = (FIRST, MOST.0, data.start.index + 1);
    loop {
        let mut end = (data.first + rows).min(data.split);
        // No last stage that is hardly longer than the one before.
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
                widest(&cells, most * 3 / 4, TEMPERED, &mut order, &mut goes_on);
                cells.retain(&goes_on);
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
        goes_on.clear();
        goes_on.resize(cells.len(), false);
        let few = (cells.len() / GO_ON.0).max(GO_ON.1);
        order.iter().take(few).for_each(|&(_, at)| goes_on[at] = true);
        cells.retain(&goes_on);
        (rows, most) = ((GROWS * rows as f64) as usize, MOST.1.max(most / 2));
    }
}
