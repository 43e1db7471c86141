//! `stictiond run` with a store, as a machine treats it: killed under load and started again, and a disk that is full.

#[path = "peers/daemon.rs"]
mod daemon;
#[path = "peers/postgres.rs"]
mod postgres;
#[path = "peers/webhook.rs"]
mod webhook;

use daemon::{Daemon, folder, stictiond};
use postgres::Cluster;
use serde_json::Value;
use std::fmt::Write as _;
use std::process::Command;
use std::time::{Duration, Instant};
use stictiond::demo::{DEFAULT_SPEED, Demo, Options};
use stictiond::store::{Config, Reader, check, check_of};

/// Time between two diagnoses of a loop in these tests (s).
const PERIOD_S: u64 = 10;

/// Replays, and finds at least `least` diagnoses and every one identical.
fn replayed(command: &mut Command, least: u64) {
    let output = command.output().expect("runs");
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let last = out.lines().last().unwrap_or_default();
    let runs: u64 = last.split(' ').nth(2).and_then(|runs| runs.parse().ok()).unwrap_or(0);
    let all = format!("{runs} of {runs} diagnoses identical to the recorded, bit for bit");
    assert!(output.status.success() && last == all && runs >= least, "{out}{err}");
    println!("{last}");
}

/// By loop: the state of its alarm, its verdict, and when it was diagnosed.
fn loops(daemon: &Daemon) -> Vec<(String, String, Option<String>, f64)> {
    let list = daemon.json("/api/v1/loops?limit=100&sort=id");
    let items = list["items"].as_array().expect("loops").iter();
    let time =
        |item: &Value| item["time"].as_str().and_then(stictiond::serve::dto::parse_time).unwrap_or(0.0);
    let text = |value: &Value| value.as_str().map(str::to_string);
    items
        .map(|item| {
            let id = text(&item["id"]).expect("a name");
            (id, text(&item["alarm"]).expect("a state"), text(&item["verdict"]), time(item))
        })
        .collect()
}

/// The demo's plant of twenty loops, polled by a daemon with a store that is killed and started again.
#[tokio::test(flavor = "multi_thread")]
async fn killed_under_load_it_goes_on_where_it_was() {
    let options =
        Options { listen: ([127, 0, 0, 1], 0).into(), speed: DEFAULT_SPEED, seed: 1, writeback: false };
    let demo = Demo::build(&options).await.expect("builds");
    let (folder, stop) = (folder("store-restart"), demo.stop());
    let store = folder.join("store");
    // On the wall clock the plant is eighty times as fast as its stamps, which is nothing to a diagnosis.
    let text = demo.config().replace(&demo.address().to_string(), "127.0.0.1:0");
    let period = text.find("period_s").expect("there");
    let line = period..period + text[period..].find('\n').expect("a line");
    let mut text = text.replacen(&text[line], &format!("period_s = {PERIOD_S}"), 1);
    let _ = write!(
        text,
        "\n[store]\nfolder = {:?}\nsync_ms = 200\nchunk_s = 10\n[alarm]\nk = 1\nn = 1\n",
        store.display().to_string()
    );
    let config = folder.join("config.toml");
    std::fs::write(&config, text).expect("writable");
    let plant = tokio::spawn(demo.run_plant());
    let done = tokio::task::spawn_blocking(move || {
        let daemon = Daemon::start(stictiond(), "run", &config);
        daemon.until("every loop diagnosed and alarms raised", Duration::from_secs(240), |daemon| {
            let loops = loops(daemon);
            let raised = loops.iter().filter(|(_, alarm, ..)| alarm == "unacknowledged").count();
            raised >= 5 && loops.iter().all(|(_, _, verdict, _)| verdict.is_some())
        });
        let raised =
            loops(&daemon).into_iter().find(|(_, alarm, ..)| alarm == "unacknowledged").expect("one");
        daemon.ask("POST", &format!("/api/v1/alarms/{}/ack", raised.0), "{\"by\":\"eve\"}");
        daemon.until("the acknowledgement is durable", Duration::from_secs(10), |_| {
            let alarm = Reader::open(&store)
                .and_then(|reader| reader.alarm(&raised.0, "stiction"))
                .expect("can be read");
            alarm.is_some_and(|alarm| alarm.acknowledged)
        });
        let before = loops(&daemon);
        // SIGKILL.
        drop(daemon);

        let down = Instant::now();
        let daemon = Daemon::start(stictiond(), "run", &config);
        let (after, started_s) = (loops(&daemon), down.elapsed().as_secs_f64());
        for (was, is) in before.iter().zip(&after) {
            // A run of the last 200 ms before the kill may not have been durable, or have come after we looked.
            assert!(is.2.is_some() && (is.3 - was.3).abs() < 2.0 * PERIOD_S as f64, "{was:?} and {is:?}");
        }
        let acked = after.iter().find(|own| own.0 == raised.0).expect("there");
        assert_eq!(acked.1, "acknowledged");
        let samples = daemon.json(&format!("/api/v1/loops/{}/samples?points=5", raised.0));
        assert!(samples["tags"][0]["found"].as_u64() > Some(200), "the ring is full again: {samples}");
        // Every loop is judged anew, from samples of before and after: none is too short. How soon depends on the machine.
        let diagnosed = |daemon: &Daemon| loops(daemon).iter().zip(&after).all(|(now, then)| now.3 > then.3);
        daemon.until("every loop diagnosed again", Duration::from_secs(120), diagnosed);
        for own in loops(&daemon) {
            let items = daemon.json(&format!("/api/v1/loops/{}/diagnosis", own.0));
            assert_ne!(items["reason_code"], "too_short", "{items}");
        }
        println!("killed and serving again after {started_s:.2} s");
        let bundle = daemon.ask("GET", &format!("/api/v1/loops/{}/bundle", raised.0), "");
        daemon.stop();
        // What was said before the kill and after it comes out again, by the bundle and by the whole record.
        let file = folder.join("bundle.json");
        std::fs::write(&file, bundle).expect("writable");
        replayed(stictiond().arg("replay").arg(&file), 1);
        replayed(stictiond().arg("replay").arg(&store).arg("--config").arg(&config), 40);
        // The history of every alarm goes on from where it was left, nothing is twice or damaged.
        let checked = check(&store).expect("can be read");
        assert_eq!(checked.faults, [""; 0]);
        assert!(checked.transitions >= 6 && checked.diagnoses >= 40, "{checked:?}");
        std::fs::remove_dir_all(&folder).expect("writable");
    });
    let done = done.await;
    stop.cancel();
    plant.await.expect("no panic").expect("ends well");
    done.expect("all is well");
}

