//! The peers of the collector's tests: a pymodbus server in a process of its own, a proxy that cuts
//! connections, and a sink that a test can wait on.

mod piped;

use piped::{python, spawn};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use stictiond::collect::modbus::{Collector, Config, Plan, TagSpec};
use stictiond::collect::{DeviceHealth, Poll, Sink, SystemClock};
use stictiond::signal::Sample;
use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::net::{TcpListener, TcpStream};
use tokio::process::{Child, ChildStdin, ChildStdout};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

/// Far longer than anything here takes even on a busy machine; a test that waits so long has failed.
const PATIENCE: Duration = Duration::from_secs(30);

/// tests/peers/modbus_server.py, killed when dropped.
pub struct Server {
    child: Child,
    commands: ChildStdin,
    lines: Lines<BufReader<ChildStdout>>,
    /// Where it listens.
    pub port: u16,
    /// Counters of answers given late.
    pub late: Vec<u64>,
}

impl Server {
    pub async fn start(port: u16, epoch: u32) -> Self {
        Self::with(port, epoch, &[]).await
    }

    /// With further arguments of the program.
    pub async fn with(port: u16, epoch: u32, more: &[&str]) -> Self {
        let arguments = ["--port", &port.to_string(), "--epoch", &epoch.to_string()];
        let (child, commands, lines) = spawn(python("modbus_server.py").args(arguments).args(more));
        let mut server = Self { child, commands, lines, port: 0, late: Vec::new() };
        let line = server.line().await;
        server.port = line.strip_prefix("port ").unwrap().parse().unwrap();
        server
    }

    async fn line(&mut self) -> String {
        let line = timeout_at(Instant::now() + PATIENCE, self.lines.next_line()).await;
        let line = line.expect("the server says nothing").unwrap().expect("the server ended");
        assert_ne!(line, "written", "the collector wrote to the device");
        if let Some(counter) = line.strip_prefix("late ") {
            self.late.push(counter.parse().unwrap());
        }
        line
    }

    /// Gives a command and waits until it holds.
    pub async fn tell(&mut self, command: &str) {
        self.commands.write_all(format!("{command}\n").as_bytes()).await.unwrap();
        while self.line().await != "ok" {}
    }

    pub async fn kill(mut self) {
        self.child.kill().await.unwrap();
    }
}

/// Passes bytes on to a server until it is told to cut an answer short or to close after one.
pub struct Proxy {
    pub port: u16,
    /// Bytes of answers still passed on before the connection is cut; `usize::MAX` for ever.
    allowance: Arc<AtomicUsize>,
    /// Connections open now, and the most there ever were at once.
    open: Arc<AtomicUsize>,
    most: Arc<AtomicUsize>,
}

impl Proxy {
    pub async fn start(server: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let allowance = Arc::new(AtomicUsize::new(usize::MAX));
        let shared = Arc::clone(&allowance);
        let (open, most) = (Arc::<AtomicUsize>::default(), Arc::<AtomicUsize>::default());
        let (now, ever) = (Arc::clone(&open), Arc::clone(&most));
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let upstream = TcpStream::connect(("127.0.0.1", server)).await.unwrap();
                ever.fetch_max(1 + now.fetch_add(1, Ordering::SeqCst), Ordering::SeqCst);
                let (shared, now) = (Arc::clone(&shared), Arc::clone(&now));
                tokio::spawn(async move {
                    pass_on(client, upstream, shared).await;
                    now.fetch_sub(1, Ordering::SeqCst);
                });
            }
        });
        Self { port, allowance, open, most }
    }

    /// Connections open now, and the most there ever were at once.
    pub fn connections(&self) -> (usize, usize) {
        (self.open.load(Ordering::SeqCst), self.most.load(Ordering::SeqCst))
    }

    /// Passes on `bytes` more bytes of answers, then cuts the connection, once.
    pub fn cut_after(&self, bytes: usize) {
        self.allowance.store(bytes, Ordering::SeqCst);
    }
}

async fn pass_on(mut client: TcpStream, mut server: TcpStream, allowance: Arc<AtomicUsize>) {
    let (mut asked, mut answered) = ([0u8; 1024], [0u8; 1024]);
    loop {
        tokio::select! {
            Ok(n) = client.read(&mut asked) => {
                if n == 0 { return; }
                server.write_all(&asked[..n]).await.unwrap();
            }
            Ok(n @ 1..) = server.read(&mut answered) => {
                let left = allowance.load(Ordering::SeqCst);
                let _ = client.write_all(&answered[..n.min(left)]).await;
                if left != usize::MAX {
                    let rest = left.saturating_sub(n);
                    allowance.store(if rest == 0 { usize::MAX } else { rest }, Ordering::SeqCst);
                    if rest == 0 { return; }
                }
            }
            else => return,
        }
    }
}

/// What a collector handed over.
#[derive(Clone, Copy, Debug)]
pub enum Event {
    Sample(usize, Sample),
    Poll(Poll),
}

struct Recorder(UnboundedSender<Event>);

impl Sink for Recorder {
    fn sample(&self, tag: usize, sample: Sample) {
        let _ = self.0.send(Event::Sample(tag, sample));
    }
    fn poll(&self, _device: usize, poll: Poll) {
        let _ = self.0.send(Event::Poll(poll));
    }
}

