//! Who asks the daemon meanwhile, in a process of its own: clients that listen to events, and requests at a steady rate,
//! each on a connection of its own and timed from when it was due.

use super::{Failed, option};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::time::MissedTickBehavior;

/// What is asked, in turns: what a dashboard and programs ask. `{}` is some loop.
const PATHS: [&str; 6] = [
    "/api/v1/loops?limit=100",
    "/api/v1/loops/{}",
    "/api/v1/loops/{}/diagnosis",
    "/api/v1/loops/{}/samples?points=500",
    "/api/v1/alarms?limit=100",
    "/api/v1/loops?limit=1000",
];

/// Listens and asks for `--for-s` seconds, then prints what came of it.
pub async fn run(to: SocketAddr) -> Result<(), Failed> {
    let (listeners, rate) = (option("--listeners", 200.0) as usize, option("--rate", 50.0));
    let (loops, lasting) = (option("--loops", 2000.0) as usize, option("--for-s", 50.0));
    let (heard, open) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    for _ in 0..listeners {
        tokio::spawn(listen(to, heard.clone(), open.clone()));
    }
    let asked = (rate * lasting) as usize;
    let mut ticks = tokio::time::interval(Duration::from_secs_f64(1.0 / rate.max(0.1)));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
    let mut answers = Vec::new();
    for at in 0..asked {
        let due = ticks.tick().await.into_std();
        let path = PATHS[at % PATHS.len()].replace("{}", &format!("L{:04}", 37 * at % loops));
        answers.push(tokio::spawn(async move { get(to, &path).await.map(|good| (good, due.elapsed())) }));
    }
    let mut times: Vec<(usize, Duration)> = Vec::new();
    let (mut refused, mut failed) = (0, 0);
    for (at, answer) in answers.into_iter().enumerate() {
        match answer.await? {
            Ok((true, took)) => times.push((at % PATHS.len(), took)),
            Ok((false, _)) => refused += 1,
            Err(_) => failed += 1,
        }
    }
    let (open, heard) = (open.load(Ordering::Relaxed), heard.load(Ordering::Relaxed));
    println!("asked          {asked} requests at {rate}/s, {refused} refused, {failed} failed");
    println!(
        "listeners      {open} of {listeners} open, {:.0} events each",
        heard as f64 / open.max(1) as f64
    );
    let all: Vec<Duration> = times.iter().map(|(_, took)| *took).collect();
    println!("  all          {}", told(all));
    for (at, path) in PATHS.iter().enumerate() {
        let own = times.iter().filter(|(which, _)| *which == at).map(|(_, took)| *took).collect();
        println!("  {path:36} {}", told(own));
    }
    Ok(())
}

fn told(mut times: Vec<Duration>) -> String {
    times.sort_unstable();
    let at = |share: f64| times.get(((times.len() as f64 * share) as usize).min(times.len().max(1) - 1));
    let ms = |share: f64| at(share).map_or(f64::NAN, |took| took.as_secs_f64() * 1e3);
    format!("p50 {:.1} ms, p99 {:.1} ms, worst {:.1} ms", ms(0.5), ms(0.99), ms(1.0))
}

/// Whether it was answered with 200, once the whole answer is here.
async fn get(to: SocketAddr, path: &str) -> std::io::Result<bool> {
    let mut stream = TcpStream::connect(to).await?;
    let head =
        format!("GET {path} HTTP/1.1\r\nhost: {to}\r\naccept-encoding: gzip\r\nconnection: close\r\n\r\n");
    stream.write_all(head.as_bytes()).await?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).await?;
    // A loop that has not been diagnosed yet says so, which is an answer too.
    Ok(answer.starts_with(b"HTTP/1.1 200") || answer.starts_with(b"HTTP/1.1 404"))
}

async fn listen(to: SocketAddr, heard: Arc<AtomicUsize>, open: Arc<AtomicUsize>) -> std::io::Result<()> {
    let stream = TcpStream::connect(to).await?;
    let mut lines = BufReader::new(stream);
    let head = format!("GET /api/v1/events HTTP/1.1\r\nhost: {to}\r\n\r\n");
    lines.get_mut().write_all(head.as_bytes()).await?;
    let mut lines = lines.lines();
    while let Some(line) = lines.next_line().await? {
        match line.strip_prefix("event: ") {
            Some("hello") => open.fetch_add(1, Ordering::Relaxed),
            Some(_) => heard.fetch_add(1, Ordering::Relaxed),
            None => 0,
        };
    }
    open.fetch_sub(1, Ordering::Relaxed);
    Ok(())
}

/// For how long to ask (s), of a run that takes so long: the daemon needs a moment to begin and to end.
pub fn lasting(wall: Duration) -> f64 {
    (wall.as_secs_f64() - 5.0).max(1.0)
}
