//! What every cell of the column could be, counted side by side.

use super::super::error::shown;
use super::super::evidence::Evidence;
use super::super::number::Decimal;
use super::super::options::{Format, Told};
use super::super::source::{Cell, TimeBase};
use super::super::stamp::{self, Order};
use super::what::What;

/// Steps between stamps that are kept to find the usual one.
const STEPS: usize = 4096;

/// One way to read the column.
#[derive(Clone, Debug)]
pub struct Track {
    /// Cells that can be read so.
    pub count: u64,
    /// The last row that can, from 1.
    pub last_row: u64,
    /// The first cell that cannot: its line and what stands there.
    pub first_miss: Option<(u64, String)>,
    /// Smallest and largest, in the unit of the track.
    pub least: f64,
    /// See `least`.
    pub most: f64,
    /// Largest step, in either direction.
    pub jump: f64,
    /// Sum of the readings: two ways that agree everywhere have the same.
    pub sum: f64,
    /// Steps from one row of a tag to its next: forward, and back as positive numbers.
    steps: [Vec<f64>; 2],
    /// How many of each there are.
    pub ways: [u64; 2],
    /// The largest step forward and the largest back, as a positive number, and their lines.
    pub largest: [Option<(f64, u64)>; 2],
    /// The reading of the last row of each tag.
    before: Vec<Option<f64>>,
    /// The tag of the row before, and how often it is another.
    last_tag: Option<usize>,
    turns: u64,
}

/// A row of the table as messages name it.
#[derive(Clone, Copy)]
struct Row {
    /// Its number among those with anything in them, from 1.
    number: u64,
    line: u64,
    /// Which tag it is a sample of, where each row is one of one tag; else 0.
    tag: usize,
}

impl Default for Track {
    fn default() -> Self {
        Self {
            count: 0,
            last_row: 0,
            first_miss: None,
            least: f64::INFINITY,
            most: f64::NEG_INFINITY,
            jump: 0.0,
            sum: 0.0,
            steps: [Vec::new(), Vec::new()],
            ways: [0; 2],
            largest: [None; 2],
            before: Vec::new(),
            last_tag: None,
            turns: 0,
        }
    }
}

impl Track {
    fn add(&mut self, row: Row, cell: &dyn Fn() -> String, value: Option<f64>) {
        let Some(value) = value else {
            self.first_miss.get_or_insert_with(|| (row.line, shown(&cell())));
            return;
        };
        self.count += 1;
        self.last_row = row.number;
        self.least = self.least.min(value);
        self.most = self.most.max(value);
        self.sum += value;
        self.turns += u64::from(self.last_tag.replace(row.tag).is_some_and(|last| last != row.tag));
        if self.before.len() <= row.tag {
            self.before.resize(row.tag + 1, None);
        }
        if let Some(before) = self.before[row.tag].replace(value) {
            let step = value - before;
            self.jump = self.jump.max(step.abs());
            if step != 0.0 {
                let way = usize::from(step < 0.0);
                self.ways[way] += 1;
                if self.steps[way].len() < STEPS {
                    self.steps[way].push(step.abs());
                }
                if self.largest[way].is_none_or(|(most, _)| step.abs() > most) {
                    self.largest[way] = Some((step.abs(), row.line));
                }
            }
        }
    }

    /// Whether the newest stands first.
    pub fn falls(&self) -> bool {
        self.ways[1] > self.ways[0]
    }

    /// Whether the tags stand one after the other, each with all its rows.
    pub fn is_stacked(&self) -> bool {
        self.turns > 0 && self.turns + 1 == self.tags()
    }

    /// How many tags have a reading.
    pub fn tags(&self) -> u64 {
        self.before.iter().flatten().count() as u64
    }

    /// The usual step in the direction of most; `None` where there is none.
    pub fn usual_step(&self) -> Option<f64> {
        let mut steps = self.steps[usize::from(self.falls())].clone();
        steps.sort_unstable_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied()
    }

    /// The share of steps that are this long.
    pub fn share_of_step(&self, length: f64) -> f64 {
        let steps = &self.steps[usize::from(self.falls())];
        let same = steps.iter().filter(|step| (*step - length).abs() < 1e-6).count();
        same as f64 / steps.len().max(1) as f64
    }
}

