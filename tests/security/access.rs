//! Who gets in, and what they may do there.

use super::rig::{PASSWORD, book, bytes, daemon, daemon_with, now, until};
use serde_json::Value;
use std::fs;
use std::io::{self, Write};
use std::sync::{Arc, Mutex};
use stictiond::access::{Role, Roles};
use stictiond::audit;
use stictiond::serve::{Need, RULES};
use stictiond::writeback::BUILT_IN;

fn viewer() -> Roles {
    Roles::of(&[Role::Viewer])
}

/// What is logged on this thread.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().expect("whole").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Every route, asked by everybody: who may gets past the door, whatever is behind it.
#[tokio::test]
async fn every_route_wants_the_role_of_its_entry() {
    let daemon = daemon("roles").await;
    let streams = |path: &str| path == "/events" || path.ends_with("/live");
    for (method, path, need) in RULES.iter().filter(|(_, path, _)| BUILT_IN || !path.contains("/writeback/"))
    {
        let own = path.replace("{id}", "FIC1");
        let what = format!("{method} /api/v1{own}");
        let stranger = daemon.ask(&what, &[], "").await;
        let Need::Role(needed) = need else {
            assert!(![401, 403].contains(&stranger.status), "{what}: {stranger:?}");
            continue;
        };
        assert_eq!((stranger.status, stranger.problem().as_str()), (401, "log_in"), "{what}");
        assert_eq!(stranger.header("www-authenticate"), Some("Bearer realm=\"stictiond\""));
        for role in Role::ALL {
            // A stream that opens does not end; that it opens is looked at elsewhere.
            if role.includes(*needed) && streams(path) {
                continue;
            }
            let answer = daemon.as_role(role, &what).await;
            if !role.includes(*needed) {
                assert_eq!((answer.status, answer.problem().as_str()), (403, "role"), "{what} by {role}");
                assert_eq!(answer.json()["needs"], needed.as_str());
            } else if path.contains("/writeback/") {
                assert_eq!((answer.status, answer.problem().as_str()), (403, "person_only"), "{what}");
            } else {
                assert!(![401, 403].contains(&answer.status), "{what} by {role}: {answer:?}");
            }
        }
    }
}

#[tokio::test]
async fn without_a_token_nothing_of_the_plant_is_told() {
    let daemon = daemon("stranger").await;
    for what in [
        "GET /api/v1/loops",
        "HEAD /api/v1/loops",
        "GET /metrics",
        "GET /api/v1/metrics",
        "GET /api/v1/loops/none",
    ] {
        let answer = daemon.ask(what, &[], "").await;
        assert!(answer.status == 401 && !answer.body.contains("FIC1"), "{what}: {answer:?}");
    }
    // What is not there looks the same to everybody, and no method opens another door.
    for (what, status) in [
        ("GET /api/v1/none", 404),
        ("PUT /api/v1/loops", 405),
        ("TRACE /api/v1/loops", 405),
        ("GET /api/v1/loops/", 404),
        ("GET //api/v1/loops", 404),
    ] {
        assert_eq!(daemon.ask(what, &[], "").await.status, status, "{what}");
    }
    for line in [
        "authorization: Basic YTpi",
        "authorization: Bearer",
        "authorization: Bearer  ",
        "authorization: stictiond",
        "cookie: stictiond_session=",
        "cookie: stictiond_session",
    ] {
        assert_eq!(daemon.ask("GET /api/v1/loops", &[line], "").await.status, 401, "{line}");
    }
}

#[tokio::test]
async fn an_expired_token_is_refused() {
    let daemon = daemon("expired").await;
    let made = book(&daemon.folder, |book| {
        book.create_token("old", viewer(), (now() - 9.0, now() - 1.0), bytes(50))
    });
    let line = format!("authorization: Bearer {}", made.text);
    // The daemon follows the file within a second or two: until then it does not know the token at all.
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(20);
    while daemon.ask("GET /api/v1/loops", &[&line], "").await.problem() != "expired_token" {
        assert!(std::time::Instant::now() < deadline, "the token was never seen");
    }
}

#[tokio::test]
async fn a_forged_token_is_refused() {
    let daemon = daemon("forged").await;
    let (own, other) = (daemon.token(Role::Viewer), daemon.token(Role::Engineer));
    let secret = |line: &str| line.rsplit('_').next().expect("a secret").to_string();
    let head = |line: &str| line.rsplit_once('_').expect("a head").0.to_string();
    let mut flipped = own.clone();
    let last = flipped.pop().expect("a digit");
    flipped.push(if last == '0' { '1' } else { '0' });
    for forged in [
        flipped,
        format!("{}_{}", head(&other), secret(&own)),
        head(&own),
        format!("{own}0"),
        own.to_uppercase().replace("AUTHORIZATION: BEARER", "authorization: Bearer"),
    ] {
        let answer = daemon.ask("GET /api/v1/loops", &[&forged], "").await;
        assert_eq!((answer.status, answer.problem().as_str()), (401, "bad_token"), "{forged}");
    }
    assert_eq!(daemon.as_role(Role::Viewer, "GET /api/v1/loops").await.status, 200);
}

