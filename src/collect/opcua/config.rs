//! What the configuration file says about an OPC UA server and about a tag's node in it.

use super::names::{NodeName, PathName};
use super::value::Meaning;
use crate::collect::scaling::Scaling;
use crate::collect::{DecimalSign, Issue};
use crate::credentials;
use crate::host::host_and_port;
use crate::signal::Role;
use serde::Deserialize;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// One OPC UA server, `[[opcua]]`. Every entry has a session and a task of its own.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name that tags refer to.
    pub name: String,
    /// `opc.tcp://host:port/path`. The host must stand in the server's certificate.
    pub url: String,
    /// How messages are protected.
    #[serde(default)]
    pub security_policy: SecurityPolicy,
    /// What that does to them; left out, `None` for the policy `None`, else `SignAndEncrypt`.
    #[serde(default)]
    pub security_mode: Option<SecurityMode>,
    /// Folder of certificates: `own/cert.der`, `private/private.pem`, `trusted/`, `rejected/`. Needed by every
    /// policy but `None`. A server whose certificate is not in `trusted/` is refused.
    #[serde(default)]
    pub pki_dir: Option<PathBuf>,
    /// URI of this client; it must be the one in `own/cert.der`.
    #[serde(default = "default_application_uri")]
    pub application_uri: String,
    /// User name; without it and without a certificate of a user the session is anonymous.
    #[serde(default)]
    pub user: Option<String>,
    /// File whose first line is the password; read at every connect.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// Environment variable that holds the password.
    #[serde(default)]
    pub password_env: Option<String>,
    /// Certificate of the user (`.der` or `.pem`), for an X.509 identity.
    #[serde(default)]
    pub user_certificate: Option<PathBuf>,
    /// Its private key (`.pem`).
    #[serde(default)]
    pub user_key: Option<PathBuf>,
    /// Subscriptions, or plain reading.
    #[serde(default)]
    pub mode: Mode,
    /// How often the server samples a node, or how often it is read (ms).
    #[serde(default = "default_sampling_ms")]
    pub sampling_ms: u64,
    /// How often the server sends what it sampled (ms).
    #[serde(default = "default_publishing_ms")]
    pub publishing_ms: u64,
    /// Samples of a node that the server keeps between two publishings.
    #[serde(default = "default_queue_size")]
    pub queue_size: u32,
    /// Changes smaller than this share of the node's EURange are not sent (%); 0 sends all.
    #[serde(default)]
    pub deadband_percent: f64,
    /// Longest wait for a connection and for each answer (ms).
    #[serde(default = "default_timeout_ms")]
    pub timeout_ms: u64,
    /// Longest pause between attempts to reconnect (ms).
    #[serde(default = "default_reconnect_max_ms")]
    pub reconnect_max_ms: u64,
    /// A session without data for longer is asked for the values itself, and given up when it hid some (s).
    #[serde(default = "default_silent_s")]
    pub silent_s: f64,
    /// What stands in where a value carries no source time.
    #[serde(default)]
    pub source_time_fallback: TimeFallback,
    /// Whether a gap is filled from the server's history after a reconnect.
    #[serde(default = "default_true")]
    pub fill_gaps: bool,
    /// Longest gap that is filled (s).
    #[serde(default = "default_history_max_s")]
    pub history_max_s: f64,
    /// At the start history is read back to the newest sample that is there, at most so long (s); 0 for none.
    #[serde(default)]
    pub backfill_s: f64,
    /// Most nodes in one request; a smaller limit of the server holds.
    #[serde(default = "default_max_nodes")]
    pub max_nodes_per_request: usize,
}

fn default_application_uri() -> String {
    "urn:stictiond".into()
}
fn default_sampling_ms() -> u64 {
    1000
}
fn default_publishing_ms() -> u64 {
    1000
}
fn default_queue_size() -> u32 {
    10
}
fn default_timeout_ms() -> u64 {
    5000
}
fn default_reconnect_max_ms() -> u64 {
    30_000
}
fn default_silent_s() -> f64 {
    30.0
}
fn default_true() -> bool {
    true
}
fn default_history_max_s() -> f64 {
    3600.0
}
fn default_max_nodes() -> usize {
    500
}

