//! The daemon as a process of its own, and the two operators.

use super::plant::HEARTBEAT_S;
use crate::http;
use serde_json::Value;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, Command};

/// Longer than anything takes; a test that waits so long has failed.
const PATIENCE: Duration = Duration::from_secs(60);

/// PV unchanged for longer is stale (s).
pub const FROZEN_S: f64 = 1.0;
/// A step later than this withdraws (s).
pub const STEP_S: f64 = 2.0;
/// The ramp from the clamp to zero (s).
pub const RAMP_S: f64 = 3.0 / 6.0;

pub struct Daemon {
    pub child: Child,
    pub api: SocketAddr,
    pub audit: PathBuf,
}

/// The configuration of one loop behind `plant`; write-back writes to `link`.
pub fn config(plant: SocketAddr, link: SocketAddr, audit: &Path) -> String {
    let device = |name: &str, address: SocketAddr| {
        format!(
            "[[modbus]]\nname = '{name}'\naddress = '{address}'\npoll_ms = 100\ntimeout_ms = 100\naddress_base = 0\n\
             reconnect_max_ms = 100\n"
        )
    };
    let tag = |role: &str, address: u16, kind: &str| {
        format!("[loop.{role}]\ndevice = 'dcs'\nregister = 'holding'\naddress = {address}\ntype = '{kind}'\n")
    };
    format!(
        "[server]\nlisten = '127.0.0.1:0'\n[schedule]\nperiod_s = 100000.0\n[writeback]\naudit_file = '{}'\n{}{}\
         [[loop]]\nid = 'LIC201'\nop_span = 100.0\nop_limits = [0.0, 100.0]\nfrozen_pv_s = {FROZEN_S:?}\n{}{}{}{}\
         [loop.writeback]\nenabled = true\ndevice = 'link'\nterm_address = 1000\nterm_type = 'f32'\n\
         term_byte_order = 'ABCD'\nterm_scale_percent = 1.0\nheartbeat_address = 1002\nheartbeat_timeout_ms = {}\n\
         write_ms = 100\ntimeout_ms = 400\nclamp_percent = 3.0\nrate_percent_per_s = 1000.0\n\
         withdraw_percent_per_s = 6.0\nwithdraw_limit_s = 5.0\ndead_band_percent = 0.05\nrest_ms = 60\n\
         max_step_ms = {}\nclock_tolerance_ms = 1000\nmax_sample_age_ms = 1000\n\
         max_missed_polls_per_minute = 10000\nop_margin_percent = 5.0\nsp_rate_per_s = 1.0\nsp_settle_s = 1.0\n\
         evidence_max_age_s = 600.0\nf_margin_percent = 5.0\ngrant_max_s = 600.0\nmeasure_s = 4.0\n\
         prove_s = 600.0\nise_gain = 1.5\nise_limit = 1000.0\ntravel_limit = 1000.0\nreversal_band_percent = 0.2\n",
        audit.display(),
        device("dcs", plant),
        device("link", link),
        tag("op", 0, "f32"),
        tag("pv", 2, "f32"),
        tag("sp", 4, "f32"),
        tag("mode", 6, "u16") + "auto_values = [1]\n",
        (1000.0 * HEARTBEAT_S) as u64,
        (1000.0 * STEP_S) as u64,
    )
}

impl Daemon {
    /// Starts it on a plant, with an audit log of this name.
    pub async fn start(plant: SocketAddr, link: SocketAddr, name: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let (path, audit) = (folder.join(format!("{name}.toml")), folder.join(format!("{name}.audit")));
        for old in [audit.clone(), folder.join(format!("{name}.audit.head"))] {
            let _ = std::fs::remove_file(old);
        }
        Self::run(&config(plant, link, &audit), &path, audit).await
    }

    /// Starts it on an address that the network can reach.
    pub async fn on_the_network(plant: SocketAddr, name: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let (path, audit) = (folder.join(format!("{name}.toml")), folder.join(format!("{name}.audit")));
        let everywhere = "listen = '0.0.0.0:0'\nallow_unauthenticated_network = true";
        let text = config(plant, plant, &audit).replace("listen = '127.0.0.1:0'", everywhere);
        Self::run(&text, &path, audit).await
    }

    /// Starts it with the audit log that is there.
    pub async fn again(plant: SocketAddr, link: SocketAddr, path: &Path, audit: PathBuf) -> Self {
        Self::run(&config(plant, link, &audit), path, audit).await
    }

    /// Starts it with a configuration that writes this audit log.
    pub async fn run(text: &str, path: &Path, audit: PathBuf) -> Self {
        std::fs::write(path, text).expect("the test directory is writable");
        let mut child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
            .args(["run", "--log-format", "json", "--config"])
            .arg(path)
            .env_remove("RUST_LOG")
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .expect("the binary starts");
        let mut log = BufReader::new(child.stderr.take().expect("piped")).lines();
        let api = loop {
            let line = log.next_line().await.expect("text").expect("it says where it serves");
            let entry: Value = serde_json::from_str(&line).expect("JSON");
            if entry["message"] == "serving" {
                break entry["address"].as_str().and_then(|text| text.parse().ok()).expect("an address");
            }
        };
        // A full pipe would stop the daemon.
        tokio::spawn(async move { while let Ok(Some(_)) = log.next_line().await {} });
        Self { child, api, audit }
    }

    pub async fn status(&self) -> Value {
        http::get(self.api, "/api/v1/loops/LIC201/writeback").await.json()
    }

    /// An operator acts; the answer must be 200.
    pub async fn act(&self, what: &str, body: &str) -> Value {
        let path = format!("/api/v1/loops/LIC201/writeback/{what}");
        let answer = http::send(self.api, "POST", &path, &["content-type: application/json"], body).await;
        assert_eq!(answer.status, 200, "{what}: {}", answer.text());
        answer.json()
    }

    /// Waits for a state.
    pub async fn state(&self, wanted: &str) -> Value {
        self.until(wanted, |status| status["state"] == wanted).await
    }

    async fn until(&self, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let status = self.status().await;
            if holds(&status) {
                return status;
            }
            assert!(began.elapsed() < PATIENCE, "never {what}: {status}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// From shadow to active, by two persons.
    pub async fn open(&self) {
        let began = Instant::now();
        loop {
            let status = self.status().await;
            let denials = status["denials"].as_array().expect("a list").clone();
            let says = |code: &str| denials.iter().any(|denial| denial["code"] == code);
            if status["state"] == "shadow" && denials.len() == 1 && says("not_granted") {
                break;
            }
            // Diagnosed until it is found, and not again: the record of a reinforced loop says less.
            if says("no_evidence") || says("not_sticky") {
                http::post(self.api, "/api/v1/loops/LIC201/diagnosis?wait_s=5", "").await;
            }
            assert!(began.elapsed() < PATIENCE, "never ready: {status}");
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        self.act("grant", r#"{"by": "Ann", "duration_s": 300}"#).await;
        self.act("approve", r#"{"by": "Bob"}"#).await;
        self.state("active").await;
    }

    pub fn signal(&self, name: &str) {
        let id = self.child.id().expect("it runs").to_string();
        let sent = std::process::Command::new("kill").args([name, &id]).status();
        assert!(sent.expect("kill is there").success());
    }
}
