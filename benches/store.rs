//! What it costs to keep 2,000 loops of 3 tags at 1 Hz: `cargo bench --bench store [-- --minutes 70] [--real-time]`.
//!
//! Plant seconds are written one after the other as fast as they go, each a batch that waits for the disk as in the daemon;
//! with `--real-time` one a second, which shows the load on the machine. With `--postgres` into a PostgreSQL of its own, as
//! Debian sets it up, instead of a folder.

#[path = "../tests/peers/postgres.rs"]
mod postgresql;

use postgresql::Cluster;
use std::fs;
use std::sync::Arc;
use std::time::{Duration, Instant};
use stictiond::signal::Sample;
use stictiond::store::{Batch, Config, Reader, Series, Store, TagName, Upkeep};

const LOOPS: usize = 2000;
const TAGS: usize = 3;
/// Loops behind one device: their tags carry one stamp.
const PER_DEVICE: usize = 20;
const START: f64 = 1_763_700_000.0;
/// Samples of each tag that a start gives back to its ring.
const RING: usize = 4096;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let minutes =
        arguments.iter().position(|a| a == "--minutes").and_then(|at| arguments.get(at + 1)?.parse().ok());
    let real_time = arguments.iter().any(|a| a == "--real-time");
    let minutes: usize = minutes.unwrap_or(if real_time { 5 } else { 70 });
    let folder = std::env::var_os("CARGO_TARGET_TMPDIR").map_or_else(std::env::temp_dir, Into::into);
    let folder = folder.join(format!("stictiond-bench-store-{}", std::process::id()));
    let cluster = arguments.iter().any(|a| a == "--postgres").then(|| Cluster::with(None, true));
    let config = cluster.as_ref().map_or_else(|| Config::new(&folder), |cluster| cluster.config(&folder));
    // The room of a plant of this size.
    let config = Config { max_mb: 1_000_000, ..config };
    write(&config, cluster.as_ref(), minutes, real_time);
    read(&config, minutes);
    thin(&config, minutes);
    drop(cluster);
    let _ = fs::remove_dir_all(&folder);
}

/// Numbers that look like a plant's and are the same each time.
struct Plant {
    state: u64,
    tags: Vec<Arc<TagName>>,
}

impl Plant {
    fn new() -> Self {
        let tag = |i: usize| TagName {
            control_loop: format!("FIC{}", 1000 + i / TAGS),
            tag: ["op", "pv", "sp"][i % TAGS].to_string(),
            source: format!("modbus 10.0.0.{} unit 1 holding {}", i / TAGS / PER_DEVICE, i),
            unit: "%".to_string(),
        };
        Self { state: 7, tags: (0..LOOPS * TAGS).map(|i| Arc::new(tag(i))).collect() }
    }

    fn random(&mut self) -> f64 {
        self.state =
            self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.state >> 11) as f64 / (1u64 << 53) as f64
    }

    /// OP as a register of hundredths, PV as a single float with noise, SP that stands still; polls jitter by 1 ms.
    fn second(&mut self, k: usize) -> Batch {
        let tags = self.tags.clone();
        let mut t = 0.0;
        let series = tags.into_iter().enumerate().map(|(i, tag)| {
            if i % (TAGS * PER_DEVICE) == 0 {
                t = START + k as f64 + 1e-3 * self.random();
            }
            let wave = (0.05 * k as f64 + i as f64).sin();
            let value = match i % TAGS {
                0 => (5000.0 + 800.0 * wave + 10.0 * self.random()).round() * 0.01,
                1 => f64::from((50.0 + 5.0 * wave + 0.2 * self.random()) as f32),
                _ => 50.0,
            };
            Series { tag, samples: vec![Sample::good(t, value)] }
        });
        Batch { series: series.collect(), rows: Vec::new() }
    }
}

fn write(config: &Config, cluster: Option<&Cluster>, minutes: usize, real_time: bool) {
    let mut store = Store::open(config).expect("opens");
    let server = || cluster.map(Server::of).unwrap_or_default();
    let (begun, mut rows) = (server(), 0);
    let mut plant = Plant::new();
    let (began, seconds) = (Instant::now(), minutes * 60);
    let (written, mut busy, mut cpu, mut longest) = (bytes_written(), Duration::ZERO, 0.0, Duration::ZERO);
    for k in 0..seconds {
        let batch = plant.second(k);
        let (clock, before) = (Instant::now(), cpu_seconds());
        store.write(&batch).expect("writes");
        rows += batch.samples();
        let acknowledged = clock.elapsed();
        store.tidy(START + k as f64).expect("tidies");
        (busy, cpu) = (busy + clock.elapsed(), cpu + cpu_seconds() - before);
        longest = longest.max(acknowledged);
        if real_time {
            std::thread::sleep(
                (began + Duration::from_secs(k as u64 + 1)).saturating_duration_since(Instant::now()),
            );
        }
    }
    // What is open is rolled, so that every sample is counted where it stays.
    store.tidy(START + seconds as f64 + 1000.0).expect("tidies");
    assert!(store.spool().is_none_or(|spool| spool.away.is_none() && !spool.waits), "the database went away");
    let samples = rows as f64;
    let usage = store.usage().expect("can be told");
    let used = usage.used_bytes as f64;
    let server = server() - begun;
    let written = (bytes_written() - written) as f64 + server.written;
    println!(
        "{LOOPS} loops x {TAGS} tags at 1 Hz, {minutes} minutes of plant, {:.1} M samples",
        samples / 1e6
    );
    println!(
        "  wall         {:.3} ms a plant second, {:.2} % of it; {:.2} M samples/s",
        1e3 * busy.as_secs_f64() / seconds as f64,
        100.0 * busy.as_secs_f64() / seconds as f64,
        samples / busy.as_secs_f64() / 1e6
    );
    println!("  processor    {:.2} % of one core at 1 Hz", 100.0 * cpu / seconds as f64);
    if cluster.is_some() {
        println!("  its server   {:.2} % of one core at 1 Hz", 100.0 * server.cpu / seconds as f64);
    }
    println!("  durable      after {:.0} ms at worst", 1e3 * longest.as_secs_f64());
    println!(
        "  on disk      {:.2} bytes a sample, {:.1} GB a day",
        used / samples,
        used / samples * 86_400.0 * (LOOPS * TAGS) as f64 / 1e9
    );
    println!(
        "  written      {:.2} bytes a sample, {:.2} for each that stays",
        written / samples,
        written / used
    );
}

