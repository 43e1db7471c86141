//! `stictiond audit verify | renew FILE`: whether an audit log is what was written, and a new one where it is not.

use super::{Failure, print};
use std::path::{Path, PathBuf};
use stictiond::audit;
use stictiond::schedule::Clock;
use stictiond::serve::dto::rfc3339;

#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Read an audit log and the rotated files beside it: exit code 1 and the line when something was changed
    Verify {
        /// The log, as `[audit] file` or `[writeback] audit_file` names it
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Put an audit log aside that is damaged and not in use, with all its files, and begin a new one that says so
    Renew {
        /// The log, as `[audit] file` or `[writeback] audit_file` names it
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

/// Runs one of them.
pub fn run(args: &Args) -> Result<(), Failure> {
    match &args.command {
        Command::Verify { file } => verify(file),
        Command::Renew { file } => renew(file),
    }
}

fn renew(file: &Path) -> Result<(), Failure> {
    let mut head = file.as_os_str().to_owned();
    head.push(".head");
    // A log that stictiond has opened has one. What has none is something else, and is left alone.
    if !Path::new(&head).exists() {
        return Err(Failure::in_file(
            file,
            "there is no audit log of this name: it would have a .head beside it",
        ));
    }
    let now = rfc3339(Clock::wall().now()).unwrap_or_default();
    let renewed = audit::renew(file, &now).map_err(|error| Failure::Failed(error.to_string()))?;
    match renewed {
        None => Err(Failure::in_file(file, "it is good, and stays")),
        Some(renewed) => print(&format!(
            "{}: a new log is begun; what was wrong: {}; the old one is in {}\n",
            file.display(),
            renewed.damage,
            renewed.aside.display()
        )),
    }
}

fn verify(file: &Path) -> Result<(), Failure> {
    if !file.exists() {
        return Err(Failure::in_file(file, "there is no such file"));
    }
    let verified = audit::verify(file).map_err(|broken| Failure::Failed(broken.to_string()))?;
    let head =
        if verified.has_head { "" } else { "; without FILE.head, lines dropped from the end are not missed" };
    print(&format!(
        "{}: good, entries {} to {} in {} files, last {}{head}\n",
        file.display(),
        verified.first,
        verified.last.n,
        verified.files,
        verified.last.hash
    ))
}
