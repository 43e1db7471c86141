use super::{ACKNOWLEDGED, Damage, Ledger, PAGE_BYTES, SUMS, examine, examine_beside, examine_some, marked};
use crate::store::backend::Writes;
use crate::store::embedded::frames::log_of;
use crate::store::embedded::tests::{Folder, all, batch, good, tag};
use crate::store::embedded::{DATABASE, Store};
use crate::store::{Config, StoreError, Upkeep};
use rusqlite::{Connection, OpenFlags};
use std::fs::{self, OpenOptions};
use std::os::unix::fs::{FileExt, symlink};
use std::time::Duration;

/// What a power failure leaves of a store: its files, but of how far the log was acknowledged only what the disk was waited for.
fn cut_off(store: &Folder, waited_for: &[u8]) -> Folder {
    let image = Folder::new();
    fs::create_dir_all(&image.0).expect("writable");
    for file in [DATABASE, SUMS] {
        fs::copy(store.0.join(file), image.0.join(file)).expect("copied");
    }
    fs::copy(log_of(&store.0), log_of(&image.0)).expect("copied");
    fs::write(image.0.join(ACKNOWLEDGED), waited_for).expect("written");
    image
}

fn acknowledged(store: &Folder) -> Vec<u8> {
    fs::read(store.0.join(ACKNOWLEDGED)).expect("there")
}

/// A store whose log was carried over while somebody reads what was there before, and that reader. So the log could not be cut.
fn carried_over_under_a_reader(folder: &Folder) -> (Store, Connection) {
    let mut store = Store::open(&folder.config()).expect("opens");
    store.write(&batch(&tag("A", "op"), good(0..10))).expect("writes");
    let path = folder.0.join(DATABASE);
    let reader = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY).expect("opens");
    reader.execute_batch("BEGIN").expect("begins");
    let tags: i64 = reader.query_row("SELECT count(*) FROM tags", [], |row| row.get(0)).expect("reads");
    assert_eq!(tags, 1);
    // The store does not wait for the reader.
    store.db.busy_timeout(Duration::ZERO).expect("no wait");
    store.carry_over().expect("carried over");
    (store, reader)
}

/// Somebody reads what was there before the log was carried over. So it cannot be cut, and what comes next goes behind it.
#[test]
fn what_goes_behind_a_log_that_was_carried_over_is_not_cut_away_with_it() {
    let folder = Folder::new();
    let (mut store, reader) = carried_over_under_a_reader(&folder);
    let (length, waited_for) = (store.log_bytes(), acknowledged(&folder));
    store.write(&batch(&tag("A", "op"), good(10..20))).expect("writes");
    assert!(length > 0 && store.log_bytes() > length, "the log goes on");
    let image = cut_off(&folder, &waited_for);
    drop((reader, store));
    let again = Store::open(&image.config()).expect("a power failure is no damage");
    assert_eq!(all(&image)[&1], good(0..20));
    drop(again);
    assert_eq!(all(&image)[&1], good(0..20), "in the database");
}

/// A part of it would turn pages back. All of it is read by somebody, who would go on behind a hole.
#[test]
fn of_a_log_that_was_carried_over_only_a_part_is_cut() {
    let folder = Folder::new();
    let (_store, reader) = carried_over_under_a_reader(&folder);
    let image = cut_off(&folder, &acknowledged(&folder));
    let length = || fs::metadata(log_of(&image.0)).expect("there").len();
    let before = length();
    drop(Ledger::open(&image.0, Upkeep::default()).expect("opens"));
    assert!(before > 0 && length() == before, "{before} bytes, now {}", length());
    let log = OpenOptions::new().write(true).open(log_of(&image.0)).expect("there");
    log.set_len(before - 1).expect("writable");
    drop(Ledger::open(&image.0, Upkeep::default()).expect("opens"));
    assert_eq!(length(), 0);
    drop(reader);
}

