//! Tables in which each tag has times of its own beside it, as historians hand out what they keep: `time, value, time, value`.
//! They are read as rows of tag, time and value.
//!
//! ```text
//! FIC101.PV       |        | FIC101.OP       |            tag    time            value
//! Timestamp       | Value  | Timestamp       | Value  ->  PV     02.06. 06:00:02  51.4
//! 02.06. 06:00:02 | 51.4   | 02.06. 06:00:01 | 49.8       OP     02.06. 06:00:01  49.8
//! ```
//!
//! The columns of times have to be called alike, but for the name of their tag or a number: `Time1, OP, Time2, PV`, `OP time, OP,
//! PV time, PV`. A run time or a temperature that rises beside the time is none.

use super::error::TableError;
use super::layout::{Body, Layout, Long, PREAMBLE, Seen, SeenRow, VALUES};
use super::names::{Meaning, Name, as_unit};
use super::number::{self, Decimal};
use super::source::{Cell, Rows};
use super::stamp;
use super::time::WhatKind;
use super::vocabulary;

/// Words of columns of times that belong together: where an interval begins and ends, one moment in two zones or on two machines.
const TOGETHER: [&str; 15] = [
    "start", "end", "begin", "stop", "from", "to", "von", "bis", "utc", "gmt", "local", "lokal", "server",
    "source", "received",
];
/// Words by which a column of numbers is one of times.
const TIMES: [&str; 9] = ["time", "timestamp", "zeit", "zeitstempel", "date", "t", "ts", "x", "stamp"];
/// Rows from which it is told what a column holds.
const FEW: usize = 3;

/// The columns of a tag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pair {
    name: String,
    unit: String,
    /// How its times are called, but for its name and a number, and their unit.
    stem: String,
    time_unit: Option<String>,
    time: usize,
    value: usize,
    quality: Option<usize>,
    /// How its column of quality is called.
    said: String,
}

/// The tags, and the rows above the first sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pairs {
    all: Vec<Pair>,
    skip: usize,
}

/// What a column holds below the header.
#[derive(Clone, Copy, PartialEq)]
enum Holds {
    /// Dates with a time of day.
    Moments,
    /// Numbers that count time.
    Counts,
    Numbers,
    Words,
    Nothing,
}

/// The layout of such a table; `told`: somebody names the column of times, which stands as long as all have the same.
pub fn look(rows: &[SeenRow], told: bool) -> Option<Result<Layout, TableError>> {
    let pairs = find(rows)?;
    if told {
        let differ = |(_, row): &SeenRow| {
            let mut times = pairs.all.iter().filter_map(|pair| row.get(pair.time)).map(|cell| &cell.text);
            times.next().is_some_and(|first| times.any(|own| !own.is_empty() && own != first))
        };
        return rows[pairs.skip..].iter().any(differ).then(|| {
            let columns: Vec<String> = pairs.all.iter().map(|pair| (pair.time + 1).to_string()).collect();
            Err(TableError::refused(format!(
                "columns {} hold other times: each tag has its own; leave --time out, and each is read by its own",
                columns.join(" and ")
            )))
        });
    }
    let said = pairs.all[0].said.as_str();
    let said = if said.is_empty() { "quality" } else { said };
    let names = ["tag", "time of each tag", "value", "unit", said].map(Name::new).into();
    let qualities = if pairs.all[0].quality.is_some() { vec![4] } else { Vec::new() };
    let body = Long { tag: 0, value: 2, owner: None, qualities, source: None, unit: Some(3) };
    let line = pairs.skip.checked_sub(1).map_or(1, |above| rows[above].0);
    Some(Ok(Layout {
        line,
        skip: 0,
        names,
        time: 1,
        clock: None,
        millis: None,
        time_unit: pairs.all[0].time_unit.clone(),
        zone: None,
        body: Body::Long(body),
        pairs: Some(pairs),
    }))
}

