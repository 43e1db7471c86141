//! How results are printed.

use clap::ValueEnum;
use std::io::{self, IsTerminal};

/// For people or for programs.
#[derive(Clone, Copy, ValueEnum)]
pub enum Format {
    Json,
    Text,
}

impl Format {
    /// Where nothing is said: text on a terminal, else JSON.
    pub fn usual() -> Self {
        if io::stdout().is_terminal() { Self::Text } else { Self::Json }
    }
}
