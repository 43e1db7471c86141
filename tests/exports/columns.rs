//! Parquet of every kind of value, written here; `written` has files of other programs.

use super::{bits, example, scratch};
use parquet::basic::{BrotliLevel, Compression, GzipLevel, ZstdLevel};
use parquet::data_type::{
    ByteArray, ByteArrayType, DoubleType, FixedLenByteArray, FixedLenByteArrayType, Int32Type, Int64Type,
    Int96, Int96Type,
};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use stictiond::table::{Options, Source, Table, read};

enum Values {
    Doubles(Vec<f64>),
    Longs(Vec<i64>),
    Ints(Vec<i32>),
    Texts(Vec<String>),
    Fixed(Vec<Vec<u8>>),
    Int96(Vec<Int96>),
}

/// A file with required columns.
fn file(name: &str, compression: Compression, schema: &str, columns: &[Values]) -> PathBuf {
    let path = scratch(name);
    let schema = parse_message_type(&format!("message m {{ {schema} }}")).expect("a schema");
    let properties = WriterProperties::builder().set_compression(compression).build();
    let out = File::create(&path).expect("a file");
    let mut writer = SerializedFileWriter::new(out, Arc::new(schema), Arc::new(properties)).expect("new");
    let mut group = writer.next_row_group().expect("a group");
    for values in columns {
        let mut column = group.next_column().expect("a column").expect("one more");
        match values {
            Values::Doubles(v) => column.typed::<DoubleType>().write_batch(v, None, None),
            Values::Longs(v) => column.typed::<Int64Type>().write_batch(v, None, None),
            Values::Ints(v) => column.typed::<Int32Type>().write_batch(v, None, None),
            Values::Int96(v) => column.typed::<Int96Type>().write_batch(v, None, None),
            Values::Texts(v) => {
                let v: Vec<ByteArray> = v.iter().map(|text| ByteArray::from(text.as_str())).collect();
                column.typed::<ByteArrayType>().write_batch(&v, None, None)
            }
            Values::Fixed(v) => {
                let v: Vec<FixedLenByteArray> =
                    v.iter().map(|bytes| FixedLenByteArray::from(ByteArray::from(bytes.clone()))).collect();
                column.typed::<FixedLenByteArrayType>().write_batch(&v, None, None)
            }
        }
        .expect("written");
        column.close().expect("closed");
    }
    group.close().expect("closed");
    writer.close().expect("closed");
    path
}

fn table(path: &Path, options: &Options) -> Result<Table, String> {
    read(Source::File(path), options).map_err(|error| error.to_string())
}

