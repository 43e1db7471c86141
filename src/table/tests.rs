use super::*;
use crate::signal::{BadReason, Quality, Series};
use std::io;

fn table(text: impl AsRef<[u8]>) -> Result<Table, String> {
    with(text, &Options::default())
}

fn with(text: impl AsRef<[u8]>, options: &Options) -> Result<Table, String> {
    read(Source::Bytes(text.as_ref()), options).map_err(|error| error.to_string())
}

fn record(text: impl AsRef<[u8]>) -> Record {
    table(text).expect("a record").record
}

fn refusal(text: impl AsRef<[u8]>) -> String {
    table(text).expect_err("refused")
}

fn points(series: &Series) -> Vec<(f64, f64)> {
    series.iter().map(|s| (s.t, s.value)).collect()
}

#[test]
fn a_plain_record() {
    let table = table("t,op,pv,sp\n0,40.5,1e-2,\n1,41,-3,\n").expect("a record");
    let record = table.record;
    assert_eq!(points(&record.op), [(0.0, 40.5), (1.0, 41.0)]);
    assert_eq!(points(&record.pv), [(0.0, 0.01), (1.0, -3.0)]);
    assert!(record.op.iter().all(|s| s.quality.is_good()));
    // A column that is blank throughout was not recorded.
    assert_eq!((record.sp, record.mode, record.mv), (None, None, None));
    assert!(record.tags.is_empty());
    assert!(
        table
            .found
            .read_as
            .starts_with(", separated, decimal point, time in seconds, op from \"op\", pv from \"pv\"")
    );
}

#[test]
fn the_same_record_however_it_is_written() {
    let plain = record("t,op,pv,sp,flow\n0,1.5,2,3,4\n60,2.5,3,3,5\n");
    for text in [
        "\u{feff}t,op,pv,sp,flow\r\n0,1.5,2,3,4\r\n60,2.5,3,3,5",
        "\n\nflow,SP,PV,OP,Time\n\n4,3,2,1.5,0\n\n5,3,3,2.5,60\n,,,,\n",
        "timestamp;Out;pv;sp;flow\n0;1,5;2;3;4\n60;2,5;3;3;5\n",
        "t\tCO\tpv\tsp\tflow\n0\t1,5\t2\t3\t4\n60\t2,5\t3\t3\t5\n",
        "t|op|pv|sp|flow\n0|1.5|2|3|4\n60|2.5|3|3|5\n",
        "sep=;\nt;op;pv;sp;flow\n0;1.5;2;3;4\n60;2.5;3;3;5\n",
        "\"t\",\"op\",\"pv\",\"sp\",\"flow\"\n\"0\",\"1.5\",2,3,4\n60,\" 2.5 \",3,3,5\n",
        "t,op,pv,sp,flow\n0,\"1,5\",2,3,4\n60,\"2,5\",3,3,5\n",
        "date,op,pv,sp,flow\n1970-01-01T00:00:00Z,1.5,2,3,4\n1970-01-01T01:01:00+01:00,2.5,3,3,5\n",
        "Date,Time,op,pv,sp,flow\n01.01.1970,00:00:00,1.5,2,3,4\n01.01.1970,00:01:00,2.5,3,3,5\n",
        "t [s],op,PV (m3/h),sp,flow\n1970-01-01 00:00:00,1.5,2,3,4\n1970-01-01 00:01:00.000,2.5,3,3,5\n",
        "t,op,pv,sp,flow,\n0,1.5,2,3,4,\n60,2.5,3,3,5,,,\n",
        "Exported by somebody\n# on a Monday; of unit 1\n\nt,op,pv,sp,flow\n0,1.5,2,3,4\n60,2.5,3,3,5\n",
        "# t, op, pv, sp, flow\n0,1.5,2,3,4\n60,2.5,3,3,5\n",
        "t,op,pv,sp,flow\nms,-,m3/h,-,t/h\n0,1.5,2,3,4\n60000,2.5,3,3,5\n",
        ",op,pv,sp,flow\n0,1.5,2,3,4\n60,2.5,3,3,5\n",
    ] {
        assert_eq!(record(text), plain, "{text:?}");
    }
}

