//! `stictiond run` as an operating system meets it: signals, exit codes, the log.

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::time::Duration;

/// A configuration that listens on `listen` and polls a port where nobody answers.
fn config(name: &str, listen: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let text = format!(
        "[server]\nlisten = '{listen}'\n[[modbus]]\nname = 'd'\naddress = '127.0.0.1:9'\naddress_base = 0\n\
         [[loop]]\nid = 'A'\n[loop.op]\ndevice = 'd'\nregister = 'input'\naddress = 0\ntype = 'f32'\n\
         [loop.pv]\ndevice = 'd'\nregister = 'input'\naddress = 2\ntype = 'f32'\n"
    );
    fs::write(&path, text).expect("the test directory is writable");
    path
}

fn run(path: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    command.args(["run", "--log-format", "json", "--config"]).arg(path).env_remove("RUST_LOG");
    command.stderr(Stdio::piped()).stdout(Stdio::piped());
    command
}

/// Reads the log up to the line that says `what`; every line before it is JSON too.
fn wait_for(log: &mut BufReader<ChildStderr>, what: &str) -> serde_json::Value {
    let mut line = String::new();
    loop {
        line.clear();
        let read = log.read_line(&mut line).expect("a log of text");
        assert!(read > 0, "the log ended before it said {what:?}");
        let entry: serde_json::Value = serde_json::from_str(&line).expect("a log of JSON");
        if entry["message"].as_str().is_some_and(|message| message.contains(what)) {
            return entry;
        }
    }
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill").args([name, &child.id().to_string()]).status();
    assert!(sent.expect("kill is there").success());
}

