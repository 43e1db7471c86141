//! An edge of many loops announces itself in parts: a centre lists all of its loops or none of them.

use crate::daemon::Daemon;
use crate::rig::{Fleet, PATIENCE, connected};
use crate::webhook;
use prost::Message;
use std::collections::BTreeSet;
use std::slice::from_ref;
use stictiond::fleet::announcement::split;
use stictiond::fleet::link::{Link, Outgoing};
use stictiond::fleet::message::{Hello, Loop, Tag};
use stictiond::fleet::subject::{Subject, What, of_site};
use stictiond::fleet::weights::MOST_DECODED;
use stictiond::protobuf::{Weighed, weigh};

const SITE: &str = "north";
const LOOPS: usize = 2_000;
/// As few as a loop may have: a centre makes a ring for each, at once.
const TAGS: [&str; 2] = ["op", "pv"];
/// Loops upstream of each: their names take five times their bytes once they are decoded, and no ring.
const UPSTREAM: usize = 130;

/// The name of a loop at its edge.
fn name(edge: &str, at: usize) -> String {
    format!("{edge}-{at:05}")
}

/// What an edge of so many loops is.
fn list(edge: &str, loops: usize) -> Vec<u8> {
    let tag = |name: &str| Tag {
        name: name.to_string(),
        source: format!("{edge} holding {name} f32"),
        unit: "%".to_string(),
        collector: edge.to_string(),
    };
    let one = |at: usize| Loop {
        id: name(edge, at),
        description: "Feed to the column, north".to_string(),
        group: "Unit 100".to_string(),
        period_s: 600.0,
        op_span: Some(100.0),
        tags: TAGS.map(tag).to_vec(),
        upstream: (1..loops.min(UPSTREAM + 1)).map(|by| name(edge, (at + by) % loops)).collect(),
        ..Loop::default()
    };
    Hello { loops: (0..loops).map(one).collect(), collectors: vec![edge.to_string()] }.encode_to_vec()
}

/// What it announces.
fn announced(edge: &str, loops: usize) -> Vec<Outgoing> {
    split(&Subject::new(SITE, edge, What::Hello), &list(edge, loops))
}

/// The names at a centre of so many loops of an edge.
fn names(edge: &str, loops: usize) -> BTreeSet<String> {
    (0..loops).map(|at| of_site(SITE, &name(edge, at))).collect()
}

async fn send(link: &Link, messages: &[Outgoing]) {
    link.send(messages).await.map_err(|(_, error)| error).expect("they are kept");
}

/// How many loops a centre lists.
fn total(centre: &Daemon) -> usize {
    let list = centre.json("/api/v1/loops?limit=1");
    list["total"].as_u64().and_then(|total| usize::try_from(total).ok()).expect("a number")
}

/// The loops that a centre lists, page by page.
fn listed(centre: &Daemon) -> BTreeSet<String> {
    let (mut names, mut after) = (BTreeSet::new(), String::new());
    loop {
        let list = centre.json(&format!("/api/v1/loops?limit=1000&sort=id{after}"));
        let items = list["items"].as_array().expect("loops").iter();
        names.extend(items.map(|item| item["id"].as_str().expect("a name").to_string()));
        let Some(next) = list["next"].as_str() else { return names };
        after = format!("&after={next}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edge_of_many_loops_is_listed_whole_or_not_at_all() {
    let fleet = Fleet::sized("announced", 1, 1);
    let link = connected(&fleet.hub, "").await;
    let (receiver, _told) = webhook::receiver();
    let centre = fleet.centre("c1", receiver);
    let e2 = announced("e2", 1);
    let all = |loops: usize| names("e1", loops).into_iter().chain(names("e2", 1)).collect::<BTreeSet<_>>();

    // More than a message may take.
    let weight = weigh(&list("e1", LOOPS), Hello::FIELDS, usize::MAX).expect("ours");
    assert!(weight > MOST_DECODED, "{weight} bytes");
    let whole = announced("e1", LOOPS);
    let (last, others) = whole.split_last().expect("there are parts");
    assert!(others.len() > 1, "{} parts", whole.len());
    send(&link, others).await;
    // A centre hears this after all of that.
    send(&link, &e2).await;
    centre.until("another edge is listed", PATIENCE, |centre| total(centre) > 0);
    assert_eq!(listed(&centre), names("e2", 1), "a list is taken that is not whole");
    send(&link, from_ref(last)).await;
    centre.until("all loops are listed", PATIENCE, |centre| total(centre) == LOOPS + 1);
    assert!(listed(&centre) == all(LOOPS), "other loops are listed");
    let id = of_site(SITE, &name("e1", LOOPS - 1));
    let own = centre.json(&format!("/api/v1/loops/{id}"));
    assert_eq!(own["values"].as_array().map(Vec::len), Some(TAGS.len()), "{own}");

    // The edge is stopped while it announces another list. A centre that is started then hears the last part of the older one,
    // and finds parts of both.
    let other = announced("e1", LOOPS + 1);
    let (first, rest) = other.split_at(other.len() / 2);
    send(&link, first).await;
    send(&link, &e2).await;
    centre.stop();
    let centre = fleet.again("centre", "c1");
    centre.until("the other edge is listed again", PATIENCE, |centre| total(centre) > 0);
    assert_eq!(listed(&centre), names("e2", 1), "a list is taken of parts of two");
    send(&link, rest).await;
    centre.until("all loops of the other list are listed", PATIENCE, |centre| total(centre) == LOOPS + 2);
    assert!(listed(&centre) == all(LOOPS + 1), "other loops are listed");

    // A shorter list replaces it, and the parts that the stream still has of the longer one stand for nothing, also to a
    // centre that finds both.
    send(&link, &announced("e1", 3)).await;
    centre.until("the shorter list is taken", PATIENCE, |centre| total(centre) == 4);
    assert_eq!(listed(&centre), all(3));
    centre.stop();
    let centre = fleet.again("centre", "c1");
    centre.until("all loops are listed again", PATIENCE, |centre| total(centre) == 4);
    assert_eq!(listed(&centre), all(3));
    drop(centre);
    std::fs::remove_dir_all(&fleet.folder).expect("writable");
}
