//! Friction that differs by direction or drifts: the valves that are proposed with it.

use super::beam::FixedDynamics;
use super::cells::Family;
use super::search::range_about;
use crate::residual::effect::EffectModel;
use crate::residual::hypotheses::proposal::{Proposal, best};
use crate::residual::screening::Screen;
use crate::sysid::arx::Arx;
use crate::sysid::valve::{StopRule, ValveModel};

/// Factor to each side of S in a beam search beside an asymmetry or a drift of friction, which moves S.
const BANDED: f64 = 1.6;
/// Largest asymmetry and drift of friction (-): at 1, one direction or one end of the record would have no friction.
pub const MOST_UNEQUAL: f64 = 0.95;

/// Proposals of an effect that changes the bands S and J, an asymmetry or a drift: at each of its values the best valve of the
/// present stop rule is searched for, and the best two are proposed.
///
/// * `values`: values of the effect's parameter.
/// * `set`: adds a value to a valve.
/// * `effect`: the effect with a value.
pub fn propose_bands(
    screen: &Screen<'_>,
    values: &[f64],
    set: impl Fn(&mut ValveModel, f64),
    effect: impl Fn(f64) -> Box<dyn EffectModel>,
) -> Vec<Proposal> {
    let (data, base) = (screen.data, screen.hypothesis());
    let Some(own) = base.valve else { return Vec::new() };
    let y = base.pv(data);
    let arx = Arx::new(data, &y, &screen.signals.shapes);
    let fit = &screen.arx_fit;
    let fixed = FixedDynamics::new(data, base, fit, &screen.signals.x);
    let mut family = Family { rule: own.rule, ratio: Some(own.j / own.s), resolution: own.resolution };
    if own.j != own.s && own.rule != StopRule::Reversal {
        family.ratio = None;
    }
    let full = base.full_valve().unwrap_or(own);
    // Small values are likelier, and come first: the second best loss so far ends the searches that exceed it.
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].abs().total_cmp(&values[*b].abs()));
    let mut rated: Vec<(f64, usize, ValveModel)> = Vec::new();
    for at in order {
        let mut bands = full;
        set(&mut bands, values[at]);
        if bands.asymmetry.abs() < MOST_UNEQUAL && bands.drift.abs() < MOST_UNEQUAL {
            let enough = rated.get(1).map_or(f64::INFINITY, |second| second.0);
            let found = fixed.beam_search(family, range_about(data, &own, BANDED), &bands, 1, enough);
            rated.extend(found.into_iter().map(|(loss, valve)| (loss, at, valve)));
            rated.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            rated.truncate(2);
        }
    }
    let proposals = rated.into_iter().map(|(_, at, valve)| {
        let plain = ValveModel { asymmetry: own.asymmetry, drift: own.drift, stops: own.stops, ..valve };
        let effect = effect(values[at]);
        let other = base.with_valve(Some(plain)).with(effect.boxed());
        let x = other.to_process(data, other.stem(data).0);
        let gain = arx.fit(&x, Some(fit)).log_likelihood - fit.log_likelihood;
        Proposal { effect, valve: Some(plain), gain }
    });
    best(proposals.collect(), 2)
}
