//! What can be done with the protocol itself, and with names from the plant.

use super::client::{exchange, parse, raw, request};
use super::rig::{NASTY, daemon, daemon_with};
use std::time::{Duration, Instant};
use stictiond::access::Role;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

#[tokio::test]
async fn a_path_that_climbs_out_finds_nothing() {
    let daemon = daemon("climb").await;
    let token = daemon.token(Role::Engineer);
    for path in [
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "/js/../../../../etc/passwd",
        "/js/..%2f..%2f..%2fetc%2fpasswd",
        "/..%5c..%5cetc%5cpasswd",
        "/api/v1/loops/..%2f..%2f..%2fetc%2fpasswd",
        "/api/v1/loops/..%2f..%2f..%2fetc%2fpasswd/report.html",
        "/api/v1/loops/%00",
        "/api/v1/loops/FIC1%00.html",
        "file:///etc/passwd",
        "//etc/passwd",
    ] {
        let answer = daemon.ask(&format!("GET {path}"), &[&token], "").await;
        assert!([400, 404].contains(&answer.status), "{path}: {answer:?}");
        assert!(!answer.body.contains("root:"), "{path}");
    }
}

/// A client that closes its half after asking still waits for the answer, however long that takes.
#[tokio::test]
async fn who_has_asked_and_closed_their_half_is_answered() {
    let daemon = daemon("half-closed").await;
    let token = daemon.token(Role::Viewer);
    for path in ["/healthz", "/api/v1/report.html", "/api/v1/loops", "/metrics"] {
        for n in 0..15 {
            let mut stream = TcpStream::connect(daemon.address).await.expect("connected");
            let text = request(daemon.address, &format!("GET {path}"), &[&token], "");
            stream.write_all(text.as_bytes()).await.expect("sent");
            stream.shutdown().await.expect("its half");
            let answer = parse(&exchange(stream, b"").await);
            assert_eq!(answer.status, 200, "{path}, trial {n}");
        }
    }
}

/// Two requests in one for a proxy that reads the length otherwise than the daemon: the second is never answered.
#[tokio::test]
async fn a_request_hidden_in_another_is_not_answered() {
    let daemon = daemon("smuggle").await;
    let hidden = "GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n";
    let head = "POST /api/v1/session HTTP/1.1\r\nhost: localhost\r\n";
    let chunked = format!(
        "{head}content-length: {}\r\ntransfer-encoding: chunked\r\n\r\n0\r\n\r\n{hidden}",
        5 + hidden.len()
    );
    let reversed = format!("{head}transfer-encoding: chunked\r\ncontent-length: 3\r\n\r\n0\r\n\r\n{hidden}");
    for text in [chunked, reversed] {
        let answers = raw(daemon.address, &text).await;
        assert_eq!(answers.matches("HTTP/1.1 ").count(), 1, "{answers}");
        assert!(!answers.contains("uptime_s"), "{answers}");
    }
    for lines in [
        "content-length: 5\r\ncontent-length: 6\r\n",
        "content-length: 5, 6\r\n",
        "content-length: +5\r\n",
        "content-length: -1\r\n",
        "content-length: 0x5\r\n",
        "transfer-encoding: xchunked\r\n",
        "transfer-encoding: chunked, identity\r\n",
        "transfer-encoding : chunked\r\n",
        "content-length : 5\r\n",
        "x: a\r\n content-length: 5\r\n",
        " host: y\r\n",
        "x\0: a\r\n",
    ] {
        let answers = raw(daemon.address, &format!("{head}{lines}\r\nabcde{hidden}")).await;
        let statuses: Vec<&str> = answers.split("HTTP/1.1 ").skip(1).map(|rest| &rest[..3]).collect();
        assert_eq!(statuses, ["400"], "{lines:?}: {answers}");
    }
    let broken =
        format!("{head}transfer-encoding: chunked\r\n\r\nFFFFFFFFFFFFFFFFF\r\nx\r\n0\r\n\r\n{hidden}");
    let answers = raw(daemon.address, &broken).await;
    assert!(!answers.contains("uptime_s") && answers.matches("HTTP/1.1 ").count() <= 1, "{answers}");
}

/// As many connections as there may be, each with a head that never ends.
#[tokio::test]
async fn heads_that_never_end_do_not_keep_others_out() {
    let daemon = daemon_with("slow-head", "read_timeout_s = 0.5\nmax_connections = 8", |_| {}).await;
    let mut slow = Vec::new();
    for n in 0..8 {
        let mut stream = TcpStream::connect(daemon.address).await.expect("connected");
        let begun = if n % 2 == 0 { "GET /healthz HTTP/1.1\r\nx-a: b\r\n" } else { "" };
        stream.write_all(begun.as_bytes()).await.expect("sent");
        slow.push(stream);
    }
    let began = Instant::now();
    assert_eq!(daemon.ask("GET /healthz", &[], "").await.status, 200);
    // Half a second, and time for a machine that does much else.
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
    for mut stream in slow {
        let mut rest = Vec::new();
        // Closed, by an end or a reset.
        let _ = timeout(Duration::from_secs(20), stream.read_to_end(&mut rest)).await.expect("closed");
    }
}

