//! `stictiond demo`: a simulated plant behind a real Modbus/TCP server on loopback, and the daemon watching it as it
//! would watch any plant, from a configuration. Plant time runs `speed` times as fast as the wall clock, and waits for a
//! computer that pauses.

pub mod dcs;
mod operators;
mod registers;
mod server;
mod table;

use crate::app::{self, App, AppError};
use crate::config;
use crate::results::Results;
use crate::schedule::Clock;
use crate::serve::WritebackPort;
use crate::signal::LoopId;
use crate::sim::demo_plant::TS_S;
use crate::sim::{DemoLoop, SpecError, demo_plant};
use registers::Pace;
use server::Station;
use std::io::{self, IsTerminal, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use table::Row;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// How many times faster than the wall clock plant time runs, where nobody says.
pub const DEFAULT_SPEED: f64 = 80.0;
/// … and with write-back, where every sample of the controllers is polled and answered.
pub const WRITEBACK_SPEED: f64 = 20.0;
/// Speeds that the polls can follow.
pub const SPEEDS: std::ops::RangeInclusive<f64> = 1.0..=200.0;
/// Plant time between two polls (s): four samples of the controllers, as a historian sees them.
const POLL_S: f64 = 2.0;
/// … with write-back: every sample, because a term that comes late is a term for another OP.
const WRITEBACK_POLL_S: f64 = TS_S;
/// Time between two diagnoses of a loop (s on the wall clock).
const DIAGNOSE_EVERY_S: f64 = 10.0;
/// How often the table is drawn again on a terminal, and at most printed elsewhere.
const REDRAW: Duration = Duration::from_millis(500);
const PRINT: Duration = Duration::from_secs(5);

/// Plant time that no run lasts for: 136 years.
const FOR_EVER: Duration = Duration::from_secs(u32::MAX as u64);
/// What is said where nobody can poll the plant any more.
const PLANT_FAILED: &str = "the simulated plant's server failed";

/// What the command line says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Where API and dashboard are shown.
    pub listen: SocketAddr,
    /// Plant time over wall time, within [`SPEEDS`].
    pub speed: f64,
    /// Seed of the plant's noise and loads.
    pub seed: u64,
    /// Whether the sticky loops are reinforced.
    pub writeback: bool,
}

