//! The gain and phase margins of a loop by a diagnosis, where the models of its valve and its process are linear.

use super::dead_time::good_model;
use crate::diagnosis::Verdict;
use crate::indicators::margins::{Margins, margins};
use crate::residual::{Effect, Kind};
use crate::results::Judged;

/// The margins by a diagnosis; `None` where they are not known.
///
/// * The diagnosis says that the valve does not stick, and its model has no friction and is good, as for the dead time.
/// * No term of write-back acts in the window, because the controller does not make it.
/// * The model has no change of the process, no curve and no stop of the valve, and no clock that is off: then one open loop does not
///   describe the whole window.
///
/// `op_limits`: the controller's output limits (OP unit), where known.
pub fn margins_of(judged: &Judged, op_limits: Option<(f64, f64)>) -> Option<Margins> {
    let (own, model) = (&judged.diagnosis, good_model(judged)?);
    let is_linear = match judged.replaced_by() {
        Some(found) => !found.effects.iter().any(is_not_linear),
        // The stem of a declared model may lag OP by an f that is too small to matter.
        None => own.estimate.as_ref().is_some_and(|estimate| estimate.f == 0.0),
    };
    let is_sound = *judged.verdict() == Verdict::NoStiction;
    if !is_sound || !is_linear || own.preparation.compensated > 0.0 {
        return None;
    }
    let window = own.shown_window()?;
    margins(&window, op_limits, model)
}

/// Whether a loop with this effect is not linear, or does not stay as it is.
fn is_not_linear(effect: &Effect) -> bool {
    effect.kind.is_between_op_and_pv() || effect.kind == Kind::ClockSkew
}

#[cfg(test)]
mod tests {
    use super::super::dead_time::tests::estimate;
    use super::*;
    use crate::diagnosis::{Diagnosis, Model, NotIdentifiable, Preparation, Residual};
    use crate::results::{made_effect, made_findings};
    use crate::signal::Window;

    /// A PI controller of a first-order process, without noise; the set point moves.
    fn window() -> Window {
        let sp = |k: usize| 50.0 + [0.0, 2.0, -1.0, 1.0][k / 50 % 4];
        let (mut y, mut last) = (0.0, 0.0);
        let mut window = Window { ts: 1.0, sp: Some((0..1000).map(sp).collect()), ..Window::default() };
        for k in 0..1000_usize {
            let op = |back: usize| k.checked_sub(back).map_or(50.0, |at| window.op[at]);
            y = 0.9 * y + 0.1 * (op(3) - 50.0);
            let e = sp(k) - (50.0 + y);
            let next = op(1) + 5.0 * e - 4.5 * last;
            window.op.push(next);
            window.pv.push(50.0 + y);
            last = e;
        }
        window
    }

    /// A diagnosis of it with its true model.
    fn judged(verdict: Verdict, f: f64) -> Judged {
        let model = Model { na: 1, nb: 1, nc: 0, nk: 3, a: vec![-0.9], b: vec![0.1], c: vec![], rmse: 0.01 };
        let preparation = Preparation { n: 1000, ts: 1.0, ..Preparation::default() };
        let residual = Some(Residual { white: true, one_step_rmse: 0.01, free_run_rmse: 0.1 });
        let bare = Diagnosis::bare(verdict, "made for a test");
        let window = Some(window());
        Diagnosis { preparation, residual, estimate: estimate(f, model), window, ..bare }.into()
    }

    fn gain(judged: &Judged) -> Option<f64> {
        margins_of(judged, None)?.gain
    }

    #[test]
    fn a_linear_loop_has_margins_also_when_its_window_is_packed() {
        let sound = judged(Verdict::NoStiction, 0.0);
        let is_true = |gain: Option<f64>, within: f64| gain.is_some_and(|gain| (gain - 1.236).abs() < within);
        assert!(is_true(gain(&sound), 1e-3), "{:?}", gain(&sound));
        let packed = sound.packed();
        assert!(is_true(gain(&packed), 0.01), "{:?}", gain(&packed));
    }

    #[test]
    fn what_is_not_linear_has_none() {
        assert_eq!(gain(&judged(Verdict::Stiction, 2.0)), None);
        assert_eq!(gain(&judged(Verdict::NoStiction, 0.05)), None);
        assert_eq!(gain(&judged(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), 0.0)), None);
        let mut compensated = judged(Verdict::NoStiction, 0.0);
        compensated.diagnosis.preparation.compensated = 0.1;
        assert_eq!(gain(&compensated), None);
        let mut coloured = judged(Verdict::NoStiction, 0.0);
        coloured.diagnosis.residual.iter_mut().for_each(|residual| residual.white = false);
        assert_eq!(gain(&coloured), None);

        // What was traced replaces the declared model, and its friction.
        let traced = |kinds: &[Kind]| {
            let mut own = judged(Verdict::NoStiction, 2.0);
            let effects = kinds.iter().map(|kind| made_effect(*kind, 0.99)).collect();
            let mut found = made_findings(Verdict::NoStiction, effects);
            found.model = own.diagnosis.estimate.clone().expect("an estimate").model;
            own.findings = Some(found);
            gain(&own)
        };
        assert!(traced(&[]).is_some() && traced(&[Kind::LoadStep, Kind::OscillatingLoad]).is_some());
        for kind in [Kind::GainChange, Kind::DeadTimeChange, Kind::StaticNonlinearity, Kind::ClockSkew] {
            assert_eq!(traced(&[Kind::LoadStep, kind]), None, "{kind}");
        }
    }
}