#[tokio::test]
async fn a_revoked_token_is_refused() {
    let daemon = daemon("revoked").await;
    assert_eq!(daemon.as_role(Role::Viewer, "GET /api/v1/loops").await.status, 200);
    book(&daemon.folder, |book| book.revoke_token("viewer"));
    let answer = until(401, || daemon.as_role(Role::Viewer, "GET /api/v1/loops")).await;
    assert_eq!(answer.problem(), "bad_token");
    assert_eq!(daemon.as_role(Role::Operator, "GET /api/v1/loops").await.status, 200);
}

#[tokio::test]
async fn a_session_that_was_logged_out_is_not_taken_again() {
    let daemon = daemon("replayed").await;
    let session = daemon.log_in("operator").await;
    assert_eq!(daemon.with_cookie("GET /api/v1/loops", &session.cookie, None).await.status, 200);
    let out = daemon.with_cookie("DELETE /api/v1/session", &session.cookie, None).await;
    assert!(
        out.status == 204 && out.header("set-cookie").is_some_and(|line| line.contains("Max-Age=0")),
        "{out:?}"
    );
    let replayed = daemon.with_cookie("GET /api/v1/loops", &session.cookie, None).await;
    assert_eq!((replayed.status, replayed.problem().as_str()), (401, "log_in"));
    let change =
        daemon.with_cookie("POST /api/v1/alarms/FIC1/ack", &session.cookie, Some(&session.csrf)).await;
    assert_eq!(change.status, 401);
}

#[tokio::test]
async fn a_session_ends_when_its_time_is_over() {
    let short = |config: &mut stictiond::config::Config| {
        config.access.as_mut().expect("a log-in").session_max_s = 0.5;
    };
    let daemon = daemon_with("old", "", short).await;
    let session = daemon.log_in("viewer").await;
    // Used all the while, and it ends all the same.
    until(401, || daemon.with_cookie("GET /api/v1/loops", &session.cookie, None)).await;
}

#[tokio::test]
async fn the_cookie_is_out_of_reach_of_scripts_and_of_other_sites() {
    let daemon = daemon("cookie").await;
    let answer = daemon.try_password("viewer", PASSWORD).await;
    let cookie = answer.header("set-cookie").expect("a cookie");
    for flag in ["; HttpOnly", "; SameSite=Strict", "; Secure", "; Path=/"] {
        assert!(cookie.contains(flag), "{cookie}");
    }
    assert!(!cookie.contains("Domain"), "{cookie}");
}

/// What another site may make a browser send, and what a page of ours sends.
#[tokio::test]
async fn the_word_of_another_session_does_not_do() {
    let daemon = daemon("csrf").await;
    let (own, other) = (daemon.log_in("operator").await, daemon.log_in("operator").await);
    let ack = "POST /api/v1/alarms/FIC1/ack";
    for word in [None, Some(""), Some(other.csrf.as_str()), Some(own.cookie.as_str())] {
        let answer = daemon.with_cookie(ack, &own.cookie, word).await;
        assert_eq!((answer.status, answer.problem().as_str()), (403, "csrf"), "{word:?}");
    }
    // Nothing to acknowledge: past the door.
    assert_eq!(daemon.with_cookie(ack, &own.cookie, Some(&own.csrf)).await.status, 409);
}

#[tokio::test]
async fn other_sites_are_not_let_in() {
    let daemon = daemon("cors").await;
    let origin = "origin: https://evil.example";
    let answer = daemon.ask("GET /api/v1/loops", &[&daemon.token(Role::Viewer), origin], "").await;
    assert_eq!((answer.status, answer.problem().as_str()), (403, "foreign_origin"));
    assert!(!answer.head.to_lowercase().contains("access-control-"), "{answer:?}");
    let asked =
        daemon.ask("OPTIONS /api/v1/loops", &[origin, "access-control-request-method: POST"], "").await;
    assert!(
        [403, 405].contains(&asked.status) && !asked.head.to_lowercase().contains("access-control-"),
        "{asked:?}"
    );
    let body = format!("{{\"user\": \"operator\", \"password\": \"{PASSWORD}\"}}");
    let log_in = daemon.ask("POST /api/v1/session", &[origin], &body).await;
    assert_eq!((log_in.status, log_in.problem().as_str()), (403, "foreign_origin"));
    for (name, value) in [
        ("x-frame-options", "DENY"),
        ("x-content-type-options", "nosniff"),
        ("cache-control", "no-store"),
        ("referrer-policy", "no-referrer"),
    ] {
        assert_eq!(answer.header(name), Some(value));
    }
    let policy = answer.header("content-security-policy").expect("a policy");
    assert!(
        policy.contains("default-src 'none'")
            && policy.contains("frame-ancestors 'none'")
            && !policy.contains("unsafe")
    );
}

