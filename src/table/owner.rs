//! Rows of several loops below each other, where OP and PV have columns of their own and another column names the loop.

use super::error::{TableError, listed};
use super::layout::{Body, Layout};
use super::number;
use super::options::Options;
use super::source::Rows;
use std::collections::BTreeSet;

/// Loops that are remembered for a message.
const MOST: usize = 64;

/// The column that names the loop of a row, and which loop is wanted.
pub struct Owner {
    at: usize,
    time: usize,
    name: String,
    wanted: Option<String>,
    found: BTreeSet<String>,
    matched: bool,
    /// The word of the row before; a blank cell below it is merged with it.
    last: String,
    /// How often the word is another than in the row before.
    changes: usize,
    /// The first time of the table, and whether another word begins with it too.
    first: Option<String>,
    again: bool,
    /// The time of the row before, and whether another word has the same.
    before: String,
    shared: bool,
    /// Rows, those without a word, and those with a number.
    rows: [u64; 3],
}

impl Owner {
    /// `None` where no column names loops by its own name.
    pub fn of(layout: &Layout, options: &Options) -> Option<Self> {
        let Body::Wide(wide) = &layout.body else { return None };
        wide.owner.map(|at| Self::named(layout, at, options))
    }

    /// That of a column which names loops.
    pub fn named(layout: &Layout, at: usize, options: &Options) -> Self {
        Self {
            at,
            time: layout.time,
            name: layout.names[at].full.clone(),
            wanted: options.of_loop.clone(),
            found: BTreeSet::new(),
            matched: false,
            last: String::new(),
            changes: 0,
            first: None,
            again: false,
            before: String::new(),
            shared: false,
            rows: [0; 3],
        }
    }

    /// Before the first row is read again.
    pub fn begin(&mut self) {
        self.last.clear();
    }

    /// Whether a row is the wanted loop's.
    pub fn takes(&mut self, rows: &dyn Rows) -> bool {
        let (cell, time) = (rows.cell(self.at), rows.cell(self.time).shown());
        self.rows[0] += 1;
        self.rows[1] += u64::from(cell.is_blank());
        if !cell.is_blank() {
            let own = cell.shown().trim().to_string();
            self.rows[2] += u64::from(number::scan(&own).is_some());
            if own != self.last {
                self.changes += 1;
                self.again |= self.first.as_ref() == Some(&time);
                self.shared |= self.before == time;
                if self.found.len() < MOST {
                    self.found.insert(own.to_lowercase());
                }
                self.last = own;
            }
        }
        self.first.get_or_insert_with(|| time.clone());
        self.before = time;
        let is_wanted = self.wanted.as_ref().is_none_or(|wanted| wanted.eq_ignore_ascii_case(&self.last));
        self.matched |= is_wanted;
        is_wanted
    }

    /// Whether the words differ in their numbers alone: `pump1` and `pump2` are two devices, `open` and `closed` a state.
    /// A source of the same data may be replaced by another, `opc1` by `opc2`.
    fn numbered(&self) -> bool {
        if self.name.eq_ignore_ascii_case("source") {
            return false;
        }
        let letters = |word: &str| word.chars().filter(|c| !c.is_ascii_digit()).collect::<String>();
        let kinds: BTreeSet<String> = self.found.iter().map(|word| letters(word)).collect();
        let lettered = |word: &String| word.chars().any(char::is_alphabetic);
        kinds.len() == 1 && kinds.iter().all(lettered)
    }

    /// Whether the words are those of several loops: they come again and again, their times begin again, or they differ in their
    /// numbers alone, and most rows have one. Numbers are those of loops where two of them share a time, and are few: a state or a counter has one at a time.
    fn several(&self) -> bool {
        let [rows, blank, numbers] = self.rows;
        let recur = self.changes > self.found.len() || self.again || self.numbered();
        let counted = numbers + blank == rows && self.found.len() < MOST && (self.again || self.shared);
        let one_kind = numbers == 0 || counted;
        self.found.len() > 1 && recur && one_kind && (blank * 2 < rows || self.again)
    }

    /// Whether the column has nothing to say of the wanted loop, so that all rows count.
    pub fn is_none(&self) -> bool {
        self.wanted.is_some() && !self.matched && !self.several()
    }

    /// Refuses rows of several loops of which nobody says which is wanted, and a loop that has none.
    pub fn decided(&self) -> Result<(), TableError> {
        let Self { at, name, wanted, found, matched, .. } = self;
        let column = at + 1;
        let loops = || listed(found.iter().map(String::as_str));
        match wanted {
            None if self.several() => Err(TableError::refused(format!(
                "column {column} ({name}): rows of several loops, {}: say which with --loop",
                loops()
            ))),
            Some(wanted) if !matched && self.several() => Err(TableError::refused(format!(
                "--loop {wanted:?}: column {column} ({name}) names no such loop; there are {}",
                loops()
            ))),
            _ => Ok(()),
        }
    }
}
