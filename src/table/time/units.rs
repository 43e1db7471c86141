//! What numbers of time count: the unit that the header says, that their range shows, or that is asked for.

use super::super::error::TableError;
use super::super::options::{Told, Unit};
use super::decide::{BAD, Column};
use super::tally::{Numbers, Odd, SERIAL, SERIAL_OR_MJD, Times, Track};

/// Steps of seconds below which days of a spreadsheet are meant (s read as days: 86 s).
const STEP_OF_DAYS: f64 = 1e-3;
/// Steps of seconds above which a doubt between the two is gone.
const STEP_OF_SECONDS: f64 = 0.05;
/// Seconds between samples from which milliseconds may be meant instead.
const LONG_STEP: f64 = 500.0;
/// Seconds between samples from which milliseconds may be meant where it is no number of minutes but one of 50 ms.
const ROUND_STEP: f64 = 100.0;
/// Minutes since 1970 from 2010 to 2045; as seconds they are the clock of a device that has run for most of a year.
const MINUTES_SINCE_1970: std::ops::Range<f64> = 21_000_000.0..39_500_000.0;
/// Steps below which they may be minutes.
const SHORT_STEP: f64 = 0.5;

impl Times {
    /// What numbers of time count.
    pub(super) fn unit(
        &self,
        numbers: &Numbers,
        column: &Column<'_>,
        told: &Told,
        all: u64,
    ) -> Result<Unit, TableError> {
        let named = told.unit.or_else(|| column.unit.and_then(Unit::of));
        let Column { row_name, number, name, .. } = column;
        let doubt = |what: String| {
            Err(TableError::refused(format!(
                "column {number} ({name}): {what}; say --time-unit s, ms, us, ns, min, h, days, s1904, ticks, datenum or mjd"
            )))
        };
        const UNITS: [Unit; 7] = [
            Unit::Seconds,
            Unit::Millis,
            Unit::Micros,
            Unit::Ticks,
            Unit::Nanos,
            Unit::FileTime,
            Unit::SecondsSince1904,
        ];
        let most = |count: u64| count > 0 && (all - count) * BAD <= all;
        let shown = numbers.track.least;
        let by_range = numbers.ranges.iter().position(|count| most(*count)).map(|at| UNITS[at]);
        let (first_line, first) =
            numbers.first.as_ref().map_or((1, ""), |(line, cell, _)| (*line, cell.as_str()));
        if let (Some(Unit::Seconds), Some(Unit::SecondsSince1904)) = (told.unit, by_range) {
            return Err(TableError::refused(format!(
                "{row_name} {first_line}, column {number} ({name}): {first:?} is a time after 2055 in seconds since 1970, which --time-unit s \
                 means; say --time-unit s1904 where LabVIEW has counted"
            )));
        }
        if let Some(unit) = told.unit {
            return Ok(unit);
        }
        if numbers.are_clock_digits() && (by_range.is_some() || most(numbers.small)) {
            return Err(TableError::refused(format!(
                "{row_name} {first_line}, column {number} ({name}): the last two digits never reach 60, nor do those before them: {first:?} \
                 may be the digits of a clock; say so with --time-format, such as %H%M%S, or --time-unit s"
            )));
        }
        match (by_range, named) {
            (Some(found), None) => return Ok(found),
            (Some(found), Some(named)) if found == named => return Ok(found),
            (Some(Unit::SecondsSince1904), Some(Unit::Seconds)) => return Ok(Unit::SecondsSince1904),
            (Some(found), Some(named)) => {
                return doubt(format!(
                    "{shown} would be a date of our time in {}, and its unit is {}",
                    of(found),
                    of(named)
                ));
            }
            _ => {}
        }
        if numbers.track.count > 0 && !most(numbers.small) && named.is_none() {
            return Err(in_no_unit(numbers, column));
        }
        let step = numbers.track.usual_step().unwrap_or(0.0);
        let (odd, parts) = as_parts(&numbers.track);
        let of_wincc = |value: f64| (SERIAL.0 * 1e6..SERIAL.1 * 1e6).contains(&value);
        match named {
            Some(Unit::Millis) if of_wincc(shown) => doubt(format!(
                "{shown} is no time in milliseconds but, as WinCC counts, in millionths of a day: take the column of dates with --time"
            )),
            Some(unit) => Ok(unit),
            None if most(numbers.serial) && step > 0.0 && step < STEP_OF_DAYS => {
                match shown < SERIAL_OR_MJD {
                    true => Ok(Unit::Days),
                    false => doubt(format!(
                        "{shown} may be days of a spreadsheet, which is 2051 or later, or modified Julian days"
                    )),
                }
            }
            None if most(numbers.date_num) && step > 0.0 && step < STEP_OF_DAYS => Ok(Unit::DateNum),
            None if most(numbers.serial) && step > 0.0 && step < STEP_OF_SECONDS => {
                doubt(format!("{shown} in steps of {step} may be seconds or days of a spreadsheet"))
            }
            None if step > 0.0 && step < STEP_OF_DAYS => {
                doubt(format!("steps of {step} are too short for seconds"))
            }
            None if step > 0.0 && step < SHORT_STEP && MINUTES_SINCE_1970.contains(&shown) => {
                doubt(format!("{shown} in steps of {step:.3} may be seconds or minutes since 1970"))
            }
            None if !parts.is_empty() => {
                doubt(format!("steps of {odd:.4} may be seconds, or {}", parts.join(", or ")))
            }
            None if step >= LONG_STEP || is_round_in_millis(step) => {
                doubt(format!("steps of {step} may be seconds or milliseconds"))
            }
            None => Ok(Unit::Seconds),
        }
    }
}

