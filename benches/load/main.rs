//! A plant of 2,000 loops at 1 Hz for ten minutes of plant time, over Modbus/TCP from a server in another process, through
//! the real collectors, history, scheduler, diagnosis and API. Prints CPU, memory and what was missed.
//!
//! `cargo bench --bench load -- [--speed 10] [--loops 2000] [--plant-s 600] [--period-s 300] [--samples 4096] [--parallelism 1]`; with `--speed 1` it takes
//! ten minutes, with the default one, and the polls come ten times as fast. With `--listeners 200 --rate 50` so many clients
//! listen to events meanwhile and so many requests a second are made, by a third process, which says how long they took.

mod asking;
mod plant;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use stictiond::app::App;
use stictiond::config::{self, Config};
use stictiond::schedule::Clock;
use tokio::net::TcpListener;

/// As the daemon's own.
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

type Failed = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failed> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    if std::env::args().any(|argument| argument == "--server") {
        return runtime.block_on(plant::serve(option("--speed", 10.0), false));
    }
    if let Some(address) = std::env::args().skip_while(|argument| argument != "--asking").nth(1) {
        return runtime.block_on(asking::run(address.parse()?));
    }
    let done = runtime.block_on(drive());
    runtime.shutdown_timeout(Duration::from_secs(1));
    done
}

/// The number after `name` among the arguments.
fn option(name: &str, default: f64) -> f64 {
    let mut arguments = std::env::args().skip_while(|argument| argument != name);
    arguments.nth(1).and_then(|text| text.parse().ok()).unwrap_or(default)
}

