//! What the configuration file says about an MQTT broker and about a tag's place in its messages.

use super::json::Path as JsonPath;
use crate::collect::scaling::Scaling;
use crate::collect::{DecimalSign, Issue};
use crate::credentials;
use crate::host;
use crate::mqtt::{Broker, Password, default_client_id, topic_fault};
use crate::signal::Role;
use serde::Deserialize;
use std::path::PathBuf;

/// One broker, `[[mqtt]]`. Every entry has a connection and a task of its own.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name that tags refer to.
    pub name: String,
    /// `host:port`, `10.0.0.5:1883`.
    pub address: String,
    /// Whether the connection is encrypted; with `ca_file` it always is.
    #[serde(default)]
    pub tls: bool,
    /// Certificates trusted (PEM); the system's where left out.
    #[serde(default)]
    pub ca_file: Option<PathBuf>,
    /// The client's own certificate (PEM).
    #[serde(default)]
    pub certificate_file: Option<PathBuf>,
    /// Its private key (PEM).
    #[serde(default)]
    pub key_file: Option<PathBuf>,
    /// User name.
    #[serde(default)]
    pub user: Option<String>,
    /// File whose first line is the password; read at every connect.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// Environment variable that holds the password.
    #[serde(default)]
    pub password_env: Option<String>,
    /// The client's name at the broker; left out, one made of the host's and the section's. Two clients must not have the
    /// same.
    #[serde(default)]
    pub client_id: Option<String>,
    /// Longest silence before the client asks for a sign of life (s).
    #[serde(default = "default_keep_alive_s")]
    pub keep_alive_s: u16,
    /// Whether the broker forgets the client between two connections; else it keeps messages of QoS 1 meanwhile.
    #[serde(default = "default_true")]
    pub clean_session: bool,
    /// Longest wait for a connection (s).
    #[serde(default = "default_timeout_s")]
    pub timeout_s: u64,
    /// Longest pause between attempts to reconnect (ms).
    #[serde(default = "default_reconnect_max_ms")]
    pub reconnect_max_ms: u64,
    /// A connection without a readable message for longer is given up and made again (s).
    #[serde(default = "default_silent_s")]
    pub silent_s: f64,
    /// A tag without a value for longer becomes bad (s); left out, only the connection is watched.
    #[serde(default)]
    pub stale_after_s: Option<f64>,
    /// Larger messages are refused (bytes).
    #[serde(default = "default_max_payload_bytes")]
    pub max_payload_bytes: usize,
    /// Path of the time in JSON payloads, for tags that name none.
    #[serde(default)]
    pub time_path: Option<String>,
    /// Unit of times that are numbers.
    #[serde(default)]
    pub time_unit: TimeUnit,
    /// What stands in where a value carries no time.
    #[serde(default)]
    pub time_fallback: TimeFallback,
    /// Path of the quality in JSON payloads, for tags that name none.
    #[serde(default)]
    pub quality_path: Option<String>,
    /// Qualities that mean good, as text; left out `good`, `ok`, `true` and `192`.
    #[serde(default)]
    pub good_values: Option<Vec<String>>,
    /// Whether an edge node of Sparkplug B is asked for its births when they were missed.
    #[serde(default = "default_true")]
    pub request_rebirth: bool,
}

fn default_keep_alive_s() -> u16 {
    30
}
fn default_true() -> bool {
    true
}
fn default_timeout_s() -> u64 {
    5
}
fn default_reconnect_max_ms() -> u64 {
    30_000
}
fn default_silent_s() -> f64 {
    120.0
}
fn default_max_payload_bytes() -> usize {
    262_144
}

/// The unit of a time that is a number since 1970.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    #[default]
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    /// All of them.
    pub(super) const ALL: [Self; 4] = [Self::S, Self::Ms, Self::Us, Self::Ns];

    /// As the file writes it.
    pub(super) fn name(self) -> &'static str {
        match self {
            TimeUnit::S => "s",
            TimeUnit::Ms => "ms",
            TimeUnit::Us => "us",
            TimeUnit::Ns => "ns",
        }
    }

    /// How many make a second.
    pub fn per_second(self) -> f64 {
        match self {
            TimeUnit::S => 1.0,
            TimeUnit::Ms => 1e3,
            TimeUnit::Us => 1e6,
            TimeUnit::Ns => 1e9,
        }
    }
}

/// The time of a value that has none of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeFallback {
    /// When it arrived here. A retained message is stale then: nobody knows how old it is.
    #[default]
    Arrival,
    /// None: such a value is refused.
    None,
}

