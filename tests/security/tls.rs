//! Certificates: the daemon's, another one after a reload, and those of clients.

use super::client::{Answer, exchange, parse, raw, request};
use super::rig::{Daemon, daemon_with, folder, parsed, text};
use rcgen::{BasicConstraints, CertificateParams, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stictiond::access::Role;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// Who signs certificates.
struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pem: String,
}

impl Authority {
    fn new() -> Self {
        let key = KeyPair::generate().expect("a key");
        let mut params = CertificateParams::new(vec![]).expect("no names");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let pem = params.self_signed(&key).expect("signed").pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    /// Certificate and key, in files named so.
    fn sign(&self, place: &Path, name: &str, usage: ExtendedKeyUsagePurpose) -> (PathBuf, PathBuf) {
        let key = KeyPair::generate().expect("a key");
        let mut params = CertificateParams::new(vec!["localhost".into(), "127.0.0.1".into()]).expect("names");
        params.extended_key_usages = vec![usage];
        let certificate = params.signed_by(&key, &self.issuer).expect("signed");
        let files = (place.join(format!("{name}.pem")), place.join(format!("{name}.key")));
        fs::write(&files.0, certificate.pem()).expect("written");
        fs::write(&files.1, key.serialize_pem()).expect("written");
        files
    }
}

/// One request over TLS; `None` when there is no connection.
async fn ask(
    daemon: &Daemon,
    ca: &Authority,
    own: Option<&(PathBuf, PathBuf)>,
    path: &str,
) -> Option<Answer> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(ca.pem.as_bytes()).expect("a certificate")).expect("a root");
    let client = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let client =
        client.with_safe_default_protocol_versions().expect("versions").with_root_certificates(roots);
    let client = match own {
        None => client.with_no_client_auth(),
        Some((certificate, key)) => {
            let certificate = CertificateDer::from_pem_file(certificate).expect("a certificate");
            let key = PrivateKeyDer::from_pem_file(key).expect("a key");
            client.with_client_auth_cert(vec![certificate], key).expect("a pair")
        }
    };
    let stream = TcpStream::connect(daemon.address).await.expect("the server listens");
    let name = ServerName::try_from("localhost").expect("a name");
    let stream = TlsConnector::from(Arc::new(client)).connect(name, stream).await.ok()?;
    let text = request(daemon.address, &format!("GET {path}"), &[&daemon.token(Role::Viewer)], "");
    // With TLS 1.3 the client hears only now that it is not wanted.
    let answer = exchange(stream, text.as_bytes()).await;
    (!answer.is_empty()).then(|| parse(&answer))
}

fn section(files: &(PathBuf, PathBuf), client_ca: Option<&Path>) -> String {
    let more = client_ca.map(|path| format!("client_ca_file = '{}'\n", path.display())).unwrap_or_default();
    format!("[server.tls]\ncert_file = '{}'\nkey_file = '{}'\n{more}", files.0.display(), files.1.display())
}

#[tokio::test]
async fn a_reload_takes_the_new_certificate_and_refuses_a_bad_one() {
    let (place, ca) = (folder("tls-files"), Authority::new());
    let files = ca.sign(&place, "server", ExtendedKeyUsagePurpose::ServerAuth);
    let daemon = daemon_with("tls", &section(&files, None), |_| {}).await;
    let answer = ask(&daemon, &ca, None, "/api/v1/loops").await.expect("a connection");
    assert_eq!((answer.status, answer.header("strict-transport-security")), (200, Some("max-age=31536000")));
    // In the clear nothing is answered.
    assert!(
        !raw(daemon.address, "GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").await.contains("HTTP/1.1")
    );
    // Who does not know who signed it does not connect.
    let other = Authority::new();
    assert!(ask(&daemon, &other, None, "/healthz").await.is_none());
    let reload = async || daemon.app.reload(parsed(&text(&daemon.folder, &section(&files, None)))).await;
    fs::write(&files.0, "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n").expect("written");
    let refused = reload().await.expect_err("no certificate").to_string();
    assert!(refused.contains("[server.tls]"), "{refused}");
    assert!(ask(&daemon, &ca, None, "/healthz").await.is_some(), "the old one stays");
    other.sign(&place, "server", ExtendedKeyUsagePurpose::ServerAuth);
    reload().await.expect("another certificate");
    assert!(ask(&daemon, &ca, None, "/healthz").await.is_none());
    assert_eq!(ask(&daemon, &other, None, "/healthz").await.expect("a connection").status, 200);
}

#[tokio::test]
async fn without_a_client_certificate_nobody_gets_in_where_one_is_asked_for() {
    let (place, ca, strange) = (folder("mtls-files"), Authority::new(), Authority::new());
    let server = ca.sign(&place, "server", ExtendedKeyUsagePurpose::ServerAuth);
    let own = ca.sign(&place, "client", ExtendedKeyUsagePurpose::ClientAuth);
    let forged = strange.sign(&place, "forged", ExtendedKeyUsagePurpose::ClientAuth);
    let ca_file = place.join("ca.pem");
    fs::write(&ca_file, &ca.pem).expect("written");
    let daemon = daemon_with("mtls", &section(&server, Some(&ca_file)), |_| {}).await;
    assert!(ask(&daemon, &ca, None, "/healthz").await.is_none());
    assert!(ask(&daemon, &ca, Some(&forged), "/healthz").await.is_none());
    assert_eq!(ask(&daemon, &ca, Some(&own), "/api/v1/loops").await.expect("a connection").status, 200);
}
