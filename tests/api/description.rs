//! The description of the API, held against what the API does by schemathesis: requests that fit it and requests that do
//! not, to every operation; no 5xx, no answer that is not described.

use crate::rig::{FOUR, START, rig};
use std::path::Path;
use std::time::Duration;
use stictiond::signal::Sample;
use tokio::process::Command;

/// Far longer than it takes; reached only when the test has failed.
const PATIENCE: Duration = Duration::from_secs(150);

#[tokio::test(flavor = "multi_thread")]
async fn every_answer_is_one_that_the_description_says() {
    // Without the loop whose diagnosis panics: 500 is what that is answered with.
    let rig = rig(&FOUR[..3]).await;
    // Ready: 503 is the right answer before.
    for tag in [0, 1] {
        rig.history.push(tag, Sample::good(START, 1.0));
    }
    for (id, _) in &FOUR[..3] {
        rig.diagnose(id).await;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let tool = root.join("target/peers-venv/bin/schemathesis");
    assert!(tool.exists(), "schemathesis is not installed: run scripts/peers once, then the tests again");
    let checks = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance,\
                  response_headers_conformance,unsupported_method";
    let mut command = Command::new(tool);
    // Streams do not end; that a time is RFC 3339 is more than a schema can say, so what is refused is not judged.
    command
        .args([
            "run",
            &format!("http://{}/openapi.json", rig.address),
            "--exclude-path-regex",
            "/(events|live)$",
        ])
        .args(["--checks", checks, "--phases", "coverage,fuzzing", "--suppress-health-check", "all"])
        .args(["--max-examples", "10", "--seed", "1", "--request-timeout", "20", "--no-color"])
        .current_dir(env!("CARGO_TARGET_TMPDIR"))
        .kill_on_drop(true);
    let done = tokio::time::timeout(PATIENCE, command.output()).await.expect("ends in time").expect("runs");
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success(), "{said}\n{}", String::from_utf8_lossy(&done.stderr));
    assert!(said.contains("Tested: "), "{said}");
}
