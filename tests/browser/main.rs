//! The dashboard in headless Chromium: what an operator sees and does, by keyboard too, and how fast it is with 2,000 loops.
//! Screenshots lie in target/browser afterwards.

#[path = "../many/mod.rs"]
mod many;
mod orders;
mod rig;
#[path = "../swinging/mod.rs"]
mod swinging;

use rig::{Rig, crowd, damaged, fleet, guarded, plant};
use std::path::Path;
use std::time::Duration;
use stictiond::app::App;
use stictiond::schedule::Clock;
use tokio::net::TcpListener;
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
async fn what_failed_is_asked_for_again_and_what_is_bad_or_of_another_time_is_shown_as_such() {
    let rig = plant().await;
    browse(&rig, "trouble").await;
    rig.stop.cancel();
}

#[tokio::test(flavor = "multi_thread")]
async fn few_samples_silent_streams_and_very_many_changes_are_shown_for_what_they_are() {
    let rig = crowd(20).await;
    browse(&rig, "small").await;
    rig.stop.cancel();
}

#[tokio::test(flavor = "multi_thread")]
async fn who_logs_in_may_do_what_their_role_says() {
    let rig = guarded().await;
    browse(&rig, "access").await;
    rig.stop.cancel();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_is_damaged_stands_above_every_view_until_it_works() {
    let rig = damaged().await;
    browse(&rig, "store").await;
    rig.stop.cancel();
}

#[tokio::test(flavor = "multi_thread")]
async fn two_thousand_loops_are_there_within_a_second_and_answer_at_once() {
    let rig = crowd(2000).await;
    browse(&rig, "speed").await;
    rig.stop.cancel();
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_thousand_loops_of_a_fleet_are_on_its_map_and_each_is_found_by_site_unit_and_name() {
    let rig = fleet(10_000).await;
    browse(&rig, "fleet").await;
    rig.stop.cancel();
}

#[tokio::test(flavor = "multi_thread")]
async fn loops_that_swing_together_are_found_and_the_work_on_their_source_is_ordered() {
    let site = swinging::site("browser");
    assert_eq!(site.config.loops.len(), site.of.loops.len());
    let app = App::build(site.config.clone(), Clock::plant(swinging::START, 10.0), App::diagnosis());
    let app = app.expect("a sound configuration");
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let rig = Rig { address: listener.local_addr().expect("bound"), stop: app.stop() };
    let running = tokio::spawn(async move { app.run(listener).await });
    browse(&rig, "swinging").await;
    rig.stop.cancel();
    running.await.expect("no panic").expect("ends well");
}
