//! What the tests stand on: mosquitto in a process of its own, clients that are not ours, and a sink to wait on.

use super::piped::{python, spawn};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use stictiond::collect::mqtt::{Collector, Config, Plan, TagSpec};
use stictiond::collect::{DeviceHealth, HealthSnapshot, Poll, Sink, SystemClock};
use stictiond::signal::Sample;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

/// Far longer than anything here takes even on a busy machine; a test that waits so long has failed.
const PATIENCE: Duration = Duration::from_secs(20);

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()
}

/// A port that was free a moment ago: mosquitto cannot be asked for any.
pub async fn free_port() -> u16 {
    tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap().port()
}

/// mosquitto, killed when dropped.
pub struct Broker {
    child: Child,
    pub port: u16,
    pub folder: PathBuf,
}

impl Broker {
    /// On a free port; `name` is the test's folder.
    pub async fn start(name: &str) -> Self {
        Self::with(name, free_port().await, "allow_anonymous true").await
    }

    /// With further lines of configuration.
    pub async fn with(name: &str, port: u16, more: &str) -> Self {
        let folder = root().join("target/tmp/mqtt").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("mosquitto.conf");
        std::fs::write(&file, format!("listener {port} 127.0.0.1\n{more}\n")).unwrap();
        let program = ["/usr/sbin/mosquitto", "/usr/bin/mosquitto"].map(Path::new);
        let program = program.into_iter().find(|path| path.exists());
        let program =
            program.expect("mosquitto is not installed: run scripts/peers once, then the tests again");
        let child = Command::new(program)
            .args(["-c".as_ref(), file.as_os_str()])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let deadline = Instant::now() + PATIENCE;
        while tokio::net::TcpStream::connect(("127.0.0.1", port)).await.is_err() {
            assert!(Instant::now() < deadline, "mosquitto does not listen");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        Self { child, port, folder }
    }

    pub async fn kill(&mut self) {
        self.child.kill().await.unwrap();
    }

    /// Publishes by mosquitto's own client.
    pub async fn publish(&self, topic: &str, payload: &str, more: &[&str]) {
        let port = self.port.to_string();
        let status = Command::new("mosquitto_pub")
            .args(["-h", "127.0.0.1", "-p", &port, "-q", "1", "-t", topic, "-m", payload])
            .args(more)
            .status();
        assert!(status.await.unwrap().success());
    }

    /// Listens by mosquitto's own client: lines of `retained topic payload`.
    pub async fn listen(&self, filter: &str) -> Lines<BufReader<ChildStdout>> {
        let port = self.port.to_string();
        let mut child = Command::new("mosquitto_sub")
            .args(["-h", "127.0.0.1", "-p", &port, "-q", "1", "-t", filter, "-F", "%r %t %p"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        // Ends with the broker or with the test's runtime.
        tokio::spawn(async move { child.wait().await });
        lines
    }
}

/// The next line that satisfies the condition.
pub async fn line(
    lines: &mut Lines<BufReader<ChildStdout>>,
    what: &str,
    wanted: impl Fn(&str) -> bool,
) -> String {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let next = timeout_at(deadline, lines.next_line()).await;
        let line = next.unwrap_or_else(|_| panic!("never {what}")).unwrap();
        let line = line.unwrap_or_else(|| panic!("ended before {what}"));
        if wanted(&line) {
            return line;
        }
    }
}

/// tests/peers/sparkplug_edge.py, killed when dropped.
pub struct Peer {
    _child: Child,
    commands: ChildStdin,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Peer {
    pub async fn start(broker: &Broker, kind: &str) -> Self {
        let (_child, commands, lines) =
            spawn(python("sparkplug_edge.py").args([&broker.port.to_string(), kind]));
        let mut peer = Self { _child, commands, lines };
        peer.said("ready").await;
        peer
    }

    /// Waits until it says so.
    pub async fn said(&mut self, wanted: &str) {
        line(&mut self.lines, wanted, |line| line == wanted).await;
    }

    /// Gives a command.
    pub async fn order(&mut self, command: &str) {
        self.commands.write_all(format!("{command}\n").as_bytes()).await.unwrap();
    }

    /// Gives a command and waits until it is done; what is said meanwhile is not heard.
    pub async fn tell(&mut self, command: &str) {
        self.order(command).await;
        self.said("ok").await;
    }

    /// The metrics of the next message whose topic begins so.
    pub async fn read(&mut self, topic: &str) -> serde_json::Value {
        let line = line(&mut self.lines, topic, |line| line.starts_with(topic)).await;
        let (_, json) = line.split_once(" {").unwrap();
        serde_json::from_str(&format!("{{{json}")).unwrap()
    }
}

/// What is logged on this thread.
#[derive(Clone, Default)]
pub struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Log {
    /// From now on until the guard goes.
    pub fn start() -> (Self, tracing::subscriber::DefaultGuard) {
        let log = Self::default();
        let writer = log.clone();
        let to_log = tracing_subscriber::fmt()
            .with_env_filter("stictiond=debug")
            .with_ansi(false)
            .with_writer(move || writer.clone())
            .finish();
        (log, tracing::subscriber::set_default(to_log))
    }

    /// The first line with this text.
    pub async fn until(&self, text: &str) -> String {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let said = String::from_utf8_lossy(&self.0.lock().unwrap()).into_owned();
            if let Some(line) = said.lines().find(|line| line.contains(text)) {
                return line.to_string();
            }
            assert!(Instant::now() < deadline, "never {text}: {said}");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
}

struct Recorder(UnboundedSender<(usize, Sample)>);

impl Sink for Recorder {
    fn sample(&self, tag: usize, sample: Sample) {
        let _ = self.0.send((tag, sample));
    }
    fn poll(&self, _device: usize, _poll: Poll) {}
}

/// A running collector and what it handed over.
pub struct Watch {
    samples: UnboundedReceiver<(usize, Sample)>,
    pub health: Arc<DeviceHealth>,
    stop: CancellationToken,
    task: tokio::task::JoinHandle<()>,
}

impl Watch {
    pub fn start(port: u16, config: &str, tags: &[&str]) -> Self {
        Self::named("b", port, config, tags)
    }

    /// Under another name of its section.
    pub fn named(name: &str, port: u16, config: &str, tags: &[&str]) -> Self {
        let text = format!("name = '{name}'\naddress = '127.0.0.1:{port}'\nreconnect_max_ms = 300\n{config}");
        let config: Config = toml::from_str(&text).unwrap();
        let specs = tags.iter().enumerate().map(|(index, text)| TagSpec {
            index,
            name: format!("tag {index}"),
            role: None,
            config: toml::from_str(&format!("device = 'b'\n{text}")).unwrap(),
            frozen_after_s: None,
        });
        let plan = Plan::new(0, &config, specs.collect()).unwrap();
        let collector = Collector::new(plan, Arc::new(SystemClock), 7);
        let (sender, samples) = unbounded_channel();
        let (health, stop) = (collector.health(), CancellationToken::new());
        let task = tokio::spawn(collector.run(Arc::new(Recorder(sender)), stop.clone()));
        Self { samples, health, stop, task }
    }

    /// The next sample of all.
    pub async fn next(&mut self) -> (usize, Sample) {
        let next = timeout_at(Instant::now() + PATIENCE, self.samples.recv()).await;
        next.expect("no sample").unwrap()
    }

    /// Whether samples wait that nobody took.
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Waits until the counters satisfy the condition.
    pub async fn until(&self, what: &str, condition: impl Fn(&HealthSnapshot) -> bool) {
        let deadline = Instant::now() + PATIENCE;
        while !condition(&self.health.snapshot()) {
            assert!(Instant::now() < deadline, "never {what}: {:?}", self.health.snapshot());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    pub async fn stop(self) {
        self.stop.cancel();
        timeout_at(Instant::now() + PATIENCE, self.task).await.expect("does not stop").unwrap();
    }
}
