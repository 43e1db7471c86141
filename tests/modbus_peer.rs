//! The Modbus collector against pymodbus: a peer that was not written here, with real faults.

#[cfg(test)]
#[path = "modbus_peer/gateway.rs"]
mod gateway;
#[cfg(test)]
#[path = "modbus_peer/odd.rs"]
mod odd;
#[cfg(test)]
mod peers;

use peers::{Proxy, Server, Watch, checked, device, hostile, patient, plan, truth_tag};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use stictiond::collect::modbus::{ProbeError, ProbeTarget, Register, probe};
use stictiond::signal::{BadReason, Quality, Sample};
use tokio::net::{TcpListener, TcpSocket};
use tokio::time::Instant;

const ORDERS: [&str; 4] = ["ABCD", "CDAB", "BADC", "DCBA"];
/// As tests/peers/modbus_server.py lays them out from 100 k on for order k: offset, type, holding, input.
const VALUES: [(i64, &str, f64, f64); 8] = [
    (0, "u16", 54321.0, 1.0),
    (1, "i16", -12345.0, -1.0),
    (2, "u32", 4000000123.0, 65537.0),
    (4, "i32", -2000000321.0, -65537.0),
    (6, "f32", -123.456_f32 as f64, 0.0015_f32 as f64),
    (8, "f64", -98.7654321, std::f64::consts::PI),
    (12, "u64", 9_007_199_254_740_993_000.0, 4_294_967_297.0),
    (16, "i64", -1_234_567_890_123_456.0, -4_294_967_297.0),
];

fn all_good(poll: &[Sample]) -> bool {
    poll.iter().all(|s| s.quality.is_good())
}

fn all_bad(poll: &[Sample], reason: BadReason) -> bool {
    poll.iter().all(|s| s.quality == Quality::Bad(reason))
}

#[tokio::test]
async fn every_type_in_every_byte_order_from_every_table_with_both_address_bases() {
    let server = Server::start(0, 1).await;
    for base in [0, 1] {
        let (mut tags, mut expected) = (Vec::new(), Vec::new());
        for (k, order) in ORDERS.iter().enumerate() {
            for (offset, kind, holding, input) in VALUES {
                let address = 100 * k as i64 + offset + base;
                for (register, value) in [("holding", holding), ("input", input)] {
                    tags.push(format!(
                        "register = '{register}'\naddress = {address}\ntype = '{kind}'\nbyte_order = '{order}'"
                    ));
                    expected.push(value);
                }
            }
        }
        for bit in 0..16 {
            let text = format!("register = 'holding'\naddress = {base}\ntype = 'bit'\nbit = {bit}");
            tags.push(text);
            expected.push(f64::from(54321u16 >> bit & 1));
        }
        for at in (0..40).chain([63]) {
            tags.push(format!("register = 'coil'\naddress = {}", at + base));
            expected.push(f64::from(u8::from(at % 3 == 0)));
            tags.push(format!("register = 'discrete'\naddress = {}", at + base));
            expected.push(f64::from(u8::from(at % 5 == 0)));
        }
        let config =
            device(server.port, &format!("address_base = {base}\nmax_gap = 30\nbyte_order = 'ABCD'"));
        let mut planned = patient(plan(&config, &tags));
        // A name may have several addresses, of which the server listens on one.
        planned.address = planned.address.replace("127.0.0.1", "localhost");
        let mut watch = Watch::start(planned);
        let poll = watch.poll().await;
        for ((tag, sample), value) in tags.iter().zip(&poll).zip(&expected) {
            assert_eq!((sample.value, sample.quality), (*value, Quality::Good), "{tag}");
        }
        watch.stop().await;
    }
}

