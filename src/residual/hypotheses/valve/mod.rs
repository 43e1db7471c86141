//! The valve beside its friction: stops, its characteristic, friction that differs or changes.

pub mod asymmetric_friction;
pub mod characteristic;
pub mod friction_drift;
pub mod saturation;
