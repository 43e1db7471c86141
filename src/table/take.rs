//! The second reading: rows become samples by what the first one decided.

use super::channel::Tag;
use super::error::{TableError, listed};
use super::found::Found;
use super::joined::Joined;
use super::layout::Body;
use super::look;
use super::odd_rows::{is_total, passed_over};
use super::options::Options;
use super::owner::Owner;
use super::roles::ROLES;
use super::says::{behind_number, measured};
use super::source::{Cell, Rows, Source};
use super::survey::Plan;
use super::time_columns;
use super::{MAX_VALUES, Table};
use crate::signal::{BadReason, LARGEST_VALUE, Quality, Record, Role, Sample, Series, outages};
use std::collections::HashMap;

/// Samples of one loop.
pub fn record(source: Source<'_>, plan: Plan) -> Result<Table, TableError> {
    let mut series: Vec<Series> = plan.channels.iter().map(|_| Series::new()).collect();
    let mut values = 0;
    let wanted: Vec<bool> =
        plan.channels.iter().map(|own| matches!(own.role, Some(Role::Op | Role::Pv))).collect();
    // The plan holds the sheets of a workbook. It is dropped here, so that they do not stay in memory beside the series.
    let (Plan { channels, .. }, mut found) = all(source, plan, &wanted, &mut |at, sample| {
        series[at].push(sample);
        values += 1;
        if values > MAX_VALUES {
            return Err(TableError::refused(format!(
                "more than {MAX_VALUES} values: cut the record into shorter files, or take it into a store with \
                 `stictiond store import`, which has no such limit, and `backfill` that"
            )));
        }
        Ok(())
    })?;
    let mut record = Record::default();
    for (channel, series) in channels.iter().zip(series) {
        // A tag of text only (an operator's remark) or a column that is blank throughout was not recorded.
        let recorded = channel.numbers > 0 || channel.words.is_some() && !series.is_empty();
        if !recorded || channel.says_of_another || channel.tag.name.is_empty() && channel.role.is_none() {
            continue;
        }
        match channel.role {
            Some(Role::Op) => record.op = series,
            Some(Role::Pv) => record.pv = series,
            Some(Role::Sp) => record.sp = Some(series),
            Some(Role::Mode) => record.mode = Some(series),
            Some(Role::Mv) => record.mv = Some(series),
            Some(Role::Term) => record.term = Some(series),
            None => record.tags.push((channel.tag.name.clone(), series)),
        }
    }
    for (role, series) in [(Role::Op, &record.op), (Role::Pv, &record.pv)] {
        found.read_as.extend(twice(role, series)?);
    }
    record.find_span(None, found.op_unit.as_deref());
    for (role, series) in [(Role::Op, &record.op), (Role::Pv, &record.pv)] {
        found.read_as.extend(none_of(role, series));
    }
    Ok(Table { record, found })
}

/// One sample in so many may have the time of another and another value.
const TWICE: usize = 10;
/// So few of them are never refused: the diagnosis counts them.
const FEW: usize = 20;

/// Refuses a tag that has two values at the same times, in different places of the file. Those one after the other are told.
pub fn twice(role: Role, series: &[Sample]) -> Result<Option<String>, TableError> {
    // Samples in a row with one time are of one run.
    let (mut run, mut last, mut good) = (0usize, f64::NAN, Vec::with_capacity(series.len()));
    for own in series.iter().filter(|own| own.quality.is_good()) {
        run += usize::from(own.t != last);
        last = own.t;
        good.push((own.t, run, own.value));
    }
    let count = good.len();
    good.sort_by(|a, b| a.0.total_cmp(&b.0));
    let other = good.windows(2).filter(|pair| pair[0].0 == pair[1].0 && pair[0].2 != pair[1].2);
    let (near, far): (Vec<_>, Vec<_>) = other.partition(|pair| pair[0].1 == pair[1].1);
    let (near, far, role) = (near.len(), far.len(), role.as_str());
    if far > FEW && far * TWICE > count {
        return Err(TableError::refused(format!(
            "{far} of {count} samples of {role} have the time of another one and another value: two tables in one file; save them apart"
        )));
    }
    Ok((near * TWICE > count).then(|| {
        format!(", {near} of {count} samples of {role} have the time of the one before and do not count")
    }))
}

