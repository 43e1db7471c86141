//! The whole daemon with a store: what a restart brings back, and how a store that fails shows.

use crate::app::{Daemon, config, device, heard, start_at};
use crate::http::{Events, get, post};
use crate::postgres::Cluster;
use crate::rig::START;
use std::path::PathBuf;
use std::time::Duration;
use stictiond::config::Config;
use stictiond::schedule::Clock;
use stictiond::store::{self, Reader, Upkeep, check};

/// A device that counts its requests counts one that we gave up too: on a busy machine none may be given up. A time-out is
/// at most the time between two polls, so these come less often.
fn patient(config: &mut Config) {
    (config.modbus[0].poll_ms, config.modbus[0].timeout_ms) = (200, 200);
}

/// A folder of its own, gone with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("store-{name}-{}", std::process::id());
        let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }

    fn config(&self) -> store::Config {
        store::Config { sync_ms: 20, chunk_s: 10, ..store::Config::new(&self.0) }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

async fn stop(daemon: Daemon) {
    daemon.app.stop().cancel();
    let ended = tokio::time::timeout(Duration::from_secs(10), daemon.task).await;
    ended.expect("ends in time").expect("no panic").expect("ends well");
}

/// Waits until the daemon says of its store what is asked for.
async fn until(daemon: &Daemon, what: &str, good: impl Fn(&serde_json::Value) -> bool) -> serde_json::Value {
    for _ in 0..600 {
        let health = daemon.json("/healthz").await["store"].clone();
        if good(&health) {
            return health;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{what}: {}", daemon.json("/healthz").await);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_brings_back_samples_diagnoses_models_and_alarms() {
    let (folder, (address, _)) = (Folder::new("restart"), device().await);
    let mut first = config(&[address], &[("A", 0, 10), ("B", 0, 20)]);
    first.store = Some(folder.config());
    let daemon = start_at(first.clone(), Clock::plant(START, 20.0)).await;
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "alarm", "A").await;
    heard(&mut events, "diagnosis", "B").await;
    let acked = post(daemon.address, "/api/v1/alarms/A/ack", "{\"by\":\"eve\",\"comment\":\"seen\"}").await;
    assert_eq!((acked.status, acked.json()["survives_restart"].as_bool()), (200, Some(true)));
    // Durable before it is answered: another reader sees it already.
    let kept = Reader::open(&folder.0).and_then(|reader| reader.alarm("A", "stiction")).expect("can be read");
    assert!(kept.is_some_and(|row| row.acknowledged && row.by.as_deref() == Some("eve")));
    // Taken out of service as well, which a restart does not give back.
    let taken = post(daemon.address, "/api/v1/alarms/B/f_rising/out-of-service", "{\"by\":\"eve\"}").await;
    assert_eq!(taken.json()["state"], "out-of-service");
    let before: Vec<_> = [
        daemon.json("/api/v1/alarms").await["items"][0].clone(),
        daemon.json("/api/v1/loops/A/diagnosis").await,
        daemon.json("/api/v1/loops/A/model").await,
        daemon.json("/api/v1/loops/B/diagnoses").await["items"][0].clone(),
    ]
    .into();
    let samples = daemon.json("/api/v1/loops/A/samples").await["tags"][1].clone();
    stop(daemon).await;

    // Plant time goes on where it was; the first diagnosis is due after a quarter of a second.
    let daemon = start_at(first.clone(), Clock::plant(START + 1000.0, 20.0)).await;
    let ready = daemon.json("/readyz").await;
    assert_eq!(
        (ready["loops_diagnosed"].as_u64(), ready["store"]["state"].as_str()),
        (Some(2), Some("working"))
    );
    let alarms = daemon.json("/api/v1/alarms").await;
    assert_eq!(alarms["items"][0], before[0], "state, times, by whom and why");
    assert_eq!(
        (&alarms["items"][1]["id"], &alarms["items"][1]["state"]),
        (&"B/f_rising".into(), &"out-of-service".into())
    );
    let log = daemon.json("/api/v1/alarms/history").await;
    assert_eq!(log["items"].as_array().map(Vec::len), Some(3), "{log}");
    let mut report = daemon.json("/api/v1/loops/A/diagnosis").await;
    assert!(report["age_s"].as_f64() > before[1]["age_s"].as_f64(), "its own time, not that of the restart");
    report["age_s"] = before[1]["age_s"].clone();
    assert_eq!(report, before[1]);
    assert_eq!(daemon.json("/api/v1/loops/A/model").await, before[2]);
    let items = daemon.json("/api/v1/loops/B/diagnoses").await;
    assert!(items["items"].as_array().expect("a list").contains(&before[3]), "{items}");
    let now = daemon.json("/api/v1/loops/A/samples").await["tags"][1].clone();
    let (times, old) = (now["time"].as_array().expect("times"), samples["time"].as_array().expect("times"));
    assert!(
        old.len() > 5 && times.len() >= old.len() && times[..old.len()] == old[..],
        "every sample is back"
    );
    // The loop is judged again within its period, and its alarm goes on from where it was.
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "diagnosis", "A").await;
    assert_eq!(daemon.json("/api/v1/loops/A").await["alarm"], "acknowledged");
    stop(daemon).await;

    let checked = check(&folder.0).expect("can be read");
    assert_eq!(checked.faults, [""; 0]);
    let transitions =
        Reader::open(&folder.0).and_then(|reader| reader.transitions(0, 100)).expect("can be read");
    let causes: Vec<_> = transitions.iter().map(|(_, row)| (row.cause.as_str(), row.by.as_deref())).collect();
    let expected = [("raised", None), ("acknowledged", Some("eve")), ("out_of_service", Some("eve"))];
    assert_eq!(causes, expected, "once each, nothing lost");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reload_refills_what_is_new_and_follows_it() {
    let (folder, (address, _)) = (Folder::new("reload"), device().await);
    let mut wide = config(&[address], &[("A", 0, 100)]);
    patient(&mut wide);
    wide.store = Some(folder.config());
    let daemon = start_at(wide.clone(), Clock::plant(START, 20.0)).await;
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "diagnosis", "A").await;
    let found = |samples: serde_json::Value| samples["tags"][0]["found"].as_u64().expect("a number");
    let before = found(daemon.json("/api/v1/loops/A/samples").await);
    // Another size means other rings.
    wide.history.samples_per_tag = 2000;
    daemon.app.reload(wide).await.expect("sound");
    assert!(found(daemon.json("/api/v1/loops/A/samples").await) >= before);
    heard(&mut events, "diagnosis", "A").await;
    let last = daemon.json("/api/v1/loops/A").await["values"][0]["value"].as_f64().expect("a number");
    stop(daemon).await;
    let mut reader = Reader::open(&folder.0).expect("can be read");
    let name = reader.tags().expect("can be read")[0].name.clone();
    let kept =
        reader.last(std::slice::from_ref(&name), 100_000).expect("can be read").remove(&name).expect("there");
    // The device counts its requests, of which there are one to a poll: a sample left out would show.
    let steps: Vec<f64> = kept.windows(2).map(|pair| pair[1].value - pair[0].value).collect();
    assert!(kept.last().is_some_and(|sample| sample.value >= last));
    assert!(steps.iter().all(|step| *step == 1.0), "{steps:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_cannot_be_opened_is_said_and_taken_up_when_it_can() {
    let (folder, (address, _)) = (Folder::new("blocked"), device().await);
    std::fs::write(&folder.0, "a file where the folder should be").expect("writable");
    let mut own = config(&[address], &[("A", 0, 10)]);
    own.store = Some(folder.config());
    let daemon = start_at(own, Clock::plant(START, 20.0)).await;
    let failing = until(&daemon, "fails", |store| store["state"] == "failing").await;
    assert!(failing["reason"].as_str().is_some_and(|why| why.contains("blocked")), "{failing}");
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "diagnosis", "A").await;
    let first = daemon.json("/api/v1/loops/A/samples").await["tags"][0]["time"][0].clone();
    let metrics = get(daemon.address, "/metrics").await.text();
    assert!(metrics.contains("stictiond_store_working 0.0"), "{metrics}");
    std::fs::remove_file(&folder.0).expect("writable");
    let working =
        until(&daemon, "works", |store| store["state"] == "working" && !store["written"].is_null()).await;
    assert!(working["reason"].is_null());
    stop(daemon).await;
    // What was measured and said meanwhile waited in memory.
    let mut reader = Reader::open(&folder.0).expect("can be read");
    let name = reader.tags().expect("can be read")[0].name.clone();
    let kept =
        reader.last(std::slice::from_ref(&name), 1000).expect("can be read").remove(&name).expect("there");
    let first = first.as_str().and_then(stictiond::serve::dto::parse_time).expect("a time");
    assert!((kept[0].t - first).abs() < 1e-3, "from the first sample on: {} and {first}", kept[0].t);
    assert!(!reader.last_diagnoses("A", 10).expect("can be read").is_empty());
}

fn lost_states(count: u64) -> String {
    format!("stictiond_store_events_total{{event=\"lost_states\"}} {count}.0\n")
}

/// The states of its alarms are overwritten, and their second copy is gone.
#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_store_is_said_with_what_is_lost_over_restarts_until_somebody_decides() {
    let (folder, (address, _)) = (Folder::new("damaged"), device().await);
    let mut own = config(&[address], &[("A", 0, 10)]);
    own.store = Some(folder.config());
    let daemon = start_at(own.clone(), Clock::plant(START, 20.0)).await;
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "alarm", "A").await;
    stop(daemon).await;
    crate::files::overwrite(&folder.0, "alarms");
    let copy = folder.0.join("states.log");
    let lost = crate::files::records(&std::fs::read(&copy).expect("there"));
    assert!(lost > 3, "two tags, an alarm and its change: {lost}");
    std::fs::write(&copy, "").expect("writable");

    for later in [1000.0, 2000.0] {
        let daemon = start_at(own.clone(), Clock::plant(START + later, 20.0)).await;
        let failing = until(&daemon, "fails", |store| store["state"] == "failing").await;
        let reason = failing["reason"].as_str().expect("a reason");
        let told = format!("{lost} records are lost");
        for part in ["pages are not what was written", "stictiond store check --repair", &told] {
            assert!(reason.contains(part), "{part}: {reason}");
        }
        assert_eq!(failing["damaged"].as_bool(), Some(true), "{failing}");
        assert_eq!(failing["lost_states"].as_u64(), Some(lost), "{failing}");
        assert!(failing["since"].is_string() && failing["written"].is_null(), "{failing}");
        let metrics = get(daemon.address, "/metrics").await.text();
        for line in ["stictiond_store_working 0.0\n", &lost_states(lost)] {
            assert!(metrics.contains(line), "{line}: {metrics}");
        }
        // It goes on from memory all the same.
        let mut events = Events::open(daemon.address).await;
        heard(&mut events, "diagnosis", "A").await;
        stop(daemon).await;
    }

    store::repair(&folder.config()).expect("repaired");
    let daemon = start_at(own, Clock::plant(START + 3000.0, 20.0)).await;
    let working = until(&daemon, "works", |store| !store["written"].is_null()).await;
    assert_eq!((working["state"].as_str(), working["damaged"].as_bool()), (Some("working"), Some(false)));
    assert_eq!(working["lost_states"].as_u64(), Some(0));
    assert!(get(daemon.address, "/metrics").await.text().contains(&lost_states(0)));
    stop(daemon).await;
}

