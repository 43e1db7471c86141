//! Who this machine is to a NATS server, and how it talks to one, as the configuration says; its files are read here.

use super::config::Config;
use async_nats::ConnectOptions;
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use nkeys::KeyPair;
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

/// What a connection begins with. What lets the client in is added to each connection by the relay ([`proof`]).
///
/// # Errors
/// Which file cannot be used, and why.
pub(super) fn options(config: &Config) -> Result<ConnectOptions, String> {
    // What cannot be used is told at the start.
    proof(config, "")?;
    let options = ConnectOptions::new()
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
    Ok(match &config.user {
        Some(user) => options.user_and_password(user.clone(), String::new()),
        None => options,
    })
}

/// What lets this machine in, by the names that the protocol gives its fields, as the files have it now: they are replaced while we
/// run. A server has its `nonce` signed.
///
/// # Errors
/// Which file cannot be used, and why.
pub(super) fn proof(config: &Config, nonce: &str) -> Result<Vec<(&'static str, String)>, String> {
    let mut fields = Vec::new();
    if let Some(file) = &config.credentials_file {
        let text = secret("credentials_file", file)?;
        let none = || format!("credentials_file {}: no JWT and seed can be read from it", file.display());
        let (jwt, seed) = jwt_and_seed(&text).ok_or_else(none)?;
        let key = key("credentials_file", file, seed)?;
        fields.extend([("jwt", jwt.to_string()), ("sig", signature(&key, nonce)?)]);
    }
    if let Some(file) = &config.nkey_file {
        let key = key("nkey_file", file, secret("nkey_file", file)?.trim())?;
        fields.extend([("nkey", key.public_key()), ("sig", signature(&key, nonce)?)]);
    }
    if let Some(file) = &config.password_file {
        let password = secret("password_file", file)?;
        fields.push(("pass", password.trim_end_matches(['\r', '\n']).to_string()));
    }
    Ok(fields)
}

/// The JWT and the seed of a file of credentials. Each stands alone between a line `-----BEGIN …-----` and one
/// `------END …------`.
fn jwt_and_seed(text: &str) -> Option<(&str, &str)> {
    let is_rule = |line: &str| line.starts_with("---") && line.ends_with("---");
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let mut framed = lines.windows(3).filter_map(|three| match three {
        [begin, own, end] if is_rule(begin) && begin.contains("BEGIN") && is_rule(end) => Some(*own),
        _ => None,
    });
    framed.next().zip(framed.next())
}

/// The key pair of a seed. The library's error may show what was read, which may be a piece of the seed.
fn key(field: &str, file: &Path, seed: &str) -> Result<KeyPair, String> {
    KeyPair::from_seed(seed)
        .map_err(|_| format!("{field} {}: no seed of an nkey can be read from it", file.display()))
}

/// A server's nonce, signed, as the protocol writes it.
fn signature(key: &KeyPair, nonce: &str) -> Result<String, String> {
    let signed = key.sign(nonce.as_bytes()).map_err(|error| format!("no signature: {error}"))?;
    Ok(URL_SAFE_NO_PAD.encode(signed))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn credentials_have_a_jwt_and_a_seed() {
        let made = "-----BEGIN NATS USER JWT-----\r\neyJ0.a-_b\r\n------END NATS USER JWT------\r\n\r\n\
                    ***** IMPORTANT *****\r\nNKEY Seed printed below\r\n\r\n\
                    -----BEGIN USER NKEY SEED-----\r\nSUAX\r\n------END USER NKEY SEED------\r\n";
        assert_eq!(jwt_and_seed(made), Some(("eyJ0.a-_b", "SUAX")));
        assert_eq!(jwt_and_seed(&made.replace("\r\n", "\n")), Some(("eyJ0.a-_b", "SUAX")));
        let (jwt, _) = made.split_at(made.find("*****").expect("it is there"));
        for none in [jwt, "SUAX", ""] {
            assert_eq!(jwt_and_seed(none), None, "{none}");
        }
    }

    #[test]
    fn a_file_without_a_seed_is_named_at_the_start_and_not_shown() {
        let file = std::env::temp_dir().join(format!("stictiond-login-{}", std::process::id()));
        let seed = KeyPair::new_user().seed().expect("it is new");
        for field in ["nkey_file", "credentials_file"] {
            let config: Config =
                toml::from_str(&format!("servers = ['nats://hub']\n{field} = {file:?}\n")).expect("readable");
            fs::write(&file, &seed[1..]).expect("writable");
            let error = options(&config).expect_err("half a seed");
            assert!(error.starts_with(&format!("{field} {}: no ", file.display())), "{error}");
            assert!(!error.contains(&seed[1..]), "{error}");
        }
        fs::remove_file(file).expect("there");
    }
}
