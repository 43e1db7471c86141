//! The plant's Modbus/TCP server: four units behind one listener on loopback. It takes writes only where the demo shows
//! write-back, into the registers of the terms.

use super::dcs::{self, Dcs};
use super::registers::{Device, devices};
use crate::collect::modbus::Register;
use crate::sim::{DemoLoop, LoopSim, Point, SpecError};
use std::future::{Ready, ready};
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_modbus::server::{Service, tcp::Server};
use tokio_modbus::{ExceptionCode, Request, Response, SlaveRequest};
use tokio_util::sync::CancellationToken;

/// Plant time simulated before anybody looks (s): the set-point steps that start the loops are long over.
const WARM_UP_S: f64 = 2000.0;
/// Most samples simulated for one request; a plant left alone for longer goes on from where it was.
const MAX_STEPS: u64 = 100_000;

/// Plant time since the start.
pub(super) type Elapsed = Arc<dyn Fn() -> Duration + Send + Sync>;

/// The plant at work; it runs on when somebody asks.
pub(super) struct Station {
    loops: Vec<DemoLoop>,
    devices: Vec<Device>,
    elapsed: Elapsed,
    ts_s: f64,
    /// Whether there are registers to write to.
    writable: bool,
    state: Mutex<State>,
}

struct State {
    sims: Vec<LoopSim>,
    points: Vec<Point>,
    steps: u64,
    ts_s: f64,
    automatic: Vec<bool>,
    dcs: Dcs,
}

impl Station {
    /// A plant that has run for a while and goes on as `elapsed` does.
    ///
    /// # Errors
    /// [`SpecError`] where a loop makes no sense.
    pub(super) fn new(
        loops: Vec<DemoLoop>,
        ts_s: f64,
        elapsed: Elapsed,
        heartbeat_s: Option<f64>,
    ) -> Result<Self, SpecError> {
        let sims =
            loops.iter().map(|demo| LoopSim::new(&demo.spec, demo.seed)).collect::<Result<Vec<_>, _>>()?;
        let mut state = State {
            points: vec![Point::default(); sims.len()],
            steps: 0,
            ts_s,
            automatic: loops.iter().map(DemoLoop::in_automatic).collect(),
            dcs: Dcs::new(sims.len(), heartbeat_s.unwrap_or(0.0)),
            sims,
        };
        state.run((WARM_UP_S / ts_s) as u64);
        state.steps = 0;
        let devices = devices(&loops);
        Ok(Self { loops, devices, elapsed, ts_s, writable: heartbeat_s.is_some(), state: Mutex::new(state) })
    }

    /// Answers requests until `stop` is cancelled.
    ///
    /// # Errors
    /// When the listener fails.
    pub(super) async fn serve(
        self: Arc<Self>,
        listener: TcpListener,
        stop: CancellationToken,
    ) -> io::Result<()> {
        let connected = |stream: tokio::net::TcpStream, _: SocketAddr| {
            let station = Arc::clone(&self);
            async move {
                // Answers are small and awaited: Nagle's algorithm would only delay them.
                stream.set_nodelay(true)?;
                Ok(Some((station, stream)))
            }
        };
        let failed = |error: io::Error| tracing::debug!(%error, "a connection to the simulated plant ended");
        Server::new(listener).serve_until(&connected, failed, stop.cancelled_owned()).await?;
        Ok(())
    }

    /// The registers asked for, as they are now.
    fn read(&self, unit_id: u8, table: Register, start: u16, count: u16) -> Result<Vec<u16>, ExceptionCode> {
        let device = self.devices.iter().find(|device| device.unit_id == unit_id);
        let device = device.ok_or(ExceptionCode::GatewayTargetDevice)?;
        let state = self.now();
        if self.writable && table == Register::Holding && start >= dcs::FIRST {
            let image: Vec<u16> = state.dcs.image().collect();
            let start = usize::from(start - dcs::FIRST);
            let words = image.get(start..start + usize::from(count));
            return Ok(words.ok_or(ExceptionCode::IllegalDataAddress)?.to_vec());
        }
        let image = device.image(table, &self.loops, &state.points);
        drop(state);
        let image = image.ok_or(ExceptionCode::IllegalFunction)?;
        let start = usize::from(start);
        let words = image.get(start..start + usize::from(count));
        Ok(words.ok_or(ExceptionCode::IllegalDataAddress)?.to_vec())
    }

    /// The plant, run on to this moment.
    fn now(&self) -> MutexGuard<'_, State> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let due = ((self.elapsed)().as_secs_f64() / self.ts_s) as u64 + 1;
        let behind = due.saturating_sub(state.steps);
        state.run(behind.min(MAX_STEPS));
        state.steps = state.steps.max(due);
        state
    }

    fn write(&self, start: u16, words: &[u16]) -> Result<(), ExceptionCode> {
        if !self.writable {
            return Err(ExceptionCode::IllegalFunction);
        }
        let mut state = self.now();
        let now = state.steps as f64 * self.ts_s;
        if state.dcs.write(start, words, now) { Ok(()) } else { Err(ExceptionCode::IllegalDataAddress) }
    }

    fn answer(&self, request: &SlaveRequest<'_>) -> Result<Response, ExceptionCode> {
        let words = |table, start, count| self.read(request.slave, table, start, count);
        let bits = |table, start, count| -> Result<Vec<bool>, ExceptionCode> {
            Ok(words(table, start, count)?.iter().map(|&bit| bit != 0).collect())
        };
        Ok(match request.request {
            Request::ReadHoldingRegisters(start, count) => {
                Response::ReadHoldingRegisters(words(Register::Holding, start, count)?)
            }
            Request::ReadInputRegisters(start, count) => {
                Response::ReadInputRegisters(words(Register::Input, start, count)?)
            }
            Request::ReadCoils(start, count) => Response::ReadCoils(bits(Register::Coil, start, count)?),
            Request::ReadDiscreteInputs(start, count) => {
                Response::ReadDiscreteInputs(bits(Register::Discrete, start, count)?)
            }
            Request::WriteMultipleRegisters(start, ref words) => {
                self.write(start, words)?;
                Response::WriteMultipleRegisters(start, words.len() as u16)
            }
            _ => return Err(ExceptionCode::IllegalFunction),
        })
    }
}

