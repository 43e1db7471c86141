//! What is only true of PostgreSQL: it can be away. Then everything waits on disk, and is delivered once, in order.

use crate::place::{Place, all, batch, good, tag, whole};
use crate::postgres::Cluster;
use crate::suite::{diagnosis, transition};
use rand::{RngExt, SeedableRng};
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use stictiond::signal::Sample;
use stictiond::store::{
    AlarmRow, Batch, Config, Reader, Row, Series, Store, StoreError, TagName, check, check_of,
};

/// Longest wait for what comes within seconds.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Tidies up until nothing waits any more.
pub fn delivered(store: &mut Store, now: f64) {
    let begun = Instant::now();
    while store.spool().expect("there is one").waits {
        while store.tidy(now).expect("the spool works") {}
        assert!(begun.elapsed() < PATIENCE, "{:?}", store.spool());
    }
}

fn alarm(active: bool) -> Row {
    Row::Alarm(AlarmRow { control_loop: "A".into(), kind: "stiction".into(), active, ..AlarmRow::default() })
}

/// What a second of the plant brings: 20 tags, and now and then something is said.
fn second(tags: &[Arc<TagName>], k: u32) -> Batch {
    let sample = |i: u32| Sample::good(1000.0 + f64::from(k), f64::from(i) + f64::from(k) * 0.25);
    let series = tags.iter().zip(0..).map(|(tag, i)| Series { tag: tag.clone(), samples: vec![sample(i)] });
    let mut rows = Vec::new();
    if k.is_multiple_of(10) {
        let (before, after) =
            if (k / 10).is_multiple_of(2) { ("normal", "raised") } else { ("raised", "normal") };
        rows.push(diagnosis("A", f64::from(k), Some(&format!("{{\"k\":{k}}}"))));
        rows.push(transition(f64::from(k), before, after));
        rows.push(alarm(after == "raised"));
    }
    Batch { series: series.collect(), rows }
}

fn tags() -> Vec<Arc<TagName>> {
    (0..20).map(|i| tag(&format!("L{i}"), "op")).collect()
}

/// Seconds `0..count` are there, each sample once, and everything that was said, in order.
fn all_there(place: &Place, count: u32) {
    for (tag, i) in tags().iter().zip(0..) {
        let expected: Vec<Sample> =
            (0..count).map(|k| second(&tags(), k).series[i as usize].samples[0]).collect();
        assert_eq!(all(place, tag), expected, "{}", tag.control_loop);
    }
    let checked = whole(place);
    let said = u64::from(count.div_ceil(10));
    assert_eq!(
        (checked.samples, checked.diagnoses, checked.transitions),
        (u64::from(count) * 20, said, said),
        "as rows, where a reader would hide one that is there twice"
    );
    let last = place.reader().alarm("A", "stiction").expect("reads").expect("there");
    assert_eq!(last.active, (said - 1).is_multiple_of(2), "the last state is the last that was said");
}

#[test]
fn ten_minutes_without_the_database_lose_nothing_and_nothing_is_twice() {
    let mut place = Place::postgres();
    let (tags, mut store) = (tags(), Store::open(&place.config()).expect("opens"));
    let write = |store: &mut Store, range: std::ops::Range<u32>| {
        for k in range {
            store.write(&second(&tags, k)).expect("writes, wherever to");
            store.tidy(1000.0 + f64::from(k)).expect("tidies");
        }
    };
    write(&mut store, 0..120);
    assert!(!store.spool().expect("there is one").waits);
    place.cluster().end();
    write(&mut store, 120..720);
    let spool = store.spool().expect("there is one");
    assert!(spool.waits && spool.bytes > 0 && spool.dropped == 0, "{spool:?}");
    assert!(spool.away.is_some_and(|why| why.contains("PostgreSQL")));
    // Whoever asks meanwhile is answered from what waits.
    assert!(matches!(Reader::of(&place.config()), Err(StoreError::Away(_))));
    let mut reader = Reader::at_hand(&place.config()).expect("the spool can be read");
    let held = reader.last(&[(*tags[0]).clone()], 50).expect("reads");
    assert_eq!(held[&*tags[0]].len(), 50);
    drop(reader);

    place.cluster().begin();
    write(&mut store, 720..760);
    delivered(&mut store, 1800.0);
    write(&mut store, 760..800);
    let spool = store.spool().expect("there is one");
    assert!(!spool.waits && spool.away.is_none() && spool.delivered >= 600 * 20, "{spool:?}");
    all_there(&place, 800);
    // Once more with nothing to do it: what was delivered is not delivered again.
    drop(store);
    let mut store = Store::open(&place.config()).expect("opens");
    delivered(&mut store, 1800.0);
    all_there(&place, 800);
}

