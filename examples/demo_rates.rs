//! What the demo's diagnoses say beside what is true of its loops, in the running daemon:
//! `cargo run --release --example demo_rates -- --diagnoses 30`.
//!
//! It ends with 1 where an effect is invented on more than 2 % of all diagnoses, or where the interval of f holds S/2 on fewer
//! than 90 % of a sticking loop's.

#[path = "../tests/demo/rates.rs"]
mod rates;
#[path = "../tests/demo/reading.rs"]
mod reading;

use clap::Parser;
use rates::Rated;
use reading::Reader;
use serde_json::Value;
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use stictiond::demo::{DEFAULT_SPEED, Demo, Options, Screen};
use stictiond::sim::DemoLoop;

/// How often the list of loops is read: a loop is diagnosed every 10 s.
const LOOK: Duration = Duration::from_millis(500);
/// Periods of plant time within which a loop has to be diagnosed once.
const PATIENCE: f64 = 50.0;
/// How long plant time may stand still on the wall clock.
const STILL: Duration = Duration::from_secs(120);

/// What the demo's diagnoses say beside what is true of its loops
#[derive(Parser)]
struct Args {
    /// Diagnoses of each loop; the daemon remembers 200
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u16).range(1..=200))]
    diagnoses: u16,
    /// Seed of the plant's noise and loads
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[tokio::main]
async fn main() -> ExitCode {
    let args = Args::parse();
    let rated = match measure(&args).await {
        Ok(rated) => rated,
        Err(why) => {
            eprintln!("demo_rates: {why}");
            return ExitCode::FAILURE;
        }
    };
    println!(
        "seed {}; Wilson 95 % intervals in brackets, as if all diagnoses were independent: those of a loop share samples\n",
        args.seed
    );
    println!("{}", rates::table(&rated).join("\n"));
    let broken = rates::broken(&rated);
    broken.iter().for_each(|line| eprintln!("demo_rates: {line}"));
    if broken.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Runs the demo until every loop has its diagnoses, and counts them.
async fn measure(args: &Args) -> Result<Vec<Rated>, String> {
    let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let options = Options { listen, speed: DEFAULT_SPEED, seed: args.seed, writeback: false };
    let demo = Demo::build(&options).await.map_err(|error| error.to_string())?;
    let (address, loops, stop) = (demo.address(), demo.loops().to_vec(), demo.stop());
    let running = tokio::spawn(demo.run(Screen::new(std::io::sink(), false)));
    let rated = watch(Reader::new(address), &loops, usize::from(args.diagnoses)).await;
    stop.cancel();
    let ended = running.await.map_err(|error| error.to_string())?;
    // A demo that failed is the reason why its API does not answer.
    ended.map_err(|error| error.to_string()).and(rated)
}

async fn watch(mut reader: Reader, loops: &[DemoLoop], wanted: usize) -> Result<Vec<Rated>, String> {
    let mut progress = Progress::new(wanted);
    while !progress.take(&reader.look().await?, Instant::now())? {
        tokio::time::sleep(LOOK).await;
    }
    let mut rated = Vec::new();
    for demo in loops {
        let diagnoses = reader.diagnoses(&demo.id).await?;
        rated.push(Rated::new(demo.clone(), &diagnoses));
    }
    Ok(rated)
}

/// How far the loops are. What bounds the wait is plant time, which waits for a computer that is busy.
struct Progress {
    wanted: usize,
    /// The fewest diagnoses of a loop, as told last.
    told: usize,
    loops: BTreeMap<String, Seen>,
    /// The latest plant time (s), and when it came.
    plant: Option<(f64, Instant)>,
}

/// Of one loop.
struct Seen {
    /// Time of the latest diagnosis, as the API writes it.
    latest: Option<String>,
    diagnoses: usize,
    /// When that was seen, in plant time (s).
    at_s: f64,
}

impl Progress {
    fn new(wanted: usize) -> Self {
        Self { wanted, told: 0, loops: BTreeMap::new(), plant: None }
    }

    /// Takes the list of loops as it is now; true once every loop has as many diagnoses as are wanted.
    ///
    /// # Errors
    /// Plant time stands still, or a loop is not diagnosed any more.
    fn take(&mut self, list: &Value, now: Instant) -> Result<bool, String> {
        let stamp = list["time"].as_str().and_then(|text| text.parse::<jiff::Timestamp>().ok());
        let plant_s = stamp.ok_or("the list of loops has no time")?.as_microsecond() as f64 * 1e-6;
        match self.plant {
            Some((before_s, since)) if plant_s <= before_s => {
                if now.duration_since(since) > STILL {
                    return Err(format!("plant time stands still for {} s", STILL.as_secs()));
                }
            }
            _ => self.plant = Some((plant_s, now)),
        }
        for item in list["items"].as_array().ok_or("the list of loops has no items")? {
            self.seen(item, plant_s)?;
        }
        let fewest = self.loops.values().map(|own| own.diagnoses).min().unwrap_or(0);
        if fewest > self.told {
            self.told = fewest;
            eprintln!("every loop has {fewest} of {} diagnoses", self.wanted);
        }
        Ok(fewest >= self.wanted)
    }

    fn seen(&mut self, item: &Value, plant_s: f64) -> Result<(), String> {
        let (id, period_s) = (item["id"].as_str(), item["period_s"].as_f64());
        let (id, period_s) = id.zip(period_s).ok_or("a loop has no id or no period")?;
        let own =
            self.loops.entry(id.to_string()).or_insert(Seen { latest: None, diagnoses: 0, at_s: plant_s });
        let latest = item["time"].as_str().map(str::to_string);
        if latest != own.latest {
            *own = Seen { latest, diagnoses: own.diagnoses + 1, at_s: plant_s };
        } else if plant_s - own.at_s > PATIENCE * period_s {
            return Err(format!("{id} was not diagnosed for {:.0} s of plant time", plant_s - own.at_s));
        }
        Ok(())
    }
}
