//! The only reader of a stream gets its messages in their order, whatever became of the one before it.

use crate::nats::Nats;
use crate::rig::connected;
use std::path::Path;
use std::time::{Duration, Instant};
use stictiond::fleet::link::{Link, Outgoing, Reading};
use stictiond::fleet::streams::DIAGNOSES;
use stictiond::fleet::subject::{Subject, What};

const PATIENCE: Duration = Duration::from_secs(60);

async fn send(link: &Link, numbers: std::ops::Range<u32>) {
    let subject = Subject::new("north", "FIC1", What::Diagnosis).to_string();
    let messages: Vec<Outgoing> =
        numbers.map(|n| Outgoing::once(subject.clone(), n.to_le_bytes().to_vec())).collect();
    link.send(&messages).await.map_err(|(_, error)| error).expect("it is kept");
}

/// The numbers of the next `count` messages, each of them done or not.
async fn take(reading: &mut Reading, count: usize, done: impl Fn(u32) -> bool) -> Vec<u32> {
    let (mut numbers, begun) = (Vec::new(), Instant::now());
    while numbers.len() < count {
        assert!(begun.elapsed() < PATIENCE, "{numbers:?}");
        let most = (count - numbers.len()).min(7);
        for message in reading.next(most, Duration::from_secs(1)).await.expect("the server is there") {
            let number = u32::from_le_bytes(message.body().try_into().expect("four bytes"));
            if done(number) {
                message.done().await.expect("the server is there");
            }
            numbers.push(number);
        }
    }
    numbers
}

#[tokio::test]
async fn what_was_given_and_not_done_comes_first_and_in_order() {
    // Each waits until messages are given again.
    tokio::join!(what_a_reader_leaves(), what_another_takes_away());
}

async fn what_a_reader_leaves() {
    let hub = Nats::hub();
    let link = connected(&hub, "").await;
    send(&link, 0..40).await;
    let mut first = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    // Some are done and others not, as where a centre is killed.
    let some = take(&mut first, 30, |number| number < 5 || number % 3 == 0).await;
    assert_eq!(some, (0..30).collect::<Vec<_>>());
    drop(first);
    send(&link, 40..50).await;
    let mut second = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    let left = (5..30).filter(|number| number % 3 != 0).chain(30..50).collect::<Vec<_>>();
    assert_eq!(take(&mut second, left.len(), |_| true).await, left);
}

/// A message that another took away is missed, and what comes after it is not taken before it.
async fn what_another_takes_away() {
    let hub = Nats::hub();
    let link = connected(&hub, "").await;
    send(&link, 0..50).await;
    let mut first = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_eq!(take(&mut first, 50, |_| true).await, (0..50).collect::<Vec<_>>());
    send(&link, 50..51).await;
    let mut thief =
        link.share(DIAGNOSES, "centre_c1", "", (PATIENCE, -1)).await.expect("the server is there");
    assert_eq!(take(&mut thief, 1, |_| false).await, [50]);
    send(&link, 51..53).await;
    let missed = first.next(9, Duration::from_secs(1)).await.map(|messages| messages.len());
    assert!(missed.is_err_and(|error| error.to_string().contains("lost on its way")));
    let mut second = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_eq!(take(&mut second, 3, |_| true).await, [50, 51, 52]);
}

/// A server that is started begins to count from then, and gives what is new before what it had given: of what was given ten
/// messages and then new ones, unless the reader waits for the rest.
#[tokio::test]
async fn what_was_given_comes_before_what_is_new_also_from_a_server_that_was_killed_meanwhile() {
    let mut hub = Nats::hub();
    let link = connected(&hub, "").await;
    send(&link, 0..30).await;
    let mut first = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    take(&mut first, 30, |number| number < 10).await;
    drop(first);
    let again = async {
        // Just before the reader asks, 11 s after it began.
        tokio::time::sleep(Duration::from_millis(10_500)).await;
        hub.end();
        hub.begin();
        let own = connected(&hub, "").await;
        send(&own, 30..40).await;
    };
    let read = async {
        let begun = Instant::now();
        loop {
            match link.read(DIAGNOSES, "centre_c1", "").await {
                Ok(reading) => break reading,
                Err(error) => assert!(begun.elapsed() < PATIENCE, "{error}"),
            }
        }
    };
    let (mut second, ()) = tokio::join!(read, again);
    assert!(!second.has_caught_up(), "what was given before is still to be taken");
    assert_eq!(take(&mut second, 30, |_| true).await, (10..40).collect::<Vec<_>>());
}

