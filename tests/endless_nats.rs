//! Debian's nats-server through the relay that bounds what a server may say: large messages come all the same, in their order,
//! certificates are checked on both sides, and no message takes much more memory than its bytes.

#[path = "peers/daemon.rs"]
mod daemon;
#[path = "peers/nats.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod nats;
#[path = "endless_nats/parts.rs"]
mod parts;

use nats::Nats;
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};
use stictiond::fleet::config::Config;
use stictiond::fleet::link::{Link, LinkError, Outgoing, Reading};
use stictiond::fleet::ops::MOST_MESSAGE;
use stictiond::fleet::streams::{DIAGNOSES, LATEST};
use stictiond::fleet::subject::{Subject, What, all};

/// Far longer than anything takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);
/// Bytes after which a reader asks for no more before it has been given those.
const HELD: usize = 8 << 20;

fn hub(name: &str, more: impl FnOnce(&Path) -> String) -> Nats {
    Nats::with(name, |folder, [clients, _]| {
        format!(
            "server_name: hub\nlisten: 127.0.0.1:{clients}\n{}{}",
            nats::jetstream(folder, nats::ROOM),
            more(folder)
        )
    })
}

fn config(text: &str) -> Config {
    toml::from_str(text).expect("readable")
}

async fn connected(config: &Config) -> Link {
    let link = Link::connect(config, "large").await.expect("begins");
    let begun = Instant::now();
    while let Err(error) = link.make_streams(config).await {
        assert!(begun.elapsed() < PATIENCE, "{error}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    link
}

/// A message about a loop or a machine called `name`, whose bytes are all `n`.
fn message(name: &str, what: What, n: u8, bytes: usize) -> Outgoing {
    Outgoing::once(Subject::new("north", name, what).to_string(), vec![n; bytes])
}

/// What comes of so many messages, by their first byte and their length. No more are held at once than a bound and one of them.
async fn come(reading: &mut Reading, count: usize) -> Vec<(u8, usize)> {
    let (mut came, begun) = (Vec::new(), Instant::now());
    while came.len() < count {
        assert!(begun.elapsed() < PATIENCE, "{} came", came.len());
        let some = reading.next(256, Duration::from_secs(1)).await.expect("the connection stands");
        let bytes: Vec<usize> = some.iter().map(|message| message.body().len()).collect();
        assert!(bytes.iter().sum::<usize>() < HELD + 32 * (1 << 19), "{bytes:?}");
        for message in some {
            message.done().await.expect("the server is there");
            came.push((message.body()[0], message.body().len()));
        }
    }
    came
}

#[tokio::test]
async fn messages_come_in_their_order_however_large_and_many_they_are() {
    let hub = hub("large", |_| "max_payload: 16MB\n".into());
    let link = connected(&config(&format!("servers = ['{}']", hub.url()))).await;
    // What no reader would take is not sent, whatever the server takes.
    assert_eq!(link.max_bytes(), MOST_MESSAGE as usize);
    let refused = link.send(&[message("FIC1", What::Diagnosis, 9, 8 << 20)]).await;
    assert!(matches!(refused, Err((0, LinkError::TooLarge(_)))), "{refused:?}");

    // More than a server may say for one request.
    let sizes: Vec<(u8, usize)> = (0..60).map(|n| (n, 1 << 19)).collect();
    let messages: Vec<Outgoing> =
        sizes.iter().map(|(n, bytes)| message("FIC1", What::Diagnosis, *n, *bytes)).collect();
    link.send(&messages).await.map_err(|(_, error)| error).expect("they are kept");
    let mut reading = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_eq!(come(&mut reading, sizes.len()).await, sizes);

    // What machines say of themselves is shorter, and there may be many of them.
    let refused = link.send(&[message("edge-0", What::Pulse, 9, 1 << 20)]).await;
    assert!(matches!(refused, Err((0, LinkError::Away(_)))), "{refused:?}");
    let sizes: Vec<(u8, usize)> = (0..60).map(|n| (n, 500_000)).collect();
    let messages: Vec<Outgoing> =
        sizes.iter().map(|(n, bytes)| message(&format!("edge-{n}"), What::Pulse, *n, *bytes)).collect();
    link.send(&messages).await.map_err(|(_, error)| error).expect("they are kept");
    let nothing = link.follow(LATEST, &all(None, What::Cursor)).await.expect("the server is there");
    assert!(nothing.has_caught_up());
    let mut following = link.follow(LATEST, &all(None, What::Pulse)).await.expect("the server is there");
    let mut came = Vec::new();
    let begun = Instant::now();
    while came.len() < sizes.len() {
        assert!(begun.elapsed() < PATIENCE, "{} came", came.len());
        let some = following.next(256, Duration::from_secs(1)).await.expect("the connection stands");
        let bytes: usize = some.iter().map(|message| message.body().len()).sum();
        assert!(bytes < HELD + (1 << 19), "{bytes} bytes are held at once");
        came.extend(some.iter().map(|message| (message.body()[0], message.body().len())));
        assert_eq!(following.has_caught_up(), came.len() == sizes.len(), "{} came", came.len());
    }
    assert_eq!(came, sizes);
}

/// A reader was given more than is held at once, and did not do it. It comes again in order, and no more is held at once.
#[tokio::test]
async fn what_is_given_again_comes_in_its_order_and_in_portions() {
    let hub = hub("again", |_| "max_payload: 16MB\n".into());
    let link = connected(&config(&format!("servers = ['{}']", hub.url()))).await;
    let messages: Vec<Outgoing> = (0..30).map(|n| message("FIC1", What::Diagnosis, n, 1 << 19)).collect();
    link.send(&messages).await.map_err(|(_, error)| error).expect("they are kept");
    let mut first = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    let (mut given, begun) = (0, Instant::now());
    while given < messages.len() {
        assert!(begun.elapsed() < PATIENCE, "{given} came");
        given += first.next(256, Duration::from_secs(1)).await.expect("the connection stands").len();
    }
    drop(first);

    let mut second = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    let (mut came, mut portions, begun) = (Vec::new(), 0, Instant::now());
    while came.len() < messages.len() {
        assert!(begun.elapsed() < PATIENCE, "{came:?} came");
        // A server whose disk is busy says nothing for seconds: then the reading is over, and the next one has the rest.
        let Ok(some) = second.next(256, Duration::from_secs(1)).await else {
            second = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
            continue;
        };
        let bytes: usize = some.iter().map(|message| message.body().len()).sum();
        assert!(bytes <= HELD, "{bytes} bytes are held at once");
        portions += usize::from(!some.is_empty());
        for message in some {
            message.done().await.expect("the server is there");
            came.push(message.body()[0]);
        }
    }
    assert_eq!(came, (0..30).collect::<Vec<u8>>());
    assert!(portions >= 2, "all of it was held at once");
}

/// An authority, and what it signed for a server on this machine and for us, as files.
fn certificates(folder: &Path) {
    let file = |name: &str, text: String| fs::write(folder.join(name), text).expect("writable");
    let mut ca = CertificateParams::new(Vec::new()).expect("no names");
    ca.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let key = KeyPair::generate().expect("a key");
    file("ca.pem", ca.self_signed(&key).expect("signs").pem());
    let issuer = Issuer::new(ca, key);
    for (who, name) in [("server", "127.0.0.1"), ("client", "stictiond")] {
        let key = KeyPair::generate().expect("a key");
        let own = CertificateParams::new(vec![name.to_string()]).expect("a name");
        file(&format!("{who}.pem"), own.signed_by(&key, &issuer).expect("signs").pem());
        file(&format!("{who}.key"), key.serialize_pem());
    }
}

#[tokio::test]
async fn encrypted_to_a_server_that_asks_for_a_certificate_of_ours() {
    let hub = hub("encrypted", |folder| {
        certificates(folder);
        let [ca, certificate, key] = ["ca.pem", "server.pem", "server.key"].map(|name| folder.join(name));
        format!("tls {{ cert_file: {certificate:?}, key_file: {key:?}, ca_file: {ca:?}, verify: true }}\n")
    });
    let [ca, certificate, key] = ["ca.pem", "client.pem", "client.key"].map(|name| hub.folder().join(name));
    // Asked for by us, and by the server alone.
    for url in [hub.url().replace("nats:", "tls:"), hub.url()] {
        let trusting = format!("servers = ['{url}']\nca_file = {ca:?}\n");
        let known = config(&format!("{trusting}certificate_file = {certificate:?}\nkey_file = {key:?}\n"));
        let link = connected(&known).await;
        assert!(link.is_up());
        // Who shows none is not let in.
        let unknown = Link::connect(&config(&trusting), "unknown").await.expect("begins");
        let (log, begun) = (hub.folder().join("log"), Instant::now());
        while !fs::read_to_string(&log).expect("there is one").contains("didn't provide a certificate") {
            assert!(begun.elapsed() < PATIENCE, "nobody came without a certificate");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert!(!unknown.is_up());
    }
}
