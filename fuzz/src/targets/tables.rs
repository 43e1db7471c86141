//! Tables: text, Parquet, workbooks. Each is read as a record and as a stream, told nothing and told everything.

use super::archive::{Part, archive, of_parts};
use super::scratch;
use std::path::PathBuf;
use std::sync::OnceLock;
use stictiond::table::{Options, Source, TableError, read, stream};

/// What a table that leaves doubts may be told.
fn told() -> &'static [Options; 4] {
    static TOLD: OnceLock<[Options; 4]> = OnceLock::new();
    TOLD.get_or_init(|| {
        let set = |options: &[(&str, &str)]| {
            let mut all = Options::default();
            options.iter().for_each(|(name, value)| assert!(all.set(name, (*value).to_string()), "{name}"));
            all
        };
        let columns = [("time", "1"), ("op", "2"), ("pv", "3")];
        let european = [("decimal", "comma"), ("time_format", "dmy"), ("tz", "Europe/Berlin")];
        let counted = [("decimal", "point"), ("time_unit", "ms"), ("mode", "4"), ("auto_values", "AUTO,1")];
        let of_tags = [("time", "1"), ("tag", "2"), ("value", "3"), ("encoding", "shift_jis")];
        [
            Options::default(),
            set(&[&columns[..], &european].concat()),
            set(&[&columns[..], &counted].concat()),
            set(&of_tags),
        ]
    })
}

fn all(source: Source<'_>) {
    for options in told() {
        if let Ok(table) = read(source, options) {
            let record = &table.record;
            assert!(
                record.op.iter().chain(&record.pv).all(|sample| sample.t.is_finite()),
                "a time that is none"
            );
        }
        let mut count = 0u64;
        let _ = stream::<TableError>(source, options, &mut |_, sample| {
            count += 1;
            assert!(sample.t.is_finite(), "a time that is none");
            Ok(())
        });
    }
}

/// Text of any dialect.
pub fn text(bytes: &[u8]) {
    all(Source::Bytes(bytes));
}

/// A Parquet file, which is read from a file only.
pub fn parquet(bytes: &[u8]) {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    let path = PATH.get_or_init(|| scratch("tables").join("table.parquet"));
    std::fs::write(path, bytes).expect("written");
    all(Source::File(path));
}

/// How each part of an `.xlsb` begins, where it lies, and a sound one: the list of sheets, the texts that cells share, the formats
/// and the sheet.
const BINARY: [([u8; 2], &str, &[u8]); 4] = [
    (
        [0x9c, 0x01],
        "xl/workbook.bin",
        b"\x9c\x01\x14\0\0\0\0\x01\0\0\0\x01\0\0\0r\0\x01\0\0\0S\0\x90\x01\0\x9d\x01\0",
    ),
    (
        [0x9f, 0x01],
        "xl/sharedStrings.bin",
        b"\x9f\x01\x08\x01\0\0\0\x01\0\0\0\x13\x09\0\x02\0\0\0P\0V\0\xa0\x01\0",
    ),
    (
        [0xe7, 0x04],
        "xl/styles.bin",
        b"\xe7\x04\x04\0\0\0\0\xe9\x04\x04\x01\0\0\0\x2f\x10\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
    ),
    (
        [0x94, 0x01],
        "xl/worksheets/sheet1.bin",
        b"\x94\x01\x10\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\x91\x01\0\0\x04\0\0\0\0\x07\x0c\0\0\0\0\0\0\0\0\0\0\0\0\x92\x01\0",
    ),
];

/// A workbook as it is; anything else is a part of one that is whole: of an `.xlsb` where it begins as one, tables of OpenDocument
/// where it begins with one, else the sheet, the formats, the texts that cells share and what is told of these in advance.
pub fn excel(bytes: &[u8]) {
    if bytes.starts_with(b"PK") || bytes.starts_with(&[0xd0, 0xcf, 0x11, 0xe0]) {
        return all(Source::Bytes(bytes));
    }
    if let Some(part) = BINARY.iter().position(|(begin, ..)| bytes.starts_with(begin)) {
        return all(Source::Bytes(&of_binary(part, bytes)));
    }
    let inside = String::from_utf8_lossy(bytes);
    let book = if inside.starts_with("<table:") { of_tables(&inside) } else { of_sheet(&inside) };
    all(Source::Bytes(&book));
}

