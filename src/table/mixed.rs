//! Rows of several loops in one table, by a column of any name: it is known by how its words stand, and by the values beside them.
//!
//! | the rows of loops stand | what tells it |
//! |---|---|
//! | at the same times | rows of one time have each another word, and other values |
//! | in turn | the word changes from row to row, and a value is nearer to the last one of its own word than to that of the row before |
//! | one loop below the other | where the word changes, the times begin again |
//!
//! A mode, a quality and a set point change seldom. A bit that turns with every row stands beside values that go on from row to row.

mod track;

use super::error::{TableError, listed, shown};
use super::header_zone::HeaderZone;
use super::layout::{Body, Layout};
use super::names::Name;
use super::number::{self, Decimal};
use super::options::{Options, Unit};
use super::owner::Owner;
use super::qualities::Quality;
use super::says::{is_alarm, is_bad_flag, is_good_flag, measured};
use super::source::{Cell, Rows};
use super::stamp::Order;
use super::time::What;
use super::time_columns;
use super::words::{Words, two_state};
use crate::signal::Role;
use std::borrow::Cow;
use std::collections::HashMap;
use std::hash::{BuildHasher, BuildHasherDefault, DefaultHasher};
use track::{Row, Track};

/// Words of a column beyond which they are none of loops.
const MOST_WORDS: usize = 64;
/// Longest of them (bytes): a longer one is prose.
const LONGEST_WORD: usize = 64;
/// Numbers in turn beyond which they count something, as the seconds of a minute do.
const MOST_NUMBERS: usize = 16;
/// Tags of a long table that are looked at: more take memory, and would say the same.
const MOST_TAGS: usize = 1024;
/// Words of all tags together that are remembered: a column with more names no loops.
const MOST_PLACES: usize = 1 << 14;
/// Rows from which anything is told.
const FEW_ROWS: u64 = 10;
/// Rows of one time from which they tell.
const FEW: u64 = 3;
/// Changes of the word from which it is told what a value does at them.
const FEW_CHANGES: u64 = 10;
/// Rows of a word that always stands alone from which it is one of a loop with few samples.
const FEW_ALONE: u64 = 5;

/// The columns that may tell loops apart, and what is counted of them.
#[derive(Default)]
pub struct Mixed {
    columns: Vec<Column>,
    /// Where OP and PV stand, or the value of a long table.
    values: [Option<usize>; 2],
    /// The tags of a long table by loop and name, numbered.
    tags: HashMap<[String; 2], usize>,
}

/// A column of few words or whole numbers.
struct Column {
    at: usize,
    /// As they are written.
    words: Vec<String>,
    /// The place of the last one: many rows in turn have the same.
    last: usize,
    /// What is counted of each tag; in a table with a column for each tag of its rows.
    tracks: Vec<Track>,
    /// Words of all tags.
    places: usize,
}

/// A word and its rows.
struct Count<'w> {
    word: &'w str,
    rows: u64,
    alone: u64,
}

/// What a value does where the word changes.
#[derive(Clone, Copy, PartialEq)]
enum Value {
    /// It is another, and comes back with its word.
    Leaps,
    /// It goes on from row to row.
    GoesOn,
    /// It may do either, as noise does.
    Either,
}

impl Value {
    /// By how many changes there are, and at how many of them the value is nearer to that of its own word; `None` of too few.
    fn of([all, nearer]: [u64; 2]) -> Option<Self> {
        if all < FEW_CHANGES {
            None
        } else if nearer * 2 >= all {
            Some(Self::Leaps)
        } else if nearer * 5 <= all {
            Some(Self::GoesOn)
        } else {
            Some(Self::Either)
        }
    }
}

