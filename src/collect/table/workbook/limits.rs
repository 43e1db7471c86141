//! How much memory and work a workbook may take for its bytes.

/// Bytes that a workbook, or what is made of one of its parts, may always take, and how many times its own: as for Parquet.
const FEW_BYTES: u64 = 16_000_000;
const TIMES: u64 = 64;
/// Bytes that may always be moved while texts are put together, which takes less than a second, and how many times the own ones.
const FEW_MOVED: u64 = 1 << 31;
const TIMES_MOVED: u64 = 1 << 13;

/// Bytes that may be made of so many.
pub fn bytes(own: u64) -> u64 {
    FEW_BYTES.max(own.saturating_mul(TIMES))
}

/// Bytes that may be moved while texts are made of so many.
pub fn moved(own: u64) -> u64 {
    FEW_MOVED.max(own.saturating_mul(TIMES_MOVED))
}
