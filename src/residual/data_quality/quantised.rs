//! PV moves in steps larger than its noise; the quantum (PV unit).
//!
//! Recognised by its few distinct values, all a whole number of quanta apart, and by second differences that are
//! mostly of no more than two: what the process does hardly enters them, and noise as large as a quantum makes them larger.
//! Nothing is repaired: what lies between two steps is not in the data; its `q^2 / 12` is the error that no model removes.

use super::{Fact, is_measured, measured};
use crate::residual::Kind;
use crate::residual::report::Described;
use crate::signal::told;
use crate::sysid::iddata::IdData;
use crate::sysid::stats::median;

/// Quanta in one standard deviation of PV, from which on anybody sees steps in a plot of it.
pub const OF_PV: f64 = 0.03;
/// Quanta in the median second difference, up to which noise does not hide the steps: its standard deviation is then one and a
/// half quanta at most, and a tenth of it is the steps'.
const BEND: f64 = 2.0;
/// Distance within which two values are one: they were divided by a standard deviation.
const SAME: f64 = 1e-9;
/// Fewest values that have gaps to compare.
const FEWEST: usize = 3;
/// Most values per sample: more are hardly ever met twice, and have no quantum.
const MOST_PER_SAMPLE: f64 = 2.0 / 3.0;
/// How far a gap may be from a whole number of quanta: rounding of the record itself.
const OFF: f64 = 0.05;
/// Share of the gaps that are whole: the others may be single samples of another origin.
const WHOLE: f64 = 0.97;

/// The steps of a signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantum {
    /// The least step.
    pub size: f64,
    /// Number of distinct values.
    pub distinct: usize,
}

/// Tells a coarse PV. That all values lie on one grid is no chance: the fact is certain.
pub fn assess(data: &IdData) -> Option<Fact> {
    let quantum = quantum(&measured(data, &data.y)).filter(|quantum| quantum.size >= OF_PV)?;
    let whole = |k: &usize| (k - 1..=k + 1).all(|k| is_measured(data, k));
    let bend = |k: usize| (data.y[k - 1] - 2.0 * data.y[k] + data.y[k + 1]).abs();
    let bends: Vec<f64> = (1..data.len() - 1).filter(whole).map(bend).collect();
    (!bends.is_empty() && median(&bends) < (BEND + OFF) * quantum.size).then(|| Fact {
        kind: Kind::QuantisedPv,
        posterior: 1.0,
        described: describe(data, quantum),
    })
}

fn describe(data: &IdData, quantum: Quantum) -> Described {
    let size = quantum.size * data.units.y;
    Described::new(format!("PV has only {} values, {} apart", quantum.distinct, told(size)))
        .with("quantum", size, "PV")
        .with("distinct_values", quantum.distinct as f64, "-")
}

/// The quantum and the number of distinct values, where nearly all values are a whole number of quanta apart.
pub fn quantum(y: &[f64]) -> Option<Quantum> {
    let mut sorted = y.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.dedup_by(|a, b| (*a - *b).abs() < SAME);
    let distinct = sorted.len();
    if distinct < FEWEST || distinct as f64 > MOST_PER_SAMPLE * y.len() as f64 {
        return None;
    }
    let gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).collect();
    let size = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    let whole = gaps.iter().filter(|gap| (*gap / size - (*gap / size).round()).abs() < OFF).count();
    (whole as f64 >= WHOLE * gaps.len() as f64).then_some(Quantum { size, distinct })
}

/// The quantum; 0 where there is none.
pub fn step_of(y: &[f64]) -> f64 {
    quantum(y).map_or(0.0, |quantum| quantum.size)
}

/// The standard deviation of what is lost in steps of this size: evenly distributed over one.
pub fn error_of(step: f64) -> f64 {
    step / 12f64.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantum_is_found_where_there_is_one() {
        let fine: Vec<f64> = (0..300).map(|k| (0.37 * k as f64).sin()).collect();
        let coarse: Vec<f64> = fine.iter().map(|y| (y / 0.25).round() * 0.25).collect();
        let found = quantum(&coarse).expect("steps of 0.25");
        assert!((found.size - 0.25).abs() < 1e-12 && found.distinct == 9);
        assert_eq!(quantum(&fine), None);
    }

    #[test]
    fn what_stands_in_for_missing_samples_hides_no_quantum() {
        let coarse = |k: usize| ((0.37 * k as f64).sin() / 0.25).round() * 0.25;
        let missing = |k: usize| k % 100 == 7;
        let data = IdData {
            y: (0..600).map(|k| coarse(k) + if missing(k) { 0.075 } else { 0.0 }).collect(),
            weight: (0..600).map(|k| f64::from(u8::from(!missing(k)))).collect(),
            known: vec![false; 600],
            ..IdData::default()
        };
        assert_eq!(step_of(&data.y), 0.0, "with them there is none");
        assert!((step_of(&measured(&data, &data.y)) - 0.25).abs() < 1e-12);
        assert!(assess(&data).is_some());
    }
}
