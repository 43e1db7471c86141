//! `[access]`: where users and tokens are, and how long a log-in lasts.

use super::sessions::Bounds;
use serde::Deserialize;
use std::path::PathBuf;

/// `[access]`; without it nobody has to log in, and the API is for this machine.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Users and tokens, hashed; written by `stictiond user` and `stictiond token`, readable by its owner only.
    pub file: PathBuf,
    /// True to let everybody read without a log-in; changes always need one.
    #[serde(default)]
    pub anyone_may_read: bool,
    /// A log-in that is not used for so long ends (s).
    #[serde(default = "idle")]
    pub session_idle_s: f64,
    /// Every log-in ends after this (s).
    #[serde(default = "longest")]
    pub session_max_s: f64,
    /// Log-ins at the same time.
    #[serde(default = "most")]
    pub max_sessions: usize,
}

fn idle() -> f64 {
    3600.0
}

fn longest() -> f64 {
    43_200.0
}

fn most() -> usize {
    1000
}

impl Config {
    /// With the defaults.
    pub fn new(file: PathBuf) -> Self {
        Self {
            file,
            anyone_may_read: false,
            session_idle_s: idle(),
            session_max_s: longest(),
            max_sessions: most(),
        }
    }

    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        if self.file.as_os_str().is_empty() {
            wrong.push(("file", "must name a file".to_string()));
        }
        let (idle, longest) = (self.session_idle_s, self.session_max_s);
        if !(30.0..=604_800.0).contains(&idle) {
            wrong.push(("session_idle_s", format!("{idle} must be 30 to 604800")));
        }
        if !(30.0..=2_678_400.0).contains(&longest) || longest < idle {
            wrong.push((
                "session_max_s",
                format!("{longest} must be 30 to 2678400 and at least session_idle_s"),
            ));
        }
        if !(1..=100_000).contains(&self.max_sessions) {
            wrong.push(("max_sessions", format!("{} must be 1 to 100000", self.max_sessions)));
        }
        wrong
    }

    pub(super) fn bounds(&self) -> Bounds {
        Bounds { idle_s: self.session_idle_s, longest_s: self.session_max_s, most: self.max_sessions }
    }
}
