//! Where the log goes: stderr, as text or as one JSON object a line.

use super::Failure;
use clap::ValueEnum;
use std::io::stderr;
use stictiond::quiet::Quiet;
use tracing_subscriber::filter::{EnvFilter, FilterExt};
use tracing_subscriber::layer::{Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{fmt, registry};

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

/// What RUST_LOG chooses; `None` where it is not set. Set to nothing, as a container file may set it, it chooses nothing either:
/// taken as a filter it would turn the whole log off.
pub fn chosen() -> Option<String> {
    std::env::var("RUST_LOG").ok().filter(|own| !own.trim().is_empty())
}

/// Begins to write the log.
pub fn start(args: &LogArgs) -> Result<(), Failure> {
    let wanted = chosen().unwrap_or_else(|| "info".into());
    // The library of OPC UA looks for a certificate also where none is asked for, and says that "crypto won't work". Where one
    // is needed, the collector looks for it first and names the file. Whoever names the library hears it all.
    let quiet = if wanted.contains("opcua") { "" } else { ",opcua_core::comms::secure_channel=off" };
    let filter = EnvFilter::try_new(format!("{wanted}{quiet}"))
        .map_err(|error| Failure::BadInput(format!("RUST_LOG={wanted:?}: {error}")))?;
    let quiet = Quiet::default();
    quiet.tell().map_err(|error| Failure::Failed(format!("cannot start the log: {error}")))?;
    let bounded = filter.and(quiet);
    // Where nobody reads the log any more there is nobody to tell that it cannot be written.
    let log = fmt::layer().with_writer(stderr).log_internal_errors(false);
    let started = match args.log_format {
        Format::Text => registry().with(log.with_ansi(false).with_filter(bounded)).try_init(),
        Format::Json => registry().with(log.json().flatten_event(true).with_filter(bounded)).try_init(),
    };
    started.map_err(|error| Failure::Failed(format!("cannot start the log: {error}")))
}
