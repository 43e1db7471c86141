//! Loops out of a store: the folder of one, one in PostgreSQL, or the one that a configuration names.

use super::Args;
use super::source::{MOST, OneLoop, Take, why};
use crate::cli::backfill::sources::of_tags;
use crate::cli::{Failure, store as cli_store, table};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};
use stictiond::config::{self, Config, LoopConfig};
use stictiond::diagnosis::Settings;
use stictiond::schedule::Clock;
use stictiond::serve::dto::rfc3339;
use stictiond::signal::{Record, Sample};
use stictiond::store::{self, Reader, StoreError, StoredTag, TagName};

/// How addresses of PostgreSQL begin.
const ADDRESSES: [&str; 2] = ["postgres://", "postgresql://"];
/// The variable that has the password of such an address.
const PASSWORD: &str = "PGPASSWORD";
/// How far back a store is read where nothing is said (s): as far as the daemon looks, a week.
const WEEK_S: f64 = 604_800.0;
/// Most samples in memory at once: 400 MB. A loop with more is left out.
const MOST_SAMPLES: usize = 1 << 24;
/// Tags that a look at the plant takes; a diagnosis takes the others too.
const ROLES: [&str; 6] = ["op", "pv", "sp", "mode", "mv", "term"];
/// Tags that are measured. What the others were before counts on, because they may be told only when they change.
const MEASURED: [&str; 2] = ["op", "pv"];

/// Tags, each with samples of it.
type Tagged = Vec<(StoredTag, Vec<Sample>)>;

/// A store that is open, and its loops.
pub struct Stored {
    place: PathBuf,
    reader: Reader,
    /// Tags that are best read together.
    together: usize,
    loops: Vec<(String, Vec<StoredTag>)>,
    /// From when to when it is read (s).
    span: [f64; 2],
    config: Option<Config>,
    /// Loop, tag and source of each tag that the configuration has read.
    configured: HashSet<(String, String, String)>,
}

impl Stored {
    /// Opens the store that the argument names; `None` where it names none.
    pub fn open(args: &Args) -> Result<Option<Self>, Failure> {
        let place = args.source.clone();
        let Some((settings, config)) = settings(&place)? else { return Ok(None) };
        let is_folder = config.is_none() && settings.url.is_none();
        let mut reader = match Reader::of(&settings) {
            Err(StoreError::Missing(_)) if is_folder => return Ok(None),
            found => found.map_err(|error| cli_store::of_store(&error))?,
        };
        let of_store = |error: StoreError| cli_store::of_store(&error);
        let mut loops: BTreeMap<String, Vec<StoredTag>> = BTreeMap::new();
        for tag in reader.tags().map_err(of_store)? {
            loops.entry(tag.name.control_loop.clone()).or_default().push(tag);
        }
        if let Some(config) = &config {
            loops.retain(|name, _| config.loops.iter().any(|own| own.id == *name));
        }
        if loops.len() > MOST {
            return Err(Failure::in_file(&place, format!("{} loops, {MOST} are the most", loops.len())));
        }
        let roles = loops.values().flatten().filter(|tag| ROLES.contains(&tag.name.tag.as_str()));
        let roles: Vec<StoredTag> = roles.cloned().collect();
        let span = span(args, &mut reader, &roles, Clock::wall().now()).map_err(of_store)?;
        let configured = config.as_ref().map(|config| tags_of(config, &place)).transpose()?;
        Ok(Some(Self {
            together: Reader::together(&settings),
            loops: loops.into_iter().collect(),
            configured: configured.unwrap_or_default(),
            place,
            reader,
            span,
            config,
        }))
    }

