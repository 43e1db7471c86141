//! The process: changes of its gain and dead time, and a gain that is not linear.

pub mod dead_time_change;
pub mod gain_change;
pub mod gain_of_pv;
