//! What tables state of their times and of themselves beside the numbers: zones, formats, pages and sheets. It is used, or asked for.

use super::archive::archive;
use super::clocks::civil;
use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use std::fmt::Write as _;
use stictiond::table::{Options, Table};

fn plain() -> Options {
    Options::default()
}

fn zone(tz: &str) -> Options {
    Options { tz: Some(tz.into()), ..Options::default() }
}

fn iso(t: f64) -> String {
    civil("%Y-%m-%d %H:%M:%S", t)
}

fn refused(table: Result<Table, String>, by: &[&str]) {
    let said = table.map_or_else(|said| said, |table| table.found.read_as);
    by.iter().for_each(|by| assert!(said.contains(by), "{said:?} has no {by:?}"));
}

/// By how many hours the first time is later than it stands there in UTC.
fn hours(table: Result<Table, String>) -> f64 {
    let table = table.unwrap_or_else(|said| panic!("{said}"));
    (table.record.op[0].t - BEGIN as f64).round() / 3600.0
}

#[test]
fn words_in_the_header_that_may_be_a_zone_are_asked_for() {
    let own = rows(&example(), ';', iso);
    for header in [
        "Time (W. Europe Standard Time);OP;PV",
        "Timestamp ((UTC+01:00) Amsterdam, Berlin);OP;PV",
        "Time (Central European Time);OP;PV",
        "Time (GMT Standard Time);OP;PV",
        "Time [Eastern Standard Time];OP;PV",
    ] {
        refused(read(header, &own, &plain()), &["column 1", "--tz"]);
        assert_eq!(hours(read(header, &own, &zone("+02:00"))), -2.0, "{header}");
    }
    for header in ["Time (UTC);OP;PV", "Time (local time);OP;PV", "Time (GMT);OP;PV", "Time (ISO 8601);OP;PV"]
    {
        assert_eq!(hours(read(header, &own, &plain())), 0.0, "{header}");
    }
    // Where each time has its offset, the words say nothing more.
    let with: Vec<String> = own.iter().map(|row| row.replacen(';', "+02:00;", 1)).collect();
    assert_eq!(hours(read("Time (W. Europe Standard Time);OP;PV", &with, &plain())), -2.0);
}

#[test]
fn a_column_or_a_line_that_states_the_zone_is_used_or_asked_for() {
    let own = rows(&example(), ';', iso);
    let beside = |name: &str, zone: &str| {
        let rows: Vec<String> = own.iter().map(|row| format!("{row};{zone}")).collect();
        read(&format!("Time;OP;PV;{name}"), &rows, &plain())
    };
    assert_eq!(hours(beside("TimeZone", "Europe/Berlin")), -2.0);
    assert_eq!(hours(beside("UTC offset", "+02:00")), -2.0);
    assert_eq!(hours(beside("Time zone", "UTC")), 0.0);
    for (name, zone) in [("wwTimeZone", "W. Europe Standard Time"), ("UTC offset", "120"), ("TZ", "CST")] {
        refused(beside(name, zone), &["column 1 (Time)", "--tz"]);
    }
    // A temperature of that name is none.
    assert_eq!(hours(beside("TZ", "51.5")), 0.0);
    let turned: Vec<String> = own
        .iter()
        .enumerate()
        .map(|(at, row)| format!("{row};{}", if at < 900 { "+02:00" } else { "+01:00" }))
        .collect();
    refused(
        read("Time;OP;PV;UTC offset", &turned, &plain()),
        &["line 902", "\"+01:00\" where \"+02:00\"", "--tz"],
    );
    assert_eq!(hours(read("Time;OP;PV;UTC offset", &turned, &zone("UTC"))), 0.0);

    let comma = rows(&example(), ',', iso);
    for (line, shift) in [
        ("Time Zone,Europe/Berlin", -2.0),
        ("Timezone: UTC+02:00", -2.0),
        ("# timezone: America/Chicago", 5.0),
        ("Report,Trend\nTime zone:,Europe/Berlin\nUser:,me", -2.0),
        ("Time zone: UTC", 0.0),
    ] {
        assert_eq!(hours(read(&format!("{line}\n\nTime,OP,PV"), &comma, &plain())), shift, "{line}");
        assert_eq!(hours(read(&format!("{line}\n\nTime,OP,PV"), &comma, &zone("+01:00"))), -1.0, "{line}");
    }
    let windows = "Time zone: (UTC+01:00) Amsterdam, Berlin, Bern\n\nTime,OP,PV";
    refused(read(windows, &comma, &plain()), &["(UTC+01:00) Amsterdam, Berlin", "--tz"]);
    // The header itself says more of its times than a line above it.
    assert_eq!(hours(read("Time zone,Europe/Berlin\nTime (UTC),OP,PV", &comma, &plain())), 0.0);
}

