//! How much memory and work a workbook may take for its bytes, and the estimate of the memory that it would take.

use crate::table::expansion::expansion_limit;
use calamine::Data;

/// Largest memory limit (bytes). A sheet with the most rows that Excel has and a dozen columns fits, with its record.
const MAX_MEMORY_LIMIT: u64 = 1 << 31;
/// Smallest limit of bytes that are shifted: that takes less than a second.
const MIN_SHIFT_LIMIT: u64 = 1 << 31;
/// Bytes that may be shifted for each byte of a larger file. The limit grows from files of 256 KiB on, as the memory limit does.
const SHIFTS_PER_FILE_BYTE: u64 = 1 << 13;
/// Multiple of bytes to which an allocator rounds up: the alignment that it guarantees.
const ALLOCATION_STEP: u64 = 16;
/// How many times the bytes that it reads into a buffer the library takes for it: it has the bytes and their text, each in a buffer
/// that grows.
const BUFFER_FACTOR: u64 = 2 * GROWTH_FACTOR;

/// How many times the bytes of its entries a growing list takes: its room doubles, and the old room is there while the new one is
/// filled.
pub const GROWTH_FACTOR: u64 = 3;
/// Bytes of a `String` itself, without its characters: the library keeps its texts in lists of these.
pub const STRING_SIZE: u64 = size_of::<String>() as u64;
/// Bytes of the value of a cell in the library's sheets, without the characters of its text.
pub const VALUE_SIZE: u64 = size_of::<Data>() as u64;
/// Bytes that the library takes for a sheet, a style, a name of cells or a relationship, in lists that grow, with the path of its part.
/// The entries differ, so one number is high for all of them.
pub const ENTRY_SIZE: u64 = 1024;

/// Most bytes of memory that reading a workbook of `file_bytes` may take, the file itself among them.
pub fn memory_limit(file_bytes: u64) -> u64 {
    expansion_limit(file_bytes).min(MAX_MEMORY_LIMIT)
}

/// Most bytes that the library may shift while it builds texts from `file_bytes`. What is inserted into a text or removed from a list
/// shifts all that stands behind it, so the time grows with the square of the length.
pub fn shift_limit(file_bytes: u64) -> u64 {
    MIN_SHIFT_LIMIT.max(file_bytes.saturating_mul(SHIFTS_PER_FILE_BYTE))
}

/// Bytes that an allocator takes for so many.
pub fn allocation_size(bytes: u64) -> u64 {
    bytes.saturating_add(ALLOCATION_STEP - 1) / ALLOCATION_STEP * ALLOCATION_STEP
}

/// An upper bound on the memory that reading a workbook takes, counted before it is allocated. Each guard adds what it finds. The
/// sum is simple, so parts of it are counted high; none is counted low.
///
/// What is there together is added up (`add_…`). Of what is there one after the other, the largest counts (`raise_…`).
#[derive(Debug)]
pub struct MemoryEstimate {
    /// Bytes of the file.
    file_bytes: u64,
    /// What the library holds as long as the workbook is open, with the file itself (bytes).
    library_memory: u64,
    /// The library's largest buffer (bytes).
    largest_buffer: u64,
    /// The most that the library holds besides, at any moment while it opens the workbook (bytes).
    opening_peak: u64,
    /// The largest copy of a sheet that the library hands to us (bytes).
    largest_sheet_copy: u64,
    /// The sheets as we keep them (bytes).
    sheet_memory: u64,
    /// What is made of the sheets once the workbook is closed (bytes).
    record_memory: u64,
}

impl MemoryEstimate {
    /// The estimate for a file of `file_bytes`, before any guard has looked at it.
    pub fn of_file(file_bytes: u64) -> Self {
        Self {
            file_bytes,
            library_memory: file_bytes,
            largest_buffer: 0,
            opening_peak: 0,
            largest_sheet_copy: 0,
            sheet_memory: 0,
            record_memory: 0,
        }
    }

