//! How much memory it takes to read a workbook, as the allocator counts it for the whole process: so this is one test, in a process
//! of its own. The workbooks are as dense as their kind can be, and are read; or they would take far more than their bytes, and are
//! refused. Neither takes more than is allowed. `cargo nextest run --test workbook_memory --no-capture` prints a row for each.

#[path = "exports/archive.rs"]
mod archive;
#[path = "exports/packed.rs"]
mod packed;
#[path = "exports/xls.rs"]
mod xls;
#[path = "exports/xlsb_records.rs"]
mod xlsb_records;

use archive::archive;
use packed::packed;
use peak_alloc::PeakAlloc;
use std::hint::black_box;
use stictiond::table::{Options, Source, read};
use xls::{LAST, cell, compound_of, number, record, shared_text, stream_of, texts, told_text};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// The most memory that docs/tables.md says reading a workbook of so many bytes takes, with buffers and room for cells (bytes).
fn memory_limit(file_bytes: usize) -> usize {
    (64 * file_bytes).clamp(16_000_000, 1 << 31) + (64 << 20)
}

/// Samples of most workbooks here: enough for a file of a megabyte.
const ROWS: u32 = 20_000;
const NAMES: [&str; 3] = ["t", "op", "pv"];

/// The numbers of a row.
fn numbers(row: u32) -> [u32; 3] {
    [row, 40 + row * 7 % 13, 60 + row * 5 % 11]
}

/// Does something; the most memory that it held at once, beyond what was held before (bytes).
fn most_held<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    let done = work();
    (done, MEMORY.peak_usage().saturating_sub(before))
}

/// Reads a workbook with a record of so many samples, or one that is refused for the memory that it would take.
fn holds(what: &str, book: &[u8], samples: Option<u32>) {
    let (found, most) = most_held(|| read(Source::Bytes(book), &Options::default()));
    let limit = memory_limit(book.len());
    let megabytes = |bytes: usize| bytes as f64 * 1e-6;
    println!(
        "{what:<40} {:>6.2} MB of file {:>7.1} MB held {:>7.1} MB allowed, {}",
        megabytes(book.len()),
        megabytes(most),
        megabytes(limit),
        if samples.is_some() { "read" } else { "refused" }
    );
    match (found, samples) {
        (Ok(table), Some(samples)) => assert_eq!(table.record.op.len(), samples as usize, "{what}"),
        (Ok(_), None) => panic!("{what}: it is read"),
        (Err(error), Some(_)) => panic!("{what}: {error}"),
        (Err(error), None) => {
            let said = error.to_string();
            assert!(said.contains("bytes of memory") && said.contains("as CSV"), "{what}: {said}");
        }
    }
    assert!(most <= limit, "{what}: {most} bytes are held, and {limit} are allowed");
}

#[test]
fn reading_a_workbook_takes_no_more_memory_than_its_bytes_allow() {
    // A count that does not grow would hold any bound.
    let (_, counted) = most_held(|| black_box(vec![1_u8; 3 << 20]).len());
    assert!((3 << 20..4 << 20).contains(&counted), "{counted}");
    excel_97();
    excel_binary();
    excel();
    open_document();
}

/// A workbook of Excel 97 with these names of columns, records before its sheet, and cells.
fn of_excel_97(names: &[(u16, &str)], before: &[u8], cells: &[u8]) -> Vec<u8> {
    let columns = [0, names.len() as u16, 0].map(u16::to_le_bytes).concat();
    let size = record(0x0200, &[[0, ROWS + 1].map(u32::to_le_bytes).concat(), columns].concat());
    let names = names.iter().flat_map(|(column, name)| told_text(0, *column, name.len() as u16, name));
    let sheet: Vec<u8> = size.into_iter().chain(names).chain(cells.iter().copied()).collect();
    compound_of("Workbook", &stream_of(&|_| before.to_vec(), &sheet), LAST)
}