impl Mixed {
    /// The columns that are neither times nor roles; `known` are those of quality.
    pub fn of(layout: &Layout, known: &[Quality]) -> Self {
        if layout.pairs.is_some() || layout.keeps_names() {
            return Self::default();
        }
        let mut used = vec![Some(layout.time), layout.clock, layout.millis];
        used.extend(known.iter().map(|(at, _)| Some(*at)));
        let values = match &layout.body {
            Body::Wide(wide) => {
                let roles = || wide.columns.iter().zip(&wide.roles);
                used.extend(roles().filter(|(_, role)| role.is_some()).map(|(at, _)| Some(*at)));
                [Role::Op, Role::Pv]
                    .map(|role| roles().find(|(_, own)| **own == Some(role)).map(|(at, _)| *at))
            }
            Body::Long(long) => {
                used.extend([Some(long.tag), Some(long.value), long.owner]);
                [Some(long.value), None]
            }
        };
        let may_be = |at: &usize| !used.contains(&Some(*at)) && may_name_loops(&layout.names[*at]);
        let columns = (0..layout.names.len()).filter(may_be).map(Column::new).collect();
        Self { columns, values, tags: HashMap::new() }
    }

    /// One more row.
    pub fn add(&mut self, rows: &dyn Rows, layout: &Layout) {
        if self.columns.is_empty() {
            return;
        }
        let Some(tag) = self.tag(rows, layout) else { return };
        let first = rows.cell(layout.time);
        let second = layout.clock.map(|at| rows.cell(at));
        let part = layout.millis.map(|at| rows.cell(at).shown());
        let hash = |text: String| BuildHasherDefault::<DefaultHasher>::default().hash_one(text);
        let cells = [Some(first.shown()), second.as_ref().map(|cell| cell.shown()), part];
        let stamp = cells.into_iter().flatten().fold(0, |all: u64, text| all.rotate_left(1) ^ hash(text));
        let part = |at: usize| time_columns::part(&rows.cell(at).shown(), &layout.names[at]);
        let part = layout.millis.map_or(Some(0.0), part);
        let time = time_of(&first, second.as_ref()).zip(part).map(|(time, part)| time + part);
        let values = self.values.map(|at| number_of(&rows.cell(at?)));
        let row = Row { stamp, time, values };
        self.columns.retain_mut(|column| {
            let cell = rows.cell(column.at);
            column.add(tag, &row, &cell)
        });
    }

    /// The number of a row's tag; `None` of one that is not looked at.
    fn tag(&mut self, rows: &dyn Rows, layout: &Layout) -> Option<usize> {
        let Body::Long(long) = &layout.body else { return Some(0) };
        let text = |at: Option<usize>| at.map(|at| rows.cell(at).shown()).unwrap_or_default();
        let key = [text(long.owner), text(Some(long.tag))];
        let next = self.tags.len();
        match self.tags.get(&key) {
            Some(at) => Some(*at),
            None if next < MOST_TAGS => {
                self.tags.insert(key, next);
                Some(next)
            }
            None => None,
        }
    }

    /// The column by which the rows of the wanted loop are taken; `None` where no column divides them.
    ///
    /// # Errors
    /// Rows of several loops, of which none is wanted, or the wanted one is not there.
    pub fn owner(&self, layout: &Layout, options: &Options) -> Result<Option<Owner>, TableError> {
        let found = self.several(layout);
        let wanted = options.of_loop.as_deref();
        if let Some(column) = wanted.and_then(|own| found.iter().find(|column| column.has(own))) {
            return Ok(Some(Owner::named(layout, column.at, options)));
        }
        found.first().map_or(Ok(None), |column| Err(column.refused(layout, wanted)))
    }

    /// Refuses rows of several loops where those of one are taken already by another column.
    ///
    /// # Errors
    /// There are any.
    pub fn refuse(&self, layout: &Layout) -> Result<(), TableError> {
        self.several(layout).first().map_or(Ok(()), |column| Err(column.refused(layout, None)))
    }

    /// The columns that tell loops apart, those of words first.
    fn several(&self, layout: &Layout) -> Vec<&Column> {
        // One that divides the samples of a single tag says something of that tag.
        let tags = if matches!(layout.body, Body::Long(_)) { 2 } else { 1 };
        let mut found: Vec<&Column> = self.columns.iter().filter(|column| column.several(tags)).collect();
        found.sort_by_key(|column| column.words.iter().all(|word| is_whole(word)));
        found
    }
}

