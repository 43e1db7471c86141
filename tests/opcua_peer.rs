//! The OPC UA collector against asyncua: a server that was not written here, with real faults.

#[cfg(test)]
#[path = "peers/opcua.rs"]
mod peers;

use peers::{Server, TICK_S, Watch, config, config_secure, folder, plan, steady, trust};
use std::time::Duration;
use stictiond::signal::{BadReason, Quality, Sample};

const COUNTER: &str = "path = '/2:Plant/2:Unit/2:Counter'";

/// Every sample of the counter says what its source time must be, also those from history.
fn checked(samples: &[Sample]) -> Vec<u64> {
    let good: Vec<&Sample> = samples.iter().filter(|s| s.quality.is_good()).collect();
    for pair in samples.windows(2) {
        assert!(pair[1].t > pair[0].t, "twice, or backwards: {pair:?}");
    }
    for sample in &good {
        // asyncua keeps microseconds, and a double of this size steps by 2.4e-7 s.
        assert!((sample.t - sample.value * TICK_S).abs() < 5e-6, "not its source time: {sample:?}");
    }
    good.iter().map(|sample| sample.value as u64).collect()
}

fn holes(ticks: &[u64]) -> Vec<(u64, u64)> {
    ticks.windows(2).filter(|pair| pair[1] != pair[0] + 1).map(|pair| (pair[0], pair[1])).collect()
}

#[tokio::test]
async fn reads_and_subscribes_with_source_times_by_node_id_and_by_path() {
    let server = Server::start(&[]).await;
    for mode in ["subscribe", "poll"] {
        let config = config(server.port, &format!("mode = '{mode}'\nsampling_ms = 20\npublishing_ms = 50"));
        let tags = [
            steady(7),
            COUNTER.into(),
            "node = 'ns=2;s=Flag'".into(),
            steady(8) + "\nscale = 2.0\noffset = 1.0",
        ];
        let mut watch = Watch::start(plan(&config, &tags));
        let counted = watch.until("60 values", 1, |all| all.len() >= 60).await;
        let ticks = checked(&counted);
        if mode == "subscribe" {
            // Every change is sampled and queued: a machine that is slow delays samples, and loses none.
            assert_eq!(holes(&ticks), [], "{ticks:?}");
        }
        for (tag, value) in [(0, 7.0), (2, 1.0), (3, 17.0)] {
            let samples = watch.until("a value", tag, |all| !all.is_empty()).await;
            // It never changes: it is one sample, with one source time, and never stamped anew.
            let said: Vec<(f64, Quality)> = samples.iter().map(|s| (s.value, s.quality)).collect();
            assert_eq!(said, [(value, Quality::Good)], "tag {tag}");
        }
        assert!(watch.health.snapshot().connected);
        watch.stop().await;
    }
}

#[tokio::test]
async fn a_server_restarted_mid_run_leaves_no_gap_where_it_keeps_history_and_no_duplicate() {
    let server = Server::start(&["--history"]).await;
    let port = server.port;
    let config =
        config(port, "sampling_ms = 20\npublishing_ms = 50\nqueue_size = 100\nreconnect_max_ms = 1000");
    let mut watch = Watch::start(plan(&config, &[COUNTER.into(), steady(3)]));
    watch.until("values", 0, |all| all.len() > 20).await;
    server.kill().await;
    watch.until_health("down", |health| !health.connected).await;
    let before = watch.samples(0).len();
    // The historian has gone on by the time it is back: a minute of it, more than the outage was.
    let server = Server::start(&["--history", "--backlog", "60", "--port", &port.to_string()]).await;
    let began = tokio::time::Instant::now();
    watch.until_health("connected again", |health| health.reconnects > 0 && health.connected).await;
    let took = began.elapsed();
    // Two back-off steps of at most 1 s each, and the time that a busy machine takes to open a session.
    assert!(took < Duration::from_secs(10), "{took:?}");
    let samples = watch.until("values again", 0, |all| all.len() > before + 60).await;
    let ticks = checked(&samples);
    assert!(watch.health.snapshot().filled_samples > 0, "nothing was filled");
    // The server's counter begins when it has started and its backlog ends a little before: one hole at most, and its
    // own, of what starting takes it.
    let longest = holes(&ticks).iter().map(|(a, b)| b - a).max().unwrap_or(0);
    assert!(holes(&ticks).len() <= 1 && longest < 100, "a gap of {longest} ticks: {:?}", holes(&ticks));
    assert!(samples.iter().all(|s| s.quality.is_good()), "a filled gap is no gap");
    println!(
        "reconnected in {took:?}; filled {}; holes {:?}",
        watch.health.snapshot().filled_samples,
        holes(&ticks)
    );
    watch.stop().await;
    drop(server);
}