/// As where the hub has lost its disk: the stream counts from 1 again, and who reads it learns of that.
#[tokio::test]
async fn a_stream_that_is_made_anew_is_another_to_who_reads_it() {
    let hub = Nats::hub();
    let link = connected(&hub, "").await;
    send(&link, 0..3).await;
    let mut first = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_eq!(take(&mut first, 3, |_| true).await, [0, 1, 2]);
    let made = (link.made(DIAGNOSES).await.expect("it is there"), first.made());
    let again = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_eq!((link.made(DIAGNOSES).await.expect("it is there"), again.made()), made);

    let client = async_nats::connect(hub.url()).await.expect("the server is there");
    async_nats::jetstream::new(client).delete_stream(DIAGNOSES).await.expect("it is there");
    let link = connected(&hub, "").await;
    send(&link, 3..5).await;
    // What was read before ends, and does not wait for ever.
    let begun = Instant::now();
    while first.next(1, Duration::from_secs(1)).await.is_ok() {
        assert!(begun.elapsed() < PATIENCE, "it is not noticed");
    }
    let mut second = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_ne!(link.made(DIAGNOSES).await.expect("it is there"), made.0);
    assert_ne!(second.made(), made.1);
    let messages = second.next(2, Duration::from_secs(1)).await.expect("the server is there");
    assert_eq!(messages.first().map(|message| message.sequence()), Some(1));
}

/// The files of a folder, in another.
fn copy(from: &Path, to: &Path) {
    let _ = std::fs::remove_dir_all(to);
    std::fs::create_dir_all(to).expect("writable");
    for file in std::fs::read_dir(from).expect("readable") {
        let file = file.expect("readable");
        std::fs::copy(file.path(), to.join(file.file_name())).expect("writable");
    }
}

/// As where the power of the hub fails: it has acknowledged messages that are not on its disk, while the place of their reader is.
/// It uses their numbers again, for fewer messages than it has lost or for more.
#[tokio::test]
async fn what_takes_the_numbers_of_messages_that_a_server_has_lost_is_given_all_the_same() {
    tokio::join!(what_comes_after_a_loss(11), what_comes_after_a_loss(20));
}

/// Six messages are lost, and those from 9 on take their place.
async fn what_comes_after_a_loss(end: u32) {
    let mut hub = Nats::hub();
    let link = connected(&hub, "").await;
    send(&link, 0..3).await;
    let mut first = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_eq!(take(&mut first, 3, |_| true).await, [0, 1, 2]);
    hub.stop();
    let messages = hub.folder().join("js/jetstream/$G/streams").join(DIAGNOSES).join("msgs");
    let on_disk = hub.folder().join("on-disk");
    copy(&messages, &on_disk);
    hub.begin();

    let link = connected(&hub, "").await;
    send(&link, 3..9).await;
    let mut second = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_eq!(take(&mut second, 6, |_| true).await, (3..9).collect::<Vec<_>>());
    let body = async |link: &Link, sequence: u64| {
        let there = link.at(DIAGNOSES, sequence).await.expect("the server is there");
        there.map(|(_, body)| body)
    };
    assert_eq!(body(&link, 4).await, Some(3u32.to_le_bytes().to_vec()));
    hub.stop();
    copy(&on_disk, &messages);
    hub.begin();

    // This is how an edge notices it.
    let link = connected(&hub, "").await;
    assert_eq!(link.state(DIAGNOSES).await.expect("the server is there").last, 3);
    assert_eq!(body(&link, 4).await, None);
    send(&link, 9..end).await;
    assert_eq!(body(&link, 4).await, Some(9u32.to_le_bytes().to_vec()));
    // And so it is for who reads: what is left may come again, before what is new.
    let mut third = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    let (mut came, begun) = (Vec::new(), Instant::now());
    while came.last() != Some(&(end - 1)) {
        assert!(begun.elapsed() < PATIENCE, "{came:?}");
        came.extend(take(&mut third, 1, |_| true).await);
    }
    let new: Vec<u32> = (9..end).collect();
    assert!(came.ends_with(&new) && came.is_sorted(), "{came:?}");

    // A server that has lost nothing gives nothing twice.
    drop(third);
    hub.stop();
    hub.begin();
    let link = connected(&hub, "").await;
    send(&link, end..end + 1).await;
    let mut fourth = link.read(DIAGNOSES, "centre_c1", "").await.expect("the server is there");
    assert_eq!(take(&mut fourth, 1, |_| true).await, [end]);
}
