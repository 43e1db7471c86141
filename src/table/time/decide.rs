//! Which of the ways to read the column is right, or why none is.

use super::super::error::TableError;
use super::super::header_format;
use super::super::header_zone::HeaderZone;
use super::super::number::Decimal;
use super::super::options::{Format, Told};
use super::super::source::TimeBase;
use super::super::stamp::Order;
use super::reading::{How, Reading, Spread};
use super::tally::{Groups, LATEST, Times, Track};
use super::turns::{Clock, missing_hour, not_of_twelve_hours_a_day};
use super::units::{per_second, unit_said};

/// Stamps that may be missing or wrong within a column: one in so many.
pub(super) const BAD: u64 = 50;
/// Rows behind the last sample that a report adds: averages, counts, a signature.
const TRAILER: u64 = 20;
/// Rows in which nothing begins again.
const FEW: u64 = 3;
/// Rows from which a trailer can be told from a table that is none.
const ROWS: u64 = 10;
/// Rows from which one time for all of them is none.
const FEW_ROWS: u64 = 20;
/// A record may rest for so long (s), and a wrong order of day and month leaps by at least four weeks.
const REST: f64 = 10.0 * 86_400.0;
pub(super) const LEAP: f64 = 25.0 * 86_400.0;
/// Stamps are cut to one of these (s) where several rows share them.
/// Days of a spreadsheet with three to five decimals are cut to multiples of the last three.
const CUT: [f64; 6] = [1.0, 60.0, 3600.0, 0.864, 8.64, 86.4];
/// A column of dates that all are before 1700 (s since 1970) or after 2100 has the years of another calendar.
const EARLIEST: f64 = -8_520_336_000.0;
/// The first days of the years 1 and 1601, from which .NET and Windows count (days since 1970): an elapsed time that is written as a date
/// is in that year.
const ELAPSED: [i64; 2] = [-719_162, -134_774];
/// None of the two is a leap year.
const DAYS_OF_A_YEAR: i64 = 365;
/// A time of day is no more, and one of an hour (s).
const A_DAY: f64 = 86_400.0;
const AN_HOUR: f64 = 3600.0;

/// Where the column stands, for messages.
pub struct Column<'a> {
    /// How a row is called.
    pub row_name: &'a str,
    /// From 1.
    pub number: usize,
    pub name: &'a str,
    /// The unit in the header or in a row of units.
    pub unit: Option<&'a str>,
    /// The zone that the table states beside the times.
    pub zone: Option<&'a HeaderZone>,
}