/// An integer as Excel 97 packs it.
fn packed_number(value: u32) -> [u8; 4] {
    ((value << 2) | 2).to_le_bytes()
}

/// The numbers of a row in one record, from the first column on.
fn one_record(row: u32, numbers: &[u32]) -> Vec<u8> {
    let place = [row as u16 + 1, 0].map(u16::to_le_bytes).concat();
    let numbers: Vec<u8> =
        numbers.iter().flat_map(|value| [0, 0].into_iter().chain(packed_number(*value))).collect();
    let last = (numbers.len() / 6) as u16 - 1;
    record(0x00bd, &[&place[..], &numbers[..], &last.to_le_bytes()[..]].concat())
}

fn excel_97() {
    let names: Vec<(u16, &str)> = (0..).zip(NAMES).collect();
    let with = |column: u16, name: &'static str| [&names[..], &[(column, name)][..]].concat();
    let of_rows = |cells: &dyn Fn(u32) -> Vec<u8>| (0..ROWS).flat_map(cells).collect::<Vec<u8>>();
    let tags: Vec<String> = (3..12).map(|column| format!("TI1{column:02}")).collect();
    let twelve: Vec<(u16, &str)> =
        names.iter().copied().chain((3..).zip(tags.iter().map(String::as_str))).collect();
    let dense = of_rows(&|row: u32| {
        let tags: Vec<u32> = (3..12).map(|column| 10 + row * column % 97).collect();
        one_record(row, &[&numbers(row)[..], &tags[..]].concat())
    });
    holds(".xls, twelve numbers in a record", &of_excel_97(&twelve, &[], &dense), Some(ROWS));
    let single = |one: &dyn Fn(u16, u16, u32) -> Vec<u8>| {
        of_rows(&|row: u32| {
            (0..).zip(numbers(row)).flat_map(|(column, value)| one(row as u16 + 1, column, value)).collect()
        })
    };
    let doubles = single(&|row, column, value| number(row, column, f64::from(value)));
    holds(".xls, doubles", &of_excel_97(&names, &[], &doubles), Some(ROWS));
    let integers = single(&|row, column, value| cell(0x027e, row, column, &packed_number(value)));
    holds(".xls, integers", &of_excel_97(&names, &[], &integers), Some(ROWS));
    holds(".xls, thirteen blank columns", &of_excel_97(&with(15, "remark"), &[], &doubles), Some(ROWS));
    holds(".xls, a cell far from the others", &of_excel_97(&with(255, "remark"), &[], &doubles), None);
    // Two thousand texts of a letter in each part.
    let letters = b"\x01\0\0a".repeat(2000);
    let tiny = texts(&[letters.as_slice(); 150]);
    holds(".xls, 300,000 shared texts", &of_excel_97(&names, &tiny, &integers), Some(ROWS));
    let text = [&8000u16.to_le_bytes()[..], &[0][..], &[b'x'; 8000][..]].concat();
    let long = texts(&[text.as_slice()]);
    let cells =
        of_rows(&|row: u32| [one_record(row, &numbers(row)), shared_text(row as u16 + 1, 3, 0)].concat());
    holds(".xls, cells that share a long text", &of_excel_97(&with(3, "remark"), &long, &cells), None);
}

const OFFICE: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";

/// The list of parts that leads to one.
fn leads_to(kind: &str, target: &str) -> String {
    format!(
        "<Relationships xmlns=\"{PACKAGE}\"><Relationship Id=\"r\" Type=\"{OFFICE}/{kind}\" Target=\"{target}\"/></Relationships>"
    )
}

