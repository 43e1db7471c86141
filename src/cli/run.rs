//! `stictiond run --config FILE`: the daemon, until SIGTERM or SIGINT.

use super::{Failure, logging};
use std::path::PathBuf;
use stictiond::app::{self, AppError};

#[derive(clap::Args)]
pub struct Args {
    /// The configuration; read again on SIGHUP
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    #[command(flatten)]
    log: logging::LogArgs,
}

/// Runs until it is told to stop.
pub fn run(args: &Args) -> Result<(), Failure> {
    logging::start(&args.log)?;
    let runtime =
        tokio::runtime::Runtime::new().map_err(|error| Failure::Failed(format!("cannot start: {error}")))?;
    let ended = runtime.block_on(app::daemon(&args.config));
    // A diagnosis under way has nothing to save; waiting for it would hold up a restart.
    runtime.shutdown_background();
    ended.map_err(|error| match error {
        AppError::Config(errors) => Failure::BadConfig(errors),
        AppError::Plan(_) => Failure::in_file(&args.config, error),
        _ => Failure::Failed(error.to_string()),
    })
}
