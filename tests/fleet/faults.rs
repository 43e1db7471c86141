//! A fleet among faults that a seed draws: lines cut, servers and daemons killed, one at a time or several at once.
//!
//! `scripts/fleet faults 7` draws those of seed 7; `FLEET_ROUNDS` says how many. What is killed when is a function of the seed;
//! what the processes make of it is not, as in a plant.

use crate::daemon::Daemon;
use crate::rig::{Fleet, LOOPS, loops};
use crate::told::{at_site, changes, compare, notices, untold};
use crate::webhook;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::BTreeMap;
use std::thread::sleep;
use std::time::Duration;
use stictiond::demo::{DEFAULT_SPEED, Demo, Options, Screen};

/// Faults where nothing else is said.
const ROUNDS: u64 = 3;
const SITE: &str = "north";

/// What can go away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Leaf,
    Hub,
    Edge,
    Worker,
    Centre(usize),
}

const PARTS: [Part; 6] = [Part::Leaf, Part::Hub, Part::Edge, Part::Worker, Part::Centre(0), Part::Centre(1)];
const CENTRES: [&str; 2] = ["c1", "c2"];

/// The fleet, its daemons gone where they were killed.
struct Parts {
    fleet: Fleet,
    edge: Option<Daemon>,
    worker: Option<Daemon>,
    centres: [Option<Daemon>; 2],
    /// When the edge was killed (s), and how often anybody who tells people, or a line to them: an edge that is cut off tells
    /// again of what it forwarded just before.
    killed: Vec<f64>,
    tellers: usize,
}

impl Parts {
    /// SIGKILL.
    fn end(&mut self, part: Part) {
        self.tellers += usize::from(part != Part::Worker);
        if part == Part::Edge {
            self.killed.push(now());
        }
        match part {
            Part::Leaf => self.fleet.leaves[0].end(),
            Part::Hub => self.fleet.hub.end(),
            Part::Edge => self.edge = None,
            Part::Worker => self.worker = None,
            Part::Centre(at) => self.centres[at] = None,
        }
    }

    /// Again, with the disk that it had.
    fn begin(&mut self, part: Part) {
        match part {
            Part::Leaf => self.fleet.leaves[0].begin(),
            Part::Hub => self.fleet.hub.begin(),
            Part::Edge => self.edge = Some(self.fleet.again("edge", "edge-north")),
            Part::Worker => self.worker = Some(self.fleet.again("worker", "w1")),
            Part::Centre(at) => self.centres[at] = Some(self.fleet.again("centre", CENTRES[at])),
        }
    }
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// Seconds since the Unix epoch.
fn now() -> f64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    now.expect("after 1970").as_secs_f64()
}

