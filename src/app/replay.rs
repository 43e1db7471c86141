//! Recorded samples through the daemon's own rings, scheduler, diagnosis, residual, results and alarms, on the record's
//! clock: the same diagnoses at the same plant times.
//!
//! A diagnosis depends on nothing but its record, the settings and what the run before it found. Which samples the record
//! had depends on when the rings were copied; so every run keeps its [`Basis`](crate::results::Basis), which names them,
//! and a replay shows the run those and no others.

mod feed;
mod machine;

use crate::config::Config;
use crate::results::{Run, Trigger};
use crate::schedule::{Clock, next_due, stagger};
use crate::serve::dto::bundle::Bundle;
use crate::serve::dto::{BasisText, Report, rfc3339};
use crate::signal::LoopId;
use crate::store::archive::ArchiveError;
use crate::store::{DiagnosisRow, Reader, StoreError, unpack};
use crate::table;
use crate::version::BUILD;
use feed::{Feed, Listed, Stored};
use machine::Machine;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Runs that are read from the store in one go.
const ROWS: usize = 100;

/// Why a replay ends without an answer.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// What is to be replayed cannot be.
    #[error("{0}")]
    Input(String),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The export cannot be read.
    #[error("{0}")]
    Archive(#[from] ArchiveError),
    /// The daemon's parts do not work.
    #[error("{0}")]
    Failed(String),
}

/// What is replayed.
#[derive(Clone, Debug)]
pub enum Record {
    /// A store, for the plant of a configuration.
    Store(PathBuf, Box<Config>),
    /// An export of samples with what its table does not say itself, for the plant of a configuration.
    Export(PathBuf, Box<table::Options>, Box<Config>),
    /// A diagnosis bundle.
    Bundle(Box<Bundle>),
}

/// How it is replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// Plant time over wall time; `None` is as fast as possible.
    pub speed: Option<f64>,
    /// Where API and dashboard are shown.
    pub listen: Option<SocketAddr>,
    /// Only runs that ended from this time on (s).
    pub from: Option<f64>,
    /// Only runs that ended up to this time (s).
    pub to: Option<f64>,
}

/// What came of it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Diagnoses made.
    pub runs: u64,
    /// The same as recorded, to the last bit.
    pub identical: u64,
    /// Not the same.
    pub different: u64,
    /// Recorded, but not all of their samples are in the record any more.
    pub incomplete: u64,
    /// Recorded runs that failed, or that do not say what they worked on.
    pub untold: u64,
}

/// Takes a line for people.
pub type Say<'a> = &'a mut (dyn FnMut(&str) + Send);

/// Replays a record, a line to `say` for each run. With [`Options::listen`] it goes on serving until it is interrupted.
///
/// # Errors
/// [`ReplayError`].
pub async fn replay(record: &Record, options: &Options, say: Say<'_>) -> Result<Tally, ReplayError> {
    match record {
        Record::Store(folder, config) => store(folder, config, options, say).await,
        Record::Export(file, reading, config) => export(file, reading, config, options, say).await,
        Record::Bundle(bundle) => one(bundle, options, say).await,
    }
}

async fn store(
    folder: &Path,
    config: &Config,
    options: &Options,
    say: Say<'_>,
) -> Result<Tally, ReplayError> {
    let reader = Reader::open(folder)?;
    let within = |row: &DiagnosisRow| {
        options.from.is_none_or(|t| row.finished >= t) && options.to.is_none_or(|t| row.finished <= t)
    };
    let (mut first, mut room, mut after, mut chosen) = (f64::INFINITY, 0, 0, false);
    while let Some(rows) = Some(reader.diagnoses(after, ROWS)?).filter(|rows| !rows.is_empty()) {
        for (number, row) in rows {
            after = number;
            if !within(&row) {
                continue;
            }
            chosen = true;
            for extent in basis(&row).into_iter().flat_map(|basis| basis.extents) {
                room = room.max(extent.n);
                first = first.min(extent.span.map_or(first, |(first, _)| first));
            }
        }
    }
    if room == 0 {
        let why = match chosen {
            true => "no diagnosis in it names the samples it was made of, so none can be made again",
            false if after == 0 => "there is no diagnosis in it",
            false => "no run in it ended in the time that --from and --to-time name",
        };
        return Err(ReplayError::Input(format!("{}: {why}", folder.display())));
    }
    let mut machine = Machine::of(config, room, Clock::by_hand(first), options)?;
    machine.begin(options, say).await?;
    let mut feed = Stored::new(Reader::open(folder)?, machine.history(), first)?;
    let (mut tally, mut after) = (Tally::default(), 0);
    while let Some(rows) = Some(reader.diagnoses(after, ROWS)?).filter(|rows| !rows.is_empty()) {
        for (number, row) in rows {
            after = number;
            if within(&row) {
                again(&mut machine, &mut feed, &row, &mut tally, say).await?;
            }
        }
    }
    machine.end(options, say).await?;
    Ok(tally)
}

fn basis(row: &DiagnosisRow) -> Option<crate::results::Basis> {
    BasisText::read(&unpack(row.basis.as_ref()?)?)
}

