//! The process: what changes about it, or is not linear.

pub mod dead_time_change;
pub mod gain_change;
pub mod gain_of_pv;
