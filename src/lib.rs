//! `stictiond`: which control valves stick, by how much, and how sure that is.
//!
//! The code map, in reading order; data walks one way:
//! `collect -> history -> schedule -> diagnosis -> residual -> results -> serve`.

pub use stictiond_numerics::{
    compensation, detectors, diagnosis, indicators, plantwide, plot, residual, signal, sim, sysid,
};
pub use stictiond_tables::table;

pub mod reproduce;

pub mod access;
pub mod alarm;
pub mod audit;
pub mod backfill;
pub mod bounded;
pub mod collect;
pub mod credentials;
pub mod dial;
pub mod fleet;
pub mod history;
pub mod host;
pub mod mqtt;
pub mod notify;
pub mod protobuf;
pub mod quiet;
pub mod version;

pub mod results;
pub mod schedule;
pub mod serve;
pub mod store;
pub mod work;
pub mod writeback;

pub mod config;

pub mod app;
pub mod demo;
