//! The command line: `stictiond run | edge | worker | centre | demo | diagnose | backfill | benchmark | check | user | token | health | store | replay | audit | probe |
//! import-tags | plant | reproduce`.
//!
//! Exit codes: 0 done, whatever the verdict; 1 failed; 2 bad arguments, config or input. Every error is one clear
//! line on stderr.

mod audit;
mod backfill;
mod benchmark;
mod book;
mod check;
mod demo;
mod diagnose;
mod format;
mod health;
mod import_tags;
mod logging;
mod output;
mod plant;
mod plot;
mod probe;
mod replay;
mod reproduce;
mod run;
mod store;
mod table;
mod text;
mod token;
mod user;

use clap::{Parser, Subcommand};
use std::fmt::Display;
use std::io::{self, Write};
use std::process::ExitCode;
use stictiond::app::Role;
use stictiond::config::Diagnostic;
use stictiond::version::BUILD;

/// Finds sticking control valves from OP and PV, online, beside the DCS.
#[derive(Parser)]
#[command(name = "stictiond", version = BUILD, about, arg_required_else_help = true)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Poll the plant, diagnose its loops, serve the results; SIGHUP reads the configuration again
    Run(run::Args),
    /// Be the edge of a fleet: collect at a site, forward to the centre, let workers diagnose
    Edge(run::Args),
    /// Be a worker of a fleet: diagnose what edges send
    Worker(run::Args),
    /// Be the centre of a fleet: show the loops of all sites, tell people
    Centre(run::Args),
    /// Watch a simulated plant of twenty loops: no configuration, no plant
    Demo(demo::Args),
    /// Diagnose one record: columns t,op,pv[,sp][,other tags…]
    Diagnose(diagnose::Args),
    /// Diagnose a long record window by window: when did this valve begin to stick?
    Backfill(backfill::Args),
    /// The published methods and the program on a folder of labelled records: how often is each right?
    Benchmark(benchmark::Args),
    /// Validate a configuration: every error with line and column
    Check(check::Args),
    /// Add, change, remove and list users: who may log in
    User(user::Args),
    /// Create, list, rotate and revoke tokens: which programs may ask
    Token(token::Args),
    /// Ask a running daemon whether it answers: exit code 0 or 1
    Health(health::Args),
    /// Check, export or fill the store
    Store(store::Args),
    /// Run recorded samples through the whole daemon: the same diagnoses, bit for bit
    Replay(replay::Args),
    /// Work on an audit log
    Audit(audit::Args),
    /// Show what is there: registers of a Modbus device, variables of an OPC UA server, topics of an MQTT broker
    Probe(probe::Args),
    /// Make [[loop]] sections from a list of tags
    ImportTags(import_tags::Args),
    /// Analyse the loops of a folder, a store or a table together: who swings with whom, who started it, what to repair first
    Plant(plant::Args),
    /// Reproduce the paper's tables and figures, ours beside theirs, as HTML and JSON
    Reproduce(reproduce::Args),
}

/// Why a command ended without doing its work.
pub enum Failure {
    /// Something outside failed: exit code 1.
    Failed(String),
    /// Bad arguments, config or input: exit code 2.
    BadInput(String),
    /// A configuration with errors: exit code 2.
    BadConfig(Vec<Diagnostic>),
}

impl Failure {
    /// A bad input named by its file.
    pub fn in_file(path: &std::path::Path, error: impl Display) -> Self {
        Self::BadInput(format!("{}: {error}", path.display()))
    }
}

/// Parses the arguments and runs the command.
pub fn main() -> ExitCode {
    let args = match Args::try_parse() {
        Ok(args) => args,
        Err(error) => {
            // Help into a closed pipe is still help.
            let _ = error.print();
            return ExitCode::from(error.exit_code().clamp(0, 255) as u8);
        }
    };
    let done = match args.command {
        Command::Run(args) => run::run(&args, Role::Alone),
        Command::Edge(args) => run::run(&args, Role::Edge),
        Command::Worker(args) => run::run(&args, Role::Worker),
        Command::Centre(args) => run::run(&args, Role::Centre),
        Command::Demo(args) => demo::run(&args),
        Command::Diagnose(args) => diagnose::run(&args),
        Command::Backfill(args) => backfill::run(&args),
        Command::Benchmark(args) => benchmark::run(&args),
        Command::Check(args) => check::run(&args),
        Command::User(args) => user::run(&args),
        Command::Token(args) => token::run(&args),
        Command::Health(args) => health::run(&args),
        Command::Store(args) => store::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Audit(args) => audit::run(&args),
        Command::Probe(args) => probe::run(&args),
        Command::ImportTags(args) => import_tags::run(&args),
        Command::Plant(args) => plant::run(&args),
        Command::Reproduce(args) => reproduce::run(&args),
    };
    let (messages, code) = match done {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::Failed(message)) => (vec![format!("stictiond: {message}")], 1),
        Err(Failure::BadInput(message)) => (vec![format!("stictiond: {message}")], 2),
        Err(Failure::BadConfig(errors)) => (errors.iter().map(Diagnostic::to_string).collect(), 2),
    };
    let mut stderr = io::stderr().lock();
    for message in messages {
        // One line each, whatever a file is called; nobody is left to tell when stderr is closed.
        let _ = writeln!(stderr, "{}", message.replace(['\n', '\r'], " "));
    }
    ExitCode::from(code)
}

/// Writes to stdout; a reader that stops early (`| head`) is no failure.
pub fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Failure::Failed(format!("cannot write to stdout: {error}")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_arguments_do_not_contradict_each_other() {
        Args::command().debug_assert();
    }
}
