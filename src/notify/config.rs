//! What the configuration file says about telling others.

use super::{alertmanager, mqtt, smtp, webhook};
use crate::alarm::{Kind, Priority};
use serde::Deserialize;
use std::path::PathBuf;

/// `[notify]`: every part is off where it is left out.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the plant, where a receiver hears of several.
    #[serde(default)]
    pub site: Option<String>,
    /// Where people reach the dashboard, for links.
    #[serde(default)]
    pub public_url: Option<String>,
    /// `[notify.mqtt]`.
    #[serde(default)]
    pub mqtt: Option<mqtt::Config>,
    /// `[[notify.webhook]]`.
    #[serde(default)]
    pub webhook: Vec<webhook::Config>,
    /// `[[notify.alertmanager]]`.
    #[serde(default)]
    pub alertmanager: Vec<alertmanager::Config>,
    /// `[[notify.smtp]]`.
    #[serde(default)]
    pub smtp: Vec<smtp::Config>,
}

/// What happened to an alarm, as a receiver chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// It stands now and did not before.
    Raised,
    /// It stands no longer.
    Cleared,
    /// Somebody has seen it.
    Acknowledged,
    /// It was shelved, suppressed or taken out of service.
    Silenced,
    /// Its condition went and it stays until somebody resets it.
    Latched,
}

impl What {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            What::Raised => "raised",
            What::Cleared => "cleared",
            What::Acknowledged => "acknowledged",
            What::Silenced => "silenced",
            What::Latched => "latched",
        }
    }
}

/// What a receiver hears of when its file does not say.
pub(super) fn usual() -> Vec<What> {
    vec![What::Raised, What::Cleared]
}

/// `filter`: which alarms a receiver hears of; all where it is left out.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Filter {
    /// Of these kinds only; of every kind where it is empty.
    pub kinds: Vec<Kind>,
    /// Of this priority and above.
    pub min_priority: Priority,
    /// Of loops of these groups, and collectors that serve them; of every loop where it is empty.
    pub groups: Vec<String>,
}

impl Default for Filter {
    fn default() -> Self {
        Self { kinds: Vec::new(), min_priority: Priority::Low, groups: Vec::new() }
    }
}

impl Filter {
    /// Whether an alarm is one of them.
    pub fn takes(&self, kind: Kind, priority: Priority, groups: &[String]) -> bool {
        let own = |group: &String| groups.contains(group);
        (self.kinds.is_empty() || self.kinds.contains(&kind))
            && priority >= self.min_priority
            && (self.groups.is_empty() || self.groups.iter().any(own))
    }
}

/// `pace`: how many messages a receiver gets.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pace {
    /// After the first alarm others are waited for, to go into the same message (s).
    pub wait_s: f64,
    /// Least time between two messages (s); an alarm of high priority does not wait for it.
    pub interval_s: f64,
    /// Most messages in an hour; what is over it is in the next one.
    pub most_per_hour: usize,
    /// Most alarms told one by one in a message; the rest is counted.
    pub listed: usize,
}

impl Default for Pace {
    fn default() -> Self {
        Self { wait_s: 15.0, interval_s: 300.0, most_per_hour: 20, listed: 100 }
    }
}

impl Pace {
    fn validate(&self) -> Vec<(&'static str, &'static str, String)> {
        let mut wrong = Vec::new();
        for (field, value) in [("wait_s", self.wait_s), ("interval_s", self.interval_s)] {
            if !(0.0..=86_400.0).contains(&value) {
                wrong.push(("pace", field, format!("{value} must be 0 to 86400")));
            }
        }
        for (field, value, most) in
            [("most_per_hour", self.most_per_hour, 3600), ("listed", self.listed, 1000)]
        {
            if !(1..=most).contains(&value) {
                wrong.push(("pace", field, format!("{value} must be 1 to {most}")));
            }
        }
        wrong
    }
}

/// `retry`: how long a message is tried that is not taken.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Retry {
    /// First pause (s); each is twice the one before, the half of it by chance.
    pub first_s: f64,
    /// Longest pause (s).
    pub longest_s: f64,
    /// A message that is not taken for so long is a dead letter (s).
    pub for_s: f64,
    /// Dead letters kept; what is oldest goes first.
    pub dead_letters: usize,
}

impl Default for Retry {
    fn default() -> Self {
        Self { first_s: 1.0, longest_s: 300.0, for_s: 14_400.0, dead_letters: 100 }
    }
}

impl Retry {
    fn validate(&self) -> Vec<(&'static str, &'static str, String)> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push(("retry", field, message));
            }
        };
        let (first, longest, whole) = (self.first_s, self.longest_s, self.for_s);
        unless((0.01..=3600.0).contains(&first), "first_s", format!("{first} must be 0.01 to 3600"));
        let ok = (first..=86_400.0).contains(&longest);
        unless(ok, "longest_s", format!("{longest} must be first_s to 86400"));
        unless((0.0..=604_800.0).contains(&whole), "for_s", format!("{whole} must be 0 to 604800"));
        let most = self.dead_letters;
        unless((1..=10_000).contains(&most), "dead_letters", format!("{most} must be 1 to 10000"));
        wrong
    }
}

/// What is wrong: the table, empty for the receiver's own, the field, and why.
pub type Wrong = (&'static str, &'static str, String);

/// What is wrong with pace and retry.
pub(super) fn wrong_habits(pace: &Pace, retry: &Retry) -> Vec<Wrong> {
    [pace.validate(), retry.validate()].concat()
}

/// Where a secret is found; read anew whenever it is needed.
#[derive(Clone, Debug, PartialEq)]
pub enum Secret {
    /// In a file.
    File(PathBuf),
    /// In an environment variable.
    Env(String),
}

impl Secret {
    /// The one that a file names, if any.
    pub(super) fn of(file: &Option<PathBuf>, env: &Option<String>) -> Option<Self> {
        file.clone().map(Self::File).or_else(|| env.clone().map(Self::Env))
    }
}

/// What is wrong with a name and the places of its password.
pub(super) fn wrong_login(
    user: &Option<String>,
    file: &Option<PathBuf>,
    env: &Option<String>,
) -> Option<(&'static str, &'static str)> {
    if file.is_some() && env.is_some() {
        return Some(("password_env", "there is password_file too: leave one out"));
    }
    let alone = user.is_some() != (file.is_some() || env.is_some());
    alone.then_some(("user", "a user name and one of password_file and password_env belong together"))
}

/// Whether a host is this machine.
pub(super) fn is_loopback(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']').parse::<std::net::IpAddr>();
    host == "localhost" || address.is_ok_and(|address| address.to_canonical().is_loopback())
}

impl Config {
    /// Everything wrong with `[notify]` itself, by field; its parts are asked each for itself.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let plain =
            |text: &str| (1..=100).contains(&text.chars().count()) && !text.contains(char::is_control);
        if self.site.as_ref().is_some_and(|site| !plain(site)) {
            wrong.push(("site", "must be 1 to 100 characters".to_string()));
        }
        let is_url = |url: &String| {
            let rest = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://"));
            rest.is_some_and(|rest| !rest.is_empty()) && url.parse::<hyper::Uri>().is_ok()
        };
        if let Some(url) = self.public_url.as_ref().filter(|url| !is_url(url)) {
            wrong.push(("public_url", format!("{url:?} is no address that begins with http:// or https://")));
        }
        wrong
    }
}