impl Times {
    /// Decides.
    ///
    /// # Errors
    /// Too many cells that are no times, or a doubt, with the option that decides it.
    pub fn decide(
        &self,
        column: &Column<'_>,
        told: &Told,
        decimal: Decimal,
        groups: Option<Groups>,
    ) -> Result<Reading, TableError> {
        let decimal = self.evidence.alone().unwrap_or(decimal);
        let numbers = &self.numbers[usize::from(decimal == Decimal::Comma)];
        let dated = self.dates.iter().map(|track| track.count).max().unwrap_or(0);
        let best = [numbers.track.count, dated, self.clocks.count, self.moments.count, self.formatted.count];
        let most = best.into_iter().max().unwrap_or(0);
        if let Some(first) = self.first_far.as_ref().filter(|_| self.far > most) {
            return Err(far(first, column));
        }
        let chosen = self.zone(column, told)?;
        let (has_zone, zone) = (chosen.zone.name.is_some(), chosen.said.as_str());
        let new = |how, said: String| Reading::new(how, &chosen.zone, said);
        let by_pattern = matches!(told.format, Some(Format::Pattern(_)));
        let (track, mut reading, per_s) = if !by_pattern && (most == 0 || numbers.track.count == most) {
            let unit = self.unit(numbers, column, told, most)?;
            let said = unit_said(unit, numbers, zone);
            (&numbers.track, new(How::Number(decimal, unit), said), per_second(unit))
        } else if !by_pattern && dated == most {
            let order = self.order(column, told)?;
            self.of_our_calendar(order, column)?;
            self.bare_millis(column)?;
            self.one_way_of_offsets(column, has_zone)?;
            let said = self.date_said(order) + if self.offsets[1].is_some() { zone } else { "" };
            (&self.dates[order as usize], new(How::Dated(order), said), 1.0)
        } else if !by_pattern && self.clocks.count == most {
            self.minutes(column)?;
            let longest = if self.are_minutes() { AN_HOUR } else { A_DAY };
            let (how, said) = match (self.clocks.most > longest, self.are_minutes()) {
                (true, _) => (How::Elapsed, "time since the start"),
                // `59:58.5`: nobody writes a fraction of minutes behind hours.
                (_, true) => (How::Minutes, "time in minutes and seconds"),
                _ => (How::Clock, "time of day without a date"),
            };
            (&self.clocks, new(how, said.into()), 1.0)
        } else if !by_pattern && self.moments.count == most {
            (&self.moments, new(How::Moment, self.moments_said(zone, has_zone)), 1.0)
        } else {
            let pattern = match &told.format {
                Some(Format::Pattern(pattern)) => pattern.clone(),
                _ => String::new(),
            };
            let said = format!("time {pattern} by --time-format{zone}");
            (&self.formatted, new(How::Pattern(pattern), said), 1.0)
        };
        self.enough(track, column, told)?;
        let is_wide = groups.is_some();
        let shared = groups.as_ref().is_some_and(Groups::is_cut);
        reading.by_tag = track.is_stacked();
        reading.spread = groups.and_then(|groups| spread(groups, track, per_s));
        let remarks = self.remarks(&reading, column, told, &chosen.against);
        reading.said += &remarks;
        reading.follow(track, per_s, self.has_open_times(&reading.how));
        let dated = is_wide && matches!(reading.how, How::Dated(_) | How::Moment);
        let is_one = is_wide && track.count >= FEW_ROWS && track.least == track.most;
        whole(column, dated.then_some(track), shared && reading.spread.is_none() || is_one)?;
        // Times of day come back every day by themselves.
        if matches!(reading.how, How::Dated(_) | How::Moment | How::Elapsed | How::Number(..)) {
            if let How::Number(..) = reading.how {
                again(track, per_s, column)?;
            }
            let clock = Clock { has_zone, is_changed: reading.is_changed };
            reading.said += &self.back(track, per_s, told, column, clock)?;
        }
        match reading.how {
            How::Clock => not_of_twelve_hours_a_day(track, column)?,
            How::Dated(_) if !has_zone => reading.said += &missing_hour(&self.offsets, track, column),
            _ => {}
        }
        if let Some(spread) = &reading.spread {
            let step = (spread.step * 1e3).round() * 1e-3;
            reading.said += &format!(", {} rows a stamp spread over its {step} s", spread.usual);
        }
        Ok(reading)
    }

    /// Whether so many cells can be read that the rest may be left out.
    fn enough(&self, track: &Track, column: &Column<'_>, told: &Told) -> Result<(), TableError> {
        if few_are_missing(self.rows, track.count, track.last_row) {
            return Ok(());
        }
        let within = track.last_row - track.count;
        self.not_of_two_kinds(column)?;
        let (line, cell) = track.first_miss.clone().unwrap_or_default();
        let Column { row_name, number, name, .. } = column;
        if cell.is_empty() {
            return Err(TableError::refused(format!(
                "{row_name} {line}, column {number} ({name}): the cell is empty, and each row needs a time; save the table with \
                 a time in each row"
            )));
        }
        if let Some(Format::Pattern(pattern)) = &told.format {
            return Err(TableError::refused(format!(
                "{row_name} {line}, column {number} ({name}): {cell:?} is not written as --time-format {pattern}"
            )));
        }
        if within * BAD > self.rows && within * 2 < self.rows && is_trailer(self.rows, track.last_row) {
            return Err(TableError::refused(format!(
                "{row_name} {line}, column {number} ({name}): {cell:?} is no time, and {within} of {} rows have none: more than one row \
                 in fifty is no sample; take them out of the table",
                self.rows
            )));
        }
        let begins = |date: &str| date.starts_with(|c: char| c.is_ascii_digit());
        // `20260615 60000`, `15.06.2026 21600`, `46188 0.25`.
        if let Some((date, clock)) =
            cell.split_once(' ').filter(|(date, clock)| begins(date) && clock.trim().parse::<f64>().is_ok())
        {
            return Err(TableError::refused(format!(
                "{row_name} {line}, column {number} ({name}): {cell:?} is no time: {clock} behind {date} may be the digits of a clock, \
                 seconds of the day or a part of it; save it as a time of day, such as 06:00:00"
            )));
        }
        Err(TableError::refused(format!(
            "{row_name} {line}, column {number} ({name}): {cell:?} is no time; dates with a time of day in the usual formats, \
             RFC 3339 and numbers are read, others with --time-format"
        )))
    }

