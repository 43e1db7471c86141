//! Until when the certificates of a machine hold, so that a page shows it before a line goes dead.

use crate::collect::opcua::SecurityPolicy;
use crate::config::Config;
use std::path::{Path, PathBuf};
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use x509_cert::Certificate;
use x509_cert::der::Decode;

/// Largest file that is looked at (bytes).
const MOST: u64 = 1 << 20;

/// The certificate of a machine that ends first.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ends {
    /// The section and key that name it.
    pub of: String,
    /// When it ends (s).
    pub until: f64,
}

/// Of the certificates that a configuration names for this machine, the one that ends first; what cannot be read is left out.
pub(super) fn first(config: &Config) -> Option<Ends> {
    let ends = |(of, path): (String, PathBuf)| Some(Ends { of, until: until(&path)? });
    named(config).into_iter().filter_map(ends).min_by(|a, b| a.until.total_cmp(&b.until))
}

/// Every file that holds a certificate of this machine.
fn named(config: &Config) -> Vec<(String, PathBuf)> {
    let mut out = Vec::new();
    let mut put = |of: String, path: Option<&PathBuf>| out.extend(path.map(|path| (of, path.clone())));
    put("[server.tls] cert_file".into(), config.server.tls.as_ref().map(|tls| &tls.cert_file));
    put(
        "[fleet] certificate_file".into(),
        config.fleet.as_ref().and_then(|own| own.certificate_file.as_ref()),
    );
    for broker in &config.mqtt {
        put(format!("[[mqtt]] {} certificate_file", broker.name), broker.certificate_file.as_ref());
    }
    put(
        "[notify.mqtt] certificate_file".into(),
        config.notify.mqtt.as_ref().and_then(|own| own.certificate_file.as_ref()),
    );
    for device in config.opcua.iter().filter(|device| device.security_policy != SecurityPolicy::None) {
        put(format!("[[opcua]] {} user_certificate", device.name), device.user_certificate.as_ref());
        let own = device.pki_dir.as_ref().map(|folder| folder.join("own").join("cert.der"));
        put(format!("[[opcua]] {} pki_dir", device.name), own.as_ref());
    }
    out
}

/// When the certificate in a file ends (s), by PEM's first or as DER.
fn until(path: &Path) -> Option<f64> {
    let small = std::fs::metadata(path).ok()?.len() <= MOST;
    let bytes = small.then(|| std::fs::read(path).ok()).flatten()?;
    // A file may hold the key, too: what is no certificate is passed over.
    let of_pem = CertificateDer::pem_slice_iter(&bytes).find_map(Result::ok);
    let read = Certificate::from_der(of_pem.as_deref().unwrap_or(&bytes)).ok()?;
    Some(read.tbs_certificate.validity.not_after.to_unix_duration().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_certificate_that_ends_first_is_told() {
        let folder = std::env::temp_dir().join(format!("stictiond-certificates-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("writable");
        let write = |name: &str, year: i32| {
            let mut params = rcgen::CertificateParams::new(vec!["localhost".into()]).expect("a name");
            params.not_after = rcgen::date_time_ymd(year, 1, 1);
            let key = rcgen::KeyPair::generate().expect("a key");
            let own = params.self_signed(&key).expect("signs");
            std::fs::write(folder.join(format!("{name}.pem")), own.pem() + &key.serialize_pem())
                .expect("writable");
            std::fs::write(folder.join(format!("{name}.der")), own.der()).expect("writable");
        };
        std::fs::write(folder.join("empty.pem"), "").expect("writable");
        write("web", 2031);
        write("line", 2030);
        // 2030-01-01 and 2031-01-01.
        let [line, web] = [1_893_456_000.0, 1_924_992_000.0];
        for (name, end) in [("web.pem", web), ("web.der", web), ("line.pem", line), ("line.der", line)] {
            assert_eq!(until(&folder.join(name)), Some(end), "{name}");
        }
        assert_eq!((until(&folder.join("none.pem")), until(&folder.join("empty.pem"))), (None, None));
        std::fs::write(folder.join("rubbish.pem"), "-----BEGIN CERTIFICATE-----\nAA==\n").expect("writable");
        assert_eq!(until(&folder.join("rubbish.pem")), None);

        let path = |name: &str| folder.join(name).display().to_string();
        let text = format!(
            "[server]\nlisten = '127.0.0.1:0'\n[server.tls]\ncert_file = {:?}\nkey_file = 'k'\n[fleet]\nservers = ['tls://hub']\n\
             certificate_file = {:?}\nkey_file = 'k'\n",
            path("web.pem"),
            path("line.pem")
        );
        let config = crate::config::parse("stictiond.toml", &text).expect("a configuration");
        assert_eq!(first(&config), Some(Ends { of: "[fleet] certificate_file".into(), until: line }));
        std::fs::remove_dir_all(&folder).expect("writable");
    }
}
