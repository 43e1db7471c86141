//! Relays between servers that are made up and clients that are none.

use super::*;
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use nkeys::KeyPair;
use std::path::PathBuf;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::PrivateKeyDer;

/// Far longer than anything takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

async fn listening() -> (TcpListener, u16) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    (listener, port)
}

fn config(scheme: &str, port: u16) -> Config {
    toml::from_str(&format!("servers = ['{scheme}://127.0.0.1:{port}']")).unwrap()
}

async fn line(stream: &mut (impl AsyncRead + Unpin)) -> String {
    let (line, rest) = timeout(PATIENCE, first_line(stream)).await.expect("a line").unwrap();
    assert!(rest.is_empty(), "{rest:?}");
    String::from_utf8(line).unwrap()
}

/// What comes of a connection until it ends, however it ends.
async fn rest(stream: &mut (impl AsyncRead + Unpin)) -> Vec<u8> {
    let mut rest = Vec::new();
    let _ = timeout(PATIENCE, stream.read_to_end(&mut rest)).await.expect("it ends");
    rest
}

/// A certificate of this machine as a file, and what a server needs to show it.
fn certificate(name: &str) -> (PathBuf, TlsAcceptor) {
    let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_string()]).unwrap();
    let file = std::env::temp_dir().join(format!("stictiond-relay-{}-{name}.pem", std::process::id()));
    std::fs::write(&file, made.cert.pem()).unwrap();
    let key = PrivateKeyDer::try_from(made.signing_key.serialize_der()).unwrap();
    let begun = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_no_client_auth();
    let config = begun.with_single_cert(vec![made.cert.der().clone()], key).unwrap();
    (file, TlsAcceptor::from(Arc::new(config)))
}

#[tokio::test]
async fn our_client_is_let_through_under_its_name_and_nobody_else() {
    let (listener, port) = listening().await;
    let relay = Relay::start(&config("nats", port), "stictiond a".into()).await.unwrap();
    // It tells of itself: another server might be the next that is chosen.
    let info =
        format!("INFO {{\"server_id\":\"x\",\"nonce\":\"n\",\"connect_urls\":[\"127.0.0.1:{port}\"]}}\r\n");
    for (name, is_ours) in [("somebody", false), (relay.secret(), true)] {
        let mut near = TcpStream::connect(relay.address).await.unwrap();
        let (mut far, _) = listener.accept().await.unwrap();
        far.write_all(info.as_bytes()).await.unwrap();
        // The client connects to no other server by itself.
        assert_eq!(line(&mut near).await, "INFO {\"nonce\":\"n\",\"server_id\":\"x\"}\r\n");
        let connect = format!("CONNECT {{\"name\":\"{name}\",\"user\":\"u\"}}\r\n");
        near.write_all(connect.as_bytes()).await.unwrap();
        if !is_ours {
            assert_eq!((rest(&mut far).await, rest(&mut near).await), (vec![], vec![]));
            continue;
        }
        let connect = "CONNECT {\"name\":\"stictiond a\",\"tls_required\":false,\"user\":\"u\"}\r\n";
        assert_eq!(line(&mut far).await, connect);
        near.write_all(b"PUB a 2\r\nhi\r\n").await.unwrap();
        let mut said = [0; 13];
        timeout(PATIENCE, far.read_exact(&mut said)).await.expect("it is passed on").unwrap();
        assert_eq!(&said, b"PUB a 2\r\nhi\r\n");
        far.write_all(b"PONG\r\n").await.unwrap();
        assert_eq!(line(&mut near).await, "PONG\r\n");
        far.write_all(b"MSG a 1 4000000000\r\n").await.unwrap();
        assert_eq!((rest(&mut near).await, rest(&mut far).await), (vec![], vec![]));
    }
    // It ends with its client.
    let address = relay.address;
    drop(relay);
    let ended = async {
        while TcpStream::connect(address).await.is_ok() {
            tokio::task::yield_now().await;
        }
    };
    timeout(PATIENCE, ended).await.expect("nobody listens");
}

#[tokio::test]
async fn a_password_that_was_replaced_is_shown_at_the_next_connection() {
    let file = std::env::temp_dir().join(format!("stictiond-relay-{}-password", std::process::id()));
    let (listener, port) = listening().await;
    let (user, password_file) = (Some("u".to_string()), Some(file.clone()));
    let config = Config { user, password_file, ..config("nats", port) };
    std::fs::write(&file, "old\n").unwrap();
    let relay = Relay::start(&config, "a".into()).await.unwrap();
    for password in ["old", "new"] {
        std::fs::write(&file, format!("{password}\n")).unwrap();
        let mut near = TcpStream::connect(relay.address).await.unwrap();
        let (mut far, _) = listener.accept().await.unwrap();
        far.write_all(b"INFO {}\r\n").await.unwrap();
        line(&mut near).await;
        // The client knows the one of the start.
        let connect = format!("CONNECT {{\"name\":\"{}\",\"pass\":\"old\"}}\r\n", relay.secret());
        near.write_all(connect.as_bytes()).await.unwrap();
        let shown = format!("CONNECT {{\"name\":\"a\",\"pass\":\"{password}\",\"tls_required\":false}}\r\n");
        assert_eq!(line(&mut far).await, shown);
    }
    std::fs::remove_file(file).unwrap();
}

