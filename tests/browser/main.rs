//! The dashboard in headless Chromium: what an operator sees and does, by keyboard too, and how fast it is with 2,000 loops.
//! Screenshots lie in target/browser afterwards.

mod rig;

use rig::{Rig, crowd, guarded, plant};
use std::path::Path;
use std::time::Duration;
use tokio::process::Command;

/// Far longer than the walk through all views takes; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(240);

/// Runs a part of tests/browser/dashboard.py against the rig and shows what it says.
async fn browse(rig: &Rig, part: &str) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = root.join("target/peers-venv/bin/python");
    assert!(python.exists(), "playwright is not installed: run scripts/peers once, then the tests again");
    let base = format!("http://{}", rig.address);
    let out = root.join("target/browser");
    let mut command = Command::new(python);
    command.arg(root.join("tests/browser/dashboard.py")).args([part, &base]).arg(out).kill_on_drop(true);
    let done = tokio::time::timeout(PATIENCE, command.output()).await.expect("ends in time").expect("runs");
    println!("{}", String::from_utf8_lossy(&done.stdout));
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_finds_believes_and_handles_a_sticking_valve() {
    let rig = plant().await;
    browse(&rig, "walk").await;
    rig.stop.cancel();
}

#[tokio::test(flavor = "multi_thread")]
async fn who_logs_in_may_do_what_their_role_says() {
    let rig = guarded().await;
    browse(&rig, "access").await;
    rig.stop.cancel();
}

#[tokio::test(flavor = "multi_thread")]
async fn two_thousand_loops_are_there_within_a_second_and_answer_at_once() {
    let rig = crowd(2000).await;
    browse(&rig, "speed").await;
    rig.stop.cancel();
}
