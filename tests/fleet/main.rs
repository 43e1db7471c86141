//! Edge, worker and centre as processes, with nats-servers of Debian between them: a hub and a leaf node.

#[path = "../peers/daemon.rs"]
mod daemon;
#[path = "../peers/nats.rs"]
mod nats;

use daemon::Daemon;
use nats::Nats;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use stictiond::demo::{DEFAULT_SPEED, Demo, Options, Screen};
use stictiond::store::Reader;

/// Time between two diagnoses of a loop (s).
const PERIOD_S: u64 = 10;
/// Far longer than anything takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(240);

fn stictiond() -> Command {
    Command::new(env!("CARGO_BIN_EXE_stictiond"))
}

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("writable");
    path
}

/// A fleet on loopback, and the files that its parts are started with.
struct Fleet {
    folder: PathBuf,
    hub: Nats,
    leaf: Nats,
}

impl Fleet {
    fn new(name: &str) -> Self {
        let hub = Nats::hub();
        let leaf = Nats::leaf(&hub);
        Self { folder: folder(name), hub, leaf }
    }

    fn config(&self, name: &str, text: &str) -> PathBuf {
        let path = self.folder.join(format!("{name}.toml"));
        std::fs::write(&path, text).expect("writable");
        path
    }

    /// The demo's plant, polled by an edge behind the leaf node.
    fn edge(&self, demo: &Demo) -> Daemon {
        let text = demo.config().replace(&demo.address().to_string(), "127.0.0.1:0");
        let period = text.find("period_s").expect("there");
        let line = period..period + text[period..].find('\n').expect("a line");
        let mut text = text.replacen(&text[line], &format!("period_s = {PERIOD_S}"), 1);
        let _ = write!(
            text,
            "\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n[alarm]\nk = 1\nn = 1\n\
             [fleet]\nsite = 'north'\nname = 'edge-1'\nservers = ['{}']\nforward_s = 0.5\nanswer_within_s = 20\n\
             cut_off_after_s = 4\n",
            self.store("edge").display().to_string(),
            self.leaf.url()
        );
        Daemon::start(stictiond(), "edge", &self.config("edge", &text))
    }

    fn worker(&self, name: &str) -> Daemon {
        let text = format!(
            "[server]\nlisten = '127.0.0.1:0'\n[schedule]\nparallelism = 2\n[fleet]\nname = '{name}'\nservers = ['{}']\n",
            self.hub.url()
        );
        Daemon::start(stictiond(), "worker", &self.config(name, &text))
    }

    fn centre(&self, name: &str) -> Daemon {
        let text = format!(
            "[server]\nlisten = '127.0.0.1:0'\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n\
             [fleet]\nname = '{name}'\nservers = ['{}']\ncut_off_after_s = 4\n",
            self.store(name).display().to_string(),
            self.hub.url()
        );
        Daemon::start(stictiond(), "centre", &self.config(name, &text))
    }

    fn store(&self, name: &str) -> PathBuf {
        self.folder.join(format!("store-{name}"))
    }
}

/// Loops by name, as the list has them.
fn loops(daemon: &Daemon) -> BTreeMap<String, Value> {
    let list = daemon.json("/api/v1/loops?limit=100&sort=id");
    let items = list["items"].as_array().expect("loops").iter();
    items.map(|item| (item["id"].as_str().expect("a name").to_string(), item.clone())).collect()
}

/// Reports of a store by loop and time.
fn reports(store: &Path) -> BTreeMap<(String, u64), Vec<u8>> {
    let reader = Reader::open(store).expect("can be read");
    let (mut all, mut after) = (BTreeMap::new(), 0);
    while let Some(rows) = Some(reader.diagnoses(after, 100).expect("reads")).filter(|rows| !rows.is_empty())
    {
        for (number, row) in rows {
            after = number;
            let name = row.control_loop.strip_prefix("north:").unwrap_or(&row.control_loop).to_string();
            let known = all.insert((name, row.finished.to_bits()), row.report.unwrap_or_default());
            assert!(known.is_none(), "nothing is there twice");
        }
    }
    all
}