fn read(config: &Config, minutes: usize) {
    let clock = Instant::now();
    let mut reader = Reader::of(config).expect("opens");
    let names: Vec<TagName> = reader.tags().expect("reads").into_iter().map(|tag| tag.name).collect();
    let mut found = 0;
    for some in names.chunks(Reader::together(config)) {
        found += reader.last(some, RING).expect("reads").values().map(Vec::len).sum::<usize>();
    }
    println!(
        "  start        {:.1} s for {:.1} M samples into the rings",
        clock.elapsed().as_secs_f64(),
        found as f64 / 1e6
    );
    if minutes < 7 {
        return println!("  read         not told: there are no 300 s that are whole");
    }
    let clock = Instant::now();
    for tag in 1..=200 {
        let mut start = stictiond::store::first_start(START);
        for _ in 0..5 {
            let at = reader.next_start(start).expect("reads").expect("there");
            assert!(!reader.chunk(at, Some(&[tag])).expect("reads").is_empty());
            start = at + 1;
        }
    }
    println!("  read         {:.3} ms for 300 s of one tag", clock.elapsed().as_secs_f64() / 200.0 * 1e3);
}

/// All of it becomes trends, a point a minute.
fn thin(config: &Config, minutes: usize) {
    let upkeep = Upkeep { pace: None, ..config.upkeep };
    let config = Config { samples_days: 0.01, upkeep, ..config.clone() };
    let mut store = Store::open(&config).expect("opens");
    let (clock, before) = (Instant::now(), cpu_seconds());
    while store.tidy(START + 3.0 * 86_400.0).expect("tidies") {}
    let points = (minutes * LOOPS * TAGS) as f64;
    let bytes = store.usage().expect("can be told").used_bytes as f64 / points;
    println!(
        "  trends       {bytes:.1} bytes a point of a minute, {:.2} GB a day; {:.1} s and {:.1} s of processor to make them",
        bytes * 1440.0 * (LOOPS * TAGS) as f64 / 1e9,
        clock.elapsed().as_secs_f64(),
        cpu_seconds() - before
    );
}

/// What PostgreSQL has used up.
#[derive(Clone, Copy, Default)]
struct Server {
    /// User and system time of all its processes (s).
    cpu: f64,
    /// Bytes of its write-ahead log and of pages written.
    written: f64,
}

impl std::ops::Sub for Server {
    type Output = Self;

    fn sub(self, before: Self) -> Self {
        Self { cpu: self.cpu - before.cpu, written: self.written - before.written }
    }
}

impl Server {
    fn of(cluster: &Cluster) -> Self {
        let mut client = cluster.client().expect("answers");
        client.batch_execute("CHECKPOINT").expect("may");
        let sql = "SELECT (pg_current_wal_lsn() - '0/0')::float8
            + 8192 * (buffers_checkpoint + buffers_clean + buffers_backend)::float8 FROM pg_stat_bgwriter";
        let written = client.query_one(sql, &[]).expect("told").get(0);
        let parent = "SELECT pg_backend_pid()";
        let own: i32 = client.query_one(parent, &[]).expect("told").get(0);
        let fields = |pid: &str| -> Option<Vec<String>> {
            let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
            Some(stat.rsplit_once(')')?.1.split_whitespace().map(str::to_string).collect())
        };
        let postmaster = fields(&own.to_string()).map(|fields| fields[1].clone()).unwrap_or_default();
        let ticks = |fields: &[String], many: usize| -> f64 {
            fields[11..11 + many].iter().filter_map(|ticks| ticks.parse::<f64>().ok()).sum()
        };
        // Of the server that of its children that have ended too.
        let mut cpu = fields(&postmaster).map_or(0.0, |fields| ticks(&fields, 4));
        for entry in fs::read_dir("/proc").expect("Linux").flatten() {
            let pid = entry.file_name().to_string_lossy().to_string();
            if let Some(fields) = fields(&pid).filter(|fields| fields[1] == postmaster) {
                cpu += ticks(&fields, 2);
            }
        }
        Self { cpu: cpu / 100.0, written }
    }
}

/// Bytes that this process had written to disks.
fn bytes_written() -> u64 {
    let io = fs::read_to_string("/proc/self/io").unwrap_or_default();
    io.lines().find_map(|line| line.strip_prefix("write_bytes: ")?.trim().parse().ok()).unwrap_or(0)
}

/// User and system time of this process (s).
fn cpu_seconds() -> f64 {
    let stat = fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    stat.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}
