//! Second opinions: what the published methods say of a window that was diagnosed.
//!
//! They are information beside the verdict. A method that panics has no opinion, and takes neither the others' nor the
//! verdict with it.

use crate::detectors::{Agreement, Facts, Method, Opinion, agreement, opinion};
use crate::diagnosis::Verdict;
use crate::signal::Window;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What the methods say, in the order of [`Method::ALL`], and how they agree.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Second {
    pub opinions: Vec<Opinion>,
    pub agreement: Agreement,
}

/// Asks every method about a window.
///
/// * `integrates`: whether the process integrates, where somebody knows it.
/// * `found`: the verdict of the diagnosis of this window, which says whether the oscillation is undersampled.
/// * `verdict_sticks`: whether the valve sticks, where the verdict that counts can tell.
pub(super) fn second_opinions(
    window: &Window,
    integrates: Option<bool>,
    found: &Verdict,
    verdict_sticks: Option<bool>,
) -> Second {
    asked(window, integrates, found, verdict_sticks, opinion)
}

const FAILED: &str = "the method failed; the log says why";

fn asked(
    window: &Window,
    integrates: Option<bool>,
    found: &Verdict,
    verdict_sticks: Option<bool>,
    of: impl Fn(Method, &Facts<'_>) -> Opinion,
) -> Second {
    let facts = catch_unwind(AssertUnwindSafe(|| Facts::new(window, integrates)));
    let facts = facts.unwrap_or_else(|_| Err(FAILED.into())).map(|facts| facts.with_verdict(found));
    let one = |method: Method| match &facts {
        Ok(facts) => catch_unwind(AssertUnwindSafe(|| of(method, facts)))
            .unwrap_or_else(|_| Opinion::cannot_tell(method, FAILED)),
        Err(why) => Opinion::cannot_tell(method, why.clone()),
    };
    let opinions: Vec<Opinion> = Method::ALL.into_iter().map(one).collect();
    let regular = facts.as_ref().is_ok_and(|facts| facts.oscillates().is_ok());
    let agreement = agreement(&opinions, verdict_sticks, regular);
    Second { opinions, agreement }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detectors::Says;
    use crate::diagnosis::NotIdentifiable;
    use std::f64::consts::TAU;

    fn wave() -> Window {
        let op: Vec<f64> = (0..400).map(|k| (TAU * f64::from(k) / 40.0).sin()).collect();
        let pv = (0..400).map(|k| (TAU * f64::from(k) / 40.0 - 1.0).sin()).collect();
        Window { ts: 1.0, op, pv, ..Window::default() }
    }

    #[test]
    fn one_that_panics_takes_no_other_with_it() {
        let whole = second_opinions(&wave(), Some(false), &Verdict::Stiction, Some(true));
        let torn = asked(&wave(), Some(false), &Verdict::Stiction, Some(true), |method, facts| {
            assert_ne!(method, Method::He2007, "made for a test");
            opinion(method, facts)
        });
        assert_eq!(whole.opinions.len(), Method::ALL.len());
        for (whole, torn) in whole.opinions.iter().zip(&torn.opinions) {
            let failed = torn.says == Says::CannotTell && torn.why == FAILED;
            assert!(if torn.method == Method::He2007 { failed } else { whole == torn }, "{torn:?}");
        }
    }

    #[test]
    fn a_sine_is_no_sticking_valve_and_agrees_with_a_verdict_that_says_so() {
        let Second { opinions, agreement } =
            second_opinions(&wave(), Some(false), &Verdict::NoStiction, Some(false));
        let he = opinions.iter().find(|o| o.method == Method::He2007).expect("asked");
        assert_eq!(he.says, Says::Sound);
        assert!(agreement.agree > 0 && !agreement.doubtful, "{agreement:?}");
        let nothing = second_opinions(&Window::default(), None, &Verdict::NoStiction, None);
        assert!(nothing.opinions.iter().all(|o| o.says == Says::CannotTell));
        assert_eq!((nothing.agreement.could_tell, nothing.agreement.agree), (0, 0));
    }

    #[test]
    fn of_an_undersampled_window_the_reason_of_the_diagnosis_comes_first() {
        let why = NotIdentifiable::Undersampled { samples: 2.2, poll_s: Some(39.0), mean_s: None };
        let said = why.to_string();
        let found = Verdict::NotIdentifiable(why);
        let Second { opinions, agreement } = second_opinions(&wave(), Some(false), &found, None);
        assert_eq!((agreement.could_tell, agreement.doubtful), (0, false));
        for own in &opinions {
            let stem = own.method == Method::StemLoop;
            assert_eq!(own.why == said, !stem, "{own:?}");
        }
    }
}
