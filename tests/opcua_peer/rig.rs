//! What the tests stand on: servers in processes of their own, and a sink to wait on.

use super::piped::{python, spawn};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use stictiond::collect::opcua::{Collector, Config, Pinned, Plan, TagSpec};
use stictiond::collect::{DeviceHealth, HealthSnapshot, Poll, Sink, SystemClock};
use stictiond::signal::Sample;
use tokio::io::{AsyncWriteExt, BufReader, Lines};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

/// Far longer than anything here takes even on a busy machine; a test that waits so long has failed.
const PATIENCE: Duration = Duration::from_secs(60);

/// The counter of the server counts so many seconds.
pub const TICK_S: f64 = 0.02;

/// One of tests/peers/opcua_server.*, killed when dropped.
pub struct Server {
    child: Child,
    commands: ChildStdin,
    lines: Lines<BufReader<ChildStdout>>,
    /// Where it listens.
    pub port: u16,
}

impl Server {
    /// asyncua.
    pub async fn start(args: &[&str]) -> Self {
        Self::run(python("opcua_server.py").args(args)).await
    }

    /// node-opcua, with its certificates in `folder` and this many seconds of history.
    pub async fn start_node(folder: &Path, port: u16, backlog_s: u32) -> Self {
        let installed = root().join("target/peers-node/installed");
        assert!(
            installed.exists(),
            "node-opcua is not installed: run scripts/peers once, then the tests again"
        );
        let args = [folder.to_str().unwrap(), &port.to_string(), &backlog_s.to_string()];
        Self::run(Command::new("node").arg(root().join("tests/peers/opcua_server.js")).args(args)).await
    }

    async fn run(command: &mut Command) -> Self {
        let (child, commands, lines) = spawn(command.stderr(Stdio::null()));
        let mut server = Self { child, commands, lines, port: 0 };
        // The library may speak first.
        server.port = loop {
            if let Some(port) = server.line().await.strip_prefix("port ") {
                break port.parse().unwrap();
            }
        };
        server
    }

    async fn line(&mut self) -> String {
        let line = timeout_at(Instant::now() + PATIENCE, self.lines.next_line()).await;
        line.expect("the server says nothing").unwrap().expect("the server ended")
    }

    /// Gives a command and waits until it holds.
    pub async fn tell(&mut self, command: &str) {
        self.commands.write_all(format!("{command}\n").as_bytes()).await.unwrap();
        while self.line().await != "ok" {}
    }

    /// Gives a command and returns what it says before it holds.
    pub async fn ask(&mut self, command: &str) -> String {
        self.commands.write_all(format!("{command}\n").as_bytes()).await.unwrap();
        let answer = self.line().await;
        while self.line().await != "ok" {}
        answer
    }

    pub async fn kill(mut self) {
        self.child.kill().await.unwrap();
    }
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// What a collector handed over, by tag.
struct Recorder {
    samples: Mutex<Vec<Vec<Sample>>>,
    news: watch::Sender<u64>,
}

impl Sink for Recorder {
    fn sample(&self, tag: usize, sample: Sample) {
        self.samples.lock().unwrap()[tag].push(sample);
        self.news.send_modify(|n| *n += 1);
    }
    fn poll(&self, _device: usize, _poll: Poll) {
        self.news.send_modify(|n| *n += 1);
    }
}

/// A running collector and what it handed over.
pub struct Watch {
    recorder: Arc<Recorder>,
    news: watch::Receiver<u64>,
    pub health: Arc<DeviceHealth>,
    log: Arc<Mutex<Vec<u8>>>,
    stop: CancellationToken,
    task: tokio::task::JoinHandle<()>,
    _log: tracing::subscriber::DefaultGuard,
}

#[derive(Clone)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Watch {
    /// Its log is that of this thread, on which a test's tasks run.
    pub fn start(plan: Plan) -> Self {
        Self::start_pinning(plan, &Pinned::default())
    }

    /// The same, with the namespaces of all who share `pinned`.
    pub fn start_pinning(plan: Plan, pinned: &Pinned) -> Self {
        let log: Arc<Mutex<Vec<u8>>> = Arc::default();
        let writer = Log(log.clone());
        let to_log = tracing_subscriber::fmt()
            .with_env_filter("stictiond=debug")
            .with_ansi(false)
            .with_writer(move || writer.clone())
            .finish();
        let guard = tracing::subscriber::set_default(to_log);
        let (sender, news) = watch::channel(0);
        let samples = Mutex::new(vec![Vec::new(); plan.tags.len()]);
        let recorder = Arc::new(Recorder { samples, news: sender });
        let stop = CancellationToken::new();
        let collector = Collector::new(plan, Arc::new(SystemClock), 7).pinning(pinned);
        let health = collector.health();
        let task = tokio::spawn(collector.run(recorder.clone(), stop.clone()));
        Self { recorder, news, health, log, stop, task, _log: guard }
    }

