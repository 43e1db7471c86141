//! System identification, pure: what the diagnosis and the tracing of residuals share.

pub mod armax;
pub mod arx;
pub mod criterion;
pub mod encompass;
pub mod gain_sign;
pub mod gram;
pub mod iddata;
pub mod least_squares;
pub mod missing;
pub mod ols;
pub mod simulate;
pub mod spectrum;
pub mod stats;
pub mod student;
pub mod valve;
pub mod whiteness;
pub mod zeros;
