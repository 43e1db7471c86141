//! Sheets of workbooks: Excel (.xlsx, .xlsb, .xls) and OpenDocument (.ods), through calamine.

mod archive;
mod biff;
mod content;
mod fields;
mod filling;
mod guard;
mod limits;
mod ole;
mod opened;
mod relations;
mod shared_texts;
mod tags;
mod tokens;
mod xlsb;

use super::error::{TableError, listed};
use super::kinds;
use super::layout::{self, first_rows, look};
use super::options::Options;
use super::source::{Cell, Rows, Source, TimeBase, is_nothing};
use super::stamp::{DAY, MILLISECOND};
use archive::{Archive, Kind, part_names, refuse_other_archive};
use calamine::{Data, DataRef, ExcelDateTime, Ods, Reader, Sheets, Xls, Xlsb, Xlsx, open_workbook_from_rs};
use filling::Filling;
use limits::MemoryEstimate;
use std::fmt::Display;
use std::io::{Cursor, Read};
use std::panic::catch_unwind;
use std::sync::Arc;

/// Largest workbook that is read (bytes); it is unpacked in memory.
const MAX_BYTES: u64 = 1 << 28;
/// Columns of a sheet that are read: as many as of any table.
const MAX_COLUMNS: u32 = layout::MAX_COLUMNS as u32;
/// Names that a record needs: those of time, OP and PV.
const NEEDED_NAMES: usize = 3;
/// Milliseconds of a day; to them a number of days is exact.
const MS_PER_DAY: f64 = 86_400e3;

/// A cell in memory.
#[derive(Clone, Debug)]
enum Held {
    Blank,
    Text(Arc<str>),
    Number(f64),
    Moment(i64),
    Clock(i64),
}

/// A row, with its number from 1.
type Row = (u64, Vec<Held>);

/// A sheet in memory.
#[derive(Debug)]
pub struct Sheet {
    /// Its name.
    pub name: String,
    /// Whether the workbook has others.
    pub one_of_many: bool,
    /// Whether the workbook counts days from 1904, as Excel for the Macintosh once did.
    pub since_1904: bool,
    rows: Vec<Row>,
}

type Book = Sheets<Cursor<Arc<[u8]>>>;

/// Reads the sheet that is told, or the only one that has rows; of several, the only one with OP and PV where it is to be a record.
pub fn read(source: Source<'_>, wanted: Option<&str>, of_record: bool) -> Result<Sheet, TableError> {
    let mut bytes = Vec::new();
    source.open()?.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(TableError::refused(format!(
            "a workbook of more than {MAX_BYTES} bytes; save the sheet as CSV"
        )));
    }
    // The library panics at some that are damaged.
    catch_unwind(|| read_bytes(bytes, wanted, of_record))
        .unwrap_or_else(|_| Err(TableError::refused("a workbook that cannot be read: it is damaged")))
}

fn read_bytes(bytes: Vec<u8>, wanted: Option<&str>, of_record: bool) -> Result<Sheet, TableError> {
    let bytes: Arc<[u8]> = bytes.into();
    let mut archive = Archive::new(Cursor::new(bytes.clone())).ok();
    let parts = archive.as_ref().map(part_names).unwrap_or_default();
    refuse_other_archive(&parts)?;
    let kind = Kind::of(&parts);
    let mut memory = guard::check(&bytes, archive.as_mut(), kind)?;
    // The library opens the archive for itself; ours is not held beside it.
    drop(archive);
    let book = open(bytes, kind, !parts.is_empty())?;
    let since_1904 = is_since_1904(&book);
    Ok(Sheet { since_1904, ..choose(book, wanted, of_record, &mut memory)? })
}

/// Opens a workbook as the kind that the guard looked at. The library itself would try one kind after the other. `is_archive` says
/// whether the file has an archive in it.
fn open(bytes: Arc<[u8]>, kind: Kind, is_archive: bool) -> Result<Book, TableError> {
    let failed =
        |error: &dyn Display| TableError::refused(format!("a workbook that cannot be read: {error}"));
    let is_old = bytes.starts_with(kinds::OLE);
    let from = Cursor::new(bytes);
    if is_old {
        match open_workbook_from_rs::<Xls<_>, _>(from.clone()) {
            Ok(book) => return Ok(Sheets::Xls(book)),
            Err(error) if !is_archive => return Err(failed(&error)),
            // There is an archive behind the compound file: it is opened below.
            Err(_) => {}
        }
    }
    Ok(match kind {
        Kind::Binary => {
            Sheets::Xlsb(open_workbook_from_rs::<Xlsb<_>, _>(from).map_err(|error| failed(&error))?)
        }
        Kind::OpenDocument => {
            Sheets::Ods(open_workbook_from_rs::<Ods<_>, _>(from).map_err(|error| failed(&error))?)
        }
        Kind::Excel => {
            Sheets::Xlsx(open_workbook_from_rs::<Xlsx<_>, _>(from).map_err(|error| failed(&error))?)
        }
    })
}

