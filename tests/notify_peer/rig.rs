//! What the tests stand on: a daemon whose diagnoses are made up by the test, and peers in processes of their own.

use super::piped::{python, spawn};
use serde_json::Value;
use std::collections::VecDeque;
use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use stictiond::app::App;
use stictiond::config;
use stictiond::diagnosis::rivals::Rival;
use stictiond::diagnosis::{Diagnosis, Estimate, Model, NotIdentifiable, Preparation, Verdict};
use stictiond::results::{Outcome, Run, Trigger};
use stictiond::schedule::Clock;
use stictiond::signal::LoopId;
use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::net::{TcpListener, TcpStream};
use tokio::process::{Child, ChildStdin, ChildStdout};
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

/// Far longer than anything here takes even on a busy machine; a test that waits so long has failed.
pub const PATIENCE: Duration = Duration::from_secs(40);

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()
}

/// An empty folder of the test's own.
pub fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("notify").join(name);
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).unwrap();
    path
}

/// The configuration of a plant of two loops; `store` is a folder, `more` says who is told.
pub fn plant(store: Option<&Path>, more: &str) -> String {
    plant_at(1, store, more)
}

/// The same with a device at a port.
pub fn plant_at(port: u16, store: Option<&Path>, more: &str) -> String {
    let mut text = format!(
        "[server]\nlisten = '127.0.0.1:0'\n[schedule]\nperiod_s = 86400\n\
         [alarm]\nk = 1\nn = 1\nclear_k = 1\nclear_n = 1\n\
         [[modbus]]\nname = 'd'\naddress = '127.0.0.1:{port}'\naddress_base = 0\npoll_ms = 500\n",
    );
    if let Some(folder) = store {
        text += &format!("[store]\nfolder = '{}'\nsync_ms = 50\n", folder.display());
    }
    for (at, id) in ["FIC1", "FIC2"].iter().enumerate() {
        text += &format!("[[loop]]\nid = '{id}'\ngroup = 'unit {}0'\nop_span = 100.0\n", at + 1);
        for (role, tag) in ["op", "pv"].iter().enumerate() {
            let address = 10 * at + 2 * role;
            text += &format!(
                "[loop.{tag}]\ndevice = 'd'\nregister = 'holding'\naddress = {address}\ntype = 'f32'\n"
            );
        }
    }
    text + more
}

/// A daemon in this process.
pub struct Daemon {
    pub app: Arc<App>,
    pub address: SocketAddr,
    stop: CancellationToken,
    task: tokio::task::JoinHandle<()>,
}

