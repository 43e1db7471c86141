//! Rows of a Parquet file, whatever wrote it: numbers of every width, decimals, text, dates and stamps of every unit.

use super::error::TableError;
use super::source::{Cell, Rows, Source};
use super::stamp::DAY;
use parquet::basic::{LogicalType, TimeUnit};
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::reader::RowIter;
use parquet::record::{Field, Row};
use std::fs::File;

impl From<ParquetError> for TableError {
    fn from(error: ParquetError) -> Self {
        Self::refused(format!("Parquet: {error}"))
    }
}

/// How the stamps of a column are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Stamps {
    /// In nanoseconds, which come as plain numbers.
    nanos: bool,
    /// On the clock of the wall.
    civil: bool,
    /// A time of day in nanoseconds.
    clock: bool,
}

/// The rows of a file; the first is made of the columns' names.
pub struct Table {
    rows: RowIter<'static>,
    names: Vec<String>,
    stamps: Vec<Stamps>,
    row: Option<Row>,
    at: u64,
}

impl Table {
    pub fn open(source: Source<'_>) -> Result<Self, TableError> {
        let Source::File(path) = source else {
            return Err(TableError::refused("Parquet is read from a file only"));
        };
        let reader = SerializedFileReader::new(File::open(path)?)?;
        let schema = reader.metadata().file_metadata().schema_descr_ptr();
        let fields = schema.root_schema().get_fields();
        let names = fields.iter().map(|field| field.name().to_string()).collect();
        let stamps = fields.iter().map(|field| match field.get_basic_info().logical_type_ref() {
            Some(LogicalType::Timestamp(stamp)) => Stamps {
                nanos: stamp.unit == TimeUnit::NANOS,
                civil: !stamp.is_adjusted_to_u_t_c,
                clock: false,
            },
            Some(LogicalType::Time(time)) => {
                Stamps { clock: time.unit == TimeUnit::NANOS, ..Stamps::default() }
            }
            _ => Stamps::default(),
        });
        let stamps = stamps.collect();
        let rows = RowIter::from_file_into(Box::new(reader));
        Ok(Self { rows, names, stamps, row: None, at: 0 })
    }
}

impl Rows for Table {
    fn next(&mut self) -> Result<Option<u64>, TableError> {
        if self.at > 0 {
            self.row = self.rows.next().transpose()?;
        }
        // Rows are counted from 1 behind the names.
        let line = self.at;
        self.at += 1;
        Ok((line == 0 || self.row.is_some()).then_some(line))
    }

    fn len(&self) -> usize {
        self.names.len()
    }

    fn cell(&self, at: usize) -> Cell<'_> {
        let Some(row) = &self.row else {
            return self.names.get(at).map_or(Cell::Blank, |name| Cell::Text(name));
        };
        let Some((_, field)) = row.get_column_iter().nth(at) else { return Cell::Blank };
        cell(field, self.stamps[at])
    }

    fn row_name(&self) -> &'static str {
        "row"
    }
}

fn cell(field: &Field, stamps: Stamps) -> Cell<'_> {
    let moment = |value: i64, per: i64| {
        value.checked_mul(per).map_or(Cell::Blank, |ns| Cell::Moment { ns, civil: stamps.civil })
    };
    match field {
        Field::Null => Cell::Blank,
        Field::Bool(on) => Cell::Number(f64::from(u8::from(*on))),
        Field::Byte(v) => Cell::Number(f64::from(*v)),
        Field::Short(v) => Cell::Number(f64::from(*v)),
        Field::Int(v) => Cell::Number(f64::from(*v)),
        Field::Long(ns) if stamps.nanos => moment(*ns, 1),
        Field::Long(ns) if stamps.clock => Cell::Clock(*ns),
        Field::Long(v) => Cell::Number(*v as f64),
        Field::UByte(v) => Cell::Number(f64::from(*v)),
        Field::UShort(v) => Cell::Number(f64::from(*v)),
        Field::UInt(v) => Cell::Number(f64::from(*v)),
        Field::ULong(v) => Cell::Number(*v as f64),
        Field::Float16(v) => Cell::Number(f64::from(f32::from(*v))),
        Field::Float(v) => Cell::Number(f64::from(*v)),
        Field::Double(v) => Cell::Number(*v),
        Field::Decimal(_) => field.to_string().parse().map_or(Cell::Blank, Cell::Number),
        Field::Str(text) => Cell::Text(text),
        // Text that nobody has marked as such.
        Field::Bytes(bytes) => bytes.as_utf8().map_or(Cell::Blank, Cell::Text),
        Field::Date(days) => {
            let civil = Stamps { civil: true, ..stamps };
            i64::from(*days)
                .checked_mul(DAY)
                .map_or(Cell::Blank, |ns| Cell::Moment { ns, civil: civil.civil })
        }
        Field::TimeMillis(ms) => Cell::Clock(i64::from(*ms) * 1_000_000),
        Field::TimeMicros(us) => us.checked_mul(1_000).map_or(Cell::Blank, Cell::Clock),
        Field::TimestampMillis(ms) => moment(*ms, 1_000_000),
        Field::TimestampMicros(us) => moment(*us, 1_000),
        // A structure or a list is no sample.
        Field::Group(_) | Field::ListInternal(_) | Field::MapInternal(_) => Cell::Blank,
    }
}
