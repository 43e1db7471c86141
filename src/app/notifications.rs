//! Results to those who want to hear of them, as `[notify]` says. A reload stops receivers that are gone or changed and
//! begins those that are new; the letters of one that keeps its name go on with it.

use super::Clock;
use crate::config::{Config, tags};
use crate::notify::mqtt::{self, LoopName, Publisher};
use crate::notify::{Letters, Outlet, Places, Source, State, alertmanager, smtp, webhook};
use crate::results::Results;
use crate::serve::{DeadLetter, NotificationPort, ReceiverState};
use crate::signal::LoopId;
use std::collections::{BTreeSet, HashMap};
use std::future::Future;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// Folder in the store's folder where letters are.
const LETTERS: &str = "letters";

/// Who is told.
pub struct Notifications {
    publisher: Option<(Publisher, Arc<mqtt::Counters>)>,
    loops: Arc<Mutex<Vec<LoopName>>>,
    places: Arc<RwLock<Arc<Places>>>,
    results: Arc<Results>,
    clock: Clock,
    folder: Option<PathBuf>,
    /// Where what is to be told comes from, and whether to tell at all, in a fleet.
    outlet: Option<Outlet>,
    receivers: Mutex<Receivers>,
}

#[derive(Default)]
struct Receivers {
    all: Vec<Receiver>,
    /// Given once receivers may begin.
    stop: Option<CancellationToken>,
}

type Work = Pin<Box<dyn Future<Output = ()> + Send>>;

/// One receiver, and once it has begun its task.
struct Receiver {
    spec: Spec,
    state: Arc<State>,
    letters: Option<Arc<Letters>>,
    stop: CancellationToken,
    work: Option<Work>,
    task: Option<JoinHandle<()>>,
}

/// Everything that makes a receiver what it is.
#[derive(Clone, PartialEq)]
struct Spec {
    what: What,
    site: Option<String>,
    public_url: Option<String>,
}

#[derive(Clone, PartialEq)]
enum What {
    Webhook(webhook::Config),
    Alertmanager(alertmanager::Config),
    Smtp(smtp::Config),
}

impl Spec {
    fn name(&self) -> &str {
        match &self.what {
            What::Webhook(own) => &own.name,
            What::Alertmanager(own) => &own.name,
            What::Smtp(own) => &own.name,
        }
    }

    fn kind(&self) -> &'static str {
        match &self.what {
            What::Webhook(_) => "webhook",
            What::Alertmanager(_) => "alertmanager",
            What::Smtp(_) => "smtp",
        }
    }

    /// Dead letters that it keeps; `None` where it keeps none.
    fn most_letters(&self) -> Option<usize> {
        match &self.what {
            What::Webhook(own) => Some(own.retry.dead_letters),
            What::Smtp(own) => Some(own.retry.dead_letters),
            What::Alertmanager(_) => None,
        }
    }
}

impl Notifications {
    /// Nothing connects yet.
    pub fn new(config: &Config, clock: Clock, results: &Arc<Results>, outlet: Option<Outlet>) -> Self {
        let loops = Arc::new(Mutex::new(names(config)));
        let known = loops.clone();
        let known = Arc::new(move || lock(&known).clone());
        let now = Arc::new(move || clock.now());
        let publisher = config.notify.mqtt.clone().map(|mqtt| {
            let publisher = Publisher::new(mqtt, results.clone(), known, now);
            let counters = publisher.counters();
            (publisher, counters)
        });
        let own = Self {
            publisher,
            loops,
            places: Arc::new(RwLock::new(Arc::new(places(config)))),
            results: results.clone(),
            clock,
            folder: config.store.as_ref().map(|store| store.folder.join(LETTERS)),
            outlet,
            receivers: Mutex::default(),
        };
        lock(&own.receivers).all = specs(config).into_iter().map(|spec| own.receiver(spec, None)).collect();
        own
    }

