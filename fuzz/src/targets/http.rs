//! What a client of the API sends on one connection, to a daemon that has a plant.

use super::{scratch, wait};
use std::net::SocketAddr;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use stictiond::app::{App, listen};
use stictiond::config;
use stictiond::schedule::Clock;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// 2026-01-01T00:00:00Z.
const NOW: f64 = 1_767_225_600.0;
/// Longest that an answer may take.
const LONGEST: Duration = Duration::from_secs(8);

/// The daemon, on a runtime of its own.
fn daemon() -> SocketAddr {
    static ADDRESS: OnceLock<SocketAddr> = OnceLock::new();
    *ADDRESS.get_or_init(|| {
        let tables = scratch("http");
        std::fs::write(tables.join("a.csv"), "t,op,pv\n0,50,20\n1,51,21\n2,52,22\n").expect("written");
        let text = format!(
            "[server]\nlisten = \"127.0.0.1:0\"\nread_timeout_s = 0.1\n[tables]\nfolder = \"{}\"\n\
             [[modbus]]\nname = \"d\"\naddress = \"127.0.0.1:9\"\naddress_base = 0\npoll_ms = 60000\n\
             [[loop]]\nid = \"FIC1\"\ngroup = \"u\"\nop_span = 100.0\n\
             op = {{ device = \"d\", register = \"holding\", address = 0, type = \"f32\" }}\n\
             pv = {{ device = \"d\", register = \"holding\", address = 2, type = \"f32\" }}\n",
            tables.display()
        );
        let config = config::parse("fuzz.toml", &text).unwrap_or_else(|wrong| panic!("{wrong:?}"));
        let (tell, told) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
            runtime.expect("a runtime").block_on(async {
                let listener = listen(&config).await.expect("a free port");
                tell.send(listener.local_addr().expect("bound")).expect("heard");
                let app = App::build(config, Clock::by_hand(NOW), App::diagnosis()).expect("a daemon");
                let app = Arc::new(app);
                app.run(listener).await.expect("it runs");
            });
        });
        told.recv().expect("an address")
    })
}

/// Takes everything that a client sends before it closes its half; a line feed ends a line as well.
pub fn run(bytes: &[u8]) {
    let address = daemon();
    wait(async {
        let mut stream = TcpStream::connect(address).await.expect("a connection");
        // The answer to a client that is refused may come before all is sent.
        let _ = stream.write_all(bytes).await;
        let _ = stream.shutdown().await;
        let mut answer = Vec::new();
        let read = tokio::time::timeout(LONGEST, stream.read_to_end(&mut answer)).await;
        assert!(read.is_ok(), "no end of the answer");
        let text = String::from_utf8_lossy(&answer);
        assert!(!text.starts_with("HTTP/1.1 500"), "{text}");
    });
}
