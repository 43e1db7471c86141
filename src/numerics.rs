//! What is pure of `stictiond`: the same input gives the same answer, on any machine.
//!
//! A package of its own, so that none of it can reach a runtime, a log or a protocol: it depends on numerics alone. That it
//! uses no file, socket or clock of std either, `tests/architecture.rs` checks.

pub mod signal;

pub mod sysid;

pub mod detectors;
pub mod diagnosis;
pub mod residual;
pub mod sim;

pub mod indicators;
pub mod plantwide;

pub mod compensation;
pub mod plot;
