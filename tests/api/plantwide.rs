//! The plant as a whole: a daemon over a store that holds half a day of 24 coupled loops, one of which a load swings.

use crate::app::{Daemon, start_at};
use crate::http::{get, post};
use crate::rig::assert_problem;
use crate::swinging::{START, site};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;
use stictiond::schedule::Clock;

/// Looks a minute of plant time apart, 4 s on the wall: no data comes after the beginning, and a loop is silent 300 s later.
const SPEED: f64 = 15.0;
/// Asks again and again until the answer is what is waited for.
async fn until(daemon: &Daemon, path: &str, what: &str, good: impl Fn(&Value) -> bool) -> Value {
    for _ in 0..600 {
        let answer = get(daemon.address, path).await;
        if answer.status == 200 && good(&answer.json()) {
            return answer.json();
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{what}: {}", get(daemon.address, path).await.text());
}

async fn stop(daemon: Daemon) {
    daemon.app.stop().cancel();
    let ended = tokio::time::timeout(Duration::from_secs(20), daemon.task).await;
    ended.expect("ends in time").expect("no panic").expect("ends well");
}

fn named<'a>(work: &'a Value, id: &str) -> &'a Value {
    let items = work["items"].as_array().expect("a list");
    items.iter().find(|item| item["id"] == id).unwrap_or(&Value::Null)
}

/// Who calms down with the source of a group is told wherever the loop is shown, by its order and for as long as looks say so; of a
/// source that does not stand out nobody does.
async fn calms_down_with(daemon: &Daemon, group: &Value, line: &Value) {
    let first = &group["suspects"][0];
    let source = first["id"].as_str().expect("a suspect");
    let names = |list: &Value| -> BTreeSet<String> {
        list.as_array().expect("names").iter().filter_map(Value::as_str).map(str::to_string).collect()
    };
    let victims = names(&line["victims"]);
    let stands_out = first["probability"].as_f64().expect("a probability") >= 0.5;
    assert_eq!(!victims.is_empty(), stands_out, "{group} {line}");
    for other in names(&group["members"]).iter().filter(|id| *id != source) {
        let detail = daemon.json(&format!("/api/v1/loops/{other}")).await;
        let told = &detail["swings_with"];
        assert_eq!(told == source, victims.contains(other), "{other}: {told} {line}");
        if victims.contains(other) {
            let cause = &detail["cause"];
            assert_eq!(
                (&cause["name"], &cause["neighbour"]),
                (&json!("neighbour"), &json!(source)),
                "{detail}"
            );
            let causes = cause["causes"].as_array().expect("a list");
            let same = causes.iter().find(|own| own["name"] == "neighbour").expect("it is among them");
            assert_eq!((causes.len(), &same["probability"]), (7, &cause["probability"]), "{detail}");
            assert!(cause["why"].as_str().is_some_and(|why| why.contains(source)), "{detail}");
        }
    }
    if let Some(victim) = victims.first() {
        let report = get(daemon.address, &format!("/api/v1/loops/{victim}/report.html")).await.text();
        assert!(report.contains(&format!("It swings with {source}")), "{report}");
    }
}

