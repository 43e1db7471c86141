//! `stictiond store check | export | import`: the store from outside the daemon.

use super::{Failure, print};
use clap::ValueEnum;
use std::collections::HashMap;
use std::fmt::Write;
use std::io;
use std::path::{Path, PathBuf};
use stictiond::config;
use stictiond::serve::dto::{parse_time, rfc3339};
use stictiond::signal::many;
use stictiond::store::archive::{self, ArchiveError, Choice, Format, Gathered, Import, Kind, Place};
use stictiond::store::{self, Batch, Config, Reader, Store, StoreError};
use stictiond::table::{self, Found, Options, Source, TableError};

/// Faults that are printed; the rest are counted.
const FAULTS: usize = 20;

#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Read the whole store, also while it is in use: exit code 1 and what is damaged when something is
    Check {
        /// The folder, as `[store] folder` names it, or a configuration (.toml) with `[store]`
        folder: PathBuf,
        /// Make a new store of what is left of one that is damaged, which must not be in use; the damaged files stay beside it.
        /// Where only the second copy of the states is damaged, it is written anew from the database
        #[arg(long)]
        repair: bool,
    },
    /// Write what is kept to a file, also while the store is in use
    Export(Export),
    /// Take samples from files into the store, which must not be in use; what is there stays, nothing is twice
    Import(Box<ImportArgs>),
}

#[derive(clap::Args)]
struct Export {
    /// The folder, as `[store] folder` names it, or a configuration (.toml) with `[store]`
    folder: PathBuf,
    /// The file to make; `.csv` or `.parquet` says how
    #[arg(value_name = "FILE")]
    to: PathBuf,
    /// What to write
    #[arg(long, value_enum, default_value = "samples")]
    what: What,
    /// Only these loops
    #[arg(long = "loop", value_name = "ID")]
    loops: Vec<String>,
    /// From this time on: RFC 3339, or seconds since the Unix epoch
    #[arg(long, value_parser = time)]
    from: Option<f64>,
    /// Up to this time
    #[arg(long, value_parser = time)]
    to_time: Option<f64>,
}

#[derive(Clone, Copy, ValueEnum)]
enum What {
    Samples,
    Trends,
    Diagnoses,
    Alarms,
}

#[derive(clap::Args)]
struct ImportArgs {
    /// The folder, as `[store] folder` names it, made when it is not there; or a configuration (.toml) with `[store]`
    folder: PathBuf,
    /// Tables of samples (CSV, Excel, ODS, Parquet): with columns loop, tag, t, value and, as far as there are, quality,
    /// source, unit; or with a column for each tag of one loop
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// A configuration: samples that name no source are taken for those that its loops read, and fill their history
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The loop that the samples belong to, where the table does not name it
    #[arg(long = "loop", value_name = "ID")]
    of_loop: Option<String>,
    #[command(flatten)]
    table: super::table::TableArgs,
}

pub fn time(text: &str) -> Result<f64, String> {
    parse_time(text).ok_or_else(|| "neither RFC 3339 nor seconds since the Unix epoch".to_string())
}

/// Runs one of them.
pub fn run(args: &Args) -> Result<(), Failure> {
    match &args.command {
        Command::Check { folder, repair } => check(folder, *repair),
        Command::Export(args) => export(args),
        Command::Import(args) => import(args),
    }
}

/// A store that is not there or not ours is bad input; one that fails has failed.
pub fn of_store(error: &StoreError) -> Failure {
    match error {
        StoreError::Missing(_) | StoreError::Foreign(_) | StoreError::TooNew(_) => {
            Failure::BadInput(error.to_string())
        }
        _ => Failure::Failed(error.to_string()),
    }
}

/// An error of a file, or of the store behind it.
fn of_archive(path: &Path, error: &ArchiveError) -> Failure {
    match error {
        ArchiveError::Store(error) => of_store(error),
        ArchiveError::Format(_) => Failure::in_file(path, error),
        ArchiveError::Io(source) => match source.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::AlreadyExists => Failure::in_file(path, error),
            _ => Failure::Failed(format!("{}: {error}", path.display())),
        },
    }
}

fn format(path: &Path) -> Result<Format, Failure> {
    Format::of(path).ok_or_else(|| Failure::in_file(path, "the name must end in .csv or .parquet"))
}

