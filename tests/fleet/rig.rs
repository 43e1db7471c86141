//! A fleet on loopback.

use crate::daemon::{Daemon, folder, stictiond};
use crate::nats::Nats;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;
use stictiond::demo::Demo;

/// Time between two diagnoses of a loop, where there are 20 (s).
pub const PERIOD_S: usize = 10;
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
        Self { folder: folder(name), hub, leaves, copies: copies.max(1) }
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

    /// The demo's plant, polled by an edge behind the leaf node of its site.
    pub fn edge(&self, site: &str, demo: &Demo, told: SocketAddr) -> Daemon {
        let text = demo.config().replace(&demo.address().to_string(), "127.0.0.1:0");
        let period = text.find("period_s").expect("there");
        let line = period..period + text[period..].find('\n').expect("a line");
        let text = text.replacen(&text[line], &format!("period_s = {}", PERIOD_S * self.plants()), 1);
        let mut text = copied(&text, self.copies);
        let at = SITES.iter().position(|own| *own == site).expect("a site");
        let name = format!("edge-{site}");
        let _ = write!(
            text,
            "\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n[alarm]\nk = 1\nn = 1\nflood_raises = 100000\n\
             [fleet]\nsite = '{site}'\nname = '{name}'\nservers = ['{}']\nforward_s = 0.5\nanswer_within_s = 20\n\
             cut_off_after_s = 4\n{}",
            self.store(&name).display().to_string(),
            self.leaves[at].url(),
            self.telling(&name, told)
        );
        Daemon::start(stictiond(), "edge", &self.config(&name, &text))
    }

    pub fn worker(&self, name: &str) -> Daemon {
        let text = format!(
            "[server]\nlisten = '127.0.0.1:0'\n[schedule]\nparallelism = 2\n[fleet]\nname = '{name}'\nservers = ['{}']\n",
            self.hub.url()
        );
        Daemon::start(stictiond(), "worker", &self.config(name, &text))
    }

    pub fn centre(&self, name: &str, told: SocketAddr) -> Daemon {
        let text = format!(
            "[server]\nlisten = '127.0.0.1:0'\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n[alarm]\nflood_raises = 100000\n\
             [fleet]\nname = '{name}'\nservers = ['{}']\ncut_off_after_s = 4\n{}",
            self.store(name).display().to_string(),
            self.hub.url(),
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

    /// Whether no change of an alarm waits at the hub for the centre that tells people: one that follows another takes it up
    /// after the pause in which the other might still acknowledge.
    pub fn all_is_told(&self) -> bool {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runs");
        let waiting = async {
            let client = async_nats::connect(self.hub.url()).await.ok()?;
            let stream = async_nats::jetstream::new(client).get_stream("stictiond_events").await.ok()?;
            let own = stream.consumer_info("centres_tell").await.ok()?;
            Some(own.num_pending + own.num_ack_pending as u64)
        };
        runtime.block_on(waiting) == Some(0)
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

/// Loops by name, as the list has them.
pub fn loops(daemon: &Daemon) -> BTreeMap<String, Value> {
    let list = daemon.json("/api/v1/loops?limit=500&sort=id");
    let items = list["items"].as_array().expect("loops").iter();
    items.map(|item| (item["id"].as_str().expect("a name").to_string(), item.clone())).collect()
}