#[tokio::test]
async fn passwords_are_not_tried_without_end() {
    let daemon = daemon("throttle").await;
    for _ in 0..5 {
        assert_eq!(daemon.try_password("operator", "wrong").await.problem(), "log_in_failed");
    }
    let answer = daemon.try_password("operator", PASSWORD).await;
    assert_eq!((answer.status, answer.problem().as_str()), (429, "throttled"));
    let wait: u64 = answer.header("retry-after").and_then(|wait| wait.parse().ok()).expect("a wait");
    assert!((1..=2).contains(&wait), "{wait}");
    // Another user from here is not held up yet, and the right password gets in after the wait.
    daemon.log_in("viewer").await;
    until(200, || daemon.try_password("operator", PASSWORD)).await;
    // A user who does not exist hears the same as one who does.
    let (none, some) =
        (daemon.try_password("nobody", "wrong").await, daemon.try_password("viewer", "wrong").await);
    assert_eq!((none.status, none.body), (some.status, some.body));
}

#[tokio::test]
async fn who_tries_passwords_without_end_does_not_fill_the_log() {
    let log = Log::default();
    let writer = log.clone();
    let to_log = tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).finish();
    let _logging = tracing::subscriber::set_default(to_log);
    let daemon = daemon("throttle-log").await;
    let mut throttled = 0;
    for _ in 0..1000 {
        throttled += usize::from(daemon.try_password("operator", "wrong").await.status == 429);
        if throttled == 60 {
            break;
        }
    }
    assert_eq!(throttled, 60);
    let said = String::from_utf8_lossy(&log.0.lock().expect("whole")).into_owned();
    // Twenty at once, and then one a minute.
    let lines = said.lines().filter(|line| line.contains("log-in throttled")).count();
    assert!((20..=22).contains(&lines), "{lines}");
}

#[tokio::test]
async fn every_change_is_on_record_and_no_secret_is() {
    let daemon = daemon("record").await;
    let session = daemon.log_in("operator").await;
    daemon.try_password("operator", "not the password at all").await;
    daemon.try_password("a password typed as name", "x").await;
    let by = format!("cookie: {}", session.cookie);
    let word = format!("x-csrf-token: {}", session.csrf);
    let body = r#"{"duration_s": 60, "by": "somebody else", "comment": "line\nbreak"}"#;
    let shelved = daemon.ask("POST /api/v1/alarms/FIC1/shelve", &[&by, &word], body).await;
    daemon.as_role(Role::Viewer, "POST /api/v1/alarms/FIC1/ack").await;
    let list = daemon.as_role(Role::Engineer, "GET /api/v1/audit?limit=100").await.json();
    let items = list["items"].as_array().expect("entries");
    let events: Vec<&str> = items.iter().filter_map(|item| item["event"].as_str()).collect();
    assert_eq!(events, ["refused", "change", "log_in_failed", "log_in_failed", "log_in"]);
    let field = |at: usize, name: &str| items[at]["fields"][name].as_str().unwrap_or_default().to_string();
    assert_eq!(
        (field(0, "who"), field(0, "by"), field(0, "result")),
        ("viewer".into(), "token".into(), "403".into())
    );
    assert_eq!(
        (field(1, "who"), field(1, "by"), field(1, "from")),
        ("operator".into(), "session".into(), "127.0.0.1".into())
    );
    assert_eq!(field(1, "asked"), "POST /api/v1/alarms/FIC1/shelve");
    // JSON is recorded without the blanks that it came with.
    let said = r#"{"by":"somebody else","comment":"line\nbreak","duration_s":60}"#;
    assert_eq!((field(1, "result"), field(1, "said")), (shelved.status.to_string(), said.to_string()));
    assert_eq!((field(2, "who"), field(3, "who")), (String::new(), "operator".to_string()));
    let page = daemon.as_role(Role::Engineer, "GET /api/v1/audit?limit=2").await.json();
    let path = format!("GET /api/v1/audit?before={}", page["next"]);
    let rest = daemon.as_role(Role::Engineer, &path).await.json();
    assert_eq!((rest["items"].as_array().map(Vec::len), &rest["next"]), (Some(3), &Value::Null));
    let log = daemon.folder.join("audit.log");
    let text = fs::read_to_string(&log).expect("a log");
    for secret in [
        PASSWORD,
        "not the password at all",
        "typed as name",
        &session.csrf,
        session.cookie.split('=').nth(1).expect("a value"),
    ] {
        assert!(!text.contains(secret), "{secret}");
    }
    assert!(audit::verify(&log).is_ok());
}

