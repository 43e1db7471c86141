use super::running::LONGEST;
use super::*;
use crate::signal::Sample;
use crate::store::embedded::tests::Folder;
use crate::store::{AlarmRow, ModelRow, Row, Series, Spool, TagName, Writes};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Remembers what it is to merge, and has nothing to write.
#[derive(Default)]
struct Merging(Batch, Arc<Mutex<Vec<Found>>>);

impl Feed for Merging {
    fn gather(&mut self) {}
    fn take(&mut self) -> &Batch {
        &self.0
    }
    fn settled(&mut self) -> bool {
        false
    }
    fn set_back(&mut self) -> bool {
        false
    }
    fn merge(&mut self, found: Found) {
        self.1.lock().expect("no panic").push(found);
    }
}

#[test]
fn what_could_not_be_read_at_the_start_is_merged_once_the_store_works() {
    let folder = Folder::new();
    let config = Config::new(&folder.0);
    let alarm = AlarmRow {
        control_loop: "A".into(),
        kind: "stiction".into(),
        acknowledged: true,
        ..AlarmRow::default()
    };
    let model = |version| ModelRow { control_loop: "A".into(), version, ..ModelRow::default() };
    let mut other = Store::open(&config).expect("opens");
    let rows = vec![Row::Alarm(alarm.clone()), Row::Model(model(1)), Row::Model(model(2))];
    other.write(&Batch { series: Vec::new(), rows }).expect("writes");
    let patience = Duration::from_secs(60);
    let merged = Arc::<Mutex<Vec<Found>>>::default();
    let feed = Merging(Batch::default(), merged.clone());
    let writer = Writer::start(&config, Store::open(&config), feed, || 1.0).expect("a thread");
    assert!(!writer.flush(patience) && merged.lock().expect("no panic").is_empty(), "in use");
    drop(other);
    assert!(writer.flush(patience) && writer.flush(patience), "{:?}", writer.status());
    writer.stop();
    let found = Found { models: vec![model(2)], alarms: vec![alarm] };
    assert_eq!(*merged.lock().expect("no panic"), [found], "once");

    // Who has read it has it.
    let opened = Store::open(&config);
    let merged = Arc::<Mutex<Vec<Found>>>::default();
    let writer =
        Writer::start(&config, opened, Merging(Batch::default(), merged.clone()), || 1.0).expect("a thread");
    assert!(writer.flush(patience));
    writer.stop();
    assert!(merged.lock().expect("no panic").is_empty());
}

/// A store whose writes fail, done or not, as often as is left.
#[derive(Debug)]
struct Failing(Store, Arc<AtomicUsize>, bool);

impl Failing {
    fn fails(&self) -> bool {
        self.1.fetch_update(Relaxed, Relaxed, |left| left.checked_sub(1)).is_ok()
    }
}

impl Writes for Failing {
    fn write(&mut self, batch: &Batch) -> Result<(), StoreError> {
        let failed = || StoreError::io(std::path::Path::new("disk"))(io::Error::other("simulated"));
        match self.fails() {
            false => self.0.write(batch),
            true if self.2 => self.0.write(batch).and_then(|()| Err(failed())),
            true => Err(failed()),
        }
    }
    fn insert(&mut self, batch: &Batch) -> Result<(), StoreError> {
        self.0.insert(batch)
    }
    fn tidy(&mut self, now: f64) -> Result<bool, StoreError> {
        self.0.tidy(now)
    }
    fn make_room(&mut self, now: f64) -> Result<bool, StoreError> {
        self.0.make_room(now)
    }
    fn begin_era(&mut self) {
        self.0.begin_era();
    }
    fn era(&self) -> i64 {
        self.0.era()
    }
    fn usage(&self) -> Result<Usage, StoreError> {
        self.0.usage()
    }
    fn refused_and_damaged(&self) -> (u64, u64) {
        self.0.refused_and_damaged()
    }
    fn spool(&self) -> Option<Spool> {
        self.0.spool()
    }
}

/// Says once that the clock was set back, and then has one sample.
struct SetBack(Batch, bool);

impl Feed for SetBack {
    fn gather(&mut self) {}
    fn take(&mut self) -> &Batch {
        &self.0
    }
    fn settled(&mut self) -> bool {
        self.0 = Batch::default();
        false
    }
    fn set_back(&mut self) -> bool {
        std::mem::take(&mut self.1)
    }
    fn merge(&mut self, _found: Found) {}
}

#[test]
fn an_era_that_was_begun_outlives_a_write_that_fails() {
    for done in [false, true] {
        for failures in 0..3 {
            let folder = Folder::new();
            let left = Arc::new(AtomicUsize::new(failures));
            let open: Opener = Arc::new(move |config, is_read| {
                let store = Store::opened(config, is_read)?;
                Ok(Store::over(Failing(store, left.clone(), done)))
            });
            let driven = Driven { open: open.clone(), by_hand: true };
            let tag = Arc::new(TagName {
                control_loop: "A".into(),
                tag: "op".into(),
                source: String::new(),
                unit: String::new(),
            });
            let batch = |t| {
                let series = Series { tag: tag.clone(), samples: vec![Sample::good(t, 1.0)] };
                Batch { series: vec![series], rows: Vec::new() }
            };
            let config = Config::new(&folder.0);
            Store::open(&config).and_then(|mut store| store.write(&batch(1000.0))).expect("written");
            let feed = SetBack(batch(5.0), true);
            let writer = Writer::driven(&driven, &config, open(&config, true), feed, || 5.0).expect("begun");
            for _ in 0..failures {
                assert!(!writer.flush(Duration::ZERO), "it fails");
            }
            assert!(writer.flush(Duration::ZERO), "{:?}", writer.status());
            writer.stop();
            let mut reader = Reader::open(&folder.0).expect("opens");
            let eras: Vec<i64> = reader.tags().expect("reads").iter().map(|tag| tag.era).collect();
            assert_eq!(eras, [0, 1], "{failures} failures, done: {done}");
            let there: Vec<f64> =
                reader.between("A", "op", 0.0, 2000.0).expect("reads").iter().map(|s| s.t).collect();
            assert_eq!(there, [5.0, 1000.0]);
        }
    }
}

