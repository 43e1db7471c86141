//! `stictiond demo`: a simulated plant, and the daemon watching it.

use super::{Failure, logging};
use std::net::SocketAddr;
use std::path::PathBuf;
use stictiond::app::AppError;
use stictiond::demo::{self, DEFAULT_SPEED, DemoError, Options, WRITEBACK_SPEED};

#[derive(clap::Args)]
pub struct Args {
    /// Where to show API and dashboard
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// How many times faster than the wall clock plant time runs, 1 to 200; 80, with --writeback 20
    #[arg(long, value_name = "N")]
    speed: Option<f64>,
    /// Seed of the plant's noise and loads
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Reinforce the sticky loops: two demo operators grant and approve, the simulated DCS adds the terms
    #[arg(long)]
    writeback: bool,
    /// Write here with which configuration another daemon watches the same plant; not with --writeback, since terms have one writer
    #[arg(long, value_name = "FILE", conflicts_with = "writeback")]
    config_to: Option<PathBuf>,
    #[command(flatten)]
    log: logging::LogArgs,
}

/// Runs until it is told to stop.
pub fn run(args: &Args) -> Result<(), Failure> {
    // The log would run through the table: it is written only where it is asked for.
    if logging::chosen().is_some() {
        logging::start(&args.log)?;
    }
    let usual = if args.writeback { WRITEBACK_SPEED } else { DEFAULT_SPEED };
    let speed = args.speed.unwrap_or(usual);
    let options = Options { listen: args.listen, speed, seed: args.seed, writeback: args.writeback };
    demo::command(&options, args.config_to.as_deref()).map_err(|error| match error {
        DemoError::Speed(_) | DemoError::NotBuiltIn => Failure::BadInput(error.to_string()),
        // The only line of the demo's configuration that comes from outside.
        DemoError::App(AppError::Config(errors)) => Failure::BadInput(format!(
            "--listen {}: {}",
            args.listen,
            errors.iter().map(|error| error.message.as_str()).collect::<Vec<_>>().join("; ")
        )),
        _ => Failure::Failed(error.to_string()),
    })
}
