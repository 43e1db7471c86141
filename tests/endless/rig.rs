//! Peers that send without end, and daemons as processes of their own.

use super::parallel;
use serde_json::Value;
use std::fs;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::sync::mpsc::channel;
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::PrivateKeyDer;
use tokio_rustls::rustls::{ServerConfig, ServerConnection, StreamOwned};

/// What is promised (bytes).
pub const MOST: u64 = 32 << 20;
/// More than the system holds on the way (bytes).
pub const ON_THE_WAY: u64 = 12 << 20;
/// Bytes after which it is seen whether a daemon holds them: then more than the promise went to it, and 2 MiB to spare.
const ENOUGH: u64 = MOST + ON_THE_WAY + (2 << 20);
/// Daemons of a protocol at once: most of the time each waits before it connects again.
const AT_ONCE: usize = 3;
/// Bytes sent at once.
const PIECE: usize = 1 << 16;
/// Longest wait; reached only when the test has failed.
pub const PATIENCE: Duration = Duration::from_secs(240);

/// What a peer sends: first once, then again and again.
#[derive(Clone, Copy)]
pub struct Flood {
    pub name: &'static str,
    first: &'static [u8],
    then: &'static [u8],
}

pub const fn flood(name: &'static str, first: &'static [u8], then: &'static [u8]) -> Flood {
    Flood { name, first, then }
}

/// Says nothing: what a daemon takes at rest.
const NOTHING: Flood = flood("nothing", b"", b"");
pub const COMMON: [Flood; 2] = [flood("zeroes", b"", &[0]), flood("ones", b"", &[0xff])];

/// How a peer encrypts.
#[derive(Clone, Copy, PartialEq)]
pub enum Wire {
    /// Not at all.
    Clear,
    /// Everything, once it has heard so many bytes and said this.
    Tls(usize, &'static [u8]),
}

/// A certificate of this machine as a file, and what a server needs to show it.
fn certificate() -> &'static (PathBuf, Arc<ServerConfig>) {
    static MADE: OnceLock<(PathBuf, Arc<ServerConfig>)> = OnceLock::new();
    MADE.get_or_init(|| {
        let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_string()]).expect("a certificate");
        let file = folder().join("certificate.pem");
        fs::write(&file, made.cert.pem()).expect("writable");
        let key = PrivateKeyDer::try_from(made.signing_key.serialize_der()).expect("a key");
        let begun = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .expect("there are versions")
            .with_no_client_auth();
        let own = begun.with_single_cert(vec![made.cert.der().clone()], key).expect("they belong together");
        (file, Arc::new(own))
    })
}

/// A peer that counts connections that ended, and bytes that it got rid of.
pub struct Peer {
    pub port: u16,
    pub ended: Arc<AtomicU64>,
    pub sent: Arc<AtomicU64>,
}

pub fn peer(what: Flood, wire: Wire) -> Peer {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("bound").port();
    let (ended, sent) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let (count, bytes) = (ended.clone(), sent.clone());
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (count, bytes) = (count.clone(), bytes.clone());
            thread::spawn(move || {
                // It ends one way or another.
                let _ = met(stream, what, wire, &bytes);
                count.fetch_add(1, SeqCst);
            });
        }
    });
    Peer { port, ended, sent }
}

fn met(mut stream: TcpStream, what: Flood, wire: Wire, sent: &AtomicU64) -> io::Result<()> {
    let below = stream.try_clone()?;
    let Wire::Tls(hears, says) = wire else { return pour(&below, stream, what, sent) };
    below.set_read_timeout(Some(PATIENCE))?;
    stream.read_exact(&mut vec![0; hears])?;
    stream.write_all(says)?;
    let mut own = ServerConnection::new(certificate().1.clone()).map_err(io::Error::other)?;
    while own.is_handshaking() {
        own.complete_io(&mut stream)?;
    }
    pour(&below, StreamOwned::new(own, stream), what, sent)
}

fn pour(below: &TcpStream, mut stream: impl Read + Write, what: Flood, sent: &AtomicU64) -> io::Result<()> {
    if what.then.is_empty() {
        return Ok(());
    }
    let mut piece = what.then.repeat(PIECE / what.then.len());
    // Some answer a question; who asks none is sent to all the same.
    below.set_read_timeout(Some(Duration::from_millis(200)))?;
    let _ = stream.read(&mut [0; 1024]);
    stream.write_all(what.first)?;
    loop {
        let n = stream.write(&piece)?;
        sent.fetch_add(n as u64, SeqCst);
        piece.rotate_left(n % what.then.len());
    }
}

/// A folder of this process.
fn folder() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("endless-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("writable");
    folder
}

