//! By TLS against mosquitto, which asks for a certificate of ours: both are let in by who signed them, and by nothing else.

use super::publishing::Daemon;
use super::rig::{Broker, Log, Watch, free_port};
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use std::path::PathBuf;
use std::sync::atomic::Ordering::SeqCst;
use stictiond::signal::Sample;

/// An authority, and what it has signed, as files.
struct Authority {
    folder: PathBuf,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    fn new(folder: PathBuf) -> Self {
        let mut params = CertificateParams::new(Vec::new()).expect("no names");
        params.distinguished_name.push(DnType::CommonName, folder.display().to_string());
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().expect("a key");
        let own = params.self_signed(&key).expect("signs");
        std::fs::create_dir_all(&folder).expect("writable");
        std::fs::write(folder.join("ca.pem"), own.pem()).expect("writable");
        Self { folder, issuer: Issuer::new(params, key) }
    }

    /// A certificate and its key for a name, good until the end of a year.
    fn sign(&self, name: &str, file: &str, until: i32) {
        let key = KeyPair::generate().expect("a key");
        let mut own = CertificateParams::new(vec![name.to_string()]).expect("a name");
        own.distinguished_name.push(DnType::CommonName, name);
        own.not_after = rcgen::date_time_ymd(until, 12, 31);
        let signed = own.signed_by(&key, &self.issuer).expect("signs");
        std::fs::write(self.folder.join(format!("{file}.pem")), signed.pem()).expect("writable");
        std::fs::write(self.folder.join(format!("{file}.key")), key.serialize_pem()).expect("writable");
    }

    fn path(&self, file: &str) -> String {
        self.folder.join(file).display().to_string()
    }
}

/// A year that is not yet over.
const FAR: i32 = 4000;

/// A broker that asks for certificates, the authority of both sides, and another one that nobody trusts.
async fn world(name: &str, server: &str, until: i32) -> (Broker, Authority, Authority) {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/tmp/mqtt").join(name);
    let (ours, theirs) = (Authority::new(folder.join("ours")), Authority::new(folder.join("theirs")));
    ours.sign(server, "server", until);
    ours.sign("stictiond", "client", FAR);
    theirs.sign("stictiond", "client", FAR);
    let [ca, certificate, key] = ["ca.pem", "server.pem", "server.key"].map(|file| ours.path(file));
    let more = format!(
        "allow_anonymous true\ncafile {ca}\ncertfile {certificate}\nkeyfile {key}\nrequire_certificate true\n\
         use_identity_as_username true\nuser root"
    );
    (Broker::with(name, free_port().await, &more).await, ours, theirs)
}

fn lines(ca: &Authority, own: Option<&Authority>) -> String {
    let mut lines = format!("ca_file = '{}'\n", ca.path("ca.pem"));
    if let Some(own) = own {
        let [certificate, key] = ["client.pem", "client.key"].map(|file| own.path(file));
        lines += &format!("certificate_file = '{certificate}'\nkey_file = '{key}'\n");
    }
    lines
}

#[tokio::test]
async fn collected_and_published_by_tls_with_a_certificate_of_ours() {
    let (broker, ours, theirs) = world("tls", "127.0.0.1", FAR).await;
    let config = lines(&ours, Some(&ours));
    let mut watch = Watch::start(broker.port, &config, &["topic = 'plant/pv'\ntime_path = 't'\npath = 'v'"]);
    watch.until("connected", |health| health.connected).await;
    let daemon = Daemon::start(broker.port, &config);
    daemon.until_published(2).await;
    assert_eq!((daemon.counters.losses.load(SeqCst), daemon.counters.lost()), (0, None));
    let [ca, certificate, key] = ["ca.pem", "client.pem", "client.key"].map(|file| ours.path(file));
    let own = ["--cafile", &ca, "--cert", &certificate, "--key", &key];
    // The subscription may come after the first ones.
    let deadline = tokio::time::Instant::now() + std::time::Duration::from_secs(20);
    let mut t = 1_700_000_000_000_u64;
    while watch.is_empty() {
        t += 1000;
        broker.publish("plant/pv", &format!("{{\"v\":41.5,\"t\":{t}}}"), &own).await;
        assert!(tokio::time::Instant::now() < deadline, "no sample");
    }
    let (tag, sample) = watch.next().await;
    assert_eq!((tag, sample), (0, Sample::good(sample.t, 41.5)));
    assert!((1_700_000_001.0..=t as f64 / 1000.0).contains(&sample.t));
    watch.stop().await;
    daemon.end().await;

    // Who is not known there is not let in, and says so.
    for config in [lines(&ours, None), lines(&ours, Some(&theirs))] {
        let (log, _guard) = Log::start();
        let daemon = Daemon::start(broker.port, &config);
        let line = log.until("results are not published").await;
        assert!(line.contains(" WARN "), "{line}");
        daemon.until_lost().await;
        assert_eq!(daemon.counters.published.load(SeqCst), 0);
        daemon.end().await;
    }
}

#[tokio::test]
async fn a_broker_of_another_authority_or_name_or_of_yesterday_is_refused_and_the_log_says_why() {
    let (broker, ours, theirs) = world("tls-wrong", "127.0.0.1", FAR).await;
    let (elsewhere, other, _) = world("tls-name", "elsewhere", FAR).await;
    let (old, of_old, _) = world("tls-expired", "127.0.0.1", 2020).await;
    for (broker, config, why) in [
        (&broker, lines(&theirs, Some(&ours)), "UnknownIssuer"),
        (&elsewhere, lines(&other, Some(&other)), "not valid for"),
        (&old, lines(&of_old, Some(&of_old)), "expired"),
    ] {
        let (log, _guard) = Log::start();
        let watch = Watch::start(broker.port, &config, &["topic = 'plant/pv'"]);
        let line = log.until("refused: ").await;
        assert!(line.contains(" WARN ") && line.contains("certificate") && line.contains(why), "{line}");
        watch.until("counted", |health| health.security_errors > 0 && !health.connected).await;
        watch.stop().await;
        let daemon = Daemon::start(broker.port, &config);
        let line = log.until("results are not published").await;
        assert!(line.contains("certificate") && line.contains(why), "{line}");
        let lost = daemon.until_lost().await;
        assert!(lost.contains("certificate") && lost.contains(why), "{lost}");
        assert_eq!(daemon.counters.published.load(SeqCst), 0);
        daemon.end().await;
    }
}
