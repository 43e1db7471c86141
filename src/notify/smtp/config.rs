//! `[[notify.smtp]]`: by which server, to whom, and which alarms.

use crate::credentials;
use crate::host;
use crate::host::{host_and_port, shown};
use crate::notify::batch::Pace;
use crate::notify::filter::{Filter, What, usual};
use crate::notify::http::is_loopback;
use crate::notify::postman::Retry;
use crate::notify::secret::Secret;
use crate::notify::wrong::Wrong;
use lettre::message::Mailbox;
use serde::Deserialize;
use std::path::PathBuf;

/// Most people a mail goes to.
const MOST_RECEIVERS: usize = 100;

/// What is wrong with a text that nobody gets mail at.
const NO_MAIL: &str = "is not a mail address such as operator@plant.example";

/// Mails by one server to one list of people.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The receiver's name, in metrics, in the log and in the API.
    pub name: String,
    /// `host:port` of the server.
    pub address: String,
    /// How the connection is encrypted.
    #[serde(default)]
    pub security: Security,
    /// Certificates trusted (PEM); the system's where left out.
    #[serde(default)]
    pub ca_file: Option<PathBuf>,
    /// User name, where the server asks for one.
    #[serde(default)]
    pub user: Option<String>,
    /// File whose first line is the password.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// Environment variable that holds the password.
    #[serde(default)]
    pub password_env: Option<String>,
    /// Who sends.
    pub from: String,
    /// To whom.
    pub to: Vec<String>,
    /// The name that greets the server; left out, this machine's. Strict servers want a whole domain name.
    #[serde(default)]
    pub hello_name: Option<String>,
    /// Longest wait for an answer (s).
    #[serde(default = "default_timeout_s")]
    pub timeout_s: f64,
    /// What of an alarm is told.
    #[serde(default = "usual")]
    pub events: Vec<What>,
    /// Which alarms.
    #[serde(default)]
    pub filter: Filter,
    /// How many mails.
    #[serde(default)]
    pub pace: Pace,
    /// How long they are tried.
    #[serde(default)]
    pub retry: Retry,
}

/// How a connection is encrypted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Security {
    /// By STARTTLS, or not at all sent.
    #[default]
    Starttls,
    /// From the first byte.
    Tls,
    /// Not; on this machine only.
    None,
}

fn default_timeout_s() -> f64 {
    30.0
}

fn is_hello_name(name: &str) -> bool {
    let fits = |c: char| c.is_ascii_alphanumeric() || ".-_:[]".contains(c);
    (1..=255).contains(&name.len()) && name.chars().all(fits)
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
        match host_and_port(&self.address) {
            Err(why) => {
                let message =
                    format!("'{}' is not host:port, such as mail.plant:587: {why}", shown(&self.address));
                unless(false, "address", message);
            }
            Ok((host, _)) => {
                let ok = self.security != Security::None || is_loopback(&host);
                unless(ok, "security", "\"none\" is for a server on this machine only".into());
            }
        }
        for (field, why) in credentials::wrong(&self.user, &self.password_file, &self.password_env) {
            unless(false, field, why.into());
        }
        let is_address = |text: &String| text.parse::<Mailbox>().is_ok();
        unless(is_address(&self.from), "from", format!("{:?} {NO_MAIL}", self.from));
        for to in self.to.iter().filter(|to| !is_address(to)) {
            let parts: Vec<String> = to.split([',', ';']).map(|one| format!("{:?}", one.trim())).collect();
            let hint = match parts.len() {
                1 => String::new(),
                _ => format!(": write each in quotes of its own, to = [{}]", parts.join(", ")),
            };
            unless(false, "to", format!("{to:?} {NO_MAIL}{hint}"));
        }
        let ok = (1..=MOST_RECEIVERS).contains(&self.to.len());
        unless(ok, "to", format!("must name 1 to {MOST_RECEIVERS} addresses"));
        let ok = self.hello_name.as_deref().is_none_or(is_hello_name);
        unless(
            ok,
            "hello_name",
            "must be a host's name such as stictiond.plant.example, or an address in []".into(),
        );
        let ok = (0.1..=300.0).contains(&self.timeout_s);
        unless(ok, "timeout_s", format!("{} must be 0.1 to 300", self.timeout_s));
        unless(!self.events.is_empty(), "events", "must name one at least".into());
        wrong
    }

    /// The name that greets the server.
    pub(super) fn greeting(&self) -> String {
        self.hello_name.clone().unwrap_or_else(host::name)
    }

    /// The server.
    pub(super) fn host_and_port(&self) -> Result<(String, u16), String> {
        host_and_port(&self.address).map_err(|why| format!("the address is not host:port: {why}"))
    }

    pub(super) fn login(&self) -> Option<(String, Secret)> {
        self.user.clone().zip(Secret::of(&self.password_file, &self.password_env))
    }
}
