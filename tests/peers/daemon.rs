//! The binary as a process, asked over HTTP.
#![allow(dead_code, reason = "not every test asks for everything")]

use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A daemon that serves.
pub struct Daemon {
    child: Child,
    pub address: SocketAddr,
}

impl Drop for Daemon {
    /// SIGKILL: one that a failed test leaves behind would go on. Of one that has ended nothing is left to kill.
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

impl Daemon {
    /// Runs `command` with arguments that end in those of `stictiond run`, or of another `role`, and waits until it serves.
    pub fn start(mut command: Command, role: &str, config: &Path) -> Self {
        command.args([role, "--log-format", "json", "--config"]).arg(config).env_remove("RUST_LOG");
        let mut child = command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().expect("runs");
        let mut log = BufReader::new(child.stderr.take().expect("piped"));
        let mut said = String::new();
        let address = loop {
            let mut line = String::new();
            assert!(log.read_line(&mut line).expect("text") > 0, "the log ended before it served: {said}");
            said += &line;
            let entry: Value = serde_json::from_str(&line).unwrap_or_default();
            if entry["message"] == "serving" {
                break entry["address"].as_str().and_then(|a| a.parse().ok()).expect("an address");
            }
        };
        // A pipe that nobody reads would stop the daemon.
        let file = config.with_extension("log");
        let file = std::fs::OpenOptions::new().create(true).append(true).open(file);
        let mut file = file.expect("beside the configuration");
        std::thread::spawn(move || std::io::copy(&mut log, &mut file));
        Self { child, address }
    }

    pub fn ask(&self, method: &str, path: &str, body: &str) -> String {
        let mut stream = TcpStream::connect(self.address).expect("it listens");
        let length = body.len();
        let head = format!("{method} {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n", self.address);
        let head = head + &format!("Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n");
        stream.write_all((head + body).as_bytes()).expect("it takes a request");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("it answers");
        answer.split_once("\r\n\r\n").expect("an HTTP answer").1.to_string()
    }

    pub fn json(&self, path: &str) -> Value {
        serde_json::from_str(&self.ask("GET", path, "")).unwrap_or_else(|error| panic!("{path}: {error}"))
    }

    pub fn until(&self, what: &str, patience: Duration, good: impl Fn(&Self) -> bool) {
        let begun = Instant::now();
        while !good(self) {
            let health = self.ask("GET", "/healthz", "");
            assert!(begun.elapsed() < patience, "{what}: not after {patience:?}; {health}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub fn id(&self) -> String {
        self.child.id().to_string()
    }

    pub fn signal(&self, name: &str) {
        assert!(Command::new("kill").args([name, &self.id()]).status().expect("kill is there").success());
    }

    pub fn stop(mut self) {
        self.signal("-TERM");
        assert!(self.child.wait().expect("it ends").success());
    }
}

/// The binary.
pub fn stictiond() -> Command {
    Command::new(env!("CARGO_BIN_EXE_stictiond"))
}

/// An empty folder of this process.
pub fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("writable");
    path
}
