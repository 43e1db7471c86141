//! Servers that send without end to whoever brings a message.

use super::rig::{Daemon, plant};
use futures::future::join_all;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

/// What is promised (bytes); the system itself holds a few millions on the way.
const MOST: u64 = 32 << 20;

/// A server that says something and then one thing without end; gives how much each connection took.
fn endless(first: &'static str, then: &'static str) -> (u16, Receiver<u64>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = listener.local_addr().expect("bound").port();
    let (tell, told) = channel();
    thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            let tell = tell.clone();
            thread::spawn(move || {
                let (piece, mut sent) = (then.repeat((1 << 16) / then.len()), 0);
                // Who speaks first is heard; the other is spoken to.
                let _ = stream.set_read_timeout(Some(Duration::from_millis(200)));
                let _ = stream.read(&mut [0; 4096]);
                let _ = stream.write_all(first.as_bytes());
                while let Ok(n) = stream.write(piece.as_bytes()) {
                    sent += n as u64;
                }
                let _ = tell.send(sent);
            });
        }
    });
    (port, told)
}

const RETRY: &str = "[notify.KIND.pace]\nwait_s = 0.05\ninterval_s = 0.0\n\
                     [notify.KIND.retry]\nfirst_s = 0.05\nlongest_s = 0.1\n";

async fn given_up(what: &str, text: &str, told: Receiver<u64>) {
    let daemon = Daemon::start(&plant(None, text)).await;
    daemon.diagnosed("FIC1", Some(2.5));
    let taken = tokio::task::spawn_blocking(move || {
        [(); 2].map(|()| told.recv_timeout(Duration::from_secs(60)).expect("a connection ends"))
    });
    for taken in taken.await.expect("no panic") {
        println!("{what}: {:.1} MiB taken from the peer", taken as f64 / f64::from(1 << 20));
        assert!(taken < MOST, "{what}: {taken} bytes");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn mail_servers_without_end_are_given_up() {
    let servers = [
        ("a greeting without a line end", "220 ", "a"),
        ("lines without end", "", "220-still\r\n"),
        ("an answer without end", "220 here\r\n", "250-more\r\n"),
    ];
    // Each has a daemon of its own, and most of the time is waiting.
    let met = servers.map(|(what, first, then)| async move {
        let (port, told) = endless(first, then);
        let text = format!(
            "[[notify.smtp]]\nname = 'm'\naddress = '127.0.0.1:{port}'\nsecurity = 'none'\ntimeout_s = 12.0\n\
             from = 's@plant.example'\nto = ['a@plant.example']\n{}",
            RETRY.replace("KIND", "smtp")
        );
        given_up(what, &text, told).await;
    });
    join_all(met).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn web_servers_without_end_are_given_up() {
    for (what, first, then) in [
        ("a status line without end", "HTTP/1.1 ", "2"),
        ("a head without end", "HTTP/1.1 200 OK\r\n", "x-a: b\r\n"),
        ("a body without end", "HTTP/1.1 500 No\r\n\r\n", "a"),
        ("chunks without end", "HTTP/1.1 500 No\r\ntransfer-encoding: chunked\r\n\r\n", "1\r\na\r\n"),
        ("preliminary answers without end", "", "HTTP/1.1 103 Early Hints\r\nx: y\r\n\r\n"),
    ] {
        let (port, told) = endless(first, then);
        let secret =
            std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("endless-{}", std::process::id()));
        std::fs::write(&secret, "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSwMfKQ9r8GKYqrTwjU\n")
            .expect("writable");
        let text = format!(
            "[[notify.webhook]]\nname = 'w'\nurl = 'http://127.0.0.1:{port}/'\nsecret_file = '{}'\ntimeout_s = 3.0\n{}",
            secret.display(),
            RETRY.replace("KIND", "webhook")
        );
        given_up(what, &text, told).await;
    }
}
