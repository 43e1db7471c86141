//! A message of 8 MB that is nothing but empty parts, to a daemon of each role: decoded it would take up to a hundred times its
//! bytes. It is refused before that, told and counted, and the daemon goes on. So is an announcement of an edge, whose parts are
//! shorter and are fetched one after the other, and are nothing but empty loops when they are together.

use crate::daemon::{Daemon, folder, stictiond};
use crate::nats::Nats;
use crate::{config, connected, hub};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};
use stictiond::fleet::announcement::split;
use stictiond::fleet::link::{Link, Outgoing};
use stictiond::fleet::subject::{Subject, What};
use stictiond::quiet::{self, WINDOW};

/// Far longer than anything takes even on a busy machine. An edge that had no answer in time asks nobody for a minute.
const PATIENCE: Duration = Duration::from_secs(120);
/// What is promised (bytes).
const MOST: u64 = 32 << 20;
/// A message: nearly as long as any (bytes).
const BYTES: usize = 8_000_000;
const SITE: &str = "north";
/// Small messages that are none.
const NONE: u64 = 100;
/// What the log says.
const TOLD: &str = "a message of the fleet is refused";

/// A daemon in a folder where its configuration, its store and its log are.
fn start(folder: &Path, hub: &Nats, (role, name): (&str, &str), rest: &str) -> Daemon {
    let path = folder.join(format!("{name}.toml"));
    let store = match role {
        "worker" => String::new(),
        _ => format!("[store]\nfolder = {:?}\n", folder.join(format!("store-{name}"))),
    };
    let fleet = format!("[fleet]\nname = '{name}'\nservers = ['{}']\n", hub.url());
    fs::write(&path, format!("[server]\nlisten = '127.0.0.1:0'\n{store}{fleet}{rest}")).expect("writable");
    Daemon::start(stictiond(), role, &path)
}

/// An edge with one loop, whose device is away: a loop without samples is diagnosed, too.
fn edge(folder: &Path, hub: &Nats) -> Daemon {
    let tag = |role: &str, address: usize| {
        format!("[loop.{role}]\ndevice = 'd'\nregister = 'holding'\naddress = {address}\ntype = 'f32'\n")
    };
    let rest = format!(
        "site = '{SITE}'\n[schedule]\nperiod_s = 2\n[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n\
         [[loop]]\nid = 'A'\nop_span = 100.0\n{}{}",
        tag("op", 0),
        tag("pv", 2)
    );
    start(folder, hub, ("edge", "e1"), &rest)
}

/// When the loop was diagnosed last, as a centre knows; empty where it does not.
fn time(centre: &Daemon) -> String {
    let list = centre.json("/api/v1/loops?limit=10");
    list["items"][0]["time"].as_str().unwrap_or_default().to_string()
}

/// Diagnoses that the worker says it made.
fn diagnosed(centre: &Daemon) -> u64 {
    let fleet = centre.json("/api/v1/fleet");
    let mut machines = fleet["machines"].as_array().into_iter().flatten();
    machines.find(|own| own["role"] == "worker").and_then(|own| own["diagnosed"].as_u64()).unwrap_or(0)
}

/// Messages that a daemon says it refused.
fn refused(daemon: &Daemon) -> u64 {
    let text = daemon.ask("GET", "/metrics", "");
    let counter = text.lines().find_map(|line| line.strip_prefix("stictiond_fleet_refused_messages_total "));
    counter.expect("a counter").trim().parse::<f64>().expect("a number") as u64
}

/// Most memory that a daemon has taken so far (bytes).
fn most(daemon: &Daemon) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", daemon.id())).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("the system tells");
    1024 * line.trim().trim_end_matches(" kB").parse::<u64>().expect("a number")
}

/// So many bytes of a part that is empty.
fn parts(part: &[u8]) -> Vec<u8> {
    part.repeat(BYTES / part.len())
}

/// A message within a message, under a number below 16.
fn within(number: u8, body: &[u8]) -> Vec<u8> {
    let mut out = vec![(number << 3) | 2];
    prost::encode_length_delimiter(body.len(), &mut out).expect("there is room");
    out.extend_from_slice(body);
    out
}

