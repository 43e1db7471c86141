//! The servers as `deploy/nats` configures them, with ports, passwords and a folder put in: each role can do its part, and no
//! more.

use crate::daemon::{Daemon, folder, stictiond};
use crate::nats::{Nats, check};
use crate::rig::{PATIENCE, alarm, diagnosed, loops, now, tells};
use futures::StreamExt;
use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use stictiond::fleet::config::Config;
use stictiond::fleet::link::{Hearing, Link, Outgoing};
use stictiond::fleet::streams::{ACTIONS, ALARMS, DIAGNOSES, LATEST, SAMPLES, STATES, WINDOWS};
use stictiond::fleet::subject::{NO_SITE, Subject, What, all};

/// What stands in `hub.conf` for the hash of a password.
const HASH: &str = "$2a$11$replace.this.by.the.hash.of.a.password.of.your.ownxxxxxxxx";
const PASSWORD: &str = "a-password-of-our-own";
const A_WHILE: Duration = Duration::from_secs(10);
/// Under which name the edge `e1` of the site north reads its orders: `hub.conf` names it.
const ORDERS: &str = "edge_north_e1";
/// What has reached this process is heard far sooner.
const A_MOMENT: Duration = Duration::from_secs(1);

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/nats").join(name)
}

/// A configuration with something in place of what has to stand there.
fn filled(name: &str, with: &[(&str, String)]) -> String {
    let mut text = fs::read_to_string(path(name)).expect("readable");
    for (old, new) in with {
        assert!(text.contains(*old), "{name} has no {old}");
        text = text.replace(*old, new);
    }
    text
}

fn hub() -> Nats {
    Nats::with("deployed-hub", |folder, [clients, leaves]| {
        let text = filled(
            "hub.conf",
            &[
                ("listen: 0.0.0.0:4222", format!("listen: 127.0.0.1:{clients}")),
                ("listen: 0.0.0.0:7422", format!("listen: 127.0.0.1:{leaves}")),
                ("/var/lib/nats", folder.join("js").display().to_string()),
                (HASH, PASSWORD.to_string()),
            ],
        );
        with_south(&text)
    })
}

/// `hub.conf` with a second site, called south: a copy of the account of north, as `docs/fleet.md` says.
fn with_south(text: &str) -> String {
    let (before, account) = text.split_once("\n  north {").expect("the account of a site");
    let (account, end) = account.rsplit_once('}').expect("the end of the accounts");
    let copy = account.replace("north", "south");
    format!("{before}\n  north {{{account}\n  south {{{copy}}}{end}")
}

/// The leaf node of a site.
fn leaf(hub: &Nats, site: &str) -> Nats {
    let address = format!("nats-leaf://edge-{site}:{PASSWORD}@127.0.0.1:{}", hub.leaf_port());
    Nats::with(&format!("deployed-{site}"), |_, [clients, _]| {
        filled(
            "leaf.conf",
            &[
                ("server_name: stictiond-north", format!("server_name: stictiond-{site}")),
                ("listen: 127.0.0.1:4222", format!("listen: 127.0.0.1:{clients}")),
                ("nats-leaf://edge-north:PASSWORD@hub.example:7422", address),
            ],
        )
    })
}

/// `[fleet]` of who connects there; by a name and the password in a file of the folder, where a server asks for one.
fn section(server: &Nats, user: Option<&str>, folder: &Path) -> String {
    let file = folder.join("password");
    fs::write(&file, PASSWORD).expect("writable");
    let login = user.map(|user| format!("user = {user:?}\npassword_file = {file:?}\n"));
    format!("servers = [{:?}]\n{}", server.url(), login.unwrap_or_default())
}

async fn link(section: &str) -> (Link, Config) {
    let config: Config = toml::from_str(section).expect("readable");
    (Link::connect(&config, "test").await.expect("begins"), config)
}

fn message(site: &str, name: &str, what: What) -> Outgoing {
    let own = Subject::new(site, name, what);
    let subject = match what {
        What::Hello => own.part(0),
        What::State => own.of_edge("e1"),
        _ => own.to_string(),
    };
    Outgoing::once(subject, what.as_str().as_bytes().to_vec())
}