/// Security policies, by the names of the standard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum SecurityPolicy {
    /// Neither signed nor encrypted.
    None,
    /// RSA and AES-256-CBC with SHA-256.
    #[default]
    Basic256Sha256,
    /// RSA-PSS and AES-256-CBC with SHA-256.
    #[serde(rename = "Aes256_Sha256_RsaPss")]
    Aes256Sha256RsaPss,
}

/// What is done to messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum SecurityMode {
    /// Nothing.
    None,
    /// Signed: readable, not changeable on the way.
    Sign,
    /// Signed and encrypted.
    SignAndEncrypt,
}

/// How values are obtained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The server samples and sends.
    #[default]
    Subscribe,
    /// Every value is read every `sampling_ms`.
    Poll,
}

/// The time of a value that has no source time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeFallback {
    /// The server's time stamp, and if there is none either, the value is bad.
    #[default]
    Server,
    /// When it arrived here.
    Arrival,
    /// None: such a value is bad.
    None,
}

/// Where a tag lives in an OPC UA server: `[loop.op]`, `[[loop.tag]]`, … with `node` or `path`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TagConfig {
    /// Name of an extra tag; the five roles of a loop have none.
    #[serde(default)]
    pub name: Option<String>,
    /// Name of the `[[opcua]]`.
    pub device: String,
    /// Node id, `nsu=urn:plant;s=FIC101.OP` by the namespace's URI or `ns=2;i=4711` by its number.
    #[serde(default)]
    pub node: Option<String>,
    /// Browse path from the Objects folder, `/nsu=urn:plant;Unit10/nsu=urn:plant;OP` or `/2:Unit10/2:OP`.
    #[serde(default)]
    pub path: Option<String>,
    /// Element of an array, counted from 0, where the node's value is one.
    #[serde(default)]
    pub element: Option<usize>,
    /// The decimal sign of values that are text, `.` or `,`; left out, what the text itself proves.
    #[serde(default)]
    pub decimal: Option<DecimalSign>,
    /// How often the server samples this node (ms), where that is not as for the others; of a subscription only.
    #[serde(default)]
    pub sampling_ms: Option<u64>,
    /// As the server's `queue_size`, for this node.
    #[serde(default)]
    pub queue_size: Option<u32>,
    /// Changes smaller than this are not sent, in the node's own unit, before scaling.
    #[serde(default)]
    pub deadband: Option<f64>,
    /// As the server's `deadband_percent`, for this node.
    #[serde(default)]
    pub deadband_percent: Option<f64>,
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
pub enum Place {
    /// By its node id.
    Node(NodeName),
    /// By its browse path from the Objects folder.
    Path(PathName),
}

impl Place {
    /// Whether it depends on which number a server gives to a namespace.
    pub fn is_numbered(&self) -> bool {
        match self {
            Self::Node(name) => name.is_numbered(),
            Self::Path(name) => name.is_numbered(),
        }
    }

    /// Whether it is a node with a name in the standard's own namespace, whose nodes have numbers.
    pub fn has_no_namespace(&self) -> bool {
        matches!(self, Self::Node(name) if name.has_no_namespace())
    }
}

impl Config {
    /// The security mode in force.
    pub fn effective_mode(&self) -> SecurityMode {
        self.security_mode.unwrap_or(match self.security_policy {
            SecurityPolicy::None => SecurityMode::None,
            _ => SecurityMode::SignAndEncrypt,
        })
    }

