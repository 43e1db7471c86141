//! Which column holds the times: one, or a date and the time of day beside it, or whole seconds and parts of a second.

use super::channel::Channel;
use super::dotted_clock::are_dotted_clocks;
use super::error::{TableError, shown};
use super::layout::{Layout, Seen, SeenRow, known};
use super::names::{Meaning, Name};
use super::number;
use super::options::{Options, Unit};
use super::roles::{Trouble, told};
use super::stamp;
use super::time::WhatKind;
use crate::signal::Role;

/// Rows below the header that are looked at: units and descriptions stand above the samples.
const FIRST: usize = 12;

/// The column of times, and that of the time of day where the first is the date.
pub fn times(
    names: &[Name],
    below: &[SeenRow],
    options: &Options,
) -> Result<(usize, Option<usize>), Trouble> {
    let (at, other) = column(names, below, options)?;
    match (cells(below, at), other) {
        (Some(Holds::Date), _) => {
            let clocks: Vec<usize> = of_kind(names, below, Holds::Clock).collect();
            // A spreadsheet may have the time of day as a number, which only its name tells.
            Ok((at, clock_beside(at, &clocks, names).or(other)))
        }
        (Some(Holds::Clock), _) => {
            let dates: Vec<usize> = of_kind(names, below, Holds::Date).collect();
            match dates.as_slice() {
                [date] => Ok((*date, Some(at))),
                _ => Ok((at, None)),
            }
        }
        (_, other) => Ok((at, other)),
    }
}

/// Of several columns of times of day the one that is called so, else the one beside the date.
fn clock_beside(date: usize, clocks: &[usize], names: &[Name]) -> Option<usize> {
    let called = clocks.iter().find(|at| names[**at].is_clock());
    let next = || clocks.iter().find(|at| at.abs_diff(date) == 1);
    called.or_else(next).copied().or(if let [one] = clocks { Some(*one) } else { None })
}

/// What the cells of a column of times hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Holds {
    /// Dates without a time of day.
    Date,
    /// Times of day without a date.
    Clock,
    /// Dates with a time of day.
    Moment,
    /// Numbers.
    Number,
}

/// What the first cells of a column hold; `None` where they are no times.
fn cells(below: &[SeenRow], at: usize) -> Option<Holds> {
    let (mut held, mut times, mut others) = (None, 0, 0);
    let are_clocks = are_dotted_clocks(below, at);
    for cell in below.iter().take(FIRST).filter_map(|(_, row)| row.get(at)) {
        let own = match cell.kind {
            WhatKind::Clock => Holds::Clock,
            WhatKind::Dated if are_clocks => Holds::Clock,
            WhatKind::Dated if stamp::scan(&cell.text).is_some_and(|own| own.is_date_only()) => Holds::Date,
            WhatKind::Dated => Holds::Moment,
            WhatKind::Number => Holds::Number,
            WhatKind::Blank => continue,
            WhatKind::Nothing => {
                others += 1;
                continue;
            }
        };
        times += 1;
        held = match held {
            Some(before) if before != own => Some(Holds::Moment),
            _ => Some(own),
        };
    }
    held.filter(|_| times > others)
}

fn of_kind(names: &[Name], below: &[SeenRow], wanted: Holds) -> impl Iterator<Item = usize> {
    (0..names.len()).filter(move |at| cells(below, *at) == Some(wanted))
}

