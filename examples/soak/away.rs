//! What the daemon writes to goes away and comes back: its database, and the disk on which it waits for that.

#[path = "../../tests/peers/postgres.rs"]
mod postgres_peer;

use super::Failed;
use postgres_peer::Cluster;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

/// From one time away to the next (s); shorter runs have as many as a run of 1.75 h.
const ROUND: f64 = 900.0;
const ROUNDS: f64 = 7.0;
/// Shortest of a short run (s).
const SHORTEST: f64 = 60.0;
/// Parts of a round.
const PARTS: f64 = 15.0;

/// Time from one time away to the next, in a run that lasts so long (s).
fn round(lasts: f64) -> f64 {
    (lasts / ROUNDS).clamp(SHORTEST, ROUND)
}

/// Time after which what is away when recurs (s): the disk is full at another time in every other round.
pub fn recurs(lasts: f64) -> f64 {
    2.0 * round(lasts)
}

/// What is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct There {
    pub database: bool,
    pub disk: bool,
}

impl There {
    pub const ALL: Self = Self { database: true, disk: true };

    /// At a time of a run that lasts so long (s). The database is away for 2 of 15 parts of each round, and for half of that
    /// the disk is full: in the middle of it, and when the database is there, by turns.
    pub fn at(t: f64, lasts: f64) -> Self {
        let round = round(lasts);
        let part = t % round / round * PARTS;
        if lasts - t < round * 4.0 / PARTS {
            return Self::ALL;
        }
        let even = ((t / round) as u64).is_multiple_of(2);
        let full = if even { 5.5..6.5 } else { 10.0..11.0 };
        Self { database: !(5.0..7.0).contains(&part), disk: !full.contains(&part) }
    }
}

/// PostgreSQL, on a thread of its own, because all of it waits.
pub struct Database {
    pub url: String,
    tell: Sender<bool>,
    thread: JoinHandle<Result<f64, postgres::Error>>,
}

impl Database {
    /// Begins one; `spool` is where a daemon waits for it.
    pub fn begin(spool: &Path) -> Result<Self, Failed> {
        let (tell, told) = channel();
        let (say, said) = channel();
        let spool = spool.to_path_buf();
        let thread = std::thread::spawn(move || {
            let mut cluster = Cluster::with(None, false);
            // Whoever asked may have given up.
            let _ = say.send(cluster.config(&spool).url);
            for there in told {
                if there { cluster.begin() } else { cluster.end() }
            }
            longest(&mut cluster.client()?)
        });
        Ok(Self { url: said.recv()?.ok_or("it has no address")?, tell, thread })
    }

    pub fn there(&self, there: bool) -> Result<(), Failed> {
        Ok(self.tell.send(there)?)
    }

    /// Ends it; the longest time between two samples of a tag that it has (s).
    pub fn end(self) -> Result<f64, Failed> {
        drop(self.tell);
        Ok(self.thread.join().map_err(|_| "the database's thread panicked")??)
    }
}

/// Of each hundredth tag: all take long.
fn longest(client: &mut postgres::Client) -> Result<f64, postgres::Error> {
    let row = client.query_one(
        "SELECT coalesce(max(gap), 'Infinity')::float8 FROM (SELECT extract(epoch FROM at - lag(at) \
         OVER (PARTITION BY tag ORDER BY at)) AS gap FROM stictiond.samples WHERE tag % 100 = 1) AS gaps",
        &[],
    )?;
    row.try_get(0)
}

/// A limit on the size of files is a disk that is full; lifted, it has room again.
pub fn disk(pid: u32, room: bool) -> Result<(), Failed> {
    let limit = if room { "--fsize=unlimited:unlimited" } else { "--fsize=0:unlimited" };
    let set = Command::new("prlimit").args(["--pid", &pid.to_string(), limit]).status()?;
    if set.success() { Ok(()) } else { Err(format!("prlimit: {set}").into()) }
}
