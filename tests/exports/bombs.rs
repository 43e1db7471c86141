//! Workbooks that are small and would fill the memory, or never end, and sound ones that look like them.

use super::archive::archive;
use super::of_bytes;
use super::packed::packed;
use stictiond::table::Options;

const MAIN: &str = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
/// Kinds of relations, and the list of them.
pub const RELATIONS: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
pub const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
const OPEN: &str = "urn:oasis:names:tc:opendocument:xmlns";

/// The record of every sound workbook here: time, OP and PV.
pub const NAMES: [&str; 3] = ["t", "op", "pv"];
pub const ROWS: [[f64; 3]; 3] = [[0.0, 50.5, 20.0], [1.0, 51.5, 21.0], [2.0, 52.5, 22.0]];

/// It is read as the record.
pub fn is_sound(book: &[u8]) {
    let found = of_bytes(book, &Options::default()).expect("a sound workbook");
    let pairs = found.record.op.iter().zip(&found.record.pv);
    let rows: Vec<[f64; 3]> = pairs.map(|(op, pv)| [op.t, op.value, pv.value]).collect();
    assert_eq!(rows, ROWS, "{}", found.found.read_as);
}

/// One line says what is wrong, and what to do.
pub fn is_refused(book: &[u8], says: &str) {
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

/// A workbook of Excel with these formats and what is told of its texts.
pub fn excel(styles: &str, told: &str) -> Vec<u8> {
    let (parts, texts) = (parts(styles, ""), texts(told));
    let mut files: Vec<(&str, &str)> = parts.iter().map(|(name, text)| (*name, text.as_str())).collect();
    files.push(("xl/sharedStrings.xml", &texts));
    archive(&files)
}

/// The same, compressed, with these names of cells and one more part.
fn packed_excel(styles: &str, names: &str, more: (&str, &[u8])) -> Vec<u8> {
    let names = format!("</sheets><definedNames>{names}</definedNames>");
    let mut parts = parts(styles, "");
    parts.push(("xl/sharedStrings.xml", texts("")));
    for (_, text) in &mut parts {
        *text = text.replace("</sheets>", &names);
    }
    let parts = parts.iter().map(|(name, text)| (*name, text.as_bytes()));
    packed(&parts.chain([more]).collect::<Vec<_>>())
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

/// A format of so many characters, and a list of so many formats of cells with it.
fn formats(long: usize, list: &str, many: usize) -> String {
    let number = format!("<numFmt numFmtId=\"200\" formatCode=\"{}\"/>", "0".repeat(long));
    format!("<numFmts>{number}</numFmts><{list}>{}</{list}>", "<xf numFmtId=\"200\"/>".repeat(many))
}

#[test]
fn a_long_format_that_many_cells_might_have_is_refused() {
    // Excel has no longer one.
    is_sound(&excel(&formats(255, "cellXfs", 2_000), ""));
    is_refused(&excel(&formats(100_000, "cellXfs", 20_000), ""), "up to its \"xl/styles.xml\"");
}

#[test]
fn styles_and_names_of_cells_that_gathered_over_years_are_read() {
    let small = |book: Vec<u8>| {
        assert!(book.len() < 250_000, "{} bytes, which may take more than the least", book.len());
        book
    };
    let none = ("docProps/app.xml", &b"<Properties/>"[..]);
    // No cell has them.
    let styles = formats(255, "cellStyleXfs", 16_000) + "<cellXfs><xf numFmtId=\"0\"/></cellXfs>";
    is_sound(&small(packed_excel(&styles, "", none)));
    let name = |at: u32| format!("<definedName name=\"Trend_{at}\">S!$A$1:$C$4</definedName>");
    let names: String = (0..16_000).map(name).collect();
    is_sound(&small(packed_excel("", &names, none)));
}

#[test]
fn parts_that_are_not_opened_may_have_any_form() {
    // As Power Pivot keeps its model, in UTF-16.
    let model = format!("\u{feff}<Gemini>{}</Gemini>", "<a>b</a>".repeat(400));
    let model: Vec<u8> = model.encode_utf16().flat_map(u16::to_le_bytes).collect();
    is_sound(&packed_excel("", "", ("customXml/item1.xml", &model)));
    is_refused(&packed_excel("", "", ("xl/theme/theme1.xml", &model)), "nested deeper");
    // As LibreOffice lists macros, and OpenOffice began its manifest.
    let of_manifest = "manifest:manifest PUBLIC \"-//OpenOffice.org//DTD Manifest 1.0//EN\" \"Manifest.dtd\"";
    let of_macros =
        "library:libraries PUBLIC \"-//OpenOffice.org//DTD OfficeDocument 1.0//EN\" \"libraries.dtd\"";
    let document = |of_manifest: &str, of_macros: &str| {
        let macros = format!("<!DOCTYPE {of_macros}><library:libraries/>");
        let more = [("Basic/script-lc.xml", macros.as_str())];
        open_document_beside(&open_rows(""), END, &format!("<!DOCTYPE {of_manifest}>"), &more)
    };
    let declared = |doctype: &str| format!("{doctype} [<!ENTITY a \"b\">]");
    is_sound(&document(of_manifest, of_macros));
    is_sound(&document(of_manifest, &declared(of_macros)));
    is_refused(&document(&declared(of_manifest), of_macros), "it has a DOCTYPE with declarations in it");
}

#[test]
fn parts_are_looked_at_in_the_folder_that_the_workbook_lies_in() {
    let moved = |styles: &str| {
        let parts = parts(styles, "").into_iter().chain([("xl/sharedStrings.xml", texts(""))]);
        let parts: Vec<(String, String)> = parts
            .map(|(name, text)| (name.replace("xl/", "book/"), text.replace("xl/workbook", "/Book/workbook")))
            .collect();
        archive(&parts.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect::<Vec<_>>())
    };
    is_sound(&moved(""));
    is_refused(&moved(&formats(100_000, "cellXfs", 20_000)), "up to its \"book/styles.xml\"");
}

#[test]
fn a_workbook_that_unpacks_to_a_thousand_times_its_bytes_is_refused() {
    let blanks_before = |bytes: usize| {
        let (parts, texts) = (parts("", &" ".repeat(bytes)), texts(""));
        let parts = parts.iter().map(|(name, text)| (*name, text.as_bytes()));
        packed(&parts.chain([("xl/sharedStrings.xml", texts.as_bytes())]).collect::<Vec<_>>())
    };
    is_sound(&blanks_before(1 << 16));
    let book = blanks_before(16_000_000);
    assert!(book.len() < 200_000, "{} bytes", book.len());
    is_refused(&book, "unpacks to more than 16000000 bytes");
}

/// A workbook of OpenDocument with one table of these rows; `end` is what ends it.
fn open_document(rows: &str, end: &str) -> Vec<u8> {
    open_document_beside(rows, end, "", &[])
}

/// The same, with what stands before its manifest, and with more parts.
fn open_document_beside(rows: &str, end: &str, doctype: &str, more: &[(&str, &str)]) -> Vec<u8> {
    let names =
        ["office", "table", "text"].map(|name| format!(" xmlns:{name}=\"{OPEN}:{name}:1.0\"")).concat();
    let content = format!(
        "<office:document-content{names}><office:body><office:spreadsheet><table:table table:name=\"S\">{rows}{end}\
         </office:spreadsheet></office:body></office:document-content>"
    );
    let manifest = format!("{doctype}<manifest:manifest xmlns:manifest=\"{OPEN}:manifest:1.0\"/>");
    let parts = [
        ("mimetype", "application/vnd.oasis.opendocument.spreadsheet"),
        ("META-INF/manifest.xml", manifest.as_str()),
        ("content.xml", content.as_str()),
    ];
    archive(&[&parts[..], more].concat())
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
        is_refused(&book, "up to its \"content.xml\"");
    }
}

#[test]
fn a_table_without_an_end_is_refused_and_not_waited_for() {
    is_refused(&open_document(&open_rows(""), ""), "\"content.xml\" ends within a table");
}
