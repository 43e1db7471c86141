//! A run of one kind of loops: the plant in a process of its own, the daemon in this one, and looks at what it takes.

use super::kind::Kind;
use super::look::{Look, Metrics, bytes_of, bytes_written, cpu_s, get, kib};
use super::{Failed, asking, flag, option, plant, text};
use std::fs;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use stictiond::app::App;
use stictiond::config::{self, Config};
use stictiond::schedule::Clock;
use tokio::net::TcpListener;

/// Plant time at the start, 1 January 2026 (s since the Unix epoch).
const START: f64 = 1_767_225_600.0;
/// Looks at the counters in a period: the first one is not alike from beginning to end.
const LOOKS: f64 = 4.0;
/// Room for the store (MB): what it keeps is to be measured, not what it thins.
const MAX_MB: u64 = 1_000_000;
/// Times between two commits that `sync_ms` may be (ms).
const SYNC_MS: (f64, f64) = (10.0, 60_000.0);

/// What is asked for, as the head of this program describes it.
#[derive(Clone, Copy)]
pub struct Asked {
    pub loops: usize,
    pub speed: f64,
    pub plant_s: f64,
    pub period_s: f64,
    pub samples: usize,
    pub parallelism: usize,
    pub stores: bool,
}

impl Asked {
    pub fn of_arguments() -> Self {
        Self {
            loops: option("--loops", 2000.0) as usize,
            speed: option("--speed", 10.0),
            plant_s: option("--plant-s", 600.0),
            period_s: option("--period-s", 300.0),
            samples: option("--samples", 4096.0) as usize,
            parallelism: option("--parallelism", 1.0) as usize,
            stores: !flag("--no-store"),
        }
    }

    /// Time between two polls on the wall (ms): a second of plant time.
    pub fn poll_ms(&self) -> f64 {
        (1000.0 / self.speed).round()
    }

    /// Plant times of the looks (s), the last at the end and one at the end of the first period, if the run comes to that.
    fn looks(&self) -> Vec<f64> {
        let step = self.period_s.min(self.plant_s) / LOOKS;
        let end = self.plant_s - 0.01 * step;
        let before = (1_u32..).map(|at| f64::from(at) * step).take_while(|until| *until < end);
        before.chain([self.plant_s]).collect()
    }
}

/// What a run came to.
pub struct Measured {
    pub kind: Kind,
    pub asked: Asked,
    /// From the first, before anything was polled, to the end.
    pub looks: Vec<Look>,
    /// At the end.
    pub metrics: Metrics,
    /// Plant time for which it had run at least when the metrics were asked for (s).
    pub ran_s: f64,
    /// Memory before the first poll, and the most there was (KiB).
    pub idle_kib: f64,
    pub most_kib: f64,
    /// Time for the metrics, and for a page of 1,000 loops (s).
    pub scrape_s: f64,
    pub list_s: f64,
    /// Bytes of the store's files once the daemon has ended, and those that this process had written meanwhile.
    pub stored: Option<(f64, f64)>,
}

/// A folder that is removed when it is no longer needed.
struct Folder(PathBuf);

