//! This machine among others: what each role adds to the daemon. Every role is the whole daemon; a worker has no loops, and a
//! centre has those of the edges.

mod alone;
mod announcing;
mod asking;
mod centre;
mod certificates;
mod claims;
mod edge;
mod events;
mod forward;
mod found;
mod inventory;
mod lists;
mod load;
mod order;
mod orders;
mod progress;
mod server_clock;
mod standing;
mod states;
mod teller;
mod waiting;
mod watching;
mod window;
mod worker;

use super::{App, AppError};
use crate::config::Config;
use crate::fleet;
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::message::Pulse;
use crate::fleet::streams::LATEST;
use crate::fleet::subject::{NO_SITE, Subject, What};
use crate::history::History;
use crate::host;
use crate::notify::Outlet;
use crate::results::{Results, Wanted};
use crate::schedule::{Clock, Elsewhere};
use crate::version::BUILD;
use asking::Asking;
use certificates::Ends;
use claims::{Claims, Edges};
use load::StreamLoad;
use prost::Message;
use server_clock::ServerClock;
use standing::Standing;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;
use teller::Firsts;
use tokio::sync::{RwLock, RwLockWriteGuard, mpsc, watch};
use tokio_util::sync::CancellationToken;
use waiting::Waiting;
use watching::Machines;

/// Orders of people that wait for the streams.
const ORDERS: usize = 1024;
/// How often certificates are looked at.
const CERTIFICATES: Duration = Duration::from_secs(60);
/// How often a machine says that it is there.
const PULSE: Duration = Duration::from_secs(5);
/// Pause after the server could not be reached.
const PAUSE: Duration = Duration::from_secs(2);

/// What this process is in a fleet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// All of it, with no other machine.
    #[default]
    Alone,
    /// Collects at a site, and forwards.
    Edge,
    /// Diagnoses windows for others.
    Worker,
    /// Shows all sites.
    Centre,
}

impl Role {
    /// As it is written.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Alone => "alone",
            Self::Edge => "edge",
            Self::Worker => "worker",
            Self::Centre => "centre",
        }
    }
}

/// What is watched, as of the configuration in force.
pub(super) struct Scene {
    pub config: Arc<Config>,
    pub history: Arc<History>,
}

/// This machine's part in the fleet.
pub(super) struct Fleet {
    role: Role,
    config: fleet::Config,
    name: String,
    /// The site of an edge; what stands in its place for others.
    site: String,
    clock: Clock,
    results: Arc<Results>,
    asking: Arc<Asking>,
    scene: watch::Sender<Arc<Scene>>,
    /// To those who tell people.
    outlet: Outlet,
    /// Age of the oldest that waits to be forwarded (ms).
    lag_ms: AtomicU64,
    server: Mutex<ServerClock>,
    since: f64,
    diagnosed: AtomicU64,
    /// What edges say of themselves.
    edges: Mutex<Edges>,
    /// Whose loops they are, where several edges have one.
    claims: Mutex<Claims>,
    /// Since when all that the edges of a site say is in force, on a steady clock.
    in_force: Mutex<HashMap<String, Duration>>,
    standing: Arc<Standing>,
    /// Since when the loops of the edges are in force, on a steady clock.
    known: watch::Sender<Option<Duration>>,
    /// Number of the last message of alarms that was looked at.
    looked_at: watch::Sender<u64>,
    firsts: Firsts,
    /// What people want done, on its way to the edges.
    wanted: tokio::sync::Mutex<mpsc::Receiver<(Wanted, u64)>>,
    orders_waiting: Arc<Waiting>,
    link: OnceLock<Link>,
    /// The newest lease that was seen.
    epoch: AtomicU64,
    /// Held for reading while what came is taken and stored, and for writing while rings are replaced.
    taking: RwLock<()>,
    /// Held for reading while receivers are told, and for writing while they are replaced: who replaces them may wait long for
    /// `taking`, and people are told meanwhile.
    receivers: RwLock<()>,
    machines: Mutex<Machines>,
    /// The streams, where a centre could look at them.
    streams: Mutex<Vec<StreamLoad>>,
    /// Of the certificates of this machine, the one that ends first.
    ends: Mutex<Option<Ends>>,
    /// Messages that were left out because their loop is not known, or is another edge's.
    left_out: AtomicU64,
}

