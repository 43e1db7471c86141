//! JSON of webhooks and of Alertmanager's API. Pure; the names are those of the API.

use super::batch::Digest;
use super::notice::{Friction, Notice, Source};
use super::time::iso;
use crate::results::words::short;
use serde::Serialize;
use std::collections::BTreeMap;

/// A webhook's body, in the shape that Standard Webhooks recommends.
#[derive(Serialize)]
struct Webhook<'d> {
    r#type: &'static str,
    timestamp: String,
    data: Alarms<'d>,
}

#[derive(Serialize)]
struct Alarms<'d> {
    site: Option<&'d str>,
    version: &'static str,
    alarms: Vec<Alarm<'d>>,
    more: Vec<More>,
    lost: u64,
}

/// One change of an alarm.
#[derive(Serialize)]
struct Alarm<'d> {
    id: String,
    event: &'static str,
    time: String,
    r#loop: Option<&'d str>,
    device: Option<&'d str>,
    kind: &'static str,
    priority: &'static str,
    groups: &'d [String],
    state: &'static str,
    raised_at: Option<String>,
    detail: &'d str,
    f: Option<f64>,
    f_ci95: Option<[f64; 2]>,
    f_unit: Option<&'static str>,
    delta_aic: Option<f64>,
    by: Option<&'d str>,
    comment: Option<&'d str>,
    swings_with: Option<&'d str>,
    link: Option<&'d str>,
}

/// Changes that are only counted.
#[derive(Serialize)]
struct More {
    event: &'static str,
    kind: &'static str,
    count: u64,
}

/// The body of a webhook, made at `now` (s).
pub(super) fn webhook(digest: &Digest, source: &Source, now: f64) -> String {
    let more = digest.more.iter();
    let more =
        more.map(|(what, kind, count)| More { event: what.as_str(), kind: kind.as_str(), count: *count });
    let data = Alarms {
        site: source.site.as_deref(),
        version: env!("CARGO_PKG_VERSION"),
        alarms: digest.notices.iter().map(alarm).collect(),
        more: more.collect(),
        lost: digest.lost,
    };
    json(&Webhook { r#type: "alarms", timestamp: iso(now), data })
}

fn alarm(notice: &Notice) -> Alarm<'_> {
    let friction = notice.friction.as_ref();
    let device = notice.alarm.kind.of_device();
    let subject = notice.alarm.subject.as_str();
    Alarm {
        id: notice.alarm.to_string(),
        event: notice.what.as_str(),
        time: iso(notice.at),
        r#loop: (!device).then_some(subject),
        device: device.then_some(subject),
        kind: notice.alarm.kind.as_str(),
        priority: notice.priority.as_str(),
        groups: &notice.groups,
        state: notice.state.as_str(),
        raised_at: notice.raised_at.map(iso),
        detail: &notice.detail,
        f: friction.map(|friction| friction.f),
        f_ci95: friction.and_then(|friction| friction.interval),
        f_unit: friction.map(|friction| friction.unit),
        delta_aic: friction.and_then(|friction| friction.evidence),
        by: notice.by.as_deref(),
        comment: notice.comment.as_deref(),
        swings_with: notice.swings_with.as_ref().map(|order| order.source.as_str()),
        link: notice.link.as_deref(),
    }
}

/// Names and values that make an alert what it is, or say more of it.
pub(super) type Texts = BTreeMap<&'static str, String>;

/// One alert of Alertmanager's API v2.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Alert<'a> {
    pub labels: &'a Texts,
    pub annotations: &'a Texts,
    pub starts_at: String,
    pub ends_at: String,
    #[serde(rename = "generatorURL", skip_serializing_if = "Option::is_none")]
    pub generator_url: Option<&'a str>,
}

/// The body of `POST /api/v2/alerts`.
pub(super) fn alerts(alerts: &[Alert<'_>]) -> String {
    json(&alerts)
}

/// Friction in a person's numbers: `f 2.50 % OP, half of what the valve ignores (95 %: 2.40 to 2.60)`.
pub(super) fn friction(friction: &Friction) -> String {
    let mut text = format!("f {} {}, half of what the valve ignores", short(friction.f), friction.unit);
    if let Some([low, high]) = friction.interval {
        text += &format!(" (95 %: {} to {})", short(low), short(high));
    }
    text
}

fn json(value: &impl Serialize) -> String {
    // Structs of texts and finite numbers always have a JSON.
    serde_json::to_string(value).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::{Kind, Priority};
    use crate::notify::filter::What;
    use crate::notify::notice::tests::{notice, source};
    use serde_json::Value;
    use std::collections::BTreeSet;

    #[test]
    fn friction_is_told_in_figures_that_suit_its_unit() {
        let of = |f, interval, unit| friction(&Friction { f, interval, unit, evidence: None });
        let percent = "f 2.50 % OP, half of what the valve ignores (95 %: 2.40 to 2.60)";
        assert_eq!(of(2.5, Some([2.4, 2.6]), "% OP"), percent);
        // OP may be a share of its span.
        let share = "f 0.00412 OP units, half of what the valve ignores (95 %: 0.00380 to 0.0110)";
        assert_eq!(of(0.004_12, Some([0.0038, 0.011]), "OP units"), share);
        assert_eq!(of(0.0, None, "% OP"), "f 0 % OP, half of what the valve ignores");
    }

    /// The body that the document shows has the keys of one that is sent.
    #[test]
    fn the_document_shows_every_key_of_a_body() {
        let document = include_str!("../../docs/notifications.md");
        let block = document.split("```json\n").nth(1).and_then(|rest| rest.split("```").next());
        let shown: Value = serde_json::from_str(block.expect("a body")).expect("JSON");
        let notices = vec![notice("A/stiction", Priority::High)];
        let digest = Digest { notices, more: vec![(What::Raised, Kind::TagBad, 12)], lost: 0 };
        let sent: Value = serde_json::from_str(&webhook(&digest, &source(), 0.0)).expect("JSON");
        for at in ["", "/data", "/data/alarms/0", "/data/more/0"] {
            let keys = |body: &Value| -> BTreeSet<String> {
                let object = body.pointer(at).and_then(Value::as_object);
                object.expect("an object").keys().cloned().collect()
            };
            assert_eq!(keys(&shown), keys(&sent), "{at}");
        }
    }
}
