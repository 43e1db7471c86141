//! What an edge does of what a centre orders: nothing that comes from a centre which was replaced.

use crate::daemon::Daemon;
use crate::options;
use crate::rig::{Fleet, PATIENCE, alarm, connected, now};
use crate::webhook;
use prost::Message;
use stictiond::demo::Demo;
use stictiond::fleet::link::{Link, Outgoing};
use stictiond::fleet::message::Action;
use stictiond::fleet::subject::{Subject, What};

const SITE: &str = "north";

/// Has a centre of this epoch order something.
async fn order(link: &Link, (name, action): (&str, &str), epoch: u64) {
    let order = Action {
        subject: name.to_string(),
        kind: "stiction".to_string(),
        action: action.to_string(),
        by: Some("kim".to_string()),
        at: now(),
        epoch,
        ..Action::default()
    };
    let subject = Subject::new(SITE, name, What::Action).to_string();
    let message = Outgoing::once(subject, order.encode_to_vec());
    link.send(&[message]).await.map_err(|(_, error)| error).expect("it is kept");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_of_a_centre_that_was_replaced_is_refused() {
    let fleet = Fleet::sized("orders", 1, 1);
    let link = connected(&fleet.hub, "").await;
    // Its plant does not run: an alarm can be taken out of service all the same.
    let demo = Demo::build(&options(1)).await.expect("builds");
    let (receiver, _told) = webhook::receiver();
    let edge = fleet.edge(SITE, &demo, receiver);
    let [one, other] = [0, 1].map(|at| demo.loops()[at].id.clone());
    let is_out = |edge: &Daemon, name: &str| alarm(edge, name) == "out-of-service";

    order(&link, (one.as_str(), "take_out"), 7).await;
    edge.until("an order is done", PATIENCE, |edge| is_out(edge, &one));
    order(&link, (one.as_str(), "give_back"), 6).await;
    order(&link, (other.as_str(), "take_out"), 7).await;
    // Orders are heard one after the other: once this one is done the one before it was refused.
    edge.until("the next order is done", PATIENCE, |edge| is_out(edge, &other));
    assert!(is_out(&edge, &one), "an order of an older epoch was done");
    // A newer centre may order the same.
    order(&link, (one.as_str(), "give_back"), 8).await;
    edge.until("an order of a newer centre is done", PATIENCE, |edge| !is_out(edge, &one));
    drop(edge);
    std::fs::remove_dir_all(&fleet.folder).expect("writable");
}
