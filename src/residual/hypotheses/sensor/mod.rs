//! The sensor: what PV shows and the output of the process does not have.
//!
//! A sensor that drifts has the same shape in the equation as a load that drifts, so that one hypothesis stands for both
//! ([`super::load::drift`]).

pub mod pv_offset;
