//! What a file is, by its first bytes, and its rows, as often as they are asked for.

use super::error::TableError;
use super::text::{self, Encoding};
use super::{delimited, kinds, parquet, workbook};
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{self, Cursor, Read};
use std::path::Path;

/// Bytes looked at to tell what a file is.
const HEAD: u64 = 1 << 16;
/// Most bytes that a compressed file may unpack to: it is streamed, and each costs time.
const MOST_UNPACKED: u64 = 1 << 34;

/// Where a table comes from. It is read more than once, so it is no stream.
#[derive(Clone, Copy, Debug)]
pub enum Source<'s> {
    /// A file.
    File(&'s Path),
    /// Bytes in memory: text, or a workbook.
    Bytes(&'s [u8]),
}

impl<'s> Source<'s> {
    /// Its bytes, unpacked where they are gzip's.
    pub(super) fn open(&self) -> Result<Box<dyn Read + 's>, TableError> {
        let mut raw: Box<dyn Read + 's> = match self {
            Source::File(path) => Box::new(File::open(path)?),
            Source::Bytes(bytes) => Box::new(Cursor::new(*bytes)),
        };
        let mut begin = Vec::new();
        raw.by_ref().take(2).read_to_end(&mut begin)?;
        let packed = begin == kinds::GZIP;
        let whole = Cursor::new(begin).chain(raw);
        if !packed {
            return Ok(Box::new(whole));
        }
        let bound = Bound { inner: MultiGzDecoder::new(whole), left: MOST_UNPACKED };
        Ok(Box::new(bound))
    }

    fn is_packed(&self) -> Result<bool, TableError> {
        let mut begin = Vec::new();
        match self {
            Source::File(path) => File::open(path)?.take(2).read_to_end(&mut begin)?,
            Source::Bytes(bytes) => bytes.take(2).read_to_end(&mut begin)?,
        };
        Ok(begin == kinds::GZIP)
    }

    /// The beginning of the file.
    pub(super) fn head(&self) -> Result<Vec<u8>, TableError> {
        let mut head = Vec::new();
        self.open()?.take(HEAD).read_to_end(&mut head)?;
        Ok(head)
    }
}

/// A reader that fails beyond so many bytes.
struct Bound<R> {
    inner: R,
    left: u64,
}

impl<R: Read> Read for Bound<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buffer)?;
        self.left = self.left.checked_sub(n as u64).ok_or_else(|| {
            io::Error::other(format!("it unpacks to more than {MOST_UNPACKED} bytes; unpack and cut it"))
        })?;
        Ok(n)
    }
}

/// Words by which databases and spreadsheets say that nothing is there: SQL Server's and others', Grafana's, AVEVA's, MySQL's
/// and PostgreSQL's, those of programs that compute, and Excel's.
pub const NOTHING: [&str; 7] = ["NULL", "null", "(null)", "\\N", "NaN", "nan", "#N/A"];

/// Whether a text says that nothing is there: it is blank, or one of [`NOTHING`] as it is written there.
pub fn is_nothing(text: &str) -> bool {
    let bare = super::number::bare(text);
    bare.is_empty() || NOTHING.contains(&bare)
}

/// The time base of a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeBase {
    /// UTC.
    #[default]
    Utc,
    /// Local time, without an offset.
    Civil,
    /// Parquet's INT96 does not say: Spark and Hive write UTC, Impala writes local time. It is read as local time in the zone that an
    /// option gives, and as UTC without one.
    Int96,
}

/// One cell as its file has it.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell<'a> {
    /// Nothing, blanks, or a word for nothing.
    Blank,
    /// Text, which may be a number or a stamp.
    Text(&'a str),
    /// A number as such.
    Number(f64),
    /// A moment as such (ns since 1970 in its time base).
    Moment { ns: i64, base: TimeBase },
    /// A time of day as such (ns since midnight).
    Clock(i64),
}

impl<'a> Cell<'a> {
    /// A text of a file.
    pub fn of_text(text: &'a str) -> Self {
        if is_nothing(text) { Cell::Blank } else { Cell::Text(text) }
    }

    /// Whether a row that begins with it is a comment.
    pub fn is_comment(&self) -> bool {
        // `########` is a time that a spreadsheet had no room for.
        let narrow = |text: &str| text.trim().len() >= 4 && text.trim().trim_matches('#').is_empty();
        matches!(self, Cell::Text(text) if text.trim_start().starts_with('#') && !narrow(text))
    }

    /// Whether nothing stands in it.
    pub fn is_blank(&self) -> bool {
        match self {
            Cell::Blank => true,
            Cell::Text(text) => is_nothing(text),
            _ => false,
        }
    }

    /// The cell as text.
    pub fn shown(&self) -> String {
        match self {
            Cell::Blank => String::new(),
            Cell::Text(text) => (*text).to_string(),
            Cell::Number(value) => value.to_string(),
            Cell::Moment { ns, .. } => format!("{} s since 1970", *ns as f64 * 1e-9),
            Cell::Clock(ns) => format!("{} s since midnight", *ns as f64 * 1e-9),
        }
    }
}

/// The rows of a table, one after the other.
pub trait Rows {
    /// Goes to the next row that is not blank; its line in the file from 1, `None` at the end.
    fn next(&mut self) -> Result<Option<u64>, TableError>;
    /// Cells of this row.
    fn len(&self) -> usize;
    /// One of them; blank beyond the end.
    fn cell(&self, at: usize) -> Cell<'_>;
    /// How this kind of file calls a row.
    fn row_name(&self) -> &'static str {
        "line"
    }
}

/// What a file is.
pub enum Kind {
    /// Cells divided by a sign.
    Text(Encoding),
    /// A sheet of a workbook, read whole.
    Sheet(workbook::Sheet),
    /// Columns as Parquet has them.
    Parquet,
}

impl Kind {
    /// Which kind it is; of the sheets of a workbook one may be the only record.
    pub fn of(
        source: Source<'_>,
        head: &[u8],
        sheet: Option<&str>,
        encoding: Option<&'static encoding_rs::Encoding>,
        of_record: bool,
    ) -> Result<Self, TableError> {
        if head.starts_with(kinds::PARQUET) {
            match source.is_packed()? {
                true => Err(TableError::refused("Parquet within gzip: unpack it first")),
                false => Ok(Kind::Parquet),
            }
        } else if head.starts_with(kinds::ZIP) || head.starts_with(kinds::OLE) {
            Ok(Kind::Sheet(workbook::read(source, sheet, of_record)?))
        } else {
            kinds::refuse(head)?;
            Ok(Kind::Text(text::encoding(head, encoding)?))
        }
    }

    /// Its rows from the beginning; `separator` divides the cells of text.
    pub fn rows<'s>(&'s self, source: Source<'s>, separator: u8) -> Result<Box<dyn Rows + 's>, TableError> {
        Ok(match self {
            Kind::Text(encoding) => Box::new(delimited::Lines::new(source.open()?, encoding, separator)),
            Kind::Sheet(sheet) => Box::new(sheet.rows()),
            Kind::Parquet => Box::new(parquet::Table::open(source)?),
        })
    }
}