impl Folder {
    fn new() -> std::io::Result<Self> {
        let place = text("--folder").unwrap_or_else(|| env!("CARGO_TARGET_TMPDIR").to_string());
        let own = Self(Path::new(&place).join(format!("stictiond-bench-load-{}", std::process::id())));
        fs::create_dir_all(&own.0)?;
        Ok(own)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What is left is in a folder for what may be removed.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Runs the daemon for as long as is asked.
pub async fn run(kind: Kind, asked: Asked) -> Result<Measured, Failed> {
    let (mut plant, addresses) = plant_beside(kind, asked.speed)?;
    let folder = asked.stores.then(Folder::new).transpose()?;
    let app = Arc::new(App::build(
        configuration(&addresses, &asked, folder.as_ref())?,
        Clock::plant(START, asked.speed),
        App::diagnosis(),
    )?);
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let address = listener.local_addr()?;
    // `scripts/profile` waits for this line.
    println!("daemon {} at http://{address}, {} loops {}", std::process::id(), asked.loops, kind.words());
    let (idle_kib, written) = (kib("VmRSS:"), bytes_written());
    let (began, running) = (Instant::now(), app.clone());
    let daemon = tokio::spawn(async move { running.run(listener).await });
    let clients = (option("--rate", 0.0) > 0.0).then(|| ask(address, &asked)).transpose()?;
    let looks = look(address, &asked, began).await?;
    let ran_s = began.elapsed().as_secs_f64() * asked.speed;
    let before = Instant::now();
    let metrics = tokio::task::spawn_blocking(move || Metrics::of(address)).await??;
    let scrape_s = before.elapsed().as_secs_f64();
    let before = Instant::now();
    tokio::task::spawn_blocking(move || get(address, "/api/v1/loops?limit=1000")).await??;
    let list_s = before.elapsed().as_secs_f64();
    let most_kib = kib("VmHWM:");
    if let Some(mut clients) = clients {
        clients.wait()?;
    }
    app.stop().cancel();
    daemon.await??;
    drop(plant.stdin.take());
    plant.wait()?;
    let stored = folder.as_ref().map(|folder| (bytes_of(&folder.0), bytes_written() - written));
    Ok(Measured { kind, asked, looks, metrics, ran_s, idle_kib, most_kib, scrape_s, list_s, stored })
}

/// Begins the plant; ends when its standard input is closed.
fn plant_beside(kind: Kind, speed: f64) -> Result<(Child, Vec<String>), Failed> {
    let mut plant = Command::new(std::env::current_exe()?)
        .args(["--server", "--kind", kind.name(), "--speed", &speed.to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let output = plant.stdout.take().ok_or("the plant has no output")?;
    let mut lines = BufReader::new(output).lines();
    let mut addresses = Vec::new();
    for _ in 0..plant::DEVICES {
        addresses.push(lines.next().ok_or("the plant ended")??);
    }
    Ok((plant, addresses))
}

/// Looks at the counters until the end.
async fn look(address: SocketAddr, asked: &Asked, began: Instant) -> Result<Vec<Look>, Failed> {
    let mut looks = vec![Look { cpu_s: cpu_s(), ..Look::default() }];
    for until in asked.looks() {
        let due = Duration::try_from_secs_f64(until / asked.speed)?;
        tokio::time::sleep(due.saturating_sub(began.elapsed())).await;
        let seen = tokio::task::spawn_blocking(move || Look::now(address)).await??;
        looks.push(Look { until, at: began.elapsed().as_secs_f64() * asked.speed, ..seen });
    }
    Ok(looks)
}

/// Begins those who ask meanwhile.
fn ask(to: SocketAddr, asked: &Asked) -> std::io::Result<Child> {
    let wall = Duration::from_secs_f64(asked.plant_s / asked.speed);
    let numbers = [
        ("--listeners", option("--listeners", 200.0)),
        ("--rate", option("--rate", 50.0)),
        ("--loops", asked.loops as f64),
        ("--for-s", asking::lasting(wall)),
    ];
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["--asking", &to.to_string()]);
    numbers.iter().fold(&mut command, |command, (name, value)| command.args([*name, &value.to_string()]));
    command.spawn()
}

fn configuration(addresses: &[String], asked: &Asked, folder: Option<&Folder>) -> Result<Config, Failed> {
    let Asked { loops, period_s, samples, parallelism, .. } = *asked;
    let poll_ms = asked.poll_ms();
    let mut text = format!(
        "[server]\nmax_event_clients = 256\nmax_connections = 512\n\
         [schedule]\nperiod_s = {period_s:.1}\nparallelism = {parallelism}\n[history]\nsamples_per_tag = {samples}\n"
    );
    if let Some(Folder(folder)) = folder {
        // A commit for each second of plant time, as `sync_ms` has it by default.
        let sync_ms = poll_ms.clamp(SYNC_MS.0, SYNC_MS.1);
        text += &format!("[store]\nfolder = {folder:?}\nmax_mb = {MAX_MB}\nsync_ms = {sync_ms}\n");
    }
    text += &plant::sections(addresses, loops, poll_ms);
    config::parse("load.toml", &text)
        .map_err(|wrong| wrong.iter().map(|d| d.to_string() + "\n").collect::<String>().into())
}
