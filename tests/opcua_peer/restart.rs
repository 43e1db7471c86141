//! A server that goes away and comes back.

use super::rig::{COUNTER, Server, TICK_S, Watch, checked, config, holes, plan, steady};
use stictiond::signal::{BadReason, Quality, Sample};

#[tokio::test]
async fn a_server_restarted_mid_run_leaves_no_gap_where_it_keeps_history_and_no_duplicate() {
    // 3000 values of history: in three answers that say nothing of more to come, and in pages of 300 that do.
    for more in [&[][..], &["--cap", "300"][..]] {
        restarted(more).await;
    }
}

async fn restarted(more: &[&str]) {
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
    let again = port.to_string();
    let args = [&["--history", "--backlog", "60", "--port", &again], more].concat();
    let server = Server::start(&args).await;
    let (began, tried) = (tokio::time::Instant::now(), failures(&watch));
    watch.until_health("connected again", |health| health.reconnects > 0 && health.connected).await;
    let took = began.elapsed();
    // One attempt may have been on its way when the server came up; the next has to succeed.
    let steps = failures(&watch) - tried + 1;
    assert!(steps <= 2, "{steps} back-off steps, {took:?}");
    let samples = watch.until("values again", 0, |all| all.len() > before + 60).await;
    let ticks = checked(&samples);
    assert!(watch.health.snapshot().filled_samples > 0, "nothing was filled");
    assert_eq!(holes(&ticks), []);
    assert!(samples.iter().all(|s| s.quality.is_good()), "a filled gap is no gap");
    println!(
        "reconnected in {took:?}, back-off steps {steps}; filled {}",
        watch.health.snapshot().filled_samples
    );
    watch.stop().await;
    drop(server);
}

fn failures(watch: &Watch) -> u64 {
    let health = watch.health.snapshot();
    health.link_errors + health.timeouts + health.security_errors
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
async fn a_connection_cut_mid_run_loses_and_repeats_nothing() {
    let mut server = Server::start(&["--history"]).await;
    let config = config(server.port, "sampling_ms = 20\npublishing_ms = 50\nqueue_size = 100");
    let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
    for cut in 1..=3 {
        let before = watch.samples(0).len();
        watch.until("values", 0, |all| all.len() > before + 20).await;
        server.tell("drop").await;
        watch.until_health("a new session", |health| health.reconnects == cut && health.connected).await;
        // A session counts polls once its history is read: two that are lost before leave history out.
        let polls = watch.health.snapshot().polls;
        watch.until_health("live values", |health| health.connected && health.polls > polls).await;
    }
    let before = watch.samples(0).len();
    let samples = watch.until("values after all", 0, |all| all.len() > before + 40).await;
    assert_eq!(holes(&checked(&samples)), []);
    assert!(samples.iter().all(|s| s.quality.is_good()));
    assert!(watch.health.snapshot().filled_samples > 0);
    watch.stop().await;
}
