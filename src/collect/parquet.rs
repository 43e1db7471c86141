//! One loop's record from a Parquet file: a historian's table as a [`Record`].
//!
//! | accepted | |
//! |---|---|
//! | wide | a column of times and one for each tag, named as in a CSV file |
//! | long | columns of time, `tag` and `value`, a row for each sample; where there are, `loop` and `quality`. Without `loop` a tag may be `FIC101.PV` |
//! | time | a timestamp of any unit, seconds as a number, or text as in a CSV file |
//! | value | any number or Boolean; null is no sample, NaN and text are `bad:not_a_number` |

use super::csv::{Cells, Meaning, meaning};
use crate::signal::{BadReason, Quality, Record, Role, Sample, Series};
use parquet::basic::{LogicalType, TimeUnit};
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Field, Row};
use std::collections::BTreeSet;
use std::fs::File;

/// Most values taken from one file.
const MAX_VALUES: usize = super::csv::MAX_VALUES;
/// Loops named in a message.
const NAMED: usize = 8;

/// Why a file is no record.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// It is not Parquet, or damaged.
    #[error("Parquet: {0}")]
    Format(#[from] ParquetError),
    /// A needed column is missing.
    #[error("no column {missing}; the file has {found}")]
    Missing {
        /// Which.
        missing: &'static str,
        /// Those that are there.
        found: String,
    },
    /// A time cannot be read.
    #[error("row {row}: {what} is no time; a timestamp, seconds or RFC 3339 are read")]
    BadTime {
        /// From 1.
        row: usize,
        /// What stands there.
        what: String,
    },
    /// The file has several loops, or not the one that was asked for.
    #[error("{0}")]
    Loop(String),
    /// More values than fit the memory bound.
    #[error("more than {MAX_VALUES} values; cut the record into shorter files")]
    TooMany,
}

/// Reads the record of one loop; `wanted` is its name where the file has several.
///
/// # Errors
/// [`TableError`].
pub fn read(file: File, wanted: Option<&str>) -> Result<Record, TableError> {
    let reader = SerializedFileReader::new(file)?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let names: Vec<String> = schema.columns().iter().map(|column| column.name().to_string()).collect();
    let place =
        |wanted: &[&str]| names.iter().position(|own| wanted.contains(&own.to_ascii_lowercase().as_str()));
    let missing = |missing| TableError::Missing { missing, found: names.join(", ") };
    let time =
        names.iter().position(|name| meaning(name) == Some(Meaning::Time)).ok_or_else(|| missing("t"))?;
    let nanos = matches!(
        schema.column(time).logical_type_ref(),
        Some(LogicalType::Timestamp(stamp)) if stamp.unit == TimeUnit::NANOS
    );
    let mut taken = Taken { record: Record::default(), loops: BTreeSet::new(), values: 0 };
    let long = place(&["tag", "name", "tagname"]).zip(place(&["value", "val"]));
    let (owner, quality) = (place(&["loop"]), place(&["quality"]));
    if long.is_none() {
        for (role, name) in [(Role::Op, "op"), (Role::Pv, "pv")] {
            let there = names.iter().any(|own| meaning(own) == Some(Meaning::Role(role)));
            there.then_some(()).ok_or_else(|| missing(name))?;
        }
    }
    for (at, row) in reader.get_row_iter(None)?.enumerate() {
        let row: Row = row?;
        let fields: Vec<&Field> = row.get_column_iter().map(|(_, field)| field).collect();
        let bad_time = || TableError::BadTime { row: at + 1, what: fields[time].to_string() };
        let t = seconds(fields[time], nanos).ok_or_else(bad_time)?;
        match long {
            Some((tag, value)) => {
                let text = |at: Option<usize>| at.and_then(|at| text(fields[at]));
                let Some(tag) = text(Some(tag)) else { continue };
                let (own, tag) = match text(owner) {
                    Some(own) => (own, tag),
                    None => tag.rsplit_once(['.', '/']).map_or(("", tag), |(own, tag)| (own, tag)),
                };
                taken.take_long(own, tag, wanted, sample(t, fields[value], text(quality)));
            }
            None => {
                for (name, field) in names.iter().zip(&fields) {
                    taken.take(name, sample(t, field, None));
                }
            }
        }
        if taken.values > MAX_VALUES {
            return Err(TableError::TooMany);
        }
    }
    taken.finish(wanted).and_then(|record| {
        let none = if record.op.is_empty() { Some("op") } else { record.pv.is_empty().then_some("pv") };
        none.map_or(Ok(record), |name| Err(missing(name)))
    })
}

