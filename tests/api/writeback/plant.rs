//! A plant with one sticking valve, its DCS, and a link that can be cut: what write-back is tested against.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use stictiond::compensation::gate::Inputs;
use stictiond::demo::dcs::{self, Dcs};
use stictiond::signal::Sample;
use stictiond::sim::{DemoLoop, LoopSim, Point, demo_plant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_modbus::server::{Service, tcp::Server};
use tokio_modbus::{ExceptionCode, Request, Response};

/// Plant time over wall time: a sample of the controller, 0.5 s, every 25 ms.
pub const SPEED: f64 = 20.0;
/// A heartbeat that stands still for longer drops the term (s on the wall).
pub const HEARTBEAT_S: f64 = 4.0;

/// What is wrong with the plant.
#[derive(Default)]
pub struct Faults {
    /// Writes are acknowledged and forgotten.
    pub ignores_writes: AtomicBool,
    /// The transmitter repeats its last value.
    pub pv_frozen: AtomicBool,
    /// The controller is in manual, as far as its mode register says.
    pub manual: AtomicBool,
}

/// The plant; it runs on when somebody asks.
pub struct Plant {
    pub faults: Faults,
    began: Instant,
    state: Mutex<State>,
}

struct State {
    sim: LoopSim,
    point: Point,
    pv: f64,
    steps: u64,
    dcs: Dcs,
}

/// The level loop with strong stiction.
pub fn sticky() -> DemoLoop {
    demo_plant(1).into_iter().find(|own| own.id == "LIC201").expect("in the demo's plant")
}

impl Plant {
    pub fn start() -> Arc<Self> {
        let own = sticky();
        let mut sim = LoopSim::new(&own.spec, own.seed).expect("valid");
        let point = (0..4000).map(|_| sim.step()).last().expect("steps");
        let state = State { sim, point, pv: point.pv, steps: 0, dcs: Dcs::new(1, HEARTBEAT_S) };
        Arc::new(Self { faults: Faults::default(), began: Instant::now(), state: Mutex::new(state) })
    }

    /// Listens, until the runtime ends.
    pub async fn listen(self: &Arc<Self>) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("bound");
        let plant = Arc::clone(self);
        tokio::spawn(async move {
            let connected = |stream: TcpStream, _: SocketAddr| {
                let plant = Peer(Arc::clone(&plant));
                async move { stream.set_nodelay(true).map(|()| Some((plant, stream))) }
            };
            Server::new(listener).serve(&connected, |_| ()).await
        });
        address
    }

    fn now(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Runs the plant on to this moment and looks at it.
    fn look<T>(&self, with: impl FnOnce(&mut State, f64) -> T) -> T {
        let now = self.now();
        let mut state = self.state.lock().expect("whole");
        let due = (now * SPEED / 0.5) as u64;
        while state.steps < due {
            let at = state.steps as f64 * 0.5 / SPEED;
            // The DCS would drop the term in manual by itself: here it must be the daemon.
            let term = state.dcs.term(0, at, true);
            state.point = state.sim.step_with(term);
            state.steps += 1;
        }
        if !self.faults.pv_frozen.load(SeqCst) {
            state.pv = state.point.pv;
        }
        with(&mut state, now)
    }

    /// The term that is added to OP now [%], and the one that stands in the register.
    pub fn term(&self) -> (f64, f64) {
        self.look(|state, now| (state.dcs.term(0, now, true), state.dcs.written(0)))
    }

    /// The loop as a collector without delay would hand it on, at `wall` (s).
    pub fn inputs(&self, wall: f64) -> Inputs {
        self.look(|state, _| {
            let sample = |value| Some(Sample::good(wall, value));
            Inputs {
                op: sample(state.point.op),
                pv: sample(state.pv),
                sp: sample(state.point.sp),
                mode: sample(1.0),
                ..Inputs::default()
            }
        })
    }

    fn answer(&self, request: &Request) -> Result<Response, ExceptionCode> {
        match request {
            Request::ReadHoldingRegisters(start, count) => {
                let image: Vec<u16> = self.look(|state, _| {
                    let float = |value: f64| {
                        let bits = (value as f32).to_bits();
                        [(bits >> 16) as u16, bits as u16]
                    };
                    let mode = u16::from(!self.faults.manual.load(SeqCst));
                    let own = [float(state.point.op), float(state.pv), float(state.point.sp), [mode, 0]];
                    let mut image = own.concat();
                    image.resize(usize::from(dcs::FIRST), 0);
                    image.extend(state.dcs.image());
                    image
                });
                let words = image.get(usize::from(*start)..usize::from(start + count));
                Ok(Response::ReadHoldingRegisters(words.ok_or(ExceptionCode::IllegalDataAddress)?.to_vec()))
            }
            Request::WriteMultipleRegisters(start, words) => {
                let ignored = self.faults.ignores_writes.load(SeqCst);
                let taken = self.look(|state, now| ignored || state.dcs.write(*start, words, now));
                let answer = Response::WriteMultipleRegisters(*start, words.len() as u16);
                if taken { Ok(answer) } else { Err(ExceptionCode::IllegalDataAddress) }
            }
            _ => Err(ExceptionCode::IllegalFunction),
        }
    }
}

struct Peer(Arc<Plant>);

impl Service for Peer {
    type Request = tokio_modbus::SlaveRequest<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = std::future::Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        std::future::ready(self.0.answer(&request.request))
    }
}

/// Between daemon and plant; it can cut a connection in the middle of a request that writes.
pub struct Link {
    pub address: SocketAddr,
    /// Writes still to be cut; `usize::MAX` for all.
    cuts: Arc<AtomicUsize>,
}

impl Link {
    pub async fn start(plant: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("bound");
        let cuts = Arc::new(AtomicUsize::new(0));
        let shared = Arc::clone(&cuts);
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let server = TcpStream::connect(plant).await.expect("the plant listens");
                // One small segment a request: waiting for more would delay each by 40 ms.
                client.set_nodelay(true).and_then(|()| server.set_nodelay(true)).expect("set");
                tokio::spawn(pass_on(client, server, Arc::clone(&shared)));
            }
        });
        Self { address, cuts }
    }

    pub fn cut_writes(&self, count: usize) {
        self.cuts.store(count, SeqCst);
    }

    pub fn cuts_left(&self) -> usize {
        self.cuts.load(SeqCst)
    }
}

async fn pass_on(mut client: TcpStream, mut server: TcpStream, cuts: Arc<AtomicUsize>) {
    let (mut asked, mut answered) = ([0u8; 1024], [0u8; 1024]);
    loop {
        tokio::select! {
            Ok(n @ 1..) = client.read(&mut asked) => {
                // Function 16 is the eighth byte of a request; half of it goes on, then the cable is cut.
                let write = n > 8 && asked[7] == 16;
                let cut = write && cuts.fetch_update(SeqCst, SeqCst, |left| match left {
                    0 => None,
                    usize::MAX => Some(left),
                    left => Some(left - 1),
                }).is_ok();
                let whole = if cut { n / 2 } else { n };
                if server.write_all(&asked[..whole]).await.is_err() || cut {
                    return;
                }
            }
            Ok(n @ 1..) = server.read(&mut answered) => {
                if client.write_all(&answered[..n]).await.is_err() {
                    return;
                }
            }
            else => return,
        }
    }
}

/// Waits until something holds; how long that took. Looks every 2 ms: the plant has no event to wait for.
pub async fn until(what: &str, patience: Duration, mut holds: impl FnMut() -> bool) -> Duration {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < patience, "never {what}");
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    began.elapsed()
}
