//! The step back: an effect that another one has made needless goes.
//!
//! What comes first explains a part of what it is not: a step in the load, say, where the gain changed. Once the true effect
//! is there too, the first has nothing left to explain, or little: then it has to earn its place once more, beside the other.

use super::candidate::Candidate;
use super::direct::is_direct;
use super::evidence::Judge;
use super::fit::minimise;
use super::model::{Data, Spec};
use super::regress::restructure;
use super::run::held_out;
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

/// Free-run error without an effect, as a share of that with it, up to which it is as good.
const AS_GOOD: f64 = 1.01;

/// Evidence of an effect, as a share of the last one's when that was added, below which it makes way for it.
const MAKES_WAY: f64 = 0.5;

/// Evidence that other dynamics of the model without an effect take from it at most (-).
const OF_DYNAMICS: f64 = 60.0;

/// Takes away, one at a time, the effects before the last that have less evidence against the model with all others than is
/// needed, where the free run does not suffer, or, where they `may_return`, far less than the last. The free run may not be
/// beyond `most`.
pub fn drop_needless(
    data: &Data,
    settings: &Settings,
    (most, may_return): (f64, bool),
    base: &mut Candidate,
    added: &mut Vec<Added>,
) {
    while let Some((at, without)) = needless(data, settings, (most, may_return), base, added) {
        *base = without;
        added.remove(at);
    }
}

fn needless(
    data: &Data,
    settings: &Settings,
    (most, may_return): (f64, bool),
    base: &Candidate,
    added: &[Added],
) -> Option<(usize, Candidate)> {
    let (last, earlier) = added.split_last()?;
    let earlier = (0..earlier.len()).filter(|&i| !is_direct(added[i].kind));
    let makes_way = if may_return { MAKES_WAY * last.evidence } else { f64::NEG_INFINITY };
    let rated = earlier.map(|at| {
        let (evidence, without) = without(data, base, added, at, settings.least_gain.max(makes_way));
        (evidence, at, without)
    });
    let (evidence, at, least) = rated.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let free = held_out(data, &least.spec).1;
    let nothing = evidence < settings.least_gain && free <= AS_GOOD * held_out(data, &base.spec).1;
    let far_less = evidence < makes_way;
    (free <= most && (nothing || far_less)).then_some((at, least))
}

/// The model without one of its effects, and that effect's evidence against it; other dynamics are sought for that model where they
/// may bring the evidence down to what is `needed`.
fn without(data: &Data, base: &Candidate, added: &[Added], at: usize, needed: f64) -> (f64, Candidate) {
    let mut spec = Spec { loss: f64::INFINITY, ..base.spec.clone() };
    // The declared model may run free in any other's place; one with the effect that goes may not.
    spec.free = spec.free.filter(|free| free.terms.iter().all(|t| t.kind() == Kind::ClockSkew));
    let (with, counts) = base.spec.stage(data);
    let first: usize = counts[..at].iter().sum();
    spec.terms.remove(at);
    spec.linear.gamma.drain(first..first + counts[at]);
    minimise(data, &mut spec, true, 12);
    let cost = 2.0 * counts[at] as f64 + added[at].paid;
    let evidence = |spec: &Spec| {
        let judge = Judge::new(data, &spec.stage(data).0, spec.orders.nk);
        judge.gain(data, &with, base.spec.orders.nk) - cost
    };
    let mut found = evidence(&spec);
    if found < needed + OF_DYNAMICS {
        restructure(data, &mut spec, true, 3);
        found = evidence(&spec);
    }
    let likely = base.likely;
    (found, Candidate { likely, ..Candidate::new(data, spec, base.paid - added[at].paid) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::Parameter;
    use crate::residual::model::{Linear, Stage, Term};
    use crate::residual::pose::{declared, pose};
    use crate::signal::Window;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A load that steps at a sample.
    #[derive(Clone, Debug)]
    struct Step(usize, Kind);

    impl Term for Step {
        fn kind(&self) -> Kind {
            self.1
        }
        fn boxed(&self) -> Box<dyn Term> {
            Box::new(self.clone())
        }
        fn columns(&self, data: &Data, _stage: &Stage, out: &mut Vec<Vec<f64>>) {
            out.push((0..data.len()).map(|k| f64::from(u8::from(k >= self.0))).collect());
        }
        fn describe(&self, _data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
            Default::default()
        }
    }

    /// The kinds that stay of steps at these samples, added in this order, where the load steps so far at those of `loads`.
    fn left(loads: &[(usize, f64)], steps: [(usize, Kind); 2], may_return: bool) -> Vec<Kind> {
        let n = 1500;
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(4));
        let mut draw = move || -> f64 { noise.next().unwrap_or(0.0) };
        let op: Vec<f64> = (0..n).map(|k| 50.0 + (0.037 * k as f64).cos() + 0.5 * draw()).collect();
        let mut x = 0.0;
        let pv = (0..n).map(|k: usize| {
            let load: f64 = loads.iter().filter(|(at, _)| k >= *at).map(|(_, size)| size).sum();
            x = 0.8 * x + 0.3 * (op[k.saturating_sub(2)] - 50.0) + load;
            x + 0.05 * draw()
        });
        let pv = pv.collect();
        let window = Window { t0: 0.0, ts: 1.0, op, pv, sp: None, mv: None, tags: Vec::new() };
        let data = pose(&window).expect("long enough");
        let mut spec = declared(&data, 0.0);
        spec.terms = steps.iter().map(|&(at, kind)| Step(at, kind).boxed()).collect();
        spec.linear.gamma = vec![0.0; 2];
        minimise(&data, &mut spec, true, 12);
        restructure(&data, &mut spec, true, 3);
        let mut base = Candidate::new(&data, spec, 0.0);
        let mut added = steps.map(|(_, kind)| Added { kind, evidence: 100.0, paid: 10.0 }).to_vec();
        drop_needless(&data, &Settings::default(), (f64::INFINITY, may_return), &mut base, &mut added);
        assert_eq!(base.spec.terms.len(), added.len());
        assert_eq!(base.spec.linear.gamma.len(), added.len());
        added.into_iter().map(|added| added.kind).collect()
    }

    #[test]
    fn what_a_later_effect_explains_goes_and_what_none_does_stays() {
        use Kind::{FrozenPv, GainChange, LoadStep};
        let at_700 = (700, 0.1);
        assert_eq!(
            left(&[at_700, (900, 0.1)], [(700, LoadStep), (900, GainChange)], true),
            [LoadStep, GainChange]
        );
        // Nothing happens at 900; the last is not asked again, nor is what the signals alone show.
        assert_eq!(left(&[at_700], [(900, LoadStep), (700, GainChange)], true), [GainChange]);
        assert_eq!(left(&[at_700], [(700, LoadStep), (900, GainChange)], true), [LoadStep, GainChange]);
        assert_eq!(left(&[at_700], [(900, FrozenPv), (700, GainChange)], true), [FrozenPv, GainChange]);
    }

    #[test]
    fn a_small_one_makes_way_for_a_large_one_where_it_may_return() {
        use Kind::{GainChange, LoadStep};
        let loads = [(700, 0.01), (900, 0.1)];
        let (small_first, large_first) =
            ([(700, LoadStep), (900, GainChange)], [(900, LoadStep), (700, GainChange)]);
        assert_eq!(left(&loads, small_first, true), [GainChange]);
        assert_eq!(left(&loads, small_first, false), [LoadStep, GainChange]);
        assert_eq!(left(&loads, large_first, true), [LoadStep, GainChange]);
    }
}
