//! `stictiond audit verify FILE`: whether an audit log is what was written.

use super::{Failure, print};
use std::path::PathBuf;
use stictiond::audit;

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
}

/// Verifies.
pub fn run(args: &Args) -> Result<(), Failure> {
    let Command::Verify { file } = &args.command;
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
