//! `stictiond check` and `stictiond probe` as a user meets them: exit codes and what is printed where.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output};

fn stictiond(args: &[&str]) -> (Option<i32>, String, String) {
    let Output { status, stdout, stderr } =
        Command::new(env!("CARGO_BIN_EXE_stictiond")).args(args).output().expect("the binary starts");
    let (stdout, stderr) =
        (String::from_utf8_lossy(&stdout).into_owned(), String::from_utf8_lossy(&stderr).into_owned());
    assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
    (status.code(), stdout, stderr)
}

#[test]
fn a_good_file_is_summed_up() {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/stictiond.toml");
    let example = example.to_str().unwrap();
    let (code, stdout, stderr) = stictiond(&["check", "--config", example]);
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    let expected = format!(
        "{example}: good\n\
         loops    2, diagnosed every 1800 s to 3600 s\n\
         devices  2, 4 requests a round\n         \
         dcs1: 127.0.0.1:5020 unit 1, 5 tags in 2 requests every 1000 ms\n         \
         boiler plc: localhost:5021 unit 3, 4 tags in 2 requests every 5000 ms\n\
         memory   0.4 MB for 9 tags, 4096 samples each; 0.7 MB if their values are not 32-bit floats\n\
         listen   127.0.0.1:8080\n\
         access   everybody on this machine may read and do everything: there is no log-in\n"
    );
    assert_eq!(stdout, expected);
}

#[test]
fn every_error_is_a_line_with_its_place() {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("broken.toml");
    fs::write(&path, "[alarm]\nkk = 2\nn = 'x'\n[server]\nlisten = '0.0.0.0:80'\n").unwrap();
    let path = path.to_str().unwrap();
    let (code, stdout, stderr) = stictiond(&["check", "--config", path]);
    assert_eq!((code, stdout.as_str()), (Some(2), ""));
    let lines: Vec<&str> = stderr.lines().collect();
    assert_eq!(lines.len(), 4, "{stderr}");
    assert!(lines[0].starts_with(&format!("{path}:1:1: no [[loop]]")), "{stderr}");
    assert_eq!(lines[1], format!("{path}:2:1: unknown key \"kk\" in [alarm], did you mean \"k\"?"));
    assert!(lines[2].starts_with(&format!("{path}:3:5: n: ")), "{stderr}");
    assert!(lines[3].starts_with(&format!("{path}:5:10: listen: 0.0.0.0:80 is not loopback")), "{stderr}");
}

#[test]
fn a_file_that_is_not_there() {
    let (code, _, stderr) = stictiond(&["check", "--config", "none/such.toml"]);
    assert_eq!(code, Some(2));
    assert_eq!(
        stderr,
        "none/such.toml: cannot read: No such file: look at the path and at the folder it is read from\n"
    );
    assert_eq!(stictiond(&["check"]).0, Some(2));
}

#[test]
fn probe_shows_what_the_device_answers() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let device = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut request = [0; 12];
        stream.read_exact(&mut request).unwrap();
        // Unit 7, function 3, from 100 on the wire, two registers.
        assert_eq!(request[6..], [7, 3, 0, 100, 0, 2]);
        // 2.5 as an f32 in ABCD.
        let answer = [request[0], request[1], 0, 0, 0, 7, 7, 3, 4, 0x40, 0x20, 0, 0];
        stream.write_all(&answer).unwrap();
    });
    let args = ["probe", &address, "--unit-id", "7", "--start", "101", "--count", "2", "--address-base", "1"];
    let (code, stdout, stderr) = stictiond(&args);
    device.join().unwrap();
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    assert!(stdout.contains("2.5") && stdout.contains("101"), "{stdout}");
}

#[test]
fn probe_fails_in_one_line() {
    // Bound and dropped: nobody listens there.
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let (code, stdout, stderr) = stictiond(&["probe", &closed, "--start", "0"]);
    assert_eq!((code, stdout.as_str(), stderr.lines().count()), (Some(1), "", 1), "{stderr}");
    assert!(stderr.contains(&closed), "{stderr}");
    for arguments in [
        &["--start", "0", "--count", "126"][..],
        &["--start", "0", "--count", "0"],
        &["--start", "65535", "--count", "2"],
    ] {
        let (code, _, stderr) = stictiond(&[&["probe", &closed], arguments].concat());
        assert_eq!((code, stderr.lines().count()), (Some(2), 1), "{stderr}");
    }
    for arguments in [
        &[][..],
        &["--start", "65536"],
        &["--start", "0", "--register", "rod"],
        &["--start", "0", "--address-base", "2"],
    ] {
        assert_eq!(stictiond(&[&["probe", &closed], arguments].concat()).0, Some(2), "{arguments:?}");
    }
}

