//! The API over real sockets: what it refuses, what it bounds, and its streams.

use crate::http::{Events, get, post, send};
use crate::rig::{FOUR, assert_problem, judge, rig, start};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use stictiond::schedule::Diagnose;
use stictiond::serve;

#[tokio::test]
async fn every_error_is_a_problem() {
    let rig = rig(&FOUR).await;
    let to = rig.address;
    for path in [
        "/api/v1/loops/XX",
        "/api/v1/loops/XX/samples",
        "/api/v1/loops/XX/model",
        "/api/v1/loops/XX/diagnoses",
    ] {
        let problem = assert_problem(&get(to, path).await, 404);
        assert_eq!(problem["loop"], "XX");
    }
    assert_problem(&post(to, "/api/v1/alarms/XX/ack", "").await, 404);
    assert_problem(&get(to, "/api/v2/loops").await, 404);
    assert_problem(&get(to, "/../../etc/passwd").await, 404);
    assert_problem(&get(to, "/api/v1/loops/%FF").await, 400);
    let wrong = send(to, "DELETE", "/api/v1/loops", &[], "").await;
    assert_problem(&wrong, 405);
    assert!(wrong.header("allow").is_some_and(|allow| allow.contains("GET")));
    let large = "x".repeat(20_000);
    assert_problem(&post(to, "/api/v1/alarms/FIC1/ack", &large).await, 413);
    for (query, field) in [
        ("limit=0", "limit"),
        ("limit=ten", "limit"),
        ("sort=size", "sort"),
        ("order=up", "order"),
        ("after=zz", "after"),
        ("verdict=maybe", "verdict"),
        ("alarm=red", "alarm"),
        ("colour=red", "colour"),
        ("limit=1&limit=2", "limit"),
    ] {
        let problem = assert_problem(&get(to, &format!("/api/v1/loops?{query}")).await, 400);
        assert_eq!(problem["field"], field, "{query}: {problem}");
    }
}

#[tokio::test]
async fn there_is_no_bundle_of_what_is_not_there() {
    let rig = rig(&FOUR).await;
    let bundle = async |id: &str, status| {
        let answer = get(rig.address, &format!("/api/v1/loops/{id}/bundle")).await;
        let problem = assert_problem(&answer, status);
        let text = |member: &str| problem[member].as_str().unwrap_or_default().to_string();
        (text("type"), text("detail"))
    };
    let (kind, detail) = bundle("XX", 404).await;
    assert!(kind.ends_with("unknown_loop") && detail.contains("'XX'"), "{kind}: {detail}");
    let (kind, detail) = bundle("FIC1", 404).await;
    assert!(kind.ends_with("not_diagnosed_yet") && detail.contains("'FIC1'"), "{kind}: {detail}");
    // A run that failed is no diagnosis, and says so.
    rig.diagnose("TIC4").await;
    let (kind, detail) = bundle("TIC4", 404).await;
    assert!(kind.ends_with("not_diagnosed_yet") && detail.contains("panicked"), "{kind}: {detail}");
    // There is one, but nobody has its samples any more.
    rig.diagnose("FIC1").await;
    let (kind, detail) = bundle("FIC1", 409).await;
    assert!(kind.ends_with("samples_gone") && detail.contains("ask for a diagnosis"), "{kind}: {detail}");
    assert_problem(&get(rig.address, "/api/v1/loops/FIC1/bundle?colour=red").await, 400);
    assert_problem(&post(rig.address, "/api/v1/loops/FIC1/bundle", "").await, 405);
}

#[tokio::test]
async fn other_sites_may_not_act_through_a_browser() {
    let rig = rig(&FOUR).await;
    let act = |origin: String| async move {
        let line = format!("origin: {origin}");
        send(rig.address, "POST", "/api/v1/loops/FIC1/diagnosis", &[line.as_str()], "").await
    };
    assert_problem(&act("https://example.org".into()).await, 403);
    assert_problem(&act("null".into()).await, 403);
    assert_eq!(act(format!("http://{}", rig.address)).await.status, 200);
}

#[tokio::test]
async fn answers_carry_the_headers_that_keep_a_browser_safe_and_are_compressed() {
    let rig = rig(&FOUR).await;
    for path in ["/", "/api/v1/loops", "/nothing"] {
        let answer = get(rig.address, path).await;
        assert_eq!(answer.header("x-content-type-options"), Some("nosniff"), "{path}");
        assert!(answer.header("content-security-policy").is_some_and(|p| p.contains("default-src 'none'")));
    }
    let packed = send(rig.address, "GET", "/openapi.json", &["accept-encoding: gzip"], "").await;
    assert_eq!(packed.header("content-encoding"), Some("gzip"));
    assert_eq!(packed.body[..2], [0x1f, 0x8b]);
}