    /// Tells until `stop` is cancelled.
    pub async fn run(&self, stop: CancellationToken) {
        {
            let mut receivers = lock(&self.receivers);
            receivers.stop = Some(stop.clone());
            receivers.all.iter_mut().for_each(Receiver::begin);
        }
        match &self.publisher {
            Some((publisher, _)) => mqtt::run(publisher, stop.clone()).await,
            None => stop.cancelled().await,
        }
        let all = std::mem::take(&mut lock(&self.receivers).all);
        for mut receiver in all {
            receiver.leave().await;
        }
    }

    /// Another configuration is in force: who is told, and of which loops.
    pub async fn reload(&self, config: &Config) {
        *lock(&self.loops) = names(config);
        {
            let mut own = self.places.write().unwrap_or_else(PoisonError::into_inner);
            *own = Arc::new(places(config).after(&own));
        }
        let specs = specs(config);
        let (mut staying, mut letters, mut ending) = (Vec::new(), HashMap::new(), Vec::new());
        for own in &mut lock(&self.receivers).all {
            // Who has said that it is gone is asked anew.
            if specs.contains(&own.spec) && !own.state.is_gone() {
                staying.push(own.spec.clone());
            } else {
                letters.extend(own.letters.clone().map(|letters| (own.spec.name().to_string(), letters)));
                ending.push(own.leave());
            }
        }
        // Meanwhile those that go are shown and asked as before: this machine is not one that tells nobody.
        for left in ending {
            left.await;
        }
        let mut new: Vec<Receiver> = specs
            .into_iter()
            .filter(|spec| !staying.contains(spec))
            .map(|spec| {
                let own = letters.remove(spec.name());
                self.receiver(spec, own)
            })
            .collect();
        let mut receivers = lock(&self.receivers);
        if receivers.stop.as_ref().is_some_and(|stop| !stop.is_cancelled()) {
            new.iter_mut().for_each(Receiver::begin);
        }
        receivers.all.retain(|own| !own.stop.is_cancelled());
        receivers.all.append(&mut new);
    }

    fn receiver(&self, spec: Spec, letters: Option<Arc<Letters>>) -> Receiver {
        let clock = self.clock;
        let now = Arc::new(move || clock.now());
        let source = Source {
            results: self.results.clone(),
            places: self.places.clone(),
            now,
            site: spec.site.clone(),
            public_url: spec.public_url.clone(),
            outlet: self.outlet.clone(),
        };
        let state: Arc<State> = Arc::default();
        let letters = spec.most_letters().map(|most| {
            let letters = letters.unwrap_or_else(|| self.open(spec.name(), most));
            letters.keep_at_most(most);
            letters
        });
        let stop = CancellationToken::new();
        let made: Result<Work, String> = match (&spec.what, &letters) {
            (What::Webhook(own), Some(letters)) => {
                let postman = webhook::postman(own, source, letters.clone(), state.clone());
                postman.map(|postman| Box::pin(postman.run(stop.clone())) as Work)
            }
            (What::Smtp(own), Some(letters)) => {
                let postman = smtp::postman(own, source, letters.clone(), state.clone());
                Ok(Box::pin(postman.run(stop.clone())))
            }
            (What::Alertmanager(own), _) => {
                let informer = alertmanager::Informer::new(own, source, state.clone());
                informer.map(|informer| Box::pin(informer.run(stop.clone())) as Work)
            }
            _ => Err("it keeps no letters".into()),
        };
        if let Err(why) = &made {
            tracing::error!(receiver = spec.name(), "is not told: {why}");
        }
        Receiver { spec, state, letters, stop, work: made.ok(), task: None }
    }

    fn open(&self, name: &str, most: usize) -> Arc<Letters> {
        let folder = self.folder.as_deref().map(|folder: &Path| folder.join(name));
        Arc::new(Letters::open(folder, most))
    }

    fn letters(&self, receiver: &str) -> Option<Arc<Letters>> {
        lock(&self.receivers).all.iter().find(|own| own.spec.name() == receiver)?.letters.clone()
    }
}

impl Receiver {
    fn begin(&mut self) {
        self.task = self.work.take().map(tokio::spawn);
    }