struct Taken {
    record: Record,
    /// Loops that a long table names.
    loops: BTreeSet<String>,
    values: usize,
}

impl Taken {
    fn take_long(&mut self, own: &str, tag: &str, wanted: Option<&str>, sample: Option<Sample>) {
        if wanted.is_some_and(|wanted| wanted != own) {
            return;
        }
        if self.loops.len() <= NAMED && !self.loops.contains(own) {
            self.loops.insert(own.to_string());
        }
        self.take(tag, sample);
    }

    fn take(&mut self, name: &str, sample: Option<Sample>) {
        let Some(sample) = sample else { return };
        let record = &mut self.record;
        let series: &mut Series = match meaning(name) {
            Some(Meaning::Time) => return,
            Some(Meaning::Role(Role::Op)) => &mut record.op,
            Some(Meaning::Role(Role::Pv)) => &mut record.pv,
            Some(Meaning::Role(Role::Sp)) => record.sp.get_or_insert_default(),
            Some(Meaning::Role(Role::Mode)) => record.mode.get_or_insert_default(),
            Some(Meaning::Role(Role::Mv)) => record.mv.get_or_insert_default(),
            None => match record.tags.iter().position(|(own, _)| own == name) {
                Some(at) => &mut record.tags[at].1,
                None => {
                    record.tags.push((name.to_string(), Series::new()));
                    let at = record.tags.len() - 1;
                    &mut record.tags[at].1
                }
            },
        };
        series.push(sample);
        self.values += 1;
    }

    fn finish(self, wanted: Option<&str>) -> Result<Record, TableError> {
        let named: Vec<&str> = self.loops.iter().take(NAMED).map(String::as_str).collect();
        match wanted {
            None if self.loops.len() > 1 => {
                Err(TableError::Loop(format!("several loops, {} …: say which with --loop", named.join(", "))))
            }
            Some(wanted) if self.values == 0 => {
                Err(TableError::Loop(format!("no samples of loop '{wanted}'")))
            }
            _ => Ok(self.record),
        }
    }
}

fn seconds(field: &Field, nanos: bool) -> Option<f64> {
    let t = match field {
        Field::TimestampMillis(ms) => *ms as f64 * 1e-3,
        Field::TimestampMicros(us) => *us as f64 * 1e-6,
        Field::Long(ns) if nanos => *ns as f64 * 1e-9,
        Field::Str(text) => Cells { decimal_comma: false }.time(text.as_bytes())?,
        other => number(other)?,
    };
    t.is_finite().then_some(t)
}

fn number(field: &Field) -> Option<f64> {
    Some(match field {
        Field::Bool(on) => f64::from(u8::from(*on)),
        Field::Byte(v) => f64::from(*v),
        Field::Short(v) => f64::from(*v),
        Field::Int(v) => f64::from(*v),
        Field::Long(v) => *v as f64,
        Field::UByte(v) => f64::from(*v),
        Field::UShort(v) => f64::from(*v),
        Field::UInt(v) => f64::from(*v),
        Field::ULong(v) => *v as f64,
        Field::Float(v) => f64::from(*v),
        Field::Double(v) => *v,
        _ => return None,
    })
}

fn text(field: &Field) -> Option<&str> {
    if let Field::Str(text) = field { Some(text) } else { None }
}

/// A cell as a sample; `None` where there is nothing.
fn sample(t: f64, field: &Field, quality: Option<&str>) -> Option<Sample> {
    if matches!(field, Field::Null) && quality.is_none() {
        return None;
    }
    let value = number(field).filter(|value| value.is_finite());
    let quality = match (quality, value) {
        (Some("stale"), Some(_)) => Quality::Stale,
        (None | Some("good"), Some(_)) => Quality::Good,
        (None | Some("good"), None) => Quality::Bad(BadReason::NotANumber),
        // Whatever it says, it is not good.
        (Some(_), _) => Quality::Bad(BadReason::DeviceException),
    };
    Some(Sample { t, value: value.unwrap_or(f64::NAN), quality })
}

#[cfg(test)]
mod tests;