/// The column of times by its name, or by what stands in it; with that of the time of day where names say so.
fn column(names: &[Name], below: &[SeenRow], options: &Options) -> Result<(usize, Option<usize>), Trouble> {
    if let Some(wanted) = &options.time {
        let at = told(names, wanted, "time", true).map_err(|error| {
            if known(names, options) > 1 { Trouble::Refused(error) } else { Trouble::Missing(vec!["t"]) }
        })?;
        // By number any row has such a column; by a pattern anything may be a time.
        let by_pattern = options.time_format.as_ref().is_some_and(|format| format.contains('%'));
        let by_number = !names[at].is(wanted) && !by_pattern;
        if by_number && !below.is_empty() && cells(below, at).is_none() {
            return Err(Trouble::Missing(vec!["t"]));
        }
        let clock = names[at].is_date().then(|| names.iter().position(Name::is_clock)).flatten();
        return Ok((at, clock.filter(|clock| *clock != at)));
    }
    let is_time = |name: &Name| name.said().is_some_and(|said| said.meaning == Meaning::Time);
    let mut found: Vec<usize> = (0..names.len()).filter(|at| is_time(&names[*at])).collect();
    // LabVIEW's name of a time is one of anything beside a better one; local times and those at which something began are less exact
    // than others beside them.
    let is_weak = |at: &usize| {
        let is_local = names[*at].unit.as_deref().is_some_and(|unit| unit.eq_ignore_ascii_case("local"));
        is_local || ["x value", "start time", "starttime"].contains(&names[*at].plain())
    };
    if found.iter().any(|at| !is_weak(at) && !names[*at].is_date()) {
        found.retain(|at| !is_weak(at));
    }
    match found.as_slice() {
        // pandas calls an index without a name so.
        [one] if names[*one].plain() == "index level 0" => not_row_numbers(*one, names, below, options),
        [one] => Ok((*one, None)),
        [a, b] if names[*a].is_date() && names[*b].is_clock() => Ok(pair(below, *a, *b)),
        [a, b] if names[*b].is_date() && names[*a].is_clock() => Ok(pair(below, *b, *a)),
        [] => {
            // An index without a name, or a column of dates under any name.
            let holds = |at: usize| cells(below, at);
            let nameless = names.first().is_some_and(Name::is_none)
                && matches!(holds(0), Some(Holds::Number | Holds::Moment | Holds::Date | Holds::Clock));
            let is_dated = |at: &usize| matches!(holds(*at), Some(Holds::Moment | Holds::Date));
            let mut dated = (0..names.len()).filter(is_dated);
            match (dated.next(), dated.next(), nameless) {
                (Some(at), None, _) => Ok((at, None)),
                (None, _, true) => not_row_numbers(0, names, below, options),
                _ => Err(Trouble::Missing(vec!["t"])),
            }
        }
        [first, second, ..] => by_cells(&found, names, below).map(|at| (at, None)).ok_or_else(|| {
            Trouble::Refused(TableError::refused(format!(
                "column {}: {:?} is the second column for t (after column {}); say which with --time",
                second + 1,
                shown(&names[*second].full),
                first + 1
            )))
        }),
    }
}

/// The index of a table as its times, unless it numbers the rows, as pandas and R write them: whole numbers from 0 or 1 in steps
/// of 1. Seconds may be such, too, where somebody says so.
fn not_row_numbers(
    at: usize,
    names: &[Name],
    below: &[SeenRow],
    options: &Options,
) -> Result<(usize, Option<usize>), Trouble> {
    let cells = below.iter().filter_map(|(_, row)| row.get(at)).filter(|cell| cell.kind == WhatKind::Number);
    let numbers: Vec<Option<u64>> = cells.map(|cell| number::bare(&cell.text).parse().ok()).collect();
    let counts = |from: u64| numbers.iter().zip(from..).all(|(own, number)| *own == Some(number));
    if options.time_unit.is_some() || numbers.len() < FEW || !counts(0) && !counts(1) {
        return Ok((at, None));
    }
    let name = if names[at].is_none() { "no name" } else { names[at].full.as_str() };
    Err(Trouble::Refused(TableError::refused(format!(
        "column {} ({name}) holds {}, {} and so on: row numbers, or seconds; name the column of times with --time, or say \
         --time-unit s where these are seconds",
        at + 1,
        numbers[0].unwrap_or_default(),
        numbers[1].unwrap_or_default()
    ))))
}

/// Numbers from which a count is one.
const FEW: usize = 3;

/// A date and the time of day beside it; the second alone where it holds both.
fn pair(below: &[SeenRow], date: usize, clock: usize) -> (usize, Option<usize>) {
    // Access writes a time of day as one of its first day.
    let first_day = |text: &str| text.contains("1899") || text.contains("1900");
    let mut cells_of = below.iter().filter_map(|(_, row)| row.get(clock)).map(|cell| cell.text.as_str());
    let whole = cells(below, clock) == Some(Holds::Moment) && !cells_of.any(first_day);
    if whole { (clock, None) } else { (date, Some(clock)) }
}

