//! A report, as an operator would say it: [`crate::results::words`] on what the report has.

use super::dto::report::{Report, ReportCompensated, ReportEffect, ReportVerdict};
use crate::results::words::{self, Said};

pub use crate::results::words::{failed_test, percent, short};

/// An effect in words; one that has no words has only its name.
pub fn effect(found: &ReportEffect) -> Option<Said> {
    Some(words::effect(&found.kind, found.place())?.said(found.posterior))
}

/// The verdict in a sentence or two, and what stands between it and the valve.
pub fn verdict(report: &Report) -> String {
    let said = words::Verdict {
        outcome: match report.verdict {
            ReportVerdict::Stiction => "stiction",
            ReportVerdict::NoStiction => "no_stiction",
            ReportVerdict::NotIdentifiable => "not_identifiable",
        },
        reason_code: report.reason_code.as_deref(),
        reason: &report.reason,
        f: report.f,
        f_high: report.f_ci95.map(|[_, high]| high),
        unit: &report.f_unit,
        compensated: report.compensated.as_ref().and_then(ReportCompensated::read),
    };
    let swings = report.oscillation.as_ref().filter(|_| report.verdict == ReportVerdict::Stiction);
    let period = swings.and_then(|swing| swing.period_s);
    let swing =
        period.map_or_else(String::new, |t| format!(" The loop swings with a period of {} s.", short(t)));
    let archived = report.window.history.as_ref();
    let archived = archived.map_or_else(String::new, |found| format!(" The data is not raw: {}", found.note));
    // How to sample for a narrower interval concerns nearly every loop, so it is told beside the fit, and not with the verdict.
    let moved = report.acquisition.as_ref().filter(|own| own.moves_samples());
    let moved = moved.and_then(|own| own.note.as_deref());
    let moved = moved.map_or_else(String::new, |note| format!(" {}", words::sentence(note)));
    said.words() + &swing + &archived + &moved
}

/// What is to be known beside the effects: between which kinds the record lies, whether the model is worse with them, and
/// whether other methods contradict the verdict.
pub fn notes(report: &Report) -> Vec<String> {
    let residual = &report.residual;
    let between = words::between(&residual.kinds(), !residual.effects.is_empty());
    let between = between.map(|clause| words::sentence(&clause));
    let worse = residual.simulates_worse && !residual.effects.is_empty();
    between
        .into_iter()
        .chain(worse.then(|| words::simulates_worse(residual.free_run_ratio())))
        .chain(report.doubt())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::{Acquisition, Diagnosis, Preparation, Verdict};
    use crate::residual::Kind;
    use crate::results::{made_effect, made_findings};

    fn report(effects: &[(Kind, f64)]) -> Report {
        let effects = effects.iter().map(|(kind, posterior)| made_effect(*kind, *posterior)).collect();
        let declared = Diagnosis::bare(Verdict::NoStiction, "made for a test");
        let found = made_findings(Verdict::Stiction, effects);
        Report::new("FIC101", Some(100.0), &declared).with_findings(Some(100.0), &declared, &found)
    }

    #[test]
    fn a_report_is_said_with_what_was_traced() {
        let report = report(&[(Kind::StaticNonlinearity, 0.6)]);
        assert_eq!(verdict(&report), "The valve sticks: it ignores the first 4.42 % OP of each reversal.");
        let said = effect(&report.residual.effects[0]).expect("it has words");
        assert_eq!(
            said.meaning,
            "More likely than not the same movement of the valve moves PV more at one level of PV than at another."
        );
        assert!(said.advice.ends_with("at high and at low PV."), "{}", said.advice);
        let [between, worse] = &notes(&report)[..] else { panic!("two notes") };
        let told =
            ["Beside the effects named, the record ", "a gain change (48 %)", "a load step (41 %)", "(11 %)"];
        assert!(told.iter().all(|part| between.contains(part)), "{between}");
        assert!(worse.starts_with("A simulation"), "{worse}");
    }

    #[test]
    fn samples_that_were_moved_are_told_with_the_verdict_and_advice_on_sampling_is_not() {
        let said = |polls: Acquisition| {
            let preparation = Preparation { acquisition: Some(Box::new(polls)), ..Preparation::default() };
            let declared =
                Diagnosis { preparation, ..Diagnosis::bare(Verdict::NoStiction, "made for a test") };
            let report = Report::new("FIC101", Some(100.0), &declared);
            assert!(report.acquisition.as_ref().is_some_and(|own| own.note.is_some()));
            verdict(&report)
        };
        let polls = Acquisition { poll_s: Some(2.3), jitter_s: Some(0.1), ..Acquisition::default() };
        assert!(!said(polls).contains("scan"), "{}", said(polls));
        let late = Acquisition { pv_late_s: 2.0, ..Acquisition::default() };
        assert!(said(late).contains("PV is recorded 2 s late"), "{}", said(late));
    }

    #[test]
    fn a_model_without_effects_is_not_worse_for_them() {
        let [between] = &notes(&report(&[]))[..] else { panic!("one note") };
        assert!(between.starts_with("The record "), "{between}");
    }
}
