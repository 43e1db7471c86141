//! A centre with 10,000 loops of several sites and units: its map, the pages of its list, search, the way down from a site to a
//! loop, and its machines.

use crate::http::{get, post};
use crate::many::{self, Own};
use crate::rig::{Rig, assert_problem};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::Arc;

const LOOPS: usize = 10_000;
/// How the loops stand, one after the other. There are 13, so that each site and each unit has loops of most states.
const LETTERS: &str = "USOANORLHXWOO";
/// As the map has them, worst first.
const WORST_FIRST: &str = "UASRLHXNWO";
/// Most loops of a page.
const PAGE: usize = 1000;

/// Loops of odd sites: one without units, one whose name is the beginning of others, and names that have to be encoded.
fn odd() -> Vec<Own> {
    let own = |id: &str, group: &str, letter| Own {
        id: id.into(),
        description: "a /?&=+%41 \"Ünit\"".into(),
        group: group.into(),
        letter,
    };
    vec![
        own("west:A", "west", 'O'),
        own("west:B", "west", 'U'),
        own("s0:<b>a/b & \"c\" ü", "s0 / <b>U & 1</b> / 2?x=1", 'S'),
        own("s0:W+1", "s0", 'W'),
    ]
}

/// 10,000 loops, the odd ones among them.
fn loops() -> Vec<Own> {
    let odd = odd();
    let mut all = many::loops(LOOPS - odd.len(), LETTERS);
    all.extend(odd);
    all
}

async fn serve(loops: &[Own]) -> SocketAddr {
    let report: Arc<str> = "{}".into();
    many::served(loops, many::machines(), |_| report.clone()).await.0
}

async fn ask(to: SocketAddr, path: &str) -> Value {
    let answer = get(to, path).await;
    assert_eq!(answer.status, 200, "{path}: {}", answer.text());
    answer.json()
}

/// How many loops a query finds.
async fn total(to: SocketAddr, query: &str) -> usize {
    let list = ask(to, &format!("/api/v1/loops?limit=1&{query}")).await;
    let total = list["total"].as_u64().and_then(|total| usize::try_from(total).ok());
    total.expect("a number")
}

/// All loops that a query finds, by pages of `limit`.
async fn pages(to: SocketAddr, query: &str, limit: usize) -> Vec<Value> {
    let (mut found, mut after) = (Vec::new(), String::new());
    for page in 1.. {
        let list = ask(to, &format!("/api/v1/loops?limit={limit}&{query}{after}")).await;
        let items = list["items"].as_array().expect("a list");
        found.extend(items.iter().cloned());
        assert!(found.len() <= LOOPS, "{query}: page {page} brings what was there already");
        let Some(next) = list["next"].as_str() else {
            assert_eq!(list["total"], found.len(), "{query}");
            return found;
        };
        assert_eq!(items.len(), limit, "{query}: only the last page is shorter");
        after = format!("&after={next}");
    }
    unreachable!("the pages end")
}