/// What is said of good values that stand for no measurement: the diagnosis leaves them out.
fn none_of(role: Role, series: &[Sample]) -> Option<String> {
    let good: Vec<Sample> =
        series.iter().filter(|s| s.quality.is_good() && s.value.is_finite()).copied().collect();
    // A file does not say between which limits the controller keeps OP.
    let outages = outages(&good);
    let is_none = |s: &&Sample| outages.contains(&s.value) || s.value.abs() >= LARGEST_VALUE;
    let mut values: Vec<f64> = good.iter().filter(is_none).map(|s| s.value).collect();
    let count = values.len();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let named: Vec<String> = values.iter().take(LINES).map(|value| format!("{value:?}")).collect();
    (count > 0)
        .then(|| format!(", {count} samples of {} are no measurements: {}", role.as_str(), named.join(", ")))
}

/// Samples of every tag, one after the other.
pub fn stream<E: From<TableError>>(
    source: Source<'_>,
    plan: Plan,
    options: &Options,
    take: &mut dyn FnMut(&Tag, Sample) -> Result<(), E>,
) -> Result<Found, E> {
    let tags = owned(&plan, options)?;
    // A store knows an era from the one before by more than the time.
    let is_ours = plan.layout.is_ours();
    let wanted: Vec<bool> = tags.iter().map(|tag| tag.is_some() && !is_ours).collect();
    let mut failed = None;
    let walked = all(source, plan, &wanted, &mut |at, sample| {
        let Some(tag) = &tags[at] else { return Ok(()) };
        take(tag, sample).map_err(|error| {
            failed = Some(error);
            TableError::refused("taken no further")
        })
    });
    match (walked, failed) {
        (_, Some(error)) => Err(error),
        (walked, None) => Ok(walked?.1),
    }
}

/// The tag of each channel as a store keeps it, `pv` of `FIC101` for `FIC101.PV`; `None` where nothing is kept: of a tag of texts
/// alone, and of one that says of others whether they are good. What a tag is was decided with the others in sight.
fn owned(plan: &Plan, options: &Options) -> Result<Vec<Option<Tag>>, TableError> {
    let keeps_names = plan.layout.keeps_names();
    // The name of the tag that is this role of this loop.
    let mut taken: HashMap<(&str, &str), &str> = HashMap::new();
    let mut tags = Vec::with_capacity(plan.channels.len());
    for channel in &plan.channels {
        let full = channel.tag.name.as_str();
        if keeps_names && !channel.tag.owner.is_empty() {
            tags.push(Some(channel.tag.clone()));
            continue;
        }
        if full.is_empty() || channel.says_of_another || channel.role.is_none() && channel.is_text() {
            tags.push(None);
            continue;
        }
        let Some(own) = channel.control_loop.as_ref().or(options.of_loop.as_ref()) else {
            return Err(TableError::refused(format!("{full:?} names no loop; say which with --loop")));
        };
        let role = channel.role.map(Role::as_str);
        if let Some(role) = role {
            let other = *taken.entry((own.as_str(), role)).or_insert(full);
            if other != full {
                return Err(TableError::refused(format!(
                    "{} may each be {role} of loop {own:?}; say which with --{role}",
                    listed([other, full])
                )));
            }
        } else if ROLES.iter().any(|role| role.as_str() == full) && !keeps_names {
            // By this name it would be taken for what it is not.
            return Err(TableError::refused(format!(
                "{full:?} is not that of loop {own:?} by what was told, and is called as if it were; call it otherwise"
            )));
        }
        tags.push(Some(Tag {
            owner: own.clone(),
            name: role.unwrap_or(full).to_string(),
            ..channel.tag.clone()
        }));
    }
    Ok(tags)
}