/// Closed without the mark it would carry its log over into the damaged database.
#[test]
fn a_store_that_is_found_damaged_is_marked_before_it_is_closed() {
    let folder = Folder::new();
    let config = Config::new(&folder.0);
    let [control_loop, source, unit] = ["A", "", ""].map(String::from);
    let tag = Arc::new(TagName { control_loop, tag: "op".into(), source, unit });
    let batch = |t| {
        let series = Series { tag: tag.clone(), samples: vec![Sample::good(t, 1.0)] };
        Batch { series: vec![series], rows: Vec::new() }
    };
    let mut store = Store::open(&config).expect("opens");
    store.insert(&batch(1000.0)).expect("inserts");
    let db = rusqlite::Connection::open(folder.0.join("store.db")).expect("opens");
    db.execute("UPDATE chunks SET samples = zeroblob(40)", []).expect("writes");
    drop(db);
    // In the same chunk, which is over: it is merged with what is damaged.
    let driven = Driven { by_hand: true, ..Driven::default() };
    let feed = SetBack(batch(1001.0), false);
    let writer = Writer::driven(&driven, &config, Ok(store), feed, || 5000.0).expect("begun");
    assert!(!writer.flush(Duration::ZERO), "it is damaged");
    assert!(writer.status().is_damaged && super::super::is_damaged(&config));
    let log = std::fs::metadata(folder.0.join("store.db-wal")).expect("there");
    assert!(log.len() > 0, "the log stays as it was");
    writer.stop();
}

/// Its round lasts until it is let go.
struct Slow(Batch, Sender<()>, Receiver<()>);

impl Feed for Slow {
    fn gather(&mut self) {}
    fn take(&mut self) -> &Batch {
        // Once the test has seen it nobody holds it up.
        if self.1.send(()).is_ok() {
            let _ = self.2.recv();
        }
        &self.0
    }
    fn settled(&mut self) -> bool {
        false
    }
    fn set_back(&mut self) -> bool {
        false
    }
    fn merge(&mut self, _found: Found) {}
}

#[test]
fn a_round_that_hangs_is_a_failure_until_it_ends() {
    let folder = Folder::new();
    let config = Config::new(&folder.0);
    let ((begin, begun), (let_go, held)) = (channel(), channel());
    let driven = Driven { by_hand: true, ..Driven::default() };
    let feed = Slow(Batch::default(), begin, held);
    let writer = Writer::driven(&driven, &config, Store::open(&config), feed, || 7.0).expect("begun");
    assert_eq!(writer.status_at(Instant::now() + 100 * LONGEST).failing, None, "nothing is under way");
    let flusher = writer.flusher();
    let round = std::thread::spawn(move || flusher.flush(Duration::ZERO));
    begun.recv().expect("the round begins");
    let now = Instant::now();
    assert_eq!(writer.status_at(now).failing, None);
    let (why, since) = writer.status_at(now + LONGEST + Duration::from_secs(1)).failing.expect("it hangs");
    assert!(why.starts_with("a round has lasted ") && since == 7.0, "{why} since {since}");
    let_go.send(()).expect("it waits");
    assert!(round.join().expect("no panic"), "it was written after all");
    assert_eq!(writer.status_at(now + 100 * LONGEST).failing, None, "it works again");
    drop(begun);
    writer.stop();
}

#[test]
fn who_waits_for_a_round_that_never_came_is_not_told_of_an_earlier_one() {
    let inner = Inner { stop: true, good: true, ..Inner::default() };
    let shared = Shared { inner: Mutex::new(inner), changed: Condvar::new() };
    let flusher = Flusher { shared: Arc::new(shared), by_hand: None };
    assert!(!flusher.flush(Duration::ZERO));
}

/// What a round has written is in files that are gone, so it is written once more.
#[test]
fn what_was_written_to_a_folder_that_is_gone_is_written_to_the_one_in_its_place() {
    let folder = Folder::new();
    let config = Config::new(&folder.0);
    let [control_loop, source, unit] = ["A", "", ""].map(String::from);
    let tag = Arc::new(TagName { control_loop, tag: "op".into(), source, unit });
    let series = Series { tag, samples: vec![Sample::good(1000.0, 1.0)] };
    let feed = SetBack(Batch { series: vec![series], rows: Vec::new() }, false);
    let driven = Driven { by_hand: true, ..Driven::default() };
    let writer = Writer::driven(&driven, &config, Store::open(&config), feed, || 1000.0).expect("begun");
    std::fs::remove_dir_all(&folder.0).expect("there");
    assert!(!writer.flush(Duration::ZERO), "it is noticed");
    assert!(writer.flush(Duration::ZERO), "{:?}", writer.status());
    writer.stop();
    let mut reader = Reader::open(&folder.0).expect("opens");
    assert_eq!(reader.between("A", "op", 0.0, 2000.0).expect("reads"), [Sample::good(1000.0, 1.0)]);
}
