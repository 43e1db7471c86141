//! What a client that asks often relies on: pages of every list, validators, and streams that go on where they broke off.

use crate::http::{Events, get, post, send};
use crate::rig::{FOUR, Rig, START, assert_problem, rig};
use serde_json::Value;
use stictiond::results::{DeviceSeen, MOST_EVENTS};
use stictiond::signal::LoopId;

/// All entries of a list by pages of `limit`, named by `key`.
async fn joined(rig: &Rig, path: &str, limit: usize, key: &str) -> (Vec<String>, usize) {
    let (mut found, mut after, mut pages) = (Vec::new(), String::new(), 0);
    loop {
        let sign = if path.contains('?') { '&' } else { '?' };
        let list = rig.json(&format!("{path}{sign}limit={limit}{after}")).await;
        let items = list["items"].as_array().expect("a list");
        assert!(items.len() <= limit, "{path}: {} of {limit}", items.len());
        found.extend(items.iter().map(|item| item[key].as_str().expect("a name").to_string()));
        pages += 1;
        let Some(next) = list["next"].as_str() else { return (found, pages) };
        assert_eq!(items.len(), limit, "{path}: only the last page is shorter");
        after = format!("&after={}", next.replace('/', "%2F"));
    }
}

#[tokio::test]
async fn pages_of_alarms_runs_and_devices_join_to_the_whole_list() {
    let names: Vec<String> = (0..11).map(|i| format!("L{i:02}")).collect();
    let loops: Vec<(&str, &str)> = names.iter().map(|name| (name.as_str(), "sticky")).collect();
    let rig = rig(&loops).await;
    for _ in 0..2 {
        for id in &names {
            rig.diagnose(id).await;
        }
    }
    for _ in 0..3 {
        rig.diagnose("L03").await;
    }
    let whole = rig.json("/api/v1/alarms").await;
    assert_eq!((whole["total"].as_u64(), &whole["next"]), (Some(11), &Value::Null));
    let (alarms, pages) = joined(&rig, "/api/v1/alarms", 4, "id").await;
    assert_eq!((&alarms, pages), (&Rig::ids(&whole), 3));
    let one = rig.json("/api/v1/alarms?limit=1").await;
    assert_eq!((one["total"].as_u64(), one["next"].as_str()), (Some(11), Some("L00/stiction")));
    let all = rig.json("/api/v1/loops/L03/diagnoses").await;
    let times: Vec<&str> =
        all["items"].as_array().expect("items").iter().filter_map(|i| i["time"].as_str()).collect();
    let (runs, pages) = joined(&rig, "/api/v1/loops/L03/diagnoses", 2, "time").await;
    assert_eq!((runs.iter().map(String::as_str).collect::<Vec<_>>(), pages), (times, 3));
    assert_eq!(joined(&rig, "/api/v1/collectors", 1, "name").await, (vec!["dcs1".to_string()], 1));
    assert_eq!(rig.json("/api/v1/collectors?after=dcs1").await["items"], serde_json::json!([]));
    for path in
        ["/alarms?limit=0", "/alarms?limit=10001", "/collectors?limit=0", "/loops/L03/diagnoses?limit=0"]
    {
        let problem = assert_problem(&get(rig.address, &format!("/api/v1{path}")).await, 400);
        assert_eq!(problem["field"], "limit", "{path}");
    }
    let cursor = assert_problem(&get(rig.address, "/api/v1/loops/L03/diagnoses?after=soon").await, 400);
    assert_eq!(cursor["field"], "after");
}

#[tokio::test]
async fn all_that_waits_to_be_acknowledged_is_counted() {
    let rig = rig(&FOUR).await;
    let counted = async |filter: &str| {
        let list = rig.json(&format!("/api/v1/alarms?limit=1{filter}")).await;
        (list["to_acknowledge"].as_u64(), list["total"].as_u64())
    };
    assert_eq!(counted("").await, (Some(0), Some(0)));
    rig.diagnose("FIC1").await;
    rig.diagnose("FIC1").await;
    // That of a collector, whose condition has gone before anybody saw it.
    let name = LoopId::new("dcs1");
    rig.results.watch_devices(std::slice::from_ref(&name), START);
    for down in [Some("no good sample for 130 s".to_string()), None] {
        rig.results.watch(vec![DeviceSeen { name: name.clone(), down: Some(down) }], Vec::new(), START);
    }
    assert_eq!(counted("").await, (Some(2), Some(2)));
    assert_eq!(counted("&state=unacknowledged").await, (Some(2), Some(1)), "whatever the filter");
    let report = get(rig.address, "/api/v1/report.html").await.text();
    assert!(report.contains("<dt>alarms not acknowledged</dt><dd>2</dd>"), "{report}");
    for (alarm, left) in [("dcs1/collector_down", 1), ("FIC1", 0)] {
        assert_eq!(post(rig.address, &format!("/api/v1/alarms/{alarm}/ack"), "").await.status, 200);
        assert_eq!(counted("").await.0, Some(left), "{alarm}");
    }
}

