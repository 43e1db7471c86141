use super::*;
use proptest::prelude::*;

fn record(text: &str) -> Record {
    read(text.as_bytes()).unwrap()
}

fn refusal(text: impl AsRef<[u8]>) -> String {
    read(text.as_ref()).unwrap_err().to_string()
}

fn points(series: &Series) -> Vec<(f64, f64)> {
    series.iter().map(|s| (s.t, s.value)).collect()
}

#[test]
fn a_plain_record() {
    let record = record("t,op,pv,sp\n0,40.5,1e-2,\n1,41,-3,\n");
    assert_eq!(points(&record.op), [(0.0, 40.5), (1.0, 41.0)]);
    assert_eq!(points(&record.pv), [(0.0, 0.01), (1.0, -3.0)]);
    assert!(record.op.iter().all(|s| s.quality.is_good()));
    // A column that is blank throughout was not recorded.
    assert_eq!((record.sp, record.mode, record.mv), (None, None, None));
    assert!(record.tags.is_empty());
}

#[test]
fn the_same_record_however_it_is_written() {
    let plain = record("t,op,pv,sp,flow\n0,1.5,2,3,4\n60,2.5,3,3,5\n");
    for text in [
        "\u{feff}t,op,pv,sp,flow\r\n0,1.5,2,3,4\r\n60,2.5,3,3,5",
        "\n\nflow,SP,PV,OP,Time\n\n4,3,2,1.5,0\n\n5,3,3,2.5,60\n,,,,\n",
        "timestamp;Out;pv;sp;flow\n0;1,5;2;3;4\n60;2.5;3;3;5\n",
        "t\tCO\tpv\tsp\tflow\n0\t1,5\t2\t3\t4\n60\t2,5\t3\t3\t5\n",
        "\"t\",\"op\",\"pv\",\"sp\",\"flow\"\n\"0\",\"1.5\",2,3,4\n60,\" 2.5 \",3,3,5\n",
        "date,op,pv,sp,flow\n1970-01-01T00:00:00Z,1.5,2,3,4\n1970-01-01T01:01:00+01:00,2.5,3,3,5\n",
        "t [s],op,PV (m3/h),sp,flow\n1970-01-01 00:00:00,1.5,2,3,4\n1970-01-01 00:01:00.000,2.5,3,3,5\n",
        "t,op,pv,sp,flow,\n0,1.5,2,3,4,\n60,2.5,3,3,5,,,\n",
    ] {
        assert_eq!(record(text), plain, "{text:?}");
    }
}

#[test]
fn a_unit_of_per_cent_is_a_span_of_100() {
    assert_eq!(record("t,OP [%],pv\n0,1,2\n").op_span, Some(100.0));
    assert_eq!(record("t,op [mA],pv\n0,1,2\n").op_span, None);
}

#[test]
fn modes_are_decoded() {
    let record = record(
        "t,op,pv,mode,mv_stem\n0,1,1,AUTO,9\n1,1,1,man,8\n2,1,1,1,7\n3,1,1,0,6\n4,1,1,4,5\n5,1,1,,4\n",
    );
    let mode = record.mode.unwrap();
    let good: Vec<_> = mode.iter().filter(|s| s.quality.is_good()).map(|s| (s.t, s.value)).collect();
    assert_eq!(good, [(0.0, 1.0), (1.0, 0.0), (2.0, 1.0), (3.0, 0.0)]);
    assert_eq!(mode.len(), 5, "the undecidable mode is bad, the blank one is none");
    assert_eq!(record.mv.unwrap().len(), 6);
}

#[test]
fn bad_cells_are_bad_samples_and_blank_ones_are_none() {
    let record = record("t,op,pv\n0,1,2\n1,x,3\n2,,4\n3,NaN,5\n4,inf,6\n5,1e999,7\n6,1e308,8\n5,1\n");
    let bad = Quality::Bad(BadReason::NotANumber);
    let expected = [
        (0.0, Some(1.0)),
        (1.0, None),
        (3.0, None),
        (4.0, None),
        (5.0, None),
        (6.0, Some(1e308)),
        (5.0, Some(1.0)),
    ];
    assert_eq!(record.op.len(), expected.len());
    for (sample, (t, value)) in record.op.iter().zip(expected) {
        assert_eq!(sample.t, t);
        match value {
            Some(value) => assert_eq!((sample.value, sample.quality), (value, Quality::Good)),
            None => assert!(sample.value.is_nan() && sample.quality == bad),
        }
    }
    assert_eq!(record.pv.len(), 7, "times going backwards are kept as they come");
}

#[test]
fn tags_of_text_are_left_out() {
    let record = record("t,op,pv,remark,flow\n0,1,2,started,5\n1,1,2,,x\n");
    let names: Vec<_> = record.tags.iter().map(|(name, series)| (name.as_str(), series.len())).collect();
    assert_eq!(names, [("flow", 2)]);
}

