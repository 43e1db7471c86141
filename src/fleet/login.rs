//! Who this machine is to a NATS server, and how it talks to one, as the configuration says; its files are read here.

use super::config::Config;
use async_nats::ConnectOptions;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// Messages that the client holds for the socket; what does not fit waits.
const BUFFERED: usize = 256;
/// Messages that a subscription holds for us.
const SUBSCRIBED: usize = 1024;
/// How often a server asks whether we are there, and we whether it is.
const PING: Duration = Duration::from_secs(5);
/// Longest pause between two attempts to connect.
const MAX_PAUSE: Duration = Duration::from_secs(5);
/// Longest time until a connection stands. The relay gives up before, and knows why.
const CONNECT: Duration = Duration::from_secs(15);

/// What a connection begins with.
///
/// # Errors
/// Which file cannot be used, and why.
pub(super) fn options(config: &Config) -> Result<ConnectOptions, String> {
    let mut options = ConnectOptions::new()
        .retry_on_initial_connect()
        // The relay knows all of them.
        .ignore_discovered_servers()
        .client_capacity(BUFFERED)
        .subscription_capacity(SUBSCRIBED)
        .ping_interval(PING)
        .connection_timeout(CONNECT)
        .reconnect_delay_callback(|attempt| {
            Duration::from_millis(100 * 2u64.saturating_pow(attempt.min(10) as u32)).min(MAX_PAUSE)
        });
    if let Some(file) = &config.credentials_file {
        options = options
            .credentials(&secret("credentials_file", file)?)
            .map_err(|error| format!("credentials_file {}: {error}", file.display()))?;
    }
    if let Some(file) = &config.nkey_file {
        options = options.nkey(secret("nkey_file", file)?.trim().to_string());
    }
    if let Some((user, password)) = config.user.as_ref().zip(password(config)?) {
        options = options.user_and_password(user.clone(), password);
    }
    Ok(options)
}

/// The user's password, where there is one.
///
/// # Errors
/// Which file cannot be used, and why.
pub(super) fn password(config: &Config) -> Result<Option<String>, String> {
    let Some(file) = &config.password_file else { return Ok(None) };
    let password = secret("password_file", file)?;
    Ok(Some(password.trim_end_matches(['\r', '\n']).to_string()))
}

/// How a connection is encrypted. The files are read for each, because certificates are replaced while we run.
///
/// # Errors
/// Which file cannot be used, and why.
pub(super) fn tls(config: &Config) -> Result<ClientConfig, String> {
    let mut roots = RootCertStore::empty();
    match &config.ca_file {
        Some(file) => {
            for certificate in certificates("ca_file", file)? {
                let added = roots.add(certificate);
                added.map_err(|error| format!("ca_file {}: {error}", file.display()))?;
            }
        }
        // A system may have certificates that nobody can read; those that can be are enough.
        None => {
            let _ = roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
        }
    }
    if roots.is_empty() {
        return Err("no certificate is trusted: set ca_file".into());
    }
    let begun = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| error.to_string())?
        .with_root_certificates(roots);
    let Some((certificate, key)) = config.certificate_file.as_ref().zip(config.key_file.as_ref()) else {
        return Ok(begun.with_no_client_auth());
    };
    // The error may show what was read, which may be a piece of the key.
    let own = PrivateKeyDer::from_pem_file(key)
        .map_err(|_| format!("key_file {}: no private key (PEM) can be read from it", key.display()))?;
    let begun = begun.with_client_auth_cert(certificates("certificate_file", certificate)?, own);
    begun.map_err(|error| format!("certificate_file {}: {error}", certificate.display()))
}

/// The certificates of a file.
fn certificates(field: &str, file: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let read = CertificateDer::pem_file_iter(file).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    match read {
        Ok(found) if !found.is_empty() => Ok(found),
        _ => Err(format!("{field} {}: no certificates (PEM) can be read from it", file.display())),
    }
}

fn secret(field: &str, file: &Path) -> Result<String, String> {
    fs::read_to_string(file).map_err(|error| format!("{field} {}: {error}", file.display()))
}
