//! The thin binary: arguments, one line per error, exit codes; what is done lives in the library.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
