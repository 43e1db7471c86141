//! What `[tables.defaults]` tells of a file holds where the request says nothing else.

use crate::app::{device, heard, start, text};
use crate::http::{Events, post};
use serde_json::Value;
use std::path::Path;
use std::time::Duration;
use stictiond::config::{self, Config};

const BACKFILL: &str = "/api/v1/backfill";
/// Far longer than anything here takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// The job's end: what it is called, and the job.
async fn ended(events: &mut Events) -> String {
    loop {
        let told = tokio::time::timeout(PATIENCE, heard(events, "backfill", "A")).await.expect("told");
        let phase = told["phase"].as_str().expect("a phase");
        if phase != "reading" && phase != "diagnosing" {
            return phase.to_string();
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_defaults_of_the_configuration_decide_unless_the_request_does() {
    let name = format!("tables-defaults-{}", std::process::id());
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&folder).expect("writable");
    // Day and month can be told in two ways, and so can the comma.
    let row =
        |k: u32| format!("01/06/2026 06:{:02}:{:02};{};1,{:03}\n", k / 60, k % 60, 40 + k % 7, k % 900 + 100);
    let rows: String = (0..1200).map(row).collect();
    std::fs::write(folder.join("week.csv"), format!("Zeit;A.OP;A.PV\n{rows}")).expect("writable");
    let (address, _) = device().await;
    let configured = |defaults: &str| -> Config {
        let tables = format!("[tables]\nfolder = {:?}\n{defaults}", folder.display().to_string());
        let mut own =
            config::parse("test.toml", &(text(&[address], &[("A", 0, 20)]) + &tables)).expect("sound");
        // It diagnoses nothing by itself meanwhile.
        own.schedule.period_s = 86_400.0;
        own
    };
    let defaults = "[tables.defaults]\ntime_format = \"dmy\"\ndecimal = \",\"\n";
    for (defaults, table, end, says) in [
        ("", "{}", "failed", "--decimal . or --decimal ,"),
        ("", "{\"decimal\":\",\"}", "failed", "--time-format dmy or mdy"),
        (defaults, "{}", "done", "decimal comma, time dd/mm/yyyy (UTC)"),
        (defaults, "{\"time_format\":\"mdy\"}", "done", "decimal comma, time mm/dd/yyyy (UTC)"),
    ] {
        let daemon = start(configured(defaults)).await;
        let mut events = Events::open(daemon.address).await;
        let body = format!(
            "{{\"loop\":\"A\",\"file\":\"week.csv\",\"window_s\":600,\"step_s\":300,\"table\":{table}}}"
        );
        let answer = post(daemon.address, BACKFILL, &body).await;
        assert_eq!(answer.status, 202, "{body}: {}", answer.text());
        let phase = ended(&mut events).await;
        let job: Value = daemon.json(BACKFILL).await;
        assert_eq!(phase, end, "{job}");
        let said = if end == "done" { &job["report"]["read_as"] } else { &job["error"] };
        assert!(said.as_str().is_some_and(|said| said.contains(says)), "{defaults:?}, {table}: {job}");
        daemon.app.stop().cancel();
        daemon.task.await.expect("no panic").expect("ends well");
    }
    std::fs::remove_dir_all(&folder).expect("it was made");
}