#[test]
fn a_database_that_lets_in_and_refuses_what_it_is_given_is_asked_less_and_less_often() {
    let mut place = Place::postgres();
    let mut store = Store::open(&place.config()).expect("opens");
    let mut client = place.cluster().client().expect("answers");
    client
        .batch_execute(
            "CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS
                $$ BEGIN RAISE EXCEPTION 'no room at %', clock_timestamp(); END $$;
             CREATE TRIGGER refuse BEFORE INSERT ON stictiond.diagnoses FOR EACH ROW EXECUTE FUNCTION refuse()",
        )
        .expect("a superuser may");
    let begun = Instant::now();
    let rows = vec![diagnosis("A", 1.0, Some("{}"))];
    store.write(&Batch { series: Vec::new(), rows }).expect("writes, wherever to");
    let mut refusals = BTreeSet::new();
    while refusals.len() < 5 {
        store.tidy(1000.0).expect("the spool works");
        refusals.extend(store.spool().expect("there is one").away);
        assert!(begun.elapsed() < PATIENCE, "{refusals:?}");
    }
    // After 0.25 s, 0.5 s, 1 s and 2 s.
    assert!(begun.elapsed() >= Duration::from_millis(3750), "{:?}", begun.elapsed());
    client.batch_execute("DROP TRIGGER refuse ON stictiond.diagnoses").expect("a superuser may");
    delivered(&mut store, 1000.0);
    assert_eq!(whole(&place).diagnoses, 1);
}

#[test]
fn a_connection_takes_no_numbers_for_tags_that_are_there() {
    let mut place = Place::postgres();
    for k in 0..3 {
        let mut store = Store::open(&place.config()).expect("opens");
        store.write(&second(&tags(), k)).expect("writes, wherever to");
        delivered(&mut store, 1000.0);
    }
    let mut client = place.cluster().client().expect("answers");
    let last = "SELECT last_value FROM pg_sequences WHERE sequencename = 'tags_id_seq'";
    assert_eq!(client.query_one(last, &[]).expect("reads").get::<_, i64>(0), 20);
}

/// Tells the child, which is this same program, where its spool is and where the database.
const CHILD: &str = "STICTIOND_SPOOL_CHILD";
const KILLS: usize = 25;

/// In the child: goes on from where it is told, and never ends by itself.
#[test]
fn child() {
    let Ok(told) = std::env::var(CHILD) else { return };
    let [folder, url, from] = told.split('\n').collect::<Vec<_>>()[..] else { panic!("{told}") };
    let config = Config { url: Some(url.into()), chunk_s: 10, ..Config::new(folder) };
    let mut store = Store::open(&config).expect("the spool opens after every kill");
    let (tags, mut out) = (tags(), std::io::stdout());
    for k in from.parse().expect("a number").. {
        store.write(&second(&tags, k)).expect("writes");
        // The parent may be about to kill; then nobody reads this.
        let _ = writeln!(out, "ack {k}").and_then(|()| out.flush());
        store.tidy(1000.0 + f64::from(k)).expect("tidies");
    }
}

#[test]
fn killed_while_it_spools_and_while_it_delivers_it_loses_nothing() {
    let mut place = Place::postgres();
    let mut random = rand_pcg::Pcg64::seed_from_u64(7);
    let mut next = 0;
    for round in 0..KILLS {
        // Away in two rounds of three; it comes and goes also while the child runs.
        if round % 3 == 1 {
            place.cluster().end();
        }
        let told = format!("{}\n{}\n{next}", place.folder.display(), place.config().url.expect("one"));
        let mut child = Command::new(std::env::current_exe().expect("this program"))
            .args(["outage::child", "--exact", "--nocapture", "--test-threads=1"])
            .env(CHILD, told)
            .stdout(Stdio::piped())
            .spawn()
            .expect("this program runs");
        let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let mut acked = |until: Option<Instant>| {
            for line in lines.by_ref().map_while(Result::ok) {
                if let Some(k) = line.split("ack ").nth(1).and_then(|k| k.parse::<u32>().ok()) {
                    next = k + 1;
                    if until.is_some_and(|until| Instant::now() > until) {
                        return;
                    }
                }
            }
        };
        acked(Some(Instant::now()));
        acked(Some(Instant::now() + Duration::from_millis(random.random_range(0..60))));
        if round % 3 == 2 {
            place.cluster().begin();
            acked(Some(Instant::now() + Duration::from_millis(random.random_range(0..400))));
        }
        child.kill().expect("SIGKILL");
        child.wait().expect("it is gone");
        acked(None);
    }
    if place.cluster().client().is_err() {
        place.cluster().begin();
    }
    // What was written and not acknowledged may be there: it is written again, as the daemon would.
    let config = Config { chunk_s: 10, ..place.config() };
    let begun = Instant::now();
    let mut store = Store::open(&config).expect("opens");
    for k in next..next + 10 {
        store.write(&second(&tags(), k)).expect("writes");
    }
    delivered(&mut store, 1000.0 + f64::from(next));
    println!(
        "{KILLS} kills, {next} seconds of 20 tags acknowledged, the rest delivered in {:?}",
        begun.elapsed()
    );
    all_there(&place, next + 10);
}

