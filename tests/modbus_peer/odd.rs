//! Gateways and devices that keep the protocol in their own way: pymodbus behind a proxy that changes what it answers.

use super::peers::{Server, Watch, checked, device, patient, plan, truth_tag};
use super::{all_bad, all_good};
use std::io::Write;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use stictiond::signal::BadReason;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;

/// What becomes of an answer, by the number of the request since the start.
type Change = fn(usize, &mut Vec<u8>);

/// When the proxy closes a connection.
#[derive(Clone, Copy)]
enum Closes {
    Never,
    AfterEachAnswer,
    /// Once no request has come for so long.
    Idle(Duration),
}

/// A proxy that changes every answer of the server.
async fn odd(server: u16, closes: Closes, change: Change) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    tokio::spawn(async move {
        let mut number = 0;
        while let Ok((mut client, _)) = listener.accept().await {
            let mut upstream = TcpStream::connect(("127.0.0.1", server)).await.unwrap();
            let (mut request, mut head) = ([0u8; 12], [0u8; 6]);
            let idle = match closes {
                Closes::Idle(time) => time,
                _ => Duration::MAX,
            };
            while let Ok(Ok(_)) = timeout(idle, client.read_exact(&mut request)).await {
                upstream.write_all(&request).await.unwrap();
                upstream.read_exact(&mut head).await.unwrap();
                let mut answer = head.to_vec();
                answer.resize(6 + usize::from(head[5]), 0);
                upstream.read_exact(&mut answer[6..]).await.unwrap();
                change(number, &mut answer);
                number += 1;
                let sent = client.write_all(&answer).await;
                if sent.is_err() || matches!(closes, Closes::AfterEachAnswer) {
                    break;
                }
            }
        }
    });
    port
}

#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Log {
    fn start() -> (Self, tracing::subscriber::DefaultGuard) {
        let log = Self::default();
        let writer = log.clone();
        let to_log = tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).finish();
        (log, tracing::subscriber::set_default(to_log))
    }

    fn warnings(&self) -> Vec<String> {
        let said = String::from_utf8_lossy(&self.0.lock().unwrap()).into_owned();
        said.lines().filter(|line| line.contains(" WARN ")).map(str::to_string).collect()
    }
}

const ADDRESSES: [u16; 2] = [2000, 2040];

/// Two requests a poll.
fn watch(port: u16, more: &str) -> Watch {
    let config =
        device(port, &format!("poll_ms = 40\ntimeout_ms = 40\nmax_gap = 0\nreconnect_max_ms = 40\n{more}"));
    Watch::start(patient(plan(&config, &ADDRESSES.map(truth_tag))))
}

#[tokio::test]
async fn a_gateway_with_heads_of_its_own_is_named_with_the_option_and_read_by_it() {
    let number: Change = |_, answer| answer[..2].fill(0xEE);
    let cases: [(Change, &str, &str); 4] = [
        (number, "transaction_id", "transaction id 61166"),
        (|_, answer| answer[6] = 0, "unit_id", "unit id 0, not 1"),
        (|_, answer| answer[6] = 255, "unit_id", "unit id 255, not 1"),
        (
            |_, answer| {
                answer[..2].fill(0xEE);
                answer[6] = 255;
            },
            "transaction_id\", \"unit_id",
            "transaction id 61166",
        ),
    ];
    let server = Server::start(0, 1).await;
    for (change, option, said) in cases {
        let (log, _guard) = Log::start();
        let port = odd(server.port, Closes::Never, change).await;
        let mut refused = watch(port, "");
        refused.until("refused", |poll| all_bad(poll, BadReason::LinkDown)).await;
        refused.stop().await;
        let named = log.warnings().iter().any(|line| line.contains(said) && line.contains("tolerate = ["));
        assert!(named, "{said}: {:?}", log.warnings());
        let mut taken = watch(port, &format!("tolerate = [\"{option}\"]"));
        let mut polls = taken.until("good", all_good).await;
        for _ in 0..10 {
            polls.push(taken.poll().await);
        }
        assert!(polls.iter().all(|poll| all_good(poll)), "{option}");
        checked(&polls, &ADDRESSES);
        taken.stop().await;
    }
    // Another device's answer is none of ours, whatever is tolerated.
    let port = odd(server.port, Closes::Never, |_, answer| answer[6] = 9).await;
    let mut other = watch(port, "tolerate = [\"transaction_id\", \"unit_id\"]");
    for _ in 0..5 {
        assert!(all_bad(&other.poll().await, BadReason::LinkDown));
    }
    other.stop().await;
}

