//! What the configuration file says about alarms: kinds, priorities, counts, delays and bounds.

use super::votes::{Observation, Rule};
use serde::Deserialize;

/// What an alarm is about. A loop has one of each but `collector_down`, which a collector has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The valve sticks.
    Stiction,
    /// Friction grows.
    FRising,
    /// Nothing can be said of the loop for long, and not for want of movement.
    NotIdentifiable,
    /// A tag is frozen or bad.
    TagBad,
    /// A collector brings no good sample.
    CollectorDown,
    /// Write-back was closed by a fault.
    CompensationTripped,
    /// The model leaves most of PV's movement unexplained.
    UnexplainedResidual,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Kind; 7] = [
        Kind::Stiction,
        Kind::FRising,
        Kind::NotIdentifiable,
        Kind::TagBad,
        Kind::CollectorDown,
        Kind::CompensationTripped,
        Kind::UnexplainedResidual,
    ];

    /// The kind as the API writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Kind::Stiction => "stiction",
            Kind::FRising => "f_rising",
            Kind::NotIdentifiable => "not_identifiable",
            Kind::TagBad => "tag_bad",
            Kind::CollectorDown => "collector_down",
            Kind::CompensationTripped => "compensation_tripped",
            Kind::UnexplainedResidual => "unexplained_residual",
        }
    }

    /// What an alarm of this kind is about, as mails, reports and the page call it.
    pub fn words(self) -> &'static str {
        match self {
            Kind::Stiction => "the valve sticks",
            Kind::FRising => "friction rises",
            Kind::NotIdentifiable => "cannot be told",
            Kind::TagBad => "a tag is bad",
            Kind::CollectorDown => "the collector is down",
            Kind::CompensationTripped => "write-back was closed by a fault",
            Kind::UnexplainedResidual => "much is unexplained",
        }
    }

    /// The kind of this name.
    pub fn named(name: &str) -> Option<Kind> {
        Kind::ALL.into_iter().find(|kind| kind.as_str() == name)
    }

    /// Whether it is about a collector, not about a loop.
    pub fn of_device(self) -> bool {
        self == Kind::CollectorDown
    }
}

/// How soon somebody has to act.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// When there is time.
    Low,
    /// This week.
    Medium,
    /// Today.
    High,
}

impl Priority {
    /// Every priority, lowest first.
    pub const ALL: [Priority; 3] = [Priority::Low, Priority::Medium, Priority::High];

    /// The priority as the API writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Priority::Low => "low",
            Priority::Medium => "medium",
            Priority::High => "high",
        }
    }

    /// The priority of this name.
    pub fn named(name: &str) -> Option<Priority> {
        Priority::ALL.into_iter().find(|priority| priority.as_str() == name)
    }
}