/// Where a tag lives at a broker: `[loop.op]`, `[[loop.tag]]`, … with `topic`, or with `sparkplug` and `metric`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TagConfig {
    /// Name of an extra tag; the five roles of a loop have none.
    #[serde(default)]
    pub name: Option<String>,
    /// Name of the `[[mqtt]]`.
    pub device: String,
    /// Topic of JSON or of plain numbers.
    #[serde(default)]
    pub topic: Option<String>,
    /// Path of the value in JSON, `values.op`, `items[0].v`, `['a.b'].v`; left out for a payload that is a number.
    #[serde(default)]
    pub path: Option<String>,
    /// The decimal sign of values that are text, `.` or `,`; left out, what the text itself proves.
    #[serde(default)]
    pub decimal: Option<DecimalSign>,
    /// Path of its time.
    #[serde(default)]
    pub time_path: Option<String>,
    /// Path of its quality.
    #[serde(default)]
    pub quality_path: Option<String>,
    /// Edge node or device of Sparkplug B: `group/edge` or `group/edge/device`.
    #[serde(default)]
    pub sparkplug: Option<String>,
    /// Its metric, by name.
    #[serde(default)]
    pub metric: Option<String>,
    /// Its metric, by alias.
    #[serde(default)]
    pub alias: Option<u64>,
    /// value = scale * raw + offset.
    #[serde(default = "crate::collect::scaling::unscaled")]
    pub scale: f64,
    /// See `scale`.
    #[serde(default)]
    pub offset: f64,
    /// Least and greatest believable value, after scaling.
    #[serde(default, deserialize_with = "crate::collect::pair::pair")]
    pub range: Option<[f64; 2]>,
    /// Engineering unit, for people.
    #[serde(default)]
    pub unit: Option<String>,
    /// Of a mode tag: the raw values that mean automatic. Without it, anything but 0 does.
    #[serde(default)]
    pub auto_values: Option<Vec<i64>>,
}

/// Where a tag is found.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Place {
    /// In the messages of a topic.
    Topic {
        topic: String,
        value: Option<JsonPath>,
        decimal: Option<DecimalSign>,
        time: Option<JsonPath>,
        quality: Option<JsonPath>,
    },
    /// In the messages of an edge node or a device of its.
    Metric { group: String, edge: String, device: Option<String>, metric: MetricKey },
}

/// Which metric.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum MetricKey {
    Name(String),
    Alias(u64),
}

impl Config {
    /// The client's name at the broker.
    pub fn client_id(&self) -> String {
        self.client_id.clone().unwrap_or_else(|| default_client_id(&host::name(), &self.name))
    }

    /// How the broker is reached.
    pub(super) fn broker(&self) -> Broker {
        let password = self.password_file.clone().map(Password::File);
        let password = password.or_else(|| self.password_env.clone().map(Password::Env));
        Broker {
            address: self.address.clone(),
            client_id: self.client_id(),
            keep_alive_s: self.keep_alive_s,
            clean_session: self.clean_session,
            tls: self.tls,
            ca_file: self.ca_file.clone(),
            certificate: self.certificate_file.clone().zip(self.key_file.clone()),
            login: self.user.clone().zip(password),
            // A message of more ends the connection; up to here it is refused alone.
            max_bytes: self.max_payload_bytes.saturating_mul(16).max(1 << 20),
        }
    }

    /// Everything wrong with the broker's own fields; empty when it can be asked.
    pub fn validate(&self) -> Vec<Issue> {
        let found = self.broker().validate();
        let mut issues: Vec<Issue> =
            found.into_iter().map(|(field, message)| Issue { field, message }).collect();
        let mut unless = |ok: bool, field: &'static str, message: &str| {
            if !ok {
                issues.push(Issue { field, message: message.into() });
            }
        };
        unless(!self.name.trim().is_empty(), "name", "a device needs a name");
        for (field, why) in credentials::wrong(&self.user, &self.password_file, &self.password_env) {
            unless(false, field, why);
        }
        let pair = self.certificate_file.is_some() == self.key_file.is_some();
        unless(pair, "certificate_file", "certificate_file and key_file belong together");
        unless((1..=300).contains(&self.timeout_s), "timeout_s", "must be 1 to 300");
        let ok = (10..=86_400_000).contains(&self.reconnect_max_ms);
        unless(ok, "reconnect_max_ms", "must be 10 to 86400000");
        unless((0.1..=604_800.0).contains(&self.silent_s), "silent_s", "must be 0.1 to 604800");
        let ok = self.stale_after_s.is_none_or(|s| (0.1..=604_800.0).contains(&s));
        unless(ok, "stale_after_s", "must be 0.1 to 604800");
        let ok = (16..=16_777_216).contains(&self.max_payload_bytes);
        unless(ok, "max_payload_bytes", "must be 16 to 16777216");
        for (field, path) in [("time_path", &self.time_path), ("quality_path", &self.quality_path)] {
            if let Some(Err(why)) = path.as_deref().map(|text| JsonPath::parse(field, text)) {
                unless(false, field, &why);
            }
        }
        let ok = self.good_values.as_ref().is_none_or(|values| !values.is_empty());
        unless(ok, "good_values", "name at least one value");
        issues
    }
}

