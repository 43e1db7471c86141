//! The step back: an effect that another one has made needless goes.
//!
//! What comes first explains a part of what it is not: a step in the load, say, where the gain changed. Once the true effect
//! is there too, the first has nothing left to explain.

use super::candidate::Candidate;
use super::direct::is_direct;
use super::evidence::Judge;
use super::fit::{held_out, minimise};
use super::model::{Data, Spec};
use super::regress::restructure;
use super::{Kind, Settings};

/// An effect in the model.
#[derive(Clone, Copy, Debug)]
pub struct Added {
    /// Its kind.
    pub kind: Kind,
    /// Evidence when it was added.
    pub evidence: f64,
    /// What its numbers and the search for them cost in AIC.
    pub paid: f64,
}

/// Takes away, one at a time, the effects before the last that have less evidence against the model with all others than is
/// needed; the free run may not suffer.
pub fn drop_needless(data: &Data, settings: &Settings, base: &mut Candidate, added: &mut Vec<Added>) {
    while let Some((at, without)) = needless(data, settings, base, added) {
        *base = without;
        added.remove(at);
    }
}

fn needless(
    data: &Data,
    settings: &Settings,
    base: &Candidate,
    added: &[Added],
) -> Option<(usize, Candidate)> {
    let judged = held_out(data, &base.spec);
    let earlier = (0..added.len().saturating_sub(1)).filter(|&i| !is_direct(added[i].kind));
    let without = earlier.map(|at| {
        let (evidence, without) = without(data, base, added, at);
        (evidence, at, without)
    });
    let (evidence, at, without) = without.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let error = held_out(data, &without.spec);
    (evidence < settings.least_gain && error.1 <= judged.1).then_some((at, without))
}

/// The model without one of its effects, and that effect's evidence against it.
fn without(data: &Data, base: &Candidate, added: &[Added], at: usize) -> (f64, Candidate) {
    let mut spec = Spec { loss: f64::INFINITY, free: None, ..base.spec.clone() };
    let (with, counts) = base.spec.stage(data);
    let first: usize = counts[..at].iter().sum();
    spec.terms.remove(at);
    spec.linear.gamma.drain(first..first + counts[at]);
    minimise(data, &mut spec, true, 12);
    restructure(data, &mut spec, true, 3);
    let judge = Judge::new(data, &spec.stage(data).0, spec.orders.nk);
    let gain = judge.gain(data, &with, base.spec.orders.nk);
    let likely = base.likely;
    let without = Candidate { likely, ..Candidate::new(data, spec, base.paid - added[at].paid) };
    (gain - 2.0 * counts[at] as f64 - added[at].paid, without)
}