    /// Stops it; it has ended when what is given back has.
    fn leave(&mut self) -> impl Future<Output = ()> + Send + use<> {
        self.stop.cancel();
        let (task, name) = (self.task.take(), self.spec.name().to_string());
        async move {
            if let Some(task) = task
                && let Err(error) = task.await
            {
                tracing::error!(receiver = name, %error, "a receiver's task failed");
            }
        }
    }

    fn state(&self) -> ReceiverState {
        let own = self.state.snapshot();
        let dead = self.letters.as_ref().map_or(0, |letters| letters.counts().1);
        ReceiverState {
            name: self.spec.name().to_string(),
            kind: self.spec.kind(),
            failing: own.failing,
            sent_at: own.sent_at,
            sent: own.sent,
            failed: own.failed,
            dropped: own.dropped,
            queue: own.queue,
            dead_letters: dead as u64,
        }
    }
}

impl NotificationPort for Notifications {
    fn receivers(&self) -> Vec<ReceiverState> {
        let mut all: Vec<ReceiverState> = lock(&self.receivers).all.iter().map(Receiver::state).collect();
        all.extend(self.publisher.as_ref().map(|(_, counters)| {
            ReceiverState {
                name: "mqtt".into(),
                kind: "mqtt",
                failing: (!counters.connected.load(Relaxed))
                    .then(|| counters.lost().unwrap_or_else(|| ("not connected yet".into(), f64::NAN))),
                sent_at: counters.taken_at(),
                sent: counters.published.load(Relaxed),
                failed: counters.losses.load(Relaxed),
                dropped: counters.dropped.load(Relaxed),
                queue: counters.queue.load(Relaxed),
                ..ReceiverState::default()
            }
        }));
        all.sort_by(|a, b| a.name.cmp(&b.name));
        all
    }

    fn dead_letters(&self, receiver: &str) -> Option<Vec<DeadLetter>> {
        let letters = self.letters(receiver)?.dead();
        let letter = |own: crate::notify::Letter| DeadLetter {
            id: own.id,
            made: own.made,
            dead_since: own.dead_since,
            attempts: own.attempts,
            why: own.why,
            body: own.body,
        };
        Some(letters.into_iter().map(letter).collect())
    }

    fn replay(&self, receiver: &str, id: Option<&str>) -> Option<usize> {
        Some(self.letters(receiver)?.replay(id))
    }
}

/// A panic elsewhere leaves lists whole: each is replaced as one.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn specs(config: &Config) -> Vec<Spec> {
    let notify = &config.notify;
    let webhooks = notify.webhook.iter().cloned().map(What::Webhook);
    let alertmanagers = notify.alertmanager.iter().cloned().map(What::Alertmanager);
    let mails = notify.smtp.iter().cloned().map(What::Smtp);
    let spec = |what| Spec { what, site: notify.site.clone(), public_url: notify.public_url.clone() };
    webhooks.chain(alertmanagers).chain(mails).map(spec).collect()
}

fn names(config: &Config) -> Vec<LoopName> {
    let name = |control_loop: &crate::config::LoopConfig| LoopName {
        id: LoopId::new(control_loop.id.as_str()),
        group: control_loop.group.clone(),
    };
    config.loops.iter().map(name).collect()
}

