//! Edges, workers and centres as processes, with nats-servers of Debian between them: a hub, and a leaf node for each site.
//!
//! One site of 20 loops, or what `FLEET_SITES` (up to 3) and `FLEET_COPIES` (each loop so often) say: `scripts/fleet prove`
//! runs three sites of 100 loops.

#[path = "../peers/daemon.rs"]
mod daemon;
mod faults;
#[path = "../peers/nats.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod nats;
mod reader;
mod rig;
mod told;
#[path = "../peers/webhook.rs"]
mod webhook;

use daemon::Daemon;
use rig::{Fleet, LOOPS, loops};
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::{Duration, SystemTime};
use stictiond::demo::{DEFAULT_SPEED, Demo, Options, Screen};
use told::{at_site, compare, notices, untold};

/// What was told so short before a centre was killed may not be acknowledged by then (s).
const SETTLED_S: f64 = 1.0;
/// An edge that is cut off tells of what it forwarded so short before as if nobody had heard of it, and what a centre is telling
/// just then is told twice (s).
const CUT_OFF: Duration = Duration::from_secs(10);

#[tokio::test(flavor = "multi_thread")]
async fn what_an_edge_measures_and_finds_is_at_the_centre_once_whatever_is_cut_or_killed() {
    let options =
        Options { listen: ([127, 0, 0, 1], 0).into(), speed: DEFAULT_SPEED, seed: 1, writeback: false };
    let mut fleet = Fleet::new("fleet");
    let (receiver, told) = webhook::receiver();
    let first = fleet.centre("c1", receiver);
    let (mut edges, mut plants, mut stops) = (Vec::new(), Vec::new(), Vec::new());
    for (site, seed) in fleet.sites().iter().zip(1..) {
        let demo = Demo::build(&Options { seed, ..options }).await.expect("builds");
        stops.push(demo.stop());
        edges.push(fleet.edge(site, &demo, receiver));
        plants.push(tokio::spawn(demo.run(Screen::new(Vec::new(), false))));
    }
    let (worker, other) = (fleet.worker("w1"), (fleet.plants() > 1).then(|| fleet.worker("w2")));
    let done = tokio::task::spawn_blocking(move || {
        let edge = edges.remove(0);
        let (patience, all) = (fleet.patience(), LOOPS * fleet.plants());
        let verdicts =
            |daemon: &Daemon| loops(daemon).values().filter(|own| own["verdict"].is_string()).count();
        first.until("the centre has every loop and its verdict", patience, |first| verdicts(first) >= all);
        let raised = |daemon: &Daemon| {
            let north =
                |(id, own): &(String, Value)| id.starts_with("north:") && own["alarm"] == "unacknowledged";
            loops(daemon).into_iter().find(north).map(|(id, _)| id)
        };
        first.until("an alarm is raised", patience, |first| raised(first).is_some());

        // What people do at the centre is done at the edge, and shown.
        let id = raised(&first).expect("one");
        let name = at_site(&id);
        let is = |daemon: &Daemon, id: &str, state: &str| loops(daemon)[id]["alarm"] == state;
        first.ask("POST", &format!("/api/v1/alarms/{id}/ack"), "{\"by\":\"eve\"}");
        edge.until("the edge knows", patience, |edge| is(edge, &name, "acknowledged"));
        first.until("the centre knows", patience, |first| is(first, &id, "acknowledged"));

        // A second centre takes over; before that it gives no orders.
        let second = fleet.centre("c2", receiver);
        second.until("the second centre knows", patience, |second| {
            loops(second).get(&id).is_some_and(|own| own["alarm"] == "acknowledged")
        });
        let refused =
            second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), "{\"by\":\"kim\",\"duration_s\":60}");
        assert!(refused.contains("another centre"), "{refused}");
        let times = |daemon: &Daemon| -> BTreeMap<String, String> {
            loops(daemon).into_iter().map(|(id, own)| (id, own["time"].to_string())).collect()
        };
        let began = times(&second);
        // SIGKILL.
        let killed = SystemTime::now();
        drop(first);
        let order = |duration: u32| format!("{{\"by\":\"kim\",\"duration_s\":{duration}}}");
        // Once: an order that is given again would be carried out again, whatever was done at the edge meanwhile.
        second.until("the second centre acts", patience, |second| {
            let answer = second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(3600));
            !answer.contains("another centre")
        });
        second.until("what it did", patience, |second| is(second, &id, "shelved"));

        // The line to the hub is cut, the worker killed: the edge goes on by itself.
        let time = |daemon: &Daemon| loops(daemon).values().map(|own| own["time"].to_string()).max();
        let before = time(&edge);
        let mut cuts = vec![SystemTime::now()];
        fleet.leaves[0].end();
        drop(worker);
        edge.until("the edge diagnoses by itself", patience, |edge| time(edge) > before);
        edge.ask("POST", &format!("/api/v1/alarms/{name}/unshelve"), "{\"by\":\"kim\"}");
        // The centre does not know of it, and what it orders now is refused there.
        let taken = second.ask("POST", &format!("/api/v1/alarms/{id}/out-of-service"), "{\"by\":\"kim\"}");
        assert!(!taken.contains("error"), "the order is given: {taken}");

        // It comes back: nothing is missing, nothing is there twice.
        fleet.leaves[0].begin();
        second.until("what was done at the edge", patience, |second| !is(second, &id, "shelved"));
        let latest = time(&edge);
        second.until("the diagnoses of meanwhile", patience, |second| time(second) >= latest);
        // Orders are heard one after the other: once this one is done the one before it was refused.
        second.ask("POST", &format!("/api/v1/alarms/{id}/shelve"), &order(3600));
        edge.until("the next order is done", patience, |edge| is(edge, &name, "shelved"));

        // The hub and the edge are restarted with what is on their disks; what was found meanwhile is forwarded.
        cuts.push(SystemTime::now());
        fleet.hub.end();
        let before = time(&edge);
        edge.stop();
        let edge = fleet.again("edge", "edge-north");
        edge.until("the edge goes on", patience, |edge| time(edge) > before);
        fleet.hub.begin();
        let latest = time(&edge);
        second.until("the diagnoses of both lives", patience, |second| time(second) >= latest);
        let value = |daemon: &Daemon, id: &str| {
            daemon.json(&format!("/api/v1/loops/{id}"))["values"][0]["time"].to_string()
        };
        let newest = value(&edge, &name);
        second.until("the samples of meanwhile", patience, |second| value(second, &id) >= newest);
        second.until("every loop is diagnosed again", patience, |second| {
            times(second).iter().all(|(id, time)| began.get(id) != Some(time))
        });
        edge.stop();
        edges.into_iter().for_each(Daemon::stop);
        second.until("people are told of all that a centre knows", patience, |_| fleet.all_is_told());
        second.stop();
        drop(other);
        let store = |site: &str| fleet.store(&format!("edge-{site}"));
        for site in fleet.sites() {
            compare(&store(site), &fleet.store("c2"), site, LOOPS * fleet.copies, &[]);
        }

        // Each alarm was told once, by whichever machine, but for what the first centre told just before it was killed.
        let told: Vec<(SystemTime, String)> = told
            .try_iter()
            .flat_map(|(at, body)| notices(&body).into_iter().map(move |notice| (at, notice)))
            .collect();
        let mut first: BTreeMap<&String, SystemTime> = BTreeMap::new();
        let mut twice = Vec::new();
        for (at, notice) in &told {
            let before = *first.entry(notice).or_insert(*at);
            let is_by_both = cuts.iter().any(|cut| (*cut - CUT_OFF..=*cut + CUT_OFF).contains(&before));
            if before != *at && !is_by_both {
                let ago = killed.duration_since(before).map(|ago| ago.as_secs_f64());
                twice.push((notice, ago));
            }
        }
        let may = |ago: &Result<f64, _>| ago.as_ref().is_ok_and(|ago| *ago < SETTLED_S);
        assert!(twice.iter().all(|(_, ago)| may(ago)), "{twice:?} of {told:?}");
        // All that a centre knows of; the rest of what the first was to tell is on its disk.
        let letters: Vec<String> = first.keys().map(|notice| notice.to_string()).collect();
        let mut tellers = vec![fleet.store("c1"), fleet.store("c2")];
        tellers.extend(fleet.sites().iter().map(|site| fleet.store(&format!("edge-{site}"))));
        for (store, site) in
            tellers[..2].iter().flat_map(|store| fleet.sites().iter().map(move |site| (store, site)))
        {
            let missing = untold(store, site, &letters, &tellers);
            assert!(!letters.is_empty() && missing.is_empty(), "{missing:?} of {letters:?}");
        }
        println!(
            "{all} loops: {} letters of {} alarms, {} told twice",
            told.len(),
            letters.len(),
            twice.len()
        );
        std::fs::remove_dir_all(&fleet.folder).expect("writable");
    });
    let done = done.await;
    for (stop, plant) in stops.into_iter().zip(plants) {
        stop.cancel();
        plant.await.expect("no panic").expect("ends well");
    }
    done.expect("all is well");
}
