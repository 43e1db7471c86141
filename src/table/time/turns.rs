//! Times that turn: where a clock is set back or forward, or has twelve hours; and dates of which some are text.

use super::super::error::{TableError, shown};
use super::super::options::Told;
use super::decide::{BAD, Column, LEAP};
use super::tally::{Times, Track};

/// A step back that is told (s): less is a late sample.
const BACK_S: f64 = 600.0;
/// By how much a clock of twelve hours goes back at noon and at midnight (s).
const HALF_A_DAY: f64 = 43_200.0;
/// By how much clocks go back where daylight saving time ends, and forward where it begins (s).
const HOUR: f64 = 3600.0;
const A_DAY: f64 = 86_400.0;
/// The longest leap back where a day and a month change places (s): from 12 December to 1 January, less a month, and a step.
const SWAPPED: f64 = 330.0 * A_DAY;

/// A clock that is turned does so by whole hours and a step of the record, which is no longer than this (s).
const LONGEST_STEP: f64 = 60.0;

/// What is known of the clock of times without an offset.
#[derive(Clone, Copy)]
pub(super) struct Clock {
    /// Its zone is told or stated.
    pub has_zone: bool,
    /// It is changed within the record.
    pub is_changed: bool,
}

impl Times {
    /// What is remarkable where times go back and go on from there, in words.
    ///
    /// # Errors
    /// They go back by an hour on a clock whose zone nobody told, or by weeks where day and month may be mixed up.
    pub(super) fn back(
        &self,
        track: &Track,
        per_s: f64,
        told: &Told,
        column: &Column<'_>,
        clock: Clock,
    ) -> Result<String, TableError> {
        // Where the newest stands first, times that go on are those that go back in time.
        let ([forward, back], turned) = match track.falls() {
            true => ([track.ways[1], track.ways[0]], track.largest[0]),
            false => (track.ways, track.largest[1]),
        };
        let Some((step, line)) = turned.map(|(step, line)| (step / per_s, line)) else {
            return Ok(String::new());
        };
        // The hour that comes twice is known by the zone.
        if back * BAD > forward || step < BACK_S || clock.is_changed && step <= HOUR {
            return Ok(String::new());
        }
        let Column { row_name, number, name, .. } = column;
        if (LEAP..SWAPPED).contains(&step) && self.open && told.format.is_none() {
            return Err(TableError::refused(format!(
                "{row_name} {line}, column {number} ({name}): times go back by {:.0} days, as where some rows have the day first and \
                 others the month; write all in one order, or say --time-format dmy or mdy where they are in one",
                step / A_DAY
            )));
        }
        let local = !clock.has_zone && matches!(self.offsets, [None, Some(_)]);
        if local && back <= track.tags() && (HOUR * 0.9..=HOUR).contains(&step) {
            return Err(TableError::refused(format!(
                "{row_name} {line}, column {number} ({name}): times go back by an hour, as where daylight saving time ends; say \
                 the zone with --tz, such as Europe/Berlin, or --tz UTC where rows of one record stand in another order; where a clock \
                 was set back, save the rows before and after it apart"
            )));
        }
        // A clock of numbers has no noon.
        let is_clock = self.offsets.iter().any(Option::is_some) || self.moments.count > 0;
        if is_clock {
            not_of_twelve_hours(Some((step, line)), column)?;
        }
        let times = if back == 1 { "once".to_string() } else { format!("{back} times") };
        Ok(format!(", times go back {times}, by up to {step:.0} s in {row_name} {line}: rows are sorted"))
    }

    /// Refuses a column of dates as such and of dates as text.
    ///
    /// # Errors
    /// A spreadsheet of another country has read days as months where it could, and left the others.
    pub(super) fn not_of_two_kinds(&self, column: &Column<'_>) -> Result<(), TableError> {
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

/// Refuses times that go back by twelve hours, here by a step (s) in a line.
///
/// # Errors
/// They do, on a clock that says neither AM nor PM.
pub(super) fn not_of_twelve_hours(back: Option<(f64, u64)>, column: &Column<'_>) -> Result<(), TableError> {
    let Some((_, line)) = back.filter(|(step, _)| (HALF_A_DAY - LONGEST_STEP..=HALF_A_DAY).contains(step))
    else {
        return Ok(());
    };
    let Column { row_name, number, name, .. } = column;
    Err(TableError::refused(format!(
        "{row_name} {line}, column {number} ({name}): times go back by twelve hours, as on a clock of twelve hours that says \
         neither AM nor PM; save the times with it, or on a clock of 24 hours"
    )))
}

/// The same of times of day without a date. One at 13:00 or later shows a clock of 24 hours, which goes back from shift to shift.
pub(super) fn not_of_twelve_hours_a_day(clocks: &Track, column: &Column<'_>) -> Result<(), TableError> {
    let back = if clocks.falls() { clocks.largest[0] } else { clocks.largest[1] };
    if clocks.most >= HALF_A_DAY + HOUR { Ok(()) } else { not_of_twelve_hours(back, column) }
}

/// That times without a zone go forward by an hour where they go on in short steps else, in words.
pub(super) fn missing_hour(
    offsets: &[Option<(u64, String)>; 2],
    track: &Track,
    column: &Column<'_>,
) -> String {
    let of_zone = offsets[0].is_some();
    let largest = if track.falls() { track.largest[1] } else { track.largest[0] };
    let usual = track.usual_step().filter(|usual| *usual <= LONGEST_STEP && !of_zone);
    let leap = usual.and_then(|usual| largest.filter(|(step, _)| (HOUR..=HOUR + 2.0 * usual).contains(step)));
    leap.map_or_else(String::new, |(_, line)| {
        format!(
            ", an hour is missing in {} {line}: where clocks were set forward, say the zone with --tz",
            column.row_name
        )
    })
}