/// Makes a recorded diagnosis again.
async fn again(
    machine: &mut Machine,
    feed: &mut dyn Feed,
    row: &DiagnosisRow,
    tally: &mut Tally,
    say: Say<'_>,
) -> Result<(), ReplayError> {
    let recorded = row.report.as_deref().and_then(unpack);
    let (Some(basis), Some(recorded)) = (basis(row), recorded) else {
        tally.untold += 1;
        return Ok(());
    };
    let id = LoopId::new(row.control_loop.as_str());
    let newest = basis.newest().unwrap_or(row.finished);
    machine.advance(newest.min(row.finished), feed).await?;
    machine.feed(newest, feed)?;
    let lost = machine.lost(&id, &basis);
    if !lost.is_empty() {
        tally.incomplete += 1;
        say(&format!("{}  the record lacks samples of {}", head(row.finished, &id), lost.join(", ")));
        return Ok(());
    }
    let trigger = if row.on_demand { Trigger::OnDemand } else { Trigger::Periodic };
    let began = row.finished - row.took_s.max(0.0);
    let run = machine.run(&id, trigger, Some((basis, began, row.finished))).await?;
    compare(&run, &recorded, &row.version, tally, say);
    Ok(())
}

fn compare(run: &Run, recorded: &str, version: &str, tally: &mut Tally, say: Say<'_>) {
    tally.runs += 1;
    let replayed = Report::text(run).unwrap_or_default();
    let differences = Report::differences(recorded, &replayed);
    let line = told(run);
    if differences.is_empty() {
        tally.identical += 1;
        return say(&format!("{line}  identical"));
    }
    tally.different += 1;
    let by = if version == BUILD { String::new() } else { format!(" (recorded by version {version})") };
    say(&format!("{line}  DIFFERENT{by}: {}", differences.join("; ")));
}

fn head(t: f64, id: &LoopId) -> String {
    format!("{}  {id}", rfc3339(t).unwrap_or_else(|| t.to_string()))
}

/// A run in one line: its f and evidence, or why there is none.
fn told(run: &Run) -> String {
    let number = |value: Option<f64>| value.map_or("-".to_string(), |value| format!("{value:.3}"));
    let found = match Report::of(run) {
        None => String::new(),
        Some(report) if report.reason_code.is_some() => format!("  {}", report.reason),
        Some(report) => {
            format!("  f {} {}  ΔAIC {}", number(report.f), report.f_unit, number(report.delta_aic))
        }
    };
    format!("{}  {}{found}", head(run.finished, &run.id), run.outcome.as_str())
}

/// Diagnoses an export as the daemon's schedule would have; nothing is there to compare with.
async fn export(
    file: &Path,
    reading: &table::Options,
    config: &Config,
    options: &Options,
    say: Say<'_>,
) -> Result<Tally, ReplayError> {
    let plant = config.plant().map_err(machine::issues)?;
    let (mut feed, Some((first, last))) = Listed::read(file, reading, &plant.loops)? else {
        return Err(ReplayError::Input(format!(
            "{}: no sample in it is of a loop of the configuration",
            file.display()
        )));
    };
    let nothing = |what: &str| Err(ReplayError::Input(format!("{}: {what}", file.display())));
    let turned = options.from.zip(options.to).is_some_and(|(from, to)| from > to);
    if turned || options.to.is_some_and(|to| to < first) {
        return nothing("it has nothing in the time that --from and --to-time name");
    }
    let room = config.history.samples_per_tag;
    let mut machine = Machine::of(config, room, Clock::by_hand(first), options)?;
    machine.begin(options, say).await?;
    let jobs = super::jobs(config);
    let schedule = stagger(&jobs);
    let mut due: Vec<Duration> = schedule.iter().map(|(offset, _)| *offset).collect();
    let mut tally = Tally::default();
    let end = Duration::try_from_secs_f64(options.to.unwrap_or(last).min(last) - first).unwrap_or_default();
    while let Some((at, when)) = due.iter().copied().enumerate().min_by_key(|(_, when)| *when)
        && when <= end
    {
        due[at] = next_due(schedule[at].0, schedule[at].1, when).0;
        let now = first + when.as_secs_f64();
        machine.advance(now, &mut feed).await?;
        if options.from.is_none_or(|from| now >= from) {
            let run = machine.run(&jobs[at].id, Trigger::Periodic, None).await?;
            tally.runs += 1;
            say(&told(&run));
        }
    }
    machine.end(options, say).await?;
    if tally.runs == 0 {
        return nothing("no diagnosis is due in it in the time that is asked for");
    }
    Ok(tally)
}

async fn one(bundle: &Bundle, options: &Options, say: Say<'_>) -> Result<Tally, ReplayError> {
    let (basis, record) = bundle.record().map_err(ReplayError::Input)?;
    let recorded = serde_text(&bundle.report)?;
    let id = LoopId::new(bundle.r#loop.id.as_str());
    let first = basis.extents.iter().filter_map(|extent| Some(extent.span?.0)).reduce(f64::min);
    let mut machine =
        Machine::of_one(bundle, &record, Clock::by_hand(first.unwrap_or(bundle.started)), options)?;
    machine.begin(options, say).await?;
    let mut feed = Listed::of(&record);
    let newest = basis.newest().unwrap_or(bundle.finished);
    machine.advance(newest.min(bundle.finished), &mut feed).await?;
    machine.feed(newest, &mut feed)?;
    let trigger = if bundle.on_demand { Trigger::OnDemand } else { Trigger::Periodic };
    let mut tally = Tally::default();
    let run = machine.run(&id, trigger, Some((basis, bundle.started, bundle.finished))).await?;
    compare(&run, &recorded, &bundle.version, &mut tally, say);
    machine.end(options, say).await?;
    Ok(tally)
}

fn serde_text(report: &Report) -> Result<String, ReplayError> {
    report.as_text().ok_or_else(|| ReplayError::Input("the report cannot be written".to_string()))
}
