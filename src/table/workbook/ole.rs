//! Looks at an `.xls` before the library opens it: first whether its chains of sectors end, as the library follows a chain that runs
//! in a circle until there is no memory left; then at the records in them.

use super::biff;
use super::fields::{u16_at, u32_at};
use super::limits::{GROWTH_FACTOR, MemoryEstimate};
use crate::table::error::TableError;
use encoding_rs::UTF_16LE;

/// From this number on, the library takes a number for no sector.
const NO_SECTOR: u32 = 0xffff_fffa;
/// From this number on, the library takes a number in the list of tables for no table.
const NO_TABLE: u32 = 0xffff_fffc;
/// The number that ends a chain.
const END: u32 = 0xffff_fffe;

/// Where the head of a file, as Microsoft's document MS-CFB describes it, has the size of sectors, as a power of two.
const SECTOR_SHIFT_AT: usize = 30;
/// Where the head has the first sector of the directory.
const DIRECTORY_AT: usize = 48;
/// Where the head has the first sector of the table of small sectors.
const SMALL_TABLE_AT: usize = 60;
/// Where the head has how many sectors the table of small sectors takes.
const SMALL_TABLE_COUNT_AT: usize = 64;
/// Where the head has the first sector with more of the list of tables.
const MORE_TABLES_AT: usize = 68;
/// Where the head has the first of the list of tables, up to its end.
const TABLES_AT: std::ops::Range<usize> = 76..512;

/// Bytes of an entry of the directory.
const ENTRY_LEN: usize = 128;
/// Most bytes of the name in an entry.
const ENTRY_NAME_LEN: usize = 64;
/// Where an entry has the first sector of its stream.
const FIRST_SECTOR_AT: usize = 116;
/// Where an entry has the low four bytes of the length of its stream.
const LEN_AT: usize = 120;
/// Where an entry has the high four bytes of that length; they mean something only where sectors are large.
const HIGH_LEN_AT: usize = 124;

/// Bytes of a sector in most files.
const SECTOR_SIZE: usize = 512;
/// Bytes of a large sector.
const LARGE_SECTOR_SIZE: usize = 4096;
/// Bytes of a sector of small streams.
const SMALL_SECTOR_SIZE: usize = 64;
/// Bytes below which a stream is a small one.
const MIN_STREAM_LEN: usize = 4096;

/// Adds the memory that a file would take.
///
/// # Errors
/// A file that is damaged, or would take too much memory.
pub fn check(bytes: &[u8], memory: &mut MemoryEstimate) -> Result<(), TableError> {
    let (book, beside) = book(bytes).ok_or_else(|| {
        TableError::refused(
            "a workbook that cannot be read: it is damaged, and its sectors follow each other nowhere or without end; save it again, \
             or the columns that are needed as CSV",
        )
    })?;
    // The library holds all sectors, in a list with twice the room that they need, and copies of the chains.
    memory.add_library_memory(bytes.len() as u64 * 2);
    memory.add_library_memory((book.len() as u64 + beside) * GROWTH_FACTOR);
    biff::check(&book, memory)
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
        // A chain has each sector at most once, and the last sector may be cut.
        for _ in 0..=self.bytes.len() / self.size + 1 {
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

/// The stream of the workbook, empty where there is none, and how many bytes were read beside it; `None` for a file whose sectors
/// cannot be followed.
fn book(bytes: &[u8]) -> Option<(Vec<u8>, u64)> {
    let size = match u16_at(bytes, SECTOR_SHIFT_AT)? {
        9 => SECTOR_SIZE,
        12 => LARGE_SECTOR_SIZE,
        // The library refuses all others.
        _ => return Some((Vec::new(), 0)),
    };
    let sectors = Sectors { bytes: bytes.get(size..)?, size, may_be_cut: true };
    let table = table(bytes, &sectors)?;
    let directory = sectors.chain(u32_at(bytes, DIRECTORY_AT)?, &table, usize::MAX)?;
    let entries = || directory.chunks_exact(ENTRY_LEN);
    let root = entries().next()?;
    let small_tables = u32_at(bytes, SMALL_TABLE_COUNT_AT)? as usize;
    let (mut small_table, mut small) = (Vec::new(), Vec::new());
    if small_tables > 0 {
        small = sectors.chain(u32_at(root, FIRST_SECTOR_AT)?, &table, len(root, size)?)?;
        let first = u32_at(bytes, SMALL_TABLE_AT)?;
        let chain = sectors.chain(first, &table, small_tables.saturating_mul(size))?;
        small_table = numbers(&chain).collect();
    }
    let named = |name: &str| entries().find(|entry| name_of(entry).eq_ignore_ascii_case(name));
    let beside =
        (directory.len() + small.len() + size_of::<u32>() * (table.len() + small_table.len())) as u64;
    let Some(entry) = named("Workbook").or_else(|| named("Book")) else { return Some((Vec::new(), beside)) };
    let (first, len) = (u32_at(entry, FIRST_SECTOR_AT)?, len(entry, size)?);
    let book = if len < MIN_STREAM_LEN {
        let sectors = Sectors { bytes: &small, size: SMALL_SECTOR_SIZE, may_be_cut: false };
        sectors.chain(first, &small_table, len)?
    } else {
        sectors.chain(first, &table, len)?
    };
    Some((book, beside))
}

/// Which sector follows each.
fn table(bytes: &[u8], sectors: &Sectors<'_>) -> Option<Vec<u32>> {
    let most = sectors.bytes.len() / sectors.size + 2;
    let mut listed: Vec<u32> = numbers(bytes.get(TABLES_AT)?).collect();
    let mut next = u32_at(bytes, MORE_TABLES_AT)?;
    let mut lists = 0;
    while next < NO_SECTOR {
        lists += 1;
        if lists > most {
            return None;
        }
        listed.extend(numbers(&sectors.get(next)?));
        next = listed.pop()?;
    }
    listed.retain(|id| *id < NO_TABLE);
    // Each is a sector of its own.
    if listed.len() > most {
        return None;
    }
    let mut table = Vec::new();
    for id in listed {
        table.extend(numbers(&sectors.get(id)?));
    }
    Some(table)
}

/// The name of an entry of the directory.
fn name_of(entry: &[u8]) -> String {
    let name = UTF_16LE.decode(&entry[..ENTRY_NAME_LEN]).0;
    name.split('\0').next().unwrap_or_default().to_string()
}

/// Bytes of the stream of an entry.
fn len(entry: &[u8], size: usize) -> Option<usize> {
    let high = if size == SECTOR_SIZE { 0 } else { u64::from(u32_at(entry, HIGH_LEN_AT)?) };
    usize::try_from((high << 32) | u64::from(u32_at(entry, LEN_AT)?)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

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