/// Of several columns that are called times, the date of a date and a time of day, or the only one of dates among numbers:
/// WinCC writes a number of its own beside the date.
fn by_cells(found: &[usize], names: &[Name], below: &[SeenRow]) -> Option<usize> {
    let of = |wanted: Holds| found.iter().copied().filter(move |at| cells(below, *at) == Some(wanted));
    let (dates, clocks): (Vec<usize>, Vec<usize>) = (of(Holds::Date).collect(), of(Holds::Clock).collect());
    let (moments, numbers): (Vec<usize>, Vec<usize>) =
        (of(Holds::Moment).collect(), of(Holds::Number).collect());
    match (dates.as_slice(), clocks.as_slice(), moments.as_slice()) {
        ([date], [_], []) if found.len() == 2 => Some(*date),
        ([], [], [moment]) if numbers.len() + 1 == found.len() => {
            let exact = numbers.iter().find(|at| is_exact(*moment, **at, names, below));
            Some(exact.copied().unwrap_or(*moment))
        }
        _ => None,
    }
}

/// Whether a column of numbers has the times whole, in a unit below a second that its name says, and that of dates has them cut
/// to seconds.
fn is_exact(moment: usize, at: usize, names: &[Name], below: &[SeenRow]) -> bool {
    let per_second = match names[at].unit_of_time().as_deref().and_then(Unit::of) {
        Some(Unit::Millis) => 1e3,
        Some(Unit::Micros) => 1e6,
        Some(Unit::Nanos) => 1e9,
        _ => return false,
    };
    let cells = |at: usize| below.iter().filter_map(move |(_, row)| row.get(at));
    let numbers = || cells(at).filter(|cell| cell.kind == WhatKind::Number);
    let is_cut = |cell: &Seen| cell.text.trim().parse::<f64>().is_ok_and(|value| value % per_second != 0.0);
    let dates = || cells(moment).filter(|cell| cell.kind == WhatKind::Dated);
    numbers().all(|cell| is_since_1970(&cell.text, per_second))
        && numbers().any(is_cut)
        && dates().all(|cell| is_whole(&cell.text))
}

/// Refuses a second column of times between OP and PV, or with the name of one of them: then each has its own. `nameless` are
/// columns without a name that hold other times.
pub fn one_of_loop<'c>(
    channels: &'c [Channel],
    nameless: impl Iterator<Item = &'c Channel>,
    layout: &Layout,
) -> Result<(), TableError> {
    let at = |role: Role| channels.iter().find(|c| c.role == Some(role)).map_or(0, |c| c.column);
    let (op, pv) = (at(Role::Op), at(Role::Pv));
    let named_so =
        |c: &Channel| Name::new(&c.tag.name).plain().split(' ').any(|word| matches!(word, "op" | "pv"));
    let between = |c: &&Channel| c.column > op.min(pv) && c.column < op.max(pv) || named_so(c);
    let named = channels.iter().filter(|c| c.other_times * 2 > c.cells);
    named.chain(nameless).find(between).map_or(Ok(()), |other| {
        Err(TableError::refused(format!(
            "column {} ({}) holds other times than column {} ({}): each tag has its own; save them on common times, or as \
             rows of tag, time and value",
            other.column,
            if other.tag.name.is_empty() { "no name" } else { &other.tag.name },
            layout.time + 1,
            layout.names[layout.time].full
        )))
    })
}

