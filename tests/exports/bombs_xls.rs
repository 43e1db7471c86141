//! Workbooks of Excel 97 (`.xls`) that are small and would fill the memory, or never end, and sound ones that look like them.

use super::bombs::{NAMES, ROWS, excel, is_refused, is_sound};
use super::xls::{
    self, LAST, NO_SECTOR, cell, compound_of, number, place, record, shared_text, texts, told_text,
};

/// The name in a column.
fn name(column: u16) -> Vec<u8> {
    let name = NAMES[usize::from(column)];
    told_text(0, column, name.len() as u16, name)
}

/// What a sheet says of its rows, and of its three columns.
fn dimensions(rows: u32) -> Vec<u8> {
    let columns = [0u16, 3, 0].map(u16::to_le_bytes).concat();
    record(0x0200, &[[0, rows].map(u32::to_le_bytes).concat(), columns].concat())
}

/// The record of this workbook in a stream with one sheet: it says that it has so many rows, and has more at its end. `before`
/// makes records before it, told where it begins; `name` makes the names of its columns.
fn stream_of(
    rows: u32,
    before: &dyn Fn(u32) -> Vec<u8>,
    name: &dyn Fn(u16) -> Vec<u8>,
    more: &[u8],
) -> Vec<u8> {
    let numbers = (1u16..).zip(ROWS).flat_map(|(row, cells)| {
        (0u16..).zip(cells).flat_map(|(column, value)| number(row, column, value)).collect::<Vec<u8>>()
    });
    let sheet: Vec<u8> = dimensions(rows)
        .into_iter()
        .chain((0..3).flat_map(name))
        .chain(numbers)
        .chain(more.to_vec())
        .collect();
    xls::stream_of(before, &sheet)
}

fn stream(rows: u32, more: &[u8]) -> Vec<u8> {
    stream_of(rows, &|_| Vec::new(), &name, more)
}

fn compound(stream: &[u8]) -> Vec<u8> {
    compound_of("Workbook", stream, LAST)
}

#[test]
fn what_an_excel_97_workbook_says_of_its_size_is_not_believed() {
    is_sound(&compound(&stream(4, &[])));
    is_sound(&compound(&stream(65_536, &[])));
    is_refused(&compound(&stream(1 << 30, &[])), "sheet \"S\" says it has 3221225472 cells");
    // The library would make room for them, though there can be so many.
    is_refused(&compound(&stream(1 << 22, &[])), "sheet \"S\" says it has 12582912 cells");
    is_refused(&compound(&stream(65_536, &dimensions(65_536).repeat(5))), "says it has 1179648 cells");
    is_refused(&compound(&stream(4, &number(65_535, 65_535, 1.0))), "reaches over 4294967296 cells");
}

#[test]
fn an_excel_97_workbook_with_a_password_is_refused_as_one() {
    // What stands behind this record, the size of the sheet too, is encrypted.
    let book = |how: u8| compound(&stream_of(1 << 30, &|_| record(0x002f, &[how, 0, 1, 0]), &name, &[]));
    is_refused(&book(1), "a workbook that is encrypted with a password");
    is_refused(&book(0), "sheet \"S\" says it has 3221225472 cells");
}

#[test]
fn sectors_of_an_excel_97_workbook_that_run_in_a_circle_are_refused() {
    let stream = stream(4, &[]);
    for follows in [1, NO_SECTOR, 99] {
        let book = compound_of("Workbook", &stream, follows);
        is_refused(&book, "its sectors follow each other nowhere or without end");
    }
}

#[test]
fn a_long_text_that_many_cells_share_is_refused() {
    // The second is cut, and its second character takes two bytes.
    let cut = texts(&[b"\x01\0\0t\x02\0\0o", b"\x01p\0\x02\0\0pv"]);
    let name = |column: u16| shared_text(0, column, u32::from(column));
    is_sound(&compound(&stream_of(4, &|_| cut.clone(), &name, &[])));
    // 8000 letters in each part, behind a byte that says how wide they are.
    let letters = [&[0][..], &[b'x'; 8000][..]].concat();
    let begin = [&56_000u16.to_le_bytes()[..], &letters[..]].concat();
    let mut parts = vec![&begin[..]];
    parts.extend([&letters[..]; 6]);
    let long = texts(&parts);
    let cells: Vec<u8> = (4..104).flat_map(|row| shared_text(row, 0, 0)).collect();
    let book = compound(&stream_of(4, &|_| long.clone(), &self::name, &cells));
    assert!(book.len() < 80_000, "{} bytes", book.len());
    is_refused(&book, "its sheet \"S\", which reaches over 312 cells and has texts and formulas of 112");
}

