//! PV moves in steps larger than its noise; the quantum [PV].
//!
//! Recognised by its few distinct values, all a whole number of quanta apart. Nothing enters the model: what lies between
//! two steps is not in the data; its `q² / 12` is the error that no model removes.

use super::{Context, Proposal, Recognise};
use crate::residual::model::{Data, Linear, Term};
use crate::residual::{Kind, Parameter};

/// Quanta in one residual sd, and in PV's sd, from which on the steps matter.
const OF_RESIDUAL: f64 = 0.75;
const OF_PV: f64 = 0.03;

pub struct QuantisedPv;

#[derive(Clone, Debug)]
struct Quantum {
    size: f64,
    distinct: usize,
}

impl Term for Quantum {
    fn kind(&self) -> Kind {
        Kind::QuantisedPv
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let size = self.size * data.scale.y;
        let parameters = vec![
            Parameter { name: "quantum", value: size, unit: "PV" },
            Parameter { name: "distinct_values", value: self.distinct as f64, unit: "-" },
        ];
        (parameters, format!("PV has only {} values, {size:.4} apart", self.distinct))
    }
}

impl Recognise for QuantisedPv {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let Some((size, distinct)) = quantum(&c.data.y) else { return Vec::new() };
        if size < OF_RESIDUAL * c.quick.loss.sqrt() || size < OF_PV {
            return Vec::new();
        }
        let term = Quantum { size, distinct };
        vec![Proposal { term: Box::new(term), loss: 0.0, parameters: 1.0, tried: 1.0, element: None }]
    }
    fn direct(&self) -> bool {
        true
    }
}

/// The quantum and the number of distinct values, where nearly all values are a whole number of quanta apart.
pub fn quantum(y: &[f64]) -> Option<(f64, usize)> {
    let mut sorted = y.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    let distinct = sorted.len();
    // As many values as samples is no quantum.
    if distinct < 3 || distinct * 3 > y.len() * 2 {
        return None;
    }
    let gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).collect();
    let least = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    let whole = gaps.iter().filter(|g| ((*g / least) - (*g / least).round()).abs() < 0.05).count();
    (whole * 100 >= gaps.len() * 97).then_some((least, distinct))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantum_is_found_where_there_is_one() {
        let fine: Vec<f64> = (0..300).map(|k| (0.37 * k as f64).sin()).collect();
        let coarse: Vec<f64> = fine.iter().map(|y| (y / 0.25).round() * 0.25).collect();
        let (size, distinct) = quantum(&coarse).expect("steps of 0.25");
        assert!((size - 0.25).abs() < 1e-12 && distinct == 9);
        assert_eq!(quantum(&fine), None);
    }
}
