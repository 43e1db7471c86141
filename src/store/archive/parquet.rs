//! Tables as Parquet: strings and doubles, every column optional, zstd, row groups of a bounded size.

use super::{ArchiveError, Cell, Column, Read, Sink, Type};
use parquet::basic::{Compression, ZstdLevel};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl, get_typed_column_reader};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::fs::File;
use std::sync::Arc;

/// Rows of a row group, which are held in memory.
const GROUP: usize = 1 << 17;
/// Rows read in one go.
const ROWS: usize = 1 << 13;

impl From<ParquetError> for ArchiveError {
    fn from(error: ParquetError) -> Self {
        Self::Format(format!("Parquet: {error}"))
    }
}

pub struct Writer {
    out: SerializedFileWriter<File>,
    columns: Vec<Held>,
    rows: usize,
}

/// The values of one column that are not written yet, and for each row whether it has one.
enum Held {
    Texts(Vec<ByteArray>, Vec<i16>),
    Numbers(Vec<f64>, Vec<i16>),
}

impl Writer {
    pub fn new(file: File, columns: &[Column]) -> Result<Self, ArchiveError> {
        let fields: String = columns
            .iter()
            .map(|(name, of)| match of {
                Type::Text => format!("optional binary {name} (STRING);"),
                Type::Number => format!("optional double {name};"),
            })
            .collect();
        let schema = parse_message_type(&format!("message stictiond {{ {fields} }}"))?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::try_new(3)?))
            .set_created_by(concat!("stictiond ", env!("CARGO_PKG_VERSION")).to_string())
            .build();
        let out = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties))?;
        let empty = |(_, of): &Column| match of {
            Type::Text => Held::Texts(Vec::new(), Vec::new()),
            Type::Number => Held::Numbers(Vec::new(), Vec::new()),
        };
        Ok(Self { out, columns: columns.iter().map(empty).collect(), rows: 0 })
    }

    fn write_group(&mut self) -> Result<(), ArchiveError> {
        let mut group = self.out.next_row_group()?;
        for held in &mut self.columns {
            let Some(mut column) = group.next_column()? else { break };
            match (column.untyped(), held) {
                (ColumnWriter::ByteArrayColumnWriter(out), Held::Texts(values, there)) => {
                    out.write_batch(values, Some(there), None)?;
                    values.clear();
                    there.clear();
                }
                (ColumnWriter::DoubleColumnWriter(out), Held::Numbers(values, there)) => {
                    out.write_batch(values, Some(there), None)?;
                    values.clear();
                    there.clear();
                }
                _ => {
                    return Err(ArchiveError::Format(
                        "Parquet: a column has another type than its values".into(),
                    ));
                }
            }
            column.close()?;
        }
        group.close()?;
        self.rows = 0;
        Ok(())
    }
}

impl Sink for Writer {
    fn row(&mut self, cells: &[Cell]) -> Result<(), ArchiveError> {
        for (cell, held) in cells.iter().zip(&mut self.columns) {
            match (cell, held) {
                (Cell::Text(text), Held::Texts(values, there)) => {
                    values.push(ByteArray::from(text.as_bytes().to_vec()));
                    there.push(1);
                }
                (Cell::Number(value), Held::Numbers(values, there)) => {
                    values.push(*value);
                    there.push(1);
                }
                (_, Held::Texts(_, there) | Held::Numbers(_, there)) => there.push(0),
            }
        }
        self.rows += 1;
        if self.rows == GROUP { self.write_group() } else { Ok(()) }
    }

    fn finish(mut self: Box<Self>) -> Result<(), ArchiveError> {
        if self.rows > 0 {
            self.write_group()?;
        }
        self.out.close()?;
        Ok(())
    }
}