#[test]
fn a_clock_that_is_set_back_while_the_database_is_away_begins_another_era_there() {
    let mut place = Place::postgres();
    let op = tag("A", "op");
    let mut store = Store::open(&place.config()).expect("opens");
    store.write(&batch(&op, good(0..100))).expect("writes");
    store.begin_era();
    store.write(&batch(&op, good(0..50))).expect("writes");
    place.cluster().end();
    store.write(&batch(&op, good(50..60))).expect("spools");
    store.begin_era();
    store.write(&batch(&op, good(0..30))).expect("spools");
    drop(store);
    // Another process, which has never seen the database.
    let mut store = Store::open(&place.config()).expect("opens on its spool");
    store.write(&batch(&op, good(30..40))).expect("spools");
    place.cluster().begin();
    delivered(&mut store, 2000.0);
    store.write(&batch(&op, good(40..45))).expect("writes");
    let eras: Vec<Vec<Sample>> = crate::place::all_of(&place.config()).into_values().collect();
    assert_eq!(eras, [good(0..100), good(0..60), good(0..45)]);
}

#[test]
fn a_spool_has_an_end_and_what_is_oldest_goes() {
    let mut place = Place::postgres();
    let config = Config { spool_mb: 16, ..place.config() };
    let (tags, mut store) = (tags(), Store::open(&config).expect("opens"));
    place.cluster().end();
    // Random values cannot be packed: 9 bytes a sample, 24 MB in all.
    let mut random = rand_pcg::Pcg64::seed_from_u64(1);
    for hour in 0..37 {
        let mut value = || f64::from_bits(random.random::<u64>() >> 2);
        let series = tags.iter().map(|tag| {
            let at = |i: u32| f64::from(hour * 3600 + i);
            let samples = (0..3600).map(|i| Sample::good(at(i), value())).collect();
            Series { tag: tag.clone(), samples }
        });
        let batch = Batch { series: series.collect(), rows: Vec::new() };
        let now = f64::from(hour * 3600 + 3600);
        while let Err(error) = store.insert(&batch) {
            assert!(error.is_full() && store.make_room(now).expect("room can be made"), "{error}");
        }
        store.tidy(now).expect("tidies");
    }
    let spool = store.spool().expect("there is one");
    // Beside the database lies its log, which is carried over after 8 MB.
    assert!(spool.bytes <= 25_000_000 && spool.dropped > 100_000, "{spool:?}");
    drop(store);
    let kept = check(&place.folder).expect("the spool is a store");
    assert_eq!(kept.samples + spool.dropped, 37 * 3600 * 20, "there or counted");
    assert_eq!(kept.span.expect("not empty").1, 37 * 3600 - 60, "the newest is there");
}

/// States go by way of the spool though nothing waits: its log must not grow for as long as all is well.
#[test]
fn the_log_of_a_spool_that_nothing_waits_in_is_carried_over() {
    let place = Place::postgres();
    let mut store = Store::open(&place.config()).expect("opens");
    for k in 0..100 {
        // 100 kB and more each: 20 MB and more in the log.
        let trend = format!("{k} ").repeat(50_000);
        let row =
            AlarmRow { control_loop: "A".into(), kind: "f_rising".into(), trend, ..AlarmRow::default() };
        store.write(&Batch { series: Vec::new(), rows: vec![Row::Alarm(row)] }).expect("writes");
        store.tidy(1000.0 + f64::from(k)).expect("tidies");
        let spool = store.spool().expect("there is one");
        assert!(!spool.waits && spool.away.is_none(), "{spool:?}");
        assert!(spool.bytes < 14_000_000, "after {k}: {spool:?}");
    }
}

