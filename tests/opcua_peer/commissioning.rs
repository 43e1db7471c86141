//! From a server to a configuration: what `probe` shows, pasted and run.

use super::rig::{Server, folder};
use std::process::Stdio;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::Command;
use tokio::time::timeout;

/// Far longer than a start takes even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

async fn probe(port: u16, more: &[&str]) -> String {
    let url = format!("opc.tcp://localhost:{port}/peer/");
    probe_with(&[&[url.as_str()], more].concat()).await
}

async fn probe_with(args: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_stictiond")).arg("probe").args(args).output();
    let output = timeout(PATIENCE, output).await.expect("no end").unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    String::from_utf8(output.stdout).unwrap()
}

/// Lines of the log of `run` up to the one with this text.
async fn log_until(file: &std::path::Path, level: &str, text: &str) -> Vec<String> {
    let mut child = Command::new(env!("CARGO_BIN_EXE_stictiond"))
        .args(["run".as_ref(), "--config".as_ref(), file.as_os_str()])
        .env("RUST_LOG", level)
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut said = Vec::new();
    let reading = async {
        while let Some(line) = lines.next_line().await.unwrap() {
            let done = line.contains(text);
            said.push(line);
            if done {
                return;
            }
        }
        panic!("the log ended before {text}: {said:?}");
    };
    timeout(PATIENCE, reading).await.expect("never said");
    said
}

#[tokio::test]
async fn what_probe_shows_is_pasted_and_runs_without_a_word_of_certificates() {
    let server = Server::start(&["--other", "first"]).await;
    let found = probe(server.port, &["--filter", "unit*fic101"]).await;
    for part in [
        "# ns=3 is nsu=urn:peer:plant\n",
        "Plant/Unit/FIC101/OP  nsu=urn:peer:plant;s=FIC101.OP  Double 41.5 Good 20",
        "[[loop]]\nid = \"FIC101\"\n[loop.op]\n",
        "node = \"nsu=urn:peer:plant;s=FIC101.PV\"",
    ] {
        assert!(found.contains(part), "{part}: {found}");
    }
    assert!(!found.contains("Steady"), "the filter holds: {found}");

    let folder = folder("commissioning");
    let file = folder.join("stictiond.toml");
    let url = format!("opc.tcp://localhost:{}/peer/", server.port);
    let head = "[server]\nlisten = '127.0.0.1:0'\n";
    let device = format!("[[opcua]]\nname = 'server'\nurl = '{url}'\nsecurity_policy = 'None'\n");
    // By number, so that the log tells when the session is there.
    let extra = "[[loop.tag]]\nname = 'x'\ndevice = 'server'\nnode = 'ns=2;s=Steady1'\n";
    std::fs::write(&file, format!("{head}{device}{found}{extra}")).unwrap();
    let there = "ns=2 is nsu=urn:peer:other";
    // The section says the same as the address did, and gives the loop its device.
    let named = probe_with(&["server", "--config", file.to_str().unwrap(), "--filter", "unit*fic101"]).await;
    assert!(
        named.contains("device = \"server\"") && named.lines().count() == found.lines().count(),
        "{named}"
    );
    let said = log_until(&file, "info", there).await;
    assert!(!said.iter().any(|line| line.contains("crypto") || line.contains("certificate")), "{said:#?}");
    // Whoever asks for the library's log has it: the lines are there to be left out.
    let said = log_until(&file, "info,opcua_core=info", there).await;
    assert!(said.iter().any(|line| line.contains("crypto")), "{said:#?}");
}

#[tokio::test]
async fn probe_says_what_it_left_out_and_why_a_value_is_no_number() {
    let server = Server::start(&[]).await;
    let all = probe(server.port, &[]).await;
    for part in ["Double[3]", "element = 0 to 2", "'1,002'", "its name tells no role"] {
        assert!(all.contains(part), "{part}: {all}");
    }
    let few = probe(server.port, &["--most", "5"]).await;
    assert!(
        few.contains("more: narrow the filter")
            && few.lines().filter(|line| line.contains("  nsu=")).count() == 5,
        "{few}"
    );
}
