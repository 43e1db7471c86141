//! What the dashboard reads beside the rest: the picture behind a verdict, live samples, what alarms did, the daemon itself,
//! and the reports.

use crate::http::{Events, get, post, send};
use crate::rig::{FOUR, NASTY, Rig, START, assert_problem, judge, rig, start, verdict_of};
use serde_json::Value;
use std::sync::Arc;
use stictiond::diagnosis::Verdict;
use stictiond::diagnosis::packed::Packed;
use stictiond::results::{DeviceSeen, Judged, Residuals};
use stictiond::schedule::Diagnose;
use stictiond::serve;
use stictiond::signal::{LoopId, Sample, Window};

/// A verdict with everything that a picture is made of: OP swings by ± 5, the stem stands on each reversal until OP came
/// back by 2f = 5, PV follows the stem at twice its size.
fn pictured() -> Judged {
    let op: Vec<f64> = (0..1000).map(|k| 50.0 + 5.0 * (0.1 * f64::from(k)).sin()).collect();
    let mut diagnosis = verdict_of(Verdict::Stiction, 2.5, 446.0);
    let (mut stem, mut up) = (op.clone(), true);
    for k in 1..op.len() {
        let onward = if up { op[k] - stem[k - 1] } else { stem[k - 1] - op[k] };
        stem[k] = if onward > 0.0 || -onward > 5.0 { op[k] } else { stem[k - 1] };
        up ^= -onward > 5.0;
    }
    let pv = stem.iter().map(|x| 20.0 + 2.0 * (x - 50.0)).collect();
    diagnosis.estimate.as_mut().expect("stiction").mv = stem;
    diagnosis.window = Some(Window { t0: START, ts: 1.0, op, pv, ..Window::default() });
    let wave = |k: i32| (0.5 * f64::from(k)).sin();
    let before = Packed::new(&(0..1000).map(wave).collect::<Vec<_>>());
    let after = Packed::new(&[0.0; 1000]);
    let residuals =
        Residuals { t0: START, ts: 1.0, split: 700, before: Arc::new(before), after: Arc::new(after) };
    Judged { residuals: Some(residuals), ..diagnosis.into() }
}

async fn pictured_rig() -> Rig {
    let diagnose: Diagnose = Arc::new(|record, _, _| {
        let sticky = record.tags[0].0 == "sticky";
        if sticky { pictured() } else { judge(record) }
    });
    start(&FOUR, serve::Config::default(), diagnose).await
}

fn column(of: &Value) -> Vec<f64> {
    of.as_array().expect("a column").iter().map(|v| v.as_f64().expect("a number")).collect()
}

#[tokio::test]
async fn the_picture_behind_a_verdict_is_whole() {
    let rig = pictured_rig().await;
    assert_problem(&get(rig.address, "/api/v1/loops/FIC1/evidence").await, 404);
    rig.diagnose("FIC1").await;
    let evidence = rig.json("/api/v1/loops/FIC1/evidence").await;
    assert!(
        evidence["words"]
            .as_str()
            .is_some_and(|said| said.contains("ignores the first 5 % OP of each reversal")),
        "{evidence}"
    );
    let window = &evidence["window"];
    assert_eq!(
        (window["start"].as_str(), window["ts_s"].as_f64()),
        (Some("2026-01-01T00:00:00Z"), Some(1.0))
    );
    for name in ["op", "pv", "stem"] {
        assert_eq!(column(&window[name]).len(), 1000, "{name}");
    }
    assert_eq!((&window["mv"], &window["sp"]), (&Value::Null, &Value::Null));
    let band = &evidence["band"];
    let corners: Vec<Vec<f64>> = band["corners"].as_array().expect("corners").iter().map(column).collect();
    assert_eq!((band["follows"].as_bool(), corners.len()), (Some(true), 4));
    // 2f wide below and above; PV at its ends is that of the stem there, to a few samples of 1000.
    assert!(
        (corners[1][0] - corners[0][0] - 5.0).abs() < 1e-9
            && (corners[2][0] - corners[3][0] - 5.0).abs() < 1e-9
    );
    assert!((corners[0][1] - 10.0).abs() < 0.5 && (corners[2][1] - 30.0).abs() < 0.5, "{corners:?}");
    let residual = &evidence["residual"];
    let (period, power) = (column(&residual["period_s"]), column(&residual["power_before"]));
    let highest = (0..power.len()).max_by(|a, b| power[*a].total_cmp(&power[*b])).expect("a spectrum");
    // A sine of 2 pi / 0.5 = 12.57 s among the periods 256 / k.
    assert!((period[highest] - 12.57).abs() < 0.4, "{}", period[highest]);
    assert!(
        column(&residual["acf_before"])[5] < -0.9 && column(&residual["acf_after"]).iter().all(|r| *r == 0.0)
    );
    assert_eq!(column(&residual["ccf_before"]).len(), 41);
    // A loop of which nothing can be told has no band, and says so in words.
    rig.diagnose("PIC3").await;
    let flat = rig.json("/api/v1/loops/PIC3/evidence").await;
    assert!(flat["words"].as_str().is_some_and(|said| said.starts_with("Nothing can be said")), "{flat}");
    assert_eq!(
        (&flat["band"], &flat["window"], &flat["residual"]),
        (&Value::Null, &Value::Null, &Value::Null)
    );
}