#[test]
fn a_format_in_the_header_is_that_of_the_times() {
    let example = example();
    let clock = rows(&example, ',', |t| civil("%H:%M:%S", t));
    let table = read("Time (hh:mm:ss),OP,PV", &clock, &plain()).expect("times of day");
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
    // The first of June, or the sixth of January.
    let open = rows(&example, ',', |t| civil("%d/%m/%Y %H:%M:%S", t));
    refused(read("Timestamp,OP,PV", &open, &plain()), &["--time-format dmy or mdy"]);
    assert_eq!(hours(read("Timestamp (dd/mm/yyyy hh:mm:ss),OP,PV", &open, &plain())), 0.0);
    let months = hours(read("Timestamp (mm/dd/yyyy hh:mm:ss),OP,PV", &open, &plain()));
    assert!(months < -24.0 * 140.0, "2026-01-06: {months}");
    let told = Options { time_format: Some("dmy".into()), ..Options::default() };
    assert_eq!(hours(read("Timestamp (mm/dd/yyyy hh:mm:ss),OP,PV", &open, &told)), 0.0);
}

#[test]
fn hours_and_days_under_a_header_that_does_not_say_so_are_asked_for() {
    let row =
        |at: usize, of: f64, digits: usize| format!("{:.digits$},{}.5,51.25", at as f64 * of, 40 + at % 7);
    for (seconds, per, digits, word) in [
        (5.0, 3600.0, 6, "hours (then 5 s)"),
        (10.0, 3600.0, 5, "hours (then 10 s)"),
        (30.0, 3600.0, 5, "hours (then 30 s)"),
        (12.5, 3600.0, 6, "hours (then 12.5 s)"),
        (300.0, 86_400.0, 6, "days (then 300 s)"),
    ] {
        let rows: Vec<String> = (0..400).map(|at| row(at, seconds / per, digits)).collect();
        refused(read("Time,OP,PV", &rows, &plain()), &["may be seconds", word, "--time-unit"]);
    }
    // Steps of controllers are round.
    for step in [0.002, 0.005, 0.0125, 0.02, 0.25, 2.0] {
        let rows: Vec<String> = (0..400).map(|at| row(at, step, 4)).collect();
        let read = read("Time,OP,PV", &rows, &plain()).unwrap_or_else(|said| panic!("{step}: {said}"));
        let last = read.record.op[399].t;
        assert!((last - 399.0 * step).abs() < 1e-6, "{step}");
    }
}

#[test]
fn lines_of_pages_are_no_samples() {
    let example = example();
    let own = rows(&example, ',', iso);
    for line in ["Page 1,,", "Page 1 of 15", "Printed by me,,unit 10"] {
        let mut paged = Vec::new();
        for page in own.chunks(40) {
            paged.extend_from_slice(page);
            paged.push(line.to_string());
        }
        let table = read("Time,OP,PV", &paged, &plain()).unwrap_or_else(|said| panic!("{line}: {said}"));
        assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
        assert!(table.found.read_as.contains("30 rows left out"), "{}", table.found.read_as);
    }
    // The same where the rows without a time are counted once more: beside a zone that changes its clock, and parts of a second.
    let paged = |own: &[String], line: &str| -> Vec<String> {
        own.chunks(40).flat_map(|page| page.iter().cloned().chain([line.to_string()])).collect()
    };
    // 2026-10-25: clocks go back from 3 to 2 in Central Europe, at 1 UTC.
    let local = rows(&example, ',', |t| {
        let t = t - BEGIN as f64 + 1_792_889_400.0;
        iso(t + if t < 1_792_890_000.0 { 7200.0 } else { 3600.0 })
    });
    let millis: Vec<String> = rows(&example, ',', |t| format!("{},{:.0}", iso(t), (t - t.floor()) * 900.0));
    for (header, own, line, options) in [
        ("Time,OP,PV", &local, "Page 1,,", zone("Europe/Berlin")),
        ("DateTime,Millitm,OP,PV", &millis, "Page 1,,,", plain()),
    ] {
        let table = read(header, own, &options).unwrap_or_else(|said| panic!("{header}: {said}"));
        let with_pages = read(header, &paged(own, line), &options);
        let with_pages = with_pages.unwrap_or_else(|said| panic!("{header} with pages: {said}"));
        assert!(with_pages.record.op == table.record.op, "{}", with_pages.found.read_as);
    }
    // Averages have numbers, and may be samples of something.
    let mut averages = Vec::new();
    for page in own.chunks(40) {
        averages.extend_from_slice(page);
        averages.push("Average,51.0,51.0".to_string());
    }
    refused(
        read("Time,OP,PV", &averages, &plain()),
        &["\"Average\" is no time", "more than one row in fifty"],
    );
}

