//! The model that runs free: one that is right one step ahead need not be right over many.

use super::direct::is_repaired;
use super::fit::minimise_towards;
use super::model::{Data, Spec};
use super::regress::structures;
use super::run::{free_fitted, held_out};

/// Structures fitted when the dynamics are estimated once more.
const REFIT: usize = 16;
/// Loss, as a share of the declared model's, up to which a structure is as good.
const AS_GOOD: f64 = 1.005;
/// Gain of likelihood on the held-out samples that leaves no doubt (-).
pub const DOUBTLESS: f64 = 15.0;

/// The model with dynamics that run free better than the declared model where there are any, and its held-out errors.
/// `needed`: gain of likelihood over `judged` on the held-out samples from which the declared model may run free in its place.
pub fn not_beyond(
    data: &Data,
    spec: Spec,
    (declared, at_start): (&Spec, (f64, f64)),
    judged: (f64, f64),
    needed: f64,
) -> (Spec, (f64, f64)) {
    let error = held_out(data, &spec);
    // What runs free in another's place already is no further than that.
    if error.1 < at_start.1 || (spec.free.is_some() && error.1 <= at_start.1) {
        return (spec, error);
    }
    // One step ahead its dynamics may be as good as others that run free better.
    let mut spec = longer_sighted(data, &Spec { free: None, ..spec });
    let mut error = held_out(data, &spec);
    if error.1 >= at_start.1 {
        error = with_free(data, (declared, at_start), judged, needed, &mut spec).unwrap_or(error);
    }
    (spec, error)
}

/// Another model for the free run: the declared model's A and C under this one's stem and shapes, with the shorter of both
/// delays, where that is not worse than the declared model; else, where the held-out samples leave no doubt one step ahead,
/// the declared model itself. Returns the held-out errors, if either will do.
///
/// In closed loop PV may stay nearer to where it was than an open loop under the same load would: the dynamics that are right
/// one step ahead then run free worse than ones that hardly answer to OP.
fn with_free(
    data: &Data,
    (declared, at_start): (&Spec, (f64, f64)),
    judged: (f64, f64),
    needed: f64,
    spec: &mut Spec,
) -> Option<(f64, f64)> {
    let mut slow = Spec { orders: declared.orders, linear: declared.linear.clone(), ..spec.clone() };
    let earlier = slow.orders.nk.saturating_sub(spec.orders.nk);
    slow.linear.b.splice(0..0, vec![0.0; earlier]);
    (slow.orders.nk, slow.orders.nb) = (slow.orders.nk - earlier, slow.orders.nb + earlier);
    slow.linear.gamma = vec![0.0; spec.linear.gamma.len()];
    spec.free = Some(Box::new(slow));
    let error = held_out(data, spec);
    if error.1 < at_start.1 {
        return Some(error);
    }
    let held = likelier(data, judged.0, error.0);
    spec.free = (held > needed && !is_repaired(spec)).then(|| Box::new(declared.clone()));
    spec.free.is_some().then_some((error.0, at_start.1))
}

/// Twice the log-likelihood that held-out errors gain.
pub fn likelier(data: &Data, before: f64, after: f64) -> f64 {
    2.0 * (data.len() - data.split) as f64 * (before / after).ln()
}

/// The model with the structure that runs free best on the fitted samples, of those that are as good one step ahead.
pub fn longer_sighted(data: &Data, declared: &Spec) -> Spec {
    let enough = AS_GOOD * declared.loss;
    let fitted = structures(data, declared, REFIT).into_iter().map(|mut spec| {
        minimise_towards(data, &mut spec, false, (0, 12), enough);
        spec
    });
    fitted
        .filter(|spec| spec.loss < enough)
        .map(|spec| (free_fitted(data, &spec), spec))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(|| declared.clone(), |(_, spec)| spec)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::first_order;

    /// Whatever it chose, its errors are those of what it returns: a model that ran free in another's place, too.
    #[test]
    fn the_errors_are_those_of_the_model() {
        let data = first_order(600);
        let declared = declared(&data, 0.0);
        let at_start = held_out(&data, &declared);
        let mut off = declared.clone();
        off.linear.b.iter_mut().for_each(|b| *b = -*b);
        off.linear.a.iter_mut().for_each(|a| *a *= 0.5);
        for free in [None, Some(Box::new(declared.clone())), Some(Box::new(off.clone()))] {
            for spec in [&declared, &off] {
                let spec = Spec { free: free.clone(), ..spec.clone() };
                // Nothing runs free as near as that: every way out is tried.
                for most in [at_start, (at_start.0, 0.5 * at_start.1)] {
                    let (chosen, error) = not_beyond(&data, spec.clone(), (&declared, most), most, DOUBTLESS);
                    let kept = chosen.free.as_ref().is_some_and(|free| free.linear == declared.linear);
                    let own = held_out(&data, &chosen);
                    assert!(error == own || (kept && error.1 == most.1), "{error:?} {own:?}");
                }
            }
        }
    }
}