/// The parts of an `.xlsb` with so many shared texts of a letter, and rows.
fn of_excel_binary(texts: u32, rows: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    use xlsb_records::{record, wide};
    let text = |column: u32, text: &str| {
        record(6, &[&[column, 0].map(u32::to_le_bytes).concat()[..], &wide(text)[..]].concat())
    };
    let names: Vec<u8> = (0..).zip(NAMES).flat_map(|(column, name)| text(column, name)).collect();
    let sheet =
        [record(0x94, &[0; 16]), record(0x91, &[]), record(0, &[0; 4]), names, rows.to_vec()].concat();
    let one = record(0x13, &[&[0][..], &wide("a")[..]].concat());
    let texts =
        [record(0x9f, &[texts; 2].map(u32::to_le_bytes).concat()), one.repeat(texts as usize)].concat();
    let listed = [&[0, 1].map(u32::to_le_bytes).concat()[..], &wide("r")[..], &wide("S")[..]].concat();
    let book = [record(0x9c, &listed), record(0x90, &[]), record(0x9d, &[])].concat();
    vec![
        ("[Content_Types].xml", b"<Types/>".to_vec()),
        ("xl/workbook.bin", book),
        ("xl/_rels/workbook.bin.rels", leads_to("worksheet", "worksheets/sheet1.bin").into_bytes()),
        ("xl/sharedStrings.bin", [texts, record(0xa0, &[])].concat()),
        ("xl/worksheets/sheet1.bin", [sheet, record(0x92, &[])].concat()),
    ]
}

/// The parts in an archive, compressed.
fn packed_parts<B: AsRef<[u8]>>(parts: &[(&str, B)]) -> Vec<u8> {
    packed(&parts.iter().map(|(name, bytes)| (*name, bytes.as_ref())).collect::<Vec<_>>())
}

fn excel_binary() {
    use xlsb_records::record;
    let cell = |column: u32, value: u32| {
        record(
            5,
            &[&[column, 0].map(u32::to_le_bytes).concat()[..], &f64::from(value).to_le_bytes()[..]].concat(),
        )
    };
    let row = |row: u32| {
        let cells = (0..).zip(numbers(row)).flat_map(|(column, value)| cell(column, value));
        record(0, &(row + 1).to_le_bytes()).into_iter().chain(cells).collect::<Vec<u8>>()
    };
    let rows: Vec<u8> = (0..ROWS).flat_map(row).collect();
    holds(".xlsb, doubles", &packed_parts(&of_excel_binary(0, &rows)), Some(ROWS));
    holds(".xlsb, 100,000 shared texts", &packed_parts(&of_excel_binary(100_000, &rows)), Some(ROWS));
    holds(".xlsb, 600,000 shared texts", &packed_parts(&of_excel_binary(600_000, &rows)), None);
}

/// The parts of an `.xlsx` with these shared texts, and rows.
fn of_excel(texts: &str, rows: &str) -> Vec<(&'static str, String)> {
    const MAIN: &str = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    let names = NAMES.map(|name| format!("<c t=\"inlineStr\"><is><t>{name}</t></is></c>")).concat();
    vec![
        ("[Content_Types].xml", "<Types/>".into()),
        ("_rels/.rels", leads_to("officeDocument", "xl/workbook.xml")),
        (
            "xl/workbook.xml",
            format!(
                "<workbook xmlns=\"{MAIN}\" xmlns:r=\"{OFFICE}\"><sheets><sheet name=\"S\" sheetId=\"1\" r:id=\"r\"/></sheets></workbook>"
            ),
        ),
        ("xl/_rels/workbook.xml.rels", leads_to("worksheet", "worksheets/sheet1.xml")),
        ("xl/sharedStrings.xml", format!("<sst xmlns=\"{MAIN}\">{texts}</sst>")),
        (
            "xl/worksheets/sheet1.xml",
            format!(
                "<worksheet xmlns=\"{MAIN}\"><sheetData><row>{names}</row>{rows}</sheetData></worksheet>"
            ),
        ),
    ]
}

