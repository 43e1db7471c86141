//! Workbooks that are small and would fill the memory, or never end, and sound ones that look like them.

use super::archive::{Part, archive, of_parts};
use super::of_bytes;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use std::io::Write;
use stictiond::collect::table::Options;

const MAIN: &str = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
const RELATIONS: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
const OPEN: &str = "urn:oasis:names:tc:opendocument:xmlns";

/// The record of every sound workbook here: time, OP and PV.
const NAMES: [&str; 3] = ["t", "op", "pv"];
const ROWS: [[f64; 3]; 3] = [[0.0, 50.5, 20.0], [1.0, 51.5, 21.0], [2.0, 52.5, 22.0]];

fn is_sound(book: &[u8]) {
    let found = of_bytes(book, &Options::default()).expect("a sound workbook");
    let pairs = found.record.op.iter().zip(&found.record.pv);
    let rows: Vec<[f64; 3]> = pairs.map(|(op, pv)| [op.t, op.value, pv.value]).collect();
    assert_eq!(rows, ROWS, "{}", found.found.read_as);
}

/// One line says what is wrong, and what to do.
fn is_refused(book: &[u8], says: &str) {
    let said = of_bytes(book, &Options::default()).expect_err("a bomb");
    assert!(said.contains(says) && said.contains("as CSV") && said.lines().count() == 1, "{said}");
}

/// The parts of a workbook of Excel whose names are shared texts, but for the list of these.
fn parts(styles: &str, before: &str) -> Vec<(&'static str, String)> {
    let row = |cells: [f64; 3]| cells.map(|value| format!("<c><v>{value}</v></c>")).concat();
    let rows: String = ROWS.map(|cells| format!("<row>{}</row>", row(cells))).concat();
    let names: String = (0..3).map(|at| format!("<c t=\"s\"><v>{at}</v></c>")).collect();
    let related = |kind: &str, target: &str| {
        format!(
            "<Relationships xmlns=\"{PACKAGE}\"><Relationship Id=\"{kind}\" Type=\"{RELATIONS}/{kind}\" \
             Target=\"{target}\"/></Relationships>"
        )
    };
    let book = format!(
        "<workbook xmlns=\"{MAIN}\" xmlns:r=\"{RELATIONS}\"><sheets><sheet name=\"S\" sheetId=\"1\" r:id=\"worksheet\"/></sheets>\
         </workbook>"
    );
    let sheet = format!(
        "<worksheet xmlns=\"{MAIN}\">{before}<sheetData><row>{names}</row>{rows}</sheetData></worksheet>"
    );
    vec![
        ("[Content_Types].xml", "<Types/>".to_string()),
        ("_rels/.rels", related("officeDocument", "xl/workbook.xml")),
        ("xl/workbook.xml", book),
        ("xl/_rels/workbook.xml.rels", related("worksheet", "worksheets/sheet1.xml")),
        ("xl/styles.xml", format!("<styleSheet xmlns=\"{MAIN}\">{styles}</styleSheet>")),
        ("xl/worksheets/sheet1.xml", sheet),
    ]
}

/// The list of texts, with what is told of it.
fn texts(told: &str) -> String {
    let texts = NAMES.map(|name| format!("<si><t>{name}</t></si>")).concat();
    format!("<sst xmlns=\"{MAIN}\" {told}>{texts}</sst>")
}

fn excel(styles: &str, told: &str) -> Vec<u8> {
    let (parts, texts) = (parts(styles, ""), texts(told));
    let mut files: Vec<(&str, &str)> = parts.iter().map(|(name, text)| (*name, text.as_str())).collect();
    files.push(("xl/sharedStrings.xml", &texts));
    archive(&files)
}

#[test]
fn more_shared_texts_than_bytes_are_refused_before_there_is_room_for_them() {
    // Some programs tell too many, and no room is made for the count of all cells.
    for told in ["uniqueCount=\"3\"", "", "uniqueCount=\"200000\"", "count=\"10000000000\" uniqueCount=\"3\""]
    {
        is_sound(&excel("", told));
    }
    for told in [
        "uniqueCount=\"10000000000\"",
        "uniqueCount='18446744073709551615'",
        "a = '>' uniqueCount = \"300000\"",
    ] {
        is_refused(&excel("", told), "\"xl/sharedStrings.xml\" says that it holds ");
    }
}