impl Daemon {
    pub async fn start(text: &str) -> Self {
        let config = config::parse("test", text).unwrap_or_else(|errors| panic!("{errors:?}"));
        let unknown = verdict(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), 0.0);
        let app = App::build(config, Clock::wall(), Arc::new(move |_, _, _| unknown.clone().into())).unwrap();
        let (app, listener) = (Arc::new(app), TcpListener::bind("127.0.0.1:0").await.unwrap());
        let (address, stop, running) = (listener.local_addr().unwrap(), app.stop(), app.clone());
        let task = tokio::spawn(async move { running.run(listener).await.unwrap() });
        let daemon = Self { app, address, stop, task };
        daemon.until("it answers", "/healthz", |health| health["status"] == "ok").await;
        daemon
    }

    pub async fn reload(&self, text: &str) {
        let config = config::parse("test", text).unwrap_or_else(|errors| panic!("{errors:?}"));
        self.app.reload(config).await.unwrap();
    }

    pub async fn stop(self) {
        self.stop.cancel();
        self.task.await.unwrap();
    }

    /// A diagnosis ends: the valve sticks by `f`, or does not.
    pub fn diagnosed(&self, id: &str, f: Option<f64>) {
        let judged = f.map_or_else(|| verdict(Verdict::NoStiction, 0.0), |f| verdict(Verdict::Stiction, f));
        self.ended(id, judged, 0.0);
    }

    /// Diagnoses end that cannot tell, for a minute now.
    pub fn not_identifiable(&self, id: &str) {
        for ago_s in [60.0, 0.0] {
            self.ended(id, verdict(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), 0.0), ago_s);
        }
    }

    fn ended(&self, id: &str, judged: Diagnosis, ago_s: f64) {
        let now = Clock::wall().now() - ago_s;
        self.app.results().record(Run {
            id: LoopId::new(id),
            started: now,
            finished: now,
            took_s: 0.1,
            trigger: Trigger::OnDemand,
            op_span: Some(100.0),
            basis: None,
            outcome: Outcome::Diagnosed(Box::new(judged.into())),
        });
    }

    /// Asks; the status and the body.
    pub async fn ask(&self, method: &str, path: &str, body: &str) -> (u16, String) {
        http(self.address, method, path, body).await
    }

    pub async fn json(&self, path: &str) -> Value {
        let (status, body) = self.ask("GET", path, "").await;
        assert_eq!(status, 200, "{path}: {body}");
        serde_json::from_str(&body).unwrap()
    }

    /// Waits until an answer satisfies the condition.
    pub async fn until(&self, what: &str, path: &str, good: impl Fn(&Value) -> bool) -> Value {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let answer = self.json(path).await;
            if good(&answer) {
                return answer;
            }
            assert!(Instant::now() < deadline, "{what}: {answer}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// How a receiver is.
    pub async fn receiver(&self, name: &str, what: &str, good: impl Fn(&Value) -> bool) -> Value {
        let own =
            |list: &Value| list["items"].as_array().unwrap().iter().find(|r| r["name"] == name).cloned();
        let list =
            self.until(what, "/api/v1/notifications", |list| own(list).is_some_and(|own| good(&own))).await;
        own(&list).unwrap()
    }
}

/// One request on a connection of its own.
pub async fn http(address: SocketAddr, method: &str, path: &str, body: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let length = body.len();
    let head = format!(
        "{method} {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\
         Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
    );
    stream.write_all((head + body).as_bytes()).await.unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).await.unwrap();
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_string())
}

fn verdict(verdict: Verdict, f: f64) -> Diagnosis {
    let model = Model { na: 1, nb: 1, nc: 1, nk: 1, a: vec![-0.5], b: vec![0.1], c: vec![0.0], rmse: 0.01 };
    let estimate = Estimate {
        f,
        f_ci95: [f - 0.05, f + 0.05],
        f_of_op_range: 0.4,
        delta_aic: 446.0,
        rival: Rival::Linear,
        steadiness: 9.0,
        f_max: 5.0,
        d: 2.0 * f,
        curve: vec![],
        model,
        mv: vec![],
    };
    let identifiable = !matches!(verdict, Verdict::NotIdentifiable(_));
    Diagnosis {
        reason: format!("made for a test: {}", verdict.as_str()),
        verdict,
        preparation: Preparation { n: 1000, ts: 1.0, ..Preparation::default() },
        oscillation: None,
        estimate: identifiable.then_some(estimate),
        residual: None,
        packed: None,
        window: None,
    }
}

/// One of tests/peers, killed when dropped.
pub struct Peer {
    _child: Child,
    commands: ChildStdin,
    lines: Lines<BufReader<ChildStdout>>,
    heard: VecDeque<String>,
    pub port: u16,
}

impl Peer {
    pub async fn start(script: &str, arguments: &[&str]) -> Self {
        let (_child, commands, lines) = spawn(python(script).args(arguments));
        let mut peer = Self { _child, commands, lines, heard: VecDeque::new(), port: 0 };
        peer.port = peer.line().await.strip_prefix("port ").unwrap().parse().unwrap();
        peer
    }

    async fn line(&mut self) -> String {
        let line = timeout_at(Instant::now() + PATIENCE, self.lines.next_line()).await;
        line.expect("it said nothing").unwrap().expect("it ended")
    }

    /// Gives a command.
    pub async fn tell(&mut self, command: &str) {
        self.commands.write_all(format!("{command}\n").as_bytes()).await.unwrap();
        loop {
            match self.line().await {
                line if line == "ok" => return,
                line => self.heard.push_back(line),
            }
        }
    }

    /// The next thing it was sent.
    pub async fn next(&mut self) -> Value {
        let line = match self.heard.pop_front() {
            Some(line) => line,
            None => self.line().await,
        };
        serde_json::from_str(&line).unwrap()
    }
}