#[tokio::test]
async fn who_has_an_answer_is_told_that_it_is_still_good_until_it_is_not() {
    let rig = rig(&FOUR).await;
    for id in ["FIC1", "LIC2"] {
        rig.diagnose(id).await;
    }
    let asked = |path: &'static str, tag: String| async move {
        send(rig.address, "GET", path, &[&format!("if-none-match: {tag}")], "").await
    };
    for path in [
        "/api/v1/loops",
        "/api/v1/loops/FIC1",
        "/api/v1/loops/FIC1/diagnosis",
        "/api/v1/loops/FIC1/diagnoses",
        "/api/v1/loops/FIC1/samples",
        "/api/v1/loops/FIC1/model",
        "/api/v1/alarms",
        "/api/v1/alarms/history",
        "/api/v1/collectors",
        "/api/v1/openapi.json",
        "/openapi.json",
    ] {
        let first = get(rig.address, path).await;
        let tag = first.header("etag").unwrap_or_else(|| panic!("{path}: a validator")).to_string();
        let again = asked(path, tag.clone()).await;
        // Ages and the time of the answer itself have moved on meanwhile.
        assert_eq!((again.status, again.body.len(), again.header("etag")), (304, 0, Some(&*tag)), "{path}");
        assert_eq!(asked(path, "W/\"0\"".into()).await.status, 200, "{path}");
    }
    let before = get(rig.address, "/api/v1/loops").await;
    let tag = before.header("etag").expect("a validator").to_string();
    rig.diagnose("FIC1").await;
    let after = asked("/api/v1/loops", tag.clone()).await;
    assert_eq!(after.status, 200, "there is news: an alarm");
    assert_ne!(after.header("etag"), Some(tag.as_str()));
    // What is no answer, what changes of itself and what does not end has none.
    for path in ["/api/v1/loops/NONE", "/healthz", "/metrics", "/api/v1/system", "/api/v1/session"] {
        assert_eq!(get(rig.address, path).await.header("etag"), None, "{path}");
    }
    let done = send(rig.address, "POST", "/api/v1/loops/FIC1/diagnosis", &["if-none-match: *"], "").await;
    assert_eq!((done.status, done.header("etag")), (200, None), "a change is never left out");
}

#[tokio::test]
async fn a_stream_goes_on_where_it_broke_off() {
    let rig = rig(&FOUR).await;
    let mut first = Events::open(rig.address).await;
    let (name, hello) = first.next().await.expect("open");
    assert_eq!((name.as_str(), hello["resumed"].as_bool()), ("hello", Some(false)));
    rig.diagnose("FIC1").await;
    assert_eq!(first.next().await.expect("news").0, "diagnosis");
    let heard = first.id().to_string();
    drop(first);
    // Meanwhile: a diagnosis, and with it an alarm.
    rig.diagnose("FIC1").await;
    let mut again = Events::resume(rig.address, &heard).await;
    let (name, hello) = again.next().await.expect("open");
    assert_eq!((name.as_str(), hello["resumed"].as_bool()), ("hello", Some(true)));
    assert_eq!(again.id(), heard, "what was missed is still to come");
    assert_eq!(again.next().await.expect("missed").0, "diagnosis");
    let (run, number) = heard.rsplit_once('-').expect("run and number");
    let number: u64 = number.parse().expect("a number");
    assert_eq!(again.id(), format!("{run}-{}", number + 1));
    assert_eq!(again.next().await.expect("missed").0, "alarm");
    rig.diagnose("LIC2").await;
    assert_eq!(again.next().await.expect("news").1["loop"], "LIC2");
    let latest = again.id().to_string();
    let mut idle = Events::resume(rig.address, &latest).await;
    assert_eq!(idle.next().await.expect("open").1["resumed"], true);
    rig.diagnose("PIC3").await;
    assert_eq!(idle.next().await.expect("nothing was missed, nothing comes twice").1["loop"], "PIC3");
}

#[tokio::test]
async fn who_was_away_too_long_is_told_to_begin_anew() {
    let rig = rig(&FOUR).await;
    rig.diagnose("FIC1").await;
    let mut first = Events::open(rig.address).await;
    assert_eq!(first.next().await.expect("open").0, "hello");
    let heard = first.id().to_string();
    drop(first);
    let reload = || rig.results.tell_reload();
    (0..MOST_EVENTS).for_each(|_| reload());
    let mut just = Events::resume(rig.address, &heard).await;
    assert_eq!(just.next().await.expect("open").1["resumed"], true, "as many as are remembered");
    reload();
    let (run, _) = heard.rsplit_once('-').expect("run and number");
    let other_run = format!("{:016x}-1", !u64::from_str_radix(run, 16).expect("a number"));
    let lost = MOST_EVENTS as u64 + 1;
    for (id, lost) in [
        (heard.clone(), Some(lost)),
        (other_run, None),
        // More than there ever were, and what is no id.
        (format!("{run}-99999999"), None),
        ("yesterday".to_string(), None),
    ] {
        let mut late = Events::resume(rig.address, &id).await;
        assert_eq!(late.next().await.expect("open").1["resumed"], false, "{id}");
        let (name, reset) = late.next().await.expect("told");
        assert_eq!((name.as_str(), reset["lost"].as_u64()), ("reset", lost), "{id}");
        reload();
        assert_eq!(late.next().await.expect("news").0, "reloaded");
    }
}
