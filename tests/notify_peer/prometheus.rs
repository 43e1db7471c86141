//! What `deploy/` has for Prometheus and Grafana: promtool takes rules and metrics, the dashboard has the shape of one, and
//! asks for nothing that is not there.

use super::rig::{Daemon, Peer, folder, plant_at, root};
use serde_json::Value;
use std::collections::BTreeSet;
use std::process::{Output, Stdio};
use tokio::io::AsyncWriteExt;
use tokio::process::Command;

async fn promtool(arguments: &[&str], input: &str) -> Output {
    let mut child = Command::new("promtool")
        .args(arguments)
        .current_dir(root())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("there is no promtool: run scripts/peers once, then the tests again");
    let mut stdin = child.stdin.take().unwrap();
    // It may end before it has read everything, and says then why.
    let _ = stdin.write_all(input.as_bytes()).await;
    drop(stdin);
    child.wait_with_output().await.unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[tokio::test]
async fn promtool_takes_the_rules_and_what_they_say_of_made_up_plants() {
    for arguments in [
        ["check", "rules", "deploy/prometheus/rules.yml"],
        ["test", "rules", "deploy/prometheus/rules_test.yml"],
    ] {
        let output = promtool(&arguments, "").await;
        assert!(output.status.success(), "{arguments:?}: {}", said(&output));
    }
}

/// Names of metrics in an expression.
fn metrics_in(text: &str) -> BTreeSet<&str> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.split(|c| !is_part(c)).filter(|word| word.starts_with("stictiond_")).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn promtool_takes_the_metrics_and_the_dashboard_asks_for_nothing_else() {
    let folder = folder("prometheus");
    let device = Peer::start("modbus_server.py", &[]).await;
    let receiver =
        "[[notify.webhook]]\nname = 'cmms'\nurl = 'http://127.0.0.1:1/'\nsecret_env = 'NO_SUCH_VARIABLE'\n";
    let daemon = Daemon::start(&plant_at(device.port, Some(&folder.join("store")), receiver)).await;
    daemon.diagnosed("FIC1", Some(2.5));
    daemon.diagnosed("FIC2", None);
    let good = |list: &Value| list["items"][0]["counters"]["good_samples"].as_u64() > Some(0);
    daemon.until("samples arrive", "/api/v1/collectors", good).await;
    let (status, text) = daemon.ask("GET", "/metrics", "").await;
    assert_eq!(status, 200);
    let checked = promtool(&["check", "metrics"], &text).await;
    // Its advice on names goes to stderr and fails it too.
    assert!(checked.status.success() && said(&checked).is_empty(), "{}\n{text}", said(&checked));
    let broken = promtool(&["check", "metrics"], &text.replace("# HELP stictiond_loops ", "# ")).await;
    assert!(!broken.status.success(), "a metric without a description is taken");

    let there: BTreeSet<&str> = text
        .lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| line.split(['{', ' ']).next())
        .collect();
    let dashboard = std::fs::read_to_string(root().join("deploy/grafana/stictiond.json")).unwrap();
    let dashboard: Value = serde_json::from_str(&dashboard).unwrap();
    let targets =
        dashboard["panels"].as_array().unwrap().iter().flat_map(|panel| panel["targets"].as_array().unwrap());
    let asked: Vec<&str> = targets.map(|target| target["expr"].as_str().unwrap()).collect();
    let variables =
        dashboard["templating"]["list"].as_array().unwrap().iter().filter_map(|own| own["query"].as_str());
    let all = asked.iter().copied().chain(variables).collect::<Vec<_>>().join("\n");
    let used = metrics_in(&all);
    assert!(used.len() > 15, "{used:?}");
    // Only a part of a fleet has those of a fleet; `tests/api/fleet.rs` asks one for those that the document lists.
    let of_fleet = std::fs::read_to_string(root().join("docs/fleet.md")).unwrap();
    let is_there = |name: &str| {
        there.contains(name)
            || (name.starts_with("stictiond_fleet_")
                && [format!("`{name}`"), format!("`{name}{{")].iter().any(|own| of_fleet.contains(own)))
    };
    let missing: Vec<&&str> = used.iter().filter(|name| !is_there(name)).collect();
    assert!(missing.is_empty(), "{missing:?} are not among\n{there:?}");

    // Each query is one that Prometheus can read, as the expression of a rule.
    let rules: Vec<Value> = asked
        .iter()
        .enumerate()
        .map(|(at, expr)| serde_json::json!({"record": format!("query:{at}"), "expr": expr.replace("$instance", ".*").replace("$loop", ".*")}))
        .collect();
    let rules = serde_json::json!({"groups": [{"name": "dashboard", "rules": rules}]});
    let path = folder.join("queries.yml");
    std::fs::write(&path, rules.to_string()).unwrap();
    let output = promtool(&["check", "rules", path.to_str().unwrap()], "").await;
    assert!(output.status.success(), "{}", said(&output));
    daemon.stop().await;
}