    /// Refuses times of which some say their offset and others do not, where nobody told the zone of these.
    fn one_way_of_offsets(&self, column: &Column<'_>, has_zone: bool) -> Result<(), TableError> {
        let [Some((_, with)), Some((line, without))] = &self.offsets else { return Ok(()) };
        if has_zone {
            return Ok(());
        }
        let Column { row_name, number, name, .. } = column;
        Err(TableError::refused(format!(
            "{row_name} {line}, column {number} ({name}): {without:?} has no offset, and {with:?} has one; say the zone of those \
             without with --tz, such as Europe/Berlin or UTC"
        )))
    }

    /// Refuses dates whose years are those of another calendar. Those that are too far from our time to be counted, as 2569 in Thailand
    /// and 1405 in Iran are, [`far`] refuses.
    fn of_our_calendar(&self, order: Order, column: &Column<'_>) -> Result<(), TableError> {
        let track = &self.dates[order as usize];
        if track.count == 0 || track.least < LATEST && track.most >= EARLIEST {
            return Ok(());
        }
        let (line, cell) = self.example.clone().unwrap_or_default();
        Err(of_another_calendar(line, &cell, column))
    }

    /// Refuses milliseconds without their leading zeros, of which `.8` is .008.
    fn bare_millis(&self, column: &Column<'_>) -> Result<(), TableError> {
        let example = self.fractions.example.as_ref().filter(|_| self.fractions.are_bare_millis());
        let Some((line, cell)) = example else { return Ok(()) };
        let Column { row_name, number, name, .. } = column;
        Err(TableError::refused(format!(
            "{row_name} {line}, column {number} ({name}): {cell:?}: fractions of seconds have one to three digits, and none begins with \
             0, so that they are milliseconds without leading zeros; write them with three digits"
        )))
    }

    /// Refuses times of two numbers, which may be hours and minutes, or minutes and seconds.
    fn minutes(&self, column: &Column<'_>) -> Result<(), TableError> {
        let Some((line, cell)) = self.short_clock.as_ref().filter(|_| !self.are_minutes()) else {
            return Ok(());
        };
        let Column { row_name, number, name, .. } = column;
        Err(TableError::refused(format!(
            "{row_name} {line}, column {number} ({name}): {cell:?} may be hours and minutes or minutes and seconds; say \
             --time-format %H:%M or %M:%S%.f, or save the times whole: a spreadsheet shows less than it has"
        )))
    }

