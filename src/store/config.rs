//! `[store]`: where what was measured and said is kept, and for how long.

use serde::Deserialize;
use std::path::{Path, PathBuf};

/// `[store]`; without the section nothing is kept.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Folder of the store, made when it is not there; on a disk of this machine.
    pub folder: PathBuf,
    /// PostgreSQL instead of a database in the folder, as `postgres://user@host:5432/database`, without a password; the
    /// folder then holds what waits while that is away.
    #[serde(default)]
    pub url: Option<String>,
    /// File whose first line is the password.
    #[serde(default)]
    pub password_file: Option<PathBuf>,
    /// Environment variable that holds the password.
    #[serde(default)]
    pub password_env: Option<String>,
    /// Certificates (PEM) of who signs the database's: then the connection is encrypted, always.
    #[serde(default)]
    pub ca_file: Option<PathBuf>,
    /// Schema of the tables in PostgreSQL, made when it is not there.
    #[serde(default = "default_schema")]
    pub schema: String,
    /// Most bytes that wait on disk while PostgreSQL is away (MB); what is oldest goes first.
    #[serde(default = "default_spool_mb")]
    pub spool_mb: u64,
    /// Most bytes of its database (MB); what is oldest goes first.
    #[serde(default = "default_max_mb")]
    pub max_mb: u64,
    /// Samples in full are kept for this long (days), then thinned to trends.
    #[serde(default = "default_samples_days")]
    pub samples_days: f64,
    /// Trends, least, mean and most of each `trend_s`, are kept for this long (days); 0 for none.
    #[serde(default = "default_trend_days")]
    pub trend_days: f64,
    /// Time that one point of a trend stands for (s).
    #[serde(default = "default_trend_s")]
    pub trend_s: u32,
    /// Diagnoses and models are kept for this long (days); the latest of a loop and the last of all always.
    #[serde(default = "default_diagnoses_days")]
    pub diagnoses_days: f64,
    /// What happened to alarms is kept for this long (days); their state and the last change always.
    #[serde(default = "default_alarms_days")]
    pub alarms_days: f64,
    /// How often what is new is made durable (ms): a power failure costs at most this much.
    #[serde(default = "default_sync_ms")]
    pub sync_ms: u64,
    /// Samples of one tag that lie together on disk (s).
    #[serde(default = "default_chunk_s")]
    pub chunk_s: u32,
    /// Most memory for diagnoses, and for what happened to alarms, that wait while the store fails (MB). The latest states of alarms,
    /// models, orders and indicators wait beside that: they are never dropped, and bounded by the number of loops.
    #[serde(default = "default_queue_mb")]
    pub queue_mb: u64,
    /// How it looks after its files. It is no key: tests have small stores behave as large ones.
    #[serde(skip)]
    pub upkeep: Upkeep,
}

/// How a store in a folder looks after its files (pages of 8 KiB).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Upkeep {
    /// Pages that are compared with their checksums before the store is opened. The others are compared bit by bit.
    pub at_once: u32,
    /// Pages that are compared each time the write-ahead log is carried over into the database.
    pub each: u32,
    /// Pages of the log after which it is carried over.
    pub log: u32,
    /// How many times as fast as time the time moves at most by which age is measured; `None` where that is the clock.
    pub pace: Option<u32>,
}

impl Default for Upkeep {
    /// 512 MB before it is opened, which takes half a second; 32 MB each time, so that 20 GB take ten hours; a log of 8 MB, so
    /// that little hangs on one file. Four times as fast as time: a clock that is wrong for an hour costs three hours of what is
    /// oldest, and after two months off a store has caught up in twenty days.
    fn default() -> Self {
        Self { at_once: 65_536, each: 4096, log: 1000, pace: Some(4) }
    }
}

fn default_schema() -> String {
    "stictiond".to_string()
}

fn default_spool_mb() -> u64 {
    2000
}

fn default_max_mb() -> u64 {
    20_000
}

fn default_samples_days() -> f64 {
    30.0
}

fn default_trend_days() -> f64 {
    730.0
}

fn default_trend_s() -> u32 {
    60
}

fn default_diagnoses_days() -> f64 {
    1825.0
}

fn default_alarms_days() -> f64 {
    1825.0
}

fn default_sync_ms() -> u64 {
    1000
}

fn default_chunk_s() -> u32 {
    60
}

fn default_queue_mb() -> u64 {
    64
}