/// Whether a workbook says that it counts days from 1904. The library heeds it where a cell has the format of a date, and a bare number
/// of days has none. OpenDocument writes dates as text.
fn is_since_1904(book: &Book) -> bool {
    match book {
        Sheets::Xls(book) => book.has_1904_epoch(),
        Sheets::Xlsx(book) => book.has_1904_epoch(),
        Sheets::Xlsb(book) => book.has_1904_epoch(),
        Sheets::Ods(_) => false,
    }
}

fn choose(
    mut book: Book,
    wanted: Option<&str>,
    of_record: bool,
    memory: &mut MemoryEstimate,
) -> Result<Sheet, TableError> {
    let names = book.sheet_names();
    if let Some(wanted) = wanted {
        let name = names.iter().find(|name| name.eq_ignore_ascii_case(wanted)).ok_or_else(|| {
            let names = listed(names.iter().map(String::as_str));
            TableError::refused(format!("no sheet {wanted:?} (--sheet); the workbook has {names}"))
        })?;
        return sheet(&mut book, name, names.len() > 1, memory);
    }
    let mut filled = Vec::new();
    for name in &names {
        let sheet = sheet(&mut book, name, names.len() > 1, memory)?;
        // A title or a chart's sheet is no table.
        if sheet.rows.iter().filter(|(_, row)| row.len() > 1).count() > 1 {
            filled.push(sheet);
        }
    }
    // The workbook is closed before the record is made: its memory is not counted together with that of the record.
    drop(book);
    match filled.len() {
        0 => Err(TableError::refused("no sheet of the workbook holds a table")),
        1 => Ok(filled.remove(0)),
        _ => {
            let records: Vec<usize> = (0..filled.len()).filter(|at| filled[*at].may_be_record()).collect();
            if let ([one], true) = (records.as_slice(), of_record) {
                return Ok(filled.swap_remove(*one));
            }
            let names = listed(filled.iter().map(|sheet| sheet.name.as_str()));
            let apart = match of_record && records.is_empty() {
                true => ", and none has both OP and PV: put them side by side into one sheet, or",
                false => ":",
            };
            Err(TableError::refused(format!(
                "several sheets hold tables, {names}{apart} say which with --sheet"
            )))
        }
    }
}

fn sheet(
    book: &mut Book,
    name: &str,
    one_of_many: bool,
    memory: &mut MemoryEstimate,
) -> Result<Sheet, TableError> {
    let failed = |error: &dyn Display| TableError::refused(format!("sheet {name:?}: {error}"));
    let mut filling = Filling::new(name, memory);
    match book {
        // Cell by cell: the size that a sheet says of itself is not to be believed.
        Sheets::Xlsx(book) => {
            let mut cells = match book.worksheet_cells_reader(name) {
                Ok(cells) => cells,
                Err(calamine::XlsxError::NotAWorksheet(_)) => return Ok(filling.end(one_of_many)),
                Err(error) => return Err(failed(&error)),
            };
            while let Some(cell) = cells.next_cell().map_err(|error| failed(&error))? {
                filling.put(cell.get_position(), held_ref(cell.get_value()))?;
            }
        }
        // The same: the library would make a cell of every place between the first and the last.
        Sheets::Xlsb(book) => {
            let mut cells = book.worksheet_cells_reader(name).map_err(|error| failed(&error))?;
            while let Some(cell) = cells.next_cell().map_err(|error| failed(&error))? {
                filling.put(cell.get_position(), held_ref(cell.get_value()))?;
            }
        }
        other => {
            let range = other.worksheet_range(name).map_err(|error| failed(&error))?;
            let (row, column) = range.start().unwrap_or_default();
            for (r, c, value) in range.used_cells() {
                filling.put((row + r as u32, column + c as u32), held(value))?;
            }
        }
    }
    Ok(filling.end(one_of_many))
}

fn held(value: &Data) -> Held {
    match value {
        Data::Int(value) => Held::Number(*value as f64),
        Data::Float(value) => Held::Number(*value),
        Data::String(text) => text_of(text),
        // No measurement is one; flags and modes are read as words.
        Data::Bool(on) => Held::Text(on.to_string().into()),
        Data::DateTime(stamp) => moment(stamp),
        Data::DateTimeIso(text) => text_of(text),
        Data::DurationIso(text) => duration(text).map_or_else(|| text_of(text), Held::Clock),
        Data::Error(error) => text_of(&error.to_string()),
        _ => Held::Blank,
    }
}

fn held_ref(value: &DataRef<'_>) -> Held {
    match value {
        DataRef::SharedString(text) => text_of(text),
        other => held(&Data::from(other.clone())),
    }
}