/// Whatever of the log is in the database by then: the log has all of it.
#[test]
fn a_power_failure_while_the_log_is_carried_over_is_no_damage() {
    let (folder, op) = (Folder::new(), tag("A", "op"));
    let mut store = Store::open(&folder.config()).expect("opens");
    store.write(&batch(&op, good(0..10))).expect("writes");
    store.carry_over().expect("carried over");
    let waited_for = acknowledged(&folder);
    store.write(&batch(&op, good(10..20))).expect("writes");
    let image = cut_off(&folder, &waited_for);
    store.db.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(())).expect("carried over");
    fs::copy(folder.0.join(DATABASE), image.0.join(DATABASE)).expect("copied");
    drop(store);
    let _store = Store::open(&image.config()).expect("a power failure is no damage");
    assert_eq!(all(&image)[&1], good(0..20));
}

/// As without a free descriptor or without the right to read: nobody knows what the file holds, and nobody is to decide.
#[test]
fn a_file_that_cannot_be_opened_is_an_error_and_no_damage() {
    for name in [DATABASE, SUMS, ACKNOWLEDGED] {
        let (folder, op) = (Folder::new(), tag("A", "op"));
        let mut store = Store::open(&folder.config()).expect("opens");
        store.write(&batch(&op, good(0..10))).expect("writes");
        drop(store);
        let (path, aside) = (folder.0.join(name), folder.0.join("aside"));
        fs::rename(&path, &aside).expect("writable");
        symlink(&path, &path).expect("leads to itself");
        let error = Store::open(&folder.config()).expect_err("it cannot be opened");
        assert!(matches!(error, StoreError::Io { .. }) && error.to_string().contains(name), "{error}");
        assert_eq!(marked(&folder.0), None, "{name}");
        fs::remove_file(&path).expect("writable");
        fs::rename(&aside, &path).expect("writable");
        drop(Store::open(&folder.config()).expect("works again"));
        assert_eq!(all(&folder)[&1], good(0..10));
    }
    let folder = Folder::new();
    drop(Store::open(&folder.config()).expect("opens"));
    fs::remove_file(folder.0.join(DATABASE)).expect("writable");
    assert!(Store::open(&folder.config()).is_err_and(|error| error.is_damage()));
    assert!(marked(&folder.0).is_some_and(|why| why.contains("is gone")), "that is damage");
}

/// Who looks beside a writer looks again at what was found, and at nothing else.
#[test]
fn what_is_found_beside_a_writer_is_looked_at_again_and_no_more() {
    let folder = Folder::new();
    let upkeep = Upkeep { each: 0, ..Upkeep::default() };
    let store = Store::open(&Config { upkeep, ..folder.config() }).expect("opens");
    let [first, second] = ["spool", "known_models"].map(|name| -> u32 {
        let sql = "SELECT rootpage FROM sqlite_schema WHERE name = ?1";
        store.db.query_row(sql, [name], |row| row.get(0)).expect("there is one")
    });
    let file = OpenOptions::new().write(true).open(folder.0.join(DATABASE)).expect("there");
    let damaged = |page: u32| {
        let at = u64::from(page - 1) * PAGE_BYTES;
        file.write_all_at(&[0x5a; PAGE_BYTES as usize], at).expect("writable");
    };
    damaged(first);
    let before = examine(&folder.0, u32::MAX).expect("can be read");
    damaged(second);
    let again = examine_some(&folder.0, |_| before.pages.iter().copied()).expect("can be read");
    assert_eq!((&before.pages, again == before), (&vec![first], true), "the second was not looked at");
    assert_eq!(examine_beside(&folder.0).expect("can be read").pages.len(), 2);
}

#[test]
fn what_is_not_found_again_beside_a_writer_is_no_damage() {
    let found = |fault: &str, pages: &[u32], log| Damage {
        faults: vec![fault.to_string()],
        pages: pages.to_vec(),
        log,
    };
    let (before, again) = (found("1 of 7 is bad", &[2, 3, 9], true), found("2 of 80 is bad", &[3, 4], true));
    assert_eq!(again.confirms(&before), found("2 of 80 is bad", &[3], true), "numbers grow");
    let other = found("7 is gone", &[], false);
    assert_eq!(other.confirms(&before), Damage::default());
}
