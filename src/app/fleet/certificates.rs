//! Until when the certificates of a machine hold, so that a page shows it before a line goes dead.

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
    /// The section, or the device or broker, and the key that names it.
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
    let of_web =
        config.server.tls.as_ref().map(|tls| ("[server.tls] cert_file".into(), tls.cert_file.clone()));
    let certificate = |(whose, key, path): (String, &'static str, Option<PathBuf>)| {
        let path = match key {
            "certificate_file" | "user_certificate" => path?,
            "pki_dir" => path?.join("own").join("cert.der"),
            _ => return None,
        };
        Some((format!("{whose} {key}"), path))
    };
    of_web.into_iter().chain(config.files().into_iter().filter_map(certificate)).collect()
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