#[test]
fn tables_of_an_older_version_are_brought_up_to_date_and_newer_ones_refused() {
    let mut place = Place::postgres();
    let op = tag("A", "op");
    let mut store = Store::open(&place.config()).expect("opens");
    store
        .write(&Batch { rows: vec![diagnosis("A", 1.0, Some("{\"f\":0.5}"))], ..batch(&op, good(0..50)) })
        .expect("writes");
    drop(store);
    let mut client = place.cluster().client().expect("answers");
    client.batch_execute("SET search_path TO stictiond").expect("there");
    // Version 1 had no views.
    let older = "DROP VIEW measured, diagnosed, alarmed; UPDATE version SET steps = 1";
    client.batch_execute(older).expect("the tables of then");
    drop(Store::open(&place.config()).expect("opens and brings them up to date"));
    assert_eq!(all(&place, &op), good(0..50));
    let row = client
        .query_one("SELECT count(*), max(value), min(quality), min(control_loop) FROM measured", &[])
        .expect("a view for people");
    let row: (i64, f64, String, String) = (row.get(0), row.get(1), row.get(2), row.get(3));
    assert_eq!(row, (50, 24.5, "good".into(), "A".into()));
    let f: f64 = client.query_one("SELECT (report->>'f')::float8 FROM diagnosed", &[]).expect("JSON").get(0);
    assert_eq!(f, 0.5);
    let partitions = "SELECT count(*) FROM pg_inherits WHERE inhparent = 'samples'::regclass";
    assert_eq!(client.query_one(partitions, &[]).expect("reads").get::<_, i64>(0), 1);

    client.batch_execute("UPDATE version SET steps = 1000").expect("writes");
    assert!(matches!(Store::open(&place.config()), Err(StoreError::TooNew(1000))));
    assert!(matches!(check_of(&place.config()), Err(StoreError::TooNew(1000))));
    client.batch_execute("CREATE SCHEMA foreign_one; CREATE TABLE foreign_one.t (x int)").expect("writes");
    let foreign =
        Config { schema: "foreign_one".into(), folder: place.folder.join("other"), ..place.config() };
    assert!(matches!(Store::open(&foreign), Err(StoreError::Foreign(_))));
    // Somebody else's spool, the same tables: one of them waits.
    let second = Config { schema: "both".into(), folder: place.folder.join("first"), ..place.config() };
    let first = Store::open(&second).expect("opens");
    let other =
        Store::open(&Config { folder: place.folder.join("second"), ..second.clone() }).expect("opens");
    let away = other.spool().expect("there is one").away.expect("not let in");
    assert!(away.contains("another stictiond writes"), "{away}");
    drop(first);
}

#[test]
fn text_that_a_database_does_not_take_holds_nothing_up() {
    let place = Place::postgres();
    let mut store = Store::open(&place.config()).expect("opens");
    let rows = vec![diagnosis("A\0B", 1.0, None), transition(1.0, "nor\0mal", "raised")];
    store.write(&Batch { rows, ..batch(&tag("A\0", "op"), good(0..2)) }).expect("writes");
    assert!(!store.spool().expect("there is one").waits);
    assert_eq!(place.reader().last_diagnoses("AB", 9).expect("reads").len(), 1);
}

/// A certificate for `localhost`, its key, and who signed it.
fn certificates() -> (String, String, String) {
    let mut ca = rcgen::CertificateParams::new(Vec::new()).expect("no names");
    ca.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let ca_key = rcgen::KeyPair::generate().expect("a key");
    let ca_text = ca.self_signed(&ca_key).expect("signs").pem();
    let issuer = rcgen::Issuer::new(ca, ca_key);
    let key = rcgen::KeyPair::generate().expect("a key");
    let own = rcgen::CertificateParams::new(vec!["localhost".to_string()]).expect("a name");
    let text = own.signed_by(&key, &issuer).expect("signs").pem();
    (text, key.serialize_pem(), ca_text)
}

