//! Loads: what drives PV whatever the valve does.

pub mod cornered_load;
pub mod drift;
pub mod load_step;
pub mod measured_disturbance;
pub mod oscillating_load;