#[test]
fn a_long_table_is_the_same_record() {
    let plain = record("t,op,pv\n0,1.5,2\n60,2.5,3\n");
    for text in [
        "time,tag,value\n0,op,1.5\n0,pv,2\n60,op,2.5\n60,pv,3\n",
        "TagName;Timestamp;Value;Quality\nFIC101.OP;1970-01-01 00:00:00;1,5;Good\nFIC101.PV;1970-01-01 00:00:00;2;Good\n\
         FIC101.OP;1970-01-01 00:01:00;2,5;Good\nFIC101.PV;1970-01-01 00:01:00;3;Good\n",
        "#group,false,false,true\n#datatype,string,long,dateTime:RFC3339,double,string,string\n#default,_result,,,,,\n\
         ,result,table,_time,_value,_field,_measurement\n\
         ,,0,1970-01-01T00:00:00Z,1.5,op,FIC101\n,,0,1970-01-01T00:01:00Z,2.5,op,FIC101\n\n\
         #group,false,false,true\n#datatype,string,long,dateTime:RFC3339,double,string,string\n#default,_result,,,,,\n\
         ,result,table,_time,_value,_field,_measurement\n\
         ,,1,1970-01-01T00:00:00Z,2,pv,FIC101\n,,1,1970-01-01T00:01:00Z,3,pv,FIC101\n",
    ] {
        assert_eq!(record(text), plain, "{text:?}");
    }
    let two = "time,loop,tag,value\n0,A,op,1.5\n0,A,pv,2\n0,B,op,9\n0,B,pv,9\n60,A,op,2.5\n60,A,pv,3\n";
    assert_eq!(refusal(two), "several loops, \"A\", \"B\": say which with --loop");
    let one = |own: &str| with(two, &Options { of_loop: Some(own.into()), ..Options::default() });
    assert_eq!(one("A").expect("a record").record, plain);
    assert_eq!(one("X").expect_err("refused"), "no samples of loop \"X\"");
}

#[test]
fn thousands_are_never_fractions() {
    let plain = record("t,op,pv\n0,51.8,999\n1,51.9,1002\n2,51.7,1004.5\n");
    for text in [
        "t\top\tpv\n0\t51.8\t999\n1\t51.9\t1,002\n2\t51.7\t1,004.5\n",
        "t,op,pv\n0,51.8,999\n1,51.9,\"1,002\"\n2,51.7,\"1,004.5\"\n",
        "t;op;pv\n0;51,8;999\n1;51,9;1.002\n2;51,7;1.004,5\n",
        "t;op;pv\n0;51,8;999\n1;51,9;1 002\n2;51,7;1 004,5\n",
        "t;op;pv\n0;51.8;999\n1;51.9;1'002\n2;51.7;1'004.5\n",
    ] {
        assert_eq!(record(text), plain, "{text:?}");
    }
    let doubt = "t\top\tpv\n0\t51\t999\n1\t52\t1,002\n2\t53\t1,004\n";
    assert_eq!(
        refusal(doubt),
        "line 3, column pv: \"1,002\" may be 1.002 or 1002; say --decimal . or --decimal ,"
    );
    let told = |sign: &str| {
        let options = Options { decimal: Some(sign.into()), ..Options::default() };
        with(doubt, &options).expect("told").record.pv.iter().map(|s| s.value).collect::<Vec<_>>()
    };
    assert_eq!((told("."), told(",")), (vec![999.0, 1002.0, 1004.0], vec![999.0, 1.002, 1.004]));
}