impl Column {
    fn new(at: usize) -> Self {
        Self { at, words: Vec::new(), last: 0, tracks: Vec::new(), places: 0 }
    }

    /// One more cell of a tag; `false` where the column names no loops. A blank cell has the word above it, as merged cells do.
    fn add(&mut self, tag: usize, row: &Row, cell: &Cell<'_>) -> bool {
        let is_blank = cell.is_blank();
        let own = if is_blank { None } else { self.word(cell) };
        if own.is_none() && !is_blank {
            return false;
        }
        if self.tracks.len() <= tag {
            self.tracks.resize_with(tag + 1, Track::default);
        }
        let track = &mut self.tracks[tag];
        if let Some(word) = own.or(track.word()) {
            track.blanks += u64::from(is_blank);
            self.places += usize::from(track.add(word, row));
        }
        self.places <= MOST_PLACES
    }

    /// The place of a cell's word; `None` of one that names no loop.
    fn word(&mut self, cell: &Cell<'_>) -> Option<usize> {
        let own = match cell {
            Cell::Text(text) => Cow::Borrowed(text.trim()),
            Cell::Number(_) => Cow::Owned(cell.shown()),
            _ => return None,
        };
        if self.words.get(self.last).is_some_and(|word| **word == *own) {
            return Some(self.last);
        }
        let known = self.words.iter().position(|word| word.eq_ignore_ascii_case(&own));
        if known.is_none() && (self.words.len() == MOST_WORDS || !may_name(&own)) {
            return None;
        }
        self.last = known.unwrap_or(self.words.len());
        if known.is_none() {
            self.words.push(own.into_owned());
        }
        Some(self.last)
    }

    fn has(&self, wanted: &str) -> bool {
        self.words.iter().any(|word| word.eq_ignore_ascii_case(wanted))
    }

    /// The words of these tags, and how many rows have each.
    fn counted(&self, divided: &[&Track]) -> Vec<Count<'_>> {
        let mut counts: Vec<(&str, [u64; 2])> =
            self.words.iter().map(|word| (word.as_str(), [0, 0])).collect();
        for own in divided.iter().flat_map(|track| &track.own) {
            if let Some((_, [rows, alone])) = counts.get_mut(own.word) {
                *rows += own.rows;
                *alone += own.alone;
            }
        }
        let there = counts.into_iter().filter(|(_, [rows, _])| *rows > 0);
        there.map(|(word, [rows, alone])| Count { word, rows, alone }).collect()
    }

    /// Whether its words are those of several loops. So many tags at least have several.
    fn several(&self, tags: usize) -> bool {
        let divided: Vec<&Track> = self.tracks.iter().filter(|track| track.own.len() > 1).collect();
        let sum = |of: fn(&Track) -> u64| divided.iter().map(|track| of(track)).sum::<u64>();
        let rows = sum(|track| track.rows);
        let words = self.counted(&divided);
        let are_few = words.len() as u64 * 3 <= rows;
        if divided.len() < tags || rows < FEW_ROWS || !are_few || !may_be_loops(&words) {
            return false;
        }
        let are_numbers = words.iter().all(|own| is_whole(own.word));
        let are_flags = words.iter().all(|own| two_state(&own.word.to_lowercase()).is_some());
        let are_words = !are_numbers && !are_flags;
        let values: Vec<Value> =
            divided.iter().flat_map(|track| track.nearer).filter_map(Value::of).collect();
        let count = |kind: Value| values.iter().filter(|own| **own == kind).count();
        let leap = count(Value::Leaps);
        let all_leap = leap > 1 && leap * 3 >= values.len() * 2;
        let all_go_on = leap == 0 && count(Value::GoesOn) > 0;

        let (same, fresh, other) =
            (sum(|track| track.same[0]), sum(|track| track.same[1]), sum(|track| track.same[2]));
        let usual = same >= FEW && same * 20 >= rows && fresh * 10 >= same * 9 && other * 10 >= same;
        let at_one_time = usual && (are_words || !all_go_on);

        let changes = sum(|track| track.changes);
        let one_below_the_other = sum(|track| track.begins) * 2 > changes && !are_flags;

        let is_even = sum(|track| track.steps[1]) * 10 >= sum(|track| track.steps[0]) * 9;
        let in_turn = match are_words {
            true => is_even && (leap > 0 || !all_go_on) || all_leap,
            false => is_even && all_leap && words.len() <= MOST_NUMBERS,
        };
        let is_alone = |own: &Count<'_>| own.rows >= FEW_ALONE && own.alone * 10 >= own.rows * 9;
        let now_and_then = all_leap && is_even && !are_flags && words.iter().any(is_alone);
        let often = changes * 10 >= rows;
        let one_by_one = if often { in_turn } else { now_and_then };
        let most_have_one = sum(|track| track.blanks) * 2 < rows;
        one_below_the_other || most_have_one && (at_one_time || one_by_one)
    }

    fn refused(&self, layout: &Layout, wanted: Option<&str>) -> TableError {
        let name = &layout.names[self.at];
        let of = if name.is_none() { String::new() } else { format!(" {:?}", shown(&name.full)) };
        let none = wanted.map(|own| format!(", and none is {own:?} (--loop)")).unwrap_or_default();
        TableError::refused(format!(
            "column {}: the rows are of several{of}: {}{none}; keep those of one, or say which with --loop; where all are of one \
             loop, leave the column out",
            self.at + 1,
            listed(self.words.iter().map(String::as_str))
        ))
    }
}

