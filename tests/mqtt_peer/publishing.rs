//! What the daemon tells a broker: the latest of each loop, retained, whatever happened to the broker meanwhile.

use super::rig::{Broker, Peer, line};
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::Duration;
use stictiond::notify::mqtt::{Config, Counters, LoopName, Publisher, run};
use stictiond::results::{Outcome, Results, Run, Trigger};
use stictiond::signal::LoopId;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// 2023-11-14T22:13:20Z.
const START: f64 = 1_700_000_000.0;

pub struct Daemon {
    results: Arc<Results>,
    pub counters: Arc<Counters>,
    stop: CancellationToken,
    task: JoinHandle<()>,
}

impl Daemon {
    pub fn start(port: u16, more: &str) -> Self {
        let text = format!("address = '127.0.0.1:{port}'\nreconnect_max_ms = 300\n{more}");
        let config: Config = toml::from_str(&text).unwrap();
        assert_eq!(config.validate(), []);
        let ids = ["FIC101", "a/b"].map(LoopId::new);
        let results = Arc::new(Results::new(&ids, 10, &Default::default()));
        let names = ids.map(|id| LoopName { id, group: "unit 10".into() }).to_vec();
        let publisher =
            Publisher::new(config, results.clone(), Arc::new(move || names.clone()), Arc::new(|| START));
        let (counters, stop) = (publisher.counters(), CancellationToken::new());
        let own = stop.clone();
        let task = tokio::spawn(async move { run(&publisher, own).await });
        Self { results, counters, stop, task }
    }

    /// A run that ended so many seconds after the start, with a panic that says `what`.
    fn run(&self, after_s: f64, what: &str) {
        self.results.record(Run {
            id: LoopId::new("FIC101"),
            started: START,
            finished: START + after_s,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            op_span: None,
            basis: None,
            outcome: if what.is_empty() { Outcome::DeadlineExceeded } else { Outcome::Panicked(what.into()) },
        });
    }

    pub async fn until_published(&self, count: u64) {
        let deadline = tokio::time::Instant::now() + Duration::from_secs(30);
        while self.counters.published.load(SeqCst) < count {
            assert!(tokio::time::Instant::now() < deadline, "never published {count}");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// Why there is no connection, once there is none.
    pub async fn until_lost(&self) -> String {
        let deadline = tokio::time::Instant::now() + Duration::from_secs(30);
        loop {
            if let Some((why, since)) = self.counters.lost() {
                assert_eq!(since, START);
                return why;
            }
            assert!(tokio::time::Instant::now() < deadline, "never lost");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    pub async fn end(self) {
        self.stop.cancel();
        tokio::time::timeout(Duration::from_secs(30), self.task).await.expect("does not stop").unwrap();
    }
}

#[tokio::test]
async fn the_latest_is_retained_and_comes_again_after_the_broker_was_away() {
    let mut broker = Broker::start("publish").await;
    let daemon = Daemon::start(broker.port, "");
    daemon.until_published(2).await;
    daemon.run(1.0, "");
    daemon.until_published(3).await;
    assert_eq!(daemon.counters.taken_at(), Some(START));
    // Whoever comes later is told what is kept.
    let mut lines = broker.listen("stictiond/#").await;
    let told = line(&mut lines, "diagnosis", |line| line.contains("/diagnosis ")).await;
    let (head, json) = told.split_once(" {").unwrap();
    assert_eq!(head, "1 stictiond/unit 10/FIC101/diagnosis");
    let json: serde_json::Value = serde_json::from_str(&format!("{{{json}")).unwrap();
    assert_eq!((&json["loop"], &json["outcome"]), (&"FIC101".into(), &"deadline_exceeded".into()));
    assert_eq!((&json["time"], &json["group"]), (&"2023-11-14T22:13:21Z".into(), &"unit 10".into()));

    broker.kill().await;
    // While nobody listens, three runs: only the last matters.
    for k in 2..5 {
        daemon.run(f64::from(k), "x");
    }
    let broker = Broker::with("publish", broker.port, "allow_anonymous true").await;
    let mut lines = broker.listen("stictiond/#").await;
    let told = line(&mut lines, "diagnosis", |line| line.contains("/diagnosis ")).await;
    assert!(told.contains("\"panicked\"") && told.contains("22:13:24Z"), "{told}");
    line(&mut lines, "alarm", |line| line.contains("stictiond/unit 10/a_b/alarm {")).await;

    let mut lines = broker.listen("stictiond/status").await;
    line(&mut lines, "online", |line| line.contains("\"online\"")).await;
    daemon.end().await;
    line(&mut lines, "offline", |line| line.starts_with("0 ") && line.contains("\"offline\"")).await;
}

#[tokio::test]
async fn the_broker_says_offline_for_a_daemon_that_is_gone_without_a_word() {
    let broker = Broker::start("will").await;
    let daemon = Daemon::start(broker.port, "");
    daemon.until_published(2).await;
    let mut lines = broker.listen("stictiond/status").await;
    line(&mut lines, "online", |line| {
        line == "1 stictiond/status {\"status\":\"online\",\"version\":\"0.1.0\"}"
    })
    .await;
    daemon.task.abort();
    line(&mut lines, "offline", |line| line.contains("\"offline\"")).await;
    let mut later = broker.listen("stictiond/status").await;
    line(&mut later, "retained", |line| line.starts_with("1 ") && line.contains("\"offline\"")).await;
}

#[tokio::test]
async fn as_an_edge_node_it_is_read_by_a_decoder_that_is_not_ours() {
    let broker = Broker::start("edge").await;
    let mut reader = Peer::start(&broker, "read").await;
    let daemon = Daemon::start(broker.port, "[sparkplug]\ngroup = 'plant'\nedge = 'stictiond'");
    let birth = reader.read("spBv1.0/plant/NBIRTH/stictiond ").await;
    assert_eq!(birth["seq"], 0);
    let device = reader.read("spBv1.0/plant/DBIRTH/stictiond/FIC101 ").await;
    assert_eq!((&device["seq"], &device["Friction/f"]), (&1.into(), &serde_json::Value::Null));
    assert_eq!(device["Alarm/active"], false);
    reader.read("spBv1.0/plant/DBIRTH/stictiond/a_b ").await;
    daemon.run(1.0, "");
    let data = reader.read("spBv1.0/plant/DDATA/stictiond/FIC101 ").await;
    assert_eq!((&data["Outcome"], &data["seq"]), (&"deadline_exceeded".into(), &3.into()));
    reader.order("rebirth plant/stictiond").await;
    assert_eq!(reader.read("spBv1.0/plant/NBIRTH/stictiond ").await["bdSeq"], birth["bdSeq"]);
    let device = reader.read("spBv1.0/plant/DBIRTH/stictiond/FIC101 ").await;
    assert_eq!(device["Outcome"], "deadline_exceeded");
    daemon.task.abort();
    let death = reader.read("spBv1.0/plant/NDEATH/stictiond ").await;
    assert_eq!(death["bdSeq"], birth["bdSeq"]);
}
