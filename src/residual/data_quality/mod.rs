//! Faults of the data that the signals alone show, before any effect is selected: a quantised PV, a frozen PV, clocks of OP and PV
//! that disagree, and single wrong samples. Wrong samples are repaired, and count no longer.

mod clock;
mod equations;
mod fact;
mod frozen;
mod outliers;
pub mod quantised;

pub use clock::of_gate;
pub use fact::Fact;
pub(in crate::residual) use fact::is_measured;

use crate::sysid::iddata::IdData;
use fact::measured;

/// Finds the faults of the data, repairs PV, and sets the weights of wrong samples to 0.
///
/// * `stem`: the likeliest stem of a record. It is asked for the record as repaired so far, because another clock of PV makes another
///   stem likeliest.
pub fn assess(data: &mut IdData, stem: &dyn Fn(&IdData) -> Vec<f64>) -> Vec<Fact> {
    let mut facts = Vec::new();
    // The quantum is that of PV as recorded: a repair puts other values in between.
    let step = quantised::step_of(&measured(data, &data.y));
    data.least_scale = quantised::error_of(step);
    // A quantised PV stands still by itself: where both faults are there, the quantum is reported first.
    facts.extend(quantised::assess(data));
    facts.extend(frozen::assess(data));
    // The clocks come before wrong samples: PV can be predicted only from OP of the right time.
    facts.extend(clock::assess(data, step));
    facts.extend(outliers::assess(data, stem, step));
    facts
}