/// `[alarm]`: when alarms are raised and cleared, how urgent they are, and what keeps them from being noise.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Sticky diagnoses, of the last `n`, that raise the alarm.
    pub k: usize,
    /// Identifiable diagnoses looked back on to raise.
    pub n: usize,
    /// Clean diagnoses, of the last `clear_n`, that clear the alarm.
    pub clear_k: usize,
    /// Identifiable diagnoses looked back on to clear.
    pub clear_n: usize,
    /// A diagnosis without stiction is clean when f is at most this (% of OP span) …
    pub clear_f_percent: f64,
    /// … or when its evidence `delta_aic` is at most this (-).
    pub clear_evidence: f64,
    /// f from which stiction has medium priority (% of OP span); below it is low.
    pub medium_f_percent: f64,
    /// f from which stiction has high priority (% of OP span).
    pub high_f_percent: f64,
    /// Longest time an alarm may be shelved (s).
    pub max_shelve_s: f64,
    /// Kinds that stay after their condition is gone until somebody resets them.
    pub latch: Vec<Kind>,
    /// Alarms that are suppressed by design: `FIC101/f_rising`, or `*/f_rising` for every loop.
    pub suppressed: Vec<String>,
    /// An alarm raised this often within `chatter_s` chatters.
    pub chatter_raises: usize,
    /// See `chatter_raises` (s).
    pub chatter_s: f64,
    /// An alarm whose condition has held for longer is stale (s).
    pub stale_s: f64,
    /// More alarms than this raised within `flood_s`, over the plant, are a flood.
    pub flood_raises: usize,
    /// See `flood_raises` (s).
    pub flood_s: f64,
    /// `[alarm.f_rising]`.
    pub f_rising: RisingConfig,
    /// `[alarm.not_identifiable]`.
    pub not_identifiable: NotIdentifiableConfig,
    /// `[alarm.tag_bad]`.
    pub tag_bad: TagBadConfig,
    /// `[alarm.collector_down]`.
    pub collector_down: CollectorDownConfig,
    /// `[alarm.compensation_tripped]`.
    pub compensation_tripped: TrippedConfig,
    /// `[alarm.unexplained_residual]`.
    pub unexplained_residual: UnexplainedConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            k: 2,
            n: 3,
            clear_k: 3,
            clear_n: 4,
            clear_f_percent: 0.04,
            clear_evidence: 10.0,
            medium_f_percent: 0.5,
            high_f_percent: 2.0,
            max_shelve_s: 7.0 * 86_400.0,
            latch: vec![Kind::CompensationTripped],
            suppressed: Vec::new(),
            chatter_raises: 3,
            chatter_s: 86_400.0,
            stale_s: 30.0 * 86_400.0,
            flood_raises: 10,
            flood_s: 600.0,
            f_rising: RisingConfig::default(),
            not_identifiable: NotIdentifiableConfig::default(),
            tag_bad: TagBadConfig::default(),
            collector_down: CollectorDownConfig::default(),
            compensation_tripped: TrippedConfig::default(),
            unexplained_residual: UnexplainedConfig::default(),
        }
    }
}

/// `[alarm.f_rising]`: friction grows, by a straight line through means over `bucket_s`, each weighed by its interval.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RisingConfig {
    /// Whether there is such an alarm.
    pub enabled: bool,
    /// Its priority.
    pub priority: Priority,
    /// Time over which diagnoses make one point (s).
    pub bucket_s: f64,
    /// Points looked back on.
    pub points: usize,
    /// Least points that a line is drawn through.
    pub min_points: usize,
    /// Least rise over the points that counts (% of OP span), by the lower bound of its interval.
    pub min_rise_percent: f64,
}

impl Default for RisingConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            priority: Priority::Low,
            bucket_s: 86_400.0,
            points: 30,
            min_points: 10,
            min_rise_percent: 0.2,
        }
    }
}

/// `[alarm.not_identifiable]`: nothing can be said for long.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NotIdentifiableConfig {
    /// Whether there is such an alarm.
    pub enabled: bool,
    /// Its priority.
    pub priority: Priority,
    /// For how long without a break (s).
    pub after_s: f64,
    /// Reasons that are no fault: a loop that stands still, or in manual.
    pub ignore: Vec<String>,
}

impl Default for NotIdentifiableConfig {
    fn default() -> Self {
        let ignore = ["not_excited", "hidden_friction", "undecided", "manual", "flat_op"];
        let ignore = ignore.map(str::to_string).to_vec();
        Self { enabled: true, priority: Priority::Low, after_s: 7.0 * 86_400.0, ignore }
    }
}

/// `[alarm.tag_bad]`: the newest sample of a tag is stale, which a frozen one is too, or bad.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TagBadConfig {
    /// Whether there is such an alarm.
    pub enabled: bool,
    /// Its priority.
    pub priority: Priority,
    /// For how long without a break (s).
    pub after_s: f64,
}

impl Default for TagBadConfig {
    fn default() -> Self {
        Self { enabled: true, priority: Priority::Medium, after_s: 300.0 }
    }
}

/// `[alarm.collector_down]`: no good sample from any of a collector's tags.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CollectorDownConfig {
    /// Whether there is such an alarm.
    pub enabled: bool,
    /// Its priority.
    pub priority: Priority,
    /// For how long (s).
    pub after_s: f64,
}