impl State {
    fn run(&mut self, steps: u64) {
        for at in 0..self.sims.len() {
            for step in self.steps..self.steps + steps {
                let term = self.dcs.term(at, step as f64 * self.ts_s, self.automatic[at]);
                self.points[at] = self.sims[at].step_with(term);
            }
        }
        self.steps += steps;
    }
}

impl Service for Station {
    type Request = SlaveRequest<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        ready(self.answer(&request))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::demo_plant;
    use std::sync::atomic::{AtomicU64, Ordering};

    fn station() -> (Station, Arc<AtomicU64>) {
        let now = Arc::new(AtomicU64::new(0));
        let clock = Arc::clone(&now);
        let elapsed: Elapsed = Arc::new(move || Duration::from_millis(clock.load(Ordering::Relaxed)));
        (Station::new(demo_plant(1), 0.5, elapsed, None).expect("the plant is valid"), now)
    }

    fn flow_pv(station: &Station) -> f32 {
        let words = station.read(1, Register::Holding, 102, 2).expect("exists");
        f32::from_bits(u32::from(words[0]) << 16 | u32::from(words[1]))
    }

    #[test]
    fn the_plant_moves_with_its_clock_and_only_with_it() {
        let (station, now) = station();
        let first = flow_pv(&station);
        assert_eq!(flow_pv(&station), first);
        now.store(499, Ordering::Relaxed);
        assert_eq!(flow_pv(&station), first);
        now.store(500, Ordering::Relaxed);
        assert_ne!(flow_pv(&station), first);
        // The same loop stepped by hand: 4,000 samples of warm-up, the one shown at 0 s, the one at 0.5 s.
        let demo = &demo_plant(1)[0];
        let mut sim = LoopSim::new(&demo.spec, demo.seed).expect("valid");
        let by_hand = (0..4002).map(|_| sim.step().pv).last().map(|pv| pv as f32);
        assert_eq!(Some(flow_pv(&station)), by_hand);
    }

    #[test]
    fn what_does_not_exist_is_refused() {
        let (station, _) = station();
        let refused = |unit, table, start| station.read(unit, table, start, 1).err();
        assert_eq!(refused(1, Register::Holding, 0), None);
        assert_eq!(refused(1, Register::Holding, 5000), Some(ExceptionCode::IllegalDataAddress));
        assert_eq!(refused(1, Register::Coil, 0), Some(ExceptionCode::IllegalFunction));
        assert_eq!(refused(9, Register::Holding, 0), Some(ExceptionCode::GatewayTargetDevice));
        let write = SlaveRequest { slave: 1, request: Request::WriteSingleRegister(100, 7) };
        assert_eq!(station.answer(&write), Err(ExceptionCode::IllegalFunction));
        let write =
            SlaveRequest { slave: 1, request: Request::WriteMultipleRegisters(1000, vec![0, 0].into()) };
        assert_eq!(station.answer(&write), Err(ExceptionCode::IllegalFunction), "without write-back");
    }

    #[test]
    fn a_term_moves_the_valve_of_its_loop_and_no_other() {
        let elapsed: Elapsed = Arc::new(|| Duration::from_secs(5));
        let still = Station::new(demo_plant(1), 0.5, elapsed.clone(), Some(2.0)).expect("valid");
        let moved = Station::new(demo_plant(1), 0.5, elapsed, Some(2.0)).expect("valid");
        let (term, beat) = (1000 + 4 * 3, 1002 + 4 * 3);
        // From 0, as write-back begins.
        let writes = [(term, vec![0, 0]), (beat, vec![7]), (term, vec![0x4000, 0]), (beat, vec![8])];
        for (start, words) in writes {
            let request = Request::WriteMultipleRegisters(start, words.into());
            moved.answer(&SlaveRequest { slave: 1, request }).expect("writable");
        }
        let stems = |station: &Station| {
            let mut state = station.now();
            // 2 s of heartbeat and one step more.
            let first = {
                state.run(1);
                state.points.clone()
            };
            state.run(4);
            let term = state.dcs.term(3, state.steps as f64 * 0.5, true);
            (first, term)
        };
        let ((still, _), (moved, late)) = (stems(&still), stems(&moved));
        for at in 0..still.len() {
            // 2 % is 4000_0000; the fourth loop's valve is sound.
            let by = moved[at].mv - still[at].mv;
            assert!((by - if at == 3 { 2.0 } else { 0.0 }).abs() < 1e-9, "{at}: {by}");
        }
        assert_eq!(late, 0.0, "the heart stands still");
    }
}