/// The groups of loops, and of the collectors that serve them.
fn places(config: &Config) -> Places {
    let mut devices: HashMap<LoopId, BTreeSet<String>> = HashMap::new();
    for own in config.loops.iter().filter(|own| !own.group.is_empty()) {
        for (_, tag) in tags(own) {
            devices.entry(LoopId::new(tag.device())).or_default().insert(own.group.clone());
        }
    }
    Places {
        loops: names(config).into_iter().map(|name| (name.id, name.group)).collect(),
        devices: devices.into_iter().map(|(name, groups)| (name, groups.into_iter().collect())).collect(),
        before: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm;
    use std::pin::pin;
    use std::task::Poll;
    use std::time::Duration;

    /// A plant of one loop, with this in `[notify]`.
    fn config(notify: &str) -> Config {
        let mut text = "[[modbus]]\nname = 'dcs'\naddress = '10.0.0.5:502'\naddress_base = 0\n".to_string();
        text += "[[loop]]\nid = 'A'\n";
        for (role, address) in [("op", 0), ("pv", 2)] {
            text += &format!(
                "[loop.{role}]\ndevice = 'dcs'\nregister = 'input'\naddress = {address}\ntype = 'f32'\n"
            );
        }
        crate::config::parse("plant.toml", &(text + notify)).unwrap_or_else(|errors| panic!("{errors:?}"))
    }

    fn notifications(config: &Config) -> Notifications {
        let results = Arc::new(Results::new(&[LoopId::new("A")], 3, &alarm::Config::default()));
        Notifications::new(config, Clock::by_hand(1000.0), &results, None)
    }

    #[tokio::test]
    async fn who_is_told_is_known_all_through_a_reload() {
        let told = |port: u16| {
            config(&format!(
                "[[notify.webhook]]\nname = 'cmms'\nurl = 'http://127.0.0.1:{port}/'\nsecret_env = 'NO_SUCH_SECRET'\n"
            ))
        };
        let own = notifications(&told(1));
        let stop = CancellationToken::new();
        let mut running = pin!(own.run(stop.clone()));
        let began = std::future::poll_fn(|cx| Poll::Ready(running.as_mut().poll(cx))).await;
        assert!(began.is_pending());
        let other = told(2);
        let mut reloading = pin!(own.reload(&other));
        let mut looks = 0;
        let through = async {
            loop {
                let ended = std::future::poll_fn(|cx| Poll::Ready(reloading.as_mut().poll(cx))).await;
                let names: Vec<String> = own.receivers().into_iter().map(|own| own.name).collect();
                assert_eq!((names, own.replay("cmms", None)), (vec!["cmms".to_string()], Some(0)), "{looks}");
                if ended.is_ready() {
                    return;
                }
                looks += 1;
                tokio::task::yield_now().await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), through).await.expect("it ends");
        assert!(looks > 0, "it was over at once, so nothing was looked at");
        assert!(lock(&own.receivers).all.iter().all(|own| own.spec == specs(&other)[0]), "the new one");
        stop.cancel();
        running.await;
        assert!(own.receivers().is_empty());
    }

    #[test]
    fn when_a_broker_last_took_a_message_is_told() {
        let own = notifications(&config("[notify.mqtt]\naddress = '127.0.0.1:1'\n"));
        let told =
            || own.receivers().into_iter().map(|own| (own.name, own.sent, own.sent_at)).collect::<Vec<_>>();
        assert_eq!(told(), [("mqtt".to_string(), 0, None)]);
        let (_, counters) = own.publisher.as_ref().expect("it is configured");
        counters.takes(5000.0);
        assert_eq!(told(), [("mqtt".to_string(), 1, Some(5000.0))]);
    }

    #[test]
    fn a_collector_belongs_to_the_groups_of_all_tags_that_it_serves() {
        let mut text = String::new();
        for (name, port) in [("dcs", 502), ("analyser", 503)] {
            text += &format!("[[modbus]]\nname = '{name}'\naddress = '10.0.0.5:{port}'\naddress_base = 0\n");
        }
        text += "[[loop]]\nid = 'A'\ngroup = 'unit 10'\n";
        let tag = |section: &str, device: &str, more: &str| {
            format!("{section}\n{more}device = '{device}'\nregister = 'input'\naddress = 0\ntype = 'f32'\n")
        };
        text += &tag("[loop.op]", "dcs", "");
        text += &tag("[loop.pv]", "dcs", "").replace("address = 0", "address = 2");
        text += &tag("[[loop.tag]]", "analyser", "name = 'load'\n");
        let config = crate::config::parse("plant.toml", &text).expect("sound");
        let devices = places(&config).devices;
        for name in ["dcs", "analyser"] {
            assert_eq!(devices.get(&LoopId::new(name)), Some(&vec!["unit 10".to_string()]), "{name}");
        }
    }
}
