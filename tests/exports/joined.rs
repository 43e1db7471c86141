//! Exports whose times, header or quality are spread or written in ways that only the cells tell.

use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::table::{Options, Table};

/// A moment in jiff's words.
fn written(format: &str, t: f64) -> String {
    let moment = jiff::Timestamp::from_second(t.floor() as i64).expect("a time of ours");
    jiff::tz::Offset::UTC.to_datetime(moment).strftime(format).to_string()
}

fn refused(table: Result<Table, String>, by: &str) {
    let said = table.err().unwrap_or_default();
    assert!(said.contains(by), "{said:?} has no {by:?}");
}

#[test]
fn a_date_and_its_time_of_day_are_found_in_any_language() {
    let example = example();
    let pair = |t| written("%d.%m.%Y;%H:%M:%S", t);
    let rows_of = rows(&example, ';', pair);
    for names in ["Date;Heure", "Data;Ora", "Fecha;Hora", "Datum;Tid", "Дата;Время", "日付;時刻", "Data;Hora"]
    {
        let table = read(&format!("{names};OP;PV"), &rows_of, &Options::default()).expect(names);
        assert!(bits(&table.record) == bits(&example), "{names}: {}", table.found.read_as);
    }
    let told = Options { time: Some("Jour".into()), ..Options::default() };
    let table = read("Jour;Moment;OP;PV", &rows_of, &told).expect("told");
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
}

#[test]
fn a_column_that_is_called_by_its_unit_counts_in_it() {
    let example = example();
    for (name, per_s) in [("Seconds", 1.0), ("Minutes", 60.0), ("Hours", 3600.0), ("Time (hr)", 3600.0)] {
        let elapsed = rows(&example, ',', |t| format!("{:.12}", (t - BEGIN as f64) / per_s));
        let table = read(&format!("{name},OP,PV"), &elapsed, &Options::default()).expect(name);
        let off = table.record.op.iter().zip(&example.op).map(|(a, b)| (a.t - b.t).abs());
        assert!(off.fold(0.0, f64::max) < 1e-5, "{name}: {}", table.found.read_as);
    }
}

#[test]
fn wincc_counts_millionths_of_a_day_beside_the_date() {
    let example = example();
    let header = "TimeString;Time_ms;OP;PV";
    let both = |t: f64| format!("{};{:.0}", written("%d.%m.%Y %H:%M:%S", t), (t / 86_400.0 + 25_569.0) * 1e6);
    let rows = rows(&example, ';', both);
    let table = read(header, &rows, &Options::default()).expect("read");
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
    let told = Options { time: Some("Time_ms".into()), ..Options::default() };
    refused(read(header, &rows, &told), "WinCC");
}

#[test]
fn clocks_that_turn_back_are_asked_about_in_either_direction() {
    let example = example();
    // The sixth hour stands for the hour in which daylight saving time ends.
    let turned = rows(&example, ',', |t| {
        let half = BEGIN as f64 + 1200.0;
        written("%Y-%m-%d %H:%M:%S", if t < half { t } else { t - 3600.0 })
    });
    let backwards: Vec<String> = turned.iter().rev().cloned().collect();
    for rows in [turned, backwards] {
        refused(read("Time,OP,PV", &rows, &Options::default()), "daylight saving time");
    }
    let twelve =
        rows(&example, ',', |t| written("%Y-%m-%d %I:%M:%S", t - BEGIN as f64 % 86_400.0 + 12.6 * 3600.0));
    refused(read("Time,OP,PV", &twelve, &Options::default()), "twelve hours");
}

#[test]
fn a_header_that_comes_again_in_another_order_is_refused() {
    let example = example();
    let mut rows = rows(&example, ',', |t| written("%Y-%m-%d %H:%M:%S", t));
    rows.insert(600, "Time,OP,PV".into());
    let table = read("Time,OP,PV", &rows, &Options::default()).expect("the same once more");
    assert!(bits(&table.record) == bits(&example));
    rows[600] = "Time,PV,OP".into();
    refused(read("Time,OP,PV", &rows, &Options::default()), "line 602: the header comes again");
}