#[tokio::test]
async fn a_server_killed_and_restarted_leaves_a_gap_and_no_invented_value() {
    let addresses = [2000, 2004, 2040];
    let server = Server::start(0, 1).await;
    let port = server.port;
    let config = device(port, "poll_ms = 50\ntimeout_ms = 50\nmax_gap = 0\nreconnect_max_ms = 200");
    let mut watch = Watch::start(patient(plan(&config, &addresses.map(truth_tag))));
    let mut polls = watch.until("good", all_good).await;

    server.kill().await;
    polls.extend(watch.until("down", |poll| all_bad(poll, BadReason::LinkDown)).await);
    let down = polls.len();
    for _ in 0..10 {
        polls.push(watch.poll().await);
    }
    assert!(polls[down..].iter().all(|poll| all_bad(poll, BadReason::LinkDown)), "{:?}", &polls[down..]);
    assert!(!watch.health.snapshot().connected);

    let _server = Server::start(port, 2).await;
    polls.extend(watch.until("good again", all_good).await);
    for (number, _, truth) in checked(&polls, &addresses) {
        assert_eq!(truth.epoch, if number < down { 1 } else { 2 });
    }
    let health = watch.health.snapshot();
    assert!(health.connected && health.reconnects >= 1 && health.link_errors >= 1, "{health:?}");
    watch.stop().await;
}

#[tokio::test]
async fn a_late_answer_is_never_taken_for_the_next_one() {
    let addresses = [2000, 2040, 2080];
    let mut server = Server::start(0, 1).await;
    let config = device(server.port, "poll_ms = 400\ntimeout_ms = 300\nmax_gap = 0\nreconnect_max_ms = 100");
    let mut watch = Watch::start(plan(&config, &addresses.map(truth_tag)));
    let mut polls = watch.until("good", all_good).await;
    // Twice: one late answer while the others are asked on, then several in a row with nothing in between.
    for late in [1, 5] {
        server.tell(&format!("delay {late} 0.45")).await;
        polls.extend(
            watch.until("late", |p| p.iter().any(|s| s.quality == Quality::Bad(BadReason::Timeout))).await,
        );
        polls.extend(watch.until("good again", all_good).await);
    }
    for _ in 0..4 {
        polls.push(watch.poll().await);
    }
    server.tell("heal").await;
    assert!(server.late.len() >= 3, "{:?}", server.late);
    for (_, _, truth) in checked(&polls, &addresses) {
        assert!(!server.late.contains(&truth.counter), "a late answer was taken: {truth:?}");
    }
    let timeouts = watch.health.snapshot().timeouts;
    assert!(timeouts >= server.late.len() as u64, "each late answer timed out");
    watch.stop().await;
}

#[tokio::test]
async fn answers_slower_than_the_period_are_counted_and_still_true() {
    let addresses = [2000, 2040];
    let mut server = Server::start(0, 1).await;
    let config = device(server.port, "poll_ms = 200\ntimeout_ms = 200\nmax_gap = 0");
    let mut watch = Watch::start(patient(plan(&config, &addresses.map(truth_tag))));
    let mut polls = watch.until("good", all_good).await;
    // Two answers of 0.2 s each make a poll of 0.4 s in a period of 0.2 s, without a time-out.
    server.tell("delay 8 0.2").await;
    while server.late.len() < 8 {
        polls.push(watch.poll().await);
        server.tell("sync").await;
    }
    checked(&polls, &addresses);
    let health = watch.health.snapshot();
    assert!(health.overruns >= 2 && health.missed_polls >= 1, "{health:?}");
    watch.stop().await;
}

