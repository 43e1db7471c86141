//! A plant of any number of loops behind Modbus servers, and the sections of a configuration that watch it.

use super::Failed;
use std::future;
use std::io::{Read, Write};
use std::sync::Arc;
use std::time::Instant;
use stictiond::sim::scenarios::{Scenario, calibration, random_sound};
use stictiond::sim::{Load, LoadKind, Run};
use tokio::net::TcpListener;
use tokio_modbus::prelude::*;
use tokio_modbus::server::tcp::{Server, accept_tcp_connection};

pub const DEVICES: usize = 8;
/// Excited loops that differ.
const RECORDS: u64 = 48;
/// Samples of the record of each: so long that a loop is hardly seen at the seam.
const SAMPLES: usize = 48_000;
/// Registers of a loop: OP, PV and the set point, two for each.
const REGISTERS: usize = 6;
/// One loop in so many flaps: its PV is no number in every other stretch of so many seconds.
const FLAPPING: usize = 20;
const FLAP_S: usize = 45;

/// `[[modbus]]` and `[[loop]]` of a plant.
pub fn sections(addresses: &[String], loops: usize, poll_ms: f64) -> String {
    let mut text = String::new();
    for (at, address) in addresses.iter().enumerate() {
        text += &format!(
            "[[modbus]]\nname = \"d{at}\"\naddress = \"{address}\"\npoll_ms = {poll_ms}\ntimeout_ms = {poll_ms}\naddress_base = 0\n"
        );
    }
    for at in 0..loops {
        let (device, register) = (at % DEVICES, at / DEVICES * REGISTERS);
        text += &format!("[[loop]]\nid = \"L{at:04}\"\nop_span = 100.0\n");
        for (role, address) in [("op", register), ("pv", register + 2), ("sp", register + 4)] {
            text += &format!(
                "[loop.{role}]\ndevice = \"d{device}\"\nregister = \"holding\"\naddress = {address}\ntype = \"f32\"\n"
            );
        }
    }
    text
}

/// Loop l of a device has OP in registers 6l and 6l + 1, PV in the next two, its set point in the last, and replays one of the
/// records.
#[derive(Clone)]
struct Plant {
    records: Arc<Vec<Run>>,
    start: Instant,
    speed: f64,
    device: usize,
    flaps: bool,
}

impl Plant {
    fn register(&self, register: u16, now: usize) -> u16 {
        let (own, within) = (usize::from(register) / REGISTERS, usize::from(register) % REGISTERS);
        let at = own * DEVICES + self.device;
        let record = &self.records[at % self.records.len()];
        let values = [&record.op, &record.pv, &record.sp][within / 2];
        let mut value = values[(now + 7 * at) % values.len()] as f32;
        if self.flaps
            && within / 2 == 1
            && at.is_multiple_of(FLAPPING)
            && ((now + at) / FLAP_S).is_multiple_of(2)
        {
            value = f32::NAN;
        }
        let bits = value.to_bits();
        if register.is_multiple_of(2) { (bits >> 16) as u16 } else { bits as u16 }
    }
}

impl tokio_modbus::server::Service for Plant {
    type Request = Request<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = future::Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        let now = (self.start.elapsed().as_secs_f64() * self.speed) as usize;
        future::ready(match request {
            Request::ReadHoldingRegisters(start, count) => Ok(Response::ReadHoldingRegisters(
                (start..start + count).map(|r| self.register(r, now)).collect(),
            )),
            _ => Err(ExceptionCode::IllegalFunction),
        })
    }
}

/// Loops that replay long records: a third of sticking valves, a third of sound ones that a load drives, a third at rest.
pub fn excited() -> Vec<Scenario> {
    let scenario = |seed: u64| {
        let mut scenario = if seed.is_multiple_of(3) { calibration(seed) } else { random_sound(seed) };
        scenario.n = SAMPLES + scenario.warm_up;
        let spec = &mut scenario.spec;
        if !seed.is_multiple_of(3) {
            spec.loads.clear();
            spec.sp_schedule.clear();
            spec.sp = spec.pv0;
        }
        if seed % 3 == 1 {
            spec.loads.push(Load::input(LoadKind::Sine {
                amplitude: 2.0,
                period_s: (40 + seed) as f64 * spec.ts_s,
                phase: 0.0,
                growth_per_s: 0.0,
            }));
        }
        scenario
    };
    (0..RECORDS).map(scenario).collect()
}

/// A process of its own: prints its addresses and serves until its standard input is closed.
pub async fn serve(speed: f64, flaps: bool, scenarios: &[Scenario]) -> Result<(), Failed> {
    let records: Result<Vec<Run>, _> = scenarios.iter().map(Scenario::run).collect();
    let plant = Plant { records: Arc::new(records?), start: Instant::now(), speed, device: 0, flaps };
    for device in 0..DEVICES {
        let listener = TcpListener::bind("127.0.0.1:0").await?;
        println!("{}", listener.local_addr()?);
        let plant = Plant { device, ..plant.clone() };
        tokio::spawn(async move {
            let connected = |stream, peer| {
                let plant = plant.clone();
                async move { accept_tcp_connection(stream, peer, move |_| Ok(Some(plant.clone()))) }
            };
            Server::new(listener).serve(&connected, |_| {}).await
        });
    }
    std::io::stdout().flush()?;
    tokio::task::spawn_blocking(|| std::io::stdin().read(&mut [0])).await??;
    Ok(())
}
