//! A cell of the column as seconds, once its format is decided.

use super::super::error::TableError;
use super::super::number::Decimal;
use super::super::options::{Unit, Zone};
use super::super::source::{Cell, TimeBase};
use super::super::stamp::{DAY, HOUR, Order, SECOND};
use super::changes::Changes;
use super::tally::{LATEST, SINCE_1904, Track};
use super::units::of;
use super::what::What;

/// How the column is read.
pub struct Reading {
    pub(super) how: How,
    /// The clock of times without an offset; `None` for UTC.
    pub(super) clock: Option<Changes>,
    /// In words.
    pub said: String,
    /// Rows under one stamp, spread over it.
    pub spread: Option<Spread>,
    /// Of all rows, or of each tag where `by_tag`.
    last: Vec<Last>,
    /// Each tag has a clock of its own: tags stand one after the other, or each has its own column of times.
    pub by_tag: bool,
    /// The newest stands first.
    pub falls: bool,
    /// Some rows go back, against the way of the file.
    pub goes_back: bool,
    /// The clock is changed within the record.
    pub is_changed: bool,
    /// Some numbers are no times in their unit.
    pub loses: bool,
    place: (usize, u32),
}

/// The row before, of all or of a tag.
#[derive(Clone, Copy)]
struct Last {
    /// Its time (s).
    t: f64,
    /// Days or hours that have gone by since the first row, of a clock without a date (ns).
    midnight: i64,
}

/// Stamps that several rows share.
pub struct Spread {
    /// Rows of each stamp.
    pub sizes: Vec<u32>,
    /// Rows that a stamp usually has.
    pub usual: u32,
    /// From one stamp to the next (s).
    pub step: f64,
    /// The newest stands first.
    pub falls: bool,
}

impl Reading {
    /// Whether times are numbers of days as spreadsheets count them.
    pub fn counts_days(&self) -> bool {
        matches!(self.how, How::Number(_, Unit::Days))
    }

    /// What its numbers count, in words; `None` where times are none.
    pub fn counts(&self) -> Option<&'static str> {
        if let How::Number(_, unit) = self.how { Some(of(unit)) } else { None }
    }
}

/// What a cell says, before the zone is known.
pub(super) enum Meant {
    /// A moment (s since 1970, or since something began).
    Moment(f64),
    /// A time on the written clock (ns).
    Written(i64),
}

pub(super) enum How {
    Number(Decimal, Unit),
    Dated(Order),
    Clock,
    /// Minutes and seconds of an hour.
    Minutes,
    /// Since something began, also beyond a day.
    Elapsed,
    Moment,
    Pattern(String),
}

impl Last {
    /// A time of day, or of an hour, that goes on where the day or the hour ends.
    fn unwrapped(&mut self, ns: i64, period: i64) -> f64 {
        let t = seconds(ns.saturating_add(self.midnight));
        if self.t - t > seconds(period) / 2.0 {
            self.midnight = self.midnight.saturating_add(period);
        }
        seconds(ns.saturating_add(self.midnight))
    }
}

impl Reading {
    pub(super) fn new(how: How, zone: &Zone, said: String) -> Self {
        let name = zone.name.as_deref().unwrap_or("UTC");
        let clock = zone.rules.clone().map(|rules| Changes::new(rules, name));
        Self {
            how,
            clock,
            said,
            spread: None,
            last: Vec::new(),
            by_tag: false,
            falls: false,
            goes_back: false,
            is_changed: false,
            loses: false,
            place: (0, 0),
        }
    }

    /// Takes from the column how its rows follow each other, of which so many units are a second, and whether the zone moves any.
    pub(super) fn follow(&mut self, track: &Track, per_s: f64, is_open: bool) {
        self.falls = track.falls();
        self.goes_back = track.ways[usize::from(!self.falls)] > 0;
        // Rows that share a stamp are as near as the spread makes them.
        let step = track.usual_step().filter(|_| self.spread.is_none()).unwrap_or(0.0) / per_s;
        let ends = [track.least, track.most];
        let ends = match self.how {
            How::Number(_, unit) => ends.map(|end| match counted(end, unit) {
                Some(Meant::Written(ns)) => Some(seconds(ns)),
                Some(Meant::Moment(t)) => Some(t),
                None => None,
            }),
            _ => ends.map(Some),
        };
        self.loses = ends.contains(&None);
        if let Some(clock) = self.clock.as_mut().filter(|_| is_open) {
            clock.follow(step, self.falls);
            let [from, to] = ends.map(|end| end.unwrap_or(f64::NAN));
            self.is_changed = clock.is_changed(from, to);
        }
    }

