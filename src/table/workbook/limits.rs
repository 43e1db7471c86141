//! How much memory and work a workbook may take for its bytes.

/// Bytes of memory that reading a workbook may always take, the file itself among them: as for Parquet.
const FEW_BYTES: u64 = 16_000_000;
/// How many times its own bytes a larger workbook may take: as for Parquet.
const TIMES: u64 = 64;
/// Most bytes of memory for any workbook. A sheet with the most rows that Excel has and a dozen columns fits, with its record.
const MOST_BYTES: u64 = 1 << 31;
/// Bytes that may always be moved while the library puts texts together: that takes less than a second.
const FEW_MOVED: u64 = 1 << 31;
/// How many times the bytes of a larger file may be moved.
const TIMES_MOVED: u64 = 1 << 13;
/// Bytes of a `String` itself, without its characters: the library keeps its texts in lists of these.
pub const TEXT: u64 = size_of::<String>() as u64;
/// How many times the bytes of its entries a growing list takes: its room doubles, and the old room is there while the new one is
/// filled.
pub const GROWING: u64 = 3;

/// Most bytes of memory that reading a workbook of `own` bytes may take.
pub fn bytes(own: u64) -> u64 {
    FEW_BYTES.max(own.saturating_mul(TIMES)).min(MOST_BYTES)
}

/// Most bytes that the library may move while it puts texts together from `own` bytes.
pub fn moved(own: u64) -> u64 {
    FEW_MOVED.max(own.saturating_mul(TIMES_MOVED))
}

/// Bytes that an allocator takes for so many: it rounds up to multiples of 16.
pub fn heap(bytes: u64) -> u64 {
    const STEP: u64 = 16;
    bytes.saturating_add(STEP - 1) / STEP * STEP
}

/// An upper bound on the memory that reading a workbook takes, counted before it is allocated. Each guard adds what it finds. The
/// sum is simple, so parts of it are counted high; none is counted low.
#[derive(Debug)]
pub struct Weight {
    /// Bytes of the file.
    own: u64,
    /// What the library holds as long as the workbook is open, with the file itself (bytes).
    library: u64,
    /// Its largest buffer (bytes).
    buffer: u64,
    /// The most that it holds besides, at any moment while it opens the workbook (bytes).
    opening: u64,
    /// The largest copy of a sheet that it hands to us (bytes).
    handed: u64,
    /// The sheets as we keep them (bytes).
    kept: u64,
    /// What is made of the sheets once the workbook is closed (bytes).
    made: u64,
}

impl Weight {
    /// The bound for a file of `own` bytes, before any guard has looked at it.
    pub fn of(own: u64) -> Self {
        Self { own, library: own, buffer: 0, opening: 0, handed: 0, kept: 0, made: 0 }
    }

    /// Bytes of the file.
    pub fn own(&self) -> u64 {
        self.own
    }

    /// The library holds so many bytes more.
    pub fn library(&mut self, bytes: u64) {
        self.library = self.library.saturating_add(bytes);
    }

    /// One of its buffers has so many bytes.
    pub fn buffer(&mut self, bytes: u64) {
        self.buffer = self.buffer.max(bytes);
    }

    /// It takes so many bytes at a moment while it opens the workbook.
    pub fn opening(&mut self, bytes: u64) {
        self.opening = self.opening.max(bytes);
    }

    /// A sheet that it hands over has so many bytes.
    pub fn handed(&mut self, bytes: u64) {
        self.handed = self.handed.max(bytes);
    }

    /// So many bytes more of sheets are kept, and so many will be made of them.
    pub fn keep(&mut self, kept: u64, made: u64) {
        (self.kept, self.made) = (self.kept.saturating_add(kept), self.made.saturating_add(made));
    }

    /// Bytes that are taken at most at any moment.
    fn taken(&self) -> u64 {
        let read = self.opening.max(self.handed.saturating_add(self.kept));
        let with_library = self.library.saturating_add(self.buffer).saturating_add(read);
        with_library.max(self.kept.saturating_add(self.made))
    }

    /// What is wrong with a workbook that would take too much memory; `None` for one that may be read.
    pub fn over(&self) -> Option<String> {
        let (taken, most, own) = (self.taken(), bytes(self.own), self.own);
        (taken > most).then(|| {
            format!("would take {taken} bytes of memory, where {most} are allowed for a file of {own} bytes")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_file_may_take_little_and_a_large_one_in_proportion_up_to_a_bound() {
        assert_eq!([0, 250_000, 250_001, 1 << 20].map(bytes), [16_000_000, 16_000_000, 16_000_064, 64 << 20]);
        assert_eq!([1 << 25, 1 << 28, u64::MAX].map(bytes), [1 << 31; 3]);
        assert_eq!([0, 1, 16, 17].map(heap), [0, 16, 16, 32]);
    }

    #[test]
    fn parts_that_are_there_at_once_count_together() {
        let mut weight = Weight::of(100);
        weight.library(20);
        weight.buffer(3);
        weight.buffer(2);
        assert_eq!(weight.taken(), 123);
        weight.opening(50);
        assert_eq!(weight.taken(), 173);
        weight.handed(30);
        weight.keep(25, 10);
        assert_eq!(weight.taken(), 100 + 20 + 3 + 30 + 25, "more than while it was opened");
        weight.keep(100, 400);
        assert_eq!(weight.taken(), 125 + 410, "the library is gone when the record is made");
        assert_eq!(weight.over(), None);
        weight.keep(0, 16_000_000);
        let said = "would take 16000535 bytes of memory, where 16000000 are allowed for a file of 100 bytes";
        assert_eq!(weight.over().as_deref(), Some(said));
        weight.library(u64::MAX);
        assert!(weight.over().is_some(), "sums do not overflow");
    }
}
