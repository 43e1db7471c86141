//! The records of an `.xls`, by the names and numbers that Microsoft's document MS-XLS gives them: first the globals, which are for
//! all sheets, then the records of each sheet.

use crate::table::workbook::fields::{u16_at, u32_at};
use encoding_rs::UTF_16LE;

/// Bytes of the head of a record: its kind and how many bytes follow.
pub const HEAD_LEN: usize = 4;
/// Where a record that lists a sheet says how many characters its name has; the name follows.
pub const SHEET_NAME_LEN_AT: usize = 6;
/// Where a record of a name of cells says how many characters it has.
pub const NAME_LEN_AT: usize = 3;
/// Bytes before the value in the record of a cell: its row, its column and its format.
pub const CELL_HEAD_LEN: usize = 6;
/// Where the record of a formula says how many bytes of tokens follow: behind the cell, its value and its flags.
pub const TOKENS_LEN_AT: usize = 20;

/// FilePass: how what follows is encrypted.
pub const ENCRYPTED: u16 = 0x002f;
/// BOF: the globals, a sheet or a chart begin.
pub const BEGIN_OF_PART: u16 = 0x0809;
/// EOF: they end.
pub const END_OF_PART: u16 = 0x000a;
/// BoundSheet8: where a sheet begins, and its name.
pub const SHEET: u16 = 0x0085;
/// Lbl: a name of cells.
pub const NAME: u16 = 0x0018;
/// SST: the texts that cells share.
pub const TEXTS: u16 = 0x00fc;
/// Continue: more of the record before.
pub const CONTINUED: u16 = 0x003c;
/// Dimensions: the size of a sheet as it is told.
pub const DIMENSIONS: u16 = 0x0200;
/// Formula: a cell with a formula.
pub const FORMULA: u16 = 0x0006;
/// String: the text that is the value of the formula before.
pub const TEXT_OF_FORMULA: u16 = 0x0207;
/// MulRk: cells with numbers, side by side.
pub const NUMBERS: u16 = 0x00bd;
/// MergeCells: ranges of merged cells.
pub const MERGED_CELLS: u16 = 0x00e5;
/// LabelSst: a cell with a shared text.
pub const SHARED_TEXT: u16 = 0x00fd;
/// Label and RString: cells with a text of their own.
pub const OWN_TEXTS: [u16; 2] = [0x0204, 0x00d6];
/// Number, BoolErr and RK: cells without a text.
pub const OTHER_CELLS: [u16; 3] = [0x0203, 0x0205, 0x027e];

/// The records of a stream: kind and bytes.
pub fn records(stream: &[u8]) -> impl Iterator<Item = (u16, &[u8])> {
    let mut rest = stream;
    std::iter::from_fn(move || {
        let (kind, len) = (u16_at(rest, 0)?, u16_at(rest, 2)?);
        let (own, next) = rest.split_at_checked(HEAD_LEN + usize::from(len))?;
        rest = next;
        Some((kind, &own[HEAD_LEN..]))
    })
}

/// The records before the sheets.
pub fn globals(book: &[u8]) -> impl Iterator<Item = (u16, &[u8])> {
    records(book).take_while(|(kind, _)| *kind != END_OF_PART)
}

/// Whether the records are encrypted: then the library refuses the workbook, and no size in them means anything.
pub fn is_encrypted(book: &[u8]) -> bool {
    globals(book).any(|(kind, data)| kind == ENCRYPTED && u16_at(data, 0).is_some_and(|how| how != 0))
}

/// Where each sheet begins, and its name.
pub fn sheets(book: &[u8]) -> impl Iterator<Item = (usize, String)> {
    let places = globals(book).filter(|(kind, _)| *kind == SHEET);
    places.filter_map(|(_, data)| Some((u32_at(data, 0)? as usize, name_of(data))))
}

/// The name of a sheet, for a message.
fn name_of(data: &[u8]) -> String {
    let len = data.get(SHEET_NAME_LEN_AT).map_or(0, |len| usize::from(*len));
    let narrow = |text: &[u8]| text.iter().take(len).map(|byte| char::from(*byte)).collect();
    match data.get(SHEET_NAME_LEN_AT + 1..).unwrap_or_default() {
        [1, wide @ ..] => {
            UTF_16LE.decode_without_bom_handling(&wide[..wide.len().min(2 * len)]).0.into_owned()
        }
        [0, text @ ..] => narrow(text),
        // Excel 5 does not tell how wide it is.
        text => narrow(text),
    }
}

#[cfg(test)]
mod tests {
    use super::name_of;

    #[test]
    fn the_name_of_a_sheet_is_read_in_every_version() {
        assert_eq!(name_of(&[0, 0, 0, 0, 0, 0, 2, 0, b'A', b'B']), "AB");
        assert_eq!(name_of(&[0, 0, 0, 0, 0, 0, 2, 1, b'A', 0, b'B', 0]), "AB");
        assert_eq!(name_of(&[0, 0, 0, 0, 0, 0, 3, b'A', b'B', b'C', b'D']), "ABC", "as Excel 5 writes it");
        assert_eq!(name_of(&[0, 0, 0]), "");
    }
}
