//! Where the log goes: stderr, as text or as one JSON object a line.

use super::Failure;
use clap::ValueEnum;
use std::io::stderr;
use tracing_subscriber::EnvFilter;

#[derive(clap::Args)]
pub struct LogArgs {
    /// How to write the log; RUST_LOG chooses what is written (info)
    #[arg(long, value_enum, default_value_t = Format::Text)]
    log_format: Format,
}

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    Text,
    Json,
}

/// Begins to write the log.
pub fn start(args: &LogArgs) -> Result<(), Failure> {
    let wanted = std::env::var("RUST_LOG").unwrap_or_else(|_| "info".into());
    // The library of OPC UA looks for a certificate also where none is asked for, and says that "crypto won't work". Where one
    // is needed, the collector looks for it first and names the file. Whoever names the library hears it all.
    let quiet = if wanted.contains("opcua") { "" } else { ",opcua_core::comms::secure_channel=off" };
    let filter = EnvFilter::try_new(format!("{wanted}{quiet}"))
        .map_err(|error| Failure::BadInput(format!("RUST_LOG={wanted:?}: {error}")))?;
    // Where nobody reads the log any more there is nobody to tell that it cannot be written.
    let log =
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(stderr).log_internal_errors(false);
    let started = match args.log_format {
        Format::Text => log.with_ansi(false).try_init(),
        Format::Json => log.json().flatten_event(true).try_init(),
    };
    started.map_err(|error| Failure::Failed(format!("cannot start the log: {error}")))
}
