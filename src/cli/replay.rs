//! `stictiond replay RECORD`: recorded samples through the whole daemon, on the record's own clock.

use super::{Failure, print, table};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use stictiond::app::replay::{Options, Record, ReplayError, Tally, replay};
use stictiond::config::{self, Config};
use stictiond::serve::dto::bundle::Bundle;
use stictiond::serve::dto::parse_time;
use stictiond::store::StoreError;
use stictiond::table::Options as TableOptions;

/// Largest bundle that is read (bytes).
const MOST_BYTES: u64 = 256_000_000;

#[derive(clap::Args)]
pub struct Args {
    /// A store's folder, a diagnosis bundle (.json), or else a table of samples, such as an export of a store
    record: PathBuf,
    /// The configuration of the plant; a bundle needs none
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// How many times faster than the wall clock plant time runs; as fast as possible when left out
    #[arg(long, value_name = "N", value_parser = above_zero)]
    speed: Option<f64>,
    /// Show API and dashboard there, on the record's clock
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// Only runs from this time on: RFC 3339, or seconds since the Unix epoch
    #[arg(long, value_parser = time)]
    from: Option<f64>,
    /// Only runs up to this time
    #[arg(long, value_parser = time)]
    to_time: Option<f64>,
    /// The loop that the samples of a table belong to, where the table does not name it
    #[arg(long = "loop", value_name = "ID")]
    of_loop: Option<String>,
    #[command(flatten)]
    table: table::TableArgs,
}

fn above_zero(text: &str) -> Result<f64, String> {
    text.parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0).ok_or("not a number above 0".into())
}

fn time(text: &str) -> Result<f64, String> {
    parse_time(text).ok_or_else(|| "neither RFC 3339 nor seconds since the Unix epoch".to_string())
}

/// Replays, and says of each run whether it is what was recorded.
pub fn run(args: &Args) -> Result<(), Failure> {
    let record = record(args)?;
    let options = Options { speed: args.speed, listen: args.listen, from: args.from, to: args.to_time };
    let runtime =
        tokio::runtime::Runtime::new().map_err(|error| Failure::Failed(format!("cannot start: {error}")))?;
    let mut closed = None;
    let mut say = |line: &str| {
        if closed.is_none() {
            closed = print(&format!("{line}\n")).err();
        }
    };
    let tally = runtime.block_on(replay(&record, &options, &mut say)).map_err(|error| match error {
        ReplayError::Input(what) if matches!(record, Record::Bundle(_)) => {
            Failure::in_file(&args.record, what)
        }
        ReplayError::Input(_) | ReplayError::Archive(_) => Failure::BadInput(error.to_string()),
        ReplayError::Store(StoreError::Missing(_) | StoreError::Foreign(_) | StoreError::TooNew(_)) => {
            Failure::BadInput(error.to_string())
        }
        _ => Failure::Failed(error.to_string()),
    })?;
    match closed {
        Some(failure) => Err(failure),
        None => conclude(&record, &tally),
    }
}

fn conclude(record: &Record, tally: &Tally) -> Result<(), Failure> {
    let Tally { runs, identical, different, incomplete, untold } = tally;
    if matches!(record, Record::Export(..)) {
        let (diagnoses, them) = if *runs == 1 { ("diagnosis", "it") } else { ("diagnoses", "them") };
        return print(&format!("{runs} {diagnoses}; an export has none to compare {them} with\n"));
    }
    let mut said = format!("{identical} of {runs} diagnoses identical to the recorded, bit for bit");
    if *incomplete > 0 {
        said += &format!("; {incomplete} whose samples are no longer all in the record");
    }
    if *untold > 0 {
        said += &format!("; {untold} recorded runs that failed or do not say what they worked on");
    }
    match (*different, *runs) {
        (0, 0) => Err(Failure::Failed(format!("nothing could be compared: {said}"))),
        (0, _) => print(&format!("{said}\n")),
        _ => {
            let differ = if *different == 1 { "differs" } else { "differ" };
            Err(Failure::Failed(format!("{different} {differ}: {said}")))
        }
    }
}

fn record(args: &Args) -> Result<Record, Failure> {
    let path = &args.record;
    let told = args.table.options(args.of_loop.as_deref());
    let is_table = !path.is_dir() && path.extension().is_none_or(|own| !own.eq_ignore_ascii_case("json"));
    if !is_table && told != TableOptions::default() {
        let what = if path.is_dir() { "a store" } else { "a bundle" };
        let why = format!(
            "{what} says itself which loops and tags it has: leave out --loop and the options of a table"
        );
        return Err(Failure::in_file(path, why));
    }
    if path.is_dir() {
        return Ok(Record::Store(path.clone(), Box::new(configured(args)?)));
    }
    if is_table {
        table::readable_twice(path)?;
        return Ok(Record::Export(path.clone(), Box::new(told), Box::new(configured(args)?)));
    }
    let bundle = Bundle::read(&text(path)?).map_err(|error| Failure::in_file(path, error))?;
    Ok(Record::Bundle(Box::new(bundle)))
}

fn text(path: &Path) -> Result<String, Failure> {
    let bad = |error: &dyn std::fmt::Display| Failure::in_file(path, error);
    let size = std::fs::metadata(path).map_err(|error| bad(&error))?.len();
    if size > MOST_BYTES {
        return Err(bad(&format!("{size} bytes are no diagnosis bundle")));
    }
    std::fs::read_to_string(path).map_err(|error| bad(&error))
}

fn configured(args: &Args) -> Result<Config, Failure> {
    let Some(path) = &args.config else {
        return Err(Failure::BadInput("--config FILE is needed: whose loops the samples are".to_string()));
    };
    config::load(path).map_err(Failure::BadConfig)
}
