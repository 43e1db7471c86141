//! The past as a job in the API: from what is stored, and from what an OPC UA server keeps.

use crate::app::{Daemon, config, device, heard};
use crate::http::{Events, get, post, send};
use crate::rig::{START, sticky_at_ten, verdict_of};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use stictiond::app::App;
use stictiond::config::Config;
use stictiond::diagnosis::Verdict;
use stictiond::schedule::{Clock, Diagnose};
use stictiond::signal::{Record, Sample};
use stictiond::store::{self, Batch, Series, Store, TagName};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::net::TcpListener;
use tokio::process::{Child, ChildStdin, ChildStdout, Command};

/// Far longer than anything here takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);
const BACKFILL: &str = "/api/v1/backfill";

fn folder(name: &str) -> PathBuf {
    let name = format!("backfill-{name}-{}", std::process::id());
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&path);
    path
}

/// A record of three hours at 1 s in a store; OP is 10 in the second hour only.
fn filled(at: &Path) {
    let mut store = Store::open(&store::Config::new(at)).expect("opens");
    let series = |tag: &str, value: fn(u32) -> f64| {
        let name = TagName {
            control_loop: "A".into(),
            tag: tag.into(),
            source: "import".into(),
            unit: String::new(),
        };
        let samples =
            (0..3 * 3600).map(|i| Sample::good(START - 86_400.0 + f64::from(i), value(i))).collect();
        Series { tag: Arc::new(name), samples }
    };
    let op = |i: u32| if (3600..7200).contains(&i) { 10.0 } else { 20.0 };
    let series = vec![series("op", op), series("pv", |i| f64::from(i % 100))];
    store.insert(&Batch { series, rows: Vec::new() }).expect("writes");
}

/// A daemon whose diagnosis is the test's; it diagnoses nothing by itself meanwhile.
async fn start(mut own: Config, clock: Clock, diagnose: Diagnose) -> Daemon {
    own.schedule.period_s = 86_400.0;
    let app = Arc::new(App::build(own, clock, diagnose).expect("a sound configuration"));
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    let running = app.clone();
    Daemon { app, address, task: tokio::spawn(async move { running.run(listener).await }) }
}

async fn stop(daemon: Daemon) {
    daemon.app.stop().cancel();
    let ended = tokio::time::timeout(PATIENCE, daemon.task).await;
    ended.expect("ends in time").expect("no panic").expect("ends well");
}

/// Waits for the event that says so; every event on the way says no less than the one before.
async fn until(events: &mut Events, phase: &str) {
    let mut last = 0;
    loop {
        let told = tokio::time::timeout(PATIENCE, heard(events, "backfill", "A")).await.expect("told");
        if told["phase"] == phase {
            return;
        }
        assert!(told["phase"] == "diagnosing" || told["phase"] == "reading", "{told}");
        let done = told["done"].as_u64().expect("a number");
        assert!(done >= last || done == 0, "{told}");
        last = done;
    }
}