/// A log whose folder is gone fails at its next rotation, which here is at every entry.
#[tokio::test]
async fn without_a_record_nothing_is_changed_but_a_term_is_taken_back() {
    let logged = |config: &mut stictiond::config::Config| {
        let audit = config.audit.as_mut().expect("a log");
        let folder = audit.file.with_file_name("log");
        fs::create_dir_all(&folder).expect("writable");
        (audit.file, audit.max_bytes) = (folder.join("audit.log"), 1);
    };
    let daemon = daemon_with("no-record", "", logged).await;
    let session = daemon.log_in("operator").await;
    fs::remove_dir_all(daemon.folder.join("log")).expect("there");
    let by = format!("cookie: {}", session.cookie);
    let word = format!("x-csrf-token: {}", session.csrf);
    let change = async |what: &str| daemon.ask(what, &[&by, &word], r#"{"by": "operator"}"#).await;
    // The first that cannot be recorded is only found out by it.
    let refused = until(503, || change("POST /api/v1/alarms/FIC1/ack")).await;
    assert_eq!(refused.problem(), "audit_failed");
    // Past the door: there is no write-back for this loop, or none in this build.
    let answer = change("POST /api/v1/loops/FIC1/writeback/withdraw").await;
    assert_eq!(answer.status, 404, "{answer:?}");
}

#[tokio::test]
async fn a_record_that_was_changed_stops_changes_and_not_the_daemon() {
    let now = "2026-01-01T00:00:00Z";
    let changed = |config: &mut stictiond::config::Config| {
        let file = &config.audit.as_ref().expect("a log").file;
        let bounds = audit::Bounds { max_bytes: 1000, keep_files: 3 };
        let mut log = audit::Log::open(file, bounds, now).expect("opens");
        (0..50).for_each(|n| log.append(now, "change", &[("n", n.to_string())]).expect("written"));
        log.sync().expect("written");
        let old = file.with_file_name("audit.log.3");
        let text = fs::read_to_string(&old).expect("there");
        fs::write(&old, text.replacen(" change ", " chance ", 1)).expect("written");
    };
    let daemon = daemon_with("changed-record", "", changed).await;
    let old = daemon.folder.join("audit.log.3");
    let text = fs::read_to_string(&old).expect("there");
    assert!(text.contains(" chance "));
    // Who logs in sees all there is to see, and changes nothing.
    let session = daemon.log_in("operator").await;
    let [by, word] = [format!("cookie: {}", session.cookie), format!("x-csrf-token: {}", session.csrf)];
    assert_eq!(daemon.ask("GET /api/v1/loops", &[&by], "").await.status, 200);
    let token = daemon.token(Role::Operator);
    for headers in [&[by.as_str(), word.as_str()][..], &[token.as_str()]] {
        let refused = daemon.ask("POST /api/v1/alarms/FIC1/ack", headers, "").await;
        assert_eq!((refused.status, refused.problem().as_str()), (503, "audit_failed"));
        let remedy = format!("stictiond audit renew {}`", daemon.folder.join("audit.log").display());
        for part in [old.display().to_string(), remedy] {
            assert!(refused.body.contains(&part), "{part}: {refused:?}");
        }
    }
    // Past the door, as while the log cannot be written.
    let taken =
        daemon.ask("POST /api/v1/loops/FIC1/writeback/withdraw", &[&by, &word], r#"{"by": "x"}"#).await;
    assert_eq!(taken.status, 404, "{taken:?}");
    let health = daemon.ask("GET /healthz", &[], "").await.json();
    assert_eq!((&health["audit"]["state"], &health["audit"]["damaged"]), (&"failing".into(), &true.into()));
    assert_eq!(fs::read_to_string(&old).expect("there"), text, "nothing is put right by itself");
}

#[tokio::test]
async fn everybody_reads_only_where_the_file_says_so() {
    let open = |config: &mut stictiond::config::Config| {
        config.access.as_mut().expect("a log-in").anyone_may_read = true;
    };
    let daemon = daemon_with("open", "", open).await;
    assert_eq!(daemon.ask("GET /api/v1/loops", &[], "").await.status, 200);
    assert_eq!(daemon.ask("POST /api/v1/alarms/FIC1/ack", &[], "").await.status, 401);
    assert_eq!(daemon.ask("GET /api/v1/audit", &[], "").await.status, 401);
    let session = daemon.ask("GET /api/v1/session", &[], "").await.json();
    assert_eq!((&session["may"], &session["name"]), (&serde_json::json!(["viewer"]), &Value::Null));
    // Something shown that is no good is not taken for nothing.
    assert_eq!(daemon.ask("GET /api/v1/loops", &["authorization: Bearer x"], "").await.status, 401);
}
