//! Alertmanager, as Debian has it.

use super::rig::{Daemon, PATIENCE, folder, http, plant, root};
use serde_json::Value;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;
use stictiond::results::SourceOrder;
use stictiond::signal::LoopId;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpListener;
use tokio::process::{Child, Command};
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::time::{Instant, sleep, timeout};

/// Debian's program, killed when dropped.
struct Alertmanager {
    child: Child,
    address: SocketAddr,
    folder: PathBuf,
}

impl Alertmanager {
    async fn start(folder: &Path, port: u16) -> Self {
        let program = ["/usr/bin/prometheus-alertmanager", "/usr/local/bin/alertmanager"].map(Path::new);
        let program = program.into_iter().find(|path| path.exists());
        let program =
            program.expect("there is no Alertmanager: run scripts/peers once, then the tests again");
        let child = Command::new(program)
            .arg(format!("--config.file={}", folder.join("alertmanager.yml").display()))
            .arg(format!("--storage.path={}", folder.join("data").display()))
            .arg(format!("--web.listen-address=127.0.0.1:{port}"))
            .arg("--cluster.listen-address=")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let address = SocketAddr::from(([127, 0, 0, 1], port));
        let deadline = Instant::now() + PATIENCE;
        while tokio::net::TcpStream::connect(address).await.is_err() {
            assert!(Instant::now() < deadline, "it does not listen");
            sleep(Duration::from_millis(50)).await;
        }
        Self { child, address, folder: folder.to_path_buf() }
    }

    /// Stopped as a supervisor would, which lets it write down what it has told, and started again.
    async fn restart(mut self) -> Self {
        let id = self.child.id().unwrap().to_string();
        assert!(Command::new("kill").args(["-TERM", &id]).status().await.unwrap().success());
        self.child.wait().await.unwrap();
        Self::start(&self.folder, self.address.port()).await
    }

    /// The alerts that are active, by loop.
    async fn active(&self) -> Vec<Value> {
        let (status, body) = http(self.address, "GET", "/api/v2/alerts?active=true", "").await;
        assert_eq!(status, 200, "{body}");
        // Its answers come in chunks once they are long.
        let body = body.find('[').zip(body.rfind(']')).map(|(from, to)| body[from..=to].to_string());
        serde_json::from_str::<Vec<Value>>(&body.unwrap()).unwrap()
    }

    /// Waits until as many alerts are active; what makes each the one it is, by loop.
    async fn until(&self, what: &str, count: usize) -> BTreeMap<String, (Value, Value)> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let found = self.active().await;
            if found.len() == count {
                let of = |alert: &Value| {
                    let id = alert["labels"]["loop"].as_str().unwrap().to_string();
                    (id, (alert["fingerprint"].clone(), alert["startsAt"].clone()))
                };
                return found.iter().map(of).collect();
            }
            assert!(Instant::now() < deadline, "{what}: {found:?}");
            sleep(Duration::from_millis(50)).await;
        }
    }
}

