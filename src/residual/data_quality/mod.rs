//! Stub until merged.
use super::findings::Kind;
use super::report::Described;
use crate::sysid::iddata::IdData;
/// A fact.
pub struct Fact { pub kind: Kind, pub posterior: f64, pub described: Described }
/// None yet.
pub fn assess(_data: &mut IdData, _stem: &dyn Fn(&IdData) -> Vec<f64>, _known: Option<Kind>) -> Vec<Fact> { Vec::new() }
