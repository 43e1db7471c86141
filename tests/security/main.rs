//! What somebody may try against the API, and what happens: over real sockets, against the daemon as it is built.
//! docs/security.md lists every test here.

mod access;
mod client;
mod commands;
mod http;
mod names;
mod rig;
mod streams;
mod tls;
