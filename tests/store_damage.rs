//! A store that is damaged never works on with data gone, what cannot be measured again is back, and what is lost is told.
//! `cargo run --example store_damage` does the same for 200 damages and prints a table.

#[path = "store_damage/damage.rs"]
mod damage;
#[path = "store_damage/files.rs"]
mod files;

use damage::{BEGIN, Content, FILES, PAIRS, content, copy, damage as hurt, made, samples, sweep};
use rand::SeedableRng;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stictiond::alarm::AlarmId;
use stictiond::app::App;
use stictiond::schedule::Clock;
use stictiond::signal::{LoopId, Sample};
use stictiond::store::{
    self, AlarmRow, Batch, Config, DiagnosisRow, Reader, Row, Series, Store, TagName, Upkeep,
};

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("damage-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("writable");
    path
}

/// What holds whatever is damaged: it works with everything that it had, or it fails and says so.
fn holds(what: &str, found: &damage::Outcome) {
    if found.working {
        let all = found.samples.0 == found.samples.1 && found.runs.0 == found.runs.1;
        assert!(found.missing == 0 && all && found.told == 0, "works with data gone: {what}");
    } else {
        assert!(!found.checked_good, "{what}");
    }
    assert!(!found.mistold(), "lost and not told, or told and not lost: {what}");
}

/// Every file in every way once; `sweep` has other places of them. One copy of the states is left each time: they are all back,
/// and nothing is told to be lost of them.
#[test]
fn a_damaged_store_never_works_with_data_gone() {
    let (place, mut failing) = (folder("sweep"), 0);
    sweep(&place, &FILES, 20, 1, |file, kind, found| {
        let what = format!("{kind} of {file}: {found:?}");
        holds(&what, found);
        failing += usize::from(!found.working);
        assert_eq!((found.states.0, found.missing, found.told), (found.states.1, 0, 0), "{what}");
    });
    assert!(failing >= 12, "damages to the database, its log and its ledger are noticed: {failing}");
    fs::remove_dir_all(place).expect("removed");
}

/// Two files at once. Where the states can be read nowhere, exactly those records are told that their second copy has lost.
#[test]
fn what_two_damages_cost_is_told() {
    let (place, mut states) = (folder("pairs"), (0, 0));
    sweep(&place, &PAIRS, 24, 3, |files, kind, found| {
        let what = format!("{kind} of {files}: {found:?}");
        holds(&what, found);
        match files {
            // Nobody can say how many there were; the database has them all.
            "store.ack + states.log" => assert!(found.missing == 0 && found.told <= 1, "{what}"),
            _ if files.ends_with("states.log") => {
                assert!(found.told == 0 || found.told == found.unreadable, "{what}");
            }
            _ => assert_eq!((found.missing, found.told), (0, 0), "{what}"),
        }
        states = (states.0 + found.states.0, states.1 + found.states.1);
    });
    println!("{} of {} states are back", states.0, states.1);
    fs::remove_dir_all(place).expect("removed");
}

/// A store whose log is carried over, and everything that is in it.
fn at_rest(place: &Path) -> (PathBuf, Content) {
    let (truth, own) = (made(place), place.join("killed"));
    drop(Store::open(&Config::new(&own)).expect("whole"));
    (own, truth)
}

/// Its second copy gone, the database hurt: where that is elsewhere than its states all of them are back, and where it is the
/// states themselves exactly the records of the copy are told to be lost.
#[test]
fn states_without_their_second_copy_are_back_from_the_part_of_the_database_that_is_whole() {
    let place = folder("no-copy");
    let (whole, truth) = at_rest(&place);
    let own = place.join("own");
    let records = files::records(&fs::read(whole.join("states.log")).expect("there"));
    for (table, lost) in [("trends", 0), ("alarms", records)] {
        copy(&whole, &own);
        files::overwrite(&own, table);
        fs::write(own.join("states.log"), "").expect("written");
        assert!(Store::open(&Config::new(&own)).is_err_and(|error| error.is_damage()), "{table}");
        let reader = Reader::open(&own).expect("what is left can be read");
        let (left, told) = reader.lost().expect("it is damaged");
        assert_eq!(told, lost, "{left}");
        let alarms = if lost == 0 { truth.alarms.clone() } else { Vec::new() };
        assert_eq!(content(&reader), Content { alarms, ..truth.clone() }, "{left}");
        assert_eq!(left.contains("trends: some may be lost"), table == "trends", "{left}");
    }
    fs::remove_dir_all(place).expect("removed");
}

