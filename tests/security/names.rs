//! By which names the daemon answers: a page whose name was made to resolve to this machine is of one origin with it, as
//! the browser sees it.

use super::client::{Answer, parse, raw};
use super::rig::{daemon_with, folder, text};
use stictiond::config;
use stictiond::serve::RULES;

/// One request with exactly these lines; without TLS.
async fn asked(to: std::net::SocketAddr, what: &str, lines: &[String]) -> Answer {
    parse(&raw(to, &format!("{what} HTTP/1.1\r\nconnection: close\r\n{}\r\n", lines.concat())).await)
}

fn of_one_origin(host: &str) -> [String; 2] {
    [format!("host: {host}\r\n"), format!("origin: http://{host}\r\n")]
}

/// Every route and the page, without a log-in and on loopback, as the daemon is by default.
#[tokio::test]
async fn under_a_name_of_somebody_else_nothing_is_answered() {
    let daemon = daemon_with("rebinding", "", |config| config.access = None).await;
    let port = daemon.address.port();
    let routes =
        RULES.iter().map(|(method, path, _)| format!("{method} /api/v1{}", path.replace("{id}", "FIC1")));
    let others =
        ["GET /", "GET /js/main.js", "GET /healthz", "HEAD /metrics", "GET /nothing"].map(String::from);
    for what in routes.chain(others) {
        for host in
            ["evil.example", &format!("evil.example:{port}"), "localhost.evil.example", "127.0.0.1.nip.io"]
        {
            let answer = asked(daemon.address, &what, &of_one_origin(host)).await;
            assert_eq!(answer.status, 421, "{what} as {host}: {answer:?}");
            assert!(!answer.body.contains("FIC1"), "{what} as {host}");
        }
        // A page of another site that asks by our own name.
        let foreign = [format!("host: localhost:{port}\r\n"), "origin: http://evil.example\r\n".to_string()];
        assert_eq!(asked(daemon.address, &what, &foreign).await.status, 403, "{what}");
    }
    let target = format!("GET http://evil.example:{port}/api/v1/loops");
    assert_eq!(asked(daemon.address, &target, &["host: localhost\r\n".to_string()]).await.status, 421);
    let two = ["host: localhost\r\n".to_string(), "host: evil.example\r\n".to_string()];
    assert_eq!(asked(daemon.address, "GET /api/v1/loops", &two).await.status, 400);
}

#[tokio::test]
async fn under_its_own_names_it_answers() {
    let daemon = daemon_with("own-names", "hosts = ['stiction.plant.example', 'alias:8443']", |_| {}).await;
    let own = stictiond::host::name();
    let port = daemon.address.port();
    for host in [
        "localhost",
        &format!("localhost:{port}"),
        "LOCALHOST",
        "127.0.0.1",
        &format!("[::1]:{port}"),
        "10.1.2.3:80",
        &own,
        "stiction.plant.example",
        "Stiction.Plant.Example:443",
        "alias:8443",
        "alias",
    ] {
        let answer = asked(daemon.address, "GET /healthz", &of_one_origin(host)).await;
        assert_eq!(answer.status, 200, "{host}: {answer:?}");
    }
    // A proxy may ask by another name than the browser did; a probe of HTTP/1.0 names nobody.
    let proxied =
        ["host: 127.0.0.1:8080\r\n".to_string(), "origin: https://stiction.plant.example\r\n".to_string()];
    assert_eq!(asked(daemon.address, "GET /healthz", &proxied).await.status, 200);
    assert!(raw(daemon.address, "GET /healthz HTTP/1.0\r\n\r\n").await.contains("200 OK"));
}

#[test]
fn a_name_that_is_none_is_refused_in_the_file() {
    let folder = folder("hosts");
    for (hosts, wrong) in
        [("'a b'", true), ("'http://x'", true), ("''", true), ("'*'", true), ("'x.example:80'", false)]
    {
        let read = config::parse("f", &text(&folder, &format!("hosts = [{hosts}]")));
        let told = read.err().map(|errors| errors[0].to_string()).unwrap_or_default();
        assert_eq!(told.contains("hosts: "), wrong, "{hosts}: {told}");
    }
}
