//! What is read of a daemon at work: its own metrics, and what the kernel says of this process.

use super::Failed;
use std::fs;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;

/// The counters at one time.
#[derive(Clone, Copy, Default)]
pub struct Look {
    /// Plant time at which it was to be made (s).
    pub until: f64,
    /// Plant time at which it was made (s).
    pub at: f64,
    pub cpu_s: f64,
    pub diagnosed: f64,
    pub confirmed: f64,
    pub skipped: f64,
    pub waiting: f64,
    pub kib: f64,
}

impl Look {
    /// Now; when that is, the caller knows.
    pub fn now(address: SocketAddr) -> Result<Self, Failed> {
        let metrics = Metrics::of(address)?;
        Ok(Self {
            cpu_s: cpu_s(),
            diagnosed: metrics.ended("diagnosed"),
            confirmed: metrics.sum("stictiond_runs_confirmed_total", ""),
            skipped: metrics.sum("stictiond_runs_skipped_total", ""),
            waiting: metrics.sum("stictiond_runs_queued", ""),
            kib: kib("VmRSS:"),
            ..Self::default()
        })
    }
}

/// The text of `/metrics`.
pub struct Metrics(String);

impl Metrics {
    pub fn of(address: SocketAddr) -> Result<Self, Failed> {
        Ok(Self(get(address, "/metrics")?))
    }

    /// The sum of the series of a metric whose labels contain a text.
    pub fn sum(&self, name: &str, label: &str) -> f64 {
        let value = |line: &str| line.rsplit_once(' ').and_then(|(_, value)| value.parse::<f64>().ok());
        let own = self.0.lines().filter(|line| line.starts_with(name) && line.contains(label));
        // The sum of nothing is -0.
        own.filter_map(value).sum::<f64>() + 0.0
    }

    /// Diagnoses that ended so.
    pub fn ended(&self, outcome: &str) -> f64 {
        self.sum("stictiond_runs_total", &format!("outcome=\"{outcome}\""))
    }

    /// What happened on all devices.
    pub fn device(&self, event: &str) -> f64 {
        self.sum("stictiond_device_events_total", &format!("event=\"{event}\""))
    }

    /// What the store did.
    pub fn store(&self, event: &str) -> f64 {
        self.sum("stictiond_store_events_total", &format!("event=\"{event}\""))
    }

    /// Loops whose latest diagnosis says so.
    pub fn verdict(&self, verdict: &str) -> f64 {
        self.sum("stictiond_loop_verdict", &format!("verdict=\"{verdict}\""))
    }
}

pub fn get(to: SocketAddr, path: &str) -> std::io::Result<String> {
    let mut stream = TcpStream::connect(to)?;
    write!(stream, "GET {path} HTTP/1.1\r\nhost: {to}\r\nconnection: close\r\n\r\n")?;
    let mut text = String::new();
    stream.read_to_string(&mut text)?;
    Ok(text)
}

/// A field of this process' status (KiB): `VmRSS:` is the memory that it has, `VmHWM:` the most that it had.
pub fn kib(field: &str) -> f64 {
    of_process("status", field)
}

/// Bytes that this process had written to disks.
pub fn bytes_written() -> f64 {
    of_process("io", "write_bytes:")
}

/// The number behind a field of a file on this process; NaN where the kernel does not say it.
fn of_process(file: &str, field: &str) -> f64 {
    let text = fs::read_to_string(Path::new("/proc/self").join(file)).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix(field)).unwrap_or_default();
    line.split_whitespace().next().and_then(|text| text.parse().ok()).unwrap_or(f64::NAN)
}

/// User and system time of this process, fields 14 and 15 in ticks of 10 ms.
pub fn cpu_s() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    after_name.split_whitespace().skip(11).take(2).filter_map(|text| text.parse::<f64>().ok()).sum::<f64>()
        / 100.0
}

/// Bytes of the files of a folder.
pub fn bytes_of(folder: &Path) -> f64 {
    let files = fs::read_dir(folder).into_iter().flatten().flatten();
    let known = files.filter_map(|file| file.metadata().ok());
    known.filter(fs::Metadata::is_file).map(|file| file.len() as f64).sum()
}