#[test]
fn a_long_format_that_many_cells_might_have_is_refused() {
    let formats = |long: usize, many: usize| {
        let number = format!("<numFmt numFmtId=\"200\" formatCode=\"{}\"/>", "0".repeat(long));
        format!("<numFmts>{number}</numFmts><cellXfs>{}</cellXfs>", "<xf numFmtId=\"200\"/>".repeat(many))
    };
    // Excel has no longer one.
    is_sound(&excel(&formats(255, 2_000), ""));
    is_refused(&excel(&formats(100_000, 20_000), ""), "\"xl/styles.xml\" has formats that take ");
}

#[test]
fn a_workbook_that_unpacks_to_a_thousand_times_its_bytes_is_refused() {
    let blanks_before = |bytes: usize| {
        let (parts, texts) = (parts("", &" ".repeat(bytes)), texts(""));
        let parts = parts.iter().map(|(name, text)| (*name, text.as_bytes()));
        let packed: Vec<(&str, &[u8], Vec<u8>)> = parts
            .chain([("xl/sharedStrings.xml", texts.as_bytes())])
            .map(|(name, bytes)| {
                let mut packed = DeflateEncoder::new(Vec::new(), Compression::fast());
                packed.write_all(bytes).expect("into memory");
                (name, bytes, packed.finish().expect("into memory"))
            })
            .collect();
        let all: Vec<Part<'_>> = packed
            .iter()
            .map(|(name, bytes, packed)| {
                let unpacked = (bytes.len() as u32, crc32fast::hash(bytes));
                Part { name, method: 8, bytes: packed, unpacked }
            })
            .collect();
        of_parts(&all)
    };
    is_sound(&blanks_before(1 << 16));
    let book = blanks_before(16_000_000);
    assert!(book.len() < 200_000, "{} bytes", book.len());
    is_refused(&book, "unpacks to more than 16000000 bytes");
}

/// A workbook of OpenDocument with one table of these rows; `end` is what ends it.
fn open_document(rows: &str, end: &str) -> Vec<u8> {
    let names =
        ["office", "table", "text"].map(|name| format!(" xmlns:{name}=\"{OPEN}:{name}:1.0\"")).concat();
    let content = format!(
        "<office:document-content{names}><office:body><office:spreadsheet><table:table table:name=\"S\">{rows}{end}\
         </office:spreadsheet></office:body></office:document-content>"
    );
    let manifest = format!("<manifest:manifest xmlns:manifest=\"{OPEN}:manifest:1.0\"/>");
    archive(&[
        ("mimetype", "application/vnd.oasis.opendocument.spreadsheet"),
        ("META-INF/manifest.xml", &manifest),
        ("content.xml", &content),
    ])
}

const END: &str = "</table:table>";

/// The rows of the record, each with this behind it.
fn open_rows(behind: &str) -> String {
    let text = |text: &str| {
        format!("<table:table-cell office:value-type=\"string\"><text:p>{text}</text:p></table:table-cell>")
    };
    let number = |value: f64| {
        format!(
            "<table:table-cell office:value-type=\"float\" office:value=\"{value}\"><text:p>{value}</text:p></table:table-cell>"
        )
    };
    let row = |cells: String| format!("<table:table-row>{cells}{behind}</table:table-row>");
    row(NAMES.map(text).concat()) + &ROWS.map(|cells| row(cells.map(number).concat())).concat()
}

/// A cell that is there so often, with these attributes.
fn repeated(columns: u32, attributes: &str) -> String {
    format!("<table:table-cell table:number-columns-repeated=\"{columns}\"{attributes}/>")
}

#[test]
fn blank_cells_to_the_end_of_the_sheet_are_read_as_none() {
    let rest = |rows: u32| {
        let cells = repeated(16_384, " table:style-name=\"ce1\"");
        format!("<table:table-row table:number-rows-repeated=\"{rows}\">{cells}</table:table-row>")
    };
    is_sound(&open_document(&open_rows(""), END));
    // As LibreOffice writes it.
    is_sound(&open_document(&(open_rows(&repeated(16_381, "")) + &rest(1_048_572)), END));
}

