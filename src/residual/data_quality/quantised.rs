//! Quantised PV: PV moves in steps, its quantum q (PV unit), that are larger than its noise.
//!
//! It is recognised by few distinct values, nearly all a whole number of quanta apart, and by a median second difference of at most
//! two quanta. The process hardly enters second differences, and noise as large as a quantum makes them larger. Nothing is repaired,
//! because the values between two steps are not in the data. Rounding has a variance of `q^2 / 12`, which no model explains.

use super::fact::{Fact, is_measured, measured};
use crate::residual::findings::{Described, Kind};
use crate::signal::told;
use crate::sysid::iddata::IdData;
use crate::sysid::stats::median;

/// Least quantum, in standard deviations of PV: from there on the steps are visible in a plot.
pub const OF_PV: f64 = 0.03;
/// Largest median second difference (quanta) at which noise does not hide the steps: the standard deviation of the noise is then at
/// most one and a half quanta, of which a tenth is the rounding's.
const BEND: f64 = 2.0;
/// Distance within which two values are equal: they were divided by a standard deviation.
const SAME: f64 = 1e-9;
/// Fewest distinct values: fewer have no two gaps to compare.
const FEWEST: usize = 3;
/// Most distinct values per sample: where there are more, hardly any value comes twice, and there is no quantum.
const MOST_PER_SAMPLE: f64 = 2.0 / 3.0;
/// Distance of a gap from a whole number of quanta that rounding of the record explains (quanta).
const OFF: f64 = 0.05;
/// Least share of the gaps that are a whole number of quanta: the others may come from single samples of another origin.
const WHOLE: f64 = 0.97;

/// The steps of a signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantum {
    /// The quantum q, in the unit of the signal.
    pub size: f64,
    /// Number of distinct values.
    pub distinct: usize,
}

/// Finds a quantised PV. Chance does not put all values on one grid, so that its posterior is 1.
pub fn assess(data: &IdData) -> Option<Fact> {
    let quantum = quantum(&measured(data, &data.y)).filter(|quantum| quantum.size >= OF_PV)?;
    let whole = |k: &usize| (k - 1..=k + 1).all(|k| is_measured(data, k));
    let second_difference = |k: usize| (data.y[k - 1] - 2.0 * data.y[k] + data.y[k + 1]).abs();
    let differences: Vec<f64> = (1..data.len() - 1).filter(whole).map(second_difference).collect();
    (!differences.is_empty() && median(&differences) < (BEND + OFF) * quantum.size).then(|| Fact {
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

/// The quantum of a signal, and the number of its distinct values; `None` where values are not a whole number of quanta apart.
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

/// The quantum of a signal, in its unit; 0 where there is none.
pub fn step_of(y: &[f64]) -> f64 {
    quantum(y).map_or(0.0, |quantum| quantum.size)
}

/// The standard deviation of rounding to steps of this size, evenly distributed over one step: `step / sqrt 12`.
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