/// Polls a device that closes its connections until it was connected to so often: each poll is good, and nothing is
/// warned of.
/// A loaded machine polls without a pause, so a number of polls would say little of how often the device closed.
async fn costs_nothing(closes: Closes, connections: u64) {
    let (log, _guard) = Log::start();
    let server = Server::start(0, 1).await;
    let port = odd(server.port, closes, |_, _| {}).await;
    let mut watch = watch(port, "");
    let mut polls = Vec::new();
    while polls.len() < 30 || (polls.len() < 600 && watch.health.snapshot().reconnects < connections) {
        polls.push(watch.poll().await);
    }
    assert!(polls.iter().all(|poll| all_good(poll)), "{:?}", polls.iter().find(|poll| !all_good(poll)));
    checked(&polls, &ADDRESSES);
    let health = watch.health.snapshot();
    assert!(health.reconnects >= connections, "at least {connections}: {health:?}");
    assert_eq!((health.link_errors, health.timeouts), (0, 0));
    assert_eq!(log.warnings(), [""; 0]);
    watch.stop().await;
}

#[tokio::test]
async fn a_device_that_closes_after_each_answer_costs_no_sample_and_no_warning() {
    // A connection for each request.
    costs_nothing(Closes::AfterEachAnswer, 50).await;
}

#[tokio::test]
async fn a_device_that_closes_when_idle_costs_no_sample_and_no_warning() {
    // Shorter than the time between two polls: most begin on a connection that is closed or about to be.
    costs_nothing(Closes::Idle(Duration::from_millis(30)), 15).await;
}

#[tokio::test]
async fn a_device_that_is_busy_is_asked_once_more_within_the_poll() {
    let server = Server::start(0, 1).await;
    let busy: Change = |number, answer| {
        // The first request of three is answered by "acknowledge" or "busy".
        if number % 3 == 0 {
            answer.truncate(9);
            (answer[5], answer[7], answer[8]) = (3, answer[7] | 0x80, if number % 2 == 0 { 5 } else { 6 });
        }
    };
    let port = odd(server.port, Closes::Never, busy).await;
    let config = device(port, "poll_ms = 400\ntimeout_ms = 200\nmax_gap = 0");
    let mut watch = Watch::start(patient(plan(&config, &ADDRESSES.map(truth_tag))));
    let mut polls = Vec::new();
    for _ in 0..4 {
        polls.push(watch.poll().await);
    }
    assert!(polls.iter().all(|poll| all_good(poll)), "{polls:?}");
    checked(&polls, &ADDRESSES);
    assert_eq!(watch.health.snapshot().exceptions, 4, "one a poll");
    watch.stop().await;
    // One that is busy all the time is asked twice a poll and no more.
    let always: Change = |_, answer| {
        answer.truncate(9);
        (answer[5], answer[7], answer[8]) = (3, answer[7] | 0x80, 6);
    };
    let port = odd(server.port, Closes::Never, always).await;
    let config = device(port, "poll_ms = 400\ntimeout_ms = 200\nmax_gap = 0");
    let mut watch = Watch::start(patient(plan(&config, &ADDRESSES.map(truth_tag))));
    for _ in 0..2 {
        assert!(all_bad(&watch.poll().await, BadReason::DeviceException));
    }
    assert_eq!(watch.health.snapshot().exceptions, 8);
    watch.stop().await;
}