fn excel() {
    let cells = |row: u32| numbers(row).map(|value| format!("<c><v>{value}</v></c>")).concat();
    let of_rows =
        |beside: &str| (0..ROWS).map(|row| format!("<row>{}{beside}</row>", cells(row))).collect::<String>();
    let rows = of_rows("");
    holds(".xlsx, numbers", &packed_parts(&of_excel("", &rows)), Some(ROWS));
    let text = "<si><t>a</t></si>";
    let many = of_excel(&text.repeat(250_000), &rows);
    holds(".xlsx, 250,000 shared texts", &packed_parts(&many), None);
    let stored: Vec<(&str, &str)> = many.iter().map(|(name, text)| (*name, text.as_str())).collect();
    holds(".xlsx, as many in a file that is not packed", &archive(&stored), Some(ROWS));
    let long = format!("<si><t>{}</t></si>", "x".repeat(8000));
    let sharing = of_excel(&long, &of_rows("<c t=\"s\"><v>0</v></c>"));
    holds(".xlsx, cells that share a long text", &packed_parts(&sharing), None);
    // Numbers of many digits in column T, with blank cells before them.
    let far = |row: u32| {
        let digits = row.wrapping_mul(2_654_435_761);
        let number = format!("{}.{:06}", digits % 1000, digits / 1000 % 1_000_000);
        format!("<row>{}<c r=\"T{}\"><v>{number}</v></c></row>", cells(row), row + 2)
    };
    let mut sparse = of_excel("", &(0..ROWS).map(far).collect::<String>());
    for (_, text) in &mut sparse {
        let name = "<c r=\"T1\" t=\"inlineStr\"><is><t>remark</t></is></c></row>";
        *text = text.replacen("</row>", name, 1);
    }
    holds(".xlsx, blank cells before column T", &packed_parts(&sparse), Some(ROWS));
    // A cell in the last column that is read.
    let far = |row: u32| format!("<row><c r=\"FAN{row}\"><v>1</v></c></row>");
    let wide = of_excel("", &(rows + &(ROWS + 2..ROWS + 302).map(far).collect::<String>()));
    holds(".xlsx, rows with a cell far from the first", &packed_parts(&wide), None);
}

fn open_document() {
    const OPEN: &str = "urn:oasis:names:tc:opendocument:xmlns";
    const SAMPLES: u32 = 5000;
    let spaces =
        ["office", "table", "text"].map(|name| format!(" xmlns:{name}=\"{OPEN}:{name}:1.0\"")).concat();
    let text = |text: &str| {
        format!("<table:table-cell office:value-type=\"string\"><text:p>{text}</text:p></table:table-cell>")
    };
    let number = |value: u32| {
        format!(
            "<table:table-cell office:value-type=\"float\" office:value=\"{value}\"><text:p>{value}</text:p></table:table-cell>"
        )
    };
    let row = |cells: String| format!("<table:table-row>{cells}</table:table-row>");
    let rows: String = (0..SAMPLES).map(|at| row(numbers(at).map(number).concat())).collect();
    let rows = row(NAMES.map(text).concat()) + &rows;
    let of_rows = |rows: &str| {
        let content = format!(
            "<office:document-content{spaces}><office:body><office:spreadsheet><table:table table:name=\"S\">{rows}</table:table>\
             </office:spreadsheet></office:body></office:document-content>"
        );
        let manifest = format!("<manifest:manifest xmlns:manifest=\"{OPEN}:manifest:1.0\"/>");
        packed_parts(&[
            ("mimetype", "application/vnd.oasis.opendocument.spreadsheet"),
            ("META-INF/manifest.xml", manifest.as_str()),
            ("content.xml", content.as_str()),
        ])
    };
    holds(".ods, numbers", &of_rows(&rows), Some(SAMPLES));
    let repeated = number(1).repeat(9);
    let repeated =
        format!("<table:table-row table:number-rows-repeated=\"200000\">{repeated}</table:table-row>");
    holds(".ods, rows that are repeated", &of_rows(&(rows + &repeated)), None);
}
