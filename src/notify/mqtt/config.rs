//! `[notify.mqtt]`: to which broker, as whom, under which topics.

use super::message;
use crate::credentials;
use crate::host;
use crate::mqtt::{Broker, Password, default_client_id, topic_fault};
use serde::Deserialize;
use std::path::PathBuf;

/// Where diagnoses and alarms are published.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// `host:port`.
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
    /// Longest wait for a connection (s).
    #[serde(default = "default_timeout_s")]
    pub timeout_s: u64,
    /// Longest pause between attempts to reconnect (ms).
    #[serde(default = "default_reconnect_max_ms")]
    pub reconnect_max_ms: u64,
    /// Topic of diagnoses; `{group}` and `{loop}` are filled in.
    #[serde(default = "default_diagnosis_topic")]
    pub diagnosis_topic: String,
    /// Topic of alarms.
    #[serde(default = "default_alarm_topic")]
    pub alarm_topic: String,
    /// Topic that says whether the daemon is there; the broker says so when it is not.
    #[serde(default = "default_status_topic")]
    pub status_topic: String,
    /// Most topics kept for delivery.
    #[serde(default = "default_max_topics")]
    pub max_topics: usize,
    /// `[notify.mqtt.sparkplug]`: the same as metrics of an edge node.
    #[serde(default)]
    pub sparkplug: Option<SparkplugConfig>,
}

/// The edge node as which the daemon appears.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SparkplugConfig {
    /// Its group.
    pub group: String,
    /// Its name; each loop is a device of it.
    #[serde(default = "default_edge")]
    pub edge: String,
}

fn default_edge() -> String {
    "stictiond-results".into()
}
fn default_keep_alive_s() -> u16 {
    30
}
fn default_timeout_s() -> u64 {
    5
}
fn default_reconnect_max_ms() -> u64 {
    30_000
}
fn default_diagnosis_topic() -> String {
    "stictiond/{group}/{loop}/diagnosis".into()
}
fn default_alarm_topic() -> String {
    "stictiond/{group}/{loop}/alarm".into()
}
fn default_status_topic() -> String {
    "stictiond/status".into()
}
fn default_max_topics() -> usize {
    20_000
}

impl Config {
    /// Every name under which a client of this section appears at the broker.
    pub fn client_ids(&self) -> Vec<String> {
        let edge = self.sparkplug.as_ref().map(|_| self.edge_client_id());
        std::iter::once(self.client_id()).chain(edge).collect()
    }

    /// The name of the client that is an edge node.
    pub(super) fn edge_client_id(&self) -> String {
        self.client_id() + "-sparkplug"
    }

    /// The client's name at the broker.
    pub fn client_id(&self) -> String {
        self.client_id.clone().unwrap_or_else(|| default_client_id(&host::name(), "results"))
    }

    pub(super) fn broker(&self) -> Broker {
        let password = self.password_file.clone().map(Password::File);
        let password = password.or_else(|| self.password_env.clone().map(Password::Env));
        Broker {
            address: self.address.clone(),
            client_id: self.client_id(),
            keep_alive_s: self.keep_alive_s,
            clean_session: true,
            tls: self.tls,
            ca_file: self.ca_file.clone(),
            certificate: self.certificate_file.clone().zip(self.key_file.clone()),
            login: self.user.clone().zip(password),
            max_bytes: 1 << 20,
        }
    }

    /// The topics of a loop: of its diagnoses and of its alarm.
    pub fn topics(&self, id: &str, group: &str) -> [String; 2] {
        [&self.diagnosis_topic, &self.alarm_topic].map(|template| message::topic(template, group, id))
    }

    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut issues = self.broker().validate();
        let mut unless = |ok: bool, field: &'static str, message: &str| {
            if !ok {
                issues.push((field, message.to_string()));
            }
        };
        for (field, why) in credentials::wrong(&self.user, &self.password_file, &self.password_env) {
            unless(false, field, why);
        }
        let pair = self.certificate_file.is_some() == self.key_file.is_some();
        unless(pair, "certificate_file", "certificate_file and key_file belong together");
        unless((1..=300).contains(&self.timeout_s), "timeout_s", "must be 1 to 300");
        let ok = (10..=86_400_000).contains(&self.reconnect_max_ms);
        unless(ok, "reconnect_max_ms", "must be 10 to 86400000");
        let ok = (1..=1_000_000).contains(&self.max_topics);
        unless(ok, "max_topics", "must be 1 to 1000000");
        for (field, template) in
            [("diagnosis_topic", &self.diagnosis_topic), ("alarm_topic", &self.alarm_topic)]
        {
            if let Some(fault) = topic_fault(template) {
                unless(false, field, fault);
            }
            unless(template.contains("{loop}"), field, "needs {loop}: every loop has a topic of its own");
        }
        unless(self.diagnosis_topic != self.alarm_topic, "alarm_topic", "must not be that of diagnoses");
        if let Some(fault) = topic_fault(&self.status_topic) {
            unless(false, "status_topic", fault);
        }
        if let Some(sparkplug) = &self.sparkplug {
            let plain = |name: &str| topic_fault(name).is_none() && !name.contains('/');
            let ok = plain(&sparkplug.group) && plain(&sparkplug.edge);
            unless(ok, "sparkplug", "group and edge must be names without / + #");
        }
        issues
    }
}