/// The tags with their columns.
fn find(rows: &[SeenRow]) -> Option<Pairs> {
    let is_sample = |(_, row): &SeenRow| {
        let numbers = |kind| row.iter().filter(|cell| cell.kind == kind).count();
        numbers(WhatKind::Number) > 1 && numbers(WhatKind::Number) + numbers(WhatKind::Dated) > 3
    };
    let whole = rows.iter().take(PREAMBLE).position(is_sample)?;
    // Above the first whole sample there may be some in which a value is missing.
    let is_part =
        |(_, row): &SeenRow| row.iter().any(|cell| matches!(cell.kind, WhatKind::Number | WhatKind::Dated));
    let part = rows[..whole].iter().rev().take_while(|row| is_part(row)).count();
    let skip = Some(whole - part).filter(|skip| *skip > 0)?;
    let (header, above) = (&rows[skip - 1].1, skip.checked_sub(2).map(|at| rows[at].1.as_slice()));
    let samples = &rows[skip..];
    let width = samples.iter().map(|(_, row)| row.len()).max().filter(|_| samples.len() >= FEW)?;
    let holds: Vec<Holds> = (0..width).map(|at| holds(samples, at, header.get(at))).collect();
    let mut all: Vec<Pair> = Vec::new();
    let mut at = 0;
    while at < width {
        match holds[at..] {
            [Holds::Nothing, ..] => at += 1,
            [Holds::Moments | Holds::Counts, Holds::Numbers | Holds::Words, ref behind @ ..] => {
                let quality = (behind.first() == Some(&Holds::Words)).then_some(at + 2);
                all.push(pair(header, above, at, quality)?);
                at += if quality.is_some() { 3 } else { 2 };
            }
            _ => return None,
        }
    }
    let measured = all.iter().filter(|pair| holds[pair.value] == Holds::Numbers).count();
    let once = |pair: &Pair| all.iter().filter(|other| other.name == pair.name).count() == 1;
    let quality = |pair: &Pair| pair.quality.map(|_| pair.said.clone());
    let same = |pair: &Pair| (holds[pair.time], quality(pair), pair.stem.clone(), pair.time_unit.clone());
    let alike = all.windows(2).all(|two| same(&two[0]) == same(&two[1]));
    let are_pairs = measured > 1 && alike && all.iter().all(once) && overlap(samples, &all);
    are_pairs.then_some(Pairs { all, skip })
}

/// What a column holds; numbers are times where the header says so and they go one way.
fn holds(samples: &[SeenRow], at: usize, header: Option<&Seen>) -> Holds {
    let cells = || samples.iter().filter_map(|(_, row)| row.get(at));
    let (mut dated, mut numbers, mut others) = (0, 0, 0);
    for cell in cells() {
        match cell.kind {
            WhatKind::Dated if stamp::scan(&cell.text).is_none_or(|own| !own.is_date_only()) => dated += 1,
            WhatKind::Number => numbers += 1,
            WhatKind::Blank => {}
            _ => others += 1,
        }
    }
    // PHD's confidence is a number that measures nothing.
    let called_quality = header.is_some_and(|cell| Name::new(&cell.text).quality_of().is_some());
    let called_time = header.is_some_and(|cell| is_time(&Name::new(&cell.text)));
    let is_time = called_time && goes_one_way(&values(samples, at));
    match dated.max(numbers).max(others) {
        0 => Holds::Nothing,
        most if most == dated => Holds::Moments,
        most if most == numbers && called_quality => Holds::Words,
        most if most == numbers && is_time => Holds::Counts,
        most if most == numbers => Holds::Numbers,
        _ => Holds::Words,
    }
}

/// The numbers of a column.
fn values(samples: &[SeenRow], at: usize) -> Vec<f64> {
    let cells = samples.iter().filter_map(|(_, row)| row.get(at));
    let value = |cell: &Seen| {
        let number = number::scan(&cell.text)?;
        number.value(Decimal::Point).or_else(|| number.value(Decimal::Comma))
    };
    cells.filter_map(value).collect()
}

/// Whether nearly all steps of these have one sign: times do, a dead time does not.
fn goes_one_way(values: &[f64]) -> bool {
    let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
    let (up, down) =
        steps.fold((0, 0), |(up, down), step| (up + usize::from(step > 0.0), down + usize::from(step < 0.0)));
    10 * up.max(down) >= 9 * (values.len().max(2) - 1)
}

