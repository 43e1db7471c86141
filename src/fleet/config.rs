//! `[fleet]`: how this machine reaches the others.

use super::subject::{NO_SITE, is_site};
use serde::Deserialize;
use std::path::PathBuf;

/// How this machine reaches the others.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The site that this machine's loops belong to; an edge needs one.
    #[serde(default)]
    pub site: Option<String>,
    /// What this machine is called in the fleet; the host's name by default.
    #[serde(default)]
    pub name: Option<String>,
    /// Where NATS is: `nats://host:port` or `tls://host:port`.
    pub servers: Vec<String>,
    /// The name by which the streams are asked for: a JetStream domain, or what the hub maps to its API.
    #[serde(default = "domain")]
    pub domain: String,
    /// Credentials of an account (`.creds`).
    #[serde(default)]
    pub credentials_file: Option<PathBuf>,
    /// Seed of an nkey.
    #[serde(default)]
    pub nkey_file: Option<PathBuf>,
    /// User.
    #[serde(default)]
    pub user: Option<String>,
    /// The user's password.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// Who signs the server's certificate, in place of those that the system trusts.
    #[serde(default)]
    pub ca_file: Option<PathBuf>,
    /// This machine's certificate, where the server asks for one.
    #[serde(default)]
    pub certificate_file: Option<PathBuf>,
    /// And its key.
    #[serde(default)]
    pub key_file: Option<PathBuf>,
    /// Time between two messages of a loop's samples (s).
    #[serde(default = "forward_s")]
    pub forward_s: f64,
    /// An edge that has no answer of a worker for longer diagnoses by itself (s).
    #[serde(default = "answer_within_s")]
    pub answer_within_s: f64,
    /// An edge that reaches no centre for longer tells people by itself; a centre that is silent for longer is replaced by
    /// another (s).
    #[serde(default = "cut_off_after_s")]
    pub cut_off_after_s: f64,
    /// Room for samples that the centre has not stored yet (MB); the oldest go first.
    #[serde(default = "samples_mb")]
    pub samples_mb: u64,
    /// Room for diagnoses (MB). Before it is full those go that the centre which leads has and another has not; when it is full
    /// edges keep what is new and send it later.
    #[serde(default = "diagnoses_mb")]
    pub diagnoses_mb: u64,
    /// Room for what happened to alarms (MB); when it is full edges keep what is new, send it later, and tell people by
    /// themselves.
    #[serde(default = "alarms_mb")]
    pub alarms_mb: u64,
}

fn domain() -> String {
    "stictiond".into()
}

fn forward_s() -> f64 {
    5.0
}

fn answer_within_s() -> f64 {
    60.0
}

fn cut_off_after_s() -> f64 {
    10.0
}

fn samples_mb() -> u64 {
    4096
}

fn diagnoses_mb() -> u64 {
    1024
}

fn alarms_mb() -> u64 {
    256
}

impl Config {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push((field, message));
            }
        };
        if let Some(site) = &self.site {
            let message = format!("{site:?} must be 1 to 32 lower-case letters, digits and '-'");
            unless(is_site(site), "site", message);
            unless(site != NO_SITE, "site", format!("{NO_SITE:?} is what belongs to no site"));
        }
        if let Some(name) = &self.name {
            unless((1..=64).contains(&name.len()), "name", "must have 1 to 64 characters".into());
        }
        unless((1..=16).contains(&self.servers.len()), "servers", "1 to 16 addresses are needed".into());
        for server in &self.servers {
            let good = server.starts_with("nats://") || server.starts_with("tls://");
            // One with a log-in in it is not shown.
            let named = server.contains('@');
            unless(good || named, "servers", format!("{server:?} must begin with nats:// or tls://"));
            unless(!server.contains('@'), "servers", "names no user: see `user` and `password_file`".into());
        }
        let token = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let good = !self.domain.is_empty() && self.domain.chars().all(token);
        unless(good, "domain", format!("{:?} must be letters, digits, '-' and '_'", self.domain));
        let ways = [self.credentials_file.is_some(), self.nkey_file.is_some(), self.user.is_some()];
        let one = ways.iter().filter(|way| **way).count() <= 1;
        unless(one, "user", "one of `credentials_file`, `nkey_file` and `user` is enough".into());
        let login = [("user", self.user.is_some()), ("password_file", self.password_file.is_some())];
        let certificate =
            [("certificate_file", self.certificate_file.is_some()), ("key_file", self.key_file.is_some())];
        for [(first, has_first), (second, has_second)] in [login, certificate] {
            let (there, missing) = if has_first { (first, second) } else { (second, first) };
            unless(has_first == has_second, missing, format!("{there} needs it too"));
        }
        let within = |value: f64, low: f64, high: f64| (low..=high).contains(&value);
        let (forward, answer, cut) = (self.forward_s, self.answer_within_s, self.cut_off_after_s);
        unless(within(forward, 0.1, 60.0), "forward_s", format!("{forward} must be 0.1 to 60"));
        unless(within(answer, 1.0, 3600.0), "answer_within_s", format!("{answer} must be 1 to 3600"));
        unless(within(cut, 2.0, 3600.0), "cut_off_after_s", format!("{cut} must be 2 to 3600"));
        let rooms = [
            ("samples_mb", self.samples_mb),
            ("diagnoses_mb", self.diagnoses_mb),
            ("alarms_mb", self.alarms_mb),
        ];
        for (field, mb) in rooms {
            unless((16..=1_000_000).contains(&mb), field, format!("{mb} must be 16 to 1000000"));
        }
        wrong
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrong(text: &str) -> Vec<&'static str> {
        let config: Config = toml::from_str(text).expect("it can be read");
        config.validate().into_iter().map(|(field, _)| field).collect()
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        assert_eq!(wrong("servers = ['nats://hub:4222']\nsite = 'north'"), [""; 0]);
        assert_eq!(wrong("servers = []"), ["servers"]);
        assert_eq!(wrong("servers = ['http://hub']"), ["servers"]);
        assert_eq!(wrong("servers = ['nats://me:secret@hub']"), ["servers"]);
        assert_eq!(wrong("servers = ['nats://hub']\nsite = 'North'"), ["site"]);
        assert_eq!(wrong("servers = ['nats://hub']\nuser = 'a'"), ["password_file"]);
        assert_eq!(wrong("servers = ['nats://hub']\nkey_file = 'k'"), ["certificate_file"]);
        let two = "servers = ['nats://hub']\nuser = 'a'\npassword_file = 'p'\nnkey_file = 'k'";
        assert_eq!(wrong(two), ["user"]);
        assert_eq!(
            wrong("servers = ['nats://hub']\nforward_s = 0\nsamples_mb = 1\nalarms_mb = 1"),
            ["forward_s", "samples_mb", "alarms_mb"]
        );
    }
}
