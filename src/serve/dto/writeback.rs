//! Write-back as JSON.

use super::{finite, rfc3339};
use crate::compensation::gate::{Denial, Event, News, Status};
use crate::compensation::measure::Measured;
use serde::Serialize;
use utoipa::ToSchema;

/// A loop's write-back.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct WritebackView {
    /// `disabled`, `shadow`, `armed`, `active`, `withdrawing`, `tripped`.
    pub state: String,
    /// Since when.
    pub since: Option<String>,
    /// The term [% of OP span]; in `shadow` and `armed` what it would be.
    pub term_percent: Option<f64>,
    /// The term in force [%].
    pub in_force_percent: Option<f64>,
    /// Why it is not open, or closes; empty while nothing speaks against it.
    pub denials: Vec<DenialItem>,
    /// What tripped it; null unless it did.
    pub tripped_by: Option<DenialItem>,
    /// The grant; null where there is none.
    pub grant: Option<GrantItem>,
    /// How much of the stretch before is measured (s).
    pub baseline_s: Option<f64>,
    /// Before and with the term, over the same length; null before the first activation.
    pub effect: Option<Effect>,
}

/// A reason.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct DenialItem {
    /// For machines.
    pub code: String,
    /// For people.
    pub text: String,
}

impl From<Denial> for DenialItem {
    fn from(denial: Denial) -> Self {
        Self { code: denial.code().to_string(), text: denial.text().to_string() }
    }
}

/// A grant.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct GrantItem {
    /// Who gave it.
    pub by: String,
    /// Who approved it; null while it waits.
    pub approved_by: Option<String>,
    /// Until when.
    pub until: Option<String>,
}

/// What the term does, measured.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Effect {
    /// Before the latest activation.
    pub before: MeasuredItem,
    /// Over the latest whole stretch of the same length with the term; null until there is one.
    pub with: Option<MeasuredItem>,
    /// The stretch under way.
    pub running: Option<MeasuredItem>,
    /// ISE before over ISE with the term (-).
    pub ise_gain: Option<f64>,
    /// Travel with the term over travel before (-).
    pub travel_ratio: Option<f64>,
    /// Whether the gain asked for has been shown.
    pub proven: bool,
}

/// One stretch.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct MeasuredItem {
    /// Length (s).
    pub length_s: Option<f64>,
    /// ∫ (SP − PV)² dt (PV unit² s).
    pub ise: Option<f64>,
    /// ∫ |SP − PV| dt (PV unit s).
    pub iae: Option<f64>,
    /// Standard deviation of PV (PV unit).
    pub pv_sd: Option<f64>,
    /// Way of the stem [% of its span].
    pub travel_percent: Option<f64>,
    /// Turns of the stem.
    pub reversals: u64,
    /// `measured`, or `model`: what a valve with the friction found makes of its input.
    pub stem: &'static str,
}

impl From<Measured> for MeasuredItem {
    fn from(m: Measured) -> Self {
        Self {
            length_s: finite(m.length_s),
            ise: finite(m.ise),
            iae: finite(m.iae),
            pv_sd: finite(m.pv_sd),
            travel_percent: finite(m.travel),
            reversals: m.reversals,
            stem: if m.stem_measured { "measured" } else { "model" },
        }
    }
}

impl From<&Status> for WritebackView {
    fn from(status: &Status) -> Self {
        let grant = status.grant.as_ref().map(|grant| GrantItem {
            by: grant.by.clone(),
            approved_by: grant.approved_by.clone(),
            until: rfc3339(grant.until.wall),
        });
        let effect = status.before.map(|before| Effect {
            before: before.into(),
            with: status.with.map(MeasuredItem::from),
            running: status.running.map(MeasuredItem::from),
            ise_gain: status.with.and_then(|with| finite(before.ise / with.ise)),
            travel_ratio: status.with.and_then(|with| finite(with.travel / before.travel)),
            proven: status.proven,
        });
        Self {
            state: status.state.as_str().to_string(),
            since: status.since.and_then(rfc3339),
            term_percent: finite(status.term),
            in_force_percent: finite(status.in_force),
            denials: status.denials.iter().copied().map(DenialItem::from).collect(),
            tripped_by: status.tripped_by.map(DenialItem::from),
            grant,
            baseline_s: finite(status.baseline_s),
            effect,
        }
    }
}

/// Something that happened to write-back.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct WritebackNews {
    /// When.
    pub time: Option<String>,
    /// `transition`, `grant`, `approval`, `grant_expired`, `grant_dropped`.
    pub what: &'static str,
    /// State before, of a transition.
    pub from: Option<&'static str>,
    /// State after, of a transition.
    pub to: Option<&'static str>,
    /// Why, of a transition.
    pub cause: Option<&'static str>,
    /// Who, where somebody did.
    pub by: Option<String>,
}

impl From<&News> for WritebackNews {
    fn from(news: &News) -> Self {
        let plain = |what, by: Option<&String>| Self {
            time: rfc3339(news.at),
            what,
            from: None,
            to: None,
            cause: None,
            by: by.cloned(),
        };
        match &news.event {
            Event::Moved { from, to, cause, by } => Self {
                from: Some(from.as_str()),
                to: Some(to.as_str()),
                cause: Some(cause.code()),
                ..plain("transition", by.as_ref())
            },
            Event::Granted { by, .. } => plain("grant", Some(by)),
            Event::Approved { by } => plain("approval", Some(by)),
            Event::GrantExpired => plain("grant_expired", None),
            Event::GrantDropped { by } => plain("grant_dropped", Some(by)),
        }
    }
}
