//! Archives of files that are compressed, as programs write workbooks.

use super::archive::{Part, of_parts};
use flate2::Compression;
use flate2::write::DeflateEncoder;
use std::io::Write;

/// A ZIP archive of files that are compressed.
pub fn packed(files: &[(&str, &[u8])]) -> Vec<u8> {
    let pack = |bytes: &[u8]| {
        let mut packed = DeflateEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(bytes).expect("into memory");
        packed.finish().expect("into memory")
    };
    let packed: Vec<Vec<u8>> = files.iter().map(|(_, bytes)| pack(bytes)).collect();
    let parts = files.iter().zip(&packed).map(|((name, bytes), packed)| {
        let unpacked = (bytes.len() as u32, crc32fast::hash(bytes));
        Part { name, method: 8, bytes: packed, unpacked }
    });
    of_parts(&parts.collect::<Vec<_>>())
}
