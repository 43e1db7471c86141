//! What a stream does that is full: the oldest samples go, and of what was found nothing.

use crate::nats::{Nats, jetstream as streams_in};
use crate::rig::{PATIENCE, connected};
use async_nats::jetstream::{self, stream};
use std::time::{Duration, Instant};
use stictiond::fleet::config::Config;
use stictiond::fleet::link::{Incoming, Link, LinkError, Outgoing, Reading};
use stictiond::fleet::streams::{ALARMS, DIAGNOSES, LATEST, SAMPLES};
use stictiond::fleet::subject::{Subject, What, all};

/// Messages of 100 kB each, which are more than the streams of this test have room for.
const MESSAGES: u64 = 15;
const BYTES: usize = 100_000;
/// What the streams may take.
const ROOM: &str = "samples_mb = 1\ndiagnoses_mb = 1\nalarms_mb = 1";

fn message(what: What, number: u64) -> Outgoing {
    let mut body = vec![0; BYTES];
    body[..8].copy_from_slice(&number.to_le_bytes());
    Outgoing::once(Subject::new("north", "FIC1", what).to_string(), body)
}

async fn state(hub: &Nats, stream: &str) -> stream::State {
    let client = async_nats::connect(hub.url()).await.expect("the server is there");
    let stream = jetstream::new(client).get_stream(stream).await.expect("it is there");
    stream.cached_info().state.clone()
}

/// Sends messages until one is not taken; how many were.
async fn fill(link: &Link, what: What) -> u64 {
    for number in 0..MESSAGES {
        if link.send(&[message(what, number)]).await.is_err() {
            return number;
        }
    }
    MESSAGES
}

