//! PostgreSQL from Debian in a folder of its own, run by nobody in particular, gone with the test.

use std::fs;
use std::io;
use std::net::TcpListener;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use stictiond::store::Config;

/// Far longer than a start takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);
/// PostgreSQL refuses to be root; this is nobody.
const NOBODY: u32 = 65534;

/// A cluster, running or stopped.
pub struct Cluster {
    pub folder: PathBuf,
    server: Option<Child>,
    /// Where it listens on the loopback; on a socket in its folder only, when there is none.
    port: Option<u16>,
    /// Whether each commit waits for the disk; what is killed in tests are processes, not machines.
    durable: bool,
}

/// Where Debian has the programs of its newest version.
fn program(name: &str) -> PathBuf {
    let versions = fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> =
        versions.map(|version| version.path().join("bin").join(name)).filter(|path| path.exists()).collect();
    found.sort();
    found.pop().expect("PostgreSQL is not installed: run scripts/peers once, then the tests again")
}

/// A command that is not root's.
fn unprivileged(program: &Path) -> Command {
    let mut command = Command::new(program);
    if fs::metadata("/proc/self").expect("Linux").uid() == 0 {
        command.uid(NOBODY).gid(NOBODY);
    }
    command.current_dir("/").env_remove("PGDATA").env_remove("PGPORT").env_remove("PGHOST");
    command
}

impl Cluster {
    /// A new one on a socket in its folder; with certificate and key (PEM) on the loopback, encrypted, and asking for a
    /// password. When `durable`, each commit waits for the disk.
    pub fn with(tls: Option<(&str, &str)>, durable: bool) -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let name = format!("stictiond-pg-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let folder = std::env::temp_dir().join(name);
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("writable");
        let own = |path: &Path| {
            let root = fs::metadata("/proc/self").expect("Linux").uid() == 0;
            let given = if root { chown(path, Some(NOBODY), Some(NOBODY)) } else { Ok(()) };
            given.expect("may be given away");
        };
        own(&folder);
        let data = folder.join("data");
        let made = unprivileged(&program("initdb"))
            .args(["-U", "stictiond", "-A", "trust", "-N", "--no-locale", "-E", "UTF8", "-D"])
            .arg(&data)
            .output()
            .expect("initdb runs");
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let mut cluster = Self { folder, server: None, port: None, durable };
        if let Some((certificate, key)) = tls {
            for (name, text) in [("server.crt", certificate), ("server.key", key)] {
                let path = data.join(name);
                fs::write(&path, text).expect("writable");
                fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).expect("ours");
                own(&path);
            }
            let door = "hostssl all all 127.0.0.1/32 scram-sha-256\nlocal all all trust\n";
            fs::write(data.join("pg_hba.conf"), door).expect("writable");
            let free = TcpListener::bind("127.0.0.1:0").expect("a free port");
            cluster.port = Some(free.local_addr().expect("bound").port());
        }
        cluster.begin();
        cluster
    }

    /// Starts it, anew or again, and waits until it answers.
    pub fn begin(&mut self) {
        let mut arguments = vec!["-k".to_string(), self.folder.display().to_string()];
        let (listen, port) = match self.port {
            Some(port) => ("127.0.0.1", port),
            None => ("", 5432),
        };
        let mut set = |what: String| arguments.extend(["-c".to_string(), what]);
        set(format!("listen_addresses={listen}"));
        set(format!("port={port}"));
        set(format!("ssl={}", if self.port.is_some() { "on" } else { "off" }));
        set(format!("fsync={}", if self.durable { "on" } else { "off" }));
        set("max_connections=20".into());
        // When the test ends, however it does, the pipe ends, and with it the server.
        let watch =
            "exec 3<&0; \"$@\" <&- 3<&- >/dev/null 2>\"$LOG\" & read -r _ <&3; kill -QUIT $!; wait $!";
        let server = unprivileged(Path::new("sh"))
            .args(["-c", watch, "sh"])
            .arg(program("postgres"))
            .arg("-D")
            .arg(self.folder.join("data"))
            .args(arguments)
            .env("LOG", self.folder.join("log"))
            .stdin(Stdio::piped())
            .spawn()
            .expect("sh runs");
        self.server = Some(server);
        let begun = Instant::now();
        while let Err(error) = self.client() {
            let log = fs::read_to_string(self.folder.join("log")).unwrap_or_default();
            assert!(begun.elapsed() < PATIENCE, "PostgreSQL does not answer: {error}\n{log}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Ends it at once, as a power failure would.
    pub fn end(&mut self) {
        if let Some(mut server) = self.server.take() {
            drop(server.stdin.take());
            server.wait().expect("it is gone");
        }
    }

    /// Somebody who asks it directly.
    pub fn client(&self) -> Result<postgres::Client, postgres::Error> {
        let mut config = postgres::Config::new();
        config.host_path(&self.folder).port(self.port.unwrap_or(5432)).user("stictiond").dbname("postgres");
        config.connect(postgres::NoTls)
    }

    /// What a configuration says of it; `folder` is the spool's.
    pub fn config(&self, folder: &Path) -> Config {
        let url = match self.port {
            Some(port) => format!("postgres://stictiond@localhost:{port}/postgres?hostaddr=127.0.0.1"),
            None => {
                let socket = self.folder.display().to_string().replace('/', "%2F");
                format!("postgres://stictiond@{socket}:5432/postgres")
            }
        };
        Config { url: Some(url), ..Config::new(folder) }
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        self.end();
        let gone: io::Result<()> = fs::remove_dir_all(&self.folder);
        drop(gone);
    }
}
