//! The API over real sockets.

mod app;
mod daemon;
mod dashboard;
mod description;
mod edges;
mod http;
mod lists;
mod resources;
mod rig;
mod store;
#[cfg(feature = "writeback")]
mod writeback;