/// Reads rows; the row's number counts from 1.
pub fn read(
    file: File,
    take: &mut dyn FnMut(u64, &Read<'_>) -> Result<(), ArchiveError>,
) -> Result<(), ArchiveError> {
    let reader = SerializedFileReader::new(file)?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let names: Vec<String> = schema.columns().iter().map(|column| column.name().to_lowercase()).collect();
    let place = |name: &str| names.iter().position(|own| own == name);
    for name in ["loop", "tag", "t", "value"] {
        if place(name).is_none() {
            return Err(ArchiveError::Format(format!("no column {name}; the file has {}", names.join(", "))));
        }
    }
    let mut at = 0;
    for group in 0..reader.num_row_groups() {
        let group = reader.get_row_group(group)?;
        let texts = |name| place(name).map(|at| Texts::new(group.as_ref(), at)).transpose();
        let numbers = |name| place(name).map(|at| Numbers::new(group.as_ref(), at)).transpose();
        let mut texts = [texts("loop")?, texts("tag")?, texts("source")?, texts("unit")?, texts("quality")?];
        let mut numbers = [numbers("t")?, numbers("value")?];
        let mut left = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
        while left > 0 {
            let rows = left.min(ROWS);
            texts.iter_mut().flatten().try_for_each(|column| column.read(rows))?;
            numbers.iter_mut().flatten().try_for_each(|column| column.read(rows))?;
            for row in 0..rows {
                at += 1;
                let [own, tag, source, unit, quality] =
                    texts.each_ref().map(|column| column.as_ref().and_then(|column| column.0.get(row)));
                let [t, value] = numbers.each_ref().map(|column| column.as_ref().and_then(|c| c.0.get(row)));
                take(
                    at,
                    &Read {
                        control_loop: own.map(text).transpose()?.unwrap_or_default(),
                        tag: tag.map(text).transpose()?.unwrap_or_default(),
                        source: source.map(text).transpose()?,
                        unit: unit.map(text).transpose()?,
                        t: t.copied(),
                        value: value.copied().filter(|value| !value.is_nan()),
                        quality: quality.map(text).transpose()?,
                    },
                )?;
            }
            left -= rows;
        }
    }
    Ok(())
}

fn text(bytes: &ByteArray) -> Result<&str, ArchiveError> {
    Ok(bytes.as_utf8()?)
}

/// The rows that were read of a column, `None` where a row has nothing.
struct Rows<T>(Vec<Option<T>>);

impl<T> Rows<T> {
    fn get(&self, row: usize) -> Option<&T> {
        self.0.get(row)?.as_ref()
    }

    /// The next rows: `values` are those that are there, `levels` say which rows have one.
    fn fill(
        &mut self,
        rows: usize,
        read: usize,
        values: Vec<T>,
        levels: &[i16],
        most: i16,
    ) -> Result<(), ArchiveError> {
        if read != rows {
            return Err(ArchiveError::Format("Parquet: the columns are of different lengths".into()));
        }
        let mut values = values.into_iter();
        self.0.clear();
        // A column that is not optional has no levels.
        self.0.extend((0..rows).map(|row| {
            let there = most == 0 || levels.get(row) == Some(&most);
            if there { values.next() } else { None }
        }));
        Ok(())
    }
}

struct Texts(Rows<ByteArray>, ColumnReaderImpl<ByteArrayType>, i16);

impl Texts {
    fn new(group: &dyn RowGroupReader, at: usize) -> Result<Self, ArchiveError> {
        let most = plain(group, at)?;
        match group.get_column_reader(at)? {
            reader @ ColumnReader::ByteArrayColumnReader(_) => {
                Ok(Self(Rows(Vec::new()), get_typed_column_reader(reader), most))
            }
            _ => Err(other_type(group, at, "text")),
        }
    }

    fn read(&mut self, rows: usize) -> Result<(), ArchiveError> {
        let (mut values, mut levels) = (Vec::new(), Vec::new());
        let (read, _, _) = self.1.read_records(rows, Some(&mut levels), None, &mut values)?;
        self.0.fill(rows, read, values, &levels, self.2)
    }
}

struct Numbers(Rows<f64>, ColumnReaderImpl<DoubleType>, i16);

impl Numbers {
    fn new(group: &dyn RowGroupReader, at: usize) -> Result<Self, ArchiveError> {
        let most = plain(group, at)?;
        match group.get_column_reader(at)? {
            reader @ ColumnReader::DoubleColumnReader(_) => {
                Ok(Self(Rows(Vec::new()), get_typed_column_reader(reader), most))
            }
            _ => Err(other_type(group, at, "doubles")),
        }
    }

    fn read(&mut self, rows: usize) -> Result<(), ArchiveError> {
        let (mut values, mut levels) = (Vec::new(), Vec::new());
        let (read, _, _) = self.1.read_records(rows, Some(&mut levels), None, &mut values)?;
        self.0.fill(rows, read, values, &levels, self.2)
    }
}

/// The level of a value that is there; a column within lists is refused.
fn plain(group: &dyn RowGroupReader, at: usize) -> Result<i16, ArchiveError> {
    let column = group.metadata().column(at).column_descr_ptr();
    if column.max_rep_level() > 0 || column.max_def_level() > 1 {
        return Err(ArchiveError::Format(format!("column {}: nested columns are not read", column.name())));
    }
    Ok(column.max_def_level())
}

fn other_type(group: &dyn RowGroupReader, at: usize, wanted: &str) -> ArchiveError {
    let column = group.metadata().column(at).column_descr_ptr();
    let found = column.physical_type();
    ArchiveError::Format(format!("column {} must be {wanted}, and is {found}", column.name()))
}
