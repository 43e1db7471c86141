//! Columns of two values that may be the controller's mode under any name: OP moves by itself while the one stands there, and rests
//! while the other does.

use super::by_words::is_of_loop;
use super::channel::{Channel, Steps};
use super::error::{TableError, shown};
use super::layout::Wide;
use super::names::Name;
use super::says::{is_alarm, is_bad_flag, is_good_flag};
use super::source::{Cell, Rows};
use super::words::{Words, word};
use crate::signal::Role;

/// What is counted of them.
#[derive(Default)]
pub struct Rests {
    /// The column of OP, and what stood there in the row before.
    op: Option<usize>,
    before: String,
    columns: Vec<Two>,
}

/// A column that has had two values at the most.
struct Two {
    column: usize,
    words: Words,
    /// Steps of OP in rows with the one value, and in those with the other.
    steps: [Steps; 2],
}

impl Two {
    /// One more row; `false` for a third value.
    fn add(&mut self, cell: &Cell<'_>, moved: bool) -> bool {
        if cell.is_blank() {
            return true;
        }
        self.words.add(cell);
        let own = word(cell);
        let place = self.words.counts.iter().position(|(word, _)| *word == own);
        match place.filter(|place| *place < self.steps.len()) {
            Some(place) => {
                self.steps[place].add(moved);
                true
            }
            None => false,
        }
    }

    /// The value in which OP moves by itself, and the one in which it rests.
    fn found(&self) -> Option<(&str, &str)> {
        let [(first, _), (second, _)] = self.words.counts.as_slice() else { return None };
        let is = |moving: Steps, resting: Steps| moving.are_many() && moving.moves() && resting.rests();
        match self.steps {
            [a, b] if is(a, b) => Some((first.as_str(), second.as_str())),
            [a, b] if is(b, a) => Some((second.as_str(), first.as_str())),
            _ => None,
        }
    }
}

impl Rests {
    /// The columns that are nothing else.
    pub fn of(wide: &Wide) -> Self {
        let all = || wide.columns.iter().copied().zip(&wide.roles);
        let two = |column: usize| Two { column, words: Words::default(), steps: [Steps::default(); 2] };
        Self {
            op: all().find(|(_, role)| **role == Some(Role::Op)).map(|(at, _)| at),
            before: String::new(),
            columns: all().filter(|(_, role)| role.is_none()).map(|(at, _)| two(at)).collect(),
        }
    }

    /// Counts a row.
    pub fn add(&mut self, rows: &dyn Rows) {
        let Some(op) = self.op.filter(|_| !self.columns.is_empty()) else { return };
        let cell = rows.cell(op);
        if cell.is_blank() {
            return;
        }
        let before = std::mem::replace(&mut self.before, cell.shown());
        let moved = before != self.before;
        if !before.is_empty() {
            self.columns.retain_mut(|own| own.add(&rows.cell(own.column), moved));
        }
    }

    /// Asks whether such a column is the mode, unless there is one already: a record in manual would be taken for one in automatic.
    pub fn ask(&self, channels: &[Channel], names: &[Name]) -> Result<(), TableError> {
        let of_role = |role: Role| channels.iter().find(|own| own.role == Some(role));
        if of_role(Role::Mode).is_some() {
            return Ok(());
        }
        let loop_name = of_role(Role::Op).and_then(|op| Name::new(&op.tag.name).said());
        let loop_name = loop_name.map(|said| said.owner).unwrap_or_default();
        for own in &self.columns {
            let name = &names[own.column];
            // OP may be held where values are bad, too.
            let of_quality = is_bad_flag(&name.full) || is_good_flag(&name.full) || is_alarm(&name.full);
            if of_quality || own.words.speak_of_quality() || own.words.may_speak_of_quality() {
                continue;
            }
            if let Some((moving, resting)) = own.found().filter(|_| is_of_loop(name, &loop_name)) {
                let full = shown(&name.full);
                return Err(TableError::refused(format!(
                    "column {} ({full}): OP moves by itself only while it is {:?}, and rests while it is {:?}, as with the controller's \
                     mode; say so with --mode {full:?}, or that it is none with --mode none",
                    own.column + 1,
                    shown(moving),
                    shown(resting)
                )));
            }
        }
        Ok(())
    }
}
