//! Loads: signals that drive PV independently of the valve.

pub mod cornered_load;
pub mod drift;
pub mod load_step;
pub mod measured_disturbance;
pub mod oscillating_load;
pub mod periodic;