    /// The keys that are not as they would be if left out, and that a subscription alone follows.
    pub fn of_a_subscription(&self) -> Vec<&'static str> {
        let keys = [
            ("publishing_ms", self.publishing_ms != default_publishing_ms()),
            ("queue_size", self.queue_size != default_queue_size()),
            ("deadband_percent", self.deadband_percent != 0.0),
        ];
        keys.into_iter().filter(|(_, written)| *written).map(|(key, _)| key).collect()
    }

    /// Everything wrong with the server's own fields; empty when it can be asked.
    pub fn validate(&self) -> Vec<Issue> {
        let mut issues = Vec::new();
        let mut unless = |ok: bool, field: &'static str, message: String| {
            if !ok {
                issues.push(Issue { field, message });
            }
        };
        unless(!self.name.trim().is_empty(), "name", "a device needs a name".into());
        if let Err(why) = host_of(&self.url) {
            // An address with a log-in has a password in it.
            let told = if self.url.contains('@') { "the address" } else { &format!("'{}'", self.url) };
            let message = match why {
                LOG_IN => LOG_IN.to_string(),
                why => format!("{told} is not opc.tcp://host:port/path: {why}"),
            };
            unless(false, "url", message);
        }
        for (field, value, least) in [
            ("sampling_ms", self.sampling_ms, 10),
            ("publishing_ms", self.publishing_ms, 10),
            ("timeout_ms", self.timeout_ms, 10),
            ("reconnect_max_ms", self.reconnect_max_ms, 10),
        ] {
            let ok = (least..=86_400_000).contains(&value);
            unless(ok, field, format!("{value} must be {least} to 86400000"));
        }
        unless(QUEUES.contains(&self.queue_size), "queue_size", "must be 1 to 10000".into());
        unless(is_percent(self.deadband_percent), "deadband_percent", PERCENT.into());
        unless((0.1..=86_400.0).contains(&self.silent_s), "silent_s", "must be 0.1 to 86400".into());
        let ok = (1.0..=2_678_400.0).contains(&self.history_max_s);
        unless(ok, "history_max_s", "must be 1 to 2678400, 31 days".into());
        let ok = (0.0..=2_678_400.0).contains(&self.backfill_s);
        unless(ok, "backfill_s", "must be 0 to 2678400, 31 days".into());
        let ok = (1..=10_000).contains(&self.max_nodes_per_request);
        unless(ok, "max_nodes_per_request", "must be 1 to 10000".into());
        unless(self.application_uri.contains(':'), "application_uri", "must be a URI".into());
        issues.extend(self.security());
        issues
    }

    fn security(&self) -> Vec<Issue> {
        let mut issues = Vec::new();
        let mut unless = |ok: bool, field: &'static str, message: &str| {
            if !ok {
                issues.push(Issue { field, message: message.into() });
            }
        };
        let plain = self.security_policy == SecurityPolicy::None;
        unless(
            plain == (self.effective_mode() == SecurityMode::None),
            "security_mode",
            "the policy and the mode \"None\" go with each other only",
        );
        unless(
            plain || self.pki_dir.is_some(),
            "pki_dir",
            "a folder of certificates is needed; or write security_policy = \"None\", then everything is readable and \
             changeable on the way",
        );
        for (field, why) in credentials::wrong(&self.user, &self.password_file, &self.password_env) {
            unless(false, field, why);
        }
        unless(
            self.user_certificate.is_some() == self.user_key.is_some(),
            "user_certificate",
            "user_certificate and user_key belong together",
        );
        unless(
            self.user.is_none() || self.user_certificate.is_none(),
            "user_certificate",
            "there is a user name too: leave one out",
        );
        issues
    }
}

impl TagConfig {
    /// Where the tag is found, or what is wrong with `node` or `path`.
    ///
    /// # Errors
    /// The one thing to change.
    pub fn place(&self) -> Result<Place, Issue> {
        let issue = |field, message: &str| Err(Issue { field, message: message.into() });
        match (&self.node, &self.path) {
            (Some(_), Some(_)) => issue("path", "there is a node too: leave one out"),
            (None, None) => issue("node", "a tag of an OPC UA server needs a node or a path"),
            (Some(node), None) => node.parse().map(Place::Node).or_else(|()| {
                let example = "nsu=urn:plant;s=FIC101.OP or ns=2;s=FIC101.OP";
                issue("node", &format!("'{node}' is not a node id such as {example}"))
            }),
            // Clients show paths from the root; those of a tag begin below Objects.
            (None, Some(path)) if below_objects(path).is_some() => {
                let below = below_objects(path).unwrap_or_default();
                issue("path", &format!("'{path}' begins below Objects: write {below}"))
            }
            (None, Some(path)) => path.parse().map(Place::Path).or_else(|()| {
                let example = "/nsu=urn:plant;Unit10/nsu=urn:plant;OP or /2:Unit10/2:OP";
                issue("path", &format!("'{path}' is not a browse path such as {example}"))
            }),
        }
    }

