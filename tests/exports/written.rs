//! Parquet as pandas, pyarrow and DuckDB write it: each file is the example, as far as its types can hold it.

use super::dress::BEGIN;
use super::{example, scratch};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::schema::printer::print_schema;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use stictiond::signal::{Record, Sample};
use stictiond::table::{Options, Source, read};

/// What a type holds of a value.
#[derive(Clone, Copy)]
enum Values {
    /// All of it.
    Whole,
    /// 24 bits of it.
    Single,
    /// 11 bits of it.
    Half,
    /// Two decimals of it.
    Hundredths,
}

impl Values {
    /// Whether `read` is what the type holds of `value`.
    fn is(self, read: f64, value: f64) -> bool {
        match self {
            Values::Whole => read.to_bits() == value.to_bits(),
            Values::Single => read == f64::from(value as f32),
            Values::Half => {
                // The last of 11 bits.
                let last = 2f64.powi(value.log2().floor() as i32 - 10);
                read == (value / last).round_ties_even() * last
            }
            // Of five thousandths pyarrow's writer makes an even hundredth, and DuckDB the larger one.
            Values::Hundredths => {
                read == (read * 100.0).round() / 100.0 && (read - value).abs() < 0.005 + 1e-9
            }
        }
    }
}

/// What a type holds of a time.
#[derive(Clone, Copy)]
enum Times {
    /// The clock on the wall, so that `--tz` moves it.
    Civil,
    /// The same, cut to seconds, as pandas does.
    Cut,
    /// The same, rounded to seconds, as DuckDB does.
    Rounded,
    /// UTC, whatever `--tz` says.
    Utc,
    /// Seconds since the record began.
    Since,
}

impl Times {
    /// The time that is read (s), where the example has `t` and the clock on the wall is `ahead` of UTC (s).
    fn of(self, t: f64, ahead: i64) -> f64 {
        let civil = (BEGIN - ahead) as f64 + t;
        match self {
            Times::Civil => civil,
            Times::Cut => civil.floor(),
            Times::Rounded => civil.round(),
            Times::Utc => BEGIN as f64 + t,
            Times::Since => t,
        }
    }
}

/// What a file has beside times and values.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Beside {
    /// Nothing.
    Nothing,
    /// Rows without a value.
    Gaps,
    /// Rows without a value, and a mode of 1 and 0 with gaps, too.
    GapsAndMode,
    /// Words for the mode, and for how good PV is.
    Words,
}

/// A row of the example: its number, time and value.
type Row = (usize, f64, f64);

/// A file of `tests/peers/parquet_writer.py`.
struct Form {
    /// Its name without the ending.
    name: &'static str,
    /// Parts of its [`facts`]: they show that it is the form that it is called.
    says: &'static [&'static str],
    /// How the line that says what was read begins.
    read_as: &'static str,
    values: Values,
    times: Times,
    beside: Beside,
}

