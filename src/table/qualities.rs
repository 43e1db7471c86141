//! Columns that say whether a value is good: which value each belongs to, and columns that say it under a name that nobody knows.

use super::channel::{Channel, Tag};
use super::error::{TableError, shown};
use super::layout::{Body, Layout, Wide};
use super::names::Name;
use super::odd_rows::begins_with_a_word;
use super::roles::Roles;
use super::says::{Says, is_alarm, is_bad_flag, is_good_flag, is_of_value};
use super::source::{Cell, Rows};
use super::vocabulary::{QUALITIES, SHORT_QUALITIES};
use super::words::{Words, means_blank};
use crate::signal::Role;

/// A column of quality, and the place of the value it speaks of among the values; `None` where it speaks of the row.
pub type Quality = (usize, Option<usize>);

/// Whether a column says by its name if a value is good; where the words of a name do not tell, the names beside it do.
pub fn speaks(names: &[Name], at: usize) -> bool {
    names[at].quality_of().is_some() || is_copy(names, at) || is_of_another(names, at)
}

/// Whether it has the name of a quality and of no value, or is the second of that name as pandas calls it: `Quality.1`.
fn is_bare(names: &[Name], at: usize) -> bool {
    names[at].quality_of().is_some_and(|of| of.is_empty()) || is_copy(names, at)
}

fn is_copy(names: &[Name], at: usize) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let first = names[at].full.rsplit_once('.').filter(|(_, number)| is_number(number));
    let is_bare = |name: &Name| name.quality_of().is_some_and(|of| of.is_empty());
    first.is_some_and(|(first, _)| names.iter().any(|name| name.full == first && is_bare(name)))
}

/// Whether the name of another column stands behind a word of quality: `Status Flow` beside `Flow`.
fn is_of_another(names: &[Name], at: usize) -> bool {
    let long = QUALITIES.iter().filter(|word| !SHORT_QUALITIES.contains(word));
    let mut values = long.filter_map(|word| names[at].plain().strip_prefix(*word)?.strip_prefix(' '));
    values.any(|of| names.iter().any(|own| own.plain() == of && own.quality_of().is_none()))
}

/// The values that columns of quality named `says` belong to; the outer `None` is none of these values, or one that nobody can know.
///
/// A name tells it: `pv_status`. One column without such a name speaks of the row. Several stand each behind its value, or each
/// before it where the first of all stands before every value; so many together as there are values have their order.
pub fn owners(
    names: &[Name],
    says: &[usize],
    values: &[usize],
    roles: &Roles,
) -> Vec<(usize, Option<Option<usize>>)> {
    let role = |at: usize| roles.get(at).copied().flatten();
    let among = Among::new(names, values.to_vec(), &role);
    let names_none = |at: &usize| is_bare(names, *at) && among.by_name(*at).is_none();
    let alone: Vec<usize> = says.iter().copied().filter(names_none).collect();
    let owner = |at: usize| match among.by_name(at) {
        Some(value) => Some(Some(value)),
        None if alone.contains(&at) => among.by_place(at, &alone),
        None => None,
    };
    says.iter().map(|at| (*at, owner(*at))).collect()
}

/// Values among which columns of quality stand.
struct Among<'a> {
    names: &'a [Name],
    values: Vec<usize>,
    role: &'a dyn Fn(usize) -> Option<Role>,
}

impl<'a> Among<'a> {
    fn new(names: &'a [Name], values: Vec<usize>, role: &'a dyn Fn(usize) -> Option<Role>) -> Self {
        Self { names, values, role }
    }

    /// The value that the name of a column has; of several the one of the loop that is read.
    fn by_name(&self, at: usize) -> Option<usize> {
        let value = |of: &String| {
            let own = self.values.iter().copied().filter(|value| self.names[*value].owns_quality(of));
            own.min_by_key(|value| (self.names[*value].plain() != of, (self.role)(*value).is_none()))
        };
        self.names[at].values_of().iter().find_map(value)
    }