/// Times of the last diagnoses by loop, by their names at the site.
fn times(daemon: &Daemon) -> BTreeMap<String, String> {
    let all = loops(daemon).into_iter();
    all.map(|(id, own)| (at_site(&id), own["time"].to_string())).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn whatever_goes_away_nothing_is_lost_and_nothing_is_there_twice() {
    let (seed, rounds) = (number("FLEET_SEED", 1), number("FLEET_ROUNDS", ROUNDS));
    let listen = ([127, 0, 0, 1], 0).into();
    let options = Options { listen, speed: DEFAULT_SPEED, seed, writeback: false };
    let demo = Demo::build(&options).await.expect("builds");
    let fleet = Fleet::sized("faults", 1, 1);
    let (receiver, letters) = webhook::receiver();
    let centres = CENTRES.map(|name| Some(fleet.centre(name, receiver)));
    let edge = Some(fleet.edge(SITE, &demo, receiver));
    let stop = demo.stop();
    let plant = tokio::spawn(demo.run(Screen::new(Vec::new(), false)));
    let worker = Some(fleet.worker("w1"));
    let parts = Parts { fleet, edge, worker, centres, killed: Vec::new(), tellers: 0 };
    let done = tokio::task::spawn_blocking(move || {
        let (fleet, faults, kills) = among_faults(parts, seed, rounds);
        let mut letters: Vec<String> = letters.try_iter().flat_map(|(_, body)| notices(&body)).collect();
        let all = letters.len();
        letters.sort();
        letters.dedup();
        // Who is killed between a letter and its record writes it again, and so does an edge that is cut off.
        println!("seed {seed}: {rounds} faults {faults:?}, {} alarms told by {all} letters", letters.len());
        assert!(
            !letters.is_empty() && all <= letters.len() * (1 + kills),
            "{all} letters, {kills} kills: {letters:?}"
        );
        let [one, other] = CENTRES.map(|centre| fleet.store(centre));
        let tellers = [one, other, fleet.store("edge-north")];
        for store in &tellers[..2] {
            let missing = untold(store, SITE, &letters, &tellers);
            assert!(missing.is_empty(), "{missing:?} of {letters:?}");
        }
        std::fs::remove_dir_all(&fleet.folder).expect("writable");
    });
    let done = done.await;
    stop.cancel();
    plant.await.expect("no panic").expect("ends well");
    done.expect("all is well");
}

/// Lets faults happen, puts everything right, and compares what an edge has with what both centres have; the fleet, the faults,
/// and how often anybody was killed who tells people, or a line to them.
fn among_faults(mut parts: Parts, seed: u64, rounds: u64) -> (Fleet, Vec<Vec<Part>>, usize) {
    let mut draw = Pcg64Mcg::seed_from_u64(seed);
    let patience = parts.fleet.patience();
    let known = |centre: &Daemon| times(centre).values().filter(|time| *time != "null").count() >= LOOPS;
    let up = parts.centres.iter().flatten();
    up.for_each(|centre| centre.until("the centre has every loop and its verdict", patience, known));
    let mut happened = Vec::new();
    for _ in 0..rounds {
        let mut gone: Vec<Part> =
            (0..draw.random_range(1..=2)).map(|_| PARTS[draw.random_range(0..6)]).collect();
        gone.dedup();
        gone.iter().for_each(|part| parts.end(*part));
        sleep(Duration::from_millis(draw.random_range(200..6000)));
        // A daemon starts where its server is away, too; in whatever order they come back.
        gone.iter().for_each(|part| parts.begin(*part));
        sleep(Duration::from_millis(draw.random_range(200..3000)));
        happened.push(gone);
    }
    let Parts { fleet, edge: Some(edge), worker, centres: [Some(one), Some(other)], killed, tellers } = parts
    else {
        panic!("all were begun again");
    };
    let began = times(&edge);
    let again = |daemon: &Daemon| {
        let now = times(daemon);
        now.len() == LOOPS && now.iter().all(|(id, time)| time != "null" && began.get(id) != Some(time))
    };
    edge.until("the edge diagnoses every loop again", patience, again);
    let newest = |daemon: &Daemon, id: &str| {
        daemon.json(&format!("/api/v1/loops/{id}"))["values"][0]["time"].to_string()
    };
    let (name, latest) = (began.keys().next().expect("a loop").clone(), times(&edge));
    let last = newest(&edge, &name);
    for centre in [&one, &other] {
        centre.until("what was found meanwhile", patience, |centre| {
            let own = times(centre);
            latest.iter().all(|(id, time)| own.get(id).is_some_and(|own| own >= time))
        });
        let at_centre = format!("{SITE}:{name}");
        centre.until("the samples of meanwhile", patience, |centre| newest(centre, &at_centre) >= last);
    }
    // One of them acts, and one only.
    let raised = loops(&one).keys().next().expect("a loop").clone();
    let order = "{\"by\":\"kim\",\"duration_s\":60}";
    let refuses = |centre: &Daemon| {
        centre.ask("POST", &format!("/api/v1/alarms/{raised}/shelve"), order).contains("another centre")
    };
    one.until("one centre acts and the other does not", patience, |one| refuses(one) != refuses(&other));
    edge.stop();
    one.until("people are told of all that a centre knows", patience, |_| fleet.all_is_told());
    [one, other].into_iter().for_each(Daemon::stop);
    drop(worker);
    let store = |name: &str| fleet.store(name);
    let edge = store("edge-north");
    CENTRES.iter().for_each(|centre| compare(&edge, &store(centre), SITE, LOOPS, &killed));
    assert!(!changes(&edge, SITE).is_empty());
    (fleet, happened, tellers)
}
