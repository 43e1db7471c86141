//! How much memory it takes to read and to repair a store that is damaged, as the allocator counts it for the whole process: so this
//! is one test, in a process of its own. The store is large, and nearly all of it is empty.

use peak_alloc::PeakAlloc;
use std::fs::{self, OpenOptions};
use std::hint::black_box;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stictiond::signal::Sample;
use stictiond::store::{self, AlarmRow, Batch, Config, Reader, Row, Series, Store, TagName};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

const PAGE: u64 = 8192;
/// Bytes of the database.
const LENGTH: u64 = 400 << 20;
/// Most bytes that may be held beside what the database itself holds.
const MOST: usize = 8 << 20;
/// Most that the process may take of the machine, with what SQLite holds.
const MOST_RESIDENT: u64 = 200 << 20;

/// Does something; the most memory that it held at once, beyond what was held before (bytes).
fn most_held<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    let done = work();
    (done, MEMORY.peak_usage().saturating_sub(before))
}

/// What the system says of this process: a field of one of its files.
fn told(file: &str, field: &str) -> u64 {
    let text = fs::read_to_string(Path::new("/proc/self").join(file)).expect("the system tells");
    let line = text.lines().find_map(|line| line.strip_prefix(field)).expect("there is such a field");
    line.split_whitespace().next().and_then(|number| number.parse().ok()).expect("a number")
}

/// Bytes that were read from files.
fn bytes_read() -> u64 {
    told("io", "rchar:")
}

/// A store with an alarm and samples, of which the samples' page is overwritten, and empty pages behind its end.
fn damaged() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("store-memory-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    let mut store = Store::open(&Config::new(&folder)).expect("opens");
    let (control_loop, tag, source, unit) = ("A".into(), "pv".into(), "s".into(), String::new());
    let samples = (0..300).map(|i| Sample::good(1000.0 + f64::from(i), f64::from(i))).collect();
    let tag = Arc::new(TagName { control_loop, tag, source, unit });
    let alarm = AlarmRow { control_loop: "A".into(), kind: "stiction".into(), ..AlarmRow::default() };
    let batch = Batch { series: vec![Series { tag, samples }], rows: vec![Row::Alarm(alarm)] };
    store.insert(&batch).expect("writes");
    drop(store);
    let path = folder.join("store.db");
    let db = rusqlite::Connection::open(&path).expect("opens");
    let sql = "SELECT rootpage FROM sqlite_schema WHERE name = 'chunks'";
    let page: i64 = db.query_row(sql, [], |row| row.get(0)).expect("reads");
    drop(db);
    let file = OpenOptions::new().write(true).open(path).expect("there");
    file.write_all_at(&[0x5a; PAGE as usize], (page as u64 - 1) * PAGE).expect("writable");
    file.set_len(LENGTH).expect("a file may have holes");
    folder
}

#[test]
fn what_is_left_of_a_large_store_is_read_in_little_memory_and_once() {
    // A count that does not grow would hold any bound.
    let (_, counted) = most_held(|| black_box(vec![1_u8; 3 << 20]).len());
    assert!((3 << 20..4 << 20).contains(&counted), "{counted}");
    let folder = damaged();
    let config = Config::new(&folder);
    assert!(Store::open(&config).is_err_and(|error| error.is_damage()));

    let before = bytes_read();
    let (reader, most) = most_held(|| Reader::open(&folder).expect("what is left can be read"));
    let read = bytes_read() - before;
    let (left, states) = reader.lost().expect("it is damaged");
    assert!(left.contains("samples: some may be lost"), "{left}");
    assert_eq!((reader.alarms().expect("reads").len(), states), (1, 0), "{left}");
    println!("{most} bytes held and {read} bytes read for the first who reads {LENGTH} bytes");
    assert!(most <= MOST, "{most} bytes are held");
    assert!(read >= LENGTH, "it reads all: {read}");

    let before = bytes_read();
    let again = Reader::open(&folder).expect("what is left can be read");
    assert_eq!(again.lost(), reader.lost());
    let read = bytes_read() - before;
    assert!(read < LENGTH / 100, "{read} bytes are read anew for the next");
    drop((again, reader));

    let (repaired, most) = most_held(|| store::repair(&config).expect("repaired"));
    assert!(repaired.aside.join("store.db").is_file());
    assert!(most <= MOST, "{most} bytes are held by the repair");
    drop(Store::open(&config).expect("works again"));
    let resident = told("status", "VmHWM:") * 1024;
    assert!(resident <= MOST_RESIDENT, "{resident} bytes of the machine");
    fs::remove_dir_all(folder).expect("removed");
}
