//! A daemon in a process of its own watches a plant at real time for hours, among listeners, reloads and alarms that flap,
//! while somebody looks at what it takes. `scripts/soak HOURS` builds and runs it.
//!
//! `cargo run --release --example soak -- HOURS DAEMON PICTURE [--loops 2000] [--listeners 50]`

#[path = "../../benches/load/plant.rs"]
mod plant;
mod sampled;
mod told;

use sampled::{Daemon, Sample};
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader as Lines};
use tokio::net::TcpStream;

type Failed = Box<dyn std::error::Error + Send + Sync>;

/// From one look to the next.
const EVERY: Duration = Duration::from_secs(10);
/// From one reload to the next.
const RELOAD: Duration = Duration::from_secs(300);
/// Samples of each tag; a ring is full after as many seconds.
const RING: usize = 1800;
/// Time between two diagnoses of a loop (s).
const PERIOD_S: f64 = 900.0;

fn main() -> Result<ExitCode, Failed> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    if std::env::args().any(|argument| argument == "--server") {
        return runtime.block_on(plant::serve(1.0, true)).map(|()| ExitCode::SUCCESS);
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [hours, daemon, picture, ..] = &arguments[..] else {
        return Err("usage: soak HOURS DAEMON PICTURE [--loops N] [--listeners N]".into());
    };
    let number = |name: &str, default: usize| -> usize {
        let after = arguments.iter().skip_while(|argument| *argument != name).nth(1);
        after.and_then(|text| text.parse().ok()).unwrap_or(default)
    };
    let soak = Soak {
        lasts: Duration::try_from_secs_f64(3600.0 * hours.parse::<f64>()?)?,
        daemon: daemon.into(),
        loops: number("--loops", 2000),
        listeners: number("--listeners", 50),
    };
    let done = runtime.block_on(soak.run(Path::new(picture)));
    runtime.shutdown_background();
    done
}

/// What is to be done.
struct Soak {
    lasts: Duration,
    daemon: PathBuf,
    loops: usize,
    listeners: usize,
}

/// A process that ends with us.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Soak {
    async fn run(&self, picture: &Path) -> Result<ExitCode, Failed> {
        let folder = std::env::temp_dir().join(format!("stictiond-soak-{}", std::process::id()));
        std::fs::create_dir_all(&folder)?;
        let (_plant, devices) = plant_beside()?;
        let address = free_address()?;
        let file = folder.join("soak.toml");
        std::fs::write(&file, self.configuration(&folder, address, &devices, false))?;
        let began = Instant::now();
        let mut command = Command::new(&self.daemon);
        command
            .arg("run")
            .arg(&file)
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(folder.join("log"))?);
        let mut process = Ended(command.spawn()?);
        let daemon = Daemon { pid: process.0.id(), address, store: folder.join("store") };
        daemon.answers().await?;
        let heard = Arc::new(AtomicUsize::new(0));
        for _ in 0..self.listeners {
            tokio::spawn(listen(address, heard.clone()));
        }
        let (mut samples, mut reloads) = (Vec::new(), Vec::new());
        let mut looks = tokio::time::interval(EVERY);
        while began.elapsed() < self.lasts {
            looks.tick().await;
            if let Some(ended) = process.0.try_wait()? {
                return Err(format!("the daemon ended: {ended}; its log is in {}", folder.display()).into());
            }
            samples.push(daemon.look(began, samples.len(), self.loops).await?);
            if began.elapsed() > RELOAD * (reloads.len() as u32 + 1) {
                let odd = reloads.len().is_multiple_of(2);
                std::fs::write(&file, self.configuration(&folder, address, &devices, odd))?;
                daemon.hang_up()?;
                reloads.push(began.elapsed().as_secs_f64());
            }
        }
        daemon.terminate()?;
        let ended = process.0.wait()?;
        let told = told::Told::of(&samples, self.first_part(), RING as f64);
        std::fs::write(picture, told::picture(&samples, &reloads, self.first_part(), RING as f64))?;
        self.print(&samples, reloads.len(), heard.load(Ordering::Relaxed));
        let good = told.print(&samples) && ended.success();
        std::fs::remove_dir_all(&folder)?;
        Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    /// Half an hour, or the first half of what is shorter (s): stores, lists and buffers fill until then.
    fn first_part(&self) -> f64 {
        (self.lasts.as_secs_f64() / 2.0).min(1800.0)
    }

    /// Every other reload watches one loop less, and judges alarms otherwise.
    fn configuration(&self, folder: &Path, address: SocketAddr, devices: &[String], odd: bool) -> String {
        let store = folder.join("store");
        let (loops, after_s) = (self.loops - usize::from(odd), if odd { 15.0 } else { 10.0 });
        format!(
            "[server]\nlisten = \"{address}\"\nmax_event_clients = 128\nmax_connections = 256\n\
             [schedule]\nperiod_s = {PERIOD_S:.1}\nparallelism = 1\n[history]\nsamples_per_tag = {RING}\n\
             [store]\nfolder = {store:?}\nmax_mb = 1000\n[alarm.tag_bad]\nafter_s = {after_s:.1}\n{}",
            plant::sections(devices, loops, 1000.0)
        )
    }

    fn print(&self, samples: &[Sample], reloads: usize, heard: usize) {
        let last = samples.last().copied().unwrap_or_default();
        println!(
            "{} loops x 2 tags at real time for {:.2} h, {} listeners, {reloads} reloads",
            self.loops,
            self.lasts.as_secs_f64() / 3600.0,
            self.listeners
        );
        println!("polls          {:.0}, {:.0} missed, {:.0} overran", last.polls, last.missed, last.overran);
        println!(
            "diagnoses      {:.0} done, {:.0} skipped, {:.0} panicked",
            last.runs, last.skipped, last.panicked
        );
        println!("events         {:.0} heard by each listener", heard as f64 / self.listeners.max(1) as f64);
    }
}

/// The plant in another process, and where its devices are.
fn plant_beside() -> Result<(Ended, Vec<String>), Failed> {
    let mut command = Command::new(std::env::current_exe()?);
    let mut plant = Ended(command.arg("--server").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?);
    let output = plant.0.stdout.take().ok_or("the plant has no output")?;
    let addresses: Result<Vec<String>, _> = BufReader::new(output).lines().take(plant::DEVICES).collect();
    Ok((plant, addresses?))
}

/// An address that nobody has now.
fn free_address() -> Result<SocketAddr, Failed> {
    Ok(std::net::TcpListener::bind("127.0.0.1:0")?.local_addr()?)
}

/// Listens to events; whoever is turned away comes back.
async fn listen(to: SocketAddr, heard: Arc<AtomicUsize>) {
    loop {
        if let Ok(stream) = TcpStream::connect(to).await {
            let mut lines = Lines::new(stream);
            let head = format!("GET /api/v1/events HTTP/1.1\r\nhost: {to}\r\n\r\n");
            if lines.get_mut().write_all(head.as_bytes()).await.is_ok() {
                let mut lines = lines.lines();
                while let Ok(Some(line)) = lines.next_line().await {
                    heard.fetch_add(usize::from(line.starts_with("event: ")), Ordering::Relaxed);
                }
            }
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}