/// What a file of the page asks for, by the quotes around it: nothing is left out that way, and nothing else is quoted so.
fn asked_for(path: &str, text: &str) -> Vec<String> {
    let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
    let relative = |quoted: &str| quoted.strip_prefix("./").map(|name| format!("{folder}/{name}"));
    let from_root = |quoted: &str| {
        let asset = [".css", ".js", ".svg"].iter().any(|end| quoted.ends_with(end));
        (asset && !quoted.contains(' ')).then(|| format!("/{quoted}"))
    };
    text.split('"').skip(1).step_by(2).filter_map(|q| relative(q).or_else(|| from_root(q))).collect()
}

#[tokio::test]
async fn the_page_is_whole_and_needs_nothing_from_elsewhere() {
    let rig = rig(&FOUR).await;
    let page = get(rig.address, "/").await;
    assert!(page.header("content-type").is_some_and(|kind| kind.starts_with("text/html")));
    let (mut to_read, mut read) = (vec![("/".to_string(), page.text())], std::collections::BTreeSet::new());
    while let Some((path, text)) = to_read.pop() {
        assert!(
            !text.contains("innerHTML") && !text.contains("insertAdjacentHTML"),
            "{path}: names are never markup"
        );
        let elsewhere =
            text.replace("http://www.w3.org/2000/svg", "").replace("https://github.com/leeoniya/uPlot", "");
        assert!(!elsewhere.contains("http://") && !elsewhere.contains("https://"), "{path}");
        for asset in asked_for(&path, &text) {
            if read.insert(asset.clone()) {
                let file = get(rig.address, &asset).await;
                assert_eq!(file.status, 200, "{path} asks for {asset}");
                to_read.push((asset, file.text()));
            }
        }
    }
    assert!(
        read.len() >= 17 && read.contains("/vendor/uplot.min.js") && read.contains("/js/loop.js"),
        "{read:?}"
    );
}

#[tokio::test]
async fn files_of_the_page_are_sent_again_only_when_they_changed() {
    let rig = rig(&FOUR).await;
    let first = get(rig.address, "/app.css").await;
    let tag = first.header("etag").expect("a validator").to_string();
    assert_eq!(first.header("cache-control"), Some("no-cache"));
    let again = send(rig.address, "GET", "/app.css", &[&format!("if-none-match: {tag}")], "").await;
    assert_eq!((again.status, again.body.len(), again.header("etag")), (304, 0, Some(tag.as_str())));
    let other = send(rig.address, "GET", "/app.css", &["if-none-match: W/\"0\""], "").await;
    assert_eq!(other.status, 200);
    assert_eq!(get(rig.address, "/vendor/uplot.LICENSE").await.status, 200);
}

#[tokio::test]
async fn events_are_heard_as_they_happen_and_end_at_shutdown() {
    let rig = rig(&FOUR).await;
    let mut events = Events::open(rig.address).await;
    assert_eq!(events.next().await.expect("open").0, "hello");
    rig.diagnose("FIC1").await;
    rig.diagnose("FIC1").await;
    let (name, data) = events.next().await.expect("news");
    assert_eq!(
        (name.as_str(), data["loop"].as_str(), data["f"].as_f64()),
        ("diagnosis", Some("FIC1"), Some(2.5))
    );
    assert_eq!(events.next().await.expect("news").0, "diagnosis");
    let (name, data) = events.next().await.expect("news");
    assert_eq!(
        (name.as_str(), data["to"].as_str(), data["cause"].as_str()),
        ("alarm", Some("unacknowledged"), Some("raised"))
    );
    rig.stop.cancel();
    assert_eq!(events.next().await.expect("a farewell").0, "bye");
    assert!(events.next().await.is_none());
    // An open stream does not hold the shutdown: well below the 5 s after which it would be cut.
    let ended = tokio::time::timeout(Duration::from_secs(4), rig.serving).await;
    assert!(ended.expect("ends in time").expect("no panic").is_ok());
}

