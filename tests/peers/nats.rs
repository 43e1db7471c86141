//! nats-server from Debian in a folder of its own, on ports that it chooses, gone with the test.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Far longer than a start takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);
const MISSING: &str = "nats-server is not installed: run scripts/peers once, then the tests again";

/// Debian's program.
fn program() -> Command {
    let debian = Path::new("/usr/sbin/nats-server");
    Command::new(if debian.exists() { debian } else { Path::new("nats-server") })
}

/// Whether it takes a configuration, and what it says of it; nothing is started.
pub fn check(config: &Path) -> (bool, String) {
    let output = program().arg("-t").arg("-c").arg(config).output().expect(MISSING);
    let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.success(), said.into_owned())
}

/// More than the streams of a fleet ask for (GB). Without it a server takes three quarters of what is free on its disk, and the tests
/// would depend on that.
pub const ROOM: u64 = 64;

/// What keeps streams in this folder, with so much room (GB).
pub fn jetstream(folder: &Path, room: u64) -> String {
    let folder = folder.join("js");
    format!("jetstream {{ domain: stictiond, store_dir: {folder:?}, max_file_store: {room}GB }}\n")
}

/// A server, running or stopped, that keeps its ports.
pub struct Nats {
    folder: PathBuf,
    config: PathBuf,
    process: Option<Child>,
    /// For clients, and for leaf nodes.
    ports: [u16; 2],
}

impl Nats {
    /// The server that keeps the streams.
    pub fn hub() -> Self {
        Self::with("hub", |folder, [clients, leaves]| {
            format!(
                "server_name: hub\nlisten: 127.0.0.1:{clients}\n{}\
                 leafnodes {{ listen: 127.0.0.1:{leaves} }}\n",
                jetstream(folder, ROOM)
            )
        })
    }

    /// A server at a site, which passes everything on to the hub.
    pub fn leaf(hub: &Nats) -> Self {
        let to = hub.leaf_port();
        Self::with("leaf", |_, [clients, _]| {
            format!(
                "server_name: leaf-{clients}\nlisten: 127.0.0.1:{clients}\n\
                 leafnodes {{ reconnect: 1, remotes: [ {{ url: \"nats://127.0.0.1:{to}\" }} ] }}\n"
            )
        })
    }

    /// One with a configuration of its own: of its folder, and of ports for clients and for leaf nodes.
    pub fn with(name: &str, text: impl FnOnce(&Path, [u16; 2]) -> String) -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder =
            std::env::temp_dir().join(format!("stictiond-nats-{name}-{}-{number}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("writable");
        let free = || {
            let socket = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
            socket.local_addr().expect("bound").port()
        };
        let ports = [free(), free()];
        let config = folder.join("nats.conf");
        fs::write(&config, text(&folder, ports)).expect("writable");
        let mut server = Self { folder, config, process: None, ports };
        server.begin();
        server
    }

    /// Where clients connect to.
    pub fn url(&self) -> String {
        format!("nats://127.0.0.1:{}", self.ports[0])
    }

    /// Where leaf nodes connect to.
    pub fn leaf_port(&self) -> u16 {
        self.ports[1]
    }

    /// Where it keeps what it has.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The process that runs.
    pub fn pid(&self) -> String {
        self.process.as_ref().map(|process| process.id().to_string()).unwrap_or_default()
    }

    /// Starts it, again or for the first time.
    pub fn begin(&mut self) {
        let log =
            fs::File::options().append(true).create(true).open(self.folder.join("log")).expect("writable");
        let process = program().arg("-c").arg(&self.config).stdout(Stdio::null()).stderr(log).spawn();
        self.process = Some(process.expect(MISSING));
        let begun = Instant::now();
        while std::net::TcpStream::connect(("127.0.0.1", self.ports[0])).is_err() {
            assert!(begun.elapsed() < PATIENCE, "{}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Kills it; what it has stored stays.
    pub fn end(&mut self) {
        if let Some(mut process) = self.process.take() {
            process.kill().ok();
            process.wait().ok();
        }
    }

    /// Has it end by itself, with everything on its disk.
    pub fn stop(&mut self) {
        if let Some(mut process) = self.process.take() {
            let asked = Command::new("kill").arg(process.id().to_string()).status();
            assert!(asked.is_ok_and(|status| status.success()), "{}", self.log());
            process.wait().expect("it ends");
        }
    }

    /// What it has said so far.
    pub fn log(&self) -> String {
        fs::read_to_string(self.folder.join("log")).unwrap_or_default()
    }
}

impl Drop for Nats {
    fn drop(&mut self) {
        self.end();
        fs::remove_dir_all(&self.folder).ok();
    }
}
