//! Sheets of Excel and OpenDocument.

use super::archive::archive;
use super::clocks::civil;
use super::dress::BEGIN;
use super::xls::{LAST, compound_of, number, record, stream_of, told_text};
use super::{bits, example, of_bytes};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};
use stictiond::signal::Record;
use stictiond::table::Options;

/// Days as spreadsheets count them.
fn serial(t: f64) -> f64 {
    (BEGIN as f64 + t) / 86_400.0 + 25_569.0
}

/// A sheet of Excel: a title, the names, and numbers with dates in the first column.
fn xlsx(record: &Record, sheets: &[&str]) -> Vec<u8> {
    xlsx_of(record, sheets, "s=\"1\"", "")
}

/// The same, with the style of the cells of times and the properties of the workbook.
fn xlsx_of(record: &Record, sheets: &[&str], style: &str, properties: &str) -> Vec<u8> {
    let mut rows = String::from(
        "<row r=\"1\"><c r=\"A1\" t=\"inlineStr\"><is><t>Trend of unit 10</t></is></c></row>\
         <row r=\"3\"><c r=\"A3\" t=\"inlineStr\"><is><t>Time</t></is></c><c r=\"B3\" t=\"inlineStr\"><is><t>OP %</t></is></c>\
         <c r=\"C3\" t=\"inlineStr\"><is><t>PV</t></is></c></row>",
    );
    for (k, (op, pv)) in record.op.iter().zip(&record.pv).enumerate() {
        let row = k + 4;
        // Writing into a String cannot fail.
        let _ = write!(
            rows,
            "<row r=\"{row}\"><c r=\"A{row}\" {style}><v>{}</v></c><c r=\"B{row}\"><v>{}</v></c><c r=\"C{row}\"><v>{}</v></c></row>",
            serial(op.t),
            op.value,
            pv.value
        );
    }
    const MAIN: &str = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    const RELATIONS: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
    let sheet = format!("<worksheet xmlns=\"{MAIN}\"><sheetData>{rows}</sheetData></worksheet>");
    let (mut listed, mut related) = (String::new(), String::new());
    for (k, name) in sheets.iter().enumerate() {
        let _ = write!(listed, "<sheet name=\"{name}\" sheetId=\"{}\" r:id=\"rId{}\"/>", k + 1, k + 1);
        let _ = write!(
            related,
            "<Relationship Id=\"rId{}\" Type=\"{RELATIONS}/worksheet\" Target=\"worksheets/sheet1.xml\"/>",
            k + 1
        );
    }
    let _ = write!(related, "<Relationship Id=\"rIdS\" Type=\"{RELATIONS}/styles\" Target=\"styles.xml\"/>");
    archive(&[
        (
            "[Content_Types].xml",
            "<Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\
             <Default Extension=\"xml\" ContentType=\"application/xml\"/></Types>",
        ),
        (
            "_rels/.rels",
            &format!(
                "<Relationships xmlns=\"{PACKAGE}\"><Relationship Id=\"rId1\" Type=\"{RELATIONS}/officeDocument\" \
                 Target=\"xl/workbook.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/workbook.xml",
            &format!(
                "<workbook xmlns=\"{MAIN}\" xmlns:r=\"{RELATIONS}\">{properties}<sheets>{listed}</sheets></workbook>"
            ),
        ),
        (
            "xl/_rels/workbook.xml.rels",
            &format!("<Relationships xmlns=\"{PACKAGE}\">{related}</Relationships>"),
        ),
        (
            "xl/styles.xml",
            &format!(
                "<styleSheet xmlns=\"{MAIN}\"><cellXfs count=\"2\"><xf numFmtId=\"0\"/><xf numFmtId=\"22\"/></cellXfs></styleSheet>"
            ),
        ),
        ("xl/worksheets/sheet1.xml", &sheet),
    ])
}

/// A cell of text of OpenDocument.
fn ods_text(text: &str) -> String {
    format!("<table:table-cell office:value-type=\"string\"><text:p>{text}</text:p></table:table-cell>")
}

/// A number of OpenDocument.
fn ods_number(value: f64) -> String {
    format!(
        "<table:table-cell office:value-type=\"float\" office:value=\"{value}\"><text:p>{value}</text:p></table:table-cell>"
    )
}

/// A date or a time of OpenDocument, as LibreOffice keeps it.
fn ods_value(kind: &str, value: &str) -> String {
    format!(
        "<table:table-cell office:value-type=\"{kind}\" office:{kind}-value=\"{value}\"><text:p>{value}</text:p></table:table-cell>"
    )
}

/// A sheet of OpenDocument, times as numbers.
fn ods(record: &Record) -> Vec<u8> {
    ods_of(&["t"], record, ods_number)
}

/// A sheet of OpenDocument with these columns of times, the cells of which `times` makes of seconds since the begin.
fn ods_of(names: &[&str], record: &Record, times: impl Fn(f64) -> String) -> Vec<u8> {
    let row = |cells: String| format!("<table:table-row>{cells}</table:table-row>");
    let mut rows = row([names, &["op", "pv"]].concat().into_iter().map(ods_text).collect());
    for (op, pv) in record.op.iter().zip(&record.pv) {
        rows += &row([times(op.t), ods_number(op.value), ods_number(pv.value)].concat());
    }
    let content = format!(
        "<office:document-content xmlns:office=\"urn:oasis:names:tc:opendocument:xmlns:office:1.0\" \
         xmlns:table=\"urn:oasis:names:tc:opendocument:xmlns:table:1.0\" \
         xmlns:text=\"urn:oasis:names:tc:opendocument:xmlns:text:1.0\"><office:body><office:spreadsheet>\
         <table:table table:name=\"Trend\">{rows}</table:table></office:spreadsheet></office:body></office:document-content>"
    );
    archive(&[
        ("mimetype", "application/vnd.oasis.opendocument.spreadsheet"),
        (
            "META-INF/manifest.xml",
            "<manifest:manifest xmlns:manifest=\"urn:oasis:names:tc:opendocument:xmlns:manifest:1.0\"/>",
        ),
        ("content.xml", &content),
    ])
}

#[test]
fn sheets_of_excel_are_read_with_their_dates() {
    let example = example();
    let found = of_bytes(&xlsx(&example, &["Trend"]), &Options::default()).expect("a workbook");
    assert!(bits(&found.record) == bits(&example));
    let off = found
        .record
        .op
        .iter()
        .zip(&example.op)
        .map(|(a, b)| (a.t - BEGIN as f64 - b.t).abs())
        .fold(0.0, f64::max);
    assert!(off < 1e-6, "times are off by {off} s");
    assert_eq!(found.record.op_span, Some(100.0));
    assert!(
        found.found.read_as.starts_with("workbook, time as stamps (UTC), op from \"OP %\" [%]"),
        "{}",
        found.found.read_as
    );
}

/// A workbook of Excel 97, as xlwt writes it.
fn xls(record: &Record) -> Vec<u8> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = root.join("target/peers-venv/bin/python");
    assert!(python.exists(), "there are no peers: run scripts/peers once, then the tests again");
    let mut writer = Command::new(python)
        .arg(root.join("tests/peers/xls_writer.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("starts");
    let mut rows = String::new();
    for (op, pv) in record.op.iter().zip(&record.pv) {
        // Writing into a String cannot fail.
        let _ = writeln!(rows, "{},{},{}", BEGIN as f64 + op.t, op.value, pv.value);
    }
    // All is taken before anything is said.
    writer.stdin.take().expect("a pipe").write_all(rows.as_bytes()).expect("it listens");
    let said = writer.wait_with_output().expect("ends");
    assert!(said.status.success());
    said.stdout
}

#[test]
fn sheets_of_excel_97_are_read_with_their_dates() {
    let example = example();
    let book = xls(&example);
    let found = of_bytes(&book, &Options::default()).expect("a workbook");
    assert!(bits(&found.record) == bits(&example));
    let off = found.record.op.iter().zip(&example.op).map(|(a, b)| (a.t - BEGIN as f64 - b.t).abs());
    assert!(off.fold(0.0, f64::max) < 1e-3);
    assert!(found.found.read_as.starts_with("workbook, time as stamps (UTC)"), "{}", found.found.read_as);
    for cut in [10, 600, book.len() / 2, book.len() - 600] {
        let said = of_bytes(&book[..cut], &Options::default()).expect_err("cut");
        assert!(said.contains("workbook"), "{said}");
    }
}

/// Days from 1904: by the format of a date they are known, as bare numbers they are refused.
#[test]
fn days_since_1904_are_not_taken_for_days_since_1900() {
    let example = example();
    let book = |style: &str, date_1904: &str| {
        xlsx_of(&example, &["Trend"], style, &format!("<workbookPr date1904=\"{date_1904}\"/>"))
    };
    for date_1904 in ["1", "true"] {
        let said = of_bytes(&book("", date_1904), &Options::default()).expect_err("bare numbers");
        assert!(said.contains("counts them from 1904"), "{said}");
    }
    let t = |book: Vec<u8>| of_bytes(&book, &Options::default()).expect("dates").record.op[0].t;
    assert_eq!((t(book("s=\"1\"", "1")) - t(book("s=\"1\"", "0"))).round(), 1462.0 * 86_400.0);
    assert!((t(book("", "0")) - t(book("s=\"1\"", "0"))).abs() < 1e-3);
}

/// The same for Excel 97, whose workbooks say it in a record of their own.
#[test]
fn days_since_1904_in_an_excel_97_workbook_are_not_taken_for_days_since_1900() {
    const DATE_MODE: u16 = 0x0022;
    let example = example();
    let names = (0u16..).zip(["Time", "OP %", "PV"]);
    let mut sheet: Vec<u8> =
        names.flat_map(|(column, name)| told_text(0, column, name.len() as u16, name)).collect();
    for (row, (op, pv)) in (1u16..).zip(example.op.iter().zip(&example.pv)) {
        for (column, value) in (0u16..).zip([serial(op.t), op.value, pv.value]) {
            sheet.extend(number(row, column, value));
        }
    }
    let read = |mode: u16| {
        let stream = stream_of(&|_| record(DATE_MODE, &mode.to_le_bytes()), &sheet);
        of_bytes(&compound_of("Workbook", &stream, LAST), &Options::default())
    };
    let said = read(1).expect_err("bare numbers");
    assert!(said.contains("counts them from 1904"), "{said}");
    let found = read(0).expect("days since 1900");
    assert!(bits(&found.record) == bits(&example));
    assert!((found.record.op[0].t - BEGIN as f64 - example.op[0].t).abs() < 1e-3);
}

#[test]
fn one_of_several_sheets_is_named() {
    let book = xlsx(&example(), &["First", "Second"]);
    let said = of_bytes(&book, &Options::default()).expect_err("two sheets");
    assert_eq!(said, "several sheets hold tables, \"First\", \"Second\": say which with --sheet");
    let sheet = |name: &str| of_bytes(&book, &Options { sheet: Some(name.into()), ..Options::default() });
    assert!(sheet("second").expect("named").found.read_as.starts_with("sheet \"Second\""));
    assert!(sheet("Third").expect_err("none").contains("no sheet \"Third\" (--sheet)"));
}

#[test]
fn sheets_of_open_document_are_read() {
    let example = example();
    let found = of_bytes(&ods(&example), &Options::default()).expect("a workbook");
    assert!(bits(&found.record) == bits(&example));
    assert!(found.record.op.iter().zip(&example.op).all(|(a, b)| a.t == b.t));
}

/// `PT06H00M02.030000000S` of seconds since midnight.
fn duration(seconds: f64) -> String {
    let ms = (seconds * 1e3).round() as i64;
    let (h, m, s, part) = (ms / 3_600_000, ms / 60_000 % 60, ms / 1000 % 60, ms % 1000);
    format!("PT{h:02}H{m:02}M{s:02}.{part:03}000000S")
}

#[test]
fn dates_times_and_durations_of_open_document_are_read() {
    let example = example();
    let off = |book: &[u8], begin: f64| -> (f64, String) {
        let table = of_bytes(book, &Options::default()).unwrap_or_else(|said| panic!("{said}"));
        assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
        let off = table.record.op.iter().zip(&example.op).map(|(a, b)| (a.t - begin - b.t).abs());
        (off.fold(0.0, f64::max), table.found.read_as)
    };
    let six = 6.0 * 3600.0;
    let moment = |t: f64| ods_value("date", &civil("%Y-%m-%dT%H:%M:%S%.3f", BEGIN as f64 + t));
    let apart = |t: f64| ods_value("date", "2026-06-01") + &ods_value("time", &duration(six + t));
    // Whoever types a date may leave it text.
    let typed = |t: f64| ods_text("2026-06-01") + &ods_value("time", &duration(six + t));
    for (what, book) in [
        ("moments", ods_of(&["Time"], &example, moment)),
        ("apart", ods_of(&["Date", "Time"], &example, apart)),
        ("typed", ods_of(&["Date", "Time"], &example, typed)),
    ] {
        let (off, said) = off(&book, BEGIN as f64);
        assert!(off < 1e-3, "{what}: {off} s: {said}");
    }
    for (hours, said) in [(6.0, "time of day without a date"), (30.0, "time since the start")] {
        let clock = |t: f64| ods_value("time", &duration(hours * 3600.0 + t));
        let (off, read_as) = off(&ods_of(&["Time"], &example, clock), hours * 3600.0);
        assert!(off < 1e-3 && read_as.contains(said), "{hours} h: {off} s: {read_as}");
    }
}

#[test]
fn a_damaged_workbook_is_refused() {
    let book = xlsx(&example(), &["Trend"]);
    for cut in [10, 200, book.len() / 2, book.len() - 30] {
        let said = of_bytes(&book[..cut], &Options::default()).expect_err("cut");
        assert!(said.contains("workbook"), "{said}");
    }
}