#[tokio::test]
async fn clients_of_events_are_bounded_and_a_place_comes_free() {
    let config = serve::Config { max_event_clients: 1, ..serve::Config::default() };
    let rig = start(&FOUR, config, Arc::new(|record, _, _| judge(record))).await;
    let mut first = Events::open(rig.address).await;
    assert_eq!(first.next().await.expect("open").0, "hello");
    let problem = assert_problem(&get(rig.address, "/api/v1/events").await, 503);
    assert_eq!(problem["type"], "urn:stictiond:problem:too_many_event_clients");
    drop(first);
    // The server notices that the client has gone when it reads the end of the connection.
    let deadline = tokio::time::Instant::now() + Duration::from_secs(10);
    loop {
        let mut again = Events::open(rig.address).await;
        if again.next().await.is_some_and(|(name, _)| name == "hello") {
            break;
        }
        assert!(tokio::time::Instant::now() < deadline, "the place never came free");
    }
}

#[tokio::test]
async fn a_client_that_lags_is_told_how_much_it_lost() {
    let rig = rig(&FOUR).await;
    let mut events = Events::open(rig.address).await;
    assert_eq!(events.next().await.expect("open").0, "hello");
    // No await in between: the only thread of this runtime cannot serve the stream meanwhile.
    (0..3000).for_each(|_| rig.results.tell_reload());
    let (name, data) = events.next().await.expect("news");
    assert_eq!(name, "lagged");
    assert!(data["lost"].as_u64().is_some_and(|lost| (1000..3000).contains(&lost)), "{data}");
    assert_eq!(events.next().await.expect("news").0, "reloaded");
}

#[tokio::test]
async fn requests_are_bounded_in_number_and_time() {
    let (open, closed) = std::sync::mpsc::channel::<()>();
    let closed = Mutex::new(closed);
    let diagnose: Diagnose = Arc::new(move |record, _, _| {
        let _ = closed.lock().expect("one at a time").recv();
        judge(record)
    });
    let config = serve::Config { max_requests: 1, request_timeout_s: 0.3, ..serve::Config::default() };
    let rig = start(&FOUR, config, diagnose).await;
    let slow = tokio::spawn(post(rig.address, "/api/v1/loops/FIC1/diagnosis?wait_s=60", ""));
    let deadline = tokio::time::Instant::now() + Duration::from_secs(10);
    while rig.scheduler.counters().running == 0 {
        assert!(tokio::time::Instant::now() < deadline, "the request never arrived");
        tokio::task::yield_now().await;
    }
    let refused = get(rig.address, "/api/v1/loops").await;
    assert_eq!(assert_problem(&refused, 503)["type"], "urn:stictiond:problem:too_many_requests");
    // Who asks whether it lives would start a busy daemon again.
    assert_eq!(get(rig.address, "/healthz").await.status, 200);
    // Who looks at why it is busy, and who logs in for that, have slots of their own.
    assert_eq!(get(rig.address, "/metrics").await.status, 200);
    assert_eq!(get(rig.address, "/api/v1/session").await.status, 200);
    assert_eq!(refused.header("retry-after"), Some("1"));
    let late = slow.await.expect("answered");
    assert_eq!(assert_problem(&late, 503)["type"], "urn:stictiond:problem:timeout");
    drop(open);
    assert_eq!(get(rig.address, "/api/v1/loops").await.status, 200);
}

#[tokio::test]
async fn the_network_is_refused_unless_the_configuration_says_so_in_plain_words() {
    let open =
        serve::Config { listen: "0.0.0.0:8080".parse().expect("an address"), ..serve::Config::default() };
    let said = |config: &serve::Config, log_in| {
        config.permits(config.listen, log_in).map_err(|error| error.to_string()).err().unwrap_or_default()
    };
    assert!(said(&open, false).contains("allow_unauthenticated_network = true"));
    assert!(said(&open, true).contains("allow_plain_http_on_network = true"));
    let tls = serve::TlsConfig { cert_file: "c".into(), key_file: "k".into(), client_ca_file: None };
    let encrypted = serve::Config { tls: Some(tls), ..open.clone() };
    assert!(said(&encrypted, false).contains("allow_unauthenticated_network = true"));
    assert_eq!(said(&encrypted, true), "");
    let behind_a_proxy = serve::Config { allow_plain_http_on_network: true, ..open.clone() };
    assert_eq!(said(&behind_a_proxy, true), "");
    assert!(!said(&behind_a_proxy, false).is_empty());
    let allowed = serve::Config { allow_unauthenticated_network: true, ..open };
    assert_eq!(said(&allowed, false), "");
    assert!(!said(&allowed, true).is_empty(), "with a log-in there are secrets to be read");
    for loopback in ["127.0.0.1:1", "127.8.9.1:1", "[::1]:1", "[::ffff:127.0.0.1]:1"] {
        let config =
            serve::Config { listen: loopback.parse().expect("an address"), ..serve::Config::default() };
        assert_eq!((said(&config, false), said(&config, true)), (String::new(), String::new()), "{loopback}");
    }
}
