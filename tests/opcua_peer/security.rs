//! Certificates, identities and the protection of messages.

use super::rig::{COUNTER, Server, Watch, checked, config_secure, folder, holes, plan, trust};
use opcua::crypto::CertificateStore;
use std::path::Path;

#[tokio::test]
async fn sign_and_encrypt_with_a_user_name_and_explicit_trust() {
    let folder = folder("trust");
    let server = Server::start(&["--secure", folder.to_str().unwrap()]).await;
    std::fs::write(folder.join("password"), "right\n").unwrap();
    std::fs::write(folder.join("wrong"), "wrong\n").unwrap();
    for (policy, pki) in [("Basic256Sha256", "pki"), ("Aes256_Sha256_RsaPss", "pki2")] {
        let pki = folder.join(pki);
        let secure = |password: &str| {
            let more = format!(
                "security_policy = '{policy}'\npki_dir = '{}'\nuser = 'operator'\npassword_file = '{}'\nsampling_ms = 20\n\
                 publishing_ms = 50\nreconnect_max_ms = 500",
                pki.display(),
                folder.join(password).display()
            );
            plan(&config_secure(server.port, &more), &[COUNTER.into()])
        };
        // Without a key of our own nobody is asked.
        let mut watch = Watch::start(secure("password"));
        let line = watch.until_said("own/cert.der").await;
        assert!(line.contains("docs/opcua.md"), "{line}");
        watch.stop().await;

        // The server is not trusted yet: refused, and its certificate laid aside for people to compare.
        trust(&folder, &pki, false);
        let mut watch = Watch::start(secure("password"));
        let line = watch.until_said("is not trusted").await;
        assert!(
            line.contains("rejected") && line.contains("trusted") && line.contains("localhost"),
            "{line}"
        );
        assert!(watch.samples(0).iter().all(|s| !s.quality.is_good()));
        watch.stop().await;

        // People have moved it.
        trust(&folder, &pki, true);
        let mut watch = Watch::start(secure("wrong"));
        let line = watch.until_said("refuses this user or password").await;
        assert!(!line.contains("wrong"), "a secret in the log: {line}");
        watch.stop().await;

        let mut watch = Watch::start(secure("password"));
        let counted = watch.until("60 values", 0, |all| all.len() >= 60).await;
        assert_eq!(holes(&checked(&counted)), []);
        watch.stop().await;
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// The lines of configuration of a session that trusts what is in `pki`.
fn secure(policy: &str, mode: &str, pki: &Path, more: &str) -> String {
    format!(
        "security_policy = '{policy}'\nsecurity_mode = '{mode}'\npki_dir = '{}'\nsampling_ms = 20\npublishing_ms = 50\n\
         reconnect_max_ms = 100\n{more}",
        pki.display()
    )
}

/// As people do after they have compared it: the server's certificate is trusted.
fn trusted(made: &Path, pki: &Path) {
    trust(made, pki, false);
    let theirs = CertificateStore::read_cert(&made.join("server.der")).unwrap();
    let name = CertificateStore::cert_file_name(&theirs);
    std::fs::copy(made.join("server.der"), pki.join("trusted").join(name)).unwrap();
}

#[tokio::test]
async fn signed_only_and_users_by_name_and_by_certificate() {
    let folder = folder("users");
    let server = Server::start(&["--secure", folder.to_str().unwrap()]).await;
    let pki = folder.join("pki");
    trusted(&folder, &pki);
    std::fs::write(folder.join("password"), "right\n").unwrap();
    let by_name = format!("user = 'operator'\npassword_file = '{}'", folder.join("password").display());
    let by_certificate = |who: &str| {
        let file = |end: &str| folder.join(format!("{who}.{end}")).display().to_string();
        format!("user_certificate = '{}'\nuser_key = '{}'", file("der"), file("pem"))
    };
    for (policy, mode, user) in [
        ("Basic256Sha256", "Sign", by_name.clone()),
        ("Basic256Sha256", "SignAndEncrypt", by_certificate("user")),
        ("Aes256_Sha256_RsaPss", "Sign", by_certificate("user")),
    ] {
        let config = config_secure(server.port, &secure(policy, mode, &pki, &user));
        let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
        let counted = watch.until("20 values", 0, |all| all.len() >= 20).await;
        assert_eq!(holes(&checked(&counted)), [], "{policy} {mode}");
        watch.stop().await;
    }
    for (user, why) in [(by_certificate("stranger"), "refuses this user"), (String::new(), "nobody's name")] {
        let config = config_secure(server.port, &secure("Basic256Sha256", "SignAndEncrypt", &pki, &user));
        let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
        watch.until_said(why).await;
        let health = watch.until_health("counted", |health| health.security_errors > 1).await;
        assert_eq!((health.good_samples, health.link_errors), (0, 0), "{health:?}");
        watch.stop().await;
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[tokio::test]
async fn an_impostor_and_an_expired_certificate_are_refused_with_one_clear_line() {
    let (first, other, expired) = (folder("first"), folder("other"), folder("expired"));
    let text = |folder: &Path| folder.to_str().unwrap().to_string();
    // The certificates of a server that was here yesterday: trusted, and not those of the one that answers today.
    drop(Server::start(&["--secure", &text(&first)]).await);
    for (made, trusts, more, said) in [
        (&other, &first, &[][..], "is not trusted by us"),
        (&expired, &expired, &["--expired"][..], "has expired"),
    ] {
        let made_in = text(made);
        let server = Server::start(&[&["--secure", &made_in], more].concat()).await;
        let pki = made.join("pki");
        trusted(trusts, &pki);
        std::fs::write(made.join("password"), "right\n").unwrap();
        let user = format!("user = 'operator'\npassword_file = '{}'", made.join("password").display());
        let config = config_secure(server.port, &secure("Basic256Sha256", "SignAndEncrypt", &pki, &user));
        let mut watch = Watch::start(plan(&config, &[COUNTER.into()]));
        watch.until_said(said).await;
        let health = watch.until_health("tried again", |health| health.security_errors > 2).await;
        assert!(!health.connected && health.reconnects == 0, "{health:?}");
        assert_eq!(watch.samples(0), [], "a sample from nowhere");
        assert_eq!(watch.warnings().len(), 1, "{:#?}", watch.warnings());
        watch.stop().await;
    }
    for folder in [first, other, expired] {
        std::fs::remove_dir_all(folder).unwrap();
    }
}