    /// Hands on every loop that is `wanted`. `whole`: with the tags that are no role of it, too.
    pub fn each(
        &mut self,
        args: &Args,
        whole: bool,
        wanted: &dyn Fn(&str) -> bool,
        take: Take<'_>,
    ) -> Result<(), Failure> {
        let of = self.loops.len();
        let is_taken = |tag: &&StoredTag| whole || ROLES.contains(&tag.name.tag.as_str());
        let own = |(name, tags): &(String, Vec<StoredTag>)| {
            (name.clone(), tags.iter().filter(is_taken).cloned().collect::<Vec<StoredTag>>())
        };
        let chosen: Vec<(String, Vec<StoredTag>)> =
            self.loops.iter().filter(|(name, _)| wanted(name)).map(own).collect();
        let (mut rest, mut most) = (chosen.as_slice(), self.together);
        while !rest.is_empty() {
            let (now, later) = rest.split_at(fitting(rest, most));
            let tags: Vec<StoredTag> = now.iter().flat_map(|(_, tags)| tags.iter().cloned()).collect();
            let found = self.reader.apart(&tags, self.span, &mut |samples| samples <= MOST_SAMPLES);
            match (found.map_err(|error| cli_store::of_store(&error))?, now) {
                (Some(found), _) => {
                    let mut by_loop: HashMap<String, Tagged> = HashMap::new();
                    for (tag, samples) in found {
                        by_loop.entry(tag.name.control_loop.clone()).or_default().push((tag, samples));
                    }
                    for (name, _) in now {
                        let own = by_loop.remove(name).unwrap_or_default();
                        let own = self.with_earlier(own)?;
                        let record = self.record(args, name, own);
                        take(OneLoop { name: name.clone(), of, record });
                    }
                    rest = later;
                }
                (None, [(name, _)]) => {
                    let why = format!(
                        "more than {MOST_SAMPLES} samples: name a shorter time with --from and --to-time"
                    );
                    take(OneLoop { name: name.clone(), of, record: Err(why) });
                    (rest, most) = (later, self.together);
                }
                (None, _) => most = tags.len() / 2,
            }
        }
        Ok(())
    }

    /// Before the samples of a loop what was in force when they begin.
    fn with_earlier(&mut self, mut own: Tagged) -> Result<Tagged, Failure> {
        let from = self.span[0];
        let firsts = |name: &str| {
            let of = own.iter().filter(|(tag, _)| tag.name.tag == name).filter_map(|(_, all)| all.first());
            of.map(|first| first.t).fold(f64::INFINITY, f64::min)
        };
        let begin = firsts("pv");
        let is_late = |tag: &StoredTag| {
            let name = tag.name.tag.as_str();
            !MEASURED.contains(&name) && firsts(name) > begin
        };
        let late: Vec<StoredTag> =
            own.iter().map(|(tag, _)| tag).filter(|tag| is_late(tag)).cloned().collect();
        if late.is_empty() || from <= 0.0 {
            return Ok(own);
        }
        let found = self.reader.in_force(&late, &MEASURED, [from, from], &mut |_| true);
        let found = found.map_err(|error| cli_store::of_store(&error))?;
        for (tag, mut earlier) in found.unwrap_or_default() {
            earlier.retain(|sample| sample.t < from);
            if let Some((_, samples)) = own.iter_mut().find(|(other, _)| other.id == tag.id) {
                earlier.append(samples);
                *samples = earlier;
            }
        }
        Ok(own)
    }

    /// The record of a loop, with the span of its OP.
    fn record(&self, args: &Args, name: &str, own: Tagged) -> Result<Record, String> {
        let key = |tag: &TagName| (tag.control_loop.clone(), tag.tag.clone(), tag.source.clone());
        let (past, unit) = of_tags(own, &|tag| self.configured.contains(&key(tag)));
        let [from, to] = self.span;
        let mut record = past.window(from, to);
        let config = self.configured(name);
        let limits = config.and_then(|own| own.op_limits).map(|[low, high]| (low, high));
        record.op_limits = args.op_limits.or(limits);
        let unit = config.and_then(|own| own.op.unit()).map(str::to_string).or(unit);
        let given = config.and_then(|own| own.op_span);
        let remedy = "name a configuration instead of the store, in which unit, op_span and op_limits of the loop are right";
        table::scale_or(&self.place, &mut record, (given, unit.as_deref()), remedy)
            .map_err(|failure| why(&self.place, failure))?;
        Ok(record)
    }

