//! Edges, workers and centres as processes, with nats-servers of Debian between them: a hub, and a leaf node for each site.
//!
//! One site of 20 loops, or what `FLEET_SITES` (up to 3) and `FLEET_COPIES` (each loop so often) say: `scripts/fleet prove`
//! runs three sites of 100 loops.

#[path = "../peers/daemon.rs"]
mod daemon;
#[path = "../peers/nats.rs"]
#[expect(dead_code, reason = "each user takes a part")]
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

/// Time between two diagnoses of a loop, where there are 20 (s).
const PERIOD_S: usize = 10;
/// Far longer than anything takes even on a busy machine, where there are 20 loops.
const PATIENCE: Duration = Duration::from_secs(120);
/// The sites.
const SITES: [&str; 3] = ["north", "east", "south"];
/// Loops of a plant.
const LOOPS: usize = 20;

/// A fleet on loopback, and the files that its parts are started with.
struct Fleet {
    folder: PathBuf,
    hub: Nats,
    /// One for each site.
    leaves: Vec<Nats>,
    /// How often each loop of a plant is there.
    copies: usize,
}

impl Fleet {
    fn new(name: &str) -> Self {
        let told = |name: &str| std::env::var(name).ok().and_then(|own| own.parse::<usize>().ok());
        let sites = told("FLEET_SITES").unwrap_or(1).clamp(1, SITES.len());
        let hub = Nats::hub();
        let leaves = (0..sites).map(|_| Nats::leaf(&hub)).collect();
        Self { folder: folder(name), hub, leaves, copies: told("FLEET_COPIES").unwrap_or(1).max(1) }
    }