/// Alarms that are not normal, by name.
fn alarms(daemon: &Daemon) -> Vec<(String, String)> {
    let list = daemon.json("/api/v1/alarms");
    let text = |value: &Value| value.as_str().expect("text").to_string();
    let items = list["items"].as_array().expect("alarms").iter();
    items.map(|item| (text(&item["id"]), text(&item["state"]))).collect()
}

/// What people did about alarms outlasts a start without the database, and one on a fresh disk that knows nothing.
#[test]
fn a_start_without_the_database_neither_forgets_nor_overwrites_what_people_did() {
    let mut cluster = Cluster::with(None, false);
    let folder = folder("store-away");
    let (path, spool) = (folder.join("config.toml"), folder.join("spool"));
    let config: Config = cluster.config(&spool);
    let url = config.url.clone().expect("one");
    let mut text = format!(
        "[server]\nlisten = '127.0.0.1:0'\n[store]\nfolder = {spool:?}\nurl = '{url}'\nsync_ms = 20\n\
         [alarm]\nsuppressed = ['*/tag_bad', '*/not_identifiable']\n[alarm.collector_down]\nafter_s = 1.0\n"
    );
    for name in ["d", "e"] {
        let _ = write!(
            text,
            "[[modbus]]\nname = '{name}'\naddress = '127.0.0.1:9'\naddress_base = 0\npoll_ms = 50\ntimeout_ms = 50\n\
             [[loop]]\nid = 'L{name}'\n[loop.op]\ndevice = '{name}'\nregister = 'input'\naddress = 0\ntype = 'f32'\n\
             [loop.pv]\ndevice = '{name}'\nregister = 'input'\naddress = 2\ntype = 'f32'\n"
        );
    }
    std::fs::write(&path, &text).expect("writable");
    let are = |d: &str, e: &str| {
        let named = |name: &str, state: &str| (format!("{name}/collector_down"), state.to_string());
        vec![named("d", d), named("e", e)]
    };
    let patience = Duration::from_secs(30);
    let collectors = |daemon: &Daemon| -> Vec<(String, String)> {
        alarms(daemon).into_iter().filter(|(id, _)| id.ends_with("/collector_down")).collect()
    };
    let until = |daemon: &Daemon, d: &str, e: &str| {
        daemon.until(&format!("{d} and {e}"), patience, |daemon| collectors(daemon) == are(d, e));
    };
    let store = |daemon: &Daemon| daemon.json("/healthz")["store"]["state"].as_str().map(str::to_string);

    let daemon = Daemon::start(stictiond(), "run", &path);
    until(&daemon, "unacknowledged", "unacknowledged");
    daemon.ask("POST", "/api/v1/alarms/d/collector_down/ack", "{\"by\":\"eve\"}");
    daemon.ask("POST", "/api/v1/alarms/e/collector_down/shelve", "{\"by\":\"kim\",\"duration_s\":3600}");
    until(&daemon, "acknowledged", "shelved");
    daemon.stop();
    let rows = Reader::of(&config).expect("answers").alarms().expect("reads");
    cluster.end();

    // The same disk: everything is as it was, before anything is observed.
    let daemon = Daemon::start(stictiond(), "run", &path);
    assert_eq!(collectors(&daemon), are("acknowledged", "shelved"));
    let spooling = |daemon: &Daemon| store(daemon).as_deref() == Some("spooling");
    daemon.until("it spools", patience, spooling);
    daemon.stop();

    // A fresh disk: it begins anew, and says so.
    std::fs::remove_dir_all(&spool).expect("there");
    let daemon = Daemon::start(stictiond(), "run", &path);
    until(&daemon, "unacknowledged", "unacknowledged");
    cluster.begin();
    until(&daemon, "acknowledged", "shelved");
    daemon.until("nothing waits", patience, |daemon| store(daemon).as_deref() == Some("working"));
    daemon.stop();

    let after = Reader::of(&config).expect("answers").alarms().expect("reads");
    let of = |rows: &[stictiond::store::AlarmRow]| -> Vec<_> {
        let own = rows.iter().filter(|row| row.kind == "collector_down");
        own.map(|row| (row.acknowledged, row.shelved_until, row.raised_at, row.by.clone())).collect()
    };
    assert_eq!(of(&after), of(&rows));
    let checked = check_of(&config).expect("can be read");
    assert_eq!(checked.faults, [""; 0]);
    let rows = Reader::of(&config).expect("answers").transitions(0, 99).expect("reads");
    let mut of_d = rows.iter().filter(|(_, row)| row.control_loop == "d").map(|(_, row)| row.cause.as_str());
    assert_eq!(
        of_d.by_ref().collect::<Vec<_>>(),
        ["raised", "acknowledged", "forgotten", "raised", "restored"]
    );

    // Another fresh disk, and nothing has happened when the database is back and the file is read again: what happens then
    // is told, and not what happened before the start.
    std::fs::remove_dir_all(&spool).expect("there");
    cluster.end();
    let (receiver, told) = webhook::receiver();
    let secret = folder.join("secret");
    std::fs::write(&secret, "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw").expect("writable");
    let told_of = format!(
        "[[notify.webhook]]\nname = 'w'\nurl = 'http://{receiver}/'\nsecret_file = {secret:?}\n\
         events = ['raised', 'cleared', 'acknowledged', 'silenced', 'latched']\npace = {{ wait_s = 0.0 }}\n"
    );
    let text = text.replace("after_s = 1.0", "after_s = 3600.0") + &told_of;
    std::fs::write(&path, &text).expect("writable");
    let daemon = Daemon::start(stictiond(), "run", &path);
    daemon.until("it spools or waits", patience, |daemon| store(daemon).as_deref() != Some("working"));
    assert_eq!(collectors(&daemon), []);
    cluster.begin();
    until(&daemon, "acknowledged", "shelved");
    daemon.until("nothing waits", patience, |daemon| store(daemon).as_deref() == Some("working"));
    std::fs::write(&path, text.replace("id = 'Ld'", "id = 'Ld'\ndescription = 'read again'"))
        .expect("writable");
    daemon.signal("-HUP");
    let read_again = |daemon: &Daemon| daemon.json("/api/v1/loops/Ld")["description"] == "read again";
    daemon.until("the file is read again", patience, read_again);
    daemon.ask("POST", "/api/v1/alarms/d/collector_down/out-of-service", "{\"by\":\"eve\"}");
    let message: Value = serde_json::from_str(&told.recv_timeout(patience).expect("told").1).expect("JSON");
    let alarms = message["data"]["alarms"].as_array().expect("alarms").iter();
    let alarms: Vec<_> = alarms.map(|own| (own["id"].as_str(), own["state"].as_str())).collect();
    assert_eq!(alarms, [(Some("d/collector_down"), Some("out-of-service"))], "{message}");
    // The history has what happened before, each once, and after it what happened since.
    let history = daemon.json("/api/v1/alarms/history?kind=collector_down");
    let items = history["items"].as_array().expect("items").iter().rev();
    let causes = items.filter(|item| item["id"] == "d/collector_down").map(|item| item["cause"].as_str());
    let expected = ["raised", "acknowledged", "forgotten", "raised", "restored", "out_of_service"];
    assert_eq!(causes.collect::<Vec<_>>(), expected.map(Some), "{history}");
    daemon.stop();
    std::fs::remove_dir_all(&folder).expect("writable");
}

