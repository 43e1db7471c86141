//! Edge, worker and centre as processes, with nats-servers of Debian between them: a hub and a leaf node.

#[path = "../peers/daemon.rs"]
mod daemon;
#[path = "../peers/nats.rs"]
mod nats;
#[path = "../peers/webhook.rs"]
mod webhook;

use daemon::{Daemon, folder, stictiond};
use nats::Nats;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;
use stictiond::demo::{DEFAULT_SPEED, Demo, Options, Screen};
use stictiond::store::Reader;

/// Time between two diagnoses of a loop (s).
const PERIOD_S: u64 = 10;
/// Far longer than anything takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

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
    fn edge(&self, demo: &Demo, told: SocketAddr) -> Daemon {
        let text = demo.config().replace(&demo.address().to_string(), "127.0.0.1:0");
        let period = text.find("period_s").expect("there");
        let line = period..period + text[period..].find('\n').expect("a line");
        let mut text = text.replacen(&text[line], &format!("period_s = {PERIOD_S}"), 1);
        let _ = write!(
            text,
            "\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n[alarm]\nk = 1\nn = 1\n\
             [fleet]\nsite = 'north'\nname = 'edge-1'\nservers = ['{}']\nforward_s = 0.5\nanswer_within_s = 20\n\
             cut_off_after_s = 4\n{}",
            self.store("edge").display().to_string(),
            self.leaf.url(),
            self.telling("edge", told)
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

    fn centre(&self, name: &str, told: SocketAddr) -> Daemon {
        let text = format!(
            "[server]\nlisten = '127.0.0.1:0'\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n\
             [fleet]\nname = '{name}'\nservers = ['{}']\ncut_off_after_s = 4\n{}",
            self.store(name).display().to_string(),
            self.hub.url(),
            self.telling(name, told)
        );
        Daemon::start(stictiond(), "centre", &self.config(name, &text))
    }

    /// Everybody tells the same receiver what is raised.
    fn telling(&self, name: &str, told: SocketAddr) -> String {
        let secret = self.config("secret", "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw");
        format!(
            "[notify]\nsite = '{name}'\n[[notify.webhook]]\nname = 'w'\nurl = 'http://{told}/'\nsecret_file = {secret:?}\nevents = ['raised']\n\
             pace = {{ wait_s = 0.0 }}\n"
        )
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
            let known = all
                .insert((at_site(&row.control_loop), row.finished.to_bits()), row.report.unwrap_or_default());
            assert!(known.is_none(), "nothing is there twice");
        }
    }
    all
}

/// What happened to alarms by a store: subject, kind, when, cause.
fn changes(store: &Path) -> Vec<(String, String, u64, String)> {
    let reader = Reader::open(store).expect("can be read");
    let rows = reader.transitions(0, 10_000).expect("reads").into_iter();
    let mut all: Vec<_> =
        rows.map(|(_, row)| (at_site(&row.control_loop), row.kind, row.at.to_bits(), row.cause)).collect();
    all.sort();
    all
}

/// The name of a loop or collector at its site.
fn at_site(name: &str) -> String {
    name.strip_prefix("north:").unwrap_or(name).to_string()
}

/// Of each tag of a store, its samples: stamps and values as bits.
fn samples(store: &Path) -> BTreeMap<(String, String), Vec<(u64, u64)>> {
    let mut reader = Reader::open(store).expect("can be read");
    let names: Vec<_> = reader.tags().expect("reads").into_iter().map(|tag| tag.name).collect();
    let mut all = BTreeMap::new();
    for name in names {
        let found = reader.between(&name.control_loop, &name.tag, 0.0, 1e11).expect("reads");
        let bits = found.iter().map(|sample| (sample.t.to_bits(), sample.value.to_bits())).collect();
        all.insert((at_site(&name.control_loop), name.tag.clone()), bits);
    }
    all
}