/// Whether a column of this name may tell loops apart: flags, alarms and parts of a time do not.
fn may_name_loops(name: &Name) -> bool {
    let full = name.full.as_str();
    let says_another = is_alarm(full) || is_bad_flag(full) || is_good_flag(full);
    // A serial number is one of a device as well as a date's.
    let is_part_of_time = name.plain() != "serial" && Unit::of(name.plain()).is_some();
    !says_another && !is_part_of_time
}

/// Whether a word may be the name of a loop or its number: what has a fraction, a sign or a unit is measured, but for `101A`.
fn may_name(word: &str) -> bool {
    let is_letter = |unit: &str| unit.len() == 1 && unit.bytes().all(|byte| byte.is_ascii_alphabetic());
    let is_measured = number::scan(word).is_some_and(|own| !is_whole(word) && !is_letter(own.unit));
    word.len() <= LONGEST_WORD && !is_measured
}

/// Whether a word is a whole number.
fn is_whole(word: &str) -> bool {
    !word.is_empty() && word.bytes().all(|byte| byte.is_ascii_digit())
}

/// Whether words may be those of loops: they speak of no quality, no mode and no zone.
fn may_be_loops(counts: &[Count<'_>]) -> bool {
    let words = Words::of(counts.iter().map(|own| (own.word.to_lowercase(), own.rows)).collect());
    let of_quality =
        words.speak_of_quality() || words.may_speak_of_quality() || words.are_letters_of_quality();
    let of_zones = counts.iter().all(|own| HeaderZone::of(own.word).is_some());
    !(of_quality || of_zones || words.speak_of_mode())
}

/// A time in whatever it is counted, with its day and month in any order.
fn time_of(first: &Cell<'_>, second: Option<&Cell<'_>>) -> Option<f64> {
    Some(match What::of(first, second) {
        What::Number(value) => value,
        What::Digits(number) => either(&number)?,
        What::Dated(stamp) => Order::ALL.into_iter().find_map(|order| stamp.civil(order))? as f64 * 1e-9,
        What::Clock(ns) | What::Moment { ns, .. } => ns as f64 * 1e-9,
        What::Nothing => return None,
    })
}

/// A number under the sign that it may have: those of one column are compared with each other alone.
fn either(number: &number::Number<'_>) -> Option<f64> {
    number.value(Decimal::Point).or_else(|| number.value(Decimal::Comma))
}

fn number_of(cell: &Cell<'_>) -> Option<f64> {
    match cell {
        Cell::Number(value) => Some(*value).filter(|value| value.is_finite()),
        Cell::Text(text) => measured(text).and_then(|number| either(&number)),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
