//! The store as tables in files that other programs read: CSV and Parquet, row by row in bounded memory; and samples from
//! tables, which `table` reads, gathered for the store.

mod csv;
mod parquet;

use super::walk::first_start;
use super::{Batch, Reader, Series, StoreError, StoredTag, TagName, rows};
use crate::signal::{Quality, Sample};
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Samples handed on in one go by [`Import`].
const BATCH: usize = 100_000;
/// Rows of a kind that is no sample, read in one go.
const ROWS: usize = 500;
/// A stamp before this (s, March 1973) is no date of a plant. Times of day, and those since something began, are read as such.
const DATED_FROM: f64 = 1e8;
/// No stamp is later (s, the year 5138). A time that is asked for may be, and would not fit into whole seconds.
const LATEST: f64 = 1e11;

/// Why a file is no archive, or cannot be made one.
#[derive(Debug, thiserror::Error)]
pub enum ArchiveError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The file could not be read or written.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The file is not what its name says, or a row of it is not.
    #[error("{0}")]
    Format(String),
}

/// How a file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Comma, a header, UTF-8; a number that does not exist is an empty cell.
    Csv,
    /// Parquet, zstd; what does not exist is null.
    Parquet,
}

impl Format {
    /// By the end of the file's name.
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "csv" => Some(Self::Csv),
            "parquet" => Some(Self::Parquet),
            _ => None,
        }
    }
}

/// What is exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Samples in full.
    Samples,
    /// What samples were thinned to.
    Trends,
    /// Runs, with the whole report as JSON.
    Diagnoses,
    /// What happened to alarms.
    Alarms,
}

/// Which rows are exported.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choice {
    /// Of these loops; of all when empty.
    pub loops: Vec<String>,
    /// From this time on (s).
    pub from: Option<f64>,
    /// Up to and with this time (s).
    pub to: Option<f64>,
}

impl Choice {
    fn has_loop(&self, control_loop: &str) -> bool {
        self.loops.is_empty() || self.loops.iter().any(|own| own == control_loop)
    }

    fn has_time(&self, t: f64) -> bool {
        self.from.is_none_or(|from| t >= from) && self.to.is_none_or(|to| t <= to)
    }
}

/// A column's name and what its cells are.
type Column = (&'static str, Type);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Type {
    Text,
    Number,
}

/// One value of a row.
#[derive(Clone, Debug, PartialEq)]
enum Cell {
    Text(Arc<str>),
    Number(f64),
    Nothing,
}

impl Cell {
    fn text(text: &str) -> Self {
        Self::Text(text.into())
    }

    fn maybe(text: Option<&str>) -> Self {
        text.map_or(Self::Nothing, Self::text)
    }

    fn number(value: Option<f64>) -> Self {
        value.filter(|value| !value.is_nan()).map_or(Self::Nothing, Self::Number)
    }
}

/// Takes the rows of a table.
trait Sink {
    fn row(&mut self, cells: &[Cell]) -> Result<(), ArchiveError>;
    fn finish(self: Box<Self>) -> Result<(), ArchiveError>;
}

const SAMPLES: [Column; 8] = [
    ("loop", Type::Text),
    ("tag", Type::Text),
    ("source", Type::Text),
    ("unit", Type::Text),
    ("era", Type::Number),
    ("t", Type::Number),
    ("value", Type::Number),
    ("quality", Type::Text),
];
const TRENDS: [Column; 9] = [
    ("loop", Type::Text),
    ("tag", Type::Text),
    ("source", Type::Text),
    ("unit", Type::Text),
    ("era", Type::Number),
    ("t", Type::Number),
    ("least", Type::Number),
    ("mean", Type::Number),
    ("most", Type::Number),
];
const DIAGNOSES: [Column; 14] = [
    ("loop", Type::Text),
    ("t", Type::Number),
    ("took_s", Type::Number),
    ("trigger", Type::Text),
    ("outcome", Type::Text),
    ("reason_code", Type::Text),
    ("reason", Type::Text),
    ("f", Type::Number),
    ("f_low", Type::Number),
    ("f_high", Type::Number),
    ("f_unit", Type::Text),
    ("delta_aic", Type::Number),
    ("version", Type::Text),
    ("report", Type::Text),
];
const ALARMS: [Column; 10] = [
    ("loop", Type::Text),
    ("t", Type::Number),
    ("before", Type::Text),
    ("after", Type::Text),
    ("cause", Type::Text),
    ("by", Type::Text),
    ("comment", Type::Text),
    ("kind", Type::Text),
    ("priority", Type::Text),
    ("detail", Type::Text),
];