#[test]
fn a_word_of_quality_that_most_rows_have_is_asked_about() {
    let example = example();
    let mut rows = rows(&example, ',', |t| written("%Y-%m-%d %H:%M:%S", t));
    for (at, row) in rows.iter_mut().enumerate() {
        *row += if at % 400 == 7 { ",Bad" } else { ",Measured" };
    }
    refused(read("Time,OP,PV,Quality", &rows, &Options::default()), "--good-values");
    let told = Options { good_values: Some("Measured".into()), ..Options::default() };
    let table = read("Time,OP,PV,Quality", &rows, &told).expect("told");
    assert_eq!(
        table.record.pv.iter().filter(|sample| sample.quality.is_good()).count(),
        example.pv.len() - 3
    );
}

#[test]
fn columns_told_by_number_do_not_make_a_separator_right() {
    let example = example();
    let comma = |number: f64| format!("{number:.3}").replace('.', ",");
    let pairs = example.op.iter().zip(&example.pv);
    let rows: Vec<String> = pairs
        .map(|(op, pv)| {
            let t = written("%d/%m/%Y %H:%M:%S", BEGIN as f64 + op.t);
            format!("{t};{};{}", comma(op.value), comma(pv.value))
        })
        .collect();
    let by_number = Options {
        time: Some("1".into()),
        time_format: Some("dmy".into()),
        op: Some("2".into()),
        pv: Some("3".into()),
        ..Options::default()
    };
    let table = read("Date et heure;Sortie;Mesure", &rows, &by_number).expect("read");
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
}

#[test]
fn rulers_of_databases_and_row_numbers_of_r_are_no_samples() {
    let example = example();
    let plain = rows(&example, '\t', |t| written("%Y-%m-%d %H:%M:%S", t));
    let ruled = [vec!["-------------------\t------\t------".to_string()], plain.clone()].concat();
    let numbered: Vec<String> =
        plain.iter().enumerate().map(|(at, row)| format!("\"{}\"\t{row}", at + 1)).collect();
    for rows in [ruled, numbered] {
        let table = read("Time\tOP\tPV", &rows, &Options::default()).expect("read");
        assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
    }
}

/// As SQL Server's tools print a result: cells as wide as the ruler's dashes, so that a stamp leaves one blank behind it.
fn ruled(widths: [usize; 3], rows: impl Iterator<Item = [String; 3]>) -> String {
    let [a, b, c] = widths;
    let line = |cells: [&str; 3]| format!("{:<a$} {:<b$} {:<c$}\r\n", cells[0], cells[1], cells[2]);
    let dashes = widths.map(|width| "-".repeat(width));
    let mut rows = rows.peekable();
    let header = rows.next().unwrap_or_default();
    let mut text = line(header.each_ref().map(String::as_str)) + &line(dashes.each_ref().map(String::as_str));
    rows.for_each(|row| text += &line(row.each_ref().map(String::as_str)));
    text + "\r\n(1 row affected)\r\n\r\nCompletion time: 2026-06-01T12:00:00.1234567+02:00\r\n"
}

#[test]
fn a_ruler_of_dashes_says_where_cells_begin() {
    let example = example();
    let stamp = |t: f64| written("%Y-%m-%d %H:%M:%S%.3f", BEGIN as f64 + t);
    let pairs = || example.op.iter().zip(&example.pv).enumerate();
    let header = |names: [&str; 3]| std::iter::once(names.map(str::to_string));
    let wide = |missing: Option<usize>| {
        let rows = pairs().map(|(at, (op, pv))| {
            let pv = if missing == Some(at) { "NULL".into() } else { pv.value.to_string() };
            [stamp(op.t), op.value.to_string(), pv]
        });
        let text = ruled([23, 22, 22], header(["SampleTime", "OP", "PV"]).chain(rows));
        of_bytes(text.as_bytes(), &Options::default()).expect("a ruler")
    };
    let table = wide(None);
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
    assert!(table.found.read_as.contains("ruler"), "{}", table.found.read_as);
    let table = wide(Some(5));
    assert!(bits(&table.record)[0] == bits(&example)[0], "{}", table.found.read_as);
    assert!(!table.record.pv.iter().any(|own| own.t == table.record.op[5].t && own.quality.is_good()));

    // A name of a tag has a blank within.
    let long = pairs().flat_map(|(_, (op, pv))| {
        [("FIC 101.OP", op), ("FIC 101.PV", pv)]
            .map(|(tag, own)| [tag.into(), stamp(own.t), own.value.to_string()])
    });
    let text = ruled([20, 27, 22], header(["TagName", "DateTime", "Value"]).chain(long));
    let table = of_bytes(text.as_bytes(), &Options::default()).expect("a ruler");
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
}

