//! Where a record comes from: a file, a store, or the history of the devices that a configuration names.

use super::super::Failure;
use super::Args;
use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use stictiond::alarm;
use stictiond::backfill::{Part, Past};
use stictiond::collect::opcua::{self, HistoryError, Keep, Pinned, Slice, Wish};
use stictiond::config::{self, Config};
use stictiond::diagnosis::Settings;
use stictiond::schedule::Clock;
use stictiond::signal::{Record, Sample};
use stictiond::store::{self, Batch, Reader, Series, Store, StoreError, StoredTag, TagName};

/// Beside the store in the folder: how far each reading of history has come.
const PROGRESS: &str = "history.progress";
/// Beside it too: which namespaces the numbers of tags mean, so that a reading that goes on reads the nodes that it began with.
const NAMESPACES: &str = "namespaces";

/// The past of a loop, its name, how a file was read, and what a configuration says of diagnoses and alarms.
pub struct Read {
    pub past: Past,
    pub name: String,
    pub read_as: Option<String>,
    pub op_unit: Option<String>,
    pub settings: Settings,
    pub alarms: alarm::Config,
}

/// The past as a source has it.
pub fn past(args: &Args) -> Result<Read, Failure> {
    let path = &args.source;
    let named = || path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    let name = args.of_loop.clone().unwrap_or_else(named);
    let mut read_as = None;
    let op_unit;
    // A unit that was written down wrong cannot be put right in a store: who gives the span decides.
    let in_doubt = |_: &String| args.op_span.is_none();
    let (mut settings, mut alarms) = (Settings::default(), alarm::Config::default());
    let past = if path.is_dir() {
        let (past, unit) = stored(path, args, &|_| false)?;
        op_unit = unit.filter(in_doubt);
        past
    } else if path.extension().is_some_and(|own| own.eq_ignore_ascii_case("toml")) {
        let (past, config) = history(path, args)?;
        let own = config.loops.iter().find(|own| Some(own.id.as_str()) == args.of_loop.as_deref());
        op_unit = own.and_then(|own| own.op.unit()).map(str::to_string).filter(in_doubt);
        (settings, alarms) = (Settings::from(&config.diagnosis), config.alarm);
        past
    } else {
        let table = args.table.read(path, args.of_loop.as_deref())?;
        read_as = Some(table.found.read_as);
        op_unit = table.found.op_unit;
        // Its unit says more than the span alone.
        let mut record = Record { op_span: None, ..table.record };
        let within = |sample: &Sample| {
            args.from.is_none_or(|from| sample.t >= from) && args.to_time.is_none_or(|to| sample.t <= to)
        };
        record.op.retain(within);
        record.pv.retain(within);
        Past::from(record)
    };
    Ok(Read { past, name, read_as, op_unit, settings, alarms })
}

fn wanted(args: &Args) -> Result<&str, Failure> {
    args.of_loop.as_deref().ok_or_else(|| Failure::BadInput("say which loop with --loop".to_string()))
}

/// A loop as the store has it, and OP's unit where all of it has one; told of a tag whether the configuration has it read there.
fn stored(
    folder: &Path,
    args: &Args,
    is_configured: &dyn Fn(&TagName) -> bool,
) -> Result<(Past, Option<String>), Failure> {
    let of_store = |error: StoreError| Failure::in_file(folder, error);
    let own = wanted(args)?;
    let mut reader = Reader::open(folder).map_err(of_store)?;
    let mut tags: Vec<StoredTag> = reader.tags().map_err(of_store)?;
    tags.retain(|tag| tag.name.control_loop == own);
    if tags.is_empty() {
        return Err(Failure::in_file(folder, format!("no loop '{own}' in this store")));
    }
    let span = [args.from.unwrap_or(0.0), args.to_time.unwrap_or(f64::MAX)];
    let found = reader.in_force(&tags, &["op", "pv"], span, &mut |_| true).map_err(of_store)?;
    Ok(of_tags(found.unwrap_or_default(), is_configured))
}

