//! Write-back by its API, and under faults.

mod daemon;
mod faults;
mod plant;

use crate::http::{Events, get, raw, send};
use crate::rig::assert_problem;
use daemon::Daemon;
use plant::Plant;
use std::net::SocketAddr;

const LOOP: &str = "/api/v1/loops/LIC201/writeback";

async fn post(to: SocketAddr, path: &str, body: &str) -> crate::http::Answer {
    send(to, "POST", path, &["content-type: application/json"], body).await
}

#[tokio::test]
async fn two_persons_grant_and_everybody_hears_of_it() {
    let plant = Plant::start();
    let address = plant.listen().await;
    let daemon = Daemon::start(address, address, "api").await;
    let api = daemon.api;
    let mut events = Events::open(api).await;

    let refused = async |what: &str, body: &str, status: u16| {
        assert_problem(&post(api, &format!("{LOOP}/{what}"), body).await, status)
    };
    assert_eq!(refused("grant", r#"{"duration_s": 60}"#, 400).await["field"], "by");
    assert_eq!(refused("grant", r#"{"by": " ", "duration_s": 60}"#, 400).await["field"], "by");
    assert_eq!(refused("grant", r#"{"by": "Ann", "duration_s": 601}"#, 400).await["field"], "duration_s");
    assert_eq!(
        refused("grant", r#"{"by": "Ann", "duration_s": 60, "approve": true}"#, 400).await["status"],
        400
    );
    for (what, body) in
        [("approve", r#"{"by": "Bob"}"#), ("withdraw", r#"{"by": "Bob"}"#), ("reset", r#"{"by": "Bob"}"#)]
    {
        assert_eq!(refused(what, body, 409).await["type"], "urn:stictiond:problem:writeback_state");
    }
    assert_problem(
        &post(api, "/api/v1/loops/NONE/writeback/grant", r#"{"by": "Ann", "duration_s": 60}"#).await,
        404,
    );

    let granted = daemon.act("grant", r#"{"by": "Ann", "duration_s": 60}"#).await;
    assert_eq!((&granted["state"], &granted["grant"]["by"]), (&"shadow".into(), &"Ann".into()));
    let same = refused("approve", r#"{"by": "ann"}"#, 409).await;
    assert!(same["detail"].as_str().is_some_and(|text| text.contains("cannot approve")), "{same}");
    let approved = daemon.act("approve", r#"{"by": "Bob"}"#).await;
    assert_eq!((&approved["state"], &approved["grant"]["approved_by"]), (&"armed".into(), &"Bob".into()));
    assert_eq!(daemon.act("withdraw", r#"{"by": "Cid"}"#).await["grant"], serde_json::Value::Null);

    let mut heard = Vec::new();
    while heard.len() < 4 {
        let (name, data) = events.next().await.expect("the stream goes on");
        if name == "writeback" {
            assert_eq!(data["loop"], "LIC201");
            heard.push((data["what"].clone(), data["by"].clone()));
        }
    }
    let expected = [("grant", "Ann"), ("approval", "Bob"), ("transition", "Bob"), ("transition", "Cid")];
    assert_eq!(heard, expected.map(|(what, by)| (what.into(), by.into())));

    let detail = get(api, "/api/v1/loops/LIC201").await.json();
    assert_eq!(detail["writeback"]["state"], "shadow");
    let metrics = get(api, "/metrics").await.text();
    assert!(metrics.contains("stictiond_writeback_state{loop=\"LIC201\",state=\"shadow\"} 1"), "{metrics}");
    let described = get(api, "/openapi.json").await.json();
    for what in ["grant", "approve", "withdraw", "reset"] {
        let path = format!("/api/v1/loops/{{id}}/writeback/{what}");
        assert!(described["paths"][&path]["post"].is_object(), "{path}");
    }
}

/// Write-back's log was changed while the daemon was away, where people's changes have a log of their own and where they have none.
#[tokio::test]
async fn a_record_that_was_changed_stops_grants_and_not_the_daemon() {
    let plant = Plant::start();
    let address = plant.listen().await;
    let mut daemon = Daemon::start(address, address, "changed").await;
    daemon.state("shadow").await;
    daemon.signal("-TERM");
    daemon.child.wait().await.expect("waited");
    let (audit, path) = (daemon.audit.clone(), daemon.audit.with_extension("toml"));
    let mut bytes = std::fs::read(&audit).expect("there");
    // In the time of the first entry.
    bytes[10] ^= 1;
    std::fs::write(&audit, bytes).expect("written");

    let changes = daemon.audit.with_extension("changes");
    for old in [changes.clone(), daemon.audit.with_extension("changes.head")] {
        let _ = std::fs::remove_file(old);
    }
    for more in [String::new(), format!("[audit]\nfile = '{}'\n", changes.display())] {
        let text = daemon::config(address, address, &audit) + &more;
        let mut daemon = Daemon::run(&text, &path, audit.clone()).await;
        daemon.state("shadow").await;
        for (what, body) in [("grant", r#"{"by": "Ann", "duration_s": 60}"#), ("approve", r#"{"by": "Bob"}"#)]
        {
            let problem = assert_problem(&post(daemon.api, &format!("{LOOP}/{what}"), body).await, 503);
            assert_eq!(problem["type"], "urn:stictiond:problem:audit_failed");
            let detail = problem["detail"].as_str().expect("text");
            assert!(detail.contains(&format!("stictiond audit renew {}", audit.display())), "{detail}");
        }
        // Past the record: there is nothing to take back.
        let problem =
            assert_problem(&post(daemon.api, &format!("{LOOP}/withdraw"), r#"{"by": "Bob"}"#).await, 409);
        assert_eq!(problem["type"], "urn:stictiond:problem:writeback_state");
        let health = get(daemon.api, "/healthz").await.json();
        assert_eq!(
            (&health["audit"]["state"], &health["audit"]["damaged"]),
            (&"failing".into(), &true.into())
        );
        assert_eq!(plant.term().0, 0.0);
        daemon.signal("-TERM");
        daemon.child.wait().await.expect("waited");
    }
}

/// Names are believed, so nobody beyond this machine may act.
#[tokio::test]
async fn on_a_listener_for_the_network_nobody_acts() {
    let plant = Plant::start();
    let address = plant.listen().await;
    let daemon = Daemon::on_the_network(address, "network").await;
    let api = SocketAddr::from(([127, 0, 0, 1], daemon.api.port()));
    assert_eq!(get(api, LOOP).await.json()["state"], "shadow");
    for what in ["grant", "approve", "withdraw", "reset"] {
        let body = if what == "grant" { r#"{"by": "Ann", "duration_s": 60}"# } else { r#"{"by": "Ann"}"# };
        let problem = assert_problem(&post(api, &format!("{LOOP}/{what}"), body).await, 403);
        assert_eq!(problem["type"], "urn:stictiond:problem:loopback_only");
    }
}

/// A page whose name was made to point at this machine is of one origin with the daemon, as the browser sees it.
#[tokio::test]
async fn under_a_name_of_somebody_else_nobody_acts() {
    let plant = Plant::start();
    let address = plant.listen().await;
    let daemon = Daemon::start(address, address, "rebinding").await;
    let port = daemon.api.port();
    let act = async |host: String| {
        let request = format!(
            "POST {LOOP}/grant HTTP/1.1\r\nhost: {host}\r\norigin: http://{host}\r\nconnection: close\r\n"
        );
        raw(daemon.api, &request, r#"{"by": "Ann", "duration_s": 60}"#).await
    };
    for host in [format!("evil.example:{port}"), format!("127.0.0.1.evil.example:{port}")] {
        let problem = assert_problem(&act(host).await, 421);
        assert_eq!(problem["type"], "urn:stictiond:problem:unknown_host");
    }
    let problem = assert_problem(&act("10.0.0.5".into()).await, 403);
    assert_eq!(problem["type"], "urn:stictiond:problem:loopback_only");
    for host in [format!("localhost:{port}"), format!("[::1]:{port}"), format!("127.0.0.1:{port}")] {
        assert_eq!(act(host).await.status, 200);
    }
}