/// Who the Alertmanager tells: status and loop of every alert in every notification.
async fn told() -> (u16, UnboundedReceiver<(String, String)>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let (port, (said, heard)) = (listener.local_addr().unwrap().port(), unbounded_channel());
    tokio::spawn(async move {
        while let Ok((stream, _)) = listener.accept().await {
            let said = said.clone();
            tokio::spawn(async move {
                let mut stream = BufReader::new(stream);
                loop {
                    let (mut length, mut line) = (0, String::new());
                    while stream.read_line(&mut line).await.is_ok_and(|read| read > 2) {
                        if let Some(value) = line.to_lowercase().strip_prefix("content-length:") {
                            length = value.trim().parse().unwrap();
                        }
                        line.clear();
                    }
                    let mut body = vec![0; length];
                    if length == 0 || stream.read_exact(&mut body).await.is_err() {
                        return;
                    }
                    let body: Value = serde_json::from_slice(&body).unwrap();
                    for alert in body["alerts"].as_array().unwrap() {
                        let text = |value: &Value| value.as_str().unwrap().to_string();
                        let _ = said.send((text(&alert["status"]), text(&alert["labels"]["loop"])));
                    }
                    let answer = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n";
                    if stream.write_all(answer).await.is_err() {
                        return;
                    }
                }
            });
        }
    });
    (port, heard)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_alert_a_loop_outlives_a_restart_of_either_side_and_is_resolved() {
    let folder = folder("alertmanager");
    let (told_at, mut heard) = told().await;
    let route = "route:\n  receiver: it\n  group_by: ['...']\n  group_wait: 100ms\n  group_interval: 1s\n  repeat_interval: 4h\n";
    let receiver =
        format!("receivers:\n  - name: it\n    webhook_configs:\n      - url: http://127.0.0.1:{told_at}/\n");
    std::fs::write(folder.join("alertmanager.yml"), format!("{route}{receiver}")).unwrap();
    let port = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap().port();
    let text = format!(
        "[notify]\nsite = 'plant A'\n[[notify.alertmanager]]\nname = 'am'\nurl = 'http://127.0.0.1:{port}'\nresend_s = 1.0\nexpires_s = 60.0\n"
    );
    let text = plant(Some(&folder.join("store")), &text);
    let daemon = Daemon::start(&text).await;
    // It is not there yet: what happens meanwhile is told when it is.
    daemon.diagnosed("FIC1", Some(2.5));
    daemon.diagnosed("FIC2", Some(0.6));
    daemon.receiver("am", "failing", |own| own["state"] == "failing").await;
    let alertmanager = Alertmanager::start(&folder, port).await;
    let before = alertmanager.until("two alerts", 2).await;
    let alert =
        alertmanager.active().await.into_iter().find(|alert| alert["labels"]["loop"] == "FIC1").unwrap();
    let labels = serde_json::json!({
        "alertname": "ValveSticks", "job": "stictiond", "kind": "stiction", "priority": "high",
        "severity": "critical", "loop": "FIC1", "group": "unit 10", "site": "plant A",
    });
    assert_eq!(alert["labels"], labels);
    assert_eq!(
        (&alert["annotations"]["f"], &alert["annotations"]["evidence"]),
        (&"2.500 % OP".into(), &"446.0".into())
    );
    assert_eq!(
        alert["annotations"]["description"],
        "The valve sticks: it ignores the first 5 % OP of each reversal."
    );

    // Another f is the same alert, with another annotation.
    daemon.diagnosed("FIC1", Some(2.75));
    let deadline = Instant::now() + PATIENCE;
    while !alertmanager.active().await.iter().any(|alert| alert["annotations"]["f"] == "2.750 % OP") {
        assert!(Instant::now() < deadline, "f is not followed");
        sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(alertmanager.until("the same two", 2).await, before);

    // The daemon starts again.
    daemon.stop().await;
    assert_eq!(alertmanager.until("while the daemon is away", 2).await, before);
    let daemon = Daemon::start(&text).await;
    daemon.receiver("am", "told again", |own| own["sent"].as_u64().unwrap() >= 2).await;
    assert_eq!(alertmanager.until("after the daemon's restart", 2).await, before);

    // The Alertmanager starts again, with nothing but what it has told.
    let alertmanager = alertmanager.restart().await;
    assert_eq!(alertmanager.until("after its own restart", 2).await, before);

    // Cleared while the daemon is there, and shelved: both are resolved.
    daemon.diagnosed("FIC1", None);
    let left = alertmanager.until("one is resolved", 1).await;
    assert!(left.contains_key("FIC2"), "{left:?}");
    let shelve = "{\"duration_s\": 600, \"by\": \"jw\", \"comment\": \"spare part ordered\"}";
    let (status, answer) = daemon.ask("POST", "/api/v1/alarms/FIC2/stiction/shelve", shelve).await;
    assert_eq!(status, 200, "{answer}");
    alertmanager.until("none is left", 0).await;

    // In all: each told once as firing and once as resolved.
    let mut all = Vec::new();
    while all.len() < 4 {
        all.push(timeout(PATIENCE, heard.recv()).await.expect("four in time").unwrap());
    }
    // Two of its intervals: what would come twice would have come.
    let more = timeout(Duration::from_secs(2), heard.recv()).await;
    assert!(more.is_err(), "{more:?} after {all:?}");
    all.sort();
    let expected = [("firing", "FIC1"), ("firing", "FIC2"), ("resolved", "FIC1"), ("resolved", "FIC2")];
    assert_eq!(all, expected.map(|(status, id)| (status.to_string(), id.to_string())));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_swings_with_another_is_inhibited_while_that_one_stands_by_the_rules_of_deploy() {
    let folder = folder("inhibition");
    std::fs::copy(root().join("deploy/alertmanager/alertmanager.yml"), folder.join("alertmanager.yml"))
        .unwrap();
    let port = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap().port();
    let text = format!(
        "[alarm.not_identifiable]\nafter_s = 1.0\n[[notify.alertmanager]]\nname = 'am'\nurl = 'http://127.0.0.1:{port}'\nresend_s = 1.0\nexpires_s = 60.0\n"
    );
    let daemon = Daemon::start(&plant(None, &text)).await;
    let alertmanager = Alertmanager::start(&folder, port).await;
    daemon.diagnosed("FIC1", Some(2.5));
    daemon.not_identifiable("FIC2");
    let both = alertmanager.until("both loops", 2).await;
    assert_eq!(both.keys().collect::<Vec<_>>(), ["FIC1", "FIC2"]);
    let inhibited = |alert: &&Value| !alert["status"]["inhibitedBy"].as_array().unwrap().is_empty();
    assert_eq!(alertmanager.active().await.iter().filter(inhibited).count(), 0);

    // An order on FIC1 stands, and FIC2 is expected to calm down with it.
    let [source, victim] = ["FIC1", "FIC2"].map(LoopId::new);
    let order = SourceOrder { source, state: "open", since: 0.0, by: None, note: None };
    daemon.app.results().swing([(victim, order)].into());
    let deadline = Instant::now() + PATIENCE;
    loop {
        let active = alertmanager.active().await;
        let of = |id: &str| {
            active
                .iter()
                .filter(|own| own["labels"]["loop"] == id && own["labels"]["swing"].is_string())
                .collect::<Vec<_>>()
        };
        if let ([source], [victim]) = (&of("FIC1")[..], &of("FIC2")[..])
            && inhibited(victim)
        {
            assert!(!inhibited(source), "{active:?}");
            assert_eq!(
                (&source["labels"]["swing"], &victim["labels"]["swings_with"]),
                (&"source".into(), &"FIC1".into())
            );
            break;
        }
        assert!(Instant::now() < deadline, "{active:?}");
        sleep(Duration::from_millis(50)).await;
    }
    daemon.stop().await;
}
