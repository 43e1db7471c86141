//! Simulated loops of known truth, from generators that share no code: a rate that holds on one alone says little.
//!
//! A generator draws everything about a loop from its case, so that the same case gives the same record.

pub mod a;
pub mod b;
pub mod c;

use stictiond_numerics::residual::Kind;
use stictiond_numerics::signal::Record;

/// How large an undeclared effect is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// At the edge of what an engineer sees with the answer in hand.
    Small,
    /// Plain to an engineer who knows what to look for.
    Medium,
    /// Plain to everybody.
    Large,
}

/// What is asked of a generator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// The undeclared effect; `None` for a clean record.
    pub effect: Option<Kind>,
    /// Its size.
    pub size: Size,
    /// Number of the variant: loop class and valve follow from it, so that consecutive numbers cover all of them.
    pub variant: usize,
    /// Seed of everything else.
    pub seed: u64,
    /// Recorded tags that have nothing to do with the loop.
    pub tags: usize,
}

/// What is true of a record.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// The loop in a few words: class, valve, friction.
    pub name: String,
    /// S/2 in % of OP's span; 0 for a sound valve.
    pub f: f64,
    /// J in % of OP's span; 0 for a sound valve or a pure dead band.
    pub j: f64,
    /// Undeclared effects that are there beside the one asked for (a slip jump, where the valve has one).
    pub also: Vec<Kind>,
    /// What a load at the valve is worth (% of OP's span): the size of a step, the amplitude of a wave, a standard deviation of
    /// a tag, the rise of a ramp over the record; `None` where there is none there, or the generator does not tell it.
    pub load: Option<f64>,
}

/// All generators.
pub const GENERATORS: [Generator; 3] = [a::A, b::B, c::C];

/// A generator: `record` draws a case, `variants` tells how many there are for an effect, `before` draws what a loop was before.
pub struct Generator {
    /// Its letter.
    pub name: &'static str,
    /// How many variants (loop class times valve) an effect has; friction effects need friction.
    pub variants: fn(Option<Kind>) -> usize,
    /// Draws a case.
    pub record: fn(&Case) -> (Record, Truth),
    /// Draws the loop of a case without its effect and with this share of its friction; everything else about it is the case's.
    pub before: fn(&Case, f64) -> Record,
}