#[test]
fn stamps_are_read_by_the_whole_column() {
    let times = |text: &str, options: &Options| -> Result<Vec<f64>, String> {
        Ok(with(text, options)?.record.op.iter().map(|s| s.t).collect())
    };
    let none = Options::default();
    let begin = 1_780_293_600.0;
    for (a, b) in [
        ("01.06.2026 06:00:00", "01.06.2026 06:00:02"),
        ("01-Jun-26 06:00:00", "01-Jun-26 06:00:02"),
        ("2026/06/01 06:00:00", "2026/06/01 06:00:02"),
        ("2026-06-01 08:00:00 +02:00", "2026-06-01 08:00:02 +02:00"),
        ("1780293600", "1780293602"),
        ("1780293600000", "1780293602000"),
        ("1780293600000000", "1780293602000000"),
        ("1780293600000000000", "1780293602000000000"),
        ("134247672000000000", "134247672020000000"),
        ("46174.25", "46174.2500231481"),
        ("20260601060000", "20260601060002"),
        ("20260601060000.000", "20260601060002.000"),
    ] {
        let text = format!("time;op;pv\n{a};1.5;2\n{b};1.6;2\n");
        assert_eq!(times(&text, &none), Ok(vec![begin, begin + 2.0]), "{a}");
    }
    let open = "time;op;pv\n06/01/2026 06:00:00 AM;1.5;2\n06/01/2026 06:00:02 AM;1.6;2\n";
    assert_eq!(
        times(open, &none).expect_err("a doubt"),
        "line 2, column 1 (time): \"06/01/2026 06:00:00 AM\" may be dd/mm/yyyy (2026-01-06) or mm/dd/yyyy (2026-06-01); \
         say --time-format dmy or mdy"
    );
    let format = |format: &str| Options { time_format: Some(format.into()), ..Options::default() };
    for told in ["mdy", "mm/dd/yyyy hh:mm:ss", "%m/%d/%Y %I:%M:%S %p"] {
        assert_eq!(times(open, &format(told)), Ok(vec![begin, begin + 2.0]), "{told}");
    }
    // The column decides: there is no month 13, and midnight leads to the next day.
    let proved = "time;op;pv\n06/12/2026 06:00:00;1.5;2\n06/13/2026 06:00:02;1.6;2\n";
    assert!(times(proved, &none).is_ok());
    let midnight =
        "time;op;pv\n06/01/2026 23:59:58;1.5;2\n06/02/2026 00:00:00;1.6;2\n06/02/2026 00:00:02;1.6;2\n";
    assert_eq!(times(midnight, &none).map(|t| t[2] - t[0]), Ok(4.0));
    let zone = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    let local =
        "time;op;pv\n2026-10-25 02:30:00;1.5;2\n2026-10-25 02:00:00;1.6;2\n2026-10-25 03:00:00;1.6;2\n";
    assert_eq!(times(local, &zone).map(|t| (t[1] - t[0], t[2] - t[1])), Ok((1800.0, 3600.0)));
    assert!(
        times("t,op,pv\n0,1,2\n2000,1,2\n4000,1,2\n", &none).expect_err("a doubt").contains("--time-unit")
    );
}

#[test]
fn years_of_another_calendar_are_refused() {
    let of = |date: &str| table(format!("t,op,pv\n{date} 06:00:00,1,2\n{date} 06:00:01,1.5,2\n"));
    for date in ["2569-06-15", "15/06/2569", "1405/03/25", "1447-12-29"] {
        let said = of(date).expect_err("refused");
        assert!(said.starts_with(&format!("line 2, column 1 (t): \"{date} 06:00:00\"")), "{said}");
        assert!(said.contains("the year of another calendar"), "{said}");
    }
    for date in ["0001-01-01", "01/01/0001", "1601-01-01"] {
        let said = of(date).expect_err("refused");
        assert!(said.starts_with(&format!("line 2, column 1 (t): \"{date} 06:00:00\"")), "{said}");
        assert!(said.contains("is an elapsed time, written as a date"), "{said}");
    }
    // A row of no time among many is left out, whatever stands for it.
    let rows: String = (10..60).map(|k| format!("2026-06-15 06:00:{k},{k},2\n")).collect();
    let one = table(format!("t,op,pv\n{rows}0001-01-01 00:00:00,1,2\n")).expect("a record");
    assert_eq!(one.record.op.len(), 50);
    // The first day of a spreadsheet stands for none.
    assert!(of("1899-12-30").is_ok() && of("2099-06-15").is_ok());
}

