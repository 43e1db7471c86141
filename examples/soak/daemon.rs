//! The daemon as `stictiond run` has it, but for one loop whose diagnosis panics, and what it says of itself.

use super::{ALLOCATOR, Failed};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use stictiond::app::{self, App};
use stictiond::config;
use stictiond::schedule::{Clock, Diagnose};
use tokio::signal::unix::{SignalKind, signal};

/// The loop, by its `op_limits`: a record does not know its loop's name.
pub const LIMITS: (f64, f64) = (0.5, 100.5);
/// What the process says on its standard output, a line at a time, to who watches it: the log and the allocator write to another
/// pipe, so nothing runs into it.
/// Before each panic, so that they can be counted by somebody else than the daemon:
pub const PANIC: &str = "panic";
/// Bytes that are allocated and not freed:
pub const ALLOCATED: &str = "allocated ";
/// Time between two such lines.
const EVERY: Duration = Duration::from_secs(1);

fn panicking(diagnose: Diagnose) -> Diagnose {
    Arc::new(move |record, settings, known| {
        if record.op_limits == Some(LIMITS) {
            println!("{PANIC}");
            panic!("on purpose");
        }
        diagnose(record, settings, known)
    })
}

/// Runs until it is told to stop.
pub async fn run(path: &Path) -> Result<(), Failed> {
    let (mut hup, mut term) = (signal(SignalKind::hangup())?, signal(SignalKind::terminate())?);
    tracing_subscriber::fmt().with_writer(std::io::stderr).with_ansi(false).init();
    let load = || config::load(path).map_err(|wrong| format!("{wrong:?}"));
    let config = load()?;
    let listener = app::listen(&config).await?;
    let app = App::build(config, Clock::wall(), panicking(App::diagnosis()))?;
    let obeying = async {
        loop {
            tokio::select! {
                _ = term.recv() => return app.stop().cancel(),
                _ = hup.recv() => match load() {
                    Ok(config) => app.reload(config).await.unwrap_or_else(|error| eprintln!("{error}")),
                    Err(error) => eprintln!("{error}"),
                },
            }
        }
    };
    let saying = tokio::spawn(async {
        let mut every = tokio::time::interval(EVERY);
        loop {
            every.tick().await;
            println!("{ALLOCATED}{}", ALLOCATOR.allocated());
        }
    });
    let (ran, ()) = tokio::join!(app.run(listener), obeying);
    saying.abort();
    Ok(ran?)
}
