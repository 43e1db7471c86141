//! Every such peer at once, and the daemon under the limits of the unit in deploy/. Where memory ends is set by the limit on
//! what a process may write to (`RLIMIT_DATA`), which counts what was asked for and never touched too: it ends no later than
//! systemd's. Tasks are counted, because the limit on them counts those of all processes of a user.

use super::{COMMON, Daemon, Flood, MODBUS, MQTT, OPC_UA, POSTGRESQL, RTU, peer};
use super::{flood, modbus, mqtt, opcua, postgresql};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering::SeqCst;
use std::thread;
use std::time::{Duration, Instant};

const MAIL: [Flood; 3] = [
    flood("a greeting without a line end", b"220 ", b"a"),
    flood("lines without end", b"", b"220-still\r\n"),
    flood("an answer without end", b"220 here\r\n", b"250-more\r\n"),
];
const WEB: [Flood; 5] = [
    flood("a status line without end", b"HTTP/1.1 ", b"2"),
    flood("a head without end", b"HTTP/1.1 200 OK\r\n", b"x-a: b\r\n"),
    flood("a body without end", b"HTTP/1.1 500 No\r\n\r\n", b"a"),
    flood("chunks without end", b"HTTP/1.1 500 No\r\ntransfer-encoding: chunked\r\n\r\n", b"1\r\na\r\n"),
    flood("preliminary answers", b"", b"HTTP/1.1 103 Early Hints\r\nx: y\r\n\r\n"),
];
/// More than the system holds on the way (bytes): so much went to the daemon, or it gave the peer up.
const ENOUGH: u64 = 12 << 20;
/// All at once take longer than one by one.
const PATIENT: Duration = Duration::from_secs(240);
const PACE: &str =
    "pace = { wait_s = 0.05, interval_s = 0.0 }\nretry = { first_s = 0.05, longest_s = 0.1 }\n";

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
fn limited(text: &str, memory: u64, handles: u64) -> (Daemon, String) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("endless-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("writable");
    let (path, secret) = (folder.join("limits.toml"), folder.join("secret"));
    fs::write(&secret, "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSwMfKQ9r8GKYqrTwjU\n").expect("writable");
    let text = text.replace("SECRET", &secret.display().to_string());
    fs::write(&path, text.replace("FOLDER", &folder.join("spool").display().to_string())).expect("writable");
    let mut command = Command::new("prlimit");
    command.args([format!("--data={memory}"), format!("--nofile={handles}"), "--".into()]);
    command.arg(env!("CARGO_BIN_EXE_stictiond")).args(["run", "--log-format", "json", "--config"]).arg(path);
    command.env("RUST_LOG", "info").stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("prlimit is there");
    let mut log = BufReader::new(child.stderr.take().expect("piped")).lines().map_while(Result::ok);
    let served = log.find(|line| line.contains("\"serving\"")).expect("it serves");
    // A pipe that nobody reads would stop the daemon.
    thread::spawn(move || log.for_each(drop));
    let line: serde_json::Value = serde_json::from_str(&served).expect("JSON");
    (Daemon(child), line["address"].as_str().expect("an address").to_string())
}

/// What it answers, or nothing.
fn asked(address: &str) -> Option<String> {
    let mut stream = TcpStream::connect(address).ok()?;
    let head = format!("GET /healthz HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n");
    stream.write_all(head.as_bytes()).ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    Some(answer)
}

#[test]
fn all_at_once_under_the_limits_of_the_unit() {
    let unit = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/systemd/stictiond.service");
    let unit = fs::read_to_string(unit).expect("the unit");
    let (memory, tasks) = (limit(&unit, "MemoryMax"), limit(&unit, "TasksMax"));
    let handles = limit(&unit, "LimitNOFILE");
    let mail = format!(
        "[[notify.smtp]]\nname = 'm'\naddress = '127.0.0.1:PORT'\nsecurity = 'none'\ntimeout_s = 12.0\n\
         from = 's@plant.example'\nto = ['a@plant.example']\n{PACE}"
    );
    let web = format!(
        "[[notify.webhook]]\nname = 'w'\nurl = 'http://127.0.0.1:PORT/'\nsecret_file = 'SECRET'\n\
         timeout_s = 3.0\n{PACE}"
    );
    let protocols: [(&str, String, &[Flood]); 7] = [
        ("modbus tcp", modbus("tcp"), &MODBUS),
        ("modbus rtu", modbus("rtu"), &RTU),
        ("opc ua", opcua(), &OPC_UA),
        ("mqtt", mqtt(), &MQTT),
        ("postgresql", postgresql(), &POSTGRESQL),
        ("mail", mail, &MAIL),
        ("webhook", web, &WEB),
    ];
    let rounds = protocols.iter().map(|(_, _, own)| own.len() + COMMON.len()).max().unwrap_or(0);
    let mut most = (0, 0);
    for round in 0..rounds {
        let mut text =
            "[server]\nlisten = '127.0.0.1:0'\n[alarm.collector_down]\nafter_s = 1.0\n".to_string();
        let mut peers = Vec::new();
        for (at, (name, config, own)) in protocols.iter().enumerate() {
            let what = *own.iter().chain(&COMMON).nth(round % (own.len() + COMMON.len())).expect("one");
            let peer = peer(what);
            // One device and one loop of each protocol that has some.
            let named = config.replace("'d'", &format!("'d{at}'")).replace("'A'", &format!("'A{at}'"));
            text += &named.replace("PORT", &peer.port.to_string());
            peers.push((name, what, peer));
        }
        let (daemon, address) = limited(&text, memory, handles);
        let began = Instant::now();
        let met = |peer: &super::Peer| peer.ended.load(SeqCst) > 0 || peer.sent.load(SeqCst) > ENOUGH;
        while let Some((name, what, _)) = peers.iter().find(|(_, _, peer)| !met(peer)) {
            assert!(began.elapsed() < PATIENT, "{name}, {}: it was never asked", what.name);
            most.1 = most.1.max(daemon.status("Threads:"));
            thread::sleep(Duration::from_millis(20));
        }
        let answer = asked(&address).unwrap_or_default();
        assert!(answer.starts_with("HTTP/1.1 200"), "round {round}: {answer:?}");
        most = (most.0.max(daemon.most()), most.1.max(daemon.status("Threads:")));
    }
    let mib = most.0 as f64 / f64::from(1 << 20);
    println!("{rounds} rounds of 7 peers: {mib:.0} MiB of {} MiB, {} of {tasks} tasks", memory >> 20, most.1);
    assert!(most.0 < memory && most.1 < tasks, "{most:?}");
}