#[test]
fn serves_until_told_to_stop_and_refuses_a_bad_reload() {
    let path = config("run.toml", "127.0.0.1:0");
    let mut child = run(&path).spawn().unwrap();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    wait_for(&mut log, "serving");
    fs::write(&path, "[server]\nlisten = 1\n").unwrap();
    signal(&child, "-HUP");
    // One entry for each of the two errors, in the order of the file.
    for error in ["run.toml:1:1: no [[loop]]", "run.toml:2:10: listen: "] {
        let refused = wait_for(&mut log, "the configuration is refused");
        assert_eq!(refused["level"], "ERROR");
        assert!(refused["error"].as_str().unwrap().contains(error), "{refused}");
    }
    signal(&child, "-TERM");
    wait_for(&mut log, "stopping");
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

#[test]
fn a_bad_configuration_ends_with_2_and_a_taken_address_with_1() {
    let bad = config("run_bad.toml", "here");
    let output = run(&bad).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert_eq!(
        stderr,
        format!(
            "{}:2:10: listen: not an address in numbers and a port, such as 127.0.0.1:8080 for this machine alone or 0.0.0.0:8080 for all\n",
            bad.display()
        )
    );

    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let output = run(&config("run_taken.toml", &address)).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let last = stderr.lines().last().unwrap();
    assert!(last.starts_with(&format!("stictiond: cannot listen on {address}: ")), "{stderr}");
}

#[test]
fn a_log_filter_that_is_none_is_refused() {
    let path = config("run_filter.toml", "127.0.0.1:0");
    let output = run(&path).env("RUST_LOG", "stictiond=loud").output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!((output.status.code(), stderr.lines().count()), (Some(2), 1), "{stderr}");
    assert!(stderr.starts_with("stictiond: RUST_LOG=\"stictiond=loud\": "), "{stderr}");
}

/// As a container file sets a variable that it has no value for.
#[test]
fn a_log_filter_that_is_empty_is_as_none() {
    let log = Path::new(env!("CARGO_TARGET_TMPDIR")).join("run_empty_filter.log");
    let path = config("run_empty_filter.toml", "127.0.0.1:0");
    for empty in ["", " "] {
        let stderr = fs::File::create(&log).expect("the test directory is writable");
        let mut child = run(&path).env("RUST_LOG", empty).stderr(stderr).spawn().unwrap();
        let serves = (0..600).any(|_| {
            let said = fs::read_to_string(&log).unwrap().contains("serving");
            if !said {
                std::thread::sleep(Duration::from_millis(50));
            }
            said
        });
        signal(&child, "-TERM");
        assert_eq!(child.wait().unwrap().code(), Some(0));
        assert!(serves, "{empty:?}: {}", fs::read_to_string(&log).unwrap());
    }
}

/// A daemon that has refused a file goes on with the one before, and whoever watches its health must not end it for that.
#[test]
fn a_file_that_a_daemon_has_refused_does_not_count_against_its_health() {
    let path = config("health_refused.toml", "127.0.0.1:0");
    let health = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
        let output = command.args(["health", "--config"]).arg(&path).args(more).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let mut child = run(&path).spawn().unwrap();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    let address = wait_for(&mut log, "serving")["address"].as_str().unwrap().to_string();
    let text = fs::read_to_string(&path).unwrap().replace("127.0.0.1:0", &address);
    fs::write(&path, text + "[[loop]]\nid = FIC101\n").unwrap();
    signal(&child, "-HUP");
    wait_for(&mut log, "the configuration is refused");
    assert_eq!(health(&[]), (Some(0), String::new()));
    // A file that does not even say where the daemon listens, or is not there: its address is told.
    let refused = fs::read_to_string(&path).unwrap();
    for broken in ["[server]\nlisten = 1\n", "[server]\nlis"] {
        fs::write(&path, broken).unwrap();
        assert_eq!(health(&[&address]), (Some(0), String::new()), "{broken}");
    }
    fs::remove_file(&path).unwrap();
    assert_eq!(health(&[&address]), (Some(0), String::new()));
    fs::write(&path, refused).unwrap();
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    // Where none answers the file may be why.
    let (code, why) = health(&[]);
    assert!(code == Some(2) && why.contains("write id = \"FIC101\""), "{why}");
}

/// A daemon listens where it did at its start, whatever its file says by now.
#[test]
fn health_says_that_a_file_may_be_newer_than_the_daemon() {
    let path = config("health_newer.toml", "127.0.0.1:0");
    let file = path.display().to_string();
    let health = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
        let output = command.args(["health", "--config", &file]).args(more).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let mut child = run(&path).spawn().unwrap();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    let address = wait_for(&mut log, "serving")["address"].as_str().unwrap().to_string();
    // Nobody listens there.
    let text = fs::read_to_string(&path).unwrap().replace("127.0.0.1:0", "127.0.0.1:9");
    fs::write(&path, &text).unwrap();
    signal(&child, "-HUP");
    wait_for(&mut log, "[server] has changed");
    let newer = format!("[server] of {file} has this address, but a running daemon keeps the one");
    let (code, why) = health(&[]);
    assert_eq!((code, why.lines().count()), (Some(1), 1), "{why}");
    assert!(why.starts_with("stictiond: 127.0.0.1:9: ") && why.contains(&newer), "{why}");
    assert_eq!(health(&[&address]), (Some(0), String::new()));
    // A file that is wrong elsewhere has an address all the same.
    fs::write(&path, text + "[[loop]]\nid = FIC101\n").unwrap();
    let (code, why) = health(&[]);
    assert_eq!(code, Some(2), "{why}");
    let last = why.lines().last().unwrap();
    assert!(last.contains("no daemon answers at 127.0.0.1:9: ") && last.contains(&newer), "{why}");
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

/// Two daemons would write the same registers, and the same audit log.
#[test]
fn a_demo_that_writes_makes_no_configuration_for_another_daemon() {
    let to = Path::new(env!("CARGO_TARGET_TMPDIR")).join("demo_writes.toml");
    let mut demo = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    // It would not begin at this speed.
    let output = demo.args(["demo", "--writeback", "--speed", "0", "--config-to"]).arg(&to).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && stderr.contains("cannot be used with"), "{stderr}");
    assert!(!to.exists());
}

#[test]
fn health_says_whether_a_daemon_answers() {
    let health = |address: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
        command.args(["health", address]).output().unwrap()
    };
    let mut child = run(&config("health.toml", "127.0.0.1:0")).spawn().unwrap();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    let address = wait_for(&mut log, "serving")["address"].as_str().unwrap().to_string();
    let by_name = address.replace("127.0.0.1", "localhost");
    assert_eq!(health(&by_name).status.code(), Some(0), "{by_name}");
    let output = health(&address);
    assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(0), b"ok\n".as_slice()));
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(0));

    let gone = health(&address);
    let stderr = String::from_utf8(gone.stderr).unwrap();
    assert_eq!((gone.status.code(), stderr.lines().count()), (Some(1), 1), "{stderr}");
    assert!(stderr.starts_with(&format!("stictiond: {address}: ")), "{stderr}");
    assert_eq!(health("here").status.code(), Some(2));

    let mut asking = Command::new(env!("CARGO_BIN_EXE_stictiond"));
    let output = asking.args(["health", "--ca-file", "nope", "127.0.0.1:1"]).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert_eq!(stderr, "stictiond: nope: no PEM file with a certificate\n");
}

