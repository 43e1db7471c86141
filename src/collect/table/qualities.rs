//! Columns that say whether a value is good: which value each belongs to, and columns that say it under a name that nobody knows.

use super::channel::{Channel, Tag};
use super::error::{TableError, shown};
use super::layout::{Body, Layout};
use super::names::Name;
use super::odd_rows::begins_with_a_word;
use super::says::{is_alarm, is_bad_flag, is_good_flag, is_of_value};
use super::source::{Cell, Rows};
use super::vocabulary::SHORT_QUALITIES;
use super::words::{Words, means_blank};
use crate::signal::Role;

/// A column of quality, and the place of the value it speaks of among the values; `None` where it speaks of the row.
pub type Quality = (usize, Option<usize>);

/// The values that columns of quality named `says` belong to; the outer `None` is none of these values.
///
/// A name tells it: `pv_status`. One column without such a name speaks of the row. Several stand each behind its value, or each
/// before it where the first of all stands before every value.
pub fn owners(names: &[Name], says: &[usize], values: &[usize]) -> Vec<(usize, Option<Option<usize>>)> {
    let of = |at: usize| names[at].quality_of().filter(|of| !of.is_empty());
    let alone: Vec<usize> = says.iter().copied().filter(|at| of(*at).is_none()).collect();
    let owner = |at: usize| match of(at) {
        Some(of) => values.iter().copied().find(|c| names[*c].owns_quality(&of)).map(Some),
        None if alone.len() == 1 => Some(None),
        None => beside(at, &alone, values).map(Some),
    };
    says.iter().map(|at| (*at, owner(*at))).collect()
}

/// The value beside a column of quality, one of several.
fn beside(at: usize, all: &[usize], values: &[usize]) -> Option<usize> {
    let first = all.iter().min() < values.iter().min();
    let before = first && all.iter().max() < values.iter().max();
    if before {
        values.iter().copied().find(|value| *value > at)
    } else {
        values.iter().copied().rfind(|value| *value < at)
    }
}

/// A column that is neither a time nor a role, counted over the whole file.
struct Other {
    at: usize,
    words: Words,
    /// What stamps are in it, where it has no name.
    times: Option<Channel>,
}

/// Whether a column may say if values are good, and nobody can know it: most rows have a word such as `OK` and some one such as
/// `FAIL`, or it has the short name of a quality and words that are no names of anything. Of another device it says nothing here.
fn may_speak(other: &Other, name: &Name, rows: u64, loop_name: &str) -> bool {
    let numbers = |text: &str| -> Vec<String> {
        text.split(|c: char| !c.is_ascii_digit())
            .filter(|part| !part.is_empty())
            .map(str::to_string)
            .collect()
    };
    let own = numbers(loop_name);
    let of_another = numbers(name.plain()).iter().any(|number| !own.contains(number));
    // `Q [m3/h]` is a flow.
    let short = SHORT_QUALITIES.contains(&name.plain()) && name.unit.is_none();
    let marks = short || name.is_none() && other.words.are_marks();
    // `Pump status` says whose it is.
    let of_something = name.quality_of().is_some_and(|of| !of.is_empty());
    !of_another
        && !of_something
        && (other.words.may_speak_of_quality() && other.words.rows() * 2 > rows
            || marks && other.words.tell_rows_apart(rows))
}

/// What is asked of such a column.
fn doubt(other: &Other, layout: &Layout) -> TableError {
    let name = &layout.names[other.at];
    let name = if name.is_none() { String::new() } else { format!(" ({:?})", shown(&name.full)) };
    TableError::refused(format!(
        "column {}{name} may say which values are good: it holds {}; list the good ones with --good-values, with blank for an empty \
         cell, or all of them where it says nothing of the kind",
        other.at + 1,
        other.words.listed()
    ))
}

/// The columns that are neither times nor roles nor known to speak of quality.
#[derive(Default)]
pub struct Others {
    columns: Vec<Other>,
    /// Rows counted.
    rows: u64,
    /// Whether another column is known by its name to speak of quality.
    any_known: bool,
}

impl Others {
    pub fn of(layout: &Layout, known: &[Quality]) -> Self {
        let mut used: Vec<usize> = known.iter().map(|known| known.0).collect();
        used.extend([Some(layout.time), layout.clock, layout.millis].into_iter().flatten());
        match &layout.body {
            Body::Wide(wide) => {
                let roles = wide.columns.iter().zip(&wide.roles).filter(|(_, role)| role.is_some());
                used.extend(roles.map(|(at, _)| *at));
            }
            Body::Long(long) => {
                used.extend([long.tag, long.value]);
                used.extend([long.owner, long.source, long.unit].into_iter().flatten());
            }
        }
        let other = |at: usize| Other {
            at,
            words: Words::default(),
            times: layout.names[at].is_none().then(|| Channel::new(Tag::default(), None, at + 1)),
        };
        let columns = (0..layout.names.len()).filter(|at| !used.contains(at)).map(other).collect();
        Self { columns, rows: 0, any_known: !known.is_empty() }
    }

    /// Counts a row whose time is `first`.
    pub fn add(&mut self, rows: &dyn Rows, first: &Cell<'_>, line: u64) {
        // Averages below the samples are no rows of it.
        self.rows += u64::from(!begins_with_a_word(first));
        for other in &mut self.columns {
            let cell = rows.cell(other.at);
            if cell.is_blank() {
                continue;
            }
            other.words.add(&cell);
            if let Some(times) = &mut other.times
                && times.add(&cell, line, None)
            {
                times.compare(&cell, first);
            }
        }
    }

