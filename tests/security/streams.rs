//! Rights end for streams that are open as they do for requests.

use super::client::request;
use super::rig::{Daemon, book, bytes, daemon, daemon_with, now};
use std::time::Duration;
use stictiond::access::{Role, Roles};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{Instant, interval, timeout};

/// What is promised.
const PROMISED: Duration = Duration::from_secs(2);
const STREAMS: [&str; 2] = ["GET /api/v1/events", "GET /api/v1/loops/FIC1/live"];

/// A stream that has begun.
async fn opened(daemon: &Daemon, what: &str, line: &str) -> TcpStream {
    let mut stream = TcpStream::connect(daemon.address).await.expect("connected");
    stream.write_all(request(daemon.address, what, &[line], "").as_bytes()).await.expect("sent");
    let mut seen = Vec::new();
    while !String::from_utf8_lossy(&seen).contains("hello") {
        let read = timeout(Duration::from_secs(20), stream.read_buf(&mut seen)).await.expect("it begins");
        assert!(read.expect("open") > 0, "{what}: {}", String::from_utf8_lossy(&seen));
    }
    stream
}

/// The status with which a stream is answered; it is not listened to.
async fn status(daemon: &Daemon, what: &str, line: &str) -> u16 {
    let mut stream = TcpStream::connect(daemon.address).await.expect("connected");
    stream.write_all(request(daemon.address, what, &[line], "").as_bytes()).await.expect("sent");
    let mut seen = Vec::new();
    loop {
        let read = timeout(Duration::from_secs(20), stream.read_buf(&mut seen)).await.expect("it answers");
        assert!(read.expect("open") > 0, "{what}: {}", String::from_utf8_lossy(&seen));
        if let Some((head, _)) = String::from_utf8_lossy(&seen).split_once("\r\n") {
            return head.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status");
        }
    }
}

/// How long a stream goes on from now.
async fn outlasts(mut stream: TcpStream) -> Duration {
    let began = Instant::now();
    let mut rest = Vec::new();
    let _ = timeout(Duration::from_secs(20), stream.read_to_end(&mut rest)).await.expect("it ends");
    began.elapsed()
}

async fn both(daemon: &Daemon, line: &str) -> Vec<TcpStream> {
    vec![opened(daemon, STREAMS[0], line).await, opened(daemon, STREAMS[1], line).await]
}

async fn end_in_time(streams: Vec<TcpStream>, why: &str) {
    let began = Instant::now();
    for stream in streams {
        outlasts(stream).await;
    }
    assert!(began.elapsed() < PROMISED, "{why}: {:?}", began.elapsed());
}

#[tokio::test]
async fn a_stream_ends_with_the_right_to_it() {
    let daemon = daemon("leases").await;
    let token = |role| daemon.token(role);
    let cookie = |session: &super::rig::Session| format!("cookie: {}", session.cookie);
    let (first, second) = (daemon.log_in("viewer").await, daemon.log_in("operator").await);
    let third = daemon.log_in("engineer").await;
    let revoked = both(&daemon, &token(Role::Viewer)).await;
    let logged_out = both(&daemon, &cookie(&first)).await;
    let removed = both(&daemon, &cookie(&second)).await;
    let changed = both(&daemon, &cookie(&third)).await;
    let kept = opened(&daemon, STREAMS[0], &token(Role::Operator)).await;
    book(&daemon.folder, |book| book.revoke_token("viewer"));
    end_in_time(revoked, "the token was revoked").await;
    assert_eq!(daemon.with_cookie("DELETE /api/v1/session", &first.cookie, None).await.status, 204);
    end_in_time(logged_out, "logged out").await;
    book(&daemon.folder, |book| book.remove_user("operator"));
    end_in_time(removed, "the user was removed").await;
    book(&daemon.folder, |book| book.change_user("engineer", Some(Roles::of(&[Role::Viewer])), None));
    end_in_time(changed, "the roles were changed").await;
    let mut one = [0; 1];
    let still = timeout(Duration::from_millis(200), kept.peek(&mut one)).await;
    assert!(!matches!(still, Ok(Ok(0) | Err(_))), "who may go on does");
}

#[tokio::test]
async fn a_stream_ends_when_token_or_session_run_out() {
    let daemon = daemon_with("run-out", "", |config| {
        let access = config.access.as_mut().expect("configured");
        (access.session_idle_s, access.session_max_s) = (3.0, 3600.0);
    })
    .await;
    let ends = now() + 4.0;
    let made = book(&daemon.folder, |book| {
        book.create_token("short", Roles::of(&[Role::Viewer]), (now(), ends), bytes(60))
    });
    let line = format!("authorization: Bearer {}", made.text);
    let (asked, shown) = ("GET /api/v1/loops", [line.as_str()]);
    super::rig::until(200, || daemon.ask(asked, &shown, "")).await;
    let by_token = opened(&daemon, STREAMS[0], &line).await;
    outlasts(by_token).await;
    assert!((ends..ends + PROMISED.as_secs_f64()).contains(&now()), "{} s after its end", now() - ends);
    // Who only listens is idle.
    let session = daemon.log_in("viewer").await;
    let begun = Instant::now();
    let by_session = opened(&daemon, STREAMS[1], &format!("cookie: {}", session.cookie)).await;
    outlasts(by_session).await;
    let lasted = begun.elapsed().as_secs_f64();
    assert!((2.5..3.0 + PROMISED.as_secs_f64()).contains(&lasted), "{lasted} s");
    // So is a page whose streams are opened again and again, as a browser does by itself where the network is bad.
    let session = daemon.log_in("viewer").await;
    let (begun, line) = (Instant::now(), format!("cookie: {}", session.cookie));
    let mut paces = interval(Duration::from_millis(200));
    let answered = loop {
        paces.tick().await;
        let answers = [status(&daemon, STREAMS[0], &line).await, status(&daemon, STREAMS[1], &line).await];
        let lasted = begun.elapsed().as_secs_f64();
        assert!(
            answers != [200, 200] || lasted < 3.0 + PROMISED.as_secs_f64(),
            "it is still open after {lasted} s"
        );
        if answers == [401, 401] {
            break lasted;
        }
    };
    assert!(answered > 2.5, "{answered} s");
}
