//! A fleet on loopback.

use crate::daemon::{Daemon, folder, stictiond};
use crate::nats::Nats;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::{Debug, Write as _};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use stictiond::demo::Demo;
use stictiond::fleet::config::Config;
use stictiond::fleet::link::Link;
use stictiond::serve::dto::parse_time;

/// Time between two diagnoses of a loop, where there are 20 and nothing else is said (s).
const PERIOD_S: usize = 10;
/// Far longer than anything takes even on a busy machine, where there are 20 loops.
pub const PATIENCE: Duration = Duration::from_secs(120);
/// The sites.
pub const SITES: [&str; 3] = ["north", "east", "south"];
/// Loops of a plant.
pub const LOOPS: usize = 20;

/// A fleet on loopback, and the files that its parts are started with.
pub struct Fleet {
    pub folder: PathBuf,
    pub hub: Nats,
    /// One for each site.
    pub leaves: Vec<Nats>,
    /// How often each loop of a plant is there.
    pub copies: usize,
    /// Time between two diagnoses of a loop, for each plant that there is (s).
    pub period_s: usize,
    /// `cut_off_after_s` of edges and centres, where it is not the default.
    pub cut_off_after_s: Option<f64>,
}

impl Fleet {
    /// Of the size that the environment says.
    pub fn new(name: &str) -> Self {
        let told = |name: &str| std::env::var(name).ok().and_then(|own| own.parse::<usize>().ok());
        Self::sized(name, told("FLEET_SITES").unwrap_or(1), told("FLEET_COPIES").unwrap_or(1))
    }

    pub fn sized(name: &str, sites: usize, copies: usize) -> Self {
        let sites = sites.clamp(1, SITES.len());
        let hub = Nats::hub();
        let leaves = (0..sites).map(|_| Nats::leaf(&hub)).collect();
        let (folder, copies) = (folder(name), copies.max(1));
        Self { folder, hub, leaves, copies, period_s: PERIOD_S, cut_off_after_s: None }
    }

    pub fn sites(&self) -> &'static [&'static str] {
        &SITES[..self.leaves.len()]
    }

    /// How many plants of 20 loops there are.
    pub fn plants(&self) -> usize {
        self.sites().len() * self.copies
    }

    pub fn patience(&self) -> Duration {
        PATIENCE * u32::try_from(self.plants().min(10)).expect("few")
    }

    pub fn config(&self, name: &str, text: &str) -> PathBuf {
        let path = self.folder.join(format!("{name}.toml"));
        std::fs::write(&path, text).expect("writable");
        path
    }

    /// Keys of `[fleet]` that are not the default.
    fn cut_off(&self) -> String {
        self.cut_off_after_s.map(|s| format!("cut_off_after_s = {s:?}\n")).unwrap_or_default()
    }

    /// The demo's plant, polled by an edge behind the leaf node of its site.
    pub fn edge(&self, site: &str, demo: &Demo, told: SocketAddr) -> Daemon {
        let text = demo.config().replace(&demo.address().to_string(), "127.0.0.1:0");
        let period = text.find("period_s").expect("there");
        let line = period..period + text[period..].find('\n').expect("a line");
        let text = text.replacen(&text[line], &format!("period_s = {}", self.period_s * self.plants()), 1);
        let mut text = copied(&text, self.copies);
        if let Some(audit) = demo.audit() {
            // The demo writes its own.
            let own = self.folder.join(format!("audit-{site}"));
            text = text.replace(&audit.display().to_string(), &own.display().to_string());
        }
        let at = SITES.iter().position(|own| *own == site).expect("a site");
        let name = format!("edge-{site}");
        // An answer is waited for until a window that a killed worker held was given to another, which is 15 s later.
        let _ = write!(
            text,
            "\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n[alarm]\nk = 1\nn = 1\nflood_raises = 100000\n\
             [fleet]\nsite = '{site}'\nname = '{name}'\nservers = ['{}']\nforward_s = 0.5\nanswer_within_s = 30\n{}{}",
            self.store(&name).display().to_string(),
            self.leaves[at].url(),
            self.cut_off(),
            self.telling(&name, told)
        );
        Daemon::start(stictiond(), "edge", &self.config(&name, &text))
    }

    pub fn worker(&self, name: &str) -> Daemon {
        self.worker_of(name, 2)
    }

    /// A worker that takes so many windows at once.
    pub fn worker_of(&self, name: &str, slots: usize) -> Daemon {
        let text = format!(
            "[server]\nlisten = '127.0.0.1:0'\n[schedule]\nparallelism = {slots}\n[fleet]\nname = '{name}'\nservers = ['{}']\n",
            self.hub.url()
        );
        Daemon::start(stictiond(), "worker", &self.config(name, &text))
    }

    pub fn centre(&self, name: &str, told: SocketAddr) -> Daemon {
        let text = format!(
            "[server]\nlisten = '127.0.0.1:0'\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n[alarm]\nflood_raises = 100000\n\
             [fleet]\nname = '{name}'\nservers = ['{}']\n{}{}",
            self.store(name).display().to_string(),
            self.hub.url(),
            self.cut_off(),
            self.telling(name, told)
        );
        Daemon::start(stictiond(), "centre", &self.config(name, &text))
    }

    /// Everybody tells the same receiver what is raised, each alarm by itself and at once, however many there are.
    pub fn telling(&self, name: &str, told: SocketAddr) -> String {
        let secret = self.config("secret", "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw");
        format!(
            "[notify]\nsite = '{name}'\n[[notify.webhook]]\nname = 'w'\nurl = 'http://{told}/'\nsecret_file = {secret:?}\nevents = ['raised']\n\
             pace = {{ wait_s = 0.0, interval_s = 0.0, most_per_hour = 3600 }}\n"
        )
    }

    /// A part of the fleet again, with the disk that it had.
    pub fn again(&self, role: &str, name: &str) -> Daemon {
        Daemon::start(stictiond(), role, &self.folder.join(format!("{name}.toml")))
    }

    pub fn store(&self, name: &str) -> PathBuf {
        self.folder.join(format!("store-{name}"))
    }

    /// The store of the edge of a site.
    pub fn store_at(&self, site: &str) -> PathBuf {
        self.store(&format!("edge-{site}"))
    }
}