#[test]
fn probe_names_the_file_and_what_in_it_cannot_be_used() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("probe.toml");
    let path = file.display();
    let server = "[[opcua]]\nname = 's'\nurl = 'opc.tcp://localhost:4840/'\nsecurity_policy = 'None'\n";
    for (text, says) in [
        (
            server.replace("security_policy", "security_polcy"),
            format!("stictiond: {path}: [[opcua]] \"s\": unknown field `security_polcy`"),
        ),
        (server.replace("'s'", "s"), format!("{path}:2:8: a text stands in quotes: write name = \"s\"\n")),
        (
            server.replace("'s'", "'t'"),
            format!("stictiond: {path}: no [[opcua]] or [[mqtt]] is called \"s\""),
        ),
    ] {
        fs::write(&file, text).unwrap();
        let (code, stdout, stderr) = stictiond(&["probe", "--config", file.to_str().unwrap(), "s"]);
        assert_eq!((code, stdout.as_str()), (Some(2), ""), "{stderr}");
        assert!(stderr.starts_with(&says), "{stderr}");
    }
    let missing = file.with_extension("none");
    let (code, _, stderr) = stictiond(&["probe", "--config", missing.to_str().unwrap(), "s"]);
    assert!(code == Some(2) && stderr.contains("cannot read: No such file: look at the path"), "{stderr}");
}

#[test]
fn a_list_of_tags_becomes_loops_that_check_takes() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (list, file) = (folder.join("list.csv"), folder.join("imported.toml"));
    // As spreadsheets save it: a byte order mark, semicolons, and quotes around a cell that holds one.
    let mut rows = String::from("\u{feff}Tag;Node;Unit;Scale\r\n");
    for n in 1..=500 {
        for (role, unit) in [("OP", "%"), ("PV", "t/h")] {
            rows += &format!("Unit1/FIC{n}.{role};\"nsu=urn:plant;s=FIC{n}.{role}\";{unit};0.5\r\n");
        }
    }
    rows += "Unit1/TI7.PV;i=1;degC;1\r\n";
    fs::write(&list, rows).unwrap();
    let (code, stdout, stderr) = stictiond(&["import-tags", list.to_str().unwrap(), "--device", "dcs1"]);
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    assert!(stdout.starts_with("# 500 loops, 1 left out\n"), "{}", &stdout[..300]);
    assert!(stdout.contains("# left out: TI7: no op was found for it"), "{}", &stdout[..300]);
    let device = "[[opcua]]\nname = 'dcs1'\nurl = 'opc.tcp://localhost:4840/'\nsecurity_policy = 'None'\n";
    fs::write(&file, format!("{device}{stdout}")).unwrap();
    let (code, summed, stderr) = stictiond(&["check", "--config", file.to_str().unwrap()]);
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    assert!(summed.contains("loops    500") && summed.contains("1000 nodes"), "{summed}");
    assert!(!summed.contains("remark"), "{summed}");
    // By number they are read too, with a remark for all of them.
    fs::write(&file, format!("{device}{stdout}").replace("nsu=urn:plant;", "ns=2;")).unwrap();
    let (code, summed, _) = stictiond(&["check", "--config", file.to_str().unwrap()]);
    assert_eq!(code, Some(0));
    assert!(summed.contains("remark   dcs1: 1000 tags name the namespace by its number"), "{summed}");

    fs::write(&list, "tag,nod\nA.OP,i=1\n").unwrap();
    let (code, stdout, stderr) = stictiond(&["import-tags", list.to_str().unwrap()]);
    assert_eq!((code, stdout.as_str(), stderr.lines().count()), (Some(2), "", 1), "{stderr}");
    assert!(stderr.contains("list.csv: line 1:") && stderr.contains("'nod'"), "{stderr}");
}