#[test]
fn cells_that_are_repeated_over_the_sheet_are_refused_before_they_are_made() {
    let row = |repeats: &str, cells: &str| format!("<table:table-row{repeats}>{cells}</table:table-row>");
    let number = " office:value-type=\"float\" office:value=\"1\"";
    let wide = row("", &repeated(16_384, number));
    let high = row(" table:number-rows-repeated=\"1048576\"", &repeated(9, number));
    let narrow = row("", &repeated(1, number));
    let far = row("", &(repeated(16_383, "") + &repeated(1, number)));
    let blanks = "<text:p><text:s text:c=\"2147483647\"/></text:p>";
    let blanks = format!("<table:table-cell office:value-type=\"string\">{blanks}</table:table-cell>");
    let long = format!(
        "<table:table-cell table:number-columns-repeated=\"16384\" office:string-value=\"{}\"/>",
        "x".repeat(1000)
    );
    for rows in [wide.repeat(150), high, far + &narrow.repeat(300), row("", &blanks), row("", &long)] {
        let book = open_document(&(open_rows("") + &rows), END);
        assert!(book.len() < 50_000, "{} bytes", book.len());
        is_refused(&book, "\"content.xml\" repeats cells to ");
    }
}

#[test]
fn a_table_without_an_end_is_refused_and_not_waited_for() {
    is_refused(&open_document(&open_rows(""), ""), "\"content.xml\" ends within a table");
}

/// A record of a workbook of Excel 97: kind, and bytes.
fn record(kind: u16, data: &[u8]) -> Vec<u8> {
    [&kind.to_le_bytes()[..], &(data.len() as u16).to_le_bytes()[..], data].concat()
}

/// A number, by its row and column.
fn number(row: u16, column: u16, value: f64) -> Vec<u8> {
    let place = [row, column, 0].map(u16::to_le_bytes).concat();
    record(0x0203, &[&place[..], &value.to_le_bytes()[..]].concat())
}

/// The stream of a workbook of Excel 97 with one sheet, which says that it has so many rows, and has more records.
fn stream(rows: u32, more: &[u8]) -> Vec<u8> {
    let begin = |kind: u16| record(0x0809, &[0x0600, kind].map(u16::to_le_bytes).concat());
    let end = record(0x000a, &[]);
    let text = |column: usize| {
        let name = NAMES[column];
        let head = [0, column as u16, 0, name.len() as u16].map(u16::to_le_bytes).concat();
        record(0x0204, &[&head[..], &[0u8][..], name.as_bytes()].concat())
    };
    let dimensions =
        [[0, rows].map(u32::to_le_bytes).concat(), [0, 3, 0].map(u16::to_le_bytes).concat()].concat();
    // The place of the sheet is behind the three records of the first part.
    let sheet = |at: u32| record(0x0085, &[&at.to_le_bytes()[..], &[0u8, 0, 1, 0][..], &b"S"[..]].concat());
    let at = begin(5).len() + sheet(0).len() + end.len();
    let numbers = (1u16..).zip(ROWS).flat_map(|(row, cells)| {
        (0u16..).zip(cells).flat_map(|(column, value)| number(row, column, value)).collect::<Vec<u8>>()
    });
    let mut out =
        [begin(5), sheet(at as u32), end.clone(), begin(0x10), record(0x0200, &dimensions)].concat();
    out.extend((0..3).flat_map(text).chain(numbers));
    [&out[..], more, &end[..]].concat()
}

const NO_SECTOR: u32 = 0xffff_ffff;
const LAST: u32 = 0xffff_fffe;

/// A file of Excel 97 with this stream; `follows` is the sector behind that of the directory, which is the second.
fn compound(stream: &[u8], follows: u32) -> Vec<u8> {
    const SECTOR: usize = 512;
    let mut stream = stream.to_vec();
    // A shorter one would be kept elsewhere.
    stream.resize(stream.len().max(4096).next_multiple_of(SECTOR), 0);
    let sectors = (stream.len() / SECTOR) as u32;
    let mut table = vec![0xffff_fffd, follows];
    table.extend((3..2 + sectors).chain([LAST]));
    table.resize(SECTOR / 4, NO_SECTOR);
    let mut head = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1".to_vec();
    head.resize(SECTOR, 0);
    let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
    // Version 3, its order of bytes, sectors of 2^9 and 2^6 bytes; one table, where the directory and the rest begin.
    put(26, &[3, 0, 0xfe, 0xff, 9, 0, 6, 0]);
    put(44, &[1, 1].map(u32::to_le_bytes).concat());
    put(60, &[LAST, 0, LAST, 0, 0].map(u32::to_le_bytes).concat());
    put(80, &[0xff; SECTOR - 80]);
    let entry = |name: &str, kind: u8, first: u32, len: u32| {
        let mut entry: Vec<u8> = name.encode_utf16().flat_map(u16::to_le_bytes).collect();
        entry.resize(128, 0);
        entry[64] = 2 * (name.len() as u8 + 1);
        entry[66] = kind;
        entry[116..124].copy_from_slice(&[first, len].map(u32::to_le_bytes).concat());
        entry
    };
    let mut directory = entry("Root Entry", 5, LAST, 0);
    directory.extend(entry("Workbook", 2, 2, stream.len() as u32));
    directory.resize(SECTOR, 0);
    let table: Vec<u8> = table.into_iter().flat_map(u32::to_le_bytes).collect();
    [head, table, directory, stream].concat()
}

