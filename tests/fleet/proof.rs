//! The fleet's proof, step by step: what is killed or cut, and what has to be true then.

use crate::daemon::{Daemon, stictiond};
use crate::rig::{Fleet, LOOPS, alarm, diagnosed, loops, now, tells, times, until_none};
use crate::settle::Mark;
use crate::told::{Kept, at_site, compare, happened, letters, named_in, of_site, reports, too_often, untold};
use crate::wire::{Key, Made, Wire};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant, SystemTime};
use stictiond::fleet::streams::{ALARMS, WINDOWS};
use stictiond::schedule::Clock;

/// The site whose line is cut and whose edge is restarted.
const SITE: &str = "north";
/// A second centre takes over within this time, with the default settings …
const TAKEOVER: Duration = Duration::from_secs(10);
/// … and so much later where a busy machine lets a process wait that looks once a second.
const BUSY: Duration = Duration::from_secs(3);
/// What was told so short before a centre was killed may not be acknowledged by then (s).
const SETTLED_S: f64 = 1.0;
/// What arrived while a process was killed gets its time a little later (s).
const LATE_S: f64 = 0.5;
/// An edge knows that a centre has heard of an alarm once it has seen the next lease: they are written once a second, and seen
/// within half a second. What it forwarded so short before a cut it tells by itself, too (s).
const HEARD_S: f64 = 3.0;
/// A window of so short before is still waited for when it is given to another worker, 15 s after the first has fallen silent.
const LATELY: Duration = Duration::from_secs(10);
/// How long the line is cut, in plant time (s).
const CUT_S: f64 = 600.0;

/// A fleet at work, and what is known of it.
pub struct Proof {
    fleet: Fleet,
    wire: Wire,
    patience: Duration,
    /// What time it is at the first site's plant.
    plant: Clock,
    /// What is to be said of each loop of a plant.
    expected: BTreeMap<String, &'static str>,
    /// A time (s) in which workers diagnosed every loop.
    stretch: RangeInclusive<f64>,
    /// Windows that a killed worker held.
    held: Vec<Key>,
    /// Times (s) of which people may be told once more.
    excuses: Vec<RangeInclusive<f64>>,
}

impl Proof {
    pub fn new(fleet: Fleet, wire: Wire, plant: Clock, expected: BTreeMap<String, &'static str>) -> Self {
        let (patience, held, excuses) = (fleet.patience(), Vec::new(), Vec::new());
        Self { fleet, wire, patience, plant, expected, stretch: 0.0..=0.0, held, excuses }
    }

    /// With edges by site, a centre that leads and one that does not, and a worker called `w1`.
    pub fn run(
        mut self,
        mut edges: Vec<Daemon>,
        [first, second]: [Daemon; 2],
        worker: Daemon,
        told: &Receiver<(SystemTime, String)>,
    ) {
        self.every_verdict_is_right(&first);
        self.workers_diagnose();
        let workers = self.a_worker_is_killed_at_work(worker);
        self.each_worker_diagnoses(&first);
        let edge = edges.remove(0);
        let id = self.people_act(&edge, [&first, &second]);
        let began = times(&second);
        self.another_centre_takes_over(first, &second, &id);
        self.the_line_is_cut(&edge, &second, &id);
        edges.insert(0, self.hub_and_edge_are_restarted(edge, &second));
        second.until("every loop is diagnosed again", self.patience, |second| {
            times(second).iter().all(|(id, time)| began.get(id) != Some(time))
        });
        self.nothing_is_lost_or_doubled(edges, second);
        drop(workers);
        for site in self.fleet.sites() {
            self.workers_made_it(site);
            self.a_replay_says_the_same(site);
        }
        self.people_were_told_once(told);
        std::fs::remove_dir_all(&self.fleet.folder).expect("writable");
    }