/// Writes what is chosen to a file that must not be there yet; it has its name only once it is whole. How many rows it has.
///
/// # Errors
/// [`ArchiveError`]; no file is left then.
pub fn export(
    reader: &mut Reader,
    kind: Kind,
    choice: &Choice,
    format: Format,
    to: &Path,
) -> Result<u64, ArchiveError> {
    if to.exists() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "the file is there already").into());
    }
    let mut part = to.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    let exported = export_to(reader, kind, choice, format, &part);
    if exported.is_ok() {
        fs::rename(&part, to)?;
    } else {
        // What was begun is of no use; that it cannot be removed is no news beside the error itself.
        let _ = fs::remove_file(&part);
    }
    exported
}

fn export_to(
    reader: &mut Reader,
    kind: Kind,
    choice: &Choice,
    format: Format,
    to: &Path,
) -> Result<u64, ArchiveError> {
    let file = File::create(to)?;
    let columns: &[Column] = match kind {
        Kind::Samples => &SAMPLES,
        Kind::Trends => &TRENDS,
        Kind::Diagnoses => &DIAGNOSES,
        Kind::Alarms => &ALARMS,
    };
    let mut sink: Box<dyn Sink> = match format {
        Format::Csv => Box::new(csv::Writer::new(BufWriter::new(file), columns)?),
        Format::Parquet => Box::new(parquet::Writer::new(file, columns)?),
    };
    let rows = match kind {
        Kind::Samples => samples(reader, choice, sink.as_mut()),
        Kind::Trends => trends(reader, choice, sink.as_mut()),
        Kind::Diagnoses => diagnoses(reader, choice, sink.as_mut()),
        Kind::Alarms => alarms(reader, choice, sink.as_mut()),
    }?;
    sink.finish()?;
    Ok(rows)
}

fn chosen(reader: &Reader, choice: &Choice) -> Result<Vec<(StoredTag, [Cell; 5])>, ArchiveError> {
    let tags = reader.tags()?.into_iter().filter(|tag| choice.has_loop(&tag.name.control_loop));
    let cells = |tag: &StoredTag| {
        let name = &tag.name;
        let texts = [&name.control_loop, &name.tag, &name.source, &name.unit].map(|text| Cell::text(text));
        let [a, b, c, d] = texts;
        [a, b, c, d, Cell::Number(tag.era as f64)]
    };
    Ok(tags.map(|tag| (cells(&tag), tag)).map(|(cells, tag)| (tag, cells)).collect())
}

fn samples(reader: &mut Reader, choice: &Choice, sink: &mut dyn Sink) -> Result<u64, ArchiveError> {
    let tags = chosen(reader, choice)?;
    let ids: Vec<u32> = tags.iter().map(|(tag, _)| tag.id).collect();
    let qualities = Quality::ALL.map(|quality| (quality, Cell::text(quality.as_str())));
    let (mut rows, mut from) = (0, first_start(choice.from.unwrap_or(0.0)));
    while let Some(start) =
        reader.next_start(from)?.filter(|start| choice.to.is_none_or(|to| *start as f64 <= to))
    {
        from = start + 1;
        for (id, samples) in reader.chunk(start, Some(&ids))? {
            let Ok(at) = ids.binary_search(&id) else { continue };
            let name = &tags[at].1;
            for s in samples.into_iter().filter(|s| choice.has_time(s.t)) {
                let quality = qualities.iter().find(|(known, _)| *known == s.quality);
                let quality = quality.map_or(Cell::Nothing, |(_, cell)| cell.clone());
                let [a, b, c, d, e] = name.clone();
                sink.row(&[a, b, c, d, e, Cell::Number(s.t), Cell::number(Some(s.value)), quality])?;
                rows += 1;
            }
        }
    }
    Ok(rows)
}

