//! Peers that send without end, whatever is asked of them: no client of ours keeps what it cannot use. The daemon is a process
//! of its own, and its memory is what the system says of it.

#[path = "endless/limits.rs"]
mod limits;

use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::thread;
use std::time::{Duration, Instant};

/// What is promised (bytes).
const MOST: u64 = 32 << 20;
/// Bytes sent at once.
const PIECE: usize = 1 << 16;
/// Longest wait; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(60);

/// What a peer sends: first once, then again and again.
#[derive(Clone, Copy)]
struct Flood {
    name: &'static str,
    first: &'static [u8],
    then: &'static [u8],
}

const fn flood(name: &'static str, first: &'static [u8], then: &'static [u8]) -> Flood {
    Flood { name, first, then }
}

/// Says nothing: what a daemon takes at rest.
const NOTHING: Flood = flood("nothing", b"", b"");
const COMMON: [Flood; 2] = [flood("zeroes", b"", &[0]), flood("ones", b"", &[0xff])];

/// A peer that counts connections that ended, and bytes that it got rid of.
struct Peer {
    port: u16,
    ended: Arc<AtomicU64>,
    sent: Arc<AtomicU64>,
}

fn peer(what: Flood) -> Peer {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("bound").port();
    let (ended, sent) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let (count, bytes) = (ended.clone(), sent.clone());
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (count, bytes) = (count.clone(), bytes.clone());
            thread::spawn(move || {
                pour(stream, what, &bytes);
                count.fetch_add(1, SeqCst);
            });
        }
    });
    Peer { port, ended, sent }
}

fn pour(mut stream: TcpStream, what: Flood, sent: &AtomicU64) {
    if what.then.is_empty() {
        return;
    }
    let mut piece = what.then.repeat(PIECE / what.then.len());
    // Some answer a question; who asks none is sent to all the same.
    let _ = stream.set_read_timeout(Some(Duration::from_millis(200)));
    let _ = stream.read(&mut [0; 1024]);
    if stream.write_all(what.first).is_err() {
        return;
    }
    while let Ok(n) = stream.write(&piece) {
        sent.fetch_add(n as u64, SeqCst);
        piece.rotate_left(n % what.then.len());
    }
}

struct Daemon(Child);

