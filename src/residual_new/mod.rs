//! Tracing anew.
pub mod decide;
pub mod effect;
pub mod forward_selection;
pub mod hypotheses;
pub mod hypothesis;
pub mod posterior;
pub mod report;
pub mod screening;
pub mod valve_search;
pub use crate::residual::{Kind, Parameter};
