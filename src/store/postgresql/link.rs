//! A connection to PostgreSQL: who asks, encrypted or not, and nothing that waits for ever.

use super::super::{Config, StoreError};
use super::client::{Ask, Client};
use super::wire::{Clear, Within};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio_postgres::config::{Host, SslMode, SslNegotiation};
use tokio_postgres_rustls::MakeRustlsConnect;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// Longest wait for a connection, for each address of the host.
const CONNECT: Duration = Duration::from_secs(5);
/// Longest wait for a sign of life of one that was made.
const SILENCE: Duration = Duration::from_secs(15);
/// Longest wait for a lock (s).
const LOCK_S: u32 = 10;
/// Longest wait for an answer to a write, which is of a bounded size.
pub(super) const WRITES: Duration = Duration::from_secs(15);
/// Longest wait for an answer to what may look at all there is.
pub(super) const READS: Duration = Duration::from_secs(120);

/// Connects, and waits for at most `patience` for any answer; the schema's tables are found by their plain names then, and what an extension has put into `public`.
///
/// # Errors
/// [`StoreError::Away`].
pub(super) fn connect(config: &Config, patience: Duration) -> Result<Client, StoreError> {
    let away = |why: String| StoreError::Away(why);
    let url = config.url.as_deref().unwrap_or_default();
    // The error of the parser may repeat the address.
    let mut options: tokio_postgres::Config =
        url.parse().map_err(|_| away("[store] url is no address".into()))?;
    options.connect_timeout(CONNECT).tcp_user_timeout(SILENCE).keepalives_idle(SILENCE);
    options.application_name("stictiond");
    if let Some(password) = password(config)? {
        options.password(password);
    }
    let mut client = match &config.ca_file {
        Some(ca) => Client::connect(options.ssl_mode(SslMode::Require), Within(encrypted(ca)?), patience)?,
        None if options.get_hosts().iter().all(|host| matches!(host, Host::Unix(_))) => {
            Client::connect_here(options.ssl_mode(SslMode::Disable), patience)?
        }
        // Not encrypted: what the library takes for it is the socket itself, counted.
        None => {
            options.ssl_mode(SslMode::Require).ssl_negotiation(SslNegotiation::Direct);
            Client::connect(&options, Clear, patience)?
        }
    };
    client
        .batch_execute(&format!(
            "SET search_path TO \"{}\", public; SET synchronous_commit TO on; SET TimeZone TO 'UTC';
             SET client_min_messages TO warning; SET lock_timeout TO '{LOCK_S}s';
             SET tcp_keepalives_idle TO 15; SET tcp_keepalives_interval TO 5; SET tcp_keepalives_count TO 3;
             SET tcp_user_timeout TO '15s';",
            config.schema
        ))
        .map_err(|error| match error {
            StoreError::Refused(error) => away(said(&error)),
            error => error,
        })?;
    Ok(client)
}

fn password(config: &Config) -> Result<Option<String>, StoreError> {
    if let Some(name) = &config.password_env {
        let missing = |_| StoreError::Away(format!("the environment variable {name} is not set"));
        return std::env::var(name).map(Some).map_err(missing);
    }
    let Some(path) = &config.password_file else { return Ok(None) };
    let text = std::fs::read_to_string(path).map_err(StoreError::io(path))?;
    Ok(Some(text.lines().next().unwrap_or_default().to_string()))
}

fn encrypted(ca: &Path) -> Result<MakeRustlsConnect, StoreError> {
    let wrong = |why: String| StoreError::Away(format!("[store] ca_file = {}: {why}", ca.display()));
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_file_iter(ca).map_err(|error| wrong(error.to_string()))? {
        let certificate = certificate.map_err(|error| wrong(error.to_string()))?;
        roots.add(certificate).map_err(|error| wrong(error.to_string()))?;
    }
    if roots.is_empty() {
        return Err(wrong("no certificate is in it".into()));
    }
    let tls = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| wrong(error.to_string()))?
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(MakeRustlsConnect::new(tls))
}

/// What an error says, with its cause: that of the library alone says only that there was one.
pub fn said(error: &tokio_postgres::Error) -> String {
    if let Some(told) = error.as_db_error() {
        return format!("{} ({})", told.message(), told.code().code());
    }
    match error.source() {
        Some(source) => format!("{error}: {source}"),
        None => error.to_string(),
    }
}
