//! One reader for the tables that plants send: text of every dialect, workbooks, Parquet; wide or long.
//!
//! A table is read twice. The first reading counts what its cells could be, and decides from the whole of it: the decimal
//! sign, the format of times, which column is what. The second makes samples. What is doubtful is refused with the option
//! that decides, and nothing is taken for something else without a word: [`Found::read_as`] says in one line what was read.
//!
//! | step | decides |
//! |---|---|
//! | `source`, `kinds`, `text` | what kind of file, which encoding |
//! | `dialect`, `blanks`, `layout`, `why_none`, `time_columns`, `pairs`, `part`, `names`, `roles` | what divides cells, where the header is, which column is what |
//! | `evidence`, `number` | the decimal sign, thousands, units behind numbers |
//! | `time`, `stamp`, `calendar`, `header_format`, `header_zone`, `stated_zone`, `dotted_clock` | how times are written, and in which zone |
//! | `loops` | which loop each tag is of, and what it is to it, where every tag is taken |
//! | `several` | the loops of a table that has a column for each tag of several, where all of them are read |
//! | `words`, `by_words`, `rests`, `qualities`, `quality_names`, `joined`, `says` | which modes are automatic, which qualities good |
//! | `owner`, `mixed` | which rows are the loop's |
//! | `look`, `overlap` | what is looked at before samples are made: days on which the clock is changed, times that are recorded twice |
//! | `take`, `odd_rows`, `titles` | samples, which rows are left out, and where another table begins |

mod blanks;
mod by_words;
mod calendar;
mod channel;
mod delimited;
mod dialect;
mod dotted_clock;
mod error;
mod evidence;
mod expansion;
mod found;
mod header_format;
mod header_zone;
mod joined;
mod kinds;
mod layout;
mod look;
mod loops;
mod mixed;
pub mod names;
pub mod number;
mod odd_rows;
mod options;
mod overlap;
mod owner;
mod pairs;
mod parquet;
mod part;
mod qualities;
mod quality_names;
mod repeats;
mod rests;
mod roles;
mod says;
mod several;
mod source;
mod stamp;
mod stated_zone;
mod survey;
mod take;
mod text;
mod time;
mod time_columns;
mod titles;
mod two_rows;
mod vocabulary;
mod why_none;
mod words;
mod workbook;

pub use channel::Tag;
pub use error::TableError;
pub use found::Found;
pub use options::{Config, Options};
pub use several::{LoopColumns, OneOf, each_of_several};
pub use source::Source;

use crate::signal::{Record, Sample};

/// Most values (rows times columns) taken from one file: 1.6 GB of samples.
pub const MAX_VALUES: usize = 1 << 26;

/// A record and how it was read.
#[derive(Clone, Debug)]
pub struct Table {
    /// The record of one loop.
    pub record: Record,
    /// How it was read.
    pub found: Found,
}

/// Reads one loop's record.
///
/// Time and memory are linear in the number of values, which [`MAX_VALUES`] bounds.
///
/// # Errors
/// [`TableError`] for what is no record of time, OP and PV, or leaves a doubt. Unordered or repeated times and bad values are none.
pub fn read(source: Source<'_>, options: &Options) -> Result<Table, TableError> {
    take::record(source, survey::survey(source, options, true)?)
}

/// The record of a file that leaves no doubt.
///
/// # Errors
/// As [`read`].
pub fn record(path: &std::path::Path) -> Result<Record, TableError> {
    Ok(read(Source::File(path), &Options::default())?.record)
}

/// Hands every sample of a table on, in bounded memory: all loops of a long table, or the one of a wide table.
///
/// # Errors
/// [`TableError`], or what `take` said; what was handed on before stays handed on.
pub fn stream<E: From<TableError>>(
    source: Source<'_>,
    options: &Options,
    take: &mut dyn FnMut(&Tag, Sample) -> Result<(), E>,
) -> Result<Found, E> {
    take::stream(source, survey::survey(source, options, false)?, options, take)
}

/// The rows of a list that is no record, as they stand: the line of each in its file, and its cells as text.
///
/// Of `;`, tab and `,` that sign divides the cells of text by which a header is found among the first rows, else the one that
/// they have most of.
///
/// # Errors
/// [`TableError`] for what is no table, and for one of more than `most` rows or [`MAX_TEXT`] bytes of text.
pub fn texts(
    source: Source<'_>,
    options: &Options,
    most: usize,
    is_header: impl Fn(&[String]) -> bool,
) -> Result<Vec<TextRow>, TableError> {
    let told = options.told()?;
    let head = source.head()?;
    let kind = source::Kind::of(source, &head, options.sheet.as_deref(), told.encoding, false)?;
    let has_header = |separator: &u8| -> Result<bool, TableError> {
        let first = rows_of(kind.rows(source, *separator)?, HEADER_WITHIN, false)?;
        Ok(first.iter().any(|(_, cells)| is_header(cells)))
    };
    let mut found = None;
    for separator in [b',', b'\t', b';'] {
        if found.is_none() && has_header(&separator)? {
            found = Some(separator);
        }
    }
    let count = |sign: &u8| head.iter().filter(|byte| *byte == sign).count();
    let usual = || [b';', b'\t', b','].into_iter().max_by_key(count).unwrap_or(b',');
    rows_of(kind.rows(source, told.separator.or(found).unwrap_or_else(usual))?, most, true)
}

/// Rows of a list among which its header is, below titles.
pub const HEADER_WITHIN: usize = 20;
/// Most bytes of text in a list.
pub const MAX_TEXT: usize = 64 << 20;

/// The first `most` rows; more are an error where all are `wanted`.
fn rows_of(
    mut rows: Box<dyn source::Rows + '_>,
    most: usize,
    wanted: bool,
) -> Result<Vec<TextRow>, TableError> {
    let (mut out, mut bytes): (Vec<TextRow>, usize) = (Vec::new(), 0);
    while let Some(line) = rows.next()? {
        if out.len() >= most && !wanted {
            break;
        }
        let cells: Vec<String> = (0..rows.len()).map(|at| rows.cell(at).shown().trim().to_string()).collect();
        bytes += cells.iter().map(String::len).sum::<usize>();
        if out.len() >= most || bytes > MAX_TEXT {
            let name = rows.row_name();
            return Err(TableError::refused(format!(
                "{name} {line}: more than {most} rows or {MAX_TEXT} bytes"
            )));
        }
        out.push((line, cells));
    }
    Ok(out)
}

/// A row of [`texts`]: its line in the file, and its cells.
pub type TextRow = (u64, Vec<String>);

#[cfg(test)]
mod tests;