fn one_sample(t: f64) -> Batch {
    let name = |text: &str| text.to_string();
    let (control_loop, tag, source) = (name("FIC000"), name("pv"), name("register 0"));
    let tag = Arc::new(TagName { control_loop, tag, source, unit: name("m3/h") });
    Batch { series: vec![Series { tag, samples: vec![Sample::good(t, 1.0)] }], rows: Vec::new() }
}

/// A store that is larger than what is looked at before it is opened, as if a page were 256 MB: until all of it was compared it
/// does not say that it is whole, and what is damaged is found by then.
#[test]
fn what_is_damaged_behind_the_first_look_is_found_before_it_is_said_to_be_whole() {
    let place = folder("behind");
    let (whole, _) = at_rest(&place);
    let own = place.join("own");
    let upkeep = Upkeep { at_once: 2, each: 1, log: 1, ..Upkeep::default() };
    let config = Config { upkeep, ..Config::new(&own) };
    // Nobody reads that table in a folder, and nothing is written to it.
    for hurt in [false, true] {
        copy(&whole, &own);
        if hurt {
            files::overwrite(&own, "spool");
        }
        let mut store = Store::open(&config).expect("nothing is found at the start");
        let (mut shares, mut ended) = (Vec::new(), Ok(()));
        while let (Ok(()), Some(share)) = (&ended, store.checked()) {
            shares.push(share);
            assert!(shares.len() < 1000 && (0.0..1.0).contains(&share), "{shares:?}");
            let t = BEGIN + 1000.0 + shares.len() as f64;
            ended = store.write(&one_sample(t)).and_then(|()| store.tidy(t).map(|_| ()));
        }
        assert!(shares.len() > 5, "{shares:?}");
        assert_eq!(ended.is_err_and(|error| error.is_damage()), hurt, "{shares:?}");
        assert_eq!(store.checked().is_some(), hurt);
        drop(store);
        assert_eq!(Store::open(&config).is_err_and(|error| error.is_damage()), hurt);
    }
    fs::remove_dir_all(place).expect("removed");
}

/// Faults that a check finds in a store.
fn faults(own: &Path) -> Vec<String> {
    store::check(own).expect("can be read").faults
}

/// Files of a store that hold something, but for the database's index, which is made anew.
const ALL: [&str; 6] = ["states.log", "store.ack", "store.age", "store.db", "store.db-wal", "store.sum"];
/// Those that are made anew from what is whole.
const RENEWED: [&str; 2] = ["states.log", "store.age"];