/// A limit on the size of files, set from outside and lifted while it runs, is a disk that is full and has room again.
#[test]
fn a_disk_that_is_full_is_said_and_costs_nothing_when_there_is_room_again() {
    if Command::new("prlimit").arg("--version").output().is_err() {
        println!("skipped: there is no prlimit");
        return;
    }
    let folder = folder("store-full");
    let (config, store) = (folder.join("config.toml"), folder.join("store"));
    // Nobody answers on the port: every poll is a sample that says so.
    let text = format!(
        "[server]\nlisten = '127.0.0.1:0'\n[store]\nfolder = {:?}\nsync_ms = 20\nchunk_s = 10\n\
         [[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\npoll_ms = 50\ntimeout_ms = 50\n\
         [[loop]]\nid = 'A'\n[loop.op]\ndevice = 'd'\nregister = 'input'\naddress = 0\ntype = 'f32'\n\
         [loop.pv]\ndevice = 'd'\nregister = 'input'\naddress = 2\ntype = 'f32'\n",
        store.display().to_string()
    );
    std::fs::write(&config, text).expect("writable");
    // The signal that comes with the limit is ignored, as a full disk sends none.
    let mut command = Command::new("sh");
    command.args([
        "-c",
        "trap '' XFSZ; ulimit -S -f 2000; exec \"$@\"",
        "sh",
        env!("CARGO_BIN_EXE_stictiond"),
    ]);
    let daemon = Daemon::start(command, "run", &config);
    let written = |daemon: &Daemon| !daemon.json("/healthz")["store"]["written"].is_null();
    daemon.until("the store works", Duration::from_secs(10), written);
    let state = |daemon: &Daemon| daemon.json("/healthz")["store"]["state"].as_str().map(str::to_string);
    let failing = |daemon: &Daemon| state(daemon).as_deref() == Some("failing");
    daemon.until("the store fails", Duration::from_secs(30), failing);
    assert!(daemon.json("/readyz")["store"]["reason"].is_string());
    assert!(daemon.ask("GET", "/metrics", "").contains("stictiond_store_working 0.0"));
    let id = daemon.id();
    // Samples come meanwhile; where a little room is left the store works for a moment between two failures.
    let samples = |daemon: &Daemon| {
        daemon.json("/api/v1/loops/A/samples?points=5")["tags"][0]["found"].as_u64().expect("a number")
    };
    let waiting = samples(&daemon) + 40;
    daemon.until("40 more samples, and it still fails", Duration::from_secs(30), |daemon| {
        samples(daemon) >= waiting && failing(daemon)
    });
    let lifted = Command::new("prlimit").args(["--pid", &id, "--fsize=unlimited"]).status().expect("prlimit");
    assert!(lifted.success());
    daemon.until("the store works again", Duration::from_secs(30), |daemon| {
        state(daemon).as_deref() == Some("working")
    });
    daemon.stop();

    let checked = check(&store).expect("can be read");
    assert_eq!(checked.faults, [""; 0]);
    let mut reader = Reader::open(&store).expect("can be read");
    let name = reader.tags().expect("can be read")[0].name.clone();
    let kept = reader
        .last(std::slice::from_ref(&name), 1_000_000)
        .expect("can be read")
        .remove(&name)
        .expect("there");
    let worst = kept.windows(2).map(|pair| pair[1].t - pair[0].t).fold(0.0, f64::max);
    println!("{} samples, at most {worst:.3} s apart", kept.len());
    // Polls are 50 ms apart, reconnects up to the back-off of a device that is not there.
    assert!(kept.len() > 40 && worst < 1.0, "{} samples, {worst} s apart", kept.len());
    std::fs::remove_dir_all(&folder).expect("writable");
}