/// Why numbers that are neither of our days in one unit nor seconds since the start are refused.
fn in_no_unit(numbers: &Numbers, column: &Column<'_>) -> TableError {
    let Column { row_name, number, name, .. } = column;
    let (line, first) = numbers.first.as_ref().map_or((1, ""), |(line, cell, _)| (*line, cell.as_str()));
    TableError::refused(match &numbers.odd {
        Some(Odd { at: (odd_line, odd), leaps: true }) => format!(
            "{row_name} {odd_line}, column {number} ({name}): {odd:?} counts in another unit than {first:?} in {row_name} {line}; write all \
             times in one unit, or save the parts apart"
        ),
        Some(Odd { at: (odd_line, odd), .. }) => format!(
            "{row_name} {odd_line}, column {number} ({name}): {odd:?}, and {first:?} in {row_name} {line}, are times of our days in no unit; \
             say --time-unit"
        ),
        None => format!(
            "{row_name} {line}, column {number} ({name}): {first:?} is a time of our days in no unit; say --time-unit, or where the digits \
             are a date --time-format, such as %y%m%d%H%M%S"
        ),
    })
}

/// Whether a step is round in milliseconds and in no unit from seconds on, such as 100 or 250.
fn is_round_in_millis(step: f64) -> bool {
    step >= ROUND_STEP && step % 50.0 == 0.0 && step % 60.0 != 0.0
}

/// The usual step, or the mean of all, where it is no round number and would be a usual step in other units, with what it would be in
/// each: 0.0333 is 2 s in minutes, 0.001389 is 5 s in hours.
fn as_parts(track: &Track) -> (f64, Vec<String>) {
    let off = |value: f64| (value - value.round()).abs();
    let near = |value: f64, tolerance: f64| off(value) < tolerance * value;
    let of = |step: f64| {
        let (minute, hour, day) = (step * 60.0, step * 3600.0, step * 86_400.0);
        let in_minutes =
            (1.0..60.0).contains(&minute.round()) && near(minute, 0.005) && off(step * 100.0) > 0.1;
        // A part of a second has four decimals at the most.
        let is_odd = off(step * 1e4) > 0.1;
        let in_hours = is_odd && (1.0..60.5).contains(&hour) && near(2.0 * hour, 0.002);
        let in_days = is_odd && (0.5..60.5).contains(&(day / 60.0)) && near(day / 60.0, 0.002);
        [(in_minutes, "minutes", minute), (in_hours, "hours", hour), (in_days, "days", day)]
            .into_iter()
            .filter(|(is_so, ..)| *is_so)
            .map(|(_, unit, seconds)| format!("{unit} (then {} s)", (seconds * 10.0).round() / 10.0))
            .collect::<Vec<_>>()
    };
    let mean = (track.most - track.least) / (track.count.max(2) - 1) as f64;
    let steps = track.usual_step().into_iter().chain([mean]);
    steps.map(|step| (step, of(step))).find(|(_, parts)| !parts.is_empty()).unwrap_or_default()
}

/// What a unit counts, in words.
pub(super) fn of(unit: Unit) -> &'static str {
    match unit {
        Unit::Seconds => "seconds",
        Unit::Millis => "milliseconds",
        Unit::Micros => "microseconds",
        Unit::Nanos => "nanoseconds",
        Unit::SecondsSince1904 => "seconds since 1904 (LabVIEW)",
        Unit::Minutes => "minutes",
        Unit::Hours => "hours",
        Unit::Days => "days of a spreadsheet",
        Unit::FileTime => "tenths of a microsecond since 1601",
        Unit::Ticks => "tenths of a microsecond since the year 1 (.NET)",
        Unit::DateNum => "days since the year 0 (MATLAB)",
        Unit::Mjd => "modified Julian days",
    }
}

pub(super) fn per_second(unit: Unit) -> f64 {
    match unit {
        Unit::Seconds | Unit::SecondsSince1904 => 1.0,
        Unit::Millis => 1e3,
        Unit::Micros => 1e6,
        Unit::Nanos => 1e9,
        Unit::Minutes => 1.0 / 60.0,
        Unit::Hours => 1.0 / 3600.0,
        Unit::Days | Unit::DateNum | Unit::Mjd => 1.0 / 86_400.0,
        Unit::FileTime | Unit::Ticks => 1e7,
    }
}

pub(super) fn unit_said(unit: Unit, numbers: &Numbers, zone: &str) -> String {
    let epoch = numbers.ranges.iter().any(|count| *count * 2 > numbers.track.count);
    match unit {
        Unit::Days | Unit::DateNum | Unit::Mjd => format!("time in {}{zone}", of(unit)),
        _ if epoch && !matches!(unit, Unit::FileTime | Unit::Ticks | Unit::SecondsSince1904) => {
            format!("time in {} since 1970", of(unit))
        }
        _ => format!("time in {}", of(unit)),
    }
}

#[cfg(test)]
mod tests {
    use super::is_round_in_millis;

    #[test]
    fn a_step_that_only_milliseconds_make_round_is_doubted() {
        assert!([100.0, 200.0, 250.0, 450.0].into_iter().all(is_round_in_millis));
        assert!(
            [0.1, 2.0, 30.0, 50.0, 60.0, 90.0, 120.0, 300.0]
                .into_iter()
                .all(|step| !is_round_in_millis(step))
        );
    }
}
