//! Webhooks against the library of Standard Webhooks.

use super::rig::{Daemon, Peer, folder, plant};
use serde_json::Value;
use std::path::Path;

pub const SECRET: &str = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSwMfKQ9r8GKYo=";

/// A daemon's configuration that tells the peer; `more` belongs to the webhook.
fn told(store: Option<&Path>, secret: &Path, port: u16, more: &str) -> String {
    let text = format!(
        "[notify]\nsite = 'plant A'\npublic_url = 'https://stictiond.plant/'\n[[notify.webhook]]\nname = 'cmms'\n\
         url = 'http://127.0.0.1:{port}/hook'\nsecret_file = '{}'\ntimeout_s = 5.0\n{more}",
        secret.display()
    );
    plant(store, &text)
}

const QUICK: &str = "[notify.webhook.pace]\nwait_s = 0.2\ninterval_s = 0.0\n[notify.webhook.retry]\nfirst_s = 0.05\nlongest_s = 0.2\n";

fn ids(message: &Value) -> Vec<(String, String)> {
    let alarms = message["body"]["data"]["alarms"].as_array().unwrap().iter();
    let text = |value: &Value| value.as_str().unwrap().to_string();
    alarms.map(|alarm| (text(&alarm["id"]), text(&alarm["event"]))).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_are_signed_grouped_tried_again_and_dead_letters_are_replayed() {
    let (folder, mut peer) = (folder("webhook"), Peer::start("webhook_server.py", &[SECRET]).await);
    let secret = folder.join("secret");
    std::fs::write(&secret, format!("{SECRET}\n")).unwrap();
    let store = folder.join("store");
    let text = told(Some(&store), &secret, peer.port, QUICK);
    let daemon = Daemon::start(&text).await;

    // Two alarms at once are one message, verified by the library, which refuses four forgeries of it.
    daemon.diagnosed("FIC1", Some(2.5));
    daemon.diagnosed("FIC2", Some(0.6));
    let message = peer.next().await;
    assert_eq!((&message["verified"], &message["forged_refused"]), (&true.into(), &true.into()), "{message}");
    let both =
        [("FIC1/stiction".to_string(), "raised".to_string()), ("FIC2/stiction".into(), "raised".into())];
    assert_eq!(ids(&message), both);
    let alarm = &message["body"]["data"]["alarms"][0];
    assert_eq!(
        (&message["body"]["type"], &message["body"]["data"]["site"]),
        (&"alarms".into(), &"plant A".into())
    );
    assert_eq!(
        (&alarm["f"], &alarm["priority"], &alarm["f_unit"]),
        (&2.5.into(), &"high".into(), &"% OP".into())
    );
    assert_eq!(alarm["link"], "https://stictiond.plant/#/loop/FIC1");

    // What fails for a while arrives in the end, under the same name.
    peer.tell("answer 503 2").await;
    peer.tell("answer 429 1 1").await;
    daemon.diagnosed("FIC1", None);
    let tries: Vec<Value> =
        [peer.next().await, peer.next().await, peer.next().await, peer.next().await].into();
    let statuses: Vec<u64> = tries.iter().map(|m| m["status"].as_u64().unwrap()).collect();
    assert_eq!(statuses, [503, 503, 429, 204]);
    assert!(tries.iter().all(|m| m["id"] == tries[0]["id"] && m["verified"] == true), "{tries:?}");
    let waited = tries[3]["stamp"].as_i64().unwrap() - tries[2]["stamp"].as_i64().unwrap();
    assert!(waited >= 1, "Retry-After of a second was not kept");
    assert_eq!(ids(&tries[3]), [("FIC1/stiction".into(), "cleared".into())]);

    // What is refused for good is not tried again.
    peer.tell("answer 400 1").await;
    daemon.diagnosed("FIC1", Some(2.5));
    let refused = peer.next().await;
    daemon.receiver("cmms", "a dead letter", |own| own["dead_letters"] == 1).await;
    let dead = daemon.json("/api/v1/notifications/cmms/dead-letters").await;
    assert_eq!((&dead["items"][0]["id"], &dead["items"][0]["attempts"]), (&refused["id"], &1.into()));
    assert!(dead["items"][0]["reason"].as_str().unwrap().starts_with("400"), "{dead}");
    let (_, metrics) = daemon.ask("GET", "/metrics", "").await;
    let line = "stictiond_notify_dead_letters{receiver=\"cmms\",kind=\"webhook\"} 1.0";
    assert!(metrics.contains(line) && !metrics.contains("whsec_"), "{metrics}");

    // It outlives a restart, and is replayed under its name.
    daemon.stop().await;
    let daemon = Daemon::start(&text).await;
    let (status, answer) =
        daemon.ask("POST", "/api/v1/notifications/cmms/replay", "{\"id\": \"msg_x\"}").await;
    assert_eq!(status, 404, "{answer}");
    let (status, answer) = daemon.ask("POST", "/api/v1/notifications/cmms/replay", "").await;
    assert_eq!((status, answer.as_str()), (200, "{\"replayed\":1}"));
    let replayed = peer.next().await;
    assert_eq!((&replayed["id"], &replayed["status"]), (&refused["id"], &204.into()));
    assert_eq!((&replayed["body"], &replayed["verified"]), (&refused["body"], &true.into()));
    daemon.receiver("cmms", "none dead", |own| own["dead_letters"] == 0 && own["queue"] == 0).await;

    // Who is gone gets nothing more until somebody asks for it.
    peer.tell("answer 410 1").await;
    daemon.diagnosed("FIC1", None);
    assert_eq!(peer.next().await["status"], 410);
    daemon.receiver("cmms", "gone", |own| own["dead_letters"] == 1).await;
    daemon.diagnosed("FIC1", Some(2.5));
    daemon.receiver("cmms", "not sent", |own| own["dead_letters"] == 2).await;
    daemon.ask("POST", "/api/v1/notifications/cmms/replay", "").await;
    let replayed = [peer.next().await, peer.next().await];
    assert_eq!(replayed.each_ref().map(|m| ids(m)[0].1.clone()), ["cleared", "raised"]);

    // Or until the configuration is read again, though it is the same.
    peer.tell("answer 410 1").await;
    daemon.diagnosed("FIC1", None);
    assert_eq!(peer.next().await["status"], 410);
    daemon.receiver("cmms", "gone again", |own| own["dead_letters"] == 1).await;
    daemon.reload(&text).await;
    daemon.diagnosed("FIC1", Some(2.5));
    assert_eq!(ids(&peer.next().await), [("FIC1/stiction".into(), "raised".into())]);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_receiver_that_is_dead_stops_nobody_and_a_reload_reaches_it_again() {
    let (folder, mut peer) = (folder("dead"), Peer::start("webhook_server.py", &[SECRET]).await);
    let secret = folder.join("secret");
    std::fs::write(&secret, "whsec_AAAA\n").unwrap();
    // The secret is none, and then the port is nobody's.
    let text = told(None, &secret, peer.port, QUICK);
    let daemon = Daemon::start(&text).await;
    daemon.diagnosed("FIC1", Some(2.5));
    let own = daemon.receiver("cmms", "failing", |own| own["state"] == "failing").await;
    assert!(own["reason"].as_str().unwrap().starts_with("a secret is not"), "{own}");
    daemon.reload(&told(None, &secret, 1, QUICK)).await;
    daemon.receiver("cmms", "still failing", |own| own["failed"].as_u64().unwrap() >= 2).await;
    daemon.diagnosed("FIC2", Some(0.6));
    daemon.receiver("cmms", "a message and a notice wait", |own| own["queue"] == 2).await;
    let health = daemon.json("/healthz").await;
    assert_eq!(
        (&health["status"], &health["notifications"]["failing"]),
        (&"ok".into(), &1.into()),
        "{health}"
    );

    // What waited goes on under the new configuration, and what a filter does not take is not told.
    std::fs::write(&secret, format!("{SECRET}\n")).unwrap();
    let filter =
        "[notify.webhook.filter]\nkinds = ['stiction']\nmin_priority = 'high'\ngroups = ['unit 10']\n";
    daemon.reload(&told(None, &secret, peer.port, &format!("{filter}{QUICK}"))).await;
    // Either may come first: one waits for its next trial, the other for its first. FIC2's is of before the filter.
    let mut both = [ids(&peer.next().await), ids(&peer.next().await)].concat();
    both.sort();
    assert_eq!(both, [("FIC1/stiction".into(), "raised".into()), ("FIC2/stiction".into(), "raised".into())]);
    daemon.diagnosed("FIC2", None);
    daemon.diagnosed("FIC1", None);
    assert_eq!(ids(&peer.next().await), [("FIC1/stiction".into(), "cleared".into())]);
    daemon.receiver("cmms", "working", |own| own["state"] == "working" && own["queue"] == 0).await;
    daemon.stop().await;
}
