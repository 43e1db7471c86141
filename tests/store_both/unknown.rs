//! What a start without the database knows of alarms and models, and what it does not know is not overwritten.

use crate::outage::{PATIENCE, delivered};
use crate::place::{Place, batch, good, tag, whole};
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::time::{Duration, Instant};
use stictiond::store::{AlarmRow, Batch, Config, ModelRow, Reader, Row, Store, TransitionRow};

fn alarm(acknowledged: bool, shelved_until: Option<f64>) -> AlarmRow {
    AlarmRow {
        control_loop: "A".into(),
        kind: "stiction".into(),
        active: true,
        acknowledged,
        shelved_until,
        by: acknowledged.then(|| "eve".into()),
        votes: "ss".into(),
        raised_at: Some(1.0),
        ..AlarmRow::default()
    }
}

fn model(version: u64, effects: &str) -> ModelRow {
    ModelRow { control_loop: "A".into(), version, since: version as f64, effects: effects.into() }
}

fn step(at: f64, before: &str, after: &str, cause: &str) -> Row {
    Row::Transition(TransitionRow {
        control_loop: "A".into(),
        kind: "stiction".into(),
        at,
        before: before.into(),
        after: after.into(),
        cause: cause.into(),
        ..TransitionRow::default()
    })
}

fn said(rows: Vec<Row>) -> Batch {
    Batch { series: Vec::new(), rows }
}

/// An alarm that was raised, acknowledged and shelved, and three versions of a model.
fn before(store: &mut Store) {
    let mut put = |rows| store.write(&said(rows)).expect("writes");
    put((1..=3).map(|version| Row::Model(model(version, "drift\t\n"))).collect());
    put(vec![step(1.0, "normal", "unacknowledged", "raised"), Row::Alarm(alarm(false, None))]);
    put(vec![step(2.0, "unacknowledged", "acknowledged", "acknowledged"), Row::Alarm(alarm(true, None))]);
    put(vec![step(3.0, "acknowledged", "shelved", "shelved"), Row::Alarm(alarm(true, Some(9e9)))]);
}

/// What happened to the alarm, in order: cause, and the states it is between.
fn history(place: &Place) -> Vec<String> {
    let rows = place.reader().transitions(0, 99).expect("reads");
    rows.into_iter().map(|(_, row)| format!("{} {} {}", row.before, row.cause, row.after)).collect()
}

#[test]
fn a_start_without_the_database_has_the_last_state_that_it_had() {
    let mut place = Place::postgres();
    let mut store = Store::open(&place.config()).expect("opens");
    before(&mut store);
    assert!(!store.spool().expect("there is one").waits, "it is all in the database");
    drop(store);
    place.cluster().end();
    let mut store = Store::open(&place.config()).expect("opens on its spool");
    let reader = Reader::at_hand(&place.config()).expect("the spool can be read");
    assert_eq!(reader.alarms().expect("reads"), [alarm(true, Some(9e9))]);
    assert_eq!(reader.alarm("A", "stiction").expect("reads"), Some(alarm(true, Some(9e9))));
    assert_eq!(reader.model("A").expect("reads"), Some(model(3, "drift\t\n")));
    // Nothing of that waits, for the database has it.
    assert!(!store.spool().expect("there is one").waits);
    let rows = vec![
        step(4.0, "shelved", "acknowledged", "unshelved"),
        Row::Alarm(alarm(true, None)),
        Row::Model(model(4, "")),
    ];
    store.write(&said(rows)).expect("spools");
    assert_eq!(reader.alarms().expect("reads"), [alarm(true, None)], "what waits is newer");
    assert_eq!(reader.model("A").expect("reads"), Some(model(4, "")));
    drop(reader);
    place.cluster().begin();
    delivered(&mut store, 1000.0);
    assert_eq!(store.found(), None, "there was nothing that this start did not know");
    assert_eq!(place.reader().alarms().expect("reads"), [alarm(true, None)]);
    assert_eq!(place.reader().model("A").expect("reads"), Some(model(4, "")));
    assert_eq!(
        history(&place),
        [
            "normal raised unacknowledged",
            "unacknowledged acknowledged acknowledged",
            "acknowledged shelved shelved",
            "shelved unshelved acknowledged",
        ]
    );
    whole(&place);
}

