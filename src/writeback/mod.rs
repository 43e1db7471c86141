//! The only code that can write to a plant. Its configuration is always there, so that a file means the same to every
//! binary; what writes exists only with the cargo feature `writeback`.
//!
//! What is written is a term that the DCS adds to OP, never OP itself, into a register of its own, and a heartbeat
//! beside it. Every write needs an [`Order`](crate::compensation::gate::Order), which only the gate can make.
//!
//! Without the feature there is no writer to call:
#![cfg_attr(
    not(feature = "writeback"),
    doc = "```compile_fail,E0432\nuse stictiond::writeback::Writer;\n```"
)]
#![cfg_attr(feature = "writeback", doc = "```\nuse stictiond::writeback::Writer;\n```")]

mod config;
#[cfg(feature = "writeback")]
mod link;
#[cfg(feature = "writeback")]
mod run;

pub use config::{Config, LoopConfig, TERM_REPEAT_S, Target, TermType, WordOrder};
#[cfg(feature = "writeback")]
pub use link::{Clocks, Writer};
#[cfg(feature = "writeback")]
pub use run::{Heard, Keep, Look, LoopSetup, Tell, Writeback};

/// Whether this binary can write.
pub const BUILT_IN: bool = cfg!(feature = "writeback");