/// The store in a folder, or the one that a configuration names.
fn named(place: &Path) -> Result<Config, Failure> {
    if place.extension().is_none_or(|end| end != "toml") {
        return Ok(Config::new(place));
    }
    let config = config::load(place).map_err(Failure::BadConfig)?;
    config.store.ok_or_else(|| Failure::in_file(place, "there is no [store] in it"))
}

fn check(folder: &Path, repair: bool) -> Result<(), Failure> {
    let config = named(folder)?;
    if repair && let Some(aside) = store::finish_repair(&config).map_err(|error| of_store(&error))? {
        let (folder, aside) = (folder.display(), aside.display());
        print(&format!(
            "repaired    {folder}: an interrupted repair is ended; the damaged files are in {aside}\n"
        ))?;
    }
    let found = store::check_of(&config).map_err(|error| of_store(&error))?;
    let mut out = String::new();
    // Writing into a String cannot fail.
    let _ = writeln!(
        out,
        "samples     {} from {}, {} bytes in chunks",
        found.samples,
        many(found.tags, "tag"),
        found.sample_bytes
    );
    if let Some((first, last)) = found.span {
        let shown = |t: i64| rfc3339(t as f64).unwrap_or_else(|| t.to_string());
        let _ = writeln!(out, "            {} to {}", shown(first), shown(last));
    }
    let _ = writeln!(out, "trends      {}", many(found.points, "point"));
    let _ = writeln!(out, "diagnoses   {}", found.diagnoses);
    let _ = writeln!(out, "alarms      {}", many(found.transitions, "change"));
    if found.faults.is_empty() {
        return print(&format!("{}: good, version {}\n{out}", folder.display(), found.version));
    }
    for fault in found.faults.iter().take(FAULTS) {
        let _ = writeln!(out, "damaged     {fault}");
    }
    if let Some(left) = &found.left {
        let _ = writeln!(out, "left        {left}");
    }
    print(&out)?;
    if repair && found.left.is_some() {
        let done = store::repair(&config).map_err(|error| of_store(&error))?;
        return print(&format!(
            "repaired    {}; the damaged files are in {}\n",
            done.left,
            done.aside.display()
        ));
    }
    let mut damaged = found.faults.len();
    if repair && found.renewable > 0 {
        store::renew(&config).map_err(|error| of_store(&error))?;
        print(&format!("repaired    {}: what lies beside the database is made anew\n", folder.display()))?;
        damaged -= found.renewable;
    }
    match damaged {
        0 => Ok(()),
        damaged => Err(Failure::Failed(format!("{}: {damaged} things are damaged", folder.display()))),
    }
}

fn export(args: &Export) -> Result<(), Failure> {
    let format = format(&args.to)?;
    let kind = match args.what {
        What::Samples => Kind::Samples,
        What::Trends => Kind::Trends,
        What::Diagnoses => Kind::Diagnoses,
        What::Alarms => Kind::Alarms,
    };
    if let (Some(from), Some(to)) = (args.from, args.to_time)
        && from > to
    {
        return Err(Failure::BadInput("--from is later than --to-time".to_string()));
    }
    let mut reader = Reader::looked_at(&named(&args.folder)?).map_err(|error| of_store(&error))?;
    if matches!(kind, Kind::Samples | Kind::Trends) {
        let tags = reader.tags().map_err(|error| of_store(&error))?;
        let is_there = |own: &&String| tags.iter().any(|tag| tag.name.control_loop == **own);
        if let Some(strange) = args.loops.iter().find(|own| !is_there(own)) {
            return Err(Failure::in_file(&args.folder, format!("no loop {strange:?} in this store")));
        }
    }
    let choice = Choice { loops: args.loops.clone(), from: args.from, to: args.to_time };
    let rows = archive::export(&mut reader, kind, &choice, format, &args.to)
        .map_err(|error| of_archive(&args.to, &error))?;
    if let Some((left, _)) = reader.lost() {
        return Err(Failure::Failed(format!(
            "{}: {rows} rows written of a store that is damaged; {left}",
            args.to.display()
        )));
    }
    if reader.damaged() > 0 {
        let left_out = reader.damaged();
        return Err(Failure::Failed(format!(
            "{}: {rows} rows written, {left_out} damaged chunks left out; see stictiond store check",
            args.to.display()
        )));
    }
    print(&format!("{}: {rows} rows\n", args.to.display()))
}