/// As where the database was lost and begun anew, or given back from an older copy.
#[test]
fn states_that_the_database_has_no_more_are_delivered_once_more() {
    let mut place = Place::postgres();
    let mut store = Store::open(&place.config()).expect("opens");
    before(&mut store);
    drop(store);
    let schema = place.config().schema;
    let mut client = place.cluster().client().expect("answers");
    client.batch_execute(&format!("DROP SCHEMA \"{schema}\" CASCADE")).expect("it was made");
    let mut store = Store::open(&place.config()).expect("begins anew");
    assert!(!store.spool().expect("there is one").waits, "it is all in the database");
    assert_eq!(place.reader().alarms().expect("reads"), [alarm(true, Some(9e9))]);
    assert_eq!(place.reader().model("A").expect("reads"), Some(model(3, "drift\t\n")));

    // An older copy of it, with an alarm that was changed since, and one that was changed elsewhere.
    let of = |kind: &str, since| {
        let (kind, since) = (kind.to_string(), Some(since));
        AlarmRow { kind, since, ..alarm(true, None) }
    };
    let put =
        vec![Row::Alarm(of("f_rising", 50.0)), Row::Alarm(of("tag_bad", 50.0)), Row::Model(model(4, ""))];
    store.write(&said(put)).expect("writes");
    drop(store);
    let back = format!(
        "UPDATE {schema}.alarms SET since = 40, acknowledged = false WHERE kind = 'f_rising';
         UPDATE {schema}.alarms SET since = 60 WHERE kind = 'tag_bad';
         DELETE FROM {schema}.models WHERE version = 4"
    );
    client.batch_execute(&back).expect("writes");
    drop(Store::open(&place.config()).expect("opens"));
    let reader = place.reader();
    let found = |kind| reader.alarm("A", kind).expect("reads");
    assert_eq!(found("f_rising"), Some(of("f_rising", 50.0)));
    assert_eq!(found("tag_bad"), Some(of("tag_bad", 60.0)));
    assert_eq!(reader.model("A").expect("reads"), Some(model(4, "")));
}

#[test]
fn what_a_fresh_disk_does_not_know_is_merged_before_anything_newer_is_written() {
    let mut place = Place::postgres();
    let mut store = Store::open(&place.config()).expect("opens");
    before(&mut store);
    drop(store);
    place.cluster().end();
    let fresh = Config { folder: place.folder.join("fresh"), ..place.config() };
    let mut store = Store::open(&fresh).expect("opens on an empty spool");
    assert_eq!(Reader::at_hand(&fresh).expect("can be read").alarms().expect("reads"), []);
    let blank = vec![
        step(5.0, "normal", "unacknowledged", "raised"),
        Row::Alarm(alarm(false, None)),
        Row::Model(model(1, "spike\t\n")),
    ];
    store.write(&said(blank)).expect("spools");
    store.write(&batch(&tag("A", "op"), good(0..10))).expect("spools");
    place.cluster().begin();
    let begun = Instant::now();
    let found = loop {
        store.tidy(1000.0).expect("tidies");
        if let Some(found) = store.found() {
            break found;
        }
        assert!(begun.elapsed() < PATIENCE, "{:?}", store.spool());
    };
    assert_eq!(
        (found.alarms, found.models),
        (vec![alarm(true, Some(9e9))], vec![model(3, "drift\t\n")]),
        "all that this start did not know"
    );
    // However often it is tried, and whatever comes meanwhile: the states there are not touched.
    for _ in 0..3 {
        store.tidy(1000.0).expect("tidies");
        store.write(&batch(&tag("A", "op"), good(10..20))).expect("spools");
    }
    let there = Reader::of(&place.config()).expect("answers");
    assert_eq!(there.alarms().expect("reads"), [alarm(true, Some(9e9))]);
    assert_eq!(there.model("A").expect("reads"), Some(model(3, "drift\t\n")));
    assert!(store.found().is_none() && store.spool().expect("there is one").waits);
    // As the daemon does it.
    let rows = vec![
        step(6.0, "unacknowledged", "shelved", "restored"),
        Row::Alarm(alarm(true, Some(9e9))),
        Row::Model(model(4, "spike\t\n")),
    ];
    store.write(&said(rows)).expect("spools");
    store.merged().expect("is known");
    // The link is lost before anything of it is delivered: it is not found once more.
    store.disconnect();
    store.tidy(1000.0).expect("tidies");
    assert_eq!(store.found(), None);
    delivered(&mut store, 1000.0);
    assert_eq!(there.alarms().expect("reads"), [alarm(true, Some(9e9))]);
    assert_eq!(there.model("A").expect("reads"), Some(model(4, "spike\t\n")));
    assert_eq!(
        history(&place),
        [
            "normal raised unacknowledged",
            "unacknowledged acknowledged acknowledged",
            "acknowledged shelved shelved",
            // From where it was left to where the fresh disk began.
            "shelved forgotten normal",
            "normal raised unacknowledged",
            "unacknowledged restored shelved",
        ]
    );
    assert_eq!(whole(&place).samples, 20);
    drop(store);
    // What was merged is known from now on.
    place.cluster().end();
    drop(Store::open(&fresh).expect("opens"));
    let reader = Reader::at_hand(&fresh).expect("can be read");
    assert_eq!(reader.alarms().expect("reads"), [alarm(true, Some(9e9))]);
    assert_eq!(reader.model("A").expect("reads"), Some(model(4, "spike\t\n")));
}

