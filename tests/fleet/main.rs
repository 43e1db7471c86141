//! Edges, workers and centres as processes, with nats-servers of Debian between them: a hub, and a leaf node for each site.
//!
//! One site of 20 loops, or what `FLEET_SITES` (up to 3) and `FLEET_COPIES` (each loop so often) say: `scripts/fleet prove`
//! runs three sites of 100 loops.

mod announced;
#[path = "../peers/daemon.rs"]
mod daemon;
mod deployed;
mod faults;
#[path = "../peers/nats.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod nats;
mod orders;
mod proof;
mod reader;
mod rig;
mod settle;
mod streams;
mod told;
#[path = "../peers/webhook.rs"]
mod webhook;
mod wire;
mod workers;

use proof::Proof;
use rig::{Fleet, tells};
use std::collections::BTreeMap;
use stictiond::demo::{DEFAULT_SPEED, Demo, Options};
use wire::Wire;

/// The demo as it is by itself.
fn options(seed: u64) -> Options {
    Options { listen: ([127, 0, 0, 1], 0).into(), speed: DEFAULT_SPEED, seed, writeback: false }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_edge_measures_and_finds_is_at_the_centre_once_whatever_is_cut_or_killed() {
    let fleet = Fleet::new("fleet");
    let (wire, patience) = (Wire::at(&fleet.hub).await, fleet.patience());
    let (receiver, told) = webhook::receiver();
    let first = fleet.centre("c1", receiver);
    // It makes the streams: an edge whose window no stream takes asks nobody for a minute.
    first.until("the first centre leads", patience, tells);
    // From the beginning: what every centre has is deleted from the streams.
    let second = fleet.centre("c2", receiver);
    let worker = fleet.worker("w1");
    let (mut edges, mut plants, mut stops) = (Vec::new(), Vec::new(), Vec::new());
    let (mut plant, mut expected) = (None, BTreeMap::new());
    for (site, seed) in fleet.sites().iter().zip(1..) {
        // So many polls a second whatever the number of copies, as all parts share one machine.
        let slower = Options { speed: DEFAULT_SPEED / fleet.copies as f64, ..options(seed) };
        let demo = Demo::build(&slower).await.expect("builds");
        plant = plant.or(Some(demo.clock()));
        expected.extend(demo.loops().iter().map(|own| (own.id.clone(), own.expected.as_str())));
        stops.push(demo.stop());
        edges.push(fleet.edge(site, &demo, receiver));
        plants.push(tokio::spawn(demo.run_plant()));
    }
    let proof = Proof::new(fleet, wire, plant.expect("a site"), expected);
    let done = tokio::task::spawn_blocking(move || proof.run(edges, [first, second], worker, &told)).await;
    for (stop, plant) in stops.into_iter().zip(plants) {
        stop.cancel();
        plant.await.expect("no panic").expect("ends well");
    }
    done.expect("all is well");
}