    /// The order of day, month and year that the column proves, or that was told.
    fn order(&self, column: &Column<'_>, told: &Told) -> Result<Order, TableError> {
        if let Some(Format::Order(order)) = told.format {
            return Ok(order);
        }
        let most = self.dates.iter().map(|track| track.count).max().unwrap_or(0);
        let mut left: Vec<Order> =
            Order::ALL.into_iter().filter(|o| self.dates[*o as usize].count == most).collect();
        let track = |order: &Order| &self.dates[*order as usize];
        let same = |a: &Order, b: &Order| {
            let (a, b) = (track(a), track(b));
            (a.least, a.most, a.sum) == (b.least, b.most, b.sum)
        };
        if left.iter().all(|order| same(order, &left[0])) {
            return Ok(left[0]);
        }
        let stated = column.unit.and_then(header_format::order).filter(|order| left.contains(order));
        // Beyond midnight the right order goes on, and a wrong one leaps by months.
        let steady: Vec<Order> = left.iter().copied().filter(|order| track(order).jump < REST).collect();
        let goes_on = steady.first().filter(|_| {
            let mut others = left.iter().filter(|order| !steady.contains(order));
            steady.len() == 1 && others.all(|order| track(order).jump > LEAP)
        });
        match (goes_on, stated) {
            // The header says another order than the midnight in the column.
            (Some(order), Some(stated)) if *order != stated => {}
            (Some(order), _) => return Ok(*order),
            (None, Some(stated)) => return Ok(stated),
            (None, None) => {}
        }
        // Between points the month stands in the middle: the day is first in most of Europe, and the year in East Asia and Hungary.
        if self.dotted && left.contains(&Order::Dmy) {
            left.retain(|order| *order != Order::Mdy);
        }
        left.dedup_by(|a, b| same(a, b));
        if let [only] = left.as_slice() {
            return Ok(*only);
        }
        let (line, cell) = self.example.clone().unwrap_or_default();
        let Column { row_name, number, name, .. } = column;
        let written: fn(Order) -> &'static str = if self.dotted { dotted } else { letters };
        let ways: Vec<String> =
            left.iter().map(|order| format!("{} ({})", written(*order), self.begin(*order))).collect();
        let or: Vec<&str> = left.iter().map(|order| short(*order)).collect();
        Err(TableError::refused(format!(
            "{row_name} {line}, column {number} ({name}): {cell:?} may be {}; say --time-format {}",
            ways.join(" or "),
            or.join(" or ")
        )))
    }

    /// The day on which the column begins in an order.
    fn begin(&self, order: Order) -> String {
        let second = self.dates[order as usize].least;
        let stamp = jiff::Timestamp::from_second(second as i64);
        stamp.map_or_else(
            |_| String::new(),
            |stamp| jiff::tz::Offset::UTC.to_datetime(stamp).date().to_string(),
        )
    }

    /// How moments are stored, and in which zone they are read; `zone` is the text for local times.
    fn moments_said(&self, zone: &str, has_zone: bool) -> String {
        let zone = match self.base {
            // No other zone applies to them.
            Some(TimeBase::Utc) => " (UTC)".to_string(),
            Some(TimeBase::Int96) if has_zone => format!(" (INT96, {}", zone.trim_start_matches([' ', '('])),
            Some(TimeBase::Int96) => " (INT96, UTC; --tz decides)".to_string(),
            Some(TimeBase::Civil) | None => zone.to_string(),
        };
        format!("time as stamps{zone}")
    }

    /// How dates are written, by the example of the first.
    fn date_said(&self, order: Order) -> String {
        let cell = self.example.as_ref().map_or("", |(_, cell)| cell.as_str());
        if self.open {
            return format!("time {}", letters(order));
        }
        if self.dotted {
            return format!("time {}", dotted(order));
        }
        let cell = cell.split_once([' ', 'T']).map_or(cell, |(date, _)| date);
        let kind = if cell.len() >= 4 && cell.as_bytes()[..4].iter().all(u8::is_ascii_digit) {
            let of_year = cell.len() == "2026-166".len() && cell.as_bytes()[4] == b'-';
            match (cell.contains('/'), of_year) {
                (true, _) => "yyyy/mm/dd",
                (false, true) => "yyyy-ddd",
                (false, false) => "yyyy-mm-dd",
            }
        } else if cell.contains(char::is_alphabetic) {
            "dd-mmm-yy"
        } else {
            "dd.mm.yyyy"
        };
        format!("time {kind}")
    }
}

fn of_another_calendar(line: u64, cell: &str, column: &Column<'_>) -> TableError {
    let Column { row_name, number, name, .. } = column;
    TableError::refused(format!(
        "{row_name} {line}, column {number} ({name}): {cell:?} has the year of another calendar, and would be before 1700 or after 2100; \
         save the times with the years of the Gregorian calendar, or as numbers since 1970"
    ))
}

