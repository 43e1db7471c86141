//! Which node a name means when a server numbers its namespaces anew, and what a value has to be.

use super::past::{Taker, complete, wish};
use super::rig::{COUNTER, Server, Watch, config, plan};
use stictiond::collect::opcua::{Pinned, history};
use stictiond::signal::{BadReason, Quality};

/// Each kind of name, of the plant's Steady1; the first two by URI, the others by number.
const NAMES: [&str; 4] = [
    "node = 'nsu=urn:peer:plant;s=Steady1'",
    "path = '/nsu=urn:peer:plant;Plant/nsu=urn:peer:plant;Unit/nsu=urn:peer:plant;Steady1'",
    "node = 'ns=2;s=Steady1'",
    "path = '/2:Plant/2:Unit/2:Steady1'",
];

#[tokio::test]
async fn a_server_that_numbers_its_namespaces_anew_gives_the_same_node_or_an_error() {
    for mode in ["subscribe", "poll"] {
        let server = Server::start(&["--other", "last"]).await;
        let port = server.port;
        let more = "sampling_ms = 50\npublishing_ms = 50\nreconnect_max_ms = 500\nfill_gaps = false";
        let config = config(port, &format!("mode = '{mode}'\n{more}"));
        let mut watch = Watch::start(plan(&config, &NAMES.map(str::to_string)));
        for (tag, name) in NAMES.iter().enumerate() {
            let samples = watch.until("a value", tag, |all| !all.is_empty()).await;
            assert_eq!((samples[0].value, samples[0].quality), (1.0, Quality::Good), "{name}");
        }
        server.kill().await;
        watch.until_health("down", |health| !health.connected).await;
        let before: Vec<usize> = (0..NAMES.len()).map(|tag| watch.samples(tag).len()).collect();
        let _server = Server::start(&["--other", "first", "--port", &port.to_string()]).await;
        for tag in [0, 1] {
            let again = |all: &[_]| {
                all[before[tag]..].iter().any(|s: &stictiond::signal::Sample| s.quality.is_good())
            };
            watch.until("the same node", tag, again).await;
        }
        for tag in [2, 3] {
            let refused = Quality::Bad(BadReason::DeviceException);
            watch.until("an error", tag, |all| all.last().is_some_and(|s| s.quality == refused)).await;
        }
        // Whatever came of any tag is the value of its own node: the other plant's is 101.
        for (tag, name) in NAMES.iter().enumerate() {
            let samples = watch.samples(tag);
            assert!(samples.iter().all(|s| s.value.is_nan() || s.value == 1.0), "{name}: {samples:?}");
        }
        let said: Vec<String> =
            watch.warnings().into_iter().filter(|line| line.contains("is now 'urn:peer:other'")).collect();
        assert_eq!(said.len(), 2, "one line for each tag named by number: {said:?}");
        assert!(
            said.iter().all(|line| line.contains("'urn:peer:plant'") && line.contains("nsu=urn:peer:plant;"))
        );
        watch.stop().await;
    }
}

/// The counter by URI, which [`COUNTER`] is by number.
const COUNTER_BY_URI: &str =
    "path = '/nsu=urn:peer:plant;Plant/nsu=urn:peer:plant;Unit/nsu=urn:peer:plant;Counter'";