/// Whichever bit of whichever file: a check says so. Where a file is made anew from what is whole the store works all the same.
#[test]
fn a_flipped_bit_anywhere_is_found() {
    let place = folder("bits");
    made(&place);
    let (killed, own) = (place.join("killed"), place.join("own"));
    copy(&killed, &own);
    let mut files: Vec<String> = fs::read_dir(&own)
        .expect("there")
        .map(|file| file.expect("read"))
        .filter(|file| file.metadata().expect("there").len() > 0)
        .map(|file| file.file_name().to_string_lossy().into_owned())
        .collect();
    files.sort();
    assert_eq!(files, ALL);
    assert_eq!(faults(&own), [] as [String; 0]);
    let mut rng = rand_pcg::Pcg64::seed_from_u64(2);
    for n in 0..5 * ALL.len() {
        copy(&killed, &own);
        let file = ALL[n % ALL.len()];
        assert!(hurt(&own, file, "bit", &mut rng));
        let found = store::check(&own).expect("read");
        let opened = Store::open(&Config::new(&own));
        if RENEWED.contains(&file) {
            assert!(found.faults.len() == 1 && found.faults[0].starts_with(file), "{:?}", found.faults);
            assert!(found.renewable == 1 && found.left.is_none() && opened.is_ok(), "{found:?}");
        } else {
            // A page that the log has too is of no account: then nothing may be gone.
            assert_eq!(found.faults.is_empty(), opened.is_ok(), "{file}: {:?}", found.faults);
        }
    }
    fs::remove_dir_all(place).expect("removed");
}

/// Cut within a record or behind one, emptied or gone: how many of its records are lost is told, and it comes from the database.
#[test]
fn a_second_copy_that_is_cut_or_gone_is_found_and_written_anew() {
    let place = folder("copy");
    let (whole, truth) = at_rest(&place);
    let own = place.join("own");
    let config = Config::new(&own);
    let bytes = fs::read(whole.join("states.log")).expect("there");
    let all = files::records(&bytes);
    let ends = files::ends(&bytes);
    let (last, middle) = (ends[ends.len() - 2], ends[ends.len() / 2]);
    let cuts = [
        (Some(bytes.len() - 1), 1),
        (Some(last), 1),
        (Some(middle + 1), all - ends.len() as u64 / 2 - 1),
        (Some(0), all),
        (None, all),
    ];
    for (length, lost) in cuts {
        copy(&whole, &own);
        let path = own.join("states.log");
        match length {
            Some(length) => fs::write(&path, &bytes[..length]).expect("written"),
            None => fs::remove_file(&path).expect("removed"),
        }
        let told = faults(&own);
        let says = format!("states.log, the second copy of the states: {lost} of {all} records ");
        assert!(told.len() == 1 && told[0].starts_with(&says), "{length:?}: {told:?}");
        assert!(told[0].contains("no state is lost") && told[0].contains("--repair"), "{told:?}");
        assert_eq!(told[0].contains("gone with the file"), length.is_none(), "{told:?}");
        store::renew(&config).expect("written anew");
        assert_eq!(faults(&own), [] as [String; 0]);
        assert_eq!(files::records(&fs::read(&path).expect("there")), all);
        assert_eq!(content(&Reader::open(&own).expect("whole")), truth);
    }
    // What was never acknowledged may be torn.
    copy(&whole, &own);
    fs::write(own.join("states.log"), [&bytes[..], &bytes[..20]].concat()).expect("written");
    assert_eq!(faults(&own), [] as [String; 0]);
    // As of a store of before there was a second copy: there was no ledger either.
    for name in ["states.log", "store.ack", "store.sum"] {
        fs::remove_file(own.join(name)).expect("there");
    }
    assert_eq!(faults(&own), [] as [String; 0]);
    fs::remove_dir_all(place).expect("removed");
}

/// Its database damaged too: what the repair makes of the rest has a second copy that is whole.
#[test]
fn a_second_copy_is_named_beside_a_database_that_is_damaged() {
    let place = folder("copy-too");
    let (own, _) = at_rest(&place);
    files::overwrite(&own, "trends");
    fs::remove_file(own.join("states.log")).expect("there");
    let found = store::check(&own).expect("can be read");
    let of_copy: Vec<&String> = found.faults.iter().filter(|fault| fault.starts_with("states.log")).collect();
    assert!(of_copy.len() == 1 && !of_copy[0].contains("no state is lost"), "{:?}", found.faults);
    assert!(found.left.is_some_and(|left| left.contains("models: all are back")));
    store::repair(&Config::new(&own)).expect("repaired");
    assert_eq!(faults(&own), [] as [String; 0]);
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
