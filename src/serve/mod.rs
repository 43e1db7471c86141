//! What the daemon shows: REST, events, metrics, a dashboard, reports, to whom it may. Reads the plant; what an operator
//! asks of write-back it hands on to the [`WritebackPort`].

mod api;
mod conditional;
pub mod dto;
mod extract;
mod guard;
mod layers;
mod listen;
mod metrics;
mod names;
mod page;
mod picture;
mod policy;
mod ports;
mod problem;
mod refusals;
pub mod report;
mod tls;
mod words;

pub use api::openapi;
pub use policy::{Need, RULES};
#[cfg(feature = "writeback")]
pub use ports::Acted;
pub use ports::{BackfillFile, BackfillPhase, BackfillPort, BackfillRefusal, BackfillRequest, BackfillRun};
pub use ports::{CauseSeen, GroupSeen, Health, LoopLook, Overview, PlantwidePort, Standing, WorkLine};
pub use ports::{DeadLetter, NotificationPort, ReceiverState, WritebackPort};
pub use ports::{FleetLoad, FleetPort, FleetSeen, Machine, Standby};
pub use tls::{Config as TlsConfig, Tls, TlsError};

use self::refusals::Refusals;
use crate::access::{self, Access};
use crate::audit::Recorder;
use crate::history::History;
use crate::results::{Basis, Results};
use crate::schedule::{Clock, Scheduler};
use crate::signal::{LoopId, Record};
use futures::future::BoxFuture;
use serde::Deserialize;
use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use tokio_util::sync::CancellationToken;

/// Most entries of `hosts`: each is compared with every request's.
const MOST_HOSTS: usize = 32;

/// `[server]`: where to listen, and bounds.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Address and port. Anything but loopback needs `[access]` and `[server.tls]`, or that the file says otherwise.
    pub listen: SocketAddr,
    /// `[server.tls]`; without it HTTP is in the clear.
    pub tls: Option<tls::Config>,
    /// True to let everybody who reaches the address read everything and do everything but write-back.
    pub allow_unauthenticated_network: bool,
    /// True to let passwords and tokens be read on the way, or where a proxy before the daemon encrypts.
    pub allow_plain_http_on_network: bool,
    /// Further names by which the daemon may be asked, with or without a port: what a proxy before it is called, or an alias.
    pub hosts: Vec<String>,
    /// Requests worked on at the same time.
    pub max_requests: usize,
    /// Connections open at the same time.
    pub max_connections: usize,
    /// Clients that may listen to events at the same time.
    pub max_event_clients: usize,
    /// Longest time that the head of a request may take to arrive, and its body again (s).
    pub read_timeout_s: f64,
    /// Longest time until a response begins (s).
    pub request_timeout_s: f64,
    /// Largest request body (bytes).
    pub max_body_bytes: usize,
    /// Longest time that open requests may take to end at shutdown (s).
    pub shutdown_s: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            tls: None,
            allow_unauthenticated_network: false,
            allow_plain_http_on_network: false,
            hosts: Vec::new(),
            max_requests: 64,
            max_connections: 256,
            max_event_clients: 64,
            read_timeout_s: 20.0,
            request_timeout_s: 65.0,
            max_body_bytes: 16 * 1024,
            shutdown_s: 5.0,
        }
    }
}