impl Default for CollectorDownConfig {
    fn default() -> Self {
        Self { enabled: true, priority: Priority::High, after_s: 120.0 }
    }
}

/// `[alarm.compensation_tripped]`: write-back was closed by a fault.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrippedConfig {
    /// Whether there is such an alarm.
    pub enabled: bool,
    /// Its priority.
    pub priority: Priority,
}

impl Default for TrippedConfig {
    fn default() -> Self {
        Self { enabled: true, priority: Priority::High }
    }
}

/// `[alarm.unexplained_residual]`: the model with all its effects leaves most of PV's movement unexplained.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UnexplainedConfig {
    /// Whether there is such an alarm.
    pub enabled: bool,
    /// Its priority.
    pub priority: Priority,
    /// Share of PV's standard deviation, free run on held-out data, that counts as most of it (-).
    pub share: f64,
    /// Diagnoses of the last `n` that raise the alarm.
    pub k: usize,
    /// Identifiable diagnoses looked back on.
    pub n: usize,
}

impl Default for UnexplainedConfig {
    fn default() -> Self {
        Self { enabled: true, priority: Priority::Low, share: 0.8, k: 8, n: 10 }
    }
}

/// What is wrong: the table below `[alarm]`, empty for `[alarm]` itself, the field, and why.
pub type Wrong = (&'static str, &'static str, String);

