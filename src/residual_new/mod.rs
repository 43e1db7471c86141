//! Tracing anew.
pub mod data_quality;
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
