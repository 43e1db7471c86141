//! Where OP stays: quantiles and a histogram over its span.
//!
//! A valve that lives near closed is too large, one near open too small (ISA-75.25: 20 to 80 % of travel is where a valve should work).

use crate::sysid::stats::quantile;

/// Bins of the histogram over the span.
pub const BINS: usize = 20;

/// The distribution of OP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distribution {
    /// 5 %, 50 % and 95 % quantile (OP unit).
    pub quantiles: [f64; 3],
    /// Share of the samples in each twentieth of the span.
    pub histogram: [f64; BINS],
}

/// Of `op` over `(low, high)`; none without a sample or a span.
pub fn distribution(op: &[f64], (low, high): (f64, f64)) -> Option<Distribution> {
    if op.is_empty() || high <= low || !op.iter().all(|u| u.is_finite()) {
        return None;
    }
    let mut histogram = [0.0; BINS];
    for u in op {
        let at = (u - low) / (high - low) * BINS as f64;
        histogram[(at.max(0.0) as usize).min(BINS - 1)] += 1.0 / op.len() as f64;
    }
    Some(Distribution { quantiles: [0.05, 0.5, 0.95].map(|q| quantile(op, q)), histogram })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let found = distribution(&[0.0, 2.0, 52.0, 100.0, 101.0], (0.0, 100.0)).expect("five samples");
        assert_eq!((found.histogram[0], found.histogram[10], found.histogram[19]), (0.4, 0.2, 0.4));
        assert_eq!(found.quantiles[1], 52.0);
        assert!(distribution(&[], (0.0, 1.0)).is_none() && distribution(&[1.0], (1.0, 1.0)).is_none());
    }
}