/// From 1904, when LabVIEW's and the Macintosh's clocks begin, to 1970 (s).
pub const SINCE_1904: f64 = 2_082_844_800.0;
/// No time that numbers count is later than this: 2100 (s since 1970).
pub const LATEST: f64 = 4_102_444_800.0;
/// Ranges of numbers in which a unit of time puts the years 1990 to 2100. Nanoseconds of 1990 are ticks of .NET in our days,
/// which are likelier, so those come first.
/// Numbers that would be after 2055 as seconds since 1970 are read as seconds since 1904, which gives 1990 or later.
pub const RANGES: [(f64, f64); 7] = {
    const FROM: f64 = 631_152_000.0;
    const TO: f64 = LATEST;
    const SINCE_1601: f64 = 11_644_473_600.0;
    const SINCE_1: f64 = 62_135_596_800.0;
    [
        (FROM, FROM + SINCE_1904),
        (FROM * 1e3, TO * 1e3),
        (FROM * 1e6, TO * 1e6),
        ((FROM + SINCE_1) * 1e7, (TO + SINCE_1) * 1e7),
        (FROM * 1e9, TO * 1e9),
        ((FROM + SINCE_1601) * 1e7, (TO + SINCE_1601) * 1e7),
        (FROM + SINCE_1904, TO + SINCE_1904),
    ]
};
/// Days as a spreadsheet counts them, 1990 to 2100.
pub const SERIAL: (f64, f64) = (32_874.0, 73_050.0);
/// Days of a spreadsheet from here on are 2051 or later; as modified Julian days they are 2010 to 2058.
pub const SERIAL_OR_MJD: f64 = 55_197.0;
/// Days as MATLAB counts them, 1990 to 2100.
pub const DATE_NUM: (f64, f64) = (726_834.0, 767_011.0);

/// Numbers as times, under one decimal sign.
#[derive(Clone, Debug, Default)]
pub struct Numbers {
    pub track: Track,
    /// How many lie in each of [`RANGES`].
    pub ranges: [u64; 7],
    /// How many are days of a spreadsheet.
    pub serial: u64,
    /// How many are days of MATLAB.
    pub date_num: u64,
    /// How many are below every range: seconds since the record began.
    pub small: u64,
    /// The first one: its line and what stands there, and in which range it is.
    pub first: Option<(u64, String, usize)>,
    /// The first in another range.
    pub odd: Option<Odd>,
    clock: ClockDigits,
}

/// A number in another range than the first.
#[derive(Clone, Debug)]
pub struct Odd {
    /// Its line and what stands there.
    pub at: (u64, String),
    /// It is no next step from the number before it.
    pub leaps: bool,
}

/// Whether numbers are the digits of a clock, `095959` and then `100000`.
#[derive(Clone, Debug, Default)]
struct ClockDigits {
    /// A bit for each value of the last two digits.
    last: u128,
    /// Whether a number is none: it has a fraction, or its last two digits or those before them reach 60.
    beyond: bool,
}

impl ClockDigits {
    /// Fewest different seconds by which digits are told from counts: in steps of 50 s counts have two.
    const LEAST: u32 = 10;

    fn add(&mut self, value: f64) {
        let digits = value as u64;
        self.beyond |= digits as f64 != value || digits % 100 > 59 || digits / 100 % 100 > 59;
        self.last |= 1 << (digits % 100);
    }

    fn is_clock(&self, track: &Track) -> bool {
        // A minute of seconds since the start has no more than 59 of them either.
        !self.beyond && self.last.count_ones() >= Self::LEAST && track.most - track.least > 100.0
    }
}

impl Numbers {
    fn add(&mut self, row: Row, cell: &dyn Fn() -> String, value: Option<f64>) {
        let before = self.track.before.get(row.tag).copied().flatten();
        self.track.add(row, cell, value);
        let Some(value) = value else { return };
        let range = RANGES.iter().position(|(from, to)| (*from..*to).contains(&value));
        let is_small = value.abs() < RANGES[0].0;
        match range {
            Some(at) => self.ranges[at] += 1,
            None => self.small += u64::from(is_small),
        }
        let own = range.unwrap_or(RANGES.len() + usize::from(is_small));
        match &self.first {
            None => self.first = Some((row.line, shown(&cell()), own)),
            Some((.., first)) if *first != own && self.odd.is_none() => {
                // Units are a thousand times another, and a count goes on in small steps.
                let leaps = |before: f64| before != 0.0 && !(0.01..100.0).contains(&(value / before));
                self.odd = Some(Odd { at: (row.line, shown(&cell())), leaps: before.is_some_and(leaps) });
            }
            Some(_) => {}
        }
        self.serial += u64::from((SERIAL.0..SERIAL.1).contains(&value));
        self.date_num += u64::from((DATE_NUM.0..DATE_NUM.1).contains(&value));
        self.clock.add(value);
    }

    /// Whether they are the digits of a clock and no count: neither seconds nor minutes ever reach 60.
    pub fn are_clock_digits(&self) -> bool {
        self.clock.is_clock(&self.track)
    }
}