    /// Why there is nothing, where none of its loops is there.
    pub fn no_loop(&self) -> &'static str {
        match self.config {
            None => "the store has no samples of a loop",
            Some(_) => "the store has no samples of a loop of this configuration",
        }
    }

    /// From when to when it is read, in words.
    pub fn span(&self) -> String {
        let [from, to] = self.span.map(rfc3339);
        let [from, to] = [from.as_deref().unwrap_or("its beginning"), to.as_deref().unwrap_or("its end")];
        format!("read from {from} to {to}")
    }

    /// What is damaged of it.
    pub fn remark(&self) -> Option<String> {
        match (self.reader.lost(), self.reader.damaged()) {
            (Some((left, _)), _) => Some(format!("it is damaged; {left}")),
            (None, 0) => None,
            (None, damaged) => Some(format!("{damaged} damaged chunks left out; see stictiond store check")),
        }
    }

    /// What the configuration says of a loop.
    pub fn configured(&self, name: &str) -> Option<&LoopConfig> {
        self.config.as_ref()?.loops.iter().find(|own| own.id == name)
    }

    /// How valves are diagnosed.
    pub fn settings(&self) -> Settings {
        self.config.as_ref().map_or_else(Settings::default, |config| Settings::from(&config.diagnosis))
    }
}

/// From when to when a store is read (s): where nothing is said, the latest week in which one of some tags has a sample. Up to `now` (s),
/// because a tag whose clock is ahead says nothing of how long ago the others are.
fn span(args: &Args, reader: &mut Reader, tags: &[StoredTag], now: f64) -> Result<[f64; 2], StoreError> {
    let before = |t: f64| (t.clamp(0.0, 1e11) as i64) + 1;
    let mut end = args.to_time.unwrap_or(now);
    let mut last = reader.last_start(tags, before(end))?;
    if last.is_none() && args.to_time.is_none() {
        // All of it was stamped by a clock that is ahead of ours.
        (end, last) = (f64::MAX, reader.last_start(tags, i64::MAX)?);
    }
    let week = last.map_or(0.0, |last| (last as f64 - WEEK_S).max(0.0));
    let from = args.from.unwrap_or(week);
    let is_ahead = args.to_time.is_none() && from > end;
    Ok([from, if is_ahead { f64::MAX } else { end }])
}

/// How many of the first loops have no more tags together than that: one at least.
fn fitting(loops: &[(String, Vec<StoredTag>)], most: usize) -> usize {
    let mut sum = 0;
    let fits = |(_, tags): &&(String, Vec<StoredTag>)| {
        sum += tags.len();
        sum <= most
    };
    loops.iter().take_while(fits).count().max(1)
}

/// The settings of the store that a path or an address names, and the configuration that has them.
fn settings(place: &Path) -> Result<Option<(store::Config, Option<Config>)>, Failure> {
    let is_address = |own: &&str| ADDRESSES.iter().any(|begin| own.starts_with(begin));
    if let Some(url) = place.to_str().filter(is_address) {
        return Ok(Some((database(url)?, None)));
    }
    if place.extension().is_some_and(|own| own.eq_ignore_ascii_case("toml")) {
        let config = config::load(place).map_err(Failure::BadConfig)?;
        let own = config.store.clone();
        let own = own.ok_or_else(|| Failure::in_file(place, "there is no [store] in it"))?;
        return Ok(Some((own, Some(config))));
    }
    Ok(place.is_dir().then(|| (store::Config::new(place), None)))
}

/// The settings of a store in PostgreSQL at an address.
fn database(url: &str) -> Result<store::Config, Failure> {
    let password_env = std::env::var_os(PASSWORD).map(|_| PASSWORD.to_string());
    // No folder is called so: what waits for the database lies beside the daemon.
    let config = store::Config { url: Some(url.to_string()), password_env, ..store::Config::new(url) };
    match config.validate().into_iter().find(|(field, _)| *field == "url") {
        Some((_, why)) => Err(Failure::BadInput(format!(
            "the address of PostgreSQL {why}; a password is taken from {PASSWORD}, and other settings from a configuration that is named \
             instead"
        ))),
        None => Ok(config),
    }
}

/// Loop, tag and source of each tag of a configuration.
fn tags_of(config: &Config, place: &Path) -> Result<HashSet<(String, String, String)>, Failure> {
    let plant = config.plant().map_err(|issues| {
        let issues: Vec<String> =
            issues.iter().map(|issue| format!("{}: {}", issue.field, issue.message)).collect();
        Failure::in_file(place, issues.join("; "))
    })?;
    let tags = plant.loops.iter().flat_map(|own| own.tags.iter().map(move |tag| (&own.id, tag)));
    Ok(tags.map(|(id, tag)| (id.to_string(), tag.kind.name().to_string(), tag.source.clone())).collect())
}
