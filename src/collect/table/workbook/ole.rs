//! Looks at an `.xls` before the library opens it: whether its chains of sectors end, and how far its sheets reach. The library
//! follows a chain that runs in a circle until there is no memory left, and makes a cell of every place between the first and the
//! last row and column.

use super::MAX_CELLS;
use crate::collect::table::error::TableError;
use encoding_rs::UTF_16LE;

/// Numbers of sectors from which on there is no sector; that of the end of a chain; and from which on the list of tables has none.
const NO_SECTOR: u32 = 0xffff_fffa;
const END: u32 = 0xffff_fffe;
const NO_TABLE: u32 = 0xffff_fffc;
/// Bytes of a sector of small streams, and below which a stream is one.
const SMALL: usize = 64;
const SMALL_STREAM: usize = 4096;
/// Bytes of an entry of the directory.
const ENTRY: usize = 128;

/// Cells that the sheets may always reach over, and for each byte of the file.
const FEW_CELLS: u64 = 1 << 18;
const CELLS_A_BYTE: u64 = 4;

/// Records: begin and end of a part, a sheet's place, its size as it is told, and cells.
const BEGIN_OF_PART: u16 = 0x0809;
const END_OF_PART: u16 = 0x000a;
const SHEET: u16 = 0x0085;
const DIMENSIONS: u16 = 0x0200;
const FORMULA: u16 = 0x0006;
const TEXT_OF_FORMULA: u16 = 0x0207;
const NUMBERS: u16 = 0x00bd;
const CELLS: [u16; 6] = [0x0203, 0x0204, 0x00d6, 0x0205, 0x027e, 0x00fd];

/// Refuses a file that would take far more memory than it has bytes.
pub fn look(bytes: &[u8]) -> Result<(), TableError> {
    let book = book(bytes).ok_or_else(|| {
        TableError::refused(
            "a workbook that cannot be read: it is damaged, and its sectors follow each other nowhere or without end; save it again, \
             or the columns that are needed as CSV",
        )
    })?;
    let sheets =
        records(&book).take_while(|(kind, _)| *kind != END_OF_PART).filter(|(kind, _)| *kind == SHEET);
    let mut cells = 0u64;
    for at in sheets.filter_map(|(_, data)| u32_at(data, 0)) {
        let reach = Reach::of(book.get(at as usize..).unwrap_or_default());
        if reach.told > MAX_CELLS as u64 {
            let told = reach.told;
            return Err(TableError::refused(format!(
                "a workbook with a sheet that says it has {told} cells: more than {MAX_CELLS} are not read; save it again, or the \
                 columns that are needed as CSV"
            )));
        }
        cells = cells.saturating_add(reach.cells());
    }
    let most = FEW_CELLS.max((bytes.len() as u64).saturating_mul(CELLS_A_BYTE)).min(MAX_CELLS as u64);
    if cells > most {
        return Err(TableError::refused(format!(
            "a workbook whose sheets reach over {cells} cells: {most} are taken of {} bytes; delete cells far from the others, or \
             save the columns that are needed as CSV",
            bytes.len()
        )));
    }
    Ok(())
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn numbers(bytes: &[u8]) -> impl Iterator<Item = u32> {
    (0..bytes.len() / 4).filter_map(move |at| u32_at(bytes, 4 * at))
}

/// Sectors of one size, one after the other.
struct Sectors<'b> {
    bytes: &'b [u8],
    size: usize,
    /// Whether the last may be cut; the library fills it with zeros.
    may_be_cut: bool,
}

impl Sectors<'_> {
    fn get(&self, id: u32) -> Option<Vec<u8>> {
        let from = (id as usize).checked_mul(self.size)?;
        let own = self.bytes.get(from..(from + self.size).min(self.bytes.len()))?;
        let mut sector = own.to_vec();
        sector.resize(self.size, 0);
        (self.may_be_cut || own.len() == self.size).then_some(sector)
    }

    /// A chain from its first sector on, up to so many bytes; `None` where it does not end.
    fn chain(&self, first: u32, table: &[u32], most: usize) -> Option<Vec<u8>> {
        let (mut out, mut id) = (Vec::new(), first);
        // Each sector once.
        for _ in 0..=table.len() {
            if id == END {
                return Some(out);
            }
            out.extend(self.get(id)?);
            if out.len() >= most {
                out.truncate(most);
                return Some(out);
            }
            id = *table.get(id as usize)?;
        }
        None
    }
}