    /// The keys that are there, and that a subscription alone follows.
    pub fn of_a_subscription(&self) -> Vec<&'static str> {
        let keys = [
            ("sampling_ms", self.sampling_ms.is_some()),
            ("queue_size", self.queue_size.is_some()),
            ("deadband", self.deadband.is_some()),
            ("deadband_percent", self.deadband_percent.is_some()),
        ];
        keys.into_iter().filter(|(_, written)| *written).map(|(key, _)| key).collect()
    }

    /// What its raw numbers mean.
    fn scaling(&self) -> Scaling {
        let Self { scale, offset, range, .. } = *self;
        Scaling { scale, offset, range, auto_values: self.auto_values.clone() }
    }

    /// How its values are read, in this role (`None` for an extra tag).
    pub(super) fn meaning(&self, role: Option<Role>) -> Meaning {
        Meaning { scaling: self.scaling().in_role(role), element: self.element, decimal: self.decimal }
    }

    /// Everything wrong with the tag in this role (`None` for an extra tag).
    pub fn validate(&self, role: Option<Role>) -> Vec<Issue> {
        let mut issues: Vec<Issue> = self.place().err().into_iter().collect();
        let mut unless = |ok: bool, field: &'static str, message: String| {
            if !ok {
                issues.push(Issue { field, message });
            }
        };
        let ok = self.sampling_ms.is_none_or(|every| (10..=86_400_000).contains(&every));
        unless(ok, "sampling_ms", "must be 10 to 86400000".into());
        let ok = self.queue_size.is_none_or(|queue| QUEUES.contains(&queue));
        unless(ok, "queue_size", "must be 1 to 10000".into());
        let ok = self.element.is_none_or(|at| at < MAX_ARRAY);
        unless(ok, "element", format!("must be 0 to {}", MAX_ARRAY - 1));
        let ok = self.deadband.is_none_or(|band| band.is_finite() && band >= 0.0);
        unless(ok, "deadband", "must be a number from 0, in the node's own unit".into());
        unless(self.deadband_percent.is_none_or(is_percent), "deadband_percent", PERCENT.into());
        let both = self.deadband.is_some() && self.deadband_percent.is_some();
        unless(!both, "deadband_percent", "there is deadband too: leave one out".into());
        issues.extend(self.scaling().validate(role));
        issues
    }
}

/// What follows the root and its Objects folder in a path that begins with them.
fn below_objects(path: &str) -> Option<&str> {
    let step = |path: &'_ str, name: &str| {
        let rest = path.strip_prefix('/')?;
        let rest = rest.strip_prefix("0:").unwrap_or(rest).strip_prefix(name)?;
        rest.starts_with('/').then(|| path.len() - rest.len())
    };
    let from_root = step(path, "Root").map_or(path, |at| &path[at..]);
    step(from_root, "Objects").map(|at| &from_root[at..])
}

/// Most array elements of an answer: the library's default drops long ones without a word.
pub(super) const MAX_ARRAY: usize = 20_000;
const QUEUES: RangeInclusive<u32> = 1..=10_000;
const PERCENT: &str = "must be 0 to less than 100, % of the node's EURange";

fn is_percent(band: f64) -> bool {
    (0.0..100.0).contains(&band)
}

const LOG_IN: &str = "take the log-in out of the address: write user, and password_env or password_file";

/// The host of a server's address, or what is wrong with the address.
fn host_of(url: &str) -> Result<String, &'static str> {
    let rest = url.strip_prefix("opc.tcp://").ok_or("it begins otherwise")?;
    let (authority, _) = rest.split_once('/').unwrap_or((rest, ""));
    if authority.contains('@') {
        return Err(LOG_IN);
    }
    if url.contains(char::is_whitespace) {
        return Err("there is a blank in it");
    }
    host_and_port(authority).map(|(host, _)| host)
}

#[cfg(test)]
#[path = "config_tests.rs"]
mod tests;