/// Certificate and key for localhost and 127.0.0.1, in files named so.
fn certificate(name: &str) -> (String, String) {
    let made = rcgen::generate_simple_self_signed(["localhost".to_string(), "127.0.0.1".to_string()]);
    let made = made.expect("a certificate");
    let file = |kind: &str, text: String| {
        let path = format!("{}/{name}.{kind}", env!("CARGO_TARGET_TMPDIR"));
        std::fs::write(&path, text).expect("written");
        path
    };
    (file("pem", made.cert.pem()), file("key", made.signing_key.serialize_pem()))
}

#[test]
fn health_asks_a_daemon_behind_tls() {
    let ((own, own_key), (other, other_key)) = (certificate("health_own"), certificate("health_other"));
    let run_with = |name: &str, more: &str| {
        let path = config(name, "127.0.0.1:0");
        let text = std::fs::read_to_string(&path).unwrap();
        let tls = format!("[server.tls]\ncert_file = '{own}'\nkey_file = '{own_key}'\n{more}");
        std::fs::write(&path, text + &tls).unwrap();
        let mut child = run(&path).spawn().unwrap();
        let mut log = BufReader::new(child.stderr.take().unwrap());
        let address = wait_for(&mut log, "serving")["address"].as_str().unwrap().to_string();
        (child, path.display().to_string(), address)
    };
    let health = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stictiond"));
        let output = command.arg("health").args(args).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (mut child, file, address) = run_with("health_tls.toml", "");
    assert_eq!(health(&["--config", &file, &address]), (Some(0), String::new()));
    assert_eq!(health(&["--ca-file", &own, &address]), (Some(0), String::new()));
    // In the clear nothing is answered, and nobody vouches for the other certificate.
    assert_eq!(health(&[&address]).0, Some(1));
    let (code, why) = health(&["--ca-file", &other, &address]);
    assert!(code == Some(1) && why.contains("certificate") && why.lines().count() == 1, "{why}");
    let (code, why) = health(&["--ca-file", &own_key, &address]);
    assert!(code == Some(2) && why.contains("no PEM file with a certificate"), "{why}");
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let (mut child, file, address) = run_with("health_mtls.toml", &format!("client_ca_file = '{other}'\n"));
    let shown = ["--cert-file", &other, "--key-file", &other_key];
    assert_eq!(health(&[&["--config", &file, &address], &shown[..]].concat()), (Some(0), String::new()));
    assert_eq!(health(&["--config", &file, &address]).0, Some(1), "a certificate is asked for");
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(0));
}