    /// Before the first row again.
    pub fn rewind(&mut self) {
        self.last.clear();
        self.place = (0, 0);
        if let Some(clock) = &mut self.clock {
            clock.rewind();
        }
    }

    /// Refuses what the clock of the zone never showed, and rows of which nothing tells which of two hours they are in, once all rows
    /// were read.
    ///
    /// # Errors
    /// The first such row.
    pub fn refuse(&mut self, row_name: &str) -> Result<(), TableError> {
        if let Some(clock) = &mut self.clock {
            clock.refuse(row_name)?;
            self.said += &clock.said();
        }
        Ok(())
    }

    /// The time of the next row (s), which stands in a line, and is one of a tag where each row is a sample of one tag; `None` where its
    /// cell is none.
    pub fn next(
        &mut self,
        first: &Cell<'_>,
        second: Option<&Cell<'_>>,
        (tag, line): (usize, u64),
    ) -> Option<f64> {
        let (of_clock, in_turn) = ((tag, line), !self.by_tag);
        let tag = if self.by_tag { tag } else { 0 };
        if self.last.len() <= tag {
            self.last.resize(tag + 1, Last { t: f64::NEG_INFINITY, midnight: 0 });
        }
        let mut last = self.last[tag];
        let t = match (self.time(first, second, &mut last), &mut self.clock) {
            (None, _) => None,
            (Some(Meant::Moment(t)), clock) => {
                if let Some(clock) = clock {
                    clock.pass_by(t, of_clock.0, line);
                }
                Some(t)
            }
            (Some(Meant::Written(ns)), None) => Some(seconds(ns)),
            (Some(Meant::Written(ns)), Some(clock)) => clock.read(ns, of_clock, in_turn),
        };
        last.t = t.unwrap_or(last.t);
        self.last[tag] = last;
        let Some(spread) = &self.spread else { return t };
        let (group, within) = self.place;
        let size = spread.sizes.get(group).copied().unwrap_or(1);
        let last = within + 1 >= size;
        self.place = if last { (group + 1, 0) } else { (group, within + 1) };
        let (earliest, within) = match spread.falls {
            true => (group + 1 == spread.sizes.len(), (size - 1).saturating_sub(within)),
            false => (group == 0, within),
        };
        let latest = if spread.falls { group == 0 } else { group + 1 == spread.sizes.len() };
        let share = if earliest {
            // The record may begin within a stamp: what is there of it is its end.
            let missing = spread.usual.saturating_sub(size);
            f64::from(missing + within) / f64::from(size.max(spread.usual))
        } else if latest {
            f64::from(within) / f64::from(size.max(spread.usual))
        } else {
            f64::from(within) / f64::from(size)
        };
        t.map(|t| t + share * spread.step)
    }

    fn time(&self, first: &Cell<'_>, second: Option<&Cell<'_>>, last: &mut Last) -> Option<Meant> {
        if let How::Pattern(pattern) = &self.how {
            let text = match second {
                Some(second) => format!("{} {}", first.shown(), second.shown()),
                None => first.shown(),
            };
            let (ns, offset) = by_pattern(pattern, &text)?;
            return match period(pattern) {
                None => meant(ns, offset),
                Some(period) => Some(Meant::Moment(last.unwrapped(ns, period))),
            };
        }
        match (&self.how, What::of(first, second)) {
            (How::Number(_, unit), What::Number(value)) => counted(value, *unit),
            (How::Number(decimal, unit), What::Digits(number)) => counted(number.value(*decimal)?, *unit),
            (How::Dated(order), What::Dated(stamp)) => meant(stamp.civil(*order)?, stamp.offset),
            // A spreadsheet keeps most stamps as such and some as text.
            (How::Moment, What::Moment { ns, base }) => meant(ns, (base == TimeBase::Utc).then_some(0)),
            (How::Clock, What::Clock(ns)) => Some(Meant::Moment(last.unwrapped(ns, DAY))),
            (How::Minutes, What::Clock(ns)) => Some(Meant::Moment(last.unwrapped(ns, HOUR))),
            (How::Elapsed, What::Clock(ns)) => Some(Meant::Moment(seconds(ns))),
            _ => None,
        }
    }
}

