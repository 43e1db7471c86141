use super::*;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::sync::Arc;

enum Values<'v> {
    Doubles(&'v [f64]),
    Longs(&'v [i64]),
    Texts(&'v [&'v str]),
}

/// A file with required columns.
fn table(name: &str, schema: &str, columns: &[Values<'_>]) -> File {
    let path = std::env::temp_dir().join(format!("stictiond-table-{}-{name}", std::process::id()));
    let schema = parse_message_type(&format!("message m {{ {schema} }}")).expect("a schema");
    let out = File::create(&path).expect("a file");
    let mut writer =
        SerializedFileWriter::new(out, Arc::new(schema), Arc::new(WriterProperties::builder().build()))
            .expect("new");
    let mut group = writer.next_row_group().expect("a group");
    for values in columns {
        let mut column = group.next_column().expect("a column").expect("one more");
        match values {
            Values::Doubles(v) => column.typed::<DoubleType>().write_batch(v, None, None),
            Values::Longs(v) => column.typed::<Int64Type>().write_batch(v, None, None),
            Values::Texts(v) => {
                let v: Vec<ByteArray> = v.iter().map(|text| ByteArray::from(*text)).collect();
                column.typed::<ByteArrayType>().write_batch(&v, None, None)
            }
        }
        .expect("written");
        column.close().expect("closed");
    }
    group.close().expect("closed");
    writer.close().expect("closed");
    File::open(&path).expect("it is there")
}

#[test]
fn a_wide_table_with_times_of_each_unit() {
    for (unit, per_s) in [("MILLIS", 1_000), ("MICROS", 1_000_000), ("NANOS", 1_000_000_000)] {
        let file = table(
            unit,
            &format!(
                "required int64 timestamp (TIMESTAMP({unit},true)); required double op; required int64 pv; required double T5;"
            ),
            &[
                Values::Longs(&[1_700_000_000 * per_s, 1_700_000_001 * per_s]),
                Values::Doubles(&[50.0, 51.5]),
                Values::Longs(&[7, 8]),
                Values::Doubles(&[f64::NAN, 2.0]),
            ],
        );
        let record = read(file, None).expect("a record");
        assert_eq!(
            record.op,
            [Sample::good(1_700_000_000.0, 50.0), Sample::good(1_700_000_001.0, 51.5)],
            "{unit}"
        );
        assert_eq!(record.pv[1], Sample::good(1_700_000_001.0, 8.0));
        assert_eq!(record.tags[0].0, "T5");
        assert_eq!(record.tags[0].1[0].quality, Quality::Bad(BadReason::NotANumber));
    }
}

#[test]
fn a_long_table_gives_the_loop_that_is_wanted() {
    let long = |name: &str| {
        table(
            name,
            "required binary time (STRING); required binary tag (STRING); required double value;",
            &[
                Values::Texts(&["2026-01-01T00:00:00Z", "2026-01-01 00:00:00", "10", "2026-01-01T00:00:01Z"]),
                Values::Texts(&["FIC101.OP", "FIC101.PV", "FIC102.PV", "FIC101.OP"]),
                Values::Doubles(&[50.0, 7.0, 9.0, 51.0]),
            ],
        )
    };
    let record = read(long("one"), Some("FIC101")).expect("a record");
    assert_eq!(record.op.iter().map(|s| s.value).collect::<Vec<_>>(), [50.0, 51.0]);
    assert_eq!((record.op[0].t, record.pv.len()), (record.pv[0].t, 1));
    let said = |name: &str, wanted| read(long(name), wanted).expect_err("refused").to_string();
    assert!(said("two", None).contains("FIC101, FIC102"), "{}", said("two", None));
    assert!(said("three", Some("XIC")).contains("no samples of loop 'XIC'"));
    assert!(said("four", Some("FIC102")).contains("no column op"));
}

#[test]
fn what_is_no_table_is_refused() {
    let wide = table(
        "no-time",
        "required double op; required double pv;",
        &[Values::Doubles(&[1.0]), Values::Doubles(&[1.0])],
    );
    assert_eq!(read(wide, None).expect_err("refused").to_string(), "no column t; the file has op, pv");
    let path = std::env::temp_dir().join(format!("stictiond-table-{}-text", std::process::id()));
    std::fs::write(&path, "t,op,pv").expect("written");
    let text = read(File::open(&path).expect("it is there"), None).expect_err("refused");
    assert!(text.to_string().starts_with("Parquet: "), "{text}");
}