#[test]
fn other_columns_are_told_and_text_is_not_used() {
    let rows = rows(&example(), ',', |t| format!("{t:.3}"));
    let rows: Vec<String> =
        rows.iter().enumerate().map(|(at, row)| format!("{row},{}.5,ok,", at % 7)).collect();
    let table = read("t,op,pv,TI100,remark,", &rows, &Options::default()).expect("read");
    let said = &table.found.read_as;
    assert!(said.contains(", other tags \"TI100\", not used \"remark\""), "{said}");
    assert_eq!(table.record.tags.len(), 1);
}

#[test]
fn steps_far_below_a_millisecond_are_asked_about() {
    let julian = rows(&example(), ',', |t| format!("{:.9}", t / 86_400.0 + 2_440_587.5));
    refused(read("t,OP,PV", &julian, &Options::default()), "too short for seconds");
}

#[test]
fn letters_of_several_zones_are_asked_for() {
    let example = example();
    let rows = rows(&example, ',', |t| written("%Y-%m-%d %H:%M:%S EST", t - 5.0 * 3600.0));
    refused(read("Time,OP,PV", &rows, &Options::default()), "--tz");
    let told = Options { tz: Some("-05:00".into()), ..Options::default() };
    let table = read("Time,OP,PV", &rows, &told).expect("told");
    assert_eq!(table.record.op[0].t, BEGIN as f64, "{}", table.found.read_as);
    assert!(bits(&table.record) == bits(&example));
}

#[test]
fn the_hour_that_comes_twice_is_known_by_the_zone_in_either_direction() {
    let example = example();
    let begin: jiff::Timestamp = "2026-10-25T00:40:00Z".parse().expect("a moment");
    let zone = jiff::tz::TimeZone::get("Europe/Berlin").expect("known");
    let first = rows(&example, ',', |t| {
        let moment = begin + jiff::SignedDuration::from_secs(t as i64 - BEGIN);
        moment.to_zoned(zone.clone()).strftime("%Y-%m-%d %H:%M:%S").to_string()
    });
    let newest_first: Vec<String> = first.iter().rev().cloned().collect();
    let told = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    for rows in [first, newest_first] {
        let table = read("Time,OP,PV", &rows, &told).expect("read");
        let times = table.record.op.iter().map(|sample| sample.t);
        let (least, most) = times.fold((f64::MAX, f64::MIN), |(a, b), t| (a.min(t), b.max(t)));
        assert_eq!(least, begin.as_second() as f64, "{}", table.found.read_as);
        let lasts = example.op[example.op.len() - 1].t - example.op[0].t;
        assert!((most - least - lasts).abs() < 2.0, "{} {lasts}", most - least);
    }
}