    fn sites(&self) -> &'static [&'static str] {
        &SITES[..self.leaves.len()]
    }

    /// How many plants of 20 loops there are.
    fn plants(&self) -> usize {
        self.sites().len() * self.copies
    }

    fn patience(&self) -> Duration {
        PATIENCE * u32::try_from(self.plants().min(10)).expect("few")
    }

    fn config(&self, name: &str, text: &str) -> PathBuf {
        let path = self.folder.join(format!("{name}.toml"));
        std::fs::write(&path, text).expect("writable");
        path
    }

    /// The demo's plant, polled by an edge behind the leaf node of its site.
    fn edge(&self, site: &str, demo: &Demo, told: SocketAddr) -> Daemon {
        let text = demo.config().replace(&demo.address().to_string(), "127.0.0.1:0");
        let period = text.find("period_s").expect("there");
        let line = period..period + text[period..].find('\n').expect("a line");
        let text = text.replacen(&text[line], &format!("period_s = {}", PERIOD_S * self.plants()), 1);
        let mut text = copied(&text, self.copies);
        let at = SITES.iter().position(|own| *own == site).expect("a site");
        let name = format!("edge-{site}");
        let _ = write!(
            text,
            "\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n[alarm]\nk = 1\nn = 1\n\
             [fleet]\nsite = '{site}'\nname = '{name}'\nservers = ['{}']\nforward_s = 0.5\nanswer_within_s = 20\n\
             cut_off_after_s = 4\n{}",
            self.store(&name).display().to_string(),
            self.leaves[at].url(),
            self.telling(&name, told)
        );
        Daemon::start(stictiond(), "edge", &self.config(&name, &text))
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

/// A configuration with each of its loops so often, the copies with a number behind their names.
fn copied(text: &str, copies: usize) -> String {
    let parts: Vec<&str> = text.split("[[loop]]").collect();
    let (head, loops) = parts.split_first().expect("there is a text");
    let mut out = (*head).to_string();
    for copy in 1..=copies {
        for own in loops {
            let line = own.lines().find(|line| line.starts_with("id")).expect("a name");
            let end = line.rfind('"').expect("quoted");
            let named = if copy == 1 { line.to_string() } else { format!("{}-{copy}\"", &line[..end]) };
            let _ = writeln!(out, "[[loop]]{}", own.replacen(line, &named, 1).trim_end());
        }
    }
    out
}

/// Loops by name, as the list has them.
fn loops(daemon: &Daemon) -> BTreeMap<String, Value> {
    let list = daemon.json("/api/v1/loops?limit=500&sort=id");
    let items = list["items"].as_array().expect("loops").iter();
    items.map(|item| (item["id"].as_str().expect("a name").to_string(), item.clone())).collect()
}

/// Reports of a store by loop and time, those of one site.
fn reports(store: &Path, site: &str) -> BTreeMap<(String, u64), Vec<u8>> {
    let reader = Reader::open(store).expect("can be read");
    let (mut all, mut after) = (BTreeMap::new(), 0);
    while let Some(rows) = Some(reader.diagnoses(after, 100).expect("reads")).filter(|rows| !rows.is_empty())
    {
        for (number, row) in rows {
            after = number;
            let Some(name) = of_site(&row.control_loop, site) else { continue };
            let known = all.insert((name, row.finished.to_bits()), row.report.unwrap_or_default());
            assert!(known.is_none(), "nothing is there twice");
        }
    }
    all
}

/// What happened to alarms of a site by a store: subject, kind, when, cause.
fn changes(store: &Path, site: &str) -> Vec<(String, String, u64, String)> {
    let reader = Reader::open(store).expect("can be read");
    let rows = reader.transitions(0, 100_000).expect("reads").into_iter();
    let own = rows.filter_map(|(_, row)| {
        Some((of_site(&row.control_loop, site)?, row.kind, row.at.to_bits(), row.cause))
    });
    let mut all: Vec<_> = own.collect();
    all.sort();
    all
}

/// The name of a loop or collector at its site; `None` for one of another site. At the site itself no name has it.
fn of_site(name: &str, site: &str) -> Option<String> {
    match name.split_once(':') {
        Some((own, name)) => (own == site).then(|| name.to_string()),
        None => Some(name.to_string()),
    }
}

/// The name of a loop or collector at its site.
fn at_site(name: &str) -> String {
    name.split_once(':').map_or(name, |(_, name)| name).to_string()
}

/// Of each tag of a site in a store, its samples: stamps and values as bits.
fn samples(store: &Path, site: &str) -> BTreeMap<(String, String), Vec<(u64, u64)>> {
    let mut reader = Reader::open(store).expect("can be read");
    let names: Vec<_> = reader.tags().expect("reads").into_iter().map(|tag| tag.name).collect();
    let mut all = BTreeMap::new();
    for name in names {
        let Some(own) = of_site(&name.control_loop, site) else { continue };
        let found = reader.between(&name.control_loop, &name.tag, 0.0, 1e11).expect("reads");
        let bits = found.iter().map(|sample| (sample.t.to_bits(), sample.value.to_bits())).collect();
        all.insert((own, name.tag.clone()), bits);
    }
    all
}

/// A centre's store has what a site's edge has, but for the end: once, to the last bit.
fn compare(edge: &Path, centre: &Path, site: &str, loops: usize) {
    let (here, there) = (reports(edge, site), reports(centre, site));
    assert!(there.iter().all(|(key, report)| here.get(key) == Some(report)), "bit for bit");
    // What an edge finds as it stops it forwards at its next start; what every centre had before this one was there is gone
    // from the streams.
    let first = there.keys().map(|(_, finished)| *finished).min().expect("there are some");
    let missing: Vec<_> = here.keys().filter(|key| key.1 >= first && !there.contains_key(key)).collect();
    assert!(there.len() >= loops && missing.len() <= 20, "{} and without {missing:?}", there.len());
    let (own, known) = (changes(edge, site), changes(centre, site));
    assert!(!known.is_empty() && known.iter().all(|change| own.contains(change)), "{known:?}");
    let mut once = known.clone();
    once.dedup();
    assert_eq!(once, known);
    let (own, known_samples) = (samples(edge, site), samples(centre, site));
    assert_eq!(own.len(), known_samples.len());
    for (tag, some) in &known_samples {
        let all = &own[tag];
        assert!(some.len() > 200 && some.len() <= all.len(), "{tag:?}: {} of {}", some.len(), all.len());
        assert_eq!(all[..some.len()], some[..], "{tag:?}: none is missing, none is twice");
    }
    let count = |of: &BTreeMap<_, Vec<_>>| of.values().map(Vec::len).sum::<usize>();
    let bytes = there.values().map(Vec::len).sum::<usize>() / there.len();
    println!(
        "{site}: reports of {bytes} bytes; {} of {} diagnoses, {} of {} changes of alarms, {} of {} samples at the centre, the rest of its last seconds",
        there.len(),
        here.len(),
        once.len(),
        changes(edge, site).len(),
        count(&known_samples),
        count(&own)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_edge_measures_and_finds_is_at_the_centre_once_whatever_is_cut_or_killed() {
    let options =
        Options { listen: ([127, 0, 0, 1], 0).into(), speed: DEFAULT_SPEED, seed: 1, writeback: false };
    let mut fleet = Fleet::new("fleet");
    let (receiver, told) = webhook::receiver();
    let first = fleet.centre("c1", receiver);
    let (mut edges, mut plants, mut stops) = (Vec::new(), Vec::new(), Vec::new());
    for (site, seed) in fleet.sites().iter().zip(1..) {
        let demo = Demo::build(&Options { seed, ..options }).await.expect("builds");
        stops.push(demo.stop());
        edges.push(fleet.edge(site, &demo, receiver));
        plants.push(tokio::spawn(demo.run(Screen::new(Vec::new(), false))));
    }
    let (worker, other) = (fleet.worker("w1"), (fleet.plants() > 1).then(|| fleet.worker("w2")));
    let done = tokio::task::spawn_blocking(move || {
        let edge = edges.remove(0);
        let (patience, all) = (fleet.patience(), LOOPS * fleet.plants());
        let verdicts =
            |daemon: &Daemon| loops(daemon).values().filter(|own| own["verdict"].is_string()).count();
        first.until("the centre has every loop and its verdict", patience, |first| verdicts(first) >= all);
        let raised = |daemon: &Daemon| {
            let north =
                |(id, own): &(String, Value)| id.starts_with("north:") && own["alarm"] == "unacknowledged";
            loops(daemon).into_iter().find(north).map(|(id, _)| id)
        };
        first.until("an alarm is raised", patience, |first| raised(first).is_some());

        // What people do at the centre is done at the edge, and shown.
        let id = raised(&first).expect("one");
        let name = at_site(&id);
        let is = |daemon: &Daemon, id: &str, state: &str| loops(daemon)[id]["alarm"] == state;
        first.ask("POST", &format!("/api/v1/alarms/{id}/ack"), "{\"by\":\"eve\"}");
        edge.until("the edge knows", patience, |edge| is(edge, &name, "acknowledged"));
        first.until("the centre knows", patience, |first| is(first, &id, "acknowledged"));

        // A second centre takes over; before that it gives no orders.
        let second = fleet.centre("c2", receiver);
        second.until("the second centre knows", patience, |second| {
            loops(second).get(&id).is_some_and(|own| own["alarm"] == "acknowledged")
        });
        let refused =
            second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), "{\"by\":\"kim\",\"duration_s\":60}");
        assert!(refused.contains("another centre"), "{refused}");
        let times = |daemon: &Daemon| -> BTreeMap<String, String> {
            loops(daemon).into_iter().map(|(id, own)| (id, own["time"].to_string())).collect()
        };
        let began = times(&second);
        // SIGKILL.
        drop(first);
        let order = |duration: u32| format!("{{\"by\":\"kim\",\"duration_s\":{duration}}}");
        // Once: an order that is given again would be carried out again, whatever was done at the edge meanwhile.
        second.until("the second centre acts", patience, |second| {
            let answer = second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(3600));
            !answer.contains("another centre")
        });
        second.until("what it did", patience, |second| is(second, &id, "shelved"));

        // The line to the hub is cut, the worker killed: the edge goes on by itself.
        let time = |daemon: &Daemon| loops(daemon).values().map(|own| own["time"].to_string()).max();
        let before = time(&edge);
        fleet.leaves[0].end();
        drop(worker);
        edge.until("the edge diagnoses by itself", patience, |edge| time(edge) > before);
        edge.ask("POST", &format!("/api/v1/alarms/{name}/unshelve"), "{\"by\":\"kim\"}");
        // The centre does not know of it, and what it orders now is refused there.
        let taken = second.ask("POST", &format!("/api/v1/alarms/{id}/out-of-service"), "{\"by\":\"kim\"}");
        assert!(!taken.contains("error"), "the order is given: {taken}");

        // It comes back: nothing is missing, nothing is there twice.
        fleet.leaves[0].begin();
        second.until("what was done at the edge", patience, |second| !is(second, &id, "shelved"));
        let latest = time(&edge);
        second.until("the diagnoses of meanwhile", patience, |second| time(second) >= latest);
        // Orders are heard one after the other: once this one is done the one before it was refused.
        second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(3600));
        edge.until("the next order is done", patience, |edge| is(edge, &name, "shelved"));

        // The hub and the edge are restarted with what is on their disks; what was found meanwhile is forwarded.
        fleet.hub.end();
        let before = time(&edge);
        edge.stop();
        let edge = Daemon::start(stictiond(), "edge", &fleet.folder.join("edge-north.toml"));
        edge.until("the edge goes on", patience, |edge| time(edge) > before);
        fleet.hub.begin();
        let latest = time(&edge);
        second.until("the diagnoses of both lives", patience, |second| time(second) >= latest);
        let value = |daemon: &Daemon, id: &str| {
            daemon.json(&format!("/api/v1/loops/{id}"))["values"][0]["time"].to_string()
        };
        let newest = value(&edge, &name);
        second.until("the samples of meanwhile", patience, |second| value(second, &id) >= newest);
        second.until("every loop is diagnosed again", patience, |second| {
            times(second).iter().all(|(id, time)| began.get(id) != Some(time))
        });
        edge.stop();
        edges.into_iter().for_each(Daemon::stop);
        second.stop();
        drop(other);
        let store = |site: &str| fleet.store(&format!("edge-{site}"));
        for site in fleet.sites() {
            compare(&store(site), &fleet.store("c2"), site, LOOPS * fleet.copies);
        }

        // Each alarm was told once, by whichever machine.
        let mut told: Vec<String> = told.try_iter().flat_map(|body| notices(&body)).collect();
        told.sort();
        let mut once = told.clone();
        once.dedup();
        assert_eq!(told, once);
        let changes = fleet.sites().iter().flat_map(|site| changes(&store(site), site));
        let raised = changes.filter(|change| change.3 == "raised").count();
        assert!(
            told.len() + 3 * fleet.plants() >= raised && !told.is_empty(),
            "{} of {raised}: {told:?}",
            told.len()
        );
        println!("{all} loops: {} letters of {raised} alarms, none twice", told.len());
        std::fs::remove_dir_all(&fleet.folder).expect("writable");
    });
    let done = done.await;
    for (stop, plant) in stops.into_iter().zip(plants) {
        stop.cancel();
        plant.await.expect("no panic").expect("ends well");
    }
    done.expect("all is well");
}

/// The alarms of a webhook's body, each with the time of the change: the end of a shelving raises an alarm too.
fn notices(body: &str) -> Vec<String> {
    let message: Value = serde_json::from_str(body).expect("JSON");
    let alarms = message["data"]["alarms"].as_array().expect("alarms").iter();
    alarms.map(|own| format!("{} {}", at_site(own["id"].as_str().expect("a name")), own["time"])).collect()
}