/// The column, cell by cell.
#[derive(Default)]
pub struct Times {
    /// Rows with anything in them.
    pub rows: u64,
    /// Under a decimal point and a comma.
    pub numbers: [Numbers; 2],
    /// What the numbers prove of the decimal sign.
    pub evidence: Evidence,
    /// Dates, in each order of [`Order::ALL`] (s on the written clock).
    pub dates: [Track; 3],
    /// Whether a date was three bare numbers.
    pub open: bool,
    /// Whether a date is written with points and two digits of the year, so that it may begin with the day or with the year.
    pub dotted: bool,
    /// The first stamp with an offset, and the first without: its line and what stands there.
    pub offsets: [Option<(u64, String)>; 2],
    /// The first cell with letters of a zone that do not say which: its line and what stands there.
    pub letters: Option<(u64, String)>,
    /// The first dated cell: its line and what stands there.
    pub example: Option<(u64, String)>,
    /// Dates before 1678 or after 2261, which are in none of [`Times::dates`], and the first: its line, what stands there, and its days
    /// since 1970.
    pub far: u64,
    pub first_far: Option<(u64, String, i64)>,
    /// Times of day without a date.
    pub clocks: Track,
    /// The first of them with two numbers only, and its line.
    pub short_clock: Option<(u64, String)>,
    /// How many of them are minutes and seconds with a fraction: `59:58.5`.
    minutes: u64,
    /// Moments as such (s).
    pub moments: Track,
    /// The time base of the first moment: all of a column have the same.
    pub base: Option<TimeBase>,
    /// By the pattern that was told.
    pub formatted: Track,
    /// How fractions of seconds are written.
    pub fractions: Fractions,
}

/// How fractions of seconds are written.
#[derive(Clone, Debug, Default)]
pub struct Fractions {
    /// Those of three digits, and of fewer.
    whole: u64,
    short: u64,
    /// Of two digits and more: those that begin with 0, and those that end so.
    begin: u64,
    end: u64,
    /// The first of fewer than three digits: its line and what stands there.
    pub example: Option<(u64, String)>,
}

/// Fractions from which a tenth would begin with 0.
const FRACTIONS: u64 = 50;

impl Fractions {
    fn add(&mut self, text: &str, line: u64) {
        let digits = text.rsplit(['.', ',']).next().unwrap_or_default();
        let behind = text.len() - digits.len();
        let is_fraction = behind > 3 && text[..behind - 1].ends_with(|c: char| c.is_ascii_digit());
        if !is_fraction || !(1..=3).contains(&digits.len()) || !digits.bytes().all(|b| b.is_ascii_digit()) {
            return;
        }
        self.whole += u64::from(digits.len() == 3);
        self.begin += u64::from(digits.len() > 1 && digits.starts_with('0'));
        self.end += u64::from(digits.len() > 1 && digits.ends_with('0'));
        if digits.len() < 3 {
            self.short += 1;
            self.example.get_or_insert_with(|| (line, shown(text)));
        }
    }

    /// Whether they are milliseconds without their leading zeros: who leaves zeros out at the end writes none there.
    pub fn are_bare_millis(&self) -> bool {
        self.whole > 0
            && self.short > 0
            && self.whole + self.short >= FRACTIONS
            && self.begin == 0
            && self.end > 0
    }
}

impl Times {
    /// Whether all times of day are minutes and seconds.
    pub fn are_minutes(&self) -> bool {
        self.minutes > 0 && self.minutes == self.clocks.count
    }

