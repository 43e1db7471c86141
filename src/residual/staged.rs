//! A stem of slips sought with dynamics of its own at every step.
//!
//! Behind a valve whose every move is a slip of S the true threshold is a needle: a per cent off, each slip comes at another
//! sample, and no later sample mends it, since the stem remembers nothing but its last slip. Dynamics that go with a wrong
//! stem blur the true one. So all paths through the first samples are rated by a long ARX of their own on just those samples,
//! the best go on through twice as many, and so to the end. What was rated is never held: no error of the dynamics lasts.

use super::cells::{Family, Stems};
use super::model::{Data, Element, Spec};
use super::paths::{Paths, Sample};
use super::scan::Scan;

/// Samples of the first stage.
const FIRST: usize = 128;
/// Paths that go on from the first stage, and the fewest of a later one; half as many from each as from the one before.
const GO_ON: usize = 512;
const FEWEST: usize = 48;
/// Paths at which a stage ends early, if so many of its samples are rated.
const MOST: usize = 4096;
const LEAST: usize = 64;
/// S, as shares of the model's own.
const RANGE: (f64, f64) = (0.5, 1.4);
/// Lags of z in the long ARX: of a model that is wrong the delay says little.
const LAGS: usize = 8;

/// Whether [`jumps`] about one f comes to another.
pub fn reaches(about: f64, f: f64) -> bool {
    (RANGE.0 * about..RANGE.1 * about).contains(&f)
}

/// The stem of slips of S that explains most of the fitted samples, with S near that of `spec`; none where its bands differ or grow.
pub fn jumps(data: &Data, spec: &Spec) -> Option<Element> {
    let full = spec.full_element();
    if (full.growth, full.skew) != (0.0, 0.0) {
        return None;
    }
    let (stage, _) = spec.stage(data);
    let own = 2.0 * spec.element.f;
    let stems = Stems { u: &stage.u, start: data.start, range: (RANGE.0 * own, RANGE.1 * own) };
    let mut paths = Paths::new(Family::Jumps, stems.start_cells(Family::Jumps), 1);
    let (mut short, mut goes_on) = (data.clone(), Vec::new());
    let (mut rows, mut go_on, mut k) = (FIRST, GO_ON, data.start.index + 1);
    loop {
        let end = (data.first + rows).min(data.split);
        while k < end && (paths.len() < MOST || k < data.first + LEAST) {
            paths.step(k, Sample { op: stage.u[k], grown: 1.0, skew: 0.0 });
            k += 1;
        }
        short.split = k;
        let element = |cell| stems.element(cell, Family::Jumps, Element::default());
        let elements: Vec<Element> = paths.cells.iter().map(element).collect();
        let losses = Scan::of_lags(&short, spec, (1..=LAGS).collect(), 0).rate(&elements);
        let mut order: Vec<(f64, usize)> =
            losses.iter().enumerate().filter_map(|(at, loss)| Some(((*loss)?, at))).collect();
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        if k >= data.split {
            return order.first().map(|&(_, best)| elements[best]);
        }
        goes_on.clear();
        goes_on.resize(paths.len(), false);
        order.iter().take(go_on).for_each(|&(_, at)| goes_on[at] = true);
        paths.retain(&goes_on);
        if k >= end {
            (rows, go_on) = (2 * rows, FEWEST.max(go_on / 2));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::{behind_valve, noise, waves};

    #[test]
    fn a_needle_is_found_from_dynamics_that_are_wrong() {
        for (seed, rest) in [(1, 0.2), (2, 0.9), (3, 0.5), (4, 0.0)] {
            let mut draw = noise(seed);
            let op: Vec<f64> = waves(1400).into_iter().map(|op| op + 0.3 * draw()).collect();
            let valve = Element {
                f: 1.0,
                resume: 1.0,
                slips: true,
                turned: seed % 2 > 0,
                rest,
                ..Element::default()
            };
            let data = behind_valve(&op, valve, 0.8, |_| 0.05 * draw());
            for wrong in [0.85, 1.3] {
                let spec = declared(&data, wrong / data.scale.u);
                let found = jumps(&data, &spec).expect("some stem explains most");
                let f = found.f * data.scale.u;
                // A cell of thresholds that no sample of OP falls between is as far as it goes.
                assert!(
                    (f - 1.0).abs() < 3e-3 && found.slips && found.resume == 1.0,
                    "{seed} {wrong}: {found:?}"
                );
            }
        }
    }
}
