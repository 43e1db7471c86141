//! A sheet that is filled cell by cell, and the room that the sheets of a workbook have together.

use super::{Held, MAX_CELLS, MAX_COLUMNS, MAX_TEXT, Sheet};
use crate::collect::table::error::TableError;

/// What the sheets of a workbook may take yet.
#[derive(Debug)]
pub struct Room {
    cells: usize,
    /// Bytes of texts. One that many cells share is held as often.
    text: usize,
}

impl Default for Room {
    fn default() -> Self {
        Self { cells: MAX_CELLS, text: MAX_TEXT }
    }
}

impl Room {
    /// Takes so much of it; `false` where there is less.
    fn take(&mut self, cells: usize, text: usize) -> bool {
        let left = self.cells.checked_sub(cells).zip(self.text.checked_sub(text));
        if let Some((cells, text)) = left {
            *self = Self { cells, text };
        }
        left.is_some()
    }
}

/// A sheet on the way.
pub struct Filling<'f> {
    rows: Vec<(u64, Vec<Held>)>,
    name: &'f str,
    room: &'f mut Room,
}

impl<'f> Filling<'f> {
    pub fn new(name: &'f str, room: &'f mut Room) -> Self {
        Self { rows: Vec::new(), name, room }
    }

    /// One more cell, by its row and column from 0. Blank cells before it in its row take room as well.
    ///
    /// # Errors
    /// A workbook that takes too much.
    pub fn put(&mut self, (row, column): (u32, u32), held: Held) -> Result<(), TableError> {
        if matches!(held, Held::Blank) || column >= MAX_COLUMNS {
            return Ok(());
        }
        let line = u64::from(row) + 1;
        if self.rows.last().is_none_or(|(last, _)| *last != line) {
            self.rows.push((line, Vec::new()));
        }
        let Some((_, cells)) = self.rows.last_mut() else { return Ok(()) };
        let (at, before) = (column as usize, cells.len());
        cells.resize(before.max(at + 1), Held::Blank);
        let text = if let Held::Text(text) = &held { text.len() } else { 0 };
        let has_room = self.room.take(cells.len() - before, text);
        cells[at] = held;
        if has_room {
            return Ok(());
        }
        let name = self.name;
        Err(TableError::refused(format!(
            "sheet {name:?}: the workbook has more than {MAX_CELLS} cells, or {MAX_TEXT} bytes of text, up to here; say which \
             sheet with --sheet, or save the columns that are needed as CSV"
        )))
    }

    pub fn end(self, one_of_many: bool) -> Sheet {
        Sheet { name: self.name.to_string(), one_of_many, since_1904: false, rows: self.rows }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(put: Result<(), TableError>) -> String {
        put.expect_err("there is no room").to_string()
    }

    #[test]
    fn the_sheets_of_a_workbook_share_its_cells() {
        let mut room = Room { cells: 5, text: 0 };
        let mut first = Filling::new("first", &mut room);
        // The one between is blank.
        first
            .put((0, 0), Held::Number(1.0))
            .and_then(|()| first.put((0, 2), Held::Number(2.0)))
            .expect("three");
        first.put((9, MAX_COLUMNS), Held::Number(3.0)).expect("no column that is read");
        first.put((9, 0), Held::Blank).expect("nothing");
        assert_eq!(first.end(true).rows.len(), 1);
        let mut second = Filling::new("second", &mut room);
        second.put((7, 1), Held::Number(1.0)).expect("two more");
        second.put((7, 0), Held::Number(2.0)).expect("one that was counted");
        let said = said(second.put((8, 0), Held::Number(1.0)));
        assert!(
            said.starts_with("sheet \"second\": the workbook has more than") && said.contains("--sheet"),
            "{said}"
        );
    }

    #[test]
    fn a_text_takes_room_in_each_of_its_cells() {
        let mut room = Room { cells: 100, text: 10 };
        let mut sheet = Filling::new("texts", &mut room);
        let text = || Held::Text("12345".into());
        sheet.put((0, 0), text()).and_then(|()| sheet.put((1, 0), text())).expect("ten bytes");
        sheet.put((2, 0), Held::Number(1.0)).expect("no text");
        assert!(said(sheet.put((3, 0), text())).contains("bytes of text"));
    }
}