impl Config {
    /// Everything wrong with it, by table and field; empty when it can be used.
    pub fn validate(&self) -> Vec<Wrong> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, table, field, message: String| {
            if !ok {
                wrong.push((table, field, message));
            }
        };
        let residual = &self.unexplained_residual;
        let counts = [
            ("", "n", self.n, "k", self.k),
            ("", "clear_n", self.clear_n, "clear_k", self.clear_k),
            ("unexplained_residual", "n", residual.n, "k", residual.k),
        ];
        for (table, of, n, field, k) in counts {
            unless((1..=100).contains(&n), table, of, format!("{n} must be 1 to 100"));
            unless(k >= 1 && k <= n, table, field, format!("{k} must be 1 to {of} = {n}"));
        }
        let within = |value: f64, least: f64, most: f64| (least..=most).contains(&value);
        let percents = [
            ("", "clear_f_percent", self.clear_f_percent),
            ("", "medium_f_percent", self.medium_f_percent),
            ("", "high_f_percent", self.high_f_percent),
            ("f_rising", "min_rise_percent", self.f_rising.min_rise_percent),
        ];
        for (table, field, value) in percents {
            unless(within(value, 0.0, 100.0), table, field, format!("{value} must be 0 to 100"));
        }
        let (medium, high) = (self.medium_f_percent, self.high_f_percent);
        unless(
            medium <= high,
            "",
            "high_f_percent",
            format!("{high} must be at least medium_f_percent = {medium}"),
        );
        let evidence = self.clear_evidence;
        unless(evidence.is_finite(), "", "clear_evidence", format!("{evidence} must be a number"));
        let year = 365.0 * 86_400.0;
        let times = [
            ("", "max_shelve_s", self.max_shelve_s),
            ("", "chatter_s", self.chatter_s),
            ("", "stale_s", self.stale_s),
            ("", "flood_s", self.flood_s),
            ("f_rising", "bucket_s", self.f_rising.bucket_s),
            ("not_identifiable", "after_s", self.not_identifiable.after_s),
            ("tag_bad", "after_s", self.tag_bad.after_s),
            ("collector_down", "after_s", self.collector_down.after_s),
        ];
        for (table, field, value) in times {
            unless(within(value, 1.0, year), table, field, format!("{value} must be 1 to 31536000"));
        }
        let (chatter, flood) = (self.chatter_raises, self.flood_raises);
        unless((2..=20).contains(&chatter), "", "chatter_raises", format!("{chatter} must be 2 to 20"));
        unless((1..=100_000).contains(&flood), "", "flood_raises", format!("{flood} must be 1 to 100000"));
        for text in &self.suppressed {
            let known = text.rsplit_once('/').is_some_and(|(_, kind)| Kind::named(kind).is_some());
            unless(known, "", "suppressed", format!("{text:?} must be a loop or *, / and a kind of alarm"));
        }
        let (points, least) = (self.f_rising.points, self.f_rising.min_points);
        unless((6..=400).contains(&points), "f_rising", "points", format!("{points} must be 6 to 400"));
        unless(
            (6..=points.max(6)).contains(&least),
            "f_rising",
            "min_points",
            format!("{least} must be 6 to points = {points}"),
        );
        let share = residual.share;
        unless(within(share, 0.0, 10.0), "unexplained_residual", "share", format!("{share} must be 0 to 10"));
        wrong
    }

    /// What a diagnosis says to the alarm: `sticky` is its verdict, `f` in % of OP span, `delta_aic` its evidence.
    pub fn judge(&self, sticky: bool, f_percent: f64, delta_aic: f64) -> Observation {
        if sticky {
            Observation::Present
        } else if f_percent <= self.clear_f_percent || delta_aic <= self.clear_evidence {
            Observation::Absent
        } else {
            Observation::Between
        }
    }

    /// Whether there are alarms of a kind.
    pub fn is_enabled(&self, kind: Kind) -> bool {
        match kind {
            Kind::Stiction => true,
            Kind::FRising => self.f_rising.enabled,
            Kind::NotIdentifiable => self.not_identifiable.enabled,
            Kind::TagBad => self.tag_bad.enabled,
            Kind::CollectorDown => self.collector_down.enabled,
            Kind::CompensationTripped => self.compensation_tripped.enabled,
            Kind::UnexplainedResidual => self.unexplained_residual.enabled,
        }
    }

    /// The priority of a kind; of stiction by `f` (% of OP span).
    pub fn priority(&self, kind: Kind, f_percent: Option<f64>) -> Priority {
        match kind {
            Kind::Stiction => match f_percent {
                Some(f) if f >= self.high_f_percent => Priority::High,
                Some(f) if f >= self.medium_f_percent => Priority::Medium,
                _ => Priority::Low,
            },
            Kind::FRising => self.f_rising.priority,
            Kind::NotIdentifiable => self.not_identifiable.priority,
            Kind::TagBad => self.tag_bad.priority,
            Kind::CollectorDown => self.collector_down.priority,
            Kind::CompensationTripped => self.compensation_tripped.priority,
            Kind::UnexplainedResidual => self.unexplained_residual.priority,
        }
    }

    /// How many observations raise and clear a kind.
    pub(super) fn rule(&self, kind: Kind) -> Rule {
        match kind {
            Kind::Stiction => Rule { k: self.k, n: self.n, clear_k: self.clear_k, clear_n: self.clear_n },
            // One more point of a line that has stood for `min_points` must not undo what the one before said.
            Kind::FRising => Rule { k: 2, n: 2, clear_k: 3, clear_n: 3 },
            Kind::UnexplainedResidual => {
                let UnexplainedConfig { k, n, .. } = self.unexplained_residual;
                Rule { k, n, clear_k: k.div_ceil(2), clear_n: n }
            }
            _ => Rule { k: 1, n: 1, clear_k: 1, clear_n: 1 },
        }
    }

    /// How long the condition must hold without a break before it counts (s).
    pub(super) fn delay_s(&self, kind: Kind) -> f64 {
        match kind {
            Kind::NotIdentifiable => self.not_identifiable.after_s,
            Kind::TagBad => self.tag_bad.after_s,
            _ => 0.0,
        }
    }

    /// Whether the configuration itself suppresses an alarm.
    pub(super) fn suppresses(&self, subject: &str, kind: Kind) -> bool {
        let meant = |text: &String| {
            text.rsplit_once('/')
                .is_some_and(|(whose, what)| what == kind.as_str() && (whose == "*" || whose == subject))
        };
        self.suppressed.iter().any(meant)
    }
}
