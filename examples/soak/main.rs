//! A daemon in a process of its own watches a plant at real time for hours, among listeners, reloads and alarms that flap,
//! while its database and its disk go away and come back, and one loop's diagnosis panics. Somebody looks at what it takes.
//! `scripts/soak HOURS` builds and runs it.
//!
//! `cargo run --release --example soak -- HOURS PICTURE [--loops 2000] [--listeners 50]`

mod away;
mod daemon;
#[path = "../../benches/load/plant.rs"]
mod plant;
mod sampled;
mod slope;
mod told;

use away::{Database, There};
use cap::Cap;
use sampled::{Daemon, Said, Sample};
use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader as Lines};
use tokio::net::TcpStream;

/// The one that `stictiond` has; what is allocated and not freed is counted.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[global_allocator]
static ALLOCATOR: Cap<tikv_jemallocator::Jemalloc> = Cap::new(tikv_jemallocator::Jemalloc, usize::MAX);
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
#[global_allocator]
static ALLOCATOR: Cap<std::alloc::System> = Cap::new(std::alloc::System, usize::MAX);

type Failed = Box<dyn std::error::Error + Send + Sync>;

/// From one look to the next.
const EVERY: u64 = 10;
/// Between two looks at whether something is to go away or come back.
const TICK: Duration = Duration::from_secs(1);
/// Longest wait at the end, for what was written while the database was away.
const SETTLES: Duration = Duration::from_secs(120);
/// Longest wait at the end, until each panic is both said and counted.
const COUNTED: Duration = Duration::from_secs(10);
/// From one reload to the next.
const RELOAD: Duration = Duration::from_secs(300);
/// Samples of each tag; a ring is full after as many seconds.
const RING: usize = 900;
/// Time between two diagnoses of a loop (s).
const PERIOD_S: f64 = 900.0;
/// Diagnoses at a time. One core takes longer than a period for 2,000 loops while nothing is known of them; those that it skips
/// have their first report of a full ring when the bounds hold already.
const PARALLEL: usize = 2;
/// Time between two looks at all loops together (s): the first of them comes before the bounds hold.
const LOOK_S: f64 = 900.0;
/// Diagnoses that are remembered of each loop: so few that they are as many after the first part.
const REMEMBERED: usize = 2;
/// The loop whose diagnosis panics, and the time between two of these (s).
const PANICS: &str = "L0013";
const PANICS_S: f64 = 60.0;