/// The stream of the workbook, empty where there is none; `None` for a file whose sectors cannot be followed.
fn book(bytes: &[u8]) -> Option<Vec<u8>> {
    let size = match u16_at(bytes, 30)? {
        9 => 512,
        12 => 4096,
        // The library refuses all others.
        _ => return Some(Vec::new()),
    };
    let sectors = Sectors { bytes: bytes.get(size..)?, size, may_be_cut: true };
    let table = table(bytes, &sectors)?;
    let directory = sectors.chain(u32_at(bytes, 48)?, &table, usize::MAX)?;
    let entries = || directory.chunks_exact(ENTRY);
    let root = entries().next()?;
    let small_tables = u32_at(bytes, 64)? as usize;
    let (mut small_table, mut small) = (Vec::new(), Vec::new());
    if small_tables > 0 {
        small = sectors.chain(u32_at(root, 116)?, &table, len(root, size)?)?;
        let chain = sectors.chain(u32_at(bytes, 60)?, &table, small_tables.saturating_mul(size))?;
        small_table = numbers(&chain).collect();
    }
    let named = |name: &str| entries().find(|entry| name_of(entry).eq_ignore_ascii_case(name));
    let Some(entry) = named("Workbook").or_else(|| named("Book")) else { return Some(Vec::new()) };
    let (first, len) = (u32_at(entry, 116)?, len(entry, size)?);
    if len < SMALL_STREAM {
        return Sectors { bytes: &small, size: SMALL, may_be_cut: false }.chain(first, &small_table, len);
    }
    sectors.chain(first, &table, len)
}

/// Which sector follows each.
fn table(bytes: &[u8], sectors: &Sectors<'_>) -> Option<Vec<u32>> {
    let most = sectors.bytes.len() / sectors.size + 2;
    let mut listed: Vec<u32> = numbers(bytes.get(76..512)?).collect();
    let mut next = u32_at(bytes, 68)?;
    let mut lists = 0;
    while next < NO_SECTOR {
        lists += 1;
        if lists > most {
            return None;
        }
        listed.extend(numbers(&sectors.get(next)?));
        next = listed.pop()?;
    }
    let mut table = Vec::new();
    listed.retain(|id| *id < NO_TABLE);
    // Each is a sector of its own.
    if listed.len() > most {
        return None;
    }
    for id in listed {
        table.extend(numbers(&sectors.get(id)?));
    }
    Some(table)
}

/// The name of an entry of the directory.
fn name_of(entry: &[u8]) -> String {
    let name = UTF_16LE.decode(&entry[..64]).0;
    name.split('\0').next().unwrap_or_default().to_string()
}

/// Bytes of the stream of an entry.
fn len(entry: &[u8], size: usize) -> Option<usize> {
    let high = if size == 512 { 0 } else { u64::from(u32_at(entry, 124)?) };
    usize::try_from((high << 32) | u64::from(u32_at(entry, 120)?)).ok()
}

/// The records of a stream: kind and bytes.
fn records(stream: &[u8]) -> impl Iterator<Item = (u16, &[u8])> {
    let mut rest = stream;
    std::iter::from_fn(move || {
        let (kind, len) = (u16_at(rest, 0)?, u16_at(rest, 2)?);
        let (own, next) = rest.split_at_checked(4 + usize::from(len))?;
        rest = next;
        Some((kind, &own[4..]))
    })
}

/// How far a sheet reaches: rows and columns, from the first to the last.
#[derive(Debug, Default, PartialEq, Eq)]
struct Reach {
    rows: Option<(u16, u16)>,
    columns: Option<(u16, u16)>,
    /// The most cells that it says it has.
    told: u64,
}

impl Reach {
    /// Of the sheet that begins with a stream.
    fn of(stream: &[u8]) -> Self {
        let mut reach = Self::default();
        let (mut has_begun, mut within, mut formula) = (false, 0u64, Some((0, 0)));
        for (kind, data) in records(stream) {
            let place = || u16_at(data, 0).zip(u16_at(data, 2));
            match kind {
                // A chart within a sheet has cells of its own.
                BEGIN_OF_PART if has_begun => within += 1,
                BEGIN_OF_PART => has_begun = true,
                END_OF_PART if within > 0 => within -= 1,
                END_OF_PART => break,
                _ if within > 0 => {}
                DIMENSIONS => reach.told = reach.told.max(told(data).unwrap_or(0)),
                FORMULA => {
                    formula = place().or(formula);
                    reach.take(formula);
                }
                TEXT_OF_FORMULA => reach.take(formula),
                NUMBERS => {
                    reach.take(place());
                    reach.take(u16_at(data, 0).zip(u16_at(data, data.len().saturating_sub(2))));
                }
                _ if CELLS.contains(&kind) => reach.take(place()),
                _ => {}
            }
        }
        reach
    }

