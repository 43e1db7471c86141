//! Binary workbooks (`.xlsb`) that are small and would fill the memory, or never end, and sound ones that look like them.

use super::archive::{Part, of_parts};
use super::bombs::{NAMES, PACKAGE, RELATIONS, ROWS, is_refused, is_sound};
use super::xlsb_records::{record, told, wide};
use stictiond::table::Options;

/// A record that says it is as long as one can be.
fn lie(kind: u16) -> Vec<u8> {
    told(kind, (1 << 28) - 1, &[0; 12])
}

fn row(at: u32) -> Vec<u8> {
    record(0, &at.to_le_bytes())
}

/// A cell in a column, of the first format.
fn cell(kind: u16, column: u32, value: &[u8]) -> Vec<u8> {
    record(kind, &[&[column, 0].map(u32::to_le_bytes).concat()[..], value].concat())
}

/// A text that cells share.
fn shared(text: &[u8]) -> Vec<u8> {
    record(0x13, &[&[0][..], text].concat())
}

/// A list that says how many there are.
fn list(kind: u16, count: u32) -> Vec<u8> {
    record(kind, &count.to_le_bytes())
}

/// A name of cells, with the tokens of its formula.
fn name_of_cells(name: &str, tokens: &[u8]) -> Vec<u8> {
    let len = (tokens.len() as u32).to_le_bytes();
    record(0x27, &[&[0; 9][..], &wide(name)[..], &len[..], tokens].concat())
}

/// The parts of a workbook, each as its records.
struct Parts {
    sheet: Vec<Vec<u8>>,
    texts: Vec<Vec<u8>>,
    formats: Vec<Vec<u8>>,
    /// The sheet, and what stands between it and the end.
    book: Vec<Vec<u8>>,
    /// Where the sheet lies.
    place: String,
}

impl Parts {
    /// Those of a workbook with the record, the names of which are shared texts.
    fn sound() -> Self {
        let mut sheet = vec![record(0x94, &[0; 16]), record(0x91, &[]), row(0)];
        sheet.extend((0..3u32).map(|column| cell(7, column, &column.to_le_bytes())));
        for (at, cells) in (1..).zip(ROWS) {
            sheet.push(row(at));
            sheet.extend((0..).zip(cells).map(|(column, value)| cell(5, column, &value.to_le_bytes())));
        }
        let mut texts = vec![record(0x9f, &[3, 3].map(u32::to_le_bytes).concat())];
        texts.extend(NAMES.map(|name| shared(&wide(name))));
        let format = record(0x2c, &[&[164, 0][..], &wide("0.00")[..]].concat());
        let formats =
            vec![list(0x267, 1), format, record(0x268, &[]), list(0x269, 1), record(0x2f, &[0; 16])];
        let sheets = [&[0, 1].map(u32::to_le_bytes).concat()[..], &wide("r")[..], &wide("S")[..]].concat();
        let book = vec![record(0x9c, &sheets), record(0x90, &[])];
        Self { sheet, texts, formats, book, place: "worksheets/sheet1.bin".into() }
    }

    fn archive(&self) -> Vec<u8> {
        let related = format!(
            "<Relationships xmlns=\"{PACKAGE}\"><Relationship Id=\"r\" Type=\"{RELATIONS}/worksheet\" Target=\"{}\"/>\
             </Relationships>",
            self.place
        );
        let sheet = format!("xl/{}", self.place);
        let end = |records: &[Vec<u8>], kind: u16| [records.concat(), record(kind, &[])].concat();
        let parts = [
            ("[Content_Types].xml", b"<Types/>".to_vec()),
            ("xl/workbook.bin", end(&self.book, 0x9d)),
            ("xl/_rels/workbook.bin.rels", related.into_bytes()),
            ("xl/styles.bin", self.formats.concat()),
            ("xl/sharedStrings.bin", end(&self.texts, 0xa0)),
            (sheet.as_str(), end(&self.sheet, 0x92)),
        ];
        let parts = parts.each_ref().map(|(name, bytes)| {
            let unpacked = (bytes.len() as u32, crc32fast::hash(bytes));
            Part { name, method: 0, bytes, unpacked }
        });
        of_parts(&parts)
    }
}

/// A workbook with something changed.
fn changed(change: impl Fn(&mut Parts)) -> Vec<u8> {
    let mut parts = Parts::sound();
    change(&mut parts);
    let book = parts.archive();
    assert!(book.len() < 100_000, "{} bytes", book.len());
    book
}

#[test]
fn cells_far_apart_in_an_xlsb_are_no_cells_between() {
    is_sound(&changed(|_| {}));
    // The last row and column that there can be.
    is_sound(&changed(|parts| parts.sheet.extend([row(1_048_575), cell(5, 16_383, &1f64.to_le_bytes())])));
}

