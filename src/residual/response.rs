//! Whether PV answers to the stem of a hypothesis rather than to OP itself, by a regression on both (see
//! [`crate::sysid::encompass`]).

use super::findings::{Evidence, Kind};
use super::fit::{Fitted, has_positive_feedback};
use super::hypothesis::Hypothesis;
use crate::sysid::encompass::{Encompassing, Response};
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::valve::ValveModel;

/// Whether PV follows the stem beside the effects, and does not move against the stem once OP is in the regression too. The stem is
/// that of the one-parameter valve with the same f, whatever its J. True where the samples are too few for the regression.
pub fn pv_follows_stem(data: &IdData, best: &Fitted) -> bool {
    if has_positive_feedback(data, &best.model) {
        return false;
    }
    let best = &best.hypothesis;
    let valve = best.valve.map(|valve| ValveModel::one_parameter(valve.f()));
    let stem = Hypothesis { valve, effects: Vec::new() }.stem(data).0;
    // The effects act on OP as they act on the stem.
    let [p, u] = [stem, data.u.clone()].map(|own| best.to_process(data, own));
    let is_mapped = best.effects.iter().any(|effect| effect.maps_stem());
    let mut loads = Vec::new();
    best.effects.iter().for_each(|effect| effect.shapes(data, &mut loads));
    encompassing(data, best, &loads, [&p, &u])
        .is_none_or(|found| found.is_seen() && (is_mapped || !found.is_reversed()))
}

/// The evidence for effect `at`. For a stop beyond which PV follows OP the log odds are minus infinity.
///
/// * `log_odds`, `over_none`: logarithms of its odds on the fitted samples, against all else and against the model without it (-).
/// * `held_out`: standard deviations by which the held-out samples are likelier with it (-).
pub fn effect_evidence(
    data: &IdData,
    best: &Hypothesis,
    at: usize,
    [log_odds, over_none, held_out]: [f64; 3],
) -> Evidence {
    let refuted = best.effects[at].kind() == Kind::ValveSaturation && !is_stop(data, best, at);
    let [log_odds, over_none] = if refuted { [f64::NEG_INFINITY; 2] } else { [log_odds, over_none] };
    Evidence { log_odds, over_none, held_out, beside_friction: best.valve.is_some() }
}

/// Whether the stop that is effect `at` is one: PV follows the stem up to it, and does not follow the part of the stem beyond it.
/// Loads that enter the equation are left out, because they may make up for a stop that is not there.
fn is_stop(data: &IdData, best: &Hypothesis, at: usize) -> bool {
    let arrives = |of: &Hypothesis| of.to_process(data, of.stem(data).0);
    let (p, whole) = (arrives(best), arrives(&best.without(at)));
    let lost: Vec<f64> = whole.iter().zip(&p).map(|(whole, p)| whole - p).collect();
    encompassing(data, best, &[], [&p, &lost])
        .is_none_or(|found| found.is_seen() && !found.is_seen_of_other())
}

/// The regression of PV on the stem `p` and on `u` beside it, with the loads `extra`; `None` where samples are too few.
fn encompassing(
    data: &IdData,
    best: &Hypothesis,
    extra: &[Vec<f64>],
    [p, u]: [&[f64]; 2],
) -> Option<Response> {
    let counts: Vec<bool> = data.weight.iter().map(|weight| *weight > 0.0).collect();
    let (y, rows, lags) = (best.pv(data), data.rows(), LONGEST_LAG);
    let (counts, gain_sign) = (counts.as_slice(), data.gain_sign);
    Encompassing { y: &y, u, p, extra, lags, rows, counts, gain_sign }.response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::Lasting;
    use crate::residual::fit::fit_anew;
    use crate::residual::hypotheses::restored;
    use crate::signal::Window;
    use crate::sysid::valve::Start;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A lag behind a valve of this dead band and these stops whose OP swings by ±5; `gain` of the process.
    fn record(s: f64, stop: f64, gain: f64) -> IdData {
        let n = 1200;
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(3));
        let mut next = || draw.next().unwrap_or(0.0);
        let swing = |k: usize| 3.0 * (0.11 * k as f64).sin() + 2.0 * (0.043 * k as f64).cos();
        let op: Vec<f64> = (0..n).map(|k| swing(k) + 0.02 * next()).collect();
        let (mut y, mut stem, mut pv) = (0.0, 0.0f64, vec![0.0; n]);
        for k in 1..n {
            stem = stem.clamp(op[k - 1] - 0.5 * s, op[k - 1] + 0.5 * s).min(stop);
            y = 0.8 * y + 0.2 * gain * stem;
            pv[k] = y + 0.1 * next();
        }
        let window = Window { t0: 0.0, ts: 1.0, op, pv, ..Window::default() };
        IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough")
    }

    fn sticking(data: &IdData, s: f64) -> Fitted {
        let s = s / data.units.u;
        let valve = ValveModel { s, j: s, ..ValveModel::default() };
        fit_anew(data, Hypothesis { valve: Some(valve), effects: Vec::new() }, None)
    }

    #[test]
    fn pv_follows_the_stem_of_a_valve_that_sticks() {
        let mut data = record(2.0, f64::INFINITY, 1.0);
        assert!(pv_follows_stem(&data, &sticking(&data, 2.0)));
        data.gain_sign = Some(-1.0);
        assert!(
            !pv_follows_stem(&data, &sticking(&data, 2.0)),
            "the controller says that PV has to go the other way"
        );
    }

    #[test]
    fn a_pv_that_answers_to_nothing_follows_no_stem() {
        let data = record(2.0, f64::INFINITY, 0.0);
        assert!(!pv_follows_stem(&data, &sticking(&data, 2.0)));
    }

    #[test]
    fn a_stop_is_refuted_where_pv_follows_op_beyond_it() {
        for (stop, stands) in [(2.0, true), (f64::INFINITY, false)] {
            let data = record(0.0, stop, 1.0);
            let stop = Lasting::ValveSaturation { level: 2.0, above: true, held: false };
            let best = Hypothesis { valve: None, effects: restored(&data, &stop).into_iter().collect() };
            let told = effect_evidence(&data, &best, 0, [7.0, 8.0, 2.0]);
            assert_eq!(told.log_odds == 7.0, stands, "{told:?}");
            assert!(told.held_out == 2.0 && !told.beside_friction);
        }
    }
}
