//! The whole daemon with an audit log that was changed while it was away: it watches the plant, says so, and changes nothing until
//! somebody decides.

use crate::app::{Daemon, config, device, heard, start_at};
use crate::http::{Answer, Events, get, post};
use crate::rig::{START, assert_problem};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use stictiond::audit::{self, AuditError, Bounds, Log};
use stictiond::schedule::Clock;

/// Longest wait for anything; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(20);
const NOW: &str = "2026-01-01T00:00:00Z";

/// A log of several files, one bit of an old one of which is another; that file.
fn rotten(log: &Path) -> PathBuf {
    let mut writing = Log::open(log, Bounds { max_bytes: 1000, keep_files: 3 }, NOW).expect("opens");
    for n in 0..50 {
        writing.append(NOW, "change", &[("n", n.to_string())]).expect("written");
    }
    writing.sync().expect("written");
    let old = log.with_file_name("audit.log.3");
    let mut bytes = fs::read(&old).expect("there");
    let at = bytes.windows(8).position(|part| part == b" change ").expect("an entry");
    bytes[at + 1] ^= 1;
    fs::write(&old, bytes).expect("written");
    old
}

/// Every file of a folder, by its name.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let paths = fs::read_dir(folder).expect("there").map(|entry| entry.expect("read").path());
    let mut files: Vec<_> = paths.map(|path| (path.clone(), fs::read(path).expect("read"))).collect();
    files.sort();
    files
}

/// Stops a daemon, and waits until nothing of it has the log any more.
async fn stop(daemon: Daemon, log: &Path) {
    let Daemon { app, task, .. } = daemon;
    app.stop().cancel();
    let ended = tokio::time::timeout(PATIENCE, task).await;
    ended.expect("ends in time").expect("no panic").expect("ends well");
    drop(app);
    let began = Instant::now();
    while let Err(AuditError::InUse(_)) = Log::open(log, Bounds { max_bytes: 1 << 20, keep_files: 3 }, NOW) {
        assert!(began.elapsed() < PATIENCE, "it still has the log");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn acknowledged(daemon: &Daemon) -> Answer {
    post(daemon.address, "/api/v1/alarms/A/ack", "{\"by\":\"eve\"}").await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flipped_bit_in_an_old_audit_log_stops_changes_and_not_the_daemon() {
    let (address, _) = device().await;
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("audit-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("writable");
    let log = folder.join("audit.log");
    let old = rotten(&log).display().to_string();
    let before = files(&folder);
    let mut own = config(&[address], &[("A", 0, 10)]);
    own.audit = Some(audit::Config { file: log.clone(), max_bytes: 10_000, keep_files: 20 });

    for later in [0.0, 1000.0] {
        let daemon = start_at(own.clone(), Clock::plant(START + later, 20.0)).await;
        // Monitoring goes on.
        let mut events = Events::open(daemon.address).await;
        heard(&mut events, "alarm", "A").await;
        heard(&mut events, "diagnosis", "A").await;
        // It is told.
        let health = daemon.json("/healthz").await;
        assert_eq!((&health["status"], &health["audit"]["state"]), (&"ok".into(), &"failing".into()));
        assert_eq!(health["audit"]["damaged"], true);
        let remedy = format!("`stictiond audit renew {}`", log.display());
        for part in [old.as_str(), "changed: its hash is another", &remedy] {
            assert!(health["audit"]["reason"].as_str().is_some_and(|why| why.contains(part)), "{health}");
        }
        let metrics = get(daemon.address, "/metrics").await.text();
        assert!(metrics.contains("stictiond_audit_working 0.0\n"), "{metrics}");
        // Nothing is changed, also after a reload.
        for _ in 0..2 {
            let problem = assert_problem(&acknowledged(&daemon).await, 503);
            assert_eq!(problem["type"], "urn:stictiond:problem:audit_failed");
            assert_eq!(problem["damaged"], true);
            let detail = problem["detail"].as_str().expect("text");
            assert!(detail.contains(&old) && detail.contains(&remedy), "{detail}");
            assert_eq!(daemon.json("/api/v1/loops/A").await["alarm"], "unacknowledged");
            daemon.app.reload(own.clone()).await.expect("a sound configuration");
        }
        drop(events);
        stop(daemon, &log).await;
        assert!(files(&folder) == before, "the log stays as it was found");
    }

    let renewed = audit::renew(&log, NOW).expect("renewed").expect("it was damaged");
    assert!(renewed.damage.to_string().contains(&old), "{}", renewed.damage);
    let daemon = start_at(own, Clock::plant(START + 2000.0, 20.0)).await;
    let mut events = Events::open(daemon.address).await;
    heard(&mut events, "alarm", "A").await;
    assert_eq!(acknowledged(&daemon).await.status, 200);
    let health = daemon.json("/healthz").await;
    assert_eq!((&health["audit"]["state"], &health["audit"]["damaged"]), (&"working".into(), &false.into()));
    assert!(health["audit"]["reason"].is_null(), "{health}");
    assert!(get(daemon.address, "/metrics").await.text().contains("stictiond_audit_working 1.0\n"));
    let entries = daemon.json("/api/v1/audit").await;
    let items = entries["items"].as_array().expect("a list");
    let kinds: Vec<&str> = items.iter().filter_map(|own| own["event"].as_str()).collect();
    assert_eq!(kinds, ["change", "renewed"], "newest first");
    drop(events);
    stop(daemon, &log).await;
    fs::remove_dir_all(&folder).expect("ours");
}