    /// Those without a name that hold other times than their rows.
    pub fn times(&self) -> impl Iterator<Item = &Channel> {
        self.columns
            .iter()
            .filter_map(|other| other.times.as_ref())
            .filter(|times| times.other_times * 2 > times.cells)
    }

    /// Those that speak of quality by what stands in them, or by words that `--good-values` tells.
    ///
    /// # Errors
    /// A column of which nobody knows which value it speaks of, or one that may speak of quality and nobody told.
    pub fn qualities(
        self,
        layout: &Layout,
        told: Option<&[String]>,
    ) -> Result<Vec<(Quality, Words)>, TableError> {
        // `Good` speaks of the row and `PV_GOOD` of a value; `Batch valid` of neither.
        let owned = |of: &str| !of.is_empty() && layout.names.iter().any(|value| value.owns_quality(of));
        let of_a_value = |name: &Name| {
            let of = name.plain().rsplit_once(' ').map_or("", |(of, _)| of);
            let alone = !is_of_value(&name.full, true) && !is_of_value(&name.full, false);
            alone && ["", "is"].contains(&of) || owned(of)
        };
        let flag = |other: &Other| {
            let name = &layout.names[other.at];
            let bad = is_bad_flag(&name.full) && (!is_of_value(&name.full, false) || of_a_value(name));
            let says = bad || is_good_flag(&name.full) && of_a_value(name);
            says && other.words.are_flags()
        };
        let control_loop: Option<String> = match &layout.body {
            Body::Wide(wide) => {
                let owner = |role: Role| {
                    let at = wide.roles.iter().position(|own| *own == Some(role))?;
                    Some(layout.names[wide.columns[at]].said()?.owner)
                };
                owner(Role::Op).or_else(|| owner(Role::Pv))
            }
            Body::Long(_) => None,
        };
        let alarm = |other: &Other| {
            let name = &layout.names[other.at];
            let of = name.plain().rsplit_once(' ').map_or("", |(of, _)| of);
            // The alarms of another loop say nothing of this one.
            let own = of.is_empty() || control_loop.as_deref() == Some(of) || owned(of);
            is_alarm(&name.full) && own && other.words.tell_open()
        };
        // Ovation writes a letter behind each value, and no name above it; others write `Q`.
        let short = |name: &Name| name.is_none() || SHORT_QUALITIES.contains(&name.plain());
        let letters = |other: &Other| short(&layout.names[other.at]) && other.words.are_letters_of_quality();
        let speaks =
            |other: &Other| other.words.speak_of_quality() || letters(other) || flag(other) || alarm(other);
        let (mut found, others): (Vec<Other>, Vec<Other>) = self.columns.into_iter().partition(speaks);
        let loop_name = control_loop.as_deref().unwrap_or_default();
        let may_speak = |other: &Other| may_speak(other, &layout.names[other.at], self.rows, loop_name);
        let (asked, others): (Vec<Other>, Vec<Other>) = others.into_iter().partition(may_speak);
        // Where another column says how good values are, nobody is asked.
        let sure = !found.is_empty() || self.any_known;
        match told {
            Some(told) => {
                let meant = |other: &Other| other.words.any_of(told) || means_blank(told);
                found.extend(asked.into_iter().filter(meant));
                // Words that somebody tells may stand in columns of measurements, too: one column alone may be meant.
                if found.is_empty() && !sure {
                    found = others.into_iter().filter(|other| other.words.any_of(told)).collect();
                    found.truncate(if found.len() == 1 { 1 } else { 0 });
                }
            }
            None => {
                if let Some(other) = asked.first().filter(|_| !sure) {
                    return Err(doubt(other, layout));
                }
            }
        }
        let Body::Wide(wide) = &layout.body else {
            return Ok(found.into_iter().map(|other| ((other.at, None), other.words)).collect());
        };
        let says: Vec<usize> = found.iter().map(|other| other.at).collect();
        // Of a column that speaks of quality nothing is measured.
        let values: Vec<usize> = wide.columns.iter().copied().filter(|at| !says.contains(at)).collect();
        let by_name = |at: usize| {
            let of = layout.names[at].plain().rsplit_once(' ')?.0;
            values.iter().copied().find(|value| layout.names[*value].owns_quality(of))
        };
        let of_row = |at: usize| is_alarm(&layout.names[at].full);
        let alone: Vec<usize> =
            says.iter().copied().filter(|at| by_name(*at).is_none() && !of_row(*at)).collect();
        let unknown = |at: usize| {
            TableError::refused(format!(
                "column {} ({:?}) tells good from bad, of which value nobody knows; call it such as \"pv_status\"",
                at + 1,
                layout.names[at].full
            ))
        };
        let owner = |at: usize| match by_name(at) {
            Some(value) => Ok(Some(value)),
            None if of_row(at) => Ok(None),
            None if alone.len() == 1 && !layout.names[at].is_none() => Ok(None),
            None => beside(at, &alone, &values).map(Some).ok_or_else(|| unknown(at)),
        };
        let place = |value: usize| wide.columns.iter().position(|at| *at == value);
        let each = found.into_iter().map(|other| {
            let value = owner(other.at)?;
            Ok(((other.at, value.and_then(place)), other.words))
        });
        each.collect()
    }
}
