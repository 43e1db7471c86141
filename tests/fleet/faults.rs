//! A fleet among faults that a seed draws: lines cut, servers and daemons killed, one at a time or several at once.
//!
//! `scripts/fleet faults 7` draws those of seed 7; `FLEET_ROUNDS` says how many. What is killed when is a function of the seed;
//! what the processes make of it is not, as in a plant.

use crate::daemon::Daemon;
use crate::options;
use crate::rig::{Fleet, LOOPS, loops, now, times};
use crate::settle::Mark;
use crate::told::{compare, letters, named_in, too_often, untold};
use crate::webhook;
use crate::wire::Wire;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::ops::RangeInclusive;
use std::thread::sleep;
use std::time::Duration;
use stictiond::demo::Demo;
use stictiond::fleet::streams::ALARMS;

/// Faults where nothing else is said.
const ROUNDS: u64 = 3;
const SITE: &str = "north";
/// So short that an edge is cut off, and another centre leads, while something is away (s).
const CUT_OFF_S: f64 = 4.0;
/// What was told so short before its teller was killed may not be on record (s).
const SETTLED_S: f64 = 1.0;

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

impl Part {
    /// Of what was told when (s) people may be told once more, because this was away between two times (s).
    fn excuse(self, from: f64, to: f64) -> Option<RangeInclusive<f64>> {
        let before = match self {
            Self::Worker => return None,
            Self::Centre(_) => SETTLED_S,
            // An edge that is cut off tells of what it forwarded within that time, and one that is killed then forgets that.
            Self::Leaf | Self::Hub | Self::Edge => SETTLED_S + CUT_OFF_S,
        };
        Some(from - before..=to + SETTLED_S)
    }
}

/// The fleet, its daemons gone where they were killed.
struct Parts {
    fleet: Fleet,
    edge: Option<Daemon>,
    worker: Option<Daemon>,
    centres: [Option<Daemon>; 2],
    /// When the edge was killed (s).
    killed: Vec<f64>,
}

impl Parts {
    /// SIGKILL.
    fn end(&mut self, part: Part) {
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

#[tokio::test(flavor = "multi_thread")]
async fn whatever_goes_away_nothing_is_lost_and_nothing_is_there_twice() {
    let (seed, rounds) = (number("FLEET_SEED", 1), number("FLEET_ROUNDS", ROUNDS));
    let demo = Demo::build(&options(seed)).await.expect("builds");
    let mut fleet = Fleet::sized("faults", 1, 1);
    fleet.cut_off_after_s = Some(CUT_OFF_S);
    let wire = Wire::at(&fleet.hub).await;
    let (receiver, told) = webhook::receiver();
    let centres = CENTRES.map(|name| Some(fleet.centre(name, receiver)));
    let edge = Some(fleet.edge(SITE, &demo, receiver));
    let stop = demo.stop();
    let plant = tokio::spawn(demo.run_plant());
    let worker = Some(fleet.worker("w1"));
    let parts = Parts { fleet, edge, worker, centres, killed: Vec::new() };
    let done = tokio::task::spawn_blocking(move || {
        let (fleet, excuses) = among_faults(parts, &wire, seed, rounds);
        let letters = letters(&told);
        let named = named_in(&letters);
        println!("seed {seed}: {} alarms told by {} letters", named.len(), letters.len());
        let twice = too_often(&letters, &excuses, &[]);
        assert!(!named.is_empty() && twice.is_empty(), "{twice:#?}; may be told once more: {excuses:.3?}");
        let [one, other] = CENTRES.map(|centre| fleet.store(centre));
        let tellers = [one, other, fleet.store_at(SITE)];
        for store in &tellers[..2] {
            let missing = untold(store, SITE, &named, &tellers);
            assert!(missing.is_empty(), "{missing:?} of {named:?}");
        }
        std::fs::remove_dir_all(&fleet.folder).expect("writable");
    });
    let done = done.await;
    stop.cancel();
    plant.await.expect("no panic").expect("ends well");
    done.expect("all is well");
}

/// Lets faults happen as the seed draws them: of what was told when people may be told once more.
fn happen(parts: &mut Parts, seed: u64, rounds: u64) -> Vec<RangeInclusive<f64>> {
    let (mut draw, mut excuses) = (Pcg64Mcg::seed_from_u64(seed), Vec::new());
    for _ in 0..rounds {
        let mut gone: Vec<Part> =
            (0..draw.random_range(1..=2)).map(|_| PARTS[draw.random_range(0..6)]).collect();
        gone.dedup();
        let began = now();
        gone.iter().for_each(|part| parts.end(*part));
        sleep(Duration::from_millis(draw.random_range(200..6000)));
        // A daemon starts where its server is away, too; in whatever order they come back.
        gone.iter().for_each(|part| parts.begin(*part));
        excuses.extend(gone.iter().filter_map(|part| part.excuse(began, now())));
        println!("seed {seed}: {gone:?} for {:.1} s", now() - began);
        sleep(Duration::from_millis(draw.random_range(200..3000)));
    }
    excuses
}

/// Lets faults happen, puts everything right, and compares what an edge has with what both centres have; the fleet, and of what
/// was told when people may be told once more.
fn among_faults(mut parts: Parts, wire: &Wire, seed: u64, rounds: u64) -> (Fleet, Vec<RangeInclusive<f64>>) {
    let patience = parts.fleet.patience();
    let known = |centre: &Daemon| times(centre).values().filter(|time| **time > 0.0).count() >= LOOPS;
    let up = parts.centres.iter().flatten();
    up.for_each(|centre| centre.until("the centre has every loop and its verdict", patience, known));
    let excuses = happen(&mut parts, seed, rounds);
    let Parts { fleet, edge: Some(edge), worker, centres: [Some(one), Some(other)], killed } = parts else {
        panic!("all were begun again");
    };
    let began = times(&edge);
    let again = |daemon: &Daemon| {
        let now = times(daemon);
        now.len() == LOOPS && now.iter().all(|(id, time)| *time > 0.0 && began.get(id) != Some(time))
    };
    edge.until("the edge diagnoses every loop again", patience, again);
    let mark = Mark::of(&fleet, SITE);
    for (centre, name) in [&one, &other].into_iter().zip(CENTRES) {
        mark.reach(centre, name, wire, patience);
    }
    // One of them acts, and one only.
    let raised = loops(&one).keys().next().expect("a loop").clone();
    let order = "{\"by\":\"kim\",\"duration_s\":60}";
    let refuses = |centre: &Daemon| {
        centre.ask("POST", &format!("/api/v1/alarms/{raised}/shelve"), order).contains("another centre")
    };
    one.until("one centre acts and the other does not", patience, |one| refuses(one) != refuses(&other));
    edge.stop();
    one.until("people are told of all that a centre knows", patience, |_| {
        wire.is_done(ALARMS, "centres_tell")
    });
    [one, other].into_iter().for_each(Daemon::stop);
    drop(worker);
    let edge = fleet.store_at(SITE);
    CENTRES.iter().for_each(|centre| compare(&edge, &fleet.store(centre), &mark, LOOPS, &killed));
    (fleet, excuses)
}