impl Config {
    /// A store in a folder, everything else as it is by default.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: folder.into(),
            url: None,
            password_file: None,
            password_env: None,
            ca_file: None,
            schema: default_schema(),
            spool_mb: default_spool_mb(),
            max_mb: default_max_mb(),
            samples_days: default_samples_days(),
            trend_days: default_trend_days(),
            trend_s: default_trend_s(),
            diagnoses_days: default_diagnoses_days(),
            alarms_days: default_alarms_days(),
            sync_ms: default_sync_ms(),
            chunk_s: default_chunk_s(),
            queue_mb: default_queue_mb(),
            upkeep: Upkeep::default(),
        }
    }

    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push((field, message));
            }
        };
        let named = !self.folder.as_os_str().is_empty();
        unless(named, "folder", "must name a folder".to_string());
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        let sound = (1..=40).contains(&self.schema.len())
            && self.schema.chars().all(plain)
            && !self.schema.starts_with(|c: char| c.is_ascii_digit());
        unless(sound, "schema", "must be 1 to 40 of a to z, 0 to 9 and _, no digit first".to_string());
        let own = self.schema.starts_with("pg_") || self.schema == "information_schema";
        unless(!own, "schema", format!("{:?} is a schema of the database itself", self.schema));
        let is_url = self.folder.to_string_lossy().contains("://");
        unless(!is_url, "folder", "is a path, without file:// before it".to_string());
        let is_root = self.folder == Path::new("/");
        unless(!is_root, "folder", "must be a folder of its own, not the whole machine".to_string());
        if let Some(url) = &self.url {
            let fault = url_fault(url, self.ca_file.is_some());
            unless(fault.is_none(), "url", fault.unwrap_or_default());
        }
        let of_url = [
            ("password_file", self.password_file.is_some()),
            ("password_env", self.password_env.is_some()),
            ("ca_file", self.ca_file.is_some()),
        ];
        for (field, given) in of_url {
            unless(!given || self.url.is_some(), field, "is of no use without url".to_string());
        }
        let both = self.password_file.is_some() && self.password_env.is_some();
        unless(!both, "password_env", "is given twice; leave password_file or password_env out".to_string());
        let counts = [
            ("spool_mb", self.spool_mb, 16..=10_000_000),
            ("max_mb", self.max_mb, 16..=100_000_000),
            ("trend_s", u64::from(self.trend_s), 1..=600),
            ("sync_ms", self.sync_ms, 10..=60_000),
            ("chunk_s", u64::from(self.chunk_s), 10..=600),
            ("queue_mb", self.queue_mb, 1..=10_000),
        ];
        for (field, value, range) in counts {
            unless(
                range.contains(&value),
                field,
                format!("{value} must be {} to {}", range.start(), range.end()),
            );
        }
        let days = [
            ("samples_days", self.samples_days, 0.01),
            ("trend_days", self.trend_days, 0.0),
            ("diagnoses_days", self.diagnoses_days, 1.0),
            ("alarms_days", self.alarms_days, 1.0),
        ];
        for (field, value, least) in days {
            unless((least..=36_500.0).contains(&value), field, format!("{value} must be {least} to 36500"));
        }
        let divides = (1..=600).contains(&self.trend_s) && 600 % self.trend_s == 0;
        unless(divides, "trend_s", format!("{} must divide 600 s", self.trend_s));
        wrong
    }
}

/// What is wrong with an address of a database; a password in it is never repeated.
fn url_fault(url: &str, has_ca: bool) -> Option<String> {
    let known = url.starts_with("postgres://") || url.starts_with("postgresql://");
    let Some(parsed) = url.parse::<tokio_postgres::Config>().ok().filter(|_| known) else {
        return Some("is not an address such as postgres://user@host:5432/database".to_string());
    };
    if parsed.get_password().is_some() {
        return Some("must hold no password; name a password_file or password_env".to_string());
    }
    if parsed.get_hosts().is_empty() || parsed.get_user().is_none() {
        return Some("must name user and host".to_string());
    }
    let near = |host: &tokio_postgres::config::Host| match host {
        tokio_postgres::config::Host::Tcp(name) => {
            name == "localhost" || name.parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback())
        }
        tokio_postgres::config::Host::Unix(_) => true,
    };
    let all_near = parsed.get_hosts().iter().all(near)
        && parsed.get_hostaddrs().iter().all(std::net::IpAddr::is_loopback);
    if !has_ca && !all_near {
        return Some(
            "is another machine; name the ca_file that it is to be trusted by, or reach it by a tunnel"
                .to_string(),
        );
    }
    let asks = parsed.get_ssl_mode() == tokio_postgres::config::SslMode::Require;
    (asks && !has_ca)
        .then(|| "asks for TLS; name the ca_file that the database is to be trusted by".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_with_a_password_is_refused_without_repeating_it() {
        let fault = |url: &str, ca| url_fault(url, ca);
        assert_eq!(fault("postgres://stictiond@db.plant:5432/history", true), None);
        assert_eq!(fault("postgres://stictiond@[::1]:5432/history", false), None);
        let elsewhere = "postgres://stictiond@localhost/history?hostaddr=10.1.1.1";
        assert!(fault(elsewhere, false).is_some_and(|t| t.contains("ca_file")));
        assert!(
            fault("postgres://stictiond@db.plant:5432/history", false).is_some_and(|t| t.contains("ca_file"))
        );
        assert_eq!(fault("postgresql://stictiond@%2Frun%2Fpostgresql/history", false), None);
        let told = fault("postgres://eve:geheim@db/history", false).expect("refused");
        assert!(told.contains("password_file") && !told.contains("geheim"), "{told}");
        for wrong in
            ["", "db", "mysql://a@b/c", "postgres://db/x", "postgres://a@/x", "postgres://a@b:99999/x"]
        {
            assert!(fault(wrong, false).is_some(), "{wrong}");
        }
        assert!(
            fault("postgres://a@localhost/c?sslmode=require", false)
                .is_some_and(|told| told.contains("ca_file"))
        );
        assert_eq!(fault("postgres://a@b/c?sslmode=require", true), None);
    }

    #[test]
    fn what_belongs_to_a_database_needs_one() {
        let config = Config { ca_file: Some("ca.pem".into()), schema: "1x".into(), ..Config::new("f") };
        let fields: Vec<_> = config.validate().into_iter().map(|(field, _)| field).collect();
        assert_eq!(fields, ["schema", "ca_file"]);
        assert!(Config::new("f").validate().is_empty());
    }
}
