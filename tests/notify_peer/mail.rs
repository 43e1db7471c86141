//! Mails against aiosmtpd.

use super::rig::{Daemon, Peer, folder, plant};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn mails_go_by_starttls_with_a_password_and_say_what_matters() {
    let folder = folder("mail");
    let made = rcgen::generate_simple_self_signed(vec!["localhost".to_string()]).unwrap();
    let [certificate, key, password] = ["cert.pem", "key.pem", "password"].map(|name| folder.join(name));
    std::fs::write(&certificate, made.cert.pem()).unwrap();
    std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    std::fs::write(&password, "wrong\n").unwrap();
    let [certificate, key] = [&certificate, &key].map(|path| path.display().to_string());
    let mut peer = Peer::start("smtp_server.py", &[&certificate, &key, "stictiond", "right"]).await;
    let text = format!(
        "[[notify.smtp]]\nname = 'fitters'\naddress = 'localhost:{}'\nca_file = '{certificate}'\nuser = 'stictiond'\n\
         password_file = '{}'\nfrom = 'stictiond <stictiond@plant.example>'\nto = ['a@plant.example', 'b@plant.example']\n\
         [notify.smtp.pace]\nwait_s = 0.2\ninterval_s = 0.0\n\
         [notify.smtp.retry]\nfirst_s = 0.05\nlongest_s = 0.2\n",
        peer.port,
        password.display()
    );
    let daemon = Daemon::start(&plant(None, &text)).await;
    daemon.diagnosed("FIC1", Some(2.5));
    daemon.diagnosed("FIC2", Some(0.6));
    let own = daemon.receiver("fitters", "the log-in is refused", |own| own["state"] == "failing").await;
    assert!(own["reason"].as_str().unwrap().contains("535"), "{own}");
    // Set right without a restart.
    std::fs::write(&password, "right\n").unwrap();
    let mail = peer.next().await;
    assert_eq!((&mail["tls"], &mail["authenticated"]), (&true.into(), &true.into()), "{mail}");
    // It greets with the machine's name, which the server takes, and not with an address, which it does not.
    assert_eq!(mail["hello"], stictiond::host::name());
    assert_eq!(mail["to"], serde_json::json!(["a@plant.example", "b@plant.example"]));
    assert_eq!(mail["subject"], "[stictiond] HIGH FIC1: the valve sticks (and 1 more)");
    assert_eq!(mail["type"], "text/plain");
    let text = mail["text"].as_str().unwrap();
    for part in [
        "HIGH FIC1: the valve sticks",
        "MEDIUM FIC2",
        "high priority",
        "found    The valve sticks: it ignores the first 5 % OP of each reversal.",
        "friction f 2.50 % OP, half of what the valve ignores (95 %: 2.45 to 2.55)",
        "unit 20",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("evidence"), "{text}");

    // Not now is tried for each by itself and then again, never is a dead letter.
    peer.tell("refuse 2 451 later").await;
    daemon.diagnosed("FIC1", None);
    for to in ["b@plant.example", "a@plant.example"] {
        let mail = peer.next().await;
        assert_eq!(mail["to"], serde_json::json!([to]), "{mail}");
        assert_eq!(mail["subject"], "[stictiond] cleared FIC1: the valve sticks");
    }
    // Of all, then of each by itself.
    peer.tell("refuse 3 554 never").await;
    daemon.diagnosed("FIC2", None);
    daemon.receiver("fitters", "a dead letter", |own| own["dead_letters"] == 1).await;
    let (status, _) = daemon.ask("POST", "/api/v1/notifications/fitters/replay", "").await;
    assert_eq!(status, 200);
    assert_eq!(peer.next().await["subject"], "[stictiond] cleared FIC2: the valve sticks");

    // Who is not there any more does not keep the mail from the others.
    peer.tell("moved 2 a@plant.example").await;
    daemon.diagnosed("FIC1", Some(2.5));
    let mail = peer.next().await;
    assert_eq!(mail["to"], serde_json::json!(["b@plant.example"]));
    assert_eq!(mail["subject"], "[stictiond] HIGH FIC1: the valve sticks");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_does_not_take_mails_for_now_keeps_them_from_nobody() {
    let mut peer = Peer::start("smtp_server.py", &["helo"]).await;
    let text = format!(
        "[[notify.smtp]]\nname = 'fitters'\naddress = '127.0.0.1:{}'\nsecurity = 'none'\nhello_name = 'pc.plant.example'\n\
         from = 'stictiond@plant.example'\nto = ['a@plant.example', 'b@plant.example', 'c@plant.example']\n\
         [notify.smtp.pace]\nwait_s = 0.2\ninterval_s = 0.0\n\
         [notify.smtp.retry]\nfirst_s = 0.05\nlongest_s = 0.2\n",
        peer.port
    );
    let daemon = Daemon::start(&plant(None, &text)).await;
    let [first, second] = ["FIC1", "FIC2"].map(|id| format!("[stictiond] HIGH {id}: the valve sticks"));
    let to = |name: &str| serde_json::json!([format!("{name}@plant.example")]);

    // The others have each mail at once, the second too, while the first waits for one of them.
    peer.tell("busy 1 a@plant.example").await;
    for (id, subject) in [("FIC1", &first), ("FIC2", &second)] {
        daemon.diagnosed(id, Some(2.5));
        for name in ["b", "c"] {
            let mail = peer.next().await;
            assert_eq!((&mail["to"], &mail["subject"]), (&to(name), &subject.as_str().into()), "{mail}");
        }
    }
    let own = daemon.receiver("fitters", "one lacks both", |own| own["queue"] == 2).await;
    assert!(own["reason"].as_str().unwrap().starts_with("not taken for 1 of 3 addresses: "), "{own}");

    // Who lacked them has them in the end, and nobody has one twice.
    peer.tell("busy 0 a@plant.example").await;
    let late = [peer.next().await, peer.next().await];
    let mut subjects = late.each_ref().map(|mail| mail["subject"].as_str().unwrap().to_string());
    subjects.sort();
    assert_eq!(subjects, [first, second]);
    assert!(late.iter().all(|mail| mail["to"] == to("a")), "{late:?}");
    daemon.receiver("fitters", "working", |own| own["state"] == "working" && own["queue"] == 0).await;
    daemon.diagnosed("FIC1", None);
    let mail = peer.next().await;
    assert_eq!(mail["to"].as_array().unwrap().len(), 3, "{mail}");
    assert_eq!(mail["subject"], "[stictiond] cleared FIC1: the valve sticks");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_that_knows_no_ehlo_is_greeted_by_helo_with_the_name_given() {
    let mut peer = Peer::start("smtp_server.py", &["helo"]).await;
    let text = format!(
        "[[notify.smtp]]\nname = 'fitters'\naddress = '127.0.0.1:{}'\nsecurity = 'none'\nhello_name = 'pc.plant.example'\n\
         from = 'stictiond@plant.example'\nto = ['a@plant.example']\n\
         [notify.smtp.pace]\nwait_s = 0.2\ninterval_s = 0.0\n\
         [notify.smtp.retry]\nfirst_s = 0.05\nlongest_s = 0.2\n",
        peer.port
    );
    let daemon = Daemon::start(&plant(None, &text)).await;
    daemon.diagnosed("FIC1", Some(2.5));
    let mail = peer.next().await;
    assert_eq!((&mail["hello"], &mail["extended"]), (&"pc.plant.example".into(), &false.into()), "{mail}");
    assert_eq!(mail["subject"], "[stictiond] HIGH FIC1: the valve sticks");
    // What such a server refuses for good is a dead letter, and it is not asked for ever.
    peer.tell("refuse 1 554 never").await;
    daemon.diagnosed("FIC1", None);
    daemon.receiver("fitters", "a dead letter", |own| own["dead_letters"] == 1).await;
    daemon.stop().await;
}
