//! The search for the valve (S, J, stop rule, position at the start) beside given effects.
//!
//! The likelihood of S and J jumps wherever a slip moves to another sample, so that no gradient leads to its maximum. Three
//! searches complement each other:
//!
//! 1. a grid of S, J/S and stop rules, each valve with dynamics of its own (`search.rs`);
//! 2. successive halving (`successive_halving.rs`), for the stop rules whose likelihood is a needle;
//! 3. alternating maximisation: a beam search over all thresholds at once with the dynamics of the best valve so far (`beam.rs`,
//!    `cells.rs`), then the dynamics of what it finds.
//!
//! The penalty of a valve is in `cost.rs`, friction that differs or drifts in `bands.rs`.
//!
//! Valves are fitted by the high-order ARX, whose maximum is unique. A *family* is the valves of one stop rule, with J/S fixed or
//! free. The *rank* of a valve is its deviance, `-2 ln L`, plus twice its penalty over tau.

mod bands;
mod beam;
mod cells;
mod cost;
mod hidden_friction;
mod search;
mod successive_halving;
#[cfg(test)]
mod tests;

pub use bands::{MOST_UNEQUAL, propose_bands};
pub use cost::cost;
pub use hidden_friction::{excluded_friction, hidden_friction};
pub use search::{Effort, Found, LEAST_REVERSALS, search};