impl TagConfig {
    /// Where the tag is found, at this broker.
    pub(super) fn place(&self, broker: &Config) -> Result<Place, Issue> {
        let issue = |field, message: String| Issue { field, message };
        match (&self.topic, &self.sparkplug) {
            (Some(_), Some(_)) => Err(issue("sparkplug", "there is a topic too: leave one out".into())),
            (None, None) => {
                Err(issue("topic", "a tag at a broker needs a topic, or sparkplug and a metric".into()))
            }
            (Some(topic), None) => {
                if let Some(fault) = topic_fault(topic) {
                    return Err(issue("topic", format!("'{topic}' {fault}")));
                }
                for (field, set) in [("metric", self.metric.is_some()), ("alias", self.alias.is_some())] {
                    if set {
                        return Err(issue(field, "only a tag with sparkplug has one".into()));
                    }
                }
                let path = |field, own: &Option<String>, general: &Option<String>| {
                    let text = own.as_deref().or(general.as_deref());
                    text.map(|text| JsonPath::parse(field, text)).transpose().map_err(|why| issue(field, why))
                };
                let value = path("path", &self.path, &None)?;
                let plain = value.is_none();
                let time = path("time_path", &self.time_path, &broker.time_path)?.filter(|_| !plain);
                let quality = path("quality_path", &self.quality_path, &broker.quality_path)?;
                for (field, own) in [("time_path", &self.time_path), ("quality_path", &self.quality_path)] {
                    if plain && own.is_some() {
                        return Err(issue(field, "a payload without path is a plain number".into()));
                    }
                }
                let quality = quality.filter(|_| !plain);
                if time.is_none() && broker.time_fallback == TimeFallback::None {
                    let message = match plain {
                        true => {
                            "a plain number carries no time, and time_fallback = \"none\" refuses it: write path and time_path, or \
                             time_fallback = \"arrival\""
                        }
                        false => {
                            "with time_fallback = \"none\" a value needs a time_path: every one would be refused"
                        }
                    };
                    return Err(issue(if plain { "topic" } else { "path" }, message.into()));
                }
                Ok(Place::Topic { topic: topic.clone(), value, decimal: self.decimal, time, quality })
            }
            (None, Some(text)) => {
                for (field, set) in [
                    ("path", self.path.is_some()),
                    ("decimal", self.decimal.is_some()),
                    ("time_path", self.time_path.is_some()),
                    ("quality_path", self.quality_path.is_some()),
                ] {
                    if set {
                        return Err(issue(field, "only a tag with a topic has one".into()));
                    }
                }
                let metric = match (&self.metric, self.alias) {
                    (Some(name), None) if !name.is_empty() => MetricKey::Name(name.clone()),
                    (None, Some(alias)) => MetricKey::Alias(alias),
                    (None, None) => {
                        return Err(issue(
                            "metric",
                            "which metric of the node: give metric, or alias".into(),
                        ));
                    }
                    (Some(_), None) => return Err(issue("metric", "the name of the metric is empty".into())),
                    _ => return Err(issue("metric", "name the metric, or give its alias, not both".into())),
                };
                let parts: Vec<&str> = text.split('/').collect();
                let whole = (2..=3).contains(&parts.len()) && parts.iter().all(|part| !part.is_empty());
                if !whole || topic_fault(text).is_some() {
                    return Err(issue(
                        "sparkplug",
                        format!("'{text}' is not group/edge or group/edge/device, without + and #"),
                    ));
                }
                Ok(Place::Metric {
                    group: parts[0].into(),
                    edge: parts[1].into(),
                    device: parts.get(2).map(|part| (*part).into()),
                    metric,
                })
            }
        }
    }

    /// What its raw numbers mean.
    pub(super) fn scaling(&self) -> Scaling {
        let Self { scale, offset, range, .. } = *self;
        Scaling { scale, offset, range, auto_values: self.auto_values.clone() }
    }

    /// Everything wrong with the tag at this broker, in this role (`None` for an extra tag).
    pub fn validate(&self, broker: &Config, role: Option<Role>) -> Vec<Issue> {
        // What the broker's own section says wrongly is told there.
        let inherited = |issue: &Issue| match issue.field {
            "time_path" => self.time_path.is_none(),
            "quality_path" => self.quality_path.is_none(),
            _ => false,
        };
        let mut issues: Vec<Issue> =
            self.place(broker).err().into_iter().filter(|issue| !inherited(issue)).collect();
        issues.extend(self.scaling().validate(role));
        issues
    }
}
