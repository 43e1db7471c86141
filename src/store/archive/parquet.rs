//! Tables as Parquet: strings and doubles, every column optional, zstd, row groups of a bounded size.

use super::{ArchiveError, Cell, Column, Sink, Type};
use parquet::basic::{Compression, ZstdLevel};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::fs::File;
use std::sync::Arc;

/// Rows of a row group, which are held in memory.
const GROUP: usize = 1 << 17;

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
