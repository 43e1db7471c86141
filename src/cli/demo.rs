//! `stictiond demo`: a simulated plant, and the daemon watching it.

use super::{Failure, logging};
use std::net::SocketAddr;
use stictiond::app::AppError;
use stictiond::demo::{self, DEFAULT_SPEED, DemoError, Options};

#[derive(clap::Args)]
pub struct Args {
    /// Where to show API and dashboard
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// How many times faster than the wall clock plant time runs, 1 to 200
    #[arg(long, value_name = "N", default_value_t = DEFAULT_SPEED)]
    speed: f64,
    /// Seed of the plant's noise and loads
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    log: logging::LogArgs,
}

/// Runs until it is told to stop.
pub fn run(args: &Args) -> Result<(), Failure> {
    // The log would run through the table: it is written only where it is asked for.
    if std::env::var_os("RUST_LOG").is_some() {
        logging::start(&args.log)?;
    }
    let options = Options { listen: args.listen, speed: args.speed, seed: args.seed };
    demo::command(&options).map_err(|error| match error {
        DemoError::Speed(_) => Failure::BadInput(error.to_string()),
        // The only line of the demo's configuration that comes from outside.
        DemoError::App(AppError::Config(errors)) => Failure::BadInput(format!(
            "--listen {}: {}",
            args.listen,
            errors.iter().map(|error| error.message.as_str()).collect::<Vec<_>>().join("; ")
        )),
        _ => Failure::Failed(error.to_string()),
    })
}