#[test]
fn encrypted_and_with_a_password_that_is_never_told() {
    let (certificate, key, ca) = certificates();
    let mut place = Place::folder();
    std::fs::create_dir_all(&place.folder).expect("writable");
    place.cluster = Some(Cluster::with(Some((&certificate, &key)), false));
    let mut client = place.cluster().client().expect("answers");
    client.batch_execute("ALTER USER stictiond PASSWORD 'geheim'").expect("set");
    let file = |name: &str, text: &str| -> PathBuf {
        let path = place.folder.join(name);
        std::fs::write(&path, text).expect("writable");
        path
    };
    let (good_ca, bad_ca) = (file("ca.pem", &ca), file("other.pem", &certificates().2));
    let (right, wrong) = (file("right", "geheim\n"), file("wrong", "verraten\n"));
    let config = Config { ca_file: Some(good_ca), password_file: Some(right), ..place.config() };
    assert!(config.validate().is_empty(), "{:?}", config.validate());
    let mut store = Store::open(&config).expect("opens");
    store.write(&batch(&tag("A", "op"), good(0..5))).expect("writes");
    assert!(!store.spool().expect("there is one").waits, "{:?}", store.spool());
    let encrypted = "SELECT bool_or(ssl) FROM pg_stat_ssl JOIN pg_stat_activity USING (pid)
        WHERE application_name = 'stictiond'";
    assert!(client.query_one(encrypted, &[]).expect("reads").get::<_, bool>(0));
    drop(store);
    for (config, why) in [
        (Config { password_file: Some(wrong), ..config.clone() }, "password authentication failed"),
        (Config { password_file: None, ..config.clone() }, "password"),
        (Config { ca_file: Some(bad_ca), ..config.clone() }, "certificate"),
        // Without encryption the server's door is shut.
        (Config { ca_file: None, ..config.clone() }, "no encryption"),
    ] {
        let store = Store::open(&config).expect("opens on its spool");
        let away = store.spool().expect("there is one").away.expect("not let in");
        assert!(away.contains(why) && !away.contains("geheim") && !away.contains("verraten"), "{away}");
    }
}

/// Exit code, and stdout or else stderr.
fn stictiond(arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    let output = command.arg("store").args(arguments).output().expect("runs");
    let said = if output.stdout.is_empty() { output.stderr } else { output.stdout };
    (output.status.code(), String::from_utf8(said).expect("text"))
}

#[test]
fn the_commands_work_on_it_by_way_of_the_configuration() {
    let mut place = Place::postgres();
    std::fs::create_dir_all(&place.folder).expect("writable");
    let path = |name: &str| place.folder.join(name).display().to_string();
    let (config, file) = (path("plant.toml"), path("out.csv"));
    let own = place.config();
    let store = |schema: &str| {
        let (folder, url) = (path("spool"), own.url.clone().expect("one"));
        format!("[store]\nfolder = '{folder}'\nurl = '{url}'\nschema = '{schema}'\n")
    };
    let plant = "[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n[[loop]]\nid = 'A'\n\
        [loop.op]\ndevice = 'd'\nregister = 'input'\naddress = 0\ntype = 'f32'\n\
        [loop.pv]\ndevice = 'd'\nregister = 'input'\naddress = 2\ntype = 'f32'\n";
    std::fs::write(&config, store("stictiond") + plant).expect("writable");
    let (code, said) = stictiond(&["check", &config]);
    assert!(code == Some(2) && said.contains("there is no store"), "{said}");
    // What is imported has to have a date.
    let dated = |s: &Sample| Sample { t: 1_763_700_000.0 + s.t, ..*s };
    let samples = good(0..100).iter().map(dated).collect();
    Store::open(&own).and_then(|mut store| store.write(&batch(&tag("A", "op"), samples))).expect("writes");
    let (code, said) = stictiond(&["check", &config]);
    assert!(
        code == Some(0) && said.contains("good, version 2") && said.contains("100 from 1 tag,"),
        "{said}"
    );
    assert_eq!(stictiond(&["export", &config, &file]).1, format!("{file}: 100 rows\n"));
    let other = path("other.toml");
    std::fs::write(&other, store("another") + plant).expect("writable");
    let (code, out) = stictiond(&["import", &other, &file]);
    assert!(code == Some(0) && out.starts_with(&format!("{file}: 100 samples, read as: ")), "{out}");
    assert!(stictiond(&["check", &other]).1.contains("100 from 1 tag,"));
    let again = path("again.csv");
    place.cluster().end();
    for arguments in [vec!["check", &config], vec!["export", &config, &again], vec!["import", &config, &file]]
    {
        let (code, said) = stictiond(&arguments);
        assert!(code != Some(0) && said.contains("PostgreSQL"), "{said}");
    }
}
