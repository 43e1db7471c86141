//! Peers that make a library speak without end: of each library the log has no more than its share, and the rest is counted.

use super::rig::{Daemon, Flood, PATIENCE, Wire, asked, flood, peer, written};
use super::{ACK, nats, opcua};
use std::collections::BTreeMap;
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};
use stictiond::quiet::{MOST, WINDOW};

/// Lines that have to be left out before it is looked whether the log is short: far more than one library has.
const ENOUGH: f64 = 50.0;
/// Lines of our own. We say a reason once, however often a peer makes it; a start takes some ten.
const OURS: u64 = 50;

/// How many lines of libraries a daemon says it left out.
fn left_out(address: &str) -> f64 {
    let answer = asked(address, "/metrics").unwrap_or_default();
    let counter = answer.lines().find_map(|line| line.strip_prefix("stictiond_log_lines_left_out_total "));
    counter.map_or(0.0, |number| number.trim().parse().expect("a number"))
}

fn is_ours(target: &str) -> bool {
    target.starts_with("stictiond")
}

fn is_short(role: &str, config: &str, what: Flood) {
    let peer = peer(what, Wire::Clear);
    let config = config.replace("PORT", &peer.port.to_string());
    let path = written(&format!("noise-{role}"), &format!("[server]\nlisten = '127.0.0.1:0'\n{config}"));
    let lines = Arc::new(Mutex::new(BTreeMap::<String, u64>::new()));
    let count = lines.clone();
    let began = Instant::now();
    let command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    let (_daemon, address) = Daemon::serving(command, role, &path, move |line| {
        let target = line["target"].as_str().unwrap_or_default().to_string();
        *count.lock().expect("nobody panicked").entry(target).or_default() += 1;
    });
    // What is written may be read a little later than it is counted.
    let is_heard =
        || lines.lock().expect("nobody panicked").iter().any(|(of, lines)| !is_ours(of) && *lines >= MOST);
    while left_out(&address) < ENOUGH || !is_heard() {
        assert!(began.elapsed() < PATIENCE, "{role}: {:?}", lines.lock());
        thread::sleep(Duration::from_millis(20));
    }
    let lines = lines.lock().expect("nobody panicked");
    println!("{role:8} {:20} {lines:?}", what.name);
    // One window may have ended and another begun.
    let share = MOST * (began.elapsed().as_secs() / WINDOW.as_secs() + 1);
    for (target, lines) in lines.iter() {
        let most = if is_ours(target) { OURS } else { share };
        assert!(*lines <= most, "{role}: {lines} lines of {target:?}");
    }
}

#[test]
fn the_log_stays_short_whatever_a_device_makes_its_library_say() {
    is_short("run", &opcua(), flood("acknowledgements", ACK, ACK));
}

#[test]
fn the_log_stays_short_whatever_a_nats_server_makes_its_library_say() {
    is_short("worker", &nats(Wire::Clear), flood("errors without end", logged_in!(), b"-ERR 'no'\r\n"));
}