/// Why the demo does not run.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// The speed cannot be followed.
    #[error("--speed {0} must be 1 to 200")]
    Speed(f64),
    /// The binary only reads.
    #[error("--writeback: this stictiond was built without the cargo feature \"writeback\"")]
    NotBuiltIn,
    /// The plant makes no sense.
    #[error(transparent)]
    Plant(#[from] SpecError),
    /// The daemon does not run.
    #[error(transparent)]
    App(#[from] AppError),
    /// The plant's server, the terminal or the runtime failed.
    #[error("{what}: {source}")]
    Io {
        /// Which.
        what: &'static str,
        /// Why.
        source: io::Error,
    },
}

impl DemoError {
    fn io(what: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { what, source }
    }
}

/// The plant and the daemon, listening and not yet running.
pub struct Demo {
    app: App,
    clock: Clock,
    loops: Vec<DemoLoop>,
    station: Arc<Station>,
    modbus: TcpListener,
    api: TcpListener,
    address: SocketAddr,
    config: String,
    audit: Option<PathBuf>,
}

impl Demo {
    /// Binds both servers and builds the daemon.
    ///
    /// # Errors
    /// [`DemoError`]; a taken address is [`AppError::Bind`].
    pub async fn build(options: &Options) -> Result<Self, DemoError> {
        let Options { listen, speed, seed, writeback } = *options;
        if writeback && !crate::writeback::BUILT_IN {
            return Err(DemoError::NotBuiltIn);
        }
        if !SPEEDS.contains(&speed) {
            return Err(DemoError::Speed(speed));
        }
        let loops = demo_plant(seed);
        let modbus = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await;
        let modbus = modbus.map_err(DemoError::io("cannot listen for the simulated plant"))?;
        let at = modbus.local_addr().map_err(DemoError::io("cannot listen for the simulated plant"))?;
        let poll_s = if writeback { WRITEBACK_POLL_S } else { POLL_S };
        let audit = writeback.then(|| {
            std::env::temp_dir().join(format!("stictiond-demo-{}-{}.log", std::process::id(), at.port()))
        });
        let poll_ms = ((1000.0 * poll_s / speed).round() as u64).max(1);
        let pace = Pace { poll_ms, period_s: DIAGNOSE_EVERY_S * speed, audit };
        let text = registers::config(&loops, listen, at, &pace);
        let config = config::parse("demo", &text).map_err(AppError::Config)?;
        let api = app::listen(&config).await?;
        let address = api.local_addr().map_err(DemoError::io("cannot listen"))?;
        // Late polls are gaps in what is diagnosed and terms for another OP: the plant waits for a computer that pauses.
        let clock = Clock::watched(Clock::wall().now(), speed, Duration::from_millis(poll_ms));
        let heartbeat = writeback.then_some(registers::HEARTBEAT_S);
        let station = Station::new(loops.clone(), TS_S, Arc::new(move || clock.elapsed()), heartbeat)?;
        Ok(Self {
            app: App::build(config, clock, App::diagnosis())?,
            clock,
            loops,
            station: Arc::new(station),
            modbus,
            api,
            address,
            config: text,
            audit: pace.audit,
        })
    }

    /// Where API and dashboard are shown.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The plant's loops and what is true of them.
    pub fn loops(&self) -> &[DemoLoop] {
        &self.loops
    }

    /// The configuration file that `stictiond run` would need to watch the same plant.
    pub fn config(&self) -> &str {
        &self.config
    }

    /// Where write-back is put on record.
    pub fn audit(&self) -> Option<&Path> {
        self.audit.as_deref()
    }

    /// Write-back, as the API sees it.
    pub fn writeback(&self) -> Arc<dyn WritebackPort> {
        self.app.writeback()
    }

    /// The plant's clock. It waits for a computer that pauses, so it goes on only while somebody polls the plant or looks at it.
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// What the diagnoses said.
    pub fn results(&self) -> Arc<Results> {
        Arc::clone(self.app.results())
    }

    /// Cancel it to stop the demo.
    pub fn stop(&self) -> CancellationToken {
        self.app.stop()
    }

    /// Runs the plant alone until [`Demo::stop`] is cancelled: for a daemon elsewhere that watches it by [`Demo::config`].
    ///
    /// # Errors
    /// [`DemoError`] when the plant's server fails.
    pub async fn run_plant(self) -> Result<(), DemoError> {
        let (stop, clock) = (self.app.stop(), self.clock);
        // That daemon has a clock of its own: the plant goes on with the wall, however late a poll comes.
        let going = stop.run_until_cancelled(clock.sleep_until(FOR_EVER));
        let plant = async {
            let served = self.station.serve(self.modbus, stop.clone()).await;
            stop.cancel();
            served.map_err(DemoError::io(PLANT_FAILED))
        };
        let (served, _) = tokio::join!(plant, going);
        served
    }

    /// Runs plant and daemon until [`Demo::stop`] is cancelled, and draws the table on `screen`.
    ///
    /// # Errors
    /// [`DemoError`] when a server or the screen fails; the rest is stopped first.
    pub async fn run(self, mut screen: Screen<impl Write>) -> Result<(), DemoError> {
        let stop = self.app.stop();
        let drawing = View {
            results: self.results(),
            writeback: self.app.writeback(),
            loops: &self.loops,
            clock: self.clock,
            address: self.address,
            audit: self.audit.as_deref(),
        };
        let drawing = async {
            let drawn = drawing.draw(&mut screen, &stop).await;
            stop.cancel();
            match drawn {
                // A reader that stops early (`| head`) is no failure, and nobody is left to watch.
                Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
                drawn => drawn.map_err(DemoError::io("cannot write to the terminal")),
            }
        };
        // The plant outlives the daemon, which still has terms to take back.
        let plant_stop = CancellationToken::new();
        let plant = async {
            let served = self.station.serve(self.modbus, plant_stop.clone()).await;
            stop.cancel();
            served.map_err(DemoError::io(PLANT_FAILED))
        };
        let daemon = async {
            let ran = self.app.run(self.api).await;
            stop.cancel();
            plant_stop.cancel();
            ran.map_err(DemoError::from)
        };
        let operators = operators::work(self.app.writeback(), &self.loops, &stop);
        let (drawn, served, ran, ()) = tokio::join!(drawing, plant, daemon, operators);
        ran.and(served).and(drawn)
    }
}

/// Where the table is drawn.
pub struct Screen<W> {
    out: W,
    in_place: bool,
}

impl<W: Write> Screen<W> {
    /// `in_place`: a terminal, on which the table is drawn over itself. Elsewhere it is printed when a verdict changes.
    pub fn new(out: W, in_place: bool) -> Self {
        Self { out, in_place }
    }

    fn show(&mut self, lines: &[String]) -> io::Result<()> {
        let text = if self.in_place { table::redrawn(lines) } else { lines.join("\n") + "\n\n" };
        self.out.write_all(text.as_bytes()).and_then(|()| self.out.flush())
    }
}

/// What the screen is drawn from.
struct View<'a> {
    results: Arc<Results>,
    writeback: Arc<dyn WritebackPort>,
    loops: &'a [DemoLoop],
    clock: Clock,
    address: SocketAddr,
    audit: Option<&'a Path>,
}

