//! What a diagnosis means, as an operator would say it, and what to do about it.

use super::dto::report::{Report, ReportVerdict};

/// An effect in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effect {
    /// In a line.
    pub title: &'static str,
    /// What it means.
    pub meaning: &'static str,
    /// What to do.
    pub advice: &'static str,
}

/// An effect by its kind; one that has no words here has only its name.
pub fn effect(kind: &str) -> Option<Effect> {
    let (title, meaning, advice) = match kind {
        "oscillating_load" => (
            "A load that comes and goes",
            "Something upstream or downstream swings and this loop follows it.",
            "Find where the swing comes from: work on this valve will not end it.",
        ),
        "measured_disturbance" => (
            "Another measurement drives this loop",
            "PV follows another tag, with a delay.",
            "Look at that tag first; a feed-forward may help.",
        ),
        "load_step" => (
            "The load changed once and stayed",
            "At one moment the process moved to another balance, as when a stream is opened.",
            "Check what was switched at that time.",
        ),
        "drift" => (
            "Load or sensor drifts",
            "PV moves away at a steady rate that the valve does not explain.",
            "Check transmitter, fouling and feed.",
        ),
        "gain_change" => (
            "The process answers more, or less, than before",
            "The same movement of the valve has another effect from some time on.",
            "Check operating point and tuning.",
        ),
        "dead_time_change" => (
            "The process answers later, or earlier, than before",
            "The delay from valve to PV changed at some time.",
            "Check flow rate, analyser lag and tuning.",
        ),
        "valve_saturation" => (
            "The valve runs into its stop",
            "Beyond some OP the stem does not move any further.",
            "Check sizing and stroke calibration.",
        ),
        "static_nonlinearity" => (
            "The valve's answer is curved",
            "The same change of OP does more at one opening than at another.",
            "Check characteristic and sizing; consider a linearisation.",
        ),
        "slip_jump" => (
            "The stem lags while it moves",
            "It jumps by another amount than it sticks: there is a dead band beside the friction.",
            "Look for play in linkage and actuator as well as for friction.",
        ),
        "asymmetric_friction" => (
            "It sticks more in one direction",
            "Opening and closing need different force.",
            "Check packing, spring and air supply.",
        ),
        "friction_drift" => (
            "Friction changed over the record",
            "The valve sticks more, or less, at the end than at the beginning.",
            "Watch f: it may be getting worse.",
        ),
        "quantised_pv" => (
            "PV moves in steps",
            "The signal's resolution is coarser than its noise.",
            "Check transmitter range, compression and scaling.",
        ),
        "outliers" => (
            "Single wild PV samples",
            "Some values lie far off and come back at once.",
            "Check wiring, transmitter and data link.",
        ),
        "frozen_pv" => (
            "PV stands still at times",
            "The value repeats although the process moves.",
            "Check transmitter, impulse lines and data link.",
        ),
        "clock_skew" => (
            "Clocks disagree",
            "OP and PV are stamped by clocks that are apart.",
            "Synchronise the clocks of the data sources.",
        ),
        _ => return None,
    };
    Some(Effect { title, meaning, advice })
}

/// What a test of the residual that failed has seen.
pub fn failed_test(name: &str) -> String {
    let said = match name {
        "whiteness" => "it still depends on its own past",
        "input" => "it still follows OP",
        "tags" => "it follows another tag",
        "line_spectrum" => "it swings at one period",
        "change_point" => "its level changes",
        "drift" => "its level drifts",
        "direction" => "it depends on the stem's direction",
        "travel" => "it depends on the stem's position",
        "variance" => "its spread changes",
        "tails" => "it has single wild values",
        other => return other.replace('_', " "),
    };
    said.to_string()
}

/// Why nothing can be said.
fn not_identifiable(code: &str) -> Option<&'static str> {
    Some(match code {
        "too_short" => "There is not enough data yet.",
        "no_time_base" => "The time stamps make no sense.",
        "gaps" => "Too much of the data is missing or bad.",
        "flat_op" => "The controller does not move the valve.",
        "flat_pv" => "The measurement stands still: check the transmitter.",
        "saturated" => "The controller pushes against a limit: the valve may be too small or shut off.",
        "manual" => "The loop is not in automatic.",
        "not_excited" => "The valve is hardly asked to turn round, so that friction cannot show.",
        "no_response" => "PV does not follow the valve: stuck altogether, or not this loop's valve.",
        "out_of_scale" => "The values are too large or too small to compute with.",
        "deadline_exceeded" => "The analysis took too long.",
        _ => return None,
    })
}

/// Three significant digits, at least the whole part.
pub fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return "0".to_string();
    }
    let decimals = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

/// The verdict in a sentence or two, and what stands between it and the valve.
pub fn verdict(report: &Report) -> String {
    let archived = report.window.history.as_ref();
    let archived = archived.map_or_else(String::new, |found| format!(" The data is not raw: {}", found.note));
    said(report) + &archived
}

fn said(report: &Report) -> String {
    let unit = &report.f_unit;
    match report.verdict {
        ReportVerdict::Stiction => {
            let wide = report.f.map_or_else(String::new, |f| short(2.0 * f));
            let period = report.oscillation.as_ref().and_then(|swing| swing.period_s);
            let swing = period
                .map_or_else(String::new, |t| format!(" The loop swings with a period of {} s.", short(t)));
            format!(
                "The valve sticks: on every reversal the controller has to move {wide} {unit} before the stem follows.{swing}"
            )
        }
        ReportVerdict::NoStiction => {
            let hidden =
                report.f_ci95.filter(|[_, high]| *high > 0.0).map_or_else(String::new, |[_, high]| {
                    format!(" The record could hide an f of at most {} {unit}.", short(high))
                });
            format!("No sign of sticking.{hidden}")
        }
        ReportVerdict::NotIdentifiable => {
            let why = report.reason_code.as_deref().and_then(not_identifiable);
            format!("Nothing can be said about the valve. {}", why.unwrap_or(&report.reason))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::NotIdentifiable;
    use crate::residual::{Kind, Test};

    #[test]
    fn everything_that_can_be_found_has_words() {
        for kind in Kind::ALL {
            assert!(effect(kind.as_str()).is_some(), "{kind}");
        }
        for test in [Test::Whiteness, Test::Input, Test::Tags, Test::Line, Test::ChangePoint, Test::Drift] {
            assert!(failed_test(test.as_str()).contains(' '), "{test:?}");
        }
        let reasons = [
            NotIdentifiable::NoTimeBase,
            NotIdentifiable::FlatOp,
            NotIdentifiable::FlatPv,
            NotIdentifiable::NoResponse,
            NotIdentifiable::OutOfScale,
            NotIdentifiable::DeadlineExceeded,
            NotIdentifiable::TooShort { n: 0, need: 1 },
            NotIdentifiable::Gaps { share: 1.0 },
            NotIdentifiable::Saturated { share: 1.0 },
            NotIdentifiable::Manual { share_auto: 0.0 },
            NotIdentifiable::NotExcited { reversals: 0 },
        ];
        for reason in reasons {
            assert!(not_identifiable(reason.code()).is_some(), "{}", reason.code());
        }
        assert_eq!((effect("new_kind"), failed_test("new_test").as_str()), (None, "new test"));
    }

    #[test]
    fn numbers_are_short() {
        let said = [2.4449, 0.049_96, 73.61, 1234.5, 0.0, f64::NAN].map(short);
        assert_eq!(said, ["2.44", "0.0500", "73.6", "1234", "0", "0"]);
    }
}
