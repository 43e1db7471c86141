//! Terms added to OP that make a sticking valve move, pure: constant reinforcement and its rivals from the
//! literature. A compensator sees OP and says what to add to it at the same sample; it never replaces OP.
//!
//! ```
//! use stictiond_numerics::compensation::{Compensator, ConstantReinforcement, CrSettings};
//!
//! let mut cr = ConstantReinforcement::new(2.5, [2.4, 2.6], CrSettings::default())?;
//! let terms: Vec<f64> = [50.0, 50.1, 50.2, 50.2, 50.1].iter().map(|&op| cr.step(op, 1.0)).collect();
//! assert_eq!(terms, [0.0, 2.5, 2.5, 0.0, -2.5]);
//! # Ok::<(), stictiond_numerics::compensation::CrError>(())
//! ```

mod cr;
pub mod gate;
pub mod measure;
mod rivals;

pub use cr::{ConstantReinforcement, CrError, CrSettings, Followed};
pub use rivals::{BacklashInverse, Knocker};

/// Something that adds a term to OP.
pub trait Compensator {
    /// The term [% of OP span] for this sample's `op` [%], `dt_s` (s) after the sample before.
    fn step(&mut self, op: f64, dt_s: f64) -> f64;
}

/// The sign of a number with 0 for 0; `signum` says 1 for 0.
fn sign(x: f64) -> f64 {
    if x > 0.0 {
        1.0
    } else if x < 0.0 {
        -1.0
    } else {
        0.0
    }
}