/// What is counted on the way.
#[derive(Default)]
pub struct Counted {
    /// Rows without a stamp: the first lines, and how many.
    pub left_out: (Vec<u64>, u64),
    /// Samples that are not good by their quality.
    pub not_good: u64,
    /// Samples of the mode: all, not automatic, and words that nobody knows.
    pub modes: [u64; 3],
    /// Samples of OP and PV that are no numbers.
    pub no_number: u64,
}

/// Lines that are named.
const LINES: usize = 3;

/// What takes a sample, with the place of its channel.
pub type Take<'t> = &'t mut dyn FnMut(usize, Sample) -> Result<(), TableError>;

/// Takes every sample. The times of channels that are `wanted` must not be recorded twice.
fn all(
    source: Source<'_>,
    mut plan: Plan,
    wanted: &[bool],
    take: Take<'_>,
) -> Result<(Plan, Found), TableError> {
    ready(source, &mut plan, wanted)?;
    let counted = samples(source, &mut plan, take)?;
    let found = Found::new(&plan, &counted);
    Ok((plan, found))
}

/// What is looked at before samples are taken. The times of channels that are `wanted` must not be recorded twice.
pub fn ready(source: Source<'_>, plan: &mut Plan, wanted: &[bool]) -> Result<(), TableError> {
    look::look(source, plan)?;
    if !plan.joined.is_empty() {
        join(source, plan)?;
    }
    look::twice(source, plan, wanted)
}

/// Takes every sample of a table that is [`ready`], with the place of its channel.
pub fn samples(source: Source<'_>, plan: &mut Plan, take: Take<'_>) -> Result<Counted, TableError> {
    let mut counted = Counted::default();
    walk(source, plan, &mut |rows, plan, line, at| match at {
        Some(at) => row(rows, plan, at, &mut counted, take),
        None => {
            counted.left_out.1 += 1;
            if counted.left_out.0.len() < LINES {
                counted.left_out.0.push(line);
            }
            Ok(())
        }
    })?;
    Ok(counted)
}

/// The time of a row (s), and the tag that it is a sample of, where each row is one of one tag.
pub type At = (f64, Option<usize>);

/// What is done with a row, its line in the file and [`At`], which is `None` where the row has no time.
pub type Each<'e> = &'e mut dyn FnMut(&dyn Rows, &Plan, u64, Option<At>) -> Result<(), TableError>;

/// Every row of the loop, one after the other.
pub fn walk(source: Source<'_>, plan: &mut Plan, each: Each<'_>) -> Result<(), TableError> {
    plan.reading.rewind();
    plan.owner.iter_mut().for_each(Owner::begin);
    let mut rows = plan.layout.rows(plan.kind.rows(source, plan.separator)?)?;
    for _ in 0..plan.layout.skip {
        rows.next()?;
    }
    while let Some(line) = rows.next()? {
        let other = |owner: &mut Owner| !owner.takes(rows.as_ref());
        if passed_over(rows.as_ref(), &plan.layout) || plan.owner.as_mut().is_some_and(other) {
            continue;
        }
        if is_total(rows.as_ref(), &plan.layout) {
            each(rows.as_ref(), plan, line, None)?;
            continue;
        }
        let first = rows.cell(plan.layout.time);
        let second = plan.layout.clock.map(|at| rows.cell(at));
        let part = |at: usize| time_columns::part(&rows.cell(at).shown(), &plan.layout.names[at]);
        let part = plan.layout.millis.map_or(Some(0.0), part);
        let tag = match &plan.layout.body {
            Body::Wide(_) => None,
            Body::Long(long) => plan.tags.get(&Tag::of_row(rows.as_ref(), long)).copied(),
        };
        let read = plan.reading.next(&first, second.as_ref(), (tag.unwrap_or(0), line));
        let at = read.zip(part).map(|(t, part)| (t + part, tag));
        each(rows.as_ref(), plan, line, at)?;
    }
    Ok(())
}