#[test]
fn refusals_say_where() {
    let cases: [(&str, &str); 20] = [
        ("", "line 1: empty file; a header such as t,op,pv and one line per sample are needed"),
        ("\n \r\n", "line 1: empty file; a header such as t,op,pv and one line per sample are needed"),
        (
            "pv\n1\n",
            "line 1: only one column, \"pv\"; t, op and pv must be separated by comma, semicolon or tab",
        ),
        (
            "t|op|pv\n0|1|2\n",
            "line 1: only one column, \"t|op|pv\"; t, op and pv must be separated by comma, semicolon or tab",
        ),
        ("1\n2\n", "line 1: numbers where the header should be; put a line such as t,op,pv above them"),
        (
            "\n0,1,2\n1,1,2\n",
            "line 2: numbers where the header should be; put a line such as t,op,pv above them",
        ),
        (
            "t,op,flow\n0,1,2\n",
            "line 1: no column pv (t the time, op the controller's output, pv the measured value); the header has \"t\", \"op\", \"flow\"",
        ),
        (
            "a,b\n0,1\n",
            "line 1: no column t, op, pv (t the time, op the controller's output, pv the measured value); the header has \"a\", \"b\"",
        ),
        ("t,op,pv\n", "line 1: no samples below the header"),
        ("t,op,pv\n,,\n", "line 1: no samples below the header"),
        ("t,op,pv,OP\n0,1,2,3\n", "line 1, column 4: \"OP\" is the second column for op (after column 2)"),
        (
            "date,time,op,pv\n0,1,2,3\n",
            "line 1, column 2: \"time\" is the second column for t (after column 1)",
        ),
        (
            "t,op,pv\r\n0,1,2\r\n\r\nsoon,1,2\r\n",
            "line 4, column 1 (t): \"soon\" is no time; seconds, RFC 3339 or YYYY-MM-DD hh:mm:ss are read",
        ),
        (
            "op,pv,t\n0,1,2\n1,2,\n",
            "line 3, column 3 (t): \"\" is no time; seconds, RFC 3339 or YYYY-MM-DD hh:mm:ss are read",
        ),
        (
            "t,op,pv\nNaN,1,2\n",
            "line 2, column 1 (t): \"NaN\" is no time; seconds, RFC 3339 or YYYY-MM-DD hh:mm:ss are read",
        ),
        (
            "t,op,pv\n2024-02-30,1,2\n",
            "line 2, column 1 (t): \"2024-02-30\" is no time; seconds, RFC 3339 or YYYY-MM-DD hh:mm:ss are read",
        ),
        (
            "t,op,pv\n0,1,2\n1,0,5,2,5\n",
            "line 3: 5 cells where the header has 3; decimal commas need semicolons between cells",
        ),
        ("t,op,pv\n0,1,2\n1,a,2\n2,b,2\n", ""),
        (
            "t,op,pv\n0,,2\n1,a,2\n2,b,2\n",
            "line 3, column 2 (op): no number in the whole column, it begins with \"a\"",
        ),
        (
            "t,op,pv\n0,1,\n1,1,\n",
            "line 1, column 3 (pv): no number in the whole column, it begins with \"\"",
        ),
    ];
    for (text, expected) in cases {
        if expected.is_empty() {
            assert_eq!(record(text).op.len(), 3, "one number in the column is enough");
        } else {
            assert_eq!(refusal(text), expected, "{text:?}");
        }
    }
}

#[test]
fn what_is_no_text_is_refused() {
    assert!(refusal([0xff, 0xfe, b't', 0, b',', 0]).contains("UTF-16"));
    assert!(refusal([0x7f, b'E', b'L', b'F', 0, 0, 1]).contains("zero bytes"));
    assert!(refusal([0x89, 0xd0, 0xcf, 0x11, 0xe0]).contains("only one column"));
}

#[test]
fn a_quote_left_open_does_not_read_on_for_ever() {
    let text = format!("t,op,pv\n0,1,2\n1,\"{}", "1,2\n".repeat(1 << 20));
    assert!(refusal(text).starts_with("line 3: longer than 1048576 bytes"));
    // Endless input without a line is refused after the same amount.
    let header = "t,op,pv\n0,1,".as_bytes();
    let error = read(header.chain(io::repeat(b'1'))).unwrap_err();
    assert!(matches!(error, CsvError::LineTooLong { line: 2 }), "{error}");
}

#[test]
fn a_reader_that_fails_is_named() {
    struct Broken;
    impl Read for Broken {
        fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
            Err(io::Error::other("gone"))
        }
    }
    let error = read("t,op,pv\n0,1,2\n".as_bytes().chain(Broken)).unwrap_err();
    assert_eq!(error.to_string(), "cannot read: gone");
}

proptest! {
    #[test]
    fn any_bytes_are_a_record_or_a_refusal(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = read(bytes.as_slice());
    }

    /// Bytes that get past the header: what comes out is finite or bad, and no sample is invented.
    #[test]
    fn any_rows_give_judged_samples(rows in "[0-9a-zN.,;\"\t\r\n+-]{0,200}", semicolon: bool) {
        let header = if semicolon { "t;op;pv;x\n" } else { "t,op,pv,x\n" };
        if let Ok(record) = read(format!("{header}{rows}").as_bytes()) {
            let lines = rows.split('\n').count();
            for series in [&record.op, &record.pv].into_iter().chain(record.tags.iter().map(|(_, s)| s)) {
                prop_assert!(series.len() <= lines);
                for sample in series {
                    prop_assert!(sample.t.is_finite());
                    prop_assert_eq!(sample.value.is_finite(), sample.quality.is_good());
                }
            }
        }
    }

    /// Every finite number survives being written and read.
    #[test]
    fn numbers_round_trip(values in prop::collection::vec(
        (prop::num::f64::NORMAL, prop::num::f64::NORMAL, prop::num::f64::NORMAL), 1..20)) {
        let rows: String = values.iter().map(|(t, op, pv)| format!("{t:e};{op};{pv:e}\n")).collect();
        let record = record(&format!("t;op;pv\n{rows}"));
        let expected: Vec<_> = values.iter().map(|v| (v.0, v.1)).collect();
        prop_assert_eq!(points(&record.op), expected);
    }
}