#[tokio::test]
async fn what_a_method_looked_at_can_be_fetched_and_doubt_is_in_the_list() {
    let diagnose: Diagnose = Arc::new(|record, _, _| {
        let sticky = record.tags[0].0 == "sticky";
        if sticky { pictured().with_opinions(Some(false)) } else { judge(record) }
    });
    let rig = start(&FOUR, serve::Config::default(), diagnose).await;
    let of = |method: &str| format!("/api/v1/loops/FIC1/opinions/{method}");
    assert_problem(&get(rig.address, &of("kano_2004_b")).await, 404);
    rig.diagnose("FIC1").await;
    let report = rig.json("/api/v1/loops/FIC1/diagnosis").await;
    let opinions = report["opinions"].as_array().expect("opinions");
    assert_eq!(opinions.len(), 12);
    let told = opinions.iter().filter(|own| own["says"] != "cannot_tell").count();
    assert!(told > 0 && report["agreement"]["could_tell"] == told, "{}", report["agreement"]);
    for own in opinions {
        let found = rig.json(&of(own["method"].as_str().expect("a name"))).await;
        assert_eq!(found["opinion"]["why"], own["why"]);
    }
    // The run does not say whether its process integrates, and the record tells it by itself or not: one that asks is drawn.
    let drawn = rig.json(&of("rossi_scali_2005")).await;
    let layers = drawn["pictures"][0]["layers"].as_array().expect("a picture");
    assert!(layers.iter().any(|layer| layer["mark"] == "line" && column(&layer["x"]).len() > 10), "{drawn}");
    let list = rig.json("/api/v1/loops").await;
    let items = list["items"].as_array().expect("loops");
    let listed = items.iter().find(|item| item["id"] == "FIC1").expect("it is listed");
    assert_eq!(listed["doubtful"], report["doubtful"]);
    assert_problem(&get(rig.address, &of("nobody_1999")).await, 404);
    assert_problem(&get(rig.address, "/api/v1/loops/nowhere/opinions/he_2007").await, 404);
}

#[tokio::test]
async fn samples_are_heard_as_they_arrive_each_once_whatever_their_clock_says() {
    let rig = rig(&FOUR).await;
    // Stamped far behind the daemon's clock: what is there already is not news.
    let old = START - 5000.0;
    for tag in [0, 1] {
        rig.history.push(tag, Sample::good(old, 1.0));
    }
    let mut live = Events::open_at(rig.address, "/api/v1/loops/FIC1/live").await;
    assert_eq!(live.next().await.expect("open").0, "hello");
    let push = |tag, t, value| rig.history.push(tag, Sample::good(old + t, value));
    push(0, 1.0, 2.0);
    push(1, 1.5, 3.0);
    let mut heard = Vec::new();
    while heard.len() < 2 {
        let (name, tags) = live.next().await.expect("samples");
        assert_eq!(name, "samples");
        for tag in tags.as_array().expect("tags") {
            heard.extend(
                column(&tag["value"]).into_iter().map(|v| (tag["tag"].as_str().unwrap_or("").to_string(), v)),
            );
        }
    }
    assert_eq!(heard, [("op".to_string(), 2.0), ("pv".to_string(), 3.0)]);
    push(0, 2.0, 4.0);
    let (_, tags) = live.next().await.expect("samples");
    assert_eq!((column(&tags[0]["value"]), column(&tags[1]["value"])), (vec![4.0], vec![]));
    rig.stop.cancel();
    assert!(live.next().await.is_none(), "it ends with the daemon");
}

