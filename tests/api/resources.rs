//! The API over real sockets: what CONTRACT promises.

use crate::http::{get, post, send};
use crate::rig::{FOUR, NASTY, Rig, START, assert_problem, judge, rig, start};
use serde_json::Value;
use std::sync::{Arc, Mutex};
use stictiond::schedule::Diagnose;
use stictiond::serve;
use stictiond::signal::{BadReason, Quality, Sample};

#[tokio::test]
async fn loops_are_listed_worst_first_with_what_is_known() {
    let rig = rig(&FOUR).await;
    let fresh = rig.json("/api/v1/loops").await;
    assert_eq!((fresh["total"].as_u64(), &fresh["items"][0]["verdict"]), (Some(4), &Value::Null));
    for id in ["FIC1", "FIC1", "LIC2", "PIC3", "TIC4"] {
        rig.diagnose(id).await;
    }
    let list = rig.json("/api/v1/loops").await;
    assert_eq!(Rig::ids(&list), ["FIC1", "PIC3", "TIC4", "LIC2"]);
    let worst = &list["items"][0];
    assert_eq!((worst["verdict"].as_str(), worst["f"].as_f64()), (Some("stiction"), Some(2.5)));
    assert_eq!((worst["f_unit"].as_str(), worst["alarm"].as_str()), (Some("% OP"), Some("unacknowledged")));
    assert!(worst["time"].as_str().is_some_and(|t| t.starts_with("2026-01-01T") && t.ends_with('Z')));
    assert_eq!(worst["quality"], "good");
    let flat = &list["items"][1];
    assert_eq!((flat["reason_code"].as_str(), &flat["f"]), (Some("flat_pv"), &Value::Null));
    let broken = &list["items"][2];
    assert_eq!((broken["failure"].as_str(), &broken["verdict"]), (Some("panicked"), &Value::Null));
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?verdict=stiction").await), ["FIC1"]);
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?verdict=none").await), ["TIC4"]);
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?alarm=unacknowledged").await), ["FIC1"]);
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?group=unit%201&sort=id").await), ["LIC2", "TIC4"]);
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?q=SOUND").await), ["LIC2"]);
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?q=Unit%201&sort=id").await), ["LIC2", "TIC4"]);
    assert_eq!(list["items"][0]["period_s"], 1e6);
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?sort=f&order=asc").await)[3], "FIC1");
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?sort=id&order=desc").await)[0], "TIC4");
    assert_eq!(Rig::ids(&rig.json("/api/v1/loops?sort=age").await)[3], "TIC4");
}

#[tokio::test]
async fn pages_join_to_the_whole_list_in_every_order() {
    let names: Vec<String> = (0..25).map(|i| format!("L{i:02}")).collect();
    let kinds = ["sticky", "sound", "flat"];
    let loops: Vec<(&str, &str)> =
        names.iter().enumerate().map(|(i, n)| (n.as_str(), kinds[i % 3])).collect();
    let rig = rig(&loops).await;
    for id in &names[..20] {
        rig.diagnose(id).await;
    }
    for sort in ["severity", "id", "group", "f", "delta_aic", "age", "score", "cost"] {
        for order in ["asc", "desc"] {
            let query = format!("/api/v1/loops?sort={sort}&order={order}");
            let whole = Rig::ids(&rig.json(&format!("{query}&limit=1000")).await);
            let (mut joined, mut path) = (Vec::new(), format!("{query}&limit=7"));
            for page in 1.. {
                assert!(page <= 4, "25 loops are four pages of 7");
                let list = rig.json(&path).await;
                joined.extend(Rig::ids(&list));
                let Some(next) = list["next"].as_str() else { break };
                path = format!("{query}&limit=7&after={next}");
            }
            assert_eq!(joined, whole, "{sort} {order}");
        }
    }
}

