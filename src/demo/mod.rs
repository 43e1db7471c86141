//! `stictiond demo`: a simulated plant behind a real Modbus/TCP server, and the daemon watching it.

mod registers;
mod server;