#[tokio::test]
async fn credentials_and_keys_that_were_replaced_sign_the_next_connection() {
    let file = std::env::temp_dir().join(format!("stictiond-relay-{}-key", std::process::id()));
    let write = |field: &str, jwt: &str, key: &KeyPair| {
        let seed = key.seed().unwrap();
        let text = match field {
            "nkey_file" => format!("{seed}\n"),
            _ => format!(
                "-----BEGIN NATS USER JWT-----\n{jwt}\n------END NATS USER JWT------\n\n\
                 -----BEGIN USER NKEY SEED-----\n{seed}\n------END USER NKEY SEED------\n"
            ),
        };
        std::fs::write(&file, text).unwrap();
    };
    for field in ["nkey_file", "credentials_file"] {
        let (listener, port) = listening().await;
        let own = match field {
            "nkey_file" => Config { nkey_file: Some(file.clone()), ..config("nats", port) },
            _ => Config { credentials_file: Some(file.clone()), ..config("nats", port) },
        };
        let relay = Relay::start(&own, "a".into()).await.unwrap();
        for (jwt, nonce) in [("old.jwt", "first"), ("new.jwt", "second")] {
            let key = KeyPair::new_user();
            write(field, jwt, &key);
            let mut near = TcpStream::connect(relay.address).await.unwrap();
            let (mut far, _) = listener.accept().await.unwrap();
            far.write_all(format!("INFO {{\"nonce\":\"{nonce}\"}}\r\n").as_bytes()).await.unwrap();
            line(&mut near).await;
            let connect = format!("CONNECT {{\"name\":\"{}\"}}\r\n", relay.secret());
            near.write_all(connect.as_bytes()).await.unwrap();
            let shown = line(&mut far).await;
            let shown: Value = serde_json::from_str(shown.strip_prefix("CONNECT ").unwrap()).unwrap();
            let signature = URL_SAFE_NO_PAD.decode(shown["sig"].as_str().unwrap()).unwrap();
            key.verify(nonce.as_bytes(), &signature).expect("it is signed by the key of now");
            match field {
                "nkey_file" => assert_eq!(shown["nkey"], key.public_key()),
                _ => assert_eq!(shown["jwt"], jwt),
            }
        }
    }
    std::fs::remove_file(&file).unwrap();
}

#[tokio::test]
async fn encrypted_to_who_is_trusted_and_to_nobody_else() {
    let ((own, acceptor), (other, _)) = (certificate("own"), certificate("other"));
    // Asked for by the server, and by us of a server that does not.
    for (scheme, info) in [("nats", &b"INFO {\"tls_required\":true}\r\n"[..]), ("tls", b"INFO {}\r\n")] {
        for (trusted, is_trusted) in [(&own, true), (&other, false)] {
            let (listener, port) = listening().await;
            let config = Config { ca_file: Some(trusted.clone()), ..config(scheme, port) };
            let relay = Relay::start(&config, "a".into()).await.unwrap();
            let mut near = TcpStream::connect(relay.address).await.unwrap();
            let (mut far, _) = listener.accept().await.unwrap();
            far.write_all(info).await.unwrap();
            let accepted = timeout(PATIENCE, acceptor.accept(far)).await.expect("it answers");
            if !is_trusted {
                assert!(accepted.is_err(), "{scheme}");
                assert_eq!(rest(&mut near).await, b"", "the client is told nothing");
                continue;
            }
            let mut far = accepted.unwrap();
            assert_eq!(line(&mut near).await, "INFO {}\r\n");
            let connect = format!("CONNECT {{\"name\":\"{}\"}}\r\n", relay.secret());
            near.write_all(connect.as_bytes()).await.unwrap();
            assert_eq!(line(&mut far).await, "CONNECT {\"name\":\"a\",\"tls_required\":true}\r\n");
            far.write_all(b"PONG\r\n").await.unwrap();
            far.flush().await.unwrap();
            assert_eq!(line(&mut near).await, "PONG\r\n");
        }
    }
    for file in [own, other] {
        std::fs::remove_file(file).unwrap();
    }
}

#[tokio::test]
async fn what_is_said_before_a_connection_is_encrypted_does_not_count() {
    let (listener, port) = listening().await;
    let relay = Relay::start(&config("nats", port), "a".into()).await.unwrap();
    for said in
        [&b"INFO {\"tls_required\":true}\r\nPONG\r\n"[..], b"INFO []\r\n", b"PING\r\n", &[b'a'; 1 << 16]]
    {
        let mut near = TcpStream::connect(relay.address).await.unwrap();
        let (mut far, _) = listener.accept().await.unwrap();
        // Where it is too long it may end before all of it went.
        let _ = far.write_all(said).await;
        assert_eq!((rest(&mut near).await, rest(&mut far).await), (vec![], vec![]));
    }
}

#[test]
fn the_server_that_fails_least_is_next_and_others_are_known_up_to_a_bound() {
    let config: Config =
        toml::from_str("servers = ['nats://10.0.0.1', 'nats://10.0.0.2:4222']").expect("readable");
    let servers = Mutex::new(config.servers.iter().map(|server| Server::of(server).unwrap()).collect());
    let between = Between { config, name: "a".into(), secret: "s".into(), servers };
    let [first, second] = [1, 2].map(|n| between.servers()[n - 1].address.clone());
    between.failed(&first, Some("why".into()));
    assert_eq!(between.chosen(), Some(second.clone()));
    between.let_in(&first);
    between.failed(&second, None);
    assert_eq!(between.chosen(), Some(first));
    let told: Vec<String> = (1..500).map(|port| format!("\"10.0.0.3:{port}\"")).collect();
    let said = format!("INFO {{\"connect_urls\":[{}, \"{}\"]}}\r\n", told.join(","), "a".repeat(300));
    let others = Said::read(said.as_bytes()).expect("it greets").others;
    assert_eq!(others.len(), 499);
    between.learn(others);
    assert_eq!(between.servers().len(), MOST_SERVERS);
}