#[test]
fn what_an_excel_97_workbook_says_of_its_size_is_not_believed() {
    is_sound(&compound(&stream(4, &[]), LAST));
    is_sound(&compound(&stream(65_536, &[]), LAST));
    is_refused(&compound(&stream(1 << 30, &[]), LAST), "says it has 3221225472 cells");
    is_refused(&compound(&stream(4, &number(65_535, 65_535, 1.0)), LAST), "reach over 4294967296 cells");
}

#[test]
fn sectors_of_an_excel_97_workbook_that_run_in_a_circle_are_refused() {
    let stream = stream(4, &[]);
    for follows in [1, NO_SECTOR, 99] {
        is_refused(&compound(&stream, follows), "its sectors follow each other nowhere or without end");
    }
}

/// A record of a workbook `.xlsb`.
fn binary(kind: u16, data: &[u8]) -> Vec<u8> {
    let mut out = if kind < 0x80 { vec![kind as u8] } else { vec![kind as u8 | 0x80, (kind >> 7) as u8] };
    // None here takes a second byte for its length.
    out.push(data.len() as u8);
    out.extend(data);
    out
}

/// A text of such a workbook.
fn wide(text: &str) -> Vec<u8> {
    let words = text.encode_utf16().flat_map(u16::to_le_bytes);
    (text.len() as u32).to_le_bytes().into_iter().chain(words).collect()
}

#[test]
fn cells_far_apart_in_an_xlsb_are_no_cells_between() {
    let row = |at: u32| binary(0, &at.to_le_bytes());
    let cell = |kind: u16, column: u32, value: &[u8]| {
        binary(kind, &[&[column, 0].map(u32::to_le_bytes).concat()[..], value].concat())
    };
    let mut sheet = [binary(0x94, &[0; 16]), binary(0x91, &[]), row(0)].concat();
    sheet.extend((0..).zip(NAMES).flat_map(|(column, name)| cell(6, column, &wide(name))));
    for (at, cells) in (1..).zip(ROWS) {
        sheet.extend(row(at));
        sheet.extend((0..).zip(cells).flat_map(|(column, value)| cell(5, column, &value.to_le_bytes())));
    }
    // The last row and column that there can be.
    sheet.extend([row(1_048_575), cell(5, 16_383, &1f64.to_le_bytes()), binary(0x92, &[])].concat());
    let listed = [&[0, 1].map(u32::to_le_bytes).concat()[..], &wide("r")[..], &wide("S")[..]].concat();
    let book = [binary(0x9c, &listed), binary(0x90, &[]), binary(0x9d, &[])].concat();
    let related = format!(
        "<Relationships xmlns=\"{PACKAGE}\"><Relationship Id=\"r\" Type=\"{RELATIONS}/worksheet\" \
         Target=\"worksheets/sheet1.bin\"/></Relationships>"
    );
    let parts: [(&str, &[u8]); 4] = [
        ("[Content_Types].xml", b"<Types/>"),
        ("xl/workbook.bin", &book),
        ("xl/_rels/workbook.bin.rels", related.as_bytes()),
        ("xl/worksheets/sheet1.bin", &sheet),
    ];
    let parts = parts.map(|(name, bytes)| {
        let unpacked = (bytes.len() as u32, crc32fast::hash(bytes));
        Part { name, method: 0, bytes, unpacked }
    });
    is_sound(&of_parts(&parts));
}