/// A configuration with each of its loops so often, the copies with a number behind their names.
pub fn copied(text: &str, copies: usize) -> String {
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

/// A link to a hub whose streams are there, with more keys of `[fleet]`.
pub async fn connected(hub: &Nats, more: &str) -> Link {
    let config: Config = toml::from_str(&format!("servers = [{:?}]\n{more}", hub.url())).expect("readable");
    let link = Link::connect(&config, "test").await.expect("begins");
    let begun = Instant::now();
    while let Err(error) = link.make_streams(&config).await {
        assert!(begun.elapsed() < PATIENCE, "{error}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    link
}

/// Waits until nothing is left; says what is, where that takes too long.
pub fn until_none<T: Debug>(what: &str, patience: Duration, mut left: impl FnMut() -> Vec<T>) {
    let begun = Instant::now();
    loop {
        let left = left();
        if left.is_empty() {
            return;
        }
        assert!(begun.elapsed() < patience, "{what}: not after {patience:?}: {left:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Seconds since the Unix epoch.
pub fn seconds(time: SystemTime) -> f64 {
    time.duration_since(UNIX_EPOCH).expect("after 1970").as_secs_f64()
}

/// Now (s since the Unix epoch).
pub fn now() -> f64 {
    seconds(SystemTime::now())
}

/// Loops by name, as the list has them.
pub fn loops(daemon: &Daemon) -> BTreeMap<String, Value> {
    let list = daemon.json("/api/v1/loops?limit=500&sort=id");
    let items = list["items"].as_array().expect("loops").iter();
    items.map(|item| (item["id"].as_str().expect("a name").to_string(), item.clone())).collect()
}

/// When each loop was diagnosed last (s); 0 where it was not.
pub fn times(daemon: &Daemon) -> BTreeMap<String, f64> {
    loops(daemon).into_iter().map(|(id, own)| (id, time(&own["time"]))).collect()
}

/// How the alarm of a loop stands; empty where the loop is not known.
pub fn alarm(daemon: &Daemon, id: &str) -> String {
    let state = loops(daemon).get(id).and_then(|own| own["alarm"].as_str().map(str::to_string));
    state.unwrap_or_default()
}

/// When the newest sample of a loop's tags was measured, of the tag that is furthest behind (s).
pub fn newest(daemon: &Daemon, id: &str) -> f64 {
    let own = daemon.json(&format!("/api/v1/loops/{id}"));
    let values = own["values"].as_array().expect("values").iter();
    values.map(|value| time(&value["time"])).fold(f64::INFINITY, f64::min)
}

/// A time (s); 0 where there is none.
fn time(value: &Value) -> f64 {
    value.as_str().and_then(parse_time).unwrap_or(0.0)
}

/// Whether a centre leads, or an edge tells people by itself.
pub fn tells(daemon: &Daemon) -> bool {
    daemon.json("/api/v1/fleet")["tells"] == true
}

/// Diagnoses that each worker says it made, by name.
pub fn diagnosed(centre: &Daemon) -> BTreeMap<String, u64> {
    let fleet = centre.json("/api/v1/fleet");
    let machines = fleet["machines"].as_array().expect("machines").iter();
    let workers = machines.filter(|own| own["role"] == "worker");
    let count = |own: &Value| own["diagnosed"].as_u64().expect("a number");
    workers.map(|own| (own["name"].as_str().expect("a name").to_string(), count(own))).collect()
}