/// Sends a message, at the first time before everything is connected.
async fn sent(link: &Link, message: Outgoing) {
    let (begun, message) = (Instant::now(), [message]);
    while let Err((_, error)) = link.send(&message).await {
        assert!(begun.elapsed() < PATIENCE, "{}: {error}", message[0].subject);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

fn good<T, E: Display>(done: Result<T, E>) -> T {
    done.unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn the_servers_take_their_configurations() {
    for name in ["hub.conf", "leaf.conf"] {
        let (is_good, said) = check(&path(name));
        assert!(is_good, "{said}");
    }
    // One that is none is refused, and one that lets a site speak in the name of another.
    let folder = folder("deployed-check");
    let broken = folder.join("broken.conf");
    for (old, new, why) in [
        ("permissions: $WORKER", "permissions: $NOBODY", "NOBODY"),
        ("\n  north {", "\n  south {", "import not authorized"),
    ] {
        fs::write(&broken, filled("hub.conf", &[(old, new.to_string())])).expect("writable");
        let (is_good, said) = check(&broken);
        assert!(!is_good && said.contains(why), "{said}");
    }
    fs::remove_dir_all(&folder).expect("writable");
}

/// A fleet's links: each by its log-in.
struct Roles {
    centre: Link,
    worker: Link,
    /// Nobody to its leaf node, which has the log-in of its site, north.
    edge: Link,
    /// The same of the site south.
    south: Link,
}

impl Roles {
    async fn of(hub: &Nats, [north, south]: [&Nats; 2], folder: &Path) -> Self {
        let (centre, config) = link(&section(hub, Some("centre"), folder)).await;
        let begun = Instant::now();
        while let Err(error) = centre.make_streams(&config).await {
            assert!(begun.elapsed() < PATIENCE, "{error}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let (worker, _) = link(&section(hub, Some("worker"), folder)).await;
        let (edge, _) = link(&section(north, None, folder)).await;
        let (south, _) = link(&section(south, None, folder)).await;
        Self { centre, worker, edge, south }
    }

    /// What an edge forwards arrives; a window goes to a worker and its answer to the edge, and an order to the edge.
    async fn do_their_parts(&self) {
        use What::{Alarm, Cursor, Diagnosis, Hello, Pulse, Samples, State};
        let Self { centre, worker, edge, .. } = self;
        for what in [Samples, Diagnosis, Alarm, State, Hello, Pulse, Cursor] {
            sent(edge, message("north", "A", what)).await;
        }
        // It asks whether the streams still have that, and what time it is there.
        for (stream, what) in [(DIAGNOSES, Diagnosis), (ALARMS, Alarm), (STATES, State)] {
            assert_eq!(good(edge.state(stream).await).last, 1, "{stream}");
            let there = good(edge.at(stream, 1).await).expect("it is kept");
            assert_eq!(there, (message("north", "A", what).subject, what.as_str().as_bytes().to_vec()));
        }
        let pulse = Subject::new("north", "A", Pulse).to_string();
        assert!(good(edge.last_taken_at(LATEST, &pulse).await).is_some_and(|at| (at - now()).abs() < 3600.0));
        let samples = Subject::new("north", "A", What::Samples).to_string();
        let last = good(edge.last(SAMPLES, &samples).await);
        assert_eq!(last.map(|(_, body)| body).as_deref(), Some(&b"samples"[..]));
        // A centre fetches what an edge is, part by part.
        let part = Subject::new("north", "A", What::Hello).part(0);
        let last = good(centre.last(LATEST, &part).await);
        assert_eq!(last.map(|(_, body)| body).as_deref(), Some(&b"hello"[..]));
        good(centre.write_lease(0, "0 c1".to_string()).await);
        assert!(good(edge.lease().await).is_some());
        for stream in [SAMPLES, DIAGNOSES, ALARMS] {
            let mut reading = good(centre.read(stream, "centre_c1", "").await);
            let found = good(reading.next(1, A_WHILE).await);
            assert_eq!(found.len(), 1, "{stream}");
            for own in found {
                good(own.done().await);
            }
        }

        let mut states = good(centre.follow(STATES, &all(None, State)).await);
        assert_eq!(good(states.next(1, A_WHILE).await).len(), 1);

        let mut answers = good(edge.hear(all(Some("north"), What::Answer)).await);
        sent(edge, message("north", "A", What::Window)).await;
        sent(worker, message(NO_SITE, "w1", What::Pulse)).await;
        let mut windows =
            good(worker.share(WINDOWS, "workers", &all(None, What::Window), (A_WHILE, 3)).await);
        let window = good(windows.next(1, A_WHILE).await).pop().expect("a window");
        let answer = message("north", "A", What::Answer);
        good(worker.tell(answer.subject, answer.body).await);
        good(window.done().await);
        let answer = tokio::time::timeout(PATIENCE, answers.next()).await.expect("it is heard");
        assert_eq!(answer.expect("it is connected").payload[..], b"answer"[..]);

        sent(centre, message("north", "A", What::Action)).await;
        let mut orders = good(edge.read(ACTIONS, ORDERS, &all(Some("north"), What::Action)).await);
        let order = good(orders.next(1, A_WHILE).await).pop().expect("an order");
        good(order.done().await);
    }

    /// What is not theirs the hub does not take from them, and does not give them.
    async fn do_no_more(&self) {
        let Self { centre, worker, edge, south } = self;
        let mut overheard = good(worker.hear(all(None, What::Samples)).await);
        let mut foreign = good(edge.hear(all(Some("south"), What::Answer)).await);
        let mut everything = good(edge.hear(all(None, What::Answer)).await);
        let mut own = good(south.hear(all(Some("south"), What::Answer)).await);
        sent(edge, message("north", "B", What::Samples)).await;
        let samples = Subject::new("north", "B", What::Samples).to_string();
        // The orders of another site, which has its reader already.
        let theirs = all(Some("south"), What::Action);
        let mut orders = good(south.read(ACTIONS, "edge_south_e1", &theirs).await);
        sent(centre, message("south", "A", What::Action)).await;
        // An edge that asks what it may not is refused at once. A worker gets no answer, and waits for one.
        let refused = tokio::join!(
            async { edge.read(ACTIONS, "edge_north_e2", &theirs).await.is_err() },
            async { edge.read(ACTIONS, "edge_south_e1", &theirs).await.is_err() },
            async { edge.send(&[message("north", "B", What::Action)]).await.is_err() },
            async { edge.write_lease(1, "0 edge".to_string()).await.is_err() },
            async { edge.read(WINDOWS, "thief", "").await.is_err() },
            async { worker.send(&[message("north", "C", What::Action)]).await.is_err() },
            async { worker.send(&[message("north", "C", What::Samples)]).await.is_err() },
            async { worker.last(SAMPLES, &samples).await.is_err() },
            async { worker.read(SAMPLES, "thief", "").await.is_err() },
        );
        assert_eq!(refused, (true, true, true, true, true, true, true, true, true));
        // Nothing of it is there, and the links are as good as before.
        for (stream, name, what) in
            [(ACTIONS, "B", What::Action), (ACTIONS, "C", What::Action), (SAMPLES, "C", What::Samples)]
        {
            let subject = Subject::new("north", name, what).to_string();
            assert_eq!(good(centre.last(stream, &subject).await), None, "{subject}");
        }
        assert_eq!(good(centre.lease().await).map(|own| own.holder).as_deref(), Some("c1"));
        good(worker.share(WINDOWS, "workers", &all(None, What::Window), (A_WHILE, 3)).await);
        assert!(!has_heard(&mut overheard).await, "a worker has heard samples");
        let order = good(orders.next(1, A_WHILE).await).pop().expect("nobody has taken it away");
        good(order.done().await);
        // The answer to the other site first: who hears the second would have heard it.
        for site in ["south", "north"] {
            let answer = message(site, "A", What::Answer);
            good(worker.tell(answer.subject, answer.body).await);
        }
        tokio::time::timeout(PATIENCE, own.next()).await.expect("it is heard").expect("it is connected");
        let heard = tokio::time::timeout(PATIENCE, everything.next()).await.expect("it is heard");
        let subject = message("north", "A", What::Answer).subject;
        assert_eq!(heard.expect("it is connected").subject.as_str(), subject);
        assert!(!has_heard(&mut everything).await, "an edge has heard what another is told");
        assert!(!has_heard(&mut foreign).await, "an edge has heard what another is told");
    }

    /// What an edge says in the name of another site no stream takes; from that site each takes it.
    async fn speak_for_their_own_sites(&self) {
        let Self { centre, edge, south, .. } = self;
        let kinds = [
            (SAMPLES, What::Samples),
            (WINDOWS, What::Window),
            (DIAGNOSES, What::Diagnosis),
            (ALARMS, What::Alarm),
            (STATES, What::State),
            (LATEST, What::Hello),
            (LATEST, What::Pulse),
            (LATEST, What::Cursor),
        ];
        for (stream, what) in kinds {
            let named = message("south", "N", what);
            let subject = named.subject.clone();
            assert!(edge.send(&[named]).await.is_err(), "{subject} was taken");
            assert_eq!(good(centre.last(stream, &subject).await), None, "{subject}");
            sent(south, message("south", "N", what)).await;
            let last = good(centre.last(stream, &subject).await);
            assert_eq!(last.map(|(_, body)| body).as_deref(), Some(what.as_str().as_bytes()), "{subject}");
        }
    }
}

/// Whether something has come.
async fn has_heard(hearing: &mut Hearing) -> bool {
    matches!(tokio::time::timeout(A_MOMENT, hearing.next()).await, Ok(Some(_)))
}

#[tokio::test(flavor = "multi_thread")]
async fn each_role_can_do_its_part_and_no_more() {
    let folder = folder("deployed-roles");
    let hub = hub();
    let (north, south) = (leaf(&hub, "north"), leaf(&hub, "south"));
    let roles = Roles::of(&hub, [&north, &south], &folder).await;
    roles.do_their_parts().await;
    assert!(!hub.log().contains("Violation"), "{}", hub.log());
    roles.speak_for_their_own_sites().await;
    roles.do_no_more().await;
    assert!(hub.log().contains("Publish Violation - User \"worker\""), "{}", hub.log());
    fs::remove_dir_all(&folder).expect("writable");
}

/// What of the log says that nobody takes or answers what a daemon sends: so an edge is told what the account of its site lacks.
fn refusals(log: &Path) -> Vec<String> {
    let text = fs::read_to_string(log).expect("readable");
    let is_one = |line: &&str| {
        line.contains("requested JetStream resource does not exist") || line.contains("no stream found")
    };
    text.lines().filter(is_one).map(str::to_string).collect()
}

/// A daemon of each role: what they ask of the servers is what their log-ins may.
#[test]
fn the_daemons_of_each_role_need_no_more_than_they_may() {
    let folder = folder("deployed-daemons");
    let hub = hub();
    let leaf = leaf(&hub, "north");
    let start = |role: &str, name: &str, (server, user): (&Nats, Option<&str>), rest: &str| -> Daemon {
        let store = folder.join(format!("store-{name}"));
        let store = if role == "worker" { String::new() } else { format!("[store]\nfolder = {store:?}\n") };
        let fleet = format!("[fleet]\nname = '{name}'\n{}", section(server, user, &folder));
        let config = folder.join(format!("{name}.toml"));
        fs::write(&config, format!("[server]\nlisten = '127.0.0.1:0'\n{store}{fleet}{rest}"))
            .expect("writable");
        Daemon::start(stictiond(), role, &config)
    };
    let centre = start("centre", "c1", (&hub, Some("centre")), "");
    centre.until("the centre leads", PATIENCE, tells);
    // Before that nobody answers an edge.
    let is_joined = |_: &Daemon| hub.log().contains("Leafnode connection created");
    centre.until("the leaf node is at the hub", PATIENCE, is_joined);
    let worker = start("worker", "w1", (&hub, Some("worker")), "");
    // A loop without samples is diagnosed, too.
    let tag = |role: &str| {
        format!("[loop.{role}]\ndevice = 'd'\nregister = 'holding'\naddress = 0\ntype = 'f32'\n")
    };
    let rest = format!(
        "site = 'north'\n[schedule]\nperiod_s = 2\n[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n\
         [[loop]]\nid = 'A'\nop_span = 100.0\n{}{}",
        tag("op"),
        tag("pv").replace("address = 0", "address = 2")
    );
    let edge = start("edge", "e1", (&leaf, None), &rest);
    centre.until("a worker's diagnosis is at the centre", PATIENCE, |centre| {
        let is_there = loops(centre).get("north:A").is_some_and(|own| own["verdict"].is_string());
        is_there && diagnosed(centre).get("w1").is_some_and(|count| *count > 0)
    });
    centre.ask("POST", "/api/v1/alarms/north:A/out-of-service", "{\"by\":\"kim\"}");
    edge.until("the edge does what the centre wants", PATIENCE, |edge| alarm(edge, "A") == "out-of-service");
    centre.until("the centre knows", PATIENCE, |centre| alarm(centre, "north:A") == "out-of-service");
    let known = centre.json("/api/v1/fleet");
    let machines = known["machines"].as_array().expect("machines");
    assert_eq!(machines.len(), 3, "{known}");
    for own in machines {
        assert_eq!(own["version"], stictiond::version::BUILD, "{own}");
        assert_eq!(own["silent"], false, "{own}");
        // All of them have one clock: what is left is the way to the server.
        let off = own["clock_offset_s"].as_f64().expect("a number");
        assert!(off.abs() < 10.0 && own["lag_s"].is_number(), "{own}");
    }
    for name in ["c1", "w1", "e1"] {
        assert_eq!(refusals(&folder.join(format!("{name}.log"))), [""; 0], "{name}");
    }
    // An edge that `hub.conf` does not name hears no orders, and says so.
    let unnamed = start("edge", "e2", (&leaf, None), &rest);
    unnamed.until("it is refused", PATIENCE, |_| {
        refusals(&folder.join("e2.log"))
            .iter()
            .any(|line| line.contains("orders of the centre are not heard"))
    });
    unnamed.stop();
    edge.stop();
    worker.stop();
    centre.stop();
    assert!(!hub.log().contains("Violation"), "{}", hub.log());
    fs::remove_dir_all(&folder).expect("writable");
}