impl Fleet {
    /// The part of a role; nothing connects yet.
    ///
    /// # Errors
    /// [`AppError::Fleet`]: a role without `[fleet]`, an edge without a site or a store, a centre with too short rings.
    pub(super) fn new(
        role: Role,
        config: &Arc<Config>,
        clock: Clock,
        history: &Arc<History>,
        results: &Arc<Results>,
    ) -> Result<Option<Arc<Self>>, AppError> {
        let own = match (role, &config.fleet) {
            (Role::Alone, None) => return Ok(None),
            (Role::Alone, Some(_)) => {
                return Err(AppError::Fleet(
                    "[fleet] is for `stictiond edge`, `worker` and `centre`: take it out, or start one of them".into(),
                ));
            }
            (role, None) => {
                return Err(AppError::Fleet(format!(
                    "`stictiond {}` needs a section [fleet]",
                    role.as_str()
                )));
            }
            (_, Some(own)) => own.clone(),
        };
        check(role, config, &own).map_err(AppError::Fleet)?;
        let site = own.site.clone().filter(|_| role == Role::Edge).unwrap_or_else(|| NO_SITE.to_string());
        let scene = Scene { config: config.clone(), history: history.clone() };
        let (want, wanted) = mpsc::channel(ORDERS);
        let (standing, orders_waiting) = (Arc::new(Standing::new()), Arc::<Waiting>::default());
        if role == Role::Centre {
            let (leads, waiting) = (standing.clone(), orders_waiting.clone());
            results.follow_others(Arc::new(move |own| {
                waiting.begin();
                let epoch = leads.epoch(clock.elapsed());
                let taken = epoch.is_some_and(|epoch| want.try_send((own, epoch)).is_ok());
                if !taken {
                    waiting.end(false);
                }
                taken
            }));
        }
        let asking = Arc::new(Asking::new(&site, own.answer_within_s, clock));
        Ok(Some(Arc::new(Self {
            role,
            name: own.name.clone().unwrap_or_else(host::name),
            site,
            clock,
            results: results.clone(),
            asking,
            scene: watch::Sender::new(Arc::new(scene)),
            outlet: Outlet::default(),
            lag_ms: AtomicU64::new(0),
            server: Mutex::default(),
            since: clock.now(),
            diagnosed: AtomicU64::new(0),
            edges: Mutex::default(),
            claims: Mutex::default(),
            in_force: Mutex::default(),
            standing,
            known: watch::Sender::new(None),
            looked_at: watch::Sender::new(0),
            firsts: Firsts::default(),
            wanted: tokio::sync::Mutex::new(wanted),
            orders_waiting,
            link: OnceLock::new(),
            epoch: AtomicU64::new(0),
            taking: RwLock::default(),
            receivers: RwLock::default(),
            machines: Mutex::default(),
            streams: Mutex::default(),
            ends: Mutex::default(),
            left_out: AtomicU64::new(0),
            config: own,
        })))
    }

    /// Asks workers, where this is an edge.
    pub(super) fn elsewhere(self: &Arc<Self>) -> Option<Elsewhere> {
        (self.role == Role::Edge).then(|| self.asking.clone().elsewhere())
    }

    /// Where those who tell people hear what is theirs to tell.
    pub(super) fn outlet(&self) -> Outlet {
        self.outlet.clone()
    }

    /// Whether loops and alarms are those of other machines.
    pub(super) fn follows(&self) -> bool {
        self.role == Role::Centre
    }

    /// Nothing is taken and nobody is told while the guards live: rings, results, store and receivers are replaced.
    pub(super) async fn pause(&self) -> [RwLockWriteGuard<'_, ()>; 2] {
        let taking = self.taking.write().await;
        [taking, self.receivers.write().await]
    }

    /// Has everything that was noted made durable.
    async fn is_durable(&self, app: &App) -> bool {
        let persistence = app.persistence.clone();
        tokio::task::spawn_blocking(move || persistence.make_durable()).await.unwrap_or(false)
    }

