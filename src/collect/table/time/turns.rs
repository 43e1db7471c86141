//! Times that turn: where a clock is set back or forward, has twelve hours, or is of two kinds.

use super::super::error::{TableError, shown};
use super::super::options::Told;
use super::decide::{BAD, Column};
use super::tally::{Times, Track};

/// A step back that is told (s): less is a late sample.
const BACK_S: f64 = 600.0;
/// By how much a clock of twelve hours goes back at noon and at midnight (s).
const HALF_A_DAY: f64 = 43_200.0;
/// By how much clocks go back where daylight saving time ends, and forward where it begins (s).
const HOUR: f64 = 3600.0;

/// A clock of twelve hours goes back by them less a step, which is no longer than this (s).
const STEP: f64 = 60.0;

impl Times {
    /// What is remarkable where times go back and go on from there, in words.
    ///
    /// # Errors
    /// They go back by an hour on a clock whose zone nobody told.
    pub(super) fn back(
        &self,
        track: &Track,
        per_s: f64,
        told: &Told,
        column: &Column<'_>,
    ) -> Result<String, TableError> {
        // Where the newest stands first, times that go on are those that go back in time.
        let ([forward, back], turned) = match track.falls() {
            true => ([track.ways[1], track.ways[0]], track.largest[0]),
            false => (track.ways, track.largest[1]),
        };
        let Some((step, line)) = turned.map(|(step, line)| (step / per_s, line)) else {
            return Ok(String::new());
        };
        // Where a zone is told, the hour that comes twice is known by it.
        if back * BAD > forward || step < BACK_S || told.zone.name.is_some() && step <= HOUR {
            return Ok(String::new());
        }
        let Column { row_name, number, name, .. } = column;
        let local = told.zone.name.is_none() && matches!(self.offsets, [None, Some(_)]);
        if local && back <= track.tags() && (HOUR * 0.9..=HOUR).contains(&step) {
            return Err(TableError::refused(format!(
                "{row_name} {line}, column {number} ({name}): times go back by an hour, as where daylight saving time ends; say \
                 the zone with --tz, such as Europe/Berlin, or --tz UTC where they are right"
            )));
        }
        // A clock of numbers has no noon.
        let is_clock = self.offsets.iter().any(Option::is_some) || self.moments.count > 0;
        if is_clock {
            not_of_twelve_hours(track, column)?;
        }
        let times = if back == 1 { "once".to_string() } else { format!("{back} times") };
        Ok(format!(", times go back {times}, by up to {step:.0} s in {row_name} {line}: rows are sorted"))
    }

    /// Refuses a column of dates as such and of dates as text.
    ///
    /// # Errors
    /// A spreadsheet of another country has read days as months where it could, and left the others.
    pub(super) fn dates_of_one_kind(&self, column: &Column<'_>) -> Result<(), TableError> {
        let Column { row_name, number, name, .. } = column;
        match (&self.moments.first_miss, &self.example) {
            (Some(_), Some((line, cell))) if self.moments.count > 0 => Err(TableError::refused(format!(
                "{row_name} {line}, column {number} ({name}): {:?} is text and other cells are dates, as where a spreadsheet takes \
                 days for months: import the original file again with the right order of day and month",
                shown(cell)
            ))),
            _ => Ok(()),
        }
    }
}

/// Refuses times that go back by twelve hours.
///
/// # Errors
/// They do, on a clock that says neither AM nor PM.
pub(super) fn not_of_twelve_hours(track: &Track, column: &Column<'_>) -> Result<(), TableError> {
    let turned = if track.falls() { track.largest[0] } else { track.largest[1] };
    let Some((_, line)) = turned.filter(|(step, _)| (HALF_A_DAY - STEP..=HALF_A_DAY).contains(step)) else {
        return Ok(());
    };
    let Column { row_name, number, name, .. } = column;
    Err(TableError::refused(format!(
        "{row_name} {line}, column {number} ({name}): times go back by twelve hours, as on a clock of twelve hours that says \
         neither AM nor PM; save the times with it, or on a clock of 24 hours"
    )))
}

/// What is remarkable where times without a zone go forward by an hour once, in words.
pub(super) fn spring(offsets: &[Option<(u64, String)>; 2], track: &Track) -> String {
    let of_zone = offsets[0].is_some();
    let largest = if track.falls() { track.largest[1] } else { track.largest[0] };
    let leap = largest.filter(|(step, _)| (HOUR..=HOUR + STEP).contains(step) && !of_zone);
    leap.map_or_else(String::new, |(_, line)| {
        format!(", an hour is missing in line {line}: where clocks were set forward, say the zone with --tz")
    })
}
