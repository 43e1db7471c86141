//! The API over real sockets.

mod app;
mod audit;
mod backfill;
mod daemon;
mod dashboard;
mod description;
mod edges;
#[path = "../store_damage/files.rs"]
mod files;
mod fleet;
mod http;
mod lists;
#[path = "../many/mod.rs"]
mod many;
mod plantwide;
#[path = "../peers/postgres.rs"]
mod postgres;
mod resources;
mod rig;
mod store;
#[path = "../swinging/mod.rs"]
mod swinging;
mod tables;
#[cfg(feature = "writeback")]
mod writeback;