#[tokio::test]
async fn one_loop_its_diagnosis_its_runs_and_its_model() {
    let rig = rig(&FOUR).await;
    rig.history.push(0, Sample::good(START + 1.0, 42.0));
    rig.history
        .push(1, Sample { t: START + 1.0, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) });
    let problem = assert_problem(&get(rig.address, "/api/v1/loops/FIC1/diagnosis").await, 404);
    assert_eq!(problem["type"], "urn:stictiond:problem:not_diagnosed_yet");
    for id in ["FIC1", "PIC3", "TIC4"] {
        rig.diagnose(id).await;
    }
    let detail = rig.json("/api/v1/loops/FIC1").await;
    let (op, pv) = (&detail["values"][0], &detail["values"][1]);
    assert_eq!(
        (op["tag"].as_str(), op["value"].as_f64(), op["unit"].as_str()),
        (Some("op"), Some(42.0), Some("%"))
    );
    assert_eq!((op["time"].as_str(), op["quality"].as_str()), (Some("2026-01-01T00:00:01Z"), Some("good")));
    assert_eq!((&pv["value"], pv["quality"].as_str()), (&Value::Null, Some("bad:timeout")));
    assert_eq!(detail["values"][2]["quality"], "none");
    // Of OP a sample came 300 s ago from a source that is a year behind.
    let (t, ring) = (START - 3e7, rig.history.ring(0).expect("OP"));
    ring.push(Sample::good(t, 43.0));
    ring.heard().sample(t, -300.0);
    let values = rig.json("/api/v1/loops/FIC1").await["values"].clone();
    let age = |at: usize| values[at]["age_s"].as_f64();
    assert!(age(0).is_some_and(|age_s| (300.0..400.0).contains(&age_s)), "{values}");
    assert!(age(1).is_some_and(|age_s| age_s < 100.0), "{values}");
    assert_eq!((values[0]["value"].as_f64(), age(2)), (Some(43.0), None));
    let report = rig.json("/api/v1/loops/FIC1/diagnosis").await;
    assert_eq!((report["loop"].as_str(), report["verdict"].as_str()), (Some("FIC1"), Some("stiction")));
    assert_eq!(report["f_ci95"][0].as_f64().map(|f| (f * 100.0).round()), Some(244.0));
    assert_eq!(report["window"]["n"], 1000);
    assert_eq!(report["window_start"], "2026-01-01T00:00:00Z");
    assert!(report["residual"]["traced"].is_null() && report["traced_start"].is_null(), "{report}");
    // What is not finite is null, wherever it stands.
    assert_eq!(report["model"]["b"][1], Value::Null);
    let flat = rig.json("/api/v1/loops/PIC3/diagnosis").await;
    assert_eq!((flat["verdict"].as_str(), &flat["f"]), (Some("not_identifiable"), &Value::Null));
    let broken = get(rig.address, "/api/v1/loops/TIC4/diagnosis").await;
    assert_problem(&broken, 404);
    assert!(!broken.text().contains("secret"));
    let model = rig.json("/api/v1/loops/FIC1/model").await;
    assert_eq!((model["model"]["na"].as_u64(), model["ts_s"].as_f64()), (Some(2), Some(1.0)));
    for _ in 0..6 {
        rig.diagnose("FIC1").await;
    }
    let runs = rig.json("/api/v1/loops/FIC1/diagnoses?limit=3").await;
    assert_eq!(runs["items"].as_array().map(Vec::len), Some(3));
    let all = rig.json("/api/v1/loops/FIC1/diagnoses").await;
    assert_eq!(all["items"].as_array().map(Vec::len), Some(5), "as many as are kept");
    // As times: as texts they do not sort, because zeros at the end of the fraction are not written.
    let time =
        |item: &Value| item["time"].as_str().expect("a time").parse::<jiff::Timestamp>().expect("RFC 3339");
    let times: Vec<_> = all["items"].as_array().expect("items").iter().map(time).collect();
    assert!(times.windows(2).all(|w| w[0] >= w[1]), "newest first: {times:?}");
}