#[tokio::test]
async fn a_refused_address_costs_only_its_own_tag() {
    let server = Server::start(0, 1).await;
    let config = device(server.port, "poll_ms = 50\ntimeout_ms = 50\nmax_gap = 8");
    let u16_at = |address: u16| format!("register = 'holding'\naddress = {address}\ntype = 'u16'");
    // One request of 2100..2105 spans the hole 2102..2103; nobody asks for 2103, somebody for 2102.
    let tags = [2100, 2101, 2102, 2104, 2105].map(u16_at);
    let planned = patient(plan(&config, &tags));
    assert_eq!(planned.requests.len(), 1);
    let mut watch = Watch::start(planned);
    let mut exceptions = 0;
    for number in 0..5 {
        let poll = watch.poll().await;
        for (tag, value) in [(0, 2100.0), (1, 2101.0), (3, 2104.0), (4, 2105.0)] {
            assert_eq!((poll[tag].value, poll[tag].quality), (value, Quality::Good), "poll {number}");
        }
        assert_eq!(poll[2].quality, Quality::Bad(BadReason::DeviceException));
        assert!(poll[2].value.is_nan());
        let now = watch.health.snapshot().exceptions;
        // The division is remembered: after the first poll only the bad address itself is refused.
        assert!(number == 0 || now - exceptions <= 1, "poll {number}: {exceptions} then {now}");
        exceptions = now;
    }
    assert_eq!(watch.health.snapshot().reconnects, 0, "a refusal is no reason to hang up");
    watch.stop().await;
}

#[tokio::test]
async fn a_silent_unit_behind_a_gateway_is_asked_once_a_poll() {
    let mut server = Server::start(0, 1).await;
    let config = device(server.port, "poll_ms = 50\ntimeout_ms = 50\nmax_gap = 0");
    let mut watch = Watch::start(patient(plan(&config, &[2000, 2040, 2080].map(truth_tag))));
    watch.until("good", all_good).await;
    server.tell("gateway").await;
    watch.until("refused", |poll| all_bad(poll, BadReason::DeviceException)).await;
    let before = watch.health.snapshot();
    for _ in 0..4 {
        watch.poll().await;
    }
    let after = watch.health.snapshot();
    let (polls, refused) = (after.polls - before.polls, after.exceptions - before.exceptions);
    // A poll may be under way at each of the two readings.
    assert!(refused <= polls + 1, "{refused} questions in {polls} polls");
    server.tell("heal").await;
    watch.until("good again", all_good).await;
    assert_eq!(watch.health.snapshot().reconnects, 0);
    watch.stop().await;
}

#[tokio::test]
async fn a_connection_cut_at_any_byte_of_an_answer_leaves_nothing_wrong() {
    let addresses = [2000, 2004];
    let server = Server::start(0, 1).await;
    let proxy = Proxy::start(server.port).await;
    let config = device(proxy.port, "poll_ms = 40\ntimeout_ms = 40\nreconnect_max_ms = 40");
    let mut watch = Watch::start(patient(plan(&config, &addresses.map(truth_tag))));
    let mut polls = watch.until("good", all_good).await;
    // An answer is 9 bytes of head and 16 of values; 25 cuts behind the whole answer.
    for bytes in 1..=25 {
        let before = watch.health.snapshot().reconnects;
        proxy.cut_after(bytes);
        let health = Arc::clone(&watch.health);
        polls.extend(watch.until("cut", |_| health.snapshot().reconnects > before).await);
        polls.extend(watch.until("good again", all_good).await);
    }
    checked(&polls, &addresses);
    let bad = polls.iter().filter(|poll| !all_good(poll)).count();
    assert_eq!(bad, 0, "one broken connection a poll is mended within the poll");
    assert!(watch.health.snapshot().reconnects >= 25);
    watch.stop().await;
}

#[tokio::test]
async fn an_answer_with_the_wrong_register_count_is_no_value() {
    let addresses = [2000, 2004];
    let mut server = Server::start(0, 1).await;
    let config = device(server.port, "poll_ms = 50\ntimeout_ms = 50");
    let mut watch = Watch::start(patient(plan(&config, &addresses.map(truth_tag))));
    let mut polls = watch.until("good", all_good).await;
    server.tell("short").await;
    polls.extend(watch.until("short", |poll| all_bad(poll, BadReason::DeviceException)).await);
    polls.push(watch.poll().await);
    server.tell("heal").await;
    polls.extend(watch.until("good again", all_good).await);
    checked(&polls, &addresses);
    watch.stop().await;
}