/// A loop's past out of its tags in a store, and OP's unit where all of it has one; told of a tag whether the configuration has it
/// read there.
pub fn of_tags(
    found: Vec<(StoredTag, Vec<Sample>)>,
    is_configured: &dyn Fn(&TagName) -> bool,
) -> (Past, Option<String>) {
    let of_op = found.iter().filter(|(tag, samples)| tag.name.tag == "op" && !samples.is_empty());
    let units: BTreeSet<&str> = of_op.map(|(tag, _)| tag.name.unit.as_str()).collect();
    let unit = units.first().filter(|unit| units.len() == 1 && !unit.is_empty());
    let unit = unit.map(|unit| (*unit).to_string());
    let part = |(tag, samples): (StoredTag, Vec<Sample>)| Part {
        configured: is_configured(&tag.name),
        era: tag.era,
        tag: tag.name.tag,
        samples,
    };
    let parts = found.into_iter().map(part).collect();
    (Past { known: Record::default(), parts }, unit)
}

/// Reads what the loop's OPC UA servers kept into the store of `--into`, from where it was left, and then from there.
fn history(path: &Path, args: &Args) -> Result<(Past, Config), Failure> {
    let own = wanted(args)?;
    let need = |what| Failure::BadInput(format!("to read history from devices, say {what}"));
    let folder = args.into.clone().ok_or_else(|| need("with --into FOLDER where it is to be kept"))?;
    let (from, to) = args.from.zip(args.to_time).ok_or_else(|| need("--from and --to-time"))?;
    if to > Clock::wall().now() {
        // What is read up to it is noted as read, so that what comes until then would never be.
        let why = "--to-time is in the future: name a time that has passed, and read the rest later";
        return Err(Failure::BadInput(why.to_string()));
    }
    let config = config::load(path).map_err(Failure::BadConfig)?;
    let bad = |what: String| Failure::in_file(path, what);
    let plant = config.plant().map_err(|issues| {
        bad(issues
            .iter()
            .map(|issue| format!("{}: {}", issue.field, issue.message))
            .collect::<Vec<_>>()
            .join("; "))
    })?;
    let all = plant.loops.iter().flat_map(|l| l.tags.iter().map(move |tag| (l, tag)));
    let names: HashMap<usize, Arc<TagName>> = all
        .enumerate()
        .filter(|(_, (l, _))| l.id.as_str() == own)
        .map(|(at, (l, tag))| {
            let name = TagName {
                control_loop: l.id.to_string(),
                tag: tag.kind.name().to_string(),
                source: tag.source.clone(),
                unit: tag.unit.clone(),
            };
            (at, Arc::new(name))
        })
        .collect();
    if names.is_empty() {
        return Err(bad(format!("there is no loop '{own}'")));
    }
    let plans = plant.opcua.into_iter().filter_map(|mut plan| {
        plan.tags.retain(|tag| names.contains_key(&tag.index));
        (!plan.tags.is_empty()).then_some(plan)
    });
    let plans: Vec<opcua::Plan> = plans.collect();
    if plans.is_empty() {
        return Err(bad(format!(
            "no tag of loop '{own}' is read from an OPC UA server, which could have its history"
        )));
    }
    let wish = Wish {
        from,
        to,
        newest_first: args.newest_first,
        slice_s: args.slice,
        pause: Duration::from_millis(args.pause_ms),
        average_s: args.average,
    };
    let mut store =
        Store::open(&store::Config::new(&folder)).map_err(|error| Failure::Failed(error.to_string()))?;
    let mut namespaces = Namespaces::open(folder.join(NAMESPACES))?;
    let pinned = namespaces.pinned.clone();
    let runtime =
        tokio::runtime::Runtime::new().map_err(|error| Failure::Failed(format!("cannot start: {error}")))?;
    for plan in plans {
        let read: Vec<&TagName> =
            plan.tags.iter().filter_map(|tag| names.get(&tag.index)).map(Arc::as_ref).collect();
        let key = key(args, &plan.config.name, [from, to], &read);
        let progress = Progress { path: folder.join(PROGRESS), key };
        let wish = progress.done().map_or(wish, |done| wish.after(done));
        let slices = wish.slices().count();
        let bar = super::Bar::new();
        let mut kept = Kept {
            store: &mut store,
            names: &names,
            progress,
            namespaces: &mut namespaces,
            newest_first: args.newest_first,
            bar,
            slices,
            at: 0,
        };
        let read = runtime.block_on(opcua::history(&plan, &wish, &pinned, &mut kept));
        kept.bar.end();
        read.map_err(|error| match error {
            HistoryError::Tag(..) | HistoryError::None(..) => bad(error.to_string()),
            _ => Failure::Failed(format!("{error}; what was read is kept, run it again to go on")),
        })?;
    }
    drop(store);
    let is_configured =
        |stored: &TagName| names.values().any(|name| name.tag == stored.tag && name.source == stored.source);
    let (mut past, _) = stored(&folder, args, &is_configured)?;
    let limits = config.loops.iter().find(|l| l.id == own);
    past.known.op_span = limits.and_then(|l| l.op_span);
    past.known.op_limits = limits.and_then(|l| l.op_limits).map(|[low, high]| (low, high));
    Ok((past, config))
}