/// An `.xlsb` with this part, and the sound ones of all others.
fn of_binary(part: usize, bytes: &[u8]) -> Vec<u8> {
    const TYPE: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet";
    const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
    let related = format!(
        "<Relationships xmlns=\"{PACKAGE}\"><Relationship Id=\"r\" Type=\"{TYPE}\" Target=\"worksheets/sheet1.bin\"/>\
         </Relationships>"
    );
    let mut files: Vec<(&str, &[u8])> = vec![
        ("[Content_Types].xml", b"<Types/>".as_slice()),
        ("xl/_rels/workbook.bin.rels", related.as_bytes()),
    ];
    for (at, (_, name, sound)) in BINARY.iter().enumerate() {
        files.push((*name, if at == part { bytes } else { *sound }));
    }
    let stored = files.iter().map(|(name, bytes)| {
        let unpacked = (bytes.len() as u32, crc32fast::hash(bytes));
        Part { name, method: 0, bytes, unpacked }
    });
    of_parts(&stored.collect::<Vec<_>>())
}

/// A workbook of OpenDocument with these tables.
fn of_tables(tables: &str) -> Vec<u8> {
    const NAMES: &str = "urn:oasis:names:tc:opendocument:xmlns";
    let names: String = ["office", "table", "text"]
        .iter()
        .map(|name| format!(" xmlns:{name}=\"{NAMES}:{name}:1.0\""))
        .collect();
    let content = format!(
        "<office:document-content{names}><office:body><office:spreadsheet>{tables}</office:spreadsheet></office:body>\
         </office:document-content>"
    );
    let manifest = format!("<manifest:manifest xmlns:manifest=\"{NAMES}:manifest:1.0\"/>");
    archive(&[
        ("mimetype", "application/vnd.oasis.opendocument.spreadsheet"),
        ("META-INF/manifest.xml", &manifest),
        ("content.xml", &content),
    ])
}

/// A workbook of Excel with this sheet, and behind a zero each its formats, its texts and the attributes of these.
fn of_sheet(inside: &str) -> Vec<u8> {
    const MAIN: &str = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    const RELATIONS: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
    const PARTS: [(&str, &str); 3] =
        [("worksheet", "worksheets/sheet1"), ("styles", "styles"), ("sharedStrings", "sharedStrings")];
    let mut parts = inside.splitn(4, '\0');
    let sheet = format!("<worksheet xmlns=\"{MAIN}\">{}</worksheet>", parts.next().unwrap_or_default());
    let styles =
        parts.next().unwrap_or("<cellXfs count=\"2\"><xf numFmtId=\"0\"/><xf numFmtId=\"22\"/></cellXfs>");
    let styles = format!("<styleSheet xmlns=\"{MAIN}\">{styles}</styleSheet>");
    let texts = parts.next().unwrap_or("<si><t>PV</t></si>");
    let told = parts.next().unwrap_or("uniqueCount=\"1\"");
    let texts = format!("<sst xmlns=\"{MAIN}\" {told}>{texts}</sst>");
    let related: String = PARTS
        .iter()
        .map(|(kind, file)| {
            format!("<Relationship Id=\"{kind}\" Type=\"{RELATIONS}/{kind}\" Target=\"{file}.xml\"/>")
        })
        .collect();
    let book = format!(
        "<workbook xmlns=\"{MAIN}\" xmlns:r=\"{RELATIONS}\"><sheets><sheet name=\"1\" sheetId=\"1\" r:id=\"worksheet\"/>\
         </sheets></workbook>"
    );
    let root = format!(
        "<Relationships xmlns=\"{PACKAGE}\"><Relationship Id=\"rId1\" Type=\"{RELATIONS}/officeDocument\" \
         Target=\"xl/workbook.xml\"/></Relationships>"
    );
    let related = format!("<Relationships xmlns=\"{PACKAGE}\">{related}</Relationships>");
    let types = "<Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\
                 <Default Extension=\"xml\" ContentType=\"application/xml\"/></Types>";
    archive(&[
        ("[Content_Types].xml", types),
        ("_rels/.rels", &root),
        ("xl/workbook.xml", &book),
        ("xl/_rels/workbook.xml.rels", &related),
        ("xl/styles.xml", &styles),
        // The library looks for it by this name, whatever the list of parts calls it.
        ("xl/sharedStrings.xml", &texts),
        ("xl/worksheets/sheet1.xml", &sheet),
    ])
}
