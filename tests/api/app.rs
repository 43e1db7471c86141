//! The whole daemon in one process: a Modbus server, collectors, history, scheduler, alarms, API; and reloads.

use crate::http::{Events, get};
use crate::rig::sticky_at_ten;
use std::collections::HashMap;
use std::future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use stictiond::app::{App, AppError};
use stictiond::config::{self, Config};
use stictiond::schedule::Clock;
use stictiond::serve;
use tokio::net::TcpListener;
use tokio_modbus::prelude::*;
use tokio_modbus::server::tcp::{Server, accept_tcp_connection};

/// A device whose register r holds r, or r plus the number of requests so far for r >= 100; it counts connections.
#[derive(Clone, Default)]
pub struct Registers {
    requests: Arc<AtomicU64>,
    connections: Arc<AtomicU64>,
}

impl tokio_modbus::server::Service for Registers {
    type Request = Request<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = future::Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        let turn = self.requests.fetch_add(1, Ordering::Relaxed) as u16;
        future::ready(match request {
            Request::ReadHoldingRegisters(start, count) => {
                let value = |r: u16| if r >= 100 { r.wrapping_add(turn) } else { r };
                Ok(Response::ReadHoldingRegisters((start..start + count).map(value).collect()))
            }
            _ => Err(ExceptionCode::IllegalFunction),
        })
    }
}

pub async fn device() -> (SocketAddr, Registers) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    let registers = Registers::default();
    let service = registers.clone();
    tokio::spawn(async move {
        let connected = |stream, peer| {
            service.connections.fetch_add(1, Ordering::Relaxed);
            let service = service.clone();
            async move { accept_tcp_connection(stream, peer, move |_| Ok(Some(service.clone()))) }
        };
        Server::new(listener).serve(&connected, |_| {}).await
    });
    (address, registers)
}

/// Loops by name, device and first register; OP at the register, PV at the next.
pub fn text(devices: &[SocketAddr], loops: &[(&str, usize, u16)]) -> String {
    let mut text = "[schedule]\nperiod_s = 10\n[history]\nsamples_per_tag = 1000\n".to_string();
    for (at, address) in devices.iter().enumerate() {
        text += &format!(
            "[[modbus]]\nname = \"d{at}\"\naddress = \"{address}\"\npoll_ms = 20\ntimeout_ms = 20\naddress_base = 0\n"
        );
    }
    for (id, device, register) in loops {
        text += &format!("[[loop]]\nid = \"{id}\"\nop_span = 100.0\n");
        for (role, address) in [("op", *register), ("pv", *register + 1)] {
            text += &format!(
                "[loop.{role}]\ndevice = \"d{device}\"\nregister = \"holding\"\naddress = {address}\ntype = \"u16\"\n"
            );
        }
    }
    text
}

pub fn config(devices: &[SocketAddr], loops: &[(&str, usize, u16)]) -> Config {
    let text = text(devices, loops);
    config::parse("test.toml", &text).unwrap_or_else(|wrong| panic!("{wrong:?}\n{text}"))
}

pub struct Daemon {
    pub app: Arc<App>,
    pub address: SocketAddr,
    pub task: tokio::task::JoinHandle<Result<(), AppError>>,
}

/// Plant time runs 20 times as fast, so a period of 10 s is half a second. Sticky is what has an OP of 10.
pub async fn start(config: Config) -> Daemon {
    start_at(config, Clock::plant(1_767_225_600.0, 20.0)).await
}

/// The same with a clock of the test's.
pub async fn start_at(config: Config, clock: Clock) -> Daemon {
    let diagnose = Arc::new(|record: &stictiond::signal::Record, _: &_, _: Option<&_>| sticky_at_ten(record));
    let app = Arc::new(App::build(config, clock, diagnose).expect("a sound configuration"));
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    let running = app.clone();
    Daemon { app, address, task: tokio::spawn(async move { running.run(listener).await }) }
}

impl Daemon {
    pub async fn json(&self, path: &str) -> serde_json::Value {
        let answer = get(self.address, path).await;
        assert_eq!(answer.status, 200, "{path}: {}", answer.text());
        answer.json()
    }

    /// The counters `name` of `device_events` by device.
    async fn counters(&self, name: &str) -> HashMap<String, f64> {
        let text = get(self.address, "/metrics").await.text();
        let event = format!("event=\"{name}\"}} ");
        let parse = |line: &str| {
            let (series, value) = line.split_once(&event)?;
            let device = series.split('"').nth(1)?.to_string();
            Some((device, value.parse().ok()?))
        };
        text.lines().filter(|l| l.starts_with("stictiond_device_events_total")).filter_map(parse).collect()
    }
}

/// Waits for an event of this name about this loop (any, when empty).
pub async fn heard(events: &mut Events, name: &str, id: &str) -> serde_json::Value {
    loop {
        let (event, data) = events.next().await.expect("the stream goes on");
        if event == name && (id.is_empty() || data["loop"] == id) {
            return data;
        }
    }
}

