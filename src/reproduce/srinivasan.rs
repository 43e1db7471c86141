//! Srinivasan's d as the paper's Table 2 has it: the stem jumps to OP whenever OP is more than d away, and an ARMAX of
//! the paper's own orders is fitted for each d of a grid.

use crate::diagnosis::armax::{Lag, Signals, Theta, Workspace, splits};
use crate::diagnosis::friction::srinivasan;

/// Values of d tried, from 0 to the range of OP.
const GRID: usize = 60;
/// Samples before the loss counts: longer than the longest lag.
const FIRST: usize = 12;
/// Accuracy and bound of one fit; a neighbour's solution is the start of most.
const TOLERANCE: f64 = 1e-7;
const ITERATIONS: usize = 40;
/// Every so many values of d the fits start from nothing.
const AFRESH: usize = 8;

/// d [unit of `op`] with the least loss over all ARMAX with na + nb + nc = 6 and a delay of one sample; none for a
/// record that is flat or too short. The stem starts at the first OP: neither paper says where.
pub fn best_d(op: &[f64], pv: &[f64]) -> Option<f64> {
    let (u, unit) = normalised(op)?;
    let (y, _) = normalised(pv)?;
    let range = |v: &[f64]| {
        let (low, high) =
            v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
        high - low
    };
    let top = range(&u);
    let n = u.len().min(y.len());
    let mut work = Workspace::new(n);
    let (mut x, dir) = (vec![0.0; n], vec![1.0; n]);
    let mut neighbours: Vec<Option<Theta>> = vec![None; splits(1).count()];
    let mut best = (f64::INFINITY, 0.0);
    for i in 0..GRID {
        let d = top * i as f64 / GRID as f64;
        srinivasan(&u[..n], d, &mut x);
        let signals =
            Signals { y: &y[..n], x: &x, dir: &dir, start: 0, first: FIRST, rows: Default::default() };
        for (orders, neighbour) in splits(1).zip(&mut neighbours) {
            // A start of its own now and then: a neighbour may have led into a local minimum.
            let start = neighbour.filter(|_| i % AFRESH != 0).unwrap_or_default();
            let fit = work.minimise(&signals, orders, start, Lag::Fixed, TOLERANCE, ITERATIONS);
            *neighbour = Some(fit.theta);
            // All have six coefficients: AIC ranks them by the loss alone.
            if fit.loss < best.0 {
                best = (fit.loss, d);
            }
        }
    }
    Some(best.1 * unit)
}

/// Zero mean and unit variance, and the sd.
fn normalised(v: &[f64]) -> Option<(Vec<f64>, f64)> {
    if v.len() < 10 * FIRST {
        return None;
    }
    let mean = v.iter().sum::<f64>() / v.len() as f64;
    let sd = (v.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / v.len() as f64).sqrt();
    (sd.is_finite() && sd > 0.0).then(|| (v.iter().map(|x| (x - mean) / sd).collect(), sd))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_own_element_is_found_exactly() {
        // Two incommensurate sines through the element with d = 1.3 and a first-order process, no noise.
        let op: Vec<f64> = (0..600)
            .map(|k| {
                let t = f64::from(k);
                50.0 + 2.0 * (0.11 * t).sin() + 1.1 * (0.037 * t).sin()
            })
            .collect();
        let mut x = vec![0.0; op.len()];
        srinivasan(&op, 1.3, &mut x);
        let mut pv = vec![40.0; op.len()];
        for k in 1..op.len() {
            pv[k] = 0.8 * pv[k - 1] + 0.2 * (x[k - 1] - 10.0);
        }
        let d = best_d(&op, &pv).expect("a record that moves");
        // One step of the grid: OP's range of at most 6.2 over 60.
        assert!((d - 1.3).abs() < 0.11, "{d}");
    }

    #[test]
    fn a_flat_record_has_no_d() {
        assert_eq!(best_d(&[50.0; 500], &[1.0; 500]), None);
        assert_eq!(best_d(&[], &[]), None);
    }
}