/// Times that are bare numbers of days: whether they count from 1904 says a flag of the workbook.
#[test]
fn days_since_1904_in_an_xlsb_are_not_taken_for_days_since_1900() {
    const PROPERTIES: u16 = 0x99;
    /// 2026-06-01, as days since 1900.
    const DAY: f64 = 46_174.0;
    let example = super::example();
    let read = |flags: u8| {
        let mut parts = Parts::sound();
        parts.book.insert(0, record(PROPERTIES, &[flags, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]));
        // What begins the sheet, and its names.
        parts.sheet.truncate(6);
        for (at, (op, pv)) in (1..).zip(example.op.iter().zip(&example.pv)) {
            parts.sheet.push(row(at));
            let cells = (0..).zip([DAY + op.t / 86_400.0, op.value, pv.value]);
            parts.sheet.extend(cells.map(|(column, value)| cell(5, column, &value.to_le_bytes())));
        }
        super::of_bytes(&parts.archive(), &Options::default())
    };
    let said = read(1).expect_err("bare numbers");
    assert!(said.contains("counts them from 1904"), "{said}");
    let found = read(0).expect("days since 1900");
    assert!(found.found.read_as.contains("days of a spreadsheet"), "{}", found.found.read_as);
    assert!(super::bits(&found.record) == super::bits(&example));
}

#[test]
fn a_record_of_an_xlsb_that_is_longer_than_its_part_is_refused() {
    let lies = "a record says that it has 268435455 bytes";
    let refused = |part: &str, change: fn(&mut Parts)| {
        is_refused(&changed(change), &format!("a workbook whose \"xl/{part}\" cannot be read: {lies}"));
    };
    refused("worksheets/sheet1.bin", |parts| parts.sheet.push(lie(5)));
    refused("worksheets/sheet1.bin", |parts| parts.sheet.insert(0, lie(0x81)));
    refused("workbook.bin", |parts| parts.book.insert(0, lie(0x80)));
    refused("workbook.bin", |parts| parts.book.push(lie(0x27)));
    refused("sharedStrings.bin", |parts| parts.texts.insert(1, lie(0x13)));
    refused("styles.bin", |parts| parts.formats.insert(1, lie(0x2c)));
    // The library takes what stands in the middle of a record for a list.
    refused("styles.bin", |parts| parts.formats.insert(0, record(0x10, &lie(0x267))));
    is_sound(&changed(|parts| parts.formats.insert(0, record(0x116, &[]))));
}

#[test]
fn a_text_of_an_xlsb_that_goes_on_behind_its_record_is_refused() {
    // Each of the short ones would be a text of 40 kB, from the record before.
    let long = "x".repeat(20_000);
    let (many, lies) = (10_000, "which hold none");
    is_refused(
        &changed(|parts| {
            parts.texts = vec![list(0x9f, 0), shared(&wide(&long))];
            parts.texts.extend(vec![record(0x13, &[]); many]);
        }),
        lies,
    );
    is_refused(
        &changed(|parts| {
            parts.sheet.push(cell(6, 3, &wide(&long)));
            parts.sheet.extend(vec![cell(6, 3, &[]); 2000]);
        }),
        lies,
    );
    is_refused(
        &changed(|parts| parts.sheet.push(cell(8, 3, &wide("text")[..7]))),
        "a text says that it has 4 characters, in a record of 15 bytes",
    );
    is_refused(
        &changed(|parts| {
            parts.formats = vec![list(0x267, many as u32)];
            parts.formats.extend(vec![record(0x2c, &[164, 0]); many]);
        }),
        lies,
    );
}

#[test]
fn names_of_cells_that_become_long_or_deep_are_refused() {
    let nest =
        |inside: Vec<u8>| [&[0x29][..], &(inside.len() as u16).to_le_bytes()[..], &inside[..]].concat();
    let deep = |levels: usize| (0..levels).fold(vec![0x1e, 1, 0], |inside, _| nest(inside));
    is_sound(&changed(|parts| {
        parts.book.push(name_of_cells("limits", &[0x3b, 0, 0, 1, 0, 0, 0, 9, 0, 0, 0, 1, 0, 2, 0]));
        // It links to the sheet before.
        parts.book.insert(2, record(0x16a, &[1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]));
        parts.book.push(name_of_cells("sum", &deep(3)));
    }));
    // The library would call itself until there is no stack left, which ends the process.
    is_refused(&changed(|parts| parts.book.push(name_of_cells("deep", &deep(15_000)))), "nested too deep");
    let long = "x".repeat(10_000);
    is_refused(
        &changed(|parts| {
            parts.book.push(name_of_cells(&long, &[0x1e, 1, 0]));
            parts.book.push(name_of_cells("names", &[0x23, 1, 0, 0, 0].repeat(5000)));
        }),
        "up to its \"xl/workbook.bin\"",
    );
    is_refused(
        &changed(|parts| parts.book.push(name_of_cells("signs", &[0x12; 60_000]))),
        "its names of cells would take minutes",
    );
    is_refused(&changed(|parts| parts.book.insert(2, list(0x16a, 999_999))), "999999 links, in 4 bytes");
}

#[test]
fn sheets_of_an_xlsb_lie_where_they_are_looked_at() {
    is_sound(&changed(|parts| parts.place = "worksheets/Sheet2.bin".into()));
    for place in ["worksheets/_rels/sheet1.bin.rels", "worksheets/sheet1.xml"] {
        let book = changed(|parts| {
            parts.place = place.into();
            parts.sheet.push(lie(5));
        });
        is_refused(&book, &format!("it lists a part at \"{place}\", where Excel puts none"));
    }
}