#[tokio::test]
async fn samples_are_cut_by_time_and_thinned_so_that_peaks_and_gaps_survive() {
    let rig = rig(&FOUR).await;
    for i in 0..4000 {
        let value = if i == 1234 { 99.0 } else { 50.0 };
        let bad = i == 3000;
        let quality = if bad { Quality::Bad(BadReason::LinkDown) } else { Quality::Good };
        rig.history.push(0, Sample { t: START + f64::from(i), value, quality });
    }
    let samples = rig.json("/api/v1/loops/FIC1/samples?points=90").await;
    let op = &samples["tags"][0];
    let column = |name: &str| op[name].as_array().expect("a column").clone();
    assert_eq!((op["tag"].as_str(), op["found"].as_u64()), (Some("op"), Some(4000)));
    assert!(column("value").len() <= 90);
    assert!(column("value").contains(&99.0.into()), "the peak survives");
    let gap = column("quality").iter().position(|q| q == "bad:link_down").expect("the gap survives");
    assert_eq!(column("value")[gap], Value::Null);
    assert_eq!(column("time")[gap], "2026-01-01T00:50:00Z");
    let few = rig.json("/api/v1/loops/FIC1/samples?from=2026-01-01T00:00:10Z&to=1767225612").await;
    assert_eq!(few["tags"][0]["time"].as_array().map(Vec::len), Some(3));
    let before = serde_json::json!({ "time": "2026-01-01T00:00:09Z", "value": 50.0, "quality": "good" });
    assert_eq!((&few["tags"][0]["before"], &few["tags"][0]["by_changes"]), (&before, &Value::Bool(false)));
    assert_eq!((&op["before"], &few["tags"][1]["before"]), (&Value::Null, &Value::Null), "there is none");
    assert_eq!(few["tags"][1]["by_changes"], true, "nothing was repeated");
    for (query, field) in [
        ("points=2", "points"),
        ("points=many", "points"),
        ("points=-5", "points"),
        ("from=yesterday", "from"),
        ("to=NaN", "to"),
        ("from=20&to=10", "from"),
        ("form=10", "form"),
    ] {
        let problem =
            assert_problem(&get(rig.address, &format!("/api/v1/loops/FIC1/samples?{query}")).await, 400);
        assert_eq!(problem["field"], field, "{query}: {problem}");
    }
}

#[tokio::test]
async fn a_diagnosis_on_demand_answers_when_done_or_says_where_it_will_be() {
    let (open, closed) = std::sync::mpsc::channel::<()>();
    let closed = Mutex::new(closed);
    let diagnose: Diagnose = Arc::new(move |record, _, _| {
        if record.tags[0].0 == "sound" {
            let _ = closed.lock().expect("one at a time").recv();
        }
        judge(record)
    });
    let rig = start(&FOUR, serve::Config::default(), diagnose).await;
    let done = post(rig.address, "/api/v1/loops/FIC1/diagnosis", "").await;
    assert_eq!((done.status, done.json()["verdict"].as_str()), (200, Some("stiction")));
    let failed = assert_problem(&post(rig.address, "/api/v1/loops/TIC4/diagnosis", "").await, 500);
    assert_eq!(failed["outcome"], "panicked");
    let begun = post(rig.address, "/api/v1/loops/LIC2/diagnosis?wait_s=0", "").await;
    assert_eq!((begun.status, begun.header("location")), (202, Some("/api/v1/loops/LIC2/diagnosis")));
    let problem =
        assert_problem(&post(rig.address, "/api/v1/loops/LIC2/diagnosis?wait_s=1e9", "").await, 400);
    assert_eq!(problem["field"], "wait_s");
    let mut events = rig.results.subscribe();
    open.send(()).expect("the run waits");
    events.recv().await.expect("the run ends");
    assert_eq!(rig.json("/api/v1/loops/LIC2/diagnosis").await["verdict"], "no_stiction");
}

