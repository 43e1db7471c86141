//! One cell as a date or a time of day, whatever its format: the cell is cut into numbers, words and signs, and what they
//! are follows from their place. Only the order of day, month and year is left open, for the whole column decides it.

mod left;

use left::{Left, Piece, minutes, pieces};
use std::borrow::Cow;

/// Nanoseconds of a microsecond.
pub const MICROSECOND: i64 = 1_000;
/// Nanoseconds of a millisecond.
pub const MILLISECOND: i64 = 1_000_000;
/// Nanoseconds of a second.
pub const SECOND: i64 = 1_000_000_000;
/// Nanoseconds of an hour.
pub const HOUR: i64 = 3600 * SECOND;
/// Nanoseconds of a day.
pub const DAY: i64 = 86_400 * SECOND;

/// In which order a date of three numbers is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Day, month, year.
    Dmy,
    /// Month, day, year.
    Mdy,
    /// Year, month, day.
    Ymd,
}

impl Order {
    /// Each.
    pub const ALL: [Order; 3] = [Order::Dmy, Order::Mdy, Order::Ymd];
}

/// A date as it is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Date {
    /// In one order only: year, month, day.
    Known(i64, u32, u32),
    /// Three numbers, and whether the last has the four digits of a year.
    Open([i64; 3], bool),
    /// Three numbers of two digits with points between: the month is the second, and the year the first or the last.
    Dotted([i64; 3]),
}

/// A cell that holds a date, a time of day, or both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    date: Option<Date>,
    /// Nanoseconds since midnight; `None` for a date alone.
    clock: Option<i64>,
    /// Seconds east of Greenwich, where the cell says so.
    pub offset: Option<i32>,
    /// Letters of a zone stand there that more than one country has: `EST`.
    pub has_letters: bool,
}

/// Days from 1970-01-01 to a date of the Gregorian calendar; `None` where there is no such date.
fn days(year: i64, month: u32, day: u32) -> Option<i64> {
    let date =
        jiff::civil::Date::new(i16::try_from(year).ok()?, i8::try_from(month).ok()?, i8::try_from(day).ok()?);
    let epoch = jiff::civil::Date::constant(1970, 1, 1);
    Some(i64::from(date.ok()?.since(epoch).ok()?.get_days()))
}

/// Two digits of a year, which are those of our time.
fn century(year: i64, four: bool) -> i64 {
    match year {
        _ if four => year,
        0..70 => 2000 + year,
        70..100 => 1900 + year,
        _ => year,
    }
}

impl Stamp {
    /// Days since 1970 of its date in an order; `None` where it is none in that order.
    fn day(&self, order: Order) -> Option<i64> {
        let (year, month, day) = match self.date? {
            Date::Known(year, month, day) => (year, month, day),
            Date::Open([a, b, c], _) | Date::Dotted([a, b, c]) => {
                let four = matches!(self.date, Some(Date::Open(_, true)));
                let [year, month, day] = match order {
                    Order::Dmy => [century(c, four), b, a],
                    Order::Mdy => [century(c, four), a, b],
                    Order::Ymd if four => return None,
                    Order::Ymd => [century(a, false), b, c],
                };
                (year, u32::try_from(month).ok()?, u32::try_from(day).ok()?)
            }
        };
        days(year, month, day)
    }

    /// Nanoseconds since 1970 on the clock that is written, its offset not taken off.
    pub fn civil(&self, order: Order) -> Option<i64> {
        self.day(order)?.checked_mul(DAY)?.checked_add(self.clock.unwrap_or(0))
    }

    /// Days since 1970 of a date that [`Stamp::civil`] has no room for, before 1678 or after 2261, in the first order in which it is one.
    pub fn far_day(&self) -> Option<i64> {
        let far = |order| self.day(order).filter(|day| day.checked_mul(DAY).is_none());
        Order::ALL.into_iter().find_map(far)
    }

    /// Nanoseconds since midnight, where there is no date.
    pub fn time_of_day(&self) -> Option<i64> {
        self.clock.filter(|_| self.date.is_none())
    }

    /// Whether its time of day is a whole second.
    pub fn is_whole_second(&self) -> bool {
        self.clock.is_none_or(|clock| clock % SECOND == 0)
    }

    /// Whether its time of day is a whole minute.
    pub fn is_whole_minute(&self) -> bool {
        self.clock.is_some_and(|clock| clock % (60 * SECOND) == 0)
    }

    /// Whether it is a date without a time of day.
    pub fn is_date_only(&self) -> bool {
        self.date.is_some() && self.clock.is_none()
    }

    /// Whether there is a date.
    pub fn has_date(&self) -> bool {
        self.date.is_some()
    }

    /// Whether its date is three bare numbers, whose order the whole column decides.
    pub fn is_open(&self) -> bool {
        matches!(self.date, Some(Date::Open(..)))
    }

