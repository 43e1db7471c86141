use super::*;
use crate::signal::Sample;
use crate::store::backend::Writes;
use crate::store::embedded::tests::Folder;
use crate::store::embedded::{Store, marked};
use crate::store::{AlarmRow, Batch, Reader, Row, Series, TagName};
use std::os::unix::fs::FileExt;
use std::sync::Arc;

const PAGE: usize = 8192;

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("writable");
    for file in fs::read_dir(from).expect("there").map(|file| file.expect("read")) {
        // What SQLite keeps in memory between processes is made anew.
        if !file.file_name().to_string_lossy().ends_with("-shm") {
            fs::copy(file.path(), to.join(file.file_name())).expect("copied");
        }
    }
}

/// Alarms and samples of a store.
fn content(folder: &Path) -> (Vec<AlarmRow>, Vec<Sample>) {
    let mut reader = Reader::open(folder).expect("can be read");
    let samples = reader.between("A", "pv", 0.0, 1e9).expect("reads");
    (reader.alarms().expect("reads"), samples)
}

/// A store that was killed at work, so that a part of it is in its log, and of which a page is damaged that holds nothing.
fn damaged() -> Folder {
    let (live, killed) = (Folder::new(), Folder::new());
    let mut store = Store::open(&Config::new(&live.0)).expect("opens");
    let name =
        TagName { control_loop: "A".into(), tag: "pv".into(), source: "s".into(), unit: String::new() };
    let samples = (0..200).map(|i| Sample::good(1000.0 + f64::from(i), f64::from(i))).collect();
    let alarm = AlarmRow { control_loop: "A".into(), kind: "stiction".into(), ..AlarmRow::default() };
    let series = vec![Series { tag: Arc::new(name), samples }];
    store.write(&Batch { series, rows: vec![Row::Alarm(alarm)] }).expect("writes");
    let sql = "SELECT rootpage FROM sqlite_schema WHERE name = 'spool'";
    let page: i64 = store.db.query_row(sql, [], |row| row.get(0)).expect("reads");
    copy(&live.0, &killed.0);
    drop(store);
    let file = fs::OpenOptions::new().write(true).open(killed.0.join(DATABASE)).expect("there");
    file.write_all_at(&[0x5a; PAGE], (page as u64 - 1) * PAGE as u64).expect("writable");
    assert!(Store::open(&Config::new(&killed.0)).is_err_and(|error| error.is_damage()));
    killed
}

/// The next start, or another repair, ends what was begun; before that everything can be read.
#[test]
fn a_crash_at_any_step_of_a_repair_loses_nothing() {
    let killed = damaged();
    let truth = content(&killed.0);
    assert_eq!((truth.0.len(), truth.1.len()), (1, 200), "in the log too");
    let count = steps(&killed.0, &killed.0).len();
    assert!(
        count >= 8,
        "the database with its log and its index, the ledger, the mark, the second copy: {count}"
    );
    for (done, is_repaired) in (0..=count).flat_map(|done| [(done, false), (done, true)]) {
        let own = Folder::new();
        copy(&killed.0, &own.0);
        let config = Config::new(&own.0);
        let (_, away) = prepare(&own.0).expect("made");
        for (from, to) in steps(&own.0, &away).into_iter().take(done) {
            let is_there = from.is_file();
            assert_eq!(fs::rename(from, to).is_ok(), is_there);
        }
        let what = format!("{done} steps were done, repaired again: {is_repaired}");
        assert_eq!(content(&own.0), truth, "{what}");
        if is_repaired {
            repair(&config).expect("repaired");
        }
        drop(Store::open(&config).unwrap_or_else(|error| panic!("{what}: {error}")));
        assert_eq!(
            (content(&own.0), marked(&own.0), unfinished(&own.0)),
            (truth.clone(), None, None),
            "{what}"
        );
        assert!(away.join(DATABASE).is_file() && away.join("store.damaged").is_file(), "{what}");
    }
}

#[test]
fn what_a_repair_left_that_did_not_get_far_is_made_anew() {
    let own = damaged();
    let truth = content(&own.0);
    for name in ["store.new", "store.new-journal"] {
        fs::write(own.0.join(name), "a part of it").expect("writable");
    }
    let (loss, away) = repair(&Config::new(&own.0)).expect("repaired");
    assert_eq!((loss.blobs, loss.states), (0, 0));
    assert!(away.ends_with("damaged-1"));
    assert_eq!(content(&own.0), truth);
    assert!(!own.0.join("store.new").exists());
    assert_eq!(finish_repair(&Config::new(&own.0)).expect("nothing is left to do"), None);
}

#[test]
fn what_a_repair_before_has_put_away_is_not_written_over() {
    let own = damaged();
    let truth = content(&own.0);
    fs::create_dir(own.0.join("damaged-1")).expect("writable");
    fs::write(own.0.join("damaged-1").join(DATABASE), "of before").expect("writable");
    let (_, away) = prepare(&own.0).expect("made");
    assert!(away.ends_with("damaged-2"));
    fs::remove_dir(&away).expect("nothing is in it");
    let ended = finish_repair(&Config::new(&own.0)).expect("ended");
    assert_eq!(ended, Some(own.0.join("damaged-2")));
    assert_eq!(fs::read(own.0.join("damaged-1").join(DATABASE)).expect("there"), b"of before");
    assert_eq!(content(&own.0), truth);
}

/// Who reads it outlives the exchange, and would read a database that is written to by another name.
#[test]
fn nobody_reads_a_repaired_store_while_it_is_put_into_its_place() {
    let own = damaged();
    let truth = content(&own.0);
    prepare(&own.0).expect("made");
    let held = lock(&own.0).expect("free");
    assert!(matches!(Reader::open(&own.0), Err(StoreError::InUse(_))));
    drop(held);
    assert_eq!(content(&own.0), truth, "nobody is at work");
}

#[test]
fn an_address_is_of_any_path() {
    assert_eq!(
        unchanging(Path::new("/a b/50%?#/s-1_ü.db")),
        "file:/a%20b/50%25%3f%23/s-1_%c3%bc.db?immutable=1"
    );
}