#[tokio::test]
async fn alarms_are_acknowledged_shelved_and_unshelved() {
    let rig = rig(&FOUR).await;
    assert_eq!(rig.json("/api/v1/alarms").await["items"], serde_json::json!([]));
    rig.diagnose("FIC1").await;
    rig.diagnose("FIC1").await;
    let alarms = rig.json("/api/v1/alarms").await;
    assert_eq!(
        (Rig::ids(&alarms), alarms["items"][0]["state"].as_str()),
        (vec!["FIC1/stiction".into()], Some("unacknowledged"))
    );
    let act = |what: &str, body: &str| {
        let (address, path, body) = (rig.address, format!("/api/v1/alarms/FIC1/{what}"), body.to_string());
        async move { post(address, &path, &body).await }
    };
    let seen = act("ack", r#"{"by": "kim", "comment": "on my way"}"#).await;
    assert_eq!((seen.status, seen.json()["state"].as_str()), (200, Some("acknowledged")));
    assert_eq!(
        (seen.json()["by"].as_str(), seen.json()["survives_restart"].as_bool()),
        (Some("kim"), Some(false))
    );
    assert_eq!(
        (seen.json()["loop"].as_str(), seen.json()["priority"].as_str()),
        (Some("FIC1"), Some("high"))
    );
    assert_problem(&act("ack", "").await, 409);
    assert_problem(&act("unshelve", "").await, 409);
    let shelved = act("shelve", r#"{"duration_s": 3600}"#).await.json();
    assert_eq!(shelved["state"], "shelved");
    assert!(shelved["shelved_until"].as_str().is_some_and(|t| t.starts_with("2026-01-01T01:0")));
    assert_eq!(Rig::ids(&rig.json("/api/v1/alarms?state=shelved").await), ["FIC1/stiction"]);
    assert_eq!(act("unshelve", "{}").await.json()["state"], "unacknowledged");
    for (body, field) in [
        (r#"{"duration_s": -1}"#, "duration_s"),
        (r#"{"duration_s": 1e12}"#, "duration_s"),
        (r#"{"duration_s": 1, "whom": 2}"#, "whom"),
        ("{}", "duration_s"),
        ("not json", "body"),
        ("", "body"),
    ] {
        let problem = assert_problem(&act("shelve", body).await, 400);
        assert_eq!(problem["field"], field, "{body}: {problem}");
    }
    // An alarm's name may come whole or in its two halves, and whoever takes it out of service gives it back.
    for path in ["/api/v1/alarms/FIC1%2Fstiction/ack", "/api/v1/alarms/FIC1/stiction/out-of-service"] {
        assert_eq!(post(rig.address, path, "").await.status, 200, "{path}");
    }
    let taken = rig.json("/api/v1/alarms?kind=stiction&priority=high&loop=FIC1").await;
    assert_eq!(taken["items"][0]["state"], "out-of-service");
    assert_problem(&act("shelve", r#"{"duration_s": 1}"#).await, 409);
    assert_problem(&act("reset", "").await, 409);
    assert_eq!(act("in-service", "").await.json()["state"], "unacknowledged");
    assert_problem(&act("in-service", "").await, 409);
    let once = act("shelve", r#"{"duration_s": 60, "one_shot": true}"#).await.json();
    assert_eq!((once["state"].as_str(), once["one_shot"].as_bool()), (Some("shelved"), Some(true)));
    for unknown in ["FIC1%2Fsilence", "NOWHERE", "FIC1/collector_down", "dcs9/collector_down"] {
        assert_problem(&post(rig.address, &format!("/api/v1/alarms/{unknown}/ack"), "").await, 404);
    }
    let long = format!(r#"{{"by": "{}"}}"#, "x".repeat(101));
    assert_eq!(assert_problem(&act("ack", &long).await, 400)["field"], "by");
}

#[tokio::test]
async fn ready_only_when_data_and_diagnoses_are_there() {
    let rig = rig(&FOUR).await;
    for path in ["/healthz", "/api/v1/healthz"] {
        assert_eq!(rig.json(path).await["status"], "ok");
    }
    let problem = assert_problem(&get(rig.address, "/readyz").await, 503);
    assert_eq!(problem["missing"].as_array().map(Vec::len), Some(2));
    rig.history.push(0, Sample::good(START, 1.0));
    rig.history.push(1, Sample::good(START, 1.0));
    let problem = assert_problem(&get(rig.address, "/readyz").await, 503);
    assert_eq!(
        (problem["loops_with_data"].as_u64(), problem["loops_diagnosed"].as_u64()),
        (Some(1), Some(0))
    );
    rig.diagnose("FIC1").await;
    let ready = rig.json("/api/v1/readyz").await;
    assert_eq!((ready["ready"].as_bool(), ready["loops"].as_u64()), (Some(true), Some(4)));
}

#[tokio::test]
async fn metrics_name_every_loop_and_device_once() {
    let rig = rig(&[("FIC1", "sticky"), (NASTY, "sound"), ("PIC3", "flat"), ("TIC4", "broken")]).await;
    for id in ["FIC1", "FIC1", NASTY, "PIC3", "TIC4"] {
        rig.diagnose(id).await;
    }
    let plain = get(rig.address, "/metrics").await;
    assert_eq!(plain.header("content-type"), Some("text/plain; version=0.0.4; charset=utf-8"));
    let described = ["# HELP stictiond_runs_total ", "# TYPE stictiond_runs_total counter"];
    assert!(described.iter().all(|line| plain.text().contains(line)) && !plain.text().contains("# EOF"));
    let accept = "accept: application/openmetrics-text;version=1.0.0,text/plain;version=0.0.4;q=0.5";
    let answer = send(rig.address, "GET", "/metrics", &[accept], "").await;
    assert!(
        answer.header("content-type").is_some_and(|kind| kind.starts_with("application/openmetrics-text"))
    );
    let text = answer.text();
    let has = |line: &str| assert!(text.lines().any(|l| l.starts_with(line)), "{line} in\n{text}");
    has(r#"stictiond_loop_friction{loop="FIC1",f_unit="% OP"} 2.5"#);
    has(r#"stictiond_loop_evidence{loop="FIC1"} 446"#);
    has(r#"stictiond_loop_alarm_state{loop="FIC1",state="unacknowledged"} 1"#);
    has(r#"stictiond_alarm_state{subject="FIC1",kind="stiction",priority="high",state="unacknowledged"} 1"#);
    has("stictiond_alarm_flood 0");
    has("stictiond_alarms_raised_recently 1");
    has(r#"stictiond_loop_verdict{loop="<b>a/b & \"c\" ü",verdict="no_stiction"} 1"#);
    has(r#"stictiond_loop_identifiable{loop="PIC3"} 0"#);
    has(r#"stictiond_runs_total{outcome="panicked"} 1"#);
    has(r#"stictiond_device_events_total{device="dcs1",event="polls"} 7"#);
    has("stictiond_process_resident_memory_bytes ");
    has("stictiond_process_cpu_seconds_total ");
    assert!(!text.contains(r#"stictiond_loop_friction{loop="PIC3""#), "no f when not identifiable");
    assert!(text.trim_end().ends_with("# EOF"));
    let mut series: Vec<&str> = text
        .lines()
        .filter(|l| !l.starts_with('#'))
        .filter_map(|l| l.rsplit_once(' '))
        .map(|(s, _)| s)
        .collect();
    let count = series.len();
    series.sort_unstable();
    series.dedup();
    assert_eq!(series.len(), count, "no series twice");
}

#[tokio::test]
async fn the_description_names_every_route_of_the_contract() {
    let rig = rig(&FOUR).await;
    let document = rig.json("/openapi.json").await;
    assert_eq!(document, rig.json("/api/v1/openapi.json").await);
    for path in [
        "/api/v1/loops",
        "/api/v1/loops/{id}",
        "/api/v1/loops/{id}/diagnosis",
        "/api/v1/loops/{id}/diagnoses",
        "/api/v1/loops/{id}/samples",
        "/api/v1/loops/{id}/model",
        "/api/v1/alarms",
        "/api/v1/alarms/{id}/ack",
        "/api/v1/alarms/{id}/shelve",
        "/api/v1/alarms/{id}/unshelve",
        "/api/v1/alarms/{id}/reset",
        "/api/v1/alarms/{id}/out-of-service",
        "/api/v1/alarms/{id}/in-service",
        "/api/v1/events",
        "/api/v1/healthz",
        "/healthz",
        "/readyz",
        "/metrics",
    ] {
        assert!(document["paths"][path].is_object(), "{path}");
    }
    assert!(document["paths"]["/api/v1/loops/{id}/diagnosis"]["post"].is_object());
    // Every reference leads somewhere.
    let text = document.to_string();
    for reference in text.split("#/components/schemas/").skip(1).filter_map(|rest| rest.split('"').next()) {
        assert!(document["components"]["schemas"][reference].is_object(), "{reference}");
    }
}

#[tokio::test]
async fn nasty_names_come_back_as_they_are() {
    let rig = rig(&[(NASTY, "sticky")]).await;
    let encoded: String = NASTY.bytes().map(|byte| format!("%{byte:02X}")).collect();
    assert_eq!(rig.json(&format!("/api/v1/loops/{encoded}")).await["id"], NASTY);
    let done = post(rig.address, &format!("/api/v1/loops/{encoded}/diagnosis"), "").await;
    assert_eq!(done.json()["loop"], NASTY);
}