    /// The value that one of several columns without the name of one speaks of; the outer `None` is more than one that it may be.
    fn by_place(&self, at: usize, alone: &[usize]) -> Option<Option<usize>> {
        if let [_] = alone {
            let nearest = self.nearest(at).filter(|_| self.names[at].is_none());
            return Some(nearest);
        }
        // Columns that stand apart belong to the values between them, whatever they are called.
        let apart = alone.windows(2).all(|pair| self.between(pair[0], pair[1]));
        if apart && alone.iter().all(|own| self.beside(*own, alone).is_some()) {
            return self.beside(at, alone).map(Some);
        }
        let stem = self.names[at].stem();
        let alike: Vec<usize> = alone.iter().copied().filter(|own| self.names[*own].stem() == stem).collect();
        if alike.len() == 1 { Some(None) } else { self.beside(at, &alike).map(Some) }
    }

    /// The values that are measured: a mode and the name of a device have no quality.
    fn measured(&self) -> impl Iterator<Item = usize> {
        self.values.iter().copied().filter(move |value| match (self.role)(*value) {
            Some(role) => role != Role::Mode,
            None => !self.names[*value].is_owner(),
        })
    }

    /// Whether a value stands between two columns, the first of which is further left.
    fn between(&self, left: usize, right: usize) -> bool {
        self.measured().any(|value| left < value && value < right)
    }

    /// The value left of a column, or right where none is left.
    fn nearest(&self, at: usize) -> Option<usize> {
        let left = self.measured().filter(|value| *value < at).max();
        left.or_else(|| self.measured().filter(|value| *value > at).min())
    }