/// Says which stream it is, how much it asks for and what to do; an operator sees it in the log of the centre.
#[tokio::test]
async fn a_server_without_the_room_is_told_from_one_that_is_away() {
    let hub = Nats::with("small", |folder, [clients, _]| {
        format!("server_name: hub\nlisten: 127.0.0.1:{clients}\n{}", streams_in(folder, 2))
    });
    let config: Config = toml::from_str(&format!("servers = [{:?}]", hub.url())).expect("readable");
    let link = Link::connect(&config, "test").await.expect("begins");
    let begun = Instant::now();
    let error = loop {
        match link.make_streams(&config).await {
            Err(LinkError::Away(_)) if begun.elapsed() < PATIENCE => {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            other => break other.expect_err("there are 2 GB"),
        }
    };
    assert!(matches!(&error, LinkError::NoRoom { stream, megabytes: 4096 } if stream == SAMPLES), "{error}");
    assert!(error.to_string().contains("max_file_store"), "{error}");
    connected(&hub, "samples_mb = 1\ndiagnoses_mb = 1\nalarms_mb = 1").await;
}

#[tokio::test]
async fn of_samples_the_oldest_go() {
    let hub = Nats::hub();
    let link = connected(&hub, ROOM).await;
    assert_eq!(fill(&link, What::Samples).await, MESSAGES, "each is taken");
    let own = state(&hub, SAMPLES).await;
    assert!(own.first_sequence > 1 && own.bytes <= 1_000_000, "{own:?}");
    assert_eq!((own.last_sequence, own.messages), (MESSAGES, MESSAGES + 1 - own.first_sequence));
}

/// The messages that were kept, as a reader gets them: all of them, in order.
async fn all_of(reading: &mut Reading, kept: u64) -> Vec<Incoming> {
    let count = usize::try_from(kept).expect("few");
    let messages = reading.next(count, Duration::from_secs(30)).await.expect("the server is there");
    let number = |body: &[u8]| u64::from_le_bytes(body[..8].try_into().expect("eight bytes"));
    let numbers: Vec<u64> = messages.iter().map(|own| number(own.body())).collect();
    assert_eq!(numbers, (0..kept).collect::<Vec<u64>>());
    messages
}

async fn done(messages: &[Incoming]) {
    for own in messages {
        own.done().await.expect("the server is there");
    }
}

#[tokio::test]
async fn of_alarms_nothing_goes_and_what_is_new_waits_until_there_is_room() {
    let hub = Nats::hub();
    let link = connected(&hub, ROOM).await;
    let kept = fill(&link, What::Alarm).await;
    assert!((1..MESSAGES).contains(&kept), "{kept} were taken");
    let own = state(&hub, ALARMS).await;
    assert_eq!((own.first_sequence, own.messages), (1, kept));

    // A centre, and whoever tells people.
    let mut centre = link.read(ALARMS, "centre_c1", "").await.expect("the server is there");
    let mut teller = link.read(ALARMS, "centres_tell", &all(None, What::Alarm)).await.expect("it is there");
    let needed = ["centre_c1", "centres_tell"];
    let has_room = async || {
        link.purge_done(ALARMS, &needed).await.expect("the server is there");
        // The very message that was refused.
        link.send(&[message(What::Alarm, kept)]).await.is_ok()
    };
    done(&all_of(&mut centre, kept).await).await;
    assert!(!has_room().await, "people are not told yet");
    let told = all_of(&mut teller, kept).await;
    done(&told[1..]).await;
    assert!(!has_room().await, "the first is under way");
    done(&told[..1]).await;
    assert!(has_room().await);
    let own = state(&hub, ALARMS).await;
    assert_eq!((own.first_sequence, own.messages), (kept + 1, 1));
    // Without a reader that has to be there nothing is deleted.
    done(&centre.next(1, Duration::from_secs(30)).await.expect("the server is there")).await;
    done(&teller.next(1, Duration::from_secs(30)).await.expect("the server is there")).await;
    link.purge_done(ALARMS, &["centre_c2"]).await.expect("the server is there");
    assert_eq!(state(&hub, ALARMS).await.messages, 1);
}

#[tokio::test]
async fn a_centre_that_has_stopped_keeps_no_diagnoses_back_from_the_others() {
    let hub = Nats::hub();
    let link = connected(&hub, ROOM).await;
    let kept = fill(&link, What::Diagnosis).await;
    assert!((1..MESSAGES).contains(&kept), "{kept} were taken");
    // However many diagnoses there are, alarms have room of their own.
    link.send(&[message(What::Alarm, 0)]).await.map_err(|(_, error)| error).expect("there is room");

    let mut living = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    link.read(DIAGNOSES, "centre_c2", "").await.expect("the server is there");
    assert_eq!(link.make_room(DIAGNOSES, "centre_c1").await.expect("it is there"), [""; 0]);
    done(&all_of(&mut living, kept).await).await;
    link.purge_done(DIAGNOSES, &["centre_c1"]).await.expect("the server is there");
    assert!(link.send(&[message(What::Diagnosis, kept)]).await.is_err(), "another has not read them");
    assert_eq!(link.make_room(DIAGNOSES, "centre_c1").await.expect("it is there"), ["centre_c2"]);
    link.send(&[message(What::Diagnosis, kept)]).await.map_err(|(_, error)| error).expect("there is room");
    let own = state(&hub, DIAGNOSES).await;
    assert_eq!((own.first_sequence, own.messages), (kept + 1, 1));
    // Now there is room for a while, and nobody loses anything.
    done(&living.next(1, Duration::from_secs(30)).await.expect("the server is there")).await;
    assert_eq!(link.make_room(DIAGNOSES, "centre_c1").await.expect("it is there"), [""; 0]);
    assert_eq!(state(&hub, DIAGNOSES).await.messages, 1);
}

#[tokio::test]
async fn streams_of_an_earlier_build_take_what_is_sent_now_and_keep_their_room() {
    let hub = Nats::hub();
    let link = connected(&hub, "").await;
    let client = async_nats::connect(hub.url()).await.expect("the server is there");
    let js = jetstream::new(client);
    let config = async || js.get_stream(LATEST).await.expect("it is there").cached_info().config.clone();
    let now = config().await;
    // A hello in one message, of any length, and less room by an operator.
    let subject = |own: &String| own.replace(".hello.*", ".hello");
    let subjects: Vec<String> = now.subjects.iter().map(subject).collect();
    assert_ne!(subjects, now.subjects);
    let room = 7_000_000;
    let old = stream::Config { subjects, max_message_size: -1, max_bytes: room, ..now.clone() };
    js.update_stream(&old).await.expect("the server takes it");
    let part = Outgoing::latest(Subject::new("north", "e1", What::Hello).part(0), vec![0; BYTES]);
    link.send(std::slice::from_ref(&part)).await.expect_err("no stream has this subject");

    // Two centres start at once.
    tokio::join!(connected(&hub, ""), connected(&hub, ""));
    assert_eq!(config().await, stream::Config { max_bytes: room, ..now });
    link.send(std::slice::from_ref(&part)).await.map_err(|(_, error)| error).expect("it is kept");
    let (_, body) = link.last(LATEST, &part.subject).await.expect("the server is there").expect("it is kept");
    assert_eq!(body, part.body);
}