fn import(args: &ImportArgs) -> Result<(), Failure> {
    args.files.iter().try_for_each(|file| super::table::readable_twice(file))?;
    let (settings, sources) = match &args.config {
        Some(path) => configured(path, &args.folder)?,
        None => (named(&args.folder)?, HashMap::new()),
    };
    let source = |own: &str, tag: &str| sources.get(&(own.to_string(), tag.to_string())).cloned();
    let mut store = Store::open(&settings).map_err(|error| of_store(&error))?;
    if let Some(away) = store.spool().and_then(|spool| spool.away) {
        return Err(Failure::Failed(away));
    }
    let options = args.table.options(args.of_loop.as_deref());
    for file in &args.files {
        let (taken, found) = import_one(file, &options, &source, &mut store)?;
        print(&format!("{}: {}, read as: {}\n", file.display(), taken.said(), found.read_as))?;
    }
    if store.spool().is_some_and(|spool| spool.waits) {
        let folder = settings.folder.display();
        return Err(Failure::Failed(format!(
            "the database went away: the rest waits in {folder} for the daemon"
        )));
    }
    Ok(())
}

fn import_one(
    file: &Path,
    options: &Options,
    source: archive::Sources<'_>,
    store: &mut Store,
) -> Result<(Taken, Found), Failure> {
    let before = store.twice();
    let mut take = |batch: &Batch| store.insert(batch);
    let mut import = Import::new(source, &mut take);
    let read = table::stream(Source::File(file), options, &mut |tag, sample| {
        let (source, unit) = (tag.source.as_deref(), tag.unit.as_deref());
        import.sample(&Place { control_loop: &tag.owner, tag: &tag.name, source, unit }, sample)?;
        Ok::<_, Unread>(())
    });
    let found = read.map_err(|error| match error {
        Unread::Table(error) => Failure::in_file(file, error),
        Unread::Store(error) => of_archive(file, &error),
    })?;
    let gathered = import.end().map_err(|error| of_archive(file, &error))?;
    let twice = store.twice().zip(before).map_or(0, |(all, before)| all.saturating_sub(before));
    Ok((Taken::new(gathered, twice), found))
}

/// What became of a file's samples.
struct Taken {
    kept: u64,
    undated: u64,
    /// At a time at which their tag has a sample already, from this file or from before.
    twice: u64,
}

impl Taken {
    fn new(gathered: Gathered, twice: u64) -> Self {
        Self { kept: gathered.handed_on.saturating_sub(twice), undated: gathered.undated, twice }
    }

    fn said(&self) -> String {
        let Self { kept, undated, twice } = *self;
        let mut said = format!("{kept} samples");
        if undated + twice > 0 {
            said += " kept";
        }
        if undated > 0 {
            said += &format!(", {undated} refused, whose times have no date");
        }
        if twice > 0 {
            said += &format!(", {twice} left out, as their tag has a sample at the same time");
        }
        said
    }
}

/// Why a table did not get into the store.
enum Unread {
    Table(TableError),
    Store(ArchiveError),
}

impl From<TableError> for Unread {
    fn from(error: TableError) -> Self {
        Self::Table(error)
    }
}

impl From<ArchiveError> for Unread {
    fn from(error: ArchiveError) -> Self {
        Self::Store(error)
    }
}

/// Source and unit of every tag, by loop and name.
type Sources = HashMap<(String, String), (String, String)>;

/// The store's settings, and for every tag of the plant its source and unit.
fn configured(path: &Path, folder: &Path) -> Result<(Config, Sources), Failure> {
    let config = config::load(path).map_err(Failure::BadConfig)?;
    let plant = config.plant().map_err(|issues| {
        let issues =
            issues.iter().map(|issue| format!("{}: {}", issue.field, issue.message)).collect::<Vec<_>>();
        Failure::in_file(path, issues.join("; "))
    })?;
    let tags = plant.loops.iter().flat_map(|own| own.tags.iter().map(move |tag| (&own.id, tag)));
    let named = |(id, tag): (&stictiond::signal::LoopId, &stictiond::history::TagSpec)| {
        ((id.to_string(), tag.kind.name().to_string()), (tag.source.clone(), tag.unit.clone()))
    };
    let sources = tags.map(named).collect();
    if folder.extension().is_some_and(|end| end == "toml") {
        return Ok((self::named(folder)?, sources));
    }
    let own = config.store.unwrap_or_else(|| Config::new(folder));
    Ok((Config { folder: folder.to_path_buf(), url: None, ..own }, sources))
}