#[test]
fn every_compression_and_an_index_without_a_name() {
    let example = example();
    let us =
        example.op.iter().map(|s| 1_780_293_600_000_000 + (s.t * 1e6).round() as i64).collect::<Vec<_>>();
    let (op, pv): (Vec<f64>, Vec<f64>) =
        example.op.iter().zip(&example.pv).map(|(a, b)| (a.value, b.value)).unzip();
    for (name, compression) in [
        ("none", Compression::UNCOMPRESSED),
        ("snappy", Compression::SNAPPY),
        ("gzip", Compression::GZIP(GzipLevel::default())),
        ("lz4", Compression::LZ4_RAW),
        ("lz4-hadoop", Compression::LZ4),
        ("brotli", Compression::BROTLI(BrotliLevel::default())),
        ("zstd", Compression::ZSTD(ZstdLevel::default())),
    ] {
        let path = file(
            name,
            compression,
            "required double op; required double pv; required int64 __index_level_0__ (TIMESTAMP(MICROS,false));",
            &[Values::Doubles(op.clone()), Values::Doubles(pv.clone()), Values::Longs(us.clone())],
        );
        let found = table(&path, &Options::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(bits(&found.record) == bits(&example), "{name}");
        assert_eq!(found.record.op[1].t, 1_780_293_602.03, "{name}");
        assert!(found.found.read_as.starts_with("Parquet, time as stamps (UTC)"), "{}", found.found.read_as);
    }
}

/// What unpacks to far more than a file of measurements: a text that nobody asked for is not unpacked, the rest is refused.
#[test]
fn a_file_that_unpacks_to_far_more_than_it_is_costs_nothing() {
    let zstd = Compression::ZSTD(ZstdLevel::default());
    let n = 1200;
    let numbers = |scale: f64| Values::Doubles((0..n).map(|at| (f64::from(at) * scale).sin()).collect());
    let stamps = Values::Doubles((0..n).map(f64::from).collect());
    let long = "x".repeat(100_000);
    let texts = Values::Texts((0..n).map(|at| format!("{at}{long}")).collect());
    let schema =
        "required double t; required double op; required double pv; required binary remark (STRING);";
    let path = file("text-bomb", zstd, schema, &[stamps, numbers(0.1), numbers(0.2), texts]);
    let size = std::fs::metadata(&path).expect("written").len();
    assert!(size < 1_000_000, "it packs 120 MB into {size} bytes");
    let found = table(&path, &Options::default()).expect("the others are read");
    assert_eq!(found.record.op.len(), n as usize);
    let taken = memory_to_diagnose(&path);
    assert!(taken < 64 << 20, "{taken} bytes");
    // Two million rows of nothing, which is twice as many as may be.
    let rows = 2_000_000;
    let zeroes = || Values::Doubles(vec![0.0; rows]);
    let schema = "required double t; required double op; required double pv;";
    let path = file("row-bomb", zstd, schema, &[zeroes(), zeroes(), zeroes()]);
    let Err(why) = table(&path, &Options::default()) else { panic!("it is taken") };
    assert!(why.contains("2000000 rows in "), "{why}");
}

/// Most memory that a process takes which reads the file and diagnoses it (bytes).
fn memory_to_diagnose(path: &Path) -> u64 {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    command.arg("diagnose").arg(path).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().expect("it starts");
    let mut most = 0;
    while child.try_wait().expect("waited for").is_none() {
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let line = status.lines().find(|line| line.starts_with("VmHWM:"));
        let kb = line.and_then(|line| line.split_whitespace().nth(1)).and_then(|kb| kb.parse::<u64>().ok());
        most = most.max(kb.unwrap_or(0) * 1024);
        std::thread::yield_now();
    }
    most
}

#[test]
fn numbers_of_every_kind_and_stamps_of_spark() {
    let half = |value: f32| half_bits(value).to_le_bytes().to_vec();
    let mut stamp = [Int96::new(); 2];
    // 2026-06-01 is the Julian day 2461193; nanoseconds of the day, then the day.
    for (k, stamp) in stamp.iter_mut().enumerate() {
        let ns = 21_600_000_000_000u64 + 2_000_000_000 * k as u64;
        stamp.set_data(ns as u32, (ns >> 32) as u32, 2_461_193);
    }
    let path = file(
        "kinds",
        Compression::SNAPPY,
        "required int96 time; required fixed_len_byte_array(2) op (FLOAT16); required int32 pv (DECIMAL(9,3)); \
         required binary mode (STRING); required int32 pv_quality;",
        &[
            Values::Int96(stamp.to_vec()),
            Values::Fixed(vec![half(50.5), half(51.25)]),
            Values::Ints(vec![1_002_000, 1_004_500]),
            Values::Texts(vec!["AUTO".into(), "AUTO".into()]),
            Values::Ints(vec![192, 0]),
        ],
    );
    let record = table(&path, &Options::default()).expect("a record").record;
    let points =
        |series: &[stictiond::signal::Sample]| series.iter().map(|s| (s.t, s.value)).collect::<Vec<_>>();
    assert_eq!(points(&record.op), [(1_780_293_600.0, 50.5), (1_780_293_602.0, 51.25)]);
    assert_eq!(points(&record.pv), [(1_780_293_600.0, 1002.0), (1_780_293_602.0, 1004.5)]);
    assert_eq!(record.pv.iter().map(|s| s.quality.is_good()).collect::<Vec<_>>(), [true, false]);
    assert_eq!(record.mode.expect("there is one")[0].value, 1.0);
}

#[test]
fn stamps_of_impala_are_those_of_the_zone_that_is_told() {
    // 02:00:00 of 2026-10-25 twice, as the clock shows it in Berlin: before it is set back from 03:00, and after that.
    let stamps = [2 * 3600, 3 * 3600 - 60, 2 * 3600, 3 * 3600 - 60].map(|second: u64| {
        let (mut stamp, ns) = (Int96::new(), 1_000_000_000 * second);
        stamp.set_data(ns as u32, (ns >> 32) as u32, 2_461_339);
        stamp
    });
    let path = file(
        "impala",
        Compression::SNAPPY,
        "required int96 time; required double op; required double pv;",
        &[
            Values::Int96(stamps.to_vec()),
            Values::Doubles(vec![1.0, 2.0, 3.0, 4.0]),
            Values::Doubles(vec![1.0, 2.0, 3.0, 5.0]),
        ],
    );
    let told = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    let found = table(&path, &told).expect("a record");
    // 00:00, 00:59, 01:00 and 01:59 UTC.
    let begin = 1_792_886_400.0;
    let expected = [0.0, 3540.0, 3600.0, 7140.0].map(|second| begin + second);
    assert_eq!(found.record.op.iter().map(|s| s.t).collect::<Vec<_>>(), expected);
    let said = found.found.read_as;
    assert!(said.starts_with("Parquet, time as stamps (INT96, Europe/Berlin by --tz)"), "{said}");
    // Without a zone it is UTC, and the line says what would decide.
    let found = table(&path, &Options::default()).expect("a record");
    assert_eq!(found.record.op[0].t, begin + 7200.0);
    let said = found.found.read_as;
    assert!(said.starts_with("Parquet, time as stamps (INT96, UTC; --tz decides)"), "{said}");
}

#[test]
fn a_zone_beside_stamps_of_spark_does_not_move_them() {
    let stamps = [21_600_000_000_000_u64, 21_602_000_000_000].map(|ns| {
        let mut stamp = Int96::new();
        stamp.set_data(ns as u32, (ns >> 32) as u32, 2_461_193);
        stamp
    });
    for (name, zones) in [
        ("timezone", ["Europe/Berlin", "Europe/Berlin"]),
        ("timezone", ["+02:00", "+02:00"]),
        ("utcoffset", ["+02:00", "+01:00"]),
    ] {
        let path = file(
            "spark-zone",
            Compression::SNAPPY,
            &format!(
                "required int96 time; required double op; required double pv; required binary {name} (STRING);"
            ),
            &[
                Values::Int96(stamps.to_vec()),
                Values::Doubles(vec![1.0, 2.0]),
                Values::Doubles(vec![1.0, 3.0]),
                Values::Texts(zones.map(str::to_string).to_vec()),
            ],
        );
        let found = table(&path, &Options::default()).expect("a record");
        assert_eq!(found.record.op[0].t, 1_780_293_600.0, "{name} {zones:?}");
        let said = found.found.read_as;
        assert!(said.starts_with("Parquet, time as stamps (INT96, UTC; --tz decides)"), "{said}");
    }
}

#[test]
fn stamps_that_say_utc_are_of_no_other_zone() {
    let path = file(
        "utc",
        Compression::SNAPPY,
        "required int64 time (TIMESTAMP(MILLIS,true)); required double op; required double pv;",
        &[
            Values::Longs(vec![1_780_293_600_000, 1_780_293_602_000]),
            Values::Doubles(vec![1.0, 2.0]),
            Values::Doubles(vec![1.0, 3.0]),
        ],
    );
    let told = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    let found = table(&path, &told).expect("a record");
    assert_eq!(found.record.op[0].t, 1_780_293_600.0);
    assert!(found.found.read_as.starts_with("Parquet, time as stamps (UTC)"), "{}", found.found.read_as);
}

/// A number that binary16 has exactly.
fn half_bits(value: f32) -> u16 {
    let bits = value.to_bits();
    let exponent = ((bits >> 23) & 0xff) as i32 - 127 + 15;
    ((bits >> 16) & 0x8000) as u16 | ((exponent as u16) << 10) | ((bits >> 13) & 0x3ff) as u16
}

#[test]
fn a_long_table_gives_the_loop_that_is_wanted() {
    let texts = |texts: &[&str]| Values::Texts(texts.iter().map(|text| text.to_string()).collect());
    let path = file(
        "long",
        Compression::ZSTD(ZstdLevel::default()),
        "required binary time (STRING); required binary tag (STRING); required double value;",
        &[
            texts(&[
                "2026-01-01T00:00:00Z",
                "2026-01-01 00:00:00",
                "2026-01-01T00:00:00Z",
                "2026-01-01T00:00:01Z",
            ]),
            texts(&["FIC101.OP", "FIC101.PV", "FIC102.PV", "FIC101.OP"]),
            Values::Doubles(vec![50.0, 7.0, 9.0, 51.0]),
        ],
    );
    let told = Options { tz: Some("UTC".into()), ..Options::default() };
    let of = |own: Option<&str>| table(&path, &Options { of_loop: own.map(str::to_string), ..told.clone() });
    let record = of(Some("FIC101")).expect("a record").record;
    assert_eq!(record.op.iter().map(|s| s.value).collect::<Vec<_>>(), [50.0, 51.0]);
    assert_eq!((record.op[0].t, record.pv.len()), (record.pv[0].t, 1));
    let said = of(Some("FIC102")).expect_err("it has no OP");
    assert!(said.contains("no tag for op") && said.contains("--op"), "{said}");
}

#[test]
fn numeric_epochs_have_the_unit_that_makes_them_a_date_of_our_time() {
    for (name, scale) in [("s", 1), ("ms", 1_000), ("us", 1_000_000), ("ns", 1_000_000_000)] {
        let path = file(
            name,
            Compression::SNAPPY,
            "required int64 t; required double op; required double pv;",
            &[
                Values::Longs(vec![1_780_293_600 * scale, 1_780_293_602 * scale]),
                Values::Doubles(vec![1.0, 2.0]),
                Values::Doubles(vec![1.0, 2.0]),
            ],
        );
        let record = table(&path, &Options::default()).expect("a record").record;
        assert_eq!([record.op[0].t, record.op[1].t], [1_780_293_600.0, 1_780_293_602.0], "{name}");
    }
}

#[test]
fn dates_as_text_beside_times_of_day_and_nan_for_nothing_are_read() {
    let texts = |texts: &[&str]| Values::Texts(texts.iter().map(|text| text.to_string()).collect());
    let us = |seconds: f64| ((6.0 * 3600.0 + seconds) * 1e6).round() as i64;
    let path = file(
        "text-dates",
        Compression::SNAPPY,
        "required binary date (STRING); required int64 time (TIME(MICROS,true)); required double op; required double pv; \
         required double sp; required binary mode (STRING);",
        &[
            texts(&["2026-06-01"; 4]),
            Values::Longs([0.0, 2.03, 4.0, 6.0].map(us).to_vec()),
            Values::Doubles(vec![50.0, f64::NAN, 52.0, 53.0]),
            Values::Doubles(vec![1.0, 2.0, f64::NAN, f64::INFINITY]),
            Values::Doubles(vec![f64::NAN; 4]),
            texts(&["AUTO", "NULL", "NULL", "MAN"]),
        ],
    );
    let found = table(&path, &Options::default()).expect("a record");
    let record = &found.record;
    let points =
        |series: &[stictiond::signal::Sample]| series.iter().map(|s| (s.t, s.value)).collect::<Vec<_>>();
    let begin = 1_780_293_600.0;
    assert_eq!(points(&record.op), [(begin, 50.0), (begin + 4.0, 52.0), (begin + 6.0, 53.0)]);
    assert_eq!(record.pv.iter().map(|s| s.t).collect::<Vec<_>>(), [begin, begin + 2.03, begin + 6.0]);
    // What is infinite was written as a number, and is a bad one.
    assert_eq!(record.pv.iter().map(|s| s.quality.is_good()).collect::<Vec<_>>(), [true, true, false]);
    let mode = record.mode.as_ref().expect("there is one");
    assert_eq!(points(mode), [(begin, 1.0), (begin + 6.0, 0.0)]);
    assert!(record.sp.is_none() && found.found.read_as.contains("1 sample without a number"));
}