/// How loops stand among others is in their list, which is sorted by it; what is no single number is beside their indicators.
async fn stand_among_others(daemon: &Daemon, priced: &str) {
    let by_score = "/api/v1/loops?sort=score";
    let list = until(daemon, by_score, "scores", |list| !list["items"][0]["score"].is_null()).await;
    let items = list["items"].as_array().expect("a list");
    let scores: Vec<f64> = items.iter().map_while(|own| own["score"].as_f64()).collect();
    assert!(scores.len() >= 2 && scores.is_sorted(), "the worst first: {scores:?}");
    assert!(items[scores.len()..].iter().all(|own| own["score"].is_null()), "unknown ones last: {list}");
    let list = daemon.json("/api/v1/loops?sort=cost").await;
    let (first, next) = (&list["items"][0], &list["items"][1]);
    assert_eq!((&first["id"], &first["cost_unit"]), (&json!(priced), &json!("EUR/day")), "{first}");
    assert!(first["cost"].as_f64().is_some_and(|cost| cost >= 0.0), "{first}");
    assert!(next["cost"].is_null() && next["cost_unit"].is_null(), "{next}");
    let path = format!("/api/v1/loops/{priced}/indicators");
    let found = until(daemon, &path, "a look", |found| !found["latest"]["harris"].is_null()).await;
    let names = found["names"].as_array().expect("names");
    let hour = |name: &str| {
        let at = names.iter().position(|own| own["name"] == name).expect(name);
        found["over"]["hour"][at].as_f64()
    };
    // Indicators are kept in single precision.
    let same = |kept: Option<f64>, told: &Value| match (kept, told.as_f64()) {
        (Some(kept), Some(told)) => (kept - told).abs() <= 1e-6 * told.abs(),
        (kept, told) => kept == told,
    };
    let latest = &found["latest"];
    for (name, told) in [
        ("period_s", &latest["oscillations"][0]["period_s"]),
        ("regularity", &latest["oscillations"][0]["regularity_r"]),
        ("harris", &latest["harris"]["index"]),
        ("harris_low", &latest["harris"]["ci95"][0]),
        ("harris_high", &latest["harris"]["ci95"][1]),
        ("harris_dead_time_s", &latest["harris"]["dead_time_s"]),
        ("settling_s", &latest["settling"]["time_s"]),
    ] {
        assert!(same(hour(name), told), "{name}: {:?} {latest}", hour(name));
    }
    let from = latest["harris"]["dead_time_from"].as_str();
    assert_eq!(from == Some("one_sample"), latest["harris"]["dead_time_s"].is_null(), "{latest}");
    assert!(hour("compression").is_some_and(|factor| factor >= 1.0), "{found}");
    // There is no set point, and nobody said what the limits of OP are.
    assert!(hour("ise_per_s").is_none() && latest["op_distribution"].is_null(), "{found}");
    // Without a set point the margins are not known.
    assert_eq!(latest.get("margins"), Some(&Value::Null), "{found}");
}

