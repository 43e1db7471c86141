//! The thin binary: arguments, one line per error, exit codes; what is done lives in the library.

mod cli;

use std::process::ExitCode;

/// Gives freed memory back within seconds, so that the daemon holds what it uses.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> ExitCode {
    cli::main()
}
