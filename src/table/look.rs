//! What is looked at before samples are made, where the first reading gives a reason: days on which the clock is changed, rows without a
//! time, and times that are recorded twice.

use super::error::{TableError, shown};
use super::layout::Body;
use super::odd_rows::{is_no_sample, is_total};
use super::overlap::{Found, Overlaps, Runs};
use super::source::{Rows, Source};
use super::survey::Plan;
use super::take::{Counted, row, walk};
use super::time::few_are_missing;
use super::time_columns::{part, parts_said};

/// Looks for rows without a time, and for those of which nothing tells when they were.
///
/// # Errors
/// The first such row.
pub fn look(source: Source<'_>, plan: &mut Plan) -> Result<(), TableError> {
    if plan.reading.is_changed || plan.reading.loses || plan.layout.millis.is_some() {
        let mut missing = Missing::default();
        walk(source, plan, &mut |rows, plan, line, at| {
            missing.add(rows, plan, line, at.is_some());
            Ok(())
        })?;
        plan.reading.refuse(plan.row_name)?;
        missing.refuse(plan)?;
    }
    Ok(())
}

/// Rows without a time.
#[derive(Default)]
struct Missing {
    rows: u64,
    with_time: u64,
    /// The last row with a time, from 1.
    last: u64,
    /// The first without: its line, what stands there, and whether it is the part of a second.
    first: Option<(u64, String, bool)>,
}

impl Missing {
    fn add(&mut self, rows: &dyn Rows, plan: &Plan, line: u64, has_time: bool) {
        // The first reading does not count these either.
        if is_total(rows, &plan.layout) || !has_time && is_no_sample(rows, &plan.layout) {
            return;
        }
        self.rows += 1;
        if has_time {
            self.with_time += 1;
            self.last = self.rows;
        } else if self.first.is_none() {
            let millis = plan.layout.millis.map(|at| (rows.cell(at).shown(), &plan.layout.names[at]));
            self.first = Some(match millis.filter(|(cell, name)| part(cell, name).is_none()) {
                Some((cell, _)) => (line, shown(&cell), true),
                None => (line, shown(&rows.cell(plan.layout.time).shown()), false),
            });
        }
    }

    /// Refuses more of them than may be left out.
    fn refuse(&self, plan: &Plan) -> Result<(), TableError> {
        let Some((line, cell, of_part)) = &self.first else { return Ok(()) };
        if few_are_missing(self.rows, self.with_time, self.last) {
            return Ok(());
        }
        let (layout, row_name) = (&plan.layout, plan.row_name);
        let many = format!("and {} of {} rows are like it", self.rows - self.with_time, self.rows);
        let at = if *of_part { layout.millis.unwrap_or(layout.time) } else { layout.time };
        let name = &layout.names[at];
        let what = if *of_part {
            let parts = parts_said(name);
            format!(
                "is no number of {parts} within a second, {many}; write them into the times, such as 06:00:02.030"
            )
        } else {
            let unit = plan.reading.counts().unwrap_or("the format of the column");
            format!("is no time before 2100 in {unit}, {many}; say what the numbers count with --time-unit")
        };
        Err(TableError::refused(format!(
            "{row_name} {line}, column {} ({}): {cell:?} {what}",
            at + 1,
            name.full
        )))
    }
}

/// A good sample: the place of its channel, its time (s), its line, and its value.
type Sampled<'s> = &'s mut dyn FnMut(usize, f64, u64, f64) -> Result<(), TableError>;

/// Every good sample of the channels that are wanted. Others say nothing against a value at the same time.
fn samples(
    source: Source<'_>,
    plan: &mut Plan,
    wanted: &[bool],
    sampled: Sampled<'_>,
) -> Result<(), TableError> {
    // The reading that takes the samples tells what it counts.
    let mut counted = Counted::default();
    walk(source, plan, &mut |rows, plan, line, at| {
        let Some(at) = at else { return Ok(()) };
        row(rows, plan, at, &mut counted, &mut |channel, sample| {
            if wanted[channel] && sample.quality.is_good() {
                sampled(channel, sample.t, line, sample.value)?;
            }
            Ok(())
        })
    })
}

/// By what it is told that rows were in another order.
const TOLD: &str = "rows are sorted";

/// Refuses times of channels that are `wanted` where they are recorded twice with other values between or beside them. Of rows in no
/// order nothing can be said, and few such rows are no other record: they are sorted, and that is told.
///
/// # Errors
/// The first row of another record.
pub fn twice(source: Source<'_>, plan: &mut Plan, wanted: &[bool]) -> Result<(), TableError> {
    if !plan.reading.goes_back || !wanted.contains(&true) {
        return Ok(());
    }
    let (falls, row_name) = (plan.reading.falls, plan.row_name);
    let mut runs = Runs::new(wanted.len(), falls);
    samples(source, plan, wanted, &mut |at, t, line, _| match runs.add(at, t) {
        true => Ok(()),
        false => Err(TableError::refused(format!(
            "{row_name} {line}: up to here the rows are in more parts than can be told apart, and go back from one to the next; sort \
             them by time"
        ))),
    })?;
    let mut overlaps: Overlaps = runs.overlaps();
    if overlaps.is_empty() {
        return Ok(());
    }
    samples(source, plan, wanted, &mut |at, t, line, value| {
        overlaps.add(at, t, line, value.to_bits());
        Ok(())
    })?;
    let way = if falls { "forward" } else { "back" };
    let first = overlaps.first();
    if let Some(found) = first.as_ref().filter(|found| !found.is_small()) {
        let of_tag = match &plan.layout.body {
            Body::Wide(_) => String::new(),
            Body::Long(_) => format!(", tag {:?}", shown(&plan.channels[found.channel].tag.name)),
        };
        return Err(TableError::refused(format!(
            "{row_name} {}{of_tag}: times go {way} over {} s that are recorded already, with other values: two tables in one file, or a \
             clock that was set back; save them apart",
            found.line,
            seconds(found.length)
        )));
    }
    if let Some(Found { line, length, rows: [few, all], .. }) = first {
        let length = seconds(length);
        plan.reading.said += &format!(
            ", times go {way} over {length} s in {row_name} {line} that are recorded already, {few} of {all} rows: {TOLD}"
        );
    } else if let Some((line, length)) = overlaps.longest().filter(|_| !plan.reading.said.contains(TOLD)) {
        let length = seconds(length);
        plan.reading.said += &format!(", times go {way} over {length} s in {row_name} {line}: {TOLD}");
    }
    Ok(())
}

/// Seconds in a message.
fn seconds(length: f64) -> String {
    if length < 10.0 { format!("{length:.1}") } else { format!("{length:.0}") }
}
