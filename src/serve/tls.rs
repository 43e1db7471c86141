//! `[server.tls]`: certificates by rustls. A reload reads the files again; connections that are open keep the old ones.

use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::client::verify_server_name;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::server::ParsedCertificate;
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{RootCertStore, ServerConfig};

/// `[server.tls]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The server's certificate and those between it and a root, PEM.
    pub cert_file: PathBuf,
    /// Its private key, PEM.
    pub key_file: PathBuf,
    /// Certificates, PEM, of who signs clients' certificates: then only clients that show one get in.
    #[serde(default)]
    pub client_ca_file: Option<PathBuf>,
}

/// Why there is no TLS.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read, or holds nothing of the kind.
    #[error("[server.tls] {key} = {}: {why}", path.display())]
    File {
        /// The key that names it.
        key: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// Certificate and key cannot be used together.
    #[error("[server.tls] certificate and key cannot be used: {0}")]
    Pair(String),
}

/// The certificates in force.
pub struct Tls {
    config: Config,
    current: RwLock<InForce>,
}

/// What the next connection is given.
#[derive(Clone)]
struct InForce {
    server: Arc<ServerConfig>,
    /// The daemon's own certificate, which says what it is called.
    own: CertificateDer<'static>,
}

impl Tls {
    /// Reads the files.
    ///
    /// # Errors
    /// [`TlsError`].
    pub fn load(config: &Config) -> Result<Self, TlsError> {
        let current = RwLock::new(server(config)?);
        Ok(Self { config: config.clone(), current })
    }

    /// Reads the same files again.
    ///
    /// # Errors
    /// [`TlsError`]; then what was in force stays.
    pub fn reload(&self) -> Result<(), TlsError> {
        let new = server(&self.config)?;
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = new;
        Ok(())
    }

    /// For the next connection.
    pub fn acceptor(&self) -> TlsAcceptor {
        self.in_force().server.into()
    }

    /// Whether the certificate in force is for a host of this name: a browser has made sure that it is.
    pub(super) fn carries(&self, name: &str) -> bool {
        let own = self.in_force().own;
        let (Ok(name), Ok(own)) = (ServerName::try_from(name), ParsedCertificate::try_from(&own)) else {
            return false;
        };
        verify_server_name(&own, &name).is_ok()
    }

    fn in_force(&self) -> InForce {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn server(config: &Config) -> Result<InForce, TlsError> {
    let certificates = certificates("cert_file", &config.cert_file)?;
    let own = certificates.first().cloned();
    let own = own.ok_or_else(|| refused("cert_file", &config.cert_file, &"there is no certificate in it"))?;
    let key = PrivateKeyDer::from_pem_file(&config.key_file)
        .map_err(|error| unusable("key_file", &config.key_file, error, "private key"))?;
    let provider = Arc::new(ring::default_provider());
    let pair = |error: &dyn std::fmt::Display| TlsError::Pair(error.to_string());
    let begun = ServerConfig::builder_with_provider(provider.clone()).with_safe_default_protocol_versions();
    let begun = begun.map_err(|error| pair(&error))?;
    let begun = match &config.client_ca_file {
        None => begun.with_no_client_auth(),
        Some(path) => {
            let mut roots = RootCertStore::empty();
            for certificate in self::certificates("client_ca_file", path)? {
                roots.add(certificate).map_err(|error| refused("client_ca_file", path, &error))?;
            }
            let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider).build();
            begun
                .with_client_cert_verifier(verifier.map_err(|error| refused("client_ca_file", path, &error))?)
        }
    };
    let mut server = begun.with_single_cert(certificates, key).map_err(|error| pair(&error))?;
    server.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(InForce { server: Arc::new(server), own })
}

fn certificates(key: &'static str, path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let read = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    match read {
        Ok(found) if found.is_empty() => Err(refused(key, path, &"there is no certificate in it")),
        Ok(found) => Ok(found),
        Err(error) => Err(unusable(key, path, error, "certificate")),
    }
}

fn unusable(key: &'static str, path: &Path, error: pem::Error, what: &str) -> TlsError {
    let why = match error {
        pem::Error::Io(error) => error.to_string(),
        pem::Error::NoItemsFound => format!("there is no {what} in it"),
        // Of other errors rustls shows what it read, which may be a piece of a key.
        _ => format!("it is no PEM file with a {what}"),
    };
    refused(key, path, &why)
}

fn refused(key: &'static str, path: &Path, why: &dyn std::fmt::Display) -> TlsError {
    TlsError::File { key, path: path.to_path_buf(), why: why.to_string() }
}
