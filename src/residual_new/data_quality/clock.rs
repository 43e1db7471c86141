//! Clock.
use super::Fact;
use crate::sysid::iddata::IdData;

/// Tells.
pub fn assess(_data: &mut IdData) -> Option<Fact> {
    None
}