/// Rows below the header in which the names of columns may stand.
const UNDER: usize = 4;
/// Parts of a second: names of a column of them beside one of whole seconds, and how many are a second, and what they are called.
type Parts = (&'static [&'static str], f64, &'static str);
const MILLIS: Parts = (
    &[
        "millitm",
        "millis",
        "millisec",
        "millisecs",
        "millisecond",
        "milliseconds",
        "millisekunden",
        "msec",
        "msecs",
        "ms",
    ],
    1e3,
    "milliseconds",
);
const PARTS: [Parts; 4] = [
    MILLIS,
    (
        &["micros", "microsec", "microsecond", "microseconds", "usec", "usecs", "us", "µs"],
        1e6,
        "microseconds",
    ),
    (&["nanos", "nanosec", "nanosecond", "nanoseconds", "nsec", "nsecs", "ns"], 1e9, "nanoseconds"),
    (
        &[
            "fraction",
            "frac",
            "fracsec",
            "frac sec",
            "fraction sec",
            "fractional seconds",
            "subsec",
            "subseconds",
        ],
        1.0,
        "fractions of a second",
    ),
];
/// A logger's name of milliseconds, which means nothing else.
const OF_LOGGER: &str = "millitm";
/// What such a name may mean besides: a share of anything.
const SHARES: [&str; 2] = ["fraction", "frac"];

/// The parts of a second in a column of this name; thousandths where the name is none of them.
fn parts_of(name: &Name) -> Parts {
    PARTS.into_iter().find(|(names, ..)| names.contains(&name.plain())).unwrap_or(MILLIS)
}

/// How a column of this name calls the parts of a second in it.
pub fn parts_said(name: &Name) -> &'static str {
    parts_of(name).2
}

/// The column of milliseconds, or of other parts of a second: numbers below a second beside whole seconds. Where the name may mean
/// something else, it stands behind the times, one of the seconds comes more than once, or all have three digits and one begins
/// with 0. The name may stand in a row below the header, where that has the tags.
///
/// # Errors
/// A column that may be one, and stands elsewhere.
pub fn parts(
    names: &[Name],
    (time, clock): (usize, Option<usize>),
    below: &[SeenRow],
    options: &Options,
) -> Result<Option<usize>, Trouble> {
    let of_column = |at: usize| {
        let named = |row: &&SeenRow| {
            let said = row.1.get(time).and_then(|cell| Name::new(&cell.text).said());
            said.is_some_and(|said| said.meaning == Meaning::Time)
        };
        let under = below.iter().take(UNDER).filter(named).filter_map(move |(_, row)| row.get(at));
        let mut under = under.filter(|cell| cell.kind == WhatKind::Nothing).map(|cell| Name::new(&cell.text));
        let own = PARTS.iter().any(|(all, ..)| all.contains(&names[at].plain()));
        let own = own.then(|| names[at].clone());
        own.or_else(|| under.find(|name| MILLIS.0.contains(&name.plain())))
    };
    let mut others = (0..names.len()).filter(|at| *at != time && Some(*at) != clock);
    let Some((at, name)) = others.find_map(|at| Some((at, of_column(at)?))) else {
        return Ok(None);
    };
    let counts_seconds =
        options.time_unit.as_deref().is_none_or(|unit| Unit::of(unit) == Some(Unit::Seconds));
    let is_row = |row: &&SeenRow| match row.1.get(time) {
        Some(cell) if cell.kind == WhatKind::Number => counts_seconds && is_since_1970(&cell.text, 1.0),
        Some(cell) => matches!(cell.kind, WhatKind::Dated | WhatKind::Clock),
        None => false,
    };
    let timed: Vec<&SeenRow> = below.iter().filter(is_row).collect();
    let seconds_of = |row: &SeenRow| {
        let clock = clock.and_then(|at| row.1.get(at)).map_or("", |cell| cell.text.as_str());
        format!("{} {clock}", row.1[time].text)
    };
    let whole = |row: &&SeenRow| {
        let clock = clock.and_then(|at| row.1.get(at));
        is_whole(&row.1[time].text) && clock.is_none_or(|cell| is_whole(&cell.text))
    };
    let part = |row: &SeenRow| row.1.get(at).and_then(|cell| part(&cell.text, &name));
    if timed.is_empty() || !timed.iter().all(|row| whole(row) && part(row).is_some()) {
        return Ok(None);
    }
    let repeats = timed.windows(2).any(|pair| seconds_of(pair[0]) == seconds_of(pair[1]));
    let cells = || timed.iter().filter_map(|row| row.1.get(at)).map(|cell| cell.text.trim());
    let padded = cells().all(|text| text.len() == 3) && cells().any(|text| text.starts_with('0'));
    let beside = at == time + 1 || clock.is_some_and(|clock| at == clock + 1);
    let is_share = SHARES.contains(&name.plain());
    if name.plain() == OF_LOGGER || (beside || repeats || padded) && !is_share {
        return Ok(Some(at));
    }
    // Nothing but zeros changes no time.
    if timed.iter().all(|row| part(row) == Some(0.0)) {
        return Ok(None);
    }
    Err(Trouble::Refused(TableError::refused(format!(
        "column {}: {:?} may hold the parts of a second of the times in column {}, which are whole seconds; call it \"ms\", \"us\" or \
         \"ns\" right behind them, write both into one column, such as 2026-06-01 06:00:02.030, or call it otherwise where it is \
         something else",
        at + 1,
        shown(&names[at].full),
        time + 1
    ))))
}

