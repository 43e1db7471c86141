//! MQTT against mosquitto, with clients and an encoder of Sparkplug B that were not written here.

#[cfg(test)]
mod devices;
#[cfg(test)]
#[path = "../peers/piped.rs"]
mod piped;
#[cfg(test)]
mod publishing;
#[cfg(test)]
mod rig;
#[cfg(test)]
mod tls;

use rig::{Broker, Peer, Watch};
use stictiond::signal::{BadReason, Quality, Sample};

const DOWN: Quality = Quality::Bad(BadReason::LinkDown);

#[tokio::test]
async fn json_and_plain_numbers_keep_their_time_and_what_cannot_be_read_is_counted() {
    let broker = Broker::start("json").await;
    broker.publish("plant/sp", "40", &["-r"]).await;
    let tags = [
        "topic = 'plant/fic101'\npath = 'values.op'\ntime_path = 'ts'\nquality_path = 'q'",
        "topic = 'plant/fic101'\npath = 'values.pv'\ntime_path = 'ts'\nscale = 0.1",
        "topic = 'plant/sp'",
    ];
    let mut watch = Watch::start(broker.port, "max_payload_bytes = 400", &tags);
    let (tag, kept) = watch.next().await;
    assert_eq!((tag, kept.value, kept.quality), (2, 40.0, Quality::Stale), "nobody knows how old it is");

    broker
        .publish("plant/fic101", r#"{"values":{"op":41.5,"pv":200},"ts":1700000000250,"q":"GOOD"}"#, &[])
        .await;
    assert_eq!(watch.next().await, (0, Sample::good(1_700_000_000.25, 41.5)));
    assert_eq!(watch.next().await, (1, Sample::good(1_700_000_000.25, 20.0)));
    let late = r#"{"values":{"op":1,"pv":1},"ts":"2023-11-14T22:13:10Z","q":"good"}"#;
    broker.publish("plant/fic101", late, &[]).await;
    watch.until("late", |health| health.discarded_samples == 2).await;

    let refused = |count| move |health: &stictiond::collect::HealthSnapshot| health.refused_payloads == count;
    let long = "9".repeat(401);
    // Each with what is refused of it: a payload that is none once, else each tag by itself.
    let mut count = 0;
    for (topic, payload, refusals) in [
        ("plant/fic101", "{", 1),
        ("plant/fic101", "\u{1F600}", 1),
        ("plant/fic101", r#"{"values":{"op":"x","pv":[]},"ts":1700000001000,"q":"good"}"#, 2),
        ("plant/fic101", r#"{"values":{"op":1,"pv":1},"ts":"14.11.2023 23:13","q":"good"}"#, 2),
        ("plant/sp", r#"{"value":1}"#, 1),
        ("plant/sp", "", 1),
        ("plant/sp", "nan", 1),
        ("plant/sp", &long, 1),
    ] {
        broker.publish(topic, payload, &[]).await;
        count += refusals;
        watch.until(payload, refused(count)).await;
    }
    assert!(watch.is_empty(), "a sample out of nothing");
    broker
        .publish("plant/fic101", r#"{"values":{"op":42,"pv":210},"ts":1700000002000,"q":"bad"}"#, &[])
        .await;
    let (tag, bad) = watch.next().await;
    assert_eq!((tag, bad.t, bad.quality), (0, 1_700_000_002.0, Quality::Bad(BadReason::DeviceException)));
    assert!(bad.value.is_nan());
    assert_eq!(watch.next().await, (1, Sample::good(1_700_000_002.0, 21.0)));
    watch.stop().await;
}

#[tokio::test]
async fn a_broker_that_goes_and_comes_leaves_a_mark_and_no_invented_value() {
    let mut broker = Broker::start("restart").await;
    let mut watch = Watch::start(broker.port, "", &["topic = 'a'", "topic = 'b'"]);
    watch.until("connected", |health| health.connected).await;
    // A subscription may take a moment longer than the connection: retained, it comes in any case.
    broker.publish("a", "1", &["-r"]).await;
    assert_eq!(watch.next().await.1.value, 1.0);
    broker.kill().await;
    for tag in [0, 1] {
        let (lost, sample) = watch.next().await;
        assert_eq!((lost, sample.quality, sample.value.is_nan()), (tag, DOWN, true));
    }
    watch.until("several attempts", |health| health.link_errors >= 3).await;
    assert!(watch.is_empty(), "one mark an outage");
    let broker = Broker::with("restart", broker.port, "allow_anonymous true").await;
    broker.publish("b", "2", &["-r"]).await;
    let (tag, sample) = watch.next().await;
    assert_eq!((tag, sample.value), (1, 2.0));
    assert!(watch.health.snapshot().reconnects >= 1);
    watch.stop().await;
}

#[tokio::test]
async fn a_value_that_did_not_change_while_the_broker_was_away_is_good_again() {
    let mut broker = Broker::start("unchanged").await;
    let topic = ["topic = 'sp'\npath = 'v'\ntime_path = 't'"];
    let mut watch = Watch::start(broker.port, "", &topic);
    watch.until("connected", |health| health.connected).await;
    let kept = r#"{"v":50,"t":1700000000000}"#;
    broker.publish("sp", kept, &["-r"]).await;
    assert_eq!(watch.next().await.1, Sample::good(1_700_000_000.0, 50.0));
    broker.kill().await;
    let mark = watch.next().await.1;
    assert_eq!(mark.quality, DOWN);
    let broker = Broker::with("unchanged", broker.port, "allow_anonymous true").await;
    broker.publish("sp", kept, &["-r"]).await;
    let back = watch.next().await.1;
    assert!(back.quality.is_good() && back.value == 50.0 && back.t > mark.t, "{back:?} after {mark:?}");
    watch.stop().await;
}

#[tokio::test]
async fn more_topics_than_requests_wait_at_a_time_are_subscribed() {
    let broker = Broker::start("many").await;
    let topics: Vec<String> = (0..6600).map(|at| format!("topic = 'plant/tag{at}'")).collect();
    let topics: Vec<&str> = topics.iter().map(String::as_str).collect();
    let mut watch = Watch::start(broker.port, "", &topics);
    for at in [0, 6599] {
        broker.publish(&format!("plant/tag{at}"), "3", &["-r"]).await;
        assert_eq!((watch.next().await.0, watch.health.snapshot().link_errors), (at, 0));
    }
    watch.stop().await;
}

#[tokio::test]
async fn a_wrong_password_is_refused_and_the_right_one_is_read_anew() {
    let port = rig::free_port().await;
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tmp/mqtt/password");
    std::fs::create_dir_all(&folder).unwrap();
    let users = folder.join("users");
    let made = std::process::Command::new("mosquitto_passwd")
        .args(["-c".as_ref(), "-b".as_ref(), users.as_os_str(), "plant".as_ref(), "right".as_ref()])
        .status();
    assert!(made.unwrap().success());
    let more = format!("allow_anonymous false\npassword_file {}\nuser root", users.display());
    let broker = Broker::with("password", port, &more).await;
    let secret = broker.folder.join("secret");
    std::fs::write(&secret, "wrong\n").unwrap();
    let config = format!("user = 'plant'\npassword_file = '{}'", secret.display());
    let mut watch = Watch::start(port, &config, &["topic = 'a'"]);
    watch.until("refused", |health| health.security_errors >= 2).await;
    assert_eq!(watch.health.snapshot().good_samples, 0);
    std::fs::write(&secret, "right\n").unwrap();
    watch.until("connected", |health| health.connected).await;
    broker.publish("a", "7", &["-r", "-u", "plant", "-P", "right"]).await;
    loop {
        let (_, sample) = watch.next().await;
        if sample.quality != DOWN {
            assert_eq!(sample.value, 7.0);
            break;
        }
    }
    watch.stop().await;
}

#[tokio::test]
async fn a_connection_without_readable_messages_is_made_again_and_a_silent_tag_is_bad() {
    let broker = Broker::start("silent").await;
    let mut watch = Watch::start(broker.port, "silent_s = 1.5\nstale_after_s = 0.4", &["topic = 'a'"]);
    watch.until("connected", |health| health.connected).await;
    broker.publish("a", "1", &["-r"]).await;
    assert_eq!(watch.next().await.1.value, 1.0);
    let (_, sample) = watch.next().await;
    assert_eq!(sample.quality, Quality::Bad(BadReason::Timeout));
    watch.until("given up", |health| health.timeouts == 1).await;
    watch.until("made again", |health| health.reconnects >= 1).await;
    watch.stop().await;
}

#[tokio::test]
async fn sparkplug_births_data_gaps_and_deaths_of_an_encoder_that_is_not_ours() {
    let broker = Broker::start("sparkplug").await;
    let mut edge = Peer::start(&broker, "edge").await;
    edge.tell("connect 5").await;
    edge.tell("births 40.5").await;
    let tags = ["sparkplug = 'g/e/d'\nmetric = 'op'", "sparkplug = 'g/e/d'\nmetric = 'level'"];
    let mut watch = Watch::start(broker.port, "", &tags);
    // It came after the births, which nobody keeps.
    edge.said("rebirth").await;
    edge.tell("births 41.5").await;
    let next = async |watch: &mut Watch| {
        let (tag, sample) = watch.next().await;
        (tag, sample.value, sample.quality)
    };
    assert_eq!(next(&mut watch).await, (0, 41.5, Quality::Good));
    assert_eq!(next(&mut watch).await, (1, -7.0, Quality::Good));
    edge.tell("data 42.5").await;
    assert_eq!(next(&mut watch).await, (0, 42.5, Quality::Good));

    edge.tell("skip").await;
    edge.tell("data 43.5").await;
    watch.until("a gap", |health| health.sequence_gaps == 1).await;
    edge.tell("births 44.5").await;
    assert_eq!(next(&mut watch).await, (0, 44.5, Quality::Good), "an alias means nothing after a gap");
    assert_eq!(next(&mut watch).await.0, 1);

    edge.tell("gone").await;
    for tag in [0, 1] {
        let (lost, value, quality) = next(&mut watch).await;
        assert_eq!((lost, value.is_nan(), quality), (tag, true, DOWN));
    }
    edge.tell("births 45.5").await;
    assert_eq!(next(&mut watch).await, (0, 45.5, Quality::Good));
    assert_eq!(next(&mut watch).await.0, 1);
    edge.tell("cut").await;
    for tag in [0, 1] {
        assert_eq!((next(&mut watch).await.0, watch.health.snapshot().connected), (tag, true));
    }
    // Bytes that are no message.
    let before = watch.health.snapshot().refused_payloads;
    broker.publish("spBv1.0/g/NBIRTH/e", "no protobuf", &[]).await;
    watch.until("refused", |health| health.refused_payloads == before + 1).await;
    assert!(watch.is_empty());
    watch.stop().await;
}
