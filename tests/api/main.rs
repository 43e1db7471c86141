//! The API over real sockets.

mod edges;
mod http;
mod resources;
mod rig;