fn trends(reader: &mut Reader, choice: &Choice, sink: &mut dyn Sink) -> Result<u64, ArchiveError> {
    let mut rows = 0;
    for (tag, name) in chosen(reader, choice)? {
        let (from, to) = (choice.from.unwrap_or(0.0), choice.to.unwrap_or(LATEST).min(LATEST));
        for point in reader.trends(tag.id, from as i64, to as i64 + 1)? {
            if choice.has_time(point.t) {
                let [a, b, c, d, e] = name.clone();
                let numbers = [point.least, point.mean, point.most].map(|value| Cell::number(Some(value)));
                let [least, mean, most] = numbers;
                sink.row(&[a, b, c, d, e, Cell::Number(point.t), least, mean, most])?;
                rows += 1;
            }
        }
    }
    Ok(rows)
}

fn diagnoses(reader: &mut Reader, choice: &Choice, sink: &mut dyn Sink) -> Result<u64, ArchiveError> {
    let (mut rows, mut after) = (0, 0);
    loop {
        let some = reader.diagnoses(after, ROWS)?;
        let Some((last, _)) = some.last() else { return Ok(rows) };
        after = *last;
        for (_, row) in &some {
            if !choice.has_loop(&row.control_loop) || !choice.has_time(row.finished) {
                continue;
            }
            let report = row.report.as_deref().and_then(rows::unpack);
            sink.row(&[
                Cell::text(&row.control_loop),
                Cell::Number(row.finished),
                Cell::number(Some(row.took_s)),
                Cell::text(if row.on_demand { "on_demand" } else { "periodic" }),
                Cell::text(&row.outcome),
                Cell::maybe(row.reason_code.as_deref()),
                Cell::text(&row.reason),
                Cell::number(row.f),
                Cell::number(row.f_ci95.map(|[low, _]| low)),
                Cell::number(row.f_ci95.map(|[_, high]| high)),
                Cell::text(if row.f_in_percent { "% OP" } else { "OP units" }),
                Cell::number(row.delta_aic),
                Cell::text(&row.version),
                Cell::maybe(report.as_deref()),
            ])?;
            rows += 1;
        }
    }
}

fn alarms(reader: &mut Reader, choice: &Choice, sink: &mut dyn Sink) -> Result<u64, ArchiveError> {
    let (mut rows, mut after) = (0, 0);
    loop {
        let some = reader.transitions(after, ROWS)?;
        let Some((last, _)) = some.last() else { return Ok(rows) };
        after = *last;
        for (_, row) in &some {
            if !choice.has_loop(&row.control_loop) || !choice.has_time(row.at) {
                continue;
            }
            sink.row(&[
                Cell::text(&row.control_loop),
                Cell::Number(row.at),
                Cell::text(&row.before),
                Cell::text(&row.after),
                Cell::text(&row.cause),
                Cell::maybe(row.by.as_deref()),
                Cell::maybe(row.comment.as_deref()),
                Cell::text(&row.kind),
                Cell::maybe(row.priority.as_deref()),
                Cell::text(&row.detail),
            ])?;
            rows += 1;
        }
    }
}

/// Source and unit of a loop's tag, for samples that name none.
pub type Sources<'a> = &'a dyn Fn(&str, &str) -> Option<(String, String)>;

/// Where a sample that is imported belongs.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a> {
    /// The loop.
    pub control_loop: &'a str,
    /// Its tag.
    pub tag: &'a str,
    /// Where the sample came from at first, where that is known.
    pub source: Option<&'a str>,
    /// Its unit, where that is known.
    pub unit: Option<&'a str>,
}