impl Config {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push((field, message));
            }
        };
        let counts = [
            ("max_requests", self.max_requests, 1..=10_000),
            ("max_connections", self.max_connections, 1..=100_000),
            ("max_event_clients", self.max_event_clients, 0..=10_000),
            ("max_body_bytes", self.max_body_bytes, 256..=10_000_000),
        ];
        for (field, value, range) in counts {
            let message = format!("{value} must be {} to {}", range.start(), range.end());
            unless(range.contains(&value), field, message);
        }
        for fault in self.hosts.iter().filter_map(|listed| names::fault(listed)) {
            unless(false, "hosts", fault);
        }
        unless(self.hosts.len() <= MOST_HOSTS, "hosts", format!("at most {MOST_HOSTS} names"));
        let times = [
            ("read_timeout_s", self.read_timeout_s),
            ("request_timeout_s", self.request_timeout_s),
            ("shutdown_s", self.shutdown_s),
        ];
        for (field, value) in times {
            unless((0.1..=600.0).contains(&value), field, format!("{value} must be 0.1 to 600"));
        }
        wrong
    }

    /// Whether it may be served at an address, with a log-in or without.
    ///
    /// # Errors
    /// [`ServeError::Unguarded`] and [`ServeError::Clear`], unless the file says in plain words that it may.
    pub fn permits(&self, address: SocketAddr, log_in: bool) -> Result<(), ServeError> {
        if is_loopback(address) {
            return Ok(());
        }
        match log_in {
            false if !self.allow_unauthenticated_network => Err(ServeError::Unguarded(address)),
            // What everybody may read and do needs no secret on the way.
            true if self.tls.is_none() && !self.allow_plain_http_on_network => {
                Err(ServeError::Clear(address))
            }
            _ => Ok(()),
        }
    }

    fn read_timeout(&self) -> Duration {
        Duration::try_from_secs_f64(self.read_timeout_s).unwrap_or_default()
    }
}

/// Whether nobody but this machine reaches an address.
pub fn is_loopback(address: SocketAddr) -> bool {
    address.ip().to_canonical().is_loopback()
}

/// Why nothing is shown.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The network could reach a daemon that has no log-in.
    #[error(
        "{0} is not loopback, and there is no log-in: whoever reaches it may read everything and do everything but \
         write-back; add [access] and [server.tls], listen on 127.0.0.1, or set allow_unauthenticated_network = true"
    )]
    Unguarded(SocketAddr),
    /// Passwords and tokens could be read on the way.
    #[error(
        "{0} is not loopback, and without [server.tls] passwords and tokens can be read on the way; add [server.tls], \
         listen on 127.0.0.1, or set allow_plain_http_on_network = true, as behind a proxy that encrypts"
    )]
    Clear(SocketAddr),
    /// The listener failed.
    #[error("the listener for the API failed: {0}")]
    Listener(#[from] std::io::Error),
}

/// A loop, for people.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopInfo {
    /// Its name.
    pub id: LoopId,
    /// What it controls.
    pub description: String,
    /// Which part of the plant.
    pub group: String,
    /// Time between two diagnoses (s).
    pub period_s: f64,
}

/// A device that data comes from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceState {
    /// Its name.
    pub name: String,
    /// Whether a connection is open.
    pub connected: bool,
    /// When the last good sample came (s).
    pub last_good: Option<f64>,
    /// Counters since the start, by name (`polls`, `timeouts`, …).
    pub counters: Vec<(&'static str, u64)>,
}

/// How the store is, where there is one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StoreState {
    /// Why it fails, and since when (s); `None` while it works.
    pub failing: Option<(String, f64)>,
    /// It fails because it is damaged, and goes on failing until somebody decides.
    pub is_damaged: bool,
    /// Records of states of alarms, their changes and models that were lost by that, as far as it is known.
    pub lost_states: u64,
    /// The share of its files that was compared with their checksums since the start (0..1); `None` once all of them were.
    pub checked: Option<f64>,
    /// Why what is new waits on disk for a database elsewhere, and since when (s); `None` while it need not.
    pub spooling: Option<(String, f64)>,
    /// Whether that database is there, and bytes that wait for it; `None` for a store in a folder.
    pub database: Option<(bool, u64)>,
    /// When something was last made durable (s).
    pub written_at: Option<f64>,
    /// Bytes its database takes, and bytes it may take.
    pub used_bytes: u64,
    /// See `used_bytes`.
    pub max_bytes: u64,
    /// Counters since the start, by name (`samples`, `lost_samples`, …).
    pub counters: Vec<(&'static str, u64)>,
}

/// Tells how the store is.
pub type AskStore = Arc<dyn Fn() -> StoreState + Send + Sync>;

/// Waits until what was done is durable; false when it is not.
pub type AskDurable = Arc<dyn Fn() -> bool + Send + Sync>;

/// One line of the configuration, for people.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Section of the file.
    pub section: &'static str,
    /// Key.
    pub key: &'static str,
    /// Value as text.
    pub value: String,
}