    pub fn samples(&self, tag: usize) -> Vec<Sample> {
        self.recorder.samples.lock().unwrap()[tag].clone()
    }

    fn said(&self) -> String {
        String::from_utf8_lossy(&self.log.lock().unwrap()).into_owned()
    }

    /// The lines of the log that call for attention.
    pub fn warnings(&self) -> Vec<String> {
        self.said().lines().filter(|line| line.contains(" WARN ")).map(str::to_string).collect()
    }

    async fn wait<T>(&mut self, what: &str, found: impl Fn(&Self) -> Option<T>) -> T {
        let deadline = Instant::now() + PATIENCE;
        loop {
            self.news.borrow_and_update();
            if let Some(found) = found(self) {
                return found;
            }
            if timeout_at(deadline, self.news.changed()).await.is_err() || Instant::now() > deadline {
                panic!("never {what}; {:?}\n{}", self.health.snapshot(), self.said());
            }
        }
    }

    /// The samples of a tag once they satisfy the condition.
    pub async fn until(
        &mut self,
        what: &str,
        tag: usize,
        condition: impl Fn(&[Sample]) -> bool,
    ) -> Vec<Sample> {
        self.wait(what, |own| Some(own.samples(tag)).filter(|all| condition(all))).await
    }

    pub async fn until_health(
        &mut self,
        what: &str,
        condition: impl Fn(&HealthSnapshot) -> bool,
    ) -> HealthSnapshot {
        self.wait(what, |own| Some(own.health.snapshot()).filter(|health| condition(health))).await
    }

    /// The first line of the log that holds a text.
    pub async fn until_said(&mut self, text: &str) -> String {
        self.wait(text, |own| own.said().lines().find(|line| line.contains(text)).map(str::to_string)).await
    }

    pub async fn stop(self) {
        self.stop.cancel();
        timeout_at(Instant::now() + PATIENCE, self.task).await.expect("does not stop").unwrap();
    }
}

/// A server at `port` without security, with further lines of configuration.
pub fn config(port: u16, more: &str) -> Config {
    config_secure(port, &format!("security_policy = 'None'\n{more}"))
}

/// A server at `port`, with further lines of configuration.
pub fn config_secure(port: u16, more: &str) -> Config {
    toml::from_str(&format!("name = 'dut'\nurl = 'opc.tcp://localhost:{port}/peer/'\n{more}")).unwrap()
}

/// An empty folder for certificates.
pub fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("stictiond-opcua-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// A plan for the tags, each given as its configuration.
pub fn plan(config: &Config, tags: &[String]) -> Plan {
    let specs = tags.iter().enumerate().map(|(index, text)| TagSpec {
        index,
        name: format!("tag {index}"),
        role: None,
        config: toml::from_str(&format!("device = 'dut'\n{text}")).unwrap(),
        frozen_after_s: None,
    });
    Plan::new(0, config, specs.collect()).unwrap()
}

/// The tag of a node that never changes.
pub fn steady(k: usize) -> String {
    format!("node = 'ns=2;s=Steady{k}'")
}

/// Lays out a folder of certificates with the client's own key; with `server` what was rejected becomes trusted.
pub fn trust(made: &Path, pki: &Path, server: bool) {
    for folder in ["own", "private", "trusted", "rejected"] {
        std::fs::create_dir_all(pki.join(folder)).unwrap();
    }
    std::fs::copy(made.join("client.der"), pki.join("own/cert.der")).unwrap();
    std::fs::copy(made.join("client.pem"), pki.join("private/private.pem")).unwrap();
    if server {
        let rejected: Vec<_> = std::fs::read_dir(pki.join("rejected")).unwrap().flatten().collect();
        assert_eq!(rejected.len(), 1, "the server's certificate was laid aside");
        for entry in rejected {
            std::fs::rename(entry.path(), pki.join("trusted").join(entry.file_name())).unwrap();
        }
    }
}

/// The tag of the node that counts.
pub const COUNTER: &str = "path = '/2:Plant/2:Unit/2:Counter'";

/// Every sample of the counter says what its source time must be, also those from history.
pub fn checked(samples: &[Sample]) -> Vec<u64> {
    let good: Vec<&Sample> = samples.iter().filter(|s| s.quality.is_good()).collect();
    for pair in samples.windows(2) {
        assert!(pair[1].t > pair[0].t, "twice, or backwards: {pair:?}");
    }
    for sample in &good {
        // asyncua keeps microseconds, and a double of this size steps by 2.4e-7 s.
        assert!((sample.t - sample.value * TICK_S).abs() < 5e-6, "not its source time: {sample:?}");
    }
    good.iter().map(|sample| sample.value as u64).collect()
}

/// Between which ticks some are missing.
pub fn holes(ticks: &[u64]) -> Vec<(u64, u64)> {
    ticks.windows(2).filter(|pair| pair[1] != pair[0] + 1).map(|pair| (pair[0], pair[1])).collect()
}