/// A text as a part of a query.
fn encoded(text: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric();
    text.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

fn text(value: &Value) -> &str {
    value.as_str().expect("a text")
}

fn worst_first(letters: &str) -> String {
    let mut letters: Vec<char> = letters.chars().collect();
    letters.sort_by_key(|letter| WORST_FIRST.find(*letter));
    letters.into_iter().collect()
}

/// The letters of the loops by group, worst first.
fn by_group(loops: &[Own]) -> BTreeMap<String, String> {
    let mut groups = BTreeMap::<String, String>::new();
    for own in loops {
        groups.entry(own.group.clone()).or_default().push(own.letter);
    }
    groups.values_mut().for_each(|letters| *letters = worst_first(letters));
    groups
}

fn site_of(group: &str) -> &str {
    group.split_once(" / ").map_or(group, |(site, _)| site)
}

#[tokio::test]
async fn the_map_has_each_of_10_000_loops_once_by_site_unit_and_state() {
    let loops = loops();
    let to = serve(&loops).await;
    let map = ask(to, "/api/v1/map").await;
    let groups = map["groups"].as_array().expect("groups");
    let groups: Vec<(String, String)> =
        groups.iter().map(|own| (text(&own["group"]).into(), text(&own["loops"]).into())).collect();
    assert_eq!(groups, Vec::from_iter(by_group(&loops)), "by name, each unit's loops worst first");
    assert_eq!(map["total"], LOOPS);
    assert_eq!(groups.iter().map(|(_, letters)| letters.len()).sum::<usize>(), LOOPS);
    // The list counts as the map does: by site, by unit and by state.
    let mut sites = BTreeMap::<&str, usize>::new();
    for (group, letters) in &groups {
        *sites.entry(site_of(group)).or_default() += letters.len();
    }
    assert_eq!((sites.len(), sites["west"], sites["s0"]), (22, 2, 2));
    for (site, count) in sites {
        assert_eq!(total(to, &format!("site={site}")).await, count, "{site}");
    }
    for (group, letters) in groups.iter().step_by(97) {
        assert_eq!(total(to, &format!("group={}", encoded(group))).await, letters.len(), "{group}");
    }
    let standing = |among: &str| loops.iter().filter(|own| among.contains(own.letter)).count();
    let states = [
        ("alarm=unacknowledged", "U"),
        ("alarm=acknowledged", "A"),
        ("alarm=returned-unacknowledged", "R"),
        ("alarm=latched-unacknowledged", ""),
        ("alarm=latched-acknowledged", "L"),
        ("alarm=shelved", "H"),
        ("alarm=suppressed-by-design", ""),
        ("alarm=out-of-service", "X"),
        ("alarm=normal&verdict=stiction", "S"),
        ("alarm=normal&verdict=not_identifiable", "N"),
        ("alarm=normal&verdict=none", "W"),
        ("alarm=normal&verdict=no_stiction", "O"),
    ];
    let mut sum = 0;
    for (query, letters) in states {
        let found = total(to, query).await;
        assert_eq!(found, standing(letters), "{query}");
        sum += found;
    }
    assert_eq!(sum, LOOPS);
}

#[tokio::test]
async fn pages_visit_each_of_10_000_loops_once_and_in_order() {
    let loops = loops();
    let to = serve(&loops).await;
    let ids = |items: &[Value]| items.iter().map(|own| text(&own["id"]).to_string()).collect::<Vec<_>>();
    let worst = pages(to, "sort=severity", PAGE).await;
    let all: BTreeSet<String> = loops.iter().map(|own| own.id.clone()).collect();
    assert_eq!((worst.len(), BTreeSet::from_iter(ids(&worst))), (LOOPS, all));
    // By severity, then by f, both from the greatest on, then by name.
    let place = |own: &Value| (own["severity"].as_u64(), own["f"].as_f64().unwrap_or(f64::NEG_INFINITY));
    for pair in worst.windows(2) {
        let (before, after) = (place(&pair[0]), place(&pair[1]));
        let by_name = || text(&pair[0]["id"]) < text(&pair[1]["id"]);
        assert!(before > after || before == after && by_name(), "{} before {}", pair[0], pair[1]);
    }
    // Of one site by name, there and back, and by unit: a page that ends among equal units loses none.
    let of_site = loops.iter().filter(|own| site_of(&own.group) == "s07");
    let mut by_unit: Vec<(&str, &str)> = of_site.map(|own| (own.group.as_str(), own.id.as_str())).collect();
    by_unit.sort_unstable();
    let by_unit: Vec<&str> = by_unit.into_iter().map(|(_, id)| id).collect();
    let mut by_name = by_unit.clone();
    by_name.sort_unstable();
    assert_eq!(ids(&pages(to, "site=s07&sort=group", 123).await), by_unit);
    assert_eq!(ids(&pages(to, "site=s07&sort=id", 300).await), by_name);
    by_name.reverse();
    assert_eq!(ids(&pages(to, "site=s07&sort=id&order=desc", 300).await), by_name);
}

#[tokio::test]
async fn search_and_the_way_down_find_exactly_the_loops_that_are_meant() {
    let loops = loops();
    let to = serve(&loops).await;
    for needle in [
        "FIC-047",
        "s07:fic-0",
        "to column 17",
        "S03 / u17",
        "/?&=+%41 \"ü",
        "<B>a/b & \"C\" Ü",
        "w+1",
        "nowhere",
    ] {
        let lower = needle.to_lowercase();
        let holds = |text: &str| text.to_lowercase().contains(&lower);
        let meant = loops.iter().filter(|own| holds(&own.id) || holds(&own.description) || holds(&own.group));
        let meant: BTreeSet<&str> = meant.map(|own| own.id.as_str()).collect();
        let found = pages(to, &format!("q={}", encoded(needle)), PAGE).await;
        let found: BTreeSet<&str> = found.iter().map(|own| text(&own["id"])).collect();
        assert_eq!(found, meant, "{needle}");
        assert_eq!(meant.is_empty(), needle == "nowhere", "{needle}");
    }
    assert_eq!(
        total(to, "q=FEED").await,
        LOOPS - odd().len(),
        "a word of every description but the odd ones"
    );
    // Down from a site to a unit and a loop, within a search too.
    let of = |group: &str| loops.iter().filter(|own| own.group == group).count();
    assert_eq!(total(to, "site=s03&q=column%2017").await, of("s03 / U17"));
    assert_eq!(total(to, "site=s03&group=s03%20/%20U17").await, of("s03 / U17"));
    assert_eq!(total(to, "site=s04&group=s03%20/%20U17").await, 0);
    for own in odd().iter().chain(loops.iter().filter(|own| own.group == "s03 / U17").take(1)) {
        let detail = ask(to, &format!("/api/v1/loops/{}", encoded(&own.id))).await;
        assert_eq!((text(&detail["id"]), text(&detail["group"])), (own.id.as_str(), own.group.as_str()));
    }
    let of_unit = pages(to, &format!("group={}", encoded(&odd()[2].group)), 10).await;
    assert_eq!(of_unit.iter().map(|own| text(&own["id"])).collect::<Vec<_>>(), [odd()[2].id.as_str()]);
    // What is not there is said plainly.
    for nothing in ["site=nowhere", "site=s", "site=s03%20", "group=s03", "group=", "site="] {
        let list = ask(to, &format!("/api/v1/loops?{nothing}")).await;
        assert_eq!((&list["total"], &list["items"], &list["next"]), (&json!(0), &json!([]), &Value::Null));
    }
    for (query, field) in [("after=zz", "after"), ("limit=1001", "limit"), ("unit=U17", "unit")] {
        let problem = assert_problem(&get(to, &format!("/api/v1/loops?{query}")).await, 400);
        assert_eq!(problem["field"], field, "{query}");
    }
    let problem = assert_problem(&get(to, "/api/v1/loops/s03%3AFIC-99999").await, 404);
    assert_eq!(problem["loop"], "s03:FIC-99999");
    assert_eq!(assert_problem(&get(to, "/api/v1/map?site=s03").await, 400)["field"], "site");
    // A loop is diagnosed at its edge.
    assert_problem(&post(to, "/api/v1/loops/west%3AA/diagnosis", "").await, 409);
}

#[tokio::test]
async fn machines_say_how_they_are_and_an_empty_centre_is_empty() {
    let to = serve(&[]).await;
    let fleet = ask(to, "/api/v1/fleet").await;
    assert_eq!((text(&fleet["role"]), text(&fleet["name"])), ("centre", "c1"));
    let machines = fleet["machines"].as_array().expect("machines");
    assert_eq!(machines.len(), 24);
    let of = |name: &str| machines.iter().find(|own| own["name"] == name).expect("it was heard of");
    let usual = of("edge-s06");
    assert_eq!(
        (text(&usual["role"]), text(&usual["site"]), text(&usual["version"])),
        ("edge", "s06", "0.1.0")
    );
    assert_eq!((usual["lag_s"].as_f64(), usual["clock_offset_s"].as_f64()), (Some(0.8), Some(0.004)));
    assert_eq!((usual["loops"].as_u64(), usual["diagnosed"].as_u64()), (Some(500), Some(4711)));
    assert_eq!((usual["silent"].as_bool(), text(&usual["since"])), (Some(false), "2025-12-31T00:00:00Z"));
    assert_eq!(text(&usual["certificate"]), "[fleet] certificate_file");
    assert_eq!(text(&usual["certificate_until"]), "2027-01-01T00:00:00Z");
    assert_eq!(of("edge-s00")["lag_s"], 600.0);
    assert_eq!(of("edge-s01")["clock_offset_s"], 2.5);
    let silent: Vec<&str> =
        machines.iter().filter(|own| own["silent"] == true).map(|own| text(&own["name"])).collect();
    assert_eq!(silent, ["edge-s02"]);
    assert_eq!(text(&of("edge-s03")["certificate"]), "dcs user_certificate");
    assert_eq!(text(&of("edge-s03")["certificate_until"]), "2026-01-11T00:00:00Z");
    assert_eq!(text(&of("edge-s04")["version"]), "0.0.9");
    let without = of("edge-s05");
    assert_eq!((&without["certificate"], &without["certificate_until"]), (&Value::Null, &Value::Null));
    assert_eq!((text(&of("w1")["role"]), &of("w1")["site"]), ("worker", &Value::Null));
    // No edge has said yet which loops it has.
    let map = ask(to, "/api/v1/map").await;
    assert_eq!((&map["total"], &map["groups"]), (&json!(0), &json!([])));
    assert_eq!(Rig::ids(&ask(to, "/api/v1/loops").await), [""; 0]);
}

#[tokio::test]
async fn what_backs_up_in_the_fleet_is_in_the_metrics() {
    let to = serve(&[]).await;
    let text = get(to, "/metrics").await.text();
    let value = |series: &str| -> Option<f64> {
        let line = text.lines().find_map(|line| line.strip_prefix(series)?.strip_prefix(' '));
        line.and_then(|value| value.parse().ok())
    };
    let of = |name: &str, role: &str, site: &str, machine: &str| {
        value(&format!("stictiond_fleet_{name}{{role=\"{role}\",site=\"{site}\",machine=\"{machine}\"}}"))
    };
    assert_eq!(of("lag_seconds", "edge", "s00", "edge-s00"), Some(600.0), "{text}");
    assert_eq!(of("lag_seconds", "centre", "", "c1"), Some(0.8));
    assert_eq!(of("lag_seconds", "worker", "", "w1"), None, "a worker forwards nothing");
    let near = |value: Option<f64>, wanted: f64| value.is_some_and(|own| (own - wanted).abs() < 0.5);
    assert!(near(of("heard_age_seconds", "edge", "s02", "edge-s02"), 60.0), "{text}");
    assert!(near(of("heard_age_seconds", "worker", "", "w1"), 2.0), "{text}");
    assert!(near(of("certificate_days", "edge", "s03", "edge-s03"), 10.0), "{text}");
    assert_eq!(of("certificate_days", "edge", "s05", "edge-s05"), None);
    assert_eq!(value("stictiond_fleet_windows_waiting"), Some(42.0));
    let fill = |stream: &str| value(&format!("stictiond_fleet_stream_fill_ratio{{stream=\"{stream}\"}}"));
    assert_eq!((fill("stictiond_alarms"), fill("stictiond_samples")), (Some(0.85), Some(1.0)));
}