/// What of the configuration is shown. Chosen one by one: what may be secret is never among it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// Least f that counts as stiction (% of OP span).
    pub f_threshold_percent: Option<f64>,
    /// For people.
    pub settings: Vec<Setting>,
}
/// Finds the samples again that a run worked on; `None` when they are gone.
pub type Recall = Arc<dyn Fn(&LoopId, &Basis) -> Option<Record> + Send + Sync>;

/// What is watched now; replaced as a whole on reload.
pub struct Plant {
    loops: Vec<LoopInfo>,
    by_id: HashMap<LoopId, usize>,
    /// Where the samples are.
    pub history: Arc<History>,
    /// How the devices are.
    pub devices: Arc<dyn Fn() -> Vec<DeviceState> + Send + Sync>,
    /// What of the configuration is shown.
    pub facts: Facts,
    /// Where the samples of a run are, for its bundle.
    recall: Option<Recall>,
}

impl Plant {
    /// What is watched.
    pub fn new(
        loops: Vec<LoopInfo>,
        history: Arc<History>,
        devices: Arc<dyn Fn() -> Vec<DeviceState> + Send + Sync>,
    ) -> Self {
        let by_id = loops.iter().enumerate().map(|(at, info)| (info.id.clone(), at)).collect();
        Self { loops, by_id, history, devices, facts: Facts::default(), recall: None }
    }

    /// Shows these facts of the configuration.
    pub fn with_facts(self, facts: Facts) -> Self {
        Self { facts, ..self }
    }

    /// Finds the samples of a run by `recall`.
    pub fn with_recall(self, recall: Recall) -> Self {
        Self { recall: Some(recall), ..self }
    }

    /// The loops.
    pub fn loops(&self) -> &[LoopInfo] {
        &self.loops
    }

    /// A loop by name.
    pub fn info(&self, id: &LoopId) -> Option<&LoopInfo> {
        self.by_id.get(id).map(|&at| &self.loops[at])
    }
}

/// Passwords hashed at the same time: each takes 19 MiB.
const HASHING: usize = 2;

/// Everything a request may look at.
pub struct Context {
    config: Config,
    clock: Clock,
    started: f64,
    results: Arc<Results>,
    scheduler: Arc<Scheduler>,
    plant: watch::Receiver<Arc<Plant>>,
    event_clients: Arc<Semaphore>,
    /// Tells the events of this run of the daemon from those of another.
    event_run: String,
    writeback: Option<Arc<dyn WritebackPort>>,
    notifications: Option<Arc<dyn NotificationPort>>,
    store: Option<AskStore>,
    durable: Option<AskDurable>,
    backfill: Option<Arc<dyn BackfillPort>>,
    plantwide: Option<Arc<dyn PlantwidePort>>,
    fleet: Option<Arc<dyn FleetPort>>,
    access: Option<Arc<Access>>,
    audit: Option<Arc<Recorder>>,
    refusals: Refusals,
    /// Throttled log-ins, of which the log has few.
    throttled: Refusals,
    tls: Option<Arc<Tls>>,
    /// Passwords hashed at the same time.
    hashing: Arc<Semaphore>,
    /// Whether it is served on loopback, known once it is served.
    loopback: OnceLock<bool>,
    stop: CancellationToken,
}

impl Context {
    /// Everything a request may look at; when `stop` is cancelled open streams end.
    pub fn new(
        config: Config,
        clock: Clock,
        results: Arc<Results>,
        scheduler: Arc<Scheduler>,
        plant: watch::Receiver<Arc<Plant>>,
        stop: CancellationToken,
    ) -> Self {
        Self {
            event_clients: Arc::new(Semaphore::new(config.max_event_clients)),
            event_run: format!("{:016x}", u64::from_ne_bytes(access::random().unwrap_or_default())),
            started: clock.now(),
            config,
            clock,
            results,
            scheduler,
            plant,
            stop,
            writeback: None,
            notifications: None,
            store: None,
            durable: None,
            backfill: None,
            plantwide: None,
            fleet: None,
            access: None,
            audit: None,
            refusals: Refusals::default(),
            throttled: Refusals::default(),
            tls: None,
            hashing: Arc::new(Semaphore::new(HASHING)),
            loopback: OnceLock::new(),
        }
    }