/// A running collector and what it handed over.
pub struct Watch {
    events: UnboundedReceiver<Event>,
    pub health: Arc<DeviceHealth>,
    stop: CancellationToken,
    task: tokio::task::JoinHandle<()>,
    tags: usize,
}

impl Watch {
    pub fn start(plan: Plan) -> Self {
        Self::with_clock(plan, Arc::new(SystemClock))
    }

    pub fn with_clock(plan: Plan, clock: Arc<dyn stictiond::collect::Clock>) -> Self {
        let (sender, events) = unbounded_channel();
        let stop = CancellationToken::new();
        let tags = plan.tags.len();
        let collector = Collector::new(plan, clock, 7);
        let health = collector.health();
        let task = tokio::spawn(collector.run(Arc::new(Recorder(sender)), stop.clone()));
        Self { events, health, stop, task, tags }
    }

    /// The samples of the next whole poll, by tag. Every poll must bring every tag exactly once.
    pub async fn poll(&mut self) -> Vec<Sample> {
        let mut samples: Vec<Option<Sample>> = vec![None; self.tags];
        loop {
            match timeout_at(Instant::now() + PATIENCE, self.events.recv()).await.expect("no poll").unwrap() {
                Event::Sample(tag, sample) => {
                    assert_eq!(samples[tag].replace(sample), None, "tag {tag} twice in one poll");
                }
                Event::Poll(poll) => {
                    let samples: Vec<Sample> =
                        samples.into_iter().map(|s| s.expect("a tag without a sample")).collect();
                    assert_eq!(poll.good + poll.bad, samples.len());
                    return samples;
                }
            }
        }
    }

    /// Polls until one satisfies the condition; returns them all, that one last.
    pub async fn until(&mut self, what: &str, condition: impl Fn(&[Sample]) -> bool) -> Vec<Vec<Sample>> {
        let deadline = Instant::now() + PATIENCE;
        let mut polls = Vec::new();
        loop {
            let poll = self.poll().await;
            let done = condition(&poll);
            polls.push(poll);
            if done {
                return polls;
            }
            assert!(Instant::now() < deadline, "never {what}: last {:?}", polls.last());
        }
    }

    pub async fn stop(self) {
        self.stop.cancel();
        timeout_at(Instant::now() + PATIENCE, self.task).await.expect("does not stop").unwrap();
    }
}

/// A device at `port` with further lines of configuration.
pub fn device(port: u16, more: &str) -> Config {
    let defaults = if more.contains("address_base") { "" } else { "address_base = 0\n" };
    toml::from_str(&format!("name = 'dut'\naddress = '127.0.0.1:{port}'\n{defaults}{more}")).unwrap()
}

/// The plan with a time-out that only a dead peer reaches, for tests of anything but time-outs.
pub fn patient(mut plan: Plan) -> Plan {
    plan.timeout = PATIENCE / 3;
    plan
}

/// A plan for the tags, each given as its configuration.
pub fn plan(config: &Config, tags: &[String]) -> Plan {
    let specs = tags.iter().enumerate().map(|(index, text)| TagSpec {
        index,
        name: format!("tag {index}"),
        role: None,
        config: toml::from_str(&format!("device = 'dut'\n{text}")).unwrap(),
        frozen_after_s: None,
    });
    Plan::new(0, config, specs.collect()).unwrap()
}

/// The tag of a register that tells the truth of itself, see modbus_server.py.
pub fn truth_tag(address: u16) -> String {
    format!("register = 'holding'\naddress = {address}\ntype = 'f64'")
}

/// The truth that a register pair of the server tells of itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    pub address: u64,
    pub epoch: u64,
    pub counter: u64,
}

fn truth(sample: &Sample) -> Truth {
    let whole = sample.value as u64;
    assert_eq!(whole as f64, sample.value, "torn: {sample:?}");
    Truth {
        address: whole / 1_000_000_000_000,
        epoch: whole / 1_000_000_000 % 1000,
        counter: whole % 1_000_000_000,
    }
}

/// Checks every good sample of the polls against what it says of itself; returns (poll, tag, truth) of each.
/// A sample that is not good carries no value at all.
pub fn checked(polls: &[Vec<Sample>], addresses: &[u16]) -> Vec<(usize, usize, Truth)> {
    let mut found: Vec<(usize, usize, Truth)> = Vec::new();
    for (number, poll) in polls.iter().enumerate() {
        for (tag, sample) in poll.iter().enumerate() {
            if sample.quality.is_good() {
                let truth = truth(sample);
                assert_eq!(truth.address, u64::from(addresses[tag]), "another register's value");
                let before = found.iter().rev().find(|(_, t, _)| *t == tag);
                if let Some((_, _, before)) = before {
                    let newer = (truth.epoch, truth.counter) > (before.epoch, before.counter);
                    assert!(newer, "an old answer came again: {truth:?} after {before:?}");
                }
                found.push((number, tag, truth));
            } else {
                assert!(sample.value.is_nan(), "invented: {sample:?}");
            }
        }
    }
    found
}

/// Answers every request on every connection with what `reply` makes of it, then hangs up.
pub async fn hostile(reply: impl Fn(&[u8]) -> Vec<u8> + Send + 'static) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    tokio::spawn(async move {
        while let Ok((mut client, _)) = listener.accept().await {
            let mut request = [0u8; 12];
            if client.read_exact(&mut request).await.is_ok() {
                let _ = client.write_all(&reply(&request)).await;
            }
        }
    });
    port
}
