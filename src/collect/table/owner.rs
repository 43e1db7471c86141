//! Rows of several loops below each other, where OP and PV have columns of their own and another column names the loop.

use super::error::{TableError, listed};
use super::layout::{Body, Layout};
use super::options::Options;
use super::source::Rows;
use std::collections::BTreeSet;

/// Loops that are remembered for a message.
const MOST: usize = 64;

/// The column that names the loop of a row, and which loop is wanted.
pub struct Owner {
    at: usize,
    name: String,
    wanted: Option<String>,
    found: BTreeSet<String>,
    matched: bool,
}

impl Owner {
    /// `None` where no column names loops.
    pub fn of(layout: &Layout, options: &Options) -> Option<Self> {
        let Body::Wide(wide) = &layout.body else { return None };
        let (at, wanted) = (wide.owner?, options.of_loop.clone());
        Some(Self { at, name: layout.names[at].full.clone(), wanted, found: BTreeSet::new(), matched: false })
    }

    /// Whether a row is the wanted loop's.
    pub fn takes(&mut self, rows: &dyn Rows) -> bool {
        let cell = rows.cell(self.at);
        if cell.is_blank() {
            return true;
        }
        let own = cell.shown();
        let own = own.trim();
        if self.found.len() < MOST && !self.found.contains(own) {
            self.found.insert(own.to_string());
        }
        let is_wanted = self.wanted.as_ref().is_none_or(|wanted| wanted.eq_ignore_ascii_case(own));
        self.matched |= is_wanted;
        is_wanted
    }

    /// Refuses rows of several loops of which nobody says which is wanted, and a loop that has none.
    pub fn decided(&self) -> Result<(), TableError> {
        let Self { at, name, wanted, found, matched } = self;
        let column = at + 1;
        let loops = || listed(found.iter().map(String::as_str));
        match wanted {
            None if found.len() > 1 => Err(TableError::refused(format!(
                "column {column} ({name}): rows of several loops, {}: say which with --loop",
                loops()
            ))),
            Some(wanted) if !matched && !found.is_empty() => Err(TableError::refused(format!(
                "--loop {wanted:?}: column {column} ({name}) names no such loop; there are {}",
                loops()
            ))),
            _ => Ok(()),
        }
    }
}