impl View<'_> {
    async fn draw(&self, screen: &mut Screen<impl Write>, stop: &CancellationToken) -> io::Result<()> {
        let mut ticks = tokio::time::interval(if screen.in_place { REDRAW } else { PRINT });
        if screen.in_place {
            screen.out.write_all(b"\x1b[2J")?;
        } else {
            screen.show(&[self.title()])?;
        }
        let (mut before, mut has_told) = (None, vec![false; self.loops.len()]);
        while stop.run_until_cancelled(ticks.tick()).await.is_some() {
            let (lines, verdicts) = self.lines(&mut has_told);
            let said = verdicts.iter().any(Option::is_some);
            let news = (verdicts, self.writeback_states());
            if screen.in_place || (said && before.as_ref() != Some(&news)) {
                screen.show(&lines)?;
                before = Some(news);
            }
        }
        Ok(())
    }

    /// Per loop the state of write-back, and whether a whole stretch with the term has been measured.
    fn writeback_states(&self) -> Vec<Option<(&'static str, bool)>> {
        let status = |demo: &DemoLoop| self.writeback.status(&LoopId::new(demo.id.as_str()));
        self.loops.iter().map(|demo| status(demo).map(|s| (s.state.as_str(), s.with.is_some()))).collect()
    }

    fn title(&self) -> String {
        let address = self.address;
        format!(
            "simulated plant of {} loops; dashboard http://{address}/, API http://{address}/api/v1/loops, Ctrl-C ends it",
            self.loops.len()
        )
    }

    /// The table, and the verdicts in it. `has_told`: of each loop whether a diagnosis has told so far, see [`table::tells`].
    fn lines(&self, has_told: &mut [bool]) -> (Vec<String>, Vec<Option<String>>) {
        let now = self.clock.now();
        let said: Vec<_> = self
            .loops
            .iter()
            .map(|demo| self.results.get(&LoopId::new(demo.id.as_str()), now)?.summary)
            .collect();
        for (has_told, said) in has_told.iter_mut().zip(&said) {
            *has_told |= said.as_ref().is_some_and(table::tells);
        }
        let loops = self.loops.iter().zip(&said).zip(&*has_told);
        let rows: Vec<Row<'_>> =
            loops.map(|((demo, said), &has_told)| Row { demo, said: said.as_ref(), has_told }).collect();
        let mut lines = vec![self.title(), format!("plant time {:.0} s", self.clock.elapsed().as_secs_f64())];
        lines.extend(table::lines(&rows));
        lines.extend(operators::lines(&*self.writeback, self.loops));
        lines.extend(self.audit.map(|audit| format!("on record in {}", audit.display())));
        (lines, rows.iter().map(Row::verdict).collect())
    }
}

/// A configuration of the demo for a daemon beside it, which listens on a port of its own. The whole address is meant: the plant's
/// port may begin with the digits of the demo's.
fn for_another(config: &str, address: SocketAddr) -> String {
    config.replace(&format!("\"{address}\""), "\"127.0.0.1:0\"")
}

/// The command: runs until Ctrl-C, SIGTERM or a failure. With `config_to`, writes there with which configuration another daemon
/// watches the same plant.
///
/// # Errors
/// [`DemoError`].
pub fn command(options: &Options, config_to: Option<&Path>) -> Result<(), DemoError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(DemoError::io("cannot start the runtime"))?;
    let done = runtime.block_on(async {
        let demo = Demo::build(options).await?;
        if let Some(path) = config_to {
            let text = for_another(demo.config(), demo.address());
            let file = std::fs::OpenOptions::new().write(true).create_new(true).open(path);
            file.and_then(|mut file| std::io::Write::write_all(&mut file, text.as_bytes())).map_err(
                DemoError::io("cannot write the configuration (a file that is there is not overwritten)"),
            )?;
        }
        let stop = demo.stop();
        let mut terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())
            .map_err(DemoError::io("cannot listen to signals"))?;
        let signals = async {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => {}
                _ = terminate.recv() => {}
                () = stop.cancelled() => {}
            }
            stop.cancel();
        };
        let out = io::stdout();
        let screen = Screen::new(out.lock(), out.is_terminal());
        let (done, ()) = tokio::join!(demo.run(screen), signals);
        done
    });
    // A diagnosis under way is not waited for: Ctrl-C ends the demo at once.
    runtime.shutdown_background();
    done
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_daemon_beside_the_demo_listens_elsewhere_and_polls_the_same_plant() {
        let config = "[server]\nlisten = \"127.0.0.1:5000\"\n[[modbus]]\naddress = \"127.0.0.1:50001\"\n";
        let expected = "[server]\nlisten = \"127.0.0.1:0\"\n[[modbus]]\naddress = \"127.0.0.1:50001\"\n";
        assert_eq!(for_another(config, SocketAddr::from(([127, 0, 0, 1], 5000))), expected);
    }
}