/// What happened to alarms by a store: subject, kind, when, cause.
fn changes(store: &Path) -> Vec<(String, String, u64, String)> {
    let reader = Reader::open(store).expect("can be read");
    let rows = reader.transitions(0, 10_000).expect("reads").into_iter();
    let mut all: Vec<_> = rows
        .map(|(_, row)| {
            let subject = row.control_loop.strip_prefix("north:").unwrap_or(&row.control_loop).to_string();
            (subject, row.kind, row.at.to_bits(), row.cause)
        })
        .collect();
    all.sort();
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_edge_measures_and_finds_is_at_the_centre_once_whatever_is_cut_or_killed() {
    let options =
        Options { listen: ([127, 0, 0, 1], 0).into(), speed: DEFAULT_SPEED, seed: 1, writeback: false };
    let demo = Demo::build(&options).await.expect("builds");
    let stop = demo.stop();
    let mut fleet = Fleet::new("fleet");
    let (centre, edge) = (fleet.centre("c1"), fleet.edge(&demo));
    let worker = fleet.worker("w1");
    let plant = tokio::spawn(demo.run(Screen::new(Vec::new(), false)));
    let done = tokio::task::spawn_blocking(move || {
        let verdicts = |daemon: &Daemon, least: usize| {
            let loops = loops(daemon);
            loops.values().filter(|own| own["verdict"].is_string()).count() >= least
        };
        centre.until("the centre has every loop and its verdict", PATIENCE, |centre| verdicts(centre, 20));
        let raised = |centre: &Daemon| {
            loops(centre).into_iter().find(|(_, own)| own["alarm"] == "unacknowledged").map(|(id, _)| id)
        };
        centre.until("an alarm is raised", PATIENCE, |centre| raised(centre).is_some());

        // What people do at the centre is done at the edge, and shown.
        let id = raised(&centre).expect("one");
        let name = id.strip_prefix("north:").expect("of its site").to_string();
        let answer = centre.ask("POST", &format!("/api/v1/alarms/{id}/ack"), "{\"by\":\"eve\"}");
        assert!(answer.contains("acknowledged"), "{answer}");
        edge.until("the edge knows", PATIENCE, |edge| loops(edge)[&name]["alarm"] == "acknowledged");
        centre.until("the centre knows", PATIENCE, |centre| loops(centre)[&id]["alarm"] == "acknowledged");

        // The line to the hub is cut, the worker killed: the edge goes on by itself.
        let time = |daemon: &Daemon| loops(daemon).values().map(|own| own["time"].to_string()).max();
        let before = time(&edge);
        fleet.leaf.end();
        drop(worker);
        edge.until("the edge diagnoses by itself", PATIENCE, |edge| time(edge) > before);
        let alone = edge.json(&format!("/api/v1/loops/{name}"));
        edge.ask("POST", &format!("/api/v1/alarms/{name}/shelve"), "{\"by\":\"kim\",\"duration_s\":3600}");
        assert!(alone["id"] == name.as_str(), "{alone}");

        // It comes back: nothing is missing, nothing is there twice.
        fleet.leaf.begin();
        centre
            .until("what was done at the edge", PATIENCE, |centre| loops(centre)[&id]["alarm"] == "shelved");
        let latest = time(&edge);
        centre.until("the diagnoses of meanwhile", PATIENCE, |centre| time(centre) >= latest);
        edge.stop();
        let (at_edge, at_centre) = (reports(&fleet.store("edge")), reports(&fleet.store("c1")));
        let missing: Vec<_> = at_edge.keys().filter(|key| !at_centre.contains_key(key)).collect();
        // What an edge finds as it stops it forwards at its next start.
        assert!(missing.len() <= 20, "{missing:?}");
        assert!(at_centre.iter().all(|(key, report)| at_edge.get(key) == Some(report)), "bit for bit");
        assert!(at_centre.len() > 40, "{}", at_centre.len());
        let edge = changes(&fleet.store("edge"));
        let here = changes(&fleet.store("c1"));
        assert!(here.iter().all(|change| edge.contains(change)), "{here:?}");
        centre.stop();
        std::fs::remove_dir_all(&fleet.folder).expect("writable");
    });
    let done = done.await;
    stop.cancel();
    plant.await.expect("no panic").expect("ends well");
    done.expect("all is well");
}
