//! `stictiond run | edge | worker | centre --config FILE`: the daemon, alone or as a part of a fleet, until SIGTERM or SIGINT.

use super::{Failure, logging};
use std::path::PathBuf;
use stictiond::app::{self, AppError, Role};

#[derive(clap::Args)]
pub struct Args {
    /// The configuration; read again on SIGHUP
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    #[command(flatten)]
    log: logging::LogArgs,
}

/// Runs until it is told to stop.
pub fn run(args: &Args, role: Role) -> Result<(), Failure> {
    logging::start(&args.log)?;
    let runtime =
        tokio::runtime::Runtime::new().map_err(|error| Failure::Failed(format!("cannot start: {error}")))?;
    let ended = runtime.block_on(app::daemon(&args.config, role));
    // A diagnosis under way has nothing to save; waiting for it would hold up a restart.
    runtime.shutdown_background();
    ended.map_err(|error| match error {
        AppError::Config(errors) => Failure::BadConfig(errors),
        AppError::Plan(_) | AppError::Fleet(_) => Failure::in_file(&args.config, error),
        _ => Failure::Failed(error.to_string()),
    })
}