/// One slot for requests, and a body that comes a byte at a time.
#[tokio::test]
async fn bodies_that_never_end_take_no_place_and_are_given_up() {
    let daemon = daemon_with("slow-body", "read_timeout_s = 1.0\nmax_requests = 1", |_| {}).await;
    let token = daemon.token(Role::Operator);
    let head = format!(
        "POST /api/v1/alarms/FIC1/ack HTTP/1.1\r\nhost: localhost\r\n{token}\r\ncontent-length: 1000\r\n\r\n{{"
    );
    let mut slow = TcpStream::connect(daemon.address).await.expect("connected");
    slow.write_all(head.as_bytes()).await.expect("sent");
    assert_eq!(daemon.ask("GET /api/v1/loops", &[&token], "").await.status, 200, "meanwhile");
    let answer = parse(&exchange(slow, b"\"").await);
    assert_eq!((answer.status, answer.problem().as_str()), (408, "slow_body"));
}

#[tokio::test]
async fn a_body_of_a_gigabyte_is_refused_before_it_is_read() {
    let daemon = daemon("gigabyte").await;
    let token = daemon.token(Role::Operator);
    let ack = "POST /api/v1/alarms/FIC1/ack";
    let announced = daemon.ask(ack, &[&token, "content-length: 1073741824"], "").await;
    assert_eq!((announced.status, announced.problem().as_str()), (413, "too_large"));
    // Unannounced: pieces until the daemon has had enough.
    let head = request(daemon.address, ack, &[&token, "transfer-encoding: chunked"], "");
    let mut stream = TcpStream::connect(daemon.address).await.expect("connected");
    stream.write_all(head.as_bytes()).await.expect("sent");
    let piece = format!("{:x}\r\n{}\r\n", 65_536, "x".repeat(65_536));
    let mut sent = 0u64;
    while sent < 1 << 30 {
        match timeout(Duration::from_secs(20), stream.write_all(piece.as_bytes())).await.expect("not held up")
        {
            Ok(()) => sent += 65_536,
            Err(_) => break,
        }
    }
    // What the system buffers on both sides may be a few megabytes; the daemon takes 16 kB.
    assert!(sent < 64 << 20, "{sent} bytes were taken");
    assert_eq!(daemon.ask("GET /healthz", &[], "").await.status, 200);
}

#[tokio::test]
async fn a_head_without_end_or_measure_is_refused() {
    let daemon = daemon("head").await;
    let long = format!("x-long: {}", "y".repeat(40_000));
    assert_eq!(daemon.ask("GET /healthz", &[&long], "").await.status, 431);
    let many: Vec<String> = (0..200).map(|n| format!("x-{n}: y")).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    assert_eq!(daemon.ask("GET /healthz", &many, "").await.status, 431);
    let path = format!("GET /{}", "a".repeat(40_000));
    assert!([414, 431].contains(&daemon.ask(&path, &[], "").await.status));
}

#[tokio::test]
async fn a_name_from_the_plant_is_never_markup() {
    let daemon = daemon("markup").await;
    let token = daemon.token(Role::Viewer);
    let own = "/api/v1/loops/%3Cimg%20src%3Dx%20onerror%3Dalert(1)%3E/report.html";
    for path in ["/api/v1/report.html", own] {
        let report = daemon.ask(&format!("GET {path}"), &[&token], "").await;
        assert_eq!(report.status, 200);
        assert!(
            report.body.contains("&lt;img src=x onerror=alert(1)&gt;") && !report.body.contains("<img"),
            "{path}"
        );
        let policy = report.header("content-security-policy").expect("a policy");
        assert!(!policy.contains("unsafe") && !policy.contains("script-src"), "{policy}");
    }
    // What is no page is never shown as one, whatever is in it.
    let list = daemon.ask("GET /api/v1/loops", &[&token], "").await;
    assert!(list.body.contains(NASTY));
    assert_eq!(
        (list.header("content-type"), list.header("x-content-type-options")),
        (Some("application/json"), Some("nosniff"))
    );
    let lost = daemon.ask("GET /api/v1/loops/%3Cscript%3Ealert(1)%3C%2Fscript%3E", &[&token], "").await;
    assert_eq!((lost.status, lost.header("content-type")), (404, Some("application/problem+json")));
}
