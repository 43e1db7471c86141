//! What the latest diagnosis of a loop's valve tells the analysis of the plant.

use crate::plantwide::{Friction, Untold};
use crate::residual::overruled;
use crate::results::Summary;

/// What a diagnosis says of a loop's valve; `None` where it cannot tell. `op_span`: the span of OP (OP unit), where known.
///
/// A valve that sticks by a verdict which tracing contested is told with that, as the report of the diagnosis has it.
pub fn friction_of(summary: &Summary, op_span: Option<f64>) -> Option<Friction> {
    let sticks = match summary.outcome.as_ref() {
        "stiction" => true,
        "no_stiction" => false,
        _ => return None,
    };
    let is_contested = summary.reason.contains(overruled());
    let words = summary.words();
    let words = words.trim_end_matches('.');
    let says = if sticks && is_contested { format!("{words}; {}", overruled()) } else { words.to_string() };
    // S is twice f.
    let unit = if summary.f_in_percent { op_span.map(|span| 0.01 * span) } else { Some(1.0) };
    let band = summary.f.zip(unit).map(|(f, unit)| 2.0 * f * unit);
    let evidence = summary.delta_aic.unwrap_or_default();
    Some(Friction { band, says, ..Friction::of(sticks, evidence, is_contested) })
}

/// Why a diagnosis says nothing of a loop's valve; `None` where it tells.
pub fn untold_of(summary: &Summary) -> Option<Untold> {
    let code = match summary.outcome.as_ref() {
        "stiction" | "no_stiction" => return None,
        outcome => summary.reason_code.as_deref().unwrap_or(outcome),
    };
    // The sentence says enough without the name of the reason. Only `undersampled` adds something, which people read in plain words.
    let (name, rest) = summary.reason.split_once(": ").unwrap_or_default();
    let says = match name {
        "undersampled" => format!("sampled too slowly: {rest}"),
        name if name.to_lowercase().replace(' ', "_") == code => rest.to_string(),
        _ => summary.reason.clone(),
    };
    Some(Untold { code: code.to_string(), says })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::Trigger;

    fn summary(reason: &str, f_in_percent: bool) -> Summary {
        Summary {
            time: 0.0,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            outcome: "stiction".into(),
            reason_code: None,
            reason: reason.into(),
            f: Some(2.0),
            f_ci95: Some([1.9, 2.1]),
            f_in_percent,
            delta_aic: Some(21.0),
            compensated: None,
        }
    }

    #[test]
    fn a_verdict_that_tracing_contested_says_so_and_counts_less() {
        let clear = friction_of(&summary("f = 2.000 % OP, evidence 21", true), None).expect("a verdict");
        let reason = format!("f = 2.000 % OP, evidence 21; {}", overruled());
        let contested = friction_of(&summary(&reason, true), None).expect("a verdict");
        assert_eq!(clear.says, "The valve sticks: it ignores the first 4 % OP of each reversal");
        assert_eq!(contested.says, format!("{}; {}", clear.says, overruled()));
        assert!(!clear.is_contested && contested.is_contested);
        assert!((contested.probability - 0.5 * clear.probability).abs() < 1e-12);
        assert_eq!((clear.evidence, contested.evidence), (21.0, 21.0));
    }

    #[test]
    fn friction_is_told_in_the_unit_of_op() {
        let band = |in_percent, span| friction_of(&summary("", in_percent), span).and_then(|own| own.band);
        // Per cent of 16 mA; OP's own unit; per cent of a span that is not known.
        assert!(band(true, Some(16.0)).is_some_and(|band| (band - 0.64).abs() < 1e-12));
        assert_eq!((band(false, None), band(true, None)), (Some(4.0), None));
        let silent = Summary { outcome: "panicked".into(), ..summary("", true) };
        assert_eq!(friction_of(&silent, None), None);
    }
}
