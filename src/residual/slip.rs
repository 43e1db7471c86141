//! The slip jump: every friction estimate has a kinetic lag, and it is named where the evidence for it is that of an effect.
//!
//! ```text
//! evidence = (L + L') / 2 > 12.5,   L' of the valve itself > 10
//! L  = gain in AIC over the fitted samples + n ln(V0 / V1) over those held out, of the model itself
//! L' = n ln(V0 / V1) of a long model over all samples
//! ```
//!
//! An ARMAX of low order gladly takes a stem that lags for dynamics it lacks: both count, against the valve without the lag and
//! against none, and the long one has to agree on the valve as a whole. Where the declared model saw no friction, the valve needs
//! the evidence of a verdict, too. With evidence above 20 the declared model may stay for the free run.

use super::Kind;
use super::candidate::{Candidate, FRICTION_COST};
use super::direct::is_repaired;
use super::evidence::Judge;
use super::findings::Needed;
use super::free::{DOUBTLESS, likelier, not_beyond};
use super::model::{Data, Element, Spec};
use super::needless::Added;
use super::run::held_out;

/// Gain in AIC below which nothing is looked at.
const LEAST: f64 = 7.0;
/// Evidence of the lag, and of the valve in the long model, that are needed.
const OF_LAG: f64 = 12.5;
const OF_VALVE: f64 = 10.0;
/// Evidence for which the declared model is kept for the free run.
const CERTAIN: f64 = 20.0;

/// Adds the slip jump to `added` where it earns its place; the free run stays within the declared model's, `at_start`. `needed`:
/// by the valve as a whole, where it is the first to say that it sticks.
pub fn slip_jump(
    data: &Data,
    base: &mut Candidate,
    (declared, at_start): (&Spec, (f64, f64)),
    needed: Option<&Needed>,
    added: &mut Vec<Added>,
) {
    let own = base.spec.element;
    if own.f <= 0.0 || own.lag == 0.0 {
        return;
    }
    let without = base.with_valve(data, Element { lag: 0.0, ..own }, false);
    if without.aic - base.aic <= LEAST {
        return;
    }
    let sound = base.with_valve(data, Element { f: 0.0, lag: 0.0, ..own }, false);
    let (by_armax, by_long) =
        needed.map_or((0.0, OF_VALVE), |of| (of.aic, OF_VALVE.max(of.long + FRICTION_COST)));
    if sound.aic - base.aic <= by_armax.max(LEAST) {
        return;
    }
    let (stage, _) = base.spec.stage(data);
    let against = |c: &Candidate| {
        let judge = Judge::new(data, &c.spec.stage(data).0, c.spec.orders.nk);
        judge.gain(data, &stage, base.spec.orders.nk)
    };
    let of_valve = against(&sound);
    if of_valve <= by_long {
        return;
    }
    let (mut spec, mut now) = not_beyond(data, base.spec.clone(), (declared, at_start), at_start, DOUBTLESS);
    let itself = |c: &Candidate| c.aic - base.aic + likelier(data, held_out(data, &c.spec).0, now.0);
    let evidence = 0.5 * (itself(&without) + against(&without)).min(itself(&sound) + of_valve);
    if now.1 > at_start.1 && now.0 < at_start.0 && evidence > CERTAIN && !is_repaired(&spec) {
        spec.free = Some(Box::new(declared.clone()));
        now.1 = at_start.1;
    }
    let rivalled = || needed.is_some_and(|needed| needed.is_rivalled(data, &base.spec));
    if now.1 <= at_start.1 && evidence > OF_LAG && !rivalled() {
        base.spec = spec;
        added.push(Added { kind: Kind::SlipJump, evidence, paid: 0.0 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::candidate::{Sought, with_friction};
    use crate::residual::findings::slip_effect;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::{behind_valve, noise, waves};

    /// The lag that is found of a valve with S = 2 (OP), and its sentence if it is named.
    fn found(lag: f64) -> (f64, Option<String>) {
        let mut draw = noise(5);
        let valve = Element { f: 1.0, lag, ..Element::default() };
        let data = behind_valve(&waves(1400), valve, 0.8, |_| 0.05 * draw());
        let declared = declared(&data, 1.0 / data.scale.u);
        let at_start = held_out(&data, &declared);
        let base = Candidate::new(&data, declared.clone(), 0.0);
        let mut base = with_friction(&data, base, Sought::Any { slips: true, paths: true }, &mut 0);
        let mut added = Vec::new();
        slip_jump(&data, &mut base, (&declared, at_start), None, &mut added);
        let element = base.spec.element;
        let said =
            added.first().map(|slip| slip_effect(&data, &element, slip.kind, slip.evidence).explanation);
        (element.lag, said)
    }

    #[test]
    fn a_stem_that_lags_or_slips_beyond_op_is_named_and_one_that_follows_is_not() {
        for (lag, says) in [(0.5, "lags OP by"), (-0.5, "slips beyond OP by")] {
            let (is, said) = found(lag);
            // 0.05 of noise beside jumps of 1 and 3.
            assert!((is - lag).abs() < 0.1, "{is} for {lag}");
            assert!(said.as_ref().is_some_and(|said| said.contains(says)), "{said:?}");
        }
        assert_eq!(found(0.0).1, None);
    }
}
