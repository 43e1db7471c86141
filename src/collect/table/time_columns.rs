//! Which column holds the times: one, or a date and the time of day beside it, or whole seconds and milliseconds.

use super::error::{TableError, shown};
use super::layout::{SeenRow, known};
use super::names::{Meaning, Name};
use super::options::Options;
use super::roles::{Trouble, told};
use super::stamp;
use super::time::WhatKind;

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
    for cell in below.iter().take(FIRST).filter_map(|(_, row)| row.get(at)) {
        let own = match cell.kind {
            WhatKind::Clock => Holds::Clock,
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
    // LabVIEW's name of a time is one of anything beside a better one.
    if found.len() > 1 {
        found.retain(|at| names[*at].plain() != "x value");
    }
    match found.as_slice() {
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
                (None, _, true) => Ok((0, None)),
                _ => Err(Trouble::Missing(vec!["t"])),
            }
        }
        [first, second, ..] => by_cells(&found, below).map(|at| (at, None)).ok_or_else(|| {
            Trouble::Refused(TableError::refused(format!(
                "column {}: {:?} is the second column for t (after column {}); say which with --time",
                second + 1,
                shown(&names[*second].full),
                first + 1
            )))
        }),
    }
}

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
fn by_cells(found: &[usize], below: &[SeenRow]) -> Option<usize> {
    let of = |wanted: Holds| found.iter().copied().filter(move |at| cells(below, *at) == Some(wanted));
    let (dates, clocks): (Vec<usize>, Vec<usize>) = (of(Holds::Date).collect(), of(Holds::Clock).collect());
    let (moments, numbers): (Vec<usize>, usize) = (of(Holds::Moment).collect(), of(Holds::Number).count());
    match (dates.as_slice(), clocks.as_slice(), moments.as_slice()) {
        ([date], [_], []) if found.len() == 2 => Some(*date),
        ([], [], [moment]) if numbers + 1 == found.len() => Some(*moment),
        _ => None,
    }
}

/// Rows below the header in which the names of columns may stand.
const UNDER: usize = 4;
/// Names of a column of milliseconds beside one of whole seconds. The first is a logger's and means nothing else.
const MILLIS: [&str; 6] = ["millitm", "millis", "millisecond", "milliseconds", "msec", "ms"];

/// The column of milliseconds: whole numbers below a thousand beside whole seconds. Where the name may mean something else, it
/// stands behind the times, one of the seconds comes more than once, or all have three digits and one begins with 0. The name may stand in a row below the
/// header, where that has the tags.
pub fn millis(names: &[Name], time: usize, below: &[SeenRow]) -> Option<usize> {
    let of_column = |at: usize| {
        let named = |row: &&SeenRow| {
            let said = row.1.get(time).and_then(|cell| Name::new(&cell.text).said());
            said.is_some_and(|said| said.meaning == Meaning::Time)
        };
        let under = below.iter().take(UNDER).filter(named).filter_map(move |(_, row)| row.get(at));
        let under = under.filter(|cell| cell.kind == WhatKind::Nothing).map(|cell| Name::new(&cell.text));
        [names[at].clone()].into_iter().chain(under).find(|name| MILLIS.contains(&name.plain()))
    };
    let (at, name) = (0..names.len()).find_map(|at| Some((at, of_column(at)?)))?;
    let dated: Vec<&SeenRow> =
        below.iter().filter(|row| row.1.get(time).is_some_and(|cell| cell.kind == WhatKind::Dated)).collect();
    let whole = |row: &&SeenRow| stamp::scan(&row.1[time].text).is_some_and(|own| own.is_whole_second());
    let small = |row: &&SeenRow| row.1.get(at).is_some_and(|cell| whole_millis(&cell.text).is_some());
    let repeats = dated.windows(2).any(|pair| pair[0].1[time].text == pair[1].1[time].text);
    let cells = || dated.iter().filter_map(|row| row.1.get(at)).map(|cell| cell.text.trim());
    let padded = cells().all(|text| text.len() == 3) && cells().any(|text| text.starts_with('0'));
    let meant = name.plain() == MILLIS[0] || at == time + 1 || repeats || padded;
    (meant && !dated.is_empty() && dated.iter().all(|row| whole(row) && small(row))).then_some(at)
}

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

/// A cell of milliseconds of a second.
pub fn whole_millis(cell: &str) -> Option<u32> {
    cell.trim().parse().ok().filter(|ms| *ms < 1000)
}