async fn send(link: &Link, name: &str, what: What, body: Vec<u8>) {
    let subject = Subject::new(SITE, name, what).to_string();
    let sent = match what {
        // No stream keeps it.
        What::Answer => link.tell(subject, body).await,
        _ => link.send(&[Outgoing::once(subject, body)]).await.map_err(|(_, error)| error),
    };
    sent.expect("the server takes it");
}

#[tokio::test(flavor = "multi_thread")]
async fn empty_parts_are_refused_before_they_are_decoded_by_each_role() {
    let (hub, folder) = (hub("parts", |_| "max_payload: 8MB\n".into()), folder("endless-parts"));
    let link = connected(&config(&format!("servers = ['{}']", hub.url()))).await;
    let began = Instant::now();
    let centre = start(&folder, &hub, ("centre", "c1"), "");
    let worker = start(&folder, &hub, ("worker", "w1"), "");
    let edge = edge(&folder, &hub);
    // An edge that has a worker's answer hears answers.
    let is_whole = |centre: &Daemon| !time(centre).is_empty() && diagnosed(centre) > 0;
    centre.until("a worker's diagnosis is at the centre", PATIENCE, is_whole);
    let roles = [("centre", "c1", &centre), ("worker", "w1", &worker), ("edge", "e1", &edge)];
    let rest = roles.map(|(_, _, daemon)| most(daemon));

    // The effects of a diagnosis.
    let effects = parts(b"\x82\x01\x00");
    for (daemon, name, what, body) in [
        (&centre, "A", What::Samples, parts(b"\x0a\x00")),
        (&centre, "A", What::Diagnosis, within(2, &effects)),
        (&worker, "A", What::Window, parts(b"\x1a\x00")),
        (&edge, "A", What::Answer, within(3, &effects)),
    ] {
        let before = refused(daemon);
        send(&link, name, what, body).await;
        daemon.until(&format!("a {} is refused", what.as_str()), PATIENCE, |own| refused(own) > before);
    }
    // Of as many bytes as a list may have: each loop would take nearly a hundred times its bytes.
    let announcement = split(&Subject::new(SITE, "e2", What::Hello), &parts(b"\x0a\x00")[..47 << 17]);
    assert_eq!(announcement.len(), 48);
    let before = refused(&centre);
    link.send(&announcement).await.map_err(|(_, error)| error).expect("the server takes it");
    centre.until("an announcement is refused", PATIENCE, |own| refused(own) > before);
    for ((role, name, daemon), rest) in roles.into_iter().zip(rest) {
        let grown = most(daemon).saturating_sub(rest);
        println!("{role:20} {:6.1} MiB beyond rest", grown as f64 / f64::from(1 << 20));
        assert!(grown < MOST, "{role}: {grown} bytes beyond rest");
        let log = folder.join(format!("{name}.log"));
        let is_told = |what: &str| fs::read_to_string(&log).expect("it has one").contains(what);
        daemon.until("it is told", PATIENCE, |_| is_told(TOLD) && is_told("would take more than"));
    }
    let (time_before, count_before) = (time(&centre), diagnosed(&centre));
    let goes_on = |centre: &Daemon| time(centre) != time_before && diagnosed(centre) > count_before;
    centre.until("another diagnosis of the worker is at the centre", PATIENCE, goes_on);

    // Who sends such messages does not fill the log.
    let before = refused(&edge);
    for _ in 0..NONE {
        send(&link, "A", What::Answer, b"\x0b".to_vec()).await;
    }
    edge.until("all are refused", PATIENCE, |edge| refused(edge) >= before + NONE);
    let log = fs::read_to_string(folder.join("e1.log")).expect("it has one");
    // One window may have ended and another begun.
    let share = quiet::MOST * (began.elapsed().as_secs() / WINDOW.as_secs() + 1);
    assert!((log.matches(TOLD).count() as u64) <= share, "{log}");
    [edge, worker, centre].into_iter().for_each(Daemon::stop);
    fs::remove_dir_all(&folder).expect("writable");
}