/// Reads the tags that say whether others are good.
fn join(source: Source<'_>, plan: &mut Plan) -> Result<(), TableError> {
    let mut joined = std::mem::take(&mut plan.joined);
    let place: HashMap<usize, usize> = joined.iter().enumerate().map(|(at, own)| (own.by, at)).collect();
    let mut values = 0;
    walk(source, plan, &mut |rows, plan, _, at| {
        let (Body::Long(long), Some((t, Some(tag)))) = (&plan.layout.body, at) else { return Ok(()) };
        let Some(own) = place.get(&tag).map(|at| &mut joined[*at]) else { return Ok(()) };
        values += 1;
        if values > MAX_VALUES {
            return Err(TableError::refused(format!(
                "more than {MAX_VALUES} qualities: cut the table into shorter files"
            )));
        }
        own.since.push((t, own.says.quality(&rows.cell(long.value))));
        Ok(())
    })?;
    joined.iter_mut().for_each(Joined::sort);
    plan.joined = joined;
    Ok(())
}

/// The samples of one row at `t`, which is one of `tag` where each row is a sample of one tag.
pub fn row(
    rows: &dyn Rows,
    plan: &Plan,
    (t, tag): At,
    counted: &mut Counted,
    take: &mut dyn FnMut(usize, Sample) -> Result<(), TableError>,
) -> Result<(), TableError> {
    match &plan.layout.body {
        Body::Wide(wide) => {
            for (at, column) in wide.columns.iter().enumerate() {
                let cell = rows.cell(*column);
                if !cell.is_blank() {
                    let sample = sample(rows, plan, at, &cell, t, counted);
                    take(at, sample)?;
                }
            }
        }
        Body::Long(long) => {
            let Some(at) = tag else { return Ok(()) };
            let channel = &plan.channels[at];
            if !channel.tag.name.is_empty() && !channel.says_of_another {
                let sample = sample(rows, plan, at, &rows.cell(long.value), t, counted);
                take(at, sample)?;
            }
        }
    }
    Ok(())
}

fn sample(rows: &dyn Rows, plan: &Plan, at: usize, cell: &Cell<'_>, t: f64, counted: &mut Counted) -> Sample {
    let channel = &plan.channels[at];
    // What a word behind the number says of it: `51.2 Bad`.
    let mut behind = None;
    let value = match (&plan.modes[at], cell) {
        (Some(modes), cell) => {
            let on = modes.value(cell);
            counted.modes[0] += 1;
            counted.modes[1] += u64::from(on == Some(0.0));
            counted.modes[2] += u64::from(on.is_none());
            on
        }
        (None, Cell::Number(value)) => Some(*value).filter(|value| value.is_finite()),
        (None, Cell::Text(text)) => measured(text).and_then(|number| {
            let (unit, said) = behind_number(number.unit, plan.letters);
            behind = said;
            if unit == plan.units[at] { number.value(plan.decimal) } else { None }
        }),
        _ => None,
    };
    // A mode is what it is, whatever the quality of the value beside it.
    let says = plan.qualities.iter().filter(|(_, of, _)| of.is_none_or(|of| of == at));
    let said = says.map(|(column, _, says)| says.quality(&rows.cell(*column)));
    let of_tags = channel.said_by.iter().filter_map(|own| plan.joined[*own].quality(t));
    let said = behind.into_iter().chain(said).chain(of_tags).find(|quality| !quality.is_good());
    let quality = match (said, value) {
        (Some(quality), _) => {
            counted.not_good += 1;
            quality
        }
        (None, Some(_)) => Quality::Good,
        (None, None) => {
            counted.no_number += u64::from(matches!(channel.role, Some(Role::Op | Role::Pv)));
            Quality::Bad(BadReason::NotANumber)
        }
    };
    Sample { t, value: value.unwrap_or(f64::NAN), quality }
}

/// The role of a channel, for the line that tells what was read.
pub fn role_of(role: Option<Role>) -> &'static str {
    role.map_or("", Role::as_str)
}