    /// Bytes of the file.
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// The library holds so many bytes more as long as the workbook is open.
    pub fn add_library_memory(&mut self, bytes: u64) {
        self.library_memory = self.library_memory.saturating_add(bytes);
    }

    /// The library reads so many bytes of the file into one buffer.
    pub fn raise_largest_buffer(&mut self, bytes_read: u64) {
        self.largest_buffer = self.largest_buffer.max(bytes_read.saturating_mul(BUFFER_FACTOR));
    }

    /// The library takes so many bytes at a moment while it opens the workbook.
    pub fn raise_opening_peak(&mut self, bytes: u64) {
        self.opening_peak = self.opening_peak.max(bytes);
    }

    /// A sheet that the library hands to us has so many bytes.
    pub fn raise_largest_sheet_copy(&mut self, bytes: u64) {
        self.largest_sheet_copy = self.largest_sheet_copy.max(bytes);
    }

    /// We keep so many bytes more of sheets.
    pub fn add_sheet_memory(&mut self, bytes: u64) {
        self.sheet_memory = self.sheet_memory.saturating_add(bytes);
    }

    /// So many bytes more will be made of the sheets once the workbook is closed.
    pub fn add_record_memory(&mut self, bytes: u64) {
        self.record_memory = self.record_memory.saturating_add(bytes);
    }

    /// Most bytes that are taken at any moment.
    fn peak(&self) -> u64 {
        let reading = self.opening_peak.max(self.largest_sheet_copy.saturating_add(self.sheet_memory));
        let while_open = self.library_memory.saturating_add(self.largest_buffer).saturating_add(reading);
        while_open.max(self.sheet_memory.saturating_add(self.record_memory))
    }

    /// What is wrong with a workbook that would take more memory than its limit; `None` for one that may be read.
    pub fn over_limit(&self) -> Option<String> {
        let (peak, limit, own) = (self.peak(), memory_limit(self.file_bytes), self.file_bytes);
        (peak > limit).then(|| {
            format!("would take {peak} bytes of memory, where {limit} are allowed for a file of {own} bytes")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_file_may_take_little_and_a_large_one_in_proportion_up_to_a_bound() {
        assert_eq!([0, 250_001, 1 << 20].map(memory_limit), [16_000_000, 16_000_064, 64 << 20]);
        assert_eq!([1 << 25, 1 << 28, u64::MAX].map(memory_limit), [1 << 31; 3]);
        assert_eq!([0, 1 << 18, 1 << 19].map(shift_limit), [1 << 31, 1 << 31, 1 << 32]);
        assert_eq!([0, 1, 16, 17].map(allocation_size), [0, 16, 16, 32]);
    }

    #[test]
    fn parts_that_are_there_at_once_count_together() {
        let mut memory = MemoryEstimate::of_file(100);
        memory.add_library_memory(20);
        memory.raise_largest_buffer(3);
        memory.raise_largest_buffer(2);
        assert_eq!(memory.peak(), 100 + 20 + 6 * 3, "the bytes and their text, in buffers that grow");
        memory.raise_opening_peak(50);
        assert_eq!(memory.peak(), 138 + 50);
        memory.raise_largest_sheet_copy(30);
        memory.add_sheet_memory(25);
        memory.add_record_memory(10);
        assert_eq!(memory.peak(), 138 + 30 + 25, "more than while it was opened");
        memory.add_sheet_memory(100);
        memory.add_record_memory(400);
        assert_eq!(memory.peak(), 125 + 410, "the library is gone when the record is made");
        assert_eq!(memory.over_limit(), None);
        memory.add_record_memory(16_000_000);
        let said = "would take 16000535 bytes of memory, where 16000000 are allowed for a file of 100 bytes";
        assert_eq!(memory.over_limit().as_deref(), Some(said));
        memory.add_library_memory(u64::MAX);
        assert!(memory.over_limit().is_some(), "sums do not overflow");
    }
}