#[tokio::test(flavor = "multi_thread")]
async fn from_a_swing_that_loops_share_to_an_order_that_outlives_a_restart() {
    let site = site("order");
    let daemon = start_at(site.config.clone(), Clock::plant(START, SPEED)).await;
    let groups = until(&daemon, "/api/v1/groups", "looked at", |groups| !groups["time"].is_null()).await;
    assert_eq!(
        (groups["looked_at"].as_u64(), groups["skipped"].as_array().map(Vec::len)),
        (Some(24), Some(0))
    );
    let group = &groups["items"][0];
    let members: BTreeSet<&str> =
        group["members"].as_array().expect("names").iter().filter_map(Value::as_str).collect();
    let entered = site.of.loops[3].name.as_str();
    assert!(members.len() >= 3 && members.contains(entered), "{groups}");
    stand_among_others(&daemon, entered).await;
    let truth = site.of.period_s[0];
    assert!((group["period_s"].as_f64().expect("a period") / truth - 1.0).abs() < 0.05, "{group} {truth}");
    assert!(group["words"].as_str().is_some_and(|words| words.contains("swing together")), "{group}");
    let drawn = daemon.json("/api/v1/groups/1").await;
    let pictures = drawn["pictures"].as_array().expect("pictures");
    assert!(
        pictures.len() == 4
            && pictures.iter().all(|own| own["svg"].as_str().is_some_and(|svg| svg.starts_with("<svg")))
    );
    assert_problem(&get(daemon.address, "/api/v1/groups/999").await, 404);

    // A suspicion lasts a minute of plant time, and is an order then where its cause is known.
    let source = group["suspects"][0]["id"].as_str().expect("a suspect").to_string();
    let path = "/api/v1/work";
    let lasts = |line: &Value| line["state"] == "open" || line["state"] == "unexplained";
    let work = until(&daemon, path, "an order", |work| lasts(named(work, &source))).await;
    let line = named(&work, &source);
    for own in work["items"].as_array().expect("a list") {
        assert!(own["cause"] != "unknown" || own["part"] == "unknown", "nothing to do: {own}");
    }
    // Of a cause that is not known there is nothing to be sure of.
    assert_eq!(line["probability"].is_null(), line["cause"] == "unknown", "{line}");
    calms_down_with(&daemon, group, line).await;
    if source == entered {
        assert!(
            line["cost"].as_f64().is_some_and(|cost| cost > 0.0) && line["cost_unit"] == "EUR/day",
            "{line}"
        );
    }
    let refused = post(daemon.address, &format!("{path}/{source}/reopen"), "").await;
    assert_problem(&refused, 409);
    assert_problem(&post(daemon.address, &format!("{path}/nobody/order"), "").await, 404);
    let said = json!({"by": "ann", "note": "=order 4711"}).to_string();
    let ordered = post(daemon.address, &format!("{path}/{source}/order"), &said).await;
    assert_eq!(
        (ordered.status, ordered.json()["state"].as_str()),
        (200, Some("ordered")),
        "{}",
        ordered.text()
    );
    assert_eq!(ordered.json()["part"], "first", "what people have ordered is to be done");
    let csv = get(daemon.address, "/api/v1/work.csv").await;
    assert!(
        csv.text().contains(&format!("{source},ordered,")) && csv.text().contains("'=order 4711"),
        "{}",
        csv.text()
    );
    let page = get(daemon.address, "/api/v1/work.html").await;
    assert!(page.text().contains("Work list") && page.text().contains(&source), "{}", page.text());

    let health = daemon.json(&format!("/api/v1/loops/{entered}/indicators")).await;
    assert_eq!(health["names"].as_array().map(Vec::len), health["over"]["hour"].as_array().map(Vec::len));
    assert!(
        health["over"]["day"][0].as_f64().is_some_and(|score| (0.0..=100.0).contains(&score)),
        "{health}"
    );
    assert!(health["looks"].as_array().is_some_and(|looks| !looks.is_empty()));
    let report = get(daemon.address, &format!("/api/v1/loops/{entered}/report.html")).await.text();
    assert!(report.contains("<h2>Health</h2>"), "{report}");
    let metrics = get(daemon.address, "/metrics").await.text();
    for series in [
        "stictiond_work_orders{state=\"ordered\"} 1",
        "stictiond_loop_indicator{loop=",
        ",indicator=\"compression\"} ",
        "stictiond_swing_groups ",
    ] {
        assert!(metrics.contains(series), "{series} in {metrics}");
    }
    stop(daemon).await;

    // Another run of the daemon knows of the order before it has looked.
    let mut config = site.config.clone();
    config.plantwide.enabled = false;
    let daemon = start_at(config, Clock::plant(START + 7200.0, SPEED)).await;
    let work = daemon.json(path).await;
    let line = named(&work, &source);
    assert_eq!(
        (line["state"].as_str(), line["by"].as_str(), line["note"].as_str()),
        (Some("ordered"), Some("ann"), Some("=order 4711"))
    );
    assert!(daemon.json("/api/v1/groups").await["time"].is_null());
    assert_problem(&post(daemon.address, "/api/v1/groups", "").await, 409);
    stop(daemon).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_look_can_be_asked_for() {
    let site = site("asked");
    let mut config = site.config.clone();
    config.plantwide.period_s = 86_400.0;
    config.plantwide.persist_s = 86_400.0;
    let daemon = start_at(config, Clock::plant(START, 1.0)).await;
    assert!(daemon.json("/api/v1/groups").await["time"].is_null());
    assert_eq!(post(daemon.address, "/api/v1/groups", "").await.status, 202);
    let groups = until(&daemon, "/api/v1/groups", "looked at", |groups| !groups["time"].is_null()).await;
    assert!(groups["items"].as_array().is_some_and(|items| !items.is_empty()), "{groups}");
    // What has been seen once is watched, and nobody has anything to do yet.
    let work = daemon.json("/api/v1/work").await;
    assert!(
        work["items"].as_array().is_some_and(Vec::is_empty) && work["watched"].as_u64() > Some(0),
        "{work}"
    );
    let all = daemon.json("/api/v1/work?all=true").await;
    assert!(all["items"].as_array().expect("a list").iter().all(|item| item["state"] == "watched"), "{all}");
    stop(daemon).await;
}
