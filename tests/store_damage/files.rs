//! Damage to the files of a store, and what one of them holds.

use std::fs;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Overwrites the first page of a table of a store that nobody has open.
pub fn overwrite(folder: &Path, table: &str) {
    let path = folder.join("store.db");
    let db = rusqlite::Connection::open(&path).expect("opens");
    let sql = "SELECT rootpage FROM sqlite_schema WHERE name = ?1";
    let page: i64 = db.query_row(sql, [table], |row| row.get(0)).expect("a table");
    drop(db);
    let file = fs::OpenOptions::new().write(true).open(path).expect("there");
    file.write_all_at(&[0x5a; 8192], (page as u64 - 1) * 8192).expect("writable");
}

/// Records of a second copy that is whole.
pub fn records(bytes: &[u8]) -> u64 {
    ends(bytes).len() as u64
}

/// Where each of its records ends: it begins with the length of its text, and its head has 16 bytes.
pub fn ends(bytes: &[u8]) -> Vec<usize> {
    let (mut at, mut ends) = (0, Vec::new());
    while let Some(length) = bytes.get(at..at + 4) {
        at += 16 + u32::from_le_bytes(length.try_into().expect("four")) as usize;
        ends.push(at);
    }
    ends
}
