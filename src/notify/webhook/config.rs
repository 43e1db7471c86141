//! `[[notify.webhook]]`: where to, signed with what, and which alarms.

use crate::credentials;
use crate::notify::batch::Pace;
use crate::notify::filter::{Filter, What, usual};
use crate::notify::http::Endpoint;
use crate::notify::postman::Retry;
use crate::notify::secret::Secret;
use crate::notify::wrong::Wrong;
use serde::Deserialize;
use std::path::PathBuf;

/// What a secret begins with.
pub(super) const PREFIX: &str = "whsec_";

/// One webhook.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The receiver's name, in metrics, in the log and in the API.
    pub name: String,
    /// Where to; `https`, or `http` on this machine.
    pub url: String,
    /// Allows `http` to other machines: alarms can then be read and changed on the way.
    #[serde(default)]
    pub allow_plain_http: bool,
    /// Certificates trusted (PEM); the system's where left out.
    #[serde(default)]
    pub ca_file: Option<PathBuf>,
    /// File with the secret, `whsec_…`; while one is replaced by another, both, a line each.
    #[serde(default)]
    pub secret_file: Option<PathBuf>,
    /// Environment variable with the secret.
    #[serde(default)]
    pub secret_env: Option<String>,
    /// Longest wait for an answer (s).
    #[serde(default = "default_timeout_s")]
    pub timeout_s: f64,
    /// What of an alarm is told.
    #[serde(default = "usual")]
    pub events: Vec<What>,
    /// Which alarms.
    #[serde(default)]
    pub filter: Filter,
    /// How many messages.
    #[serde(default)]
    pub pace: Pace,
    /// How long they are tried.
    #[serde(default)]
    pub retry: Retry,
}

fn default_timeout_s() -> f64 {
    10.0
}

impl Config {
    /// Everything wrong with it, by table and field.
    pub fn validate(&self) -> Vec<Wrong> {
        let mut wrong = [self.pace.validate(), self.retry.validate()].concat();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push(("", field, message));
            }
        };
        if let Err(why) = Endpoint::of(&self.url, self.allow_plain_http, self.ca_file.clone()) {
            unless(false, "url", why);
        }
        let secrets = usize::from(self.secret_file.is_some()) + usize::from(self.secret_env.is_some());
        unless(secrets > 0, "name", "needs secret_file or secret_env: every message is signed".into());
        let is_secret = |file: &PathBuf| file.to_str().is_some_and(|file| file.starts_with(PREFIX));
        let ok = !self.secret_file.as_ref().is_some_and(is_secret);
        unless(
            ok,
            "secret_file",
            "is the secret itself: write it into a file, and the file's path here".into(),
        );
        unless(secrets < 2, "secret_env", "there is secret_file too: leave one out".into());
        unless(!credentials::names_nothing(&self.secret_env), "secret_env", credentials::NO_NAME.into());
        let ok = (0.1..=300.0).contains(&self.timeout_s);
        unless(ok, "timeout_s", format!("{} must be 0.1 to 300", self.timeout_s));
        unless(!self.events.is_empty(), "events", "must name one at least".into());
        wrong
    }

    pub(super) fn secret(&self) -> Option<Secret> {
        Secret::of(&self.secret_file, &self.secret_env)
    }
}
