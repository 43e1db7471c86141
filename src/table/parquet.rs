//! Rows of a Parquet file, whatever wrote it: numbers of every width, decimals, text, dates and stamps of every unit.

use super::error::TableError;
use super::expansion::expansion_limit;
use super::source::{Cell, Rows, Source, TimeBase};
use super::stamp::{DAY, MICROSECOND, MILLISECOND};
use parquet::basic::{LogicalType, TimeUnit, Type as PhysicalType};
use parquet::errors::ParquetError;
use parquet::file::metadata::ParquetMetaData;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::reader::RowIter;
use parquet::record::{Field, Row};
use parquet::schema::types::Type;
use std::collections::BTreeSet;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

impl From<ParquetError> for TableError {
    fn from(error: ParquetError) -> Self {
        Self::refused(format!("Parquet: {error}"))
    }
}

/// Smallest limit of rows: so many cost little, even where all of them are the same and take no bytes.
const MIN_ROW_LIMIT: u64 = 1_000_000;
/// Rows for each byte of a larger file: measurements have fewer, as they take a byte or more for a row.
const ROWS_PER_FILE_BYTE: u64 = 4;

/// How the stamps of a column are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Stamps {
    /// In nanoseconds, which come as plain numbers.
    nanos: bool,
    /// Their time base.
    base: TimeBase,
    /// A time of day in nanoseconds.
    clock: bool,
}

impl Stamps {
    fn of(field: &Type) -> Self {
        if field.is_primitive() && field.get_physical_type() == PhysicalType::INT96 {
            return Self { base: TimeBase::Int96, ..Self::default() };
        }
        match field.get_basic_info().logical_type_ref() {
            Some(LogicalType::Timestamp(stamp)) => Self {
                nanos: stamp.unit == TimeUnit::NANOS,
                base: if stamp.is_adjusted_to_u_t_c { TimeBase::Utc } else { TimeBase::Civil },
                clock: false,
            },
            Some(LogicalType::Time(time)) => Self { clock: time.unit == TimeUnit::NANOS, ..Self::default() },
            _ => Self::default(),
        }
    }
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
        unless_it_panics(|| Self::begin(source))
    }

    fn begin(source: Source<'_>) -> Result<Self, TableError> {
        let Source::File(path) = source else {
            return Err(TableError::refused("Parquet is read from a file only"));
        };
        let file = File::open(path)?;
        let bytes = file.metadata()?.len();
        let reader = SerializedFileReader::new(file)?;
        let left_out = oversized_texts(reader.metadata(), bytes)?;
        let schema = reader.metadata().file_metadata().schema_descr_ptr();
        let read = |field: &&Arc<Type>| !left_out.contains(field.name());
        let fields: Vec<Arc<Type>> = schema.root_schema().get_fields().iter().filter(read).cloned().collect();
        let names = fields.iter().map(|field| field.name().to_string()).collect();
        let stamps = fields.iter().map(|field| Stamps::of(field)).collect();
        let only =
            Type::group_type_builder(schema.root_schema().name()).with_fields(fields.clone()).build()?;
        let rows = RowIter::from_file_into(Box::new(reader)).project(Some(only))?;
        Ok(Self { rows, names, stamps, row: None, at: 0 })
    }
}

/// The library panics at some files that are damaged.
fn unless_it_panics<T>(read: impl FnOnce() -> Result<T, TableError>) -> Result<T, TableError> {
    // What was read half is not asked again: an error ends the reading.
    catch_unwind(AssertUnwindSafe(read))
        .unwrap_or_else(|_| Err(TableError::refused("Parquet: the file is damaged, and cannot be read")))
}

