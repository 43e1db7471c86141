//! Which alerts stand and which are over. The labels of an alert say which alarm it is and nothing that changes with each
//! diagnosis: an alert whose labels change is another one.

use crate::alarm::{AlarmId, Kind, Priority};
use crate::notify::filter::Filter;
use crate::notify::notice::{Source, stands};
use crate::notify::payload::{self, Texts};
use crate::notify::time::iso;
use crate::results::AlarmView;
use std::collections::{BTreeMap, HashMap};

/// How long it is said that an alert is over (s), as Prometheus does.
const SAID_FOR: f64 = 900.0;
/// Most alerts of which it is said that they are over.
const MOST_OVER: usize = 10_000;

/// The alerts of one Alertmanager.
#[derive(Default)]
pub(super) struct Table {
    standing: BTreeMap<AlarmId, Alert>,
    over: Vec<Over>,
    /// Whether anything was looked up yet.
    begun: bool,
}

#[derive(Clone, Debug, PartialEq)]
struct Alert {
    labels: Texts,
    annotations: Texts,
    starts: f64,
    link: Option<String>,
}

struct Over {
    alert: Alert,
    ended: f64,
    noticed: f64,
}

impl Table {
    /// Takes the alarms as they are at `now` (s).
    pub(super) fn update(&mut self, source: &Source, filter: &Filter, now: f64) {
        let views = source.alarms();
        let taken = |view: &&AlarmView| filter.takes(view.id.kind, view.priority, &source.groups(&view.id));
        let mut standing = BTreeMap::new();
        for view in views.iter().filter(|view| stands(view.state)).filter(taken) {
            standing.insert(view.id.clone(), alert(view, source));
        }
        let ended: HashMap<&AlarmId, f64> =
            views.iter().filter_map(|view| Some((&view.id, view.since?))).collect();
        for (id, old) in std::mem::take(&mut self.standing) {
            match standing.get(&id) {
                Some(new) if new.labels == old.labels => {}
                // It goes on under other labels, or is no longer wanted here: over now.
                Some(_) => self.over.push(Over { alert: old, ended: now, noticed: now }),
                None => {
                    let ended = ended.get(&id).copied().filter(|ended| *ended >= old.starts);
                    self.over.push(Over { alert: old, ended: ended.unwrap_or(now).min(now), noticed: now });
                }
            }
        }
        if !std::mem::replace(&mut self.begun, true) {
            // What was cleared just before a restart may not have been said.
            let recent = |view: &&AlarmView| view.since.is_some_and(|since| now - since < SAID_FOR);
            let gone = views.iter().filter(|view| !stands(view.state) && view.raised_at.is_some());
            for view in gone.filter(recent).filter(taken) {
                let ended = view.since.unwrap_or(now);
                self.over.push(Over { alert: alert(view, source), ended, noticed: now });
            }
        }
        let again = |over: &Over| standing.values().any(|alert| alert.labels == over.alert.labels);
        self.over.retain(|over| now - over.noticed < SAID_FOR && !again(over));
        let surplus = self.over.len().saturating_sub(MOST_OVER);
        self.over.drain(..surplus);
        self.standing = standing;
    }

    /// What is sent: alerts that stand, until `expires` (s) unless sent again before, and those that are over.
    pub(super) fn alerts(&self, expires: f64) -> Vec<payload::Alert<'_>> {
        let standing = self.standing.values().map(|alert| alert.sent(expires));
        let over = self.over.iter().map(|over| over.alert.sent(over.ended));
        standing.chain(over).collect()
    }

    /// How many stand.
    pub(super) fn standing(&self) -> usize {
        self.standing.len()
    }
}

impl Alert {
    fn sent(&self, ends: f64) -> payload::Alert<'_> {
        payload::Alert {
            labels: &self.labels,
            annotations: &self.annotations,
            // A clock that was set back leaves alarms of the future, which are refused.
            starts_at: iso(self.starts.min(ends)),
            ends_at: iso(ends),
            generator_url: self.link.as_deref(),
        }
    }
}

fn alert(view: &AlarmView, source: &Source) -> Alert {
    let subject = view.id.subject.to_string();
    let of = if view.id.kind.of_device() { "collector" } else { "loop" };
    let mut labels = Texts::from([
        ("alertname", name(view.id.kind).to_string()),
        ("job", "stictiond".to_string()),
        ("kind", view.id.kind.as_str().to_string()),
        ("priority", view.priority.as_str().to_string()),
        ("severity", severity(view.priority).to_string()),
        (of, subject.clone()),
    ]);
    if let [group] = &source.groups(&view.id)[..] {
        labels.insert("group", group.clone());
    }
    if let Some(site) = &source.site {
        labels.insert("site", site.clone());
    }
    // By looks at the plant, and not by each diagnosis: it says so while an order stands and looks find the swing, and an alert that
    // it changes is another one.
    let source_of = source.swings_with(&view.id).map(|order| order.source);
    let is_source = view.id.of_loop().is_some_and(|id| source.results.is_source(id));
    if let Some(of) = source_of.as_ref().or(view.id.of_loop().filter(|_| is_source)) {
        labels.insert("swings_with", of.to_string());
        labels.insert("swing", if source_of.is_some() { "victim" } else { "source" }.to_string());
    }
    let mut annotations = Texts::from([
        ("summary", format!("{subject}: {}", view.id.kind.words())),
        ("state", view.state.as_str().to_string()),
    ]);
    let mut say = |name, text: Option<String>| {
        if let Some(text) = text.filter(|text| !text.is_empty()) {
            annotations.insert(name, text);
        }
    };
    let friction = source.friction(&view.id);
    say("description", Some(view.detail.clone()));
    say("f", friction.as_ref().map(|own| format!("{:.3} {}", own.f, own.unit)));
    let interval = friction.as_ref().and_then(|own| own.interval);
    say("f_ci95", interval.map(|[low, high]| format!("{low:.3} to {high:.3}")));
    let evidence = friction.as_ref().and_then(|own| own.evidence);
    say("evidence", evidence.map(|evidence| format!("{evidence:.1}")));
    say("by", view.by.clone());
    say("comment", view.comment.clone());
    let link = source.link(&view.id);
    say("link", link.clone());
    let starts = view.raised_at.or(view.since).unwrap_or_default();
    Alert { labels, annotations, starts, link }
}

fn name(kind: Kind) -> &'static str {
    match kind {
        Kind::Stiction => "ValveSticks",
        Kind::FRising => "FrictionRises",
        Kind::NotIdentifiable => "LoopNotIdentifiable",
        Kind::TagBad => "TagBad",
        Kind::CollectorDown => "CollectorDown",
        Kind::CompensationTripped => "CompensationTripped",
        Kind::UnexplainedResidual => "ResidualUnexplained",
    }
}

/// As Prometheus' users call it.
fn severity(priority: Priority) -> &'static str {
    match priority {
        Priority::Low => "info",
        Priority::Medium => "warning",
        Priority::High => "critical",
    }
}
