//! Who we are to a server and whether it is the right one: identity, certificates, and errors in plain words.

use super::config::{Config, SecurityMode, SecurityPolicy};
use opcua::client::IdentityToken;
use opcua::crypto::CertificateStore;
use opcua::types::{MessageSecurityMode, StatusCode};
use std::path::Path;

/// Most bytes read of a password file.
const MAX_PASSWORD: usize = 4096;

/// The name of the policy in endpoint descriptions.
pub(super) fn policy_uri(policy: SecurityPolicy) -> &'static str {
    match policy {
        SecurityPolicy::None => "http://opcfoundation.org/UA/SecurityPolicy#None",
        SecurityPolicy::Basic256Sha256 => "http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256",
        SecurityPolicy::Aes256Sha256RsaPss => {
            "http://opcfoundation.org/UA/SecurityPolicy#Aes256_Sha256_RsaPss"
        }
    }
}

pub(super) fn message_mode(mode: SecurityMode) -> MessageSecurityMode {
    match mode {
        SecurityMode::None => MessageSecurityMode::None,
        SecurityMode::Sign => MessageSecurityMode::Sign,
        SecurityMode::SignAndEncrypt => MessageSecurityMode::SignAndEncrypt,
    }
}

/// The identity of the session. Secrets are read at every connect, so that a changed password needs no restart.
pub(super) fn identity(config: &Config) -> Result<IdentityToken, String> {
    if let Some(user) = &config.user {
        return Ok(IdentityToken::new_user_name(user.clone(), password(config)?));
    }
    if let (Some(certificate), Some(key)) = (&config.user_certificate, &config.user_key) {
        return IdentityToken::new_x509_path(certificate, key)
            .map_err(|error| format!("user_certificate, user_key: {error}"));
    }
    Ok(IdentityToken::Anonymous)
}

fn password(config: &Config) -> Result<String, String> {
    if let Some(variable) = &config.password_env {
        return std::env::var(variable).map_err(|error| format!("password_env {variable}: {error}"));
    }
    let Some(path) = &config.password_file else { return Ok(String::new()) };
    let wrong = |why: String| format!("password_file {}: {why}", path.display());
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    if text.len() > MAX_PASSWORD {
        return Err(wrong(format!("longer than {MAX_PASSWORD} bytes")));
    }
    Ok(text.lines().next().unwrap_or_default().to_string())
}

/// Looks for our own certificate and key before anybody is asked, where the policy needs them.
pub(super) fn own_files(config: &Config) -> Result<(), String> {
    let Some(folder) = config.pki_dir.as_deref().filter(|_| config.security_policy != SecurityPolicy::None)
    else {
        return Ok(());
    };
    let readable = |name: &str, read: &dyn Fn(&Path) -> Result<(), String>| {
        let path = folder.join(name);
        read(&path).map_err(|why| format!("{}: {why}; docs/opcua.md says how to make it", path.display()))
    };
    readable("own/cert.der", &|path| CertificateStore::read_cert(path).map(drop))?;
    readable("private/private.pem", &|path| CertificateStore::read_pkey(path).map(drop))
}

/// What can be done about a status that prevented a session; `None` when that has nothing to do with security.
pub(super) fn explain(status: StatusCode, config: &Config) -> Option<String> {
    let folder = config.pki_dir.as_deref().unwrap_or(Path::new("pki_dir")).display();
    let hint = if status == StatusCode::BadCertificateUntrusted
        || status == StatusCode::BadSecurityChecksFailed
    {
        format!(
            "the certificate of {} is not trusted by us, or ours not by it: compare the server's, which is in \
             {folder}/rejected, with the one it should have and move it to {folder}/trusted; have {folder}/own/cert.der \
             trusted there",
            config.url
        )
    } else if status == StatusCode::BadCertificateTimeInvalid {
        "a certificate has expired or is not valid yet, or a clock is wrong".into()
    } else if status == StatusCode::BadCertificateHostNameInvalid {
        "the host in url is none of those in the server's certificate: write one that is; its alternative names have \
         to begin with the application URI"
            .into()
    } else if status == StatusCode::BadCertificateUriInvalid {
        "the application URI is not the one in the certificate: see application_uri".into()
    } else if status == StatusCode::BadUserAccessDenied || status == StatusCode::BadIdentityTokenRejected {
        "the server refuses this user or password".into()
    } else if status == StatusCode::BadIdentityTokenInvalid {
        "the server does not accept this kind of identity".into()
    } else if status == StatusCode::BadTcpEndpointUrlInvalid
        || status == StatusCode::BadSecurityPolicyRejected
    {
        let identity = match (&config.user, &config.user_certificate) {
            (Some(_), _) => "a user name",
            (None, Some(_)) => "a user's certificate",
            (None, None) => "nobody's name: see user and user_certificate",
        };
        format!(
            "the server has no endpoint at this url with {:?} and {:?} that takes {identity}",
            config.security_policy,
            config.effective_mode()
        )
    } else {
        return None;
    };
    Some(format!("{status}: {hint}"))
}