fn sticky() -> Diagnose {
    Arc::new(|record: &Record, _: &_, _: Option<&_>| sticky_at_ten(record))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_past_is_diagnosed_window_by_window_and_says_when_it_began() {
    let (folder, (address, _)) = (folder("stored"), device().await);
    filled(&folder);
    let mut own = config(&[address], &[("A", 0, 20)]);
    own.store = Some(store::Config::new(&folder));
    let daemon = start(own, Clock::plant(START, 20.0), sticky()).await;
    assert_eq!(get(daemon.address, BACKFILL).await.status, 404, "none since the start");
    let from = START - 86_400.0;
    let refused = [
        (format!("{{\"loop\":\"X\",\"from\":\"{from}\"}}"), 404, "unknown_loop"),
        ("{\"loop\":\"A\",\"from\":\"yesterday\"}".to_string(), 400, "bad_field"),
        (format!("{{\"loop\":\"A\",\"from\":\"{from}\",\"to\":\"{}\"}}", from - 1.0), 400, "bad_field"),
        (format!("{{\"loop\":\"A\",\"from\":\"{from}\",\"window_s\":1}}"), 400, "bad_field"),
        (format!("{{\"loop\":\"A\",\"from\":\"{from}\",\"windows\":1}}"), 400, "bad_field"),
    ];
    for (body, status, kind) in refused {
        let answer = post(daemon.address, BACKFILL, &body).await;
        assert_eq!(answer.status, status, "{body}: {}", answer.text());
        assert!(answer.text().contains(kind), "{body}: {}", answer.text());
    }
    let mut events = Events::open(daemon.address).await;
    let to = from + 3.0 * 3600.0;
    let body =
        format!("{{\"loop\":\"A\",\"from\":\"{from}\",\"to\":\"{to}\",\"window_s\":600,\"step_s\":300}}");
    let begun = post(daemon.address, BACKFILL, &body).await;
    assert_eq!((begun.status, begun.json()["phase"].as_str()), (202, Some("diagnosing")), "{}", begun.text());
    until(&mut events, "done").await;
    let job = daemon.json(BACKFILL).await;
    let report = &job["report"];
    let items = report["items"].as_array().expect("windows");
    // 10,799 s in windows of 600 s, one every 300 s.
    assert_eq!((items.len() as u64, job["done"].as_u64(), job["of"].as_u64()), (34, Some(34), Some(34)));
    let sticky = items.iter().filter(|item| item["verdict"] == "stiction").count();
    assert_eq!(sticky, 12, "an hour of windows: {report}");
    // Two of three windows: the alarm is raised by the second.
    let raised = report["alarms"][0]["from"].as_f64().expect("raised");
    assert!((3600.0..3600.0 + 900.0).contains(&(raised - from)), "{report}");
    assert_eq!(send(daemon.address, "DELETE", BACKFILL, &[], "").await.status, 404, "none runs");
    let alarms = daemon.json("/api/v1/alarms").await;
    assert_eq!(alarms["items"], serde_json::json!([]), "nobody is called for the past");
    stop(daemon).await;
    std::fs::remove_dir_all(&folder).expect("it was made");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_at_a_time_and_it_ends_when_it_is_told_to() {
    let (folder, (address, _)) = (folder("cancel"), device().await);
    filled(&folder);
    let mut own = config(&[address], &[("A", 0, 10)]);
    own.store = Some(store::Config::new(&folder));
    // The first window waits until it is let go.
    let gate = Arc::new((Mutex::new(false), Condvar::new()));
    let held = gate.clone();
    let diagnose: Diagnose = Arc::new(move |_: &Record, _: &_, _: Option<&_>| {
        let open = held.0.lock().expect("no panic");
        drop(held.1.wait_while(open, |open| !*open).expect("no panic"));
        verdict_of(Verdict::NoStiction, 0.0, -2.0).into()
    });
    let daemon = start(own, Clock::plant(START, 20.0), diagnose).await;
    let mut events = Events::open(daemon.address).await;
    let body = format!("{{\"loop\":\"A\",\"from\":\"{}\",\"window_s\":600}}", START - 86_400.0);
    assert_eq!(post(daemon.address, BACKFILL, &body).await.status, 202);
    let second = post(daemon.address, BACKFILL, &body).await;
    assert_eq!(
        (second.status, second.json()["type"].as_str()),
        (409, Some("urn:stictiond:problem:backfill_state"))
    );
    assert_eq!(send(daemon.address, "DELETE", BACKFILL, &[], "").await.status, 200);
    *gate.0.lock().expect("no panic") = true;
    gate.1.notify_all();
    until(&mut events, "cancelled").await;
    let job = daemon.json(BACKFILL).await;
    assert!(job["report"].is_null() && job["ended"].is_string(), "{job}");
    assert_eq!(post(daemon.address, BACKFILL, &body).await.status, 202, "then the next one may");
    until(&mut events, "done").await;
    stop(daemon).await;
    std::fs::remove_dir_all(&folder).expect("it was made");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_store_there_is_no_past() {
    let (address, _) = device().await;
    let own = config(&[address], &[("A", 0, 10)]);
    let daemon = start(own, Clock::plant(START, 20.0), sticky()).await;
    let body = format!("{{\"loop\":\"A\",\"from\":\"{}\"}}", START - 86_400.0);
    let refused = post(daemon.address, BACKFILL, &body).await;
    assert_eq!((refused.status, refused.text().contains("[store]")), (409, true));
    stop(daemon).await;
}

/// asyncua with two minutes of history of a counter; gone with the test.
struct Historian {
    port: u16,
    commands: ChildStdin,
    lines: Lines<BufReader<ChildStdout>>,
    _child: Child,
}

impl Historian {
    async fn start() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let python = root.join("target/peers-venv/bin/python");
        assert!(python.exists(), "asyncua is not installed: run scripts/peers once, then the tests again");
        let mut child = Command::new(python)
            .arg(root.join("tests/peers/opcua_server.py"))
            .args(["--history", "--backlog", "120"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()
            .expect("runs");
        let commands = child.stdin.take().expect("piped");
        let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        loop {
            let line = lines.next_line().await.expect("text").expect("the server goes on");
            if let Some(port) = line.strip_prefix("port ") {
                let port = port.parse().expect("a number");
                return Self { port, commands, lines, _child: child };
            }
        }
    }

    /// Waits until it has kept so many values more.
    async fn kept(&mut self, values: usize) {
        self.commands.write_all(format!("count {values}\n").as_bytes()).await.expect("it listens");
        let answer = tokio::time::timeout(PATIENCE, self.lines.next_line()).await.expect("it goes on");
        assert_eq!(answer.expect("text").as_deref(), Some("ok"));
    }
}

fn plant(port: u16, more: &str) -> String {
    // The same node by its number and by its path: an OP and a PV must not read the same.
    let tag = |role: &str, at: &str| format!("[loop.{role}]\ndevice = 'h'\n{at}\n");
    format!(
        "[[opcua]]\nname = 'h'\nurl = 'opc.tcp://localhost:{port}/peer/'\nsecurity_policy = 'None'\n{more}[[loop]]\nid = 'A'\n{}{}",
        tag("op", "node = 'ns=2;i=1000'"),
        tag("pv", "path = '/2:Plant/2:Unit/2:Counter'")
    )
}

fn wall() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970").as_secs_f64()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_server_kept_is_read_into_the_store_and_diagnosed() {
    let server = Historian::start().await;
    let folder = folder("devices");
    std::fs::create_dir_all(&folder).expect("writable");
    let file = folder.join("plant.toml");
    std::fs::write(&file, plant(server.port, "")).expect("writable");
    let mut own = stictiond::config::load(&file).expect("sound");
    own.store = Some(store::Config::new(folder.join("store")));
    let daemon = start(own, Clock::wall(), sticky()).await;
    let mut events = Events::open(daemon.address).await;
    let (from, to) = ((wall() - 60.0).floor(), (wall() - 40.0).floor());
    let body = format!(
        "{{\"loop\":\"A\",\"from\":\"{from}\",\"to\":\"{to}\",\"window_s\":10,\"read_devices\":true}}"
    );
    let begun = post(daemon.address, BACKFILL, &body).await;
    assert_eq!((begun.status, begun.json()["phase"].as_str()), (202, Some("reading")), "{}", begun.text());
    until(&mut events, "done").await;
    let job = daemon.json(BACKFILL).await;
    // 20 s in windows of 10 s, one every 2.5 s; the last value lies one tick before the end.
    assert_eq!(job["report"]["items"].as_array().map(Vec::len), Some(4), "{job}");
    stop(daemon).await;
    let mut reader = store::Reader::open(&folder.join("store")).expect("can be read");
    let kept = reader.between("A", "pv", from, to).expect("can be read");
    let steps = kept.windows(2).filter(|pair| pair[1].value - pair[0].value != 1.0).count();
    // The counter counts every 20 ms: each once, none lost; the ends may lie on the edge.
    assert!(steps == 0 && (999..=1001).contains(&kept.len()), "{} samples, {steps} gaps", kept.len());

    // The same by the command, end to end; run again it goes on where it was, and says the same.
    let (at, into) = (file.display().to_string(), folder.join("past").display().to_string());
    let run = move || {
        let time = |t: f64| t.to_string();
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_stictiond"))
            .args(["backfill", &at, "--loop", "A", "--window", "10", "--format", "json"])
            .args(["--from", &time(from), "--to-time", &time(to), "--slice", "15", "--pause-ms", "0"])
            .args(["--into", &into])
            .output()
            .expect("runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    };
    // Then OP and PV are read elsewhere, and a window needs more: what is noted as read is not of these tags.
    let changed = plant(server.port, "[diagnosis]\nmin_samples = 600\n")
        .replace("[loop.op]", "[loop.x]")
        .replace("[loop.pv]", "[loop.op]")
        .replace("[loop.x]", "[loop.pv]");
    let runs = tokio::task::spawn_blocking(move || {
        let (first, again) = (run(), run());
        std::fs::write(&file, changed).expect("writable");
        (first, again, run())
    });
    let (first, again, other) = runs.await.expect("all end");
    assert_eq!(first, again);
    let reader = store::Reader::open(&folder.join("past")).expect("can be read");
    let tags = reader.tags().expect("can be read");
    let places = tags.iter().filter(|tag| tag.name.tag == "pv").map(|tag| tag.name.source.as_str());
    let places: std::collections::BTreeSet<&str> = places.collect();
    assert_eq!(places.len(), 2, "PV by its path, and by its node: {places:?}");
    let needed = |report: &[u8]| String::from_utf8_lossy(report).matches("600 needed").count();
    assert_eq!((needed(&first), needed(&other)), (0, 4), "{}", String::from_utf8_lossy(&other));
    let report: serde_json::Value = serde_json::from_slice(&first).expect("JSON");
    assert_eq!(report["items"].as_array().map(Vec::len), Some(4), "{report}");
    std::fs::remove_dir_all(&folder).expect("it was made");
}

/// History of before the first start, and of the time between two of them: one line without a gap.
#[tokio::test(flavor = "multi_thread")]
async fn at_its_start_the_daemon_reads_back_to_what_it_has() {
    let mut server = Historian::start().await;
    let folder = folder("start");
    std::fs::create_dir_all(&folder).expect("writable");
    let file = folder.join("plant.toml");
    let more = "backfill_s = 60.0\nsampling_ms = 20\npublishing_ms = 50\nqueue_size = 100\n";
    std::fs::write(&file, plant(server.port, more)).expect("writable");
    let mut own = stictiond::config::load(&file).expect("sound");
    own.store = Some(store::Config { sync_ms: 20, ..store::Config::new(folder.join("store")) });
    let mut begun = f64::NAN;
    let mut newest = f64::NEG_INFINITY;
    for _ in 0..2 {
        let daemon = start(own.clone(), Clock::wall(), sticky()).await;
        begun = begun.min(wall());
        let came = Instant::now();
        loop {
            let samples = daemon.json("/api/v1/loops/A/samples?points=5").await;
            let last = samples["tags"][1]["time"].as_array().and_then(|times| times.last().cloned());
            let last = last.as_ref().and_then(|t| t.as_str()).and_then(stictiond::serve::dto::parse_time);
            // Live values have come when the newest is of after this start.
            if let Some(last) = last.filter(|last| *last > newest.max(begun)) {
                newest = last;
                break;
            }
            assert!(came.elapsed() < PATIENCE, "{samples}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        stop(daemon).await;
        newest = newest.max(wall());
        // Three seconds of values that nobody listens to would show.
        server.kept(150).await;
    }
    let mut reader = store::Reader::open(&folder.join("store")).expect("can be read");
    let kept = reader.between("A", "pv", 0.0, 1e10).expect("can be read");
    assert!((59.0..=61.0).contains(&(begun - kept[0].t)), "from {} s before the start on", begun - kept[0].t);
    let holes: Vec<f64> = kept
        .windows(2)
        .filter(|pair| pair[1].value - pair[0].value != 1.0)
        .map(|pair| pair[1].t - pair[0].t)
        .collect();
    // The archive of asyncua runs up to half a second behind its live values: a hole at either start, no longer than that
    // on a busy machine. Without history the second start would leave one of the time that nobody ran.
    assert!(
        holes.len() <= 2 && holes.iter().all(|hole| (0.0..1.5).contains(hole)),
        "{} samples: {holes:?}",
        kept.len()
    );
    assert!(kept.len() > 2900, "a sample each 20 ms: {}", kept.len());
    std::fs::remove_dir_all(&folder).expect("it was made");
}

/// A table in the folder of `[tables]`: it is read as the command line reads it, and nothing outside the folder is.
#[tokio::test(flavor = "multi_thread")]
async fn a_table_is_diagnosed_in_place_of_the_store() {
    let (folder, (address, _)) = (folder("table"), device().await);
    std::fs::create_dir_all(&folder).expect("writable");
    let rows = |format: fn(u32) -> String| (0..7200u32).map(format).collect::<String>();
    let table = rows(|i| {
        let op = if i >= 3600 { "10,0" } else { "20,0" };
        format!("01/06/2026 {:02}:{:02}:{:02};{op};{},5\n", 6 + i / 3600, i / 60 % 60, i % 60, i % 100)
    });
    std::fs::write(folder.join("week.csv"), format!("Zeit;A.OP;A.PV\n{table}")).expect("writable");
    std::os::unix::fs::symlink("/etc/hostname", folder.join("link.csv")).expect("writable");
    let mut own = config(&[address], &[("A", 0, 20)]);
    own.tables.folder = Some(folder.clone());
    let daemon = start(own, Clock::plant(START, 20.0), sticky()).await;
    for (file, table, said) in [
        ("../week.csv", "{}", "is no name of a file in the folder"),
        ("/etc/hostname", "{}", "is no name of a file in the folder"),
        ("link.csv", "{}", "there is no file"),
        ("gone.csv", "{}", "there is no file"),
        ("week.csv", "{\"colour\": \"red\"}", "no option is called"),
        ("week.csv", "{\"tz\": \"Mars\"}", "--tz"),
    ] {
        let body = format!("{{\"loop\":\"A\",\"file\":\"{file}\",\"table\":{table}}}");
        let answer = post(daemon.address, BACKFILL, &body).await;
        assert_eq!(answer.status, 400, "{body}: {}", answer.text());
        assert!(answer.text().contains(said), "{body}: {}", answer.text());
    }
    // What is doubtful ends the job with the option that decides.
    let mut events = Events::open(daemon.address).await;
    let doubtful = "{\"loop\":\"A\",\"file\":\"week.csv\",\"window_s\":600,\"step_s\":300}";
    assert_eq!(post(daemon.address, BACKFILL, doubtful).await.status, 202);
    until(&mut events, "failed").await;
    let job = daemon.json(BACKFILL).await;
    assert!(job["error"].as_str().is_some_and(|why| why.contains("--time-format dmy or mdy")), "{job}");
    let told = "{\"loop\":\"A\",\"file\":\"week.csv\",\"window_s\":600,\"step_s\":300,\"table\":{\"time_format\":\"dmy\"}}";
    assert_eq!(post(daemon.address, BACKFILL, told).await.status, 202);
    until(&mut events, "done").await;
    let report = daemon.json(BACKFILL).await["report"].clone();
    let read_as = report["read_as"].as_str().expect("a line");
    assert!(read_as.contains("decimal comma, time dd/mm/yyyy (UTC), op from \"A.OP\""), "{read_as}");
    let items = report["items"].as_array().expect("windows");
    let sticky = items.iter().filter(|item| item["verdict"] == "stiction").count();
    assert!(sticky >= 10 && sticky < items.len(), "{report}");
    stop(daemon).await;
    std::fs::remove_dir_all(&folder).expect("it was made");
}

/// A file whose OP is in another unit than that of the loop: f would be told a hundred times, or six times, too small.
#[tokio::test(flavor = "multi_thread")]
async fn a_file_whose_op_is_not_in_the_configured_unit_fails_with_what_contradicts() {
    let (folder, (address, _)) = (folder("units"), device().await);
    std::fs::create_dir_all(&folder).expect("writable");
    let mut own = config(&[address], &[("A", 0, 20)]);
    own.tables.folder = Some(folder.clone());
    let daemon = start(own, Clock::plant(START, 20.0), sticky()).await;
    let mut events = Events::open(daemon.address).await;
    for (name, header, scale, offset, said) in [
        (
            "share.csv",
            "OP",
            0.01,
            0.0,
            Some("its values look like a span of 1, and the configuration tells a span of 100"),
        ),
        ("milli.csv", "OP [mA]", 0.16, 4.0, Some("op_span = 100 contradicts OP's unit \"mA\"")),
        ("percent.csv", "OP [%]", 1.0, 0.0, None),
    ] {
        let row = |i: u32| {
            let op = offset + scale * (50.0 + f64::from(i % 11));
            format!("2026-06-01 06:{:02}:{:02},{op:.4},{}\n", i / 60, i % 60, i % 100)
        };
        let rows: String = (0..1800).map(row).collect();
        std::fs::write(folder.join(name), format!("t,{header},PV\n{rows}")).expect("writable");
        let body = format!("{{\"loop\":\"A\",\"file\":\"{name}\",\"window_s\":600,\"step_s\":300}}");
        assert_eq!(post(daemon.address, BACKFILL, &body).await.status, 202, "{name}");
        until(&mut events, if said.is_some() { "failed" } else { "done" }).await;
        let job = daemon.json(BACKFILL).await;
        match said {
            Some(said) => {
                assert!(job["error"].as_str().is_some_and(|why| why.contains(said)), "{name}: {job}");
            }
            None => {
                assert!(job["report"]["items"].as_array().is_some_and(|items| !items.is_empty()), "{job}")
            }
        }
    }
    stop(daemon).await;
    std::fs::remove_dir_all(&folder).expect("it was made");
}