#[tokio::test]
async fn history_takes_a_number_for_what_the_collector_took_it_for_and_not_for_what_it_is_now() {
    let server = Server::start(&["--other", "last"]).await;
    let port = server.port;
    let config = config(port, "sampling_ms = 50\npublishing_ms = 50\nreconnect_max_ms = 500");
    let by_number = plan(&config, &[COUNTER.to_string()]);
    let pinned = Pinned::default();
    let mut watch = Watch::start_pinning(by_number.clone(), &pinned);
    watch.until("a value", 0, |all| all.iter().any(|sample| sample.quality.is_good())).await;
    watch.stop().await;
    server.kill().await;
    // After a restart of the daemon it knows no more than what was kept.
    let restarted = Pinned::of_text(&pinned.to_text()).expect("it is whole");
    let again = ["--other", "first", "--history", "--backlog", "120", "--port", &port.to_string()];
    let _server = Server::start(&again).await;
    let wish = wish(false);
    for known in [&pinned, &restarted] {
        let refused = history(&by_number, &wish, known, &mut Taker::default()).await;
        let refused = refused.expect_err("it is another node").to_string();
        assert!(refused.starts_with("tag 0: ns=2 was the namespace 'urn:peer:plant'"), "{refused}");
        assert!(refused.contains("is now 'urn:peer:other'"), "{refused}");
        let mut taker = Taker::default();
        let by_uri = plan(&config, &[COUNTER_BY_URI.to_string()]);
        history(&by_uri, &wish, known, &mut taker).await.expect("it is read");
        complete(&taker.samples(0, &wish), &wish, 1);
        // Nor does a collector that takes the place of the first read it.
        let mut watch = Watch::start_pinning(by_number.clone(), known);
        let refused = Quality::Bad(BadReason::DeviceException);
        watch.until("an error", 0, |all| all.last().is_some_and(|s| s.quality == refused)).await;
        assert!(watch.samples(0).iter().all(|sample| sample.value.is_nan()));
        watch.stop().await;
    }
}

#[tokio::test]
async fn a_namespace_that_is_not_there_is_named_with_those_that_are() {
    let server = Server::start(&[]).await;
    let config = config(server.port, "sampling_ms = 50\npublishing_ms = 50");
    let mut watch = Watch::start(plan(&config, &["node = 'nsu=urn:peer:plnt;s=Steady1'".into()]));
    let line = watch.until_said("urn:peer:plnt").await;
    assert!(line.contains("WARN") && line.contains("'urn:peer:plant'"), "{line}");
    watch.stop().await;
}

#[tokio::test]
async fn elements_and_texts_are_read_and_what_is_no_number_is_said_in_one_line() {
    let server = Server::start(&[]).await;
    let named = |name: &str, more: &str| format!("node = 'nsu=urn:peer:plant;s={name}'\n{more}");
    let tags = [
        (named("Array", "element = 2"), Ok(12.0)),
        (named("Text", ""), Ok(12.5)),
        (named("Doubtful", "decimal = ','"), Ok(1.002)),
        (named("Array", ""), Err("element = 0 to 2")),
        (named("Array", "element = 3"), Err("element = 3")),
        (named("Steady1", "element = 0"), Err("leave element out")),
        (named("Doubtful", ""), Err("decimal =")),
        (named("When", ""), Err("DateTime")),
    ];
    for mode in ["subscribe", "poll"] {
        let config = config(server.port, &format!("mode = '{mode}'\nsampling_ms = 20\npublishing_ms = 20"));
        let texts: Vec<String> = tags.iter().map(|(text, _)| text.clone()).collect();
        let mut watch = Watch::start(plan(&config, &texts));
        for (at, (text, expected)) in tags.iter().enumerate() {
            let samples = watch.until("a sample", at, |all| !all.is_empty()).await;
            match expected {
                Ok(value) => {
                    assert_eq!((samples[0].value, samples[0].quality), (*value, Quality::Good), "{text}")
                }
                Err(_) => assert_eq!(samples[0].quality, Quality::Bad(BadReason::NotANumber), "{text}"),
            }
        }
        // Many more rounds, in which a line each would show.
        let rounds = watch.health.snapshot().polls + 10;
        watch.until_health("rounds", |health| health.polls > rounds).await;
        for (at, (_, expected)) in tags.iter().enumerate() {
            let tag = format!("\"tag {at}\"");
            let is_of = |line: &&String| line.contains(&tag) || line.contains(&format!("tag=tag {at}"));
            let lines: Vec<String> = watch.warnings().iter().filter(is_of).cloned().collect();
            match expected {
                Ok(_) => assert!(lines.is_empty(), "{lines:?}"),
                Err(why) => assert!(lines.len() == 1 && lines[0].contains(why), "{why}: {lines:?}"),
            }
        }
        watch.stop().await;
    }
}