#[test]
fn a_row_of_loops_above_the_header_belongs_to_it() {
    let example = example();
    let two = |name: &str| {
        let other = |row: &String| {
            let cells: Vec<&str> = row.split(',').collect();
            format!("{row},{},{}", 100.0 - cells[1].parse::<f64>().expect("OP"), cells[2])
        };
        let header = match name {
            "merged" => ",FIC101,,FIC102,\nTime,OP,PV,OP,PV",
            "repeated" => ",FIC101,FIC101,FIC102,FIC102\nTime,OP,PV,OP,PV",
            "pandas" => ",FIC101,FIC101,FIC102,FIC102\n,OP,PV,OP,PV\nTime,,,,",
            _ => "Time,\"('FIC101', 'OP')\",\"('FIC101', 'PV')\",\"('FIC102', 'OP')\",\"('FIC102', 'PV')\"",
        };
        (header, rows(&example, ',', civil_of).iter().map(other).collect::<Vec<_>>())
    };
    for name in ["merged", "repeated", "pandas", "tuples"] {
        let (header, rows) = two(name);
        refused(read(header, &rows, &Options::default()), "may each be op; say which with --op NAME");
        let of = |id: &str| Options { of_loop: Some(id.into()), ..Options::default() };
        let table = read(header, &rows, &of("FIC101")).expect(name);
        assert!(bits(&table.record) == bits(&example), "{name}: {}", table.found.read_as);
        let other = read(header, &rows, &of("FIC102")).expect(name);
        assert_eq!(other.record.op[0].value, 100.0 - example.op[0].value, "{name}");
    }
}

#[test]
fn labview_says_where_its_properties_end() {
    let example = example();
    let rows = rows(&example, '\t', |t| format!("{:.6}", t - BEGIN as f64));
    let header = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDate\t2026/06/01\nTime\t06:00:00.0\n\
                  ***End_of_Header***\t\n\t\nChannels\t2\t\t\nDate\t2026/06/01\t2026/06/01\t\nTime\t06:00:00\t06:00:00\t\n\
                  X_Dimension\tTime\tTime\t\nX0\t0.0E+0\t0.0E+0\t\nDelta_X\t2.0\t2.0\t\n***End_of_Header***\t\t\t\n\
                  X_Value\tOP\tPV\tComment";
    let table = read(header, &rows, &Options::default()).expect("read");
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
}

#[test]
fn what_helps_is_said_where_a_form_is_not_read() {
    let example = example();
    let plain = Options::default();
    let compact = rows(&example, ',', |t| written("%y%m%d%H%M%S", t));
    refused(read("Time,OP,PV", &compact, &plain), "--time-format, such as %y%m%d%H%M%S");
    let told = Options { time_format: Some("%y%m%d%H%M%S".into()), ..Options::default() };
    assert!(bits(&read("Time,OP,PV", &compact, &told).expect("told").record) == bits(&example));
    let dates = rows(&example, ',', |t| written("%Y-%m-%d", t));
    refused(read("Date,OP,PV", &dates, &plain), "every row has the same date and no time of day");
    let quoted: Vec<String> = rows(&example, ',', civil_of).iter().map(|row| format!("\"{row}\"")).collect();
    refused(read("\"Time,OP,PV\"", &quoted, &plain), "each line stands in quotes as a whole");
    // A value that stands for none is left out and says nothing of the decimal sign.
    let mut none = rows(&example, ',', civil_of);
    let at = none[7].rfind(',').expect("PV") + 1;
    none[7].replace_range(at.., "1E+30");
    let table = read("Time,OP,PV", &none, &plain).expect("read");
    assert_eq!(table.record.pv.len(), example.pv.len());
}

/// `2026-06-01 06:00:02`.
fn civil_of(t: f64) -> String {
    written("%Y-%m-%d %H:%M:%S", t)
}

#[test]
fn rows_of_several_loops_are_told_apart_by_the_column_that_names_them() {
    let example = example();
    let both = |row: &String| {
        let (time, values) = row.split_once(',').expect("a time");
        [format!("{time},FIC101,{values}"), format!("{time},FIC102,50.0,30.0")]
    };
    let alternating: Vec<String> = rows(&example, ',', civil_of).iter().flat_map(both).collect();
    let mut stacked = alternating.clone();
    stacked.sort_by_key(|row| row.contains("FIC101"));
    for rows in [&alternating, &stacked] {
        for name in ["loop", "Asset", "Controller", "Tag"] {
            let header = format!("Time,{name},OP,PV");
            refused(
                read(&header, rows, &Options::default()),
                "rows of several loops, \"fic101\", \"fic102\": say which",
            );
            let of = |id: &str| Options { of_loop: Some(id.into()), ..Options::default() };
            let table = read(&header, rows, &of("fic101")).expect(name);
            assert!(bits(&table.record) == bits(&example), "{name}: {}", table.found.read_as);
            let other = read(&header, rows, &of("FIC102")).expect(name);
            assert!(other.record.op.len() == example.op.len() && other.record.op[9].value == 50.0);
            refused(read(&header, rows, &of("FIC9")), "names no such loop; there are \"fic101\", \"fic102\"");
        }
    }
}