/// A number as a time; `None` for one that is no time before 2100 in its unit.
pub(super) fn counted(value: f64, unit: Unit) -> Option<Meant> {
    const SINCE_1601: f64 = 11_644_473_600.0;
    const SINCE_1: f64 = 62_135_596_800.0;
    /// 1970-01-01 as spreadsheets, MATLAB and astronomers count.
    const EPOCH: f64 = 25_569.0;
    const EPOCH_OF_DATE_NUM: f64 = 719_529.0;
    const EPOCH_OF_MJD: f64 = 40_587.0;
    let t = match unit {
        Unit::Seconds => value,
        Unit::SecondsSince1904 => value - SINCE_1904,
        Unit::Millis => value / 1e3,
        Unit::Micros => value / 1e6,
        Unit::Nanos => value / 1e9,
        Unit::Minutes => value * 60.0,
        Unit::Hours => value * 3600.0,
        Unit::FileTime => value / 1e7 - SINCE_1601,
        Unit::Ticks => value / 1e7 - SINCE_1,
        Unit::Days | Unit::DateNum | Unit::Mjd => {
            let epoch = match unit {
                Unit::DateNum => EPOCH_OF_DATE_NUM,
                Unit::Mjd => EPOCH_OF_MJD,
                _ => EPOCH,
            };
            let ms = ((value - epoch) * 86_400e3).round();
            let fits = ms.abs() < 1e13 && ms < LATEST * 1e3;
            return Some(Meant::Written(fits.then_some(ms as i64)?.checked_mul(1_000_000)?));
        }
    };
    (t.is_finite() && t < LATEST).then_some(Meant::Moment(t))
}

/// A time on the written clock (ns) with its offset from UTC (s), where it has one.
fn meant(ns: i64, offset: Option<i32>) -> Option<Meant> {
    Some(match offset {
        Some(offset) => Meant::Moment(seconds(ns.checked_sub(i64::from(offset) * SECOND)?)),
        None => Meant::Written(ns),
    })
}

/// Nanoseconds as seconds.
pub(super) fn seconds(ns: i64) -> f64 {
    ns.div_euclid(SECOND) as f64 + ns.rem_euclid(SECOND) as f64 * 1e-9
}

/// What a pattern without a date comes back after (ns); `None` for one with a date.
fn period(pattern: &str) -> Option<i64> {
    let mut letters = pattern.split('%').skip(1).filter_map(|part| {
        part.trim_start_matches(|c: char| c.is_ascii_digit() || ".-_0^:".contains(c)).chars().next()
    });
    let all: Vec<char> = letters.by_ref().collect();
    if all.iter().any(|c| !"HIklMSfNLpPTRrXZz".contains(*c)) {
        return None;
    }
    let hours = all.iter().any(|c| "HIklTRrX".contains(*c));
    Some(if hours { DAY } else { HOUR })
}

/// Nanoseconds on the written clock, and the offset where the pattern has one.
pub(super) fn by_pattern(pattern: &str, text: &str) -> Option<(i64, Option<i32>)> {
    let text = super::super::number::bare(text);
    let parts = jiff::fmt::strtime::parse(pattern, text).ok()?;
    let civil = match (parts.to_datetime(), parts.to_date()) {
        (Ok(civil), _) => civil,
        // A date without a time of day.
        (Err(_), Ok(date)) => date.to_datetime(jiff::civil::Time::midnight()),
        // A time of day, or minutes and seconds alone.
        (Err(_), Err(_)) => {
            let nanos = parts.subsec_nanosecond().unwrap_or(0);
            let (hour, minute) = (parts.hour().unwrap_or(0), parts.minute()?);
            let time = jiff::civil::Time::new(hour, minute, parts.second().unwrap_or(0), nanos).ok()?;
            jiff::civil::date(1970, 1, 1).to_datetime(time)
        }
    };
    let moment = jiff::tz::Offset::UTC.to_timestamp(civil).ok()?;
    let ns = i64::try_from(moment.as_nanosecond()).ok()?;
    Some((ns, parts.offset().map(|offset| offset.seconds())))
}
