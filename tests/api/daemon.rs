//! The daemon as a process: signals.

use crate::app::{device, text};
use crate::http::get;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStderr, Command};

struct Process {
    child: Child,
    log: Lines<BufReader<ChildStderr>>,
    file: PathBuf,
}

impl Process {
    fn start(config: &str) -> Self {
        let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("daemon.toml");
        std::fs::write(&file, config).expect("written");
        let mut child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
            .args(["run", "--log-format", "json", "--config"])
            .arg(&file)
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .expect("started");
        let log = BufReader::new(child.stderr.take().expect("piped")).lines();
        Self { child, log, file }
    }

    /// Waits for a line of the log that contains this.
    async fn logged(&mut self, what: &str) -> String {
        loop {
            let line = tokio::time::timeout(Duration::from_secs(20), self.log.next_line()).await;
            let line = line.unwrap_or_else(|_| panic!("'{what}' was never logged"));
            let line = line.expect("read").unwrap_or_else(|| panic!("ended before '{what}' was logged"));
            if line.contains(what) {
                return line;
            }
        }
    }

    async fn signal(&self, name: &str) {
        let id = self.child.id().expect("it runs").to_string();
        let sent = Command::new("kill").args([format!("-{name}"), id]).status().await;
        assert!(sent.expect("there is kill").success());
    }
}

async fn loops(address: SocketAddr) -> Vec<String> {
    let list = get(address, "/api/v1/loops").await.json();
    let items = list["items"].as_array().expect("a list");
    items.iter().filter_map(|item| item["id"].as_str().map(str::to_string)).collect()
}

#[tokio::test]
async fn a_hangup_reloads_a_good_file_and_refuses_a_bad_one() {
    let (plc, _) = device().await;
    let with = |id: &str| text(&[plc], &[(id, 0, 10)]) + "[server]\nlisten = \"127.0.0.1:0\"\n";
    let mut daemon = Process::start(&with("A"));
    let line: serde_json::Value =
        serde_json::from_str(&daemon.logged("\"serving\"").await).expect("a line of JSON");
    let address: SocketAddr =
        line["address"].as_str().and_then(|text| text.parse().ok()).expect("an address");
    assert_eq!(loops(address).await, ["A"]);
    std::fs::write(&daemon.file, with("B") + "[shedule]\nperiod_s = 3\n").expect("written");
    daemon.signal("HUP").await;
    daemon.logged("refused").await;
    assert_eq!(loops(address).await, ["A"]);
    std::fs::write(&daemon.file, with("B")).expect("written");
    daemon.signal("HUP").await;
    daemon.logged("in force").await;
    assert_eq!(loops(address).await, ["B"]);
    daemon.signal("TERM").await;
    let ended = tokio::time::timeout(Duration::from_secs(10), daemon.child.wait()).await;
    assert!(ended.expect("ends in time").expect("waited for").success());
}
