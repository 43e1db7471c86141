//! How much of the time a loop does its work.
//!
//! ```text
//! service factor = time in automatic / time recorded
//! at limits      = time with OP within 0.1 % of its span of a limit / time recorded
//! ```
//!
//! Source: Jelali, Control Performance Management in Industrial Automation, 2013, section 2.3 (service factor, saturation).

/// Distance from a limit that is at it, as a part of the span between them.
const AT: f64 = 1e-3;

/// Share of the samples in automatic (0..1), by a mode of 1 in automatic, 0 otherwise, and NaN where it is not known; none where
/// that is so at more than half of them.
pub fn service_factor(mode: &[f64]) -> Option<f64> {
    share(mode, |mode| mode >= 0.5)
}

/// Share of the samples with OP at one of its limits (0..1); none without a sample or without a span.
pub fn at_limits(op: &[f64], (low, high): (f64, f64)) -> Option<f64> {
    let span = high - low;
    (span > 0.0).then_some(())?;
    share(op, |op| op <= low + AT * span || op >= high - AT * span)
}

fn share(v: &[f64], is: impl Fn(f64) -> bool) -> Option<f64> {
    let finite = v.iter().filter(|x| x.is_finite());
    let (all, those) =
        finite.fold((0_usize, 0_usize), |(all, those), x| (all + 1, those + usize::from(is(*x))));
    (all > 0 && 2 * all >= v.len()).then(|| those as f64 / all as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        assert_eq!(service_factor(&[1.0, 1.0, 0.0, 1.0, f64::NAN]), Some(0.75));
        assert_eq!(at_limits(&[0.0, 50.0, 99.95, 99.0], (0.0, 100.0)), Some(0.5));
        // What is known of less than half of the time is nothing.
        assert_eq!(service_factor(&[1.0, 1.0, f64::NAN, f64::NAN]), Some(1.0));
        assert_eq!(service_factor(&[1.0, f64::NAN, f64::NAN]), None);
        assert_eq!((service_factor(&[]), at_limits(&[1.0], (5.0, 5.0))), (None, None));
    }
}