#[tokio::test]
async fn a_register_that_never_answers_costs_the_others_nothing_after_it_is_known() {
    let addresses = [2000, 2040, 2080];
    let mut server = Server::start(0, 1).await;
    let config = device(server.port, "poll_ms = 200\ntimeout_ms = 150\nmax_gap = 0\nreconnect_max_ms = 100");
    let mut watch = Watch::start(plan(&config, &addresses.map(truth_tag)));
    let mut polls = watch.until("good", all_good).await;
    server.tell("hang 2000").await;
    let silent = |poll: &[Sample]| poll[0].quality == Quality::Bad(BadReason::Timeout);
    polls.extend(watch.until("silent", silent).await);
    let known = polls.len();
    for _ in 0..20 {
        polls.push(watch.poll().await);
    }
    for poll in &polls[known..] {
        assert!(silent(poll) && poll[1].quality.is_good() && poll[2].quality.is_good(), "{poll:?}");
    }
    assert!(
        watch.health.snapshot().timeouts <= 8,
        "it rests longer and longer: {:?}",
        watch.health.snapshot()
    );
    server.tell("heal").await;
    polls.extend(watch.until("good again", all_good).await);
    checked(&polls, &addresses);
    watch.stop().await;
}

#[tokio::test]
async fn dead_devices_do_not_slow_the_others() {
    let mut hung = Server::start(0, 1).await;
    hung.tell("hang 2000").await;
    let server = Server::start(0, 1).await;
    // Accepts connections (in the kernel's queue) and never answers.
    let black_hole = TcpListener::bind("127.0.0.1:0").await.unwrap();
    // Bound, and not listening: it refuses connections, and nobody else gets the port.
    let refusing = TcpSocket::new_v4().unwrap();
    refusing.bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let slow = "poll_ms = 1000\ntimeout_ms = 1000";
    let [queueing, closed] = [black_hole.local_addr(), refusing.local_addr()].map(|at| at.unwrap().port());
    let dead: Vec<Watch> = [hung.port, queueing, closed]
        .map(|port| Watch::start(plan(&device(port, slow), &[truth_tag(2000)])))
        .into();
    let config = device(server.port, "poll_ms = 50\ntimeout_ms = 50");
    let mut alive = Watch::start(patient(plan(&config, &[truth_tag(2000)])));
    alive.until("good", all_good).await;
    let began = Instant::now();
    let mut polls = Vec::new();
    for _ in 0..40 {
        polls.push(alive.poll().await);
    }
    // 40 polls of 50 ms are 2 s, more on a busy machine; waiting for any of the dead would take 1 s a poll.
    assert!(began.elapsed() < Duration::from_secs(30), "{:?}", began.elapsed());
    assert_eq!(checked(&polls, &[2000]).len(), 40);
    for (watch, name) in dead.into_iter().zip(["hung", "black hole", "refusing"]) {
        let health = watch.health.snapshot();
        assert_eq!((health.good_samples, health.last_good), (0, None), "{name}");
        watch.stop().await;
    }
    alive.stop().await;
}

#[tokio::test]
async fn a_frozen_value_turns_stale_and_a_live_one_does_not() {
    let server = Server::start(0, 1).await;
    let config = device(server.port, "poll_ms = 20\ntimeout_ms = 20");
    let constant = "register = 'holding'\naddress = 0\ntype = 'u16'".to_string();
    let mut planned = patient(plan(&config, &[constant, truth_tag(2000)]));
    planned.tags.iter_mut().for_each(|tag| tag.frozen_after_s = Some(10.0));
    // One second of plant time goes by each time the clock is read, which is once or more a poll.
    let seconds = AtomicU64::new(1_000_000);
    let clock = move || seconds.fetch_add(1, Ordering::SeqCst) as f64;
    let mut watch = Watch::with_clock(planned, Arc::new(clock));
    let polls = watch.until("stale", |poll| poll[0].quality == Quality::Stale).await;
    let last = polls.last().unwrap();
    assert_eq!((last[0].value, last[1].quality), (54321.0, Quality::Good));
    let first_good = polls.iter().find(|poll| all_good(poll)).unwrap();
    assert!(last[0].t - first_good[0].t > 10.0);
    assert!(polls.iter().rev().skip(1).all(|poll| poll[0].quality != Quality::Stale));
    watch.stop().await;
}

