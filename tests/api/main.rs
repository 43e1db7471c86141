//! The API over real sockets.

mod app;
mod edges;
mod http;
mod resources;
mod rig;