#[tokio::test]
async fn from_a_register_to_an_alarm_and_through_a_reload() {
    let ((first, registers), (second, _)) = (device().await, device().await);
    let old = config(&[first, second], &[("A", 0, 10), ("B", 1, 20)]);
    let daemon = start(old).await;
    let mut events = Events::open(daemon.address).await;
    let raised = heard(&mut events, "alarm", "A").await;
    assert_eq!(raised["to"], "unacknowledged");
    heard(&mut events, "diagnosis", "B").await;
    assert_eq!(daemon.json("/readyz").await["loops_diagnosed"], 2);
    let detail = daemon.json("/api/v1/loops/A").await;
    assert_eq!(
        (detail["values"][0]["value"].as_f64(), detail["values"][1]["value"].as_f64()),
        (Some(10.0), Some(11.0))
    );
    let samples = daemon.json("/api/v1/loops/A/samples").await;
    let found = samples["tags"][0]["found"].as_u64().expect("a number");
    assert!(found > 5, "half a second of polls at 20 ms and more: {found}");
    let polls = daemon.counters("polls").await;
    // B goes, C comes before A, so A's tags get other numbers; A's device is as it was.
    let new = config(&[first, second], &[("C", 1, 30), ("A", 0, 10)]);
    daemon.app.reload(new).await.expect("a sound configuration");
    heard(&mut events, "reloaded", "").await;
    assert_eq!(get(daemon.address, "/api/v1/loops/B").await.status, 404);
    assert_eq!(daemon.json("/api/v1/loops/A").await["alarm"], "unacknowledged");
    let kept = daemon.json("/api/v1/loops/A/samples").await["tags"][0]["found"].as_u64();
    assert!(kept >= Some(found), "its samples are kept: {kept:?}");
    heard(&mut events, "diagnosis", "C").await;
    heard(&mut events, "diagnosis", "A").await;
    let detail = daemon.json("/api/v1/loops/C").await;
    assert_eq!(detail["values"][1]["value"], 31.0);
    // A's samples go on arriving in A's ring, and every one of them is A's.
    let after = daemon.json("/api/v1/loops/A/samples").await;
    assert!(after["tags"][0]["found"].as_u64() > kept, "{after}");
    let ops = after["tags"][0]["value"].as_array().expect("a column");
    assert!(ops.iter().all(|op| op.is_null() || *op == 10.0), "{after}");
    assert!(daemon.counters("polls").await["d0"] >= polls["d0"], "its counters go on");
    assert_eq!(registers.connections.load(Ordering::Relaxed), 1, "its connection was never dropped");
    daemon.app.stop().cancel();
    let ended = tokio::time::timeout(std::time::Duration::from_secs(4), daemon.task).await;
    assert!(ended.expect("ends in time").expect("no panic").is_ok());
}

#[tokio::test]
async fn a_tag_that_reads_something_else_starts_empty() {
    let (address, registers) = device().await;
    let daemon = start(config(&[address], &[("A", 0, 10)])).await;
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "diagnosis", "A").await;
    daemon.app.reload(config(&[address], &[("A", 0, 50)])).await.expect("a sound configuration");
    heard(&mut events, "reloaded", "").await;
    heard(&mut events, "diagnosis", "A").await;
    let samples = daemon.json("/api/v1/loops/A/samples").await;
    let ops = samples["tags"][0]["value"].as_array().expect("a column");
    assert!(!ops.is_empty() && ops.iter().all(|op| op.is_null() || *op == 50.0), "{samples}");
    assert_eq!(registers.connections.load(Ordering::Relaxed), 2);
    daemon.app.stop().cancel();
    daemon.task.await.expect("no panic").expect("ends well");
}

#[tokio::test]
async fn an_address_that_the_network_reaches_is_refused_before_anything_is_served() {
    let (address, _) = device().await;
    let clock = Clock::wall();
    let app = App::build(config(&[address], &[("A", 0, 10)]), clock, App::diagnosis()).expect("sound");
    let listener = TcpListener::bind("0.0.0.0:0").await.expect("a free port");
    let refused = app.run(listener).await;
    assert!(matches!(refused, Err(AppError::Serve(serve::ServeError::Unguarded(_)))), "{refused:?}");
}

#[tokio::test]
async fn a_configuration_that_cannot_be_polled_is_refused_and_the_old_one_stays() {
    let (address, _) = device().await;
    let daemon = start(config(&[address], &[("A", 0, 10)])).await;
    let mut bad = config(&[address], &[("B", 0, 10)]);
    bad.modbus[0].poll_ms = 0;
    assert!(matches!(daemon.app.reload(bad).await, Err(AppError::Plan(_))));
    assert_eq!(daemon.json("/api/v1/loops").await["items"][0]["id"], "A");
    daemon.app.stop().cancel();
    daemon.task.await.expect("no panic").expect("ends well");
}