    /// The value that a column speaks of, one of several that are alike; `None` where it may be more than one.
    fn beside(&self, at: usize, all: &[usize]) -> Option<usize> {
        let first = all.iter().copied().min() < self.measured().min();
        let before = first && all.iter().copied().max() < self.measured().max();
        let apart = |own: usize| self.between(own.min(at), own.max(at));
        let together: Vec<usize> = all.iter().copied().filter(|own| !apart(*own)).collect();
        let (left, right) = (*together.first()?, *together.last()?);
        let mut values: Vec<usize> = if before {
            let next = all.iter().copied().find(|own| *own > right).unwrap_or(usize::MAX);
            self.measured().filter(|value| right < *value && *value < next).collect()
        } else {
            let last = all.iter().copied().rfind(|own| *own < left);
            self.measured().filter(|value| *value < left && last.is_none_or(|last| last < *value)).collect()
        };
        if together.len() == values.len() {
            return together.iter().position(|own| *own == at).map(|place| values[place]);
        }
        if before {
            values.reverse();
        }
        // One behind several is that of the last, unless OP or PV would be left without.
        let own = values.pop().filter(|_| together.len() == 1)?;
        let is_needed = |value: &usize| matches!((self.role)(*value), Some(Role::Op | Role::Pv));
        (!values.iter().any(is_needed)).then_some(own)
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
/// `FAIL`, or it has the short name of a quality and words or numbers that are no names of anything. Of another device it says nothing
/// here.
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
    let states = short && other.words.counts.len() > 1 && other.words.are_states();
    // `Pump status` says whose it is.
    let of_something = name.quality_of().is_some_and(|of| !of.is_empty());
    !of_another
        && !of_something
        && (other.words.may_speak_of_quality() && other.words.rows() * 2 > rows
            || marks && other.words.tell_rows_apart(rows)
            || states)
}

/// Whether a column holds a state that may be that of a value of the loop, and nobody knows which of its numbers are good: `PV_STS`.
fn may_qualify(other: &Other, layout: &Layout) -> bool {
    let (Body::Wide(wide), Some(of)) = (&layout.body, layout.names[other.at].may_qualify()) else {
        return false;
    };
    let mut values = wide.columns.iter().zip(&wide.roles).filter(|(_, role)| role.is_some());
    values.any(|(at, _)| layout.names[*at].owns_quality(&of)) && other.words.are_states()
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
    /// Those that are known by their names to speak of quality.
    known: Vec<Quality>,
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
        Self { columns, rows: 0, known: known.to_vec() }
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

    /// The places of those without a name that hold digits alone in most of so many rows.
    pub fn nameless_digits(&self, rows: u64) -> impl Iterator<Item = usize> {
        let nameless = self.columns.iter().filter_map(|other| Some((other.at, other.times.as_ref()?)));
        let are_digits =
            move |own: &Channel| own.numbers * 2 > rows && own.numbers == own.cells && !own.evidence.any();
        nameless.filter(move |(_, own)| are_digits(own)).map(|(at, _)| at)
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
        let owned = |of: &str| match &layout.body {
            Body::Wide(wide) => wide.columns.iter().any(|at| layout.names[*at].owns_quality(of)),
            Body::Long(_) => layout.names.iter().any(|value| value.owns_quality(of)),
        };
        let of_a_value = |name: &Name| {
            let of = name.plain().rsplit_once(' ').map_or("", |(of, _)| of);
            let alone = !is_of_value(&name.full, true) && !is_of_value(&name.full, false);
            alone && ["", "is"].contains(&of) || name.values_of().iter().any(|of| owned(of))
        };
        let flag = |other: &Other| {
            let name = &layout.names[other.at];
            let bad = is_bad_flag(&name.full) && (!is_of_value(&name.full, false) || of_a_value(name));
            let says = bad || is_good_flag(&name.full) && of_a_value(name);
            says && other.words.are_flags()
        };
        let control_loop = control_loop(layout);
        let alarm = |other: &Other| {
            let name = &layout.names[other.at];
            let of = name.plain().rsplit_once(' ').map_or("", |(of, _)| of);
            // The alarms of another loop say nothing of this one.
            let own = of.is_empty() || control_loop.as_deref() == Some(of) || owned(of);
            is_alarm(&name.full) && own && other.words.tell_open()
        };
        // Ovation writes a letter behind each value, and no name above it; others write `Q`.
        let short = |name: &Name| name.is_none() || SHORT_QUALITIES.contains(&name.stem());
        let letters = |other: &Other| short(&layout.names[other.at]) && other.words.are_letters_of_quality();
        // What is called a quality, and nobody could tell of which value, is not left out without a word.
        let bare = |other: &Other| {
            let is_any = other.words.rows() > 0 && !other.words.speak_of_mode();
            is_any && matches!(layout.body, Body::Wide(_)) && is_bare(&layout.names, other.at)
        };
        // `FIC102.Quality` says nothing of FIC101.
        let of_another = |other: &Other| {
            let of = layout.names[other.at].quality_of().filter(|of| !of.is_empty());
            let owners = || layout.names.iter().filter_map(|name| Some(name.said()?.owner));
            of.is_some_and(|of| control_loop.as_ref() != Some(&of) && owners().any(|own| own == of))
        };
        let speaks = |other: &Other| {
            let any = other.words.speak_of_quality() || letters(other) || flag(other) || alarm(other);
            any && !of_another(other) || bare(other)
        };
        let (mut found, others): (Vec<Other>, Vec<Other>) = self.columns.into_iter().partition(speaks);
        let loop_name = control_loop.as_deref().unwrap_or_default();
        let may_speak = |other: &Other| {
            may_qualify(other, layout) || may_speak(other, &layout.names[other.at], self.rows, loop_name)
        };
        let (mut asked, others): (Vec<Other>, Vec<Other>) = others.into_iter().partition(may_speak);
        let sure = !found.is_empty() || !self.known.is_empty();
        if let Some(told) = told {
            let meant = |other: &Other| other.words.any_of(told) || means_blank(told);
            found.extend(std::mem::take(&mut asked).into_iter().filter(meant));
            // Words that somebody tells may stand in columns of measurements, too: one column alone may be meant.
            if found.is_empty() && !sure {
                found = others.into_iter().filter(|other| other.words.any_of(told)).collect();
                found.truncate(if found.len() == 1 { 1 } else { 0 });
            }
        }
        // One that another says of the same value already what it may say as well is not asked about: what either calls bad is bad.
        // Where the good words are told, those of this one are not among them.
        let is_second = |other: &&Other| told.is_none() && other.words.may_speak_of_quality();
        let Body::Wide(wide) = &layout.body else {
            if let Some(other) = asked.first().filter(|_| !sure) {
                return Err(doubt(other, layout));
            }
            let second =
                asked.iter().filter(is_second).map(|other| ((other.at, None), bad_words(&other.words)));
            let second: Vec<(Quality, Words)> = second.collect();
            return Ok(found
                .into_iter()
                .map(|other| ((other.at, None), other.words))
                .chain(second)
                .collect());
        };
        let owned = placed(&found, &asked, wide, layout, self.rows)?;
        // Where another column says how good the same value is, nobody is asked.
        let known: Vec<Option<usize>> = self
            .known
            .iter()
            .map(|(_, of)| of.map(|place| wide.columns[place]))
            .chain(owned.iter().copied())
            .collect();
        let role = role_in(wide);
        let says: Vec<usize> = found.iter().chain(&asked).map(|other| other.at).collect();
        let among = Among::new(&layout.names, values(wide, &says), &role);
        let is_known = |other: &Other| {
            let value = among.by_name(other.at).or_else(|| among.nearest(other.at));
            known.iter().any(|own| own.is_none() || *own == value)
        };
        if let Some(other) = asked.iter().find(|other| !is_known(other)) {
            return Err(doubt(other, layout));
        }
        let second: Vec<&Other> = asked.iter().filter(is_second).collect();
        let names_none = |other: &&&Other| among.by_name(other.at).is_none();
        let alone: Vec<usize> = second.iter().filter(names_none).map(|other| other.at).collect();
        // One alone speaks of what the other speaks of; several stand each with its value.
        let of_row = known.contains(&None) || alone.len() > 1;
        let owner = |at: usize| match among.by_name(at) {
            Some(value) => Some(value),
            None if of_row => among.by_place(at, &alone).flatten(),
            None => among.nearest(at),
        };
        let place = |value: usize| wide.columns.iter().position(|at| *at == value);
        let second: Vec<(Quality, Words)> = second
            .iter()
            .map(|other| ((other.at, owner(other.at).and_then(place)), bad_words(&other.words)))
            .collect();
        let each = found.into_iter().zip(owned);
        let first = each.map(|(other, value)| ((other.at, value.and_then(place)), other.words));
        Ok(first.chain(second).collect())
    }
}

/// The words of a column that do not say good: of one that stands beside another, a blank cell says nothing.
fn bad_words(words: &Words) -> Words {
    let says = Says::Words(true);
    let mut bad = words.clone();
    bad.counts.retain(|(word, _)| !says.quality(&Cell::Text(word)).is_good());
    bad
}

/// The loop of OP or PV by its name, where each has a column.
fn control_loop(layout: &Layout) -> Option<String> {
    let Body::Wide(wide) = &layout.body else { return None };
    let owner = |role: Role| {
        let at = wide.roles.iter().position(|own| *own == Some(role))?;
        Some(layout.names[wide.columns[at]].said()?.owner)
    };
    owner(Role::Op).or_else(|| owner(Role::Pv))
}

/// The role of a column.
fn role_in(wide: &Wide) -> impl Fn(usize) -> Option<Role> {
    move |at| {
        wide.columns.iter().zip(&wide.roles).find(|(column, _)| **column == at).and_then(|(_, role)| *role)
    }
}

/// The values of a table: of a column that speaks of quality nothing is measured.
fn values(wide: &Wide, says: &[usize]) -> Vec<usize> {
    wide.columns.iter().copied().filter(|at| !says.contains(at)).collect()
}

/// The value that each of `found` speaks of, `None` for the row. Those that are only `asked` about may stand among them.
///
/// # Errors
/// One of which nobody can know it.
fn placed(
    found: &[Other],
    asked: &[Other],
    wide: &Wide,
    layout: &Layout,
    rows: u64,
) -> Result<Vec<Option<usize>>, TableError> {
    let mut says: Vec<usize> = found.iter().chain(asked).map(|other| other.at).collect();
    says.sort_unstable();
    let role = role_in(wide);
    let among = Among::new(&layout.names, values(wide, &says), &role);
    let own_loop = control_loop(layout);
    let of_row = |at: usize| {
        let of = layout.names[at].quality_of().filter(|of| !of.is_empty());
        is_alarm(&layout.names[at].full) || of.is_some() && of == own_loop
    };
    let alone: Vec<usize> =
        says.iter().copied().filter(|at| among.by_name(*at).is_none() && !of_row(*at)).collect();
    let owner = |other: &Other| match among.by_name(other.at) {
        Some(value) => Ok(Some(value)),
        None if of_row(other.at) => Ok(None),
        None => match among.by_place(other.at, &alone) {
            Some(owner) => Ok(owner),
            // Where every value is good it does not matter whose they are.
            None if other.words.rows() >= rows && other.words.are_all_good(&layout.names[other.at].full) => {
                Ok(None)
            }
            None => Err(TableError::refused(format!(
                "column {} ({:?}) tells good from bad, of which value nobody knows; call it such as \"pv_status\"",
                other.at + 1,
                layout.names[other.at].full
            ))),
        },
    };
    found.iter().map(owner).collect()
}