#[tokio::test]
async fn a_gap_without_history_is_said_to_be_one() {
    let server = Server::start(&[]).await;
    let port = server.port;
    let config =
        config(port, "sampling_ms = 20\npublishing_ms = 50\nqueue_size = 100\nreconnect_max_ms = 1000");
    let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
    watch.until("values", 0, |all| all.len() > 20).await;
    server.kill().await;
    watch.until_health("down", |health| !health.connected).await;
    let before = watch.samples(0).len();
    let _server = Server::start(&["--port", &port.to_string()]).await;
    let samples = watch.until("values again", 0, |all| all.len() > before + 20).await;
    let ticks = checked(&samples);
    let bad: Vec<&Sample> = samples.iter().filter(|s| !s.quality.is_good()).collect();
    assert_eq!(bad.len(), 1, "{bad:?}");
    assert_eq!(bad[0].quality, Quality::Bad(BadReason::LinkDown));
    let (last, next) = holes(&ticks)[0];
    assert!(last as f64 * TICK_S < bad[0].t && bad[0].t < next as f64 * TICK_S);
    watch.stop().await;
}

#[tokio::test]
async fn a_bad_node_a_bad_value_and_an_old_one_stop_no_other() {
    let mut server = Server::start(&[]).await;
    let config = config(server.port, "sampling_ms = 20\npublishing_ms = 50");
    let tags = [
        "node = 'ns=2;s=Nowhere'".into(),
        "path = '/2:Plant/2:Nowhere'".into(),
        steady(1),
        steady(2),
        COUNTER.into(),
    ];
    let mut watch = Watch::start(plan(&config, &tags));
    for tag in [0, 1] {
        let samples = watch.until("refused", tag, |all| !all.is_empty()).await;
        assert_eq!(samples[0].quality, Quality::Bad(BadReason::DeviceException));
        assert!(samples[0].value.is_nan());
    }
    server.tell("bad Steady1").await;
    server.tell("uncertain Steady2").await;
    let bad = watch.until("bad", 2, |all| all.len() > 1).await;
    assert_eq!(bad[1].quality, Quality::Bad(BadReason::DeviceException));
    let stale = watch.until("stale", 3, |all| all.len() > 1).await;
    assert_eq!((stale[1].value, stale[1].quality), (1.0, Quality::Stale));
    server.tell("set Steady1 5").await;
    let good = watch.until("good again", 2, |all| all.len() > 2).await;
    assert_eq!((good[2].value, good[2].quality), (5.0, Quality::Good));
    checked(&watch.until("the counter", 4, |all| all.len() > 20).await);
    watch.stop().await;
}

