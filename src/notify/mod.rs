//! Telling others what was found. It only speaks: nothing here listens to a plant or writes to one.

mod config;
pub mod mqtt;

pub use config::Config;
