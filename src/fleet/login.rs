//! Who this machine is to a NATS server, as the configuration says; its files are read here.

use super::config::Config;
use async_nats::ConnectOptions;
use std::fs;
use std::path::Path;

/// What a connection begins with.
///
/// # Errors
/// Which file cannot be used, and why.
pub(super) fn options(config: &Config) -> Result<ConnectOptions, String> {
    let mut options = ConnectOptions::new();
    if let Some(file) = &config.credentials_file {
        options = options
            .credentials(&secret("credentials_file", file)?)
            .map_err(|error| format!("credentials_file {}: {error}", file.display()))?;
    }
    if let Some(file) = &config.nkey_file {
        options = options.nkey(secret("nkey_file", file)?.trim().to_string());
    }
    if let Some((user, file)) = config.user.as_ref().zip(config.password_file.as_ref()) {
        let password = secret("password_file", file)?;
        options =
            options.user_and_password(user.clone(), password.trim_end_matches(['\r', '\n']).to_string());
    }
    if let Some(file) = &config.ca_file {
        options = options.add_root_certificates(file.clone());
    }
    if let Some((certificate, key)) = config.certificate_file.as_ref().zip(config.key_file.as_ref()) {
        options = options.add_client_certificate(certificate.clone(), key.clone());
    }
    let tls = config.servers.iter().all(|server| server.starts_with("tls://"));
    Ok(options.require_tls(tls))
}

fn secret(field: &str, file: &Path) -> Result<String, String> {
    fs::read_to_string(file).map_err(|error| format!("{field} {}: {error}", file.display()))
}
