//! What a daemon takes, as the system and the daemon itself tell it.

use super::Failed;
use super::daemon::{ALLOCATED, PANIC};
use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Longest start of the daemon, and longest answer.
const PATIENCE: Duration = Duration::from_secs(30);

/// Counters of the store that stay 0 where nothing is lost.
const LOSSES: [&str; 6] =
    ["lost_samples", "dropped_samples", "refused_samples", "dropped_rows", "damaged_chunks", "lost_states"];

/// One look.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// Since the start (s).
    pub t: f64,
    /// Resident memory (MB).
    pub memory: f64,
    /// Allocated and not freed, by what is not C (MB).
    pub allocated: f64,
    /// What the rings may take (MB).
    pub rings: f64,
    /// Open files and sockets.
    pub handles: f64,
    pub threads: f64,
    /// The store's folder (MB).
    pub disk: f64,
    /// Until a page of 100 loops, one loop, and all metrics are answered (ms).
    pub list: f64,
    pub one: f64,
    pub metrics: f64,
    /// Counters.
    pub polls: f64,
    pub missed: f64,
    pub overran: f64,
    pub runs: f64,
    pub skipped: f64,
    pub panicked: f64,
    /// Panics on purpose, as the process says before each.
    pub meant: f64,
    /// Alarms that are not normal.
    pub alarms: f64,
    /// What waits on disk for the database (MB).
    pub waits: f64,
    /// Samples and rows that are in no store, or were not readable there.
    pub lost: f64,
}

/// What the daemon's process says of itself.
#[derive(Default)]
pub struct Said {
    panics: AtomicU64,
    allocated: AtomicU64,
}

impl Said {
    /// Hears a line.
    pub fn hear(&self, line: &str) {
        if line == PANIC {
            self.panics.fetch_add(1, Relaxed);
        } else if let Some(Ok(bytes)) = line.strip_prefix(ALLOCATED).map(str::parse::<u64>) {
            self.allocated.store(bytes, Relaxed);
        }
    }
}

/// The daemon that is looked at.
pub struct Daemon {
    pub said: Arc<Said>,
    pub pid: u32,
    pub address: SocketAddr,
    pub store: PathBuf,
}

impl Daemon {
    /// Waits until it answers.
    pub async fn answers(&self) -> Result<(), Failed> {
        let began = Instant::now();
        while began.elapsed() < PATIENCE {
            if self.get("/healthz").await.is_ok() {
                return Ok(());
            }
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        Err("the daemon does not answer".into())
    }

    /// Waits until the store works and nothing waits; whether it came to that.
    pub async fn settles(&self, patience: Duration) -> Result<bool, Failed> {
        let began = Instant::now();
        while began.elapsed() < patience {
            if self.get("/healthz").await?.1.contains("\"store\":{\"state\":\"working\"") {
                return Ok(true);
            }
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        Ok(false)
    }

    pub async fn look(&self, began: Instant, number: usize, loops: usize) -> Result<Sample, Failed> {
        let (list, _) = self.get("/api/v1/loops?limit=100").await?;
        let (one, _) = self.get(&format!("/api/v1/loops/L{:04}", 37 * number % (loops - 1))).await?;
        let (metrics, text) = self.get("/metrics").await?;
        let device = |event: &str| sum(&text, "stictiond_device_events_total", &format!("event=\"{event}\""));
        let kept = |event: &str| sum(&text, "stictiond_store_events_total", &format!("event=\"{event}\""));
        let ended = |outcome: &str| sum(&text, "stictiond_runs_total", &format!("outcome=\"{outcome}\""));
        Ok(Sample {
            t: began.elapsed().as_secs_f64(),
            memory: self.kib("VmRSS:")? * 1024.0 / 1e6,
            allocated: self.said.allocated.load(Relaxed) as f64 / 1e6,
            rings: sum(&text, "stictiond_history_memory_bytes", "") / 1e6,
            handles: fs::read_dir(format!("/proc/{}/fd", self.pid))?.count() as f64,
            threads: self.kib("Threads:")?,
            disk: size(&self.store) as f64 / 1e6,
            list,
            one,
            metrics,
            polls: device("polls"),
            missed: device("missed_polls"),
            overran: device("overruns"),
            runs: ended("diagnosed"),
            skipped: sum(&text, "stictiond_runs_skipped_total", ""),
            panicked: ended("panicked"),
            meant: self.said.panics.load(Relaxed) as f64,
            alarms: sum(&text, "stictiond_alarm_state{", ""),
            waits: sum(&text, "stictiond_store_spool_bytes", "") / 1e6,
            lost: LOSSES.iter().map(|event| kept(event)).sum(),
        })
    }

    /// Has it load its configuration anew.
    pub fn hang_up(&self) -> Result<(), Failed> {
        self.signal("-HUP")
    }

    /// Has it end.
    pub fn terminate(&self) -> Result<(), Failed> {
        self.signal("-TERM")
    }

    fn signal(&self, signal: &str) -> Result<(), Failed> {
        let sent = Command::new("kill").args([signal, &self.pid.to_string()]).status()?;
        if sent.success() { Ok(()) } else { Err(format!("kill {signal}: {sent}").into()) }
    }

    /// How long it took (ms), and the answer.
    async fn get(&self, path: &str) -> Result<(f64, String), Failed> {
        let began = Instant::now();
        let head = format!("GET {path} HTTP/1.1\r\nhost: {}\r\nconnection: close\r\n\r\n", self.address);
        let asked = async {
            let mut stream = TcpStream::connect(self.address).await?;
            stream.write_all(head.as_bytes()).await?;
            let mut answer = Vec::new();
            stream.read_to_end(&mut answer).await?;
            std::io::Result::Ok(answer)
        };
        let answer = tokio::time::timeout(PATIENCE, asked).await??;
        let text = String::from_utf8_lossy(&answer).into_owned();
        if !text.starts_with("HTTP/1.1 200") {
            return Err(format!("{path}: {}", text.lines().next().unwrap_or_default()).into());
        }
        Ok((began.elapsed().as_secs_f64() * 1e3, text))
    }

    /// A number of the process's status.
    fn kib(&self, field: &str) -> Result<f64, Failed> {
        let status = fs::read_to_string(format!("/proc/{}/status", self.pid))?;
        let line = status.lines().find_map(|line| line.strip_prefix(field));
        let number = line.and_then(|line| line.split_whitespace().next());
        Ok(number.ok_or("the system does not tell")?.parse()?)
    }
}

/// The sum of the series of a metric whose labels contain a text.
fn sum(metrics: &str, name: &str, label: &str) -> f64 {
    let value = |line: &str| line.rsplit_once(' ').and_then(|(_, value)| value.parse::<f64>().ok());
    metrics.lines().filter(|l| l.starts_with(name) && l.contains(label)).filter_map(value).sum()
}

/// Bytes of the files in a folder; one that goes away meanwhile has none.
fn size(folder: &Path) -> u64 {
    let Ok(entries) = fs::read_dir(folder) else { return 0 };
    entries
        .flatten()
        .filter_map(|entry| entry.metadata().ok())
        .filter(|file| file.is_file())
        .map(|f| f.len())
        .sum()
}
