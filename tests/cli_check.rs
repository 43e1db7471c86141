//! `stictiond check` of what `run` needs beside the configuration, and commands on a file of users that is not there.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use stictiond::audit::{Bounds, Log};

/// Exit code, stdout and stderr.
fn stictiond(args: &[&str]) -> (Option<i32>, String, String) {
    let command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    let Output { status, stdout, stderr } = { command }.args(args).output().expect("the binary starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    (status.code(), text(stdout), text(stderr))
}

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("writable");
    path
}

const LOOP: &str = "[[modbus]]\nname = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0\npoll_ms = 1000\n\
                    [[loop]]\nid = 'A'\nop_span = 100.0\n\
                    [loop.op]\ndevice = 'd'\nregister = 'input'\naddress = 0\ntype = 'f32'\n\
                    [loop.pv]\ndevice = 'd'\nregister = 'input'\naddress = 2\ntype = 'f32'\n";

/// What `check` says of a configuration.
fn check(folder: &Path, text: &str) -> (Option<i32>, String, String) {
    let path = folder.join("plant.toml");
    fs::write(&path, text).expect("writable");
    stictiond(&["check", "--config", path.to_str().expect("text")])
}

#[test]
fn an_audit_log_that_run_cannot_go_on_with_is_told() {
    let folder = folder("check-audit");
    let file = folder.join("audit.log");
    let told = |file: &Path| check(&folder, &format!("[audit]\nfile = {file:?}\n{LOOP}"));
    let good = |when: &str| {
        let (code, out, err) = told(&file);
        assert_eq!((code, err.as_str()), (Some(0), ""), "{when}: {out}");
    };
    good("before there is one");
    assert!(!file.exists() && !folder.join("audit.log.head").exists(), "nothing is left behind");
    let now = "2026-01-01T00:00:00Z";
    let mut log = Log::open(&file, Bounds { max_bytes: 1 << 20, keep_files: 1 }, now).expect("opens");
    log.append(now, "access", &[("what", "a change".to_string())]).expect("writes");
    log.sync().expect("writes");
    good("while it is written");
    drop(log);
    let whole = fs::read_to_string(&file).expect("there");
    // A crash cuts the last line off, and the next start takes it out.
    fs::write(&file, format!("{whole}3 2026")).expect("writable");
    good("after a crash");
    assert!(fs::read_to_string(&file).expect("there").ends_with("3 2026"), "nothing is changed");

    // One that was changed is told aloud. It stops changes, and not the daemon, which a service starts only after this.
    let damaged = |out: &str, what: &str| {
        assert!(out.contains("run will start with it and refuse changes"), "{out}");
        assert!(out.contains("DAMAGED  [audit] file: ") && out.contains(what), "{out}");
    };
    fs::write(&file, whole.replace("a change", "a chance")).expect("writable");
    let (code, out, err) = told(&file);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    damaged(&out, "line 2: changed");
    let name = file.to_str().expect("text");
    let (code, _, err) = stictiond(&["audit", "verify", name]);
    assert!(code == Some(1) && err.contains("line 2: changed"), "{err}");
    fs::remove_file(&file).expect("there");
    damaged(&told(&file).1, "entries 1 to 2 were written and are no longer there");
    fs::write(&file, whole.replace("a change", "a chance")).expect("writable");

    let (code, out, err) = stictiond(&["audit", "renew", name]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    assert!(out.contains("line 2: changed") && out.contains("audit.log.damaged-1"), "{out}");
    good("once there is a new log");
    let begun = fs::read_to_string(&file).expect("there");
    assert!(begun.lines().nth(1).is_some_and(|line| line.contains(" renewed damage=")), "{begun}");
    assert_eq!(stictiond(&["audit", "verify", name]).0, Some(0));
    for (name, why) in [(name, "it is good, and stays"), ("Cargo.toml", "there is no audit log of this name")]
    {
        let (code, _, err) = stictiond(&["audit", "renew", name]);
        assert!(code == Some(2) && err.contains(why), "{err}");
    }
    assert_eq!(fs::read_to_string(&file).expect("there"), begun);
    // There no file can be made, whoever asks.
    let (code, _, err) = told(Path::new("/proc/audit.log"));
    assert!(code == Some(2) && err.contains("cannot be written by the user that runs check"), "{err}");
    // `check` and `run` name the folder and what helps; systems differ in why they refuse a file there.
    let told_of_sys = format!("[server]\nlisten = '127.0.0.1:0'\n[audit]\nfile = '/sys/audit.log'\n{LOOP}");
    let (code, _, err) = check(&folder, &told_of_sys);
    assert!(code == Some(2) && err.contains("the folder /sys ") && err.contains("name a log in"), "{err}");
    let path = folder.join("plant.toml");
    let (code, _, err) = stictiond(&["run", "--config", path.to_str().expect("text")]);
    let last = err.lines().last().unwrap_or_default();
    assert!(code == Some(1) && last.contains("the folder /sys ") && last.contains("name a log in"), "{err}");
    let left = fs::read_dir(&folder).expect("there").flatten().map(|entry| entry.file_name());
    assert!(left.into_iter().all(|name| !name.to_string_lossy().contains("stictiond-check")));
    fs::remove_dir_all(&folder).expect("ours");
}

#[test]
fn a_part_of_a_fleet_is_good_for_those_that_would_start_with_it() {
    let folder = folder("check-fleet");
    let fleet = |more: &str| format!("[fleet]\nservers = ['nats://127.0.0.1:4222']\n{more}");
    let store = format!("[store]\nfolder = {:?}\n", folder.join("store"));
    let edge = format!("{}{store}{LOOP}", fleet("site = 'north'\n"));
    for (text, parts) in
        [(edge, "edge"), (fleet(""), "worker"), (format!("{}{store}", fleet("")), "worker and centre")]
    {
        let (code, out, err) = check(&folder, &text);
        assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
        assert!(out.contains(&format!("plant.toml: good for {parts}\n")) && !out.contains("inf"), "{out}");
    }
    let (code, out, err) = check(&folder, &format!("{}{LOOP}", fleet("")));
    assert!(code == Some(2) && out.contains("fleet    for no part of a fleet"), "{out}");
    for why in
        ["[fleet] site: an edge needs one", "a worker has no loops", "a centre has the loops of the edges"]
    {
        assert!(err.contains(why), "{err}");
    }
    fs::remove_dir_all(&folder).expect("ours");
}

#[test]
fn what_will_fail_later_is_remarked() {
    let folder = folder("check-later");
    let text = format!(
        "[store]\nfolder = {:?}\nmax_mb = 16\nsamples_days = 700\n\
         [[notify.webhook]]\nname = 'cmms'\nurl = 'https://h/x'\nsecret_env = 'STICTIOND_TEST_UNSET'\n\
         [[notify.smtp]]\nname = 'fitters'\naddress = 'mail:587'\nfrom = 'a@b.c'\nto = ['d@b.c']\n\
         user = 'u'\npassword_env = 'PATH'\n{LOOP}",
        folder.join("store")
    );
    let (code, out, err) = check(&folder, &text);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    for remark in [
        "remark   cmms: secret_env = \"STICTIOND_TEST_UNSET\" is not set here; it must be where stictiond starts\n",
        "remark   [store] max_mb = 16 holds about ",
    ] {
        assert!(out.contains(remark), "{remark}: {out}");
    }
    assert!(!out.contains("PATH"), "{out}");
    fs::remove_dir_all(&folder).expect("ours");
}

#[test]
fn a_file_of_users_that_is_not_there_is_told_and_none_is_made() {
    let folder = folder("check-users");
    let file = folder.join("access.json");
    let path = file.to_str().expect("text");
    for args in [
        &["user", "list"][..],
        &["user", "passwd", "m.keller"],
        &["user", "roles", "m.keller", "--role", "viewer"],
        &["user", "remove", "m.keller"],
        &["token", "list"],
        &["token", "rotate", "prometheus"],
        &["token", "revoke", "prometheus"],
    ] {
        let (code, out, err) = stictiond(&[args, &["--access-file", path]].concat());
        assert_eq!((code, out.as_str(), err.lines().count()), (Some(2), "", 1), "{args:?}: {err}");
        assert!(err.starts_with(&format!("stictiond: {path}: is not there")), "{args:?}: {err}");
        assert_eq!(fs::read_dir(&folder).expect("there").count(), 0, "{args:?} leaves something behind");
    }
    let create = ["token", "create", "prometheus", "--role", "viewer", "--access-file", path];
    assert_eq!(stictiond(&create).0, Some(0), "the first one makes it");
    assert_eq!(stictiond(&["token", "list", "--access-file", path]).0, Some(0));
    fs::remove_dir_all(&folder).expect("ours");
}
