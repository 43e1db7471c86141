//! How far PV is from where it should be.
//!
//! ```text
//! e = sp - pv      IAE = ts sum |e|      ISE = ts sum e²      sd = standard deviation of e
//! ```
//!
//! PV, SP and e in PV's unit, ts in seconds; IAE in PV·s, ISE in PV²·s. Both are told per second as well, since records differ
//! in length. Without a set point it is the mean of PV. Where the set point was not sampled there is no error: it begins and ends
//! with it, and is drawn through what is missing between.

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
    /// Mean of e² (PV²).
    pub mean_square: f64,
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

/// [`errors`] from the first sample at which the set point is known to the last, drawn through what is not known between them;
/// `known` says at which it is, and none that it is at all of them. Nothing where it is known at less than half.
pub fn known_errors(pv: &[f64], sp: Option<&[f64]>, known: Option<&[bool]>) -> Vec<f64> {
    let mut e = errors(pv, sp);
    let Some(known) = known.filter(|known| sp.is_some() && known.len() == e.len()) else { return e };
    let at: Vec<usize> = (0..e.len()).filter(|k| known[*k]).collect();
    let (Some(first), Some(last)) = (at.first(), at.last()) else { return Vec::new() };
    if 2 * at.len() < e.len() {
        return Vec::new();
    }
    for (from, to) in at.iter().zip(&at[1..]) {
        let slope = (e[*to] - e[*from]) / (to - from) as f64;
        (from + 1..*to).for_each(|k| e[k] = e[*from] + slope * (k - from) as f64);
    }
    e[*first..=*last].to_vec()
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
        mean_square: square / e.len() as f64,
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
        assert_eq!((found.iae, found.ise), (20.0, 20.0));
        assert_eq!((found.mean_absolute, found.mean_square), (0.5, 0.5));
        assert!((found.sd - 0.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(errors(&[1.0, 3.0], None), [1.0, -1.0]);
        assert_eq!(measure(&[], 1.0), None);
        assert_eq!(measure(&[f64::NAN], 1.0), None);
    }

    #[test]
    fn where_the_set_point_is_not_known_there_is_no_error() {
        let (pv, level) = ([1.0, 3.0, 2.0, 2.0], [2.0; 4]);
        let of = |known: [bool; 4]| known_errors(&pv, Some(&level), Some(&known));
        assert_eq!(of([true, true, true, false]), [1.0, -1.0, 0.0], "it ends with the set point");
        assert_eq!(of([false, true, true, true]), [-1.0, 0.0, 0.0], "and begins with it");
        assert_eq!(of([true, false, true, true]), [1.0, 0.5, 0.0, 0.0], "a gap is drawn through");
        assert!(of([true, false, false, false]).is_empty() && of([false; 4]).is_empty());
        assert_eq!(known_errors(&pv, Some(&level), None).len(), 4);
        // None that could be lost.
        assert_eq!(known_errors(&pv, None, Some(&[false; 4])).len(), 4);
    }
}