/// A secret as a file. It is written once: a daemon may be reading it while another is made.
fn secret() -> &'static Path {
    static MADE: OnceLock<PathBuf> = OnceLock::new();
    MADE.get_or_init(|| {
        let file = folder().join("secret");
        fs::write(&file, "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSwMfKQ9r8GKYqrTwjU\n").expect("writable");
        file
    })
}

/// A configuration as a file, with what it names beside it.
pub fn written(name: &str, text: &str) -> PathBuf {
    let path = folder().join(format!("{name}.toml"));
    let text = text.replace("SECRET", &secret().display().to_string());
    let text = text.replace("CERT", &certificate().0.display().to_string());
    fs::write(&path, text.replace("FOLDER", &folder().join(name).display().to_string())).expect("writable");
    path
}

pub struct Daemon(Child);

impl Daemon {
    /// One that says nothing.
    fn start(role: &str, config: &Path) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
        command.args([role, "--config"]).arg(config).env("RUST_LOG", "off");
        Self(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts"))
    }

    /// One that serves, and where. It is run by `command`, which ends in the program; every line of its log is heard.
    pub fn serving(
        mut command: Command,
        role: &str,
        config: &Path,
        mut heard: impl FnMut(&Value) + Send + 'static,
    ) -> (Self, String) {
        command.args([role, "--log-format", "json", "--config"]).arg(config).env("RUST_LOG", "info");
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("it starts");
        let log = BufReader::new(child.stderr.take().expect("piped"));
        let (daemon, (tell, told)) = (Self(child), channel());
        // A pipe that nobody reads would stop the daemon.
        thread::spawn(move || {
            for line in log.lines().map_while(Result::ok) {
                let line: Value = serde_json::from_str(&line).unwrap_or_default();
                if line["message"] == "serving" {
                    let _ = tell.send(line["address"].as_str().expect("an address").to_string());
                }
                heard(&line);
            }
        });
        let address = told.recv_timeout(PATIENCE).expect("it serves");
        (daemon, address)
    }

    /// Most memory it has taken so far (bytes).
    pub fn most(&self) -> u64 {
        self.status("VmHWM:") * 1024
    }

    /// A number that the system tells of it.
    pub fn status(&self, name: &str) -> u64 {
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

/// What a daemon answers, or nothing.
pub fn asked(address: &str, path: &str) -> Option<String> {
    let mut stream = TcpStream::connect(address).ok()?;
    let head = format!("GET {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n");
    stream.write_all(head.as_bytes()).ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    Some(answer)
}

/// Most memory until three connections to such a peer ended, or it has got rid of more than may be held and be on the way.
fn taken(name: &str, config: &str, wire: Wire, what: Flood) -> u64 {
    measured(&peer(what, wire), &format!("{name}-{}", what.name), config, ENOUGH)
}

/// What a daemon takes at rest, whose peer says nothing.
pub fn at_rest(name: &str, config: &str) -> u64 {
    taken(name, config, Wire::Clear, NOTHING)
}

/// Most memory until three connections to a peer ended, or it has got rid of so many bytes.
pub fn measured(peer: &Peer, name: &str, config: &str, enough: u64) -> u64 {
    let text =
        format!("[server]\nlisten = '127.0.0.1:0'\n{}", config.replace("PORT", &peer.port.to_string()));
    // Only the parts of a fleet talk to NATS.
    let role = if config.contains("[fleet]") { "worker" } else { "run" };
    let daemon = Daemon::start(role, &written(&name.replace(' ', "-"), &text));
    let began = Instant::now();
    // What is read and dropped need not end: then it is enough that more went than may be held.
    while peer.ended.load(SeqCst) < 3 && peer.sent.load(SeqCst) < enough {
        assert!(began.elapsed() < PATIENCE, "{name}: {} bytes were taken", peer.sent.load(SeqCst));
        thread::sleep(Duration::from_millis(20));
    }
    daemon.most()
}

/// What such peers make a daemon hold, beyond one that says nothing.
pub fn holds(name: &str, config: &str, wire: Wire, own: &[Flood]) {
    let all: Vec<Flood> = [&[NOTHING][..], own, &COMMON].concat();
    let held = parallel::on(AT_ONCE, &all, |what| taken(name, config, wire, *what));
    for (what, most) in all.iter().zip(&held).skip(1) {
        let grown = most.saturating_sub(held[0]);
        println!("{name:20} {:32} {:6.1} MiB beyond rest", what.name, grown as f64 / f64::from(1 << 20));
        assert!(grown < MOST, "{name}, {}: {grown} bytes beyond rest", what.name);
    }
}