#[test]
fn rows_under_one_stamp_are_spread_over_it() {
    let mut text = String::from("time,op,pv\n");
    for k in 0..40 {
        text += &format!("2026-06-01 06:00:{:02},{},{}\n", (k + 1) / 4, 50.0 + 0.1 * f64::from(k), k);
    }
    let table = table(&text).expect("a record");
    let t: Vec<f64> = table.record.op.iter().map(|s| s.t - 1_780_293_600.0).collect();
    assert!(t.windows(2).all(|two| (two[1] - two[0] - 0.25).abs() < 1e-6), "{t:?}");
    assert!(table.found.read_as.contains("4 rows a stamp spread over its 1 s"), "{}", table.found.read_as);
}

#[test]
fn some_rows_may_be_left_out_and_are_told() {
    let mut text = String::from("time,op,pv\n");
    for k in 0..100 {
        text += &if k == 7 { "soon,1.5,2\n".to_string() } else { format!("{k},{k}.5,2\n") };
    }
    text += "\nAverage,50.1,50.2\nTotal samples: 100\n";
    let table = table(&text).expect("a record");
    assert_eq!(table.record.op.len(), 99);
    assert!(table.found.read_as.ends_with("3 rows left out: lines 9, 103, 104"), "{}", table.found.read_as);
    let half: String =
        (0..40).map(|k| if k % 3 == 0 { "soon,1,2\n".into() } else { format!("{k},1,2\n") }).collect();
    assert!(refusal(format!("t,op,pv\n{half}")).starts_with("line 5, column 1 (t): \"soon\" is no time"));
}

#[test]
fn values_have_units_and_qualities() {
    let table =
        table("t;OP %;pv;pv_status\n0;50,1 %;7 m3/h;Good\n1;50,2 %;8 m3/h;Bad\n2;50,3 %;9 m3/h;Good\n")
            .expect("a record");
    assert_eq!(table.record.op_span, Some(100.0));
    assert_eq!(points(&table.record.op), [(0.0, 50.1), (1.0, 50.2), (2.0, 50.3)]);
    let good: Vec<bool> = table.record.pv.iter().map(|s| s.quality.is_good()).collect();
    assert_eq!(good, [true, false, true]);
    assert!(table.found.read_as.contains("op from \"OP %\" [%]"), "{}", table.found.read_as);
    assert!(table.found.read_as.contains("1 sample not good by pv_status"), "{}", table.found.read_as);
    let mixed = "t;op;pv\n0;1.5;0.9 bar\n1;1.6;90 kPa\n2;1.7;91 kPa\n";
    assert!(refusal(mixed).contains("a number in \"bar\" among numbers in \"kPa\""), "{}", refusal(mixed));
}

#[test]
fn modes_are_decoded() {
    let record = record(
        "t,op,pv,mode,mv_stem\n0,1,1,AUTO,9\n1,1,1,man,8\n2,1,1,1,7\n3,1,1,0,6\n4,1,1,what,5\n5,1,1,,4\n",
    );
    let mode = record.mode.expect("there is one");
    let good: Vec<_> = mode.iter().filter(|s| s.quality.is_good()).map(|s| (s.t, s.value)).collect();
    assert_eq!(good, [(0.0, 1.0), (1.0, 0.0), (2.0, 1.0), (3.0, 0.0)]);
    assert_eq!(mode.len(), 5, "the undecidable mode is bad, the blank one is none");
    assert_eq!(record.mv.expect("there is one").len(), 6);
}