async fn drive() -> Result<(), Failed> {
    let (loops, speed) = (option("--loops", 2000.0) as usize, option("--speed", 10.0));
    let (plant_s, period_s) = (option("--plant-s", 600.0), option("--period-s", 300.0));
    let mut server = Command::new(std::env::current_exe()?)
        .args(["--server", "--speed", &speed.to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let output = server.stdout.take().ok_or("the server has no output")?;
    let mut lines = BufReader::new(output).lines();
    let mut addresses = Vec::new();
    for _ in 0..plant::DEVICES {
        addresses.push(lines.next().ok_or("the server ended")??);
    }
    let app = Arc::new(App::build(
        configuration(&addresses, loops, speed, period_s)?,
        Clock::plant(1_767_225_600.0, speed),
        App::diagnosis(),
    )?);
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let address = listener.local_addr()?;
    let idle_rss = kib("VmRSS:");
    let (began, cpu) = (Instant::now(), cpu_s());
    let running = app.clone();
    let daemon = tokio::spawn(async move { running.run(listener).await });
    let wall = Duration::from_secs_f64(plant_s / speed);
    let asking = (option("--rate", 0.0) > 0.0).then(|| ask(address, loops, wall)).transpose()?;
    // In the first period nothing is known of any loop; what comes after goes on for years.
    let mut looks = vec![Look { cpu_s: cpu, ..Look::default() }];
    for at in 1..=LOOKS {
        tokio::time::sleep((wall * at / LOOKS).saturating_sub(began.elapsed())).await;
        looks.push(tokio::task::spawn_blocking(move || look(address)).await??);
    }
    let (wall, used) = (began.elapsed().as_secs_f64(), cpu_s() - cpu);
    let asked = Instant::now();
    let metrics = tokio::task::spawn_blocking(move || get(address, "/metrics")).await??;
    let scrape = asked.elapsed();
    let asked = Instant::now();
    tokio::task::spawn_blocking(move || get(address, "/api/v1/loops?limit=1000")).await??;
    let list = asked.elapsed();
    if let Some(mut asking) = asking {
        asking.wait()?;
    }
    app.stop().cancel();
    daemon.await??;
    drop(server.stdin.take());
    server.wait()?;
    let device = |event: &str| sum(&metrics, "stictiond_device_events_total", &format!("event=\"{event}\""));
    let ended = |outcome: &str| sum(&metrics, "stictiond_runs_total", &format!("outcome=\"{outcome}\""));
    let skipped = sum(&metrics, "stictiond_runs_skipped_total", "");
    let diagnosed = ended("diagnosed");
    println!("{loops} loops x 3 tags, {plant_s} s of plant time at {speed} x in {wall:.1} s");
    println!("cpu            {used:.1} s = {:.1} % of one core in plant time", 100.0 * used / plant_s);
    println!("  diagnoses    {:.1} s", sum(&metrics, "stictiond_runs_busy_seconds_total", ""));
    table(&looks, plant_s);
    println!(
        "memory         {:.0} MiB resident, {:.0} MiB at most, {:.0} MiB before the first poll",
        kib("VmRSS:") / 1024.0,
        kib("VmHWM:") / 1024.0,
        idle_rss / 1024.0
    );
    println!("  history      {:.0} MiB", sum(&metrics, "stictiond_history_memory_bytes", "") / 1_048_576.0);
    println!(
        "polls          {} done, {} missed, {} overran",
        device("polls"),
        device("missed_polls"),
        device("overruns")
    );
    println!("samples        {} good, {} bad", device("good_samples"), device("bad_samples"));
    println!(
        "diagnoses      {diagnosed} done, {} of them without a search, {} late, {} panicked, {skipped} skipped",
        sum(&metrics, "stictiond_runs_confirmed_total", ""),
        ended("deadline_exceeded"),
        ended("panicked")
    );
    println!(
        "verdicts       {}",
        ["stiction", "no_stiction", "not_identifiable"]
            .map(|v| format!("{} {v}", sum(&metrics, "stictiond_loop_verdict", &format!("verdict=\"{v}\""))))
            .join(", ")
    );
    println!(
        "API            scrape {:.1} ms, page of 1000 loops {:.1} ms",
        scrape.as_secs_f64() * 1e3,
        list.as_secs_f64() * 1e3
    );
    Ok(())
}

/// Looks at the counters meanwhile.
const LOOKS: u32 = 8;

/// The counters at one time.
#[derive(Clone, Copy, Default)]
struct Look {
    cpu_s: f64,
    diagnosed: f64,
    confirmed: f64,
    skipped: f64,
    waiting: f64,
    kib: f64,
}

fn look(address: SocketAddr) -> Result<Look, Failed> {
    let metrics = get(address, "/metrics")?;
    Ok(Look {
        cpu_s: cpu_s(),
        diagnosed: sum(&metrics, "stictiond_runs_total", "outcome=\"diagnosed\""),
        confirmed: sum(&metrics, "stictiond_runs_confirmed_total", ""),
        skipped: sum(&metrics, "stictiond_runs_skipped_total", ""),
        waiting: sum(&metrics, "stictiond_runs_queued", ""),
        kib: kib("VmRSS:"),
    })
}

/// What happened between two looks.
fn table(looks: &[Look], plant_s: f64) {
    let step_s = plant_s / f64::from(LOOKS);
    println!("  until (s)  % of a core  diagnoses  without a search  skipped  waiting  MiB");
    for (at, pair) in looks.windows(2).enumerate() {
        let (before, after) = (pair[0], pair[1]);
        println!(
            "{:>11.0} {:>12.1} {:>10} {:>17} {:>8} {:>8} {:>4.0}",
            (at + 1) as f64 * step_s,
            100.0 * (after.cpu_s - before.cpu_s) / step_s,
            after.diagnosed - before.diagnosed,
            after.confirmed - before.confirmed,
            after.skipped - before.skipped,
            after.waiting,
            after.kib / 1024.0
        );
    }
}

/// Starts who asks meanwhile.
fn ask(to: SocketAddr, loops: usize, wall: Duration) -> std::io::Result<Child> {
    let numbers = [
        ("--listeners", option("--listeners", 200.0)),
        ("--rate", option("--rate", 50.0)),
        ("--loops", loops as f64),
        ("--for-s", asking::lasting(wall)),
    ];
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["--asking", &to.to_string()]);
    numbers.iter().fold(&mut command, |command, (name, value)| command.args([*name, &value.to_string()]));
    command.spawn()
}

fn configuration(addresses: &[String], loops: usize, speed: f64, period_s: f64) -> Result<Config, Failed> {
    let (poll_ms, room) = ((1000.0 / speed).round(), option("--samples", 4096.0));
    let parallelism = option("--parallelism", 1.0);
    let mut text = format!(
        "[server]\nmax_event_clients = 256\nmax_connections = 512\n[schedule]\nperiod_s = {period_s:.1}\nparallelism = {parallelism:.0}\n[history]\nsamples_per_tag = {room:.0}\n"
    );
    text += &plant::sections(addresses, loops, poll_ms);
    config::parse("load.toml", &text)
        .map_err(|wrong| wrong.iter().map(|d| d.to_string() + "\n").collect::<String>().into())
}

fn get(to: SocketAddr, path: &str) -> std::io::Result<String> {
    let mut stream = TcpStream::connect(to)?;
    write!(stream, "GET {path} HTTP/1.1\r\nhost: {to}\r\nconnection: close\r\n\r\n")?;
    let mut text = String::new();
    stream.read_to_string(&mut text)?;
    Ok(text)
}

/// The sum of the series of a metric whose labels contain a text.
fn sum(metrics: &str, name: &str, label: &str) -> f64 {
    let value = |line: &str| line.rsplit_once(' ').and_then(|(_, value)| value.parse::<f64>().ok());
    metrics.lines().filter(|l| l.starts_with(name) && l.contains(label)).filter_map(value).sum()
}

fn kib(field: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(field)).unwrap_or_default();
    line.split_whitespace().next().and_then(|text| text.parse().ok()).unwrap_or(f64::NAN)
}

/// User and system time of this process, fields 14 and 15 in ticks of 10 ms.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    after_name.split_whitespace().skip(11).take(2).filter_map(|text| text.parse::<f64>().ok()).sum::<f64>()
        / 100.0
}
