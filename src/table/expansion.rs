//! How far a packed file may expand when it is read. A file of a few kilobytes can claim to hold more than a machine has.

/// Smallest limit (bytes): what is there once, such as a list of styles, may outweigh a short record.
const MIN_EXPANSION_LIMIT: u64 = 16_000_000;
/// Bytes for each byte of a larger file: the densest workbooks of `tests/workbook_memory.rs` stay below it.
const EXPANSION_PER_FILE_BYTE: u64 = 64;

/// Most bytes that a file of `file_bytes` may expand to: 64 times as many, or 16 MB where that is more.
pub fn expansion_limit(file_bytes: u64) -> u64 {
    MIN_EXPANSION_LIMIT.max(file_bytes.saturating_mul(EXPANSION_PER_FILE_BYTE))
}

#[cfg(test)]
mod tests {
    use super::expansion_limit;

    #[test]
    fn a_large_file_may_expand_in_proportion() {
        let limits = [0, 250_000, 250_001, 1 << 20, u64::MAX].map(expansion_limit);
        assert_eq!(limits, [16_000_000, 16_000_000, 16_000_064, 64 << 20, u64::MAX]);
    }
}
