//! What devices send beside plain numbers, and a second client of one name.

use super::rig::{Broker, Log, Watch};
use std::process::Stdio;
use stictiond::signal::Quality;
use tokio::process::Command;

#[tokio::test]
async fn values_are_read_as_devices_write_them_and_the_rest_is_named() {
    let (log, _guard) = Log::start();
    let broker = Broker::start("devices").await;
    let tags = ["topic = 'a'", "topic = 'b'\ndecimal = ','", "topic = 'c'\npath = 'v'\ntime_path = 't'"];
    let mut watch = Watch::start(broker.port, "", &tags);
    watch.until("connected", |health| health.connected).await;
    broker.publish("a", "0", &["-r"]).await;
    watch.next().await;
    let file = broker.folder.join("payload");
    let all: [(&[u8], f64); 8] = [
        (b"12,5", 12.5),
        ("50.1 °C".as_bytes(), 50.1),
        (b"51.1 \xb0C", 51.1),
        (b"+52.1", 52.1),
        (b"53.1\0", 53.1),
        (b"\xef\xbb\xbf54.1\r\n", 54.1),
        (b"ON", 1.0),
        (b"OFF", 0.0),
    ];
    for (payload, value) in all {
        std::fs::write(&file, payload).unwrap();
        let port = broker.port.to_string();
        let sent = Command::new("mosquitto_pub")
            .args(["-h", "127.0.0.1", "-p", &port, "-q", "1", "-t", "a", "-f"])
            .arg(&file)
            .status();
        assert!(sent.await.unwrap().success());
        let (tag, sample) = watch.next().await;
        assert_eq!((tag, sample.value, sample.quality), (0, value, Quality::Good), "{payload:?}");
    }
    broker.publish("a", "1,002", &[]).await;
    let line = log.until("'1,002'").await;
    assert!(line.contains("WARN") && line.contains("decimal"), "{line}");
    broker.publish("b", "1,002", &[]).await;
    assert_eq!(watch.next().await.1.value, 1.002);
    broker.publish("c", r#"{"v":1,"t":1700000000}"#, &[]).await;
    let line = log.until("1970").await;
    assert!(line.contains("time_unit \"s\"?"), "{line}");
    assert!(watch.is_empty(), "what is refused is no sample");
    watch.stop().await;
}

#[tokio::test]
async fn a_client_that_takes_ours_over_is_named_in_the_log() {
    let (log, _guard) = Log::start();
    let broker = Broker::start("takeover").await;
    let watch = Watch::start(broker.port, "client_id = 'twice'", &["topic = 'a'"]);
    watch.until("connected", |health| health.connected).await;
    // Comes back a second after it was thrown out, as ours does.
    let port = broker.port.to_string();
    let _other = Command::new("mosquitto_sub")
        .args(["-h", "127.0.0.1", "-p", &port, "-i", "twice", "-t", "a"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    let line = log.until("another client").await;
    assert!(line.contains("WARN") && line.contains("client_id = \"twice\""), "{line}");
    watch.stop().await;
}

#[tokio::test]
async fn two_sections_without_an_id_are_two_clients_and_lose_nothing() {
    let broker = Broker::start("distinct").await;
    let mut first = Watch::start(broker.port, "", &["topic = 'a'"]);
    let mut second = Watch::named("c", broker.port, "", &["topic = 'a'"]);
    for watch in [&first, &second] {
        watch.until("connected", |health| health.connected).await;
    }
    broker.publish("a", "0", &["-r"]).await;
    for watch in [&mut first, &mut second] {
        watch.next().await;
    }
    for value in 1..=20 {
        broker.publish("a", &value.to_string(), &[]).await;
        for watch in [&mut first, &mut second] {
            assert_eq!(watch.next().await.1.value, f64::from(value));
        }
    }
    assert_eq!([&first, &second].map(|watch| watch.health.snapshot().link_errors), [0, 0]);
    first.stop().await;
    second.stop().await;
}

#[tokio::test]
async fn probe_shows_topics_and_paths_as_a_loop_ready_to_paste() {
    let broker = Broker::start("probe").await;
    broker
        .publish("plant/FIC101", r#"{"values":{"op":41.5,"pv":50.5},"ts":1700000000000,"q":"good"}"#, &["-r"])
        .await;
    broker.publish("plant/TI7", "12.5", &["-r"]).await;
    broker.publish("other/a", "1", &["-r"]).await;
    let output = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args([
            "probe",
            &format!("mqtt://127.0.0.1:{}", broker.port),
            "--filter",
            "plant/#",
            "--seconds",
            "2",
        ])
        .output()
        .await
        .unwrap();
    let (found, error) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{error}");
    for part in [
        "# plant/FIC101 (1 messages): {\"values\"",
        "#   values.op = 41.5\n",
        "#   ts = 1700000000000, a time with time_unit = \"ms\"",
        "#   q = good, no number",
        "[loop.pv]\n# 50.5\ndevice = \"broker\"\ntopic = \"plant/FIC101\"\npath = \"values.pv\"\ntime_path = \"ts\"\n",
    ] {
        assert!(found.contains(part), "{part}: {found}");
    }
    assert!(!found.contains("other/a"), "{found}");
    let device = format!("[[mqtt]]\nname = 'broker'\naddress = '127.0.0.1:{}'\n", broker.port);
    let parsed = stictiond::config::parse("f", &format!("{device}{found}"));
    assert!(parsed.is_ok(), "{:?}", parsed.err());
}
