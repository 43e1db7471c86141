//! Several units behind one gateway: one connection, fair turns, RTU frames, small limits and slow hands.

use super::peers::{Proxy, Server, Watch, checked, device, patient, plan, truth_tag};
use super::{all_bad, all_good};
use std::time::Duration;
use stictiond::signal::BadReason;
use tokio::time::Instant;

#[tokio::test]
async fn units_that_share_one_connection_take_turns_and_a_dead_one_harms_no_other() {
    let mut server = Server::with(0, 1, &["--units", "3"]).await;
    let proxy = Proxy::start(server.port).await;
    let addresses = [2000, 2040];
    let lines =
        "poll_ms = 100\ntimeout_ms = 100\nmax_gap = 0\nshare_connection = true\nreconnect_max_ms = 2000";
    let mut units: Vec<Watch> = (1..=3)
        .map(|unit| device(proxy.port, &format!("unit_id = {unit}\n{lines}")))
        .map(|config| Watch::start(plan(&config, &addresses.map(truth_tag))))
        .collect();
    for watch in &mut units {
        watch.until("good", all_good).await;
    }
    assert_eq!(proxy.connections(), (1, 1), "three units, one connection");

    server.tell("silent 2").await;
    let mut dead = units.remove(1);
    dead.until("silent", |poll| all_bad(poll, BadReason::Timeout)).await;
    let before = dead.health.snapshot();
    let mut polls = [Vec::new(), Vec::new()];
    for _ in 0..40 {
        for (watch, polls) in units.iter_mut().zip(&mut polls) {
            polls.push(watch.poll().await);
        }
    }
    let timeouts = dead.health.snapshot().timeouts - before.timeouts;
    // 40 polls are 4 s or more; pauses of 0.05, 0.1, 0.2, … 2 s fit some eight probes in, and not forty.
    assert!((1..=12).contains(&timeouts), "{timeouts} probes");
    for (polls, epoch) in polls.iter().zip([1, 301]) {
        let read = checked(polls, &addresses);
        assert!(read.iter().all(|(_, _, truth)| truth.epoch == epoch), "another unit's value");
        // A connection dropped for the dead unit's time-out is opened again within the poll.
        let good = polls.iter().filter(|poll| all_good(poll)).count();
        assert!(good >= polls.len() - 1, "{good} of {} polls", polls.len());
    }
    server.tell("heal").await;
    dead.until("good again", all_good).await;
    assert_eq!(proxy.connections().0, 1, "still one connection");
    for watch in units.into_iter().chain([dead]) {
        watch.stop().await;
    }
}

#[tokio::test]
async fn rtu_frames_over_tcp_are_read_and_a_late_answer_is_not_taken_for_the_next() {
    let mut server = Server::with(0, 1, &["--units", "2", "--framer", "rtu"]).await;
    let addresses = [2000, 2040];
    let config = device(
        server.port,
        "unit_id = 2\nframing = 'rtu'\npoll_ms = 300\ntimeout_ms = 200\nmax_gap = 0\nreconnect_max_ms = 100",
    );
    let mut watch = Watch::start(plan(&config, &addresses.map(truth_tag)));
    let mut polls = watch.until("good", all_good).await;
    server.tell("delay 3 0.3").await;
    polls.extend(watch.until("late", |poll| !all_good(poll)).await);
    polls.extend(watch.until("good again", all_good).await);
    for _ in 0..3 {
        polls.push(watch.poll().await);
    }
    server.tell("heal").await;
    assert!(!server.late.is_empty());
    for (_, _, truth) in checked(&polls, &addresses) {
        assert!(
            truth.epoch == 201 && !server.late.contains(&truth.counter),
            "a late answer was taken: {truth:?}"
        );
    }
    watch.stop().await;
}

#[tokio::test]
async fn a_device_that_gives_fewer_registers_at_once_is_asked_for_fewer_from_then_on() {
    let mut server = Server::start(0, 1).await;
    server.tell("limit 10").await;
    let addresses: Vec<u16> = (2000..2100).step_by(4).collect();
    let tags: Vec<String> = addresses.iter().copied().map(truth_tag).collect();
    let planned = patient(plan(&device(server.port, "poll_ms = 50\ntimeout_ms = 50"), &tags));
    assert_eq!(planned.requests.len(), 1);
    let mut watch = Watch::start(planned);
    // The first poll may end in the midst of dividing, for its time is up.
    let mut polls = watch.until("good", all_good).await;
    let learned = watch.health.snapshot().exceptions;
    // 25 tags of 4 registers in requests of at most 10: a binary tree of at most 25 leaves has fewer than 25 inner nodes.
    assert!((1..25).contains(&learned), "{learned} refusals");
    for _ in 0..5 {
        polls.push(watch.poll().await);
    }
    assert!(polls[polls.len() - 5..].iter().all(|poll| all_good(poll)));
    assert_eq!(watch.health.snapshot().exceptions, learned, "it is not asked for too much again");
    assert_eq!(watch.health.snapshot().reconnects, 0);
    checked(&polls, &addresses);
    watch.stop().await;
}

#[tokio::test]
async fn requests_keep_the_gap_between_them() {
    let server = Server::start(0, 1).await;
    let addresses = [2000, 2020, 2040, 2060];
    let config = device(server.port, "poll_ms = 60000\ntimeout_ms = 1000\nmax_gap = 0\nmin_gap_ms = 60");
    let mut watch = Watch::start(patient(plan(&config, &addresses.map(truth_tag))));
    let poll = watch.poll().await;
    assert!(all_good(&poll), "{poll:?}");
    // A sample is stamped when its answer has come, and the gap runs from there; 1 ms for the clocks' grain.
    for pair in poll.windows(2) {
        assert!(pair[1].t - pair[0].t >= 0.059, "{poll:?}");
    }
    let began = Instant::now();
    watch.stop().await;
    // Far from the next poll, however busy the machine is.
    assert!(began.elapsed() < Duration::from_secs(20), "a pause does not delay the end");
}