/// Looks at what a file would unpack to before anything of it is unpacked. Text that is far larger than its file is no tag's: the names
/// of such columns are returned, and they are left out as if they were not there.
///
/// # Errors
/// Too many rows, or another column that is far larger than the file.
fn oversized_texts(file: &ParquetMetaData, bytes: u64) -> Result<BTreeSet<String>, TableError> {
    let rows: u64 = file.row_groups().iter().map(|group| group.num_rows().max(0) as u64).sum();
    if rows > MIN_ROW_LIMIT.max(bytes.saturating_mul(ROWS_PER_FILE_BYTE)) {
        let why = format!(
            "Parquet: {rows} rows in {bytes} bytes: more than measurements take; write a shorter file"
        );
        return Err(TableError::refused(why));
    }
    let limit = expansion_limit(bytes);
    let mut left_out = BTreeSet::new();
    for column in file.row_groups().iter().flat_map(|group| group.columns()) {
        let size = column.uncompressed_size().max(0) as u64;
        let name = column.column_path().parts().first().cloned().unwrap_or_default();
        if size > limit
            && matches!(column.column_type(), PhysicalType::BYTE_ARRAY | PhysicalType::FIXED_LEN_BYTE_ARRAY)
        {
            left_out.insert(name);
        } else if size > limit {
            let why = format!(
                "Parquet: the column {name:?} unpacks to {size} bytes, from {bytes}: {limit} are taken"
            );
            return Err(TableError::refused(why));
        }
    }
    Ok(left_out)
}

impl Rows for Table {
    fn next(&mut self) -> Result<Option<u64>, TableError> {
        if self.at > 0 {
            self.row = unless_it_panics(|| Ok(self.rows.next().transpose()?))?;
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
        value.checked_mul(per).map_or(Cell::Blank, |ns| Cell::Moment { ns, base: stamps.base })
    };
    // Spark, DuckDB and pandas write NaN where nothing was measured.
    let float = |value: f64| if value.is_nan() { Cell::Blank } else { Cell::Number(value) };
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
        Field::Float16(v) => float(f64::from(f32::from(*v))),
        Field::Float(v) => float(f64::from(*v)),
        Field::Double(v) => float(*v),
        Field::Decimal(_) => field.to_string().parse().map_or(Cell::Blank, Cell::Number),
        Field::Str(text) => Cell::of_text(text),
        // Text that nobody has marked as such.
        Field::Bytes(bytes) => bytes.as_utf8().map_or(Cell::Blank, Cell::of_text),
        Field::Date(days) => i64::from(*days)
            .checked_mul(DAY)
            .map_or(Cell::Blank, |ns| Cell::Moment { ns, base: TimeBase::Civil }),
        Field::TimeMillis(ms) => Cell::Clock(i64::from(*ms) * MILLISECOND),
        Field::TimeMicros(us) => us.checked_mul(MICROSECOND).map_or(Cell::Blank, Cell::Clock),
        Field::TimestampMillis(ms) => moment(*ms, MILLISECOND),
        Field::TimestampMicros(us) => moment(*us, MICROSECOND),
        // A structure or a list is no sample.
        Field::Group(_) | Field::ListInternal(_) | Field::MapInternal(_) => Cell::Blank,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::schema::parser::parse_message_type;

    #[test]
    fn stamps_have_the_time_base_of_their_type() {
        let schema = parse_message_type(
            "message m { required int96 a; required int64 b (TIMESTAMP(NANOS,false)); \
             required int64 c (TIMESTAMP(MICROS,true)); required int64 d (TIME(NANOS,true)); \
             required group e { required int96 f; } }",
        );
        let schema = schema.expect("a schema");
        let stamps: Vec<Stamps> = schema.get_fields().iter().map(|field| Stamps::of(field)).collect();
        let of = |nanos, base, clock| Stamps { nanos, base, clock };
        let expected = [
            of(false, TimeBase::Int96, false),
            of(true, TimeBase::Civil, false),
            of(false, TimeBase::Utc, false),
            of(false, TimeBase::Utc, true),
            // A structure is no stamp.
            of(false, TimeBase::Utc, false),
        ];
        assert_eq!(stamps, expected);
        // The library makes milliseconds of INT96.
        let moment = cell(&Field::TimestampMillis(7), stamps[0]);
        assert_eq!(moment, Cell::Moment { ns: 7_000_000, base: TimeBase::Int96 });
    }
}