#[test]
fn texts_that_say_they_are_longer_than_they_are_are_refused() {
    let longer = |column: u16| told_text(0, column, 1000, NAMES[usize::from(column)]);
    is_sound(&compound(&stream_of(4, &|_| Vec::new(), &longer, &[])));
    let cells: Vec<u8> = (4..204).flat_map(|row| told_text(row, 0, u16::MAX, "")).collect();
    let of_formulas = record(0x0207, &[0xff, 0xff, 0]).repeat(200);
    for more in [cells, of_formulas] {
        let book = compound(&stream(4, &more));
        assert!(book.len() < 10_000, "{} bytes", book.len());
        is_refused(&book, "cells and has texts and formulas of 131");
    }
}

#[test]
fn shared_texts_in_thousands_of_parts_are_refused() {
    let parts = |count: usize| {
        let texts = [texts(&[b""]), record(0x003c, &[]).repeat(count)].concat();
        compound(&stream_of(4, &|_| texts.clone(), &name, &[]))
    };
    is_sound(&parts(100));
    is_refused(&parts(60_000), "shared texts are cut into 60001 parts");
}

/// A formula in the last cell of the record, which holds what that does.
fn formula(tokens: &[u8]) -> Vec<u8> {
    let value = [&22f64.to_le_bytes()[..], &[0; 6][..]].concat();
    let tokens = [&(tokens.len() as u16).to_le_bytes()[..], tokens].concat();
    cell(0x0006, 3, 2, &[value, tokens].concat())
}

#[test]
fn formulas_that_become_long_or_take_long_are_refused() {
    // 20 + 2.
    is_sound(&compound(&stream(4, &formula(&[0x1e, 20, 0, 0x1e, 2, 0, 0x03]))));
    // A blank before a number, as often as a byte can say, and that often.
    let blanks = [&[0x1e, 20, 0][..], &[0x19, 0x40, 0, 255].repeat(2000)[..]].concat();
    let book = compound(&stream(4, &formula(&blanks)));
    is_refused(&book, "sheet \"S\" has formulas that would take minutes");
    let long_name = record(0x0018, &[&[0, 0, 0, 255][..], &[0; 10][..], &[0; 256][..]].concat());
    let names = formula(&[0x23, 1, 0, 0, 0].repeat(12_000));
    let book = compound(&stream_of(4, &|_| long_name.clone(), &name, &names));
    assert!(book.len() < 80_000, "{} bytes", book.len());
    is_refused(&book, "reaches over 12 cells and has texts and formulas of 37680");
}

#[test]
fn sheets_that_share_their_cells_are_refused() {
    // Cells that are joined, which the library keeps for each sheet.
    let joined = record(0x00e5, &[&1000u16.to_le_bytes()[..], &[0; 8000][..]].concat());
    let book = |letters: &'static [u8]| {
        let places = move |at: u32| letters.iter().flat_map(|letter| place(at, *letter)).collect::<Vec<u8>>();
        compound(&stream_of(4, &places, &name, &joined))
    };
    is_sound(&book(b""));
    is_refused(&book(b"ABCDEFGHIJKLMNOPQRSTUVWXYZ"), "shares its cells with others");
}

#[test]
fn an_archive_behind_a_file_of_excel_97_is_looked_at_as_well() {
    let behind = |told: &str| [compound_of("Other", &[], LAST), excel("", told)].concat();
    is_sound(&behind("uniqueCount=\"3\""));
    is_refused(&behind("uniqueCount=\"10000000000\""), "\"xl/sharedStrings.xml\" says that it holds ");
}