#[tokio::test]
async fn what_alarms_did_is_remembered_with_who_and_why() {
    let rig = rig(&FOUR).await;
    rig.diagnose("FIC1").await;
    rig.diagnose("FIC1").await;
    let act = |action: &'static str, body: &'static str| {
        let path = format!("/api/v1/alarms/FIC1/{action}");
        async move { assert_eq!(post(rig.address, &path, body).await.status, 200, "{path}") }
    };
    act("ack", r#"{"by": "jw", "comment": "seen"}"#).await;
    act("shelve", r#"{"duration_s": 60, "by": "jw", "comment": "no spare part"}"#).await;
    let log = rig.json("/api/v1/alarms/history").await;
    let said = |i: usize, field: &str| log["items"][i][field].as_str().map(str::to_string);
    let causes: Vec<_> = (0..4).map(|i| said(i, "cause")).collect();
    assert_eq!(causes, [Some("shelved".into()), Some("acknowledged".into()), Some("raised".into()), None]);
    assert_eq!((said(0, "by"), said(0, "comment")), (Some("jw".into()), Some("no spare part".into())));
    assert_eq!(
        (said(1, "from"), said(1, "to")),
        (Some("unacknowledged".into()), Some("acknowledged".into()))
    );
    assert_eq!(said(2, "by"), None);
    let one = rig.json("/api/v1/alarms/history?loop=FIC1&limit=1").await;
    assert_eq!(one["items"].as_array().map(Vec::len), Some(1));
    // Page by page it is the same.
    let mut causes = Vec::new();
    let mut after = String::new();
    loop {
        let page = rig.json(&format!("/api/v1/alarms/history?limit=2{after}")).await;
        for item in page["items"].as_array().expect("a list") {
            causes.push(item["cause"].as_str().expect("a cause").to_string());
        }
        let Some(next) = page["next"].as_u64() else { break };
        after = format!("&after={next}");
    }
    assert_eq!(causes, ["shelved", "acknowledged", "raised"]);
    let other = rig.json("/api/v1/alarms/history?loop=LIC2").await;
    assert_eq!(other["items"].as_array().map(Vec::len), Some(0));
    assert_problem(&get(rig.address, "/api/v1/alarms/history?limit=0").await, 400);
}

#[tokio::test]
async fn the_daemon_says_what_it_is_and_where_its_data_comes_from() {
    let rig = rig(&FOUR).await;
    rig.diagnose("FIC1").await;
    let system = rig.json("/api/v1/system").await;
    assert_eq!(system["version"], env!("CARGO_PKG_VERSION"));
    let build = system["build"].as_str().and_then(|own| own.strip_prefix(env!("CARGO_PKG_VERSION")));
    let identity = build.and_then(|own| own.strip_prefix('+')).unwrap_or_default();
    assert!(identity.len() == 16 && identity.chars().all(|c| c.is_ascii_hexdigit()), "{system}");
    assert_eq!((system["loops"].as_u64(), system["tags"].as_u64()), (Some(4), Some(12)));
    assert!(system["memory_bytes"].as_u64().is_some_and(|bytes| bytes > 1_000_000), "{system}");
    assert_eq!(system["scheduler"]["diagnosed"], 1);
    assert_eq!(system["max_shelve_s"], 604_800.0);
    let collectors = rig.json("/api/v1/collectors").await;
    let device = &collectors["items"][0];
    assert_eq!((device["name"].as_str(), device["connected"].as_bool()), (Some("dcs1"), Some(true)));
    assert_eq!(device["counters"]["polls"], 7);
    assert_eq!(device["down"], false);
    // A connection may be open to a device that says nothing: its alarm counts.
    let name = LoopId::new("dcs1");
    rig.results.watch_devices(std::slice::from_ref(&name), START);
    let down = async |why: Option<&str>| {
        let seen = DeviceSeen { name: name.clone(), down: Some(why.map(str::to_string)) };
        rig.results.watch(vec![seen], Vec::new(), START);
        rig.json("/api/v1/collectors").await["items"][0]["down"].clone()
    };
    assert_eq!(down(Some("no good sample for 130 s")).await, true);
    assert_eq!(down(None).await, false);
}

#[tokio::test]
async fn reports_stand_alone_and_names_in_them_are_text() {
    let diagnose: Diagnose = Arc::new(|_, _, _| pictured());
    let rig = start(&[(NASTY, "sticky"), ("LIC2", "sound")], serve::Config::default(), diagnose).await;
    rig.diagnose(NASTY).await;
    rig.diagnose(NASTY).await;
    let own = "/api/v1/loops/%3Cb%3Ea%2Fb%20%26%20%22c%22%20%C3%BC/report.html";
    for (path, plots) in [(own, 3), ("/api/v1/report.html", 1)] {
        let report = get(rig.address, path).await;
        let text = report.text();
        assert_eq!(report.header("content-type"), Some("text/html; charset=utf-8"));
        assert!(text.contains("&lt;b&gt;a/b &amp; &quot;c&quot; ü") && !text.contains("<b>"), "{path}");
        assert_eq!(text.matches("<svg").count(), plots, "{path}");
        assert!(!text.contains("src=") && !text.contains("<script") && !text.contains("://"), "{path}");
        let policy = report.header("content-security-policy").expect("a policy of its own");
        assert!(policy.contains("style-src 'sha256-") && !policy.contains("unsafe"), "{policy}");
    }
    // A loop that was never diagnosed has a report that says so.
    let waiting = get(rig.address, "/api/v1/loops/LIC2/report.html").await.text();
    assert!(waiting.contains("Not diagnosed yet."));
    let packed = send(rig.address, "GET", "/api/v1/report.html", &["accept-encoding: gzip"], "").await;
    assert_eq!(packed.header("content-encoding"), Some("gzip"));
}
