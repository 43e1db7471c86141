//! Topics and JSON of diagnoses and alarms. Pure.

use super::super::time::iso;
use crate::alarm::State;
use crate::results::{AlarmView, Summary, f_unit};
use serde::Serialize;

/// A diagnosis as subscribers read it; the names are those of the API.
#[derive(Serialize)]
struct Diagnosis<'s> {
    #[serde(rename = "loop")]
    id: &'s str,
    group: &'s str,
    time: String,
    outcome: &'s str,
    words: String,
    reason_code: Option<&'s str>,
    reason: &'s str,
    f: Option<f64>,
    f_ci95: Option<[f64; 2]>,
    f_unit: &'s str,
    delta_aic: Option<f64>,
}

/// An alarm.
#[derive(Serialize)]
struct Alarm<'s> {
    #[serde(rename = "loop")]
    id: &'s str,
    group: &'s str,
    state: &'s str,
    active: bool,
    since: Option<String>,
    raised_at: Option<String>,
    shelved_until: Option<String>,
    by: Option<&'s str>,
    comment: Option<&'s str>,
}

#[derive(Serialize)]
struct Status<'s> {
    status: &'s str,
    version: &'s str,
}

/// Fills `{group}` and `{loop}` in. What would be more than one level of a topic, or a wildcard, becomes `_`.
pub(super) fn topic(template: &str, group: &str, id: &str) -> String {
    template.replace("{group}", &level(group)).replace("{loop}", &level(id))
}

/// A name as one level of a topic.
pub(super) fn level(name: &str) -> String {
    if name.is_empty() {
        return "_".into();
    }
    name.chars().map(|c| if "/+#{}$".contains(c) || c.is_control() { '_' } else { c }).collect()
}

pub(super) fn diagnosis(id: &str, group: &str, summary: &Summary) -> Vec<u8> {
    json(&Diagnosis {
        id,
        group,
        time: iso(summary.time),
        outcome: &summary.outcome,
        words: summary.words(),
        reason_code: summary.reason_code.as_deref(),
        reason: &summary.reason,
        f: summary.f.filter(|f| f.is_finite()),
        f_ci95: summary.f_ci95.filter(|interval| interval.iter().all(|limit| limit.is_finite())),
        f_unit: f_unit(summary.f_in_percent),
        delta_aic: summary.delta_aic.filter(|evidence| evidence.is_finite()),
    })
}

pub(super) fn alarm(group: &str, view: &AlarmView) -> Vec<u8> {
    json(&Alarm {
        id: view.id.subject.as_str(),
        group,
        state: state(view.state),
        active: view.active,
        since: view.since.map(iso),
        raised_at: view.raised_at.map(iso),
        shelved_until: view.shelved_until.map(iso),
        by: view.by.as_deref(),
        comment: view.comment.as_deref(),
    })
}

/// The state's name, as the API has it.
pub(super) fn state(state: State) -> &'static str {
    state.as_str()
}

/// Whether the daemon is there.
pub(super) fn status(online: bool) -> Vec<u8> {
    let status = if online { "online" } else { "offline" };
    json(&Status { status, version: env!("CARGO_PKG_VERSION") })
}

fn json(value: &impl Serialize) -> Vec<u8> {
    // Structs of texts and finite numbers always have a JSON.
    serde_json::to_vec(value).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn topics_of_loops() {
        let template = "stictiond/{group}/{loop}/diagnosis";
        assert_eq!(topic(template, "unit 10", "FIC101"), "stictiond/unit 10/FIC101/diagnosis");
        assert_eq!(topic(template, "", "a/b+#"), "stictiond/_/a_b__/diagnosis");
        assert_eq!(topic("{loop}", "g", "{group}"), "_group_");
    }

    #[test]
    fn a_diagnosis_is_told_in_words_and_in_numbers() {
        let summary = Summary {
            time: 0.0,
            took_s: 0.1,
            trigger: crate::results::Trigger::Periodic,
            outcome: "stiction".into(),
            reason_code: None,
            reason: "f = 2.45, evidence 707".into(),
            f: Some(2.45),
            f_ci95: Some([2.4, 2.5]),
            f_in_percent: true,
            delta_aic: Some(707.0),
            compensated: None,
        };
        let told =
            serde_json::from_slice::<serde_json::Value>(&diagnosis("FIC101", "", &summary)).expect("JSON");
        assert_eq!(told["words"], "The valve sticks: it ignores the first 4.9 % OP of each reversal.");
        assert_eq!((&told["reason"], &told["delta_aic"]), (&"f = 2.45, evidence 707".into(), &707.0.into()));
    }

    #[test]
    fn times_are_told_in_utc() {
        assert_eq!(iso(1_700_000_000.25), "2023-11-14T22:13:20.25Z");
    }

    proptest! {
        /// Nothing that a loop is called leaves the place that the template gives it.
        #[test]
        fn a_name_stays_in_its_level(group in ".{0,20}", id in ".{0,20}") {
            let topic = topic("a/{group}/{loop}/b", &group, &id);
            prop_assert_eq!(topic.matches('/').count(), 3);
            prop_assert!(!topic.contains(['+', '#']));
        }
    }
}
