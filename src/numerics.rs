//! What is pure of `stictiond`: the same input gives the same answer, on any machine.
//!
//! A package of its own, so that none of it can reach a file, a socket, a clock or a log: it depends on numerics alone.

pub mod signal;

pub mod diagnosis;
pub mod residual;
pub mod sim;

pub mod compensation;
pub mod plot;