/// Stands between us and PostgreSQL, and takes everything without a word when it is told to.
struct Between {
    port: u16,
    silent: Arc<AtomicBool>,
}

impl Between {
    /// Before a server's socket; where there is none nobody is ever answered.
    fn start(server: Option<PathBuf>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = listener.local_addr().expect("bound").port();
        let silent = Arc::new(AtomicBool::new(false));
        let own = silent.clone();
        std::thread::spawn(move || {
            let mut held = Vec::new();
            for client in listener.incoming().map_while(Result::ok) {
                match server.as_ref().map(UnixStream::connect) {
                    Some(Ok(server)) => Self::pass(&client, &server, &own),
                    _ => held.push(client),
                }
            }
        });
        Self { port, silent }
    }

    fn pass(client: &TcpStream, server: &UnixStream, silent: &Arc<AtomicBool>) {
        let (mut asks, mut asked) =
            (client.try_clone().expect("a copy"), server.try_clone().expect("a copy"));
        let (mut answers, mut answered) =
            (server.try_clone().expect("a copy"), client.try_clone().expect("a copy"));
        let (own, other) = (silent.clone(), silent.clone());
        std::thread::spawn(move || {
            copy(&mut asks, &mut asked, &own);
            // Whoever has left is left.
            let _ = asked.shutdown(Shutdown::Both);
        });
        std::thread::spawn(move || copy(&mut answers, &mut answered, &other));
    }

    fn config(&self, place: &Place, folder: &str) -> Config {
        let url = format!("postgres://stictiond@localhost:{}/postgres?hostaddr=127.0.0.1", self.port);
        Config { url: Some(url), folder: place.folder.join(folder), ..place.config() }
    }
}

fn copy(from: &mut impl Read, to: &mut impl Write, silent: &AtomicBool) {
    let mut bytes = [0; 4096];
    while let Ok(count) = from.read(&mut bytes) {
        if count == 0 || (!silent.load(SeqCst) && to.write_all(&bytes[..count]).is_err()) {
            return;
        }
    }
}

/// Longer than any wait for an answer to a write, with time for a busy machine; the system's own limits are minutes.
const BOUND: Duration = Duration::from_secs(40);

#[test]
fn who_accepts_and_never_answers_is_away_in_bounded_time() {
    let place = Place::folder();
    let between = Between::start(None);
    let begun = Instant::now();
    let mut store = Store::open(&between.config(&place, "spool")).expect("opens on its spool");
    let away = store.spool().expect("there is one").away.expect("nobody answered");
    assert!(away.contains("no answer within"), "{away}");
    store.write(&batch(&tag("A", "op"), good(0..10))).expect("spools");
    assert!(begun.elapsed() < BOUND, "after {:?}", begun.elapsed());
    assert!(store.spool().expect("there is one").waits);
}

#[test]
fn a_connection_that_falls_silent_is_given_up_and_nothing_is_lost() {
    let mut place = Place::postgres();
    let between = Between::start(Some(place.cluster().folder.join(".s.PGSQL.5432")));
    let mut store = Store::open(&between.config(&place, "spool")).expect("opens");
    store.write(&batch(&tag("A", "op"), good(0..10))).expect("writes");
    assert!(!store.spool().expect("there is one").waits);
    between.silent.store(true, SeqCst);
    let begun = Instant::now();
    store.write(&batch(&tag("A", "op"), good(10..20))).expect("spools");
    assert!(begun.elapsed() < BOUND, "after {:?}", begun.elapsed());
    let spool = store.spool().expect("there is one");
    assert!(
        spool.waits && spool.away.as_deref().is_some_and(|why| why.contains("no answer for")),
        "{spool:?}"
    );
    between.silent.store(false, SeqCst);
    delivered(&mut store, 2000.0);
    assert_eq!(crate::place::all(&place, &tag("A", "op")), good(0..20));
    whole(&place);
}
