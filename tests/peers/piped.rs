//! A peer in a process of its own: commands go in, lines come out.

use std::path::Path;
use std::process::Stdio;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};

/// A script of this folder, for the Python that has the libraries it needs.
pub fn python(script: &str) -> Command {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = root.join("target/peers-venv/bin/python");
    assert!(python.exists(), "there are no peers: run scripts/peers once, then the tests again");
    let mut command = Command::new(python);
    command.arg(root.join("tests/peers").join(script));
    command
}

/// Runs it until the first of what is returned is dropped.
pub fn spawn(command: &mut Command) -> (Child, ChildStdin, Lines<BufReader<ChildStdout>>) {
    let command = command.stdin(Stdio::piped()).stdout(Stdio::piped()).kill_on_drop(true);
    let mut child = command.spawn().unwrap();
    let commands = child.stdin.take().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    (child, commands, lines)
}