/// Nobody reads the page that is overwritten, and nothing is written to it: only who compares all pages finds it.
#[tokio::test(flavor = "multi_thread")]
async fn damage_under_a_running_daemon_is_found_and_what_people_did_before_is_back() {
    let (folder, (address, _)) = (Folder::new("rotten"), device().await);
    let mut own = config(&[address], &[("A", 0, 10)]);
    let upkeep = Upkeep { log: 4, ..Upkeep::default() };
    own.store = Some(store::Config { upkeep, ..folder.config() });
    let daemon = start_at(own.clone(), Clock::plant(START, 20.0)).await;
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "alarm", "A").await;
    let acked = post(daemon.address, "/api/v1/alarms/A/ack", "{\"by\":\"eve\"}").await;
    assert_eq!((acked.status, acked.json()["survives_restart"].as_bool()), (200, Some(true)));
    until(&daemon, "works", |store| store["state"] == "working" && store["damaged"] == false).await;
    crate::files::overwrite(&folder.0, "known_models");
    let failing = until(&daemon, "fails", |store| store["state"] == "failing").await;
    let is_told = |store: &serde_json::Value| {
        let reason = store["reason"].as_str().unwrap_or_default();
        store["damaged"] == true && reason.contains("page") && reason.contains("is not what was written")
    };
    assert!(is_told(&failing), "{failing}");
    let metrics = get(daemon.address, "/metrics").await.text();
    for line in ["stictiond_store_working 0.0\n", &lost_states(0)] {
        assert!(metrics.contains(line), "{line}: {metrics}");
    }
    let shelving = "{\"by\":\"eve\",\"comment\":\"later\",\"duration_s\":3600}";
    let shelved = post(daemon.address, "/api/v1/alarms/A/shelve", shelving).await;
    assert_eq!((shelved.status, shelved.json()["survives_restart"].as_bool()), (200, Some(false)));
    stop(daemon).await;

    let daemon = start_at(own, Clock::plant(START + 1000.0, 20.0)).await;
    let failing = until(&daemon, "fails", |store| store["state"] == "failing").await;
    assert!(is_told(&failing) && failing["lost_states"] == 0, "{failing}");
    assert_eq!(daemon.json("/api/v1/loops/A").await["alarm"], "acknowledged");
    stop(daemon).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_of_which_not_all_was_compared_yet_is_checking() {
    let (folder, (address, _)) = (Folder::new("large"), device().await);
    let mut own = config(&[address], &[("A", 0, 10)]);
    own.store = Some(folder.config());
    let daemon = start_at(own.clone(), Clock::plant(START, 20.0)).await;
    let new = until(&daemon, "works", |store| !store["written"].is_null()).await;
    assert_eq!((new["state"].as_str(), &new["checked"]), (Some("working"), &serde_json::Value::Null));
    stop(daemon).await;

    // As large as if one page were 512 MB.
    let started = |each: u32, later: f64| {
        let upkeep = Upkeep { at_once: 1, each, ..Upkeep::default() };
        let mut own = own.clone();
        own.store = Some(store::Config { upkeep, ..folder.config() });
        start_at(own, Clock::plant(START + later, 20.0))
    };
    let daemon = started(0, 1000.0).await;
    let checking = until(&daemon, "works", |store| !store["written"].is_null()).await;
    assert_eq!(checking["state"], "checking", "{checking}");
    assert!(checking["checked"].as_f64().is_some_and(|share| share > 0.0 && share < 0.5), "{checking}");
    assert!(checking["reason"].is_null() && checking["damaged"] == false, "{checking}");
    let metrics = get(daemon.address, "/metrics").await.text();
    for line in ["stictiond_store_working 1.0\n", "stictiond_store_checked_ratio 0."] {
        assert!(metrics.contains(line), "{line}: {metrics}");
    }
    stop(daemon).await;
    let daemon = started(4096, 2000.0).await;
    let working = until(&daemon, "works", |store| !store["written"].is_null()).await;
    assert_eq!((working["state"].as_str(), &working["checked"]), (Some("working"), &serde_json::Value::Null));
    assert!(get(daemon.address, "/metrics").await.text().contains("stictiond_store_checked_ratio 1.0\n"));
    stop(daemon).await;
}

