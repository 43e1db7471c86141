//! Write-back under one name for the rest of `app`, whether or not this binary can write.

#[cfg(not(feature = "writeback"))]
mod absent;
#[cfg(feature = "writeback")]
mod enabled;

#[cfg(not(feature = "writeback"))]
pub(super) use absent::WritebackControl;
#[cfg(feature = "writeback")]
pub(super) use enabled::WritebackControl;
