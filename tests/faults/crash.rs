//! What a power failure leaves of the store's files. Whatever the disk was waited for is there; of what it was not, any
//! sectors.

use rand::RngExt;
use rand_pcg::Pcg64;
use std::fs;
use std::path::Path;
use stictiond::store::{Config, Store};

/// What a disk writes whole.
const SECTOR: usize = 512;
const LOG: &str = "store.db-wal";
const STATES: &str = "states.log";
const ACKNOWLEDGED: &str = "store.ack";
const DATABASE: &str = "store.db";

/// Copies the files of a store, without what the system keeps of it in memory.
pub fn copy(from: &Path, to: &Path) {
    let _ = fs::remove_dir_all(to);
    fs::create_dir_all(to).expect("writable");
    for file in fs::read_dir(from).expect("there").map(|file| file.expect("read")) {
        if file.path().is_file() && !file.file_name().to_string_lossy().ends_with("-shm") {
            fs::copy(file.path(), to.join(file.file_name())).expect("copied");
        }
    }
}

fn bytes(folder: &Path, file: &str) -> Vec<u8> {
    fs::read(folder.join(file)).unwrap_or_default()
}

/// A file of which only some sectors came to the disk.
fn torn(before: &[u8], after: &[u8], random: &mut Pcg64) -> Vec<u8> {
    let share = random.random_range(0.0..1.0);
    let mut file = after.to_vec();
    for (at, sector) in file.chunks_mut(SECTOR).enumerate() {
        let from = at * SECTOR;
        if sector != before.get(from..from + sector.len()).unwrap_or_default() && random.random_bool(share) {
            // Where nothing was, there are zeroes.
            for (offset, byte) in sector.iter_mut().enumerate() {
                *byte = before.get(from + offset).copied().unwrap_or(0);
            }
        }
    }
    // The length is written by itself.
    if random.random_bool(0.5) {
        file.truncate(random.random_range(before.len().min(after.len())..=after.len()));
    }
    file
}

/// A crash within a write: the log comes first, then the second copy of the states, then how far both are acknowledged. Where
/// the log was carried over meanwhile, of before or of after.
pub fn within(before: &Path, after: &Path, image: &Path, random: &mut Pcg64) -> &'static str {
    let carried = bytes(before, DATABASE) != bytes(after, DATABASE);
    if carried || random.random_bool(0.1) {
        let whole = random.random_bool(0.5);
        copy(if whole { after } else { before }, image);
        return if whole { "kills after a write" } else { "kills before a write" };
    }
    let stage = random.random_range(0..4);
    copy(before, image);
    let put = |file: &str, bytes: &[u8]| fs::write(image.join(file), bytes).expect("written");
    let log = bytes(after, LOG);
    if stage == 0 {
        put(LOG, &torn(&bytes(before, LOG), &log, random));
        return "torn logs";
    }
    put(LOG, &log);
    let states = bytes(after, STATES);
    if stage == 1 {
        put(STATES, &torn(&bytes(before, STATES), &states, random));
        return "torn second copies";
    }
    put(STATES, &states);
    if stage == 3 {
        put(ACKNOWLEDGED, &bytes(after, ACKNOWLEDGED));
    }
    "kills before a write is acknowledged"
}

/// A crash between two writes, half of them while the log is carried over: then of the database any sectors are new.
pub fn at_rest(folder: &Path, image: &Path, random: &mut Pcg64) -> &'static str {
    copy(folder, image);
    if random.random_bool(0.5) {
        return "kills between two writes";
    }
    let other = image.with_extension("carried");
    copy(folder, &other);
    // It is carried over when it is opened.
    let opened = Store::open(&Config::new(&other)).is_ok();
    if opened {
        let (old, new) = (bytes(folder, DATABASE), bytes(&other, DATABASE));
        let mut half = torn(&old, &new, random);
        half.resize(new.len().max(old.len()), 0);
        fs::write(image.join(DATABASE), half).expect("written");
    }
    fs::remove_dir_all(other).expect("removed");
    "torn databases while the log is carried over"
}