#[test]
fn bad_cells_are_bad_samples_and_blank_ones_are_none() {
    let record = record("t,op,pv\n0,1,2\n1,x,3\n2,,4\n3,NaN,5\n4,inf,6\n5,1e999,7\n6,1e308,8\n5,1\n");
    let bad = Quality::Bad(BadReason::NotANumber);
    let expected =
        [(0.0, Some(1.0)), (1.0, None), (4.0, None), (5.0, None), (6.0, Some(1e308)), (5.0, Some(1.0))];
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
fn words_for_nothing_are_blank_cells() {
    let of = |nothing: &str, auto_values: Option<&str>| {
        let text = format!(
            "t,op,pv,sp,mode,pv_status\n0,1,2,{nothing},AUTO,Good\n1,{nothing},3,{nothing},{nothing},Good\n\
             2,2,{nothing},{nothing},{nothing},{nothing}\n3,3,4,{nothing},MAN,Bad\n4,1,2,{nothing},{nothing},Good\n"
        );
        let options = Options { auto_values: auto_values.map(str::to_string), ..Options::default() };
        with(text, &options).unwrap_or_else(|said| panic!("{nothing}: {said}"))
    };
    for auto_values in [None, Some("AUTO")] {
        let blank = of("", auto_values);
        for nothing in ["NULL", "null", "(null)", "\\N", "NaN", "nan", "#N/A", "\"NULL\""] {
            let table = of(nothing, auto_values);
            assert_eq!(table.record, blank.record, "{nothing}");
            assert_eq!(table.found.read_as, blank.found.read_as, "{nothing}");
        }
        let Record { op, pv, sp, mode, .. } = &blank.record;
        assert_eq!(points(op), [(0.0, 1.0), (2.0, 2.0), (3.0, 3.0), (4.0, 1.0)]);
        assert_eq!(points(pv), [(0.0, 2.0), (1.0, 3.0), (3.0, 4.0), (4.0, 2.0)]);
        assert_eq!(mode.as_ref().map(points), Some(vec![(0.0, 1.0), (3.0, 0.0)]));
        assert!(sp.is_none(), "{}", blank.found.read_as);
    }
    // Another word is a bad sample, and a row without a time is none and no comment.
    assert_eq!(record("t,op,pv\n0,1,2\n1,none,3\n2,2,3\n").op.len(), 3);
    let said = refusal("t,op,pv\n0,1,2\n#N/A,1,2\n2,1,2\n");
    assert!(said.starts_with("line 3, column 1 (t): the cell is empty"), "{said}");
}

#[test]
fn a_mode_of_nothing_in_rows_of_tags_is_unknown_and_not_manual() {
    let row = |t: u32, mode: &str| format!("{t},op,1.{t}\n{t},pv,2\n{t},mode,{mode}\n");
    let text = format!("time,tag,value\n{}{}{}", row(0, "AUTO"), row(1, "NULL"), row(2, "MAN"));
    let options = Options { auto_values: Some("AUTO".into()), ..Options::default() };
    let mode = with(text, &options).expect("a record").record.mode.expect("there is one");
    let good: Vec<(f64, f64)> =
        mode.iter().filter(|own| own.quality.is_good()).map(|own| (own.t, own.value)).collect();
    assert_eq!(good, [(0.0, 1.0), (2.0, 0.0)]);
}

#[test]
fn tags_of_text_are_left_out() {
    let record = record("t,op,pv,remark,flow\n0,1,2,started,5\n1,1,2,,x\n");
    let names: Vec<_> = record.tags.iter().map(|(name, series)| (name.as_str(), series.len())).collect();
    assert_eq!(names, [("flow", 2)]);
}

#[test]
fn refusals_say_where_and_what_to_do() {
    let cases: [(&str, &str); 18] = [
        ("", "line 1: empty file; a header such as t,op,pv and one line per sample are needed"),
        ("\n \r\n", "line 1: empty file; a header such as t,op,pv and one line per sample are needed"),
        (
            "pv\n1\n",
            "line 1: only one column, \"pv\"; cells are divided by comma, semicolon, tab, | or blanks, others with --separator",
        ),
        ("1\n2\n", "line 1: numbers where the header should be; put a line such as t,op,pv above them"),
        (
            "\n0,1,2\n1,1,2\n",
            "line 2: numbers where the header should be; put a line such as t,op,pv above them",
        ),
        (
            "t,op,flow\n0,1,2\n",
            "line 1: no column pv (t the time, op the controller's output, pv the measured value); the header has \
             \"t\", \"op\", \"flow\"; name them with --time, --op and --pv",
        ),
        (
            "a,b\n0,1\n",
            "line 1: no column t, op, pv (t the time, op the controller's output, pv the measured value); the header has \
             \"a\", \"b\"; name them with --time, --op and --pv",
        ),
        ("t,op,pv\n", "line 1: no samples below the header"),
        ("t,op,pv\n,,\n", "line 1: no samples below the header"),
        (
            "t,op,pv,OP\n0,1,2,3\n",
            "line 1: column 4: \"OP\" is the second column for op (after column 2); say which with --op",
        ),
        (
            "timestamp,time,op,pv\n0,1,2,3\n",
            "line 1: column 2: \"time\" is the second column for t (after column 1); say which with --time",
        ),
        ("t,op,pv\r\n0,1,2\r\n\r\nsoon,1,2\r\n", "line 4, column 1 (t): \"soon\" is no time"),
        ("op,pv,t\n0,1,2\n1,2,\n", "line 3, column 3 (t): the cell is empty, and each row needs a time"),
        ("t,op,pv\nNaN,1,2\n", "line 2, column 1 (t): the cell is empty, and each row needs a time"),
        ("t,op,pv\n2024-02-30,1,2\n", "line 2, column 1 (t): \"2024-02-30\" is no time"),
        (
            "t,op,pv\n0,1,2\n1,0,5,2,5\n",
            "line 3: 5 cells where the header has 3; decimal commas need quotes, or semicolons between cells",
        ),
        (
            "t,op,pv\n0,,2\n1,a,2\n2,b,2\n",
            "line 3, column 2 (op): no number in the whole column, it begins with \"a\"",
        ),
        ("t,op,pv\n0,1,\n1,1,\n", "line 1, column 3 (pv): nothing in the whole column"),
    ];
    for (text, expected) in cases {
        let said = refusal(text);
        assert!(said.starts_with(expected), "{text:?}: {said}");
    }
    assert_eq!(record("t,op,pv\n0,1,2\n1,a,2\n2,b,2\n").op.len(), 3, "one number in the column is enough");
}

#[test]
fn columns_can_be_named() {
    let text = "when,valve,flow,3\n0,1.5,2,9\n1,1.6,2,9\n";
    let named = Options {
        time: Some("when".into()),
        op: Some("Valve".into()),
        pv: Some("flow".into()),
        ..Options::default()
    };
    let record = with(text, &named).expect("named").record;
    assert_eq!((record.op.len(), record.tags.len()), (2, 1));
    let wrong = Options { op: Some("vlave".into()), ..named };
    assert!(with(text, &wrong).expect_err("refused").contains("--op \"vlave\": no column is called so"));
}

#[test]
fn what_is_no_text_is_refused() {
    assert!(refusal([0x7f, b'E', b'L', b'F', 0, 0, 1]).contains("zero bytes"));
    assert!(refusal([0x89, 0xd0, 0xcf, 0x11, 0xe0]).contains("only one column"));
    assert!(refusal(b"PAR1 and no more").contains("Parquet"));
    assert!(refusal(b"PK\x03\x04 and no more").contains("workbook"));
}

#[test]
fn a_quote_left_open_does_not_read_on_for_ever() {
    let text = format!("t,op,pv\n0,1,2\n1,\"{}", "1,2\n".repeat(1 << 20));
    let said = refusal(text);
    assert!(said.starts_with("line 3: longer than 1048576 bytes"), "{said}");
}

#[test]
fn a_file_that_is_not_there_is_named_by_the_system() {
    let error = read(Source::File(std::path::Path::new("/nowhere/at/all.csv")), &Options::default())
        .expect_err("gone");
    assert!(matches!(&error, TableError::Io(source) if source.kind() == io::ErrorKind::NotFound), "{error}");
}