    /// One more row; `tag` is the tag that it is a sample of, 0 in a table with a column for each.
    pub fn add(
        &mut self,
        (line, tag): (u64, usize),
        first: &Cell<'_>,
        second: Option<&Cell<'_>>,
        name: &str,
        told: &Told,
    ) {
        self.rows += 1;
        let row = Row { number: self.rows, line, tag };
        let text = || both(first, second);
        if let Some(Format::Pattern(pattern)) = &told.format {
            let t = super::reading::by_pattern(pattern, &text()).map(|(ns, _)| ns as f64 * 1e-9);
            self.formatted.add(row, &text, t);
            return;
        }
        let what = What::of(first, second);
        let numbers = match &what {
            What::Number(value) => [Some(*value); 2],
            What::Digits(number) => {
                self.evidence.add(number, line, name, &first.shown());
                [number.value(Decimal::Point), number.value(Decimal::Comma)]
            }
            _ => [None; 2],
        };
        for (numbers, value) in self.numbers.iter_mut().zip(numbers) {
            numbers.add(row, &text, value);
        }
        let stamp = if let What::Dated(stamp) = &what { Some(*stamp) } else { None };
        for (track, order) in self.dates.iter_mut().zip(Order::ALL) {
            track.add(row, &text, stamp.and_then(|s| s.civil(order)).map(|ns| ns as f64 * 1e-9));
        }
        if let Some(stamp) = stamp {
            if !stamp.is_whole_second() {
                self.fractions.add(&text(), line);
            }
            self.offsets[usize::from(stamp.offset.is_none())].get_or_insert_with(|| (line, shown(&text())));
            self.open |= stamp.is_open();
            self.dotted |= stamp.is_dotted();
            if stamp.has_letters && self.letters.is_none() {
                self.letters = Some((line, shown(&text())));
            }
            self.example.get_or_insert_with(|| (line, shown(&text())));
            if let Some(day) = stamp.far_day() {
                self.far += 1;
                self.first_far.get_or_insert_with(|| (line, shown(&text()), day));
            }
        }
        let clock = if let What::Clock(ns) = what { Some(ns as f64 * 1e-9) } else { None };
        if clock.is_some() && self.short_clock.is_none() && is_short(&text()) {
            self.short_clock = Some((line, shown(&text())));
        }
        self.minutes += u64::from(clock.is_some() && stamp::are_minutes(&text()));
        self.clocks.add(row, &text, clock);
        let moment = if let What::Moment { ns, base } = what {
            self.base.get_or_insert(base);
            Some(ns as f64 * 1e-9)
        } else {
            None
        };
        self.moments.add(row, &text, moment);
    }
}

/// Whether a time of day is two numbers: `06:00`, `00:02.5`.
fn is_short(text: &str) -> bool {
    text.bytes().filter(|byte| *byte == b':').count() == 1
        && text.bytes().all(|byte| byte.is_ascii_digit() || b":., ".contains(&byte))
}

fn both(first: &Cell<'_>, second: Option<&Cell<'_>>) -> String {
    match second {
        Some(second) => format!("{} {}", first.shown(), second.shown()),
        None => first.shown(),
    }
}

/// Rows that follow each other under the same stamp.
#[derive(Default)]
pub struct Groups {
    /// How many rows each has.
    pub sizes: Vec<u32>,
    /// Rows in all.
    pub rows: u64,
    /// Rows under the stamp of the row before, and those of them with other values than it.
    pub repeated: u64,
    /// See `repeated`.
    pub moved: u64,
    before: String,
    given_up: bool,
}

/// Groups that are remembered; a table of more is read as it is.
const MOST_GROUPS: usize = 1 << 22;
/// Rows from which stamps that were cut can be told.
const FEW_ROWS: u64 = 20;
/// Groups after which it is clear whether there are any.
const FIRST_GROUPS: usize = 1 << 12;

impl Groups {
    /// One more row. `moves` says whether its values are others than those of the rows before under its stamp; it is told whether the
    /// row is the first of its stamp.
    pub fn add(&mut self, first: &Cell<'_>, second: Option<&Cell<'_>>, moves: impl FnOnce(bool) -> bool) {
        if self.given_up {
            return;
        }
        let text = both(first, second);
        self.rows += 1;
        let is_first = self.sizes.is_empty() || text != self.before;
        let moved = moves(is_first);
        match self.sizes.last_mut() {
            Some(size) if !is_first => {
                *size += 1;
                self.repeated += 1;
                self.moved += u64::from(moved);
            }
            _ => {
                self.sizes.push(1);
                self.before = text;
            }
        }
        let single = self.sizes.len() >= FIRST_GROUPS && self.repeated < self.sizes.len() as u64 / 2;
        if single || self.sizes.len() > MOST_GROUPS {
            *self = Self { given_up: true, ..Self::default() };
        }
    }

    /// Whether nearly every row has the stamp of the row before, and other values.
    pub fn is_cut(&self) -> bool {
        self.rows >= FEW_ROWS
            && self.sizes.len() > 1
            && self.repeated * 10 >= self.rows * 9
            && self.moved * 10 >= self.repeated
    }

    /// How many rows a stamp usually has, where most have several of other values.
    pub fn usual(&self) -> Option<u32> {
        let inner = self.sizes.get(1..self.sizes.len().checked_sub(1)?)?;
        let mut sorted = inner.to_vec();
        sorted.sort_unstable();
        let usual = *sorted.get(sorted.len() / 2)?;
        let even = inner.iter().filter(|size| size.abs_diff(usual) <= (usual / 5).max(1)).count();
        let many = usual >= 2 && inner.len() >= 2 && self.moved * 10 >= self.repeated;
        (many && even * 10 >= inner.len() * 9).then_some(usual)
    }
}