/// Whether a cell of times says whole seconds.
fn is_whole(text: &str) -> bool {
    // A moment of a workbook, as it is shown.
    let near = |number: f64| (number - number.round()).abs() < 1e-5;
    let number = text.split(" s since ").next().unwrap_or(text).trim().parse::<f64>();
    number.map_or_else(|_| stamp::scan(text).is_some_and(|own| own.is_whole_second()), near)
}

/// Whether a number counts parts of a second since 1970, so many a second.
fn is_since_1970(text: &str, per_second: f64) -> bool {
    let value = text.trim().parse::<f64>().unwrap_or(f64::NAN);
    (SINCE_1970.0 * per_second..SINCE_1970.1 * per_second).contains(&value)
}

/// Seconds since 1970 from 1990 to 2100.
const SINCE_1970: (f64, f64) = (631_152_000.0, 4_102_444_800.0);

/// Names of a column of seconds beside times in whole minutes.
const SECONDS: [&str; 5] = ["sec", "second", "seconds", "ss", "s"];

/// Refuses a column of seconds beside times in whole minutes that come more than once.
pub fn seconds(names: &[Name], time: usize, below: &[SeenRow]) -> Result<(), Trouble> {
    let named = |at: &usize| *at != time && SECONDS.contains(&names[*at].plain());
    let Some(at) = (0..names.len()).find(named) else { return Ok(()) };
    let dated: Vec<&SeenRow> =
        below.iter().filter(|row| row.1.get(time).is_some_and(|cell| cell.kind == WhatKind::Dated)).collect();
    let minutes = |row: &&SeenRow| stamp::scan(&row.1[time].text).is_some_and(|own| own.is_whole_minute());
    let below_sixty = |row: &&SeenRow| {
        let cell = row.1.get(at).and_then(|cell| cell.text.trim().replace(',', ".").parse::<f64>().ok());
        cell.is_some_and(|s| (0.0..60.0).contains(&s))
    };
    let repeats = dated.windows(2).any(|pair| pair[0].1[time].text == pair[1].1[time].text);
    if !repeats || !dated.iter().all(|row| minutes(row) && below_sixty(row)) {
        return Ok(());
    }
    Err(Trouble::Refused(TableError::refused(format!(
        "column {}: {:?} holds the seconds of the times in column {}; write them into one column, such as 2026-06-01 06:00:02",
        at + 1,
        shown(&names[at].full),
        time + 1
    ))))
}

/// A cell in a column of this name as a part of a second (s).
pub fn part(cell: &str, name: &Name) -> Option<f64> {
    let (_, per_second, _) = parts_of(name);
    let cell = cell.trim();
    if per_second > 1.0 {
        let count = cell.parse::<u32>().ok().map(f64::from)?;
        return (count < per_second).then_some(count / per_second);
    }
    let share = cell.replace(',', ".").parse::<f64>().ok()?;
    (0.0..1.0).contains(&share).then_some(share)
}

#[cfg(test)]
mod tests {
    use super::super::{Options, Source, Table, read};

    fn table(text: &str, options: &Options) -> Result<Table, String> {
        read(Source::Bytes(text.as_bytes()), options).map_err(|error| error.to_string())
    }

    fn rows(row: impl Fn(usize) -> String) -> String {
        (0..60).map(|at| row(at) + "\n").collect()
    }