/// Whether columns of numbers have times in common.
fn overlap(samples: &[SeenRow], all: &[Pair]) -> bool {
    let range = |pair: &Pair| {
        let values = values(samples, pair.time);
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        (least, values.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    };
    let (least, most) = range(&all[0]);
    // Dates have none.
    all.iter().map(range).all(|own| own.0 <= most && own.1 >= least || least > most)
}

fn is_time(name: &Name) -> bool {
    let of_time = |word: &str| TIMES.contains(&word.trim_end_matches(|c: char| c.is_ascii_digit()));
    name.said().is_some_and(|said| said.meaning == Meaning::Time) || name.plain().split(' ').any(of_time)
}

/// The tag whose times stand at `time`; its name stands over its value or its times, there or a row above.
fn pair(header: &[Seen], above: Option<&[Seen]>, time: usize, quality: Option<usize>) -> Option<Pair> {
    fn text(row: &[Seen], at: usize) -> &str {
        row.get(at).map_or("", |cell| cell.text.trim())
    }
    let value = time + 1;
    let named = text(header, time).to_lowercase();
    if named.split(|c: char| !c.is_alphanumeric()).any(|word| TOGETHER.contains(&word)) {
        return None;
    }
    // Words behind a value that are not called a quality may be a mode or a unit.
    let behind = quality.map(|at| Name::new(text(header, at)));
    if behind.as_ref().is_some_and(|name| !name.is_none() && name.quality_of().is_none()) {
        return None;
    }
    let said = behind.map(|name| name.plain().to_string()).unwrap_or_default();
    let unit = as_unit(text(header, value)).unwrap_or_default();
    let of_value = |word: &str| [VALUES.as_slice(), vocabulary::VALUES].iter().any(|all| all.contains(&word));
    let is_name = |name: &&str| {
        let own = Name::new(name);
        !own.is_none() && !is_time(&own) && !of_value(own.plain()) && as_unit(name).is_none()
    };
    let places = [(Some(header), value), (Some(header), time), (above, time), (above, value)];
    let name = places.into_iter().filter_map(|(row, at)| Some(text(row?, at))).find(is_name)?;
    let stem = stem(text(header, time), name)?;
    let time_unit = Name::new(text(header, time)).unit_of_time();
    // WinCC calls its columns `FIC101_OP Time` and `FIC101_OP ValueY`, in German `Zeit` and `Wert`.
    let behind = name.rsplit_once(' ').filter(|(_, last)| of_value(&last.to_lowercase()));
    let name = behind.map_or(name, |(tag, _)| tag.trim());
    let (name, unit) = (name.to_string(), unit.to_string());
    Some(Pair { name, unit, stem, time_unit, time, value, quality, said })
}

impl Pairs {
    /// One more row stands above.
    pub fn lower(&mut self) {
        self.skip += 1;
    }
}

/// How times are called, `OP time (s)`, but for the words of their tag and a number behind; `None` for a letter alone, which may be a
/// temperature.
fn stem(times: &str, tag: &str) -> Option<String> {
    let (times, tag) = (Name::new(times), Name::new(tag));
    let of_tag: Vec<&str> = tag.plain().split(' ').collect();
    let own = times.plain().split(' ').filter(|word| !of_tag.contains(word) && word.parse::<u32>().is_err());
    let stem = own.collect::<Vec<_>>().join(" ").trim_end_matches(|c: char| c.is_ascii_digit()).to_string();
    (stem.len() != 1 || stem != times.plain()).then_some(stem)
}

/// Rows of tag, time, value, unit and quality out of rows with several tags.
pub struct PairRows<'r> {
    inner: Box<dyn Rows + 'r>,
    pairs: &'r Pairs,
    /// The tag of this row, and the line that all tags of a row have.
    at: usize,
    line: Option<u64>,
}

impl<'r> PairRows<'r> {
    /// Passes over what stands above the samples.
    pub fn new(mut inner: Box<dyn Rows + 'r>, pairs: &'r Pairs) -> Result<Self, TableError> {
        for _ in 0..pairs.skip {
            inner.next()?;
        }
        Ok(Self { inner, pairs, at: 0, line: None })
    }

    fn pair(&self) -> &'r Pair {
        &self.pairs.all[self.at]
    }
}

impl Rows for PairRows<'_> {
    fn next(&mut self) -> Result<Option<u64>, TableError> {
        loop {
            if self.line.is_some() && self.at + 1 < self.pairs.all.len() {
                self.at += 1;
            } else {
                (self.line, self.at) = (self.inner.next()?, 0);
            }
            let pair = self.pair();
            let blank = [pair.time, pair.value].iter().any(|at| self.inner.cell(*at).is_blank());
            if self.line.is_none() || !blank {
                return Ok(self.line);
            }
        }
    }

    fn len(&self) -> usize {
        5
    }

    fn cell(&self, at: usize) -> Cell<'_> {
        let pair = self.pair();
        match at {
            0 => Cell::Text(&pair.name),
            1 => self.inner.cell(pair.time),
            2 => self.inner.cell(pair.value),
            3 => Cell::Text(&pair.unit),
            4 => pair.quality.map_or(Cell::Blank, |at| self.inner.cell(at)),
            _ => Cell::Blank,
        }
    }

    fn row_name(&self) -> &'static str {
        self.inner.row_name()
    }
}