#[test]
fn a_number_behind_a_date_is_named() {
    let of_day = rows(&example(), ',', |t| format!("{},{:.0}", civil("%d.%m.%Y", t), t.rem_euclid(86_400.0)));
    refused(read("Date,Time,OP,PV", &of_day, &plain()), &["21600 behind 01.06.2026", "seconds of the day"]);
}

/// A workbook of sheets of text and numbers.
fn book(sheets: &[(&str, Vec<Vec<String>>)]) -> Vec<u8> {
    const MAIN: &str = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    const RELATIONS: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
    let types = "<Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\
                 <Default Extension=\"xml\" ContentType=\"application/xml\"/></Types>";
    let root = format!(
        "<Relationships xmlns=\"{PACKAGE}\"><Relationship Id=\"rId1\" Type=\"{RELATIONS}/officeDocument\" \
         Target=\"xl/workbook.xml\"/></Relationships>"
    );
    let (mut listed, mut related, mut parts) = (String::new(), String::new(), Vec::new());
    for (at, (name, rows)) in sheets.iter().enumerate() {
        let k = at + 1;
        // Writing into a String cannot fail.
        let _ = write!(listed, "<sheet name=\"{name}\" sheetId=\"{k}\" r:id=\"rId{k}\"/>");
        let _ = write!(
            related,
            "<Relationship Id=\"rId{k}\" Type=\"{RELATIONS}/worksheet\" Target=\"worksheets/sheet{k}.xml\"/>"
        );
        let mut text = String::new();
        for (row, cells) in rows.iter().enumerate() {
            let row = row + 1;
            let _ = write!(text, "<row r=\"{row}\">");
            for (cell, letter) in cells.iter().zip('A'..) {
                let _ = match cell.parse::<f64>() {
                    Ok(_) => write!(text, "<c r=\"{letter}{row}\"><v>{cell}</v></c>"),
                    Err(_) => {
                        write!(text, "<c r=\"{letter}{row}\" t=\"inlineStr\"><is><t>{cell}</t></is></c>")
                    }
                };
            }
            text += "</row>";
        }
        let sheet = format!("<worksheet xmlns=\"{MAIN}\"><sheetData>{text}</sheetData></worksheet>");
        parts.push((format!("xl/worksheets/sheet{k}.xml"), sheet));
    }
    let workbook =
        format!("<workbook xmlns=\"{MAIN}\" xmlns:r=\"{RELATIONS}\"><sheets>{listed}</sheets></workbook>");
    let relations = format!("<Relationships xmlns=\"{PACKAGE}\">{related}</Relationships>");
    let mut files = vec![
        ("[Content_Types].xml", types),
        ("_rels/.rels", root.as_str()),
        ("xl/workbook.xml", workbook.as_str()),
        ("xl/_rels/workbook.xml.rels", relations.as_str()),
    ];
    files.extend(parts.iter().map(|(name, text)| (name.as_str(), text.as_str())));
    archive(&files)
}

#[test]
fn the_only_sheet_with_op_and_pv_is_taken() {
    let example = example();
    let table = |names: [&str; 3], columns: [usize; 3]| -> Vec<Vec<String>> {
        let row = |at: usize| [example.op[at].t, example.op[at].value, example.pv[at].value];
        let cells = |at: usize| columns.map(|column| row(at)[column].to_string()).to_vec();
        let header = names.map(str::to_string).to_vec();
        [header].into_iter().chain((0..example.op.len()).map(cells)).collect()
    };
    let info = vec![vec!["Unit".to_string(), "10".into()], vec!["Exported by".to_string(), "me".into()]];
    let data = table(["t", "op", "pv"], [0, 1, 2]);
    let read = |book: &[u8]| of_bytes(book, &Options::default());
    let found = read(&book(&[("Info", info), ("Data", data)])).unwrap_or_else(|said| panic!("{said}"));
    assert!(bits(&found.record) == bits(&example), "{}", found.found.read_as);
    assert!(found.found.read_as.starts_with("sheet \"Data\""), "{}", found.found.read_as);
    let apart = [("OP", table(["t", "op", "x"], [0, 1, 1])), ("PV", table(["t", "pv", "x"], [0, 2, 2]))];
    refused(read(&book(&apart)), &["\"OP\", \"PV\", and none has both OP and PV", "--sheet"]);
}