/// A centre's store has what the edge's has, but for the end: once, to the last bit.
fn compare(edge: &Path, centre: &Path) {
    let (here, there) = (reports(edge), reports(centre));
    assert!(there.iter().all(|(key, report)| here.get(key) == Some(report)), "bit for bit");
    // What an edge finds as it stops it forwards at its next start; what every centre had before this one was there is gone
    // from the streams.
    let first = there.keys().map(|(_, finished)| *finished).min().expect("there are some");
    let missing: Vec<_> = here.keys().filter(|key| key.1 >= first && !there.contains_key(key)).collect();
    assert!(there.len() >= 20 && missing.len() <= 20, "{} and without {missing:?}", there.len());
    let (own, known) = (changes(edge), changes(centre));
    assert!(!known.is_empty() && known.iter().all(|change| own.contains(change)), "{known:?}");
    let mut once = known.clone();
    once.dedup();
    assert_eq!(once, known);
    let (own, known) = (samples(edge), samples(centre));
    assert_eq!(own.len(), known.len());
    for (tag, some) in &known {
        let all = &own[tag];
        assert!(some.len() > 200 && some.len() <= all.len(), "{tag:?}: {} of {}", some.len(), all.len());
        assert_eq!(all[..some.len()], some[..], "{tag:?}: none is missing, none is twice");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_edge_measures_and_finds_is_at_the_centre_once_whatever_is_cut_or_killed() {
    let options =
        Options { listen: ([127, 0, 0, 1], 0).into(), speed: DEFAULT_SPEED, seed: 1, writeback: false };
    let demo = Demo::build(&options).await.expect("builds");
    let stop = demo.stop();
    let mut fleet = Fleet::new("fleet");
    let (receiver, told) = webhook::receiver();
    let first = fleet.centre("c1", receiver);
    let (edge, worker) = (fleet.edge(&demo, receiver), fleet.worker("w1"));
    let plant = tokio::spawn(demo.run(Screen::new(Vec::new(), false)));
    let done = tokio::task::spawn_blocking(move || {
        let verdicts =
            |daemon: &Daemon| loops(daemon).values().filter(|own| own["verdict"].is_string()).count();
        first.until("the centre has every loop and its verdict", PATIENCE, |first| verdicts(first) >= 20);
        let raised = |daemon: &Daemon| {
            loops(daemon).into_iter().find(|(_, own)| own["alarm"] == "unacknowledged").map(|(id, _)| id)
        };
        first.until("an alarm is raised", PATIENCE, |first| raised(first).is_some());

        // What people do at the centre is done at the edge, and shown.
        let id = raised(&first).expect("one");
        let name = at_site(&id);
        let is = |daemon: &Daemon, id: &str, state: &str| loops(daemon)[id]["alarm"] == state;
        first.ask("POST", &format!("/api/v1/alarms/{id}/ack"), "{\"by\":\"eve\"}");
        edge.until("the edge knows", PATIENCE, |edge| is(edge, &name, "acknowledged"));
        first.until("the centre knows", PATIENCE, |first| is(first, &id, "acknowledged"));

        // A second centre takes over; before that it gives no orders.
        let second = fleet.centre("c2", receiver);
        second.until("the second centre knows", PATIENCE, |second| {
            loops(second).get(&id).is_some_and(|own| own["alarm"] == "acknowledged")
        });
        let refused =
            second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), "{\"by\":\"kim\",\"duration_s\":60}");
        assert!(refused.contains("another centre"), "{refused}");
        // SIGKILL.
        drop(first);
        let order = |duration: u32| format!("{{\"by\":\"kim\",\"duration_s\":{duration}}}");
        // Once: an order that is given again would be carried out again, whatever was done at the edge meanwhile.
        second.until("the second centre acts", PATIENCE, |second| {
            let answer = second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(3600));
            !answer.contains("another centre")
        });
        second.until("what it did", PATIENCE, |second| is(second, &id, "shelved"));

        // The line to the hub is cut, the worker killed: the edge goes on by itself.
        let time = |daemon: &Daemon| loops(daemon).values().map(|own| own["time"].to_string()).max();
        let before = time(&edge);
        fleet.leaf.end();
        drop(worker);
        edge.until("the edge diagnoses by itself", PATIENCE, |edge| time(edge) > before);
        edge.ask("POST", &format!("/api/v1/alarms/{name}/unshelve"), "{\"by\":\"kim\"}");
        // The centre does not know of it, and what it orders now is refused there.
        let taken = second.ask("POST", &format!("/api/v1/alarms/{id}/out-of-service"), "{\"by\":\"kim\"}");
        assert!(!taken.contains("error"), "the order is given: {taken}");

        // It comes back: nothing is missing, nothing is there twice.
        fleet.leaf.begin();
        second.until("what was done at the edge", PATIENCE, |second| !is(second, &id, "shelved"));
        let latest = time(&edge);
        second.until("the diagnoses of meanwhile", PATIENCE, |second| time(second) >= latest);
        // Orders are heard one after the other: once this one is done the one before it was refused.
        second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(3600));
        edge.until("the next order is done", PATIENCE, |edge| is(edge, &name, "shelved"));

        // The hub and the edge are restarted with what is on their disks; what was found meanwhile is forwarded.
        fleet.hub.end();
        let before = time(&edge);
        edge.stop();
        let edge = Daemon::start(stictiond(), "edge", &fleet.folder.join("edge.toml"));
        edge.until("the edge goes on", PATIENCE, |edge| time(edge) > before);
        fleet.hub.begin();
        let latest = time(&edge);
        second.until("the diagnoses of both lives", PATIENCE, |second| time(second) >= latest);
        let value = |daemon: &Daemon, id: &str| {
            daemon.json(&format!("/api/v1/loops/{id}"))["values"][0]["time"].to_string()
        };
        let newest = value(&edge, &name);
        second.until("the samples of meanwhile", PATIENCE, |second| value(second, &id) >= newest);
        edge.stop();
        second.stop();
        compare(&fleet.store("edge"), &fleet.store("c2"));

        // Each alarm was told once, by whichever machine.
        let mut told: Vec<String> = told.try_iter().flat_map(|body| notices(&body)).collect();
        told.sort();
        let mut once = told.clone();
        once.dedup();
        assert_eq!(told, once);
        let raised = changes(&fleet.store("edge")).into_iter().filter(|change| change.3 == "raised").count();
        assert!(told.len() + 3 >= raised && !told.is_empty(), "{} of {raised}: {told:?}", told.len());
        std::fs::remove_dir_all(&fleet.folder).expect("writable");
    });
    let done = done.await;
    stop.cancel();
    plant.await.expect("no panic").expect("ends well");
    done.expect("all is well");
}

/// The alarms of a webhook's body, each with the time of the change: the end of a shelving raises an alarm too.
fn notices(body: &str) -> Vec<String> {
    let message: Value = serde_json::from_str(body).expect("JSON");
    let alarms = message["data"]["alarms"].as_array().expect("alarms").iter();
    alarms.map(|own| format!("{} {}", at_site(own["id"].as_str().expect("a name")), own["time"])).collect()
}
