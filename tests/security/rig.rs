//! A daemon with a log-in, on loopback; its only device never answers.

use super::client::{Answer, ask};
use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use stictiond::access::file::change;
use stictiond::access::{Book, BookError, Cost, PasswordHash, Role, Roles};
use stictiond::app::App;
use stictiond::config::{self, Config};
use stictiond::schedule::Clock;
use tokio::net::TcpListener;
use tokio::time::{Instant, sleep};

/// A name that would act if it ever became markup.
pub const NASTY: &str = "<img src=x onerror=alert(1)>";
pub const PASSWORD: &str = "a password for tests";
/// Longest wait for something to come about; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(20);

pub struct Daemon {
    pub address: SocketAddr,
    pub app: Arc<App>,
    pub folder: PathBuf,
    /// A token of each role.
    tokens: Vec<(Role, String)>,
}

/// A folder of its own, empty.
pub fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("security-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("writable");
    path
}

/// A configuration with a log-in, and these lines in `[server]`.
pub fn text(folder: &Path, server: &str) -> String {
    let place = |name: &str| folder.join(name).display().to_string();
    let (book, log) = (place("access.json"), place("audit.log"));
    format!(
        "[server]\n{server}\n[access]\nfile = '{book}'\n[audit]\nfile = '{log}'\n\
         [[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n{}{}",
        control_loop("FIC1", 0),
        control_loop(NASTY, 4)
    )
}

fn control_loop(id: &str, at: u16) -> String {
    let tag = |role: &str, at: u16| {
        format!("[loop.{role}]\ndevice = 'd'\nregister = 'input'\naddress = {at}\ntype = 'f32'\n")
    };
    format!("[[loop]]\nid = '{id}'\n{}{}", tag("op", at), tag("pv", at + 2))
}

pub fn parsed(text: &str) -> Config {
    config::parse("test.toml", text).unwrap_or_else(|errors| panic!("{errors:?}"))
}

/// Seconds since the Unix epoch.
pub fn now() -> f64 {
    Clock::wall().now()
}

/// Changes the book beside a daemon, as the command line does.
pub fn book<T>(folder: &Path, what: impl FnOnce(&mut Book) -> Result<T, BookError>) -> T {
    let changed =
        change(&folder.join("access.json"), |book| Ok::<_, Box<dyn std::error::Error>>(what(book)?));
    changed.expect("changed")
}

/// Random enough for a test: each call gives other bytes.
pub fn bytes(n: u8) -> [u8; 38] {
    let mut bytes = [n; 38];
    bytes[7] = 255 - n;
    bytes
}

/// One user and one token of each role, named like it.
fn everybody(folder: &Path) -> Vec<(Role, String)> {
    let cheap = Cost { memory_kib: 8, passes: 1 };
    book(folder, |book| {
        let mut tokens = Vec::new();
        for (n, role) in Role::ALL.into_iter().enumerate() {
            let hash = PasswordHash::of(PASSWORD, [n as u8; 16], cheap).expect("a cost");
            book.add_user(role.as_str(), Roles::of(&[role]), hash)?;
            let ends = (now(), now() + 3600.0);
            let made = book.create_token(role.as_str(), Roles::of(&[role]), ends, bytes(n as u8))?;
            tokens.push((role, made.text));
        }
        Ok(tokens)
    })
}

/// A daemon that runs, with these lines in `[server]`, after `adjust` had its way with the configuration.
pub async fn daemon_with(name: &str, server: &str, adjust: impl FnOnce(&mut Config)) -> Daemon {
    let folder = folder(name);
    let tokens = everybody(&folder);
    let mut config = parsed(&text(&folder, server));
    adjust(&mut config);
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    let app = Arc::new(App::build(config, Clock::wall(), App::diagnosis()).expect("built"));
    let running = app.clone();
    tokio::spawn(async move { running.run(listener).await });
    Daemon { address, app, folder, tokens }
}

pub async fn daemon(name: &str) -> Daemon {
    daemon_with(name, "", |_| {}).await
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.app.stop().cancel();
    }
}

/// What a browser holds after a log-in.
pub struct Session {
    /// `name=value` of the cookie.
    pub cookie: String,
    pub csrf: String,
}

impl Daemon {
    pub async fn ask(&self, what: &str, headers: &[&str], body: &str) -> Answer {
        ask(self.address, what, headers, body).await
    }

    /// The header line of the token of a role.
    pub fn token(&self, role: Role) -> String {
        let (_, token) = self.tokens.iter().find(|(own, _)| *own == role).expect("one of each");
        format!("authorization: Bearer {token}")
    }

    pub async fn as_role(&self, role: Role, what: &str) -> Answer {
        self.ask(what, &[&self.token(role)], "").await
    }

    pub async fn try_password(&self, user: &str, password: &str) -> Answer {
        let body = serde_json::json!({"user": user, "password": password}).to_string();
        self.ask("POST /api/v1/session", &[], &body).await
    }

    pub async fn log_in(&self, user: &str) -> Session {
        let answer = self.try_password(user, PASSWORD).await;
        assert_eq!(answer.status, 200, "{answer:?}");
        let cookie = answer.header("set-cookie").and_then(|line| line.split(';').next()).expect("a cookie");
        let csrf = answer.json()["csrf"].as_str().expect("a word").to_string();
        Session { cookie: cookie.to_string(), csrf }
    }

    /// Asks with a cookie and, where there is one, the word that changes need.
    pub async fn with_cookie(&self, what: &str, cookie: &str, csrf: Option<&str>) -> Answer {
        let cookie = format!("cookie: {cookie}");
        let csrf = csrf.map(|word| format!("x-csrf-token: {word}"));
        let headers: Vec<&str> = [Some(cookie.as_str()), csrf.as_deref()].into_iter().flatten().collect();
        self.ask(what, &headers, "").await
    }
}

/// Asks again until the status is this one.
pub async fn until<F: Future<Output = Answer>>(status: u16, ask: impl Fn() -> F) -> Answer {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let answer = ask().await;
        if answer.status == status {
            return answer;
        }
        assert!(Instant::now() < deadline, "never {status}, still {answer:?}");
        sleep(Duration::from_millis(20)).await;
    }
}
