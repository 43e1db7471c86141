//! Twelve published methods for detecting a sticking valve, as second opinions on the program's own verdict. One file has one
//! publication, and is named after its author and year. Pure: no clock, no files, no randomness.
//!
//! [`Facts`] has what all methods need, computed once: the oscillation of OP and its period, whether the process integrates, and the
//! half cycles of OP and PV. Each method then gives an [`Opinion`]; [`Agreement`] counts them. `docs/benchmark.md` measures how often
//! each is right.
//!
//! | file | what it has |
//! |---|---|
//! | `facts.rs` | the properties that all methods need, from `oscillation.rs`, `integration.rs`, `half_cycles.rs` |
//! | `<author><year>.rs`, `stem_loop.rs` | `evaluate` computes an index, `opinion` compares it with its thresholds, `picture` draws what was evaluated |
//! | `opinion.rs` | the result of one method |
//! | `agreement.rs` | how many methods agree, and whether they cast doubt on the verdict |
//! | `picture.rs` | marks over two axes |
//! | `tally.rs` | hits and misses over records whose truth is known |

mod agreement;
pub mod choudhury2006;
mod facts;
pub mod half_cycles;
pub mod he2007;
pub mod horch1999;
pub mod horch2000;
pub mod integration;
pub mod kano2004;
pub mod lee2008;
mod opinion;
pub mod oscillation;
pub mod picture;
pub mod rossi_scali2005;
pub mod srinivasan2005;
pub mod stem_loop;
pub mod tally;
#[cfg(test)]
mod tests;
pub mod yamashita2006;

pub use agreement::{Agreement, agreement};
pub use facts::Facts;
pub use integration::{Integrates, Integration};
pub use opinion::{Band, Method, Opinion, Quantity, Says};
pub use picture::Picture;

use crate::signal::Window;

/// The opinion of every method on a window, in the order of [`Method::ALL`].
///
/// Where the window cannot be used (too short, values that are not finite, signals that do not move), every method cannot tell, and
/// its opinion has the reason.
///
/// * `integrates`: whether the process integrates, where that is known.
pub fn opinions(window: &Window, integrates: Option<bool>) -> Vec<Opinion> {
    match Facts::new(window, integrates) {
        Ok(facts) => Method::ALL.into_iter().map(|method| opinion(method, &facts)).collect(),
        Err(why) => Method::ALL.into_iter().map(|method| Opinion::cannot_tell(method, why.clone())).collect(),
    }
}

/// The methods that leave out rows that were not measured. All others take the values that were filled in for measurements.
const LEAVE_OUT: [Method; 2] = [Method::StemLoop, Method::Srinivasan2005D];

/// Whether a method can be used, given how often the oscillation was sampled and how many rows were not measured; otherwise the
/// reason. All methods but the measured stem's need the path of OP between its turns.
fn can_be_asked(method: Method, facts: &Facts<'_>) -> Result<(), String> {
    if let Some(why) = facts.undersampled.as_ref().filter(|_| method != Method::StemLoop) {
        return Err(why.clone());
    }
    if LEAVE_OUT.contains(&method) { Ok(()) } else { facts.measured() }
}

/// The opinion of one method.
pub fn opinion(method: Method, facts: &Facts<'_>) -> Opinion {
    if let Err(why) = can_be_asked(method, facts) {
        return Opinion::cannot_tell(method, why);
    }
    match method {
        Method::StemLoop => stem_loop::opinion(facts),
        Method::Horch1999 => horch1999::opinion(facts),
        Method::Horch2000 => horch2000::opinion(facts),
        Method::Yamashita2006 => yamashita2006::opinion(facts),
        Method::Kano2004A => kano2004::opinion_a(facts),
        Method::Kano2004B => kano2004::opinion_b(facts),
        Method::He2007 => he2007::opinion(facts),
        Method::Choudhury2006 => choudhury2006::opinion(facts),
        Method::Srinivasan2005Shape => srinivasan2005::opinion_shape(facts),
        Method::Srinivasan2005D => srinivasan2005::opinion_d(facts),
        Method::Lee2008 => lee2008::opinion(facts),
        Method::RossiScali2005 => rossi_scali2005::opinion(facts),
    }
}

/// Pictures of what a method evaluated; none where it does not apply.
pub fn picture(method: Method, facts: &Facts<'_>) -> Vec<Picture> {
    if can_be_asked(method, facts).is_err() {
        return Vec::new();
    }
    match method {
        Method::StemLoop => stem_loop::picture(facts),
        Method::Horch1999 => horch1999::picture(facts),
        Method::Horch2000 => horch2000::picture(facts),
        Method::Yamashita2006 => yamashita2006::picture(facts),
        Method::Kano2004A => kano2004::picture_a(facts),
        Method::Kano2004B => kano2004::picture_b(facts),
        Method::He2007 => he2007::picture(facts),
        Method::Choudhury2006 => choudhury2006::picture(facts),
        Method::Srinivasan2005Shape => srinivasan2005::picture_shape(facts),
        Method::Srinivasan2005D => srinivasan2005::picture_d(facts),
        Method::Lee2008 => lee2008::picture(facts),
        Method::RossiScali2005 => rossi_scali2005::picture(facts),
    }
}
