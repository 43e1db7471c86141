//! `stictiond health`: whether a running daemon answers, for containers and supervisors that have no HTTP client.

use super::{Failure, print};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use stictiond::config::{self, Diagnostic};
use tokio_rustls::rustls::client::WebPkiServerVerifier;
use tokio_rustls::rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use tokio_rustls::rustls::crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature};
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use tokio_rustls::rustls::{
    ClientConfig, ClientConnection, DigitallySignedStruct, Error, RootCertStore, SignatureScheme, StreamOwned,
};

/// More of an answer than is looked at.
const MOST_BYTES: u64 = 4096;

#[derive(clap::Args)]
pub struct Args {
    /// Where the daemon listens; default 127.0.0.1:8080, or what --config says
    #[arg(value_name = "HOST:PORT", value_parser = host_and_port)]
    address: Option<String>,
    /// Its configuration: says where it listens, and whether by TLS. Its certificate is not verified, and nothing secret is
    /// told to it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Asks by TLS; certificates, PEM, of who signs the daemon's, which must be for HOST
    #[arg(long, value_name = "FILE")]
    ca_file: Option<PathBuf>,
    /// The certificate to show, PEM, where the daemon wants one
    #[arg(long, value_name = "FILE", requires = "key_file")]
    cert_file: Option<PathBuf>,
    /// Its private key, PEM
    #[arg(long, value_name = "FILE", requires = "cert_file")]
    key_file: Option<PathBuf>,
    /// Longest wait for the connection and for the answer (ms)
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    timeout_ms: u64,
}

fn host_and_port(text: &str) -> Result<String, String> {
    let is =
        text.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    if is { Ok(text.into()) } else { Err("not host:port, such as 127.0.0.1:8080".into()) }
}

/// Asks once.
pub fn run(args: &Args) -> Result<(), Failure> {
    let (server, wrong) = match &args.config {
        Some(path) => match config::server(path) {
            // A file that says nothing any more does not end the daemon either. Whoever gave the address asks there, by TLS only where
            // --ca-file says so: whether the daemon listens by TLS stood in the file. Without an address nobody knows where to ask.
            Err(wrong) if args.address.is_some() => (stictiond::serve::Config::default(), wrong),
            found => found.map_err(Failure::BadConfig)?,
        },
        None => (stictiond::serve::Config::default(), Vec::new()),
    };
    let address = args.address.clone().unwrap_or_else(|| reachable(server.listen).to_string());
    let hint = hint(args);
    let failed = |error: &dyn std::fmt::Display| Failure::Failed(format!("{address}: {error}{hint}"));
    let tls = match args.ca_file.is_some() || server.tls.is_some() {
        true => Some(tls(args).map_err(Failure::BadInput)?),
        false => None,
    };
    let asked = ask(&address, tls, Duration::from_millis(args.timeout_ms));
    let status = asked.map_err(|error| match &args.config {
        // A daemon that answers has refused a wrong file. Where none answers, the file may be why.
        Some(path) if !wrong.is_empty() => {
            let told = format!("no daemon answers at {address}: {error}{hint}");
            let told = Diagnostic::of_file(&path.display().to_string(), told);
            Failure::BadConfig(wrong.into_iter().chain([told]).collect())
        }
        _ => failed(&error),
    })?;
    match status.split_whitespace().nth(1) {
        Some("200") => print("ok\n"),
        _ => Err(failed(&format!("answers {status:?}"))),
    }
}

/// The likeliest reason and the remedy, where the address was read from a file: a daemon reads `[server]` at its start only.
fn hint(args: &Args) -> String {
    match (&args.config, &args.address) {
        (Some(path), None) => {
            let file = path.display();
            format!(
                "; [server] of {file} has this address, but a running daemon keeps the one that it had at its start: restart it, or ask \
                 at the old address with `stictiond health --config {file} HOST:PORT`"
            )
        }
        _ => String::new(),
    }
}

