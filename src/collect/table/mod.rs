//! One reader for the tables that plants send: text of every dialect, workbooks, Parquet; wide or long.
//!
//! A table is read twice. The first reading counts what its cells could be, and decides from the whole of it: the decimal
//! sign, the format of times, which column is what. The second makes samples. What is doubtful is refused with the option
//! that decides, and nothing is taken for something else without a word: [`Found::read_as`] says in one line what was read.
//!
//! | step | decides |
//! |---|---|
//! | `source`, `kinds`, `text` | what kind of file, which encoding |
//! | `layout`, `time_columns`, `names`, `roles` | what divides cells, where the header is, which column is what |
//! | `evidence`, `number` | the decimal sign, thousands, units behind numbers |
//! | `time`, `stamp`, `calendar` | how times are written |
//! | `words` | which modes are automatic, which qualities good |
//! | `take` | samples, and which rows are left out |

mod calendar;
mod channel;
mod delimited;
mod error;
mod evidence;
mod found;
mod kinds;
mod layout;
pub(super) mod names;
pub(super) mod number;
mod options;
mod parquet;
mod roles;
mod source;
mod stamp;
mod survey;
mod take;
mod text;
mod time;
mod time_columns;
mod words;
mod workbook;

pub use channel::Tag;
pub use error::TableError;
pub use found::Found;
pub use options::{Config, Options};
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
/// What divides the cells of text is the sign of `;`, tab and `,` that its first line has most of.
///
/// # Errors
/// [`TableError`] for what is no table, and for one of more than `most` rows.
pub fn texts(source: Source<'_>, sheet: Option<&str>, most: usize) -> Result<Vec<TextRow>, TableError> {
    let head = source.head()?;
    let kind = source::Kind::of(source, &head, sheet, None)?;
    let first = head.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let count = |sign: &u8| first.iter().filter(|byte| *byte == sign).count();
    let separator = [b',', b'\t', b';'].into_iter().max_by_key(count).unwrap_or(b',');
    let mut rows = kind.rows(source, separator)?;
    let mut out = Vec::new();
    while let Some(line) = rows.next()? {
        if out.len() >= most {
            return Err(TableError::refused(format!("{} {line}: more than {most} rows", rows.row_name())));
        }
        out.push((line, (0..rows.len()).map(|at| rows.cell(at).shown().trim().to_string()).collect()));
    }
    Ok(out)
}

/// A row of [`texts`]: its line in the file, and its cells.
pub type TextRow = (u64, Vec<String>);

#[cfg(test)]
mod tests;