#[tokio::test]
async fn the_dashboard_has_the_shape_of_one() {
    let check = |file: &'static str| async move {
        let script = "import json, sys, jsonschema\nload = lambda path: json.load(open(path))\n\
            jsonschema.Draft202012Validator(load(sys.argv[1])).validate(load(sys.argv[2]))";
        let mut python = Command::new(root().join("target/peers-venv/bin/python"));
        python.args(["-c", script, "deploy/grafana/dashboard.schema.json", file]).current_dir(root());
        python.output().await.expect("there are no peers: run scripts/peers once, then the tests again")
    };
    let output = check("deploy/grafana/stictiond.json").await;
    assert!(output.status.success(), "{}", said(&output));
    assert!(!check("deploy/grafana/dashboard.schema.json").await.status.success(), "anything is taken");
    let dashboard = std::fs::read_to_string(root().join("deploy/grafana/stictiond.json")).unwrap();
    let dashboard: Value = serde_json::from_str(&dashboard).unwrap();
    // No two panels lie over each other or have one number.
    let mut taken = BTreeSet::new();
    for panel in dashboard["panels"].as_array().unwrap() {
        assert!(taken.insert((panel["id"].as_u64().unwrap(), u64::MAX)), "{panel}");
        let [x, y, w, h] = ["x", "y", "w", "h"].map(|key| panel["gridPos"][key].as_u64().unwrap());
        for cell in (x..x + w).flat_map(|x| (y..y + h).map(move |y| (x, y))) {
            assert!(cell.0 < 24 && taken.insert((1000 + cell.0, cell.1)), "{panel}");
        }
    }
}

#[tokio::test]
async fn the_dashboard_counts_collectors_that_have_never_answered_among_the_silent() {
    let dashboard = std::fs::read_to_string(root().join("deploy/grafana/stictiond.json")).unwrap();
    let dashboard: Value = serde_json::from_str(&dashboard).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let silent = panels.iter().find(|panel| panel["title"] == "Collectors that are silent").unwrap();
    let expr = silent["targets"][0]["expr"].as_str().unwrap().replace("$instance", ".*");
    let series = |metric: &str, device: &str, values: &str| {
        let series = format!("stictiond_device_{metric}{{instance=\"i\",device=\"{device}\"}}");
        serde_json::json!({"series": series, "values": values})
    };
    // One that answers, one that has stopped, and one that never began.
    let plant = [
        series("connected", "well", "1x10"),
        series("last_good_age_seconds", "well", "1x10"),
        series("connected", "stopped", "1x10"),
        series("last_good_age_seconds", "stopped", "100+60x10"),
        series("connected", "never", "0x10"),
    ];
    let asked =
        serde_json::json!({"expr": expr, "eval_time": "5m", "exp_samples": [{"labels": "{}", "value": 2}]});
    let tests = serde_json::json!({
        "evaluation_interval": "1m",
        "tests": [{"interval": "1m", "input_series": plant, "promql_expr_test": [asked]}]
    });
    let path = folder("prometheus-silent").join("silent.yml");
    std::fs::write(&path, tests.to_string()).unwrap();
    let output = promtool(&["test", "rules", path.to_str().unwrap()], "").await;
    assert!(output.status.success(), "{}", said(&output));
}