/// A file with stamps on the wall's clock and whole values.
const fn form(name: &'static str, says: &'static [&'static str]) -> Form {
    let read_as = "Parquet, time as stamps";
    Form { name, says, read_as, values: Values::Whole, times: Times::Civil, beside: Beside::Nothing }
}

const LONG: &str = "Parquet, a row for each sample, time as stamps";
const WORDS: Beside = Beside::Words;

const OF_PANDAS: &[Form] = &[
    form("pandas-default", &["parquet-cpp-arrow", "op: 0 null, SNAPPY PLAIN RLE RLE_DICTIONARY"]),
    form("pandas-gzip", &["op: 0 null, GZIP"]),
    form("pandas-brotli", &["op: 0 null, BROTLI"]),
    form("pandas-lz4", &["op: 0 null, LZ4_RAW"]),
    form("pandas-zstd", &["op: 0 null, ZSTD"]),
    form("pandas-uncompressed", &["op: 0 null, UNCOMPRESSED"]),
    // Parquet has no stamps in seconds.
    Form { times: Times::Cut, ..form("pandas-stamps-s", &["INT64 time (TIMESTAMP(MILLIS,false));"]) },
    form("pandas-stamps-ms", &["INT64 time (TIMESTAMP(MILLIS,false));"]),
    form("pandas-stamps-us", &["INT64 time (TIMESTAMP(MICROS,false));"]),
    form("pandas-stamps-ns", &["INT64 time (TIMESTAMP(NANOS,false));"]),
    // It has no mark of a zone: Spark keeps UTC in it, and Impala what its clock shows.
    Form { read_as: "Parquet, time as stamps (INT96, ", ..form("pandas-int96", &["INT96 time;"]) },
    form("pandas-index", &["INT64 __index_level_0__ (TIMESTAMP(MICROS,false));"]),
    Form {
        times: Times::Utc,
        ..form("pandas-index-zone", &["INT64 __index_level_0__ (TIMESTAMP(MICROS,true));"])
    },
    form("pandas-index-numbers", &["INT64 __index_level_0__;"]),
    form("pandas-decimal", &["FIXED_LEN_BYTE_ARRAY (3) op (DECIMAL(5,3));"]),
    Form { values: Values::Half, ..form("pandas-float16", &["FIXED_LEN_BYTE_ARRAY (2) op (FLOAT16);"]) },
    Form { values: Values::Single, ..form("pandas-float32", &["FLOAT op;"]) },
    Form { beside: WORDS, ..form("pandas-texts", &["BYTE_ARRAY mode (STRING);"]) },
    Form { beside: WORDS, ..form("pandas-categories", &["BYTE_ARRAY mode (STRING);"]) },
    Form {
        beside: Beside::GapsAndMode,
        ..form("pandas-nullable", &["op: 24 null, ", "INT64 mode;", "mode: 24 null, ", " DATA_PAGE\n"])
    },
    Form {
        beside: Beside::GapsAndMode,
        ..form("pandas-nullable-v2", &["op: 24 null, ", "INT64 mode;", "mode: 24 null, ", " DATA_PAGE_V2\n"])
    },
];

const OF_ARROW: &[Form] = &[
    form("arrow-row-groups", &["parquet-cpp-arrow", "12 row groups"]),
    Form {
        beside: WORDS,
        ..form("arrow-pages-v2", &["op: 0 null, ZSTD", "DATA_PAGE_V2 DATA_PAGE_V2 DATA_PAGE_V2"])
    },
    Form {
        beside: WORDS,
        ..form(
            "arrow-no-dictionary",
            &["op: 0 null, SNAPPY PLAIN RLE DATA_PAGE\n", "mode: 0 null, SNAPPY PLAIN RLE DATA"],
        )
    },
    Form {
        beside: WORDS,
        ..form(
            "arrow-encodings",
            &[
                "time: 0 null, SNAPPY RLE DELTA_BINARY_PACKED DATA",
                "op: 0 null, SNAPPY RLE BYTE_STREAM_SPLIT DATA",
                "mode: 0 null, SNAPPY RLE DELTA_BYTE_ARRAY DATA",
                "pv_status: 0 null, SNAPPY RLE DELTA_LENGTH_BYTE_ARRAY DATA",
            ],
        )
    },
    form(
        "arrow-decimal-fixed",
        &["FIXED_LEN_BYTE_ARRAY (4) op (DECIMAL(9,3));", "FIXED_LEN_BYTE_ARRAY (16) pv (DECIMAL(38,3));"],
    ),
    form("arrow-decimal-integer", &["INT32 op (DECIMAL(9,3));", "INT64 pv (DECIMAL(18,3));"]),
    Form {
        values: Values::Hundredths,
        ..form("arrow-decimal-rounded", &["FIXED_LEN_BYTE_ARRAY (4) op (DECIMAL(9,2));"])
    },
    Form { beside: Beside::Gaps, ..form("arrow-nan", &["op: 0 null, ", "pv: 0 null, ", "sp: 0 null, "]) },
    Form { read_as: LONG, ..form("arrow-long", &["BYTE_ARRAY tag (STRING);", "tag: 0 null, SNAPPY"]) },
];

const OF_DUCKDB: &[Form] = &[
    // DuckDB's own reading of the CSV.
    Form {
        times: Times::Since,
        read_as: "Parquet, time in seconds",
        ..form("duckdb-csv", &["DuckDB version", "DOUBLE t;"])
    },
    form("duckdb-snappy", &["op: 0 null, SNAPPY", "INT64 time (TIMESTAMP(MICROS,false));"]),
    form("duckdb-gzip", &["op: 0 null, GZIP"]),
    form("duckdb-brotli", &["op: 0 null, BROTLI"]),
    form("duckdb-lz4", &["op: 0 null, LZ4_RAW"]),
    form("duckdb-zstd", &["op: 0 null, ZSTD"]),
    form("duckdb-uncompressed", &["op: 0 null, UNCOMPRESSED"]),
    Form { times: Times::Utc, ..form("duckdb-timestamptz", &["INT64 time (TIMESTAMP(MICROS,true));"]) },
    Form { times: Times::Rounded, ..form("duckdb-timestamp-s", &["INT64 time (TIMESTAMP(MICROS,false));"]) },
    form("duckdb-timestamp-ms", &["INT64 time (TIMESTAMP(MILLIS,false));"]),
    form("duckdb-timestamp-ns", &["INT64 time (TIMESTAMP(NANOS,false));"]),
    form("duckdb-date-and-time", &["INT32 date (DATE);", "INT64 time (TIME(MICROS,false));"]),
    form("duckdb-decimal-9-3", &["INT32 op (DECIMAL(9,3));"]),
    form("duckdb-decimal-18-3", &["INT64 op (DECIMAL(18,3));"]),
    form("duckdb-decimal-38-3", &["FIXED_LEN_BYTE_ARRAY (16) op (DECIMAL(38,3));"]),
    Form { values: Values::Hundredths, ..form("duckdb-decimal-9-2", &["INT32 op (DECIMAL(9,2));"]) },
    Form { values: Values::Single, ..form("duckdb-float", &["FLOAT op;"]) },
    Form { beside: WORDS, ..form("duckdb-enum", &["BYTE_ARRAY mode (UTF8);"]) },
    Form {
        beside: WORDS,
        ..form("duckdb-v2", &["time: 0 null, ZSTD DELTA_BINARY_PACKED", "op: 0 null, ZSTD BYTE_STREAM_SPLIT"])
    },
    Form {
        times: Times::Utc,
        read_as: LONG,
        ..form("duckdb-long", &["BYTE_ARRAY tag (UTF8);", "INT64 time (TIMESTAMP(MICROS,true));"])
    },
];

/// What a file says of itself: who wrote it, its columns, and of the first row group how many nulls a column has, how it is
/// compressed, its encodings and its pages.
fn facts(path: &Path) -> String {
    let reader = SerializedFileReader::new(File::open(path).expect("it was written")).expect("Parquet");
    let about = reader.metadata();
    let file = about.file_metadata();
    let mut schema: Vec<u8> = Vec::new();
    print_schema(&mut schema, file.schema());
    let by = file.created_by().unwrap_or_default();
    let schema = String::from_utf8_lossy(&schema);
    let mut out = format!("{by}\n{} row groups\n{schema}", about.num_row_groups());
    let group = reader.get_row_group(0).expect("a row group");
    for (at, column) in about.row_group(0).columns().iter().enumerate() {
        let nulls = column.statistics().and_then(|own| own.null_count_opt());
        let nulls = nulls.map_or("unknown".to_string(), |count| count.to_string());
        let (name, codec) = (column.column_path().string(), column.compression_codec());
        // Writing into a String cannot fail.
        let _ = write!(out, "{name}: {nulls} null, {codec}");
        for encoding in column.encodings() {
            let _ = write!(out, " {encoding}");
        }
        let mut pages = group.get_column_page_reader(at).expect("pages");
        while let Some(page) = pages.get_next_page().expect("a page") {
            let _ = write!(out, " {}", page.page_type());
        }
        out.push('\n');
    }
    out
}

impl Form {
    /// What is wrong with the file.
    fn check(&self, folder: &Path, example: &Record) -> Result<(), String> {
        let path = folder.join(format!("{}.parquet", self.name));
        let facts = facts(&path);
        if let Some(missing) = self.says.iter().find(|own| !facts.contains(**own)) {
            return Err(format!("{}: {missing:?} is not in\n{facts}", self.name));
        }
        for (zone, ahead) in [(None, 0), (Some("+02:00"), 7200)] {
            let options = Options { tz: zone.map(str::to_string), ..Options::default() };
            let table =
                read(Source::File(&path), &options).map_err(|error| format!("{}: {error}", self.name))?;
            if !table.found.read_as.starts_with(self.read_as) {
                return Err(format!("{}: read as {}", self.name, table.found.read_as));
            }
            self.record(&table.record, example, ahead)?;
        }
        Ok(())
    }

    /// What is wrong with a record that was read.
    fn record(&self, record: &Record, example: &Record, ahead: i64) -> Result<(), String> {
        let sp = |record: &Record| record.sp.clone().unwrap_or_default();
        self.series("op", &record.op, &self.rows(&example.op, |row| row % 50 == 3), ahead)?;
        self.series("pv", &record.pv, &self.rows(&example.pv, |row| row % 50 == 5), ahead)?;
        self.series("sp", &sp(record), &self.rows(&sp(example), |row| row % 10 != 0), ahead)?;
        let mode = |(row, t, _): Row| (row, t, f64::from(u8::from(row < 900)));
        let modes: Vec<Row> = match self.beside {
            Beside::Nothing | Beside::Gaps => Vec::new(),
            Beside::GapsAndMode | Beside::Words => {
                self.rows(&example.op, |row| row % 50 == 9).into_iter().map(mode).collect()
            }
        };
        self.series("mode", record.mode.as_deref().unwrap_or_default(), &modes, ahead)
    }

    /// The rows that a column of the example has in this form.
    fn rows(&self, series: &[Sample], is_gap: impl Fn(usize) -> bool) -> Vec<Row> {
        let gaps = matches!(self.beside, Beside::Gaps | Beside::GapsAndMode);
        let all = series.iter().enumerate().map(|(row, own)| (row, own.t, own.value));
        all.filter(|(row, ..)| !(gaps && is_gap(*row))).collect()
    }

    /// What is wrong with a column that was read.
    fn series(&self, what: &str, read: &[Sample], own: &[Row], ahead: i64) -> Result<(), String> {
        let name = self.name;
        if read.len() != own.len() {
            return Err(format!("{name}: {} samples of {what}, not {}", read.len(), own.len()));
        }
        for (sample, (row, t, value)) in read.iter().zip(own) {
            let t = self.times.of(*t, ahead);
            let is_good = !(what == "pv" && self.beside == Beside::Words && row % 100 == 7);
            let is_value = self.values.is(sample.value, *value);
            if sample.t.to_bits() != t.to_bits() || !is_value || sample.quality.is_good() != is_good {
                return Err(format!(
                    "{name}: {what} of row {row} is {sample:?}, not {value} at {t}, good: {is_good}"
                ));
            }
        }
        Ok(())
    }
}

/// The folder in which the peers have written every form.
fn written() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = root.join("target/peers-venv/bin/python");
    assert!(python.exists(), "there are no peers: run scripts/peers once, then the tests again");
    let folder = scratch("written");
    fs::create_dir_all(&folder).expect("a folder");
    let mut writer = Command::new(python);
    writer.arg(root.join("tests/peers/parquet_writer.py")).arg(root.join("docs/example.csv")).arg(&folder);
    let said = writer.output().expect("it starts");
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
    folder
}

#[test]
fn parquet_of_pandas_pyarrow_and_duckdb_is_the_example() {
    let folder = written();
    let forms = || [OF_PANDAS, OF_ARROW, OF_DUCKDB].into_iter().flatten();
    let files = fs::read_dir(&folder).expect("a folder").map(|file| file.expect("a file").file_name());
    let files: BTreeSet<String> = files.map(|name| name.to_string_lossy().into_owned()).collect();
    let listed: BTreeSet<String> = forms().map(|form| format!("{}.parquet", form.name)).collect();
    assert_eq!(files, listed);
    let example = example();
    let wrong: Vec<String> = forms().filter_map(|form| form.check(&folder, &example).err()).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    fs::remove_dir_all(&folder).expect("it can be removed");
}
