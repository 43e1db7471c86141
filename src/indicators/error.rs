//! How far PV is from where it should be.
//!
//! ```text
//! e = sp - pv      IAE = ts sum |e|      ISE = ts sum e²      sd = standard deviation of e
//! ```
//!
//! PV, SP and e in PV's unit, ts in seconds; IAE in PV·s, ISE in PV²·s. Both are told per second as well, since records differ
//! in length. Without a set point it is the mean of PV. Where the set point was lost the error ends with it.

use crate::sysid::stats::{mean, sd};

/// The error of a loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopError {
    /// Integral of |e| (PV·s).
    pub iae: f64,
    /// Integral of e² (PV²·s).
    pub ise: f64,
    /// Mean of |e| (PV).
    pub mean_absolute: f64,
    /// Standard deviation of e (PV).
    pub sd: f64,
}

/// `sp - pv` at every sample; of the mean of PV without a set point as long as PV.
pub fn errors(pv: &[f64], sp: Option<&[f64]>) -> Vec<f64> {
    let level = mean(pv);
    match sp.filter(|sp| sp.len() == pv.len()) {
        Some(sp) => sp.iter().zip(pv).map(|(sp, pv)| sp - pv).collect(),
        None => pv.iter().map(|pv| level - pv).collect(),
    }
}

/// How many samples of a record there is an error of: `known` says at how many the set point is, from the first on, and none
/// says at all of them. None of them where that is less than half.
pub fn known_samples(pv: &[f64], sp: Option<&[f64]>, known: Option<usize>) -> usize {
    let n = pv.len();
    let known = known.filter(|_| sp.is_some()).map_or(n, |known| known.min(n));
    if 2 * known < n { 0 } else { known }
}

/// [`errors`] at the samples of which there is one.
pub fn known_errors(pv: &[f64], sp: Option<&[f64]>, known: Option<usize>) -> Vec<f64> {
    let n = known_samples(pv, sp, known);
    errors(&pv[..n], sp.filter(|sp| sp.len() == pv.len()).map(|sp| &sp[..n]))
}

/// Measures the errors of a record; none without a sample.
pub fn measure(e: &[f64], ts: f64) -> Option<LoopError> {
    if e.is_empty() || !e.iter().all(|e| e.is_finite()) {
        return None;
    }
    let absolute: f64 = e.iter().map(|e| e.abs()).sum();
    let square: f64 = e.iter().map(|e| e * e).sum();
    Some(LoopError {
        iae: ts * absolute,
        ise: ts * square,
        mean_absolute: absolute / e.len() as f64,
        sd: sd(e),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let e = errors(&[1.0, 3.0, 2.0, 2.0], Some(&[2.0, 2.0, 2.0, 2.0]));
        let found = measure(&e, 10.0).expect("four samples");
        assert_eq!((found.iae, found.ise, found.mean_absolute), (20.0, 20.0, 0.5));
        assert!((found.sd - 0.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(errors(&[1.0, 3.0], None), [1.0, -1.0]);
        assert_eq!(measure(&[], 1.0), None);
        let (pv, level) = ([1.0, 3.0, 2.0, 2.0], [2.0; 4]);
        let sp = Some(level.as_slice());
        assert_eq!(known_errors(&pv, sp, Some(3)), [1.0, -1.0, 0.0], "it ends with the set point");
        assert_eq!(known_errors(&pv, sp, None).len(), 4);
        // A set point of less than half of the time, and none that could be lost.
        assert_eq!((known_samples(&pv, sp, Some(1)), known_samples(&pv, None, Some(1))), (0, 4));
        assert_eq!(measure(&[f64::NAN], 1.0), None);
    }
}