    /// Whether its date is three numbers of two digits with points between.
    pub fn is_dotted(&self) -> bool {
        matches!(self.date, Some(Date::Dotted(_)))
    }

    /// What it is where only a time of day can stand: `06.00.02` is one, and written as a date is.
    pub fn as_clock(&self) -> Stamp {
        match (self.date, self.clock) {
            (Some(Date::Dotted([hour @ 0..24, minute @ 0..60, second @ 0..60])), None) => {
                let clock = (hour * 3600 + minute * 60 + second) * SECOND;
                Stamp { date: None, clock: Some(clock), ..*self }
            }
            _ => *self,
        }
    }

    /// Whether it is no date with the month in the middle, as between points: `06.00.02` has none.
    pub fn is_no_date(&self) -> bool {
        [Order::Dmy, Order::Ymd].into_iter().all(|order| self.day(order).is_none())
    }

    /// The date of this cell with the time of day of another.
    pub fn at(&self, clock: &Stamp) -> Option<Stamp> {
        let clock = clock.as_clock();
        let of_a_day = clock.clock.is_some_and(|clock| clock <= DAY);
        if self.clock.is_some_and(|clock| clock != 0) || clock.date.is_some() || !of_a_day {
            return None;
        }
        Some(Stamp { date: self.date, ..clock })
    }

    /// The date of this cell with a time of day (ns since midnight).
    pub fn at_clock(&self, clock: i64) -> Option<Stamp> {
        let is_date = self.date.is_some() && self.clock.is_none_or(|own| own == 0);
        (is_date && (0..=DAY).contains(&clock)).then_some(Stamp { clock: Some(clock), ..*self })
    }
}

/// Whether a character only says in which direction a text runs: Windows writes such among the parts of its dates.
fn is_mark(c: char) -> bool {
    matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// A text without the marks of direction in it.
pub fn unmarked(text: &str) -> Cow<'_, str> {
    if text.is_ascii() || !text.contains(is_mark) {
        return Cow::Borrowed(text);
    }
    Cow::Owned(text.replace(is_mark, ""))
}

/// The cell as a date, a time of day, or both.
pub fn scan(cell: &str) -> Option<Stamp> {
    let cell = unmarked(cell);
    let cell = super::number::bare(&cell);
    // `+02:00[Europe/Berlin]`, `GMT+0200 (CEST)`: the offset says it already.
    let named = cell.strip_suffix(']').and_then(|cell| cell.rsplit_once('['));
    if let Some((before, _)) = named.or_else(|| cell.strip_suffix(')')?.rsplit_once(" (")) {
        return scan(before).filter(|stamp| stamp.offset.is_some());
    }
    // Shorter is no stamp, longer is prose.
    if !(3..=64).contains(&cell.len()) || !cell.bytes().any(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let divided;
    let cell = match cell.split_at_checked(14) {
        // `20260601060000`: date and time of day without a sign.
        Some((digits, rest)) if digits.bytes().all(|byte| byte.is_ascii_digit()) => {
            divided = format!("{} {}{rest}", &digits[..8], &digits[8..]);
            divided.as_str()
        }
        _ => cell,
    };
    let pieces = pieces(cell)?;
    if let Some(clock) = minutes(&pieces) {
        return Some(Stamp { date: None, clock: Some(clock), offset: None, has_letters: false });
    }
    let mut left = Left(&pieces);
    if let Some(elapsed) = left.elapsed() {
        return left.0.is_empty().then_some(Stamp {
            date: None,
            clock: Some(elapsed),
            offset: None,
            has_letters: false,
        });
    }
    left.skip_weekday();
    let (mut date, mut clock) = (left.date(), None);
    if date.is_some() {
        left.between();
    }
    if !left.0.is_empty() {
        clock = left.clock();
    }
    if date.is_none() && clock.is_some() {
        // The date may follow: `06:00:00 01.06.2026`.
        left.between();
        date = left.date();
    }
    let (offset, has_letters) = left.offset()?;
    left.blanks();
    // `Jun 1 06:00:00 2026`: the year at the end.
    if let (Some(Date::Known(0, month, day)), [Piece::Number(year, 4)]) = (date, left.0) {
        date = Some(Date::Known(*year, month, day));
        left.0 = &[];
    }
    let whole = left.0.is_empty() && !matches!(date, Some(Date::Known(0, ..)));
    (whole && (date.is_some() || clock.is_some())).then_some(Stamp { date, clock, offset, has_letters })
}

/// Whether a cell is minutes and seconds with a fraction.
pub fn are_minutes(cell: &str) -> bool {
    pieces(super::number::bare(cell)).is_some_and(|pieces| minutes(&pieces).is_some())
}

#[cfg(test)]
mod tests;