impl Daemon {
    fn start(name: &str, text: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("endless-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("writable");
        let path: PathBuf = folder.join(format!("{name}.toml"));
        fs::write(&path, text.replace("FOLDER", &folder.join(name).display().to_string())).expect("writable");
        let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
        command.args(["run", "--config"]).arg(path).env("RUST_LOG", "off");
        Self(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts"))
    }

    /// Most memory it has taken so far (bytes).
    fn most(&self) -> u64 {
        self.status("VmHWM:") * 1024
    }

    /// A number that the system tells of it.
    fn status(&self, name: &str) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.0.id())).expect("it runs");
        let line = status.lines().find(|line| line.starts_with(name)).expect("a line");
        line.split_whitespace().nth(1).and_then(|number| number.parse().ok()).expect("a number")
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Most memory until three connections to such a peer ended, or it has got rid of twice what may be held.
fn taken(name: &str, config: &str, what: Flood) -> u64 {
    let peer = peer(what);
    let text =
        format!("[server]\nlisten = '127.0.0.1:0'\n{}", config.replace("PORT", &peer.port.to_string()));
    let daemon = Daemon::start(&format!("{name}-{}", what.name.replace(' ', "-")), &text);
    let began = Instant::now();
    // What is read and dropped need not end: then it is enough that more went than may be held.
    while peer.ended.load(SeqCst) < 3 && peer.sent.load(SeqCst) < 2 * MOST {
        assert!(
            began.elapsed() < PATIENCE,
            "{name}, {}: {} bytes were taken",
            what.name,
            peer.sent.load(SeqCst)
        );
        thread::sleep(Duration::from_millis(20));
    }
    daemon.most()
}

fn holds(name: &str, config: &str, own: &[Flood]) {
    let rest = taken(name, config, NOTHING);
    for what in own.iter().chain(&COMMON) {
        let grown = taken(name, config, *what).saturating_sub(rest);
        println!("{name:12} {:32} {:6.1} MiB beyond rest", what.name, grown as f64 / f64::from(1 << 20));
        assert!(grown < MOST, "{name}, {}: {grown} bytes beyond rest", what.name);
    }
}

fn control_loop(of_tag: impl Fn(usize) -> String) -> String {
    format!(
        "[[loop]]\nid = 'A'\n[loop.op]\ndevice = 'd'\n{}[loop.pv]\ndevice = 'd'\n{}",
        of_tag(0),
        of_tag(2)
    )
}

fn modbus(framing: &str) -> String {
    let tag = |at: usize| format!("register = 'input'\naddress = {at}\ntype = 'f32'\n");
    format!(
        "[[modbus]]\nname = 'd'\naddress = '127.0.0.1:PORT'\nframing = '{framing}'\ntimeout_ms = 1000\naddress_base = 0\n{}",
        control_loop(tag)
    )
}

const MODBUS: [Flood; 1] = [flood("heads of the longest", b"", &[0, 1, 0, 0, 0xff, 0xff, 1, 4])];

#[test]
fn modbus_over_tcp() {
    holds("modbus tcp", &modbus("tcp"), &MODBUS);
}

const RTU: [Flood; 1] = [flood("answers of 255 bytes", b"", &[1, 4, 255])];

#[test]
fn modbus_rtu_over_tcp() {
    holds("modbus rtu", &modbus("rtu"), &RTU);
}

const ACK: &[u8] =
    &[b'A', b'C', b'K', b'F', 28, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
const OPC_UA: [Flood; 4] = [
    flood("a length of 4 GB", b"ACKF\xf0\xff\xff\xff", &[7]),
    flood("a chunk of 4 GB after the greeting", ACK, b"MSGF\xf0\xff\xff\xff"),
    flood("chunks that never end", ACK, b"MSGC\x10\0\0\0\0\0\0\0\0\0\0\0"),
    flood("acknowledgements", ACK, ACK),
];

fn opcua() -> String {
    format!(
        "[[opcua]]\nname = 'd'\nurl = 'opc.tcp://127.0.0.1:PORT/'\nsecurity_policy = 'None'\ntimeout_ms = 4000\n\
         reconnect_max_ms = 100\n{}",
        control_loop(|at| format!("node = 'ns=2;i={at}'\n"))
    )
}

#[test]
fn opc_ua() {
    holds("opc ua", &opcua(), &OPC_UA);
}

const MQTT: [Flood; 3] = [
    flood("a packet of 268 MB", &[0x20, 2, 0, 0, 0x30, 0xff, 0xff, 0xff, 0x7f], &[0, 1, b'a']),
    flood("messages", &[0x20, 2, 0, 0], &[0x30, 5, 0, 1, b'a', b'1', b'2']),
    flood("a length that never ends", b"", &[0x30, 0x80]),
];

fn mqtt() -> String {
    format!(
        "[[mqtt]]\nname = 'd'\naddress = '127.0.0.1:PORT'\ntimeout_s = 4\nreconnect_max_ms = 500\n{}",
        control_loop(|at| format!("topic = 'a/{at}'\n"))
    )
}

#[test]
fn mqtt_brokers() {
    holds("mqtt", &mqtt(), &MQTT);
}

const LET_IN: &[u8] = b"R\0\0\0\x08\0\0\0\0Z\0\0\0\x05I";
const POSTGRESQL: [Flood; 5] = [
    flood("a message of 2 GB before log-in", b"R\x7f\xff\xff\xf0", &[0]),
    flood("settings without end", b"R\0\0\0\x08\0\0\0\0", b"S\0\0\0\x0ca\0b\0c\0d\0"),
    flood("notices without end", LET_IN, b"N\0\0\0\x0cSFATAL\0\0"),
    flood("rows without end", LET_IN, b"D\0\0\0\x06\0\0"),
    flood("a row of 2 GB", LET_IN, b"D\x7f\xff\xff\xf0\0\0"),
];

fn postgresql() -> String {
    "[store]\nfolder = 'FOLDER'\nurl = 'postgres://stictiond@127.0.0.1:PORT/history'\n".to_string()
}

#[test]
fn postgresql_servers() {
    let plant = modbus("tcp").replace("PORT", "9");
    holds("postgresql", &(postgresql() + &plant), &POSTGRESQL);
}
