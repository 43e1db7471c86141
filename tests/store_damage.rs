//! A store that is damaged never works on with data gone, what cannot be measured again is back, and what is lost is told.
//! `cargo run --example store_damage` does the same for 200 damages and prints a table.

#[path = "store_damage/damage.rs"]
mod damage;

use damage::{Content, copy, damage as hurt, made, samples, sweep};
use rand::SeedableRng;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use stictiond::alarm::AlarmId;
use stictiond::app::App;
use stictiond::schedule::Clock;
use stictiond::signal::LoopId;
use stictiond::store::{self, AlarmRow, Batch, Config, DiagnosisRow, Reader, Row, Store};

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("damage-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("writable");
    path
}

/// Every file in every way once; `sweep` has other places of them.
#[test]
fn a_damaged_store_never_works_with_data_gone() {
    let place = folder("sweep");
    let (mut states, mut failing) = ((0, 0), 0);
    sweep(&place, 20, 1, |file, kind, found| {
        let what = format!("{kind} of {file}: {found:?}");
        if found.working {
            assert!(found.missing == 0 && found.samples.0 == found.samples.1, "works with data gone: {what}");
        } else {
            failing += 1;
            assert!(!found.checked_good, "{what}");
        }
        assert!(found.missing as u64 <= found.told, "lost and not told: {what}");
        states = (states.0 + found.states.0, states.1 + found.states.1);
    });
    assert!(failing >= 12, "damages to the database, its log and its ledger are noticed: {failing}");
    assert!(states.0 * 100 >= states.1 * 95, "{states:?}");
    fs::remove_dir_all(place).expect("removed");
}

/// Whichever bit of the database or of its log: a check says so.
#[test]
fn a_flipped_bit_anywhere_is_found() {
    let place = folder("bits");
    made(&place);
    let (killed, own) = (place.join("killed"), place.join("own"));
    assert_eq!(store::check(&killed).expect("read").faults, [] as [String; 0]);
    let mut rng = rand_pcg::Pcg64::seed_from_u64(2);
    for n in 0..40 {
        copy(&killed, &own);
        let file = ["store.db", "store.db-wal"][n % 2];
        assert!(hurt(&own, file, "bit", &mut rng));
        // A page that the log has too is of no account: then nothing may be gone.
        let found = store::check(&own).expect("read");
        let opened = Store::open(&Config::new(&own));
        assert_eq!(found.faults.is_empty(), opened.is_ok(), "{file}: {:?}", found.faults);
    }
    fs::remove_dir_all(place).expect("removed");
}

/// It stays so over restarts, until somebody decides.
#[test]
fn a_damaged_store_fails_until_it_is_repaired() {
    let place = folder("decide");
    let truth: Content = made(&place);
    let own = place.join("killed");
    let config = Config::new(&own);
    let path = own.join("store.db");
    let mut bytes = fs::read(&path).expect("there");
    let middle = bytes.len() / 2 / 8192 * 8192;
    bytes[middle..middle + 8192].fill(0);
    let was = fs::read(&path).expect("there");
    fs::write(&path, &bytes).expect("written");
    assert!(Store::open(&config).is_err_and(|error| error.is_damage()));
    // Even if the bytes come back: nobody has looked at what was done meanwhile.
    fs::write(&path, was).expect("written");
    assert!(Store::open(&config).is_err_and(|error| error.is_damage()));
    let told = store::repair(&config).expect("repaired");
    assert!(told.aside.join("store.db").is_file(), "the old one is kept");
    let store = Store::open(&config).expect("works again");
    drop(store);
    let mut reader = Reader::open(&own).expect("there");
    assert_eq!(damage::content(&reader), truth);
    assert!(samples(&mut reader) > 0);
    fs::remove_dir_all(place).expect("removed");
}

/// A run that cannot be read, as a version that wrote it wrongly would leave it: every other loop comes back, and every state.
#[tokio::test]
async fn what_cannot_be_read_of_one_loop_keeps_nothing_else_back() {
    let place = folder("one-loop");
    let own = place.join("store");
    let mut text = format!(
        "[store]\nfolder = {own:?}\n[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n"
    );
    let mut rows = Vec::new();
    for (at, id) in ["A", "B"].into_iter().enumerate() {
        let tag = |role: &str, address: usize| {
            format!("[loop.{role}]\ndevice = 'd'\nregister = 'input'\naddress = {address}\ntype = 'u16'\n")
        };
        let (op, pv) = (tag("op", 2 * at), tag("pv", 2 * at + 1));
        write!(text, "[[loop]]\nid = '{id}'\n{op}{pv}").expect("a string takes everything");
        let (control_loop, kind, outcome) = (id.to_string(), "stiction".to_string(), "stiction".to_string());
        let run = DiagnosisRow {
            control_loop: control_loop.clone(),
            finished: 1e9,
            outcome,
            ..DiagnosisRow::default()
        };
        let alarm = AlarmRow { control_loop, kind, active: true, acknowledged: true, ..AlarmRow::default() };
        rows.extend([Row::Diagnosis(run), Row::Alarm(alarm)]);
    }
    let mut store = Store::open(&Config::new(&own)).expect("opens");
    store.write(&Batch { series: Vec::new(), rows }).expect("writes");
    drop(store);
    let db = rusqlite::Connection::open(own.join("store.db")).expect("opens");
    db.execute("UPDATE diagnoses SET finished = 'then' WHERE control_loop = 'A'", []).expect("writes");
    drop(db);
    // It is what was written: nobody is to take it for damage.
    for name in ["store.sum", "store.ack"] {
        fs::remove_file(own.join(name)).expect("there");
    }
    let config = stictiond::config::parse("plant.toml", &text).expect("sound");
    let app = App::build(config, Clock::wall(), App::diagnosis()).expect("sound");
    let runs = ["A", "B"].map(|id| app.results().summaries(&LoopId::new(id)).map(|runs| runs.len()));
    assert_eq!(runs, [Some(0), Some(1)]);
    for id in ["A/stiction", "B/stiction"] {
        let alarm = app.results().alarm(&AlarmId::named(id), 2e9).expect("there");
        assert_eq!((alarm.active, alarm.state.as_str()), (true, "acknowledged"), "{id}");
    }
    drop(app);
    fs::remove_dir_all(place).expect("removed");
}
