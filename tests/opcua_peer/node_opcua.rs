//! A second implementation: node-opcua, with limits, percent dead bands, continuation points and certificates of its own.

use super::rig::{Server, Watch, checked, config, config_secure, folder, plan, trust};
use stictiond::signal::Quality;

const COUNTER: &str = "node = 'ns=1;s=Counter'";
/// The counter changes by two of its ticks.
const STEP: u64 = 2;

fn steady(k: usize) -> String {
    format!("node = 'ns=1;s=Steady{k}'")
}

#[tokio::test]
async fn thirty_nodes_ten_at_a_time_and_a_dead_band_of_a_range() {
    let folder = folder("node");
    let mut server = Server::start_node(&folder, 0, 0).await;
    let mut tags: Vec<String> = (0..30).map(steady).collect();
    tags.extend((0..12).map(|k| format!("path = '/1:Plant/1:Steady{k}'\ndeadband_percent = 0.0")));
    tags.extend([COUNTER.into(), "node = 'ns=1;s=Nowhere'".into()]);
    let (counter, nowhere) = (tags.len() - 2, tags.len() - 1);
    for mode in ["subscribe", "poll"] {
        let lines = format!("mode = '{mode}'\nsampling_ms = 20\npublishing_ms = 50\ndeadband_percent = 5.0");
        let mut watch = Watch::start(plan(&config(server.port, &lines), &tags));
        for tag in 0..counter {
            let samples = watch.until("a value", tag, |all| !all.is_empty()).await;
            assert_eq!((samples[0].value, samples[0].quality), ((tag % 30) as f64, Quality::Good));
        }
        // It has no EURange, so there is nothing that 5 % could be of: all is sent.
        checked(&watch.until("the counter", counter, |all| all.len() > 20).await);
        let refused = watch.until("a refusal", nowhere, |all| !all.is_empty()).await;
        assert!(refused.iter().all(|s| s.value.is_nan() && !s.quality.is_good()), "{refused:?}");
        let health = watch.health.snapshot();
        assert_eq!((health.link_errors, health.timeouts, health.reconnects), (0, 0, 0), "{health:?}");
        if mode == "subscribe" {
            // Of 0 to 100: 3 is not sent, 10 is; the same node without a band sends both.
            let (banded, plain) = (1, 31);
            for value in [4.0, 14.0] {
                server.tell(&format!("set Steady1 {value}")).await;
                watch.until("without a band", plain, |all| all.iter().any(|s| s.value == value)).await;
            }
            let samples = watch.until("a great change", banded, |all| all.len() > 1).await;
            assert_eq!(samples.iter().map(|s| s.value).collect::<Vec<_>>(), [1.0, 14.0]);
            server.tell("set Steady1 1.0").await;
        }
        watch.stop().await;
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[tokio::test]
async fn restarted_mid_run_the_gap_is_filled_over_continuation_points() {
    let folder = folder("node-restart");
    let server = Server::start_node(&folder, 0, 0).await;
    let port = server.port;
    let lines = "sampling_ms = 10\npublishing_ms = 50\nqueue_size = 100\nreconnect_max_ms = 1000";
    let mut watch = Watch::start(plan(&config(port, lines), &[COUNTER.into(), steady(3)]));
    watch.until("values", 0, |all| all.len() > 20).await;
    server.kill().await;
    watch.until_health("down", |health| !health.connected).await;
    let before = watch.samples(0).len();
    let server = Server::start_node(&folder, port, 60).await;
    watch.until_health("filled", |health| health.connected && health.filled_samples > 0).await;
    // The first value that the subscription brings comes after all of history.
    let samples = watch.until("values again", 0, |all| all.len() > before + 100).await;
    let ticks = checked(&samples);
    let filled = watch.health.snapshot().filled_samples as usize;
    // From the last sample before to the last of history: every step of the counter, once.
    for pair in ticks[before - 1..before + filled].windows(2) {
        assert_eq!(pair[1], pair[0] + STEP, "a gap of {} ticks", pair[1] - pair[0]);
    }
    assert!(samples.iter().all(|s| s.quality.is_good()));
    // Steady3 has no history and is another of the nodes asked; it does not keep the counter's from being read.
    let steady = watch.until("the other", 1, |all| !all.is_empty()).await;
    assert!(steady.iter().all(|s| s.value == 3.0 || s.value.is_nan()), "{steady:?}");
    println!("filled {filled} samples after a restart");
    watch.stop().await;
    drop(server);
    std::fs::remove_dir_all(folder).unwrap();
}

#[tokio::test]
async fn its_certificate_is_refused_until_it_is_trusted() {
    let made = folder("node-secure");
    // The other server makes certificates of a server and of us.
    drop(Server::start(&["--secure", made.to_str().unwrap()]).await);
    let server = Server::start_node(&made, 0, 0).await;
    let pki = made.join("pki");
    for policy in ["Basic256Sha256", "Aes256_Sha256_RsaPss"] {
        let lines =
            format!("security_policy = '{policy}'\npki_dir = '{}'\nreconnect_max_ms = 100", pki.display());
        let plan = || plan(&config_secure(server.port, &lines), &[COUNTER.into()]);
        if policy == "Basic256Sha256" {
            trust(&made, &pki, false);
            let mut watch = Watch::start(plan());
            watch.until_said("is not trusted by us").await;
            assert_eq!(watch.samples(0), []);
            watch.stop().await;
            trust(&made, &pki, true);
        }
        let mut watch = Watch::start(plan());
        checked(&watch.until("values", 0, |all| all.len() > 3).await);
        watch.stop().await;
    }
    std::fs::remove_dir_all(made).unwrap();
}
