//! Something that listens where a server should, and is none.

use super::rig::{COUNTER, Watch, config, plan};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;

/// Acknowledges the greeting: version 0, buffers of 64 KiB, messages and chunks without limit.
const ACK: [u8; 28] =
    [b'A', b'C', b'K', b'F', 28, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];

/// What is answered to the greeting, and to what comes after it.
fn answers() -> Vec<(&'static str, Vec<u8>, Vec<u8>)> {
    let head = |kind: &[u8; 4], length: u32| [&kind[..], &length.to_le_bytes()].concat();
    let opened = |rest: &[u8]| {
        // A secure channel of the policy None, and a sequence header.
        let uri = b"http://opcfoundation.org/UA/SecurityPolicy#None";
        let mut body = [&1u32.to_le_bytes()[..], &(uri.len() as u32).to_le_bytes(), uri].concat();
        body.extend([[0xff; 4], [0xff; 4], [1, 0, 0, 0], [1, 0, 0, 0]].concat());
        body.extend(rest);
        [head(b"OPNF", 8 + body.len() as u32), body].concat()
    };
    vec![
        ("closes at once", vec![], vec![]),
        ("another protocol", b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec(), vec![]),
        ("noise", (0..=255).cycle().skip(77).take(3000).collect(), vec![]),
        ("a length of 4 GiB", head(b"ACKF", u32::MAX), vec![]),
        ("a length of none", head(b"ACKF", 0), vec![]),
        ("half an answer", ACK[..13].to_vec(), vec![]),
        (
            "an error with a text of 2 GiB",
            [head(b"ERRF", 16), vec![0, 0, 5, 0x80, 0xff, 0xff, 0xff, 0x7f]].concat(),
            vec![],
        ),
        ("buffers of no size", [&ACK[..12], &[0; 16]].concat(), vec![]),
        ("noise after the greeting", ACK.to_vec(), (0..=255).cycle().take(5000).collect()),
        ("an open channel without an answer in it", ACK.to_vec(), opened(&[])),
        ("an answer that is no answer", ACK.to_vec(), opened(&[0xff; 200])),
        ("an answer of a type that there is not", ACK.to_vec(), opened(&[1, 0, 0xff, 0xff, 0, 0, 0, 0])),
    ]
}

#[tokio::test]
async fn what_is_no_server_gives_no_sample_and_every_attempt_is_counted() {
    for (what, greeting, more) in answers() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let server = tokio::spawn(async move {
            while let Ok((mut socket, _)) = listener.accept().await {
                let mut asked = [0; 4096];
                for answer in [&greeting, &more] {
                    let _ = socket.read(&mut asked).await;
                    let _ = socket.write_all(answer).await;
                }
            }
        });
        let config = config(port, "timeout_ms = 100\nreconnect_max_ms = 10\npublishing_ms = 20");
        let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
        let health = watch
            .until_health(what, |health| health.link_errors + health.timeouts + health.security_errors > 1)
            .await;
        assert!(!health.connected, "{what}: {health:?}");
        assert_eq!(watch.samples(0), [], "{what}");
        assert_eq!(watch.warnings().len(), 1, "{what}: {:#?}", watch.warnings());
        watch.stop().await;
        server.abort();
    }
}