/// An answer of two registers to the request, which asks for two: the right one, to be spoilt.
fn right(request: &[u8]) -> Vec<u8> {
    let mut answer = request[..8].to_vec();
    answer[5] = 7;
    answer.extend([4, 0x42, 0xF6, 0xE9, 0x79]);
    answer
}

#[tokio::test]
async fn answers_that_do_not_answer_the_question_are_no_values() {
    type Spoil = fn(&mut Vec<u8>);
    let spoils: [(&str, Spoil); 13] = [
        ("transaction", |a| a[1] ^= 1),
        ("protocol", |a| a[3] = 1),
        ("length 0", |a| a[5] = 0),
        ("length 1", |a| a[5] = 1),
        ("length 65535", |a| a[4..6].fill(0xFF)),
        ("unit", |a| a[6] ^= 1),
        ("function: input registers", |a| a[7] = 4),
        ("function: coils", |a| a[7] = 1),
        ("function: unknown", |a| a[7] = 0x7F),
        ("odd byte count", |a| a[8] = 3),
        ("byte count beyond the answer", |a| a[8] = 250),
        ("one register", |a| {
            a.truncate(11);
            (a[5], a[8]) = (5, 2);
        }),
        ("three registers", |a| {
            a.extend([1, 2]);
            (a[5], a[8]) = (9, 6);
        }),
    ];
    let tag = ["register = 'holding'\naddress = 7\ntype = 'f32'".to_string()];
    let settings = "poll_ms = 20\ntimeout_ms = 20\nreconnect_max_ms = 20";
    let mut good = Watch::start(patient(plan(&device(hostile(right).await, settings), &tag)));
    assert_eq!(good.poll().await[0].value, f64::from(123.456_f32), "unspoilt it is a value");
    good.stop().await;
    for (name, spoil) in spoils {
        let port = hostile(move |request| {
            let mut answer = right(request);
            spoil(&mut answer);
            answer
        });
        let mut watch = Watch::start(patient(plan(&device(port.await, settings), &tag)));
        for _ in 0..3 {
            let poll = watch.poll().await;
            assert!(matches!(poll[0].quality, Quality::Bad(_)) && poll[0].value.is_nan(), "{name}: {poll:?}");
        }
        let health = watch.health.snapshot();
        assert!(health.link_errors + health.timeouts + health.exceptions > 0, "{name}: {health:?}");
        watch.stop().await;
    }
}

#[tokio::test]
async fn probe_shows_what_the_device_holds() {
    let server = Server::start(0, 1).await;
    let target = |register, start, count| ProbeTarget {
        address: format!("127.0.0.1:{}", server.port),
        unit_id: 1,
        address_base: 0,
        register,
        start,
        count,
        timeout: Duration::from_secs(5),
    };
    let table = probe(&target(Register::Holding, 106, 6)).await.unwrap();
    let text = table.to_string();
    // 106..107 is -123.456 in CDAB, 108..111 is -98.7654321 in CDAB.
    let row = |order_row: usize| text.lines().nth(order_row).unwrap().to_string();
    assert!(row(2).contains("CDAB") && row(2).contains("-123.456"), "{text}");
    assert!(row(2 + 8).contains("CDAB") && row(2 + 8).contains("-98.7654321"), "{text}");
    assert_eq!(probe(&target(Register::Coil, 0, 10)).await.unwrap().words, [1, 0, 0, 1, 0, 0, 1, 0, 0, 1]);

    let refused = probe(&target(Register::Holding, 2100, 4)).await.unwrap_err();
    assert!(matches!(refused, ProbeError::Device { .. }), "{refused}");
    let nobody = ProbeTarget { address: "127.0.0.1:1".into(), ..target(Register::Holding, 0, 1) };
    assert!(matches!(probe(&nobody).await.unwrap_err(), ProbeError::Link { .. }));
}