#[test]
fn what_only_looks_like_op_a_comment_or_a_good_value_is_not_taken_for_it() {
    let example = example();
    let plain = Options::default();
    let least: Vec<String> = rows(&example, ',', civil_of);
    refused(read("Time,OP Min,PV Min", &least, &plain), "no column op");
    // A column too narrow for its times: they are told, and too many of them refused.
    let mut narrow = rows(&example, ',', civil_of);
    for row in narrow.iter_mut().step_by(4) {
        let at = row.find(',').expect("a time");
        row.replace_range(..at, "########");
    }
    refused(read("Time,OP,PV", &narrow, &plain), "########");
    // A name in Cyrillic, and OPC's numbers.
    for (header, good, bad) in
        [("Time,Качество,OP,PV", "good", "bad"), ("Time,Quality code,OP,PV", "192", "0")]
    {
        let mark = |(at, row): (usize, String)| {
            let (time, values) = row.split_once(',').expect("a time");
            format!("{time},{},{values}", if at % 50 == 7 { bad } else { good })
        };
        let marked: Vec<String> = rows(&example, ',', civil_of).into_iter().enumerate().map(mark).collect();
        let table = read(header, &marked, &plain).expect(header);
        let not_good = table.record.pv.iter().filter(|sample| !sample.quality.is_good()).count();
        assert_eq!(not_good, example.pv.len().div_ceil(50), "{header}");
    }
    // The zone in the header, as loggers write it.
    let hours = |header: &str| {
        let table = read(header, &rows(&example, ',', civil_of), &plain).expect(header);
        (table.record.op[0].t - BEGIN as f64).round() / 3600.0
    };
    assert_eq!(hours("\"Date Time, GMT+02:00\",OP,PV"), -2.0);
    assert_eq!(hours("Time UTC+02:00,OP,PV"), -2.0);
    assert_eq!(hours("Time (Europe/Berlin),OP,PV"), -2.0);
    // Volts are no per cent.
    let volts = read("Time,OP [V],PV", &rows(&example, ',', civil_of), &plain).expect("volts");
    assert_eq!(volts.record.op_span, None);
}

#[test]
fn times_of_pv_behind_it_are_no_times_of_op() {
    let example = example();
    let two = |row: String| {
        let (time, values) = row.split_once(',').expect("a time");
        format!("{time},{values},{}", time.replacen("2026", "2027", 1))
    };
    let rows: Vec<String> = rows(&example, ',', civil_of).into_iter().map(two).collect();
    for name in ["PV Time", "FIC101_PV_TIMESTAMP"] {
        refused(read(&format!("Time,OP,PV,{name}"), &rows, &Options::default()), "each tag has its own");
    }
    let table = read("Time,OP,PV,Archived", &rows, &Options::default()).expect("when it was written down");
    assert!(bits(&table.record) == bits(&example));
}

#[test]
fn a_recorder_has_its_tags_above_the_names_of_its_columns() {
    let example = example();
    let stamp =
        |t: f64| format!("{},{:03.0}", written("%Y/%m/%d,%H:%M:%S", t), (t.fract() * 100.0).round() * 10.0);
    let header = "\"Tag\",,,\"FIC101.OP\",\"FIC101.PV\"\n\"Unit\",,,\"%\",\"m3/h\"\n\"Date\",\"Time\",\"msec\",\"INST\",\"INST\"";
    let table = read(header, &rows(&example, ',', stamp), &Options::default()).expect("read");
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
    let off = table.record.op.iter().zip(&example.op).map(|(a, b)| (a.t - BEGIN as f64 - b.t).abs());
    assert!(off.fold(0.0, f64::max) < 0.006, "the milliseconds are read");
}