/// Who listens on every address is asked on loopback.
fn reachable(listen: SocketAddr) -> SocketAddr {
    match listen.ip() {
        IpAddr::V4(Ipv4Addr::UNSPECIFIED) => (Ipv4Addr::LOCALHOST, listen.port()).into(),
        IpAddr::V6(Ipv6Addr::UNSPECIFIED) => (Ipv6Addr::LOCALHOST, listen.port()).into(),
        _ => listen,
    }
}

/// The first line of the answer.
fn ask(address: &str, tls: Option<Arc<ClientConfig>>, patience: Duration) -> io::Result<String> {
    // A name may have addresses on which nobody listens, such as ::1 of localhost.
    let mut stream = Err(io::Error::new(io::ErrorKind::NotFound, "the name has no address"));
    for address in address.to_socket_addrs()? {
        stream = TcpStream::connect_timeout(&address, patience);
        if stream.is_ok() {
            break;
        }
    }
    let stream = stream?;
    stream.set_read_timeout(Some(patience))?;
    stream.set_write_timeout(Some(patience))?;
    let Some(tls) = tls else { return first_line(stream, address) };
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host).trim_matches(['[', ']']);
    let name = ServerName::try_from(host.to_string()).map_err(io::Error::other)?;
    let connection = ClientConnection::new(tls, name).map_err(io::Error::other)?;
    first_line(StreamOwned::new(connection, stream), address)
}

fn first_line(mut stream: impl Read + Write, address: &str) -> io::Result<String> {
    write!(stream, "GET /healthz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    stream.flush()?;
    let mut line = Vec::new();
    BufReader::new(stream.take(MOST_BYTES)).read_until(b'\n', &mut line)?;
    Ok(String::from_utf8_lossy(&line).trim_end().to_string())
}

/// How to speak to the daemon by TLS.
fn tls(args: &Args) -> Result<Arc<ClientConfig>, String> {
    let provider = Arc::new(ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider.clone()).with_safe_default_protocol_versions();
    let builder = builder.map_err(|error| error.to_string())?.dangerous();
    let verifier: Arc<dyn ServerCertVerifier> = match &args.ca_file {
        Some(path) => {
            let mut roots = RootCertStore::empty();
            for root in certificates(path)? {
                roots.add(root).map_err(|error| format!("{}: {error}", path.display()))?;
            }
            let built = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider).build();
            built.map_err(|error| format!("{}: {error}", path.display()))?
        }
        None => Arc::new(AnyCertificate(provider)),
    };
    let builder = builder.with_custom_certificate_verifier(verifier);
    let config = match (&args.cert_file, &args.key_file) {
        (Some(certificate), Some(key)) => {
            let pem = PrivateKeyDer::from_pem_file(key);
            let own = pem.map_err(|_| format!("{}: no PEM file with a private key", key.display()))?;
            let pair = builder.with_client_auth_cert(certificates(certificate)?, own);
            pair.map_err(|error| format!("{}: {error}", key.display()))?
        }
        _ => builder.with_no_client_auth(),
    };
    Ok(Arc::new(config))
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let read = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let found = read.unwrap_or_default();
    if found.is_empty() {
        Err(format!("{}: no PEM file with a certificate", path.display()))
    } else {
        Ok(found)
    }
}

/// Takes whatever certificate the daemon shows: it is asked on this machine whether it lives, and its file may have been
/// replaced since it was read. That it has the key to the certificate is checked.
#[derive(Debug)]
struct AnyCertificate(Arc<CryptoProvider>);

impl ServerCertVerifier for AnyCertificate {
    fn verify_server_cert(
        &self,
        _end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls12_signature(message, certificate, signed, &self.0.signature_verification_algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(message, certificate, signed, &self.0.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.0.signature_verification_algorithms.supported_schemes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_listens_everywhere_is_asked_on_loopback() {
        let asked = |listen: &str| reachable(listen.parse().expect("an address")).to_string();
        assert_eq!(asked("0.0.0.0:8080"), "127.0.0.1:8080");
        assert_eq!(asked("[::]:8080"), "[::1]:8080");
        assert_eq!(asked("10.1.2.3:8080"), "10.1.2.3:8080");
    }
}
