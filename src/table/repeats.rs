//! Rows that cannot all be samples of what they name: of a long table, the tag and the time of the row before with another value, or
//! no tag at all.

use super::error::TableError;
use super::source::Cell;
use std::hash::{BuildHasher, BuildHasherDefault, DefaultHasher};

/// One row in so many may have the tag and the time of the row before.
const REPEATED: u64 = 10;
/// One row in so many may have a value and no tag.
const NAMELESS: u64 = 50;

/// What is counted of them.
#[derive(Default)]
pub struct Repeats {
    /// The time and the value of each tag's last row.
    last: Vec<(u64, u64)>,
    repeated: u64,
    nameless: u64,
    /// Line of the first row without a tag.
    first: Option<u64>,
}

impl Repeats {
    /// A row of a tag: the cells of its time, and its value.
    pub fn add(&mut self, tag: usize, times: &[Option<Cell<'_>>], value: &Cell<'_>) {
        let hash = |cell: &Cell<'_>| BuildHasherDefault::<DefaultHasher>::default().hash_one(cell.shown());
        let time = times.iter().flatten().fold(0, |all: u64, cell| all.rotate_left(1) ^ hash(cell));
        let own = (time, hash(value));
        if self.last.len() <= tag {
            self.last.resize(tag + 1, (0, 0));
        }
        let before = std::mem::replace(&mut self.last[tag], own);
        self.repeated += u64::from(before.0 == own.0 && before.1 != own.1);
    }

    /// A row with a value and without a tag.
    pub fn nameless(&mut self, line: u64) {
        self.nameless += 1;
        self.first.get_or_insert(line);
    }

    /// Refuses a table with too many of them.
    pub fn refuse(&self, rows: u64, column: usize) -> Result<(), TableError> {
        if self.repeated * REPEATED > rows {
            return Err(TableError::refused(format!(
                "{} of {rows} rows have the tag and the time of a row before and another value: another column tells them apart, or \
                 times were cut; keep the rows of one kind, and the times whole",
                self.repeated
            )));
        }
        match self.first.filter(|_| self.nameless * NAMELESS > rows) {
            Some(line) => Err(TableError::refused(format!(
                "line {line}, column {}: {} of {rows} rows have a value and no tag; write the tag into every row",
                column + 1,
                self.nameless
            ))),
            None => Ok(()),
        }
    }
}