    /// What is to be said of a loop by its name at its site; a copy has a number behind its name.
    fn expected(&self, name: &str) -> &'static str {
        self.expected[name.split_once('-').map_or(name, |(first, _)| first)]
    }

    /// Every loop has had its right verdict at the centre.
    fn every_verdict_is_right(&self, centre: &Daemon) {
        let (all, mut right) = (LOOPS * self.fleet.plants(), BTreeSet::new());
        until_none("every loop has its right verdict at the centre", self.patience, || {
            let mut wrong = Vec::new();
            let loops = loops(centre);
            for (id, own) in &loops {
                if own["verdict"] == self.expected(&at_site(id)) {
                    right.insert(id.clone());
                } else if !right.contains(id) {
                    wrong.push(format!("{id} {}", own["verdict"]));
                }
            }
            if loops.len() < all {
                wrong.push(format!("{} of {all} loops", loops.len()));
            }
            wrong
        });
    }

    /// A worker diagnoses every loop once more.
    fn workers_diagnose(&mut self) {
        let from = now();
        until_none("a worker diagnoses every loop", self.patience, || {
            let is_new = |(_, at): &&Made| f64::from_bits(*at) >= from;
            let left = self.fleet.sites().iter().map(|site| {
                let made = self.wire.made(site);
                let done: BTreeSet<&String> = made.keys().filter(is_new).map(|(id, _)| id).collect();
                (LOOPS * self.fleet.copies).saturating_sub(done.len())
            });
            left.filter(|left| *left > 0).collect::<Vec<usize>>()
        });
        self.stretch = from..=now();
    }

    /// `w1` is killed while it has windows that it has not answered: another worker answers them. Then both are there.
    fn a_worker_is_killed_at_work(&mut self, worker: Daemon) -> [Daemon; 2] {
        let holds = || self.wire.under_way(WINDOWS, "workers").is_some_and(|windows| windows > 0);
        until_none("a worker is at work", self.patience, || if holds() { Vec::new() } else { vec!["idle"] });
        // From now on it says nothing more, whatever it holds.
        worker.signal("-STOP");
        until_none("it holds a window", self.patience, || {
            if holds() && !self.wire.unanswered(LATELY).is_empty() { Vec::new() } else { vec!["nothing"] }
        });
        let mut held = self.wire.unanswered(LATELY);
        // SIGKILL.
        drop(worker);
        let begun = Instant::now();
        // Its last answer may have been heard only now.
        held.retain(|key| self.wire.answers(key).is_empty());
        assert!(!held.is_empty(), "it was not at work");
        let second = self.fleet.worker("w2");
        until_none("another worker answers", self.patience, || {
            let left = held.iter().filter(|key| self.wire.answers(key).is_empty());
            left.copied().collect::<Vec<Key>>()
        });
        println!("{} windows of a killed worker answered within {:.1?}", held.len(), begun.elapsed());
        for (site, by, made) in held.iter().flat_map(|key| self.wire.answers(key)) {
            assert_eq!(by, "w2", "{site}: {made:?}");
        }
        self.held = held;
        [self.fleet.again("worker", "w1"), second]
    }

    /// Each of two workers makes diagnoses, from now on, and says so.
    fn each_worker_diagnoses(&self, centre: &Daemon) {
        let from = now();
        until_none("each worker diagnoses", self.patience, || {
            let all = self.fleet.sites().iter().flat_map(|site| self.wire.made(site));
            let new = all.filter(|((_, at), _)| f64::from_bits(*at) >= from);
            let at_work: BTreeSet<String> = new.map(|(_, by)| by).collect();
            ["w1", "w2"].into_iter().filter(|name| !at_work.contains(*name)).collect()
        });
        centre.until("each worker says so", self.patience, |centre| {
            let all = diagnosed(centre);
            ["w1", "w2"].iter().all(|name| all.get(*name).is_some_and(|count| *count > 0))
        });
    }

    /// What people do at the centre is done at the edge, and shown; before it leads another gives no orders. Which alarm that was.
    fn people_act(&self, edge: &Daemon, [first, second]: [&Daemon; 2]) -> String {
        let raised = |daemon: &Daemon| {
            let mut all = loops(daemon).into_iter();
            all.find(|(id, own)| of_site(id, SITE).is_some() && own["alarm"] == "unacknowledged")
        };
        first.until("an alarm is raised", self.patience, |first| raised(first).is_some());
        let (id, _) = raised(first).expect("one");
        let name = at_site(&id);
        first.ask("POST", &format!("/api/v1/alarms/{id}/ack"), "{\"by\":\"eve\"}");
        edge.until("the edge knows", self.patience, |edge| alarm(edge, &name) == "acknowledged");
        for centre in [first, second] {
            centre.until("a centre knows", self.patience, |centre| alarm(centre, &id) == "acknowledged");
        }
        let refused = second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(60));
        assert!(refused.contains("another centre"), "{refused}");
        let refused = second.ask("POST", &format!("/api/v1/work/{id}/order"), "{\"by\":\"eve\"}");
        assert!(refused.contains("another centre"), "{refused}");
        id
    }

    /// The centre that leads is killed.
    fn another_centre_takes_over(&mut self, first: Daemon, second: &Daemon, id: &str) {
        let (killed, begun) = (now(), Instant::now());
        // SIGKILL.
        drop(first);
        // Once: an order that is given again would be carried out again, whatever was done at the edge meanwhile.
        second.until("the second centre acts", self.patience, |second| {
            let answer = second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(3600));
            !answer.contains("another centre")
        });
        let took = begun.elapsed();
        assert!(took < TAKEOVER + BUSY, "{took:?}");
        println!("a second centre gave an order {took:.1?} after the first was killed");
        self.excuses.push(killed - SETTLED_S..=killed + LATE_S);
        second.until("what it did", self.patience, |second| alarm(second, id) == "shelved");
    }

    /// The line to the hub is cut for so long that the edge goes on by itself, and comes back.
    fn the_line_is_cut(&mut self, edge: &Daemon, second: &Daemon, id: &str) {
        let name = at_site(id);
        let (cut, begun, before) = (now(), self.plant.elapsed(), latest(edge));
        self.fleet.leaves[0].end();
        edge.until("the edge diagnoses by itself", self.patience, |edge| latest(edge) > before);
        edge.until("the edge tells people by itself", self.patience, tells);
        edge.ask("POST", &format!("/api/v1/alarms/{name}/unshelve"), "{\"by\":\"kim\"}");
        // The centre does not know of it, and what it orders now is refused there.
        let taken = second.ask("POST", &format!("/api/v1/alarms/{id}/out-of-service"), "{\"by\":\"kim\"}");
        assert!(!taken.contains("error"), "the order is given: {taken}");
        until_none("the line is cut for long", self.patience, || {
            let lasts_s = (self.plant.elapsed() - begun).as_secs_f64();
            if lasts_s >= CUT_S { Vec::new() } else { vec![lasts_s] }
        });
        let lasted_s = (self.plant.elapsed() - begun).as_secs_f64();
        self.fleet.leaves[0].begin();
        println!("the line was cut for {lasted_s:.0} s of plant time, {:.1} s on the wall", now() - cut);
        self.excuses.push(cut - HEARD_S..=cut + HEARD_S);

        second.until("what was done at the edge", self.patience, |second| alarm(second, id) != "shelved");
        let newest = latest(edge);
        second.until("the diagnoses of meanwhile", self.patience, |second| latest(second) >= newest);
        // Orders are heard one after the other: once this one is done the one before it was refused.
        second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(3600));
        edge.until("the next order is done", self.patience, |edge| alarm(edge, &name) == "shelved");
    }

    /// The hub and the edge are restarted with what is on their disks; what was found meanwhile is forwarded.
    fn hub_and_edge_are_restarted(&mut self, edge: Daemon, second: &Daemon) -> Daemon {
        let cut = now();
        self.fleet.hub.end();
        self.excuses.push(cut - HEARD_S..=cut + HEARD_S);
        let before = latest(&edge);
        edge.stop();
        let edge = self.fleet.again("edge", &format!("edge-{SITE}"));
        edge.until("the edge goes on", self.patience, |edge| latest(edge) > before);
        self.fleet.hub.begin();
        let newest = latest(&edge);
        second.until("the diagnoses of both lives", self.patience, |second| latest(second) >= newest);
        edge
    }

    /// What every edge has now is at the centre, once and to the last bit, and people are told of it.
    fn nothing_is_lost_or_doubled(&self, edges: Vec<Daemon>, centre: Daemon) {
        let marks: Vec<Mark> = self.fleet.sites().iter().map(|site| Mark::of(&self.fleet, site)).collect();
        marks.iter().for_each(|mark| mark.reach(&centre, "c2", &self.wire, self.patience));
        edges.into_iter().for_each(Daemon::stop);
        centre.until("people are told of all that a centre knows", self.patience, |_| {
            self.wire.is_done(ALARMS, "centres_tell")
        });
        centre.stop();
        for mark in &marks {
            let (edge, loops) = (self.fleet.store_at(&mark.site), LOOPS * self.fleet.copies);
            compare(&edge, &self.fleet.store("c2"), mark, loops, &[]);
        }
    }

    /// While workers were there the edge of a site diagnosed nothing by itself, and took what they said; what a killed worker held
    /// as well. That a source is silent the edge tells without a diagnosis, because only its clock knows.
    fn workers_made_it(&self, site: &str) {
        let (kept, made) = (reports(&self.fleet.store_at(site), site), self.wire.made(site));
        let is_within = |((_, at), _): &(&Made, &Kept)| self.stretch.contains(&f64::from_bits(*at));
        let own: Vec<(&Made, &Kept)> = kept.iter().filter(is_within).collect();
        let is_diagnosed = |(_, own): &&(&Made, &Kept)| own.reason_code.as_deref() != Some("silent");
        let alone: Vec<&Made> = own
            .iter()
            .filter(is_diagnosed)
            .map(|(key, _)| *key)
            .filter(|key| !made.contains_key(*key))
            .collect();
        assert!(own.len() >= LOOPS * self.fleet.copies && alone.is_empty(), "{} and {alone:?}", own.len());
        // Where a poll comes late on a busy machine a verdict may be another for once.
        let right = own.iter().filter(|((name, _), own)| own.outcome == self.expected(name)).count();
        assert!(10 * right >= 9 * own.len(), "{right} of {} verdicts are right", own.len());
        println!("{site}: {right} of {} verdicts of workers are right", own.len());
        for (of, _, key) in self.held.iter().flat_map(|key| self.wire.answers(key)) {
            assert!(of != site || kept.contains_key(&key), "{of}: its edge has not taken {key:?}");
        }
    }

    /// A replay of what an edge measured makes each of its diagnoses again, to the last bit, whoever had made it: of a small fleet
    /// those of the time of the workers, of a large one all.
    fn a_replay_says_the_same(&self, site: &str) {
        let store = self.fleet.store_at(site);
        let config = self.fleet.folder.join(format!("edge-{site}.toml"));
        let mut command = stictiond();
        command.arg("replay").arg(&store).arg("--config").arg(config);
        let mut within = f64::NEG_INFINITY..=f64::INFINITY;
        if self.fleet.copies == 1 {
            within = self.stretch.clone();
            command.arg("--from").arg(within.start().to_string());
            command.arg("--to-time").arg(within.end().to_string());
        }
        let kept = reports(&store, site);
        let with_report = kept.iter().filter(|(_, own)| !own.report.is_empty());
        let all = with_report.filter(|((_, at), _)| within.contains(&f64::from_bits(*at))).count();
        let output = command.output().expect("runs");
        let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        let last = out.lines().last().unwrap_or_default();
        let wanted = format!("{all} of {all} diagnoses identical to the recorded, bit for bit");
        assert!(output.status.success() && all >= LOOPS && last == wanted, "{wanted}, but: {out}{err}");
        println!("{site}: {last}");
    }

    /// Each alarm was told once, by whichever machine, but for what was told just before a fault; and every alarm that a centre
    /// knows was told, or waits on a disk.
    fn people_were_told_once(&self, told: &Receiver<(SystemTime, String)>) {
        let letters = letters(told);
        let named = named_in(&letters);
        let at = |site: &&str| happened(&self.fleet.store_at(site), site);
        let known: Vec<String> = self.fleet.sites().iter().flat_map(at).collect();
        let twice = too_often(&letters, &self.excuses, &known);
        assert!(twice.is_empty(), "{twice:#?}; may be told once more: {:.3?}", self.excuses);
        let mut tellers = vec![self.fleet.store("c1"), self.fleet.store("c2")];
        tellers.extend(self.fleet.sites().iter().map(|site| self.fleet.store_at(site)));
        for store in &tellers[..2] {
            for site in self.fleet.sites() {
                let missing = untold(store, site, &named, &tellers);
                assert!(!named.is_empty() && missing.is_empty(), "{missing:?} of {named:?}");
            }
        }
        let all = LOOPS * self.fleet.plants();
        println!("{all} loops: {} letters of {} alarms", letters.len(), named.len());
    }
}

/// A shelving for so long (s).
fn order(duration: u32) -> String {
    format!("{{\"by\":\"kim\",\"duration_s\":{duration}}}")
}

/// When a loop of the site was diagnosed last (s).
fn latest(daemon: &Daemon) -> f64 {
    let all = times(daemon).into_iter().filter(|(id, _)| of_site(id, SITE).is_some());
    all.map(|(_, time)| time).fold(0.0, f64::max)
}