    /// Shows write-back as `writeback` knows it.
    pub fn with_writeback(self, writeback: Arc<dyn WritebackPort>) -> Self {
        Self { writeback: Some(writeback), ..self }
    }

    /// Shows those who are told of alarms.
    pub fn with_notifications(self, notifications: Arc<dyn NotificationPort>) -> Self {
        Self { notifications: Some(notifications), ..self }
    }

    /// Shows the store as `store` tells.
    pub fn with_store(self, store: Option<AskStore>) -> Self {
        Self { store, ..self }
    }

    /// Answers what was done to an alarm once `durable` says so.
    pub fn with_durable(self, durable: Option<AskDurable>) -> Self {
        Self { durable, ..self }
    }

    /// Asks `fleet` for the machines that this one works with.
    pub fn with_fleet(self, fleet: Option<Arc<dyn FleetPort>>) -> Self {
        Self { fleet, ..self }
    }

    /// Asks `backfill` for what was before.
    pub fn with_backfill(self, backfill: Arc<dyn BackfillPort>) -> Self {
        Self { backfill: Some(backfill), ..self }
    }

    /// Shows the plant as a whole.
    pub fn with_plantwide(self, plantwide: Arc<dyn PlantwidePort>) -> Self {
        Self { plantwide: Some(plantwide), ..self }
    }

    /// How a loop stands among others; unknown where nobody looks at the plant as a whole.
    fn standing(&self, id: &LoopId) -> Standing {
        self.plantwide.as_ref().map_or_else(Standing::default, |port| port.standing(id))
    }

    /// Lets in whom `access` knows; without it everybody on this machine.
    pub fn with_access(self, access: Option<Arc<Access>>) -> Self {
        Self { access, ..self }
    }

    /// Puts changes on record.
    pub fn with_audit(self, audit: Option<Arc<Recorder>>) -> Self {
        Self { audit, ..self }
    }

    /// Serves by TLS.
    pub fn with_tls(self, tls: Option<Arc<Tls>>) -> Self {
        Self { tls, ..self }
    }

    /// The logs that changes and write-back are put on record in; the same one may be for both.
    fn records(&self) -> Vec<Arc<Recorder>> {
        let of_writeback = self.writeback.as_ref().and_then(|writeback| writeback.record());
        let mut all: Vec<_> = self.audit.iter().cloned().chain(of_writeback).collect();
        all.dedup_by(|one, other| Arc::ptr_eq(one, other));
        all
    }

    /// Whether nobody but this machine can ask.
    #[cfg(feature = "writeback")]
    fn on_loopback(&self) -> bool {
        self.loopback.get() == Some(&true)
    }

    fn plant(&self) -> Arc<Plant> {
        self.plant.borrow().clone()
    }
}

/// All routes, wrapped in the bounds every request passes.
pub fn router(context: Arc<Context>) -> axum::Router {
    layers::wrap(page::routes().merge(api::routes(context.clone())), &context)
}

/// Serves on a listener until `stop` is cancelled, then lets open requests end within `shutdown_s`.
///
/// # Errors
/// [`ServeError::Unguarded`], [`ServeError::Clear`] before anything is served, [`ServeError::Listener`] when the listener fails.
pub fn serve(listener: TcpListener, context: Arc<Context>) -> BoxFuture<'static, Result<(), ServeError>> {
    // Boxed here, so that a binary that calls it does not compile the server once more.
    Box::pin(serve_within(listener, context))
}

async fn serve_within(listener: TcpListener, context: Arc<Context>) -> Result<(), ServeError> {
    let address = listener.local_addr()?;
    let (stop, config) = (context.stop.clone(), context.config.clone());
    config.permits(address, context.access.is_some())?;
    // Set once: a context is served by one listener, and the first decides.
    let _ = context.loopback.set(is_loopback(address));
    let bounds = listen::Bounds { connections: config.max_connections, head: config.read_timeout() };
    let tls = context.tls.clone();
    let serving = listen::serve(listener, router(context), tls, bounds, stop.clone());
    let patience = async {
        stop.cancelled().await;
        tokio::time::sleep(Duration::try_from_secs_f64(config.shutdown_s).unwrap_or_default()).await;
    };
    tokio::select! {
        () = serving => Ok(()),
        () = patience => Ok(()),
    }
}