    /// Another configuration is in force.
    pub(super) fn replace(&self, config: &Arc<Config>, history: &Arc<History>) {
        self.scene.send_replace(Arc::new(Scene { config: config.clone(), history: history.clone() }));
    }

    /// Does its part until the daemon stops.
    pub(super) async fn run(self: Arc<Self>, app: &App) -> Result<(), AppError> {
        let link = Link::connect(&self.config, &self.name)
            .await
            .map_err(|error| AppError::Fleet(error.to_string()))?;
        let _ = self.link.set(link.clone());
        let stop = app.stop.clone();
        tokio::join!(self.pulse(&link, &stop), async {
            match self.role {
                Role::Alone => {}
                Role::Edge => self.edge(&link, app).await,
                Role::Worker => self.worker(&link, app).await,
                Role::Centre => self.centre(&link, app).await,
            }
        });
        Ok(())
    }

    /// Says every few seconds that this machine is there.
    async fn pulse(&self, link: &Link, stop: &CancellationToken) {
        let (mut looked, mut ends) = (None::<Duration>, None);
        while stop.run_until_cancelled(tokio::time::sleep(PULSE)).await.is_some() {
            let scene = self.scene.borrow().clone();
            let now = self.clock.elapsed();
            if looked.is_none_or(|then| now.saturating_sub(then) >= CERTIFICATES) {
                (looked, ends) = (Some(now), certificates::first(&scene.config));
            }
            lock(&self.ends).clone_from(&ends);
            if let Err((_, error)) = link.send(&[self.sign(&scene.config, ends.as_ref())]).await {
                tracing::debug!(%error, "the fleet does not hear that this machine is there");
            }
        }
    }

    /// Says that this machine is there, with its certificate that ends first.
    fn sign(&self, config: &Config, ends: Option<&Ends>) -> Outgoing {
        let pulse = Pulse {
            role: self.role.as_str().to_string(),
            version: BUILD.to_string(),
            at: self.clock.now(),
            since: self.since,
            lag_s: self.lag_ms.load(Relaxed) as f64 * 1e-3,
            diagnosed: self.diagnosed.load(Relaxed),
            loops: config.loops.len() as u64,
            certificate: ends.map(|ends| ends.of.clone()),
            certificate_until: ends.map(|ends| ends.until),
        };
        let subject = Subject::new(&self.site, &self.name, What::Pulse).to_string();
        Outgoing::latest(subject, pulse.encode_to_vec())
    }

    /// Asks for the NATS server's time: the stamp of a message that is sent now.
    async fn ask_server(&self, link: &Link) -> Result<(), LinkError> {
        let config = self.scene.borrow().config.clone();
        let sign = self.sign(&config, certificates::first(&config).as_ref());
        let subject = sign.subject.clone();
        link.send(&[sign]).await.map_err(|(_, error)| error)?;
        link.last_taken_at(LATEST, &subject).await?.into_iter().for_each(|at| self.hear_server(at));
        Ok(())
    }

    /// A message came now that the NATS server had stamped `stamp` (s).
    fn hear_server(&self, stamp: f64) {
        lock(&self.server).hear(stamp, self.clock.elapsed());
    }

    /// Now, by the NATS server's clock (s); by ours before a stamp of it was heard.
    fn server_now(&self) -> f64 {
        lock(&self.server).at(self.clock.elapsed()).unwrap_or_else(|| self.clock.now())
    }

    fn lag(&self, s: f64) {
        self.lag_ms.store((s.max(0.0) * 1e3) as u64, Relaxed);
    }
}

/// Locks what several tasks share. It stays usable after one of them panicked, because each step of a change leaves it whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn check(role: Role, config: &Config, own: &fleet::Config) -> Result<(), String> {
    match role {
        Role::Edge if own.site.is_none() => Err("[fleet] site: an edge needs one".into()),
        Role::Edge if config.store.is_none() => {
            Err("an edge needs a [store]: what cannot be forwarded waits there".into())
        }
        Role::Worker if !config.loops.is_empty() => {
            Err("a worker has no loops of its own: take out [[loop]]".into())
        }
        Role::Centre if !config.loops.is_empty() => {
            Err("a centre has the loops of the edges: take out [[loop]]".into())
        }
        Role::Centre => check_rings(config).and(match config.store {
            Some(_) => Ok(()),
            None => Err(
                "a centre needs a [store]: what edges forward is deleted from the streams once it is there"
                    .into(),
            ),
        }),
        _ => Ok(()),
    }
}

