//! Values, their times and their quality, by subscription and by reading.

use super::rig::{COUNTER, Server, Watch, checked, config, holes, plan, steady};
use stictiond::signal::{BadReason, Quality};

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
    let config = config(server.port, "sampling_ms = 20\npublishing_ms = 50\nsilent_s = 0.3");
    let mut watch = Watch::start(plan(&config, &[steady(1)]));
    watch.until("a value", 0, |all| !all.is_empty()).await;
    // Forty publishings are several times the silence allowed.
    let health = watch.until_health("periods", |health| health.polls > 40).await;
    assert_eq!((health.reconnects, health.link_errors, health.timeouts), (0, 0, 0));
    assert_eq!(watch.samples(0).len(), 1);
    watch.stop().await;
}

#[tokio::test]
async fn a_subscription_slower_than_the_silence_allowed_is_no_reason_to_reconnect() {
    let server = Server::start(&[]).await;
    let config = config(server.port, "sampling_ms = 500\npublishing_ms = 500\nsilent_s = 0.3");
    let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
    watch.until("values", 0, |all| all.len() > 10).await;
    let health = watch.health.snapshot();
    assert_eq!((health.reconnects, health.link_errors, health.timeouts), (0, 0, 0), "{health:?}");
    watch.stop().await;
}

#[tokio::test]
async fn a_value_that_has_to_move_and_does_not_is_stale_once() {
    let mut server = Server::start(&[]).await;
    for (mode, value) in [("subscribe", 5.0), ("poll", 6.0)] {
        let lines = format!("mode = '{mode}'\nsampling_ms = 20\npublishing_ms = 50");
        let mut planned = plan(&config(server.port, &lines), &[steady(1)]);
        planned.tags[0].frozen_after_s = Some(0.5);
        let mut watch = Watch::start(planned);
        let first = watch.until("stale", 0, |all| all.iter().any(|s| s.quality == Quality::Stale)).await;
        let polls = watch.health.snapshot().polls;
        watch.until_health("periods", |health| health.polls > polls + 20).await;
        assert_eq!(watch.samples(0).len(), first.len(), "{mode}");
        server.tell(&format!("set Steady1 {value}")).await;
        let samples = watch.until("it moves", 0, |all| all.iter().any(|s| s.value == value)).await;
        let moved = samples.iter().find(|s| s.value == value).expect("it is there");
        assert_eq!(moved.quality, Quality::Good, "{mode}");
        assert!(samples.windows(2).all(|pair| pair[1].t > pair[0].t), "{samples:?}");
        watch.stop().await;
    }
}

#[tokio::test]
async fn a_dead_band_holds_back_small_changes_of_its_own_node_only() {
    let mut server = Server::start(&[]).await;
    let config = config(server.port, "sampling_ms = 20\npublishing_ms = 50");
    let tags = [steady(1) + "\ndeadband = 2.0", steady(2)];
    let mut watch = Watch::start(plan(&config, &tags));
    for tag in [0, 1] {
        watch.until("the first value", tag, |all| !all.is_empty()).await;
    }
    for value in ["1.5", "4.5", "5.5"] {
        server.tell(&format!("set Steady1 {value}")).await;
        server.tell(&format!("set Steady2 {value}")).await;
        watch.until("without a band", 1, |all| all.iter().any(|s| s.value.to_string() == value)).await;
    }
    server.tell("set Steady1 9.5").await;
    let samples = watch.until("a great change", 0, |all| all.iter().any(|s| s.value == 9.5)).await;
    // 0.5 and 1.0 are changes within the band.
    assert_eq!(samples.iter().map(|s| s.value).collect::<Vec<_>>(), [1.0, 4.5, 9.5]);
    watch.stop().await;
}

#[tokio::test]
async fn a_source_clock_set_by_an_hour_invents_nothing_and_is_counted() {
    let mut server = Server::start(&[]).await;
    let config = config(server.port, "sampling_ms = 20\npublishing_ms = 50\nqueue_size = 100");
    let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
    watch.until("values", 0, |all| all.len() > 20).await;
    server.tell("jump 3600").await;
    watch.until_health("a jump forward", |health| health.clock_jumps == 1).await;
    let ahead = watch.samples(0).len();
    watch.until("values of then", 0, |all| all.len() > ahead + 20).await;
    server.tell("jump -3600").await;
    let health = watch.until_health("a jump back", |health| health.clock_jumps == 2).await;
    // The fifth of a row of older times is believed; the four before it are gone, and counted.
    assert_eq!(health.discarded_samples, 4, "{health:?}");
    let back = watch.samples(0).len();
    let samples = watch.until("values of now", 0, |all| all.len() > back + 20).await;
    let turn = samples.windows(2).position(|pair| pair[1].t < pair[0].t).unwrap() + 1;
    // What was handed on are values that were sent, each under its own time.
    checked(&samples[..turn]);
    checked(&samples[turn..]);
    assert!(samples.iter().all(|s| s.quality.is_good()));
    assert_eq!(health.reconnects, 0);
    watch.stop().await;
}
