//! Every such peer at once, and the daemon under the limits of the unit in deploy/. Where memory ends is set by the limit on
//! what a process may write to (`RLIMIT_DATA`), which counts what was asked for and never touched too: it ends no later than
//! systemd's. Tasks are counted, because the limit on them counts those of all processes of a user.

use super::rig::{COMMON, Daemon, Flood, ON_THE_WAY, Peer, Wire, asked, peer, written};
use super::{MAIL, MODBUS, MQTT, NATS, OPC_UA, POSTGRESQL, RTU, TOLD, WEB};
use super::{mail, modbus, mqtt, nats, opcua, postgresql, web};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::Ordering::SeqCst;
use std::thread;
use std::time::{Duration, Instant};

/// All at once take longer than one by one.
const PATIENT: Duration = Duration::from_secs(240);

/// A number of the unit, in bytes where it has a unit.
fn limit(unit: &str, name: &str) -> u64 {
    let line = unit.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
    let text = line.unwrap_or_else(|| panic!("{name} is not in the unit"));
    let (digits, times) = match text.strip_suffix('G') {
        Some(digits) => (digits, 1 << 30),
        None => (text, 1),
    };
    times * digits.parse::<u64>().expect("a number")
}

/// A daemon under limits, and where it answers.
fn limited(role: &str, text: &str, memory: u64, handles: u64) -> (Daemon, String) {
    let mut command = Command::new("prlimit");
    command.args([format!("--data={memory}"), format!("--nofile={handles}"), "--".into()]);
    command.arg(env!("CARGO_BIN_EXE_stictiond"));
    let text = format!("[server]\nlisten = '127.0.0.1:0'\n{text}");
    Daemon::serving(command, role, &written(&format!("limits-{role}"), &text), |_| {})
}

#[test]
fn all_at_once_under_the_limits_of_the_unit() {
    let unit = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/systemd/stictiond.service");
    let unit = fs::read_to_string(unit).expect("the unit");
    let (memory, tasks) = (limit(&unit, "MemoryMax"), limit(&unit, "TasksMax"));
    let handles = limit(&unit, "LimitNOFILE");
    let clear = Wire::Clear;
    // Only the parts of a fleet talk to NATS.
    let protocols: [(&str, String, &[Flood]); 8] = [
        ("modbus tcp", modbus("tcp"), &MODBUS),
        ("modbus rtu", modbus("rtu"), &RTU),
        ("opc ua", opcua(), &OPC_UA),
        ("mqtt", mqtt(clear), &MQTT),
        ("postgresql", postgresql(clear), &POSTGRESQL),
        ("mail", mail(clear), &MAIL),
        ("webhook", web(clear), &WEB),
        ("nats", nats(clear), &NATS),
    ];
    let rounds = protocols.iter().map(|(_, _, own)| own.len() + COMMON.len()).max().unwrap_or(0);
    let mut most = (0, 0);
    for round in 0..rounds {
        let (mut alone, mut part, mut peers) = (TOLD.to_string(), String::new(), Vec::new());
        for (at, (name, config, own)) in protocols.iter().enumerate() {
            let what = *own.iter().chain(&COMMON).nth(round % (own.len() + COMMON.len())).expect("one");
            let peer = peer(what, clear);
            // One device and one loop of each protocol that has some.
            let named = config.replace("'d'", &format!("'d{at}'")).replace("'A'", &format!("'A{at}'"));
            let text = if *name == "nats" { &mut part } else { &mut alone };
            *text += &named.replace("PORT", &peer.port.to_string());
            peers.push((name, what, peer));
        }
        let daemons = [("run", &alone), ("worker", &part)];
        let daemons = daemons.map(|(role, text)| limited(role, text, memory, handles));
        let threads = || daemons.iter().map(|(daemon, _)| daemon.status("Threads:")).max().unwrap_or(0);
        let began = Instant::now();
        // It gave the peer up, or something came to it.
        let met = |peer: &Peer| peer.ended.load(SeqCst) > 0 || peer.sent.load(SeqCst) > ON_THE_WAY;
        while let Some((name, what, _)) = peers.iter().find(|(_, _, peer)| !met(peer)) {
            assert!(began.elapsed() < PATIENT, "{name}, {}: it was never asked", what.name);
            most.1 = most.1.max(threads());
            thread::sleep(Duration::from_millis(20));
        }
        for (daemon, address) in &daemons {
            let answer = asked(address, "/healthz").unwrap_or_default();
            assert!(answer.starts_with("HTTP/1.1 200"), "round {round}: {answer:?}");
            most = (most.0.max(daemon.most()), most.1.max(threads()));
        }
    }
    let mib = most.0 as f64 / f64::from(1 << 20);
    println!(
        "{rounds} rounds of {} peers: {mib:.0} MiB of {} MiB, {} of {tasks} tasks",
        protocols.len(),
        memory >> 20,
        most.1
    );
    assert!(most.0 < memory && most.1 < tasks, "{most:?}");
}
