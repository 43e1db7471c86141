//! How a broker is reached: address, TLS, identity. Secrets are read at every connect and never shown.

use crate::host::{host_and_port, shown};
use rumqttc::{MqttOptions, Transport};
use std::fs;
use std::path::{Path, PathBuf};

/// Longest secret or certificate file read (bytes).
const MAX_FILE: u64 = 1 << 20;
/// Longest topic (bytes); the protocol allows 65535.
const MAX_TOPIC: usize = 1024;

/// One broker and who asks it.
#[derive(Clone, Debug, PartialEq)]
pub struct Broker {
    /// `host:port`.
    pub address: String,
    /// The client's name at the broker.
    pub client_id: String,
    /// Longest silence before the client asks for a sign of life (s).
    pub keep_alive_s: u16,
    /// Whether the broker forgets the client between two connections.
    pub clean_session: bool,
    /// Whether the connection is encrypted; with `ca_file` it always is.
    pub tls: bool,
    /// The certificates trusted (PEM); the system's where there is none.
    pub ca_file: Option<PathBuf>,
    /// The client's own certificate (PEM) and key.
    pub certificate: Option<(PathBuf, PathBuf)>,
    /// User name and where the password is found.
    pub login: Option<(String, Password)>,
    /// Largest message taken (bytes).
    pub max_bytes: usize,
}

/// Where a password is found.
#[derive(Clone, Debug, PartialEq)]
pub enum Password {
    /// In the first line of a file.
    File(PathBuf),
    /// In an environment variable.
    Env(String),
}

/// Why no connection can be tried.
#[derive(Debug, thiserror::Error)]
pub enum BrokerError {
    /// A file that is needed.
    #[error("{}: {why}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why not.
        why: String,
    },
    /// An environment variable that is needed.
    #[error("the environment variable {0} is not set")]
    Env(String),
    /// The address or the client's name.
    #[error("{0}")]
    Options(String),
}

impl Broker {
    /// Everything wrong with it, by the field of the file.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut issues = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                issues.push((field, message));
            }
        };
        if let Err(why) = host_and_port(&self.address) {
            let secure = ["mqtts://", "ssl://"].into_iter().find(|own| self.address.starts_with(*own));
            let (port, why) = match secure {
                Some(scheme) => (8883, format!("leave out {scheme} and write tls = true")),
                None => (1883, why.to_string()),
            };
            unless(
                false,
                "address",
                format!("'{}' is not host:port, such as 10.0.0.5:{port}: {why}", shown(&self.address)),
            );
        }
        let named = (1..=128).contains(&self.client_id.len()) && !self.client_id.contains(char::is_control);
        unless(named, "client_id", "must be 1 to 128 bytes".into());
        let ok = (1..=3600).contains(&self.keep_alive_s);
        unless(ok, "keep_alive_s", "must be 1 to 3600".into());
        let ok = self.certificate.is_none() || self.ca_file.is_some();
        unless(ok, "certificate_file", "needs ca_file too".into());
        issues
    }

    /// What the client needs to connect; reads the secrets.
    ///
    /// # Errors
    /// [`BrokerError`].
    pub fn options(&self) -> Result<MqttOptions, BrokerError> {
        let (host, port) = host_and_port(&self.address).map_err(|why| {
            BrokerError::Options(format!("'{}' is not host:port: {why}", shown(&self.address)))
        })?;
        let mut options = MqttOptions::new(self.client_id.clone(), (host, port));
        options.set_keep_alive(self.keep_alive_s);
        options
            .try_set_clean_session(self.clean_session)
            .map_err(|error| BrokerError::Options(error.to_string()))?;
        options.set_max_packet_size(self.max_bytes, self.max_bytes);
        if let Some((user, password)) = &self.login {
            options.set_credentials(user.clone(), password.read()?);
        }
        if self.tls || self.ca_file.is_some() {
            options.set_transport(self.transport()?);
        }
        Ok(options)
    }

    fn transport(&self) -> Result<Transport, BrokerError> {
        let Some(ca) = &self.ca_file else {
            let tls = rumqttc::TlsConfiguration::try_default_rustls()
                .map_err(|error| BrokerError::Options(format!("the system's certificates: {error}")))?;
            return Ok(Transport::tls_with_config(tls));
        };
        let own = match &self.certificate {
            Some((certificate, key)) => Some((read(certificate)?, read(key)?)),
            None => None,
        };
        Ok(Transport::tls(read(ca)?, own, None))
    }
}

impl Password {
    fn read(&self) -> Result<String, BrokerError> {
        match self {
            Password::Env(name) => std::env::var(name).map_err(|_| BrokerError::Env(name.clone())),
            Password::File(path) => {
                let bytes = read(path)?;
                let text = String::from_utf8(bytes)
                    .map_err(|_| BrokerError::File { path: path.clone(), why: "not UTF-8 text".into() })?;
                Ok(text.lines().next().unwrap_or_default().to_string())
            }
        }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, BrokerError> {
    let wrong = |why: String| BrokerError::File { path: path.into(), why };
    let size = fs::metadata(path).map_err(|error| wrong(error.to_string()))?.len();
    if size > MAX_FILE {
        return Err(wrong(format!("larger than {MAX_FILE} bytes")));
    }
    fs::read(path).map_err(|error| wrong(error.to_string()))
}

/// What is wrong with a topic that is to be published or subscribed as such, without wildcards.
pub fn topic_fault(topic: &str) -> Option<&'static str> {
    if topic.is_empty() || topic.len() > MAX_TOPIC {
        return Some("must be 1 to 1024 bytes");
    }
    if topic.contains(['+', '#']) {
        return Some("must name one topic, without + and #");
    }
    if topic.trim() != topic {
        return Some("has a blank before or after it, which is part of the topic's name");
    }
    topic.contains(char::is_control).then_some("must not contain control characters")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_text_is_a_topic_with_a_wildcard(text in "[a-z/+#\\x00-\\x1f]{0,30}") {
            if topic_fault(&text).is_none() {
                prop_assert!(!text.is_empty() && !text.contains(['+', '#', '\0', '\n']));
            }
        }

        #[test]
        fn any_address_is_taken_or_refused(text in ".{0,40}") {
            let _ = host_and_port(&text);
        }
    }
}