fn main() -> Result<ExitCode, Failed> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    if std::env::args().any(|argument| argument == "--server") {
        return runtime.block_on(plant::serve(1.0, true, &plant::excited())).map(|()| ExitCode::SUCCESS);
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [daemon, file] = &arguments[..]
        && daemon == "--daemon"
    {
        let ran = runtime.block_on(daemon::run(Path::new(file)));
        runtime.shutdown_background();
        return ran.map(|()| ExitCode::SUCCESS);
    }
    let [hours, picture, ..] = &arguments[..] else {
        return Err("usage: soak HOURS PICTURE [--loops N] [--listeners N]".into());
    };
    let number = |name: &str, default: usize| -> usize {
        let after = arguments.iter().skip_while(|argument| *argument != name).nth(1);
        after.and_then(|text| text.parse().ok()).unwrap_or(default)
    };
    let soak = Soak {
        lasts: Duration::try_from_secs_f64(3600.0 * hours.parse::<f64>()?)?,
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
        let (file, store) = (folder.join("soak.toml"), folder.join("store"));
        let database = Database::begin(&store)?;
        let configure =
            |odd| std::fs::write(&file, self.configuration(&store, &database.url, address, &devices, odd));
        configure(false)?;
        let began = Instant::now();
        let mut process = Ended(daemon_beside(&file)?);
        let log = process.0.stderr.take().ok_or("the daemon has no log")?;
        let kept = std::fs::File::create(folder.join("log"))?;
        std::thread::spawn(move || keep(BufReader::new(log), kept));
        let output = process.0.stdout.take().ok_or("the daemon says nothing of itself")?;
        let said = Arc::<Said>::default();
        let heard = said.clone();
        std::thread::spawn(move || {
            BufReader::new(output).lines().map_while(Result::ok).for_each(|line| heard.hear(&line));
        });
        let daemon = Daemon { said, pid: process.0.id(), address, store: store.clone() };
        daemon.answers().await?;
        let heard = Arc::new(AtomicUsize::new(0));
        for _ in 0..self.listeners {
            tokio::spawn(listen(address, heard.clone()));
        }
        let (mut samples, mut reloads, mut went) = (Vec::new(), Vec::new(), (0, 0));
        let mut unanswered = Vec::new();
        let (mut ticks, mut there) = (tokio::time::interval(TICK), There::ALL);
        for tick in 0.. {
            ticks.tick().await;
            let t = began.elapsed();
            if t >= self.lasts {
                break;
            }
            if let Some(ended) = process.0.try_wait()? {
                return Err(format!("the daemon ended: {ended}; its log is in {}", folder.display()).into());
            }
            let should = There::at(t.as_secs_f64(), self.lasts.as_secs_f64());
            if should.database != there.database {
                database.there(should.database)?;
                went.0 += usize::from(!should.database);
            }
            if should.disk != there.disk {
                away::disk(daemon.pid, should.disk)?;
                went.1 += usize::from(!should.disk);
            }
            there = should;
            if u64::is_multiple_of(tick, EVERY) {
                match daemon.look(began, samples.len(), self.loops).await {
                    Ok(sample) => samples.push(sample),
                    Err(error) => unanswered.push(format!("{:.0} s: {error}", t.as_secs_f64())),
                }
            }
            if t > RELOAD * (reloads.len() as u32 + 1) {
                configure(reloads.len().is_multiple_of(2))?;
                daemon.hang_up()?;
                reloads.push(t.as_secs_f64());
            }
        }
        let settled = daemon.settles(SETTLES).await?;
        samples.push(self.last_look(&daemon, began, samples.len()).await?);
        daemon.terminate()?;
        let ended = process.0.wait()?;
        let gap = database.end()?;
        let told =
            told::Told::of(&samples, self.first_part(), RING as f64, away::recurs(self.lasts.as_secs_f64()));
        std::fs::write(picture, told::picture(&samples, &reloads, self.first_part(), RING as f64))?;
        self.print(&samples, reloads.len(), heard.load(Ordering::Relaxed));
        println!("away           database {} times, disk full {} times", went.0, went.1);
        unanswered.iter().for_each(|what| println!("no answer      {what}"));
        let kept = told::Kept { settled, gap, unanswered: unanswered.len() as f64 };
        let good = told.print(&samples, &kept) && ended.success();
        std::fs::remove_dir_all(&folder)?;
        Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    /// The last look: again, for a while, where a panic was said and not counted yet, or the other way round.
    async fn last_look(&self, daemon: &Daemon, began: Instant, number: usize) -> Result<Sample, Failed> {
        let asked = Instant::now();
        loop {
            let sample = daemon.look(began, number, self.loops).await?;
            if (sample.panicked - sample.meant).abs() < 0.5 || asked.elapsed() > COUNTED {
                return Ok(sample);
            }
            tokio::time::sleep(TICK).await;
        }
    }

    /// Until rings are full and every loop is diagnosed once more, or the first half of what is shorter (s): stores, lists,
    /// reports and buffers fill until then.
    fn first_part(&self) -> f64 {
        (self.lasts.as_secs_f64() / 2.0).min(RING as f64 + PERIOD_S)
    }

    /// Every other reload watches one loop less, and judges alarms otherwise.
    fn configuration(
        &self,
        store: &Path,
        url: &str,
        address: SocketAddr,
        devices: &[String],
        odd: bool,
    ) -> String {
        let (loops, after_s) = (self.loops - usize::from(odd), if odd { 15.0 } else { 10.0 });
        let (low, high) = daemon::LIMITS;
        let named = format!("id = \"{PANICS}\"\n");
        let panics = format!("{named}period_s = {PANICS_S:.1}\nop_limits = [{low:.1}, {high:.1}]\n");
        format!(
            "[server]\nlisten = \"{address}\"\nmax_event_clients = 128\nmax_connections = 256\n\
             [schedule]\nperiod_s = {PERIOD_S:.1}\nparallelism = {PARALLEL}\nkeep_results = {REMEMBERED}\n\
                 [plantwide]\nperiod_s = {LOOK_S:.1}\n[history]\nsamples_per_tag = {RING}\n\
             [store]\nfolder = {store:?}\nurl = \"{url}\"\n[alarm.tag_bad]\nafter_s = {after_s:.1}\n{}",
            plant::sections(devices, loops, 1000.0).replace(&named, &panics)
        )
    }

    fn print(&self, samples: &[Sample], reloads: usize, heard: usize) {
        let last = samples.last().copied().unwrap_or_default();
        println!(
            "{} loops x 3 tags at real time for {:.2} h, {} listeners, {reloads} reloads",
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

/// The daemon in another process. The signal that comes with a limit on files is ignored, as a full disk sends none.
fn daemon_beside(file: &Path) -> Result<Child, Failed> {
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' XFSZ; exec \"$@\"", "sh"]).arg(std::env::current_exe()?);
    command.arg("--daemon").arg(file).stdout(Stdio::piped()).stderr(Stdio::piped());
    Ok(command.spawn()?)
}

/// Writes the log to a file, which no limit of the daemon's reaches.
fn keep(log: impl BufRead, mut kept: impl Write) {
    for line in log.lines().map_while(Result::ok) {
        // A daemon whose log nobody takes would stand still, so it is taken even where it cannot be kept.
        let _ = writeln!(kept, "{line}");
    }
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
