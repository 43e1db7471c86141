//! `[[notify.alertmanager]]`: where it is, and which alarms it hears of.

use crate::credentials;
use crate::notify::filter::Filter;
use crate::notify::http::Endpoint;
use crate::notify::secret::Secret;
use crate::notify::wrong::Wrong;
use serde::Deserialize;
use std::path::PathBuf;

/// One Alertmanager; of a cluster each has an entry.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The receiver's name, in metrics, in the log and in the API.
    pub name: String,
    /// Where it is, without `/api/v2`; `https`, or `http` on this machine.
    pub url: String,
    /// Allows `http` to other machines: alarms can then be read and changed on the way.
    #[serde(default)]
    pub allow_plain_http: bool,
    /// Certificates trusted (PEM); the system's where left out.
    #[serde(default)]
    pub ca_file: Option<PathBuf>,
    /// User name, where it asks for one.
    #[serde(default)]
    pub user: Option<String>,
    /// File whose first line is the password.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// Environment variable that holds the password.
    #[serde(default)]
    pub password_env: Option<String>,
    /// Longest wait for an answer (s).
    #[serde(default = "default_timeout_s")]
    pub timeout_s: f64,
    /// Alerts are sent again after this (s), until they are resolved.
    #[serde(default = "default_resend_s")]
    pub resend_s: f64,
    /// An alert that is not sent again for so long is over for the Alertmanager (s).
    #[serde(default = "default_expires_s")]
    pub expires_s: f64,
    /// Which alarms.
    #[serde(default)]
    pub filter: Filter,
}

fn default_timeout_s() -> f64 {
    10.0
}
fn default_resend_s() -> f64 {
    60.0
}
fn default_expires_s() -> f64 {
    300.0
}

impl Config {
    /// Everything wrong with it, by table and field.
    pub fn validate(&self) -> Vec<Wrong> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push(("", field, message));
            }
        };
        let bare = self.url.trim_end_matches('/');
        if let Some(end) = ["/api/v2/alerts", "/api/v2"].into_iter().find(|end| bare.ends_with(end)) {
            unless(false, "url", format!("leave out its end {end}: /api/v2/alerts is added here"));
        } else if let Err(why) = self.endpoint() {
            unless(false, "url", why);
        }
        for (field, why) in credentials::wrong(&self.user, &self.password_file, &self.password_env) {
            unless(false, field, why.into());
        }
        let ok = (0.1..=300.0).contains(&self.timeout_s);
        unless(ok, "timeout_s", format!("{} must be 0.1 to 300", self.timeout_s));
        let (again, over) = (self.resend_s, self.expires_s);
        unless((1.0..=3600.0).contains(&again), "resend_s", format!("{again} must be 1 to 3600"));
        let ok = (3.0 * again..=86_400.0).contains(&over);
        unless(ok, "expires_s", format!("{over} must be three times resend_s to 86400"));
        wrong
    }

    pub(super) fn endpoint(&self) -> Result<Endpoint, String> {
        let url = format!("{}/api/v2/alerts", self.url.trim_end_matches('/'));
        Endpoint::of(&url, self.allow_plain_http, self.ca_file.clone())
    }

    pub(super) fn login(&self) -> Option<(String, Secret)> {
        self.user.clone().zip(Secret::of(&self.password_file, &self.password_env))
    }
}