/// By which a reading is known again. Where its tags are read belongs to it: one that is added, or read elsewhere since, has a past
/// that was not read.
fn key(args: &Args, server: &str, [from, to]: [f64; 2], tags: &[&TagName]) -> String {
    let own = args.of_loop.as_deref().unwrap_or_default();
    let places: Vec<String> = tags.iter().map(|tag| format!("{} {}", tag.tag, tag.source)).collect();
    // As text in quotes it has no tab and no line end of its own.
    format!("{own}\t{server}\t{from}\t{to}\t{}\t{:?}\t{places:?}", args.newest_first, args.average)
}

/// How far one reading has come: a line of a small file, replaced whole.
struct Progress {
    path: PathBuf,
    key: String,
}

impl Progress {
    fn lines(&self) -> Vec<String> {
        let text = fs::read_to_string(&self.path).unwrap_or_default();
        let other = |line: &&str| line.rsplit_once('\t').is_some_and(|(key, _)| key != self.key);
        text.lines().filter(other).map(str::to_string).collect()
    }

    fn done(&self) -> Option<f64> {
        let text = fs::read_to_string(&self.path).ok()?;
        let own = |line: &str| line.rsplit_once('\t').filter(|(key, _)| *key == self.key)?.1.parse().ok();
        text.lines().find_map(own)
    }

    fn set(&self, done: f64) -> std::io::Result<()> {
        let mut lines = self.lines();
        lines.push(format!("{}\t{done}", self.key));
        let new = self.path.with_extension("new");
        fs::write(&new, lines.join("\n") + "\n")?;
        fs::rename(new, &self.path)
    }
}

/// The namespaces of all servers, and the file that has them.
struct Namespaces {
    path: PathBuf,
    pinned: Pinned,
    kept: String,
}

impl Namespaces {
    fn open(path: PathBuf) -> Result<Self, Failure> {
        let remedy = "take it away, and numbers of namespaces mean what the servers say now";
        let pinned =
            Pinned::read(&path).map_err(|error| Failure::in_file(&path, format!("{error}; {remedy}")))?;
        Ok(Self { path, kept: pinned.to_text(), pinned })
    }

    /// Keeps what is new.
    fn note(&mut self) -> std::io::Result<()> {
        let text = self.pinned.to_text();
        if text != self.kept {
            Pinned::keep(&text, &self.path)?;
            self.kept = text;
        }
        Ok(())
    }
}

/// Puts slices into the store. One that was kept and not noted is read again, and changes nothing.
struct Kept<'s> {
    store: &'s mut Store,
    names: &'s HashMap<usize, Arc<TagName>>,
    progress: Progress,
    namespaces: &'s mut Namespaces,
    newest_first: bool,
    bar: super::Bar,
    slices: usize,
    at: usize,
}

impl Keep for Kept<'_> {
    async fn keep(&mut self, slice: Slice) -> Result<(), String> {
        let named =
            |(at, samples): (usize, Vec<Sample>)| Some(Series { tag: self.names.get(&at)?.clone(), samples });
        let batch = Batch { series: slice.series.into_iter().filter_map(named).collect(), rows: Vec::new() };
        // Before there is anything of these nodes.
        let noted = self.namespaces.note();
        noted.map_err(|error| format!("{}: {error}", self.namespaces.path.display()))?;
        self.store.insert(&batch).map_err(|error| error.to_string())?;
        let done = if self.newest_first { slice.from } else { slice.to };
        self.progress.set(done).map_err(|error| format!("{}: {error}", self.progress.path.display()))?;
        self.at += usize::from(slice.is_last);
        self.bar.show(self.at, self.slices);
        Ok(())
    }
}