#[tokio::test]
async fn a_limit_of_ten_nodes_a_read_is_kept_whether_or_not_it_is_said() {
    for (unsaid, most) in [(false, 10), (true, 30)] {
        let mut args = vec!["--max-read", "10"];
        args.extend(unsaid.then_some("--unsaid"));
        let mut server = Server::start(&args).await;
        let config = config(server.port, "mode = 'poll'\nsampling_ms = 50");
        let tags: Vec<String> = (0..30).map(steady).collect();
        let mut watch = Watch::start(plan(&config, &tags));
        for tag in 0..30 {
            let samples = watch.until("a value", tag, |all| !all.is_empty()).await;
            assert_eq!((samples[0].value, samples[0].quality), (tag as f64, Quality::Good));
        }
        // Untold, it is found by the one refusal that it takes.
        assert_eq!(server.ask("max").await, format!("max {most}"));
        assert_eq!(watch.health.snapshot().link_errors, 0);
        watch.stop().await;
    }
}

#[tokio::test]
async fn a_session_that_is_connected_but_silent_is_dead() {
    let mut server = Server::start(&[]).await;
    let config =
        config(server.port, "sampling_ms = 20\npublishing_ms = 50\nsilent_s = 1.0\nfill_gaps = false");
    let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
    watch.until("values", 0, |all| all.len() > 20).await;
    server.tell("silent").await;
    let health = watch.until_health("given up", |health| health.reconnects > 0).await;
    assert!(health.link_errors > 0, "{health:?}");
    checked(&watch.samples(0));
    watch.stop().await;
}

#[tokio::test]
async fn values_that_do_not_change_are_no_reason_to_reconnect() {
    let server = Server::start(&[]).await;
    let config = config(server.port, "publishing_ms = 50\nsilent_s = 0.3");
    let mut watch = Watch::start(plan(&config, &[steady(1)]));
    watch.until("a value", 0, |all| !all.is_empty()).await;
    // Forty publishings are several times the silence allowed.
    let health = watch.until_health("periods", |health| health.polls > 40).await;
    assert_eq!((health.reconnects, health.link_errors, health.timeouts), (0, 0, 0));
    assert_eq!(watch.samples(0).len(), 1);
    watch.stop().await;
}

#[tokio::test]
async fn sign_and_encrypt_with_a_user_name_and_explicit_trust() {
    let folder = folder();
    let server = Server::start(&["--secure", folder.to_str().unwrap()]).await;
    std::fs::write(folder.join("password"), "right\n").unwrap();
    std::fs::write(folder.join("wrong"), "wrong\n").unwrap();
    for (policy, pki) in [("Basic256Sha256", "pki"), ("Aes256_Sha256_RsaPss", "pki2")] {
        let pki = folder.join(pki);
        let secure = |password: &str| {
            let more = format!(
                "security_policy = '{policy}'\npki_dir = '{}'\nuser = 'operator'\npassword_file = '{}'\nsampling_ms = 20\n\
                 publishing_ms = 50\nreconnect_max_ms = 500",
                pki.display(),
                folder.join(password).display()
            );
            plan(&config_secure(server.port, &more), &[COUNTER.into()])
        };
        // Without a key of our own nobody is asked.
        let mut watch = Watch::start(secure("password"));
        let line = watch.until_said("own/cert.der").await;
        assert!(line.contains("docs/configuration.md"), "{line}");
        watch.stop().await;

        // The server is not trusted yet: refused, and its certificate laid aside for people to compare.
        trust(&folder, &pki, false);
        let mut watch = Watch::start(secure("password"));
        let line = watch.until_said("is not trusted").await;
        assert!(
            line.contains("rejected") && line.contains("trusted") && line.contains("localhost"),
            "{line}"
        );
        assert!(watch.samples(0).iter().all(|s| !s.quality.is_good()));
        watch.stop().await;

        // People have moved it.
        trust(&folder, &pki, true);
        let mut watch = Watch::start(secure("wrong"));
        let line = watch.until_said("refuses this user or password").await;
        assert!(!line.contains("wrong"), "a secret in the log: {line}");
        watch.stop().await;

        let mut watch = Watch::start(secure("password"));
        let counted = watch.until("60 values", 0, |all| all.len() >= 60).await;
        assert_eq!(holes(&checked(&counted)), []);
        watch.stop().await;
    }
    std::fs::remove_dir_all(folder).unwrap();
}