/// The database goes away under the whole daemon, which is ended meanwhile and started again without it.
#[tokio::test(flavor = "multi_thread")]
async fn while_its_database_is_away_the_daemon_spools_says_so_and_delivers() {
    let folder = Folder::new("away");
    let mut cluster = tokio::task::spawn_blocking(|| Cluster::with(None, false)).await.expect("starts");
    let (address, _) = device().await;
    let mut own = config(&[address], &[("A", 0, 10), ("B", 0, 100)]);
    patient(&mut own);
    let kept = store::Config { sync_ms: 20, ..cluster.config(&folder.0) };
    own.store = Some(kept.clone());
    let daemon = start_at(own.clone(), Clock::plant(START, 20.0)).await;
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "alarm", "A").await;
    until(&daemon, "works", |store| store["state"] == "working" && !store["written"].is_null()).await;
    let metrics = get(daemon.address, "/metrics").await.text();
    assert!(metrics.contains("stictiond_store_database_connected 1.0"), "{metrics}");

    let mut cluster = tokio::task::spawn_blocking(move || {
        cluster.end();
        cluster
    })
    .await
    .expect("ends");
    let away = until(&daemon, "spools", |store| store["state"] == "spooling").await;
    assert!(
        away["reason"].as_str().is_some_and(|why| why.contains("PostgreSQL")) && away["since"].is_string()
    );
    heard(&mut events, "diagnosis", "A").await;
    let acked = post(daemon.address, "/api/v1/alarms/A/ack", "{\"by\":\"eve\"}").await;
    assert_eq!(acked.status, 200, "what somebody says is durable in the spool");
    let metrics = get(daemon.address, "/metrics").await.text();
    for line in ["stictiond_store_database_connected 0.0", "stictiond_store_working 1.0"] {
        assert!(metrics.contains(line), "{metrics}");
    }
    stop(daemon).await;
    let daemon = start_at(own, Clock::plant(START + 1000.0, 20.0)).await;
    until(&daemon, "spools again", |store| store["state"] == "spooling").await;
    assert_eq!(daemon.json("/api/v1/loops/A").await["alarm"], "acknowledged", "from what waits");
    let found = daemon.json("/api/v1/loops/B/samples").await["tags"][0]["found"].as_u64();
    assert!(found > Some(1), "the ring has what waits");
    let cluster = tokio::task::spawn_blocking(move || {
        cluster.begin();
        cluster
    })
    .await
    .expect("begins");
    until(&daemon, "works again", |store| store["state"] == "working").await;
    stop(daemon).await;
    tokio::task::spawn_blocking(move || {
        assert_eq!(store::check_of(&kept).expect("can be read").faults, [""; 0]);
        let mut reader = Reader::of(&kept).expect("can be read");
        let all = reader.between("B", "op", 0.0, 1e10).expect("can be read");
        // The device counts its requests, two to a poll; only what it counted for the daemon that ended may be missing.
        let steps: Vec<f64> = all.windows(2).map(|pair| pair[1].value - pair[0].value).collect();
        let gaps = steps.iter().filter(|step| **step != 2.0).count();
        assert!(all.len() > 5 && gaps <= 1 && steps.iter().all(|step| *step > 0.0), "{steps:?}");
        assert!(reader.alarm("A", "stiction").expect("reads").is_some_and(|row| row.acknowledged));
        drop(cluster);
    })
    .await
    .expect("all is there");
}

#[tokio::test]
async fn without_a_store_health_says_none() {
    let (address, _) = device().await;
    let daemon = start_at(config(&[address], &[("A", 0, 10)]), Clock::plant(START, 20.0)).await;
    assert!(daemon.json("/healthz").await["store"].is_null());
    assert!(!get(daemon.address, "/metrics").await.text().contains("stictiond_store"));
    stop(daemon).await;
}