    fn take(&mut self, place: Option<(u16, u16)>) {
        let Some((row, column)) = place else { return };
        let wider = |from_to: Option<(u16, u16)>, at: u16| {
            let (from, to) = from_to.unwrap_or((at, at));
            Some((from.min(at), to.max(at)))
        };
        (self.rows, self.columns) = (wider(self.rows, row), wider(self.columns, column));
    }

    fn cells(&self) -> u64 {
        let count = |from_to: Option<(u16, u16)>| from_to.map_or(0, |(from, to)| u64::from(to - from) + 1);
        count(self.rows) * count(self.columns)
    }
}

/// The cells that a sheet says it has, as the library reads it.
fn told(data: &[u8]) -> Option<u64> {
    let short = |at: usize| u16_at(data, at).map(u32::from);
    let (from, to, left, right) = match data.len() {
        10 => (short(0)?, short(2)?, short(4)?, short(6)?),
        14 | 16 => (u32_at(data, 0)?, u32_at(data, 4)?, short(8)?, short(10)?),
        _ => return None,
    };
    let left = if left > 0xff || right < left { 0 } else { left };
    let (rows, columns) = if to > 0 && right > 0 { (to.wrapping_sub(from), right - left) } else { (1, 1) };
    Some(u64::from(rows) * u64::from(columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(kind: u16, data: &[u16]) -> Vec<u8> {
        let data: Vec<u8> = data.iter().flat_map(|word| word.to_le_bytes()).collect();
        [&kind.to_le_bytes()[..], &(data.len() as u16).to_le_bytes()[..], &data[..]].concat()
    }

    fn number(row: u16, column: u16) -> Vec<u8> {
        record(0x0203, &[row, column, 0, 0, 0, 0, 0x4049])
    }

    #[test]
    fn a_sheet_reaches_from_its_first_to_its_last_cell() {
        let begin = record(BEGIN_OF_PART, &[0x0600, 0x10]);
        let chart = [begin.clone(), number(9000, 200), record(END_OF_PART, &[])].concat();
        let own = [number(2, 1), number(4, 3), chart, record(NUMBERS, &[5, 2, 0, 0, 0, 0, 0, 0, 3])].concat();
        let after = [record(END_OF_PART, &[]), number(60_000, 255)].concat();
        let reach = Reach::of(&[begin.clone(), own, after].concat());
        assert_eq!((reach.rows, reach.columns, reach.told), (Some((2, 5)), Some((1, 3)), 0));
        assert_eq!(reach.cells(), 4 * 3);
        let text = [record(FORMULA, &[7, 8]), record(TEXT_OF_FORMULA, &[0])].concat();
        assert_eq!(Reach::of(&text).cells(), 1);
        assert_eq!(Reach::of(&begin).cells(), 0);
        assert_eq!(Reach::of(&number(1, 1)[..9]), Reach::default(), "a record that is cut");
    }

    #[test]
    fn what_a_sheet_says_of_its_size_is_read_as_the_library_reads_it() {
        let cells = |data: &[u16]| Reach::of(&record(DIMENSIONS, data)).told;
        assert_eq!(cells(&[0, 0, 1200, 0, 0, 4, 0]), 4800);
        assert_eq!(cells(&[3, 0, 1200, 0, 300, 4, 0]), 1197 * 4, "a first column that cannot be is 0");
        assert_eq!(cells(&[0, 1200, 0, 4, 0]), 4800, "as Excel 5 writes it");
        assert_eq!(cells(&[0, 0, 0, 0, 0, 0, 0]), 1);
        assert_eq!(cells(&[0, 0, 0, 0x8000, 0, 256, 0]), 0x8000_0000 * 256);
        assert_eq!(cells(&[9, 0, 1, 0, 0, 1, 0]), 0xffff_fff8, "from a row behind its last");
        assert_eq!(cells(&[1, 2]), 0);
    }

    #[test]
    fn a_chain_that_does_not_end_is_none() {
        let bytes: Vec<u8> = (0..160).collect();
        let chain = |table: &[u32], may_be_cut, most| {
            Sectors { bytes: &bytes, size: 64, may_be_cut }.chain(0, table, most).map(|chain| chain.len())
        };
        assert_eq!(chain(&[1, END], true, usize::MAX), Some(128));
        assert_eq!(chain(&[1, 2, END], true, usize::MAX), Some(192), "the last is filled");
        assert_eq!(chain(&[1, 2, END], false, usize::MAX), None);
        assert_eq!(chain(&[1, 0], true, usize::MAX), None, "a circle");
        assert_eq!(chain(&[1, 0], true, 100), Some(100), "its begin is enough");
        assert_eq!(chain(&[1], true, usize::MAX), None, "nothing is said of the next");
        assert_eq!(chain(&[7, END], true, usize::MAX), None, "there is no such sector");
    }
}