/// Refuses dates of which the first is this one, so far from our time that no times are counted by them.
fn far((line, cell, day): &(u64, String, i64), column: &Column<'_>) -> TableError {
    if !ELAPSED.iter().any(|first| (*first..first + DAYS_OF_A_YEAR).contains(day)) {
        return of_another_calendar(*line, cell, column);
    }
    let Column { row_name, number, name, .. } = column;
    TableError::refused(format!(
        "{row_name} {line}, column {number} ({name}): {cell:?} is an elapsed time, written as a date of the first year that .NET or Windows \
         counts; save it as a number of seconds"
    ))
}

/// Whether so few of all rows have no time that they may be left out; the last one that has a time is numbered from 1.
pub fn few_are_missing(rows: u64, with_time: u64, last: u64) -> bool {
    with_time > 0 && is_trailer(rows, last) && (last - with_time) * BAD <= rows
}

/// Whether the rows behind the last one that has a time may be a trailer.
fn is_trailer(rows: u64, last: u64) -> bool {
    let trailing = rows - last;
    trailing <= TRAILER && (trailing == 0 || rows >= ROWS && trailing * 2 <= rows)
}

/// Refuses numbers that begin again, such as seconds of the day: sorted, one part would lie within the other. A single number
/// that is off leads back, too.
fn again(track: &Track, per_s: f64, column: &Column<'_>) -> Result<(), TableError> {
    let half = 0.5 * (track.most - track.least);
    let [on, back] = if track.falls() { [1, 0] } else { [0, 1] };
    let is_long = |step: &(f64, u64)| step.0 > half;
    let (Some((step, line)), None) = (track.largest[back].filter(is_long), track.largest[on].filter(is_long))
    else {
        return Ok(());
    };
    // Rows that lead back more often are in no order, and are sorted.
    if track.count <= FEW || track.ways[back] > track.tags() {
        return Ok(());
    }
    let Column { row_name, number, name, .. } = column;
    Err(TableError::refused(format!(
        "{row_name} {line}, column {number} ({name}): times begin again, {:.0} s before the row above, as a counter or seconds of \
         the day do; save the parts apart, or with dates",
        step / per_s
    )))
}

/// Refuses times that were cut: to dates, or so that nearly every row has the time of the row before.
fn whole(column: &Column<'_>, dated: Option<&Track>, shared: bool) -> Result<(), TableError> {
    let one_date = |track: &Track| track.count > 1 && track.least == track.most && track.least % A_DAY == 0.0;
    let what = if dated.is_some_and(one_date) {
        "every row has the same date and no time of day; save the times whole, or name their column with --time"
    } else if shared {
        "nearly every row has the time of the row before, and other values: the times were cut or rounded, as a spreadsheet does \
         with what it shows; save them whole"
    } else {
        return Ok(());
    };
    Err(TableError::refused(format!("column {} ({}): {what}", column.number, column.name)))
}

/// An order as a format shows it.
pub(super) fn letters(order: Order) -> &'static str {
    match order {
        Order::Dmy => "dd/mm/yyyy",
        Order::Mdy => "mm/dd/yyyy",
        Order::Ymd => "yy/mm/dd",
    }
}

/// The same of dates with points and two digits of the year.
fn dotted(order: Order) -> &'static str {
    match order {
        Order::Dmy => "dd.mm.yy",
        Order::Mdy => "mm.dd.yy",
        Order::Ymd => "yy.mm.dd",
    }
}

fn short(order: Order) -> &'static str {
    match order {
        Order::Dmy => "dmy",
        Order::Mdy => "mdy",
        Order::Ymd => "ymd",
    }
}

/// Stamps that are cut to whole seconds or minutes, with several rows each.
fn spread(groups: Groups, track: &Track, per_s: f64) -> Option<Spread> {
    let usual = groups.usual()?;
    let step = track.usual_step()? / per_s;
    let cut = CUT.iter().any(|cut| (step - cut).abs() < 1e-6);
    let falls = track.falls();
    (cut && track.share_of_step(step * per_s) > 0.9).then_some(Spread {
        sizes: groups.sizes,
        usual,
        step,
        falls,
    })
}