/// What became of the samples of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gathered {
    /// Samples that were handed on.
    pub handed_on: u64,
    /// Samples that were left out, because their times have no date.
    pub undated: u64,
}

/// Gathers samples that a reader of tables hands over, and hands them on some at a time.
pub struct Import<'a> {
    source: Sources<'a>,
    take: &'a mut dyn FnMut(&Batch) -> Result<(), StoreError>,
    /// Where in the batch the samples of a tag are.
    names: HashMap<TagName, usize>,
    batch: Batch,
    held: usize,
    gathered: Gathered,
    /// The time of the first sample without a date (s).
    first_undated: Option<f64>,
}

impl<'a> Import<'a> {
    /// Nothing is gathered yet.
    pub fn new(source: Sources<'a>, take: &'a mut dyn FnMut(&Batch) -> Result<(), StoreError>) -> Self {
        let (names, batch, gathered) = (HashMap::new(), Batch::default(), Gathered::default());
        Self { source, take, names, batch, held: 0, gathered, first_undated: None }
    }

    /// One more sample. One whose time has no date is counted and left out: an archive may have some stamps of a clock that was
    /// not set yet.
    ///
    /// # Errors
    /// [`ArchiveError::Format`] for one that belongs nowhere; what was handed on before stays handed on.
    pub fn sample(&mut self, place: &Place<'_>, sample: Sample) -> Result<(), ArchiveError> {
        let Place { control_loop, tag, source, unit } = *place;
        if control_loop.is_empty() || tag.is_empty() {
            return Err(ArchiveError::Format("a sample without a loop or a tag".into()));
        }
        if !(sample.t.is_finite() && sample.t >= 0.0) {
            return Err(ArchiveError::Format(format!(
                "a time of {} s: times must be seconds since 1970, or dates",
                sample.t
            )));
        }
        if sample.t < DATED_FROM {
            self.gathered.undated += 1;
            self.first_undated.get_or_insert(sample.t);
            return Ok(());
        }
        let (source, unit) = match source {
            Some(source) => (source.to_string(), unit.unwrap_or_default().to_string()),
            None => (self.source)(control_loop, tag)
                .unwrap_or_else(|| ("import".to_string(), unit.unwrap_or_default().to_string())),
        };
        let name = TagName { control_loop: control_loop.into(), tag: tag.into(), source, unit };
        let series = match self.names.get(&name) {
            Some(&at) => at,
            None => {
                self.batch.series.push(Series { tag: Arc::new(name.clone()), samples: Vec::new() });
                self.names.insert(name, self.batch.series.len() - 1);
                self.batch.series.len() - 1
            }
        };
        self.batch.series[series].samples.push(sample);
        self.held += 1;
        if self.held >= BATCH { self.hand_on() } else { Ok(()) }
    }

    /// Hands the rest on: what became of the samples.
    ///
    /// # Errors
    /// What the store said, and [`ArchiveError::Format`] where no sample has a date: then nothing was handed on.
    pub fn end(mut self) -> Result<Gathered, ArchiveError> {
        match self.first_undated {
            Some(t) if self.held == 0 && self.gathered.handed_on == 0 => Err(ArchiveError::Format(format!(
                "a time of {t} s, and no other has a date: times must be seconds since 1970, or dates; a time of day, or one since \
                 the start, does not tell when it was: save the table with dates, or say how its times are written with \
                 --time-format, or what its numbers count with --time-unit"
            ))),
            _ => {
                self.hand_on()?;
                Ok(self.gathered)
            }
        }
    }

    fn hand_on(&mut self) -> Result<(), ArchiveError> {
        (self.take)(&self.batch)?;
        self.gathered.handed_on += self.held as u64;
        self.held = 0;
        self.batch.series.clear();
        self.names.clear();
        Ok(())
    }
}

#[cfg(test)]
mod tests;