fn text_of(text: &str) -> Held {
    if is_nothing(text) { Held::Blank } else { Held::Text(text.into()) }
}

/// Whole milliseconds as nanoseconds.
fn nanoseconds(ms: f64) -> i64 {
    (ms.round() as i64).saturating_mul(MILLISECOND)
}

/// A time of day as OpenDocument keeps it, or a time since something began: `PT06H00M02.03S` (ns). One of months or below zero is none.
fn duration(text: &str) -> Option<i64> {
    let (days, clock) = text.trim().strip_prefix('P')?.split_once('T')?;
    let number = |digits: &str| {
        let is_plain = digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
        digits.parse::<f64>().ok().filter(|_| is_plain)
    };
    let mut ms = if days.is_empty() { 0.0 } else { number(days.strip_suffix('D')?)? * MS_PER_DAY };
    let mut rest = clock;
    for (letter, part) in [('H', 3_600e3), ('M', 60e3), ('S', 1e3)] {
        if let Some((digits, behind)) = rest.split_once(letter) {
            ms += number(digits)? * part;
            rest = behind;
        }
    }
    (!clock.is_empty() && rest.is_empty()).then(|| nanoseconds(ms))
}

/// A stamp as spreadsheets count, to the millisecond.
fn moment(stamp: &ExcelDateTime) -> Held {
    let days = stamp.as_f64();
    if !days.is_finite() || days < 0.0 {
        return Held::Text("a date before 1900".into());
    }
    if days < 1.0 || stamp.is_duration() {
        return Held::Clock(nanoseconds(days * MS_PER_DAY));
    }
    let (year, month, day, ..) = stamp.to_ymd_hms_milli();
    let date = jiff::civil::Date::new(year as i16, month as i8, day as i8);
    let since = date.ok().and_then(|date| date.since(jiff::civil::Date::constant(1970, 1, 1)).ok());
    // The date is that of the rounded stamp, which may be the day after.
    let clock = nanoseconds((days - days.floor()) * MS_PER_DAY) % DAY;
    let begin = since.and_then(|since| i64::from(since.get_days()).checked_mul(DAY));
    // A year that no stamp reaches is no date.
    begin.and_then(|begin| begin.checked_add(clock)).map_or(Held::Number(days), Held::Moment)
}

impl Sheet {
    /// Whether it has OP and PV by the names of its columns, in doubt or not.
    fn may_be_record(&self) -> bool {
        let first = first_rows(&mut self.rows()).unwrap_or_default();
        let looked = look(&first, &Options::default(), "row", false);
        looked.layout.is_ok() || looked.known >= NEEDED_NAMES
    }

    pub fn rows(&self) -> SheetRows<'_> {
        SheetRows { sheet: self, next: 0 }
    }
}

/// The rows of a sheet.
pub struct SheetRows<'s> {
    sheet: &'s Sheet,
    next: usize,
}

impl SheetRows<'_> {
    fn row(&self) -> &[Held] {
        self.next.checked_sub(1).and_then(|at| self.sheet.rows.get(at)).map_or(&[], |(_, row)| row)
    }
}

impl Rows for SheetRows<'_> {
    fn next(&mut self) -> Result<Option<u64>, TableError> {
        let line = self.sheet.rows.get(self.next).map(|(line, _)| *line);
        self.next += usize::from(line.is_some());
        Ok(line)
    }

    fn len(&self) -> usize {
        self.row().len()
    }

    fn cell(&self, at: usize) -> Cell<'_> {
        match self.row().get(at) {
            None | Some(Held::Blank) => Cell::Blank,
            Some(Held::Text(text)) => Cell::Text(text),
            Some(Held::Number(value)) => Cell::Number(*value),
            Some(Held::Moment(ns)) => Cell::Moment { ns: *ns, base: TimeBase::Civil },
            Some(Held::Clock(ns)) => Cell::Clock(*ns),
        }
    }

    fn row_name(&self) -> &'static str {
        "row"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_of_open_document_is_a_time_of_day_or_longer() {
        for (text, ms) in [
            ("PT06H00M02S", Some(21_602_000)),
            ("PT06H00M02.030000000S", Some(21_602_030)),
            ("PT06H00M02.0299999999S", Some(21_602_030)),
            ("PT00H00M00S", Some(0)),
            ("PT25H00M02S", Some(90_002_000)),
            ("P1DT01H00M02S", Some(90_002_000)),
            ("PT2.5S", Some(2_500)),
            ("PT", None),
            ("P1M", None),
            ("P1MT1H", None),
            ("-PT06H00M02S", None),
            ("PT6S3H", None),
            ("PTinfS", None),
            ("06:00:02", None),
            ("", None),
        ] {
            assert_eq!(duration(text), ms.map(|ms: i64| ms * 1_000_000), "{text:?}");
        }
    }
}