impl Config {
    /// The parts of a fleet, and why one would not start with this configuration; none without a `[fleet]`.
    pub fn fleet_parts(&self) -> Vec<(&'static str, Result<(), String>)> {
        let Some(own) = &self.fleet else { return Vec::new() };
        [Role::Edge, Role::Worker, Role::Centre].map(|role| (role.as_str(), check(role, self, own))).into()
    }

    /// Remarks on a configuration with which a part of a fleet would start.
    pub fn fleet_remarks(&self) -> Vec<String> {
        let is_edge = self.fleet.as_ref().is_some_and(|own| check(Role::Edge, self, own).is_ok());
        let notify = &self.notify;
        let receivers = notify.webhook.len() + notify.smtp.len() + notify.alertmanager.len();
        if !is_edge || receivers > 0 {
            return Vec::new();
        }
        let remark = "[notify] has no receiver: while an edge with this file reaches no centre nobody is told of its alarms";
        vec![remark.to_string()]
    }
}

/// A centre's rings hold a message twice: the store reads one while the next comes.
fn check_rings(config: &Config) -> Result<(), String> {
    let (own, most) = (config.history.samples_per_tag, forward::MOST_SAMPLES);
    if own >= 2 * most {
        return Ok(());
    }
    Err(format!(
        "[history] samples_per_tag = {own}: a centre needs at least {}, for it takes up to {most} samples of a tag at once",
        2 * most
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::LoopId;

    fn config(fleet: &str) -> Config {
        let fleet = toml::from_str(&format!("servers = ['nats://127.0.0.1:1']\n{fleet}")).unwrap();
        let store = toml::from_str("folder = 'unused'").unwrap();
        Config { fleet: Some(fleet), store: Some(store), ..Config::default() }
    }

    fn part(role: Role, config: Config, own: &str) -> (Arc<Fleet>, Arc<Results>) {
        let results = Arc::new(Results::new(&[LoopId::new(own)], 5, &config.alarm));
        let history = Arc::new(History::new(&[], &config.history));
        let fleet = Fleet::new(role, &Arc::new(config), Clock::wall(), &history, &results);
        (fleet.unwrap().unwrap(), results)
    }

    /// A centre that knows one loop, and the collector `north:dcs`, with two kinds of alarms switched off.
    pub(super) fn centre(own: &str) -> (Arc<Fleet>, Arc<Results>) {
        let mut config = config("");
        config.alarm.f_rising.enabled = false;
        config.alarm.collector_down.enabled = false;
        config.forwarded = vec!["north:dcs".to_string()];
        config.history.samples_per_tag = 2 * forward::MOST_SAMPLES;
        part(Role::Centre, config, own)
    }

    /// An edge that has one loop.
    pub(super) fn edge(own: &str) -> (Arc<Fleet>, Arc<Results>) {
        part(Role::Edge, config("site = 'north'"), own)
    }

    #[test]
    fn an_edge_without_receivers_is_remarked() {
        let mut edge = config("site = 'north'");
        assert!(edge.fleet_remarks().concat().contains("nobody is told of its alarms"));
        assert_eq!(config("").fleet_remarks(), [""; 0], "a worker or a centre");
        edge.notify.smtp = toml::from_str::<crate::notify::Config>(
            "[[smtp]]\nname = 'a'\naddress = 'mail:587'\nfrom = 'a@b.c'\nto = ['d@b.c']",
        )
        .unwrap()
        .smtp;
        assert_eq!(edge.fleet_remarks(), [""; 0]);
    }

    #[test]
    fn a_centre_with_short_rings_is_refused() {
        let mut config = Config::default();
        config.history.samples_per_tag = 2 * forward::MOST_SAMPLES;
        assert_eq!(check_rings(&config), Ok(()));
        config.history.samples_per_tag -= 1;
        let said = check_rings(&config).expect_err("too short");
        assert!(said.contains("samples_per_tag = 3999") && said.contains("4000"), "{said}");
    }
}