    #[test]
    fn parts_of_a_second_belong_to_the_times_beside_them() {
        let part = |at: usize| (30 * at) % 1000;
        let dated = |at: usize| format!("2026-06-15 06:{:02}:{:02}", at * 2 / 60, at * 2 % 60);
        for (header, scale, since_1970) in [
            ("Date,Time,Millisec,OP,PV", 1, false),
            ("timestamp,usec,OP,PV", 1_000, false),
            ("timestamp,nanoseconds,OP,PV", 1_000_000, false),
            ("time,ms,OP,PV", 1, true),
        ] {
            let row = |at: usize| {
                let time = if since_1970 { (1_781_503_200 + 2 * at).to_string() } else { dated(at) };
                let time = if header.starts_with("Date") { time.replace(' ', ",") } else { time };
                format!("{time},{},{}.5,51.25", part(at) * scale, 40 + at % 7)
            };
            let read = table(&format!("{header}\n{}", rows(row)), &Options::default());
            let op = read.unwrap_or_else(|said| panic!("{header}: {said}")).record.op;
            let off = |(at, own): (usize, &crate::signal::Sample)| {
                (own.t - op[0].t - 2.0 * at as f64 - part(at) as f64 / 1e3).abs()
            };
            assert!(op.iter().enumerate().map(off).fold(0.0, f64::max) < 1e-5, "{header}");
        }
        // A share may be one of anything, and milliseconds elsewhere a latency.
        for (header, cell) in [("Time,Fraction,OP,PV", 0), ("Time,OP,PV,ms", 3)] {
            let row = |at: usize| {
                let share = format!("0.{:03}", part(at));
                match cell {
                    0 => format!("{},{share},{}.5,51.25", dated(at), 40 + at % 7),
                    _ => format!("{},{}.5,51.25,{}", dated(at), 40 + at % 7, part(at)),
                }
            };
            let said =
                table(&format!("{header}\n{}", rows(row)), &Options::default()).err().unwrap_or_default();
            assert!(
                said.contains("may hold the parts of a second of the times in column 1"),
                "{header}: {said}"
            );
        }
    }

    #[test]
    fn exact_times_as_numbers_are_taken_before_cut_dates() {
        let row = |at: usize| {
            let ms = 1_781_503_200_000_u64 + 2_030 * at as u64;
            let s = ms / 1000 - 1_781_503_200;
            format!("2026-06-15 06:{:02}:{:02},{ms},{}.5,51.25", s / 60, s % 60, 40 + at % 7)
        };
        let read = table(&format!("Time,Timestamp_ms,OP,PV\n{}", rows(row)), &Options::default());
        let op = read.unwrap_or_else(|said| panic!("{said}")).record.op;
        assert!((op[1].t - op[0].t - 2.03).abs() < 1e-6 && (op[0].t - 1_781_503_200.0).abs() < 1e-6);
    }

    #[test]
    fn row_numbers_are_no_times() {
        for (first, header) in [(0, ",op,pv"), (1, "\"\",\"op\",\"pv\""), (1, "op,pv")] {
            let text = format!("{header}\n{}", rows(|at| format!("{},{}.5,51.25", first + at, 40 + at % 7)));
            let said = table(&text, &Options::default()).err().unwrap_or_default();
            assert!(said.contains("row numbers") && said.contains("--time-unit s"), "{header}: {said}");
            let told = Options { time_unit: Some("s".into()), ..Options::default() };
            let op = table(&text, &told).unwrap_or_else(|said| panic!("{said}")).record.op;
            assert!(op[59].t - op[0].t == 59.0, "{header}");
        }
        // Other steps are times, and row numbers beside times are passed over.
        let steps = rows(|at| format!("{},{}.5,51.25", 2 * at, 40 + at % 7));
        assert!(table(&format!(",op,pv\n{steps}"), &Options::default()).is_ok());
        let beside = rows(|at| format!("{at},2026-06-15 06:00:{at:02},{}.5,51.25", 40 + at % 7));
        let read = table(&format!(",time,op,pv\n{beside}"), &Options::default());
        assert!(read.is_ok_and(|table| table.record.op[1].t - table.record.op[0].t == 1.0));
    }
}
