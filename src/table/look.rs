//! What is looked at before samples are made, where the first reading gives a reason: days on which the clock is changed, rows without a
//! time, and times that are recorded twice.

use super::error::{TableError, shown};
use super::layout::Body;
use super::number::Decimal;
use super::odd_rows::is_total;
use super::overlap::{Overlaps, Runs};
use super::says::measured;
use super::source::{Cell, Rows, Source};
use super::survey::Plan;
use super::take::walk;
use super::time::few_are_missing;
use super::time_columns::{part, parts_said};
use std::hash::{BuildHasher, BuildHasherDefault, DefaultHasher};

/// Looks at the rows as often as it has to. The times of channels that are `wanted` must not be recorded twice.
///
/// # Errors
/// The first row that makes the record another one than was meant.
pub fn look(source: Source<'_>, plan: &mut Plan, wanted: &[bool]) -> Result<(), TableError> {
    if plan.reading.is_changed || plan.reading.loses || plan.layout.millis.is_some() {
        let mut missing = Missing::default();
        walk(source, plan, &mut |rows, plan, line, at| {
            missing.add(rows, plan, line, at.is_some());
            Ok(())
        })?;
        plan.reading.refuse(plan.row_name)?;
        missing.refuse(plan)?;
    }
    if plan.reading.goes_back && wanted.contains(&true) {
        twice(source, plan, wanted)?;
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
        if is_total(rows, &plan.layout) {
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

/// A sample: the place of its channel, its time (s), its line, and its cell.
type Sampled<'s> = &'s mut dyn FnMut(usize, f64, u64, &Cell<'_>);

/// Every sample of the channels that are wanted.
fn samples(
    source: Source<'_>,
    plan: &mut Plan,
    wanted: &[bool],
    sampled: Sampled<'_>,
) -> Result<(), TableError> {
    walk(source, plan, &mut |rows, plan, line, at| {
        let Some((t, tag)) = at else { return Ok(()) };
        match (&plan.layout.body, tag) {
            (Body::Wide(wide), _) => {
                for (at, column) in wide.columns.iter().enumerate().filter(|(at, _)| wanted[*at]) {
                    let cell = rows.cell(*column);
                    if !cell.is_blank() {
                        sampled(at, t, line, &cell);
                    }
                }
            }
            (Body::Long(long), Some(at)) if wanted[at] => sampled(at, t, line, &rows.cell(long.value)),
            (Body::Long(_), _) => {}
        }
        Ok(())
    })
}

/// By what it is told that rows were in another order.
const TOLD: &str = "rows are sorted";

/// Refuses times that are recorded twice with other values between or beside them. Of rows in no order nothing can be said: they are
/// sorted, and that is told.
fn twice(source: Source<'_>, plan: &mut Plan, wanted: &[bool]) -> Result<(), TableError> {
    let falls = plan.reading.falls;
    let mut runs = Runs::new(wanted.len(), falls);
    let mut are_too_many = false;
    samples(source, plan, wanted, &mut |at, t, _, _| are_too_many |= !runs.add(at, t))?;
    let row_name = plan.row_name;
    if are_too_many {
        return Err(TableError::refused(format!(
            "{row_name} {}: the rows are in more parts than can be told apart, and go back from one to the next; sort them by time",
            plan.layout.line
        )));
    }
    let mut overlaps: Overlaps = runs.overlaps();
    if overlaps.is_empty() {
        return Ok(());
    }
    let decimal = plan.decimal;
    samples(source, plan, wanted, &mut |at, t, line, cell| overlaps.add(at, t, line, || key(cell, decimal)))?;
    let way = if falls { "forward" } else { "back" };
    if let Some(found) = overlaps.first() {
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
    if let Some((line, length)) = overlaps.longest().filter(|_| !plan.reading.said.contains(TOLD)) {
        let length = seconds(length);
        plan.reading.said += &format!(", times go {way} over {length} s in {row_name} {line}: {TOLD}");
    }
    Ok(())
}

/// Seconds in a message.
fn seconds(length: f64) -> String {
    if length < 10.0 { format!("{length:.1}") } else { format!("{length:.0}") }
}

/// What stands in a cell, by which one value is told from another.
fn key(cell: &Cell<'_>, decimal: Decimal) -> u64 {
    let value = match cell {
        Cell::Number(value) => Some(*value),
        Cell::Text(text) => measured(text).and_then(|number| number.value(decimal)),
        _ => None,
    };
    value.map_or_else(|| BuildHasherDefault::<DefaultHasher>::default().hash_one(cell.shown()), f64::to_bits)
}
