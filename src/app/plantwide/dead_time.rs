//! The dead time of a loop's process, for its Harris index: that of the model which its diagnosis fitted, where this model is good.
//!
//! A model is good where its residual is white and the diagnosis says whether the valve sticks. Its delay is a whole number of
//! samples, and that of another diagnosis of the same loop may be one more or less. An index for another dead time is another index:
//! so the dead time stays as it is until a good model has one that differs by more than a sample and more than a fifth.

use crate::diagnosis::{Model, Verdict};
use crate::results::{Judged, Known};
use crate::serve::dto::Report;

/// Least change as a share of the dead time (-): a convention.
const CHANGE: f64 = 0.2;
/// Least change in samples of the model (-): between one and two, because sample periods differ a little between diagnoses.
const CHANGE_SAMPLES: f64 = 1.5;

/// The dead time of a process as a model has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadTime {
    /// Without the sample that passes before OP acts (s).
    pub own_s: f64,
    /// Sample period of the model (s).
    pub ts: f64,
}

impl DeadTime {
    /// Of a model with a delay of `nk` samples of `ts` (s), the one included that passes before OP acts.
    fn new(nk: usize, ts: f64) -> Option<Self> {
        let own_s = nk.checked_sub(1)? as f64 * ts;
        (own_s.is_finite() && ts > 0.0).then_some(Self { own_s, ts })
    }

    /// By the latest diagnosis of a loop; `None` where that has no good model.
    pub(super) fn of(known: &Known) -> Option<Self> {
        match &known.diagnosed {
            Some(run) => Self::of_judged(run.judged()?),
            None => Self::of_report(&Report::read(&known.restored.as_ref()?.report)?),
        }
    }

    /// By a diagnosis; `None` where that has no good model.
    pub fn of_judged(judged: &Judged) -> Option<Self> {
        Self::new(good_model(judged)?.nk, judged.diagnosis.preparation.ts)
    }

    /// By the report of a diagnosis, as [`DeadTime::of_judged`].
    fn of_report(report: &Report) -> Option<Self> {
        let is_good = report.residual.white_after == Some(true) && report.reason_code.is_none();
        Self::new(report.model.as_ref()?.nk, report.window.ts_s?).filter(|_| is_good)
    }
}

/// The model of a diagnosis, where it is good.
pub(super) fn good_model(judged: &Judged) -> Option<&Model> {
    let own = &judged.diagnosis;
    let declared = own.residual.as_ref().is_some_and(|residual| residual.white);
    let is_white = judged.findings.as_ref().map_or(declared, |found| found.after.white);
    let model = match judged.replaced_by() {
        Some(found) => &found.model,
        None => &own.estimate.as_ref()?.model,
    };
    let is_good = is_white && !matches!(judged.verdict(), Verdict::NotIdentifiable(_));
    is_good.then_some(model)
}

/// The dead time from now on (s), where it was `before` (s) and a good model has that.
pub(super) fn kept(before: Option<f64>, fitted: Option<DeadTime>) -> Option<f64> {
    let Some(new) = fitted else { return before };
    let stays = |old: &f64| (new.own_s - old).abs() <= (CHANGE_SAMPLES * new.ts).max(CHANGE * old);
    before.filter(stays).or(Some(new.own_s))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::diagnosis::rivals::Rival;
    use crate::diagnosis::{Diagnosis, Estimate, NotIdentifiable, Preparation, Residual};

    /// An estimate by this model, with little behind it.
    pub(in crate::app::plantwide) fn estimate(f: f64, model: Model) -> Option<Estimate> {
        Some(Estimate {
            f,
            f_ci95: [0.0, 0.1],
            f_of_op_range: 0.0,
            delta_aic: 0.0,
            rival: Rival::Linear,
            steadiness: 0.0,
            f_max: 5.0,
            d: 0.0,
            curve: Vec::new(),
            model,
            mv: Vec::new(),
        })
    }

    /// A diagnosis with a model of three samples' delay at 10 s.
    fn judged(verdict: Verdict, white: bool) -> Judged {
        let model =
            Model { na: 1, nb: 1, nc: 1, nk: 3, a: vec![-0.9], b: vec![0.1], c: vec![0.0], rmse: 0.01 };
        let preparation = Preparation { n: 1000, ts: 10.0, ..Preparation::default() };
        let residual = Some(Residual { white, one_step_rmse: 0.01, free_run_rmse: 0.1 });
        let bare = Diagnosis::bare(verdict, "made for a test");
        Diagnosis { preparation, residual, estimate: estimate(0.0, model), ..bare }.into()
    }

    #[test]
    fn only_a_good_model_has_a_dead_time_and_its_report_has_the_same() {
        let unknown = || Verdict::NotIdentifiable(NotIdentifiable::FlatPv);
        for (verdict, white, own_s) in [
            (Verdict::Stiction, true, Some(20.0)),
            (Verdict::NoStiction, true, Some(20.0)),
            (Verdict::NoStiction, false, None),
            (unknown(), true, None),
        ] {
            let judged = judged(verdict, white);
            let report = Report::new("FIC1", Some(100.0), &judged.diagnosis);
            for found in [DeadTime::of_judged(&judged), DeadTime::of_report(&report)] {
                assert_eq!(
                    found.map(|own| (own.own_s, own.ts)),
                    own_s.map(|own_s| (own_s, 10.0)),
                    "{judged:?}"
                );
            }
        }
        assert_eq!(DeadTime::new(0, 10.0), None);
        assert_eq!(DeadTime::new(1, 10.0).map(|own| own.own_s), Some(0.0));
    }

    #[test]
    fn a_dead_time_stays_until_another_differs_by_more_than_a_sample_and_a_fifth() {
        let new = |own_s, ts| Some(DeadTime { own_s, ts });
        assert_eq!((kept(None, None), kept(Some(20.0), None)), (None, Some(20.0)));
        assert_eq!(kept(None, new(20.0, 10.0)), Some(20.0));
        // One sample more or less is what a delay in whole samples differs by.
        for own_s in [10.0, 20.0, 30.0] {
            assert_eq!(kept(Some(20.0), new(own_s, 10.0)), Some(20.0));
        }
        assert_eq!(
            (kept(Some(20.0), new(40.0, 10.0)), kept(Some(20.0), new(0.0, 10.0))),
            (Some(40.0), Some(0.0))
        );
        // Of a hundred samples twenty are a fifth.
        assert_eq!(
            (kept(Some(100.0), new(120.0, 1.0)), kept(Some(100.0), new(121.0, 1.0))),
            (Some(100.0), Some(121.0))
        );
    }
}
