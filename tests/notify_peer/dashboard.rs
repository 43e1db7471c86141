//! What the dashboard shows of those who are told, in headless Chromium. Screenshots lie in target/browser afterwards.

use super::rig::{Daemon, Peer, folder, plant, root};
use super::webhook::SECRET;
use std::time::Duration;
use stictiond::access::file::change;
use stictiond::access::{Cost, PasswordHash, Role, Roles};
use tokio::process::Command;

/// Far longer than the walk takes; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(120);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn dead_letters_are_seen_and_sent_again_in_the_dashboard() {
    let (folder, mut peer) = (folder("dashboard"), Peer::start("webhook_server.py", &[SECRET]).await);
    let place = |name: &str| folder.join(name).display().to_string();
    std::fs::write(folder.join("secret"), SECRET).unwrap();
    let user = change(&folder.join("access.json"), |book| {
        let cheap = Cost { memory_kib: 8, passes: 1 };
        let hash = PasswordHash::of("a password for tests", [1; 16], cheap).expect("a cost");
        Ok::<_, Box<dyn std::error::Error>>(book.add_user("enya", Roles::of(&[Role::Engineer]), hash)?)
    });
    user.expect("added");
    let webhook = |name: &str, port: u16| {
        format!(
            "[[notify.webhook]]\nname = '{name}'\nurl = 'http://127.0.0.1:{port}/hook'\nsecret_file = '{}'\n\
             pace = {{ wait_s = 0.05, interval_s = 0.0 }}\nretry = {{ first_s = 0.05, longest_s = 0.2 }}\n",
            place("secret")
        )
    };
    let text = plant(
        None,
        &format!(
            "[access]\nfile = '{}'\nanyone_may_read = true\n[audit]\nfile = '{}'\n{}{}",
            place("access.json"),
            place("audit.log"),
            webhook("cmms", peer.port),
            webhook("nobody", 1)
        ),
    );
    let daemon = Daemon::start(&text).await;
    peer.tell("answer 400 3").await;
    for (at, f) in [Some(2.5), None, Some(2.5)].into_iter().enumerate() {
        daemon.diagnosed("FIC1", f);
        daemon.receiver("cmms", "a dead letter", |own| own["dead_letters"] == at + 1).await;
    }
    daemon.receiver("nobody", "failing", |own| own["state"] == "failing").await;
    let python = root().join("target/peers-venv/bin/python");
    let mut walk = Command::new(python);
    walk.arg(root().join("tests/browser/dashboard.py")).arg("receivers");
    walk.arg(format!("http://{}", daemon.address)).arg(root().join("target/browser")).kill_on_drop(true);
    let done = tokio::time::timeout(PATIENCE, walk.output()).await.expect("ends in time").expect("runs");
    println!("{}", String::from_utf8_lossy(&done.stdout));
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    // What was sent again has arrived, each once, in the order in which it was made.
    let mut taken = Vec::new();
    for _ in 0..6 {
        let message = peer.next().await;
        assert_eq!(message["verified"], true, "{message}");
        if message["status"] == 204 {
            taken.push(message["body"]["data"]["alarms"][0]["event"].as_str().unwrap().to_string());
        }
    }
    assert_eq!(taken, ["raised", "cleared", "raised"]);
    daemon.stop().await;
}
